"""Parquet, and Arrow IPC files (Feather)."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import LogError, reason_of
from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS, Unfolded, refuse_many_columns, refuse_unpacked_size
from split_cli.logs.raw import (
    LazyTableRecording,
    RawChannelInfo,
    RawRecording,
    RawSignal,
    ReadNote,
    UniqueNames,
    Words,
    note_once,
)
from split_cli.logs.readers.probe import probe
from split_cli.logs.scratch import set_aside
from split_cli.signals import split_name_and_unit


def open_parquet(path: Path) -> RawRecording:
    """Open a Parquet file; columns are read when asked for.

    Raises
    ------
    LogError
        If it is damaged or holds no rows.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _damaged(path, "Parquet", error) from error

    # A column that never changes may stand for any number of rows.
    size = path.stat().st_size
    refuse_unpacked_size(8 * file.metadata.num_rows, size, "a column", path.name, Unfolded(size).whole)

    def read(name: str) -> Any:
        return file.read(columns=[name])[name]

    return _recording(path, "Parquet", file.schema_arrow, file.metadata.num_rows, read)


STREAM = b"\xff\xff\xff\xff"
"""How an Arrow file begins that was written as it came, without the list of its parts at the end."""


def read_arrow(path: Path) -> Any:
    """Return the table of an Arrow file: what a compressed part of it becomes, nobody knows before."""
    import pyarrow as pa

    with pa.memory_map(str(path)) as source:
        opened = pa.ipc.open_stream if source.read(len(STREAM)) == STREAM else pa.ipc.open_file
        source.seek(0)
        table = opened(source).read_all()
        # A structure whose parts are shorter than it claims ends the process where one of them is taken out.
        table.validate(full=True)
    return table


def open_arrow(path: Path) -> RawRecording:
    """Open an Arrow IPC or Feather (version 2) file, which is mapped rather than read.

    Raises
    ------
    LogError
        If it is damaged or holds no rows.
    """
    import pyarrow as pa

    probe(path, read_arrow)
    try:
        table = read_arrow(path)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _damaged(path, "Arrow", error) from error
    return _recording(path, "Arrow", table.schema, table.num_rows, table.column)


def _recording(path: Path, kind: str, schema: Any, rows: int, read: Callable[[str], Any]) -> LazyTableRecording:
    import pyarrow as pa

    if not rows:
        raise LogError("holds no rows", where=path.name, advice="Export it again.")
    columns: dict[str, tuple[str, ...]] = {}
    infos = []
    notes: list[ReadNote] = []
    unique = UniqueNames()
    leaves = list(itertools.islice(_leaves(schema), MOST_FIELDS + 1))
    refuse_many_columns(len(leaves), path.name)
    for path_of, column in leaves:
        name, unit = split_name_and_unit(".".join(path_of))
        stated = (column.metadata or {}).get(b"unit")
        name = unique.of(name)
        columns[name] = path_of
        unit = stated.decode() if stated else unit
        if _is_time(column.type):
            unit = "s"  # `column_values` gives seconds, whatever the name or the field says
        infos.append(RawChannelInfo(name, "text" if _is_text(column.type) else str(column.type), rows, unit))
    if unique.renamed:
        note_once(notes, "column names that occur twice, numbered", path.name, unique.renamed)
    units = {info.name: info.unit for info in infos}
    types = {name: column.type for name, (_, column) in zip(columns, leaves, strict=True)}

    def load(names: Sequence[str]) -> dict[str, RawSignal]:
        above: dict[str, list[str]] = {}
        for name in names:
            if not _has_numbers(types[name]):
                advice = "Map a column of numbers."
                raise LogError(f"column {name!r} holds {types[name]}, not numbers", where=path.name, advice=advice)
            above.setdefault(columns[name][0], []).append(name)
        values: dict[str, np.ndarray] = {}
        for top, below in above.items():
            # One by one, so that a long recording is not held twice.
            try:
                column = read(top)
            except (pa.ArrowException, OSError, ValueError) as error:
                raise _damaged(path, kind, error) from error
            for name in below:
                values[name] = set_aside(column_values(_leaf(column, columns[name]), f"{path.name}, column {name}"))
            del column
            pa.default_memory_pool().release_unused()
        return {name: RawSignal(name, None, values[name], units[name]) for name in names}

    def texts(name: str) -> tuple[np.ndarray, list[str]]:
        try:
            return _texts(_leaf(read(columns[name][0]), columns[name]))
        except (pa.ArrowException, OSError, ValueError) as error:
            raise _damaged(path, kind, error) from error

    return LazyTableRecording(path.name, path, infos, load, notes=notes, texts=texts)


