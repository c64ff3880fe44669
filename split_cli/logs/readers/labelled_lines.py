"""Lines of values that each have their name in front: ``t:12,ax:0.1`` of a serial port, ``time=.. speed=..``."""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from split_cli.logs.raw import RawRecording, ReadNote, note_once
from split_cli.logs.readers.cells import number_of
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.dialect import LONGEST_LINE
from split_cli.logs.readers.json_rows import table_of_rows

_PAIR = re.compile(r"\s*([^\W\d][^:=,;\t\"]{0,80}?) ?[:=] ?(\"[^\"]*\"|[^,;\s]*)(?:[,;\t ]+|$)")
_FRONT = re.compile(r"(?:[A-Z]+ *)?(?:\[[^\]]{0,80}\]\s*)+:?\s*")
_BRACKETS = re.compile(r"\[([^\]]*)\]")
"""What a program that logs to a console writes before its text, in brackets: its level, its name, and the time."""
_LINES, _FEWEST = 60, 6
"""Lines that are looked at, and those of one form that show it [1]; judgement."""


def is_labelled(head: bytes) -> bool:
    """Tell by the first bytes of a file whether its lines hold names with values, two or more, in one order.

    What a program says before it begins to log is of no form: the last lines decide.
    """
    lines = [line for line in decoded(head).splitlines()[:-1] if line.strip()][-_LINES:]
    forms = Counter(tuple(row) for row in map(_row, lines) if len(row) > 1)
    return bool(forms) and sum(forms.values()) >= max(_FEWEST, 0.9 * len(lines) - 5) and _numbers(lines)


def _numbers(lines: list[str]) -> bool:
    """Whether half of the values are numbers."""
    values = [value for line in lines for value in _row(line).values()]
    return 2 * sum(isinstance(value, float) and value == value for value in values) >= len(values) > 0


def _row(line: str) -> dict[str, Any]:
    """Return the values of a line by name; empty for a line that holds anything else beside them."""
    row: dict[str, Any] = {}
    at, text = 0, line.strip()
    if (front := _FRONT.match(text)) is not None:
        stamps = [s for s in (number_of(cell, ".") for cell in _BRACKETS.findall(front[0])) if s == s]
        row = {"time": stamps[0]} if stamps else {}
        at = front.end()
    while at < len(text):
        found = _PAIR.match(text, at)
        if found is None:
            return {}
        row[found[1].strip()] = number_of(found[2].strip('"').strip(), ".")
        at = found.end()
    return row


def open_labelled(path: Path) -> RawRecording:
    """Open lines of names with values: a column for each name; lines of any other form are counted.

    Raises
    ------
    LogError
        If no line holds a number.
    """
    notes: list[ReadNote] = []

    def rows() -> Iterator[dict[str, Any]]:
        others = 0
        with path.open("rb") as stream:
            while raw := stream.readline(LONGEST_LINE):
                row = _row(decoded(raw)) if not raw.isspace() else {}
                if row:
                    yield row
                else:
                    others += not raw.isspace()
        if others:
            note_once(notes, "lines of another form than names with values, left out", path.name, others)

    return table_of_rows(path, rows, notes)
