"""The canonical recording: one row a sample on a uniform clock, SI units, ISO 8855 at the CG."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from split_cli.errors import DriveError, nearest_names, reason_of
from split_cli.files import atomic_path, refuse_no_regular_file, sha256_of_file
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.columns_of_file import ColumnsOfFile, column_in_si, columns_of_csv
from split_cli.logs.drive_metadata import (
    DriveMetadata,
    NoiseEstimate,
    Source,
    metadata_from_schema,
    metadata_of_drive,
    schema_of,
)
from split_cli.logs.scratch import LONG, GrowingColumn, in_pieces, let_go
from split_cli.signals import CHANNELS, REQUIRED_CHANNELS, split_name_and_unit

__all__ = [
    "INPUT_CHANNELS",
    "Drive",
    "DriveMetadata",
    "NoiseEstimate",
    "Source",
    "metadata_of_drive",
    "open_drive",
    "read_drive",
    "unstated_inputs",
    "with_inputs_alike",
    "write_drive",
]

INPUT_CHANNELS = ("T", "delta")
_MAKE_A_DRIVE = "Give a recording to `split ingest` first."
_GROUP_ROWS = 2**20
#: Rows from which on `open_drive` leaves columns in the file [1]: 11 of them take 46 MB.
LONG_ROWS = 2**19


@dataclass(frozen=True)
class Drive:
    """A recording on a uniform clock.

    Attributes
    ----------
    name : str
        Name of the file, without folder.
    columns : mapping of str to ndarray
        Channel name to samples `(N,)`, float64, SI units; always has ``t`` and the required channels. Of a long
        drive that `open_drive` opened each is read from the file when it is asked for.
    segment : ndarray of int32, shape (N,)
        Changes at every gap; nothing may be computed across a change.
    period : float
        Sample period [s].
    sha256 : str
        Of the file it was read from; empty for a drive made in memory.
    """

    name: str
    columns: Mapping[str, np.ndarray]
    segment: np.ndarray
    period: float
    metadata: DriveMetadata = DriveMetadata()
    sha256: str = ""

    def __post_init__(self) -> None:
        missing = [name for name in ("t", *REQUIRED_CHANNELS) if name not in self.columns]
        if missing:
            advice = nearest_names(missing[0], self.columns) + " Map it with `split ingest --map`."
            raise DriveError(f"the drive lacks {', '.join(missing)}", where=self.name, advice=advice)
        length = len(self.segment)
        if not self.stays_in_file:
            length = len(self.columns["t"])
            for name, values in self.columns.items():
                if len(values) != length:
                    raise DriveError(f"column {name} has {len(values)} samples, t has {length}", where=self.name)
        if len(self.segment) != length:
            raise DriveError(f"segment has {len(self.segment)} samples, t has {length}", where=self.name)

    def __len__(self) -> int:
        return len(self.segment)

    def __contains__(self, channel: str) -> bool:
        return channel in self.columns

    def __getitem__(self, channel: str) -> np.ndarray:
        """Return the samples of a channel, shape (N,).

        Raises
        ------
        DriveError
            If the drive has no such channel; names the nearest.
        """
        if channel not in self.columns:
            advice = nearest_names(channel, self.columns)
            raise DriveError(f"no channel {channel!r}", where=self.name, advice=advice)
        return self.columns[channel]

    @property
    def stays_in_file(self) -> bool:
        """Whether columns are read when they are asked for, as `open_drive` leaves those of a long drive."""
        return isinstance(self.columns, ColumnsOfFile)

    @property
    def rate(self) -> float:
        """Sample rate [Hz]."""
        return 1.0 / self.period

    @property
    def held(self) -> tuple[str, ...]:
        """Inputs (T, delta) that keep their value until the next sample; the others run in straight lines."""
        return tuple(name for name in INPUT_CHANNELS if self.metadata.between.get(name) == "held")

    def with_held(self, channels: Sequence[str]) -> Drive:
        """Return the drive with these inputs held between samples and the other inputs as they were.

        Raises
        ------
        DriveError
            If a channel is none of the inputs.
        """
        for name in channels:
            if name not in INPUT_CHANNELS:
                raise DriveError(
                    f"{name!r} cannot be held between samples, only the inputs {' and '.join(INPUT_CHANNELS)} can",
                    where=self.name,
                    advice=nearest_names(name, INPUT_CHANNELS),
                )
        return self.with_between({**self.metadata.between, **dict.fromkeys(channels, "held")})

    def with_between(self, between: Mapping[str, str]) -> Drive:
        """Return the drive with another `DriveMetadata.between`."""
        return replace(self, metadata=replace(self.metadata, between=between))

    @property
    def has_position(self) -> bool:
        """Whether X, Y and yaw were recorded or derived."""
        return all(name in self.columns for name in ("X", "Y", "yaw"))

    def segments(self) -> list[slice]:
        """Return the runs of rows without a gap, in order."""
        if len(self) == 0:
            return []
        inner = np.concatenate(
            [
                piece.start + 1 + np.flatnonzero(np.diff(self.segment[piece.start : piece.stop + 1]))
                for piece in in_pieces(len(self))
            ]
        )
        starts, ends = np.append(0, inner), np.append(inner, len(self))
        return [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True)]

    def stretch(self, first: int, last: int) -> Drive:
        """Return the rows [first, last) as they are: views of the columns, or a part of a long drive's file."""
        if isinstance(self.columns, ColumnsOfFile):
            columns = self.columns.rows(first, last)
        else:
            columns = {name: values[first:last] for name, values in self.columns.items()}
        return replace(self, columns=columns, segment=self.segment[first:last])

    def part(self, name: str, first: int, last: int) -> np.ndarray:
        """Return the rows [first, last) of one column; of a long drive nothing else is read."""
        if self.stays_in_file:
            return self.columns.rows(first, last, (name,))[name]
        return self.columns[name][first:last]

    def at(self, name: str, rows: np.ndarray) -> np.ndarray:
        """Return one column at some rows, shape (N,), which ascend; of a long drive a piece is read at a time."""
        values = np.empty(len(rows))
        for first, last in _spans(self):
            low, high = np.searchsorted(rows, (first, last))
            if low < high:
                values[low:high] = self.part(name, first, last)[rows[low:high] - first]
        return values

    def select(self, rows: np.ndarray | slice) -> Drive:
        """Return the drive restricted to `rows` (a slice or a boolean mask); a removed run starts a segment."""
        if isinstance(rows, slice):
            index = np.arange(len(self))[rows]
        else:
            rows = np.asarray(rows)
            index = np.flatnonzero(rows) if rows.dtype == bool else rows
        segment = self.segment[index]
        broken = np.diff(index, prepend=index[0] - 1 if len(index) else 0) != 1
        changed = np.diff(segment, prepend=segment[0] if len(segment) else 0) != 0
        renumbered = np.cumsum(broken | changed).astype(np.int32)
        columns = {name: values[index] for name, values in self.columns.items()}
        return Drive(self.name, columns, renumbered, self.period, self.metadata, self.sha256)


