"""At which lag one signal is best explained by others, to a fraction of a sample, with an error or a refusal."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

LONGEST_DELAY = 1.5
"""Searched on both sides [s]."""

LARGEST_ERROR = 0.05
"""An estimate less sure than this is refused [s], unless it is `_CLEAR` times its error and within twice this."""

_CLEAR = 4.0
_LEAST_DETERMINATION = 0.5
_COARSE_STEP = 0.025
_BLOCKS = 10
_MOST_ROWS = 8000


@dataclass(frozen=True)
class LagFit:
    """By how much one signal lags another."""

    # lag, error: positive when the first is late [s]; standard error from blocks of time.
    lag: float
    error: float
    determination: float  # share of the first signal's variance that the second explains at that lag
    refusal: str = ""  # why the lag is not to be used, else empty
    beyond: float | None = None  # where a wider search finds it, when it lies beyond what is searched [s]


def fit_lag(
    signal: np.ndarray,
    regressors: list[np.ndarray],
    mask: np.ndarray,
    period: float,
    segments: list[slice],
    longest: float = LONGEST_DELAY,
) -> LagFit:
    """Find the lag at which a signal is best explained linearly by others, to a fraction of a sample.

    Parameters
    ----------
    signal : ndarray, shape (N,)
        The one that may be late; NaN where unknown.
    regressors : list of ndarray, shape (N,)
    mask : ndarray of bool, shape (N,)
        Rows to use.
    period : float
        [s].
    longest : float
        Lags searched on both sides [s].

    Notes
    -----
    The signal is shifted by its cubic spline; the residual variance is tabulated over lags for every tenth of the
    time left out, and the vertex of the parabola at its least value taken; the error is their jackknife spread.
    """
    rows, x, shifted = _prepare(signal, regressors, mask, period, segments, longest)
    if rows < 300:
        return LagFit(0.0, np.inf, 0.0, "too little driving in which it changes")
    coarse = np.arange(-longest, longest + 0.5 * _COARSE_STEP, _COARSE_STEP)
    costs = _costs(x, shifted, coarse)
    best = int(np.argmin(costs[0]))
    determination = 1.0 - float(costs[0, best])
    lag = float(coarse[best])

    def farther() -> LagFit:
        return _beyond(
            lag, determination, lambda reach: fit_lag(signal, regressors, mask, period, segments, reach), longest
        )

    if determination < _LEAST_DETERMINATION:
        wider = farther()
        if wider.beyond is not None:
            return wider
        return LagFit(
            lag, np.inf, determination, f"the identity explains only {100.0 * max(determination, 0):.0f} % of it"
        )
    if best in (0, len(coarse) - 1):
        return farther()
    local = (costs[0, 1:-1] < costs[0, :-2]) & (costs[0, 1:-1] < costs[0, 2:])
    others = np.flatnonzero(local) + 1
    rivals = [j for j in others if abs(coarse[j] - lag) > 0.2 and costs[0, j] < 1.1 * costs[0, best] + 1e-6]
    if rivals:
        return LagFit(lag, np.inf, determination, f"{lag:+.2f} s and {coarse[rivals[0]]:+.2f} s fit equally well")
    fine = lag + np.linspace(-_COARSE_STEP, _COARSE_STEP, 9)
    vertices = _vertices(fine, _costs(x, shifted, fine))
    full, parts = vertices[0], vertices[1:]
    error = float(np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((parts - parts.mean()) ** 2)))
    refusal = "" if is_sure(full, error) else f"the lag {full:+.3f} s is uncertain by {error:.3f} s"
    return LagFit(float(full), error, determination, refusal)


def _beyond(lag: float, determination: float, again: Callable[[float], LagFit], longest: float) -> LagFit:
    """Search once four times as far, to say where the lag lies; it is not believed unasked."""
    refusal = f"the best lag is at the end of the search, {lag:+.2f} s"
    if longest > LONGEST_DELAY:
        return LagFit(lag, np.inf, determination, refusal)
    wider = again(4.0 * longest)
    if wider.refusal or not abs(wider.lag) > 0.9 * longest:
        return LagFit(lag, np.inf, determination, f"{refusal}, and none is found within {4.0 * longest:g} s")
    refusal = f"it lies beyond the {longest:g} s that are searched, at {wider.lag:+.2f} +- {wider.error:.2f} s"
    return LagFit(lag, np.inf, determination, refusal, wider.lag)


def is_sure(delay: float, error: float) -> bool:
    """Tell whether a delay [s] of that standard error [s] is to be used."""
    return error <= LARGEST_ERROR or (error <= 2.0 * LARGEST_ERROR and abs(delay) >= _CLEAR * error)


def _prepare(signal, regressors, mask, period, segments, longest):
    """Return the row count, the regressors `(B, n, p)` by blocks of time, and the signal `(B, n)` for a lag."""
    from scipy.interpolate import make_interp_spline

    usable = mask & np.isfinite(signal)
    for regressor in regressors:
        usable &= np.isfinite(regressor)
    margin = int(np.ceil((longest + _COARSE_STEP) / period)) + 1
    known = np.isfinite(signal)
    pieces, splines = [], []
    for run in segments:
        finite = np.flatnonzero(known[run])
        if len(finite) < 4 or len(finite) <= 2 * margin:
            continue
        inside = np.zeros(len(signal), dtype=bool)
        first, last = run.start + finite[0], run.start + finite[-1]
        inside[first + margin : last - margin + 1] = usable[first + margin : last - margin + 1]
        chosen = np.flatnonzero(inside)
        if len(chosen):
            # A spline across the few unknown samples inside keeps the clock; rows next to them are not used.
            splines.append(make_interp_spline((run.start + finite) * period, signal[run.start + finite], k=3))
            pieces.append(chosen)
    total = sum(len(piece) for piece in pieces)
    if total < 300:
        return 0, None, None
    stride = max(1, total // _MOST_ROWS)
    pieces = [piece[::stride] for piece in pieces]
    rows = np.concatenate(pieces)
    length = len(rows) // _BLOCKS
    rows = rows[: length * _BLOCKS]
    columns = [regressor[rows] - np.mean(regressor[rows]) for regressor in regressors]
    design = np.stack(
        [np.clip(column, *np.quantile(column, [0.002, 0.998])) for column in columns] + [np.ones(len(rows))], axis=1
    )
    limits = np.quantile(signal[rows], [0.002, 0.998])

    def shifted(lag: float) -> np.ndarray:
        values = np.concatenate([spline(piece * period + lag) for spline, piece in zip(splines, pieces, strict=True)])
        return np.clip(values[: length * _BLOCKS], *limits).reshape(_BLOCKS, length)

    return len(rows) * stride, design.reshape(_BLOCKS, length, -1), shifted


def _costs(design: np.ndarray, shifted: Callable, lags: np.ndarray) -> np.ndarray:
    """Return 1 - R^2, shape (1 + B, K): with all blocks, then with each one left out."""
    kept = 1.0 - np.eye(1 + _BLOCKS, _BLOCKS, -1)  # which blocks a row of the result has
    inverses = np.linalg.pinv(np.tensordot(kept, np.einsum("bni,bnj->bij", design, design), 1), 1e-12)
    counts = design.shape[1] * kept.sum(axis=1)
    costs = np.empty((1 + _BLOCKS, len(lags)))
    for column, lag in enumerate(lags):
        y = shifted(lag)
        right, squares, sums = kept @ np.einsum("bni,bn->bi", design, y), kept @ (y * y).sum(1), kept @ y.sum(1)
        explained = np.einsum("ri,rij,rj->r", right, inverses, right)
        costs[:, column] = (squares - explained) / np.maximum(squares - sums**2 / counts, 1e-300)
    return costs


def _vertices(lags: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Return for each row of costs the least point of its parabola over the lags."""
    centre = float(np.mean(lags))
    scale = float(lags[-1] - centre)
    coefficients = np.polyfit((lags - centre) / scale, costs.T, 2)
    curvature = np.maximum(coefficients[0], 1e-300)
    return centre + scale * np.clip(-0.5 * coefficients[1] / curvature, -2.0, 2.0)
