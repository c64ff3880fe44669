"""ASCII exports of Pi Toolbox (Cosworth): one block for all channels, or a block for each with its own clock."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.raw import (
    RawRecording,
    RawSignal,
    ReadNote,
    TableRecording,
    UniqueNames,
    column_name_and_unit,
    note_once,
)
from split_cli.logs.readers.budget import refuse_many_columns
from split_cli.logs.scratch import GrowingColumn
from split_cli.signals import find_unit

__all__ = ["is_pi_toolbox", "open_pi_toolbox"]

_BLOCK = "{channelblock}"
_LONGEST_LINE = 4 << 20
"""[bytes]; judgement: a row of a thousand numbers has 12 kB. What goes on is a line of its own."""
_NUMBERS_AT_ONCE = 1 << 16


def is_pi_toolbox(head: bytes) -> bool:
    """Tell an export by its first word."""
    return head.removeprefix(b"\xef\xbb\xbf").startswith(b"PiToolbox")


def open_pi_toolbox(path: Path) -> RawRecording:
    """Open an export. The first column of a block is its time; a name that occurs twice is numbered.

    Raises
    ------
    LogError
        If no block holds a row of numbers, or there are more columns than `refuse_many_columns` allows.
    """
    notes: list[ReadNote] = []
    blocks = _blocks(path)
    bad = sum(block.bad for block in blocks)
    if bad:
        note_once(notes, ReadNote("rows with too few or too many cells, or no numbers, left out", path.name, bad))
    alone = len(blocks) == 1
    signals: dict[str, RawSignal] = {}
    unique = UniqueNames()
    for block in blocks:
        clock, unit = column_name_and_unit(block.titles[0])
        known = find_unit(unit or "s")
        time, *columns = block.finished()
        if not len(time):
            continue
        time = time * known.factor if known is not None and known.si == "s" else time
        if alone:
            signals[unique.of(clock)] = RawSignal(clock, None, time, "s")
        for place, (title, values) in enumerate(zip(block.titles[1:], columns, strict=True), 2):
            name, unit = column_name_and_unit(title)
            name = unique.of(name or f"column{place}")
            known = find_unit(unit) if unit else None
            signals[name] = RawSignal(name, None if alone else time, values, known.symbol if known else unit)
    if not signals:
        raise LogError("holds no rows of numbers", where=path.name, advice="Export the outing again.")
    return TableRecording(path.name, path, signals, notes=notes)


class _Block:
    """Titles and rows of one block; an empty cell is missing.

    Attributes
    ----------
    bad : int
        Rows that are none.
    """

    def __init__(self, titles: list[str]) -> None:
        self.titles = titles
        self.bad = 0
        self._rows: list[list[float]] = []
        self._columns = [GrowingColumn() for _ in titles]

    def add(self, row: str) -> None:
        """Take in one row."""
        width = len(self.titles)
        cells = row.replace(",", ".").split("\t")[:width]
        try:
            # Python takes 1_5 for 15; no logger writes that.
            numbers = [float(cell) if cell.strip() else np.nan for cell in cells] if "_" not in row else []
        except ValueError:
            numbers = []
        if len(numbers) != width or not np.isfinite(numbers[0]):
            self.bad += 1
            return
        self._rows.append(numbers)
        if width * len(self._rows) >= _NUMBERS_AT_ONCE:
            self._hand_over()

    def finished(self) -> list[np.ndarray]:
        """Return the columns, shapes (N,)."""
        self._hand_over()
        return [column.finished() for column in self._columns]

    def _hand_over(self) -> None:
        rows = np.array(self._rows, dtype=float).reshape(len(self._rows), len(self.titles))
        for column, values in zip(self._columns, rows.T, strict=True):
            column.append(values)
        self._rows = []


def _blocks(path: Path) -> list[_Block]:
    """Return the blocks of an export that have two columns or more."""
    found: list[_Block] = []
    inside = titled = False
    columns = 0
    for line in _lines(path):
        if line.startswith("{"):
            inside, titled = line.strip().lower() == _BLOCK, False
        elif inside:
            if titled:
                found[-1].add(line)
                continue
            titles = [title.strip() for title in line.split("\t")]
            columns += len(titles)
            refuse_many_columns(columns, path.name)
            # A block of one column has a time and no channel.
            titled = inside = len(titles) > 1
            if titled:
                found.append(_Block(titles))
    return found


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines that are not empty, those that are no UTF-8 as Western European."""
    with path.open("rb") as stream:
        mark = b"\xef\xbb\xbf"
        while raw := stream.readline(_LONGEST_LINE):
            if raw.isspace():
                continue
            raw, mark = raw.removeprefix(mark), b""
            try:
                line = raw.decode()
            except UnicodeDecodeError:
                line = raw.decode("cp1252", errors="replace")
            yield line.rstrip("\r\n")
