"""Three laws of tyre force over slip, each of another family; forces have the sign of the slip.

Slips are of the rubber against the road: `along` is (rolling speed - travel speed)/travel speed, positive when
driving; `across` is the tangent of the slip angle, positive for a force to the left.
"""

from math import atan, sin, sqrt

from numba import njit


@njit(cache=True)
def brush_force(along: float, across: float, stiffness_along: float, stiffness_across: float, limit: float):
    """Return the forces along and across of a brush tyre with a parabolic pressure distribution [N].

    Parameters
    ----------
    along, across : float
        Practical slips [1].
    stiffness_along, stiffness_across : float
        Slopes at zero slip [N].
    limit : float
        Friction coefficient times load [N].

    Notes
    -----
    Bristles deform by the theoretical slips, s/(1 + along). With g the length of the vector of stiffness times
    theoretical slip, and q = g/(3 limit), the force is limit (1 - (1 - q)^3) up to q = 1 and the limit beyond; it
    points along that vector. Textbook result for a constant friction coefficient, Pacejka (2012), section 3.2.
    """
    spin = 1.0 + along
    if spin < 0.1:
        spin = 0.1
    x, y = stiffness_along * along / spin, stiffness_across * across / spin
    length = sqrt(x * x + y * y)
    if length < 1e-9:
        return x, y
    q = length / (3.0 * limit)
    force = limit * (1.0 - (1.0 - q) ** 3) if q < 1.0 else limit
    return force * x / length, force * y / length


@njit(cache=True)
def tmeasy_force(slip: float, slope: float, peak: float, peak_slip: float, slide: float, slide_slip: float) -> float:
    """Return the force of a TMeasy tyre [N] from five numbers: slope at zero, peak and its slip, sliding and its slip.

    Notes
    -----
    Up to the peak a rational function, F = s_M F' q/(1 + q (q + F' s_M/F_M - 2)) with q = s/s_M; from the peak to full
    sliding a cubic without slope at either end; then constant. Rill, Road Vehicle Dynamics (2012), section 3.3.
    """
    size, sign = (slip, 1.0) if slip >= 0.0 else (-slip, -1.0)
    if size < peak_slip:
        q = size / peak_slip
        return sign * peak_slip * slope * q / (1.0 + q * (q + slope * peak_slip / peak - 2.0))
    if size < slide_slip:
        q = (size - peak_slip) / (slide_slip - peak_slip)
        return sign * (peak - (peak - slide) * q * q * (3.0 - 2.0 * q))
    return sign * slide


@njit(cache=True)
def magic_force(along: float, across: float, stiffness: float, shape: float, limit: float):
    """Return the forces along and across [N] of one Magic Formula of the combined slip.

    Parameters
    ----------
    along, across : float
        Practical slips [1].
    stiffness : float
        Slope at zero slip, alike along and across [N].
    shape : float
        C of the formula [1].
    limit : float
        D, friction coefficient times load [N].

    Notes
    -----
    Similarity method: with s the length of the theoretical slip, F = D sin(C atan(B s)), B = stiffness/(C D), in the
    direction of the slip. Pacejka (2012), section 4.1.
    """
    spin = 1.0 + along
    if spin < 0.1:
        spin = 0.1
    x, y = along / spin, across / spin
    length = sqrt(x * x + y * y)
    if length < 1e-9:
        return stiffness * x, stiffness * y
    force = limit * sin(shape * atan(stiffness / (shape * limit) * length))
    return force * x / length, force * y / length
