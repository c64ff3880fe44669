"""The loops that take most of the time of learning: the update of cells, the likelihood of blocks.

Private; needs numba. Every sample is computed by itself in a fixed order of operations, without fast-math, so that
labels and sets do not depend on how samples are batched.
"""

import math

import numpy as np
from numpy import ndarray

from split_cli.compiled_code import compiled
from split_cli.learning.set_limits import LARGEST_LABEL

_INSERTED, _REPLACED = 1, 2
_JITTERS = np.array([0.0, 1e-13, 1e-12, 1e-11, 1e-10])


# ---- the update of cells ---------------------------------------------------------------------------------------

# Columns of the points of a cell, behind their D features: one array, since Python takes 50 ns to hand over each, and
# a cell of thousands is not in the processor's cache.
_GAMMA, _CLOCK = -2, -1


@compiled(cache=True)
def _correlation(a: ndarray, b: ndarray, inverse_scales: ndarray) -> float:
    squared = 0.0
    for feature in range(len(inverse_scales)):
        distance = (a[feature] - b[feature]) * inverse_scales[feature]
        squared += distance * distance
    return math.exp(-0.5 * squared)


@compiled(cache=True)
def _refresh(
    z: ndarray, n: int, first: int, inverse_scales: ndarray, low: ndarray, inverse: ndarray, gamma: ndarray
) -> int:
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
def _spanned_by(
    z: ndarray, points: ndarray, n: int, inverse_scales: ndarray, inverse: ndarray, k: ndarray, bound: float
) -> int:
    """Return how many of the first of n points leave at most `bound` of 1 - |L^-1 k|^2; n + 1 if none do.

    The sum of squares only grows, also in floating point, so a sample is turned away as soon as the partial sum
    decides; most need two or three of the n points. `k` (2, M) receives correlations and, below, L^-1 k.
    """
    total = 0.0
    for i in range(n):
        k[0, i] = _correlation(points[i], z, inverse_scales)
        value = 0.0
        for j in range(i + 1):
            value += inverse[i, j] * k[0, j]
        k[1, i] = value
        total += value * value
        if 1.0 - total <= bound:
            return i + 1
    return n + 1 if 1.0 - total > bound else n


@compiled(cache=True)
def _span(m: int, inverse: ndarray, k: ndarray) -> None:
    """Write K^-1 k of the first m points into the first row of `k`, from L^-1 k in the second."""
    for j in range(m):
        value = 0.0
        for i in range(j, m):
            value += inverse[i, j] * k[1, i]
        k[0, j] = value


@compiled(cache=True)
def _absorb(m: int, k: ndarray, sample: int, samples: ndarray, c: int, sums: ndarray) -> None:
    """Add a sample's label to the sums of cell `c`: its first m points have the shares in the first row of `k`."""
    capacity, labels = sums.shape[1], samples.shape[1] - 3
    for i in range(m):
        own = k[0, i]
        for j in range(i + 1):
            sums[c, i, j] += own * k[0, j]
        for output in range(3):
            sums[c, i, capacity + output] += own * samples[sample, labels + output]


@compiled(cache=True)
def _hand_over(slot: int, n: int, k: ndarray, sums: ndarray) -> None:
    """Project what a cell's sums hold of a point that left `slot` on its n points now; `k` as `_span` left it."""
    share, shared, capacity = k[0], k[1], len(sums)
    for i in range(n):
        shared[i] = sums[max(i, slot), min(i, slot)]
    own, shared[slot] = shared[slot], 0.0
    for i in range(n):
        sums[max(i, slot), min(i, slot)] = 0.0
    for i in range(n):
        row = sums[i]
        for j in range(i + 1):
            row[j] += share[i] * shared[j] + shared[i] * share[j] + own * share[i] * share[j]
    for output in range(capacity, capacity + 3):
        left = sums[slot, output]
        sums[slot, output] = 0.0
        for i in range(n):
            sums[i, output] += share[i] * left


