"""Centre lines of users, read in the form of the TUM racetrack database or refused with the reason."""

from pathlib import Path as FilePath

import numpy as np

from split_cli.control.path import Path, resampled
from split_cli.errors import SplitError
from split_cli.files import read_text

_MOST_BYTES = 16 << 20
"""Of a centre line's file [bytes]; judgement: the longest circuit at 1 m takes 2 MB."""
_LONGEST_LAP = 100_000.0
"""Of a centre line [m]; judgement: four times the Nuerburgring."""
_COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")
_ADVICE = f"A centre line has the columns {','.join(_COLUMNS)}."


def read_centerline(path: str | FilePath) -> Path:
    """Read a closed centre line in the form of the TUM racetrack database.

    Columns ``x_m,y_m,w_tr_right_m,w_tr_left_m``, split by commas, semicolons or blanks; between semicolons a comma
    is a decimal mark. A header, with or without a ``#`` before it, may name them in another order and beside
    others; without one this order is taken.

    Raises
    ------
    SplitError
        If the file is missing, lacks columns, has numbers that are not finite or fewer than 8 points, if a point
        lies far from the others, or if the line is not closed, turns back on itself, or is too short for its
        lane.
    """
    path = FilePath(path)
    if not path.is_file():
        problem = "is a folder" if path.is_dir() else "there is no such file, and no track of that name"
        raise SplitError(problem, where=str(path), advice=_ADVICE)
    try:
        lines = read_text(path, _MOST_BYTES).removeprefix("\ufeff").splitlines()
    except UnicodeDecodeError as error:
        raise SplitError("is no text in UTF-8", where=str(path), advice=_ADVICE) from error
    except OSError as error:
        raise SplitError(f"cannot be read ({error})", where=str(path), advice=_ADVICE) from error
    names = _COLUMNS
    rows, numbers = [], []
    for number, line in enumerate(lines, 1):
        parts = _parts(line)
        if "x_m" in parts:
            names = tuple(parts)
            missing = [name for name in _COLUMNS if name not in names]
            if missing:
                raise SplitError(f"has no column {', '.join(missing)}", where=str(path), advice=_ADVICE)
        if "x_m" in parts or not line.strip() or line.strip().startswith("#"):
            continue
        rows.append(_row(parts, names, f"row {number} is {line.strip()[:60]!r}", path))
        numbers.append(number)
    table = np.array(rows).reshape(-1, 4)
    if len(table) > 1 and np.linalg.norm(table[0, :2] - table[-1, :2]) < 1e-6:
        table = table[:-1]
    if len(table) < 8:
        raise SplitError(f"holds {len(table)} points, 8 or more are needed", where=str(path), advice=_ADVICE)
    length = _checked_length(table, numbers, str(path))
    spacing = min(0.5, length / 400.0)
    return resampled(path.stem, table[:, :2], table[:, 3], table[:, 2], closed=True, spacing=spacing)


def _parts(line: str) -> list[str]:
    """Return the words of a line: a semicolon separates before a comma does, and a comma before blanks."""
    text = line.strip().lstrip("#").strip()
    if ";" in text:
        parts = text.replace(",", ".").split(";")
    else:
        parts = text.split(",") if "," in text else text.split()
    return [part.strip().strip('"') for part in parts]


def _row(parts: list[str], names: tuple[str, ...], row_text: str, path: FilePath) -> list[float]:
    """Return x, y and the widths to the right and to the left of one row [m]."""
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != len(names) or not np.isfinite(values).all():
        raise SplitError(f"{row_text}, where {len(names)} numbers were expected", where=str(path), advice=_ADVICE)
    chosen = [values[names.index(name)] for name in _COLUMNS]
    if min(chosen[2:]) <= 0.0:
        advice = "Give both widths in metres, above 0."
        raise SplitError(f"{row_text}: a width is not positive", where=str(path), advice=advice)
    return chosen


def _checked_length(table: np.ndarray, numbers: list[int], where: str) -> float:
    """Return the length of the closed line through points [m], shape (N, 4).

    Raises
    ------
    SplitError
        If the line has a gap, repeats a point, turns back, or has a length that no track has.
    """
    steps = np.diff(table[:, :2], axis=0, append=table[:1, :2])
    step = np.linalg.norm(steps, axis=1)
    far, same, usual = int(np.argmax(step)), int(np.argmin(step)), np.median(step)
    if step[same] < 1e-9:
        advice = "Remove one of the two rows."
        raise SplitError(f"row {numbers[same]} and the next are the same point", where=where, advice=advice)
    if step[far] > 20.0 * usual:
        last = far == len(table) - 1
        place = "between its last point and its first" if last else f"after row {numbers[far]}"
        what = f"has a gap of {step[far]:.1f} m {place}, where {usual:.2g} m are usual"
        advice = "A track is a closed line." if last else "Remove the point that lies apart, or fill the gap."
        raise SplitError(what, where=where, advice=advice)
    length, lane = float(step.sum()), float(table[:, 2:].min())
    if not length <= _LONGEST_LAP:
        what = f"is {length:.3g} m long, at most {_LONGEST_LAP:.0f} m were expected"
        raise SplitError(what, where=where, advice="Give coordinates in metres.")
    if length < 2.0 * np.pi * lane:
        # A closed line that bends nowhere tighter than its border is at least as long as the border's circle.
        what = f"is {length:.3g} m long, while its border is {lane:.3g} m or more away from it"
        raise SplitError(what, where=where, advice="Give coordinates in metres, not in kilometres or degrees.")
    back = np.flatnonzero((steps * np.roll(steps, 1, axis=0)).sum(axis=1) < 0.0)
    if len(back):
        problem = f"turns back on itself at row {numbers[back[0]]}" if back[0] else "ends beyond its first point"
        advice = "Sort the points along the track, leave out what was driven twice, or smooth the line."
        raise SplitError(problem, where=where, advice=advice)
    return length
