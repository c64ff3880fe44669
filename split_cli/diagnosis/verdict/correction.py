"""SPLIT on the remainder of a model: trained on training time, applied by its trust."""

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

_FEWEST_TO_LEARN = 100
_FOLDS = 4
_STARTS = 120  # of rollouts, a recording
_SHARES = (1.0, 0.5, 0.0)  # of the trust that labels earn; the largest is kept that rollouts bear
# Lateral velocity and yaw rate move together; what is said of one acts on the other within a tenth of a second.
_GROUPS = ((0,), (1, 2))
_BEYOND_CHANCE = 1.0  # standard errors of a difference, by blocks of time


def learn_correction(
    recordings: Sequence[tuple[Evidence, np.ndarray]],
    stages: Sequence[Stage],
    parts: Sequence[LabelErrors],
    errors: Sequence[np.ndarray],
) -> LearnedCorrection | None:
    """Learn what a model leaves, with the trust that it earned where it had not been learned.

    Parameters
    ----------
    recordings : sequence of (Evidence, ndarray of bool of shape (N,))
        Real recordings and which of their rows are held out; nothing is learned or judged there.
    stages : sequence of Stage
        The model, a recording each.
    errors : sequence of ndarray, shape (L, 3)
        Label errors of the model [m/s^2], [m/s^2], [rad/s^2].

    Returns
    -------
    Rest or None
        None where there are too few labels, or no output is to be trusted.

    Notes
    -----
    Each quarter of the training time is predicted from the three others. An output's trust is the share w of the
    prediction p that leaves least of the error e, sum(e p)/sum(p^2) between 0 and 1; it is 0 where that saves no
    more than chance. Rollouts over the same quarters then show what small steps cannot: a correction that makes a
    velocity drift. It is halved, and left away, while an error is larger than without it: at all at the longest
    horizon, beyond chance at any other.
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
    """Return label errors (L, 3) less what SPLIT predicts, where it claims to be valid and on held-out time."""
    left = error.copy()
    if correction is not None:
        use = part.held & part.labels.accepted
        left[use] -= correction.at(part.labels.z[use], part.labels.row[use])
    return left


def _folds(part: LabelErrors) -> np.ndarray:
    """Return the quarter of the training time that each label lies in, -1 for held-out ones, shape (L,)."""
    fold = np.full(len(part.held), -1)
    training = np.flatnonzero(~part.held)
    fold[training] = np.arange(len(training)) * _FOLDS // max(len(training), 1)
    return fold


def _learned(parts, errors, masks, vehicle) -> LearnedCorrection | None:
    """Learn SPLIT on labels of a choice; None for too few."""
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
    """Return the share of each output's prediction that leaves least of the errors of the fold left out."""
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
    """SPLIT at each row as learned from the other quarters of a recording; a `LearnedCorrection` for rollouts."""

    others: Sequence[LearnedCorrection | None]  # learned without each quarter
    fold: np.ndarray  # (N,): quarter of each row, -1 for held-out ones
    trust: np.ndarray  # (3,)

    def at(self, z: np.ndarray, rows: np.ndarray) -> np.ndarray:
        out = np.zeros((len(z), 3))
        for k, correction in enumerate(self.others):
            here = self.fold[rows] == k
            if correction is not None and here.any():
                out[here] = self.trust * correction.at(z[here], rows[here])
        return out


def _trust_by_rollouts(recordings, stages, parts, folds, others, trust: np.ndarray) -> np.ndarray:
    """Return the trust, less by `_SHARES` in every group until no rollout error of it grows beyond chance."""
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
            # What is worse in a channel that nothing acts on comes of the other group.
            return now * ~np.any(worse)
        for group in failing:
            steps[group] += 1
    return np.zeros(3)


def _fold_of_rows(part: LabelErrors, fold: np.ndarray, length: int) -> np.ndarray:
    """Return the fold of every row, that of the label before it; -1 in held-out time, shape (N,)."""
    last = np.searchsorted(part.labels.row, np.arange(length), side="right") - 1
    return np.where(last >= 0, fold[np.maximum(last, 0)], -1)


def _inside(fold: np.ndarray) -> np.ndarray:
    """Return a mask of the rows of the folds, one row at each border taken out so that no rollout crosses it."""
    inside = fold >= 0
    inside[1:] &= fold[1:] == fold[:-1]
    return inside
