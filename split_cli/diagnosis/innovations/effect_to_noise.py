"""Effect-to-noise ratio: the rms of an effect's prediction error over 0.05 s, over that of sensor noise."""

from collections.abc import Callable, Sequence

import numpy as np

from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.recording.series import Series
from split_cli.vehicle.effects import Term

_HORIZON = 0.05
_ROWS_AT_A_TIME = 8192  # rows that are joined for a product [1]; affects memory alone


def effect_to_noise(series: Series, defect: np.ndarray) -> float:
    """Return the largest of the three effect-to-noise ratios of defects [1]; see `effects_to_noise`."""
    return float(effects_to_noise(series, defect).max())


def effects_to_noise(series: Series, defect: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
    """Return the effect-to-noise ratios of defects in v_x, v_y and r, shape (3,) [1].

    Parameters
    ----------
    defect : ndarray, shape (N - 1, 3)
        What an effect adds to each transition [m/s], [m/s], [rad/s].
    rows : ndarray of int, optional
        Samples about which windows of 0.05 s are taken; by default all windows.

    Notes
    -----
    The rms of the defects summed over 0.05 s, over the noise of a difference of two samples.
    """
    return rms_over_noise(series, windowed(series, defect, rows))


def windowed(series: Series, defect: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
    """Return defects (N - 1, ...) summed over 0.05 s, all windows or those about the samples `rows`."""
    window = max(1, int(round(_HORIZON / series.period)))
    total = np.zeros((len(defect) + 1, *defect.shape[1:]))
    np.cumsum(defect, axis=0, out=total[1:])
    if rows is None or len(total) <= window:
        return total[window:] - total[:-window]
    first = np.clip(rows - window // 2, 0, len(total) - window - 1)
    return total[first + window] - total[first]


def rms_over_noise(series: Series, errors: np.ndarray) -> np.ndarray:
    """Return the rms of prediction errors (W, 3) over the noise of a difference of two samples, shape (3,) [1]."""
    if not len(errors):
        return np.zeros(3)
    return np.sqrt(np.mean(errors**2, axis=0)) / (np.sqrt(2.0) * series.stated_noise)


def products_over_noise(series: Series, errors: Sequence[np.ndarray]) -> np.ndarray:
    """Return mean products of prediction errors over the variance of a difference, shape (3, Q, Q).

    The Q columns come a few at a time, shape (W, 3, c) each. With weights w of them, w^T (products) w is the
    square of what `rms_over_noise` makes of `errors @ w`.
    """
    products = np.stack([products_of([some[:, i] for some in errors]) for i in range(3)])
    return products / (2.0 * max(len(errors[0]), 1) * series.stated_noise[:, None, None] ** 2)


def products_of(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """Return the products of columns, shape (Q, Q), from blocks of columns, shape (R, c) each.

    Blocks are joined for some rows at a time, so that the columns are not in memory twice.
    """
    total = 0.0
    for begin in range(0, max(len(blocks[0]), 1), _ROWS_AT_A_TIME):
        rows = np.hstack([some[begin : begin + _ROWS_AT_A_TIME] for some in blocks])
        total = total + rows.T @ rows
    return total


def effects_to_noise_of(
    evidence: Evidence,
    rows: np.ndarray,
    terms: tuple[Term, ...],
    without: tuple[Term, ...] = (),
    discrepancy_rates: Callable[[tuple[Term, ...]], np.ndarray | None] = lambda terms: None,
) -> np.ndarray:
    """Return the effect-to-noise ratios of terms about the samples `rows`, against the model with `without` alone.

    `discrepancy_rates` returns how terms change the rates of the shared discrepancy, (N, 3), or None.
    """
    with_all, with_some = (evidence.defects(some, discrepancy_rates(some)) for some in (terms, without))
    return effects_to_noise(evidence.series, with_all - with_some, rows)
