"""Predictors applied to drives: at recorded rows and at simulated states; FITC gets the recorded future."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from split_cli.learning.features import FeatureSet
from split_cli.learning.labels import Labels, nominal_errors
from split_cli.learning.pieces import pieces
from split_cli.logs.drive import Drive
from split_cli.prediction import Prediction, Predictor
from split_cli.prediction.fitc import CONTEXT_INTERVAL, CONTEXT_STATES
from split_cli.vehicle.single_track import SingleTrack

_TIMED_QUERIES = 200
_LONGEST_TIMING = 2.0
#: Features that follow the predicted state in a rollout; all others are taken as recorded.
_OF_STATE = ("alpha_f", "alpha_r", "speed", "vx", "vy", "r")


@dataclass(frozen=True)
class Correction:
    """A residual model in a rollout."""

    features: FeatureSet
    z: np.ndarray  # (rows of the drive, D): recorded features
    residual: Callable[[np.ndarray], np.ndarray]  # features (N, D) to g (N, 3)
    # Features (N, D) to g (N, 3) and how much the set knows there (N,), as `Predictor.mean_and_knowledge`: asked where
    # a lag depends on it. Without it all is known.
    informed: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None

    def answers(self, at: np.ndarray, asks_knowledge: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return g (N, 3) at features `at` (N, D) and how much is known there (N,): all of it unless a model asks."""
        if asks_knowledge and self.informed is not None:
            return self.informed(at)
        return self.residual(at), np.ones(len(at))


def future_rows(drive: Drive, row: int) -> np.ndarray:
    """Return the rows of the next ten states 100 ms apart, fewer at the end of a segment, at least one."""
    step = max(1, round(CONTEXT_INTERVAL / drive.period))
    ahead = row + step * np.arange(1, CONTEXT_STATES + 1)
    last = int(np.searchsorted(drive.segment[row:], drive.segment[row], side="right")) + row - 1
    return np.unique(np.minimum(ahead, last))


def predict_rows(predictor: Predictor, drive: Drive, z: np.ndarray, rows: np.ndarray) -> Prediction:
    """Predict at recorded rows.

    Parameters
    ----------
    z : ndarray, shape (rows of the drive, D)
        Features of every row: a predictor that needs a situation gets the recorded future from it.
    rows : ndarray of int, shape (N,)
    """
    if not predictor.needs_context:
        return predictor.beginning(rows).predict(z[rows])
    mean, variance = np.empty((2, len(rows), 3))
    for i, row in enumerate(rows):
        one = predictor.at(z[future_rows(drive, row)]).predict(z[row : row + 1])
        mean[i], variance[i] = one.mean[0], one.variance[0]
    return Prediction(mean, variance)


def correction_from(predictor: Predictor, drive: Drive, z: np.ndarray, starts: np.ndarray) -> Correction:
    """Return the correction of N rollouts that begin at the rows `starts` of a drive.

    Parameters
    ----------
    z : ndarray, shape (rows of the drive, D)
        Features of every row: a predictor that needs a situation gets the recorded future from it.
    """
    features = predictor.training_set.features
    if not predictor.needs_context:
        begun = predictor.beginning(starts)
        return Correction(features, z, begun.mean, begun.mean_and_knowledge)
    situated = [predictor.at(z[future_rows(drive, row)]) for row in starts]

    def mean(at: np.ndarray) -> np.ndarray:
        return np.concatenate([s.mean(at[i : i + 1]) for i, s in enumerate(situated)])

    def informed(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        both = [s.mean_and_knowledge(at[i : i + 1]) for i, s in enumerate(situated)]
        return np.concatenate([one for one, _ in both]), np.concatenate([known for _, known in both])

    return Correction(features, z, mean, informed)


def left_by_model(predictor: Predictor, drive: Drive, z: np.ndarray, labels: Labels) -> np.ndarray:
    """Return what the model of a predictor's set leaves of recorded windows, shape (N, 3), in units of labels.

    Parameters
    ----------
    z : ndarray, shape (rows of the drive, D)
        Features of every row.
    labels : Labels
        Of the set's vehicle on this drive: N of them.

    Notes
    -----
    These are the labels themselves, but where a lag acts only as far as the set knows: labels have the whole lag.
    """
    model = SingleTrack(predictor.training_set.vehicle)
    if not model.asks_knowledge or not len(labels):
        return labels.y
    _, knowledge = correction_from(predictor, drive, z, labels.row).answers(z[labels.row], True)
    left = np.empty_like(labels.y)
    for rows, piece in pieces(model, drive, labels.row, labels.window):
        local, known = labels.row[rows] - piece.first, knowledge[rows]
        left[rows] = nominal_errors(
            model, piece.drive, local, labels.window, plain=labels.plain, recording=piece.recording, knowledge=known
        )
    return left


def features_at(
    features: FeatureSet, model: SingleTrack, drive: Drive, rows: np.ndarray, velocity: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """Return features at states of the model's own beside recorded inputs, shape (N, D).

    Parameters
    ----------
    rows : ndarray of int, shape (N,)
        Where inputs and all that is no function of the state are taken from.
    velocity : ndarray, shape (N, 3)
        v_x, v_y, r in place of the recorded ones.
    z : ndarray, shape (rows of the drive, D)
        Recorded features.
    """
    columns = {name: values[rows] for name, values in drive.columns.items()}
    columns.update(zip(("vx", "vy", "r"), velocity.T, strict=True))
    alone = Drive(drive.name, columns, np.arange(len(rows), dtype=np.int32), drive.period)
    follows = np.isin(features.names, _OF_STATE)
    at = features.compute(model, alone)
    if model.terms:
        # A single row has no past, so delays and states of the terms are those of the recording.
        recorded = {name: values[rows] for name, values in drive.columns.items()}
        at = at + z[rows] - features.compute(model, replace(alone, columns=recorded))
    return np.where(follows, at, z[rows])


def time_per_query(predictor: Predictor, drive: Drive, z: np.ndarray, rows: np.ndarray) -> float:
    """Return the median time of one query with mean and variance, asked one at a time as a controller does [s].

    For a predictor that needs a situation the time includes `at`.
    """
    rows = rows[np.linspace(0, len(rows) - 1, min(_TIMED_QUERIES, len(rows))).astype(int)]
    predict_rows(predictor, drive, z, rows[:1])
    times: list[float] = []
    for row in rows:
        if sum(times) > _LONGEST_TIMING:
            break
        begin = time.perf_counter()
        predict_rows(predictor, drive, z, np.array([row]))
        times.append(time.perf_counter() - begin)
    return float(np.median(times))
