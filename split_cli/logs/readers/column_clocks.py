"""Several columns of time in one table, each the clock of the columns behind it, as acquisition programs export."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from split_cli.logs.raw import TIME_COLUMNS, RawChannelInfo, RawSignal, unit_of_time
from split_cli.logs.readers.clock_of_day import over_midnight, packed_clock
from split_cli.signals import find_unit

_CALLED_TIME = re.compile(r"(?i)(?<![a-z])(time|timestamp|zeit|zeitstempel|temps|tempo|tiempo)(?![a-z])")
_OF_SOMETHING = re.compile(r"(?i)(?<![a-z])(lap|sector|stint|delta|gap|best|split|run|step|runde)")
"""Times of these are no clock of a recording."""
_APART = 0.02
"""Of a span, by which two clocks of one row differ at least where they are not the same clock [1]; judgement."""
_FEWEST = 10
"""Rows of a clock, below which nothing shows that it counts [1]; judgement."""


def clocks_of_columns(
    infos: Sequence[RawChannelInfo], read: Callable[[str], np.ndarray]
) -> tuple[dict[str, np.ndarray], float]:
    """Return the time of each column of a table with several clocks, and their origin; of others none, and 0.

    Parameters
    ----------
    infos : sequence of RawChannelInfo
        The columns in the file's order.
    read : callable
        Returns a column of numbers by its name, shape (N,), NaN where a cell is empty.

    Returns
    -------
    dict of ndarray
        By name: seconds from the origin, shape (M,), for the first M rows. The clocks themselves have one too.
    float
        Origin [s].

    Notes
    -----
    Hours, minutes and seconds in one number are a clock of the day, as `packed_clock` reads them. A clock rises
    from row to row, and ends where its columns end. That there are several shows where some end before others, or
    where two of the same rows do not count the same time.
    """
    behind = _possible_clocks(infos)
    clocks: dict[str, np.ndarray] = {}
    for name in behind:
        time = read(name)
        time = time[: np.count_nonzero(np.isfinite(time))]
        of_day = packed_clock(time)
        time = over_midnight(time) if of_day is None else of_day
        if len(time) < _FEWEST or not np.all(np.diff(time) > 0.0):
            return {}, 0.0
        clocks[name] = time
    rows = max((len(time) for time in clocks.values()), default=0)
    ends = {name for name, time in clocks.items() if len(time) < rows}
    first = next(iter(clocks.values()), None)
    if first is None or (not ends and all(_is_same(first, time) for time in clocks.values())):
        return {}, 0.0
    if any(np.isfinite(read(column)[len(clocks[name]) :]).any() for name in ends for column in behind[name]):
        return {}, 0.0
    units = {info.name: info.unit for info in infos}
    seconds = {name: time * _factor(units[name], time) for name, time in clocks.items()}
    origin = min(float(time[0]) for time in seconds.values())
    times = {}
    for name, columns in behind.items():
        times |= dict.fromkeys((name, *columns), seconds[name] - origin)
    return times, origin


def with_clock(signal: RawSignal, time: np.ndarray | None) -> RawSignal:
    """Return a column with its own time, cut off where that ends; as it is without one."""
    return signal if time is None else replace(signal, time=time, values=signal.values[: len(time)])


def _possible_clocks(infos: Sequence[RawChannelInfo]) -> dict[str, list[str]]:
    """Return the numbers that follow each column of time, by name; empty where one rules all rows by its place.

    There are two columns of time or more, the first in front, and none without columns of its own.
    """
    behind: dict[str, list[str]] = {}
    for info in infos:
        if _is_clock(info):
            behind[info.name] = []
        elif not behind:
            return {}
        elif info.type_name != "text":
            behind[next(reversed(behind))].append(info.name)
    return behind if len(behind) > 1 and all(behind.values()) else {}


def _is_clock(info: RawChannelInfo) -> bool:
    called = re.sub(r"(?<=[a-z])(?=[A-Z])|_+", " ", info.name).strip()
    known = re.sub(r" ?\d+$", "", called).lower() in TIME_COLUMNS and called.rstrip("0123456789 ") != "T"
    timed = known or _CALLED_TIME.search(called) is not None
    return timed and info.type_name != "text" and not _OF_SOMETHING.search(called)


def _factor(unit: str | None, time: np.ndarray) -> float:
    """Return the seconds of one of a clock's unit, as the file states it, else as its steps show."""
    stated = find_unit(unit or "")
    if stated is not None and stated.si == "s":
        return stated.factor
    found = find_unit(unit_of_time(time))
    return 1.0 if found is None else found.factor


def _is_same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two clocks of the same rows count the same time, in whatever unit and from whatever zero."""
    first, second = ((time - time[0]) / (time[-1] - time[0]) for time in (one, other))
    return bool(np.max(np.abs(first - second)) < _APART)
