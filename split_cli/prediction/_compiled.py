"""Inner loops of the predictors, compiled. The plain forms are in tests/prediction.

A committee's query visits every cell whose box of points lies within the cell's reach; all lengths are in length
scales. A spline's query reads 64 coefficients whatever the size of the set.
"""

import numpy as np
from numpy import ndarray

from split_cli.compiled_code import compiled

#: Sums may be reordered and contracted; infinities and not-a-number keep their meaning.
_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}


@compiled(cache=True, fastmath=_FASTMATH, inline="always")
def _beyond_reach(z: ndarray, lower: ndarray, upper: ndarray, reach_squared: ndarray, cell: int) -> bool:
    distance = 0.0
    for d in range(z.shape[0]):
        gap = max(lower[cell, d] - z[d], z[d] - upper[cell, d], 0.0)
        distance += gap * gap
    return bool(distance > reach_squared[cell])


@compiled(cache=True, fastmath=_FASTMATH, inline="always")
def _correlations(z: ndarray, points: ndarray, begin: int, count: int, c: ndarray) -> None:
    for j in range(count):
        squared = 0.0
        for d in range(z.shape[0]):
            gap = z[d] - points[begin + j, d]
            squared += gap * gap
        c[j] = np.exp(-0.5 * squared)


@compiled(cache=True, fastmath=_FASTMATH)
def _predict_one(
    z: ndarray,
    points: ndarray,
    turned: ndarray,
    gains: ndarray,
    vectors: ndarray,
    offsets: ndarray,
    vector_offsets: ndarray,
    lower: ndarray,
    upper: ndarray,
    reach: ndarray,
    floor: ndarray,
    robust: bool,
    c: ndarray,
    t: ndarray,
    mean: ndarray,
    spread: ndarray,
) -> None:
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
        if robust:
            # Half the information an expert has gained on the prior, log(S0/Sigma_i)/2, weighs it.
            b0, b1, b2 = 0.5 * np.log(u0), 0.5 * np.log(u1), 0.5 * np.log(u2)
            n0 += b0 * m0 * u0
            n1 += b1 * m1 * u1
            n2 += b2 * m2 * u2
            d0 += b0 * p0 * u0
            d1 += b1 * p1 * u1
            d2 += b2 * p2 * u2
        else:
            n0 += m0 * u0
            n1 += m1 * u1
            n2 += m2 * u2
            d0 += p0 * u0
            d1 += p1 * u1
            d2 += p2 * u2
    spread[0], spread[1], spread[2] = 1.0 / d0, 1.0 / d1, 1.0 / d2
    mean[0], mean[1], mean[2] = n0 / d0, n1 / d1, n2 / d2


@compiled(cache=True, fastmath=_FASTMATH)
def predict(
    z: ndarray,
    points: ndarray,
    turned: ndarray,
    gains: ndarray,
    vectors: ndarray,
    offsets: ndarray,
    vector_offsets: ndarray,
    lower: ndarray,
    upper: ndarray,
    reach: ndarray,
    floor: ndarray,
    robust: bool,
    capacity: int,
) -> tuple[ndarray, ndarray]:
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
            robust,
            c,
            t,
            mean[i],
            spread[i],
        )
    return mean, spread


