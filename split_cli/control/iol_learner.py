"""The online rival in closed loop: one dictionary, in a thread of its own that falls behind."""

import time
from dataclasses import replace

import numpy as np

from split_cli.control.grip import PeakShift
from split_cli.control.learner import LabellingLearner
from split_cli.control.policy import DICTIONARY
from split_cli.control.residual import Residual, ResidualValues
from split_cli.learning.iol import Dictionary, empty_dictionary, extend_dictionary
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import Labels
from split_cli.learning.training_set import TrainingSet


def printed_update_cost(points: int) -> float:
    """Return what re-evaluating every gain by an inversion a point would take here [s].

    One inversion of a matrix of `points` - 1 is timed, the median of three, and counted once a point.
    """
    if points < 2:
        return 0.0
    matrix = np.eye(points - 1) + np.exp(-np.square(np.subtract.outer(*2 * [np.arange(points - 1.0)])))
    times = []
    for _ in range(3):
        start = time.thread_time()
        np.linalg.inv(matrix)
        times.append(time.thread_time() - start)
    return points * float(np.median(times))


class DictionaryResidual(Residual):
    """The exact process on a dictionary, factored again after each update.

    Parameters
    ----------
    header : TrainingSet
        For features and kernel.

    Notes
    -----
    Kabzan et al. evaluate a FITC approximation for speed; the SPLIT paper leaves FITC out since it made the race
    fail, and so does this: the rival gets the better evaluation, and its cost is not counted against it.
    """

    def __init__(self, dictionary: Dictionary, header: TrainingSet) -> None:
        self.dictionary = dictionary
        self.features, self.kernel = header.features, header.kernel
        self.refresh()

    def refresh(self) -> None:
        """Factor the kernel matrices of the dictionary as it is now."""
        kernel: Kernel = self.kernel
        z, y = self.dictionary.z.copy(), self.dictionary.y
        self._z = z / kernel.length_scales
        correlation = kernel.correlation(z, z)
        ratio = kernel.noise_variance / kernel.signal_variance
        self._inverse = np.array([np.linalg.inv(correlation + r * np.eye(len(z))) for r in ratio])
        self._weights = np.einsum("oij,jo->io", self._inverse, self.beyond_prior(z, y))

    def rest_on(self, peak: PeakShift | None) -> None:
        """Take the prior mean, and factor anew."""
        super().rest_on(peak)
        self.refresh()

    def of_data(self, z: np.ndarray) -> ResidualValues:
        """Return mean, slope and variance at features `z`, shape (N, D)."""
        scaled = z / self.kernel.length_scales
        gap = self._z[None] - scaled[:, None]
        cross = np.exp(-0.5 * np.square(gap).sum(axis=2))
        mean = cross @ self._weights
        slope = np.einsum("nk,nkd,ko->nod", cross, gap, self._weights, optimize=True) / self.kernel.length_scales
        explained = np.stack([((cross @ inverse) * cross).sum(axis=1) for inverse in self._inverse], axis=1)
        knowledge = np.clip(explained, 0.0, 1.0)
        return ResidualValues(
            mean, slope * knowledge[:, :, None], (1.0 - knowledge) * self.kernel.signal_variance, knowledge
        )


class IolLearner(LabellingLearner):
    """Kabzan et al. 2019: every sample is compared with the whole dictionary.

    Parameters
    ----------
    header : TrainingSet
        An empty set, for vehicle, features, region and kernel.
    printed : bool
        Count an update as the SPLIT paper describes it, all gains by an inversion each; otherwise as the
        incremental inverse of `Dictionary` takes it, which is far cheaper and gives the same dictionary.

    Notes
    -----
    Learning has a thread of its own: while an update runs, in simulated time and by its measured cost, samples
    that come in are not looked at, and the controller goes on with the residual of before.
    """

    def __init__(self, header: TrainingSet, printed: bool = True) -> None:
        super().__init__(header)
        self.set = empty_dictionary(header, DICTIONARY)
        self.printed = printed
        self.dictionary = Dictionary(header.kernel, DICTIONARY, header.threshold)
        self.residual = DictionaryResidual(self.dictionary, header)
        self.busy_until, self.skipped = -np.inf, 0
        self._pending = False
        self._offered: list[Labels] = []
        # Seconds that an update takes, by the number of points in the dictionary.
        self.costs = {n: printed_update_cost(n) for n in (50, 100, 200, 300, DICTIONARY)} if printed else {}

    @property
    def size(self) -> int:
        """Points of the dictionary."""
        return len(self.dictionary)

    def begin_lap(self, name: str, start_time: float) -> None:
        """Begin a source of the set."""
        self._name, self._start_time, self._offered = name, start_time, []

    def _update(self, labels: Labels) -> int:
        now = float(labels.t[0]) + labels.horizon
        if now < self.busy_until:
            self.skipped += 1
            return 0
        if self._pending:
            self.residual.refresh()
            self._pending = False
        self._offered.append(labels)
        if not labels.accepted[0]:
            return 0
        start = time.thread_time()
        slot = self.dictionary.offer(labels.z[0], labels.y[0], now)
        cost = time.thread_time() - start
        if self.printed:
            cost = float(np.interp(self.size, list(self.costs), list(self.costs.values())))
        if slot < 0:
            # A rejected sample costs its own gain only, one product with the inverse that is kept.
            self.busy_until = now + (0.0 if self.printed else cost)
            return 0
        self.busy_until, self._pending = now + cost, True
        return 1

    def end_lap(self, duration: float) -> TrainingSet:
        """Return the dictionary as a set, the lap as its last source."""
        if self._offered:
            labels = Labels.joined(self._offered)
            labels = replace(labels, drive=self._name, start_time=self._start_time, duration=duration)
            self.set = extend_dictionary(self.set, [labels])
        return self.set
