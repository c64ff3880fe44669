"""What the predictors share: checked queries, a Cholesky factor with bounded and loud repair, greedy selection."""

import warnings

import numpy as np
import scipy.linalg

from split_cli.errors import NumericalRepairWarning, SetError
from split_cli.learning.kernel import correlation
from split_cli.learning.training_set import TrainingSet

_LARGEST_JITTER = 1e-6


def queries(z: np.ndarray, training_set: TrainingSet) -> np.ndarray:
    """Return `z` as contiguous floats of shape (N, D).

    Raises
    ------
    ValueError
        If its width is not the number of features.
    """
    z = np.ascontiguousarray(z, dtype=float)
    width = len(training_set.features.names)
    if z.ndim != 2 or z.shape[1] != width:
        raise ValueError(f"queries have shape {z.shape}, (N, {width}) was expected: {training_set.features.names}")
    return z


def cholesky(correlation_matrix: np.ndarray, diagonal: float) -> np.ndarray:
    """Return the lower Cholesky factor of ``correlation_matrix + diagonal I``.

    A matrix that is singular in floating point gets a diagonal raised tenfold a time, from 1e-12 to at most 1e-6
    of the signal variance, with a warning each time.

    Raises
    ------
    SetError
        If 1e-6 does not help.
    """
    jitter = 0.0
    while True:
        matrix = correlation_matrix.copy()
        matrix[np.diag_indices_from(matrix)] += diagonal + jitter
        try:
            low: np.ndarray = scipy.linalg.cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)
            return low
        except scipy.linalg.LinAlgError:
            jitter = 10.0 * jitter if jitter else 1e-12
        if jitter > _LARGEST_JITTER:
            raise SetError(
                f"a kernel matrix of {len(matrix)} points cannot be factored, even with {_LARGEST_JITTER:g} added",
                advice="The noise variance is far too small for points this close; fit the hyperparameters.",
            )
        warnings.warn(
            f"a kernel matrix of {len(matrix)} points is singular; {jitter:g} of the signal variance is added "
            "to its diagonal",
            NumericalRepairWarning,
            stacklevel=2,
        )


def most_informative(
    z: np.ndarray, length_scales: np.ndarray, count: int, threshold: float = 1e-10
) -> tuple[np.ndarray, np.ndarray]:
    """Select samples one by one, each time the one of largest marginal gain given those already selected.

    Parameters
    ----------
    z : ndarray, shape (N, D)
        Candidates.
    length_scales : ndarray, shape (D,)
    count : int
        Samples wanted.
    threshold : float
        Selection ends early when no candidate's gain exceeds it: the others add nothing that can be computed.

    Returns
    -------
    rows : ndarray of int64, shape (K,)
        In order of selection, so that a prefix is the selection of a smaller size.
    gains : ndarray, shape (K,)
        gamma at the moment of selection; not increasing.

    Notes
    -----
    gamma(z) = k(z, z) - k^T K^-1 k (SPLIT paper, the independence measure; unit variance, no noise) is the
    diagonal of the Schur complement, which a pivoted Cholesky factorisation keeps up to date: exact greedy in
    N K^2 operations. The first of equal candidates is taken, so the order does not depend on the machine's mood.
    """
    candidates = len(z)
    count = min(count, candidates)
    columns = np.empty((count, candidates))
    remaining = np.ones(candidates)
    rows = np.empty(count, dtype=np.int64)
    gains = np.empty(count)
    for step in range(count):
        pivot = int(np.argmax(remaining))
        gain = remaining[pivot]
        if gain <= threshold:
            return rows[:step], gains[:step]
        column = correlation(z, z[pivot : pivot + 1], length_scales)[:, 0]
        column -= columns[:step, pivot] @ columns[:step]
        column /= np.sqrt(gain)
        columns[step] = column
        remaining -= column * column
        remaining[pivot] = -np.inf
        rows[step], gains[step] = pivot, gain
    return rows, gains