def read_drive(path: str | Path, held: Sequence[str] = ()) -> Drive:
    """Read a drive: a Parquet that `split ingest` wrote, or a plain Parquet or CSV with a drive's columns.

    Headers may carry units (``vx(km/h)``); without units SI is taken, as docs/formats.md says.
    Inputs named in `held` keep their value between samples, whatever the file says of them.

    Raises
    ------
    DriveError
        If the file cannot be read, lacks a required column, is empty, holds non-finite values in a required
        column, or its clock is not uniform inside segments.
    """
    path = _existing(path)
    try:
        drive = _drive_from_table(_read_table(path), path)
    except (UnicodeDecodeError, pa.ArrowException) as error:  # text is decoded when it is asked for
        advice = "Ingest the recording again."
        raise DriveError(f"is damaged ({reason_of(error)})", where=str(path), advice=advice) from error
    return drive.with_held(held) if held else drive


def open_drive(path: str | Path, held: Sequence[str] = (), beside: int = 1) -> Drive:
    """Return a drive as `read_drive` does; the columns of a long one stay in its file.

    The drive is equal to the one that is read. Every access of a column reads it, so it serves what goes through a
    drive piece by piece (`Drive.stretch`) or column by column. A large CSV is copied into a temporary Parquet that
    goes with the drive.

    Parameters
    ----------
    beside : int
        Drives that are open at a time: each is then long sooner.
    """
    path = _existing(path)
    try:
        columns = columns_of_csv(path) if path.suffix.lower() == ".csv" else ColumnsOfFile(path)
    except (pa.ArrowException, OSError, ValueError):
        columns = None
    if columns is None or columns.length * beside <= LONG_ROWS or not columns.is_plain or "t" not in columns:
        return read_drive(path, held)  # which says what is wrong
    metadata, period = metadata_from_schema(columns.schema.metadata or {}, path)
    segment = None
    if "segment" in columns:
        growing = GrowingColumn(np.int32)
        for rows in in_pieces(columns.length):
            part = columns.rows(rows.start, rows.stop, ("segment",))["segment"]
            growing.append(_whole(part, path, rows.start))
        segment = growing.finished()
    drive = _checked_drive(columns.without("segment"), segment, period, metadata, path)
    return drive.with_held(held) if held else drive


