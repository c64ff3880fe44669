"""Rows above the values of a table that are neither titles nor units: rules, factors, lists of channels."""

import re
from collections.abc import Sequence

LABELS_OF_NAMES = ("name", "names", "channel name", "channel", "channels", "signal name", "signal", "signals", "title")
"""What stands before the names where each row above the values begins with what it holds (name, unit, comment)."""
RULED = re.compile(r":?[-=+]{2,}:?")
"""What a line under the titles is drawn with, in Markdown and by data bases."""
_FACTORS = ("factor", "faktor", "facteur", "scale", "scaling", "gain", "multiplier", "resolution")
_OFFSETS = ("offset", "offsets", "versatz")
"""What stands before the factors and the offsets that make whole numbers quantities, in rows above the values."""
_NUMBER = {mark: re.compile(rf"[+-]?(\d+({re.escape(mark)}\d*)?|{re.escape(mark)}\d+)([eE][+-]?\d+)?") for mark in ".,"}


def is_scaling(row: Sequence[str], decimal: str) -> bool:
    """Tell a row of factors or of offsets: it begins with that word, and all other cells are numbers."""
    return _scales(row, (*_FACTORS, *_OFFSETS), decimal)


def _scales(row: Sequence[str], labels: tuple[str, ...], decimal: str) -> bool:
    filled = [cell.strip() for cell in row[1:] if cell.strip()]
    label = row[0].strip().rstrip(":").lower() if row else ""
    return label in labels and bool(filled) and all(map(_NUMBER[decimal].fullmatch, filled))


def scaling_rows(rows: Sequence[Sequence[str]], width: int, decimal: str) -> list[list[str] | None]:
    """Return the rows of factors and of offsets above the values, a cell a column; None of one that is missing."""
    found = []
    for labels in (_FACTORS, _OFFSETS):
        row = next((row for row in rows if len(row) <= width and _scales(row, labels, decimal)), None)
        found.append(None if row is None else [*row, *[""] * (width - len(row))])
    return found


def listed_names(rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return titles from lines above the values that name a channel each, ``Channel : Yaw rate``; empty where none do.

    There are as many as columns, or one less, where the first column is the time.
    """
    parted = [row[0].partition(":") for row in rows if row and ":" in row[0]]
    names = [name.strip() for label, _, name in parted if label.strip().lower() in LABELS_OF_NAMES and name.strip()]
    if len(names) < 2 or len(names) not in (width, width - 1):
        return []
    return names if len(names) == width else ["Time", *names]
