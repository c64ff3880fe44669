"""Held-out blocks of time: contiguous, spread over the drive, with a guard on both sides."""

from dataclasses import dataclass

import numpy as np

from split_cli.errors import DriveError
from split_cli.logs.drive import Drive

DEFAULT_BLOCKS = 10
DEFAULT_HOLDOUT = 0.3
DEFAULT_GUARD = 1.0


@dataclass(frozen=True)
class BlockSplit:
    """Which rows of a drive train and which test."""

    # train, test: bool (N,): never both; rows of the guards are neither.
    train: np.ndarray
    test: np.ndarray
    block: np.ndarray  # int32 (N,): block number of every row
    held_out: tuple[int, ...]  # blocks that test
    intervals: tuple[tuple[float, float], ...]  # first and last time stamp of each held-out block [s]


def hold_out_blocks(
    drive: Drive, blocks: int = DEFAULT_BLOCKS, holdout: float = DEFAULT_HOLDOUT, guard: float = DEFAULT_GUARD
) -> BlockSplit:
    """Cut a drive into equal blocks of time and hold some out, evenly spread.

    Parameters
    ----------
    blocks : int
        Number of blocks.
    holdout : float
        Share of the blocks that test, rounded to at least one and at most all but one.
    guard : float
        Time before and after each held-out block in which nothing trains [s]: neighbours in time are near
        copies, and a sample next to the border would give the answer away.

    Raises
    ------
    DriveError
        If the settings leave less than half of the other blocks' rows for training.
    """
    if blocks < 2 or not 0.0 < holdout < 1.0 or not 0.0 <= guard < float("inf"):
        what = f"{blocks} blocks with a share of {holdout:g} held out and a guard of {guard:g} s cannot be made"
        advice = "Two blocks or more, a share between 0 and 1 and a guard of 0 s or more are needed."
        raise DriveError(what, where=drive.name, advice=advice)
    rows = len(drive)
    block = (np.arange(rows) * blocks // rows).astype(np.int32)
    count = min(max(1, round(holdout * blocks)), blocks - 1)
    held_out = tuple(int((j + 0.5) * blocks / count) for j in range(count))
    test = np.isin(block, held_out)
    train = ~with_guards(test, int(np.ceil(guard / drive.period)))
    if train.sum() < 0.5 * (~test).sum():
        raise DriveError(
            f"{blocks} blocks of {rows * drive.period / blocks:.3g} s with guards of {guard:g} s leave "
            f"{100.0 * train.sum() / rows:.0f} % of the drive for training",
            where=drive.name,
            advice="Use fewer blocks or a shorter guard.",
        )
    time = drive["t"]
    intervals = tuple((float(time[block == b][0]), float(time[block == b][-1])) for b in held_out)
    return BlockSplit(train, test, block, held_out, intervals)


def with_guards(test: np.ndarray, margin: int) -> np.ndarray:
    """Return which rows are held out or at most `margin` rows from one that is, shape (N,)."""
    count = np.concatenate([[0], np.cumsum(test)])
    rows = np.arange(len(test))
    near: np.ndarray = count[np.minimum(rows + margin + 1, len(test))] > count[np.maximum(rows - margin, 0)]
    return near


def whole_drive(drive: Drive) -> BlockSplit:
    """Return the split that tests on the whole drive and trains on nothing."""
    rows, time = len(drive), drive["t"]
    everything = np.ones(rows, dtype=bool)
    interval = (float(time[0]), float(time[-1]))
    return BlockSplit(~everything, everything, np.zeros(rows, dtype=np.int32), (0,), (interval,))
