"""Rows written as JSON: an object a line (JSON lines, donkeycar catalogs), a list of objects, a list a column."""

import contextlib
import itertools
import math
import re
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS, refuse_many_columns
from split_cli.logs.one_car import NAMES_OF_CARS
from split_cli.logs.raw import (
    LazyTableRecording,
    RawChannelInfo,
    RawRecording,
    RawSignal,
    ReadNote,
    TableRecording,
    UniqueNames,
    Words,
    note_once,
)
from split_cli.logs.readers.cells import seconds_of
from split_cli.logs.readers.json_channels import LARGEST_DOCUMENT, is_channel, open_json_channels
from split_cli.logs.readers.json_document import LONGEST_ELEMENT, JsonDocument, parsed
from split_cli.logs.readers.json_frames import frame_of_pandas
from split_cli.logs.readers.json_topics import key_of_topics, rows_by_topic
from split_cli.logs.readers.named_values import open_named_rows
from split_cli.logs.readers.several_tables import joined_tables
from split_cli.logs.scratch import GrowingColumn
from split_cli.signals import split_name_and_unit, symbol_of

_LISTED_ROWS = 200
"""Rows whose fields are listed: an event writes fields that the first row lacks [1]."""
_PLACES, _ROWS_A_PLACE, _BYTES_A_PLACE = 16, 25, 1 << 18
"""Of a file of lines, where further rows are looked at for fields: a sensor may start late [1]."""
_DEEPEST = 12
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_LONGEST_NUMBER = 64
"""Of a text that is a number or a time [characters]."""
_DEEPEST_LIST, _FEWEST_ROWS = 6, 20
"""Objects one inside another around a list of rows, and rows that make a log of it [1]; judgement."""
_SAYS_NOTHING = frozenset("samples data values rows points messages records".split())
"""Keys of lists that leave it to the key before to say what they hold."""
_LISTED_ELEMENTS = 64
_NUMBERS_AT_ONCE, _ROWS_AT_ONCE = 1 << 20, 4096
"""Rows times fields, and rows, that are decoded before they go to their columns [1]: 8 MB."""
_NUMBERS_OF_ANY, _NUMBERS_A_BYTE = 8 << 20, 40
"""What rows may become [1], of any file and for each byte: 320 bytes to one, near what a compressed chunk may;
judgement: one event of a hundred has 60 bytes, and all have 1,000 fields together at most."""


