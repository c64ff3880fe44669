"""The committee over cells of fixed room, compiled: a cell's decomposition, and all answers in one visit."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from split_cli.compiled_code import compiled

__all__ = ["committee", "decompose"]

_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}


@compiled(cache=True)
def decompose(
    cell: int, z: ndarray, y: ndarray, scales: ndarray, ratio: ndarray, points: ndarray, turned: ndarray,
    gains: ndarray, vectors: ndarray, lower: ndarray, upper: ndarray,
) -> None:  # fmt: skip
    """Write what `committee` needs of a cell with points `z` (n, D) and labels `y` (n, 3) into the row `cell`.

    C = V diag(lambda) V^T of the correlations between points, gains 1/(lambda + rho) and V^T y times them.
    """
    n, D = z.shape
    own = z / scales
    correlations = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            squared = 0.0
            for d in range(D):
                squared += (own[i, d] - own[j, d]) ** 2
            correlations[i, j] = np.exp(-0.5 * squared)
    values, columns = np.linalg.eigh(correlations)
    for d in range(D):
        lower[cell, d], upper[cell, d] = own[:, d].min(), own[:, d].max()
    for e in range(n):
        points[cell, e], vectors[cell, e, :n] = own[e], columns[e]
        for o in range(3):
            # A kernel matrix has no negative eigenvalue; below zero is rounding.
            gains[cell, e, o] = 1.0 / (max(values[e], 0.0) + ratio[o])
            turned[cell, e, o] = (columns[:, e] * y[:, o]).sum() * gains[cell, e, o]


@compiled(cache=True, fastmath=_FASTMATH)
def committee(
    z: ndarray, count: ndarray, cells: int, points: ndarray, turned: ndarray, gains: ndarray, vectors: ndarray,
    lower: ndarray, upper: ndarray, ratio: ndarray, reach: float,
) -> tuple[ndarray, ndarray, ndarray]:  # fmt: skip
    """Return mean (N, 3), variance over signal variance (N, 3) and Jacobian by scaled features (N, 3, D).

    As `_compiled.predict` and `_compiled.jacobian`, for arrays whose first axis are cells and whose second are
    slots, of which `count` are filled; `reach` is the squared distance beyond which a cell is skipped.
    """
    N, D, M = z.shape[0], z.shape[1], points.shape[1]
    mean, spread, slope = np.empty((N, 3)), np.empty((N, 3)), np.empty((N, 3, D))
    c, t, dt = np.empty(M), np.empty(M), np.empty((D, M))
    for i in range(N):
        top, bottom = np.zeros(3), np.ones(3)
        d_top, d_bottom = np.zeros((3, D)), np.zeros((3, D))
        for cell in range(cells):
            distance = 0.0
            for d in range(D):
                gap = max(lower[cell, d] - z[i, d], z[i, d] - upper[cell, d], 0.0)
                distance += gap * gap
            if distance > reach:
                continue
            n = count[cell]
            for e in range(n):
                t[e] = 0.0
                for d in range(D):
                    dt[d, e] = 0.0
            for j in range(n):
                squared = 0.0
                for d in range(D):
                    gap = z[i, d] - points[cell, j, d]
                    squared += gap * gap
                c[j] = np.exp(-0.5 * squared)
                for e in range(n):
                    t[e] += vectors[cell, j, e] * c[j]
                for d in range(D):
                    tilt = c[j] * (points[cell, j, d] - z[i, d])
                    for e in range(n):
                        dt[d, e] += vectors[cell, j, e] * tilt
            for o in range(3):
                mu = 0.0
                p = 0.0
                for e in range(n):
                    mu += turned[cell, e, o] * t[e]
                    p += gains[cell, e, o] * t[e] * t[e]
                u = 1.0 / max(1.0 - p, ratio[o] / (n + ratio[o]))
                top[o] += mu * u
                bottom[o] += p * u
                for d in range(D):
                    dmu = 0.0
                    dp = 0.0
                    for e in range(n):
                        dmu += turned[cell, e, o] * dt[d, e]
                        dp += 2.0 * gains[cell, e, o] * t[e] * dt[d, e]
                    d_top[o, d] += u * dmu + mu * u * u * dp
                    d_bottom[o, d] += u * u * dp
        for o in range(3):
            mean[i, o] = top[o] / bottom[o]
            spread[i, o] = 1.0 / bottom[o]
            for d in range(D):
                slope[i, o, d] = (d_top[o, d] - mean[i, o] * d_bottom[o, d]) / bottom[o]
    return mean, spread, slope
