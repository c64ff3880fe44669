"""The online process as a predictor: all points of a set, on the few that span them."""

import numpy as np

from split_cli.learning.kernel import Kernel
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.factorization import queries
from split_cli.prediction.online_process import MOST_SPANNING, OnlineProcess, noise_to_signal
from split_cli.prediction.predictor import Prediction, Predictor


def process_of(training_set: TrainingSet, most: int = MOST_SPANNING, threshold: float | None = None) -> OnlineProcess:
    """Return the online process after all labels of a set; parameters as of `OnlineProcess`.

    The points are learned in order of time, which decides which of them span the process. Then the process takes
    the sums that cells keep over all their labels, where they keep them.
    """
    order = learning_order(training_set)
    process = process_of_labels(training_set.kernel, training_set.z[order], training_set.y[order], most, threshold)
    if training_set.information is not None and training_set.size:
        process.inform(training_set.z, training_set.offsets, *sums_over_labels(training_set))
    return process


def sums_over_labels(training_set: TrainingSet) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the sums over a set's labels, and of each cell (C,) the gain up to which it rejects a label [1].

    That is the threshold where a cell has room, and its least gain where it has none: more has been kept.
    """
    s = training_set
    counts = np.diff(s.offsets)
    least = np.minimum.reduceat(s.gamma, s.offsets[:-1]) if s.size else np.zeros(0)
    return *s.sums(), np.where(counts < s.capacity, s.threshold, np.maximum(least, s.threshold))


def learning_order(training_set: TrainingSet) -> np.ndarray:
    """Return the numbers of a set's points in order of time, drive after drive, shape (N,)."""
    return np.lexsort((training_set.row, training_set.source))


def process_of_labels(
    kernel: Kernel, z: np.ndarray, y: np.ndarray, most: int = MOST_SPANNING, threshold: float | None = None
) -> OnlineProcess:
    """Return the online process after labels `y` at `z`, one after the other.

    Where its room is used up on the way, whatever is driven last would find none. The most informative points are
    then chosen first, from the whole set. The threshold is the ratio of noise to signal, also where that exceeds
    1: a set is asked on other drives, and where all labels are mostly noise few points do less harm there.
    """
    threshold = noise_to_signal(kernel) if threshold is None else threshold
    process = OnlineProcess(kernel, most, threshold)
    process.learn(z, y)
    if process.count == most < len(z):
        process = OnlineProcess(kernel, most, threshold)
        process.span(z)
        process.learn(z, y)
    return process


class ProjectedPredictor(Predictor):
    """The online process after the points of a set, in order of time.

    Parameters
    ----------
    most : int
        Largest number of points that span the process.
    threshold : float or None
        As of `OnlineProcess`; by default the smallest ratio of noise to signal variance.
    """

    name: str = "projected"

    def __init__(self, training_set: TrainingSet, most: int = MOST_SPANNING, threshold: float | None = None) -> None:
        super().__init__(training_set)
        self.process = process_of(training_set, most, threshold)

    def predict(self, z: np.ndarray) -> Prediction:
        return Prediction(*self.process.along(queries(z, self.training_set))[:2])

    def mean(self, z: np.ndarray) -> np.ndarray:
        return self.process.along(queries(z, self.training_set), certainty=False)[0]

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        return self.process.along(queries(z, self.training_set), certainty=False)[2]
