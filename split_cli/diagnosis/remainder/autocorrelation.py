"""Residual autocorrelation: rows that no smooth function explains, and that still vary together.

Gusts, a driver's hand on a loose column, a load that shifts: they have no place in feature space, in time or along
the track, yet they are no noise. Their slow variance is.
"""

from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.innovations.autocovariance import LAG_ROWS, autocovariances, bartlett_sum
from split_cli.diagnosis.policy import STANDARD, SelfTestRules
from split_cli.diagnosis.remainder.structure import Structure

_NEAR_ROWS = 4


@dataclass(frozen=True)
class ResidualAutocorrelation:
    """How much rows vary together."""

    ratio: float  # long-run variance over that of a row, at least 1; the worst of v_x, v_y and r
    effect_to_noise: float  # root of the variance that neighbouring rows share, over that of their noise
    rows: int

    def p_value(self, usual: float, rules: SelfTestRules = STANDARD.self_test) -> float:
        """Return the probability of varying together this much where `usual` is the simulation's own ratio.

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
    """Return how much whitened residuals (R,) vary together beyond every flexible fit.

    Notes
    -----
    The long-run variance over the plain one (Newey and West, 1987). A flexible fit takes slow parts with it, so
    that white rows give less than 1. Rows quieter than noise, of a simulation without any, count as noisy ones.
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
