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


def titles_a_list(row: Sequence[str]) -> bool:
    """Tell the titles of a list of channels above the values: one says Factor, and another Name or Signal."""
    labels = {cell.strip().strip(":").lower() for cell in row}
    return bool(labels & set(_FACTORS)) and bool(labels & set(LABELS_OF_NAMES))


def below_a_list(rows: Sequence[Sequence[str]]) -> Sequence[Sequence[str]]:
    """Return the rows below a list of channels above the values; all where there is none."""
    at = next((n for n, row in enumerate(rows) if titles_a_list(row)), None)
    if at is None:
        return rows
    return rows[next((n for n in range(at, len(rows)) if len(rows[n]) != len(rows[at])), len(rows)) :]


_KEYED = re.compile(r"(?<![A-Za-z])([A-Za-z]+)\s*[=:]\s*([^\s,;=]+)")
_UNITS = ("unit", "units", "einheit")


def listed_scaling(
    rows: Sequence[Sequence[str]], names: Sequence[str], decimal: str
) -> tuple[list[str], list[str], list[str]] | None:
    """Return factors, offsets and units from lines above the values that each describe a channel; None where none do.

    ``name=VehSpd unit=km/h factor=0.01 offset=0``, or a list of channels under titles that say Factor or Scale.
    """
    found: dict[str, dict[str, str]] = {}
    labels: list[str] = []
    for row in rows:
        cells = [cell.strip() for cell in row]
        if titles_a_list(cells):
            labels = [cell.strip(":").lower() for cell in cells]
            continue
        keyed = {key.lower(): value for key, value in _KEYED.findall(" ".join(cells))}
        if labels and not keyed and len(cells) == len(labels):
            keyed = dict(zip(labels, cells, strict=True))
        name = next((keyed[label] for label in LABELS_OF_NAMES if label in keyed and keyed[label] in names), "")
        if name and any(_NUMBER[decimal].fullmatch(keyed.get(label, "")) for label in _FACTORS):
            found[name] = keyed
    if not found:
        return None
    columns = [found.get(name, {}) for name in names]
    said = [[next((c[key] for key in keys if key in c), "") for c in columns] for keys in (_FACTORS, _OFFSETS, _UNITS)]
    return said[0], said[1], said[2]
