"""Whether what a model leaves is noise: its autocorrelation over time."""

import numpy as np

_TWO_SIDED_99 = 2.575829


def autocorrelation(values: np.ndarray, run: np.ndarray, lags: int) -> tuple[np.ndarray, float]:
    """Return the autocorrelation at lags 0 to `lags`, and the 99 % band of white noise around 0.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Equally spaced inside a run; the mean over all is taken out.
    run : ndarray, shape (N,)
        Changes where samples do not follow each other; no product spans a change.

    Notes
    -----
    The band is 2.58/sqrt(N): the limit in law for white noise (Ljung, System Identification, residual analysis).
    Differences of noisy samples are not white: sensor noise alone gives -0.5 at lag 1.
    """
    centred = values - values.mean()
    power = float(np.mean(centred**2))
    out = np.zeros(lags + 1)
    for lag in range(min(lags, len(values) - 1) + 1):
        ahead = len(values) - lag
        same = run[:ahead] == run[lag:]
        if same.any() and power > 0.0:
            out[lag] = float(np.mean(centred[:ahead][same] * centred[lag:][same])) / power
    return out, _TWO_SIDED_99 / np.sqrt(max(len(values), 1))
