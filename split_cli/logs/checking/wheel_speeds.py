"""Speeds of the wheels of an axle: what turning adds to one of them it takes from the other."""

from collections.abc import Callable

import numpy as np

from split_cli.logs.checking.kinematics import Kinematics, Slope, fit_slope

AXLES = (("wheel_speed_fl", "wheel_speed_fr"), ("wheel_speed_rl", "wheel_speed_rr"))
"""Left and right wheel of each axle."""
_SIDES_APART = 0.25
"""Of the logarithm of one wheel's speed over the other's: a track over the radius of the tightest turn [1]."""


def outer_wheels(k: Kinematics, usable: Callable[..., bool]) -> dict[str, Slope]:
    """Return for each axle, by its left wheel, the slope of right less left wheel speed against r.

    In a left turn the right wheels are faster: the slope is the track where left is left [m], and negative where
    wheels are exchanged or r is right-positive.
    """
    axles = {pair[0]: pair for pair in AXLES if usable(*pair, "r")}
    found = {
        left: fit_slope(k.signal(right) - k.signal(left), k.signal("r"), k.moving) for left, right in axles.values()
    }
    return {left: slope for left, slope in found.items() if slope is not None}


def without_turning(k: Kinematics, channel: str, usable: Callable[..., bool]) -> np.ndarray:
    """Return a wheel's speed [m/s], shape (N,): of both of its axle where only turning parts them.

    In a bend the outer wheel is faster than v_x by half the track times r, the inner one slower.

    Parameters
    ----------
    channel : str
        ``wheel_speed_fl`` and so on.
    usable : callable
        Whether channels are recorded.
    """
    other = next((b for pair in AXLES for a, b in (pair, pair[::-1]) if a == channel), "")
    speed = k.signal(channel)
    if not usable(channel, other):
        return speed
    ratio = fit_slope(k.signal(other), speed, k.moving)
    alike = ratio is not None and abs(np.log(max(ratio.slope, 1e-9))) < _SIDES_APART
    return 0.5 * (speed + k.signal(other)) if alike else speed
