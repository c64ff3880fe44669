"""ASCII logs of NovAtel receivers: ``#INSPVAXA,COM1,...,2210,250000.0,...;...*crc``, each message with its clock.

The order of the fields is that of the OEM7 manual. Increments of the IMU (CORRIMUDATA, RAWIMU) have the unit of a
sample of its own rate, which no message states: they are listed and not converted.
"""

import re
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.raw import RawRecording, RawSignal, ReadNote, TableRecording
from split_cli.logs.readers.cells import number_of
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.dialect import LONGEST_LINE

_LINE = re.compile(r"[#%](?P<name>[A-Z0-9]{3,20}A),(?P<header>[^;]*);(?P<body>[^*]*)(\*[0-9a-fA-F]{8})?\s*")
_VELOCITIES = ("north_velocity [m/s]", "east_velocity [m/s]", "up_velocity [m/s]")
_PLACE = ("latitude [deg]", "longitude [deg]", "height [m]")
_ATTITUDE = ("roll [deg]", "pitch [deg]", "true_heading [deg]")
_INCREMENTS = ("", "", "pitch_increment", "roll_increment", "yaw_increment")
_INS = ("", "", *_PLACE, *_VELOCITIES, *_ATTITUDE)
FIELDS: dict[str, tuple[str, ...]] = {
    "INSPVA": _INS,
    "INSPVAS": _INS,
    "INSPVAX": ("", "", *_PLACE, "", *_VELOCITIES, *_ATTITUDE),
    "BESTPOS": ("", "", *_PLACE),
    "BESTVEL": ("", "", "latency [s]", "", "ground_speed [m/s]", "course_over_ground [deg]", "vertical_velocity [m/s]"),
    "INSVEL": ("", "", *_VELOCITIES),
    "INSATT": ("", "", *_ATTITUDE),
    "CORRIMUDATA": _INCREMENTS,
    "CORRIMUDATAS": _INCREMENTS,
    "CORRIMUS": ("", *_INCREMENTS[1:]),
}
"""Names and units of the fields of each message from the first on; empty of one that is no quantity."""
_SHORT = ("week", "seconds")
_SECONDS_OF_WEEK = 604_800.0


def is_novatel(head: bytes) -> bool:
    """Tell by the first bytes: most lines are messages of this form, and one of them is known."""
    lines = [line for line in decoded(head).splitlines()[:-1] if line.strip()]
    names = [found["name"][:-1] for found in map(_LINE.fullmatch, lines) if found]
    return 2 * len(names) > len(lines) and any(name in FIELDS for name in names)


def open_novatel(path: Path) -> RawRecording:
    """Open such a log; a field is called ``INSPVAX.latitude``, its time counts seconds of GPS.

    Raises
    ------
    LogError
        If no message of a known kind holds a number.
    """
    times: dict[str, array[float]] = {}
    columns: dict[str, list[array[float]]] = {}
    others: dict[str, int] = {}
    for name, time, cells in _messages(path):
        known = FIELDS.get(name)
        if known is None or not np.isfinite(time):
            others[name] = others.get(name, 0) + 1
            continue
        row = [number_of(cell, ".") for cell in cells[: len(known)]]
        row += [np.nan] * (len(known) - len(row))
        times.setdefault(name, array("d")).append(time)
        for column, value in zip(columns.setdefault(name, [array("d") for _ in known]), row, strict=True):
            column.append(value)
    signals = {}
    for name, made in columns.items():
        time = np.array(times[name])
        for title, column in zip(FIELDS[name], made, strict=True):
            values = np.array(column)
            field, _, unit = title.partition(" [")
            if title and np.isfinite(values).any():
                signals[f"{name}.{field}"] = RawSignal(f"{name}.{field}", time, values, unit.rstrip("]") or None)
    if not signals:
        advice = "Log INSPVAX or INSPVA, or export a table."
        raise LogError("holds no message of a known kind", where=path.name, advice=advice)
    notes = [ReadNote(f"messages {name or 'of another form'}, not read", path.name, n) for name, n in others.items()]
    return TableRecording(path.name, path, signals, notes=notes)


def _messages(path: Path) -> Iterator[tuple[str, float, list[str]]]:
    """Yield name, time [s] and fields of each message; a line of another form has no name."""
    with path.open("rb") as stream:
        while raw := stream.readline(LONGEST_LINE):
            found = _LINE.fullmatch(decoded(raw).strip())
            if found is None:
                if not raw.isspace():
                    yield "", np.nan, []
                continue
            header = found["header"].split(",")
            # Week and seconds are the short header, and follow port, number, idle time and status in a long one.
            moment = header if len(header) == len(_SHORT) else [*header, "", "", "", "", "", ""][4:6]
            week, seconds = (number_of(cell, ".") for cell in moment)
            time = week * _SECONDS_OF_WEEK + seconds
            yield found["name"][:-1], time, found["body"].split(",")