@compiled(cache=True)
def update_cells(
    groups: ndarray,
    cell_of_group: ndarray,
    order: ndarray,
    samples: ndarray,
    clock_new: ndarray,
    inverse_scales: ndarray,
    threshold: float,
    forgetting: float,
    count: ndarray,
    points: ndarray,
    sums: ndarray,
    origin: ndarray,
) -> tuple[ndarray, int, int]:
    """Offer samples to their cells, cell by cell, each cell's samples in their order.

    Parameters
    ----------
    groups : ndarray of int64, shape (G + 1,)
        Samples of group g are ``order[groups[g]:groups[g + 1]]``.
    cell_of_group : ndarray of int64, shape (G,)
    order : ndarray of int64, shape (N,)
    samples, clock_new : ndarray, shape (N, D + 3), (N,)
        Features, and behind them the label.
    inverse_scales : ndarray, shape (D,)
        Reciprocal length scales.
    threshold, forgetting : float
        Forgetting 0 is off.
    count, points, origin : ndarray, shape (C,), (C, M, D + 2), (C, M)
        The cells, altered in place: of each point the features, the gain and its time. `origin` receives the
        sample that fills a slot.
    sums : ndarray, shape (C, M, M + 3)
        Over all labels: the lower triangle of `information`, and behind its columns `absorbed` of `TrainingSet`.
        Of shape (C, 0, 0) where they are not kept.

    Returns
    -------
    (ndarray of int8, int, int)
        What became of each sample, repairs by jitter, and the first cell no jitter could repair or -1.
    """
    capacity = points.shape[1]
    outcome = np.zeros(len(samples), dtype=np.int8)
    # Only triangles that were written are read; filling the rest costs more than a small cell's update.
    low, inverse = np.empty((capacity, capacity)), np.empty((capacity, capacity))
    k, absorbs = np.empty((3, max(capacity, len(inverse_scales)))), sums.shape[1] > 0
    repairs = 0
    for group in range(len(cell_of_group)):
        c = cell_of_group[group]
        own = points[c]
        gamma, clock = own[:, _GAMMA], own[:, _CLOCK]
        jitter = _refresh(own, count[c], 0, inverse_scales, low, inverse, gamma)
        weakest = _least(gamma, clock, count[c], 0.0, 0.0)
        for position in range(groups[group], groups[group + 1]):
            sample = order[position]
            n = count[c]
            slot, least = weakest
            if forgetting > 0.0:
                slot, least = _least(gamma, clock, n, clock_new[sample], forgetting)
                # A cell with room whose points grow old must let them go too, or they never leave.
                bound = least if n == capacity else min(threshold, least)
            else:
                bound = least if n == capacity else threshold
            # Here and not in a call, which would count references to ten arrays for each sample.
            spans = _spanned_by(samples[sample], own, n, inverse_scales, inverse, k, bound)
            if spans <= n:
                if absorbs:
                    _span(spans, inverse, k)
                    _absorb(spans, k, sample, samples, c, sums)
                continue
            outcome[sample], slot, jitter = _take(
                c, sample, clock_new[sample], samples, inverse_scales, threshold, forgetting, slot,
                jitter, low, inverse, k, count, points, sums,
            )  # fmt: skip
            origin[c, slot] = sample
            if jitter < 0:
                return outcome, repairs, c
            if jitter > 0:
                repairs += 1
            weakest = _least(gamma, clock, count[c], 0.0, 0.0)
    return outcome, repairs, -1


@compiled(cache=True)
def update_cell(
    cell: int,
    sample: int,
    time: float,
    samples: ndarray,
    inverse_scales: ndarray,
    threshold: float,
    forgetting: float,
    count: ndarray,
    points: ndarray,
    sums: ndarray,
) -> tuple[int, int, int]:
    """Offer row `sample` of `samples` to one cell: `update_cells` for a label alone, to the bit.

    Every array that Python hands over costs some 50 ns, and so does one that is made here: none only sorts. Returns
    what became of the sample, the slot of one that was taken, and the repairs by jitter, -1 when none sufficed.
    """
    n, own = count[cell], points[cell]
    room = min(n + 1, len(own))  # short rows lie together in memory
    work = np.empty((2 * room + 3, max(room, len(inverse_scales))))
    low, inverse, k = work[:room], work[room : 2 * room], work[2 * room :]
    jitter = _refresh(own, n, 0, inverse_scales, low, inverse, own[:, _GAMMA])
    slot, least = _least(own[:, _GAMMA], own[:, _CLOCK], n, time, forgetting)
    full = n == len(own)
    bound = least if full else min(threshold, least) if forgetting > 0.0 else threshold
    spans = _spanned_by(samples[sample], own, n, inverse_scales, inverse, k, bound)
    if spans <= n:
        if sums.shape[1] > 0:
            _span(spans, inverse, k)
            _absorb(spans, k, sample, samples, cell, sums)
        return 0, 0, 0
    became, slot, jitter = _take(
        cell, sample, time, samples, inverse_scales, threshold, forgetting, slot,
        jitter, low, inverse, k, count, points, sums,
    )  # fmt: skip
    return became, slot, -1 if jitter < 0 else int(jitter > 0)


