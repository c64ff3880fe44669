"""Spreadsheets of Excel (.xlsx): the sheet with the most rows of numbers, read as the table that it is exported to."""

import csv
import itertools
import re
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any
from xml.etree.ElementTree import ParseError, XMLPullParser

from split_cli.errors import LogError, damaged
from split_cli.files import ScratchFolder
from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS, refuse_unpacked_size
from split_cli.logs.raw import RawRecording, ReadNote
from split_cli.logs.readers.delimited import open_delimited

_SHEET = re.compile(r"xl/worksheets/[^/]+\.xml")
_TEXTS = "xl/sharedStrings.xml"
_PIECE = 1 << 16
_MOST_TEXTS = 1 << 20
"""Different texts of a workbook that are kept [1]: those of titles; rows of texts are no log."""
_ROWS_LOOKED_AT = 400
"""Of each sheet, to see which holds the log [1]; judgement."""


def is_spreadsheet(path: Path, head: bytes) -> bool:
    """Tell a workbook of Excel: a zip archive with its sheets in it."""
    if not head.startswith(b"PK\x03\x04") or not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return any(_SHEET.fullmatch(name) for name in archive.namelist())


def open_spreadsheet(path: Path) -> RawRecording:
    """Open the sheet of a workbook that holds the most numbers; dates count days, as Excel stores them.

    Raises
    ------
    LogError
        If it is damaged, or no sheet is a table of numbers.
    """
    scratch = ScratchFolder()
    table = scratch.path / path.name
    try:
        with zipfile.ZipFile(path) as archive:
            texts = _shared_texts(archive, path)
            sheets = [name for name in archive.namelist() if _SHEET.fullmatch(name)]
            begun = {name: itertools.islice(_rows(archive, name, texts, path), _ROWS_LOOKED_AT) for name in sheets}
            numbers = {name: _numbers(rows) for name, rows in begun.items()}
            chosen = max(sheets, key=lambda name: (numbers[name], archive.getinfo(name).file_size))
            with table.open("w", encoding="utf-8", newline="") as stream:
                writer = csv.writer(stream)
                writer.writerows(_of_one_width(_rows(archive, chosen, texts, path)))
    except (zipfile.BadZipFile, ParseError, NotImplementedError, RuntimeError, EOFError) as error:
        raise damaged(path, error, "Save it again.") from error
    read: Any = open_delimited(table)
    recording: Any = replace(read, name=path.name, path=path)
    recording.scratch = scratch  # which lives as long as what is read from it
    others = sum(numbers[name] > 0 for name in sheets) - 1
    if others:
        called = Path(chosen).stem
        recording.notes.append(ReadNote(f"other sheets with numbers, left out: {called} is read", path.name, others))
    made: RawRecording = recording
    return made


def _numbers(rows: Iterator[list[str]]) -> int:
    return sum(bool(re.fullmatch(r"[+-]?\d+(\.\d*)?([eE][+-]?\d+)?", cell)) for row in rows for cell in row)


def _of_one_width(rows: Iterator[list[str]]) -> Iterator[list[str]]:
    """Yield rows with empty cells at the end as far as any of the first ones goes: Excel stores none."""
    first = list(itertools.islice(rows, _ROWS_LOOKED_AT))
    width = max(map(len, first), default=0)
    for row in itertools.chain(first, rows):
        yield row + [""] * (width - len(row))


def _elements(archive: zipfile.ZipFile, name: str, path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the elements of a part as they end, their names without the name space; entities are refused."""
    info = archive.getinfo(name)
    refuse_unpacked_size(info.file_size, info.compress_size, name, path.name)
    parser: Any = XMLPullParser(("end",))
    with archive.open(name) as stream:
        for piece in _pieces(stream):
            if b"<!DOCTYPE" in piece or b"<!ENTITY" in piece:
                raise LogError("holds definitions that no program writes", where=path.name, advice="Save it again.")
            parser.feed(piece)
            for _, element in parser.read_events():
                yield element.tag.rpartition("}")[2], element


def _pieces(stream: IO[bytes]) -> Iterator[bytes]:
    while piece := stream.read(_PIECE):
        yield piece


def _shared_texts(archive: zipfile.ZipFile, path: Path) -> list[str]:
    texts: list[str] = []
    if _TEXTS not in archive.namelist():
        return texts
    for tag, element in _elements(archive, _TEXTS, path):
        if tag == "si":
            if len(texts) >= _MOST_TEXTS:
                raise LogError("holds more texts than a log has", where=path.name, advice="Export it as CSV.")
            texts.append("".join(part.text or "" for part in element.iter() if part.tag.endswith("}t"))[:LONGEST_NAME])
            element.clear()
    return texts


def _rows(archive: zipfile.ZipFile, name: str, texts: list[str], path: Path) -> Iterator[list[str]]:
    """Yield the cells of each row as texts, by their columns."""
    row: list[str] = []
    for tag, element in _elements(archive, name, path):
        if tag == "c":
            place = _column(element.get("r", "")) if element.get("r") else len(row)
            if len(row) <= place < MOST_FIELDS:
                row += [""] * (place - len(row)) + [_cell(element, texts)]
            element.clear()
        elif tag == "row":
            yield row
            row = []
            element.clear()
        elif tag == "sheetData":
            element.clear()


def _column(address: str) -> int:
    """Return the place of a cell in its row, from 0: C7 is 2."""
    letters = re.match(r"[A-Z]{1,3}", address)
    place = 0
    for letter in letters[0] if letters else "":
        place = 26 * place + ord(letter) - ord("A") + 1
    return place - 1


def _cell(element: Any, texts: list[str]) -> str:
    kind = element.get("t", "n")
    if kind == "inlineStr":
        return "".join(part.text or "" for part in element.iter() if part.tag.endswith("}t"))[:LONGEST_NAME]
    value = next((part.text or "" for part in element if part.tag.endswith("}v")), "")
    if kind == "s":
        return texts[int(value)] if value.isdigit() and int(value) < len(texts) else ""
    return "" if kind == "e" else value
