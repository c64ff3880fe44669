"""The Magic Formula of a whole axle."""

import math
from dataclasses import dataclass
from typing import Any

from split_cli.vehicle.operations import NUMPY, Operations

# Below this share of its capacity an axle that brakes at its limit keeps lateral force [1]; it keeps roots smooth.
LEAST_CAPACITY = 1e-3


@dataclass(frozen=True)
class MagicFormula:
    """Coefficients of one axle's lateral force."""

    B: float  # stiffness factor [1/rad], positive
    C: float  # shape factor [1], in (0, 2)
    D: float  # peak lateral force of the whole axle [N], friction and load included

    @property
    def cornering_stiffness(self) -> float:
        """Slope of the lateral force at zero slip angle, B C D [N/rad]."""
        return self.B * self.C * self.D


def lateral_force(B: Any, C: Any, D: Any, slip_angle: Any, ops: Operations = NUMPY) -> Any:
    """Return the lateral force of an axle [N], left positive.

    Parameters
    ----------
    B, C, D : float or array
        Magic Formula coefficients [1/rad], [1], [N].
    slip_angle : array
        Slip angle [rad]; positive gives a positive (leftward) force.

    Notes
    -----
    F_y = D sin(C atan(B alpha)): SPLIT paper, the simplified Magic Formula, after Pacejka (2005).
    """
    return D * ops.sine_of_multiple_of_atan(C, B * slip_angle)


def lateral_force_slope(B: Any, C: Any, D: Any, slip_angle: Any) -> Any:
    """Return dF_y/dalpha [N/rad] of `lateral_force`."""
    reduced = B * slip_angle
    return D * C * B * NUMPY.cos(C * NUMPY.atan(reduced)) / (1.0 + reduced * reduced)


def is_beyond_peak(B: Any, C: Any, slip_angle: Any) -> Any:
    """Return where a slip angle [rad] is beyond that of the largest lateral force, bool, shape as `slip_angle`.

    Notes
    -----
    The peak is at C arctan(B |alpha|) = pi/2.
    """
    return C * NUMPY.atan(B * abs(slip_angle)) > 0.5 * math.pi


def share_beside_longitudinal(longitudinal_force: Any, D: Any, strength: Any, ops: Operations = NUMPY) -> Any:
    """Return the share of an axle's lateral force that is left beside a longitudinal one [N], of the peak D [N].

    Notes
    -----
    sqrt(1 - strength (F_x/D)^2): the friction ellipse for a strength of 1, Pacejka (2012), section 3.3.
    """
    used = longitudinal_force / D
    return ops.sqrt(ops.maximum(1.0 - strength * used * used, LEAST_CAPACITY))
