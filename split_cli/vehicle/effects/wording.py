"""Numbers as a reader wants them in a statement: enough digits, signs as words, small lengths in millimetres."""

import math
from collections.abc import Mapping
from typing import Protocol

__all__ = ["Estimate", "Estimates", "amount", "late", "number", "percent", "scaled"]

_MOST_DECIMALS = 9
_BADLY_KNOWN = 0.4  # half an interval over its value, from which on the value's own digits mean nothing
# Small lengths and times are read in thousandths: a model car's centre of gravity moves by millimetres.
_THOUSANDTHS = {"m": ("mm", 0.1), "s": ("ms", 1.0)}


class Estimate(Protocol):
    """One estimated parameter: value, unit, and 95 % interval; its standard error may be unknown."""

    @property
    def value(self) -> float:
        """The estimate, in `unit`."""

    @property
    def std_error(self) -> float | None:
        """Its standard error."""

    @property
    def unit(self) -> str:
        """SI unit."""

    @property
    def interval_95(self) -> tuple[float, float]:
        """Lower and upper end."""


Estimates = Mapping[str, Estimate]


def number(value: float, digits: int = 3) -> str:
    """Return a number with some significant digits, never by a power of ten: ``0.00146``, ``12,300``."""
    if not math.isfinite(value):
        return "unknown"
    return f"{value:,.{_decimals(value, digits)}f}"


def percent(share: float) -> str:
    """Return a share in per cent; never 100 or 0 for what only comes close."""
    scaled = 100.0 * share
    if 0.0 < scaled < 1.0:
        return "less than 1 %"
    if 99.0 < scaled < 100.0:
        return "over 99 %"
    return f"{scaled:.0f} %"


def amount(
    estimate: Estimate,
    *,
    neutral: float = 0.0,
    more: str = "",
    less: str = "",
    share: bool = False,
    one_sided: bool = False,
    unsigned: bool = False,
) -> str:
    """Return how far a parameter is from `neutral`, its sign as a word, with its interval.

    Parameters
    ----------
    neutral : float
        Where the term vanishes.
    more, less : str
        Words for above and below; without them the sign stays a sign.
    share : bool
        Whether to tell the difference in per cent.
    one_sided : bool
        Whether there is nothing below `neutral`, whatever the interval says.
    unsigned : bool
        Whether only the size is stated, without its sign.

    Returns
    -------
    str
        ``3.02 mm further back (95 %: 2.11 to 3.93 mm)``, ``1.2 % less (95 %: 3.1 % less to 0.7 % more)``.
    """
    unit, scale = ("%", 100.0) if share else _unit(estimate, neutral)
    value, *limits = (scale * (x - neutral) for x in (estimate.value, *estimate.interval_95))
    if unsigned and value < 0.0:
        value, limits = -value, [-x for x in limits]
    low, high = sorted(limits)
    if one_sided:
        low = max(low, 0.0)
    places = _shared_decimals(value, low, high)
    unit = f" {unit}" if unit not in ("", "1") else ""

    def rounded(x: float, sign: bool = False) -> str:
        size = x if sign else abs(x)
        return f"{size:,.{places}f}" if round(size, places) else "0"

    if not more:
        interval = f"{rounded(low, True)} to {rounded(high, True)}{unit}"
        text = f"{rounded(value, True)}{unit}"
    else:
        text = f"{rounded(value)}{unit} {more if value >= 0.0 else less}"
        if low < 0.0 < high and less:
            interval = f"{rounded(low)}{unit} {less} to {rounded(high)}{unit} {more}"
        else:
            first, last = sorted((abs(low), abs(high)))
            interval = f"{rounded(first)} to {rounded(last)}{unit}"
    return f"{text} (95 %: {interval})" if math.isfinite(low + high) else text


def scaled(scale: Estimate, more: str, less: str) -> str:
    """Return by how many per cent a scale, 1 in the simulation, is more or less."""
    return amount(scale, neutral=1.0, share=True, more=more, less=less)


def late(estimate: Estimate) -> str:
    """Return how late something is, a time that has no sign."""
    return amount(estimate, one_sided=True, more="late", less="late")


def _unit(estimate: Estimate, neutral: float) -> tuple[str, float]:
    small, below = _THOUSANDTHS.get(estimate.unit, ("", 0.0))
    if abs(estimate.value - neutral) < below:
        return small, 1e3
    return estimate.unit, 1.0


def _decimals(value: float, digits: int) -> int:
    size = math.floor(math.log10(abs(value))) if value else 0
    return min(max(digits - 1 - size, 0), _MOST_DECIMALS)


def _shared_decimals(value: float, low: float, high: float) -> int:
    """Return decimals for a value and its interval: as many as the interval's width has digits to tell.

    Of a value that is well known three significant digits at least, five at most however narrow the interval.
    """
    half = 0.5 * (high - low)
    if not 0.0 < half < math.inf:
        return _decimals(value, 3)
    if half > _BADLY_KNOWN * abs(value):
        return _decimals(half, 2)
    return max(_decimals(value, 3), min(_decimals(half, 2), _decimals(value, 5)))
