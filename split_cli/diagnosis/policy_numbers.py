"""How a number that decides is written down: value, unit, meaning, origin."""

from __future__ import annotations

from dataclasses import field
from typing import Any

__all__ = ["CHOSEN", "JUDGEMENT", "THEORY", "number"]

THEORY, JUDGEMENT = "theory: ", "judgement: "
CHOSEN = JUDGEMENT + "chosen while developing on cases of `split prove`, without a study of its own"


def number(default: float, unit: str, meaning: str, origin: str) -> Any:
    """Return a field of a policy whose metadata hold what a reader asks of a number."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "origin": origin})
