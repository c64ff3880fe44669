"""Trust found on held-out driving: whole blocks of time that a set learned on the other blocks has not seen.

Every held-out block is predicted over one step and rolled out; the errors are linear in the trust of the three
outputs, so what any trust would have done is known from four rollouts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, t

from split_cli.learning.cells import extend
from split_cli.learning.labels import Labels
from split_cli.learning.training_set import TrainingSet
from split_cli.learning.trust import Trust
from split_cli.logs.drive import Drive
from split_cli.prediction import Predictor, make_predictor
from split_cli.scoring.application import correction_from, predict_rows
from split_cli.scoring.persistence import velocity_persistence_errors
from split_cli.scoring.rollouts import Correction, roll_out, rollout_starts
from split_cli.vehicle.single_track import SingleTrack

__all__ = [
    "HORIZONS",
    "MOST_ROWS",
    "TrainingDrive",
    "TrustEvidence",
    "estimate_trust",
    "held_out_evidence",
    "trust_from",
]

#: Horizons beyond one step at which trust is judged [s].
HORIZONS = (0.5, 1.0, 2.0)
_STATES = ("vx", "vy", "r")
#: A block shorter than this holds no two-second rollout with room to start from different places [s].
_SHORTEST_BLOCK = 4.0
_MOST_BLOCKS = 24
_FEWEST_BLOCKS = 5
_FOLDS = 5
_GUARD = 1.0
_STARTS_A_BLOCK = 10
#: One-sided level of 95 %: a gain within chance is not believed. Of Student's t with many blocks; with few blocks
#: the quantile of their own degrees of freedom is taken.
_LEVEL = 0.95
#: Increase of a mean squared error that counts as none: 1 % of its root over all driving, 5 % in a third of it.
#: docs/decisions/0030 shows how little hangs on them.
_NEGLIGIBLE = 0.02
_NEGLIGIBLE_IN_A_THIRD = 0.10
#: Errors below this share of how far the state moves count as none: 1 cm/s where the speed changes by 1 m/s.
_NEGLIGIBLE_MOVEMENT = 0.01
#: Rows of recordings that trust is found on at most; of more, drives are taken evenly.
MOST_ROWS = 400_000
_LEVELS_OF_INTERVALS = (0.5, 0.9, 0.95)
_GRID = np.linspace(0.0, 1.0, 21)


@dataclass(frozen=True)
class TrainingDrive:
    """A drive that trains: the recording, and its labels that may be learned."""

    drive: Drive
    labels: Labels


@dataclass(frozen=True)
class TrustEvidence:
    """Errors of held-out predictions of one state at one horizon.

    Attributes
    ----------
    state : int
        0, 1, 2: v_x, v_y, r.
    horizon : float
        [s]; 0 stands for one step, in label units.
    error : ndarray, shape (N,)
        Recorded less nominal.
    change : ndarray, shape (N, 3)
        What the correction of each output alone adds to the nominal prediction.
    movement : ndarray, shape (N,)
        By how much the recorded state changes within the horizon, in the unit of `error`.
    block : ndarray of int, shape (N,)
    conditions : ndarray, shape (N, C)
        What the car was doing: see `_CONDITIONS`.
    variance : ndarray, shape (N,), or None
        The process's latent variance; for one step.
    """

    state: int
    horizon: float
    error: np.ndarray
    change: np.ndarray
    movement: np.ndarray
    block: np.ndarray
    conditions: np.ndarray
    variance: np.ndarray | None = None


#: Conditions no state may be made worse in: features need not tell them, so a correction can be right on average
#: and wrong in a part of the driving. Means over the interval predicted.
_CONDITIONS = ("torque rate", "steer rate", "speed", "lateral acceleration", "torque", "time", "drive")


def estimate_trust(
    drives: Sequence[TrainingDrive],
    empty: TrainingSet,
    predictor: str = "bcm",
    say: Callable[[str], None] = lambda text: None,
) -> Trust:
    """Return the trust of each output, found on held-out blocks of the drives.

    Parameters
    ----------
    drives : sequence of TrainingDrive
    empty : TrainingSet
        Without points: its settings and kernel are those of the set that is trained on everything.
    predictor : str
    say : callable
        Told what is being done.

    Returns
    -------
    Trust
        ``unjudged`` and full when the drives are too short for five blocks.
    """
    evidence, blocks = held_out_evidence(drives, empty, predictor, say)
    if blocks < _FEWEST_BLOCKS:
        return Trust((1.0, 1.0, 1.0), "unjudged", blocks)
    share = trust_from(evidence)
    doubt = doubt_from(evidence, share, empty.kernel.noise_variance)
    return Trust(tuple(share.tolist()), "held-out", blocks, tuple(doubt.tolist()))


def held_out_evidence(
    drives: Sequence[TrainingDrive],
    empty: TrainingSet,
    predictor: str = "bcm",
    say: Callable[[str], None] = lambda text: None,
) -> tuple[tuple[TrustEvidence, ...], int]:
    """Return errors of held-out predictions by state and horizon, and the number of blocks they are from."""
    drives = _spread(drives)
    numbered = _number_blocks(drives)
    total = 1 + max((int(block.max(initial=-1)) for block in numbered), default=-1)
    if total < _FEWEST_BLOCKS:
        return (), total
    model = SingleTrack(empty.vehicle)
    features = [empty.features.compute(model, part.drive) for part in drives]
    conditions = [_conditions(part.drive, number, model) for number, part in enumerate(drives)]
    parts: list[TrustEvidence] = []
    for fold in range(_FOLDS):
        say(f"judging the correction on held-out blocks, fold {fold + 1} of {_FOLDS}")
        tests = [(block >= 0) & (block % _FOLDS == fold) for block in numbered]
        kept = [p.labels.within(~_widen(test, p.drive)) for p, test in zip(drives, tests, strict=True)]
        if not sum(int(labels.accepted.sum()) for labels in kept):
            continue
        learned = make_predictor(predictor, extend(empty, [labels for labels in kept if len(labels)]))
        for part, test, block, z, at in zip(drives, tests, numbered, features, conditions, strict=True):
            if test.any():
                parts += _one_step(part, test, block, z, at, learned, model)
                parts += _rolled_out(part, test, block, z, at, learned, model)
    seen = {int(b) for part in parts for b in np.unique(part.block)}
    return tuple(_joined(parts)), len(seen)


def _spread(drives: Sequence[TrainingDrive]) -> list[TrainingDrive]:
    """Return drives of at most `MOST_ROWS` rows together, taken evenly; of a longer one its middle."""
    rows = sum(len(part.drive) for part in drives)
    chosen = list(drives)[:: max(1, -(-rows // MOST_ROWS))] if rows > MOST_ROWS else list(drives)
    cut = []
    for part in chosen:
        length, most = len(part.drive), MOST_ROWS // len(chosen)
        middle = np.zeros(length, dtype=bool)
        first = max(0, (length - most) // 2)
        middle[first : first + most] = True
        cut.append(part if length <= MOST_ROWS else TrainingDrive(part.drive, part.labels.within(middle)))
    return cut


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
    numbered, number = [], 0
    for (first, last), span, part in zip(spans, seconds, drives, strict=True):
        count = int(span / length + 0.5) if span >= 0.5 * length else 0
        block = np.full(len(part.drive), -1)
        if count:
            block[first:last] = number + np.arange(last - first) * count // (last - first)
        numbered.append(block)
        number += count
    return numbered


def _widen(test: np.ndarray, drive: Drive) -> np.ndarray:
    """Return the rows of held-out blocks and of the guards beside them."""
    margin = int(np.ceil(_GUARD / drive.period))
    edges = np.concatenate([[0], np.cumsum(test)])
    rows = np.arange(len(test))
    return edges[np.minimum(rows + margin + 1, len(test))] > edges[np.maximum(rows - margin, 0)]


def _conditions(drive: Drive, number: int, model: SingleTrack) -> np.ndarray:
    """Return the conditions of every row, shape (rows, C); means over an interval are taken by the caller."""

    def rate(name: str) -> np.ndarray:
        change = np.abs(np.diff(drive[name], append=drive[name][-1])) / drive.period
        change[np.append(np.diff(drive.segment) != 0, True)] = 0.0
        return change

    columns = [
        rate("T"), rate("delta"), drive["vx"], np.abs(drive["vx"] * drive["r"]), drive["T"], drive["t"],
        np.full(len(drive), float(number)),
    ]  # fmt: skip
    return np.nan_to_num(np.stack(columns, axis=1))


def _means(values: np.ndarray, first: np.ndarray, length: int) -> np.ndarray:
    """Return the means of columns over `length` rows from each of `first`, shape (N, C)."""
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    return (sums[first + length] - sums[first]) / length


def _one_step(
    part: TrainingDrive,
    test: np.ndarray,
    block: np.ndarray,
    z: np.ndarray,
    at: np.ndarray,
    learned: Predictor,
    model: SingleTrack,
) -> list[TrustEvidence]:
    labels = part.labels.within(test)
    labels = labels.take(np.isfinite(labels.y).all(axis=1))
    if not len(labels):
        return []
    told = predict_rows(learned, part.drive, z, labels.row)
    movement = velocity_persistence_errors(model, part.drive, labels)
    situation = _means(at, labels.row, labels.window)
    found = []
    for state in range(3):
        change = np.zeros((len(labels), 3))
        change[:, state] = told.mean[:, state]
        error, moved = labels.y[:, state], movement[:, state]
        rest = (block[labels.row], situation, told.variance[:, state])
        found.append(TrustEvidence(state, 0.0, error, change, moved, *rest))
    return found


def _rolled_out(
    part: TrainingDrive,
    test: np.ndarray,
    block: np.ndarray,
    z: np.ndarray,
    at: np.ndarray,
    learned: Predictor,
    model: SingleTrack,
) -> list[TrustEvidence]:
    """Return errors of rollouts that stay inside one held-out block, as long as blocks allow."""
    drive, labels = part.drive, part.labels
    window, speed = labels.window, labels.region.minimum_speed
    found: list[TrustEvidence] = []
    for horizon in HORIZONS[::-1]:
        if any(part.horizon >= horizon for part in found):
            continue  # read off the longer rollouts
        steps = max(1, round(horizon / labels.horizon))
        most = _STARTS_A_BLOCK * max(1, len(np.unique(block[test])))
        # Neighbouring blocks of one fold never touch, so a run of test rows is one block.
        starts = rollout_starts(drive, test, steps * window, speed, most)
        if len(starts) < _FEWEST_BLOCKS:
            continue
        rolled = _with_each_output(model, drive, starts, steps, labels, z, learned)
        nominal = rolled[0]
        change = np.stack([corrected - nominal for corrected in rolled[1:]], axis=-1)
        for asked in [h for h in HORIZONS if h <= horizon]:
            step = max(1, round(asked / labels.horizon)) - 1
            rows = starts + (step + 1) * window
            begin, end = (
                np.stack([drive[name][at_rows] for name in _STATES], axis=1) for at_rows in (starts, rows)
            )
            error = end - nominal[:, step]
            good = np.isfinite(error).all(axis=1) & np.isfinite(change[:, step]).all(axis=(1, 2))
            situation = _means(at, starts, (step + 1) * window)
            found += [
                TrustEvidence(
                    s,
                    asked,
                    error[good, s],
                    change[good, step, s],
                    (end - begin)[good, s],
                    block[starts[good]],
                    situation[good],
                )
                for s in range(3)
            ]
    return found


def _with_each_output(
    model: SingleTrack,
    drive: Drive,
    starts: np.ndarray,
    steps: int,
    labels: Labels,
    z: np.ndarray,
    learned: Predictor,
) -> np.ndarray:
    """Return rollouts of the nominal model and of it with each output's correction alone, (4, N, steps, 3)."""
    applied = np.repeat(np.concatenate([np.zeros((1, 3)), np.eye(3)]), len(starts), axis=0)
    every = np.tile(starts, 4)
    residual = correction_from(learned, drive, z, every)
    correction = Correction(labels.features, z, lambda q: applied * residual(q))
    rolled = roll_out(model, drive, every, steps, labels.window, correction)[..., -3:]
    return rolled.reshape(4, len(starts), steps, 3)


