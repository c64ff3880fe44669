"""Coordinates in several columns (degrees, minutes and seconds), and both coordinates in one cell."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

_COORDINATE = re.compile(r"(?i)(?<![a-z])(lat|lon|lng|latitude|longitude|breite|l(ä|ae)nge)")
_PART = re.compile(
    r"(?i)(?P<stem>.*?)[\s_.(\[]+(?P<part>d|deg|degrees?|°|m|min|minutes?|arcmin|'|s|sec|seconds?|arcsec|\")[)\]]*"
)
_TITLED_PARTS = ("deg", "min", "sec")
_BOTH = re.compile(r"(?:POINT\s*)?[\[(]?\s*([+-]?\d{1,3}\.\d+)°?\s*[,; ]\s*([+-]?\d{1,3}\.\d+)°?\s*[\])]?")
_PLACE = re.compile(r"(?i)pos|coord|loc|gps|gnss|fix|lat.?lon|lon.?lat|point|place")
_MOST = 0.9
"""Of the filled cells, that hold two coordinates [1]; judgement."""


def parts_of_angles(titles: Sequence[str]) -> dict[int, tuple[int, ...]]:
    """Return the columns of degrees of coordinates, with those behind them that hold minutes, or minutes and seconds.

    The titles have one beginning, ``Lat_deg``, ``Lat_min``, ``Lat_sec``.
    """
    found: dict[int, tuple[int, ...]] = {}
    parted = [_PART.fullmatch(title.strip()) for title in titles]
    kinds = [(match["stem"].lower(), _kind(match["part"])) if match else ("", "") for match in parted]
    for place, (stem, kind) in enumerate(kinds):
        if kind != "d" or not _COORDINATE.search(stem) or (stem, "m") not in kinds[place + 1 : place + 2]:
            continue
        seconds = (stem, "s") in kinds[place + 2 : place + 3]
        found[place] = (place + 1, place + 2) if seconds else (place + 1,)
    return found


def _kind(part: str) -> str:
    first = part.lower().removeprefix("arc")[:1]
    return {"°": "d", "'": "m", '"': "s"}.get(first, first)


def in_degrees(degrees: np.ndarray, *parts: np.ndarray) -> np.ndarray:
    """Return an angle [deg] by its degrees, minutes and seconds, shape (N,); the degrees hold its sign."""
    size = np.abs(degrees) + sum((part / 60.0 ** (n + 1) for n, part in enumerate(parts)), np.zeros(len(degrees)))
    return np.asarray(np.where(np.signbit(degrees), -size, size))


def titles_of_parts(above: Sequence[Sequence[str]], width: int) -> list[list[str]]:
    """Return rows above the values, the nearest first, with a title for each column under a common one.

    ``Latitude`` over ``(D) (M) (S)`` becomes three titles, where that gives all columns one; other rows stay.
    """
    rows = [list(row) for row in above]
    for place, row in enumerate(rows[:-1]):
        bare = "".join(cell.strip("()[] ").upper()[:1] if len(cell.strip("()[] ")) == 1 else "." for cell in row)
        count = bare.count("DMS")
        titles = rows[place + 1]
        if len(row) != width or not count or len(titles) != width - 2 * count:
            continue
        made: list[str] = []
        at = 0
        while at < width and titles:
            title = titles[len(made) - 2 * sum(t.endswith(" sec") for t in made)]
            triple = bare[at : at + 3] == "DMS"
            made += [f"{title} {part}" for part in _TITLED_PARTS] if triple else [title]
            at += 3 if triple else 1
        rows[place + 1] = made
        rows[place] = ["" if letter in "DMS" else cell for cell, letter in zip(row, bare, strict=True)]
    return rows


def holds_both(title: str, cells: Sequence[str]) -> tuple[str, str] | None:
    """Return what the two numbers in each cell of a column are, ``latitude`` and ``longitude``; None of any other.

    The latitude stands first, as people write it, unless the title or a number beyond 90 degrees says otherwise.
    """
    filled = [cell.strip() for cell in cells if cell.strip()]
    pairs = [match for cell in filled if (match := _BOTH.fullmatch(cell))]
    if not filled or len(pairs) < _MOST * len(filled) or not _PLACE.search(title):
        return None
    farthest = max(abs(float(pair[1])) for pair in pairs)
    # Well-known text has the longitude first (OGC 06-103r4).
    turned = farthest > 90.0 or filled[0].startswith("POINT") or re.search(r"(?i)(lon|lng).?lat", title)
    return ("longitude", "latitude") if turned else ("latitude", "longitude")


_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_BETWEEN = r"(?:\s*[,;]\s*|\s+)"
_NAMED = rf"['\"]?\w+['\"]?\s*[:=]\s*{_NUMBER}"
_LIST = re.compile(rf"[\[(]\s*{_NUMBER}(?:{_BETWEEN}{_NUMBER})+\s*[\])]")
_PAIRS = re.compile(rf"\{{?\s*{_NAMED}(?:{_BETWEEN}{_NAMED})*\s*\}}?")
_PAIR = re.compile(rf"['\"]?(\w+)['\"]?\s*[:=]\s*({_NUMBER})")
_FEWEST_CELLS, _LONGEST_CELL = 5, 1000
"""Cells that show a form, and characters of one that is looked at [1]; judgement."""


def parts_of_cells(cells: Sequence[str]) -> list[str]:
    """Return what is behind a column's name for each number in its cells: ``[0]`` of a list, ``.x`` of named ones.

    Empty where the cells hold no two numbers, or not as many in each of the first rows.
    """
    filled = [cell.strip() for cell in cells if cell.strip()]
    if len(filled) < _FEWEST_CELLS or max(map(len, filled)) > _LONGEST_CELL:
        return []
    if all(map(_LIST.fullmatch, filled)):
        counts = {len(re.findall(_NUMBER, cell)) for cell in filled}
        return [f"[{n}]" for n in range(counts.pop())] if len(counts) == 1 else []
    if all(cell[:1] in "{'\"" or cell[:1].isalpha() for cell in filled) and all(map(_PAIRS.fullmatch, filled)):
        names = {tuple(name for name, _ in _PAIR.findall(cell)) for cell in filled}
        return [f".{name}" for name in names.pop()] if len(names) == 1 else []
    return []


def of_cells(cells: Sequence[str], part: str) -> np.ndarray:
    """Return the numbers of one part of all cells, shape (N,); NaN where a cell lacks it."""
    values = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        if part.startswith("["):
            numbers = re.findall(_NUMBER, cell)
            values[row] = float(numbers[int(part[1:-1])]) if len(numbers) > int(part[1:-1]) else np.nan
        else:
            values[row] = float(dict(_PAIR.findall(cell)).get(part[1:], "nan"))
    return values


def of_both(cells: Sequence[str], place: int) -> np.ndarray:
    """Return the first or the second number of each cell, shape (N,); NaN where a cell holds no two."""
    found = (_BOTH.fullmatch(cell.strip()) for cell in cells)
    return np.array([float(match[1 + place]) if match else np.nan for match in found])


def columns_in_cells(columns: Mapping[str, int], rows: Sequence[Sequence[str]]) -> dict[str, tuple[int, str]]:
    """Return names for the numbers in each cell of a column, with its place and which of them each is.

    Two coordinates are called so; a list, or numbers with names, are addressed as those of messages are.
    """
    found = {}
    for name, index in columns.items():
        cells = [row[index] for row in rows if index < len(row)]
        called = holds_both(name, cells)
        found |= {f"{name}.{own}": (index, f"both{place}") for place, own in enumerate(called or ())}
        if called is None:
            found |= {f"{name}{part}": (index, part) for part in parts_of_cells(cells)}
    return found
