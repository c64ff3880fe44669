"""Whitening: normalised innovations of a Kalman filter for a model linearised along a recording.

The defect of transition k, z_k = y_{k+1} - y_k - integral of f, contains the noise of two samples and the error of the
model. Its noise is correlated from one transition to the next, so plain least squares would ignore slow effects. The
filter turns defects into innovations that are white and of unit variance. Least squares on these is the
prediction-error method (Ljung, 1999) over all horizons at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from split_cli.diagnosis.innovations.noise_memory import (
    NoiseMemory,
    NoiseModel,
    gains_with_memory,
    inverse_factor,
    whiten_with_memory,
)


@dataclass(frozen=True)
class Whitener:
    """The whitening filter of one recording with N samples: its gains at the N - 1 transitions."""

    # gain, root, carry: (N - 1, 3, 3): Kalman gain K_k, inverse Cholesky factor of the innovation's covariance, and
    # N of the `NoiseModel`.
    gain: np.ndarray
    root: np.ndarray
    carry: np.ndarray
    begins: np.ndarray  # bool (N - 1,): transitions at which the filter restarts
    group: np.ndarray  # int64 (N - 1,): number of the output row a transition is summed into; -1 for none
    count: np.ndarray  # (G,): number of transitions in a row
    # (N - 1, 3, 3), and how noise changes later forces: gain of that; both None if forces build up at once.
    recall: np.ndarray | None = None
    memory: NoiseMemory | None = None

    def __call__(self, defect: np.ndarray, estimate: np.ndarray | None = None) -> np.ndarray:
        """Return whitened rows, shape (G, 3, C), of defects (N - 1, 3, C), or (G, 3) of (N - 1, 3).

        A row is the sum of successive innovations over the root of their count, which is white and of unit variance
        too. Signals faster than the rows are lost.

        Parameters
        ----------
        defect : ndarray, shape (N - 1, 3, C) or (N - 1, 3)
            Defects of v_x, v_y [m/s] and r [rad/s].
        estimate : ndarray, shape (6, C), optional
            Estimate of the noise of the sample before the first defect, and of what earlier noise left in forces; 0
            at the begin of a recording. It is overwritten with that after the last defect. For defects with columns
            only.
        """
        defect = np.ascontiguousarray(defect)
        filtered = self.gain, self.root, self.carry, self.begins, self.group, len(self.count)
        if defect.ndim == 2 and self.memory is None:
            rows = _whiten_one(defect, *filtered)
        else:
            columns = defect if defect.ndim == 3 else defect[:, :, None]
            estimate = np.zeros((6, columns.shape[2])) if estimate is None else estimate
            if self.memory is None:
                rows = _whiten(columns, *filtered, estimate)
            else:
                into, kept, times, _ = self.memory
                rows = whiten_with_memory(columns, *filtered, estimate, self.recall, into, kept, times)
            rows = rows if defect.ndim == 3 else rows[:, :, 0]
        return rows / np.sqrt(self.count).reshape(-1, *(1,) * (rows.ndim - 1))

    def stretches(self, length: int) -> Iterator[tuple[slice, slice, Whitener]]:
        """Yield the transitions, the rows and the whitener of successive stretches of at most `length` rows."""
        begin = 0
        for first in range(0, len(self.count), length):
            rows = slice(first, min(first + length, len(self.count)))
            last = rows.stop == len(self.count)
            end = len(self.group) if last else int(np.argmax(self.group == rows.stop))
            at = slice(begin, end)
            group = np.where(self.group[at] >= 0, self.group[at] - first, -1)
            piece = replace(
                self,
                gain=self.gain[at],
                root=self.root[at],
                carry=self.carry[at],
                begins=self.begins[at],
                group=group,
                count=self.count[rows],
            )
            if self.recall is not None and self.memory is not None:
                piece = replace(piece, recall=self.recall[at], memory=self.memory.at(at))
            yield at, rows, piece
            begin = end

    def of_every_sample(self) -> Whitener:
        """Return the whitener whose rows are single transitions."""
        every = np.arange(len(self.group), dtype=np.int64)
        return replace(self, group=every, count=np.ones(len(every)))


def build_whitener(
    model: NoiseModel, noise: np.ndarray, disturbance: np.ndarray, period: float, begins: np.ndarray, group: np.ndarray
) -> Whitener:
    """Return the whitening filter of a recording, by the covariance recursion of a Kalman filter.

    Parameters
    ----------
    model : NoiseModel
        How noise enters the defects.
    noise : ndarray, shape (3,)
        Standard deviation of a sample of v_x, v_y [m/s] and r [rad/s].
    disturbance : ndarray, shape (3,)
        Variance per second of unmodelled disturbances [m^2/s^3], [m^2/s^3], [rad^2/s^3].
    period : float
        Sample period [s].
    begins, group
        As in `Whitener`.

    Notes
    -----
    Without memory z_k = w_k + P n_{k+1} - N n_k with n the sensor noise and w the disturbance: a moving average of
    order one. The estimate of n_k from the past, with covariance S, gives the innovation z_k + N n^, its covariance
    Q + P R P^T + N S N^T, and the next estimate. With memory what earlier noise left in forces is estimated as well.
    """
    covariances = np.diag(np.asarray(noise, dtype=float) ** 2), np.diag(np.asarray(disturbance, dtype=float) * period)
    gain, recall, root, _ = _gains_of(model, *covariances, begins)
    kept = group[group >= 0]
    count = np.bincount(kept, minlength=(int(kept.max()) + 1) if len(kept) else 0).astype(float)
    return Whitener(gain, root, model.carry, begins, group, count, recall, model.memory)


def cost_by_disturbance(
    defect: np.ndarray, model: NoiseModel, noise: np.ndarray, period: float, begins: np.ndarray
) -> Callable[[np.ndarray], float]:
    """Return a function of the disturbance: minus twice the log likelihood of defects (N - 1, 3), up to a constant.

    Parameters are those of `build_whitener`.
    """
    R = np.diag(np.asarray(noise, dtype=float) ** 2)
    every = np.arange(len(begins), dtype=np.int64)

    def cost(disturbance: np.ndarray) -> float:
        gain, recall, root, log_determinant = _gains_of(model, R, np.diag(disturbance * period), begins)
        whitener = Whitener(gain, root, model.carry, begins, every, np.ones(len(every)), recall, model.memory)
        return float(np.sum(whitener(defect) ** 2)) + float(log_determinant)

    return cost


def _gains_of(
    model: NoiseModel, R: np.ndarray, Q: np.ndarray, begins: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, float]:
    """Return the gains of the noise and of its memory, roots of inverse covariances, and their log determinant."""
    if model.memory is not None:
        return gains_with_memory(model.carry, model.onward, R, Q, begins, *model.memory)
    gain, root, log_determinant = _gains(model.carry, model.onward, R, Q, begins)
    return gain, None, root, log_determinant


@njit(cache=True, nogil=True)
def _product(a, b, out):
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit(cache=True, nogil=True)
def _gains(carry, onward, R, Q, begins):
    n = carry.shape[0]
    gain = np.empty((n, 3, 3))
    root = np.zeros((n, 3, 3))
    S = R.copy()
    log_determinant = 0.0
    PR, NS, E, L, scaled = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    for k in range(n):
        if begins[k]:
            # Element by element: assigning an array would take four seconds to compile, with its error message.
            for i in range(3):
                for j in range(3):
                    S[i, j] = R[i, j]
        N, P = carry[k], onward[k]
        # Products of 3 by 3 matrices are written out: library calls take ten times as long.
        _product(P, R, PR)
        _product(N, S, NS)
        for i in range(3):
            for j in range(3):
                E[i, j] = Q[i, j]
                for m in range(3):
                    E[i, j] += PR[i, m] * P[j, m] + NS[i, m] * N[j, m]
        inverse = root[k]
        log_determinant += inverse_factor(E, L, inverse)
        # K = (P R)^T E^-1, and E^-1 = L^-T L^-1.
        _product(inverse, PR, scaled)
        K = gain[k]
        for i in range(3):
            for j in range(3):
                K[i, j] = 0.0
                for m in range(3):
                    K[i, j] += scaled[m, i] * inverse[m, j]
        for i in range(3):
            for j in range(3):
                S[i, j] = R[i, j]
                for m in range(3):
                    S[i, j] -= K[i, m] * PR[m, j]
    return gain, root, log_determinant


@njit(cache=True, nogil=True)
def _whiten(z, gain, root, carry, begins, group, rows, estimate):
    n, _, columns = z.shape
    out = np.zeros((rows, 3, columns))
    innovation = np.empty((3, columns))
    for k in range(n):
        if begins[k]:
            estimate[:] = 0.0
        N, K, W = carry[k], gain[k], root[k]
        for i in range(3):
            for c in range(columns):
                innovation[i, c] = (
                    z[k, i, c] + N[i, 0] * estimate[0, c] + N[i, 1] * estimate[1, c] + N[i, 2] * estimate[2, c]
                )
        for i in range(3):
            for c in range(columns):
                estimate[i, c] = K[i, 0] * innovation[0, c] + K[i, 1] * innovation[1, c] + K[i, 2] * innovation[2, c]
        g = group[k]
        if g >= 0:
            for c in range(columns):
                out[g, 0, c] += W[0, 0] * innovation[0, c]
                out[g, 1, c] += W[1, 0] * innovation[0, c] + W[1, 1] * innovation[1, c]
                out[g, 2, c] += W[2, 0] * innovation[0, c] + W[2, 1] * innovation[1, c] + W[2, 2] * innovation[2, c]
    return out


@njit(cache=True, nogil=True)
def _whiten_one(z, gain, root, carry, begins, group, rows):
    """Do as `_whiten` for one column, shape (n, 3), with the same bits, for the many calls of a search."""
    out = np.zeros((rows, 3))
    x = y = w = 0.0
    for k in range(z.shape[0]):
        if begins[k]:
            x = y = w = 0.0
        N, K, W = carry[k], gain[k], root[k]
        a = z[k, 0] + N[0, 0] * x + N[0, 1] * y + N[0, 2] * w
        b = z[k, 1] + N[1, 0] * x + N[1, 1] * y + N[1, 2] * w
        c = z[k, 2] + N[2, 0] * x + N[2, 1] * y + N[2, 2] * w
        x = K[0, 0] * a + K[0, 1] * b + K[0, 2] * c
        y = K[1, 0] * a + K[1, 1] * b + K[1, 2] * c
        w = K[2, 0] * a + K[2, 1] * b + K[2, 2] * c
        g = group[k]
        if g >= 0:
            out[g, 0] += W[0, 0] * a
            out[g, 1] += W[1, 0] * a + W[1, 1] * b
            out[g, 2] += W[2, 0] * a + W[2, 1] * b + W[2, 2] * c
    return out
