"""The Bayesian committee machine over the cells of the set: one small Gaussian process a cell, combined."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from split_cli.learning.training_set import TrainingSet
from split_cli.prediction import _compiled
from split_cli.prediction.factorization import queries
from split_cli.prediction.predictor import Prediction, Predictor


@dataclass(frozen=True)
class CommitteeTables:
    """Everything about the cells that does not depend on the query; exports round it and store it."""

    points: np.ndarray  # (P, D): features divided by their length scales
    offsets: np.ndarray  # int64 (C + 1,): points of cell c are rows ``offsets[c]:offsets[c + 1]``
    # (Q,): eigenvectors V of each cell's correlation matrix C_i, n_i x n_i: a row a point, a column an eigenvalue.
    vectors: np.ndarray
    vector_offsets: np.ndarray  # int64 (C + 1,)
    gains: np.ndarray  # (P, 3): 1/(lambda + rho), an eigenvalue of the cell each, rho = s^2/S0 of the output
    turned: np.ndarray  # (P, 3): V^T y of the cell times its gains
    weight_sum: np.ndarray  # (C, 3): sum of the absolute weights (C_i + rho I)^-1 y_i
    # lower, upper: (C, D): box around each cell's points, in length scales.
    lower: np.ndarray
    upper: np.ndarray
    smallest: np.ndarray  # (C, 3): smallest eigenvalue of C_i + rho I
    energy: np.ndarray  # (C, 3): y^T (C_i + rho I)^-1 y over the signal variance, y the cell's labels
    # (C, 3): smallest value 1 - q_i/S0 can take, rho/(n_i + rho): reached by n_i points at the query.
    floor: np.ndarray


def committee_tables(training_set: TrainingSet) -> CommitteeTables:
    """Decompose every cell's kernel matrix, cells of one size together."""
    kernel = training_set.kernel
    ratio = kernel.noise_variance / kernel.signal_variance
    points = np.ascontiguousarray(training_set.z / kernel.length_scales)
    offsets = np.ascontiguousarray(training_set.offsets, dtype=np.int64)
    counts = np.diff(offsets)
    cells = len(counts)
    vector_offsets = np.concatenate([[0], np.cumsum(counts * counts)]).astype(np.int64)
    vectors = np.empty(vector_offsets[-1])
    gains, turned = np.empty((len(points), 3)), np.empty((len(points), 3))
    box = np.empty((2, cells, points.shape[1]))
    smallest, energy, weight_sum = np.empty((3, cells, 3))
    for count in np.unique(counts):
        members = np.flatnonzero(counts == count)
        rows = offsets[members, None] + np.arange(count)
        box[0, members], box[1, members] = points[rows].min(axis=1), points[rows].max(axis=1)
        inside = training_set.z[rows]
        values, columns = np.linalg.eigh(kernel.correlation(inside, inside))
        # A kernel matrix has no negative eigenvalue; below zero is rounding, at most about 1e-15.
        damped = np.maximum(values, 0.0)[:, :, None] + ratio
        labels = columns.transpose(0, 2, 1) @ training_set.y[rows]
        gains[rows], turned[rows] = 1.0 / damped, labels / damped
        slots = vector_offsets[members, None] + np.arange(count * count)
        vectors[slots] = columns.reshape(len(members), -1)
        smallest[members] = damped[:, 0]
        energy[members] = (labels**2 / damped).sum(axis=1) / kernel.signal_variance
        weight_sum[members] = np.abs(np.einsum("cje,ceo->cjo", columns, turned[rows])).sum(axis=1)
    floor = np.ascontiguousarray(ratio / (counts[:, None] + ratio))
    return CommitteeTables(
        points, offsets, vectors, vector_offsets, gains, turned, weight_sum, box[0], box[1], smallest, energy, floor
    )


#: As `_compiled.predict` takes them after the queries: points, turned, gains, vectors, offsets, vector offsets,
#: lower, upper, reach, floor, robust, capacity.
CompiledArguments = tuple[
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    np.ndarray,
    bool,
    int,
]


