"""The learned residual as a controller takes it: value, slope and variance along the predicted trajectory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from split_cli.control.grip import PeakShift
from split_cli.control.policy import TABLE_BOUND
from split_cli.learning.features import Z2, FeatureSet
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction import make_predictor
from split_cli.prediction.online import OnlineCommittee
from split_cli.prediction.online_process import OnlineProjection
from split_cli.prediction.predictor import Predictor


@dataclass(frozen=True)
class ResidualValues:
    """The residual at N features."""

    mean: np.ndarray  # (N, 3): rates left out, of v_x, v_y [m/s^2] and r [rad/s^2]
    slope: np.ndarray  # (N, 3, D): its Jacobian with respect to the features
    variance: np.ndarray  # (N, 3): latent variance, same units squared
    knowledge: np.ndarray  # (N, 3): 1 - variance/prior variance, from 0 (nothing was learned here) to 1

    @classmethod
    def of(cls, mean: np.ndarray, slope: np.ndarray, variance: np.ndarray, prior: np.ndarray) -> ResidualValues:
        """Return what a predictor says, given its `prior` variance, (3,), with a slope of what is known.

        Where data thin out a slope is the least certain of all that the residual says, and a controller that
        follows it to the edge spins: it is multiplied by 1 - variance/prior.
        """
        knowledge = np.clip(1.0 - variance / prior, 0.0, 1.0)
        return cls(mean, slope * knowledge[:, :, None], variance, knowledge)

    def stages(self, which: slice) -> ResidualValues:
        """Return the residual at some of the features."""
        return ResidualValues(self.mean[which], self.slope[which], self.variance[which], self.knowledge[which])


class Residual(ABC):
    """What a controller adds to its nominal model.

    Notes
    -----
    A process without data returns to its prior mean. With zero for it, the nominal model speaks there, whose peaks
    are the very thing that labels contradict. So the prior mean m is the force that the moved peaks leave out, and
    the mean is m + k K^-1 (y - m) (Rasmussen and Williams, Gaussian processes for machine learning, eq. 2.38).
    What is left for the data is small then, and so is what damping its slope makes of it.
    """

    features: FeatureSet = Z2
    peak: PeakShift | None = None  # what moved peaks of the tyres leave out: the prior mean

    def rest_on(self, peak: PeakShift | None) -> None:
        """Take the prior mean; a residual of data lets them speak of what they say beyond it."""
        self.peak = peak

    @abstractmethod
    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return what the data say beyond the prior mean at features `z`, shape (N, D); zero without data."""

    def beyond_prior(self, z: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return labels `y`, shape (N, 3), less the prior mean at features `z`, shape (N, D)."""
        return y if self.peak is None else y - self.peak.at(z)[0]

    def along(self, z: np.ndarray) -> ResidualValues:
        """Return the residual at features `z`, shape (N, D), the prior mean included."""
        found = self.of_data(z)
        if self.peak is None:
            return found
        mean, slope = self.peak.at(z)
        return replace(found, mean=found.mean + mean, slope=found.slope + slope)


class NoResidual(Residual):
    """The nominal model alone."""

    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return zeros; nothing is known, and nothing is claimed."""
        count, width = z.shape
        zero = np.zeros((count, 3))
        return ResidualValues(zero, np.zeros((count, 3, width)), zero, zero)


class PredictorResidual(Residual):
    """A predictor of a trained set, made when it is first asked: a table takes seconds.

    Parameters
    ----------
    name : str
        Of the predictor.
    """

    def __init__(self, training_set: TrainingSet, name: str) -> None:
        self.name = name
        self._set = training_set
        self._made: Predictor | None = None
        self.features = training_set.features
        self._prior = training_set.kernel.signal_variance

    @property
    def predictor(self) -> Predictor:
        """The predictor of what labels say beyond the prior mean."""
        if self._made is None:
            shifted = replace(self._set, y=self.beyond_prior(self._set.z, self._set.y))
            options = {"bound": TABLE_BOUND} if self.name == "table" else {}
            self._made = make_predictor(self.name, shifted, **options)
        return self._made

    def rest_on(self, peak: PeakShift | None) -> None:
        """Take the prior mean; the predictor is made anew."""
        super().rest_on(peak)
        self._made = None

    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return mean, slope and variance at features `z`, shape (N, D)."""
        if self._set.size == 0:
            nothing = NoResidual().of_data(z)
            variance = np.broadcast_to(self._prior, nothing.mean.shape)
            return ResidualValues(nothing.mean, nothing.slope, variance, nothing.knowledge)
        predictor = self.predictor.at(z)
        found = predictor.predict(z)
        return ResidualValues.of(found.mean, predictor.jacobian(z), found.variance, self._prior)


class OnlineResidual(Residual):
    """The committee, or the projected process, of a set that grows while it is asked.

    Parameters
    ----------
    known : OnlineCommittee or OnlineProjection
    """

    def __init__(self, known: OnlineCommittee | OnlineProjection, features: FeatureSet) -> None:
        self.known = known
        self.features = features
        self._prior = known.kernel.signal_variance

    def rest_on(self, peak: PeakShift | None) -> None:
        """Take the prior mean, and learn anew what labels say beyond it; later ones follow."""
        super().rest_on(peak)
        self.known.rest_on(None if self.peak is None else self.beyond_prior)

    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return mean, slope and variance at features `z`, shape (N, D)."""
        mean, variance, slope = self.known.along(z)
        return ResidualValues.of(mean, slope, variance, self._prior)
