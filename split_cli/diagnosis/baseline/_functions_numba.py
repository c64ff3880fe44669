"""The weighted sum of the shared discrepancy's smooth functions, compiled, without storing each function."""

import numpy as np
from numpy import ndarray

from split_cli.compiled_code import compiled

_SAMPLES_AT_A_TIME = 256
"""Samples whose powers are computed at a time [1]: with the sums 47 kB, about the first cache of a core. Judgement; it
affects time and no result."""


@compiled(cache=True, nogil=True)
def _add_product(powers: ndarray, row: ndarray, weight: float, out: ndarray) -> None:
    a, b, c, v = powers[0, row[0]], powers[1, row[1]], powers[2, row[2]], powers[3, row[3]]
    for s in range(_SAMPLES_AT_A_TIME):
        out[s] += weight * (a[s] * b[s]) * (c[s] * v[s])


@compiled(cache=True, nogil=True)
def _add_products(powers: ndarray, row: ndarray, one: float, two: float, out: ndarray, other: ndarray) -> None:
    a, b, c, v = powers[0, row[0]], powers[1, row[1]], powers[2, row[2]], powers[3, row[3]]
    for s in range(_SAMPLES_AT_A_TIME):
        product = (a[s] * b[s]) * (c[s] * v[s])
        out[s] += one * product
        other[s] += two * product


@compiled(cache=True, nogil=True)
def weighted_functions(
    z: ndarray,
    steer: ndarray,
    even: ndarray,
    odd: ndarray,
    of_even: ndarray,
    of_odd: ndarray,
    of_sizes: ndarray,
    of_memory: ndarray,
    starts: ndarray,
    kept: ndarray,
    mean: ndarray,
) -> ndarray:
    """Return longitudinal, front lateral and rear lateral force, shape (3, N), as a share of an axle's peak force.

    Parameters
    ----------
    z, steer : ndarray, shape (4, N) and (N,)
        Scaled features and steer angle.
    even, odd : ndarray of int64, shape (F, 4) and (G, 4)
        Powers of the features.
    of_even, of_odd, of_sizes, of_memory : ndarray, shape (F,), (2, G), (9,) and (3, 5)
        Weights, with z = (a, b, c, v): of the powers; of |c|, and of a |c|, b |c|, |a| a, |b| b at the front and at the
        rear; and for each time constant, of the filtered less the unfiltered c and a^2 (longitudinal), steer and c a
        (front), c b (rear).
    starts : ndarray of int64
        Samples at which the filters restart in steady state.
    kept, mean : ndarray, shape (3,)
        e^-q and (1 - e^-q)/q of each time constant, with q the sample period over it; see `first_order_response`.
    """
    n = z.shape[1]
    out = np.zeros((3, n))
    powers, total = np.ones((4, 5, _SAMPLES_AT_A_TIME)), np.zeros((3, _SAMPLES_AT_A_TIME))
    for first in range(0, n, _SAMPLES_AT_A_TIME):
        count = min(_SAMPLES_AT_A_TIME, n - first)
        for d in range(4):
            for p in range(1, 5):
                for s in range(count):
                    powers[d, p, s] = powers[d, p - 1, s] * z[d, first + s]
        total[:] = 0.0
        for f in range(len(even)):
            _add_product(powers, even[f], of_even[f], total[0])
        for f in range(len(odd)):
            _add_products(powers, odd[f], of_odd[0, f], of_odd[1, f], total[1], total[2])
        for i in range(3):
            for s in range(count):
                out[i, first + s] = total[i, s]
    slow, before, here = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    upcoming = 0
    for s in range(n):
        a, b, c = z[0, s], z[1, s], z[2, s]
        size = abs(c)
        out[0, s] += of_sizes[0] * size
        for side in range(2):
            k = 1 + 4 * side
            out[1 + side, s] += (of_sizes[k] * a + of_sizes[k + 1] * b) * size
            out[1 + side, s] += of_sizes[k + 2] * abs(a) * a + of_sizes[k + 3] * abs(b) * b
        here[0], here[1], here[2] = c, a * a, steer[s]
        anew = upcoming < len(starts) and starts[upcoming] == s
        upcoming += anew
        for t in range(3):
            for i in range(3):
                drive = (1.0 - kept[t]) * before[i] + (1.0 - mean[t]) * (here[i] - before[i])
                slow[t, i] = here[i] if anew else kept[t] * slow[t, i] + drive
            late = slow[t, 0] - c
            out[0, s] += of_memory[t, 0] * late + of_memory[t, 1] * (slow[t, 1] - here[1])
            out[1, s] += of_memory[t, 2] * (slow[t, 2] - here[2]) + of_memory[t, 3] * late * a
            out[2, s] += of_memory[t, 4] * late * b
        before[:] = here
    return out
