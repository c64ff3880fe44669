"""Whether velocities and accelerations are along the axes they should be: swapped, or along those of the world."""

import numpy as np

from split_cli.logs.checking.checks import LEAST_CORRELATION, Checks
from split_cli.logs.checking.kinematics import Slope, fit_slope
from split_cli.logs.checking.relations import ConsistencyFinding

_SIDESLIP = 0.95
"""Mean cosine of the direction of (v_x, v_y), above which it may be sideslip: 18 degrees rms."""


def look_swapped(checks: Checks) -> bool:
    """Tell whether v_y carries the motion: larger than v_x, and the ground speed where that is known."""
    if not checks.usable("vx", "vy"):
        return False
    vx, vy = checks.k.columns["vx"], checks.k.columns["vy"]
    if not np.nanmean(vy**2) > 4.0 * np.nanmean(vx**2):
        return False
    if checks.usable("X", "Y"):
        return _agreement(np.abs(vy), checks.k.ground_speed()) > 0.8
    # A car travels one way: in another unit v_y is larger too, but to both sides.
    one_way = [abs(np.nanmean(v)) / np.sqrt(np.nanmean(v**2)) if np.any(v) else 0.0 for v in (vx, vy)]
    return bool(one_way[1] > one_way[0])


def swap_finding(checks: Checks) -> ConsistencyFinding:
    """Say that v_x and v_y are swapped."""
    vx, vy = checks.k.columns["vx"], checks.k.columns["vy"]
    ratio = float(np.sqrt(np.nanmean(vy**2) / max(np.nanmean(vx**2), 1e-12)))
    return ConsistencyFinding(
        "swapped",
        "vx",
        f"v_y is {ratio:.3g} times as large as v_x: the two look swapped. Exchange their sources in the map. "
        "Nothing else was judged.",
        ratio,
    )


def along_the_world(checks: Checks) -> list[ConsistencyFinding]:
    """Tell whether the direction of (v_x, v_y) turns as the car does: then they are along the world's axes.

    Of the car's own velocity the direction is the sideslip, which stays near 0.
    """
    if not checks.usable("vx", "vy"):
        return []
    k = checks.k
    vx, vy = k.signal("vx"), k.signal("vy")
    squared = vx * vx + vy * vy
    moving = squared > 0.04 * np.nanquantile(squared, 0.95) if np.isfinite(squared).any() else np.isfinite(vx)
    if np.count_nonzero(moving) < 50:
        return []
    forward = float(np.nanmean(np.cos(np.arctan2(vy, vx)[moving])))
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = (vx * k.rate("vy") - vy * k.rate("vx")) / squared
    # First the path: its direction has no unit and no zero.
    turnings = (("X", k.course_rate), ("yaw", lambda: k.rate("yaw")), ("r", lambda: k.signal("r")))
    slopes = [fit_slope(turned, of(), moving) for channel, of in turnings if checks.usable(channel)]
    slope = next((s for s in slopes if s is not None and _is_one(s)), None)
    if slope is None or forward > _SIDESLIP:
        return []
    text = (
        f"the direction of (v_x, v_y) turns with the car (slope {slope.slope:.3g}, correlation "
        f"{slope.correlation:.3f}): they are along the axes of the world, not of the car. Map the car's own, "
        "or leave vx and vy out and give X, Y and yaw with `--derive velocity-from-pose`. "
        "Nothing else was judged."
    )
    return [ConsistencyFinding("world", channel, text, slope.slope, slope.error) for channel in ("vx", "vy")]


def exchanged_accelerations(checks: Checks) -> list[ConsistencyFinding]:
    """Return accelerations that do not go with their own motion and do with the other's."""
    if not checks.usable("ax") or not (checks.usable("r") or checks.usable("X", "Y")):
        return []
    inertial = checks.k.rate("vx") - checks.carried()
    rate = checks.k.columns["r"] if checks.usable("r") else checks.k.course_rate()
    turning = checks.k.columns["vx"] * rate
    motions = {"ax": (inertial, "dv_x/dt - v_y r"), "ay": (turning, "v_x r")}
    found = []
    for channel, other in (("ax", "ay"), ("ay", "ax")):
        if not checks.usable(channel):
            continue
        signal = checks.k.signal(channel)
        own, across = (fit_slope(signal, motions[c][0], checks.k.moving) for c in (channel, other))
        if own is None or across is None or abs(across.correlation) < LEAST_CORRELATION:
            continue
        if abs(own.correlation) < abs(across.correlation) - 0.5:
            text = (
                f"{channel[0]}_{channel[1]} goes with {motions[other][1]} (correlation "
                f"{across.correlation:.2f}), not with {motions[channel][1]} ({own.correlation:.2f}): it is "
                "along the other axis. Exchange the sources of a_x and a_y in the map."
            )
            found.append(ConsistencyFinding("swapped", channel, text, across.correlation))
    return found


def _is_one(slope: Slope) -> bool:
    """Tell whether two signals are equal but for the sign, within 30 %."""
    return abs(slope.correlation) > LEAST_CORRELATION and abs(np.log(abs(slope.slope))) < 0.3


def _agreement(a: np.ndarray, b: np.ndarray) -> float:
    use = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(use) < 50 or np.std(a[use]) == 0 or np.std(b[use]) == 0:
        return 0.0
    return float(np.corrcoef(a[use], b[use])[0, 1])
