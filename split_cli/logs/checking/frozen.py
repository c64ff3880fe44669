"""Channels that keep one value while others say that it changed: commands too, and channels without noise."""

import numpy as np

from split_cli.logs.checking.checks import LEAST_CORRELATION, Checks
from split_cli.logs.checking.jumps import source_failed
from split_cli.logs.checking.kinematics import SETTLING, fit_slope
from split_cli.logs.checking.relations import ConsistencyFinding

_LIKE_ELSEWHERE = 0.5
"""Of the range that a channel has elsewhere, by which the others say that it changed [1]: a car that is steered or
driven as it is elsewhere does it, and the understeer of a steady circle at rising speed does not. Judgement."""
_BEYOND_MISFIT = 3.0
"""Times the misfit that the relation has elsewhere [1]; judgement."""
_GENTLE = 0.5
"""Of the tyres' grip, up to which a steer angle tells the turning [1]: beyond, a car that slides does not follow."""
_INPUTS = ("T", "delta")
_OTHERS = {"delta": "the car turns as if it were steered", "T": "the car's acceleration says that it changes"}


def frozen_channels(checks: Checks) -> list[ConsistencyFinding]:
    """Report where a channel stands exactly still while what it goes with elsewhere says that it changes.

    Notes
    -----
    Of a relation y = slope x, fitted where the channel changes, the rest y - slope x is constant over a stretch in
    which both stand still, and moves with whatever else moves. Its range from the 10 % to the 90 % quantile counts.
    So a steady circle, a held speed and a command that is written only on change are no fault. An input at the end
    of its range is at its limit, and T = 0 says nothing of brakes.
    """
    places: dict[str, list[tuple[float, float, float]]] = {}
    for y, x, powers, zeroed in checks.beside.values():
        for channel in powers:
            for place in _places(checks, channel, y, x, zeroed):
                places.setdefault(channel, []).append(place)
    return [
        source_failed(
            "stopped",
            channel,
            f"{channel} stands still",
            f"it keeps one value while {_OTHERS.get(channel, 'other channels say that it changes')}",
            [f"{value:.3g} from t = {start:.1f} to {end:.1f} s" for start, end, value in sorted(set(found))],
            "Its source or bus",
        )
        for channel, found in places.items()
    ]


def _places(
    checks: Checks, channel: str, y: np.ndarray, x: np.ndarray, zeroed: bool
) -> list[tuple[float, float, float]]:
    """Return start, end [s] and value of each stretch over which a channel is frozen."""
    k, runs = checks.k, checks.still(channel)
    values, t = k.columns[channel], k.times()
    use = k.moving & np.isfinite(y) & np.isfinite(x)
    if channel == "delta" and checks.vehicle is not None:
        use = use & (np.abs(k.turning()) < _GENTLE * checks.vehicle.lateral_grip)
    elsewhere = use.copy()
    for run in runs:
        elsewhere[run] = False
    slope = fit_slope(y, x, elsewhere, zeroed=zeroed)
    if slope is None or slope.correlation < LEAST_CORRELATION:
        return []
    rest = y - slope.slope * x
    most = max(
        _LIKE_ELSEWHERE * min(_range(y[elsewhere]), abs(slope.slope) * _range(x[elsewhere])),
        _BEYOND_MISFIT * _range(rest[elsewhere]),
    )
    settled = round(SETTLING / k.period)
    limits = {float(np.nanmin(values)), float(np.nanmax(values))} if channel in _INPUTS else set()
    found = []
    for run in runs:
        value = float(values[run.start])
        inside = np.arange(run.start + settled, run.stop)
        inside = inside[use[inside]]
        asked = slope.slope * x[inside]
        if channel == "T" and value == 0.0:
            asked = np.maximum(asked, 0.0)
        if value in limits or len(inside) * k.period < SETTLING or _range(y[inside] - asked) <= most:
            continue
        found.append((float(t[run.start]), float(t[run.stop - 1]), value))
    return found


def _range(values: np.ndarray) -> float:
    return float(np.subtract(*np.quantile(values, [0.9, 0.1]))) if len(values) else 0.0
