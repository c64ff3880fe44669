"""ASCII exports of Pi Toolbox (Cosworth): one block for all channels, or a block for each with its own clock."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import RawRecording, RawSignal, ReadNote, TableRecording, UniqueNames
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.delimited import read_columns
from split_cli.logs.readers.dialect import LONGEST_LINE, Dialect
from split_cli.signals import find_unit, split_name_and_unit, symbol_of

_BLOCK, _BRACE = b"{channelblock}", ord("{")


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
    lost: Counter[tuple[str, str]] = Counter()
    blocks = list(_blocks(path))
    alone = len(blocks) == 1
    signals: dict[str, RawSignal] = {}
    unique = UniqueNames()
    for block in blocks:
        found: list[ReadNote] = []
        columns = read_columns(path, block.dialect, block.width, dict(enumerate(block.titles)), found)
        timed = np.isfinite(columns[0])
        if not timed.all():
            found.append(ReadNote("rows without a time, left out", path.name, int((~timed).sum())))
            columns = {index: values[timed] for index, values in columns.items()}
        lost.update({(note.what, note.where): note.count for note in found})
        if not timed.any():
            continue
        clock, unit = split_name_and_unit(block.titles[0])
        known = find_unit(unit or "s")
        factor = known.factor if known is not None and known.si == "s" else 1.0
        time = columns[0] if factor == 1.0 else columns[0] * factor
        if alone:
            signals[unique.of(clock)] = RawSignal(clock, None, time, "s")
        for place, title in enumerate(block.titles[1:], 1):
            name, unit = split_name_and_unit(title)
            name = unique.of(name or f"column{place + 1}")
            signals[name] = RawSignal(name, None if alone else time, columns[place], symbol_of(unit))
    if not signals:
        raise LogError("holds no rows of numbers", where=path.name, advice="Export the outing again.")
    notes = [ReadNote(what, where, count) for (what, where), count in lost.items()]
    return TableRecording(path.name, path, signals, notes=notes)


@dataclass(frozen=True)
class _TextBlock:
    """Titles of one block, and where its rows stand in the file."""

    titles: list[str]
    width: int  # cells of its rows: a tabulator may end each
    dialect: Dialect


def _blocks(path: Path) -> Iterator[_TextBlock]:
    """Yield the blocks of an export that have two columns and a row or more."""
    columns = 0
    inside, comma, first = False, False, 0
    titles: list[str] = []
    end = width = 0
    with path.open("rb") as stream:
        while True:
            line = stream.readline(LONGEST_LINE)
            if (not line or line[0] == _BRACE) and len(titles) > 1 and width:
                yield _TextBlock(titles, width, Dialect("\t", "," if comma else ".", "utf-8", first, end=end))
            if not line:
                return
            begin, end = end, end + len(line)
            if line[0] == _BRACE:
                inside, comma, titles, width = line.strip().lower() == _BLOCK, False, [], 0
            elif inside and not width and not line.isspace():
                if titles:
                    first, width = begin, len(titles) + _ends_in_a_tabulator(line, len(titles))
                else:
                    titles = [title.strip() for title in decoded(line).split("\t")]
                    columns += len(titles)
                    refuse_many_columns(columns, path.name)
                    # A block of one column has a time and no channel.
                    inside = len(titles) > 1
            if width and not comma:
                comma = b"," in line


def _ends_in_a_tabulator(row: bytes, width: int) -> bool:
    """Tell whether an empty cell follows those of the titles."""
    cells = row.split(b"\t")
    return len(cells) == width + 1 and not cells[-1].strip()
