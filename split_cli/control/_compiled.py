"""Inner loops of the controllers, compiled; the plain forms are in tests/control."""

import numba
import numpy as np

_TERMS = 14
#: The Taylor series of 14 terms leaves 1e-13 where the scaled matrix has this norm.
_NORM = 1.0


@numba.njit(cache=True)
def _multiply(a, b, out):
    """Write a b into out; zeros of a cost nothing."""
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
        for k in range(n):
            value = a[i, k]
            if value != 0.0:
                for j in range(n):
                    out[i, j] += value * b[k, j]


@numba.njit(cache=True)
def _with_identity(a, g, e):
    """Write E = I + A G into e."""
    _multiply(a, g, e)
    for row in range(a.shape[0]):
        e[row, row] += 1.0


@numba.njit(cache=True)
def discretize(A, step):
    """Return exp(A h), shape (N, n, n), and int_0^h exp(A s) ds, shape (N, n, n), by scaling and squaring.

    With G(t) = int_0^t exp(A s) ds and E = I + A G: G(2 t) = G(t) + E(t) G(t). Most of A is zero, and so it is the
    left factor wherever it may be.
    """
    count, n = A.shape[0], A.shape[1]
    E, G = np.empty_like(A), np.empty_like(A)
    M, power, work = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for i in range(count):
        norm = 0.0
        for row in range(n):
            total = 0.0
            for column in range(n):
                total += abs(A[i, row, column])
            norm = max(norm, total * step)
        halvings = 0
        while norm > _NORM and halvings < 40:
            norm *= 0.5
            halvings += 1
        t = step / 2.0**halvings
        M[:] = A[i] * t
        g, e = G[i], E[i]
        # G/t = I + M/2! + M^2/3! + ...
        power[:] = 0.0
        g[:] = 0.0
        for row in range(n):
            power[row, row] = 1.0
            g[row, row] = 1.0
        for term in range(2, _TERMS + 2):
            _multiply(M, power, work)
            for row in range(n):
                for column in range(n):
                    power[row, column] = work[row, column] / term
                    g[row, column] += power[row, column]
        for row in range(n):
            for column in range(n):
                g[row, column] *= t
        for _ in range(halvings):
            _with_identity(A[i], g, e)
            _multiply(e, g, work)
            for row in range(n):
                for column in range(n):
                    g[row, column] += work[row, column]
        _with_identity(A[i], g, e)
    return E, G
