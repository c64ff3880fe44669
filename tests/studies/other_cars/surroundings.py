"""What acts on every car from outside or on top of it: the road's grip, gusts, a load that sloshes, heat of tyres."""

from math import pi, sin

from numba import njit

GRAVITY = 9.81
_GUST_FREQUENCIES = (0.23, 0.61, 1.37)
"""Of the sines that a gust is made of [Hz]; the amplitudes halve from one to the next."""
_HEAT_TIME = 25.0
"""Time constant with which a tyre cools [s]."""


@njit(cache=True)
def grip_at(place: float, scale: float, start: float, end: float, lap: float) -> float:
    """Return the factor of the grip at a place of the course [1]: `scale` on [start, end) of each lap [m]."""
    s = place % lap
    return scale if start <= s < end else 1.0


@njit(cache=True)
def gust(time: float, size: float, phase: float) -> float:
    """Return the side force of gusts [N], positive to the left: three sines, at most 1.75 times `size`."""
    first, second, third = _GUST_FREQUENCIES
    return size * (
        sin(2.0 * pi * first * time + phase)
        + 0.5 * sin(2.0 * pi * second * time + 2.3 * phase)
        + 0.25 * sin(2.0 * pi * third * time + 4.1 * phase)
    )


@njit(cache=True)
def heating(friction_power: float, capacity: float, heat: float) -> float:
    """Return the rate of a tyre's heat [1/s]: friction power [W] over `capacity` [J], less what is cooled."""
    return friction_power / capacity - heat / _HEAT_TIME


@njit(cache=True)
def grip_of_heat(heat: float, loss: float) -> float:
    """Return the factor of the grip of a tyre with this heat [1]: 1 - `loss` is approached for a hot tyre."""
    return 1.0 - loss * heat / (1.0 + heat)


@njit(cache=True)
def slosh_spring(position: float, velocity: float, mass: float, frequency: float, damping: float) -> float:
    """Return the force of a load on the car [N], positive to the left, from its place beside its rest [m] and m/s."""
    w = 2.0 * pi * frequency
    return mass * (w * w * position + 2.0 * damping * w * velocity)
