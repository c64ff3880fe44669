"""Learning while driving: a set that takes one control interval after the other, by the code of `split train`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from split_cli.errors import SetError
from split_cli.learning.cells import _Cells, _check_belongs
from split_cli.learning.labels import Labels, Reason
from split_cli.learning.training_set import SetSource, TrainingSet

__all__ = ["CellChange", "OnlineSet"]


_TOO_LITTLE = Reason.GAIN.word


@dataclass(frozen=True)
class CellChange:
    """What one offer did.

    Attributes
    ----------
    changed : tuple of int
        Positions of the cells whose points changed, see `OnlineSet.cell`.
    updates : int
        Insertions and replacements.
    """

    changed: tuple[int, ...]
    updates: int


class OnlineSet:
    """A trained set that grows while the car drives.

    Parameters
    ----------
    training_set : TrainingSet
        What is known before; may be empty.

    Notes
    -----
    Labels go through the same cells as in `extend`, so that a lap learned interval by interval gives the set that
    `split train` makes of the lap's drive, point for point.
    """

    def __init__(self, training_set: TrainingSet) -> None:
        self.header = training_set
        self._digest = training_set.vehicle.digest()
        self._cells = _Cells(training_set)
        self._sources = list(training_set.sources)
        self._open: _Tally | None = None

    @property
    def size(self) -> int:
        """Number of points."""
        return int(self._cells.count[: self.cell_count].sum())

    @property
    def cell_count(self) -> int:
        """Number of non-empty cells."""
        return len(self._cells.numbers)

    def cell(self, position: int) -> tuple[np.ndarray, np.ndarray]:
        """Return features (n, D) and labels (n, 3) of the cell at `position`, in slot order."""
        count = self._cells.count[position]
        return self._cells.slots["z"][position, :count], self._cells.slots["y"][position, :count]

    def begin_drive(self, name: str, start_time: float) -> None:
        """Begin a drive, which becomes a source of the set."""
        if self._open is not None:
            raise SetError("the drive before has not ended", where=name)
        self._open = _Tally(name, start_time)

    def offer(self, labels: Labels) -> CellChange:
        """Offer the labels of one interval."""
        tally = self._open
        if tally is None:
            raise SetError("no drive was begun", where=labels.drive)
        _check_belongs(self.header, labels, self._digest)
        grid = self.header.grid
        index, has_cell = grid.index(labels.z)
        accepted = labels.accepted
        if not (accepted & has_cell).all():
            labels = labels.inside(grid)
            accepted = labels.accepted
            tally.rejected.update(labels.counts())
        tally.samples += len(labels)
        tally.horizon = labels.horizon
        rows = np.flatnonzero(accepted)
        if not len(rows):
            return CellChange((), 0)
        begin = self._cells.base[-1] - tally.start_time
        numbers = grid.pack(index[rows])
        # Lists: there are one or two labels, and every call of NumPy costs a microsecond or more.
        outcome = self._cells._offer(labels, rows, numbers, len(self._sources), begin).tolist()
        tally.accepted += len(rows)
        tally.insertions += outcome.count(1)
        tally.replacements += outcome.count(2)
        tally.rejected[_TOO_LITTLE] += outcome.count(0)
        taken = [number for number, became in zip(numbers.tolist(), outcome, strict=True) if became]
        return CellChange(tuple(dict.fromkeys(self._cells.position[number] for number in taken)), len(taken))

    def end_drive(self, duration: float) -> TrainingSet:
        """End the drive and return the set as it is now."""
        tally, self._open = self._open, None
        if tally is None:
            raise SetError("no drive was begun")
        self._cells.base.append(self._cells.base[-1] + duration)
        rejected = {word: count for word, count in tally.rejected.items() if count}
        order = [reason.word for reason in Reason]
        self._sources.append(
            SetSource(
                name=tally.name,
                sha256="",
                samples=tally.samples,
                accepted=tally.accepted,
                rejected=dict(sorted(rejected.items(), key=lambda pair: order.index(pair[0]))),
                insertions=tally.insertions,
                replacements=tally.replacements,
                points=self.size,
                cells=self.cell_count,
                horizon=tally.horizon,
                start_time=tally.start_time,
                duration=duration,
            )
        )
        return self.freeze()

    def freeze(self) -> TrainingSet:
        """Return the set as it is now, with the drives that have ended as its sources."""
        return self._cells.freeze(tuple(self._sources))


class _Tally:
    """Counts of the drive that is being driven."""

    def __init__(self, name: str, start_time: float) -> None:
        self.name, self.start_time = name, start_time
        self.samples = self.accepted = self.insertions = self.replacements = 0
        self.rejected: Counter[str] = Counter()
        self.horizon = 0.0
