"""What the single track works out sample by sample along a recording, compiled.

NumPy's sine alone takes longer than a whole tyre does here: without a branch in the loop a processor works out
several samples at once. The plain forms stand where these are used.
"""

import math

import numpy as np
from numpy import ndarray

from split_cli.compiled_code import compiled

_EIGHTH = math.sqrt(2.0) - 1.0  # tan(pi/8)
_STEEP = math.sqrt(2.0) + 1.0  # tan(3 pi/8)
_PI_REST = 1.2246467991473532e-16  # what pi exceeds its nearest double by, sin(math.pi)
# sin(x)/x in x^2: its Taylor series; what is left out is below 1e-19 up to pi/2.
_SINE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(12))
# atan(y)/y in y^2: the polynomial through 13 Chebyshev nodes of 0 to tan(pi/8)^2, worked out with 40 digits; it is
# off by less than 1e-17.
_ATAN = (
    1.0,
    -0.33333333333333326,
    0.19999999999997015,
    -0.1428571428532971,
    0.11111111085322109,
    -0.09090908059031191,
    0.07692281099937744,
    -0.06666205259976526,
    0.05876834004614161,
    -0.05217312574061591,
    0.04499500728984032,
    -0.03338782450121195,
    0.015113765096600925,
)


@compiled(cache=True, nogil=True, inline="always")
def _polynomial(coefficients: tuple[float, ...], x: float) -> float:
    total = 0.0
    for k in range(len(coefficients)):
        total = total * x + coefficients[len(coefficients) - 1 - k]
    return total


@compiled(cache=True, nogil=True, inline="always")
def _atan_of_size(a: float) -> float:
    """Return atan(a) of a number from 0 on.

    It is pi/4 + atan((a - 1)/(a + 1)) above tan(pi/8), and pi/2 + atan(-1/a) above tan(3 pi/8).
    """
    steep, middle = a > _STEEP, a > _EIGHTH
    over = -1.0 if steep else (a - 1.0 if middle else a)
    under = a if steep else (a + 1.0 if middle else 1.0)
    turned = 0.5 * math.pi if steep else (0.25 * math.pi if middle else 0.0)
    y = over / under
    return turned + y * _polynomial(_ATAN, y * y)


@compiled(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def sine_of_multiple_of_atan(c: float, x: ndarray) -> ndarray:
    """Return sin(c atan(x)), shape (N,), for c from 0 to 2."""
    out = np.empty_like(x)
    for i in range(x.size):
        angle = c * _atan_of_size(abs(x[i]))
        angle = angle if angle <= 0.5 * math.pi else (math.pi - angle) + _PI_REST
        out[i] = math.copysign(angle * _polynomial(_SINE, angle * angle), x[i])
    return out


@compiled(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def atan_of_ratio(y: ndarray, x: ndarray) -> ndarray:
    """Return atan(y/x), shape (N,): the angle of (x, y) where x is positive."""
    out = np.empty_like(x)
    for i in range(x.size):
        ratio = y[i] / x[i]
        out[i] = math.copysign(_atan_of_size(abs(ratio)), ratio)
    return out


@compiled(cache=True, nogil=True, fastmath={"contract"})
def sine(x: ndarray) -> ndarray:
    """Return sin(x), shape (N,), of angles from -pi/2 to pi/2."""
    out = np.empty_like(x)
    for i in range(x.size):
        out[i] = x[i] * _polynomial(_SINE, x[i] * x[i])
    return out


@compiled(cache=True, nogil=True, fastmath={"contract"})
def cosine(x: ndarray) -> ndarray:
    """Return cos(x) = 1 - 2 sin(x/2)^2, shape (N,), of angles from -pi to pi."""
    out = np.empty_like(x)
    for i in range(x.size):
        half = 0.5 * x[i]
        root = half * _polynomial(_SINE, half * half)
        out[i] = 1.0 - 2.0 * root * root
    return out


@compiled(cache=True, nogil=True, error_model="numpy")
def balance(
    front_along: ndarray,
    front_across: ndarray,
    rear_along: ndarray,
    rear_across: ndarray,
    along: ndarray,
    across: ndarray,
    moment: ndarray,
    sine: ndarray,
    cosine: ndarray,
    vx: ndarray,
    vy: ndarray,
    r: ndarray,
    mass: float,
    rotating_mass: float,
    yaw_inertia: float,
    l_f: float,
    l_r: float,
) -> ndarray:
    """Return v_x', v_y' [m/s^2] and r' [rad/s^2], shape (3, N); see `SingleTrack.balance`."""
    out = np.empty((3, vx.size))
    driven = mass / (mass + rotating_mass)
    for i in range(vx.size):
        x = front_along[i] * cosine[i] - front_across[i] * sine[i]
        y = front_across[i] * cosine[i] + front_along[i] * sine[i]
        out[0, i] = ((rear_along[i] + x + along[i]) / mass + vy[i] * r[i]) * driven
        out[1, i] = (rear_across[i] + y + across[i]) / mass - vx[i] * r[i]
        out[2, i] = (y * l_f - rear_across[i] * l_r + moment[i]) / yaw_inertia
    return out


@compiled(cache=True, nogil=True)
def add_change(total: ndarray, weight: float, after: ndarray, before: ndarray) -> None:
    """Add a weight times what an array, (N,), has become beyond what it was."""
    for i in range(total.size):
        total[i] += weight * (after[i] - before[i])
