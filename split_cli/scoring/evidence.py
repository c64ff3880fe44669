"""Evidence on a correction: its errors on held-out blocks, each predicted by a set trained on the other blocks.

Every held-out block is predicted over one step and rolled out; the errors are linear in the trust of the three
outputs, so what any trust would have done is known from four rollouts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from split_cli.learning.cells import extend
from split_cli.learning.labels import Labels, nominal_errors
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive import Drive
from split_cli.prediction import Predictor, make_predictor
from split_cli.scoring.application import correction_from, left_by_model, predict_rows
from split_cli.scoring.persistence import velocity_persistence_errors
from split_cli.scoring.rollouts import roll_out, rollout_starts
from split_cli.scoring.splits import with_guards
from split_cli.vehicle.single_track import SingleTrack

#: Horizons beyond one step at which trust is judged [s].
HORIZONS = (0.5, 1.0, 2.0)
_STATES = ("vx", "vy", "r")
#: A block shorter than this holds no two-second rollout with room to start from different places [s].
_SHORTEST_BLOCK = 4.0
#: Drives too short for five such blocks are cut into five shorter ones, down to this length [s]: 20 labels each.
_SHORTEST_OF_ALL = 1.0
_MOST_BLOCKS = 24
#: Fewer blocks are too few to judge how a correction does on other driving.
FEWEST_BLOCKS = 5
_FOLDS = 5
#: From this many drives on each is held out whole: two would leave a fold one drive to learn from.
WHOLE_DRIVES = 3
_GUARD = 1.0
_STARTS_A_BLOCK = 10
#: Rows of recordings that trust is found on at most; of more, drives are taken evenly.
MOST_ROWS = 400_000


def middle_rows(length: int, most: int) -> tuple[int, int]:
    """Return the first of at most `most` rows in the middle of a drive, and the row after their last."""
    first = max(0, (length - most) // 2)
    return first, min(length, first + most)


@dataclass(frozen=True)
class TrainingDrive:
    """A drive that trains: the recording, and its labels that may be learned."""

    drive: Drive
    labels: Labels

    def middle(self, most: int) -> TrainingDrive:
        """Return the `most` rows in the middle of a longer drive, with their labels."""
        if len(self.drive) <= most:
            return self
        first, last = middle_rows(len(self.drive), most)
        return TrainingDrive(self.drive.stretch(first, last), self.labels.between(first, last))


@dataclass(frozen=True)
class TrustEvidence:
    """Errors of held-out predictions of one state at one horizon."""

    state: int  # 0, 1, 2: v_x, v_y, r
    horizon: float  # [s]; 0 stands for one step, in label units
    error: np.ndarray  # (N,): recorded less predicted by the set's vehicle without correction
    change: np.ndarray  # (N, 3): what the correction of each output alone adds to the nominal prediction
    movement: np.ndarray  # (N,): by how much the recorded state changes within the horizon, in the unit of `error`
    block: np.ndarray  # (N,)
    conditions: np.ndarray  # (N, C): what the car was doing: see `_conditions`
    variance: np.ndarray | None = None  # (N,): the process's latent variance; for one step
    # (N, K): signals outside the features that may be what the correction stands in for: see `_rivals`; for one
    # step.
    rivals: np.ndarray | None = None
    # (N,): recorded less predicted by the vehicle file, where the set's vehicle holds effects beyond it; else
    # `error`.
    nominal: np.ndarray | None = None

    @property
    def file_error(self) -> np.ndarray:
        """Recorded less predicted by the vehicle file, shape (N,)."""
        return self.error if self.nominal is None else self.nominal


@dataclass(frozen=True)
class _HeldOut:
    """What one drive is judged by in one fold."""

    part: TrainingDrive
    test: np.ndarray  # bool (rows,): rows held out
    block: np.ndarray  # (rows,): the block of each row, -1 outside
    z: np.ndarray  # (rows, D): features
    at: np.ndarray  # (rows, C): conditions
    learned: Predictor  # from the other blocks
    model: SingleTrack  # the nominal model, with the effects that the set found
    of_file: SingleTrack | None  # the same without them, where there are any


def held_out_evidence(
    drives: Sequence[TrainingDrive],
    empty: TrainingSet,
    predictor: str = "rbcm",
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[tuple[TrustEvidence, ...], int]:
    """Return errors of held-out predictions by state and horizon, and the number of blocks they are from.

    Notes
    -----
    Of three drives or more each is held out whole, in at most five groups: what differs from drive to drive (load,
    road, driver, sensor offsets) is then in the errors. Of fewer, every fifth block is held out in turn, and the
    errors are those of the same drive at another time. Drives too short for a block do not count.
    """
    drives = _spread(drives)
    numbered = _number_blocks(drives)
    folds = _folds_of(numbered)
    total = 1 + max((int(block.max(initial=-1)) for block in numbered), default=-1)
    if total < FEWEST_BLOCKS:
        return (), total
    models = SingleTrack(empty.vehicle), SingleTrack(empty.nominal_vehicle) if empty.found_effects else None
    model = models[0]
    features = [empty.features.compute(model, part.drive) for part in drives]
    conditions = [_conditions(part.drive, number, model) for number, part in enumerate(drives)]
    parts: list[TrustEvidence] = []
    for fold in range(_FOLDS):
        progress(f"judging the correction on held-out blocks, fold {fold + 1} of {_FOLDS}")
        tests = [its == fold for its in folds]
        if not any(test.any() for test in tests):
            continue
        near = [with_guards(test, int(np.ceil(_GUARD / p.drive.period))) for p, test in zip(drives, tests, strict=True)]
        kept = [p.labels.within(~its) for p, its in zip(drives, near, strict=True)]
        if not sum(int(labels.accepted.sum()) for labels in kept):
            continue
        learned = make_predictor(predictor, extend(empty, [labels for labels in kept if len(labels)]))
        for part, test, block, z, at in zip(drives, tests, numbered, features, conditions, strict=True):
            if test.any():
                held = _HeldOut(part, test, block, z, at, learned, *models)
                parts += _one_step(held) + _rolled_out(held)
    seen = {int(b) for part in parts for b in np.unique(part.block)}
    return tuple(_joined(parts)), len(seen)


def _spread(drives: Sequence[TrainingDrive]) -> list[TrainingDrive]:
    """Return drives of at most `MOST_ROWS` rows together, taken evenly; of a longer one its middle."""
    rows = sum(len(part.drive) for part in drives)
    chosen = list(drives)[:: max(1, -(-rows // MOST_ROWS))] if rows > MOST_ROWS else list(drives)
    return [part if len(part.drive) <= MOST_ROWS else part.middle(MOST_ROWS // len(chosen)) for part in chosen]


def _number_blocks(drives: Sequence[TrainingDrive]) -> list[np.ndarray]:
    """Return the block of every row that may be learned, -1 elsewhere; equally long over all drives."""
    spans = []
    for part in drives:
        usable = np.zeros(len(part.drive), dtype=bool)
        usable[part.labels.row] = True
        first, last = (part.labels.row[0], part.labels.row[-1]) if len(part.labels) else (0, -1)
        spans.append((int(first), int(last) + 1))
    seconds = [(last - first) * part.drive.period for (first, last), part in zip(spans, drives, strict=True)]
    length = max(_SHORTEST_BLOCK, sum(seconds) / _MOST_BLOCKS)
    if sum(seconds) < FEWEST_BLOCKS * length:
        length = max(_SHORTEST_OF_ALL, sum(seconds) / FEWEST_BLOCKS)
    numbered, number = [], 0
    for (first, last), span, part in zip(spans, seconds, drives, strict=True):
        count = int(span / length + 0.5) if span >= 0.5 * length else 0
        block = np.full(len(part.drive), -1)
        if count:
            block[first:last] = number + np.arange(last - first) * count // (last - first)
        numbered.append(block)
        number += count
    return numbered


def held_out_whole(drives: Sequence[TrainingDrive]) -> int:
    """Return how many drives `held_out_evidence` holds out whole; 0 where it holds out blocks of time."""
    judged = sum(bool((block >= 0).any()) for block in _number_blocks(_spread(drives)))
    return judged if judged >= WHOLE_DRIVES else 0


def _folds_of(numbered: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the fold in which each row is held out, -1 for none; drives too short for a block only teach."""
    judged = [number for number, block in enumerate(numbered) if (block >= 0).any()]
    if len(judged) < WHOLE_DRIVES:
        return [np.where(block >= 0, block % _FOLDS, -1) for block in numbered]
    fold_of = {number: rank % _FOLDS for rank, number in enumerate(judged)}
    return [np.where(block >= 0, fold_of.get(number, -1), -1) for number, block in enumerate(numbered)]


