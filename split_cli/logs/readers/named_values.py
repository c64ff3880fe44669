"""Tables and JSON lines with one value a row and its name beside it: openXC, InfluxDB, lists of CAN signals.

Each name becomes a signal with a clock of its own.
"""

import csv
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import (
    TIME_COLUMNS,
    RawChannelInfo,
    RawRecording,
    RawSignal,
    ReadNote,
    TableRecording,
    UniqueNames,
    seconds_a_tick,
    time_column,
)
from split_cli.logs.readers.cells import number_of
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.dialect import LONGEST_LINE
from split_cli.logs.readers.json_document import plain_number
from split_cli.logs.scratch import GrowingSignal
from split_cli.signals import split_name_and_unit, symbol_of

NAMES = tuple("signal signal_name channel name variable parameter topic key field _field metric sensor pid".split())
VALUES = ("value", "_value", "val", "data", "reading", "measurement", "signal_value", "physical_value")
_GROUPS = ("message", "_measurement", "measurement", "message_name", "ecu", "device", "topic")
_CARS = tuple("vehicle_id vehicle car_id car original_vehicle_id vehicle_number car_number driver".split())
"""A race's table holds the values of all its cars."""
_TIMES = tuple(
    name + unit
    for name in ("_time", "receive_time", "log_time", *TIME_COLUMNS)
    for unit in ("", "_s", "_ms", "_us", "_ns")
)
_SEPARATORS = (",", ";", "\t")
_ROWS_LOOKED_AT, _LINES_BEFORE = 40, 20
_FEWEST_ROWS = 8
"""Lines without titles that show their form [1]; judgement."""


@dataclass(frozen=True)
class Places:
    """Where a row holds what."""

    # time, name, value: position of a cell, or key of an object.
    time: Any
    name: Any
    value: Any
    # unit, groups: of the value, and of what several names stand in, as a car or a message.
    unit: Any = None
    groups: tuple[Any, ...] = ()
    unit_of_time: str | None = None  # as the title says
    # separator, decimal: of a table.
    separator: str = ","
    decimal: str = "."
    titles: tuple[str, ...] = ()  # which a table may repeat


def places_in(titles: Sequence[str]) -> Places | None:
    """Return where a row of these titles holds time, name and value, by position; None if one is missing."""
    parted = [split_name_and_unit(title) for title in titles]
    bare = ["_".join(name.strip().lower().split()) for name, _ in parted]

    def first(known: Sequence[str], *but: int | None) -> int | None:
        return next((bare.index(n) for n in known if n in bare and bare.index(n) not in but), None)

    time, name = first(_TIMES), first(NAMES)
    value = first(VALUES, name)
    if name is None or value is None:
        name, value = _pair_of_one_beginning(bare)
    if time is None and name is not None:
        others = [RawChannelInfo(title, "column", None) for n, title in enumerate(bare) if n not in (name, value)]
        timed = time_column(others)
        time = None if timed is None else bare.index(timed.name)
    if time is None or name is None or value is None:
        return None
    groups = (first(_CARS, name, value), first(_GROUPS, name, value))
    places = tuple(place for place in groups if place is not None)
    return Places(time, name, value, first(("unit", "units")), places, parted[time][1])


def _pair_of_one_beginning(titles: Sequence[str]) -> tuple[int | None, int | None]:
    """Return the places of titles such as ``telemetry_name`` and ``telemetry_value``; None where there are none."""
    for place, title in enumerate(titles):
        beginning, _, last = title.rpartition("_")
        if beginning and last in NAMES:
            values = [f"{beginning}_{word}" for word in VALUES]
            value = next((titles.index(word) for word in values if word in titles), None)
            if value is not None:
                return place, value
    return None, None


def open_named_rows(
    path: Path, looked_at: Sequence[dict[str, Any]], rows: Iterable[dict[str, Any]]
) -> RawRecording | None:
    """Open objects with one value each; None if they are of another form.

    Parameters
    ----------
    looked_at : sequence of dict
        Some objects, which show the form.
    rows : iterable of dict
        All of them.

    Raises
    ------
    LogError
        If no name has values that are numbers.
    """
    keys = [str(key) for key in dict.fromkeys(key for row in looked_at for key in row)]
    at = places_in(keys)
    if at is None or not _are_named([str(row.get(keys[at.name], "")) for row in looked_at]):
        return None
    if not any(np.isfinite(_number(row.get(keys[at.value]), at.decimal)) for row in looked_at):
        return None
    cells = ([row.get(key) for key in keys] for row in rows)
    return _gathered(path, at, cells)


def table_of_named_values(head: bytes) -> Places | None:
    """Return the form of a table by its first bytes; None if it is another one."""
    lines = head.decode("utf-8-sig", errors="replace").splitlines()[:-1]
    for separator in _SEPARATORS:
        rows = list(csv.reader(lines, delimiter=separator))
        for number, row in enumerate(rows[:_LINES_BEFORE]):
            at = places_in(row) if len(row) > 2 else None
            if at is None:
                continue
            below = [r for r in rows[number + 1 : number + 1 + _ROWS_LOOKED_AT] if len(r) == len(row)]
            values = [r[at.value].strip() for r in below]
            decimal = "," if separator != "," and any("," in cell for cell in values) else "."
            numbers = sum(np.isfinite(number_of(cell, decimal)) for cell in values)
            if 2 * numbers > len(values) and _are_named([r[at.name] for r in below]):
                return replace(at, separator=separator, decimal=decimal, titles=tuple(row))
    return _without_titles(lines)


