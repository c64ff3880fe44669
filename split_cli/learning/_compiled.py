"""The loops that carry the time: windows of the nominal model, the update of cells, the likelihood of blocks.

Private; needs numba. Every sample is computed by itself in a fixed order of operations, without fast-math, so that
labels and sets do not depend on how samples are batched.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import ndarray

from split_cli.compiled_code import compiled

__all__ = ["blocks_likelihood", "refresh_cells", "update_cell", "update_cells", "window_errors"]

_INSERTED, _REPLACED = 1, 2
_JITTERS = np.array([0.0, 1e-13, 1e-12, 1e-11, 1e-10])


# ---- windows of the nominal model ------------------------------------------------------------------------------


@compiled(cache=True)
def _derivative(
    vx: float, vy: float, r: float, T: float, delta: float, sine: float, cosine: float, p: ndarray
) -> tuple[float, float, float]:
    """Return (v_x', v_y', r') of the nominal single track; `p` as packed by labels._nominal_constants."""
    m, i_z, l_f, l_r, radius = p[0], p[1], p[2], p[3], p[4]
    kappa = p[6] if T < 0.0 else p[5]
    if vx > 0.0:  # the arctangent of one argument costs two thirds of the other
        alpha_f = delta - math.atan((vy + l_f * r) / vx)
        alpha_r = -math.atan((vy - l_r * r) / vx)
    else:
        alpha_f = delta - math.atan2(vy + l_f * r, vx)
        alpha_r = -math.atan2(vy - l_r * r, vx)
    front_x = kappa * (T / radius) - p[7]
    rear_x = (1.0 - kappa) * (T / radius) - p[8]
    front_y = p[12] * math.sin(p[11] * math.atan(p[10] * alpha_f))
    rear_y = p[15] * math.sin(p[14] * math.atan(p[13] * alpha_r))
    along = front_x * cosine - front_y * sine
    across = front_y * cosine + front_x * sine
    dvx = (rear_x + along - p[9] * vx * vx) / m + vy * r
    dvy = (rear_y + across) / m - vx * r
    dr = (across * l_f - rear_y * l_r) / i_z
    return dvx, dvy, dr


@compiled(cache=True)
def _slope(B: float, C: float, D: float, alpha: float) -> float:
    reduced = B * alpha
    return D * C * B * math.cos(C * math.atan(reduced)) / (1.0 + reduced * reduced)


@compiled(cache=True)
def _jacobian(vx: float, vy: float, r: float, delta: float, p: ndarray, A: ndarray) -> None:
    """Fill A (3, 3), the derivative of (v_x', v_y', r') with respect to (v_x, v_y, r)."""
    m, i_z, l_f, l_r = p[0], p[1], p[2], p[3]
    w_f, w_r = vy + l_f * r, vy - l_r * r
    slope_f = _slope(p[10], p[11], p[12], delta - math.atan2(w_f, vx)) / (vx * vx + w_f * w_f)
    slope_r = _slope(p[13], p[14], p[15], -math.atan2(w_r, vx)) / (vx * vx + w_r * w_r)
    sine, cosine = math.sin(delta), math.cos(delta)
    for column in range(3):
        if column == 0:
            front, rear = slope_f * w_f, slope_r * w_r
        elif column == 1:
            front, rear = -slope_f * vx, -slope_r * vx
        else:
            front, rear = -slope_f * l_f * vx, slope_r * l_r * vx
        A[0, column] = -front * sine / m
        A[1, column] = (rear + front * cosine) / m
        A[2, column] = (front * cosine * l_f - rear * l_r) / i_z
    A[0, 0] -= 2.0 * p[9] * vx / m
    A[0, 1] += r
    A[0, 2] += vy
    A[1, 0] -= r
    A[1, 2] -= vx


@compiled(cache=True)
def _multiply(a: ndarray, b: ndarray, out: ndarray) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled(cache=True)
def _substeps(A: ndarray, period: float, half_wheelbase: float, work: ndarray) -> int:
    """Return how many RK4 steps a sample keep |lambda| step <= 1; see vehicle.windows.substep_count."""
    scaled, squared, fourth = work[0], work[1], work[2]
    for i in range(3):
        for j in range(3):
            up = half_wheelbase if i == 2 else 1.0
            down = half_wheelbase if j == 2 else 1.0
            scaled[i, j] = A[i, j] * up / down
    _multiply(scaled, scaled, squared)
    _multiply(squared, squared, fourth)
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += fourth[i, j] * fourth[i, j]
    radius = math.sqrt(math.sqrt(math.sqrt(total)))
    return max(1, int(math.ceil(radius * period)))


@compiled(cache=True)
def _phi(A: ndarray, horizon: float, phi: ndarray, work: ndarray) -> None:
    """Fill phi = (1/h) int_0^h exp(A s) ds: Taylor series on a halved argument, then doubling."""
    argument, product, exponential = work[0], work[1], work[2]
    norm = 0.0
    for i in range(3):
        row = 0.0
        for j in range(3):
            argument[i, j] = A[i, j] * horizon
            row += abs(argument[i, j])
        norm = max(norm, row)
    halvings = 0
    while norm > 0.5:
        norm *= 0.5
        halvings += 1
    for i in range(3):
        for j in range(3):
            argument[i, j] *= 0.5**halvings
            phi[i, j] = 1.0 if i == j else 0.0
    # Horner from the far end; 13 terms leave less than 1e-16 at norm 1/2.
    for k in range(13, 0, -1):
        _multiply(argument, phi, product)
        for i in range(3):
            for j in range(3):
                phi[i, j] = product[i, j] / (k + 1) + (1.0 if i == j else 0.0)
    for _ in range(halvings):
        # phi(2 M) = phi(M) (I + exp M)/2 with exp M = I + M phi(M)
        _multiply(argument, phi, exponential)
        for i in range(3):
            exponential[i, i] += 2.0
        _multiply(phi, exponential, product)
        for i in range(3):
            for j in range(3):
                phi[i, j] = 0.5 * product[i, j]
                argument[i, j] *= 2.0


@compiled(cache=True)
def _solve(a: ndarray, b0: float, b1: float, b2: float) -> tuple[float, float, float]:
    """Solve a 3 x 3 system by the adjugate; not finite when singular."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    if determinant == 0.0:
        return np.nan, np.nan, np.nan
    x0 = b0 * c00 + b1 * (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]) + b2 * (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1])
    x1 = b0 * c01 + b1 * (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) + b2 * (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2])
    x2 = b0 * c02 + b1 * (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) + b2 * (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0])
    return x0 / determinant, x1 / determinant, x2 / determinant


@compiled(cache=True)
def window_errors(
    vx: ndarray, vy: ndarray, r: ndarray, T: ndarray, delta: ndarray, starts: ndarray, window: int,
    period: float, p: ndarray, plain: bool, run_on: ndarray,
) -> ndarray:  # fmt: skip
    """Return the labels y of windows, shape (N, 3); the compiled twin of labels._window_errors_reference.

    `run_on` is 1 for T and for delta where they run on to the next sample in a straight line, 0 where held.
    """
    out = np.empty((len(starts), 3))
    A, phi, work = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3, 3))
    horizon = window * period
    half_wheelbase = 0.5 * (p[2] + p[3])
    for n in range(len(starts)):
        i = starts[n]
        _jacobian(vx[i], vy[i], r[i], delta[i], p, A)
        if not np.isfinite(A).all():
            out[n] = np.nan
            continue
        substeps = _substeps(A, period, half_wheelbase, work)
        h = period / substeps
        a, b, c = vx[i], vy[i], r[i]
        for k in range(i, i + window):
            d_torque, d_steer = run_on[0] * (T[k + 1] - T[k]), run_on[1] * (delta[k + 1] - delta[k])
            T0, d0 = T[k], delta[k]
            sine0, cosine0 = math.sin(d0), math.cos(d0)
            for sub in range(substeps):
                middle, last = (sub + 0.5) / substeps, (sub + 1.0) / substeps
                T1, d1 = T[k] + middle * d_torque, delta[k] + middle * d_steer
                T2, d2 = T[k] + last * d_torque, delta[k] + last * d_steer
                sine1, cosine1, sine2, cosine2 = math.sin(d1), math.cos(d1), math.sin(d2), math.cos(d2)
                a1, b1, c1 = _derivative(a, b, c, T0, d0, sine0, cosine0, p)
                half = 0.5 * h
                a2, b2, c2 = _derivative(a + half * a1, b + half * b1, c + half * c1, T1, d1, sine1, cosine1, p)
                a3, b3, c3 = _derivative(a + half * a2, b + half * b2, c + half * c2, T1, d1, sine1, cosine1, p)
                a4, b4, c4 = _derivative(a + h * a3, b + h * b3, c + h * c3, T2, d2, sine2, cosine2, p)
                a += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
                b += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
                c += h / 6.0 * (c1 + 2.0 * c2 + 2.0 * c3 + c4)
                T0, d0, sine0, cosine0 = T2, d2, sine2, cosine2
        end = i + window
        y0, y1, y2 = (vx[end] - a) / horizon, (vy[end] - b) / horizon, (r[end] - c) / horizon
        if not plain:
            _phi(A, horizon, phi, work)
            y0, y1, y2 = _solve(phi, y0, y1, y2)
        out[n, 0], out[n, 1], out[n, 2] = y0, y1, y2
    return out


# ---- the update of cells ---------------------------------------------------------------------------------------


@compiled(cache=True)
def _correlation(a: ndarray, b: ndarray, inverse_scales: ndarray) -> float:
    squared = 0.0
    for feature in range(len(inverse_scales)):
        distance = (a[feature] - b[feature]) * inverse_scales[feature]
        squared += distance * distance
    return math.exp(-0.5 * squared)


@compiled(cache=True)
def _refresh(
    z: ndarray, n: int, first: int, inverse_scales: ndarray, low: ndarray, inverse: ndarray, gamma: ndarray,
) -> int:  # fmt: skip
    """Recompute a cell from its points: L^-1 of K = L L^T, and gamma_i = 1/[K^-1]_ii.

    Points before `first` are as they were when `low` and `inverse` were made without jitter: their rows stay, to
    the bit. Returns the index of the jitter that was needed, -1 when the largest does not suffice.
    """
    for step in range(len(_JITTERS)):
        good = True
        if step > 0:
            first = 0
        for i in range(first, n):
            for j in range(i + 1):
                value = 1.0 + _JITTERS[step] if i == j else _correlation(z[i], z[j], inverse_scales)
                for k in range(j):
                    value -= low[i, k] * low[j, k]
                if i == j:
                    # Below this the pivot holds rounding only: n terms of size one are accumulated in it.
                    good = value > 4.0 * n * 2.2e-16
                    if not good:
                        break
                    low[i, i] = math.sqrt(value)
                else:
                    low[i, j] = value / low[j, j]
            if not good:
                break
        if good:
            break
    if not good:
        return -1
    for j in range(n):
        if j >= first:
            inverse[j, j] = 1.0 / low[j, j]
        for i in range(max(first, j + 1), n):
            value = 0.0
            for k in range(j, i):
                value -= low[i, k] * inverse[k, j]
            inverse[i, j] = value / low[i, i]
        total = 0.0
        for i in range(j, n):
            total += inverse[i, j] * inverse[i, j]
        gamma[j] = 1.0 / total
    return step


@compiled(cache=True)
def _least(gamma: ndarray, clock: ndarray, n: int, now: float, forgetting: float) -> tuple[int, float]:
    """Return the slot of the least gain, weighted by exp(-age^2/(2 tau^2)) when forgetting, and that gain."""
    slot, least = 0, np.inf
    for i in range(n):
        weighted = gamma[i]
        if forgetting > 0.0:
            age = (now - clock[i]) / forgetting
            weighted *= math.exp(-0.5 * age * age)
        if weighted < least:
            slot, least = i, weighted
    return slot, least


@compiled(cache=True)
def _exceeds(
    z: ndarray, points: ndarray, n: int, inverse_scales: ndarray, inverse: ndarray, k: ndarray, bound: float,
) -> bool:  # fmt: skip
    """Return whether 1 - |L^-1 k|^2 exceeds `bound`.

    The sum of squares only grows, also in floating point, so a sample is turned away as soon as the partial sum
    decides; most need two or three of the n points.
    """
    total = 0.0
    for i in range(n):
        k[i] = _correlation(points[i], z, inverse_scales)
        value = 0.0
        for j in range(i + 1):
            value += inverse[i, j] * k[j]
        total += value * value
        if 1.0 - total <= bound:
            return False
    return 1.0 - total > bound


@compiled(cache=True)
def update_cells(
    groups: ndarray, cell_of_group: ndarray, order: ndarray, z_new: ndarray, clock_new: ndarray,
    inverse_scales: ndarray, threshold: float, forgetting: float, count: ndarray, z: ndarray, gamma: ndarray,
    clock: ndarray, origin: ndarray,
) -> tuple[ndarray, int, int]:  # fmt: skip
    """Offer samples to their cells, cell by cell, each cell's samples in their order.

    Parameters
    ----------
    groups : ndarray of int64, shape (G + 1,)
        Samples of group g are ``order[groups[g]:groups[g + 1]]``.
    cell_of_group : ndarray of int64, shape (G,)
    order : ndarray of int64, shape (N,)
    z_new, clock_new : ndarray, shape (N, D), (N,)
    inverse_scales : ndarray, shape (D,)
        Reciprocal length scales.
    threshold, forgetting : float
        Forgetting 0 is off.
    count, z, gamma, clock, origin : ndarray, shape (C,), (C, M, D), (C, M), (C, M), (C, M)
        The cells, altered in place; `origin` receives the sample that fills a slot.

    Returns
    -------
    (ndarray of int8, int, int)
        What became of each sample, repairs by jitter, and the first cell no jitter could repair or -1.
    """
    capacity = z.shape[1]
    outcome = np.zeros(len(z_new), dtype=np.int8)
    # Only triangles that were written are read; filling the rest costs more than a small cell's update.
    low, inverse = np.empty((capacity, capacity)), np.empty((capacity, capacity))
    k = np.empty(capacity)
    repairs = 0
    for group in range(len(cell_of_group)):
        c = cell_of_group[group]
        jitter = _refresh(z[c], count[c], 0, inverse_scales, low, inverse, gamma[c])
        slot, least = _least(gamma[c], clock[c], count[c], 0.0, 0.0)
        for position in range(groups[group], groups[group + 1]):
            sample = order[position]
            n = count[c]
            if forgetting > 0.0:
                slot, least = _least(gamma[c], clock[c], n, clock_new[sample], forgetting)
                # A cell with room whose points grow old must let them go too, or they never leave.
                bound = least if n == capacity else min(threshold, least)
            else:
                bound = least if n == capacity else threshold
            if not _exceeds(z_new[sample], z[c], n, inverse_scales, inverse, k, bound):
                continue
            if n < capacity and (
                forgetting <= 0.0 or _exceeds(z_new[sample], z[c], n, inverse_scales, inverse, k, threshold)
            ):
                slot = n
                count[c] = n + 1
                outcome[sample] = _INSERTED
            else:
                outcome[sample] = _REPLACED
            z[c, slot] = z_new[sample]
            clock[c, slot] = clock_new[sample]
            origin[c, slot] = sample
            same = slot if jitter == 0 else 0
            jitter = _refresh(z[c], count[c], same, inverse_scales, low, inverse, gamma[c])
            if jitter < 0:
                return outcome, repairs, c
            if jitter > 0:
                repairs += 1
            slot, least = _least(gamma[c], clock[c], count[c], 0.0, 0.0)
    return outcome, repairs, -1


@compiled(cache=True)
def update_cell(
    cell: int, sample: int, time: float, z_new: ndarray, inverse_scales: ndarray, threshold: float,
    forgetting: float, count: ndarray, z: ndarray, gamma: ndarray, clock: ndarray,
) -> tuple[int, int, int]:  # fmt: skip
    """Offer row `sample` of `z_new` to one cell: `update_cells` for a label alone, to the bit.

    Every array that Python hands over costs some 50 ns, as much as a sixth of the update. So those that only sort
    samples into cells are made here. Returns what became of the sample, the slot of one that was taken, and the
    repairs by jitter, -1 when none sufficed.
    """
    first = np.zeros(1, dtype=np.int64)
    origin = np.full((1, z.shape[1]), -1, dtype=np.int64)
    one = slice(cell, cell + 1)
    outcome, repairs, broken = update_cells(
        np.arange(2), first, first, z_new[sample : sample + 1], np.full(1, time), inverse_scales, threshold,
        forgetting, count[one], z[one], gamma[one], clock[one], origin,
    )  # fmt: skip
    return outcome[0], int(np.argmax(origin[0])), repairs if broken < 0 else -1


@compiled(cache=True)
def refresh_cells(offsets: ndarray, z: ndarray, inverse_scales: ndarray, capacity: int) -> ndarray:
    """Return gamma of every point of a set, shape (P,); NaN where a cell's kernel matrix cannot be factored."""
    gamma = np.empty(len(z))
    low, inverse = np.empty((capacity, capacity)), np.empty((capacity, capacity))
    for c in range(len(offsets) - 1):
        first, last = offsets[c], offsets[c + 1]
        if _refresh(z[first:last], last - first, 0, inverse_scales, low, inverse, gamma[first:last]) < 0:
            gamma[first:last] = np.nan
    return gamma


# ---- the likelihood of blocks ----------------------------------------------------------------------------------


@compiled(cache=True, fastmath={"reassoc", "contract"})
def _dot(a: ndarray, b: ndarray, first: int, last: int) -> float:
    total = 0.0
    for i in range(first, last):
        total += a[i] * b[i]
    return total


@compiled(cache=True)
def _invert(covariance: ndarray, n: int, low: ndarray, rows: ndarray, inverse: ndarray) -> float:
    """Fill the lower triangle of `inverse` from that of `covariance`; return half the log determinant, or NaN.

    `rows` receives the transpose of L^-1, so that every inner loop runs along rows.
    """
    half = 0.0
    for i in range(n):
        for j in range(i + 1):
            value = covariance[i, j] - _dot(low[i], low[j], 0, j)
            if i > j:
                low[i, j] = value / low[j, j]
            elif value > 0.0:
                low[i, i] = math.sqrt(value)
                half += math.log(low[i, i])
            else:
                return np.nan
    for j in range(n):
        rows[j, j] = 1.0 / low[j, j]
        for i in range(j + 1, n):
            rows[j, i] = -_dot(low[i], rows[j], j, i) / low[i, i]
    for i in range(n):
        for j in range(i + 1):
            inverse[i, j] = _dot(rows[i], rows[j], i, n)
    return half


@compiled(cache=True)
def blocks_likelihood(
    z: ndarray, t: ndarray, y: ndarray, offsets: ndarray, scales: ndarray, signal: ndarray, noise: ndarray,
    lasting: ndarray, memory: float,
) -> tuple[float, ndarray]:  # fmt: skip
    """Return the value and gradient that hyperparameters.block_likelihood defines, NaN where K is not positive.

    Errors of variance `lasting` fade over `memory` between the times `t`; the gradient goes on with theirs.

    Own loops rather than LAPACK: matrices of 60 are too small for threads, which some builds start all the same
    and then wait for each other longer than they compute.
    """
    dimension, outputs = z.shape[1], y.shape[1]
    most = np.max(np.diff(offsets))
    shape = (most, most)
    low, rows, inverse, covariance = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    correlation, distances = np.zeros(shape), np.zeros((dimension, most, most))
    apart, together = np.zeros(shape), np.zeros(shape)
    lasts = np.max(lasting) > 0.0
    weights = np.zeros(most)
    gradient = np.zeros(dimension + 3 * outputs + 1)
    value = 0.0
    for block in range(len(offsets) - 1):
        first = offsets[block]
        n = offsets[block + 1] - first
        for i in range(n):
            for j in range(i + 1):
                squared = 0.0
                for d in range(dimension):
                    distance = (z[first + i, d] - z[first + j, d]) / scales[d]
                    distances[d, i, j] = distance * distance
                    squared += distance * distance
                correlation[i, j] = math.exp(-0.5 * squared)
                if lasts:
                    apart[i, j] = abs(t[first + i] - t[first + j]) / memory
                    together[i, j] = math.exp(-apart[i, j])
        for output in range(outputs):
            for i in range(n):
                for j in range(i + 1):
                    covariance[i, j] = signal[output] * correlation[i, j]
                    if lasts:
                        covariance[i, j] += lasting[output] * together[i, j]
                covariance[i, i] += noise[output]
            half = _invert(covariance, n, low, rows, inverse)
            if np.isnan(half):
                return np.nan, gradient
            quadratic = 0.0
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += (inverse[i, j] if j <= i else inverse[j, i]) * y[first + j, output]
                weights[i] = total
                quadratic += total * y[first + i, output]
            value += 0.5 * quadratic + half + 0.5 * n * math.log(2.0 * math.pi)
            trace = 0.0
            for i in range(n):
                for j in range(i + 1):
                    slope = inverse[i, j] - weights[i] * weights[j]
                    # Off the diagonal each pair counts twice.
                    slope *= 0.5 if i == j else 1.0
                    if i == j:
                        trace += slope
                    part = slope * signal[output] * correlation[i, j]
                    gradient[dimension + output] += part
                    for d in range(dimension):
                        gradient[d] += part * distances[d, i, j]
                    if lasts:
                        part = slope * lasting[output] * together[i, j]
                        gradient[dimension + 2 * outputs + output] += part
                        gradient[dimension + 3 * outputs] += part * apart[i, j]
            gradient[dimension + outputs + output] += noise[output] * trace
    return value, gradient
