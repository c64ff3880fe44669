"""Fields of the policy: a constant with unit, meaning and origin."""

from dataclasses import field
from typing import Any

THEORY, JUDGEMENT = "theory: ", "judgement: "
CHOSEN = JUDGEMENT + "chosen while developing on cases of `split prove`, without a study of its own"


def number(default: float, unit: str, meaning: str, origin: str) -> Any:
    """Return a field of a policy with its unit, meaning and origin as metadata."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "origin": origin})
