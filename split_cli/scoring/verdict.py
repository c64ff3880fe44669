"""A verdict in words: is the corrected model better than the nominal one and than persistence, beyond chance?"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.learning.labels import Labels
from split_cli.learning.trust import STATES
from split_cli.scoring.evaluation import NOMINAL, VELOCITY_PERSISTENCE, HeldOutSamples
from split_cli.scoring.persistence import velocity_persistence_errors
from split_cli.scoring.trust import NEGLIGIBLE
from split_cli.vehicle.single_track import SingleTrack

#: Shortest block of time whose errors count as independent of the next one's [s]: twice the longest rollout.
_BLOCK_SECONDS = 4.0
_MOST_BLOCKS = 40
_RESAMPLES = 2000
_INTERVAL = (2.5, 97.5)
_FEWEST_BLOCKS = 4
#: Error of velocities held, as a multiple of which a model runs away [1]. Judgement: a model of the car's motion may be
#: behind velocities held where a state hardly changes, by an offset; not by twice the error, and growing.
_RUNS_AWAY = 2.0
VISIBLE = 5e-4
"""Of the ratio to the nominal error, from which on a change is reported [1]; judgement: below, three decimals read
1.000. Where the trust is small, a change of 0.003 % may be beyond chance, and means nothing."""


@dataclass(frozen=True)
class BlockErrors:
    """Errors of three models on the same samples of one horizon."""

    horizon: float  # [s]; 0 is one step, in label units
    # corrected, nominal, held: (N, 3): errors of v_x, v_y, r; `held` is persistence: velocities as they were.
    corrected: np.ndarray
    nominal: np.ndarray
    held: np.ndarray
    block: np.ndarray  # (N,): block of time of each sample; numbers of different drives differ


@dataclass(frozen=True)
class Comparison:
    """The corrected model beside the nominal one and persistence, one state at one horizon."""

    # name, features: predictor and features of the correction.
    name: str
    features: str
    state: str  # {"v_x", "v_y", "r"}
    horizon: float  # [s]; 0 is one step, in label units
    blocks: int  # blocks of time that were resampled
    # corrected, nominal, held: root mean square errors.
    corrected: float
    nominal: float
    held: float
    # to_nominal, to_held: corrected over the other: the ratio, and the ends of its 95 % interval (block
    # bootstrap); NaN with fewer than four blocks.
    to_nominal: tuple[float, float, float]
    to_held: tuple[float, float, float]

    @property
    def is_better(self) -> bool:
        """Whether the error is smaller than the nominal one, beyond chance and by what can be seen."""
        ratio, _, high = self.to_nominal
        return high < 1.0 and 1.0 - ratio >= VISIBLE

    @property
    def is_worse(self) -> bool:
        """Whether the error is larger than the nominal one, beyond chance and by what can be seen."""
        return _is_larger(self.to_nominal)

    @property
    def when(self) -> str:
        """The horizon in words."""
        return f"after {self.horizon:g} s" if self.horizon else "over one step"


def _is_larger(compared: tuple[float, float, float]) -> bool:
    ratio, low, _ = compared
    return low > 1.0 and ratio - 1.0 >= VISIBLE


def number_blocks(time: np.ndarray, segment: np.ndarray, first: int = 0) -> np.ndarray:
    """Return the block of every row of a drive: equal stretches of at least 4 s, at most 40, from `first` on.

    Parameters
    ----------
    time : ndarray, shape (N,)
        [s]
    segment : ndarray of int, shape (N,)
    first : int
        Number of the first block.
    """
    driven = np.concatenate([[0.0], np.cumsum(np.where(np.diff(segment) == 0, np.diff(time), 0.0))])
    length = max(_BLOCK_SECONDS, driven[-1] / _MOST_BLOCKS)
    count = max(1, int(driven[-1] / length))
    block: np.ndarray = first + np.minimum((driven / max(driven[-1], 1e-9) * count).astype(np.int64), count - 1)
    return block


def comparisons_of(name: str, features: str, parts: Sequence[BlockErrors], seed: int = 0) -> tuple[Comparison, ...]:
    """Return the comparisons of all states at all horizons.

    Parameters
    ----------
    parts : sequence of BlockErrors
        Of any number of drives; those of one horizon are pooled by squares.
    seed : int
        Of the bootstrap.

    Notes
    -----
    Whole blocks are drawn with replacement, 2,000 times; the same draw serves the three models, so that what they
    have in common cancels in the ratio (Kuensch, The jackknife and the bootstrap for general stationary
    observations, Annals of Statistics 17(3), 1989, with blocks that do not overlap).
    """
    found = []
    for horizon in dict.fromkeys(part.horizon for part in parts):
        same = [part for part in parts if part.horizon == horizon and len(part.block)]
        if not same:
            continue
        columns = [np.concatenate([getattr(p, n) for p in same]) for n in ("corrected", "nominal", "held")]
        block = np.concatenate([p.block for p in same])
        finite = np.isfinite(np.stack(columns)).all(axis=(0, 2))
        if not finite.any():
            continue
        numbers, member = np.unique(block[finite], return_inverse=True)
        sums = np.zeros((3, len(numbers), 3))
        for total, errors in zip(sums, columns, strict=True):
            np.add.at(total, member, np.square(errors[finite]))
        drawn = np.random.default_rng(seed).multinomial(
            len(numbers), np.full(len(numbers), 1.0 / len(numbers)), _RESAMPLES
        )
        resampled = np.sqrt(np.einsum("rb,mbs->mrs", drawn, sums))
        rmse = np.sqrt(sums.sum(axis=1) / finite.sum())
        for state, label in enumerate(STATES):
            ratios = [
                _ratio(rmse[0, state], rmse[other, state], resampled[0, :, state], resampled[other, :, state])
                if len(numbers) >= _FEWEST_BLOCKS
                else (_divide(rmse[0, state], rmse[other, state]), float("nan"), float("nan"))
                for other in (1, 2)
            ]
            ours, of_file, of_held = (float(value) for value in rmse[:, state])
            found.append(Comparison(name, features, label, horizon, len(numbers), ours, of_file, of_held, *ratios))
    return tuple(found)


def _divide(above: float, below: float) -> float:
    return float(above / below) if below > 0.0 else float("nan")


def _ratio(ours: float, theirs: float, ours_drawn: np.ndarray, theirs_drawn: np.ndarray) -> tuple[float, float, float]:
    """Return the ratio and the ends of its interval."""
    good = theirs_drawn > 0.0
    if not good.any():
        return (float("nan"),) * 3
    low, high = np.percentile(ours_drawn[good] / theirs_drawn[good], _INTERVAL)
    return _divide(ours, theirs), float(low), float(high)


def does_harm(comparison: Comparison) -> bool:
    """Return whether an error grows beyond chance, and by more than counts as none when the trust is found."""
    ratio, low, _ = comparison.to_nominal
    return low > 1.0 and ratio**2 > 1.0 + NEGLIGIBLE


def runs_away(comparisons: Sequence[Comparison]) -> tuple[Comparison, ...]:
    """Return the comparisons at the longest horizon of the states in which the open-loop model runs away, as in a spin.

    Parameters
    ----------
    comparisons : sequence of Comparison
        Of one predictor.

    Notes
    -----
    Two signs must come together. The error is more than twice that of velocities held, beyond chance; and it grows
    faster than the time. A constant error of a force makes v_x grow in proportion to the time, and an offset of v_y
    or r does not grow.
    """
    found = []
    for state in STATES:
        own = sorted((c for c in comparisons if c.state == state and c.horizon > 0.0), key=lambda c: c.horizon)
        if len(own) < 2:
            continue
        first, last = own[0], own[-1]
        if last.to_held[1] > _RUNS_AWAY and last.corrected * first.horizon > first.corrected * last.horizon:
            found.append(last)
    return tuple(found)


def nominal_runs_away(found: Sequence[Comparison]) -> bool:
    """Return whether the nominal model runs away in a state in which the corrected one does, see `runs_away`."""
    return any(c.nominal > _RUNS_AWAY * c.held for c in found)


def verdict(comparisons: Sequence[Comparison], running: Sequence[Comparison] = ()) -> str:
    """Return in a sentence what the correction is worth, state by state, beyond chance.

    Parameters
    ----------
    comparisons, running : sequence of Comparison
        With the stored trust, and the same with the running one. Where the stored one does harm, further
        sentences say what is left of it with the running one, and what to do without.

    Notes
    -----
    An increase that is no harm by `does_harm` is stated all the same, beside what the state gains at
    other horizons or with other predictors. A state without comparisons is left out.
    """
    judged = [c for c in comparisons if c.to_nominal[1] == c.to_nominal[1]]
    if not judged:
        return "verdict: too few blocks of time to tell whether the correction helps"
    parts = []
    for state in [state for state in STATES if any(c.state == state for c in comparisons)]:
        own = [c for c in judged if c.state == state]
        worse, better = [c for c in own if c.is_worse], [c for c in own if c.is_better]
        if any(map(does_harm, worse)):
            found = {"WORSE": worse}
        else:
            found = {"better": better, "hardly worse": worse}
        words = [
            f"{word} ({_span([c.to_nominal[0] for c in several])} times the nominal error {_where(several, own)})"
            for word, several in found.items()
            if several
        ]
        parts.append(f"{state} {', '.join(words) or 'as the nominal model'}")
    harm = any("WORSE" in part for part in parts)
    gain = any("better" in part for part in parts)
    head = (
        "the correction does harm"
        if harm
        else "the correction helps"
        if gain
        else "the correction changes hardly anything"
        if any("hardly" in part for part in parts)
        else "the correction changes nothing"
    )
    return f"verdict: {head}: " + "; ".join(parts) + (_way_out(running, gain) if harm else "")


def _way_out(running: Sequence[Comparison], gain: bool) -> str:
    """Return what to do on such driving, as sentences after another: a running trust first, where there is one."""
    alone = "use the vehicle file alone"
    if gain:
        alone = f"weigh what is worse against what is better, or {alone}"
    if not running:
        return f". On such driving {alone}"
    worst = max(filter(does_harm, running), key=lambda c: c.to_nominal[0], default=None)
    left = (
        f"{worst.state} is {_beside_one(worst.to_nominal[0])} times as wrong at most" if worst else "no state is worse"
    )
    return f". With a running trust (NAME_observe in an export) {left}. Without it {alone}"


def _span(ratios: Sequence[float]) -> str:
    if not ratios:
        return ""
    plain = f"{min(ratios):.2f}", f"{max(ratios):.2f}"
    # Where the ends differ in two decimals, further digits add nothing.
    low, high = plain if plain[0] != plain[1] else (_beside_one(ratio) for ratio in (min(ratios), max(ratios)))
    return low if low == high else f"{low} to {high}"


def _beside_one(ratio: float) -> str:
    """Return a ratio with two decimals, or as many as distinguish it from 1."""
    texts = [f"{ratio:.{digits}f}" for digits in range(2, 6)]
    return next((text for text in texts if float(text) != 1.0), texts[0])


def _where(comparisons: Sequence[Comparison], judged: Sequence[Comparison] = ()) -> str:
    """Name each horizon once, also where several predictors were compared; all that were judged have one name."""
    horizons = dict.fromkeys(c.when for c in comparisons)
    if len(horizons) > 1 and horizons.keys() == {c.when for c in judged}:
        return "at every horizon"
    return ", ".join(horizons)


def warnings_of(comparisons: Sequence[Comparison]) -> tuple[str, ...]:
    """Return a warning for every state that is worse than the nominal model or than persistence.

    Beyond chance and by what can be seen: what the verdict calls "as the nominal model" or "hardly worse" is no
    warning. A model that runs away is warned of first.
    """
    warnings = []
    names = dict.fromkeys(c.name for c in comparisons)
    away = [c for name in names for c in runs_away([one for one in comparisons if one.name == name])]
    if away:
        worst = max(away, key=lambda c: c.to_held[0])
        too = "; the nominal model does so too" if nominal_runs_away(away) else ""
        warnings.append(
            f"WARNING: the corrected model ({worst.name}) runs away, as in a spin: {worst.when} its error of "
            f"{worst.state} is {worst.to_held[0]:.2g} times that of holding the velocities{too}"
        )
    for state in STATES:
        for other, attribute, is_worse in (
            ("the nominal model", "to_nominal", does_harm),
            ("holding the velocities", "to_held", lambda c: _is_larger(c.to_held)),
        ):
            worse = [c for c in comparisons if c.state == state and is_worse(c)]
            if worse:
                c = max(worse, key=lambda c: getattr(c, attribute)[0])
                ratio, low, high = map(_beside_one, getattr(c, attribute))
                warnings.append(
                    f"WARNING: {state} of the corrected model is worse than {other} {_where(worse)}: at most "
                    f"{ratio} times its error (95 % interval {low} to {high}, {c.blocks} blocks)"
                )
    return tuple(warnings)


def one_step_errors(
    nominal: HeldOutSamples, model: SingleTrack, own: Labels, mean: np.ndarray, block: np.ndarray
) -> BlockErrors:
    """Return the errors over one step on a drive's test samples, in label units.

    Parameters
    ----------
    nominal : HeldOutSamples
        As the nominal model labels the drive.
    model : SingleTrack
        The nominal one.
    own : Labels
        Of the test samples, N of them, with what the model of the set leaves of each: `left_by_model`.
    mean : ndarray, shape (N, 3)
        Predicted residual of them.
    block : ndarray of int, shape (rows of the drive,)
    """
    tested = nominal.labels.take(nominal.tested)
    # A label may be finite with one model and not with the other.
    _, ours, theirs = np.intersect1d(own.row, tested.row, assume_unique=True, return_indices=True)
    tested = tested.take(theirs)
    persistence = velocity_persistence_errors(model, nominal.drive, tested)
    return BlockErrors(0.0, own.y[ours] - mean[ours], tested.y, persistence, block[tested.row])


def rollout_errors(
    held: HeldOutSamples,
    starts: np.ndarray,
    trajectories: Mapping[tuple[str, str], np.ndarray],
    key: tuple[str, str],
    horizon: float,
    block: np.ndarray,
) -> BlockErrors:
    """Return the errors of rollouts after `horizon` [s]; `key` names the corrected model's trajectory."""
    window = held.labels.window
    step = max(1, round(horizon / held.labels.horizon))
    rows = starts + step * window
    truth = np.stack([held.drive[name][rows] for name in ("vx", "vy", "r")], axis=1)
    ours, of_file, of_held = (
        truth - trajectories[name][:, step - 1, -3:] for name in (key, (NOMINAL, ""), (VELOCITY_PERSISTENCE, ""))
    )
    return BlockErrors(horizon, ours, of_file, of_held, block[starts])
