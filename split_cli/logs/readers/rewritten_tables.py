"""Tables of numbers that are written anew before they are read: touching columns, exponents with D, channels as rows.

Each is written as the CSV that it would be exported to, a line at a time, into a folder of its own.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from split_cli.files import ScratchFolder
from split_cli.logs.raw import RawRecording, ReadNote
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.delimited import open_delimited

_Rows = Callable[[Iterator[str]], Iterator[Sequence[str]]]
_SHOWN = 60
"""Lines that are looked at [1]; judgement."""
_FEWEST_A_LINE = 20
"""Numbers behind a name, from which on a line is a channel and no row [1]; judgement."""
_LONGEST = 1 << 24
"""Of a line with all values of a channel [bytes]; judgement: a million values."""
_MOST_CHANNELS, _LARGEST_ON_ITS_SIDE = 500, 64 << 20
"""Lines of a table on its side, and its size [1, bytes]: it is held as a whole to be turned; judgement."""
_EXPONENT = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d{1,3}(?!\S*[A-Za-z]))")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_TOUCHES = re.compile(r"\d-\d|\.\d+\.\d")
"""Two numbers of one word: a minus behind a digit, or two points."""
_WORD = re.compile(r"[^\W\deEdD]|:")
_PIECES, _PIECE = 64, 1 << 16
"""Of a long file, that are looked at, and their size [bytes]; judgement."""
_DATE_AND_CLOCK = re.compile(r"\s*(\d{4}[/-]\d\d?[/-]\d\d?)\s+(\d\d?:\d\d:\d\d\S*)\s")


def open_rewritten(path: Path) -> RawRecording | None:
    """Open a table of such a form; None of any other text.

    Raises
    ------
    LogError
        If what was written anew is no table of numbers.
    """
    form = _form_of(path)
    if form is None:
        return None
    rows, what = form
    scratch = ScratchFolder()
    table = scratch.path / path.name
    with path.open("rb") as stream, table.open("w", encoding="utf-8", newline="") as made:
        pieces = iter(lambda: stream.readline(_LONGEST), b"")
        csv.writer(made).writerows(rows(decoded(line).rstrip("\r\n") for line in pieces))
    read: Any = open_delimited(table)
    recording: Any = replace(read, name=path.name, path=path)
    recording.scratch = scratch  # which lives as long as what is read from it
    recording.notes.append(ReadNote(what, path.name))
    made_of: RawRecording = recording
    return made_of


def is_rewritten(path: Path) -> bool:
    """Whether a text is a table of such a form."""
    return _form_of(path) is not None


def _form_of(path: Path) -> tuple[_Rows, str] | None:
    with path.open("rb") as stream:
        head = [decoded(line) for line in stream.read(_PIECE).splitlines()[:-1]]
    return _form([line for line in head if line.strip()][:_SHOWN], path) or _of_channels_in_rows(path)


def _form(lines: Sequence[str], path: Path) -> tuple[_Rows, str] | None:
    tail = lines[len(lines) // 3 :]
    if len(tail) < 3:
        return None
    if sum(bool(_EXPONENT.search(line)) for line in tail) > 0.9 * len(tail):
        return _with_exponents, "exponents written with D, as FORTRAN does, are read"
    if ends := _ends_of_columns(lines, path):
        return lambda text: _cut(text, ends), "columns of fixed width whose numbers touch: cut where they end"
    if all(_DATE_AND_CLOCK.match(line) for line in tail) and _title_of_both(lines):
        return _with_moments, "date and clock under one title are one moment"
    return None


def _with_exponents(lines: Iterator[str]) -> Iterator[Sequence[str]]:
    for line in lines:
        cells = line.replace(",", " ").replace(";", " ").split()
        yield [_EXPONENT.sub("E", cell) for cell in cells]


def _ends_of_columns(lines: Sequence[str], path: Path) -> tuple[int, ...]:
    """Return where columns of fixed width end [signs]; empty unless numbers touch in some rows.

    Numbers that stand to the right end in the same places in all rows, also in those in which they touch.
    """
    rows = [line.rstrip() for line in lines if "," not in line and ";" not in line and "\t" not in line]
    if len(rows) < 0.9 * len(lines) or not _numbers_touch(path):
        return ()
    words = [[(found[0], found.end()) for found in re.finditer(r"\S+", row)] for row in rows]
    plain = [tuple(end for _, end in row) for row in words if row and all(_NUMBER.fullmatch(w) for w, _ in row)]
    common = Counter(plain).most_common(1)
    if not common or len(common[0][0]) < 2:
        return ()
    ends = common[0][0]
    values = [row for row in rows if re.match(r"\s*[+-]?[\d.]", row)]
    fit = sum(all(_NUMBER.fullmatch(cell.strip()) for cell in _cells(row, ends)) for row in values)
    return ends if fit > 0.9 * len(values) else ()


def _numbers_touch(path: Path) -> bool:
    """Whether two numbers touch in some row; of a long file pieces all over it are looked at."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        for place in range(_PIECES if size > _PIECES * _PIECE else 1):
            stream.seek(size * place // _PIECES)
            text = stream.read(_PIECE if size > _PIECES * _PIECE else -1)
            if any(_TOUCHES.search(line) and not _WORD.search(line) for line in decoded(text).splitlines()[1:-1]):
                return True
    return False


def _cells(line: str, ends: Sequence[int]) -> list[str]:
    return [line[begin:end] for begin, end in pairwise((0, *ends))]


def _cut(lines: Iterator[str], ends: Sequence[int]) -> Iterator[Sequence[str]]:
    for line in lines:
        words = line.split()
        is_row = all(_NUMBER.fullmatch(cell.strip()) for cell in _cells(line, ends))
        yield [cell.strip() for cell in _cells(line, ends)] if is_row or len(words) != len(ends) else words


def _title_of_both(lines: Sequence[str]) -> bool:
    """Whether a line of titles has one less than the rows have words: date and clock stand under one."""
    count = len(lines[-1].split())
    above = [line for line in lines if not _DATE_AND_CLOCK.match(line)]
    return bool(above) and len(above[-1].lstrip("#%/ ").split()) == count - 1


def _with_moments(lines: Iterator[str]) -> Iterator[Sequence[str]]:
    for line in lines:
        found = _DATE_AND_CLOCK.match(line)
        if found is None:
            yield line.lstrip("#%/ ").split()
        else:
            yield [f"{found[1].replace('/', '-')}T{found[2]}", *line[found.end() :].split()]


def _of_channels_in_rows(path: Path) -> tuple[_Rows, str] | None:
    """Tell a table on its side: a line for each channel, its name in front of all its values."""
    if path.stat().st_size > _LARGEST_ON_ITS_SIDE:
        return None
    titles: list[str] = []
    counts: set[int] = set()
    separator = ""
    with path.open("rb") as stream:
        while line := stream.readline(_LONGEST):
            text = decoded(line).rstrip("\r\n")
            if not text.strip():
                continue
            separator = separator or max(",;\t", key=text.count)
            name, *cells = text.split(separator)
            if len(cells) < _FEWEST_A_LINE or _NUMBER.fullmatch(name.strip()) or len(titles) == _MOST_CHANNELS:
                return None
            if not all(_NUMBER.fullmatch(cell.strip()) for cell in cells[:_FEWEST_A_LINE]):
                return None
            titles.append(name)
            counts.add(len(cells))
    if len(counts) != 1 or not 2 <= len(titles) < min(counts) or len(set(titles)) < len(titles):
        return None

    def rows(lines: Iterator[str]) -> Iterator[Sequence[str]]:
        yield from zip(*(line.split(separator) for line in lines if line.strip()), strict=True)

    return rows, "a line for each channel: lines and columns exchanged"
