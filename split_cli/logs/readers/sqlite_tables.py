"""Tables of a data base in one file (SQLite), as apps and loggers keep what they measure."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import (
    RawChannelInfo,
    RawRecording,
    RawSignal,
    ReadNote,
    TableRecording,
    seconds_a_tick,
    time_column,
)
from split_cli.logs.readers.cells import seconds_of
from split_cli.logs.scratch import GrowingColumn
from split_cli.signals import split_name_and_unit

_FEWEST_ROWS = 20
_ROWS_AT_ONCE = 4096
_FREE_STEPS, _STEPS_A_BYTE, _STEPS_AT_ONCE = 1_000_000, 8, 10_000
"""Steps of SQLite's machine that reading may take [1], and for a byte of the file: a row has a few for each value."""


def is_rosbag2(path: Path) -> bool:
    """Whether a data base has the tables of rosbag2; one that cannot be looked at counts as one, which says why."""
    try:
        return {"messages", "topics"} <= {name for name, _ in _tables(_opened(path))}
    except sqlite3.Error:
        return True


def open_sqlite(path: Path) -> RawRecording:
    """Open the tables of a data base: columns of numbers, and times in words; of several tables each has its clock.

    Raises
    ------
    LogError
        If it is damaged, or no table holds numbers.
    """
    try:
        database = _opened(path)
        tables = {name: _columns(database, name) for name, sql in _tables(database) if _is_plain(sql)}
        refuse_many_columns(sum(map(len, tables.values())), path.name)
        read = {name: _read(database, name, columns) for name, columns in tables.items()}
    except sqlite3.Error as error:
        raise LogError(f"is damaged ({error})", where=path.name, advice="Export its table as CSV.") from error
    lengths = {name: len(next(iter(columns.values()), ())) for name, columns in read.items()}
    read = {name: columns for name, columns in read.items() if lengths[name] >= _FEWEST_ROWS}
    if not read:
        known = ", ".join(list(tables)[:6]) or "none"
        what = f"is a data base without a table of {_FEWEST_ROWS} rows of numbers (tables: {known})"
        raise LogError(what, where=path.name, advice="Export the measurements as CSV.")
    signals: dict[str, RawSignal] = {}
    for table, columns in read.items():
        infos = [RawChannelInfo(name, "column", None, split_name_and_unit(name)[1]) for name in columns]
        clock = time_column(infos) if len(read) > 1 else None
        time = None if clock is None else columns[clock.name] * seconds_a_tick(columns[clock.name], clock.unit)
        for info in infos:
            name = f"{table}.{info.name}" if len(read) > 1 else info.name
            signals[name] = RawSignal(name, time, columns[info.name], info.unit)
    left = [name for name in tables if name not in read]
    notes = [ReadNote(f"tables without numbers, left out: {', '.join(left[:3])}", path.name, len(left))] if left else []
    return TableRecording(path.name, path, signals, notes=notes)


def _opened(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro", uri=True)
    size = path.stat().st_size
    left = [(_FREE_STEPS + _STEPS_A_BYTE * size) // _STEPS_AT_ONCE]

    def goes_on_for_ever() -> bool:
        left[0] -= 1
        return left[0] < 0

    database.set_progress_handler(goes_on_for_ever, _STEPS_AT_ONCE)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(1 << 26, min(size, 1_000_000_000)))
    return database


def _tables(database: sqlite3.Connection) -> list[tuple[str, str]]:
    query = "SELECT name, sql FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
    return [(str(name), str(sql or "")) for name, sql in database.execute(query)]


def _is_plain(sql: str) -> bool:
    """Whether a table stores its values: one that computes them may go on for ever."""
    lowered = " ".join(sql.lower().split())
    return lowered.startswith("create table") and " generated " not in lowered and " as (" not in lowered


def _columns(database: sqlite3.Connection, table: str) -> list[str]:
    return [str(row[1]) for row in database.execute(f"PRAGMA table_info({_quoted(table)})")]


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _read(database: sqlite3.Connection, table: str, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the columns in which most values are numbers or times, shapes (N,)."""
    if not columns:
        return {}
    growing = [GrowingColumn() for _ in columns]
    good = np.zeros(len(columns))
    count = 0
    cursor = database.execute(f"SELECT {', '.join(map(_quoted, columns))} FROM {_quoted(table)}")
    while rows := cursor.fetchmany(_ROWS_AT_ONCE):
        for place, column in enumerate(growing):
            values = np.array([_number(row[place]) for row in rows])
            good[place] += np.count_nonzero(np.isfinite(values)) + sum(row[place] is None for row in rows)
            column.append(values)
        count += len(rows)
    read = {name: column.finished() for name, column in zip(columns, growing, strict=True)}
    most = [name for place, name in enumerate(columns) if 2 * good[place] > count]
    return {name: read[name] for name in most if np.isfinite(read[name]).any()}


def _number(value: Any) -> float:
    if isinstance(value, int | float):
        return float(value)
    return seconds_of(value) if isinstance(value, str) and len(value) < 64 else float("nan")
