"""The path of X, Y beside yaw and v_y: another zero, a course instead of a yaw, a v_y that is mostly error."""

import numpy as np

from split_cli.logs.checking.checks import LEAST_CORRELATION, Checks, Unjudged
from split_cli.logs.checking.kinematics import (
    Kinematics,
    around_mean,
    fit_linear,
    fit_slope,
    has_dependent_columns,
    robust_spread,
)
from split_cli.logs.checking.relations import ConsistencyFinding

_LEAST_DIRECTION = 0.05
"""Smaller errors of a direction are those of an ordinary pose [rad]; judgement."""
_SURELY, _LEAST_ZERO = 3.0, 0.005
"""Standard errors, and angle [rad], within which a zero is a multiple of 90 degrees, as makers choose."""
_NO_UNIT = 5.0
"""Times a speed that no unit makes of it: km/h makes 3.6 [1]."""
_LEAST_REAR_SLIP = 1e-3
"""Slip of the rear axle a unit of lateral acceleration that every car exceeds [rad/(m/s^2)]: racing tyres carry at
most some 40 times their load a radian, which makes 2.5e-3."""


def direction_of_travel(checks: Checks, with_velocity: bool = True) -> list[ConsistencyFinding]:
    """Compare yaw with the direction in which X, Y moves, its sideslip taken off `with_velocity`."""
    if not checks.usable("X", "Y", "yaw") or not checks.known("vx"):
        return []
    k = checks.k
    measured = with_velocity and checks.usable("vy")
    sideslip = np.arctan2(k.signal("vy"), k.signal("vx")) if measured else 0.0
    centre, off = around_mean(k.travel_from_yaw() - sideslip)
    # A pose that stands still while v_x says otherwise travels nowhere.
    if np.count_nonzero(np.isfinite(off) & (k.ground_speed() > 0.0)) < 50:
        return []
    zero, error = _without_turning(k, off, not measured)
    centre, off = centre + zero, off[np.isfinite(off)] - zero
    quarter = 0.5 * np.pi * round(centre / (0.5 * np.pi))
    if abs(centre - quarter) < max(_SURELY * error, _LEAST_ZERO):
        centre = quarter
    spread = robust_spread(off)
    if abs(centre) < _LEAST_DIRECTION or abs(centre) < 2.0 * spread:
        if spread > 0.3 and checks.of_pose:
            text = (
                f"yaw and the travel of X, Y differ by {spread:.2f} rad at random: they are not of one pose. "
                "The v_y that is derived from them means nothing: map X, Y and yaw of one estimator."
            )
            return [ConsistencyFinding("contradiction", "vy", text, spread, None)]
        if spread > 0.3:
            checks.unjudged.append(
                Unjudged("yaw against the travel of X, Y", f"they differ by {spread:.2f} rad at random")
            )
        return []
    text = (
        f"X, Y travels {np.degrees(centre):+.1f} deg off yaw (spread {np.degrees(spread):.1f} deg): yaw has "
        f"another zero than the map's X axis. Use `offset: {centre:.4f}` rad for yaw, or set `world:`."
    )
    return [ConsistencyFinding("direction", "yaw", text, centre, spread)]


def _without_turning(k: Kinematics, off: np.ndarray, slips: bool) -> tuple[float, float]:
    """Return the direction of travel off yaw where the car goes straight [rad], and its standard error.

    off = zero + p r/v_x - q v_x r, the steady sideslip at the place of X, Y, if `slips`; else its mean. A lap has
    more turns to one side: the mean of its sideslip is no zero, and made a v_y of 0.2 m/s.
    """
    v, r = k.ground_speed(), k.rate("yaw")
    use = np.isfinite(off * v * r) & (v > 0.0)
    parts = [np.ones(np.count_nonzero(use))]
    if slips and np.any(r[use] != 0.0):
        parts += [r[use] / v[use], v[use] * r[use]]
    design, y = np.stack(parts, axis=1), off[use]
    fitted, errors = fit_linear(design, y)
    return float(fitted[0]), float(errors[0])