def _conditions(drive: Drive, number: int, model: SingleTrack) -> np.ndarray:
    """Return the conditions of every row, shape (rows, 7); means over an interval are taken by the caller.

    No state may be made worse in any of them: rate of torque, rate of steer angle, speed, lateral acceleration,
    torque, time, drive. Features need not determine them, so a correction can be right on average and wrong in a
    part of the driving.
    """

    def rate(name: str) -> np.ndarray:
        change: np.ndarray = np.abs(np.diff(drive[name], append=drive[name][-1])) / drive.period
        change[np.append(np.diff(drive.segment) != 0, True)] = 0.0
        return change

    columns = [
        rate("T"),
        rate("delta"),
        drive["vx"],
        np.abs(drive["vx"] * drive["r"]),
        drive["T"],
        drive["t"],
        np.full(len(drive), float(number)),
    ]
    conditions: np.ndarray = np.nan_to_num(np.stack(columns, axis=1))
    return conditions


def _means(values: np.ndarray, first: np.ndarray, length: int) -> np.ndarray:
    """Return the means of columns over `length` rows from each of `first`, shape (N, C)."""
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    means: np.ndarray = (sums[first + length] - sums[first]) / length
    return means


def _one_step(held: _HeldOut) -> list[TrustEvidence]:
    """Return errors of one step from every held-out row that has a finite label."""
    drive, of_file = held.part.drive, held.of_file
    labels = held.part.labels.within(held.test)
    labels = labels.take(np.isfinite(labels.y).all(axis=1))
    if not len(labels):
        return []
    predicted = predict_rows(held.learned, drive, held.z, labels.row)
    left = left_by_model(held.learned, drive, held.z, labels)
    movement = velocity_persistence_errors(held.model, drive, labels)
    situation, rivals = _means(held.at, labels.row, labels.window), _rivals(drive, labels)
    nominal = None
    if of_file is not None:
        nominal = nominal_errors(of_file, drive, labels.row, labels.window, plain=labels.plain)
    found = []
    for state in range(3):
        change = np.zeros((len(labels), 3))
        change[:, state] = predicted.mean[:, state]
        error, moved = left[:, state], movement[:, state]
        block, by_file = held.block[labels.row], None if nominal is None else nominal[:, state]
        variance = predicted.variance[:, state]
        found.append(TrustEvidence(state, 0.0, error, change, moved, block, situation, variance, rivals, by_file))
    return found