def _without_titles(lines: Sequence[str]) -> Places | None:
    """Return the form of lines of a time, a name and a number each, as those of topics that a program prints."""
    for separator in (" ", *_SEPARATORS):
        rows = [_cells(line, separator) for line in lines[:_ROWS_LOOKED_AT] if line.strip()]
        if len(rows) < _FEWEST_ROWS or any(len(row) != 3 for row in rows):
            continue
        times = [number_of(row[0].strip(), ".") for row in rows]
        numbers = [number_of(row[2].strip(), ".") for row in rows]
        rising = bool(np.all(np.diff(times) >= 0.0)) and times[-1] > times[0]
        words = all(row[1].strip()[:1].isalpha() or row[1].strip()[:1] in "/_" for row in rows)
        if rising and words and np.isfinite(numbers).all() and _are_named([row[1].strip() for row in rows]):
            return Places(0, 1, 2, separator=separator)
    return None


def open_named_table(path: Path, at: Places) -> RawRecording:
    """Open a table with one value a row; see `open_named_rows`."""
    lines = (line for line in _lines(path) if not line.startswith("#"))
    return _gathered(path, at, (_cells(line, at.separator) for line in lines))


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of one line: a quote that is never closed takes no rows behind it."""
    if separator == " ":
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator))
    except (csv.Error, StopIteration):  # a cell of over 128 kB
        return [line]


def _are_named(names: Sequence[str]) -> bool:
    """Whether cells are words that come again; a table sorted by name begins with many rows of one."""
    words = {name for name in names if name and not np.isfinite(number_of(name, "."))}
    return bool(words) and len(words) < len(names)


class _Signal(GrowingSignal):
    """A signal with its unit, and how many of its values are no numbers."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self.unit, self.others = unit, 0


def _gathered(path: Path, at: Places, rows: Iterable[Sequence[Any]]) -> RawRecording:
    found: dict[tuple[tuple[str, ...], str], _Signal] = {}
    bad = 0
    width = max(place for place in (at.time, at.name, at.value, at.unit, *at.groups) if place is not None)
    for row in rows:
        name = str(row[at.name] or "") if len(row) > width else ""
        time = _number(row[at.time], at.decimal) if name else np.nan
        if not np.isfinite(time):
            bad += bool(row) and tuple(row) != at.titles
            continue
        groups = tuple(str(row[place] or "") for place in at.groups)
        signal = found.get((groups, name))
        if signal is None:
            refuse_many_columns(len(found) + 1, path.name)
            unit = str(row[at.unit] or "").strip() if at.unit is not None else ""
            signal = found[(groups, name)] = _Signal(unit)
        value = _number(row[at.value], at.decimal)
        if np.isfinite(value):
            signal.append(time, value)
        else:
            signal.others += 1
    return _recording(path, at, found, bad)


def _number(cell: Any, decimal: str) -> float:
    if isinstance(cell, str):
        return number_of(cell.strip(), decimal)
    return plain_number(cell)


def _recording(path: Path, at: Places, found: dict[tuple[tuple[str, ...], str], _Signal], bad: int) -> RawRecording:
    notes = [ReadNote("rows without a name or a time, left out", path.name, bad)] if bad else []
    shared = Counter(name for _, name in found)
    unique, signals, words = UniqueNames(), {}, []
    read = {key: signal.finished() for key, signal in found.items()}
    longest = max((time for time, _ in read.values()), key=len, default=np.zeros(0))
    scale = seconds_a_tick(longest, at.unit_of_time)
    differ = [len({groups[n] for groups, _ in found}) > 1 for n in range(len(at.groups))]
    for (groups, name), signal in found.items():
        time, values = read[(groups, name)]
        if signal.others > len(values) or not len(values):
            words.append(name)
            continue
        own, unit = split_name_and_unit(name)
        group = [word for word, several in zip(groups, differ, strict=True) if several and word]
        own = unique.of(".".join([*group, own or name]) if shared[name] > 1 else own or name)
        signals[own] = RawSignal(own, time * scale, values, symbol_of(signal.unit) or unit)
    if words:
        shown = ", ".join(words[:3]) + (", ..." if len(words) > 3 else "")
        notes.append(ReadNote(f"names whose values are no numbers, left out: {shown}", path.name, len(words)))
    if not signals:
        raise LogError("holds no values that are numbers", where=path.name, advice="Export it again.")
    return TableRecording(path.name, path, signals, notes=notes)


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines that are not empty, those that are no UTF-8 as Western European."""
    with path.open("rb") as stream:
        mark = b"\xef\xbb\xbf"
        while raw := stream.readline(LONGEST_LINE):
            if raw.isspace():
                continue
            raw, mark = raw.removeprefix(mark), b""
            yield decoded(raw).rstrip("\r\n")
