"""Inner loops of the Bayesian committee machine, compiled. The plain form is in tests/prediction.

One query visits every cell whose box of points lies within the cell's reach; all lengths are in length scales.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["jacobian", "predict", "predict_parallel"]

#: Sums may be reordered and contracted; infinities and not-a-number keep their meaning.
_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}


@numba.njit(cache=True, fastmath=_FASTMATH, inline="always")
def _beyond_reach(z, lower, upper, reach_squared, cell):
    distance = 0.0
    for d in range(z.shape[0]):
        gap = max(lower[cell, d] - z[d], z[d] - upper[cell, d], 0.0)
        distance += gap * gap
    return distance > reach_squared[cell]


@numba.njit(cache=True, fastmath=_FASTMATH, inline="always")
def _correlations(z, points, begin, count, c):
    for j in range(count):
        squared = 0.0
        for d in range(z.shape[0]):
            gap = z[d] - points[begin + j, d]
            squared += gap * gap
        c[j] = np.exp(-0.5 * squared)


@numba.njit(cache=True, fastmath=_FASTMATH)
def _predict_one(
    z, points, turned, gains, vectors, offsets, vector_offsets, lower, upper, reach, floor, c, t, mean, spread
):
    """Fill `mean` with Sum mu/(1-p) / precision and `spread` with 1/precision, both over the three outputs."""
    n0 = n1 = n2 = 0.0
    d0 = d1 = d2 = 1.0
    for cell in range(offsets.shape[0] - 1):
        if _beyond_reach(z, lower, upper, reach, cell):
            continue
        begin = offsets[cell]
        count = offsets[cell + 1] - begin
        _correlations(z, points, begin, count, c)
        m0 = m1 = m2 = 0.0
        p0 = p1 = p2 = 0.0
        t[:count] = 0.0
        k = vector_offsets[cell]
        for j in range(count):
            for e in range(count):
                t[e] += vectors[k + e] * c[j]
            k += count
        for e in range(count):
            m0 += turned[begin + e, 0] * t[e]
            m1 += turned[begin + e, 1] * t[e]
            m2 += turned[begin + e, 2] * t[e]
            square = t[e] * t[e]
            p0 += gains[begin + e, 0] * square
            p1 += gains[begin + e, 1] * square
            p2 += gains[begin + e, 2] * square
        u0 = 1.0 / max(1.0 - p0, floor[cell, 0])
        u1 = 1.0 / max(1.0 - p1, floor[cell, 1])
        u2 = 1.0 / max(1.0 - p2, floor[cell, 2])
        n0 += m0 * u0
        n1 += m1 * u1
        n2 += m2 * u2
        d0 += p0 * u0
        d1 += p1 * u1
        d2 += p2 * u2
    spread[0], spread[1], spread[2] = 1.0 / d0, 1.0 / d1, 1.0 / d2
    mean[0], mean[1], mean[2] = n0 / d0, n1 / d1, n2 / d2


@numba.njit(cache=True, fastmath=_FASTMATH)
def predict(z, points, turned, gains, vectors, offsets, vector_offsets, lower, upper, reach, floor, capacity):
    """Return mean (N, 3) and variance in units of the signal variance (N, 3), one thread."""
    mean = np.empty((z.shape[0], 3))
    spread = np.empty((z.shape[0], 3))
    c, t = np.empty(capacity), np.empty(capacity)
    for i in range(z.shape[0]):
        _predict_one(
            z[i],
            points,
            turned,
            gains,
            vectors,
            offsets,
            vector_offsets,
            lower,
            upper,
            reach,
            floor,
            c,
            t,
            mean[i],
            spread[i],
        )
    return mean, spread


@numba.njit(cache=True, fastmath=_FASTMATH, parallel=True)
def predict_parallel(
    z, points, turned, gains, vectors, offsets, vector_offsets, lower, upper, reach, floor, capacity
):
    """`predict` with the queries shared out over threads; the same bits, since a query is never split."""
    mean = np.empty((z.shape[0], 3))
    spread = np.empty((z.shape[0], 3))
    for i in numba.prange(z.shape[0]):
        c, t = np.empty(capacity), np.empty(capacity)
        _predict_one(
            z[i],
            points,
            turned,
            gains,
            vectors,
            offsets,
            vector_offsets,
            lower,
            upper,
            reach,
            floor,
            c,
            t,
            mean[i],
            spread[i],
        )
    return mean, spread


@numba.njit(cache=True, fastmath=_FASTMATH)
def jacobian(z, points, turned, gains, vectors, offsets, vector_offsets, lower, upper, reach, floor, capacity):
    """Return the mean's Jacobian with respect to scaled features, (N, 3, D).

    mean = A/P with A = Sum mu u, P = 1 + Sum p u, u = 1/(1-p); hence
    dmean = (Sum u dmu + mu u^2 dp - mean u^2 dp)/P, d c_j = -c_j (z - z_j), and with t = V^T c of a cell's
    eigenvectors p = Sum g t^2, dp = 2 Sum g t dt, dmu = Sum w dt.
    """
    features = z.shape[1]
    out = np.empty((z.shape[0], 3, features))
    c = np.empty(capacity)
    d_top = np.empty((3, features))
    d_bottom = np.empty((3, features))
    dp = np.empty((3, features))
    dmu = np.empty((3, features))
    t = np.empty(capacity)
    dt = np.empty((features, capacity))
    mu = np.empty(3)
    p = np.empty(3)
    for i in range(z.shape[0]):
        top = np.zeros(3)
        bottom = np.ones(3)
        d_top[:] = 0.0
        d_bottom[:] = 0.0
        for cell in range(offsets.shape[0] - 1):
            if _beyond_reach(z[i], lower, upper, reach, cell):
                continue
            begin = offsets[cell]
            count = offsets[cell + 1] - begin
            _correlations(z[i], points, begin, count, c)
            mu[:] = 0.0
            p[:] = 0.0
            dmu[:] = 0.0
            dp[:] = 0.0
            t[:count] = 0.0
            dt[:, :count] = 0.0
            k = vector_offsets[cell]
            for j in range(count):
                for e in range(count):
                    t[e] += vectors[k + e] * c[j]
                for d in range(features):
                    slope = c[j] * (points[begin + j, d] - z[i, d])
                    for e in range(count):
                        dt[d, e] += vectors[k + e] * slope
                k += count
            for e in range(count):
                for o in range(3):
                    weight = turned[begin + e, o]
                    gain = gains[begin + e, o] * t[e]
                    mu[o] += weight * t[e]
                    p[o] += gain * t[e]
                    for d in range(features):
                        dmu[o, d] += weight * dt[d, e]
                        dp[o, d] += 2.0 * gain * dt[d, e]
            for o in range(3):
                u = 1.0 / max(1.0 - p[o], floor[cell, o])
                top[o] += mu[o] * u
                bottom[o] += p[o] * u
                for d in range(features):
                    d_top[o, d] += u * dmu[o, d] + mu[o] * u * u * dp[o, d]
                    d_bottom[o, d] += u * u * dp[o, d]
        for o in range(3):
            for d in range(features):
                out[i, o, d] = (d_top[o, d] - top[o] / bottom[o] * d_bottom[o, d]) / bottom[o]
    return out
