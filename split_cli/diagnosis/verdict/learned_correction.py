"""A SPLIT correction of what a model leaves: learned on training time, with a trust estimated by cross-validation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.rollouts import LearnedCorrection, Stage, roll_out_stages
from split_cli.diagnosis.verdict.label_errors import BLOCK_SECONDS, LabelErrors, blocks_of_time, in_standard_errors
from split_cli.learning.cells import learn
from split_cli.learning.hyperparameters import default_kernel, scatter_variance
from split_cli.learning.region import z2_grid
from split_cli.prediction import make_predictor

_FEWEST_TO_LEARN = 100  # accepted labels [1]; judgement: 5 s of driving
_FOLDS = 4  # parts of the training time that are predicted from the others [1]
_STARTS = 120  # starts of rollouts in each recording
_SHARES = (1.0, 0.5, 0.0)  # of the trust from labels; the largest is kept with which no rollout gets worse
# Outputs whose trust is reduced together: v_y and r are coupled within a tenth of a second.
_GROUPS = ((0,), (1, 2))
_BEYOND_CHANCE = 1.0  # standard errors over blocks of time that a difference has to exceed


def learn_correction(
    recordings: Sequence[tuple[Evidence, np.ndarray]],
    stages: Sequence[Stage],
    parts: Sequence[LabelErrors],
    errors: Sequence[np.ndarray],
) -> LearnedCorrection | None:
    """Learn a correction of what a model leaves, and the trust in it.

    Parameters
    ----------
    recordings : sequence of (Evidence, ndarray of bool of shape (N,))
        Real recordings and which of their samples are held out; held-out time is not used.
    stages : sequence of Stage
        The model, for each recording.
    parts : sequence of LabelErrors
        For each recording.
    errors : sequence of ndarray, shape (L, 3)
        Label errors of the model [m/s^2], [m/s^2], [rad/s^2].

    Returns
    -------
    LearnedCorrection or None
        None if there are too few labels, or if no output is trusted.

    Notes
    -----
    Each quarter of the training time is predicted from the three others. An output's trust is the share of the
    prediction p that minimises the error e: sum(e p)/sum(p^2), between 0 and 1, and 0 if it saves no more than chance.
    Rollouts over the same quarters then show corrections that make a velocity drift. The trust is halved, then set to
    zero, while an error is larger than without correction: by any amount at the longest horizon, beyond chance at the
    others.
    """
    vehicle = recordings[0][0].vehicle
    folds = [_folds(part) for part in parts]
    whole = _learned(parts, errors, [fold >= 0 for fold in folds], vehicle)
    if whole is None:
        return None
    others = [_learned(parts, errors, [(f >= 0) & (f != k) for f in folds], vehicle) for k in range(_FOLDS)]
    trust = _trust_by_rollouts(recordings, stages, parts, folds, others, _trust_in_labels(parts, errors, folds, others))
    return replace(whole, trust=trust) if np.any(trust) else None


def without_correction(part: LabelErrors, error: np.ndarray, correction: LearnedCorrection | None) -> np.ndarray:
    """Return label errors (L, 3) less the correction, at held-out labels inside its valid region."""
    left = error.copy()
    if correction is not None:
        use = part.held & part.labels.accepted
        left[use] -= correction.at(part.labels.z[use], part.labels.row[use])
    return left


def _folds(part: LabelErrors) -> np.ndarray:
    """Return the quarter of the training time of each label, 0 to 3, shape (L,); -1 for held-out labels."""
    fold = np.full(len(part.held), -1)
    training = np.flatnonzero(~part.held)
    fold[training] = np.arange(len(training)) * _FOLDS // max(len(training), 1)
    return fold


def _learned(parts, errors, masks, vehicle) -> LearnedCorrection | None:
    """Learn a correction on the labels that masks choose; None if they are too few."""
    training = [
        replace(part.labels, y=error).take(mask) for part, error, mask in zip(parts, errors, masks, strict=True)
    ]
    grid = z2_grid(vehicle, training[0].region)
    training = [labels.inside(grid) for labels in training]
    accepted = np.concatenate([labels.y[labels.accepted] for labels in training])
    if len(accepted) < _FEWEST_TO_LEARN:
        return None
    noise = np.mean([scatter_variance(labels) for labels in training], axis=0)
    trained = learn(training, vehicle=vehicle, grid=grid, kernel=default_kernel(grid, accepted, noise))
    return LearnedCorrection(make_predictor("bcm", trained), grid, np.ones(3))


def _trust_in_labels(parts, errors, folds, others: Sequence[LearnedCorrection | None]) -> np.ndarray:
    """Return the trust of each output, (3,): the share of predictions that minimises errors of left-out folds."""
    error, predicted, block = [], [], []
    for part, left, fold in zip(parts, errors, folds, strict=True):
        guess = np.zeros_like(left)
        for k, correction in enumerate(others):
            rows = (fold == k) & part.labels.accepted
            if correction is not None and rows.any():
                guess[rows] = correction.at(part.labels.z[rows], part.labels.row[rows])
        used = (fold >= 0) & part.labels.accepted
        error.append(left[used])
        predicted.append(guess[used])
        block.append(part.labels.t[used])
    number = blocks_of_time(block)
    e, p = np.concatenate(error), np.concatenate(predicted)
    share = np.clip(np.sum(e * p, axis=0) / np.maximum(np.sum(p * p, axis=0), 1e-300), 0.0, 1.0)
    saved = e**2 - (e - share * p) ** 2
    return np.where(in_standard_errors(saved, number) > _BEYOND_CHANCE, share, 0.0)


@dataclass(frozen=True)
class _LeftOut:
    """A correction that uses, at each sample, what was learned from the other quarters; for rollouts."""

    others: Sequence[LearnedCorrection | None]  # learned without each quarter
    fold: np.ndarray  # (N,): quarter of each sample, -1 in held-out time
    trust: np.ndarray  # (3,)

    def at(self, z: np.ndarray, rows: np.ndarray) -> np.ndarray:
        out = np.zeros((len(z), 3))
        for k, correction in enumerate(self.others):
            here = self.fold[rows] == k
            if correction is not None and here.any():
                out[here] = self.trust * correction.at(z[here], rows[here])
        return out


def _trust_by_rollouts(recordings, stages, parts, folds, others, trust: np.ndarray) -> np.ndarray:
    """Return the trust, reduced by `_SHARES` in each group of outputs until no rollout error of it grows."""
    of_rows = [
        _fold_of_rows(part, fold, len(one.series))
        for (one, _), part, fold in zip(recordings, parts, folds, strict=True)
    ]
    plain = [
        roll_out_stages(one, {"it": stage}, _inside(fold), most_starts=_STARTS)
        for (one, _), stage, fold in zip(recordings, stages, of_rows, strict=True)
    ]
    steps = np.zeros(3, dtype=int)
    while np.any(now := trust * np.array(_SHARES)[steps]):
        change, block = [], []
        for number, without in enumerate(plain):
            if without is None:
                continue
            (one, _), fold = recordings[number], of_rows[number]
            trusted = replace(stages[number], correction=_LeftOut(others, fold, now))
            errors = roll_out_stages(one, {"it": trusted}, _inside(fold), most_starts=_STARTS)
            change.append(errors.squared["it"] - without.squared["it"])
            block.append(errors.t // BLOCK_SECONDS + 1e6 * number)
        if not change:
            return np.zeros(3)
        horizons = min(one.shape[1] for one in change)
        more = np.concatenate([one[:, :horizons] for one in change])
        worse = np.any(in_standard_errors(more, np.concatenate(block)) > _BEYOND_CHANCE, axis=0)
        worse |= more[:, -1].sum(axis=0) > 0.0
        failing = [list(group) for group in _GROUPS if np.any(worse[list(group)]) and np.any(now[list(group)])]
        if not failing:
            # An error that grows in outputs without correction comes from the other group.
            return now * ~np.any(worse)
        for group in failing:
            steps[group] += 1
    return np.zeros(3)


def _fold_of_rows(part: LabelErrors, fold: np.ndarray, length: int) -> np.ndarray:
    """Return the fold of every sample, that of the last label before it; -1 in held-out time, shape (N,)."""
    last = np.searchsorted(part.labels.row, np.arange(length), side="right") - 1
    return np.where(last >= 0, fold[np.maximum(last, 0)], -1)


def _inside(fold: np.ndarray) -> np.ndarray:
    """Return which samples lie inside a fold, without one sample at each border, so that no rollout crosses it."""
    inside = fold >= 0
    inside[1:] &= fold[1:] == fold[:-1]
    return inside
