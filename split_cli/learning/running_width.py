"""Running width: intervals that hold the share of labels that they promise, on whatever is driven."""

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

#: What a label outside adds to the logarithm of a width, times the level [1]: a 95 % interval grows by 10 % for
#: each label outside, and shrinks by 0.5 % for each inside. Judgement: seven labels outside in a row double it.
_STEP = 0.1


class RunningWidth:
    """Half-widths of intervals in predicted deviations, adapted while a drive lasts.

    Parameters
    ----------
    levels : sequence of float, shape (L,)
        Shares of labels that the intervals are to hold [1].

    Attributes
    ----------
    widths : ndarray, shape (L, 3)
        Half-width of each interval over the predicted standard deviation, label noise included; at first a
        Gaussian's.

    Notes
    -----
    A label outside multiplies the width by exp(0.1 level), one inside by exp(-0.1 (1 - level)). Over N labels the
    share inside is then off the level by |log(last width/first)|/(0.1 N) at most, whatever the labels are
    (Gibbs and Candes, Adaptive conformal inference under distribution shift, NeurIPS 2021, equation 2, here of
    the logarithm of a width).
    """

    def __init__(self, levels: Sequence[float] = (0.5, 0.9, 0.95)) -> None:
        self._outside = 1.0 - np.array(levels, dtype=float)[:, None]
        self.widths = np.tile(ndtri(1.0 - 0.5 * self._outside), (1, 3))

    def observe(self, ratio: np.ndarray) -> np.ndarray:
        """Take in a label's error over its predicted deviation, shape (3,); return whether it was inside (L, 3).

        What is not finite leaves its widths as they are and counts as outside.
        """
        size = np.abs(ratio)
        inside: np.ndarray = size <= self.widths
        self.widths = np.where(np.isfinite(size), self.widths * np.exp(_STEP * (~inside - self._outside)), self.widths)
        return inside
