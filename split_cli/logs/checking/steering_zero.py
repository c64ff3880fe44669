"""Where a steering sensor has its zero: on straights, or between turns of both hands."""

import numpy as np

from split_cli.logs.checking.kinematics import Kinematics, median_of
from split_cli.logs.checking.relations import ConsistencyFinding
from split_cli.vehicle.parameters import Vehicle

_CROOKED = 0.015
"""Road-wheel angle on straights that is no play of the steering [rad]: 13 deg of a steering wheel."""
_OTHER_HAND = 0.2
"""Share of the turning that the rarer hand has [1]; judgement: with less, understeer and zero look alike."""
_BLOCKS = 10


def steering_zero(k: Kinematics, vehicle: Vehicle, straight: np.ndarray | None) -> list[ConsistencyFinding]:
    """Return a finding where delta is not zero when the car does not turn.

    Parameters
    ----------
    k : Kinematics
        With v_x, r and delta.
    vehicle : Vehicle
        Its wheelbase.
    straight : ndarray of bool, shape (N,), or None
        Rows in which the car goes straight; None where there are too few. Then turns of both hands decide: the
        steer angle without its zero is odd in the turning, delta = a r/v_x + b v_x r + c (v_x r)^3 + zero.
    """
    if straight is None:
        found = _between_hands(k)
        where = "between left and right turns"
    else:
        rest = k.signal("delta") - vehicle.wheelbase * k.signal("r") / k.signal("vx")
        found = median_of(rest[straight])
        where = "on straights"
    if found is None or abs(found[0]) < _CROOKED or abs(found[0]) < 4.0 * found[1]:
        return []
    bias, error = found
    text = (
        f"delta reads {bias:+.4f} +- {error:.4f} rad ({np.degrees(bias):+.2f} deg) {where}: a sensor "
        "that is not at zero, or a car that needs it to go straight. "
        f"An `offset:` of {-bias:.4f} rad takes it off, written in the entry's unit; it counts after `scale:`."
    )
    return [ConsistencyFinding("bias on straights", "delta", text, bias, error)]


def _between_hands(k: Kinematics) -> tuple[float, float] | None:
    """Return zero and standard error of delta by turns of both hands [rad], the error by blocks left out."""
    vx, r, delta = (k.signal(name) for name in ("vx", "r", "delta"))
    rows = np.flatnonzero(k.moving & np.isfinite(vx) & np.isfinite(r) & np.isfinite(delta))
    if len(rows) < 100 * _BLOCKS:
        return None
    vx, r, delta = vx[rows], r[rows], delta[rows]
    left = float(np.mean(r > 0.0))
    if min(left, 1.0 - left) < _OTHER_HAND:
        return None
    lateral = vx * r / np.std(vx * r)
    design = np.stack([r / vx, lateral, lateral**3, np.ones(len(r))], axis=1)

    def zero(chosen: np.ndarray) -> float:
        return float(np.linalg.lstsq(design[chosen], delta[chosen], rcond=None)[0][-1])

    block = np.arange(len(r)) * _BLOCKS // len(r)
    parts = np.array([zero(block != b) for b in range(_BLOCKS)])
    error = float(np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((parts - parts.mean()) ** 2)))
    return zero(block >= 0), error
