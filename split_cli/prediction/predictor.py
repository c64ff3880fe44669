"""The interface of all predictors: mean, variance and Jacobian for a batch of queries."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from split_cli.learning.training_set import TrainingSet


@dataclass(frozen=True)
class Prediction:
    """Predicted residual of a batch of queries.

    Attributes
    ----------
    mean : ndarray, shape (N, 3)
        Of v_x', v_y' [m/s^2] and r' [rad/s^2].
    variance : ndarray, shape (N, 3)
        Latent variance, without label noise, same units squared.
    """

    mean: np.ndarray
    variance: np.ndarray


class Predictor(ABC):
    """Mean, variance and Jacobian of the residual g(z) from a trained set.

    Attributes
    ----------
    name : str
        How the command line calls it.
    needs_context : bool
        Whether `at` must be called before predicting; reports then say that the recorded future was used.
    """

    name: str
    needs_context: bool = False

    def __init__(self, training_set: TrainingSet) -> None:
        self.training_set = training_set

    def at(self, context: np.ndarray) -> Predictor:
        """Return the predictor for a situation: `context`, shape (P, D), are the features expected next.

        Predictors that need none return themselves.
        """
        return self

    def beginning(self, rows: np.ndarray) -> Predictor:
        """Return the predictor for a batch of predictions that begin at `rows` (N,) of the drive it follows.

        Predictors that follow none return themselves.
        """
        return self

    @abstractmethod
    def predict(self, z: np.ndarray) -> Prediction:
        """Return mean and latent variance at queries `z`, shape (N, D)."""

    def mean(self, z: np.ndarray) -> np.ndarray:
        """Return the mean alone at queries `z`, shape (N, 3); cheaper where the variance costs more."""
        return self.predict(z).mean

    def mean_and_knowledge(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean (N, 3) and what `knowledge` does (N,) at queries `z`: two answers for one prediction."""
        found = self.predict(z)
        return found.mean, self.training_set.kernel.knowledge(found.variance)

    def knowledge(self, z: np.ndarray) -> np.ndarray:
        """Return the share of the prior's variance that labels explain at queries `z`, from 0 to 1, shape (N,).

        How far the correction is trusted does not count. `Kernel.knowledge` says of which output it is.
        """
        return self.mean_and_knowledge(z)[1]

    @abstractmethod
    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Return the mean's Jacobian at queries `z`, shape (N, 3, D)."""
