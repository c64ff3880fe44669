"""Learning: every sample is offered to its cell, which keeps the points of greatest marginal gain."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from split_cli.errors import NumericalRepairWarning, SetError
from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import Labels, Reason
from split_cli.learning.late_labels import freed_of_late_torque
from split_cli.learning.region import Grid, Region
from split_cli.learning.set_limits import LARGEST_CELL
from split_cli.learning.training_set import SetSource, TrainingSet
from split_cli.logs.scratch import PIECE, let_go
from split_cli.vehicle.parameters import Vehicle

DEFAULT_CAPACITY = 10
DEFAULT_THRESHOLD = 1e-3
_POINT_ARRAYS = ("z", "y", "gamma", "t", "source", "row")
#: What the compiled update takes as one array: a point's features, its gain, and its time on the clock of learning.
_COLUMNS: dict[str, int | slice] = {"z": slice(None, -2), "gamma": -2, "clock": -1}


def empty_set(
    vehicle: Vehicle,
    features: FeatureSet,
    region: Region,
    grid: Grid,
    kernel: Kernel,
    *,
    horizon: float,
    capacity: int = DEFAULT_CAPACITY,
    threshold: float = DEFAULT_THRESHOLD,
    forgetting: float | None = None,
    plain: bool = False,
) -> TrainingSet:
    """Return a set without points, ready for `extend`.

    Parameters
    ----------
    vehicle, features, region, grid, kernel, horizon, capacity, threshold, forgetting, plain
        As kept in `TrainingSet`.

    Raises
    ------
    SetError
        If a setting is out of its range, or grid and kernel are not of the features' dimension.
    """
    dimension = len(features.names)
    if not 1 <= capacity <= LARGEST_CELL:
        raise SetError(f"the capacity of a cell is {capacity}, 1 to {LARGEST_CELL} was expected")
    if not 1e-9 <= threshold < 1.0:
        # Below, the threshold would be in the rounding of the gain, and K singular to working precision.
        raise SetError(f"the gain threshold is {threshold:g}, a value from 1e-9 to below 1 was expected")
    if forgetting is not None and not (np.isfinite(forgetting) and forgetting > 0):
        raise SetError(f"the time constant of forgetting is {forgetting!r}, a positive time was expected")
    if len(grid.edges) != dimension or len(kernel.length_scales) != dimension:
        raise SetError(
            f"{dimension} features, but a grid of {len(grid.edges)} and a kernel of "
            f"{len(kernel.length_scales)} dimensions"
        )
    return TrainingSet(
        vehicle=vehicle,
        features=features,
        region=region,
        grid=grid,
        kernel=kernel,
        horizon=horizon,
        capacity=capacity,
        threshold=threshold,
        forgetting=forgetting,
        cell_numbers=np.empty(0, dtype=np.int64),
        offsets=np.zeros(1, dtype=np.int64),
        z=np.empty((0, dimension)),
        y=np.empty((0, 3)),
        gamma=np.empty(0),
        t=np.empty(0),
        source=np.empty(0, dtype=np.int16),
        row=np.empty(0, dtype=np.int64),
        plain=plain,
    )


def without_points(training_set: TrainingSet) -> TrainingSet:
    """Return an empty set with the settings and the kernel of another."""
    s = training_set
    empty = empty_set(
        s.vehicle,
        s.features,
        s.region,
        s.grid,
        s.kernel,
        horizon=s.horizon,
        capacity=s.capacity,
        threshold=s.threshold,
        forgetting=s.forgetting,
        plain=s.plain,
    )
    return replace(empty, found_effects=s.found_effects)


def learn(
    labels: Sequence[Labels],
    *,
    vehicle: Vehicle,
    grid: Grid,
    kernel: Kernel,
    capacity: int = DEFAULT_CAPACITY,
    threshold: float = DEFAULT_THRESHOLD,
    forgetting: float | None = None,
    batch: int | None = None,
) -> TrainingSet:
    """Learn labels, drive after drive as given, into a new set.

    Parameters
    ----------
    labels : sequence of Labels
        One a drive, all of the same features, region and horizon.
    vehicle, grid, kernel, capacity, threshold, forgetting
        As kept in `TrainingSet`.
    batch : int, optional
        Samples offered at once; the set does not depend on it.

    Notes
    -----
    SPLIT paper, sparse incremental learning. For a sample in cell k, gamma_new = k(z, z) - k^T K_k^-1 k (the
    independence measurement). Below capacity it is inserted when gamma_new exceeds the threshold; at capacity it
    replaces the point of least gamma when it exceeds that. The gains of kept points are gamma_i = 1/[K^-1]_ii, an
    exact identity (the Schur complement of i in K) for what the paper gets by one inversion a point.

    With forgetting, a kept point's gain counts as gamma_i exp(-age^2/(2 tau^2)), after Kabzan et al.,
    Learning-based model predictive control for autonomous racing, IEEE RA-L 4(4), 2019; age is driving time
    learned since. A cell with room then also replaces, since its old points would stay for ever otherwise.
    """
    if not labels:
        raise SetError("nothing to learn: no drive was given")
    first = labels[0]
    start = empty_set(
        vehicle,
        first.features,
        first.region,
        grid,
        kernel,
        horizon=first.horizon,
        capacity=capacity,
        threshold=threshold,
        forgetting=forgetting,
        plain=first.plain,
    )
    return extend(start, labels, batch=batch)


def extend(training_set: TrainingSet, labels: Iterable[Labels], *, batch: int | None = None) -> TrainingSet:
    """Go on learning: offer labels, drive after drive, to a set.

    Raises
    ------
    SetError
        If the labels are of another vehicle, or of other features, region or horizon than the set.
    """
    if training_set.learner != "split":
        what = f"was learned by {training_set.learner!r}, whose points are not kept cell by cell"
        raise SetError(what, advice="Continue it with that learner.")
    cells = _Cells(training_set)
    sources = list(training_set.sources)
    for drive in labels:
        _check_belongs(training_set, drive)
        drive = freed_of_late_torque(training_set, drive)
        if len(sources) > np.iinfo(np.int16).max:
            raise SetError(f"holds {len(sources)} drives already, a set can list no more")
        sources.append(cells.offer(drive, len(sources), batch or PIECE))
    return cells.freeze(tuple(sources))


def recompute_gains(training_set: TrainingSet) -> np.ndarray:
    """Return gamma of every point from the points alone, shape (P,); what `TrainingSet.gamma` must equal."""
    from split_cli.learning._compiled import refresh_cells

    widest = int(np.diff(training_set.offsets).max(initial=1))
    return refresh_cells(training_set.offsets, training_set.z, 1.0 / training_set.kernel.length_scales, widest)


def warm_up() -> None:
    """Load or compile the fast loops, so that a time measured afterwards is that of the work."""
    from split_cli.learning._compiled import cell_number, update_cell, update_cells
    from split_cli.learning._windows_numba import window_errors

    whole, one = np.zeros(1, dtype=np.int64), np.ones(2)
    window_errors(one, one, one, one, one, whole, 1, 1.0, np.ones(16), False, one)
    sample, cells = np.zeros((1, 4)), (np.zeros((1, 1, 3)), np.zeros((1, 1, 4)))
    origin = np.zeros((1, 1), dtype=np.int64)
    update_cells(np.arange(2), whole, whole, sample, np.zeros(1), one[:1], 0.5, 0.0, whole.copy(), *cells, origin)
    update_cell(0, 0, 0.0, sample, one[:1], 0.5, 0.0, whole.copy(), *cells)
    cell_number(np.zeros(1), one, np.ones((5, 1)), 62)


def _check_belongs(training_set: TrainingSet, labels: Labels, digest: str | None = None) -> None:
    """Refuse labels of another kind than the set's; `digest` is that of its vehicle, where it is known."""
    advice = "Train a set of its own for it."
    if labels.vehicle_digest != (training_set.vehicle.digest() if digest is None else digest):
        raise SetError("its labels are of another vehicle than the set", where=labels.drive, advice=advice)
    for what, theirs, ours in (
        ("features", labels.features.names, training_set.features.names),
        ("valid region", labels.region, training_set.region),
        ("kind of label (plain difference)", labels.plain, training_set.plain),
    ):
        if theirs != ours:
            raise SetError(f"its {what} is {theirs}, the set's is {ours}", where=labels.drive, advice=advice)
    if labels.plain and abs(labels.horizon - training_set.horizon) > 1e-9:
        raise SetError(
            f"its horizon is {labels.horizon:g} s, the set's is {training_set.horizon:g} s, and plain differences "
            "depend on it",
            where=labels.drive,
            advice=advice,
        )


