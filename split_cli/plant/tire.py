"""The tyre of one wheel: a load-dependent Magic Formula with combined slip."""

from dataclasses import dataclass

import numpy as np

from split_cli.plant._compiled import tire_force_many
from split_cli.plant._numbers import as_numbers


@dataclass(frozen=True)
class TireParameters:
    """Coefficients of the Magic Formula, symbols as in Pacejka, Tyre and Vehicle Dynamics, 2nd ed., section 4.3.

    Shifts, camber and left-right asymmetries are left out; signs are turned so that a positive slip angle gives
    a positive (leftward) force with positive coefficients.
    """

    nominal_load: float  # F_z0 [N]
    # p_cx1, p_dx1, p_dx2, p_ex1, p_ex2, p_ex3, p_kx1, p_kx2, p_kx3: longitudinal shape, peak, curvature, slip
    # stiffness [1].
    p_cx1: float
    p_dx1: float
    p_dx2: float
    p_ex1: float
    p_ex2: float
    p_ex3: float
    p_kx1: float
    p_kx2: float
    p_kx3: float
    # p_cy1, p_dy1, p_dy2, p_ey1, p_ey2, p_ky1, p_ky2: lateral shape, peak, curvature, cornering stiffness [1].
    p_cy1: float
    p_dy1: float
    p_dy2: float
    p_ey1: float
    p_ey2: float
    p_ky1: float
    p_ky2: float
    # r_bx1, r_bx2, r_cx1, r_by1, r_by2, r_cy1: how lateral slip takes longitudinal force (x) and the reverse (y)
    # [1].
    r_bx1: float
    r_bx2: float
    r_cx1: float
    r_by1: float
    r_by2: float
    r_cy1: float
    # relaxation_longitudinal, relaxation_lateral: distance over which a force builds up to 63 % [m].
    relaxation_longitudinal: float
    relaxation_lateral: float
    rolling_resistance: float  # resisting moment over load and radius [1]
    combined_slip: float = 1.0  # 1 for the weighting above, 0 for forces that do not know of each other [1]


def tire_force(
    tire: TireParameters,
    slip_ratio: np.ndarray | float,
    slip_angle: np.ndarray | float,
    load: np.ndarray | float,
    friction: float = 1.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the steady longitudinal and lateral force of a wheel; the arguments broadcast.

    Parameters
    ----------
    slip_ratio : float or ndarray
        kappa, positive when driving [1].
    slip_angle : float or ndarray
        alpha, positive when the force is to the left [rad].
    load : float or ndarray
        F_z [N].
    friction : float
        Scales both peaks, not the slopes (lambda_mu) [1].

    Returns
    -------
    (ndarray, ndarray)
        F_x, F_y in the wheel's frame [N].

    Notes
    -----
    With df_z = (F_z - F_z0)/F_z0 and, for either direction, F0 = D sin(C atan(B s - E (B s - atan(B s)))):

    - along: D = (p_dx1 + p_dx2 df_z) F_z, E = p_ex1 + p_ex2 df_z + p_ex3 df_z^2,
      B C D = F_z (p_kx1 + p_kx2 df_z) exp(p_kx3 df_z);
    - across: D = (p_dy1 + p_dy2 df_z) F_z, E = p_ey1 + p_ey2 df_z,
      B C D = p_ky1 F_z0 sin(2 atan(F_z/(p_ky2 F_z0)));
    - together: F_x = F_x0 cos(r_cx1 atan(alpha r_bx1 cos(atan(r_bx2 kappa)))), and F_y with x and y, alpha and
      kappa exchanged.

    Pacejka, Tyre and Vehicle Dynamics, 2nd ed. 2006, eqs. (4.E9) to (4.E68) without shifts.
    """
    kappa, alpha, weight = np.broadcast_arrays(slip_ratio, slip_angle, load)
    force = np.empty((2, kappa.size))
    tire_force_many(
        np.ravel(kappa).astype(float),
        np.tan(np.ravel(alpha).astype(float)),
        np.ravel(weight).astype(float),
        float(friction),
        as_numbers(tire),
        force,
    )
    return force[0].reshape(kappa.shape), force[1].reshape(kappa.shape)
