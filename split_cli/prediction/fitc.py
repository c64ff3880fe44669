"""FITC with the expected trajectory as pseudo-inputs: the sparse process of earlier racing controllers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from split_cli.errors import SplitError
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.factorization import cholesky, most_informative, queries
from split_cli.prediction.predictor import Prediction, Predictor

#: The SPLIT paper's FITC: ten future states, 100 ms apart, as in Hewing et al. (2018).
CONTEXT_STATES = 10
CONTEXT_INTERVAL = 0.1

_REDUNDANT = 1e-8


@dataclass(frozen=True)
class _Situation:
    """What the pseudo-inputs fix: their points (P, D), factors, and weights on the cross-correlation (P, 3)."""

    pseudo_inputs: np.ndarray
    factor: np.ndarray
    posterior_factors: tuple[np.ndarray, ...]
    weights: np.ndarray


class FitcPredictor(Predictor):
    """Fully independent training conditional, pseudo-inputs set by `at`.

    Parameters
    ----------
    situation : _Situation, optional
        Made by `at`.

    Notes
    -----
    Snelson and Ghahramani (2005), in the stable form: with V = L_u^-1 C_uf (L_u the factor of C_uu),
    Lambda = diag(1 - |v_j|^2) + rho I and B = I + V Lambda^-1 V^T = L_B L_B^T, at a query with v = L_u^-1 c_u:
    mean = v^T B^-1 V Lambda^-1 y, variance = S0 (1 - |v|^2 + |L_B^-1 v|^2).
    `at` costs N P^2; pseudo-inputs whose marginal gain given the others is below 1e-8 are dropped, since they
    span nothing of their own.

    Away from the pseudo-inputs the mean goes to the prior whatever the training set holds there.
    """

    name: str = "fitc"
    needs_context: bool = True

    def __init__(self, training_set: TrainingSet, situation: _Situation | None = None) -> None:
        super().__init__(training_set)
        self._situation = situation

    def at(self, context: np.ndarray) -> FitcPredictor:
        """Return the predictor with `context`, shape (P, D), as pseudo-inputs."""
        context = queries(context, self.training_set)
        if len(context) == 0:
            advice = "Evaluate with a drive that goes on after the block."
            raise SplitError("fitc needs at least one future state as pseudo-input", advice=advice)
        stored, kernel = self.training_set, self.training_set.kernel
        kept, _ = most_informative(context, kernel.length_scales, len(context), threshold=_REDUNDANT)
        pseudo = context[np.sort(kept)]
        factor = cholesky(kernel.correlation(pseudo, pseudo), 0.0)
        projected = solve_triangular(factor, kernel.correlation(pseudo, stored.z), lower=True, check_finite=False)
        unexplained = np.maximum(1.0 - np.square(projected).sum(axis=0), 0.0)
        posterior_factors, weights = [], np.empty((len(pseudo), 3))
        for output, ratio in enumerate(kernel.noise_variance / kernel.signal_variance):
            scaled = projected / (unexplained + ratio)
            posterior = cholesky(scaled @ projected.T, 1.0)
            half = solve_triangular(posterior, scaled @ stored.y[:, output], lower=True)
            inner = solve_triangular(posterior, half, lower=True, trans=1)
            weights[:, output] = solve_triangular(factor, inner, lower=True, trans=1)
            posterior_factors.append(posterior)
        return FitcPredictor(stored, _Situation(pseudo, factor, tuple(posterior_factors), weights))

    def predict(self, z: np.ndarray) -> Prediction:
        z, now = queries(z, self.training_set), self._require_situation()
        cross = self.training_set.kernel.correlation(now.pseudo_inputs, z)
        projected = solve_triangular(now.factor, cross, lower=True, check_finite=False)
        prior_left = np.maximum(1.0 - np.square(projected).sum(axis=0), 0.0)
        variance = np.empty((len(z), 3))
        for output, posterior in enumerate(now.posterior_factors):
            spread = np.square(solve_triangular(posterior, projected, lower=True, check_finite=False)).sum(axis=0)
            variance[:, output] = self.training_set.kernel.signal_variance[output] * (prior_left + spread)
        return Prediction(cross.T @ now.weights, variance)

    def mean(self, z: np.ndarray) -> np.ndarray:
        z, now = queries(z, self.training_set), self._require_situation()
        mean: np.ndarray = self.training_set.kernel.correlation(z, now.pseudo_inputs) @ now.weights
        return mean

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        z, now = queries(z, self.training_set), self._require_situation()
        scales = self.training_set.kernel.length_scales
        cross = self.training_set.kernel.correlation(z, now.pseudo_inputs)
        slope = cross[:, :, None] * (now.pseudo_inputs[None] - z[:, None]) / np.square(scales)
        jacobian: np.ndarray = np.einsum("npd,po->nod", slope, now.weights)
        return jacobian

    def _require_situation(self) -> _Situation:
        if self._situation is None:
            raise SplitError("fitc predicts for a situation only", advice="Call .at(future features) first.")
        return self._situation
