"""Racelogic .vbo files, as VBOX loggers and their CAN modules write them."""

from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.raw import RawRecording, RawSignal, ReadNote, TableRecording
from split_cli.logs.readers.clock_of_day import seconds_of_day
from split_cli.signals import symbol_of

# Units of the columns that every VBOX writes. Positions are converted while reading: no unit says "west positive".
_STANDARD_UNITS = {
    "time": "s",
    "lat": "deg",
    "long": "deg",
    "_lat": "deg",
    "_long": "deg",
    "velocity": "km/h",
    "heading": "deg",
    "height": "m",
    "vert-vel": "km/h",
    "Longacc": "g",
    "Latacc": "g",
}
_SPELLINGS = {"newtonmet": "N m", "kmh": "km/h", "km/h": "km/h", "degrees/s": "deg/s"}
_STRAY_STEPS = 10.0


def open_vbo(path: Path) -> RawRecording:
    """Open a .vbo file.

    Time is seconds since midnight UTC; ``lat`` and ``long`` are degrees, north and east positive (the file has arc
    minutes, west positive). The units of a file stand in a list without names. There are fewer of them than
    columns, since the standard columns in front have none: the list belongs to the last columns.

    Raises
    ------
    LogError
        If the sections of names or of data are missing, or no row of numbers follows.
    """
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    if "\ufffd" in text:
        text = path.read_bytes().decode("latin-1")
    sections = _sections(text.splitlines())
    names = " ".join(sections.get("column names", [])).split()
    if not names:
        raise LogError("has no [column names]", where=path.name, advice="Is it a .vbo file? Export it again.")
    notes: list[ReadNote] = []
    rows = _rows(sections.get("data", []), len(names), path, notes)
    units = _units(names, sections, path, notes)
    signals: dict[str, RawSignal] = {}
    for index, name in enumerate(names):
        values = rows[:, index]
        if name == "time":
            values = seconds_of_day(values)
        elif name in ("lat", "_lat"):
            values = values / 60.0
        elif name in ("long", "_long"):
            values = -values / 60.0
        unique = name if name not in signals else f"{name}_{index}"
        signals[unique] = RawSignal(unique, None, values, units[index])
    if {"lat", "long"} <= set(names):
        notes.append(ReadNote("positions from arc minutes, west positive, to degrees, east positive", path.name))
    signals = _without_stray_end(signals, path, notes)
    return TableRecording(path.name, path, signals, notes=notes)


def _sections(lines: list[str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    current = ""
    for line in lines:
        stripped = line.strip()
        if stripped.startswith("[") and stripped.endswith("]"):
            current = stripped[1:-1].strip().lower()
            found.setdefault(current, [])
        elif current == "channel units" or stripped:
            found.setdefault(current, []).append(stripped)
    return found


def _rows(lines: list[str], width: int, path: Path, notes: list[ReadNote]) -> np.ndarray:
    """Return the values, shape (N, width); others are counted and left out."""
    rows, bad = [], 0
    for line in lines:
        cells = line.replace(",", ".").split()
        try:
            # Python takes 1_5 for 15; no logger writes that.
            row = [float(cell) for cell in cells] if "_" not in line else []
        except ValueError:
            row = []
        if len(row) == width:
            rows.append(row)
        else:
            bad += 1
    if bad:
        notes.append(ReadNote("rows with too few or too many cells, left out", path.name, bad))
    if not rows:
        raise LogError("holds no rows", where=path.name, advice="Its [data] section is empty or damaged.")
    return np.array(rows)


def _units(names: list[str], sections: dict[str, list[str]], path: Path, notes: list[ReadNote]) -> list[str | None]:
    listed = sections.get("channel units", [])
    if listed and not listed[-1]:
        listed = listed[:-1]  # the empty line that ends every section
    if len(listed) > len(names):
        notes.append(ReadNote("units in the file, more than columns: not used", path.name, len(listed)))
        listed = []
    units: list[str | None] = [None] * (len(names) - len(listed))
    units += [symbol_of(_SPELLINGS.get(text.strip().lower(), text)) for text in listed]
    titles = sections.get("header", [])
    for index, name in enumerate(names):
        standard = _STANDARD_UNITS.get(name)
        if name == "vert-vel" and index < len(titles) and "m/s" in titles[index]:
            standard = "m/s"
        units[index] = units[index] or standard
    return units


def _without_stray_end(signals: dict[str, RawSignal], path: Path, notes: list[ReadNote]) -> dict[str, RawSignal]:
    """Leave out a last row that the logger wrote long after the one before it, when recording had ended."""
    if "time" not in signals or len(signals["time"].values) < 20:
        return signals
    step = np.diff(signals["time"].values)
    typical = float(np.median(step[step > 0])) if np.any(step > 0) else 0.0
    if typical == 0.0 or 0.0 <= step[-1] <= _STRAY_STEPS * typical:
        return signals
    notes.append(ReadNote(f"last row, {step[-1]:.3g} s after the one before it, left out", path.name))
    return {name: RawSignal(name, None, s.values[:-1], s.unit) for name, s in signals.items()}
