"""Statistics of one lap while it is driven: errors of the model, distance to the border, step times."""

import numpy as np

from split_cli.control.learner import Learned
from split_cli.control.receding_horizon import StepInfo
from split_cli.learning.labels import Labels
from split_cli.signals import STANDARD_GRAVITY
from split_cli.workflows.racing.result import Lap


class Tally:
    """Statistics of one lap.

    Parameters
    ----------
    number : int
        Number of the lap.
    first : int
        Row of the world's recording at which it begins.
    share : float
        Share of the peak force that plans may use [1].
    length : float
        Length of a lap [m]; places along the track are counted from the line.

    Attributes
    ----------
    beyond, place : float, float or None
        Largest distance of a side of the car beyond the border [m], at least 0, and the progress there [m].
    needed : float
        Most by which the car came nearer to the border than plans do [m].
    margin : float
        Smallest distance to the border that plans kept [m].
    """

    def __init__(self, number: int, first: int, share: float, length: float) -> None:
        self.number, self.first, self.share, self.length = number, first, share, length
        self.infos: list[StepInfo] = []
        self.learned: list[Learned] = []
        self.trace: list[tuple[float, ...]] = []
        self.beyond, self.place = 0.0, None
        self.needed = -np.inf
        self.margin = np.inf

    def add(self, row: tuple[float, ...], beyond: float, kept: float, info: StepInfo) -> None:
        """Add one interval.

        Parameters
        ----------
        row : tuple of float
            Row of `RaceResult.traces`.
        beyond, kept : float
            Distance of a side of the car beyond the border, negative within the track, and the distance to the border
            that plans keep there [m].
        info : StepInfo
            Result of the controller's step.
        """
        self.infos.append(info)
        if beyond > self.beyond:
            self.beyond, self.place = beyond, row[1]
        self.needed = max(self.needed, kept + beyond)
        self.margin = min(self.margin, kept)
        self.trace.append(row)

    @property
    def labels(self) -> Labels:
        """Labels of the lap, in the order of the intervals."""
        return Labels.joined([entry.labels for entry in self.learned])

    def lap(self, time: float | None, truth: np.ndarray, size: int, cells: int, ended: str) -> Lap:
        """Return the lap: its time [s], `truth` the exact rows (t, X, Y, yaw, v_x, v_y, r, a_x, a_y, ...)."""
        used = [entry for entry in self.learned if entry.labels.accepted[0]]
        before, after = _errors([(entry.labels.y[0], entry.predicted) for entry in used])
        exact = [(entry.exact_label, entry.exact_predicted) for entry in used if entry.exact_label is not None]
        motion_before, motion_after = _errors(exact)
        return Lap(
            number=self.number,
            time=time,
            mean_speed=float(np.hypot(truth[:, 4], truth[:, 5]).mean()),
            max_lateral=float(np.abs(truth[:, 8]).max()) / STANDARD_GRAVITY,
            updates=sum(entry.updates for entry in self.learned),
            size=size,
            cells=cells,
            error_before=before,
            error_after=after,
            samples=len(self.learned),
            accepted=len(used),
            solver_ms=_times([info.solver_seconds for info in self.infos]),
            step_ms=_times([info.total_seconds for info in self.infos]),
            update_ms=_times([entry.seconds for entry in self.learned]),
            failures=sum(not info.solved for info in self.infos),
            outside=self.beyond,
            outside_at=None if self.place is None else self.place % self.length,
            ended=ended,
            motion_before=motion_before,
            motion_after=motion_after,
            margin=self.margin if self.infos else 0.0,
            share=self.share,
        )


def _errors(pairs: list[tuple[np.ndarray, np.ndarray]]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return root mean squares of labels and of what predictions leave of them."""
    labels = np.array([label for label, _ in pairs]).reshape(-1, 3)
    predicted = np.array([prediction for _, prediction in pairs]).reshape(-1, 3)
    return _rms(labels), _rms(labels - predicted)


def _rms(values: np.ndarray) -> tuple[float, ...]:
    return tuple(np.sqrt(np.mean(np.square(values), axis=0)).tolist()) if len(values) else (0.0, 0.0, 0.0)


def _times(seconds: list[float]) -> tuple[float, ...]:
    return tuple((1e3 * np.quantile(seconds, [0.5, 0.99, 1.0])).tolist()) if seconds else (0.0, 0.0, 0.0)
