"""The dense process with its weights solved once: a query sums over the points that can still matter."""

import numpy as np

from split_cli.learning.training_set import TrainingSet
from split_cli.prediction import _compiled
from split_cli.prediction.factorization import queries
from split_cli.prediction.full import FullPredictor
from split_cli.prediction.local import DEFAULT_NEIGHBOURS, LocalPredictor
from split_cli.prediction.predictor import Prediction, Predictor

#: Largest error of the mean by leaving far points out, in signal deviations.
DEFAULT_BOUND = 1e-4


class WeightsPredictor(Predictor):
    """Mean of the dense process within a stated bound; variance of the process on near points.

    Parameters
    ----------
    bound : float
        Largest error of the mean, in signal deviations; 0 sums over every point.
    neighbours : int
        Points the variance is taken from; a process on fewer points has a variance that is never smaller.

    Attributes
    ----------
    reach : float
        Distance in length scales beyond which a cell is left out.

    Notes
    -----
    mean = sum_j c(z, z_j) w_j with w = (C + rho I)^-1 y, solved once for N^3/3. Points further than d length
    scales add at most e^(-d^2/2) sum |w_j|, which is `bound` signal deviations at the reach. The weights are large
    and alternate, so that the reach is about five length scales; cut at three the sum is useless.
    """

    name: str = "weights"

    def __init__(
        self, training_set: TrainingSet, bound: float = DEFAULT_BOUND, neighbours: int = DEFAULT_NEIGHBOURS
    ) -> None:
        super().__init__(training_set)
        if not 0.0 <= bound < 1.0:
            raise ValueError(f"bound is {bound!r}, it must lie in [0, 1)")
        kernel, s = training_set.kernel, training_set
        self._near = LocalPredictor(training_set, neighbours)
        weights = FullPredictor(training_set).weights
        total = np.abs(weights).sum(axis=0) / np.sqrt(kernel.signal_variance)
        with np.errstate(divide="ignore"):
            squared = 2.0 * np.log(total / bound).max() if bound and s.size else np.inf
        self.reach = float(np.sqrt(max(squared, 0.0)))
        points = np.ascontiguousarray(s.z / kernel.length_scales)
        starts = s.offsets[:-1].astype(np.int64)
        shape = (0, points.shape[1])
        lower = np.minimum.reduceat(points, starts) if s.size else np.empty(shape)
        upper = np.maximum.reduceat(points, starts) if s.size else np.empty(shape)
        self._arguments = (
            points,
            np.ascontiguousarray(weights),
            np.ascontiguousarray(s.offsets, dtype=np.int64),
            lower,
            upper,
            np.full(len(starts), self.reach**2),
        )

    def predict(self, z: np.ndarray) -> Prediction:
        return Prediction(self.mean(z), self._near.predict(z).variance)

    def mean(self, z: np.ndarray) -> np.ndarray:
        z = queries(z, self.training_set)
        return _compiled.weighted_sum(z / self.training_set.kernel.length_scales, *self._arguments)[0]

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        z, scales = queries(z, self.training_set), self.training_set.kernel.length_scales
        slopes: np.ndarray = _compiled.weighted_sum(z / scales, *self._arguments)[1] / scales
        return slopes
