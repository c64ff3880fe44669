"""Rows written as JSON: an object a line (JSON lines, donkeycar catalogs), a list of objects, a list a column."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.raw import (
    LazyTableRecording,
    RawChannelInfo,
    RawRecording,
    RawSignal,
    ReadNote,
    TableRecording,
    column_name_and_unit,
    note_once,
)
from split_cli.logs.readers.budget import MOST_FIELDS
from split_cli.logs.readers.delimited import seconds_of
from split_cli.logs.scratch import GrowingColumn

__all__ = ["is_json", "open_json"]

_MOST_BYTES = 256 << 20
"""Of a document that is one piece and has to be read at once [bytes]; rows of an object each have no limit."""
_LONGEST_LINE = 4 << 20
_LISTED_ROWS = 200
"""Rows whose fields are listed: an event writes fields that the first row lacks [1]."""
_PIECE = 4096
_DEEPEST = 12
_LISTED_ELEMENTS = 64


def is_json(head: bytes) -> bool:
    """Tell JSON by its first characters: an object with a quoted key, or a list of objects or of numbers."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    inside = text[1:].lstrip()[:1]
    return (text[:1] == b"{" and inside == b'"') or (text[:1] == b"[" and inside == b"{")


def open_json(path: Path) -> RawRecording:
    """Open rows written as JSON; a field inside others is addressed as ``imu.gyro.z``, an element as ``q[0]``.

    A text that is a time (ISO 8601) reads as seconds since 1970. Fields that a row lacks are missing in it.

    Raises
    ------
    LogError
        If it holds no rows of numbers, or is one piece too large to be read at once.
    """
    with path.open("rb") as stream:
        first = stream.readline(_LONGEST_LINE)
    if not isinstance(_parsed(first), dict) or _has_columns(_parsed(first)):
        return _whole(path)
    notes: list[ReadNote] = []
    known: dict[str, None] = {}
    for row, _ in zip(_rows(path, []), range(_LISTED_ROWS), strict=False):
        known |= dict.fromkeys(name for name, _ in _numbers_of(row))
        if len(known) > MOST_FIELDS:
            raise _no_rows(path)
    if not known:
        raise _no_rows(path)
    infos = [_info(name) for name in known]
    real = {info.name: name for info, name in zip(infos, known, strict=True)}

    def load(names: Sequence[str]) -> dict[str, RawSignal]:
        wanted = {real[name]: place for place, name in enumerate(names)}
        columns = [GrowingColumn() for _ in names]
        for piece in _pieces(_rows(path, notes)):
            values = np.full((len(piece), len(names)), np.nan)
            for at, row in enumerate(piece):
                for name, number in _numbers_of(row):
                    if name in wanted:
                        values[at, wanted[name]] = number
            for place, column in enumerate(columns):
                column.append(values[:, place])
        units = {info.name: info.unit for info in infos}
        return {
            name: RawSignal(name, None, column.finished(), units[name])
            for name, column in zip(names, columns, strict=True)
        }

    return LazyTableRecording(path.name, path, infos, load, notes=notes)


def _whole(path: Path) -> RawRecording:
    """Open a document in one piece: a list of objects, or an object with a list for each column."""
    if path.stat().st_size > _MOST_BYTES:
        advice = "Write one object a line (JSON lines), or CSV or Parquet."
        raise LogError("is one JSON document, too large to be read at once", where=path.name, advice=advice)
    document = _parsed(path.read_bytes())
    if isinstance(document, dict) and not _has_columns(document):
        # {"header": ..., "samples": [{...}, ...]}
        lists = [v for v in document.values() if isinstance(v, list) and v and isinstance(v[0], dict)]
        document = max(lists, key=len) if lists else document
    if isinstance(document, list):
        flat = [dict(_numbers_of(row)) for row in document if isinstance(row, dict)]
        names = list(dict.fromkeys(name for row in flat for name in row))
        columns = {name: [row.get(name, math.nan) for row in flat] for name in names}
    elif isinstance(document, dict) and _has_columns(document):
        columns = {name: v for name, v in document.items() if _is_column(v) and len(v) == _length(document)}
        columns = {name: [_number(x) for x in v] for name, v in columns.items()}
    else:
        raise _no_rows(path)
    if not columns or len(columns) > MOST_FIELDS:
        raise _no_rows(path)
    signals = {}
    for name, values in columns.items():
        info = _info(name)
        signals[info.name] = RawSignal(info.name, None, np.array(values, dtype=float), info.unit)
    return TableRecording(path.name, path, signals)


def _info(name: str) -> RawChannelInfo:
    own, unit = column_name_and_unit(name)
    return RawChannelInfo(own, "column", None, unit)


def _parsed(text: bytes) -> Any:
    try:
        return json.loads(text.removeprefix(b"\xef\xbb\xbf"))
    except (ValueError, RecursionError):
        return None


def _rows(path: Path, notes: list[ReadNote]) -> Iterator[dict[str, Any]]:
    """Yield the objects of a file; lines that are none are counted."""
    damaged = 0
    with path.open("rb") as stream:
        while line := stream.readline(_LONGEST_LINE):
            row = _parsed(line) if line.strip() else None
            if isinstance(row, dict):
                yield row
            else:
                damaged += bool(line.strip())
    if damaged:
        note_once(notes, ReadNote("lines that hold no object, left out", path.name, damaged))


def _pieces(rows: Iterator[dict[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    piece = []
    for row in rows:
        piece.append(row)
        if len(piece) == _PIECE:
            yield piece
            piece = []
    if piece:
        yield piece


def _numbers_of(value: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, float]]:
    """Yield address and value of every number, and of every text that is a time."""
    if depth > _DEEPEST:
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


def _number(value: Any) -> float:
    """Return a number, or a text that is a time, as seconds; NaN for anything else."""
    if isinstance(value, bool | int | float):
        try:
            return float(value)
        except OverflowError:
            return math.nan
    return seconds_of(value) if isinstance(value, str) and len(value) < 64 else math.nan


def _is_column(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 1 and not isinstance(value[0], dict | list)


def _length(document: dict[str, Any]) -> int:
    return max((len(v) for v in document.values() if _is_column(v)), default=0)


def _has_columns(document: Any) -> bool:
    """Whether an object holds a list for each column: two or more, of one length, and more rows than columns."""
    if not isinstance(document, dict):
        return False
    lengths = [len(v) for v in document.values() if _is_column(v)]
    return len(lengths) > 1 and lengths.count(max(lengths)) > 1 and max(lengths) > _LISTED_ELEMENTS


def _no_rows(path: Path) -> LogError:
    advice = "Write one object a line, each with its time, or CSV or Parquet."
    return LogError("is JSON without rows of numbers", where=path.name, advice=advice)
