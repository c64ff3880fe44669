"""Predictors in plain NumPy: what every export is compared with.

That of the committee visits every cell for every query and shares neither tables nor code with the exports.
"""

import numpy as np

from split_cli.export.projection import answer_of, projection_data
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.predictor import Prediction
from split_cli.prediction.projected import ProjectedPredictor
from split_cli.prediction.table import TablePredictor

_CHUNK = 256


class Reference:
    """Mean and latent variance of a predictor of a set, evaluated otherwise than in an export.

    Attributes
    ----------
    deviation : ndarray, shape (3,)
        Signal deviations.
    hessian_step : ndarray, shape (D,)
        Step of differences of the Jacobian: small against the distance on which the committee changes.
    """

    rounding: float = 1e-12  # what the predictor may differ by, in signal deviations and variances
    accuracy: float = 1e-12  # what an export in double may differ by, likewise

    def __init__(self, training_set: TrainingSet) -> None:
        kernel = training_set.kernel
        self.training_set = training_set
        self.deviation = np.sqrt(kernel.signal_variance)
        self._ratio = kernel.noise_variance / kernel.signal_variance
        self.hessian_step = 1e-3 * np.sqrt(self._ratio.min()) * kernel.length_scales

    def predict(self, z: np.ndarray) -> Prediction:
        """Return mean and latent variance at `z`, shape (N, D), as far as the set is trusted."""
        z = np.asarray(z, dtype=float)
        parts = [self._chunk(z[first : first + _CHUNK]) for first in range(0, len(z), _CHUNK)]
        mean, variance = (np.concatenate(column) for column in zip(*parts, strict=True))
        signal = self.training_set.kernel.signal_variance
        return Prediction(*self.training_set.trust.apply(mean, variance, signal))

    def knowledge(self, z: np.ndarray) -> np.ndarray:
        """Return the share of the prior's variance that labels explain at `z`, shape (N,)."""
        parts = [self._chunk(z[first : first + _CHUNK])[1] for first in range(0, len(z), _CHUNK)]
        return self.training_set.kernel.knowledge(np.concatenate(parts))

    def _chunk(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and latent variance at a few queries as though the set were fully trusted."""
        raise NotImplementedError

    def jacobian_by_differences(self, z: np.ndarray) -> np.ndarray:
        """Return the mean's Jacobian by central differences of fourth order, shape (N, 3, D).

        The step is 0.003 of the shortest distance on which the mean changes, sqrt(rho) length scales.
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
        scales = self.training_set.kernel.length_scales
        size: np.ndarray = (self.deviation / np.sqrt(self._ratio))[:, None] / scales
        return size


class CommitteeReference(Reference):
    """The Bayesian committee machine straight from the trained set, to about 1e-13 of the signal.

    Parameters
    ----------
    robust : bool
        Whether an expert counts by half the logarithm of what it has learned (`rbcm`).

    Notes
    -----
    Design of the form: S0 - q = S0 - k^T (K + s^2 I)^-1 k is evaluated in the frame of the eigenvectors of the
    correlation matrix. With an explicit inverse the quadratic form cancels, and rounding grows as 1/rho
    (rho = s^2/S0) instead of 1/sqrt(rho): 1e-12 at rho = 0.004, 1e-10 at 0.00004, against a computation in
    extended precision. A comparison at 1e-12 needs a reference better than that.
    """

    def __init__(self, training_set: TrainingSet, robust: bool = False) -> None:
        super().__init__(training_set)
        self.robust, kernel = robust, training_set.kernel
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
                share = (0.5 * np.log(1.0 / rest) if self.robust else 1.0) / rest
                top[:, output] += (m * share).sum(axis=0)
                precision[:, output] += (q * share).sum(axis=0)
        return top / precision, kernel.signal_variance / precision


class ProcessReference(Reference):
    """The projected process from the numbers that are exported, in plain NumPy.

    Notes
    -----
    A sum is rounded by at most eps times the sizes of its terms (Higham, Accuracy and Stability, section 4.2).
    The predictor takes c.Q c off 1, and Q = L L^T reaches 1e6 where labels have no noise: `rounding` is 16 eps
    times the trace of Q.
    What is exported sums c.w and L^T c: `accuracy` is eps times the larger of sum |w| and 2 |L|.
    """

    def __init__(self, predictor: ProjectedPredictor) -> None:
        super().__init__(predictor.training_set)
        self._numbers = vars(projection_data(predictor))
        lower, weights = self._numbers["whitening"], self._numbers["weights"] / self.deviation
        eps, squares = np.finfo(float).eps, float(np.square(lower).sum())
        self.rounding = max(Reference.rounding, 16.0 * eps * squares)
        terms = max(float(np.abs(weights).sum(axis=0).max()), 2.0 * np.sqrt(squares))
        self.accuracy = max(Reference.accuracy, eps * terms)

    def _chunk(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return answer_of(self._numbers, z)


class SplineReference(Reference):
    """A table evaluated from its coefficients by the Cox-de Boor recursion, axis by axis.

    Parameters
    ----------
    table : TablePredictor
        In double.

    Notes
    -----
    `hessian_step` is a hundred-thousandth of the spacing, since second derivatives have kinks at the nodes.
    """

    def __init__(self, table: TablePredictor) -> None:
        super().__init__(table.training_set)
        self.table = table
        self.hessian_step = 1e-5 * table.spline.spacing

    def _chunk(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        spline = self.table.spline
        sizes = np.array(spline.coefficients.shape[:3])
        # Nodes so far out that nothing but zeros is met there, for queries that are far or infinite.
        place = np.clip((z - spline.origin) / spline.spacing, 1.0, sizes - 2.0)
        value = np.empty((len(z), 6))
        for i, query in enumerate(place):
            if np.isnan(query).any():
                value[i] = np.nan
                continue
            first = [min(int(v), n - 3) - 1 for v, n in zip(query, sizes, strict=True)]
            block = spline.coefficients[tuple(slice(k, k + 4) for k in first)]
            weights = [[_cubic(v - (k + j)) for j in range(4)] for v, k in zip(query, first, strict=True)]
            value[i] = spline.unit * np.einsum("abcw,a,b,c->w", block.astype(float), *weights)
        left = np.minimum(np.maximum(1.0 - value[:, 3:], self.table.least), 1.0)
        return value[:, :3], self.training_set.kernel.signal_variance * left**2

    def jacobian_by_differences(self, z: np.ndarray) -> np.ndarray:
        """Return the mean's Jacobian by central differences, shape (N, 3, 3).

        The step is 1e-4 of the spacing: where a piece ends within it the third derivative jumps, which a
        difference sees as 1e-9 of the mean.
        """
        jacobian = np.empty((len(z), 3, 3))
        for feature, spacing in enumerate(self.table.spline.spacing):
            step = np.zeros(3)
            step[feature] = 1e-4 * spacing
            change = self.predict(z + step).mean - self.predict(z - step).mean
            jacobian[:, :, feature] = change / (2.0 * step[feature])
        return jacobian


def _cubic(x: float) -> float:
    """Return the centred cubic B-spline of unit spacing at `x`, by the recursion over its degree."""

    def basis(x: float, degree: int) -> float:
        if degree == 0:
            return 1.0 if -0.5 <= x < 0.5 else 0.0
        half = 0.5 * (degree + 1)
        return ((half + x) * basis(x + 0.5, degree - 1) + (half - x) * basis(x - 0.5, degree - 1)) / degree

    return basis(x, 3)