def _rivals(drive: Drive, labels: Labels) -> np.ndarray:
    """Return signals that no slip and no torque hold, shape (N, 8).

    Changes of T and delta over the label's interval and over the two before it, within the segment: what a late
    actuator, a lag or a relaxation makes of them. Then v_x and v_x^2: what is wrong in drag or in speed.
    """
    window, change = labels.window, np.flatnonzero(np.diff(drive.segment)) + 1
    first = np.concatenate([[0], change])[np.searchsorted(change, labels.row, side="right")]
    edges = [np.maximum(labels.row - back * window, first) for back in (-1, 0, 1, 2)]
    edges[0] = np.minimum(labels.row + window, len(drive) - 1)
    columns = [drive[name][late] - drive[name][early] for name in ("T", "delta") for late, early in pairwise(edges)]
    speed = drive["vx"][labels.row]
    rivals: np.ndarray = np.nan_to_num(np.stack([*columns, speed, speed**2], axis=1))
    return rivals


def _rolled_out(held: _HeldOut) -> list[TrustEvidence]:
    """Return errors of rollouts that stay on held-out rows, as long as those allow; by the block they begin in."""
    drive, labels, of_file = held.part.drive, held.part.labels, held.of_file
    window, speed = labels.window, labels.region.minimum_speed
    found: list[TrustEvidence] = []
    for horizon in HORIZONS[::-1]:
        if any(part.horizon >= horizon for part in found):
            continue  # read off the longer rollouts
        steps = max(1, round(horizon / labels.horizon))
        most = _STARTS_A_BLOCK * max(1, len(np.unique(held.block[held.test])))
        starts = rollout_starts(drive, held.test, steps * window, speed, most)
        if len(starts) < FEWEST_BLOCKS:
            continue
        rolled = _with_each_output(held, starts, steps)
        nominal = rolled[0]
        by_file = nominal if of_file is None else roll_out(of_file, drive, starts, steps, window)[..., -3:]
        change = np.stack([corrected - nominal for corrected in rolled[1:]], axis=-1)
        for asked in [h for h in HORIZONS if h <= horizon]:
            step = max(1, round(asked / labels.horizon)) - 1
            rows = starts + (step + 1) * window
            begin, end = (np.stack([drive[name][at_rows] for name in _STATES], axis=1) for at_rows in (starts, rows))
            error = end - nominal[:, step]
            file_error = end - by_file[:, step]
            good = np.isfinite(error + file_error).all(axis=1) & np.isfinite(change[:, step]).all(axis=(1, 2))
            situation = _means(held.at, starts, (step + 1) * window)
            found += [
                TrustEvidence(
                    s,
                    asked,
                    error[good, s],
                    change[good, step, s],
                    (end - begin)[good, s],
                    held.block[starts[good]],
                    situation[good],
                    nominal=None if of_file is None else file_error[good, s],
                )
                for s in range(3)
            ]
    return found


