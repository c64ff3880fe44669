"""The online method of Kabzan et al. (2019) as a predictor: the exact process on one bounded dictionary."""

from dataclasses import replace

import numpy as np

from split_cli.learning.iol import DEFAULT_DICTIONARY, LEARNER, Dictionary
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.full import FullPredictor
from split_cli.prediction.predictor import Prediction, Predictor


class IolPredictor(Predictor):
    """Dense process on what a dictionary of `capacity` points keeps of the set.

    Parameters
    ----------
    training_set : TrainingSet
        One learned by ``iol`` is its dictionary already. Of any other, the points are offered to a dictionary in
        order of time.

    Notes
    -----
    Kabzan et al. (2019), see `learning.iol.Dictionary`, without their FITC step. When the dictionary holds the
    whole set this is the dense process.
    """

    name: str = "iol"

    def __init__(self, training_set: TrainingSet, capacity: int = DEFAULT_DICTIONARY) -> None:
        super().__init__(training_set)
        self._dense = FullPredictor(_reduced(training_set, capacity))

    def predict(self, z: np.ndarray) -> Prediction:
        return self._dense.predict(z)

    def mean(self, z: np.ndarray) -> np.ndarray:
        return self._dense.mean(z)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        return self._dense.jacobian(z)


def _reduced(s: TrainingSet, capacity: int) -> TrainingSet:
    if s.learner == LEARNER:
        return s
    dictionary = Dictionary(s.kernel, capacity, s.threshold)
    for row in np.lexsort((s.row, s.source)):
        dictionary.offer(s.z[row], s.y[row])
    offsets = np.array([0, len(dictionary)], dtype=np.int64)
    # The dense process reads points, labels and kernel only.
    z, y = dictionary.z.copy(), dictionary.y.copy()
    cell = np.zeros(1, dtype=np.int64)
    return replace(s, offsets=offsets, cell_numbers=cell, z=z, y=y, information=None, absorbed=None)