def _joined(parts: Sequence[TrustEvidence]) -> list[TrustEvidence]:
    keys = dict.fromkeys((part.state, part.horizon) for part in parts)
    joined = []
    for key in keys:
        same = [part for part in parts if (part.state, part.horizon) == key]
        columns = (np.concatenate([getattr(p, name) for p in same]) for name in
                   ("error", "change", "movement", "block", "conditions"))  # fmt: skip
        variance = [p.variance for p in same if p.variance is not None]
        joined.append(TrustEvidence(*key, *columns, np.concatenate(variance) if variance else None))
    return joined


def trust_from(evidence: Sequence[TrustEvidence]) -> np.ndarray:
    """Return the trust of each output that the evidence supports, shape (3,).

    Notes
    -----
    With nominal error e and changes d of the three outputs, trust tau changes the squared error by
    -2 tau.(e d) + tau.(d d^T) tau. Of all trusts on a grid of 0.05, those are left out that make any state at any
    horizon worse, as a whole or in a third of the driving by torque rate, steer rate, speed, lateral acceleration,
    torque, time or drive, beyond what is negligible and beyond one standard error over blocks there. Of the rest
    the one is taken whose gain, as a share of the nominal error and less the uncertainty of its mean over blocks
    (95 %, one-sided), is largest in sum over states and horizons. No trust gains nothing: where the data show no
    gain beyond chance it is taken.
    """
    shares = np.stack(np.meshgrid(_GRID, _GRID, _GRID, indexing="ij"), axis=-1).reshape(-1, 3)
    gain = np.zeros(len(shares))
    for part in evidence:
        everything = np.ones(len(part.error), dtype=bool)
        base, unnoticed = _sizes(part, everything)
        if base + unnoticed > 0.0:
            worse, error = _increase(part, everything, shares)
            gain -= (worse + _quantile(len(np.unique(part.block))) * error) / (base + unnoticed)
            gain[worse > _NEGLIGIBLE * base + unnoticed] = -np.inf
    # Trust of nothing gains nothing and is always allowed; what gains less need not be looked at.
    kept = np.flatnonzero(gain >= 0.0)
    shares, gain = shares[kept], gain[kept]
    for part in evidence:
        for inside in _thirds(part.conditions):
            base, unnoticed = _sizes(part, inside)
            worse, error = _increase(part, inside, shares)
            allowed = worse <= _NEGLIGIBLE_IN_A_THIRD * base + unnoticed + error
            shares, gain = shares[allowed], gain[allowed]
    return shares[int(np.argmax(gain))]


