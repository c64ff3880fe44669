"""Score of one case (exact, class, abstained, missed, wrong), and rates with Wilson intervals."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sqrt

_Z = 1.959963984540054

OUTCOMES = ("exact", "class", "abstained", "missed", "wrong")


@dataclass(frozen=True)
class Named:
    """One finding of a diagnosis."""

    term: str
    # With the ends of the 95 % interval.
    parameters: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    alternatives: tuple[str, ...] = ()
    variant: str = ""


@dataclass(frozen=True)
class Statement:
    """What was said of a case."""

    verdict: str  # match, mismatch or undecided
    findings: tuple[Named, ...] = ()
    unexplained: bool = False


def judge(truth: Sequence[str], said: Statement, *, in_catalogue: bool = True) -> str:
    """Return how a statement fares against the truth.

    Parameters
    ----------
    truth : sequence of str
        The concealed terms; empty for a null.
    in_catalogue : bool
        Whether the truth has a name in the catalogue.

    Returns
    -------
    str
        ``exact``: just the true terms are named (for a null: no mismatch; for an effect outside the catalogue:
        unexplained). ``class``: every finding is true or has a true one among its alternatives, and no true one
        is left out. ``abstained``: unexplained, and not exact nor in class. ``missed``: match or undecided.
        ``wrong``: all else, which is what a reader would believe without reason: a wrong name, a name too many,
        a true one left out without a word; for a null any mismatch.
    """
    if said.verdict != "mismatch":
        return "exact" if not truth else "missed"
    if not truth:
        return "wrong"
    if not in_catalogue:
        return "exact" if said.unexplained else "wrong"
    named = [finding.term for finding in said.findings]
    if sorted(named) == sorted(truth):
        return "exact"
    if _in_class(truth, said):
        return "class"
    return "abstained" if said.unexplained else "wrong"


def _in_class(truth: Sequence[str], said: Statement) -> bool:
    """Tell whether the true terms are reached by replacing findings by their alternatives.

    An alternative ``a+b`` of one finding stands for both terms.
    """
    reached = [set()]
    for finding in said.findings:
        options = [{finding.term}, *({*option.split("+")} for option in finding.alternatives)]
        reached = [before | option for before in reached for option in options][:4096]
    return bool(said.findings) and any(one == set(truth) for one in reached)


@dataclass(frozen=True)
class Rate:
    """A share with its 95 % Wilson interval."""

    hits: int
    of: int
    # low, high: [1]; 0 and 1 when nothing was counted.
    low: float
    high: float

    @property
    def share(self) -> float | None:
        """hits/of, None when nothing was counted."""
        return self.hits / self.of if self.of else None

    def __str__(self) -> str:
        if not self.of:
            return "-"
        share, low, high = (100.0 * value for value in (self.hits / self.of, self.low, self.high))
        return f"{share:.1f} % ({self.hits}/{self.of}; {low:.1f} to {high:.1f})"


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return the ends of the 95 % Wilson score interval of a share.

    Notes
    -----
    The p with |p_hat - p| <= z sqrt(p (1 - p)/n): (p_hat + z^2/2n +- z sqrt(p_hat (1 - p_hat)/n + z^2/4n^2))
    /(1 + z^2/n); Wilson, J. Am. Stat. Assoc. 22 (1927), 209.
    """
    if of == 0:
        return 0.0, 1.0
    share, z2 = hits / of, _Z**2
    middle = share + z2 / (2 * of)
    spread = _Z * sqrt(share * (1.0 - share) / of + z2 / (4.0 * of * of))
    return max(0.0, (middle - spread) / (1.0 + z2 / of)), min(1.0, (middle + spread) / (1.0 + z2 / of))


def share_of_true(outcomes: Sequence[bool]) -> Rate:
    """Return the share of true entries."""
    hits = sum(bool(o) for o in outcomes)
    return Rate(hits, len(outcomes), *wilson(hits, len(outcomes)))
