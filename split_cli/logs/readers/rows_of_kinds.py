"""Tables whose rows are of several kinds: each begins with the name of its kind, and has titles of its own.

So write loggers that send ``IMU,...`` and ``GPS,...`` down one line.
"""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import (
    RawChannelInfo,
    RawRecording,
    RawSignal,
    ReadNote,
    TableRecording,
    time_column,
    unit_of_time,
)
from split_cli.logs.readers.cells import number_of
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.dialect import LONGEST_LINE, split_line
from split_cli.logs.scratch import GrowingSignal
from split_cli.signals import find_unit, split_name_and_unit

_SEPARATORS = (",", ";", "\t")
_KIND = re.compile(r"[A-Za-z][\w/.-]{0,63}")
_FEWEST_ROWS = 3
"""Of each of two kinds, among the first bytes of a file [1]; judgement."""


def titles_of_kinds(head: bytes) -> tuple[str, dict[str, list[str]]] | None:
    """Return the separator and the titles of each kind of row by the first bytes of a file; None of another form.

    A row of titles holds a kind, behind the mark of a comment or not, and a name for each cell of its rows.
    """
    lines = decoded(head.removeprefix(b"\xef\xbb\xbf")).splitlines()[:-1] if b"\0" not in head else []
    for separator in _SEPARATORS:
        rows = [row for row in (split_line(line, separator) for line in lines) if len(row) > 2]
        valued = Counter((row[0].strip(), len(row)) for row in rows if _holds_values(row))
        named: dict[str, list[str]] = {}
        for row in rows:
            kind = row[0].strip()
            if _KIND.fullmatch(kind) and _holds_names(row) and valued[kind, len(row)] >= _FEWEST_ROWS:
                named.setdefault(kind, [cell.strip() for cell in row[1:]])
        if len(named) > 1 and sum(n for (kind, _), n in valued.items() if kind in named) > 0.5 * len(rows):
            return separator, named
    return None


def _holds_values(row: Sequence[str]) -> bool:
    return bool(_KIND.fullmatch(row[0].strip())) and any(np.isfinite(number_of(cell.strip(), ".")) for cell in row[1:])


def _holds_names(row: Sequence[str]) -> bool:
    return all(cell.strip()[:1].isalpha() and not np.isfinite(number_of(cell.strip(), ".")) for cell in row[1:])


def open_rows_of_kinds(path: Path, separator: str, titles: dict[str, list[str]]) -> RawRecording:
    """Open rows of several kinds: a channel ``kind.title`` for each column of each kind, with the clock of its kind.

    Raises
    ------
    LogError
        If a kind has no column that counts time, or no row holds a number.
    """
    columns = {kind: [split_name_and_unit(title) for title in row] for kind, row in titles.items()}
    refuse_many_columns(sum(map(len, columns.values())), path.name)
    clocks = {kind: _clock_of(path, kind, row) for kind, row in columns.items()}
    read = {kind: [GrowingSignal() for _ in row] for kind, row in columns.items()}
    others = 0
    for row in _rows(path, separator):
        kind = row[0].strip()
        if kind not in columns or len(row) != len(columns[kind]) + 1:
            others += 1
            continue
        cells = [number_of(cell.strip(), ".") for cell in row[1:]]
        time = cells[clocks[kind]]
        if not np.isfinite(time):
            others += row[1:] != titles[kind]
            continue
        for signal, value in zip(read[kind], cells, strict=True):
            if np.isfinite(value):
                signal.append(time, value)
    signals = {}
    for kind, titled in columns.items():
        stamps = read[kind][clocks[kind]].finished()[1]
        unit = find_unit(titled[clocks[kind]][1] or "") or find_unit(unit_of_time(stamps))
        factor = unit.factor if unit is not None and unit.si == "s" else 1.0
        for place, ((name, stated), column) in enumerate(zip(titled, read[kind], strict=True)):
            times, values = column.finished() if place != clocks[kind] else (stamps[:0], stamps[:0])
            if len(values):
                address = f"{kind}.{name}"
                signals[address] = RawSignal(address, times * factor, values, stated)
    if not signals:
        raise LogError("holds no rows of numbers", where=path.name, advice="Export it again.")
    notes = [ReadNote("rows of no kind that has titles, or of another length, left out", path.name, others)] * bool(
        others
    )
    return TableRecording(path.name, path, signals, notes=notes)


def _clock_of(path: Path, kind: str, row: Sequence[tuple[str, str | None]]) -> int:
    """Return the place of the column that counts the time of a kind."""
    infos = [RawChannelInfo(name, "column", None, unit) for name, unit in row]
    found = time_column(infos)
    if found is None:
        found = next((i for i in infos if getattr(find_unit(i.unit or ""), "si", "") == "s"), None)
    if found is None:
        advice = f"Call one of its columns `time`; there are {', '.join(name for name, _ in row[:6])}."
        raise LogError(f"holds rows of {kind} without a column of time", where=path.name, advice=advice)
    return infos.index(found)


def _rows(path: Path, separator: str) -> Iterator[list[str]]:
    with path.open("rb") as stream:
        mark = b"\xef\xbb\xbf"
        while raw := stream.readline(LONGEST_LINE):
            row = split_line(decoded(raw.removeprefix(mark)), separator)
            mark = b""
            if len(row) > 1:
                yield row
