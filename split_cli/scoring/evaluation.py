"""One evaluation: predictors, nominal model, persistence and noise floor scored on the same samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from split_cli.learning.labels import Labels
from split_cli.logs.drive import Drive
from split_cli.prediction import Prediction, Predictor
from split_cli.scoring.application import correction_from, left_by_model, predict_rows
from split_cli.scoring.metrics import ErrorSums, ProbabilitySums, skill
from split_cli.scoring.noise import NoiseFloor, noise_floor
from split_cli.scoring.persistence import label_persistence_errors, velocity_persistence_errors
from split_cli.scoring.rollouts import hold_velocity, roll_out, rollout_starts
from split_cli.scoring.splits import BlockSplit
from split_cli.vehicle.single_track import SingleTrack

NOMINAL = "nominal"
VELOCITY_PERSISTENCE = "velocity held"
LABEL_PERSISTENCE = "last label held"


@dataclass(frozen=True)
class HeldOutSamples:
    """One drive's test samples."""

    drive: Drive
    split: BlockSplit
    labels: Labels  # all labels of the drive, in order
    z: np.ndarray  # (rows of the drive, D): features of every row

    @property
    def tested(self) -> np.ndarray:
        """Index of the labels that test: window on test rows, and computable, shape (N,)."""
        blocked = np.concatenate([[0], np.cumsum(~self.split.test)])
        last = np.minimum(self.labels.row + self.labels.window + 1, len(self.drive))
        inside = blocked[last] == blocked[self.labels.row]
        return np.flatnonzero(inside & np.isfinite(self.labels.y).all(axis=1))


def predictor_names(keys: Iterable[tuple[str, str]]) -> dict[tuple[str, str], str]:
    """Return what to call each predictor with its features; of one set of features only the predictor is named."""
    keys = list(keys)
    several = len({features for _, features in keys if features}) > 1
    return {key: " on ".join(part for part in key if part) if several else key[0] for key in keys}


@dataclass(frozen=True)
class ScoreTally:
    """Sums of one model over test samples: all of them, and those inside the valid region."""

    everywhere: ErrorSums
    valid: ErrorSums
    probability: ProbabilitySums | None = None

    @classmethod
    def of(cls, errors: np.ndarray, valid: np.ndarray, variance: np.ndarray | None = None) -> ScoreTally:
        """Sum errors (N, 3) with the mask of the valid region (N,) and the labels' predicted variance."""
        probability = None if variance is None else ProbabilitySums.of(errors, variance)
        return cls(ErrorSums.of(errors), ErrorSums.of(errors[valid]), probability)

    def __add__(self, other: ScoreTally) -> ScoreTally:
        mine, theirs = self.probability, other.probability
        return ScoreTally(
            self.everywhere + other.everywhere,
            self.valid + other.valid,
            None if mine is None or theirs is None else mine + theirs,
        )


@dataclass(frozen=True)
class Score:
    """Figures of merit of one model; arrays are v_x, v_y, r, and the norm where there are four."""

    name: str  # ``nominal``, ``velocity held``, ``last label held``, or a predictor
    features: str  # ``z1``, ``z2`` or names; empty for the baselines
    drive: str  # empty when pooled over all
    points: int | None  # size of the set behind it
    # samples, samples_valid: test samples, and those inside the valid region.
    samples: int
    samples_valid: int
    # rmse, rmse_valid: (4,): [m/s^2], [m/s^2], [rad/s^2] and the norm.
    rmse: np.ndarray
    rmse_valid: np.ndarray
    # skill_nominal, skill_velocity_held, skill_label_held: (4,): 1 - MSE/MSE of that baseline.
    skill_nominal: np.ndarray
    skill_velocity_held: np.ndarray
    skill_label_held: np.ndarray
    # (3,): [nat] a sample. The nominal model's is that of a Gaussian with mean 0 and the training labels' mean
    # square.
    nlpd: np.ndarray | None = None
    # coverage_50, coverage_95: (3,): observed share inside the central intervals.
    coverage_50: np.ndarray | None = None
    coverage_95: np.ndarray | None = None
    time_per_query: float | None = None  # [s]
    uses_recorded_future: bool = False


