"""Errors and probabilities as sums that can be added over drives, and the figures of merit made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erfinv

#: Shares of probability whose central intervals are counted.
INTERVALS = (0.5, 0.95)
_LEVELS = np.linspace(0.05, 0.95, 19)


@dataclass(frozen=True)
class ErrorSums:
    """Squared errors, pooled: means of root mean squares over drives would favour short ones."""

    squared: np.ndarray  # (3,): sum of squares a state
    count: int  # samples

    @classmethod
    def of(cls, errors: np.ndarray) -> ErrorSums:
        """Sum the squares of errors, shape (N, 3); rows that are not finite are left out of sum and count."""
        finite = np.isfinite(errors).all(axis=1)
        return cls(np.square(errors[finite]).sum(axis=0), int(finite.sum()))

    def __add__(self, other: ErrorSums) -> ErrorSums:
        return ErrorSums(self.squared + other.squared, self.count + other.count)

    @property
    def rmse(self) -> np.ndarray:
        """Root mean square a state, shape (3,) [m/s^2], [m/s^2], [rad/s^2] for labels; NaN without samples."""
        return np.sqrt(self.squared / self.count) if self.count else np.full(3, np.nan)

    @property
    def norm(self) -> float:
        """Root mean square of the error's norm over the three states, as the SPLIT paper's \\|e\\|.

        It adds m/s^2 and rad/s^2, as the paper does; read it beside the single states.
        """
        return float(np.sqrt(self.squared.sum() / self.count)) if self.count else float("nan")


def skill(errors: ErrorSums, reference: ErrorSums) -> np.ndarray:
    """Return 1 - MSE/MSE of the reference for v_x, v_y, r and the norm, shape (4,).

    1 is perfect, 0 as good as the reference, negative worse; NaN where the reference has no error.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.append(errors.rmse, errors.norm) ** 2 / np.append(reference.rmse, reference.norm) ** 2
    return np.where(np.isfinite(ratio), 1.0 - ratio, np.nan)


@dataclass(frozen=True)
class ProbabilitySums:
    """How well predicted distributions describe the labels, pooled."""

    negative_log_density: np.ndarray  # (3,): sum over samples of -log p(y) [nat]
    inside: np.ndarray  # (2, 3): samples inside the central intervals of `INTERVALS`
    # (19, 3): samples inside central intervals of 5, 10, ... 95 % probability.
    reliability: np.ndarray
    count: int

    @classmethod
    def of(cls, errors: np.ndarray, variance: np.ndarray) -> ProbabilitySums:
        """Score Gaussian predictions.

        Parameters
        ----------
        errors : ndarray, shape (N, 3)
            Label minus mean.
        variance : ndarray, shape (N, 3) or (3,)
            Of a label: latent variance plus label noise.
        """
        finite = np.isfinite(errors).all(axis=1)
        variance = np.broadcast_to(variance, errors.shape)[finite]
        normalised = np.square(errors[finite]) / variance
        density = 0.5 * (normalised + np.log(2.0 * np.pi * variance)).sum(axis=0)
        standard = np.sqrt(normalised)

        def inside(levels: Sequence[float] | np.ndarray) -> np.ndarray:
            bound = np.sqrt(2.0) * erfinv(np.asarray(levels))
            held: np.ndarray = np.sum(standard[None] <= bound[:, None, None], axis=1).astype(float)
            return held

        return cls(density, inside(INTERVALS), inside(_LEVELS), int(finite.sum()))

    def __add__(self, other: ProbabilitySums) -> ProbabilitySums:
        return ProbabilitySums(
            self.negative_log_density + other.negative_log_density,
            self.inside + other.inside,
            self.reliability + other.reliability,
            self.count + other.count,
        )

    @property
    def nlpd(self) -> np.ndarray:
        """Mean negative log predictive density a state, shape (3,) [nat]; lower is better."""
        return self.negative_log_density / max(self.count, 1)

    @property
    def coverage(self) -> np.ndarray:
        """Share of labels inside the central intervals of `INTERVALS`, shape (2, 3)."""
        return self.inside / max(self.count, 1)

    @property
    def reliability_curve(self) -> tuple[np.ndarray, np.ndarray]:
        """Return expected shares, shape (19,), and observed shares, shape (19, 3)."""
        return _LEVELS, self.reliability / max(self.count, 1)
