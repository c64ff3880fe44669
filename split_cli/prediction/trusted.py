"""A predictor as far as its set is trusted: the one place where trust acts on predictions."""

from __future__ import annotations

import numpy as np

from split_cli.prediction.predictor import Prediction, Predictor


class TrustedPredictor(Predictor):
    """Mean, variance and Jacobian of another predictor, with the trust of its set applied.

    Parameters
    ----------
    inner : Predictor
        Answers as the Gaussian process alone does; its set says how far each output is trusted.
    share : ndarray, shape (N, 3), optional
        The share to apply to each query of a batch of N, in place of the set's own.

    Notes
    -----
    `split_cli.learning.trust.Trust` has the formula. `make_predictor` wraps where trust is not full.
    """

    def __init__(self, inner: Predictor, share: np.ndarray | None = None) -> None:
        super().__init__(inner.training_set)
        self.inner = inner
        self.share = inner.training_set.trust.array if share is None else share
        self.name = inner.name
        self.needs_context = inner.needs_context

    def at(self, context: np.ndarray) -> TrustedPredictor:
        """Return the predictor for a situation, `context` (P, D), equally trusted."""
        return TrustedPredictor(self.inner.at(context), self.share)

    def predict(self, z: np.ndarray) -> Prediction:
        """Return the believed mean and latent variance at queries `z`, shape (N, D)."""
        raw = self.inner.predict(z)
        signal = self.training_set.kernel.signal_variance
        return Prediction(*self.training_set.trust.apply(raw.mean, raw.variance, signal, self.share))

    def mean(self, z: np.ndarray) -> np.ndarray:
        """Return the believed mean alone, shape (N, 3)."""
        believed: np.ndarray = self.share * self.inner.mean(z)
        return believed

    def mean_and_knowledge(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the believed mean (N, 3), and the share of the variance that labels explain whatever the trust."""
        mean, known = self.inner.mean_and_knowledge(z)
        return self.share * mean, known

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Return the believed mean's Jacobian, shape (N, 3, D)."""
        believed: np.ndarray = self.share[..., None] * self.inner.jacobian(z)
        return believed


def untrusted(predictor: Predictor) -> Predictor:
    """Return what answers before trust acts."""
    return predictor.inner if isinstance(predictor, TrustedPredictor) else predictor
