"""The linearised exact discretisation of a single track, slowly: what fast steps are compared with."""

import numpy as np
from scipy.linalg import expm

from split_cli.vehicle.single_track import SingleTrack


def exact_step(
    model: SingleTrack, state: np.ndarray, torque_rate: np.ndarray, steer_rate: np.ndarray, horizon: float
) -> np.ndarray:
    """Advance x = [X, Y, yaw, v_x, v_y, r, T, delta] by the linearised exact discretisation of controllers.

    Parameters
    ----------
    model : SingleTrack
    state : ndarray, shape (N, 8)
    torque_rate, steer_rate : ndarray, shape (N,)
        u = [dT, ddelta] [N m/s], [rad/s].
    horizon : float
        h [s].

    Returns
    -------
    ndarray, shape (N, 8)

    Notes
    -----
    x(h) = x + phi_1(A h) h f(x, u), A the Jacobian of f at x: exact for a system that is linear in x, second
    order otherwise. The difference from RK4 over 50 ms is told in docs/nomenclature.md.
    """
    state = np.asarray(state, dtype=float)
    count = len(state)

    def full(x: np.ndarray) -> np.ndarray:
        yaw, vx, vy, r, T, delta = x.T[2:]
        rates = model.velocity_derivative(vx, vy, r, T, delta, yaw=yaw)
        cosine, sine = np.cos(yaw), np.sin(yaw)
        rows = [vx * cosine - vy * sine, vx * sine + vy * cosine, r, *rates, torque_rate, steer_rate]
        return np.stack([np.broadcast_to(row, (count,)) for row in rows], axis=1)

    jacobian = np.empty((count, 8, 8))
    for column in range(8):
        step = 1e-6 * (1.0 + np.abs(state[:, column]))
        ahead, behind = state.copy(), state.copy()
        ahead[:, column] += step
        behind[:, column] -= step
        width = ahead[:, column] - behind[:, column]
        jacobian[:, :, column] = (full(ahead) - full(behind)) / width[:, None]
    # exp of [[A, f], [0, 0]] h holds phi_1(A h) h f in its last column.
    augmented = np.zeros((count, 9, 9))
    augmented[:, :8, :8] = jacobian
    augmented[:, :8, 8] = full(state)
    reached: np.ndarray = state + expm(augmented * horizon)[:, :8, 8]
    return reached
