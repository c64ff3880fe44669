"""Do the intervals of a set hold on a drive, near its points and beyond? A warning where they are too narrow."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from scipy.special import ndtri, stdtrit

from split_cli.learning.running_width import RunningWidth
from split_cli.learning.training_set import TrainingSet
from split_cli.learning.trust import STATES
from split_cli.scoring.report import IntervalShares
from split_cli.scoring.run import Trace
from split_cli.scoring.vehicle_match import near_points
from split_cli.scoring.verdict import number_blocks

_LEVEL = 0.95
_LEVELS = (0.5, 0.9, _LEVEL)
#: By how much an interval of 95 % may miss what it promises [1]: docs/prediction.md states 3 points.
_ALLOWED = 0.03
#: Fewer blocks of time show no chance.
_FEWEST_BLOCKS = 4


def interval_shares(
    traces: Sequence[Trace], sets: Mapping[str, TrainingSet], running: str = ""
) -> tuple[IntervalShares, ...]:
    """Return the shares that intervals held, by predictor, near the points of the set and beyond.

    Parameters
    ----------
    sets : mapping of str to TrainingSet
        By features.
    running : str
        What the names of predictors end in whose widths follow the drive (`RunningWidth`).

    Notes
    -----
    Training drives show how wrong a correction is near its points. Beyond them an interval carries only the size
    that the residual had in training, and no label says how much larger it becomes (docs/decisions/0032).
    """
    found = []
    for name, features in dict.fromkeys((trace.name, trace.features) for trace in traces):
        same = [trace for trace in traces if (trace.name, trace.features) == (name, features)]
        follows = bool(running) and name.endswith(running)
        ratios = [_ratios(trace) for trace in same]
        inside = np.concatenate([_inside(ratio, follows) for ratio in ratios])
        finite = np.isfinite(np.concatenate(ratios)).all(axis=1)
        near = np.concatenate([near_points(sets[features], trace.tested.z) for trace in same])
        for close in (True, False):
            part = inside[finite & (near == close)]
            if len(part):
                share = len(part) / int(finite.sum())
                found.append(IntervalShares(name, features, close, len(part), share, *part.mean(axis=0)))
    return tuple(found)


def _inside(ratio: np.ndarray, follows: bool) -> np.ndarray:
    """Return whether each label was inside its intervals, shape (N, 3 levels, 3); `follows` as they then were."""
    if not follows:
        inside: np.ndarray = ratio[:, None, :] <= ndtri(0.5 + 0.5 * np.array(_LEVELS))[:, None]
        return inside
    width = RunningWidth(_LEVELS)
    return np.array([width.observe(one) for one in ratio]).reshape(-1, len(_LEVELS), 3)


def _ratios(trace: Trace) -> np.ndarray:
    """Return errors over the deviations that were predicted, label noise included, shape (N, 3)."""
    deviation = np.sqrt(trace.prediction.variance + trace.noise_variance)
    ratio: np.ndarray = np.abs(trace.tested.y - trace.prediction.mean) / deviation
    return ratio


def too_narrow(error: np.ndarray, deviation: np.ndarray, block: np.ndarray) -> tuple[float, float] | None:
    """Return the share that 95 % intervals hold and the factor they lack, None where they hold enough.

    Parameters
    ----------
    error, deviation : ndarray, shape (N,)
        Of labels, and the standard deviation that was predicted, label noise included.
    block : ndarray of int, shape (N,)
        Blocks of time, which count as independent.

    Returns
    -------
    (float, float) or None
        None also with fewer than four blocks, or where the share may be within three points by chance (95 %,
        one-sided).
    """
    ratio = np.abs(error) / (ndtri(0.5 + 0.5 * _LEVEL) * deviation)
    numbers, member = np.unique(block, return_inverse=True)
    count = len(numbers)
    if count < _FEWEST_BLOCKS:
        return None
    share = float(np.mean(ratio <= 1.0))
    beyond = np.bincount(member, (ratio <= 1.0) - share)
    scatter = float(np.sqrt(count / (count - 1) * np.square(beyond).sum()) / len(ratio))
    if share + float(stdtrit(count - 1, _LEVEL)) * scatter >= _LEVEL - _ALLOWED:
        return None
    return share, float(np.quantile(ratio, _LEVEL))


_REMEDY = ". This driving differs from that of the training; add drives like this one to it"


def interval_warnings(
    traces: Sequence[Trace], shares: Sequence[IntervalShares] = (), silent: Collection[str] = ()
) -> list[str]:
    """Return a warning for every state whose intervals are too narrow on these drives, by predictor.

    Parameters
    ----------
    traces : sequence of Trace
        Of any predictors; of each, one a drive.
    shares : sequence of IntervalShares
        The warning says of the first predictor named what it holds near the points and beyond.
    silent : collection of str
        States that are not judged: labels or training say nothing of them (`logs.drive_metadata.CIRCULAR`).
    """
    narrow = {
        name: _narrow_states([trace for trace in traces if trace.name == name])
        for name in dict.fromkeys(trace.name for trace in traces)
    }
    warnings: list[str] = []
    for number, state in enumerate(STATES):
        found = {name: states[state] for name, states in narrow.items() if state in states}
        if not found or state in silent:
            continue
        held = " and ".join(f"{100.0 * share:.0f} % ({name})" for name, (share, _) in found.items())
        factor = max(factor for _, factor in found.values())
        advice = "" if warnings else _REMEDY  # one for all states
        warnings.append(
            f"WARNING: intervals of {state} are too narrow here: the 95 % intervals hold only {held} of the "
            f"labels. They would have to be {'up to ' if len(found) > 1 else ''}{factor:.1f} times as wide{advice}"
            f"{_by_distance([s for s in shares if s.name == list(found)[0]], number)}"
        )
    return warnings


def _by_distance(shares: Sequence[IntervalShares], state: int) -> str:
    """Return what 95 % intervals of one predictor hold near the points and beyond, empty without either."""
    where = {True: "near the points of the set", False: "farther than a length scale from all of them"}
    parts = [f"{100.0 * s.coverage_95[state]:.0f} % {where[s.near]}" for s in shares]
    return f". They hold {' and '.join(parts)} ({shares[0].name})" if len(parts) > 1 else ""


def _narrow_states(traces: Sequence[Trace]) -> dict[str, tuple[float, float]]:
    """Return what `too_narrow` says of one predictor on all drives together, by state."""
    parts, first = [], 0
    for trace in traces:
        drive = trace.held.drive
        block = number_blocks(drive["t"], drive.segment, first)
        first = int(block.max()) + 1
        parts.append((_ratios(trace), block[trace.tested.row]))
    ratio, block = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    finite = np.isfinite(ratio).all(axis=1)
    ratio, block = ratio[finite], block[finite]
    found = {state: too_narrow(ratio[:, k], np.ones(len(ratio)), block) for k, state in enumerate(STATES)}
    return {state: narrow for state, narrow in found.items() if narrow}
