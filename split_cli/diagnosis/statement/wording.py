"""Numbers and names as a reader wants them: enough digits, signs as words, terms in words."""

from __future__ import annotations

import math

from split_cli.diagnosis.statement.result import ParameterEstimate

__all__ = ["amount", "number", "percent", "term_name", "term_with_id", "variable_name"]

_VARIABLES = {
    "v_x": ("longitudinal velocity", "m/s"),
    "v_y": ("lateral velocity", "m/s"),
    "r": ("yaw rate", "rad/s"),
    "T": ("torque", "N m"),
    "delta": ("steer angle", "rad"),
    "alpha_f": ("front slip angle", "rad"),
    "alpha_r": ("rear slip angle", "rad"),
    "a_x": ("longitudinal acceleration", "m/s^2"),
    "a_y": ("lateral acceleration", "m/s^2"),
    "steer_rate": ("steer rate", "rad/s"),
    "t": ("time", "s"),
    "s": ("track position", "m"),
}
_MOST_DECIMALS = 9
_BADLY_KNOWN = 0.4  # half an interval over its value, from which on the value's own digits mean nothing
# Small lengths and times are read in thousandths: a model car's centre of gravity moves by millimetres.
_THOUSANDTHS = {"m": ("mm", 0.1), "s": ("ms", 1.0)}


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
    estimate: ParameterEstimate,
    *,
    neutral: float = 0.0,
    more: str = "",
    less: str = "",
    share: bool = False,
    one_sided: bool = False,
) -> str:
    """Return how far a parameter is from `neutral`, its sign as a word, with its interval.

    Parameters
    ----------
    estimate : ParameterEstimate
    neutral : float
        Where the term vanishes.
    more, less : str
        Words for above and below; without them the sign stays a sign.
    share : bool
        Whether to tell the difference in per cent.
    one_sided : bool
        Whether there is nothing below `neutral`, whatever the interval says.

    Returns
    -------
    str
        ``3.02 mm further back (95 %: 2.11 to 3.93 mm)``, ``1.2 % less (95 %: 3.1 % less to 0.7 % more)``.
    """
    unit, scale = ("%", 100.0) if share else _unit(estimate, neutral)
    value, *limits = (scale * (x - neutral) for x in (estimate.value, *estimate.interval_95))
    low, high = sorted(limits)
    if one_sided:
        low = max(low, 0.0)
    places = _shared_decimals(value, low, high)
    unit = f" {unit}" if unit not in ("", "1") else ""

    def told(x: float, sign: bool = False) -> str:
        size = x if sign else abs(x)
        return f"{size:,.{places}f}" if round(size, places) else "0"

    if not more:
        interval = f"{told(low, True)} to {told(high, True)}{unit}"
        text = f"{told(value, True)}{unit}"
    else:
        text = f"{told(value)}{unit} {more if value >= 0.0 else less}"
        if low < 0.0 < high and less:
            interval = f"{told(low)}{unit} {less} to {told(high)}{unit} {more}"
        else:
            first, last = sorted((abs(low), abs(high)))
            interval = f"{told(first)} to {told(last)}{unit}"
    return f"{text} (95 %: {interval})" if math.isfinite(low + high) else text


def term_name(term: str) -> str:
    """Return a term in words: ``cg_shift+steer_gain`` is "CG shift and steer gain together"."""
    parts = [part.replace("_", " ").replace("cg ", "CG ") for part in term.split("+")]
    if len(parts) == 1:
        return parts[0]
    return f"{', '.join(parts[:-1])} and {parts[-1]} together"


def term_with_id(term: str) -> str:
    """Return a term in words with its id behind."""
    return f"{term_name(term)} ({term})"


def variable_name(name: str) -> tuple[str, str]:
    """Return a variable's name in words and its unit."""
    return _VARIABLES.get(name, (name.replace("_", " "), ""))


def _unit(estimate: ParameterEstimate, neutral: float) -> tuple[str, float]:
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
