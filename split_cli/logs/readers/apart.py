"""Formats that a library of others reads: in a process of its own, which hands over columns in a temporary file."""

import importlib.util
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import LogError, SplitError, damaged
from split_cli.files import ScratchFolder
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import LazyTableRecording, RawChannelInfo, RawRecording, RawSignal, ReadNote, UniqueNames
from split_cli.logs.readers.probe import probe
from split_cli.logs.scratch import mapped_file

_LIST, _COLUMNS = "channels.json", "columns.f8"
_ADVICE = "Save it again with the logger's own tool."


@dataclass(frozen=True)
class ColumnApart:
    """One channel that a library read."""

    name: str
    unit: str
    time: np.ndarray | None  # (N,) [s]; None for a column of a table whose time is another column
    values: np.ndarray  # (N,), of any type that becomes float64


@dataclass(frozen=True)
class TableApart:
    """All that a library read of a file."""

    columns: list[ColumnApart]
    notes: list[ReadNote] = field(default_factory=list)


def open_apart(path: Path, hand_over: Callable[[Path, str], None], library: str, what: str, extra: str) -> RawRecording:
    """Open a file by a library that runs in a process of its own, with bounds on its memory and time.

    A damaged file can make compiled code read or write where it should not: only that process is harmed.

    Parameters
    ----------
    hand_over : callable
        A function of a module, which calls `write_table` with what the library read.
    library : str
        Module that it needs.
    what : str
        What the file is, for the error without the library.
    extra : str
        Of this package, that brings the library.

    Raises
    ------
    LogError
        If the library is not installed, or the file is damaged or holds no numbers.
    """
    if importlib.util.find_spec(library) is None:
        raise LogError(f"is {what}, which needs {library}", where=path.name, advice=f"pip install 'split-cli[{extra}]'")
    scratch = ScratchFolder()
    probe(path, hand_over, str(scratch.path))
    try:
        listed = json.loads((scratch.path / _LIST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise LogError("is damaged: reading it did not end well", where=path.name, advice=_ADVICE) from error
    if "error" in listed:
        what, where, advice = listed["error"]
        raise LogError(what, where=where, advice=advice)
    return _recording(path, listed, scratch)


def write_table(path: Path, folder: str, read: Callable[[Path], TableApart]) -> None:
    """Write what `read` makes of a file, or why it failed, to a folder: what the process of its own does."""
    with (Path(folder) / _COLUMNS).open("wb") as stream:
        try:
            table = read(path)
            refuse_many_columns(len(table.columns), path.name)
            listed = {"channels": _written(table, stream), "notes": [[n.what, n.count] for n in table.notes]}
        except MemoryError:
            raise
        except SplitError as error:
            listed = {"error": [error.what, error.where or path.name, error.advice or ""]}
        except Exception as error:  # a library passes on whatever damaged bytes lead to
            failed = damaged(path, error, _ADVICE)
            listed = {"error": [failed.what, path.name, _ADVICE]}
    (Path(folder) / _LIST).write_text(json.dumps(listed), encoding="utf-8")


def _written(table: TableApart, stream: Any) -> list[list[Any]]:
    """Write each column once; return name, unit, count, and where its time and values lie."""
    known: dict[int, int] = {}
    unique = UniqueNames()
    listed = []
    for column in table.columns:
        places: list[int | None] = []
        for values in (column.time, column.values):
            if values is not None and id(values) not in known:
                known[id(values)] = stream.tell()
                stream.write(np.ascontiguousarray(values, dtype="<f8").data)
            places.append(None if values is None else known[id(values)])
        listed.append([unique.of(column.name), column.unit, len(column.values), *places])
    return listed


def _recording(path: Path, listed: dict[str, Any], scratch: ScratchFolder) -> RawRecording:
    places = {name: (count, time, values) for name, _, count, time, values in listed["channels"]}
    units = {name: unit or None for name, unit, *_ in listed["channels"]}
    if not any(count for count, *_ in places.values()):
        raise LogError("holds no channel with numbers", where=path.name, advice="Export it again.")
    with (scratch.path / _COLUMNS).open("rb") as stream:
        content = mapped_file(stream)

    def load(names: list[str]) -> dict[str, RawSignal]:
        def column(count: int, place: int | None) -> np.ndarray | None:
            return None if place is None else np.frombuffer(content, "<f8", count, place)

        made = {}
        for name in names:
            count, time, values = places[name]
            made[name] = RawSignal(name, column(count, time), column(count, values), units[name])
        return made

    infos = [RawChannelInfo(name, "column", count, units[name]) for name, (count, *_) in places.items()]
    notes = [ReadNote(what, path.name, count) for what, count in listed["notes"]]
    timed = all(time is not None for _, time, _ in places.values())
    return LazyTableRecording(path.name, path, infos, load, notes=notes, own_clocks=timed)