def _existing(path: str | Path) -> Path:
    path = Path(path)
    refuse_no_regular_file(path, DriveError)
    if not path.is_file():
        what = "is a folder, a drive is a file" if path.is_dir() else "no such file"
        raise DriveError(what, where=str(path), advice="Name the Parquet file that `split ingest` wrote.")
    return path


def _read_table(path: Path) -> pa.Table:
    try:
        if path.suffix.lower() == ".csv":
            table = pa.csv.read_csv(path)
            refuse_many_columns(table.num_columns, str(path))
        else:
            with pa.parquet.ParquetFile(path, page_checksum_verification=True) as file:
                refuse_many_columns(len(file.schema_arrow), str(path))
                table = file.read()
    except (pa.ArrowInvalid, pa.ArrowException, OSError, ValueError) as error:
        reason = reason_of(error)
        if "magic bytes not found" in reason:
            reason = "it is a trained set" if path.suffix == ".split" else "it is no Parquet file"
        advice = f"A drive is the Parquet that `split ingest` writes. {_MAKE_A_DRIVE}"
        if "CRC" in reason:
            reason, advice = "its content does not match its checksums", "Copy it or ingest its log again."
        raise DriveError(f"cannot be read as a drive ({reason})", where=str(path), advice=advice) from error
    if table.num_rows < 2:
        raise DriveError(f"holds {table.num_rows} samples", where=str(path), advice="A drive needs two or more.")
    return table


def _drive_from_table(table: pa.Table, path: Path) -> Drive:
    metadata, period = metadata_from_schema(table.schema.metadata or {}, path)
    columns: dict[str, np.ndarray] = {}
    segment: np.ndarray | None = None
    # A column goes as soon as it is read, so that a long drive is not held twice.
    titles, left, long = table.column_names, deque(table.columns), table.num_rows >= LONG
    del table
    for title in titles:
        name, unit = split_name_and_unit(title)
        column = left.popleft()
        try:
            values = np.array(column.to_numpy(), dtype=float)
        except (TypeError, ValueError):
            continue  # text columns ride along in logs; a drive has no use for them
        finally:
            del column
            if long:
                pa.default_memory_pool().release_unused()
        if name == "segment":
            segment = _whole(values, path)
        else:
            if name in columns:
                raise DriveError(f"two columns are {name}", where=str(path), advice="Leave one.")
            columns[name] = column_in_si(values, name, unit, path)
    if "t" not in columns:
        # Cells of words are left out above: of a logger's table there may be no column left to name.
        advice = f"{nearest_names('t', titles)} {_MAKE_A_DRIVE}"
        raise DriveError("is no drive: it has no column t", where=str(path), advice=advice)
    return _checked_drive(columns, segment, period, metadata, path)


