"""Whether v_y, and X, Y from which it may be derived, are of the place where a_y is measured."""

import numpy as np

from split_cli.logs.checking.checks import Checks, Unjudged
from split_cli.logs.checking.kinematics import block_interval
from split_cli.logs.checking.relations import ConsistencyFinding

_SURE = 4.0
"""Standard errors from which on a place differs from another [1]."""
_FAR_BETTER = 0.25
"""Variance that a place leaves, of what delays, gain and offset leave without it, from which on it is one [1]."""
_NEAR = 0.3
"""Of the distance from the CG to an axle, within which a place is that axle's [1]."""


def behind_the_accelerometer(checks: Checks) -> list[ConsistencyFinding]:
    """Tell how far behind the accelerometer v_y is measured, where that is the distance of an axle from the CG.

    a_y - v_x r - dv_y/dt = x dr/dt + tau v_x dr/dt + sigma da_y/dt + c a_y + b, with x the distance [m]. Delays
    tau of r and sigma of a_y, a gain c and an offset b are not reported, and where they do as well, no place is. A
    message of odometry is often of the middle of the rear axle.
    """
    k, car = checks.k, checks.vehicle
    if checks.of_pose and not checks.usable("ay"):
        away = (
            "a v_y derived from a pose off the CG is wrong by its distance times r, and no a_y tells the distance"
        )
        checks.unjudged.append(
            Unjudged("place of X, Y", f"{away}: set `position:` for X and Y if they are not of the CG")
        )
    if car is None or not checks.usable("r", "ay") or not checks.known("vx"):
        return []
    if not (checks.of_pose or checks.usable("vy")):
        return []
    lateral, turning = k.signal("ay"), k.rate("r")
    rest = lateral - k.of("vx r", lambda: k.columns["vx"] * k.columns["r"]) - k.rate("vy")
    delayed = k.rate("ay")
    use = k.moving & np.isfinite(rest * turning * delayed)
    if np.count_nonzero(use) < 300:
        return []
    late = k.signal("vx") * turning
    design = np.stack([part[use] for part in (turning, late, delayed, lateral, np.ones(k.count))], axis=1)
    y = rest[use]
    if np.linalg.matrix_rank(design / np.maximum(np.linalg.norm(design, axis=0), 1e-300)) < design.shape[1]:
        return []
    fitted, errors = block_interval(lambda rows: np.linalg.lstsq(design[rows], y[rows], rcond=None)[0], len(y))
    x, error = float(fitted[0]), float(errors[0])
    # A delay acts as a place does at one speed; of a large one, the first derivative is not all.
    without = np.delete(design, 0, axis=1)
    rest_without = y - without @ np.linalg.lstsq(without, y, rcond=None)[0]
    if np.var(y - design @ fitted) > _FAR_BETTER * np.var(rest_without):
        return []
    axle, reach = ("rear", car.cg_to_rear_axle) if x > 0.0 else ("front", car.cg_to_front_axle)
    if abs(x) < _SURE * error or abs(abs(x) - reach) > _NEAR * reach:
        return []
    whose, entries = ("X, Y and v_y of them are", "X and Y") if checks.of_pose else ("v_y is", "vx and vy")
    text = (
        f"{whose} of a point {abs(x):.2f} +- {max(error, 0.01):.2f} m {'behind' if x > 0.0 else 'ahead of'} the "
        f"accelerometer: by a_y - v_x r - dv_y/dt against dr/dt. If that is at the CG, it is the {axle} axle: "
        f"set `position: {axle}_axle` for {entries}. If not, give `position:` of ax and ay."
    )
    return [ConsistencyFinding("place", "vy", text, float(x), float(error))]
