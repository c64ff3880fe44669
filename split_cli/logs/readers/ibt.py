"""iRacing telemetry (.ibt): a head, a list of variables, and one record of all of them for each tick."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.raw import LazyTableRecording, RawChannelInfo, RawRecording, RawSignal, ReadNote

_HEAD = np.dtype(
    [
        ("version", "<i4"),
        ("status", "<i4"),
        ("rate", "<i4"),
        ("update", "<i4"),
        ("info_size", "<i4"),
        ("info_place", "<i4"),
        ("variables", "<i4"),
        ("place", "<i4"),
        ("buffers", "<i4"),
        ("record", "<i4"),
        ("pad", "<i4", 2),
        ("tick", "<i4"),
        ("data", "<i4"),
    ]
)
_DISK = 112
"""Where the part of a file on disk begins, behind the head and four places of buffers [bytes]."""
_ON_DISK = np.dtype([("begin", "<i8"), ("first", "<f8"), ("last", "<f8"), ("laps", "<i4"), ("records", "<i4")])
_VARIABLE = np.dtype(
    [
        ("type", "<i4"),
        ("offset", "<i4"),
        ("count", "<i4"),
        ("as_time", "?"),
        ("pad", "S3"),
        ("name", "S32"),
        ("words", "S64"),
        ("unit", "S32"),
    ]
)
_TYPES = ("S1", "?", "<i4", "<u4", "<f4", "<f8")
_MOST_VARIABLES = 5000
"""[1]; judgement: a session has about 280."""


def is_ibt(path: Path, head: bytes) -> bool:
    """Whether a file is telemetry of iRacing: its head leads to a list of variables within it."""
    if len(head) < _DISK + _ON_DISK.itemsize:
        return False
    h = np.frombuffer(head, _HEAD, 1)[0]
    behind = _DISK + _ON_DISK.itemsize
    return bool(
        h["version"] in (1, 2)
        and 0 < h["rate"] <= 1000
        and 0 < h["variables"] <= _MOST_VARIABLES
        and behind <= h["place"] < path.stat().st_size
        and h["buffers"] in (1, 2, 3, 4)
        and h["record"] > 0
    )


def _fields(listed: bytes, record: int, path: Path) -> tuple[dict[str, tuple[str, int, int, str]], int]:
    """Return type, place in the record, count and unit of each variable, and how many arrays are of cars."""
    fields: dict[str, tuple[str, int, int, str]] = {}
    of_cars = 0
    for v in np.frombuffer(listed, _VARIABLE):
        name = v["name"].decode("latin-1").strip()
        kind = _TYPES[v["type"]] if 0 <= v["type"] < len(_TYPES) else ""
        count, offset = int(v["count"]), int(v["offset"])
        if not name or not kind or count < 1 or offset < 0 or offset + count * np.dtype(kind).itemsize > record:
            advice = "Copy it again."
            raise LogError(f"has a variable {name!r} outside its records", where=path.name, advice=advice)
        if count > 1 and not v["as_time"]:
            of_cars += 1
        elif kind != "S1":
            unit = v["unit"].decode("latin-1").strip()
            fields[name] = (kind, offset, count, "1" if unit == "%" else unit)
    return fields, of_cars


def open_ibt(path: Path) -> RawRecording:
    """Open telemetry of iRacing: every variable with its unit, over the time of the session.

    A variable with several samples in a record (``countAsTime``) is one channel of that many times the rate.
    Arrays with an element for each car of the session are left out, and counted, as are records missing at the
    end. What is called % are shares from 0 to 1.

    Raises
    ------
    LogError
        If its list of variables is damaged or it holds no records.
    """
    with path.open("rb") as stream:
        h = np.frombuffer(stream.read(_HEAD.itemsize), _HEAD, 1)[0]
        stream.seek(_DISK)
        promised = int(np.frombuffer(stream.read(_ON_DISK.itemsize), _ON_DISK, 1)[0]["records"])
        stream.seek(int(h["place"]))
        listed = stream.read(int(h["variables"]) * _VARIABLE.itemsize)
    size, record, data = path.stat().st_size, int(h["record"]), int(h["data"])
    if len(listed) < int(h["variables"]) * _VARIABLE.itemsize:
        raise LogError("is cut off within its list of variables", where=path.name, advice="Copy it again.")
    fields, of_cars = _fields(listed, record, path)
    whole = max(size - data, 0) // record if data > 0 else 0
    rows = min(whole, promised) if promised > 0 else whole
    if rows < 2:
        raise LogError("holds no records", where=path.name, advice="Record it again, in the car.")
    notes = []
    if promised > rows:
        notes.append(ReadNote("records missing at the end", path.name, promised - rows))
    if of_cars:
        notes.append(ReadNote("arrays with an element for each car, left out", path.name, of_cars))
    table = np.dtype(
        {
            "names": list(fields),
            "formats": [(f[0], (f[2],)) for f in fields.values()],
            "offsets": [f[1] for f in fields.values()],
            "itemsize": record,
        }
    )
    values = np.memmap(path, table, "r", data, (rows,))
    rate = float(h["rate"])
    clock = values["SessionTime"][:, 0].astype(np.float64) if "SessionTime" in fields else np.arange(rows) / rate

    def load(names: Sequence[str]) -> dict[str, RawSignal]:
        made = {}
        for name in names:
            count = fields[name][2]
            # The last sample of a record is of its time.
            time = clock if count == 1 else (clock[:, None] - np.arange(count)[::-1] / (count * rate)).ravel()
            made[name] = RawSignal(name, time, values[name].astype(np.float64).ravel(), fields[name][3] or None)
        return made

    infos = [RawChannelInfo(name, "column", rows * field[2], field[3] or None) for name, field in fields.items()]
    return LazyTableRecording(path.name, path, infos, load, notes=notes)