def _whole(values: np.ndarray, path: Path, first: int = 0) -> np.ndarray:
    """Return the numbers of segments from row `first` on as int32, shape (N,).

    Raises
    ------
    DriveError
        If a number is missing or not whole.
    """
    bad = np.flatnonzero(~(np.isfinite(values) & (values == np.round(values)) & (np.abs(values) < 2**31)))
    if len(bad):
        what = f"segment holds values that are no whole numbers, the first in row {first + bad[0] + 1}"
        advice = "Number every row, or leave the column out: gaps in time then part the segments."
        raise DriveError(what, where=str(path), advice=advice)
    return values.astype(np.int32)


def _checked_drive(
    columns: Mapping[str, np.ndarray],
    segment: np.ndarray | None,
    period: float | None,
    metadata: DriveMetadata,
    path: Path,
) -> Drive:
    """Return a drive of columns, its segments and period found where the file does not say them."""
    if segment is None:
        segment = _segments_from_time(columns["t"], path)
    if period is None:  # of a long drive all its times take more memory than all that follows
        period = _period_from_time(columns["t"], segment, path)
    drive = Drive(path.name, columns, segment, period, metadata, sha256_of_file(path))
    _check_drive(drive, path)
    return drive


def _check_drive(drive: Drive, path: Path) -> None:
    for name in ("t", *REQUIRED_CHANNELS):
        limit = CHANNELS[name].limit
        count, missing, beyond = 0, [], []  # of each piece that has some the first row; and its value
        for first, last in _spans(drive):
            values = drive.part(name, first, last)
            bad = np.flatnonzero(~np.isfinite(values))
            count += len(bad)
            missing += (first + bad[:1]).tolist()
            beyond += [(first + int(at), values[at]) for at in np.flatnonzero(np.abs(values) > limit)[:1]]
        if count:
            what = f"{count} non-finite values in {name}, the first in row {missing[0]}"
            advice = "Run the recording through `split ingest`, which drops and counts them."
            if count == len(drive):
                what = f"{name} holds no number in any of its {count} rows"
                advice = "Was it recorded? Name another source for it in the map of `split ingest`."
            raise DriveError(what, where=str(path), advice=advice)
        if beyond:
            row, value = beyond[0]
            what = f"{name} is {value:g} in row {row}, beyond {limit:g} no number is a measurement"
            advice = "Check units, or run the recording through `split ingest`, which drops and counts them."
            raise DriveError(what, where=str(path), advice=advice)
    for first, last in _spans(drive):
        end = min(last + 1, len(drive))
        step = np.diff(drive.part("t", first, end))
        inside = drive.segment[first + 1 : end] == drive.segment[first : end - 1]
        uneven = np.flatnonzero(inside & (np.abs(step - drive.period) > 0.02 * drive.period + 1e-6))
        if len(uneven):
            row = first + int(uneven[0])
            raise DriveError(
                f"the clock is not uniform: row {row} to {row + 1} takes {step[uneven[0]]:.6g} s, "
                f"the period is {drive.period:.6g} s",
                where=str(path),
                advice="Run the recording through `split ingest`.",
            )


def _spans(drive: Drive) -> Iterator[tuple[int, int]]:
    """Yield first rows and ends of pieces of which a long drive's column is read at a time."""
    for first in range(0, len(drive), _GROUP_ROWS):
        yield first, min(first + _GROUP_ROWS, len(drive))


