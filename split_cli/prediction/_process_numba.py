"""The online process, compiled: one label absorbed, and all answers at a query.

Symmetric matrices are kept as their lower triangles, which halves what an update reads and writes.
"""

import numpy as np
from numpy import ndarray

from split_cli.compiled_code import compiled

_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}


@compiled(cache=True, fastmath=_FASTMATH)
def _times(matrix: ndarray, vector: ndarray, count: int, product: ndarray) -> None:
    """Write a symmetric matrix times a vector, both of `count` rows, into `product`."""
    for i in range(count):
        row, own, total = matrix[i], vector[i], 0.0
        for j in range(i):
            total += row[j] * vector[j]
            product[j] += row[j] * own
        product[i] = total + row[i] * own


@compiled(cache=True, fastmath=_FASTMATH)
def _add_square(matrix: ndarray, vector: ndarray, factor: float, count: int) -> None:
    """Add `factor` times the square of a vector to a symmetric matrix."""
    for i in range(count):
        row, own = matrix[i], factor * vector[i]
        for j in range(i + 1):
            row[j] += own * vector[j]


@compiled(cache=True, fastmath=_FASTMATH)
def _correlate(z: ndarray, points: ndarray, count: int, correlations: ndarray) -> None:
    """Write the correlations of a scaled query with the points."""
    for j in range(count):
        squared = 0.0
        for d in range(len(z)):
            squared += (z[d] - points[j, d]) ** 2
        correlations[j] = np.exp(-0.5 * squared)


@compiled(cache=True, fastmath=_FASTMATH)
def absorb(
    z: ndarray,
    y: ndarray,
    count: int,
    signal: ndarray,
    ratio: ndarray,
    threshold: float,
    points: ndarray,
    inverse: ndarray,
    weights: ndarray,
    learned: ndarray,
    unspanned: ndarray,
) -> int:
    """Absorb one label `y` (3,) at the scaled features `z` (D,) in place; return how many points span now.

    Parameters as `OnlineProcess` has them; `learned` (3, U, U) is what data have added to the prior's covariance,
    and `unspanned` (2, 3) the sums from which the share of the gains in the labels follows.
    """
    room = len(points)
    c, e, s = np.zeros(room), np.zeros(room), np.zeros(room)
    _correlate(z, points, count, c)
    _times(inverse, c, count, e)
    spanned = 0.0
    for i in range(count):
        spanned += c[i] * e[i]
    gain = max(1.0 - spanned, 0.0)
    n = count
    if (gain > threshold or count == 0) and count < room:  # the first always, also where all is noise
        for d in range(len(z)):
            points[count, d] = z[d]
        n = count + 1
        e[count] = -1.0
        _add_square(inverse, e, 1.0 / gain, n)
        for i in range(count):
            e[i] = 0.0
        e[count] = 1.0
        c[count] = 1.0
        spanned, gain = 1.0, 0.0
    for o in range(3):
        s[:n] = 0.0
        _times(learned[o], c, n, s)
        known, error = 0.0, y[o]
        for i in range(n):
            known += c[i] * s[i]
            error -= c[i] * weights[o, i]
            s[i] += e[i]
        # What the points do not span is noise of this label: its variance is the gain.
        certain = ratio[o] + max(spanned + known, 0.0)
        total = certain + gain
        unspanned[0, o] += gain * (error * error / signal[o] - certain) / (total * total)
        unspanned[1, o] += gain * gain / (total * total)
        for i in range(n):
            weights[o, i] += error / total * s[i]
        _add_square(learned[o], s, -1.0 / total, n)
    return n


@compiled(cache=True, fastmath=_FASTMATH)
def answer(
    z: ndarray,
    count: int,
    points: ndarray,
    inverse: ndarray,
    weights: ndarray,
    learned: ndarray,
    threshold: float,
    absent: ndarray,
    certainty: bool,
) -> tuple[ndarray, ndarray, ndarray]:
    """Return mean (N, 3), variance over signal variance (N, 3) and Jacobian by scaled features (N, 3, D).

    The share `absent` (3,) of a gain up to `threshold` is left out of the variance, fading as points span less.
    Without `certainty` the variance, which costs the square of the points, stays the prior's.
    """
    N, D = z.shape
    mean, spread, slope = np.zeros((N, 3)), np.ones((N, 3)), np.zeros((N, 3, D))
    c, s = np.zeros(len(points)), np.zeros(len(points))
    for i in range(N):
        _correlate(z[i], points, count, c)
        gain = 1.0
        if certainty:
            s[:count] = 0.0
            _times(inverse, c, count, s)
            for j in range(count):
                gain -= s[j] * c[j]
        gain = min(max(gain, 0.0), 1.0)
        shown = min(gain, threshold) * (1.0 - gain)
        for o in range(3):
            for j in range(count):
                share = weights[o, j] * c[j]
                mean[i, o] += share
                for d in range(D):
                    slope[i, o, d] += share * (points[j, d] - z[i, d])
            if certainty:
                s[:count] = 0.0
                _times(learned[o], c, count, s)
                for j in range(count):
                    spread[i, o] += s[j] * c[j]
                # What is spanned stays: rounding may not make it negative.
                spread[i, o] = max(spread[i, o], gain) - absent[o] * shown
    return mean, np.maximum(spread, 0.0), slope
