"""Fields of the policy: a constant with unit, meaning and origin, and kinds of constants by what they decide."""

from dataclasses import field
from typing import Any

THEORY, JUDGEMENT = "theory: ", "judgement: "
CHOSEN = JUDGEMENT + "chosen while developing on cases of `split prove`, without a study of its own"

#: Constants that do not decide on a difference, its name or its size, by kind and name. A group stands for all of its
#: constants that no other kind names. Guards refuse a recording or leave rows out, effort bounds computing time, and
#: "report" chooses what a report says of a gap.
KINDS = {
    kind: tuple(names.split())
    for kind, names in {
        "guards": """
            screening comparison.least_rows comparison.least_share believing.rolling_share believing.lost_share
            believing.rolling_seconds believing.least_rolling believing.cycling_seconds believing.cycling_share
            unnamed.fewest""",
        "effort": """
            selection.few_names selection.full_fits selection.considered selection.rounds selection.swaps
            selection.beginnings""",
        "report": """
            comparison.holdout_share abstention.most_leads reporting.least_dependence reporting.clearly_more
            reporting.local_gap reporting.local_ratio reporting.stable reporting.formula_terms reporting.much_slipping
            reporting.least_compared""",
    }.items()
}
DECIDES = "decides"
# A sensor out of scale is a difference, whatever the drives show otherwise.
_SCALES = ("screening.least_scale_error", "screening.sure_scale_error")


def number(default: float, unit: str, meaning: str, origin: str) -> Any:
    """Return a field of a policy with its unit, meaning and origin as metadata."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "origin": origin})


def kind_of(name: str) -> str:
    """Return the kind of a constant by its name `group.number`: a key of `KINDS`, or `DECIDES`."""
    if name in _SCALES:
        return DECIDES
    group = name.partition(".")[0]
    return next((kind for kind, names in KINDS.items() if name in names or group in names), DECIDES)
