"""The committee in plain NumPy, straight from the trained set: what every export is compared with.

It visits every cell for every query and shares neither tables nor code with the exports.
"""

from __future__ import annotations

import numpy as np

from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.predictor import Prediction

__all__ = ["Reference"]

_CHUNK = 256


class Reference:
    """Mean and latent variance of the Bayesian committee machine, to about 1e-13 of the signal.

    Parameters
    ----------
    training_set : TrainingSet

    Notes
    -----
    Design of the form: S0 - q = S0 - k^T (K + s^2 I)^-1 k is evaluated in the frame of the eigenvectors of the
    correlation matrix. With an explicit inverse the quadratic form cancels, and rounding grows as 1/rho
    (rho = s^2/S0) instead of 1/sqrt(rho): 1e-12 at rho = 0.004, 1e-10 at 0.00004, against a computation in
    extended precision. A comparison at 1e-12 needs a reference better than that.
    """

    def __init__(self, training_set: TrainingSet) -> None:
        kernel = training_set.kernel
        self.training_set = training_set
        self.deviation = np.sqrt(kernel.signal_variance)
        self._ratio = kernel.noise_variance / kernel.signal_variance
        self._groups = []
        offsets = np.asarray(training_set.offsets)
        counts = np.diff(offsets)
        for count in np.unique(counts):
            rows = offsets[:-1][counts == count, None] + np.arange(count)
            points = training_set.z[rows]
            difference = (points[:, :, None, :] - points[:, None, :, :]) / kernel.length_scales
            values, vectors = np.linalg.eigh(np.exp(-0.5 * np.square(difference).sum(axis=-1)))
            damped = np.maximum(values, 0.0)[:, :, None] + self._ratio
            turned = np.einsum("cij,cio->cjo", vectors, training_set.y[rows]) / damped
            self._groups.append((points, vectors, 1.0 / damped, turned))

    def predict(self, z: np.ndarray) -> Prediction:
        """Return mean and latent variance at `z`, shape (N, D), as far as the set is trusted."""
        z = np.asarray(z, dtype=float)
        parts = [self._chunk(z[first : first + _CHUNK]) for first in range(0, len(z), _CHUNK)]
        mean, variance = (np.concatenate(column) for column in zip(*parts, strict=True))
        signal = self.training_set.kernel.signal_variance
        return Prediction(*self.training_set.trust.apply(mean, variance, signal))

    def _chunk(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        kernel = self.training_set.kernel
        top, precision = np.zeros((len(z), 3)), np.ones((len(z), 3))
        for points, vectors, gains, weights in self._groups:
            squared = np.zeros((len(points), len(z), points.shape[1]))
            # Queries may be infinite or so large that their square is: both are simply far away.
            with np.errstate(over="ignore", under="ignore", invalid="ignore"):
                for feature, scale in enumerate(kernel.length_scales):
                    squared += np.square((z[None, :, None, feature] - points[:, None, :, feature]) / scale)
                turned = np.exp(-0.5 * squared) @ vectors
            for output in range(3):
                q = (np.square(turned) @ gains[:, :, output, None])[..., 0]
                m = (turned @ weights[:, :, output, None])[..., 0]
                least = self._ratio[output] / (points.shape[1] + self._ratio[output])
                rest = np.maximum(1.0 - q, least)
                top[:, output] += (m / rest).sum(axis=0)
                precision[:, output] += (q / rest).sum(axis=0)
        return top / precision, kernel.signal_variance / precision

    def jacobian_by_differences(self, z: np.ndarray) -> np.ndarray:
        """Return the mean's Jacobian by central differences of fourth order, shape (N, 3, D).

        The step is 0.003 of the shortest distance on which the committee changes, sqrt(rho) length scales.
        """
        scale = 3e-3 * min(1.0, float(np.sqrt(self._ratio.min())))
        jacobian = np.empty((len(z), 3, z.shape[1]))
        for feature, length in enumerate(self.training_set.kernel.length_scales):
            step = np.zeros(z.shape[1])
            step[feature] = scale * length
            near = self.predict(z + step).mean - self.predict(z - step).mean
            far = self.predict(z + 2.0 * step).mean - self.predict(z - 2.0 * step).mean
            jacobian[:, :, feature] = (8.0 * near - far) / (12.0 * step[feature])
        return jacobian

    def jacobian_scale(self) -> np.ndarray:
        """Return the size a slope can reach, sd/(l sqrt(rho)), shape (3, D)."""
        return (self.deviation / np.sqrt(self._ratio))[:, None] / self.training_set.kernel.length_scales