def is_json(head: bytes) -> bool:
    """Tell JSON by its first characters: an object with a quoted key, or a list of objects or of numbers."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    inside = text[1:].lstrip()[:1]
    if text[:1] == b"[" and inside == b'"':
        return _titles_of_lists(text.splitlines()[:-1]) != []
    return (text[:1] == b"{" and inside == b'"') or (text[:1] == b"[" and inside == b"{")


def open_json(path: Path) -> RawRecording:
    """Open rows written as JSON; a field inside others is addressed as ``imu.gyro.z``, an element as ``q[0]``.

    A text that is a time (ISO 8601) reads as seconds since 1970. Fields that a row lacks are missing in it.

    Raises
    ------
    LogError
        If it holds no rows of numbers, or more than `MOST_FIELDS` fields.
    """
    with path.open("rb") as stream:
        titles = _titles_of_lists([stream.readline(LONGEST_ELEMENT) for _ in range(2)])
        if titles:
            notes_of_lists: list[ReadNote] = []
            return table_of_rows(path, lambda: _rows_of_lists(path, titles, notes_of_lists), notes_of_lists)
        stream.seek(0)
        first = parsed(stream.readline(LONGEST_ELEMENT))
        more = any(not line.isspace() for line in iter(lambda: stream.readline(LONGEST_ELEMENT), b""))
    # A file with one object is a document: as a row it would have one time only.
    if not (isinstance(first, dict) and more):
        return open_json_channels(path) or _whole(path)
    notes: list[ReadNote] = []
    beginning = list(itertools.islice(_rows(path, []), _LISTED_ROWS))
    named = open_named_rows(path, beginning, _rows(path, notes))
    if named is not None:
        named.notes.extend(notes)
        return named
    topic = key_of_topics(beginning)
    if topic:
        known = _names_of(rows_by_topic(itertools.chain(beginning, _rows_of_places(path)), topic), path)
        return _table(path, known, lambda: rows_by_topic(_rows(path, notes), topic), notes)
    known = _names_of(itertools.chain(beginning, _rows_of_places(path)), path)
    return _table(path, known, lambda: _rows(path, notes), notes)


def _titles_of_lists(lines: Sequence[bytes]) -> list[str]:
    """Return the titles of lines with a list each, of which the first holds them; empty of another form."""
    first, second = (parsed(line) for line in lines[:2]) if len(lines) > 1 else (None, None)
    alike = isinstance(first, list) and isinstance(second, list) and len(first) == len(second) > 1
    return list(first) if alike and all(isinstance(title, str) for title in first) else []


def _rows_of_lists(path: Path, titles: Sequence[str], notes: list[ReadNote]) -> Iterator[dict[str, Any]]:
    others = 0
    with path.open("rb") as stream:
        stream.readline(LONGEST_ELEMENT)
        while line := stream.readline(LONGEST_ELEMENT):
            row = parsed(line) if not line.isspace() else None
            if isinstance(row, list) and len(row) == len(titles):
                yield dict(zip(titles, row, strict=True))
            else:
                others += not line.isspace()
    if others:
        note_once(notes, "lines that hold no list of that many, left out", path.name, others)


def table_of_rows(path: Path, rows: Callable[[], Iterator[dict[str, Any]]], notes: list[ReadNote]) -> RawRecording:
    """Return a recording of rows of any form that hold their values by name, read anew for each call of `rows`.

    Raises
    ------
    LogError
        If the first rows hold no number.
    """
    return _table(path, _names_of(itertools.islice(rows(), _LISTED_ROWS), path), rows, notes)


def _table(
    path: Path, known: Sequence[str], rows: Callable[[], Iterator[dict[str, Any]]], notes: list[ReadNote]
) -> RawRecording:
    """Return a recording of rows, which are read anew for each call of `rows`."""
    real: dict[str, str] = {}
    units: dict[str, str | None] = {}
    infos, unique = [], UniqueNames()
    stated = dict(_units_of(next(rows(), {})))
    for name in known:
        own, unit = split_name_and_unit(name)
        unit = symbol_of(stated.get(name)) or unit
        own = unique.of(own or name)
        real[own], units[own] = name, unit
        infos.append(RawChannelInfo(own, "column", None, unit))
    if unique.renamed:
        note_once(notes, "column names that occur twice, numbered", path.name, unique.renamed)

    listed = set(known)
    cars = [key for key, value in next(rows(), {}).items() if key.lower() in NAMES_OF_CARS and isinstance(value, str)]
    infos += [RawChannelInfo(key, "text", None) for key in cars if key not in listed]

    def texts(name: str) -> tuple[np.ndarray, list[str]]:
        words = Words()
        for batch in _batched(rows(), _ROWS_AT_ONCE):
            words.append([str((row or {}).get(name) or "")[:LONGEST_NAME] for row in batch])
        return words.finished()

    def load(names: Sequence[str]) -> dict[str, RawSignal]:
        missed: dict[str, None] = {}
        wanted = {real[name]: place for place, name in enumerate(names)}
        columns = [GrowingColumn() for _ in names]
        count, size = 0, path.stat().st_size
        values = np.full((min(max(_NUMBERS_AT_ONCE // max(len(names), 1), 1), _ROWS_AT_ONCE), len(names)), np.nan)

        def hand_over(length: int) -> None:
            for place, column in enumerate(columns):
                column.append(values[:length, place])
            values[:] = np.nan

        for row in rows():
            at = count % len(values)
            for name, number in _numbers_of(row) if row else ():
                if name in wanted:
                    values[at, wanted[name]] = number
                elif name not in listed and len(missed) < MOST_FIELDS:
                    missed[name] = None
            count += 1
            if at + 1 == len(values):
                _refuse_rows_of_nothing(count * len(names), size, path)
                hand_over(len(values))
        hand_over(count % len(values))
        if missed:
            shown = ", ".join([*missed][:3]) + (", ..." if len(missed) > 3 else "")
            note_once(notes, f"fields of few rows, not listed: {shown}", path.name, len(missed))
        read = zip(names, columns, strict=True)
        return {name: RawSignal(name, None, column.finished(), units[name]) for name, column in read}

    return LazyTableRecording(path.name, path, infos, load, notes=notes, texts=texts)


def _batched(rows: Iterator[dict[str, Any]], count: int) -> Iterator[list[dict[str, Any]]]:
    while batch := list(itertools.islice(rows, count)):
        yield batch


def _refuse_rows_of_nothing(numbers: int, size: int, path: Path) -> None:
    """Refuse columns that are larger than any rows of that many bytes: all fields missing in nearly all rows."""
    if numbers > _NUMBERS_OF_ANY + _NUMBERS_A_BYTE * size:
        what = f"lacks nearly all fields in nearly all rows (over {_NUMBERS_A_BYTE} numbers for each byte)"
        advice = "Map the channels that you need, or write a file for each kind of row."
        raise LogError(what, where=path.name, advice=advice)


def _names_of(rows: Iterable[dict[str, Any]], path: Path) -> list[str]:
    """Return the addresses of all numbers in some rows."""
    known: dict[str, None] = {}
    for row in filter(None, rows):
        known |= dict.fromkeys(name for name, _ in _numbers_of(row))
        refuse_many_columns(len(known), path.name)
    if not known:
        raise _no_rows(path)
    return list(known)


def _whole(path: Path) -> RawRecording:
    """Open a document in one piece: a list of objects, or an object with a list for each column or one of rows."""
    rows_of, columns_of = Counter[str](), Counter[str]()
    notes: list[ReadNote] = []
    try:
        for key, elements in JsonDocument(path).lists():
            first = next(elements, None)
            counts = rows_of if isinstance(first, dict) else columns_of
            if len(counts) < MOST_FIELDS and not isinstance(first, list) and first is not None:
                passed = itertools.count(1)
                try:
                    deque(zip(elements, passed, strict=False), maxlen=0)
                finally:  # of a document that is cut off, what stands before counts
                    counts[key] = next(passed)
    except (ValueError, RecursionError):
        notes.append(ReadNote("the document is cut off or damaged: read up to there", path.name))
    lengths = [length for length in columns_of.values() if length > 1]
    if "" not in columns_of and _are_columns(lengths):
        longest = max(lengths)
        return _columns(path, [key for key, length in columns_of.items() if length == longest], longest, notes)
    if (together := _tables_of_lists(path, notes)) is not None:
        return together
    if not rows_of:
        if (inside := _columns_inside(path, notes)) is not None:
            return inside
        raise _no_rows(path)
    chosen = max(rows_of, key=lambda key: rows_of[key])

    def rows() -> Iterator[dict[str, Any]]:
        for key, elements in JsonDocument(path).lists():
            if key == chosen:
                whole = itertools.islice(elements, rows_of[key])
                yield from (row for row in whole if isinstance(row, dict))
                return

    _refuse_columns_in_rows(next(rows(), {}), chosen, rows_of[chosen], path)
    if topic := key_of_topics(list(itertools.islice(rows(), _LISTED_ROWS))):
        by_topic: dict[str, list[dict[str, Any]]] = {}
        for row in rows() if path.stat().st_size <= LARGEST_DOCUMENT else ():
            by_topic.setdefault(str(row.get(topic)), []).append(row)
        if (together := _with_own_clocks(path, by_topic, notes)) is not None:
            return together
        return _table(path, _names_of(rows_by_topic(rows(), topic), path), lambda: rows_by_topic(rows(), topic), notes)
    return _table(path, _names_of(rows(), path), rows, notes)


def _columns_inside(path: Path, notes: list[ReadNote]) -> RawRecording | None:
    """Return the lists of numbers of a document that holds them in objects (``velocity.x``); None of any other."""
    if path.stat().st_size > LARGEST_DOCUMENT:
        return None
    if (frame := frame_of_pandas(path)) is not None:
        return _of_columns(path, frame, notes)
    lists: dict[str, np.ndarray] = {}
    with contextlib.suppress(ValueError, RecursionError):
        for place, item in JsonDocument(path).items(_DEEPEST_LIST):
            values = np.fromiter(map(_number, item), dtype=float) if isinstance(item, Iterator) else np.zeros(0)
            if np.isfinite(values).any() and len(lists) < MOST_FIELDS:
                lists[".".join(place)] = values
    if not _are_columns([len(values) for values in lists.values()] or [0]):
        return None
    longest = max(map(len, lists.values()))
    return _of_columns(path, {key: values for key, values in lists.items() if len(values) == longest}, notes)


def _of_columns(path: Path, columns: dict[str, np.ndarray], notes: list[ReadNote]) -> RawRecording:
    """Return a recording of columns of one length."""
    refuse_many_columns(len(columns), path.name)
    signals, unique = {}, UniqueNames()
    for key, values in columns.items():
        own, unit = split_name_and_unit(key)
        own = unique.of(own or key)
        if np.isfinite(values).any():
            signals[own] = RawSignal(own, None, values, unit)
    return TableRecording(path.name, path, signals, notes=notes)


def _tables_of_lists(path: Path, notes: list[ReadNote]) -> RawRecording | None:
    """Return the lists of rows of a document that holds one for each sensor, however deep; None of any other."""
    if path.stat().st_size > LARGEST_DOCUMENT:
        return None
    lists: dict[str, list[dict[str, Any]]] = {}
    with contextlib.suppress(ValueError, RecursionError):
        for place, item in JsonDocument(path).items(_DEEPEST_LIST):
            rows = list(item) if isinstance(item, Iterator) else []
            named = [key for key in place if key.lower() not in _SAYS_NOTHING and not key.startswith("[")]
            if len(rows) >= _FEWEST_ROWS and all(isinstance(row, dict) for row in rows) and named:
                lists.setdefault(named[-1], rows)
    if len(lists) < 2:
        return None
    return _with_own_clocks(path, lists, notes)


def _with_own_clocks(path: Path, lists: dict[str, list[dict[str, Any]]], notes: list[ReadNote]) -> RawRecording | None:
    """Return lists of rows by name as one recording, each with its clock; None where fewer than two have one."""
    tables = {}
    for name, rows in lists.items():
        with contextlib.suppress(LogError):
            tables[name] = _table(path, _names_of(rows, path), lambda rows=rows: iter(rows), [])  # type: ignore[misc]
    made = joined_tables(path, tables)
    if made is not None:
        made.notes.extend(notes)
    return made


def _refuse_columns_in_rows(row: dict[str, Any], key: str, count: int, path: Path) -> None:
    """Refuse a list whose objects are stretches, such as laps, with a list for each channel: none is a row."""
    if is_channel(row):
        raise _no_rows(path)
    tracks = [n for n, one in row.items() if isinstance(one, list) and len(one) >= _FEWEST_ROWS]
    tracks = [name for name in tracks if all(isinstance(item, dict) for item in row[name])]
    if tracks:
        place = f"[{key!r}][0][{tracks[0]!r}]" if key else f"[0][{tracks[0]!r}]"
        raise LogError(
            f"is a list of {count} objects with a list of rows each ({tracks[0]}: {len(row[tracks[0]]):,} in the "
            "first), such as tracks",
            where=path.name,
            advice=f'Write the one that you need as a file, the first for instance by python -c "import json; '
            f"json.dump(json.load(open('{path.name}')){place}, open('first.json', 'w'))\".",
        )
    lists = {name: len(one) for name, one in row.items() if isinstance(one, list)}
    if not _are_columns(list(lists.values())):
        return
    longest = [name for name, length in lists.items() if length == max(lists.values())]
    place = f"[{key!r}][0]" if key else "[0]"
    raise LogError(
        f"is a list of {count} objects with a list for each channel ({longest[0]}, {longest[1]}, ...: "
        f"{max(lists.values()):,} numbers in the first), such as laps",
        where=path.name,
        advice=f'Write each as a file of its own, the first for instance by python -c "import json; '
        f"json.dump(json.load(open('{path.name}')){place}, open('first.json', 'w'))\".",
    )


def _columns(path: Path, keys: Sequence[str], length: int, notes: list[ReadNote]) -> RawRecording:
    """Return a recording of the lists of an object, all of one length."""
    signals, unique = {}, UniqueNames()
    wanted = set(keys)
    for key, elements in JsonDocument(path).lists():
        if not wanted:
            break  # what comes after may be damaged
        if key not in wanted:
            continue
        wanted.remove(key)
        column = GrowingColumn()
        numbers = map(_number, itertools.islice(elements, length))
        while len(piece := np.fromiter(itertools.islice(numbers, _ROWS_AT_ONCE), dtype=float)):
            column.append(piece)
        own, unit = split_name_and_unit(key)
        own = unique.of(own or key)
        signals[own] = RawSignal(own, None, column.finished(), unit)
    if unique.renamed:
        notes.append(ReadNote("column names that occur twice, numbered", path.name, unique.renamed))
    return TableRecording(path.name, path, signals, notes=notes)


def _rows(path: Path, notes: list[ReadNote]) -> Iterator[dict[str, Any]]:
    """Yield the objects of a file; lines that are none are counted."""
    damaged = 0
    with path.open("rb") as stream:
        while line := stream.readline(LONGEST_ELEMENT):
            if line.isspace():
                continue
            row = parsed(line)
            if isinstance(row, dict):
                yield row
            else:
                damaged += 1
    if damaged:
        note_once(notes, "lines that hold no object, left out", path.name, damaged)


def _rows_of_places(path: Path) -> Iterator[dict[str, Any]]:
    """Yield some objects from places all over a file of lines; what a place cuts in two is left out."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        for place in range(1, _PLACES):
            stream.seek(size * place // _PLACES)
            stream.readline(LONGEST_ELEMENT)
            begin = stream.tell()
            for _ in range(_ROWS_A_PLACE):
                row = parsed(stream.readline(LONGEST_ELEMENT))
                if isinstance(row, dict):
                    yield row
                if stream.tell() > begin + _BYTES_A_PLACE:
                    break


def _numbers_of(value: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, float]]:
    """Yield address and value of every number, and of every text that is a time."""
    if depth > _DEEPEST or len(prefix) > LONGEST_NAME:
        return
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers_of(item, f"{prefix}.{key}" if prefix else str(key), depth + 1)
    elif isinstance(value, list):
        for index, item in enumerate(value[:_LISTED_ELEMENTS]):
            yield from _numbers_of(item, f"{prefix}[{index}]", depth + 1)
    elif prefix:
        number = _number(value)
        if not math.isnan(number):
            yield prefix, number


