"""The trained set: the points each cell kept, and everything needed to predict with them or to go on learning."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from split_cli.errors import SetError, VehicleError
from split_cli.files import atomic_path, parse_json
from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import OUTPUTS, Kernel
from split_cli.learning.label_sums import SUMS, check_sums, read_sums, sums_by_cell
from split_cli.learning.region import Grid, Region, valid_cells
from split_cli.learning.set_limits import FOUND, check_header, check_points
from split_cli.learning.trust import Trust
from split_cli.vehicle.parameters import EffectSpec, Vehicle, vehicle_from_mapping, vehicle_to_mapping

SET_FORMAT = "split-set/3"
_WITHOUT_SUMS = "split-set/2"  # written where nothing was absorbed, and by versions that absorbed nothing
_WITHOUT_TRUST = "split-set/1"  # all of it
_READABLE = (SET_FORMAT, _WITHOUT_SUMS, _WITHOUT_TRUST)
_RETRAIN = "Train it again with `split train`."
_GAIN_TOLERANCE = 1e-9  # of gains between 0 and 1: LAPACK's inverse against the factors that learning keeps
_JITTER = 1e-10  # the largest that learning adds to a kernel matrix
_NUMBERS_AT_ONCE = 1 << 20  # of the kernel matrices that are inverted together: 8 MB
NUMBERS_WHEN_READ = 64 * _NUMBERS_AT_ONCE  # of those that are inverted when a set is read: some 5 s


@dataclass(frozen=True)
class SetSource:
    """One drive a set was trained on, and what became of its samples.

    Attributes
    ----------
    samples : int
        Labels offered.
    accepted : int
        Labels inside the valid region.
    rejected : mapping of str to int
        By reason: speed, ellipse, slip, slip_difference, grid, gap, non_finite, gain.
    insertions, replacements : int
        Updates of the set.
    points, cells : int
        Size of the set and non-empty cells after this drive.
    horizon : float
        Label interval of this drive [s]: the set's, rounded to whole samples.
    start_time, duration : float
        First time stamp and length of the drive [s]; with forgetting, ages run over the drives one after another.
    faults, remarks, circular : tuple of str
        What ingest found wrong and what else, and states whose labels say nothing of the car (see `Labels`).
    """

    name: str
    sha256: str
    samples: int
    accepted: int
    rejected: Mapping[str, int]
    insertions: int
    replacements: int
    points: int
    cells: int
    horizon: float = 0.0
    start_time: float = 0.0
    duration: float = 0.0
    faults: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    circular: tuple[str, ...] = ()


@dataclass(frozen=True)
class TrainingSet:
    """A SPLIT training set.

    Attributes
    ----------
    kernel : Kernel
        Of the residual; the marginal gain uses its length scales with unit variance and no noise.
    horizon : float
        Label interval h [s] as asked for; each drive rounds it to whole samples of its own.
    capacity : int
        M, points a cell may keep.
    threshold : float
        Marginal gain a point needs to enter a cell that has room.
    forgetting : float or None
        Time constant of forgetting [s]; None is off.
    cell_numbers : ndarray of int64, shape (C,)
        Non-empty cells, ascending.
    offsets : ndarray of int64, shape (C + 1,)
        Points of cell c are rows ``offsets[c]:offsets[c + 1]``, in slot order.
    z : ndarray, shape (P, D)
    y : ndarray, shape (P, 3)
        Labels [m/s^2], [m/s^2], [rad/s^2].
    gamma : ndarray, shape (P,)
        Marginal gain of a point given the others of its cell.
    t : ndarray, shape (P,)
        Time in its drive [s].
    source : ndarray of int16, shape (P,)
        Index into `sources`.
    row : ndarray of int64, shape (P,)
        Row in its drive.
    plain : bool
        Whether y are the paper's plain differences, which depend on the horizon: for reproduction only.
    learner : {"split", "iol"}
        What chose the points: cells by themselves, or one dictionary of `capacity` points (learning/iol.py).
    trust : Trust
        The share of each output's correction that is applied, by every predictor and every export.
    found_effects : int
        How many effects, the last of `vehicle`, training found beyond the vehicle file (scoring/found_lags.py).
    information : ndarray, shape (sum of n^2,), or None
        Sums of e e^T over the labels of each cell of n points, the matrices of its cells one after another: a
        label at z observes e.f, with f the process at the points and e = K^-1 k(z) [1]. None where a set absorbs
        no label beyond its points: with forgetting, by `iol`, and in files of older versions.
    absorbed : ndarray, shape (P, 3), or None
        Sums of e y^T over the same labels, in the units of y.
    """

    vehicle: Vehicle
    features: FeatureSet
    region: Region
    grid: Grid
    kernel: Kernel
    horizon: float
    capacity: int
    threshold: float
    forgetting: float | None
    cell_numbers: np.ndarray
    offsets: np.ndarray
    z: np.ndarray
    y: np.ndarray
    gamma: np.ndarray
    t: np.ndarray
    source: np.ndarray
    row: np.ndarray
    sources: tuple[SetSource, ...] = ()
    plain: bool = False
    learner: str = "split"
    trust: Trust = field(default_factory=Trust.full)
    found_effects: int = 0
    information: np.ndarray | None = None
    absorbed: np.ndarray | None = None

    @property
    def nominal_vehicle(self) -> Vehicle:
        """The vehicle of the file that the set was trained with, without what training found beyond it."""
        effects = self.vehicle.effects
        return replace(self.vehicle, effects=effects[: len(effects) - self.found_effects])

    @property
    def found(self) -> tuple[EffectSpec, ...]:
        """Effects that training found beyond the vehicle file; the set corrects the model with them."""
        return self.vehicle.effects[len(self.vehicle.effects) - self.found_effects :]

    @property
    def size(self) -> int:
        """Number of points."""
        return len(self.z)

    @property
    def cell_count(self) -> int:
        """Number of non-empty cells."""
        return len(self.cell_numbers)

    @property
    def nbytes(self) -> int:
        """Memory of the points and cells [bytes]."""
        names = ("cell_numbers", "offsets", *_POINT_FIELDS, *SUMS)
        return sum(values.nbytes for name in names if (values := getattr(self, name)) is not None)

    def sums(self) -> tuple[np.ndarray, np.ndarray]:
        """Return `information` and `absorbed`; where there are none, those of the points' own labels."""
        if self.information is not None and self.absorbed is not None:
            return self.information, self.absorbed
        counts = np.diff(self.offsets).tolist()
        return np.concatenate([np.zeros(0), *(np.eye(n).ravel() for n in counts)]), self.y

    def valid_share(self) -> float | None:
        """Return the share of the valid region's cells that hold points; None for features other than z2."""
        if not self.features.is_z2:
            return None
        valid = valid_cells(self.vehicle, self.region, self.grid)
        return float(np.isin(valid, self.cell_numbers).mean()) if len(valid) else None


