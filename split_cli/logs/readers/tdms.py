"""Files of LabVIEW and NI loggers (.tdms), through npTDMS (extra ``tdms``)."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.logs.raw import RawChannelInfo, RawRecording, ReadNote, seconds_a_tick, time_column
from split_cli.logs.readers.apart import ColumnApart, TableApart, open_apart, write_table
from split_cli.signals import split_name_and_unit, symbol_of

TDMS_MAGIC = b"TDSm"
_STEP, _OFFSET, _START = "wf_increment", "wf_start_offset", "wf_start_time"
_UNITS = ("unit_string", "NI_UnitDescription", "Unit", "unit")
"""Properties in which programs of NI and others write the unit of a channel."""


def open_tdms(path: Path) -> RawRecording:
    """Open a TDMS file. A channel with a waveform's properties has its own clock, others that of their group.

    A name that occurs in several groups is addressed as ``group.name``. Of groups without any clock, those with
    another number of rows than the longest are left out and counted.

    Raises
    ------
    LogError
        If npTDMS is not installed, or the file is damaged or holds no numbers.
    """
    return open_apart(path, hand_over_tdms, "nptdms", "a TDMS file", "tdms")


def hand_over_tdms(path: Path, folder: str) -> None:
    """Read a file and write its columns: what a process of its own does."""
    write_table(path, folder, _read)


def _read(path: Path) -> TableApart:
    from nptdms import TdmsFile

    with TdmsFile.open(str(path)) as file:
        groups = {group.name: [c for c in group.channels() if _is_numeric(c)] for group in file.groups()}
        starts = [c.properties[_START] for own in groups.values() for c in own if _START in c.properties]
        first = min(starts, default=None)
        counts = Counter(split_name_and_unit(c.name)[0] for own in groups.values() for c in own)
        columns = []
        for group, own in groups.items():
            for name, column in _of_group(own, first, len(groups) == 1).items():
                bare, unit = split_name_and_unit(name)
                address = bare if counts[bare] == 1 else f"{group}.{bare}"
                columns.append(ColumnApart(address, column.unit or symbol_of(unit) or "", column.time, column.values))
    longest = max((len(c.values) for c in columns if c.time is None), default=0)
    kept = [c for c in columns if c.time is not None or len(c.values) == longest]
    lost = len(columns) - len(kept)
    notes = [ReadNote("channels without a clock and of another length, left out", path.name, lost)] if lost else []
    return TableApart(kept, notes)


def _is_numeric(channel: Any) -> bool:
    return channel.dtype.kind in "biufM" and len(channel) > 0


def _of_group(channels: list[Any], first: Any, alone: bool) -> dict[str, ColumnApart]:
    """Return the columns of a group by name, with the clock that properties or a column of it give.

    Of the only group a column is the clock as in any table.
    """
    columns: dict[str, ColumnApart] = {}
    for channel in channels:
        values, unit = channel[:], next((str(channel.properties[k]) for k in _UNITS if k in channel.properties), "")
        if values.dtype.kind == "M":
            values, unit = (values - np.datetime64(0, "s")) / np.timedelta64(1, "s"), "s"
        columns[channel.name] = ColumnApart(channel.name, symbol_of(unit) or "", _waveform(channel, first), values)
    if alone or any(column.time is not None for column in columns.values()):
        return columns
    infos = [RawChannelInfo(split_name_and_unit(n)[0], "column", len(c.values), c.unit) for n, c in columns.items()]
    clock = time_column(infos)
    if clock is None:
        return columns
    by_name = dict(zip((info.name for info in infos), columns, strict=True))
    ticks = columns[by_name[clock.name]]
    time = ticks.values * seconds_a_tick(ticks.values, ticks.unit)
    return {
        name: ColumnApart(name, c.unit, time if len(c.values) == len(time) else None, c.values)
        for name, c in columns.items()
    }


def _waveform(channel: Any, first: Any) -> np.ndarray | None:
    """Return the times of a waveform from the first start in the file [s], shape (N,); None for another channel."""
    step = float(channel.properties.get(_STEP, 0.0))
    if not step > 0.0:
        return None
    start = channel.properties.get(_START)
    begin = 0.0 if start is None else float((start - first) / np.timedelta64(1, "s"))
    return begin + float(channel.properties.get(_OFFSET, 0.0)) + step * np.arange(len(channel))
