"""Learning while driving: a set that takes one control interval after the other, by the code of `split train`."""

from collections import Counter
from typing import NamedTuple

import numpy as np

from split_cli.errors import SetError
from split_cli.learning.cells import _Cells, _check_belongs
from split_cli.learning.labels import Labels, Reason
from split_cli.learning.region import valid_cell_count
from split_cli.learning.training_set import SetSource, TrainingSet

#: What `cell_number` returns in place of a cell.
_WITHOUT_CELL = {-1: int(Reason.GRID), -2: int(Reason.NON_FINITE)}
_TOO_LITTLE, _WORDS = Reason.GAIN.word, tuple(reason.word for reason in Reason)


class CellChange(NamedTuple):
    """What one offer did."""

    changed: tuple[int, ...]  # positions of the cells whose points changed, see `OnlineSet.cell`
    updates: int  # insertions and replacements


_NOTHING = CellChange((), 0)


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
        from split_cli.learning._compiled import cell_number

        self.header = training_set
        self._number, self._grid, self._bits = cell_number, training_set.grid.table, training_set.grid.bits
        self._known: Labels | None = None
        self._digest = training_set.vehicle.digest()
        self._cells = _Cells(training_set)
        if training_set.features.is_z2:
            # A controller's interval must not wait until arrays have grown.
            self._cells.reserve(valid_cell_count(training_set.vehicle, training_set.region, training_set.grid))
        self._z = self._cells.sample
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
        return self._cells.values("z")[position, :count], self._cells.slots["y"][position, :count]

    def begin_drive(self, name: str, start_time: float) -> None:
        """Begin a drive, which becomes a source of the set."""
        if self._open is not None:
            raise SetError("the drive before has not ended", where=name)
        self._open = _Tally(name, start_time)

    def offer(self, labels: Labels) -> CellChange:
        """Offer the labels of one interval."""
        if self._open is None:
            raise SetError("no drive was begun", where=labels.drive)
        self._check(labels)
        self._open.horizon = labels.horizon
        # Numbers of Python, and few calls of NumPy: each costs as much as a part of the update.
        z, y, t, row, reason = labels.z, labels.y, labels.t, labels.row, labels.reason
        if len(row) == 1:
            return self.offer_one(z[0], y[0], t.item(), row.item(), reason.item())
        changes = [self.offer_one(z[at], y[at], t.item(at), row.item(at), reason.item(at)) for at in range(len(row))]
        cells = [cell for change in changes for cell in change.changed]
        return CellChange(tuple(dict.fromkeys(cells)), len(cells))

    def offer_one(self, z: np.ndarray, y: np.ndarray, t: float, row: int = 0, reason: int = 0) -> CellChange:
        """Offer one label of the drive that was begun, from numbers alone.

        Parameters
        ----------
        z : ndarray, shape (D,)
            Features of the set's header, in their order.
        y : ndarray, shape (3,)
            Rate that the set's vehicle leaves out, of v_x, v_y [m/s^2] and r [rad/s^2].
        t : float
            Time of the window's start on the clock of the drive [s].
        row : int
            Its row in the drive.
        reason : Reason or int
            Why it may not be learned, 0 (`Reason.ACCEPTED`) where it may: whether a sample lies in the valid
            region is not asked here. A sample outside the grid is not learned.

        Notes
        -----
        For a controller's loop. A label that is not finite, or over 1e9, is not learned, with `Reason.NON_FINITE`.
        """
        tally, cells = self._open, self._cells
        if tally is None:
            raise SetError("no drive was begun")
        tally.samples += 1
        number = -1
        if not reason:
            self._z[:], cells.label[:] = z, y
            number = self._number(self._z, cells.label, self._grid, self._bits)
            reason = _WITHOUT_CELL.get(number, 0)
        if reason:
            tally.rejected[_WORDS[reason]] += 1
            return _NOTHING
        begin = cells.base[-1] - tally.start_time
        became = cells.offer_sample(number, t, row, len(self._sources), begin, tally.name)
        tally.accepted += 1
        if became == 1:
            tally.insertions += 1
        elif became:
            tally.replacements += 1
        else:
            tally.rejected[_TOO_LITTLE] += 1
            return _NOTHING
        return CellChange((cells.position[number],), 1)

    def _check(self, labels: Labels) -> None:
        """Refuse labels of another kind than the set's; those of one kind in a row are compared once."""
        known = self._known
        if known is None or not (
            labels.features is known.features
            and labels.region is known.region
            and labels.vehicle_digest is known.vehicle_digest
            and labels.plain is known.plain
            and labels.horizon == known.horizon
        ):
            _check_belongs(self.header, labels, self._digest)
            self._known = labels

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
