"""Do the intervals of a set hold on a drive? A warning in words where they are too narrow beyond chance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import norm, t

from split_cli.scoring.run import Trace
from split_cli.scoring.verdict import STATES, number_blocks

__all__ = ["interval_warnings", "too_narrow"]

_LEVEL = 0.95
#: By how much an interval of 95 % may miss what it promises [1]: docs/prediction.md states 3 points.
_ALLOWED = 0.03
#: Fewer blocks of time show no chance.
_FEWEST_BLOCKS = 4


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
    ratio = np.abs(error) / (norm.ppf(0.5 + 0.5 * _LEVEL) * deviation)
    numbers, member = np.unique(block, return_inverse=True)
    count = len(numbers)
    if count < _FEWEST_BLOCKS:
        return None
    share = float(np.mean(ratio <= 1.0))
    beyond = np.bincount(member, (ratio <= 1.0) - share)
    scatter = float(np.sqrt(count / (count - 1) * np.square(beyond).sum()) / len(ratio))
    if share + float(t.ppf(_LEVEL, count - 1)) * scatter >= _LEVEL - _ALLOWED:
        return None
    return share, float(np.quantile(ratio, _LEVEL))


def interval_warnings(traces: Sequence[Trace]) -> list[str]:
    """Return a warning for every state whose intervals are too narrow on these drives, by predictor.

    Parameters
    ----------
    traces : sequence of Trace
        Of any predictors; of each, one a drive.
    """
    narrow = {
        name: _narrow_states([trace for trace in traces if trace.name == name])
        for name in dict.fromkeys(trace.name for trace in traces)
    }
    told = []
    for state in STATES:
        found = {name: states[state] for name, states in narrow.items() if state in states}
        if not found:
            continue
        held = " and ".join(f"{100.0 * share:.0f} % ({name})" for name, (share, _) in found.items())
        factor = max(factor for _, factor in found.values())
        told.append(
            f"WARNING: intervals of {state} are too narrow here: the 95 % intervals hold only {held} of the "
            f"labels. They would have to be {'up to ' if len(found) > 1 else ''}{factor:.1f} times as wide. This "
            "driving differs from that of the training; add drives like this one to it"
        )
    return told


def _narrow_states(traces: Sequence[Trace]) -> dict[str, tuple[float, float]]:
    """Return what `too_narrow` says of one predictor on all drives together, by state."""
    parts, first = [], 0
    for trace in traces:
        drive = trace.held.drive
        block = number_blocks(drive["t"], drive.segment, first)
        first = int(block.max()) + 1
        error = trace.tested.y - trace.prediction.mean
        deviation = np.sqrt(trace.prediction.variance + trace.noise_variance)
        parts.append((error, deviation, block[trace.tested.row]))
    error, deviation, block = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    finite = np.isfinite(error).all(axis=1)
    error, deviation, block = error[finite], deviation[finite], block[finite]
    found = {state: too_narrow(error[:, k], deviation[:, k], block) for k, state in enumerate(STATES)}
    return {state: narrow for state, narrow in found.items() if narrow}