@compiled(cache=True, fastmath=_FASTMATH)
def jacobian(
    z: ndarray,
    points: ndarray,
    turned: ndarray,
    gains: ndarray,
    vectors: ndarray,
    offsets: ndarray,
    vector_offsets: ndarray,
    lower: ndarray,
    upper: ndarray,
    reach: ndarray,
    floor: ndarray,
    robust: bool,
    capacity: int,
) -> ndarray:
    """Return the mean's Jacobian with respect to scaled features, (N, 3, D).

    mean = A/P with A = Sum b mu u, P = 1 + Sum b p u, u = 1/(1-p); b = 1 or, robust, log(u)/2, so that b' = u/2;
    hence dmean = (Sum b u dmu + mu (b u^2 + u b') dp - mean (b u^2 + p u b') dp)/P, d c_j = -c_j (z - z_j), and
    with t = V^T c of a cell's eigenvectors p = Sum g t^2, dp = 2 Sum g t dt, dmu = Sum w dt.
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
                b = 0.5 * np.log(u) if robust else 1.0
                change = 0.5 * u if robust else 0.0
                top[o] += b * mu[o] * u
                bottom[o] += b * p[o] * u
                for d in range(features):
                    d_top[o, d] += b * u * dmu[o, d] + mu[o] * u * (b * u + change) * dp[o, d]
                    d_bottom[o, d] += (b * u * u + change * p[o] * u) * dp[o, d]
        for o in range(3):
            for d in range(features):
                out[i, o, d] = (d_top[o, d] - top[o] / bottom[o] * d_bottom[o, d]) / bottom[o]
    return out


@compiled(cache=True, fastmath=_FASTMATH)
def weighted_sum(
    z: ndarray, points: ndarray, weights: ndarray, offsets: ndarray, lower: ndarray, upper: ndarray, reach: ndarray
) -> tuple[ndarray, ndarray]:
    """Return the sum of weights (P, 3) times correlations, (N, 3), and its slopes by scaled features."""
    features = z.shape[1]
    out, slope = np.zeros((z.shape[0], 3)), np.zeros((z.shape[0], 3, features))
    for i in range(z.shape[0]):
        for cell in range(offsets.shape[0] - 1):
            if _beyond_reach(z[i], lower, upper, reach, cell):
                continue
            for j in range(offsets[cell], offsets[cell + 1]):
                squared = 0.0
                for d in range(features):
                    gap = z[i, d] - points[j, d]
                    squared += gap * gap
                c = np.exp(-0.5 * squared)
                for o in range(3):
                    part = c * weights[j, o]
                    out[i, o] += part
                    for d in range(features):
                        slope[i, o, d] += part * (points[j, d] - z[i, d])
    return out, slope


@compiled(cache=True)
def _basis(position: float, size: int, at: ndarray, slope: ndarray) -> int:
    """Fill the four cubic B-spline weights at `position` (in nodes) and their slopes; return the first node.

    Clamped so that all four nodes exist; beyond the array the fraction stays at its end, where coefficients are 0.
    """
    inside = min(max(position, 1.0), size - 2.0)
    first = int(inside)
    first = min(first, size - 3)
    t = inside - first
    left = 1.0 - t
    at[0] = left * left * left / 6.0
    at[3] = t * t * t / 6.0
    at[1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
    at[2] = (4.0 - 6.0 * left * left + 3.0 * left * left * left) / 6.0
    slope[0] = -0.5 * left * left
    slope[3] = 0.5 * t * t
    slope[1] = 1.5 * t * t - 2.0 * t
    slope[2] = 2.0 * left - 1.5 * left * left
    return first - 1


@compiled(cache=True)
def spline(
    z: ndarray, origin: ndarray, inverse_spacing: ndarray, coefficients: ndarray, slopes: bool
) -> tuple[ndarray, ndarray]:
    """Return values (N, W) of a tricubic B-spline and, when `slopes`, derivatives (N, W, 3), else an empty array.

    `coefficients` is (n0, n1, n2, W); the sums run over the 64 nodes around a query, nearest axis last.
    """
    width = coefficients.shape[3]
    sizes = coefficients.shape[:3]
    out = np.zeros((z.shape[0], width))
    derivative = np.zeros((z.shape[0] if slopes else 0, width, 3))
    weight, change = np.empty((3, 4)), np.empty((3, 4))
    first = np.empty(3, dtype=np.int64)
    for i in range(z.shape[0]):
        bad = False
        for d in range(3):
            bad |= np.isnan(z[i, d])
            position = 1.0 if np.isnan(z[i, d]) else (z[i, d] - origin[d]) * inverse_spacing[d]
            first[d] = _basis(position, sizes[d], weight[d], change[d])
        if bad:
            out[i] = np.nan
            if slopes:
                derivative[i] = np.nan
            continue
        for a in range(4):
            for b in range(4):
                w = weight[0, a] * weight[1, b]
                w0 = change[0, a] * weight[1, b] * inverse_spacing[0]
                w1 = weight[0, a] * change[1, b] * inverse_spacing[1]
                for c in range(4):
                    node = coefficients[first[0] + a, first[1] + b, first[2] + c]
                    v = weight[2, c]
                    v2 = change[2, c] * inverse_spacing[2]
                    for o in range(width):
                        out[i, o] += w * v * node[o]
                        if slopes:
                            derivative[i, o, 0] += w0 * v * node[o]
                            derivative[i, o, 1] += w1 * v * node[o]
                            derivative[i, o, 2] += w * v2 * node[o]
    return out, derivative