_POINT_FIELDS = ("z", "y", "gamma", "t", "source", "row")


def write_set(training_set: TrainingSet, path: str | Path) -> None:
    """Write a trained set as an Arrow IPC file, one record batch a non-empty cell, whole or not at all.

    Equal sets give equal bytes: nothing of when, where or by whom is stored.
    """
    described = _describe(training_set)
    described["content_sha256"] = content_digest(described, training_set)
    metadata = {b"split": json.dumps(described, sort_keys=True, allow_nan=False).encode()}
    schema = _schema(training_set.features).with_metadata(metadata)
    columns = _columns(training_set)
    batch = pa.record_batch([pa.array(columns[name]) for name in schema.names], schema=schema)
    beside = sums_by_cell(training_set.information, training_set.absorbed, training_set.offsets)
    offsets = training_set.offsets.tolist()
    with atomic_path(path) as temporary, pa.ipc.new_file(str(temporary), schema) as writer:
        for cell, (first, last) in enumerate(pairwise(offsets)):
            writer.write_batch(batch.slice(first, last - first), custom_metadata=beside[cell] if beside else None)


def read_set(path: str | Path, *, kernel_numbers: float = NUMBERS_WHEN_READ) -> TrainingSet:
    """Read a trained set whole; check its content against the digest in it, and against what learning leaves.

    Parameters
    ----------
    kernel_numbers : float
        As for `wrong_gains`, which checks the gains.

    Raises
    ------
    SetError
        If the file is missing, truncated, damaged, or of another version.
    """
    with SetFile(path) as file:
        return file.read(kernel_numbers)


