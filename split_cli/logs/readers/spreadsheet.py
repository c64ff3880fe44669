"""Spreadsheets of Excel (.xlsx): the sheet with the most numbers, or those with a time each, as their CSV reads."""

import csv
import itertools
import re
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import date, time, timedelta
from pathlib import Path
from typing import Any

from split_cli.errors import LogError, damaged
from split_cli.files import ScratchFolder
from split_cli.logs.budget import refuse_unpacked_size
from split_cli.logs.raw import RawRecording, ReadNote
from split_cli.logs.readers.delimited import open_delimited
from split_cli.logs.readers.several_tables import joined_tables

_SHEET = re.compile(r"xl/worksheets/[^/]+\.xml")
_FEWEST = 20
"""Numbers of a sheet that may be a log beside another [1]; judgement: a sheet about the car has fewer."""
_ROWS_LOOKED_AT = 400
"""Of each sheet, to see which holds the log [1]; judgement."""


def is_spreadsheet(path: Path, head: bytes) -> bool:
    """Tell a workbook of Excel: a zip archive with its sheets in it."""
    if not head.startswith(b"PK\x03\x04") or not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return any(_SHEET.fullmatch(name) for name in archive.namelist())


def open_spreadsheet(path: Path) -> RawRecording:
    """Open the sheet of a workbook that holds the most numbers; of formulas the stored results are taken.

    Sheets of several sensors, each with a column of time, are read together.

    Raises
    ------
    LogError
        If it is damaged, or no sheet is a table of numbers.
    """
    scratch = ScratchFolder()
    table = scratch.path / path.name
    try:
        _refuse_what_exhausts_memory(path)
        sheets = _sheets(path)
        numbers = {name: _numbers(itertools.islice(rows, _ROWS_LOOKED_AT)) for name, rows in sheets.items()}
        chosen = max(numbers, key=lambda name: numbers[name])
        if (together := _together(path, [n for n, count in numbers.items() if count >= _FEWEST], scratch)) is not None:
            return together
        with table.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows(_of_one_width(_sheets(path)[chosen]))
    except LogError:
        raise
    except Exception as error:  # what a damaged workbook does to openpyxl is not stated
        raise damaged(path, error, "Save it again.") from error
    read: Any = open_delimited(table)
    recording: Any = replace(read, name=path.name, path=path)
    recording.scratch = scratch  # which lives as long as what is read from it
    others = sum(count > 0 for count in numbers.values()) - 1
    if others > 0:
        recording.notes.append(ReadNote(f"other sheets with numbers, left out: {chosen} is read", path.name, others))
    made: RawRecording = recording
    return made


def _together(path: Path, names: Sequence[str], scratch: ScratchFolder) -> RawRecording | None:
    """Return the sheets of a workbook with a sheet for each sensor; None where fewer than two have a time."""
    tables: dict[str, RawRecording] = {}
    for number, name in enumerate(names if len(names) > 1 else ()):
        table = scratch.path / f"{number}.csv"
        with table.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows(_of_one_width(_sheets(path)[name]))
        with suppress(LogError):
            tables[name] = replace(open_delimited(table), name=f"{path.name}, {name}")  # type: ignore[type-var]
    return joined_tables(path, tables)


def _refuse_what_exhausts_memory(path: Path) -> None:
    """Refuse parts that claim to be far larger than they are stored, or define entities."""
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            refuse_unpacked_size(info.file_size, info.compress_size, info.filename, path.name)
            with archive.open(info) as part:
                if b"<!DOCTYPE" in part.read(4096):
                    raise LogError("holds definitions that no program writes", where=path.name, advice="Save it again.")


def _sheets(path: Path) -> dict[str, Iterator[tuple[Any, ...]]]:
    """Return the rows of every sheet by its name; they are read as they are asked for."""
    from openpyxl import load_workbook

    workbook = load_workbook(path, read_only=True, data_only=True)
    for sheet in workbook.worksheets:
        sheet.reset_dimensions()  # what other programs state of a sheet's size is often wrong
    return {sheet.title: sheet.iter_rows(values_only=True) for sheet in workbook.worksheets}


def _numbers(rows: Iterable[tuple[Any, ...]]) -> int:
    return sum(isinstance(cell, int | float) for row in rows for cell in row)


def _of_one_width(rows: Iterator[tuple[Any, ...]]) -> Iterator[list[str]]:
    """Yield rows as texts, with empty cells at the end as far as any of the first ones goes: Excel stores none."""
    first = [_texts(row) for row in itertools.islice(rows, _ROWS_LOOKED_AT)]
    width = max(map(len, first), default=0)
    for row in itertools.chain(first, map(_texts, rows)):
        yield row + [""] * (width - len(row))


def _texts(row: tuple[Any, ...]) -> list[str]:
    """Return cells as texts, those that are empty at the end left out."""
    texts = [_text(cell) for cell in row]
    while texts and not texts[-1]:
        texts.pop()
    return texts


def _text(cell: Any) -> str:
    if isinstance(cell, date | time):
        return cell.isoformat()
    if isinstance(cell, timedelta):
        return repr(cell.total_seconds())
    return "" if cell is None else str(cell)
