"""Columns whose cells are written only where the value changes."""

import numpy as np

_EMPTY = 0.2
"""Share of empty cells, below which nothing is looked for [1]; judgement."""
_FEWEST, _FEWEST_LONG = 50, 10
"""Values, and long gaps among them, that show the form [1]; judgement."""
_AGAIN = 0.05
"""Share of values that follow themselves, at most [1]: a logger may write all channels now and then."""
_LONG = 5.0
"""Times the usual gap, from which on one is long [1]; judgement."""
_STEPS = 2.5
"""Smallest steps by which a value differs behind a long gap, at most [1]: one, or two where a row was late."""
_SHARE = 0.9
"""Of the long gaps, that end in so small a step [1]; a sensor that failed comes back elsewhere. Judgement."""


def held_on_change(values: np.ndarray) -> np.ndarray | None:
    """Return a column that is written on change with each value held until the next, shape (N,); None of any other.

    Parameters
    ----------
    values : ndarray
        As recorded, shape (N,), NaN where the cell is empty.

    Notes
    -----
    Hardly any value follows itself, gaps are of all lengths, and behind a long one the value is the next step of a
    coarse scale: that the cell was empty says that the value was the same. A slow sensor has gaps that are alike,
    and what moved in a long one is far from where it was.
    """
    kept = np.flatnonzero(np.isfinite(values))
    if len(kept) < _FEWEST or len(kept) > (1.0 - _EMPTY) * len(values):
        return None
    steps, gaps = np.abs(np.diff(values[kept])), np.diff(kept)
    if np.mean(steps == 0.0) > _AGAIN:
        return None
    scale = float(np.quantile(steps[steps > 0.0], 0.01))
    long = gaps >= _LONG * np.median(gaps)
    if np.count_nonzero(long) < _FEWEST_LONG or np.mean(steps[long] <= _STEPS * scale) < _SHARE:
        return None
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))
    return np.where(last >= 0, values[np.maximum(last, 0)], np.nan)