def doubt_from(evidence: Sequence[TrustEvidence], share: np.ndarray, noise_variance: np.ndarray) -> np.ndarray:
    """Return the variance of what remains wrong beyond the process's and the label noise, shape (3,).

    Parameters
    ----------
    evidence : sequence of TrustEvidence
    share : ndarray, shape (3,)
        Trust of each output.
    noise_variance : ndarray, shape (3,)
        Label noise of the kernel.

    Notes
    -----
    Of a range of variances the one is taken with which 50, 90 and 95 % intervals of held-out labels hold shares
    closest to these, in squares. Labels of whole blocks that training has not seen count, so what differs between
    stretches of driving is in it.
    """
    doubt = np.zeros(3)
    for part in evidence:
        if part.horizon or part.variance is None or not len(part.error):
            continue
        tau, noise = share[part.state], noise_variance[part.state]
        squared = np.square(part.error - part.change @ share)
        known = tau**2 * part.variance + noise
        tried = float(np.mean(squared) + np.mean(known)) * np.append(0.0, np.geomspace(1e-4, 4.0, 80))
        missed = np.zeros(len(tried))
        for level in _LEVELS_OF_INTERVALS:
            # A label is inside its interval of this level from this variance on.
            needed = np.sort(squared / norm.ppf(0.5 + 0.5 * level) ** 2 - known)
            missed += np.square(np.searchsorted(needed, tried, side="right") / len(needed) - level)
        doubt[part.state] = tried[int(np.argmin(missed))]
    return doubt