class SetFile:
    """A trained set on disk, mapped into memory; one cell is read by reading one batch.

    Attributes
    ----------
    header : TrainingSet
        Everything but the points.

    Raises
    ------
    SetError
        If the file is missing, truncated, damaged, or of another version.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            what = "is a folder, a trained set is a file" if self.path.is_dir() else "no such file"
            raise SetError(what, where=str(path), advice="Name the file that `split train` wrote.")
        try:
            self._source = pa.memory_map(str(path))
            self._reader = pa.ipc.open_file(self._source)
            self._described = parse_json((self._reader.schema.metadata or {})[b"split"])
            found = self._described["format"]
        except PermissionError as error:
            raise SetError("cannot be read (Permission denied)", where=str(path)) from error
        except (pa.ArrowException, OSError, ValueError, KeyError, TypeError) as error:
            own = self.path.suffix == ".split"
            what = "is not a whole trained set (truncated or damaged)" if own else "is no trained set"
            advice = _RETRAIN if own else "A trained set is the NAME.split that `split train` writes."
            raise SetError(what, where=str(path), advice=advice) from error
        if found not in _READABLE:
            raise SetError(
                f"is a trained set of format {found!r}, this version reads {SET_FORMAT!r}",
                where=str(path),
                advice=_RETRAIN,
            )
        try:
            self.header = _header_from(self._described)
            check_header(self._described, self.header.features.names, self.header.vehicle.digest())
            if self._reader.schema.remove_metadata() != _schema(self.header.features):
                raise ValueError("its columns are not those of a trained set")
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError, VehicleError) as error:
            raise SetError(f"its header is damaged ({error})", where=str(path), advice=_RETRAIN) from error
        self.cell_count = self._reader.num_record_batches

    def __enter__(self) -> SetFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._source.close()

    def read(self, kernel_numbers: float = NUMBERS_WHEN_READ) -> TrainingSet:
        """Return the whole set, its content checked; see `read_set`."""
        batches = [self._batch(index) for index in range(self.cell_count)]
        lengths = [batch.num_rows for batch in batches]
        offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        try:
            table = pa.Table.from_batches(batches, self._reader.schema).combine_chunks()
            numbers = table["cell"].to_numpy()
            points = _points_from(table, self.header.features)
        except (pa.ArrowException, ValueError) as error:
            raise self._damaged(str(error)) from error
        first = offsets[:-1]
        if not all(lengths) or not np.array_equal(np.repeat(numbers[first], lengths), numbers):
            raise self._damaged("a batch is not one cell")
        try:
            if self._described["format"] == SET_FORMAT:
                points |= read_sums(self._reader, lengths)
            check_points(self._described, lengths, points, len(self.header.sources))
            whole = _with_points(self.header, numbers[first], offsets, points)
            stored = self._described.pop("content_sha256", "")
            if content_digest(self._described, whole) != stored:
                raise ValueError("its content does not match the digest in it")
            if (np.diff(whole.cell_numbers) <= 0).any():
                raise ValueError("its cells are out of order")
            elsewhere = points_elsewhere(whole)
            if elsewhere:
                raise ValueError(f"{elsewhere} of {whole.size} points are outside their cells")
            wrong = wrong_gains(whole, kernel_numbers)
            if wrong:
                raise ValueError(f"the gains of {wrong} of {whole.size} points are not those of the points")
            check_sums(whole.kernel, points, offsets, sum(source.accepted for source in whole.sources))
        except ValueError as error:
            raise self._damaged(str(error)) from error
        return whole

    def _batch(self, index: int) -> pa.RecordBatch:
        try:
            batch = self._reader.get_batch(index)
            batch.validate(full=True)
            return batch
        except (pa.ArrowException, OSError, ValueError) as error:
            raise self._damaged(str(error).splitlines()[0]) from error

    def _damaged(self, reason: str) -> SetError:
        return SetError(f"is damaged ({reason})", where=str(self.path), advice=_RETRAIN)


def _schema(features: FeatureSet) -> pa.Schema:
    number = [f"z_{name}" for name in features.names] + [f"y_{name}" for name in OUTPUTS] + ["gamma", "t"]
    fields = [("cell", pa.int64()), *((name, pa.float64()) for name in number)]
    return pa.schema([*fields, ("source", pa.int16()), ("row", pa.int64())])


def _columns(training_set: TrainingSet) -> dict[str, np.ndarray]:
    names = training_set.features.names
    return {
        "cell": np.repeat(training_set.cell_numbers, np.diff(training_set.offsets)),
        **{f"z_{name}": training_set.z[:, i] for i, name in enumerate(names)},
        **{f"y_{name}": training_set.y[:, i] for i, name in enumerate(OUTPUTS)},
        **{name: getattr(training_set, name) for name in ("gamma", "t", "source", "row")},
    }


def _points_from(table: pa.Table | pa.RecordBatch, features: FeatureSet) -> dict[str, np.ndarray]:
    def column(name: str) -> np.ndarray:
        values: np.ndarray = table.column(name).to_numpy()
        return values

    return {
        "z": np.stack([column(f"z_{name}") for name in features.names], axis=1),
        "y": np.stack([column(f"y_{name}") for name in OUTPUTS], axis=1),
        # Copies: the file may be replaced or closed while its points are in use.
        **{name: column(name).copy() for name in ("gamma", "t", "source", "row")},
    }


def _with_points(
    header: TrainingSet, numbers: np.ndarray, offsets: np.ndarray, points: Mapping[str, np.ndarray]
) -> TrainingSet:
    columns: dict[str, Any] = dict(points)
    return replace(header, cell_numbers=numbers.copy(), offsets=offsets, **columns)


def _describe(training_set: TrainingSet) -> dict[str, Any]:
    """Return everything but the points, as the file's metadata holds it; infinite bounds as null."""
    s = training_set
    return {
        "format": _WITHOUT_SUMS if s.information is None else SET_FORMAT,
        "vehicle": vehicle_to_mapping(s.vehicle),
        "vehicle_digest": s.vehicle.digest(),
        "features": list(s.features.names),
        "region": asdict(s.region),
        "grid": {
            "edges": list(s.grid.edges),
            "lower": [_finite(value) for value in s.grid.lower],
            "upper": [_finite(value) for value in s.grid.upper],
        },
        "kernel": {
            "length_scales": s.kernel.length_scales.tolist(),
            "signal_variance": s.kernel.signal_variance.tolist(),
            "noise_variance": s.kernel.noise_variance.tolist(),
            "origin": s.kernel.origin,
        },
        "horizon": s.horizon,
        "plain": s.plain,
        "trust": {
            **asdict(s.trust),
            "share": list(s.trust.share),
            "doubt": None if s.trust.doubt is None else list(s.trust.doubt),
        },
        "capacity": s.capacity,
        "threshold": s.threshold,
        "forgetting": s.forgetting,
        **({} if s.learner == "split" else {"learner": s.learner}),
        **({"found_effects": s.found_effects} if s.found_effects else {}),
        "counts": {"points": s.size, "cells": s.cell_count},
        "sources": [_described_source(source) for source in s.sources],
    }