def _texts(column: Any) -> tuple[np.ndarray, list[str]]:
    """Return a column of text as numbers and its texts, each cut to the length of a name: one may be repeated a lot."""
    words = Words()
    for chunk in getattr(column, "chunks", [column]):
        encoded = chunk if hasattr(chunk, "dictionary") else chunk.dictionary_encode()
        texts = [*map(_text, encoded.dictionary.to_pylist()), ""]  # the last one is of what is missing
        places = encoded.indices.fill_null(len(texts) - 1).to_numpy(zero_copy_only=False)
        words.append(texts, places)
    return words.finished()


def _text(value: Any) -> str:
    text = value.decode(errors="replace") if isinstance(value, bytes) else str(value or "")
    return text[:LONGEST_NAME]


def _is_text(kind: Any) -> bool:
    import pyarrow as pa

    value = kind.value_type if pa.types.is_dictionary(kind) else kind
    return pa.types.is_string(value) or pa.types.is_large_string(value) or pa.types.is_binary(value)


def _has_numbers(kind: Any) -> bool:
    """Whether a column can be read: what cannot is not unpacked, however large it may be."""
    import pyarrow as pa

    known = pa.types
    kind = kind.value_type if known.is_dictionary(kind) else kind
    plain = known.is_floating(kind) or known.is_integer(kind) or known.is_null(kind) or known.is_boolean(kind)
    return plain or known.is_decimal(kind) or _is_time(kind)


def _is_time(kind: Any) -> bool:
    import pyarrow as pa

    return pa.types.is_timestamp(kind) or pa.types.is_duration(kind)


def _leaves(fields: Iterable[Any], above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield path and field of every column; those inside structures one by one."""
    import pyarrow as pa

    for field in fields:
        path = (*above, field.name)
        if pa.types.is_struct(field.type):
            yield from _leaves(field.type, path)
        else:
            yield path, field


def _leaf(column: Any, path: tuple[str, ...]) -> Any:
    """Return a column, or what stands at `path` inside a structure."""
    import pyarrow.compute as pc

    return pc.struct_field(column, list(path[1:])) if path[1:] else column


def column_values(column: Any, where: str) -> np.ndarray:
    """Return an Arrow column as float64, nulls as NaN, times as seconds, booleans as 0 and 1.

    Raises
    ------
    LogError
        If the column holds no numbers.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    scale = 1.0
    if _is_time(kind):
        scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
        column = column.cast(pa.int64())
    elif pa.types.is_decimal(kind) or pa.types.is_boolean(kind):
        column = column.cast(pa.float64()) if pa.types.is_decimal(kind) else column.cast(pa.uint8())
    elif not _has_numbers(kind):
        raise LogError(f"holds {kind}, not numbers", where=where, advice="Map a column of numbers.")
    column = pc.fill_null(pc.cast(column, pa.float64(), safe=False), float("nan"))
    return numbers_of(column) * scale if scale != 1.0 else numbers_of(column)


def numbers_of(column: Any) -> np.ndarray:
    """Return an Arrow column of float64 as an array of its own: a view would keep Arrow's memory."""
    chunks = [chunk.to_numpy(zero_copy_only=False) for chunk in column.chunks] or [np.empty(0)]
    return np.concatenate(chunks)


def _damaged(path: Path, kind: str, error: Exception) -> LogError:
    what = f"is cut off or damaged, or no {kind} file ({reason_of(error)})"
    return LogError(what, where=path.name, advice="Record it again.")