@compiled(cache=True)
def _take(
    c: int,
    sample: int,
    now: float,
    samples: ndarray,
    inverse_scales: ndarray,
    threshold: float,
    forgetting: float,
    slot: int,
    jitter: int,
    low: ndarray,
    inverse: ndarray,
    k: ndarray,
    count: ndarray,
    points: ndarray,
    sums: ndarray,
) -> tuple[int, int, int]:
    """Take a sample into cell `c`, whose factors and jitter are those of `_refresh`, in place of `slot` without room.

    Returns what became of it (`_INSERTED`, `_REPLACED`), its slot, and the jitter that the cell needs then.
    """
    own, n, absorbs = points[c], count[c], sums.shape[1] > 0
    capacity, dimension = len(own), len(inverse_scales)
    if n < capacity and (
        forgetting <= 0.0 or _spanned_by(samples[sample], own, n, inverse_scales, inverse, k, threshold) > n
    ):
        slot, became = n, _INSERTED
        count[c] = n + 1
    else:
        became = _REPLACED
    for feature in range(dimension):  # a row put into another would compile the words of an error
        k[2, feature] = own[slot, feature]
        own[slot, feature] = samples[sample, feature]
    own[slot, _CLOCK] = now
    same = slot if jitter == 0 else 0
    jitter = _refresh(own, count[c], same, inverse_scales, low, inverse, own[:, _GAMMA])
    if absorbs and jitter >= 0:
        if became == _REPLACED:
            _spanned_by(k[2], own, n, inverse_scales, inverse, k, -1.0)
            _span(n, inverse, k)
            _hand_over(slot, n, k, sums[c])
        sums[c, slot, slot] += 1.0
        for output in range(3):
            sums[c, slot, capacity + output] += samples[sample, dimension + output]
    return became, slot, jitter


@compiled(cache=True)
def cell_number(z: ndarray, y: ndarray, grid: ndarray, bits: int) -> int:
    """Return `Grid.pack` of `Grid.index` of one sample; -1 where it has no cell, -2 where its label is none.

    Parameters
    ----------
    z, y : ndarray, shape (D,), (3,)
    grid : ndarray, shape (5, D)
        Edges, bounds below and above, indices of the first and the last cell.
    bits : int
        Of a cell number, for each feature.
    """
    half, number = 1 << (bits - 1), 0
    for output in range(len(y)):
        if not abs(y[output]) <= LARGEST_LABEL:
            return -2
    for feature in range(len(z)):
        if not grid[1, feature] <= z[feature] <= grid[2, feature]:
            return -1
        position = np.floor(z[feature] / grid[0, feature])
        position = min(max(position, grid[3, feature]), grid[4, feature])
        if not abs(position) < half:
            return -1
        number = (number << bits) | (int(position) + half)
    return number


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
    z: ndarray, y: ndarray, offsets: ndarray, scales: ndarray, signal: ndarray, noise: ndarray
) -> tuple[float, ndarray]:
    """Return the negative log likelihood summed over blocks and outputs, NaN where K is not positive, and its gradient.

    The gradient is by the logarithms of scales, signal and noise variances. With K = S0 R + s^2 I and a = K^-1 y:
    -log p = y^T a/2 + log|K|/2 + n log(2 pi)/2, and its derivative is trace((K^-1 - a a^T) dK)/2, with
    dK/d log l_d = S0 R (z_d - z_d')^2/l_d^2, dK/d log S0 = S0 R, dK/d log s^2 = s^2 I.

    Own loops rather than LAPACK: matrices of 60 are too small for threads, which some builds start all the same
    and then wait for each other longer than they compute.
    """
    dimension, outputs = z.shape[1], y.shape[1]
    most = 0
    for block in range(len(offsets) - 1):  # a difference of arrays takes a second to compile
        most = max(most, offsets[block + 1] - offsets[block])
    shape = (most, most)
    low, rows, inverse, covariance = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    correlation, distances = np.zeros(shape), np.zeros((dimension, most, most))
    weights = np.zeros(most)
    gradient = np.zeros(dimension + 2 * outputs)
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
        for output in range(outputs):
            for i in range(n):
                for j in range(i + 1):
                    covariance[i, j] = signal[output] * correlation[i, j]
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
            gradient[dimension + outputs + output] += noise[output] * trace
    return value, gradient
