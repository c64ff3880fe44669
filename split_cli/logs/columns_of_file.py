"""Columns of a long drive, read from its file when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from split_cli.errors import DriveError, reason_of
from split_cli.files import ScratchFolder
from split_cli.logs.budget import refuse_many_columns
from split_cli.signals import CHANNELS, convert_to_si, split_name_and_unit

_BATCH = 2**16  # rows decoded at once
#: A CSV of fewer bytes is read as a whole [bytes]: it has some 300,000 rows of 11 columns.
SMALL_CSV = 2**25


class ColumnsOfFile(Mapping[str, np.ndarray]):
    """The columns of a Parquet, as a mapping that holds none of them.

    A column that is asked for is read as a whole; `rows` reads some rows of all. The file stays open, so that all
    of it is of one state.

    Raises
    ------
    pa.ArrowException, OSError
        If the file is no Parquet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.keeps: object = None  # what has to last as long as the columns
        self._file = pa.parquet.ParquetFile(path, page_checksum_verification=True)
        self.schema = self._file.schema_arrow
        refuse_many_columns(len(self.schema), str(path))
        self.length: int = self._file.metadata.num_rows
        titles = [(*split_name_and_unit(title), title) for title in self.schema.names]
        self._titles = {name: (title, unit) for name, unit, title in titles}

    def __reduce__(self) -> tuple[object, ...]:
        """Travel by name: another process opens the file for itself."""
        return _reopened, (self.path, tuple(self._titles))

    @property
    def is_plain(self) -> bool:
        """Whether all columns are numbers, each of a name of its own."""
        numbers = (pa.types.is_floating(field.type) or pa.types.is_integer(field.type) for field in self.schema)
        return len(self._titles) == len(self.schema.names) and all(numbers)

    def without(self, name: str) -> ColumnsOfFile:
        """Return the mapping without one column."""
        other = object.__new__(ColumnsOfFile)
        other.__dict__.update(self.__dict__)
        other._titles = {known: title for known, title in self._titles.items() if known != name}
        return other

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a whole column, shape (N,)."""
        return self.rows(0, self.length, (name,))[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._titles)

    def __len__(self) -> int:
        return len(self._titles)

    def __contains__(self, name: object) -> bool:
        return name in self._titles

    def rows(self, first: int, last: int, names: Sequence[str] | None = None) -> dict[str, np.ndarray]:
        """Return the rows [first, last) of some columns, by default of all, in SI.

        Raises
        ------
        DriveError
            If the file is damaged.
        KeyError
            If a column is not there.
        """
        titles = self._titles if names is None else {name: self._titles[name] for name in names}
        out = {name: np.empty(last - first) for name in titles}
        counts = [self._file.metadata.row_group(i).num_rows for i in range(self._file.num_row_groups)]
        ends = np.cumsum(counts)
        groups = [i for i, end in enumerate(ends) if end > first and end - counts[i] < last]
        at = int(ends[groups[0]] - counts[groups[0]]) if groups else last
        wanted = [title for title, _ in titles.values()]
        try:
            for batch in self._file.iter_batches(_BATCH, row_groups=groups, columns=wanted, use_threads=False):
                low, high = max(first, at), min(last, at + batch.num_rows)
                if low < high:
                    part = batch.slice(low - at, high - low)
                    for name, (title, unit) in titles.items():
                        values = np.array(part.column(title).to_numpy(zero_copy_only=False), dtype=float)
                        out[name][low - first : high - first] = column_in_si(values, name, unit, self.path)
                at += batch.num_rows
                if at >= last:
                    break
        except (pa.ArrowException, OSError) as error:
            advice = "Ingest the log again."
            raise DriveError(f"is damaged ({reason_of(error)})", where=str(self.path), advice=advice) from error
        return out


def _reopened(path: Path, names: Sequence[str]) -> ColumnsOfFile:
    columns = ColumnsOfFile(path)
    columns._titles = {name: columns._titles[name] for name in names}
    return columns


def columns_of_csv(path: Path) -> ColumnsOfFile | None:
    """Return the columns of a large CSV by way of a temporary Parquet; None of a small one, or without numbers.

    Raises
    ------
    pa.ArrowException, OSError
        If the file is no CSV, or a column's first megabytes are of another type than the rest.
    """
    if path.stat().st_size < SMALL_CSV:
        return None
    scratch = ScratchFolder()
    copy = scratch.path / "columns.parquet"
    with pa.csv.open_csv(path) as reader:
        numbers = [field.name for field in reader.schema if not pa.types.is_string(field.type)]
        if not numbers or len(set(reader.schema.names)) < len(reader.schema.names):
            return None
        schema = pa.schema([pa.field(name, pa.float64()) for name in numbers])
        with pa.parquet.ParquetWriter(copy, schema, compression="zstd", write_page_checksum=True) as writer:
            for batch in reader:
                writer.write_table(pa.Table.from_batches([batch]).select(numbers).cast(schema))
    columns = ColumnsOfFile(copy)
    columns.keeps = scratch
    return columns


def column_in_si(values: np.ndarray, name: str, unit: str | None, path: Path) -> np.ndarray:
    """Return a column of a drive's file in SI; without a unit SI is taken."""
    if not unit or name not in CHANNELS:
        return values
    return convert_to_si(values, unit, expected=CHANNELS[name].unit, channel=name, where=str(path))
