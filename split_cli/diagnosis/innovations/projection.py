"""Products (I - V M V^T) x for few columns x and many rows, compiled.

Library products of a tall matrix with one to six columns reach a third of the memory bandwidth. The search for terms
spends most of its time on them.
"""

import numpy as np
from numba import njit

_FEW = 8  # columns [1] up to which the loops below are faster than a library


def damped(rows: np.ndarray, basis: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Return (I - V M V^T) x, of the shape of `rows`.

    Parameters
    ----------
    rows : ndarray, shape (R,) or (R, P)
        x
    basis : ndarray, shape (R, C)
        V, contiguous.
    root : ndarray, shape (C,)
        Diagonal of M.
    """
    flat = rows.ndim == 1
    columns = rows[:, None] if flat else rows
    if columns.shape[1] > _FEW:
        return rows - basis @ (root[:, None] * (basis.T @ columns))
    columns = np.ascontiguousarray(columns, dtype=float)
    out = _taken_off(columns, basis, _projected(columns, basis) * root)
    return out[:, 0] if flat else out


@njit(cache=True, nogil=True, fastmath=True)
def _projected(columns, basis):
    """Return x^T V, shape (P, C)."""
    size, directions = basis.shape
    out = np.zeros((columns.shape[1], directions))
    for i in range(size):
        for p in range(columns.shape[1]):
            x = columns[i, p]
            for c in range(directions):
                out[p, c] += x * basis[i, c]
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _taken_off(columns, basis, weights):
    """Return x - V w^T with w of shape (P, C)."""
    size, directions = basis.shape
    out = np.empty_like(columns)
    for i in range(size):
        for p in range(columns.shape[1]):
            total = 0.0
            for c in range(directions):
                total += basis[i, c] * weights[p, c]
            out[i, p] = columns[i, p] - total
    return out