def velocity_across(checks: Checks) -> list[ConsistencyFinding]:
    """Look for a v_y that is mostly error: it varies much more than the path across yaw, and not with it.

    What the variance of v_y/v_x exceeds that of the path by is error of v_y, whatever the noise of the pose.
    """
    if not checks.usable("X", "Y", "yaw", "vy") or not checks.known("vx"):
        return []
    k = checks.k
    sideslip, path = k.sideslip(), k.path_across()
    slope = fit_slope(sideslip, path, k.moving)
    if slope is None or abs(slope.correlation) >= LEAST_CORRELATION:
        return []
    measured, true = (_spread_of(values) for values in (sideslip, path))
    error = float(np.sqrt(max(measured**2 - true**2, 0.0)))
    if error < _LEAST_DIRECTION or measured < 2.0 * true:
        return []
    text = (
        f"v_y does not follow the path: v_y/v_x spreads by {measured:.2g} rad, the travel of X, Y across yaw "
        f"by {true:.2g} rad, and the two correlate by {slope.correlation:.2f} only. At least {error:.2g} rad "
        "of it is error. Map another v_y, or leave it out and pass `--derive velocity-from-pose`."
    )
    return [ConsistencyFinding("contradiction", "vy", text, measured, None)]


def velocity_along(checks: Checks) -> list[ConsistencyFinding]:
    """Look for a v_x that is no speed of this car: far larger than that of X, Y, and not varying with it.

    Noise of a pose only adds to its speed.
    """
    if not checks.usable("X", "Y") or not checks.known("vx"):
        return []
    k = checks.k
    vx, path = k.signal("vx"), np.hypot(k.rate("X"), k.rate("Y"))
    slope = fit_slope(np.abs(vx), path, np.isfinite(path))
    if slope is not None and slope.correlation >= LEAST_CORRELATION:
        return []
    both = np.isfinite(vx) & np.isfinite(path)
    recorded, true = (float(np.sqrt(np.mean(v[both] ** 2))) if both.any() else 0.0 for v in (vx, path))
    if recorded <= _NO_UNIT * true or np.ptp(vx[both]) == 0.0:
        return []
    relation = "do not vary together" if slope is None else f"correlate by {slope.correlation:.2f} only"
    text = (
        f"v_x does not follow the path: {recorded:.3g} m/s (rms) where X, Y moves at {true:.2g} m/s, and the two "
        f"{relation}. Map another v_x, or leave it out and pass `--derive velocity-from-pose`."
    )
    return [ConsistencyFinding("contradiction", "vx", text, recorded, None)]


def yaw_is_course(checks: Checks) -> list[ConsistencyFinding]:
    """Tell a yaw that is the direction of travel: rear tyres slip when they carry force, a course does not.

    The path across yaw is v_x tan(angle) = p r - q v_x^2 r + b with q the slip of the rear axle a unit of lateral
    acceleration, wherever on the car X, Y is.
    """
    if not checks.usable("X", "Y", "yaw") or not checks.known("vx", "r"):
        return []
    k = checks.k
    vx, r = k.signal("vx"), k.signal("r")
    path = k.path_across() * vx
    use = k.moving & np.isfinite(path * vx * r)
    if np.count_nonzero(use) < 300:
        return []
    design = np.stack([r[use], -(vx[use] ** 2) * r[use], np.ones(np.count_nonzero(use))], axis=1)
    if has_dependent_columns(design):
        return []  # straight ahead, or round one circle at one speed, as a simulation can
    (_, q, _), (_, q_error, _) = fit_linear(design, path[use])
    if abs(q) + 4.0 * q_error > _LEAST_REAR_SLIP:
        return []
    text = (
        f"yaw shows no slip of tyres: {1e3 * q:.2g} +- {1e3 * q_error:.1g} mrad a m/s^2 of lateral acceleration, "
        "and no car does with less than 1. It is the course over ground, or a simulation without slip. "
        "A v_y derived from a course is zero: map a yaw that is measured, or leave yaw out."
    )
    return [ConsistencyFinding("course", "yaw", text, float(q), float(q_error))]


def _spread_of(values: np.ndarray) -> float:
    return robust_spread(values[np.isfinite(values)])
