"""Learning beside the controller: what each control interval adds to the residual."""

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from split_cli.control.policy import OPEN_ELLIPSE, SETTLED, WIDER
from split_cli.control.residual import NoResidual, OnlineResidual, PredictorResidual, Residual
from split_cli.learning.labels import Labels, compute_labels, window_samples
from split_cli.learning.online import OnlineSet
from split_cli.learning.region import Region
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive import Drive
from split_cli.prediction.online import OnlineCommittee
from split_cli.prediction.online_process import OnlineProjection
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack


def learning_region(vehicle, alpha_max: float, dalpha_max: float, p_long: float) -> Region:
    """Return the region in which a race is learned: slip angles by `WIDER` beyond the controller's bounds.

    The ellipse is left open beyond the peak: where the nominal axle saturates, its force no longer tells how far.
    """
    return Region.of(
        vehicle,
        p_long=p_long,
        p_ellipse=OPEN_ELLIPSE,
        alpha_max=round(WIDER * alpha_max, 3),
        dalpha_max=round(WIDER * dalpha_max, 3),
    )


@dataclass(frozen=True)
class Learned:
    """What one interval gave."""

    labels: Labels  # one: what the nominal model got wrong, accepted where it lies in the region and its grid
    predicted: np.ndarray  # (3,): what the residual said of it before
    updates: int
    seconds: float  # of label and update [s]
    # exact_label, exact_predicted: (3,): the same of the exact motion, where it was given and lies in the region.
    exact_label: np.ndarray | None = None
    exact_predicted: np.ndarray | None = None


class Learner(ABC):
    """Gives the controller its residual, and takes what was driven."""

    residual: Residual
    size: int = 0
    cells: int = 0

    @abstractmethod
    def begin_lap(self, name: str, start_time: float) -> None:
        """Begin a lap, which becomes a source of the set."""

    def run_up_rows(self, driven: int, period: float) -> int:
        """Return how many rows before an interval `learn` wants to see, of `driven` there are in the lap."""
        return 0

    @abstractmethod
    def learn(self, interval: Drive, row: int, exact: Drive | None = None) -> Learned:
        """Take the samples of one control interval, its two ends included.

        Parameters
        ----------
        interval : Drive
            With its run-up before it.
        row : int
            Its first row in the lap.
        exact : Drive, optional
            The same motion without noise. It is compared with the residual and not learned.
        """

    @abstractmethod
    def end_lap(self, duration: float) -> TrainingSet | None:
        """End the lap; return the set, if there is one."""


def settling_time(vehicle: Vehicle) -> float:
    """Return how long before a moment the commands still matter [s]: delays, and `SETTLED` of the slowest lag."""
    terms = SingleTrack(vehicle).terms
    slowest = [term.fastest_rate(vehicle.minimum_speed) for term in terms if getattr(term, "state_names", ())]
    delays = [delay for term in terms for delay in getattr(term, "input_delays", {}).values()]
    # What follows at once, a lag of 0 s, has no rate and needs no time.
    return max((SETTLED / rate for rate in slowest if rate > 0.0), default=0.0) + max(delays, default=0.0)


