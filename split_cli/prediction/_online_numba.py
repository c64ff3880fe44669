"""The committee over cells of fixed room, compiled: a cell's decomposition, and all answers in one visit."""

import numpy as np
from numpy import ndarray

from split_cli.compiled_code import compiled

_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}


@compiled(cache=True)
def decompose(
    cell: int,
    z: ndarray,
    y: ndarray,
    scales: ndarray,
    ratio: ndarray,
    points: ndarray,
    turned: ndarray,
    gains: ndarray,
    vectors: ndarray,
    lower: ndarray,
    upper: ndarray,
) -> None:
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


@compiled(cache=True, fastmath=_FASTMATH, inline="always")
def _decay(x: float) -> float:
    """Return exp(-x) of x >= 0 to 1e-9 of itself, 1e-13 beyond 30: arithmetic alone, so that loops are vectorised.

    Thirteen terms at x/32 leave 5e-12, which five squarings make 2e-10.
    """
    y = -min(x, 30.0) / 32.0
    value = 1.0
    for k in range(13, 0, -1):
        value = 1.0 + value * y / k
    for _ in range(5):
        value *= value
    return value


@compiled(cache=True, fastmath=_FASTMATH)
def committee(
    z: ndarray,
    count: ndarray,
    cells: int,
    points: ndarray,
    turned: ndarray,
    gains: ndarray,
    vectors: ndarray,
    lower: ndarray,
    upper: ndarray,
    ratio: ndarray,
    reach: float,
) -> tuple[ndarray, ndarray, ndarray]:
    """Return mean (3, N), variance over signal variance (3, N) and Jacobian by scaled features (3, D, N).

    As `_compiled.predict` and `_compiled.jacobian`, for arrays whose first axis are cells and whose second are
    slots, of which `count` are filled, and for queries z, shape (D, N). A cell is skipped when its squared
    distance from every query is beyond `reach`. The queries are the inner loop, where they are vectorised.
    """
    D, N, M = z.shape[0], z.shape[1], points.shape[1]
    top, bottom = np.zeros((3, N)), np.ones((3, N))
    d_top, d_bottom = np.zeros((3, D, N)), np.zeros((3, D, N))
    c, tilt, t, dt = np.empty((M, N)), np.empty((M, D, N)), np.empty(N), np.empty((D, N))
    mu, p, dmu, dp, u = np.empty((3, N)), np.empty((3, N)), np.empty((3, D, N)), np.empty((3, D, N)), np.empty(N)
    for cell in range(cells):
        nearest = np.inf
        for i in range(N):
            distance = 0.0
            for d in range(D):
                gap = max(lower[cell, d] - z[d, i], z[d, i] - upper[cell, d], 0.0)
                distance += gap * gap
            nearest = min(nearest, distance)
        if nearest > reach:
            continue
        n = count[cell]
        for j in range(n):
            t[:] = 0.0
            for d in range(D):
                for i in range(N):
                    gap = points[cell, j, d] - z[d, i]
                    tilt[j, d, i] = gap
                    t[i] += gap * gap
            for i in range(N):
                c[j, i] = _decay(0.5 * t[i])
            for d in range(D):
                for i in range(N):
                    tilt[j, d, i] *= c[j, i]
        mu[:], p[:], dmu[:], dp[:] = 0.0, 0.0, 0.0, 0.0
        for e in range(n):
            t[:], dt[:] = 0.0, 0.0
            for j in range(n):
                weight = vectors[cell, j, e]
                for i in range(N):
                    t[i] += weight * c[j, i]
                for d in range(D):
                    for i in range(N):
                        dt[d, i] += weight * tilt[j, d, i]
            for o in range(3):
                weight, gain = turned[cell, e, o], gains[cell, e, o]
                for i in range(N):
                    mu[o, i] += weight * t[i]
                    p[o, i] += gain * t[i] * t[i]
                for d in range(D):
                    for i in range(N):
                        dmu[o, d, i] += weight * dt[d, i]
                        dp[o, d, i] += 2.0 * gain * t[i] * dt[d, i]
        for o in range(3):
            least = ratio[o] / (n + ratio[o])
            for i in range(N):
                u[i] = 1.0 / max(1.0 - p[o, i], least)
                top[o, i] += mu[o, i] * u[i]
                bottom[o, i] += p[o, i] * u[i]
            for d in range(D):
                for i in range(N):
                    d_top[o, d, i] += u[i] * (dmu[o, d, i] + mu[o, i] * u[i] * dp[o, d, i])
                    d_bottom[o, d, i] += u[i] * u[i] * dp[o, d, i]
    for o in range(3):
        for i in range(N):
            top[o, i] /= bottom[o, i]
        for d in range(D):
            for i in range(N):
                d_top[o, d, i] = (d_top[o, d, i] - top[o, i] * d_bottom[o, d, i]) / bottom[o, i]
    return top, 1.0 / bottom, d_top
