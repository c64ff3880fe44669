"""The squared-exponential kernel: one set of length scales for all outputs, variances an output."""

from dataclasses import dataclass

import numpy as np

OUTPUTS = ("vx", "vy", "r")


@dataclass(frozen=True)
class Kernel:
    """Hyperparameters of the residual's Gaussian process."""

    # (D,): one a feature, in the feature's unit; shared by the outputs, so that a cell keeps one point set.
    length_scales: np.ndarray
    signal_variance: np.ndarray  # (3,): S0 of v_x', v_y' [m^2/s^4] and r' [rad^2/s^4]
    noise_variance: np.ndarray  # (3,): label noise s^2, same units
    origin: str = "given"  # {"default", "given", "fitted"}

    def __post_init__(self) -> None:
        for name in ("length_scales", "signal_variance", "noise_variance"):
            values = np.ascontiguousarray(getattr(self, name), dtype=float)
            if not (np.isfinite(values).all() and (values > 0).all()):
                raise ValueError(f"{name} must be finite and positive, got {values}")
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    @property
    def clearest(self) -> int:
        """The output, 0 to 2, whose labels have the largest signal for their noise: they tell most of a place."""
        return int(np.argmax(self.signal_variance / self.noise_variance))

    def knowledge(self, variance: np.ndarray) -> np.ndarray:
        """Return the share of the prior's variance that labels explain, from 0 where there are none to 1, shape (N,).

        Parameters
        ----------
        variance : ndarray, shape (N, 3)
            Latent variance of the process. That of the `clearest` output counts, since all share their labels.
        """
        one = self.clearest
        explained: np.ndarray = np.maximum(1.0 - variance[:, one] / self.signal_variance[one], 0.0)
        return explained

    def correlation(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the unit-variance kernel between rows of `a` (N, D) and `b` (M, D), shape (N, M)."""
        return correlation(a, b, self.length_scales)


def correlation(a: np.ndarray, b: np.ndarray, length_scales: np.ndarray) -> np.ndarray:
    """Return exp(-|a_i - b_j|^2/2) with features divided by their length scales, shape (..., N, M).

    `a` has shape (..., N, D) and `b` (..., M, D), alike in the axes before.

    Notes
    -----
    SPLIT paper, the Squared Exponential kernel with sigma_f = 1. Distances are summed feature by feature, not by
    the expanded square, so that near points keep their digits.
    """
    squared = np.zeros((*a.shape[:-1], b.shape[-2]))
    for feature, scale in enumerate(length_scales):
        squared += np.square((a[..., :, None, feature] - b[..., None, :, feature]) / scale)
    return np.exp(-0.5 * squared)