class LabellingLearner(Learner):
    """A learner that labels intervals and compares them with its residual before it learns them."""

    def __init__(self, header: TrainingSet) -> None:
        self.header = header
        self._run_up = settling_time(header.vehicle)

    def run_up_rows(self, driven: int, period: float) -> int:
        """Return whole label windows that cover the vehicle's memory, as far as the lap goes back."""
        window = window_samples(self.header.horizon, period)
        return min(int(np.ceil(self._run_up / (window * period))), driven // window) * window

    def learn(self, interval: Drive, row: int, exact: Drive | None = None) -> Learned:
        """Label the interval, compare with what the residual says, then learn."""
        start = time.thread_time()
        labels = self._last_label(interval)
        labels = replace(labels.inside(self.header.grid), row=labels.row + row)
        accepted = bool(labels.accepted[0])
        predicted = self.residual.along(labels.z[:1]).mean[0] if accepted else np.zeros(3)
        known = time.thread_time() - start
        of_motion = self._of_motion(exact) if accepted and exact is not None else (None, None)
        start = time.thread_time()
        updates = self._update(labels)
        return Learned(labels, predicted, updates, known + time.thread_time() - start, *of_motion)

    def _last_label(self, interval: Drive) -> Labels:
        """Return the label of the last window; what is before it only lets lags settle."""
        header = self.header
        labels = compute_labels(interval, header.vehicle, header.features, header.region, horizon=header.horizon)
        return labels.take(slice(len(labels) - 1, None))

    def _of_motion(self, exact: Drive) -> tuple[np.ndarray | None, np.ndarray | None]:
        labels = self._last_label(exact)
        if not labels.inside(self.header.grid).accepted[0]:
            return None, None
        return labels.y[0], self.residual.along(labels.z).mean[0]

    def watch(self, labels: Labels) -> int:
        """Learn what was driven without the residual, interval by interval; return how many updates that made.

        Parameters
        ----------
        labels : Labels
            Of the lap that was begun last, its intervals in order.
        """
        labels = labels.inside(self.header.grid)
        return sum(self._update(labels.take(slice(k, k + 1))) for k in range(len(labels)))

    @abstractmethod
    def _update(self, labels: Labels) -> int:
        """Learn one label, which is accepted where it lies in the grid, too; return how many updates that made."""


class NoLearner(LabellingLearner):
    """Learns nothing; its residual is none, or a fixed one.

    Parameters
    ----------
    header : TrainingSet
        Vehicle, features and region by which errors are reported.
    residual : Residual, optional
        None by default.
    """

    def __init__(self, header: TrainingSet, residual: Residual | None = None) -> None:
        super().__init__(header)
        self.residual = residual or NoResidual()

    def begin_lap(self, name: str, start_time: float) -> None:
        """Do nothing: no set grows."""

    def _update(self, labels: Labels) -> int:
        return 0

    def end_lap(self, duration: float) -> TrainingSet | None:
        """Return nothing: nothing was learned."""
        return None


#: Predictors that follow every update while the car drives; others are made anew after each lap.
FOLLOWING: dict[str, type[OnlineCommittee] | type[OnlineProjection]] = {
    "bcm": OnlineCommittee,
    "projected": OnlineProjection,
}


class SplitLearner(LabellingLearner):
    """Every interval is offered to its cell, and a predictor of `FOLLOWING` follows at once.

    Parameters
    ----------
    header : TrainingSet
        What is known before; may be empty.
    predictor : str
        Name of what evaluates the set. The projected process learns every valid label, those too that their cells
        do not keep. One that does not follow is made anew at the end of each lap, and in the first lap of an empty
        set nothing is known.
    """

    def __init__(self, header: TrainingSet, predictor: str = "bcm") -> None:
        super().__init__(header)
        self.online, self.predictor = OnlineSet(header), predictor
        follows = FOLLOWING.get(predictor)
        self.known = None if follows is None else follows(self.online)
        self.residual: Residual
        if self.known is not None:
            self.residual = OnlineResidual(self.known, header.features)
        elif header.size:
            self.residual = PredictorResidual(header, predictor)
        else:
            self.residual = NoResidual()
            self.residual.features = header.features

    @property
    def size(self) -> int:
        """Points of the set."""
        return self.online.size

    @property
    def cells(self) -> int:
        """Non-empty cells."""
        return self.online.cell_count

    def begin_lap(self, name: str, start_time: float) -> None:
        """Begin a source of the set."""
        self.online.begin_drive(name, start_time)

    def _update(self, labels: Labels) -> int:
        change = self.online.offer(labels)
        if isinstance(self.known, OnlineCommittee):
            self.known.update(change.changed)
        elif self.known is not None:
            self.known.learn(labels.z[labels.accepted], labels.y[labels.accepted])
        return change.updates

    def end_lap(self, duration: float) -> TrainingSet:
        """Return the set with the lap as its last source."""
        trained = self.online.end_drive(duration)
        if self.known is None and trained.size:
            self.residual = PredictorResidual(trained, self.predictor)
        return trained