def baseline_tallies(held: HeldOutSamples, model: SingleTrack, variance: np.ndarray | None) -> dict[str, ScoreTally]:
    """Return the tallies of the nominal model and both persistences on a drive's test samples.

    Parameters
    ----------
    variance : ndarray, shape (3,), or None
        Of the Gaussian that the nominal model's density is scored with.
    """
    index = held.tested
    tested = held.labels.take(index)
    errors = {
        NOMINAL: tested.y,
        VELOCITY_PERSISTENCE: velocity_persistence_errors(model, held.drive, tested),
        LABEL_PERSISTENCE: label_persistence_errors(held.labels)[index],
    }
    return {
        name: ScoreTally.of(values, tested.accepted, variance if name == NOMINAL else None)
        for name, values in errors.items()
    }


def labels_left(held: HeldOutSamples, predictor: Predictor) -> Labels:
    """Return a drive's test samples with what the model of a predictor's set leaves of each, however it is trusted."""
    tested = held.labels.take(held.tested)
    return replace(tested, y=left_by_model(predictor, held.drive, held.z, tested))


def predictor_tally(held: HeldOutSamples, predictor: Predictor, tested: Labels) -> tuple[ScoreTally, Prediction]:
    """Return a predictor's tally on a drive's test samples and its predictions of them.

    Parameters
    ----------
    tested : Labels
        As `labels_left` returns them for this predictor.
    """
    prediction = predict_rows(predictor, held.drive, held.z, tested.row)
    noise = predictor.training_set.kernel.noise_variance
    tally = ScoreTally.of(tested.y - prediction.mean, tested.accepted, prediction.variance + noise)
    return tally, prediction


def score(name: str, tally: ScoreTally, baselines: dict[str, ScoreTally], **known: Any) -> Score:
    """Turn sums into figures of merit; `known` fills the other fields of `Score`."""
    errors, valid, probability = tally.everywhere, tally.valid, tally.probability
    return Score(
        name=name,
        samples=errors.count,
        samples_valid=valid.count,
        rmse=np.append(errors.rmse, errors.norm),
        rmse_valid=np.append(valid.rmse, valid.norm),
        skill_nominal=skill(errors, baselines[NOMINAL].everywhere),
        skill_velocity_held=skill(errors, baselines[VELOCITY_PERSISTENCE].everywhere),
        skill_label_held=skill(errors, baselines[LABEL_PERSISTENCE].everywhere),
        nlpd=None if probability is None else probability.nlpd,
        coverage_50=None if probability is None else probability.coverage[0],
        coverage_95=None if probability is None else probability.coverage[1],
        **{"features": "", "drive": "", "points": None, **known},
    )


def pooled_noise_floor(model: SingleTrack, drives: Sequence[HeldOutSamples]) -> NoiseFloor:
    """Return the floor over the test samples of all drives, pooled by squares."""
    squares, count, notes = np.zeros(3), 0, []
    for held in drives:
        tested = held.labels.take(held.tested)
        if not len(tested):
            continue
        floor = noise_floor(model, held.drive, tested)
        if floor.reason:
            notes.append(f"{held.drive.name}: {floor.reason}")
        if floor.rms is None:
            return NoiseFloor(None, notes[-1])
        squares += len(tested) * floor.rms**2
        count += len(tested)
    return NoiseFloor(np.sqrt(squares / count), "; ".join(notes)) if count else NoiseFloor(None, "no test samples")


def rollout_trajectories(
    held: HeldOutSamples,
    model: SingleTrack,
    predictors: dict[tuple[str, str], tuple[HeldOutSamples, Predictor]],
    steps: int,
) -> tuple[np.ndarray, dict[tuple[str, str], np.ndarray]]:
    """Return start rows in a drive's test blocks, and the rollout of every model from them as `roll_out` does.

    Parameters
    ----------
    held : HeldOutSamples
        Says which rows test.
    predictors : dict
        (Name, features) to the drive as the predictor's features see it, and the predictor. What its set found
        beyond the vehicle file is part of its model.
    steps : int
        Steps of h.
    """
    window = held.labels.window
    speed = held.labels.region.minimum_speed
    starts = rollout_starts(held.drive, held.split.test, steps * window, speed)
    trajectories = {
        (NOMINAL, ""): roll_out(model, held.drive, starts, steps, window),
        (VELOCITY_PERSISTENCE, ""): hold_velocity(held.drive, starts, steps, window),
    }
    for key, (own, predictor) in predictors.items():
        correction = correction_from(predictor, own.drive, own.z, starts)
        known = predictor.training_set
        learned = SingleTrack(known.vehicle) if known.found_effects else model
        trajectories[key] = roll_out(learned, held.drive, starts, steps, window, correction)
    return starts, trajectories
