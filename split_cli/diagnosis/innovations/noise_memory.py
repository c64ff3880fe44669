"""Whitening where forces build up: sensor noise of a sample changes the rates of later samples, too.

The state of the filter is the noise n of the present sample and what noise of earlier samples leaves in the forces,
phi. Gains and covariances are those of the exact Kalman filter of both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from split_cli.diagnosis.innovations.linearisation import Linearisation


class NoiseMemory(NamedTuple):
    """What noise leaves in forces: phi_{k+1} = kept phi_k + into n_k, of which z_k has -times phi_k.

    Attributes
    ----------
    into : ndarray, shape (N - 1, 3, 3)
        [1/s].
    kept, times : ndarray, shape (N - 1,)
        [1] and [s].
    first : ndarray, shape (N - 1, 3, 3)
        phi over n where the filter starts, in steady state [1/s].
    """

    into: np.ndarray
    kept: np.ndarray
    times: np.ndarray
    first: np.ndarray

    def at(self, transitions: slice | np.ndarray) -> NoiseMemory:
        """Return the memory of some of the transitions."""
        return NoiseMemory(*(one[transitions] for one in self))


@dataclass(frozen=True)
class NoiseModel:
    """How sensor noise n enters the defects: z_k = w_k + P n_{k+1} - N n_k - times phi_k, with w the disturbance.

    Attributes
    ----------
    carry, onward : ndarray, shape (N - 1, 3, 3)
        N and P [1].
    memory : NoiseMemory or None
        None if forces build up at once: phi is 0, and the noise a moving average of order one.
    """

    carry: np.ndarray
    onward: np.ndarray
    memory: NoiseMemory | None

    def at(self, transitions: np.ndarray) -> NoiseModel:
        """Return the model of some of the transitions."""
        memory = self.memory and self.memory.at(transitions)
        return NoiseModel(self.carry[transitions], self.onward[transitions], memory)


def noise_model(linear: Linearisation) -> NoiseModel:
    """Return how sensor noise enters the defects of a recording.

    Notes
    -----
    Let u = (A - A_0) n be the forces that noise would give in steady state, and q the rate times the period h. Over
    one sample F+ = e^-q F + (mu - e^-q) u + (1 - mu) u+ with mu = (1 - e^-q)/q, as in `first_order_response`. The
    noise enters the defect by -(h/2) (A_0 n + F) at both ends; F is phi and d u, with d = 1 - mu of the transition
    before. If forces build up at once it enters by -P (h/2) A n, with P of `Linearisation.to_motion`.
    """
    period, identity = linear.recording.period, np.eye(3)
    if linear.rate is None:
        half = 0.5 * period * linear.jacobian
        over = identity if linear.to_motion is None else linear.to_motion
        return NoiseModel(identity + over @ half[:-1], identity - over @ half[1:], None)
    q = np.maximum(0.5 * (linear.rate[1:] + linear.rate[:-1]) * period, 1e-9)
    kept, mu = np.exp(-q), -np.expm1(-q) / q
    own = 1.0 - np.concatenate([mu[:1], mu[:-1]])
    forces = linear.jacobian - linear.immediate

    def times(share: np.ndarray, matrices: np.ndarray) -> np.ndarray:
        return share[:, None, None] * matrices

    before = identity + 0.5 * period * (linear.immediate[:-1] + times((1.0 + kept) * own + mu - kept, forces[:-1]))
    after = identity - 0.5 * period * (linear.immediate[1:] + times(1.0 - mu, forces[1:]))
    memory = NoiseMemory(
        times(kept * own + mu - kept, forces[:-1]), kept, 0.5 * period * (1.0 + kept), times(1.0 - own, forces[:-1])
    )
    return NoiseModel(before, after, memory)


@njit(cache=True, nogil=True)
def inverse_factor(E, L, inverse):
    """Write the inverse of the Cholesky factor of E, shape (3, 3), and return log det E.

    `L` has room for the factor. The upper parts of `L` and `inverse` have to be zero, and stay so.
    """
    log_determinant = 0.0
    for i in range(3):
        for j in range(i + 1):
            total = E[i, j]
            for m in range(j):
                total -= L[i, m] * L[j, m]
            if i == j:
                L[i, i] = np.sqrt(max(total, 1e-300))
            else:
                L[i, j] = total / L[j, j]
    for i in range(3):
        log_determinant += 2.0 * np.log(L[i, i])
        inverse[i, i] = 1.0 / L[i, i]
        for j in range(i):
            total = 0.0
            for m in range(j, i):
                total -= L[i, m] * inverse[m, j]
            inverse[i, j] = total / L[i, i]
    return log_determinant


@njit(cache=True, nogil=True)
def gains_with_memory(carry, onward, R, Q, begins, into, kept, times, first):
    """Return K of n, (N - 1, 3, 3), of phi, the same, roots of the innovations' inverse covariances, and their log det.

    Parameters
    ----------
    carry, onward : ndarray, shape (N - 1, 3, 3)
        N and P of `NoiseModel`; the fields of its memory follow at the end.
    R, Q : ndarray, shape (3, 3)
        Covariances of the noise of a sample and of the disturbance of a transition.
    begins : ndarray of bool, shape (N - 1,)
    """
    n = carry.shape[0]
    gain, recall, root = np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.zeros((n, 3, 3))
    S = np.zeros((6, 6))  # covariance of n and phi
    H, F = np.zeros((3, 6)), np.zeros((3, 6))
    G, FG, L = np.empty((6, 3)), np.empty((3, 3)), np.zeros((3, 3))
    PR, E, inverse, left = np.empty((3, 3)), np.empty((3, 3)), np.zeros((3, 3)), np.empty((6, 6))
    log_determinant = 0.0
    for k in range(n):
        if begins[k]:
            for i in range(3):
                for j in range(3):
                    S[i, j] = R[i, j]
                    S[i + 3, j] = 0.0
                    S[i + 3, j + 3] = 0.0
                    for m in range(3):
                        S[i + 3, j] += first[k, i, m] * R[m, j]
            for i in range(3):
                for j in range(3):
                    S[j, i + 3] = S[i + 3, j]
                    for m in range(3):
                        S[i + 3, j + 3] += S[i + 3, m] * first[k, j, m]
        for i in range(3):
            for j in range(3):
                H[i, j] = carry[k, i, j]
                H[i, j + 3] = times[k] if i == j else 0.0
                F[i, j] = into[k, i, j]
                F[i, j + 3] = kept[k] if i == j else 0.0
        # G = S H^T, E = Q + P R P^T + H G.
        for i in range(6):
            for j in range(3):
                total = 0.0
                for m in range(6):
                    total += S[i, m] * H[j, m]
                G[i, j] = total
        for i in range(3):
            for j in range(3):
                total = 0.0
                for m in range(3):
                    total += onward[k, i, m] * R[m, j]
                PR[i, j] = total
        for i in range(3):
            for j in range(3):
                total = Q[i, j]
                for m in range(3):
                    total += PR[i, m] * onward[k, j, m]
                for m in range(6):
                    total += H[i, m] * G[m, j]
                E[i, j] = total
        log_determinant += inverse_factor(E, L, root[k])
        for i in range(3):
            for j in range(3):
                total = 0.0
                for m in range(3):
                    total += root[k, m, i] * root[k, m, j]
                inverse[i, j] = total
        for i in range(3):
            for j in range(3):
                total = 0.0
                for m in range(6):
                    total += F[i, m] * G[m, j]
                FG[i, j] = total
        for i in range(3):
            for j in range(3):
                of_noise, of_phi = 0.0, 0.0
                for m in range(3):
                    of_noise += PR[m, i] * inverse[m, j]
                    of_phi -= FG[i, m] * inverse[m, j]
                gain[k, i, j] = of_noise
                recall[k, i, j] = of_phi
        # The covariance of the next n and phi, given the innovation.
        for i in range(3):
            for j in range(6):
                total = 0.0
                for m in range(6):
                    total += F[i, m] * S[m, j]
                left[i, j] = total
        for i in range(3):
            for j in range(3):
                noise, cross, phi = R[i, j], 0.0, 0.0
                for m in range(3):
                    noise -= gain[k, i, m] * PR[m, j]
                    cross += gain[k, i, m] * FG[j, m]
                    phi += recall[k, i, m] * FG[j, m]
                for m in range(6):
                    phi += left[i, m] * F[j, m]
                S[i, j] = noise
                S[i, j + 3] = cross
                S[j + 3, i] = cross
                S[i + 3, j + 3] = phi
    return gain, recall, root, log_determinant


@njit(cache=True, nogil=True)
def whiten_with_memory(z, gain, root, carry, begins, group, rows, estimate, recall, into, kept, times):
    """Return sums of normalised innovations, (rows, 3, C), of defects (N - 1, 3, C).

    `estimate`, shape (6, C), is that of n and phi before the first defect, and is overwritten. Others are as in
    `gains_with_memory`; defects of the group -1 belong to no row.
    """
    n, _, columns = z.shape
    out = np.zeros((rows, 3, columns))
    innovation, phi = np.empty((3, columns)), np.empty((3, columns))
    for k in range(n):
        if begins[k]:
            estimate[:] = 0.0
        N, K, W, M, A = carry[k], gain[k], root[k], recall[k], into[k]
        for i in range(3):
            for c in range(columns):
                x, y, w = estimate[0, c], estimate[1, c], estimate[2, c]
                innovation[i, c] = z[k, i, c] + N[i, 0] * x + N[i, 1] * y + N[i, 2] * w + times[k] * estimate[i + 3, c]
                phi[i, c] = kept[k] * estimate[i + 3, c] + A[i, 0] * x + A[i, 1] * y + A[i, 2] * w
        for i in range(3):
            for c in range(columns):
                x, y, w = innovation[0, c], innovation[1, c], innovation[2, c]
                estimate[i, c] = K[i, 0] * x + K[i, 1] * y + K[i, 2] * w
                estimate[i + 3, c] = phi[i, c] + M[i, 0] * x + M[i, 1] * y + M[i, 2] * w
        g = group[k]
        if g >= 0:
            for c in range(columns):
                out[g, 0, c] += W[0, 0] * innovation[0, c]
                out[g, 1, c] += W[1, 0] * innovation[0, c] + W[1, 1] * innovation[1, c]
                out[g, 2, c] += W[2, 0] * innovation[0, c] + W[2, 1] * innovation[1, c] + W[2, 2] * innovation[2, c]
    return out
