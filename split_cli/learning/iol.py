"""The online method of Kabzan et al. (2019) for comparison: one dictionary, compared with every sample."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg

from split_cli.errors import SetError
from split_cli.learning.cells import recompute_gains
from split_cli.learning.kernel import Kernel, correlation
from split_cli.learning.labels import Labels, Reason
from split_cli.learning.set_limits import LARGEST_DICTIONARY
from split_cli.learning.training_set import SetSource, TrainingSet

LEARNER = "iol"
#: Points a dictionary keeps [1]. The SPLIT paper's rival held 268 after one lap and 361 after ten.
DEFAULT_DICTIONARY = 300
_POINT_ARRAYS = ("z", "y", "t", "source", "row")
_JITTER = 1e-10


class Dictionary:
    """A bounded dictionary of labelled points that grows or exchanges one point a sample.

    Parameters
    ----------
    kernel : Kernel
        Its length scales enter the marginal gain; the gain's kernel has unit variance and no noise.
    capacity : int
        Most points kept.
    threshold : float
        Marginal gain a point needs while there is room.
    forgetting : float or None
        Time constant tau [s]: a kept point's gain counts as gamma exp(-age^2/(2 tau^2)).

    Attributes
    ----------
    z, y : ndarray, shape (N, D), (N, 3)
        Points kept, and their labels [m/s^2], [m/s^2], [rad/s^2].
    clock : ndarray, shape (N,)
        When each was learned [s].

    Notes
    -----
    Kabzan, Hewing, Liniger and Zeilinger, Learning-based model predictive control for autonomous racing, IEEE
    RA-L 4(4), 2019, after Nguyen-Tuong and Peters, Incremental online sparsification for model learning in
    real-time robot control, Neurocomputing 74(11), 2011. With K the correlation matrix of the dictionary a
    sample's gain is 1 - k^T K^-1 k; when the dictionary is full, the sample replaces the point of least gain
    gamma_i = 1/[K^-1]_ii if its own is larger.

    The printed way inverts a matrix of N - 1 points for each of the N points, N^4 operations an update. Here K^-1
    is kept: a sample's gain and an exchange (partitioned inverse) cost N^2. It is computed anew after every N
    exchanges, so that rounding does not pile up. Rejecting a sample costs N^2 as well, as every sample is
    compared with the whole dictionary: that is what cells avoid.
    """

    def __init__(
        self,
        kernel: Kernel,
        capacity: int = DEFAULT_DICTIONARY,
        threshold: float = 1e-3,
        forgetting: float | None = None,
    ) -> None:
        if capacity < 1:
            raise SetError(f"a dictionary of {capacity} points, at least 1 was expected")
        dimension = len(kernel.length_scales)
        self.kernel, self.capacity, self.threshold, self.forgetting = kernel, capacity, threshold, forgetting
        self._count = self._exchanges = 0
        self._z, self._y = np.empty((capacity, dimension)), np.empty((capacity, 3))
        self._clock = np.empty(capacity)
        self._inverse = np.empty((capacity, capacity))

    def __len__(self) -> int:
        return self._count

    @property
    def z(self) -> np.ndarray:
        """Points kept, shape (N, D)."""
        return self._z[: self._count]

    @property
    def y(self) -> np.ndarray:
        """Their labels, shape (N, 3)."""
        return self._y[: self._count]

    @property
    def clock(self) -> np.ndarray:
        """When they were learned [s], shape (N,)."""
        return self._clock[: self._count]

    @property
    def gains(self) -> np.ndarray:
        """Marginal gain of every point given all the others, shape (N,)."""
        return 1.0 / np.diag(self._inverse[: self._count, : self._count])

    def fill(self, z: np.ndarray, y: np.ndarray, clock: np.ndarray) -> None:
        """Begin with points that were kept before, at most `capacity`."""
        if len(z) > self.capacity:
            raise SetError(f"{len(z)} points do not fit into a dictionary of {self.capacity}")
        self._count = len(z)
        self._z[: len(z)], self._y[: len(z)], self._clock[: len(z)] = z, y, clock
        self._refresh()

    def offer(self, z: np.ndarray, y: np.ndarray, now: float = 0.0) -> int:
        """Offer one sample, shapes (D,) and (3,), at the time `now` [s].

        Returns
        -------
        int
            Slot it was put into; -1 when its gain was too small. A slot equal to the former size is an insertion.
        """
        n = self._count
        cross = correlation(z[None], self.z, self.kernel.length_scales)[0]
        solved = self._inverse[:n, :n] @ cross
        gain = 1.0 + _JITTER - float(cross @ solved)
        slot, least = n, self.threshold
        if n == self.capacity or self.forgetting:
            oldest, weighted = self._least(now)
            if n == self.capacity or (weighted < self.threshold and not gain > self.threshold):
                slot, least = oldest, weighted
        if not gain > least:
            return -1
        if slot < n:
            self._remove(slot)
            cross[slot] = cross[-1]
            cross = cross[:-1]
            solved = self._inverse[: n - 1, : n - 1] @ cross
            gain = 1.0 + _JITTER - float(cross @ solved)
        self._append(z, y, now, solved, gain)
        if slot < n:
            self._exchanges += 1
            if self._exchanges >= self.capacity:
                self._refresh()
        return slot

    def _least(self, now: float) -> tuple[int, float]:
        gains = self.gains
        if not len(gains):
            return 0, np.inf
        if self.forgetting:
            gains = gains * np.exp(-0.5 * np.square((now - self.clock) / self.forgetting))
        slot = int(np.argmin(gains))
        return slot, float(gains[slot])

    def _remove(self, slot: int) -> None:
        """Take one point out: the last moves into its place, and K^-1 loses a row and a column."""
        n = self._count
        last = n - 1
        inverse = self._inverse[:n, :n]
        for values in (self._z, self._y, self._clock):
            values[slot] = values[last]
        if slot != last:
            inverse[[slot, last]] = inverse[[last, slot]]
            inverse[:, [slot, last]] = inverse[:, [last, slot]]
        column = inverse[:last, last].copy()
        inverse[:last, :last] -= np.outer(column, column / inverse[last, last])
        self._count = last

    def _append(self, z: np.ndarray, y: np.ndarray, now: float, solved: np.ndarray, gain: float) -> None:
        n = self._count
        self._inverse[:n, :n] += np.outer(solved, solved / gain)
        self._inverse[n, :n] = self._inverse[:n, n] = -solved / gain
        self._inverse[n, n] = 1.0 / gain
        self._z[n], self._y[n], self._clock[n] = z, y, now
        self._count = n + 1

    def _refresh(self) -> None:
        self._exchanges = 0
        n = self._count
        if not n:
            return
        matrix = self.kernel.correlation(self.z, self.z)
        matrix[np.diag_indices(n)] += _JITTER
        try:
            factor = scipy.linalg.cho_factor(matrix, lower=True, check_finite=False)
        except scipy.linalg.LinAlgError:
            what = f"the {n} points of the dictionary cannot be told apart: their kernel matrix is singular"
            raise SetError(what, advice="Raise --threshold or shorten the length scales.") from None
        self._inverse[:n, :n] = scipy.linalg.cho_solve(factor, np.eye(n), check_finite=False)


def empty_dictionary(empty: TrainingSet, capacity: int = DEFAULT_DICTIONARY) -> TrainingSet:
    """Return an empty trained set that one dictionary of `capacity` points will fill.

    Parameters
    ----------
    empty : TrainingSet
        As `cells.empty_set` makes it; features, region, grid and kernel are kept.
    """
    if not 1 <= capacity <= LARGEST_DICTIONARY:
        raise SetError(f"a dictionary of {capacity} points, 1 to {LARGEST_DICTIONARY} was expected")
    return replace(empty, capacity=capacity, learner=LEARNER)


def extend_dictionary(training_set: TrainingSet, labels: Iterable[Labels]) -> TrainingSet:
    """Offer labels, drive after drive and sample after sample, to the dictionary of a set.

    Points are stored in the cells of the grid they lie in, so that every predictor and command reads the set as
    any other; `gamma` in the file is the gain given the others of the cell, as there. At the start of a drive the
    dictionary is built from its points in order of time, hence one run equals several appended ones.

    Raises
    ------
    SetError
        If the set is not one of this learner.
    """
    if training_set.learner != LEARNER:
        advice = "Leave out --append, or continue it with the learner that made it."
        raise SetError(f"the set was learned by {training_set.learner!r}, not by {LEARNER!r}", advice=advice)
    for drive in labels:
        training_set = _learn_drive(training_set, drive.inside(training_set.grid))
    return training_set


def _learn_drive(s: TrainingSet, labels: Labels) -> TrainingSet:
    begin = np.cumsum([0.0, *(source.duration for source in s.sources)])
    starts = np.array([source.start_time for source in s.sources])
    order = np.lexsort((s.row, s.source))
    kept = {name: getattr(s, name)[order] for name in _POINT_ARRAYS}
    dictionary = Dictionary(s.kernel, s.capacity, s.threshold, s.forgetting)
    dictionary.fill(kept["z"], kept["y"], (begin[:-1] - starts)[kept["source"]] + kept["t"])
    # Where each slot's point came from: an earlier point of the set, or a label of this drive after those.
    origin = list(range(len(order)))
    rows = np.flatnonzero(labels.accepted)
    clock = begin[-1] - labels.start_time + labels.t
    counts = [0, 0, 0]
    for row in rows:
        before = len(dictionary)
        slot = dictionary.offer(labels.z[row], labels.y[row], float(clock[row]))
        counts[0 if slot < 0 else 1 if slot == before else 2] += 1
        if slot < 0:
            continue
        if slot < before:  # the last moved into the place of the one that left
            origin[slot] = origin[-1]
            origin.pop()
        origin.append(len(order) + int(row))
    new = {
        "z": labels.z,
        "y": labels.y,
        "t": labels.t,
        "source": np.full(len(labels), len(s.sources), dtype=np.int16),
        "row": labels.row,
    }
    chosen = np.array(origin, dtype=np.int64)
    points = {name: np.concatenate([kept[name], new[name]])[chosen] for name in _POINT_ARRAYS}
    return _in_cells(s, points, labels, len(rows), counts)


def _in_cells(
    s: TrainingSet, points: dict[str, np.ndarray], labels: Labels, accepted: int, counts: list[int]
) -> TrainingSet:
    """Return the set with the dictionary's points sorted into cells, each cell by time."""
    numbers = s.grid.pack(s.grid.index(points["z"])[0])
    order = np.lexsort((points["row"], points["source"], numbers))
    points = {name: np.ascontiguousarray(values[order]) for name, values in points.items()}
    cells, sizes = np.unique(numbers, return_counts=True)
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    source = SetSource(
        name=labels.drive,
        sha256=labels.sha256,
        samples=len(labels),
        accepted=accepted,
        rejected={**labels.counts(), **({Reason.GAIN.word: counts[0]} if counts[0] else {})},
        insertions=counts[1],
        replacements=counts[2],
        points=len(order),
        cells=len(cells),
        horizon=labels.horizon,
        start_time=labels.start_time,
        duration=labels.duration,
        faults=labels.faults,
        remarks=labels.remarks,
        circular=labels.circular,
    )
    sources = (*s.sources, source)
    columns: dict[str, Any] = dict(points)
    whole = replace(s, cell_numbers=cells, offsets=offsets, sources=sources, **columns)
    return replace(whole, gamma=recompute_gains(whole))