def _sizes(part: TrustEvidence, inside: np.ndarray) -> tuple[float, float]:
    """Return the nominal sum of squared errors, and the sum of squares that nobody would notice."""
    moved = _NEGLIGIBLE_MOVEMENT * part.movement[inside]
    return float(np.square(part.error[inside]).sum()), float(np.square(moved).sum())


def _increase(part: TrustEvidence, inside: np.ndarray, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how the sum of squares changes for every trust, and the standard error of that over blocks."""
    terms = np.concatenate([-2.0 * shares, *(shares[:, i, None] * shares for i in range(3))], axis=1)
    numbers, member = np.unique(part.block[inside], return_inverse=True)
    error, change = part.error[inside], part.change[inside]
    products = np.concatenate([error[:, None] * change, *(change[:, i, None] * change for i in range(3))], axis=1)
    sums = np.zeros((len(numbers), products.shape[1]))
    np.add.at(sums, member, products)
    by_block = terms @ sums.T
    total, count = by_block.sum(axis=1), len(numbers)
    spread = by_block - by_block.mean(axis=1, keepdims=True)
    return total, np.sqrt(count / max(count - 1, 1) * np.square(spread).sum(axis=1))


def _quantile(blocks: int) -> float:
    return float(t.ppf(_LEVEL, max(blocks - 1, 1)))


def _thirds(conditions: np.ndarray) -> list[np.ndarray]:
    """Return masks of the lowest, middle and highest third of each condition, and of each drive."""
    masks = []
    for column in conditions.T[:-1]:
        low, high = np.quantile(column, [1 / 3, 2 / 3])
        masks += [column <= low, (column > low) & (column <= high), column > high]
    masks += [conditions[:, -1] == number for number in np.unique(conditions[:, -1])]
    fewest = max(20, len(conditions) // 20)
    return [mask for mask in masks if fewest <= mask.sum() < len(mask)]