def _described_source(source: SetSource) -> dict[str, Any]:
    content = {**asdict(source), "rejected": dict(source.rejected)}
    found = {name: list(clauses) for name in FOUND if (clauses := content.pop(name))}
    return {**content, **found}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _header_from(described: Mapping[str, Any]) -> TrainingSet:
    """Return the set that `_describe` described, without points."""
    vehicle = vehicle_from_mapping(described["vehicle"], where="the vehicle of the set")
    features = FeatureSet(tuple(described["features"]))
    grid = described["grid"]
    return TrainingSet(
        vehicle=vehicle,
        features=features,
        region=Region(**described["region"]),
        grid=Grid(
            tuple(grid["edges"]),
            tuple(-np.inf if value is None else value for value in grid["lower"]),
            tuple(np.inf if value is None else value for value in grid["upper"]),
        ),
        kernel=Kernel(**described["kernel"]),
        **{name: described[name] for name in ("horizon", "capacity", "threshold", "forgetting", "plain")},
        learner=described.get("learner", "split"),
        found_effects=described.get("found_effects", 0),
        cell_numbers=np.empty(0, dtype=np.int64),
        offsets=np.zeros(1, dtype=np.int64),
        z=np.empty((0, len(features.names))),
        y=np.empty((0, len(OUTPUTS))),
        gamma=np.empty(0),
        t=np.empty(0),
        source=np.empty(0, dtype=np.int16),
        row=np.empty(0, dtype=np.int64),
        sources=tuple(SetSource(**{**s, **{n: tuple(s.get(n, ())) for n in FOUND}}) for s in described["sources"]),
        trust=Trust.full() if described["format"] == _WITHOUT_TRUST else Trust(**described["trust"]),
    )