class BcmPredictor(Predictor):
    """Tresp's committee with latent variances on both sides, in the form that does not cancel.

    Parameters
    ----------
    neglect : float
        Cells so far from the query that together they change the variance by less than ``neglect`` S0, and the
        mean by less than ``neglect`` (sqrt(S0) + \\|mean\\|), are skipped. 0 visits every cell.

    Notes
    -----
    SPLIT paper, the BCM prediction, with the mean multiplied by Sigma and not by its inverse (docs/errata.md):
    Sigma = (-(K-1)/S0 + sum 1/Sigma_i)^-1, mu = Sigma sum mu_i/Sigma_i, with Sigma_i = S0 - q_i and
    q_i = k_i^T (K_i + s^2 I)^-1 k_i. Since 1/Sigma_i = 1/S0 + q_i/(S0 (S0 - q_i)), the K - 1 priors cancel on
    paper instead of in the machine: 1/Sigma = 1/S0 + sum q_i/(S0 (S0 - q_i)), a sum of terms that are not
    negative. An expert's noisy variance S0 - q_i + s^2 against a noise-free prior would make far cells subtract,
    and the precision negative once there are more than S0/s^2 of them.

    Reach: with d the distance in length scales to the box of a cell's n points, every kernel entry is at most
    e^(-d^2/2), so q_i/S0 <= n e^(-d^2) \\|(C_i + rho I)^-1\\| and \\|mu_i\\| <= e^(-d^2/2) \\|w_i\\|_1. A cell is
    skipped when both are below the bound's 1/(2 C)-th part, C the number of cells; as 1/Sigma >= 1/S0, the sums
    of what was left out bound the errors.
    """

    name: str = "bcm"
    robust: ClassVar[bool] = False

    def __init__(self, training_set: TrainingSet, neglect: float = 1e-13) -> None:
        super().__init__(training_set)
        if not 0.0 <= neglect < 1.0:
            raise ValueError(f"neglect is {neglect!r}, it must lie in [0, 1)")
        self.neglect = neglect
        self.tables = committee_tables(training_set)
        self._arguments = self._compiled_arguments()

    def _compiled_arguments(self) -> CompiledArguments:
        t = self.tables
        counts = np.diff(t.offsets)
        capacity = int(counts.max(initial=1))
        reach_squared = self._reach_squared(counts)
        return (
            t.points,
            t.turned,
            t.gains,
            t.vectors,
            t.offsets,
            t.vector_offsets,
            t.lower,
            t.upper,
            reach_squared,
            t.floor,
            self.robust,
            capacity,
        )

    def _reach_squared(self, counts: np.ndarray) -> np.ndarray:
        """Return the squared distance in length scales beyond which a cell is skipped, shape (C,)."""
        if self.neglect == 0.0 or len(counts) == 0:
            return np.full(len(counts), np.inf)
        share = self.neglect / (2.0 * len(counts))
        deviation = np.sqrt(self.training_set.kernel.signal_variance)
        with np.errstate(divide="ignore"):
            variance = np.log(counts[:, None] / self.tables.smallest / share)
            mean = 2.0 * np.log(self.tables.weight_sum / (share * deviation))
        return np.ascontiguousarray(np.maximum(np.maximum(variance, mean).max(axis=1), 0.0))

    def predict(self, z: np.ndarray) -> Prediction:
        z = queries(z, self.training_set)
        kernel = self.training_set.kernel
        mean, spread = _compiled.predict(z / kernel.length_scales, *self._arguments)
        return Prediction(mean, spread * kernel.signal_variance)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        z = queries(z, self.training_set)
        scales = self.training_set.kernel.length_scales
        slopes: np.ndarray = _compiled.jacobian(z / scales, *self._arguments) / scales
        return slopes


class RbcmPredictor(BcmPredictor):
    """The robust committee: an expert counts by what it has learned about the query.

    Notes
    -----
    Deisenroth and Ng, Distributed Gaussian processes, ICML 2015, eqs. 20 to 22, with latent variances:
    1/Sigma = 1/S0 + sum b_i (1/Sigma_i - 1/S0), mu = Sigma sum b_i mu_i/Sigma_i, b_i = log(S0/Sigma_i)/2. Experts
    with little information on the query, of which a committee over small cells has many, no longer add up. Far
    from the data it is the prior, as the dense process; on the points it takes their labels as the noise vanishes.
    """

    name: str = "rbcm"
    robust: ClassVar[bool] = True
