"""The learned residual as a controller takes it: value, slope and variance along the predicted trajectory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from split_cli.control.grip import PeakShift
from split_cli.learning.features import Z2, FeatureSet
from split_cli.prediction.online import OnlineCommittee
from split_cli.prediction.predictor import Predictor

__all__ = ["NoResidual", "OnlineResidual", "PredictorResidual", "Residual", "ResidualValues"]


@dataclass(frozen=True)
class ResidualValues:
    """The residual at N features.

    Attributes
    ----------
    mean : ndarray, shape (N, 3)
        Rates left out, of v_x, v_y [m/s^2] and r [rad/s^2].
    slope : ndarray, shape (N, 3, D)
        Its Jacobian with respect to the features.
    variance : ndarray, shape (N, 3)
        Latent variance, same units squared.
    knowledge : ndarray, shape (N, 3)
        1 - variance/prior variance, from 0 (nothing was learned here) to 1.
    """

    mean: np.ndarray
    slope: np.ndarray
    variance: np.ndarray
    knowledge: np.ndarray

    def stages(self, which: slice) -> ResidualValues:
        """Return the residual at some of the features."""
        return ResidualValues(self.mean[which], self.slope[which], self.variance[which], self.knowledge[which])


class Residual(ABC):
    """What a controller adds to its nominal model.

    Attributes
    ----------
    features : FeatureSet
    peak : PeakShift or None
        What moved peaks of the tyres leave out, told where the data say nothing.

    Notes
    -----
    A process without data returns to its prior mean. With zero for it, the nominal model speaks there, whose peaks
    are the very thing that labels contradict. So the prior mean m is the force that the moved peaks leave out,
    mean = data + (1 - knowledge) m, which is the posterior k K^-1 (y - m) + m with k K^-1 m taken as knowledge m:
    exact at a point that is known well, and far from all data.
    """

    features: FeatureSet = Z2
    peak: PeakShift | None = None

    @abstractmethod
    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return what the data say at features `z`, shape (N, D), and nothing where there are none."""

    def along(self, z: np.ndarray) -> ResidualValues:
        """Return the residual at features `z`, shape (N, D), the peaks' share where data are missing included."""
        found = self.of_data(z)
        if self.peak is None:
            return found
        mean, slope = self.peak.at(z)
        missing = 1.0 - found.knowledge
        return replace(found, mean=found.mean + missing * mean, slope=found.slope + missing[:, :, None] * slope)


class NoResidual(Residual):
    """The nominal model alone."""

    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return zeros; nothing is known, and nothing is claimed."""
        count, width = z.shape
        zero = np.zeros((count, 3))
        return ResidualValues(zero, np.zeros((count, 3, width)), zero, zero)


class PredictorResidual(Residual):
    """A predictor of a trained set.

    Parameters
    ----------
    predictor : Predictor
    damped : bool
        Multiply the slope by what is known, 1 - variance/prior: where data thin out a slope is the least certain
        of all that the residual says, and a controller that follows it to the edge spins.
    """

    def __init__(self, predictor: Predictor, damped: bool = True) -> None:
        self.predictor, self.damped = predictor, damped
        self.features = predictor.training_set.features
        self._prior = predictor.training_set.kernel.signal_variance

    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return mean, slope and variance at features `z`, shape (N, D)."""
        if self.predictor.training_set.size == 0:
            nothing = NoResidual().of_data(z)
            variance = np.broadcast_to(self._prior, nothing.mean.shape)
            return ResidualValues(nothing.mean, nothing.slope, variance, nothing.knowledge)
        predictor = self.predictor.at(z)
        found = predictor.predict(z)
        slope = predictor.jacobian(z)
        knowledge = np.clip(1.0 - found.variance / self._prior, 0.0, 1.0)
        if self.damped:
            slope = slope * knowledge[:, :, None]
        return ResidualValues(found.mean, slope, found.variance, knowledge)


class OnlineResidual(Residual):
    """The committee of a set that grows while it is asked.

    Parameters
    ----------
    committee : OnlineCommittee
    damped : bool
        As of `PredictorResidual`.
    """

    def __init__(self, committee: OnlineCommittee, damped: bool = True) -> None:
        self.committee, self.damped = committee, damped
        self.features = committee.online.header.features
        self._prior = committee.kernel.signal_variance

    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return mean, slope and variance at features `z`, shape (N, D)."""
        mean, variance, slope = self.committee.along(z)
        knowledge = np.clip(1.0 - variance / self._prior, 0.0, 1.0)
        if self.damped:
            slope = slope * knowledge[:, :, None]
        return ResidualValues(mean, slope, variance, knowledge)