def _units_of(value: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, str]]:
    """Yield address and unit of what has its unit beside it: ``{"value": 57.3, "unit": "km/h"}``."""
    if not isinstance(value, dict) or depth > _DEEPEST or len(prefix) > LONGEST_NAME:
        return
    unit = next((item for key, item in value.items() if key.lower() in ("unit", "units")), None)
    for key, item in value.items():
        address = f"{prefix}.{key}" if prefix else str(key)
        yield from _units_of(item, address, depth + 1)
        if isinstance(unit, str) and prefix:
            yield address, unit


def _number(value: Any) -> float:
    """Return a number, also one in quotes, or a text that is a time, as seconds; NaN for anything else."""
    if isinstance(value, bool | int | float):
        try:
            return float(value)
        except OverflowError:
            return math.nan
    if not isinstance(value, str) or len(value) >= _LONGEST_NUMBER:
        return math.nan
    return float(value) if _NUMBER.fullmatch(value) else seconds_of(value)


def _are_columns(lengths: Sequence[int]) -> bool:
    """Whether lists are columns: two or more, of one length, and more rows than a row has elements."""
    return len(lengths) > 1 and lengths.count(max(lengths)) > 1 and max(lengths) > _LISTED_ELEMENTS


def _no_rows(path: Path) -> LogError:
    if path.stat().st_size > LARGEST_DOCUMENT:
        what = f"is one JSON document of more than {LARGEST_DOCUMENT >> 20} MB without a list of rows of numbers"
        advice = (
            "Beyond that size rows are read from one list, and channels by their names, "
            '{"speed": {"values": [...]}}: write it so, '
            "or a shorter stretch, or CSV or Parquet."
        )
        return LogError(what, where=path.name, advice=advice)
    advice = (
        "Write one object a line, each with its time; or an object for each channel, with its name and the list "
        "`values`; or CSV or Parquet. Pandas writes rows with `to_json(path, orient='records', lines=True)`."
    )
    return LogError("is JSON without rows of numbers", where=path.name, advice=advice)
