"""The nominal model in discrete time: RK4 over recorded inputs, and the linearised exact step of controllers."""

from __future__ import annotations

from typing import Any

import numpy as np

from split_cli.vehicle.single_track import SingleTrack

__all__ = ["exact_step", "integrate_recorded", "phi_matrix", "substep_count"]

_TAYLOR_TERMS = 13


def substep_count(jacobian: np.ndarray, period: float) -> int:
    """Return how many RK4 substeps keep |lambda| step <= 1 for every matrix of a batch.

    Parameters
    ----------
    jacobian : ndarray, shape (N, 3, 3)
        Velocity Jacobians [1/s and mixed].
    period : float
        Sample period [s].

    Notes
    -----
    |lambda| is the largest eigenvalue magnitude of the batch; eigenvalues of 3 x 3 matrices are cheap.
    """
    if len(jacobian) == 0:
        return 1
    largest = float(np.max(np.abs(np.linalg.eigvals(jacobian))))
    return max(1, int(np.ceil(largest * period)))


def integrate_recorded(
    model: SingleTrack,
    state: np.ndarray,
    torque: np.ndarray,
    steer_angle: np.ndarray,
    period: float,
    substeps: int = 1,
    *,
    time: Any = 0.0,
    track_position: Any = 0.0,
    yaw: Any = 0.0,
) -> np.ndarray:
    """Integrate the model over recorded inputs with classical RK4, many windows at once.

    Parameters
    ----------
    model : SingleTrack
    state : ndarray, shape (N, 3) or (N, 6)
        (v_x, v_y, r), or (X, Y, yaw, v_x, v_y, r), at the start of each window, SI.
    torque, steer_angle : ndarray, shape (N, K + 1)
        Recorded T [N m] and delta [rad] on the window's samples, linear in between (u = [dT, ddelta] constant
        over a sample, as the model's input says).
    period : float
        Sample period [s].
    substeps : int
        RK4 steps a sample.
    time, track_position, yaw : array of shape (N,) or float
        At the window's start, for terms of time, place and wind. Place advances with v_x; yaw with r.

    Returns
    -------
    ndarray
        State after K samples, same shape as `state`.
    """
    with_pose = state.shape[1] == 6
    rows = [np.ascontiguousarray(column) for column in state.T]
    if not with_pose:
        rows = [track_position + 0.0 * rows[0], yaw + 0.0 * rows[0], *rows]
    else:
        rows = [track_position + 0.0 * rows[3], rows[2], *rows[3:], rows[0], rows[1]]
    step = period / substeps
    total = torque.shape[1] - 1
    for sample in range(total):
        d_torque = torque[:, sample + 1] - torque[:, sample]
        d_steer = steer_angle[:, sample + 1] - steer_angle[:, sample]
        for sub in range(substeps):
            begin = sub / substeps
            rows = _rk4(
                model,
                rows,
                lambda share, k=sample, b=begin, dT=d_torque, dd=d_steer: (
                    torque[:, k] + (b + share / substeps) * dT,
                    steer_angle[:, k] + (b + share / substeps) * dd,
                ),
                step,
                time + (sample + begin) * period,
            )
    _, psi, vx, vy, r, *position = rows
    columns = [*position, psi, vx, vy, r] if with_pose else [vx, vy, r]
    return np.stack(columns, axis=1)


def _rk4(model: SingleTrack, rows: list, inputs: Any, step: float, time: Any) -> list:
    """Advance [s, yaw, v_x, v_y, r(, X, Y)] by one classical RK4 step."""

    def derivative(now: list, share: float) -> list:
        s, psi, vx, vy, r = now[:5]
        T, delta = inputs(share)
        rates = model.velocity_derivative(vx, vy, r, T, delta, yaw=psi, t=time + share * step, s=s)
        out = [vx, r, *rates]
        if len(now) == 7:
            out += [vx * np.cos(psi) - vy * np.sin(psi), vx * np.sin(psi) + vy * np.cos(psi)]
        return out

    k1 = derivative(rows, 0.0)
    k2 = derivative([x + 0.5 * step * k for x, k in zip(rows, k1, strict=True)], 0.5)
    k3 = derivative([x + 0.5 * step * k for x, k in zip(rows, k2, strict=True)], 0.5)
    k4 = derivative([x + step * k for x, k in zip(rows, k3, strict=True)], 1.0)
    return [
        x + step / 6.0 * (a + 2.0 * b + 2.0 * c + d) for x, a, b, c, d in zip(rows, k1, k2, k3, k4, strict=True)
    ]


def phi_matrix(jacobian: np.ndarray, horizon: float) -> np.ndarray:
    """Return (1/h) times the integral of exp(A s) over 0..h, shape (N, 3, 3).

    It is how a constant rate g that acts during h arrives in the state after h: h Phi g. Truncated Taylor series
    after halving the argument until its norm is at most 1/2, then doubling by
    phi(2M) = phi(M) (I + exp(M))/2; the truncation is below 1e-16.

    Parameters
    ----------
    jacobian : ndarray, shape (N, 3, 3)
        A, velocity block of the nominal Jacobian.
    horizon : float
        h [s].
    """
    argument = np.asarray(jacobian, dtype=float) * horizon
    norm = np.abs(argument).sum(axis=-1).max(axis=-1)
    # Halved matrix by matrix: a scaling shared by the batch would let neighbours change the last bits.
    halvings = np.ceil(np.log2(np.maximum(norm, 0.5) / 0.5)).astype(int)
    argument = argument / np.exp2(halvings)[..., None, None]
    identity = np.eye(3)
    phi = np.broadcast_to(identity, argument.shape).copy()
    for k in range(_TAYLOR_TERMS, 0, -1):
        # Horner: phi = I + M/(2) (I + M/3 (I + ...)), since phi_1(M) = sum of M^k/(k+1)!
        phi = identity + argument @ phi / (k + 1)
    for doubling in range(halvings.max(initial=0)):
        open_ = halvings > doubling
        exponential = identity + argument[open_] @ phi[open_]
        phi[open_] = 0.5 * phi[open_] @ (identity + exponential)
        argument[open_] = 2.0 * argument[open_]
    return phi


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
    from scipy.linalg import expm

    augmented = np.zeros((count, 9, 9))
    augmented[:, :8, :8] = jacobian
    augmented[:, :8, 8] = full(state)
    return state + expm(augmented * horizon)[:, :8, 8]
