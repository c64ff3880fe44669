"""Speeds that are logged in several units: as multiples of each other they tell which is which."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from split_cli.logs.drafting.trial import TrialCandidate
from split_cli.logs.raw import RawSignal

_RATES = ("vx", "vy", "r", "ax", "ay")
"""Channels of which no two are one column, whatever a car does."""
_UNITS = {"m/s": 1.0, "km/h": 3.6, "mph": 1.0 / 0.44704, "kn": 3600.0 / 1852.0}
"""Of speeds, with what 1 m/s is in them [1]; no two pairs of them have one ratio."""
_SAME = 0.01
"""Ratios nearer than this are one [1]; those of two pairs of units are 11 % apart and more."""
_LEFT = 0.02
"""Rms that a multiple leaves of a signal where both are one speed, as a share [1]; slip of tyres leaves less."""


def copies_of_others(
    candidates: Sequence[TrialCandidate], signals: Mapping[str, RawSignal]
) -> dict[tuple[str, ...], str]:
    """Return what to say of columns that hold the numbers of one that means another quantity of motion."""
    alike: dict[bytes, list[TrialCandidate]] = {}
    for c in candidates:
        if c.channel in _RATES and len(c.sources) == 1 and c.sources[0] in signals:
            alike.setdefault(np.ascontiguousarray(signals[c.sources[0]].values).tobytes(), []).append(c)
    found = {}
    for group in alike.values():
        for c in group:
            other = next((o for o in group if o.sources != c.sources and o.channel != c.channel), None)
            if other is not None:
                found[c.sources] = f"holds the numbers of {other.sources[0]}, another quantity: neither is measured"
    return found


def with_units_of_multiples(
    candidates: Sequence[TrialCandidate], signals: Mapping[str, RawSignal]
) -> list[TrialCandidate]:
    """Return the candidates with units of those columns of v_x that are each other's multiples.

    A column `Speed` that is 2.237 times another one is in mph, and the other in m/s. One that states its unit
    tells that of its multiples.
    """
    speeds = [c for c in candidates if c.channel == "vx" and len(c.sources) == 1 and c.sources[0] in signals]
    found: dict[tuple[str, ...], set[str]] = {}
    for first, second in combinations(speeds, 2):
        ratio = _ratio(signals[second.sources[0]], signals[first.sources[0]])
        for one in _UNITS if ratio else ():
            for other in _UNITS:
                if one != other and abs(_UNITS[other] / _UNITS[one] / ratio - 1.0) < _SAME:
                    found.setdefault(first.sources, set()).add(one)
                    found.setdefault(second.sources, set()).add(other)
    sure = {sources: next(iter(units)) for sources, units in found.items() if len(units) == 1}
    note = "as its multiples in other units tell"
    return [
        replace(c, unit=sure[c.sources], note=c.note or note)
        if c.channel == "vx" and c.unit is None and c.sources in sure
        else c
        for c in candidates
    ]


def _ratio(y: RawSignal, x: RawSignal) -> float:
    """Return the factor that makes x to y, of one clock; 0 where they are no multiples."""
    if y.time is not None or x.time is not None or len(y.values) != len(x.values):
        return 0.0
    good = np.isfinite(y.values) & np.isfinite(x.values)
    if np.count_nonzero(good) < 50:
        return 0.0
    values, others = y.values[good], x.values[good]
    square = float(others @ others)
    if square == 0.0 or np.ptp(others) == 0.0:
        return 0.0
    factor = float(values @ others) / square
    left = float(np.sqrt(np.mean((values - factor * others) ** 2)))
    return factor if factor > 0.0 and left < _LEFT * float(np.sqrt(np.mean(values**2))) else 0.0
