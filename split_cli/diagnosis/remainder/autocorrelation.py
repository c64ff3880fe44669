"""Residual autocorrelation: slow disturbances that no function of state, time or place explains.

Gusts, play in the steering column or a shifting load are examples. They show as a long-run variance of the rows that is
larger than their variance.
"""

from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.innovations.autocovariance import LAG_ROWS, autocovariances, bartlett_sum
from split_cli.diagnosis.policy import STANDARD, SelfTestRules
from split_cli.diagnosis.remainder.structure import Structure

_NEAR_ROWS = 4  # first lags of rows, up to 0.16 s, whose mean autocovariance is the size of what lasts [1]; judgement


@dataclass(frozen=True)
class ResidualAutocorrelation:
    """Autocorrelation of whitened rows."""

    ratio: float  # long-run variance over the variance of a row, at least 1; largest of v_x, v_y and r [1]
    effect_to_noise: float  # root of the mean autocovariance at the first lags, over the noise of a row [1]
    rows: int  # rows it was computed from

    def p_value(self, usual: float, rules: SelfTestRules = STANDARD.self_test) -> float:
        """Return the p value of `ratio`, where the simulation by itself has the ratio `usual`.

        Notes
        -----
        The Bartlett estimate of a long-run variance has the relative variance 4 L/(3 n) (Priestley, 1981, section
        6.2.4).
        """
        from scipy.stats import norm

        allowed = rules.term_margin * max(usual, 1.0)
        spread = allowed * np.sqrt(4.0 * LAG_ROWS / (3.0 * max(self.rows, 1)))
        return float(norm.sf((self.ratio - allowed) / spread))


def residual_autocorrelation(structure: Structure, residuals: np.ndarray) -> ResidualAutocorrelation:
    """Return the autocorrelation of whitened residuals (R,) after a flexible fit.

    Notes
    -----
    The long-run variance over the variance (Newey and West, 1987). The flexible fit removes slow parts too, so that
    white rows give less than 1. Variances below 1, as of a simulation without noise, are taken as 1.
    """
    left = structure.left(residuals)
    rows = sum(int(mask.sum()) for mask in structure.objective.keep)
    left = left[: 3 * rows].reshape(rows, 3)  # kinematic rows come last
    width = max(min(LAG_ROWS, rows // 4), 2)
    plain = np.maximum(np.mean(left**2, axis=0), 1.0)
    shared = autocovariances(left, width - 1) / plain
    ratio = 1.0 + bartlett_sum(shared, width)
    near = np.sqrt(np.maximum(shared[:_NEAR_ROWS].mean(axis=0), 0.0))
    return ResidualAutocorrelation(float(max(1.0, ratio.max())), float(near.max()), rows)