def points_elsewhere(training_set: TrainingSet) -> int:
    """Return how many points lie outside the slip angles of the region, or in another cell than theirs."""
    s = training_set
    index, has_cell = s.grid.index(s.z)
    if s.features.is_z2:
        slips = s.z[:, 0], s.z[:, 1]
        has_cell = has_cell & s.region.inside_slip(*slips) & s.region.inside_slip_difference(*slips)
    return int((~has_cell | (s.grid.pack(index) != np.repeat(s.cell_numbers, np.diff(s.offsets)))).sum())


def wrong_gains(training_set: TrainingSet, kernel_numbers: float = np.inf) -> int:
    """Return how many stored gains are not those of the points, gamma_i = 1/[K^-1]_ii.

    Parameters
    ----------
    kernel_numbers : float
        Numbers that the kernel matrices of the checked cells may have together. Where all cells have more, each
        k-th cell is checked, with the least k that keeps to it.

    Notes
    -----
    Cells of one size are inverted together. A change E of K changes gamma_i by g' E g, with g the i-th column of
    K^-1 over its i-th number. Allowed are 1e-9, and what such a change does that is as large as rounding or the
    jitter that learning may add: near-singular cells have no gains more exact than that.
    """
    s = training_set
    counts, wrong = np.diff(s.offsets), 0
    each = max(1, math.ceil(np.square(counts).sum() / kernel_numbers))
    for n in np.unique(counts).tolist():
        cells = np.flatnonzero(counts == n)[::each]
        at_once = max(1, _NUMBERS_AT_ONCE // n**2)
        for first in range(0, len(cells), at_once):
            rows = s.offsets[cells[first : first + at_once], None] + np.arange(n)
            with np.errstate(over="ignore"):  # far apart, by forged length scales: not correlated
                kernel = s.kernel.correlation(s.z[rows], s.z[rows])
            try:
                inverse = np.linalg.inv(kernel)
            except np.linalg.LinAlgError:
                inverse = np.linalg.inv(kernel + _JITTER * np.eye(n))
            own = np.diagonal(inverse, axis1=1, axis2=2)
            change = np.square(inverse / own[:, None, :]).sum(axis=1)
            allowed = _GAIN_TOLERANCE + (_JITTER + 4 * n * np.finfo(float).eps) * change
            wrong += int((~(np.abs(1.0 / own - s.gamma[rows]) <= allowed)).sum())
    return wrong


def content_digest(described: Mapping[str, Any], training_set: TrainingSet) -> str:
    """Return the SHA-256 that a set's file keeps of its header, without the digest itself, and of its points."""
    digest = hashlib.sha256(json.dumps(described, sort_keys=True, allow_nan=False).encode())
    sums = {name: values for name in SUMS if (values := getattr(training_set, name)) is not None}
    for name, values in (_columns(training_set) | sums).items():
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
