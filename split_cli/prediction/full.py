"""The dense Gaussian process on every point of the set: the oracle the sparse predictors are compared with."""

from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.factorization import cholesky, queries
from split_cli.prediction.predictor import Prediction, Predictor

_CHUNK = 512


class FullPredictor(Predictor):
    """Exact Gaussian-process posterior, one Cholesky factor a distinct noise-to-signal ratio.

    Notes
    -----
    SPLIT paper, the Gaussian-process prediction. With the unit-variance kernel c, correlation matrix C and
    rho = s^2/S0 of an output: mean = c^T (C + rho I)^-1 y, latent variance = S0 (1 - c^T (C + rho I)^-1 c).
    Factoring costs N^3/3, a query's variance N^2 an output; the factor is made at the first use and kept.
    """

    name: str = "full"

    def __init__(self, training_set: TrainingSet) -> None:
        super().__init__(training_set)
        kernel = training_set.kernel
        self._ratio = kernel.noise_variance / kernel.signal_variance

    @cached_property
    def _factors(self) -> dict[float, np.ndarray]:
        stored = self.training_set
        correlation = stored.kernel.correlation(stored.z, stored.z)
        return {ratio: cholesky(correlation, ratio) for ratio in sorted(set(self._ratio.tolist()))}

    @cached_property
    def weights(self) -> np.ndarray:
        """(C + rho I)^-1 y, shape (P, 3)."""
        weights = np.zeros_like(self.training_set.y)
        for output, ratio in enumerate(self._ratio.tolist()):
            factor = self._factors[ratio]
            half = solve_triangular(factor, self.training_set.y[:, output], lower=True, check_finite=False)
            weights[:, output] = solve_triangular(factor, half, lower=True, trans=1, check_finite=False)
        return weights

    def predict(self, z: np.ndarray) -> Prediction:
        z = queries(z, self.training_set)
        kernel, size = self.training_set.kernel, self.training_set.size
        mean = np.zeros((len(z), 3))
        variance = np.tile(kernel.signal_variance, (len(z), 1))
        if size == 0:
            return Prediction(mean, variance)
        for begin in range(0, len(z), _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            cross = kernel.correlation(self.training_set.z, z[rows])
            mean[rows] = cross.T @ self.weights
            known = {
                ratio: np.square(solve_triangular(factor, cross, lower=True, check_finite=False)).sum(axis=0)
                for ratio, factor in self._factors.items()
            }
            for output, ratio in enumerate(self._ratio.tolist()):
                # P labels at the query itself would give the most information: rounding may not go below that.
                variance[rows, output] *= np.maximum(1.0 - known[ratio], ratio / (size + ratio))
        return Prediction(mean, variance)

    def mean(self, z: np.ndarray) -> np.ndarray:
        """Return the mean alone, shape (N, 3): P operations a query instead of P^2."""
        z = queries(z, self.training_set)
        mean = np.zeros((len(z), 3))
        for begin in range(0, len(z) if self.training_set.size else 0, _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            mean[rows] = self.training_set.kernel.correlation(z[rows], self.training_set.z) @ self.weights
        return mean

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Return the mean's Jacobian, shape (N, 3, D): sum of weights times -c (z - z_j)/l^2."""
        z = queries(z, self.training_set)
        stored, scales = self.training_set, self.training_set.kernel.length_scales
        jacobian = np.zeros((len(z), 3, z.shape[1]))
        for begin in range(0, len(z) if stored.size else 0, _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            cross = stored.kernel.correlation(z[rows], stored.z)
            for feature, scale in enumerate(scales):
                slope = cross * (stored.z[None, :, feature] - z[rows, None, feature]) / scale**2
                jacobian[rows, :, feature] = slope @ self.weights
        return jacobian
