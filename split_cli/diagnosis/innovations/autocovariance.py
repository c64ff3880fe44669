"""Autocovariances of rows, and what they contribute to a long-run variance (Newey and West, 1987)."""

import numpy as np

LAG_ROWS = 25  # of 0.04 s: a second


def autocovariances(rows: np.ndarray, count: int) -> np.ndarray:
    """Return the autocovariances of rows (G, C) of zero mean at lags 1 to `count`, shape (count, C)."""
    out = [np.sum(rows[lag:] * rows[:-lag], axis=0) / len(rows) for lag in range(1, count + 1)]
    return np.array(out).reshape(count, rows.shape[1])


def bartlett_sum(covariances: np.ndarray, width: int) -> np.ndarray:
    """Return what autocovariances (K, C) of lags 1 to K add to the variance for a long-run variance, shape (C,).

    Notes
    -----
    2 sum_k (1 - k/width) c_k (Newey and West, 1987); with K = width - 1 and the variance added, the mean square of
    sums of `width` successive rows over the width, rows outside taken as 0.
    """
    return 2.0 * (1.0 - np.arange(1, len(covariances) + 1) / width) @ covariances