def _with_each_output(held: _HeldOut, starts: np.ndarray, steps: int) -> np.ndarray:
    """Return rollouts of the nominal model and of it with each output's correction alone, (4, N, steps, 3)."""
    applied = np.repeat(np.concatenate([np.zeros((1, 3)), np.eye(3)]), len(starts), axis=0)
    every = np.tile(starts, 4)
    drive = held.part.drive
    whole = correction_from(held.learned, drive, held.z, every)
    correction = replace(whole, residual=lambda q: applied * whole.residual(q))
    rolled = roll_out(held.model, drive, every, steps, held.part.labels.window, correction)[..., -3:]
    return rolled.reshape(4, len(starts), steps, 3)


def _joined(parts: Sequence[TrustEvidence]) -> list[TrustEvidence]:
    keys = dict.fromkeys((part.state, part.horizon) for part in parts)
    joined = []
    for key in keys:
        same = [part for part in parts if (part.state, part.horizon) == key]
        columns = (
            np.concatenate([getattr(p, name) for p in same])
            for name in ("error", "change", "movement", "block", "conditions")
        )
        one_step = (
            [getattr(p, name) for p in same if getattr(p, name) is not None]
            for name in ("variance", "rivals", "nominal")
        )
        joined.append(TrustEvidence(*key, *columns, *(np.concatenate(v) if v else None for v in one_step)))
    return joined