def _segments_from_time(time: np.ndarray, path: Path) -> np.ndarray:
    step = np.diff(time)
    if len(step) and not np.all(step > 0):
        row = int(np.flatnonzero(~(step > 0))[0])
        what = f"time does not increase at row {row + 1} ({time[row]:.9g} then {time[row + 1]:.9g} s)"
        advice = "Run the recording through `split ingest`, which drops and counts such samples."
        raise DriveError(what, where=str(path), advice=advice)
    return np.concatenate([[0], np.cumsum(step > 1.5 * np.median(step))]).astype(np.int32)


def _period_from_time(time: np.ndarray, segment: np.ndarray, path: Path) -> float:
    inside = np.diff(segment) == 0
    step = np.diff(time)[inside]
    if not len(step) or not np.isfinite(step).all():
        advice = "Run the recording through `split ingest`, which puts it on one clock."
        raise DriveError("no two samples follow each other without a gap", where=str(path), advice=advice)
    return float(np.round(np.median(step), 9))


def unstated_inputs(drives: Sequence[Drive]) -> tuple[str, ...]:
    """Return what to say of inputs whose course between samples no drive's metadata tells; empty if all do."""
    unstated = {name: None for drive in drives for name in INPUT_CHANNELS if name not in drive.metadata.between}
    if not unstated:
        return ()
    return (
        f"{' and '.join(unstated)}: the recording does not say what happens between samples, so straight lines are "
        "taken. A command that is kept until the next sample then comes half a sample early, which looks like a delay. "
        f"For such commands give --held {','.join(unstated)}",
    )


def with_inputs_alike(groups: Sequence[Sequence[Drive]]) -> tuple[list[list[Drive]], tuple[str, ...]]:
    """Return groups of drives that are compared, with inputs that do the same between samples, and notes on them.

    Where some drives say that an input is held until the next sample, or runs on continuously, those that say nothing
    take it from them. Read in two ways, one and the same command would differ by a delay of half a sample. Drives that
    contradict each other stay as they are, which a note says.
    """
    out, notes = [list(group) for group in groups], []
    for name in INPUT_CHANNELS:
        every = [drive for group in out for drive in group]
        stated = {drive.metadata.between[name]: drive.name for drive in every if name in drive.metadata.between}
        if len(stated) > 1:
            one, other = (f"{how} in {where}" for how, where in stated.items())
            notes.append(
                f"{name} is {one} and {other}. That alone looks like a delay of half a sample; give --held {name} if "
                "it is a command in all of them"
            )
            continue
        for how, where in stated.items():
            for drive in every:
                if name not in drive.metadata.between:
                    notes.append(f"{drive.name} does not say what {name} does between samples: {how}, as in {where}")
            out = [[drive.with_between({name: how, **drive.metadata.between}) for drive in group] for group in out]
    return out, tuple(notes)


def write_drive(drive: Drive, path: str | Path) -> None:
    """Write a drive as Parquet, whole or not at all. No time of writing is stored: equal drives, equal bytes."""
    described = schema_of(drive.metadata, drive.period)
    # Checksums: a bit that flips on a disk must not become a velocity.
    options = {"compression": "zstd", "write_page_checksum": True}
    schema = _table_of(drive.stretch(0, 0)).schema.with_metadata(described)
    with atomic_path(path) as temporary, pa.parquet.ParquetWriter(temporary, schema, **options) as writer:
        for first in range(0, len(drive), _GROUP_ROWS):  # a long drive has no room for its table
            part = drive.stretch(first, min(first + _GROUP_ROWS, len(drive)))
            writer.write_table(_table_of(part).replace_schema_metadata(described), row_group_size=_GROUP_ROWS)
            let_go()


def _table_of(drive: Drive) -> pa.Table:
    columns = {name: pa.array(values) for name, values in drive.columns.items()}
    return pa.table({**columns, "segment": pa.array(drive.segment.astype(np.int32))})