class _Cells:
    """The growing state of learning: a row of slots a cell, cells in the order they were first seen.

    Everything beside the points (gains, factors) is recomputed from the points, so that going on from a file
    gives the same bits as never having stopped.
    """

    def __init__(self, training_set: TrainingSet) -> None:
        from split_cli.learning._compiled import update_cell

        self.set = training_set
        self.update_cell = update_cell
        #: What `offer_sample` offers, (D,) and (3,): always of the same array, of one type to the compiler.
        self._row = np.zeros((1, len(training_set.features.names) + 3))
        self.sample, self.label = self._row[0, :-3], self._row[0, -3:]
        #: Sums over all labels would not forget those that a point outlives.
        self.absorbs = training_set.forgetting is None
        self.inverse_scales = 1.0 / training_set.kernel.length_scales
        self.base = [0.0]  # clock of learning at which each source begins, and at last where the next will
        for source in training_set.sources:
            self.base.append(self.base[-1] + source.duration)
        self.numbers = training_set.cell_numbers.tolist()
        self.position = {number: index for index, number in enumerate(self.numbers)}
        self.count = np.diff(training_set.offsets).astype(np.int64)
        names = ("points", "sums", *(name for name in _POINT_ARRAYS if name not in _COLUMNS))
        self.slots = {name: self._blank(name, len(self.numbers)) for name in names}
        #: Which of the samples offered together each slot was written from; -1 between offers.
        self.origin = np.full((len(self.numbers), training_set.capacity), -1, dtype=np.int64)
        filled = self._filled()
        for name in _POINT_ARRAYS:
            self.values(name)[filled] = getattr(training_set, name)
        starts = np.array([source.start_time for source in training_set.sources])
        begin = np.array(self.base[:-1]) - starts
        self.values("clock")[filled] = begin[training_set.source] + training_set.t
        if self.absorbs:
            sums, room = self.slots["sums"], training_set.capacity
            sums[:, :, :room][_pairs(filled)], sums[:, :, room:][filled] = training_set.sums()

    def _blank(self, name: str, cells: int) -> np.ndarray:
        room = self.set.capacity
        if name == "sums":
            return np.zeros((cells, room, room + 3) if self.absorbs else (cells, 0, 0))
        if name == "points":
            return np.zeros((cells, room, len(self.inverse_scales) + 2))
        like = getattr(self.set, name)
        return np.zeros((cells, room, *like.shape[1:]), dtype=like.dtype)

    def values(self, name: str) -> np.ndarray:
        """Return what every slot holds by its name, shape (C, M) or (C, M, D): a view."""
        return self.slots["points"][:, :, _COLUMNS[name]] if name in _COLUMNS else self.slots[name]

    def _filled(self) -> np.ndarray:
        return np.arange(self.set.capacity) < self.count[: len(self.numbers), None]

    def offer(self, labels: Labels, source: int, batch: int) -> SetSource:
        """Offer one drive's labels; return what became of them."""
        labels = labels.inside(self.set.grid)
        begin = self.base[-1] - labels.start_time
        self.base.append(self.base[-1] + labels.duration)
        accepted, grid, became = labels.accepted, self.set.grid, np.zeros(3, dtype=np.int64)
        for first in range(0, len(labels), batch):
            rows = first + np.flatnonzero(accepted[first : first + batch])
            if len(rows):
                within = grid.pack(grid.index(labels.z[rows])[0])
                became += np.bincount(self._offer(labels, rows, within, source, begin), minlength=3)
            let_go()  # of the labels of a long drive
        kept, inserted, replaced = became.tolist()
        return SetSource(
            name=labels.drive,
            sha256=labels.sha256,
            samples=len(labels),
            accepted=int(became.sum()),
            rejected={**labels.counts(), **({Reason.GAIN.word: kept} if kept else {})},
            insertions=inserted,
            replacements=replaced,
            points=int(self.count.sum()),
            cells=len(self.numbers),
            horizon=labels.horizon,
            start_time=labels.start_time,
            duration=labels.duration,
            faults=labels.faults,
            remarks=labels.remarks,
            circular=labels.circular,
        )

    def _offer(self, labels: Labels, rows: np.ndarray, numbers: np.ndarray, source: int, begin: float) -> np.ndarray:
        """Offer the labels at `rows`, which lie in the cells `numbers`; return what became of each, shape (N,).

        0 (gain too small), 1 (inserted) or 2 (replaced a point).
        """
        from split_cli.learning._compiled import update_cells

        if len(rows) == 1:
            return self._offer_one(labels, int(rows[0]), int(numbers[0]), source, begin)
        samples, t = np.concatenate([labels.z[rows], labels.y[rows]], axis=1), labels.t[rows]
        order = np.argsort(numbers, kind="stable")
        distinct, first = np.unique(numbers[order], return_index=True)
        cells = self._cells_of(distinct.tolist())
        outcome, repairs, broken = update_cells(
            np.append(first, len(order)),
            cells,
            order,
            samples,
            begin + t,
            self.inverse_scales,
            self.set.threshold,
            self.set.forgetting or 0.0,
            self.count,
            self.slots["points"],
            self.slots["sums"],
            self.origin,
        )
        # Only cells that were offered something can have changed.
        origin = self.origin[cells]
        self.origin[cells] = -1
        self._check(labels.drive, repairs, broken)
        offered, slot = np.nonzero(origin >= 0)
        written, taken = (cells[offered], slot), rows[origin[offered, slot]]
        for name in ("y", "t", "row"):
            self.slots[name][written] = getattr(labels, name)[taken]
        self.slots["source"][written] = source
        return outcome

    def _offer_one(self, labels: Labels, row: int, number: int, source: int, begin: float) -> np.ndarray:
        """Offer one label as `_offer` does, at a fraction of its time: nothing needs sorting."""
        self.sample[:], self.label[:] = labels.z[row], labels.y[row]
        became = self.offer_sample(number, labels.t[row], labels.row[row], source, begin, labels.drive)
        return np.array([became], dtype=np.int8)

    def offer_sample(self, number: int, t: float, row: int, source: int, begin: float, drive: str) -> int:
        """Offer what `sample` and `label` hold to the cell `number`; return what became of it, as `_offer`."""
        position = self.position.get(number)
        if position is None:
            position = self._new_cell(number)
        slots = self.slots
        became, slot, repairs = self.update_cell(
            position,
            0,
            begin + t,
            self._row,
            self.inverse_scales,
            self.set.threshold,
            self.set.forgetting or 0.0,
            self.count,
            slots["points"],
            slots["sums"],
        )
        if repairs:
            self._check(drive, max(repairs, 0), -1 if repairs > 0 else position)
        if became:
            slots["y"][position, slot], slots["t"][position, slot] = self.label, t
            slots["row"][position, slot], slots["source"][position, slot] = row, source
        return became

    def _check(self, drive: str, repairs: int, broken: int) -> None:
        """Refuse a cell that no jitter could repair, -1 for none, and warn of those that needed it."""
        if broken >= 0:
            raise SetError(
                f"the points of cell {self.numbers[broken]} cannot be told apart: their kernel matrix is singular",
                where=drive,
                advice="Raise --threshold or shorten the length scales.",
            )
        if repairs:
            text = f"{drive}: {repairs} kernel matrices of cells needed jitter, at most 1e-10"
            warnings.warn(NumericalRepairWarning(text), stacklevel=5)

    def _cells_of(self, numbers: list[int]) -> np.ndarray:
        """Return the row of each cell number, int64; cells not seen before get the next rows."""
        for number in numbers:
            if number not in self.position:
                self._new_cell(number)
        return np.array([self.position[number] for number in numbers], dtype=np.int64)

    def _new_cell(self, number: int) -> int:
        """Return the row of a cell not seen before: the next one."""
        position = len(self.numbers)
        if position == len(self.count):
            # Doubling, so that learning sample by sample does not copy everything at each new cell.
            self.reserve(max(1, 2 * position))
        self.position[number] = position
        self.numbers.append(number)
        return position

    def reserve(self, cells: int) -> None:
        """Make room for as many cells; a sample's time then does not depend on what came before it."""
        more = cells - len(self.count)
        if more > 0:
            self.count = np.concatenate([self.count, np.zeros(more, dtype=np.int64)])
            self.origin = np.concatenate([self.origin, np.full((more, self.set.capacity), -1, dtype=np.int64)])
            for name, values in self.slots.items():
                self.slots[name] = np.concatenate([values, self._blank(name, more)])

    def freeze(self, sources: tuple[SetSource, ...]) -> TrainingSet:
        """Return the state as a trained set, cells ascending, points in slot order."""
        numbers = np.array(self.numbers, dtype=np.int64)
        # A cell is entered when a sample is offered, and its first sample always stays.
        order = np.argsort(numbers)
        filled = self._filled()[order]
        arrays = {name: self.values(name)[order][filled] for name in _POINT_ARRAYS}
        if self.absorbs:
            sums, room = self.slots["sums"][order], self.set.capacity
            lower = np.tril(sums[:, :, :room])
            whole = lower + np.tril(lower, -1).transpose(0, 2, 1)
            arrays["information"], arrays["absorbed"] = whole[_pairs(filled)], sums[:, :, room:][filled]
        offsets = np.concatenate([[0], np.cumsum(self.count[order])])
        return replace(self.set, cell_numbers=numbers[order], offsets=offsets, sources=sources, **arrays)


def _pairs(filled: np.ndarray) -> np.ndarray:
    """Return which pairs of slots are filled, shape (C, M, M), of filled slots (C, M)."""
    both: np.ndarray = filled[:, :, None] & filled[:, None, :]
    return both
