"""JSON with an object for each channel: numbers, or pairs of time and number, in a list; unit, times, rate."""

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import (
    RawRecording,
    RawSignal,
    ReadNote,
    TableRecording,
    UniqueNames,
    column_name_and_unit,
    unit_of_time,
)
from split_cli.logs.readers.delimited import seconds_of
from split_cli.logs.readers.json_document import plain_number
from split_cli.signals import find_unit

_VALUES = ("data", "values", "samples", "value", "y")
_NAMES = ("name", "channel", "signal", "id", "label", "title")
_TIMES = ("time", "times", "timestamp", "timestamps", "t", "x")
_RATES = ("frequency", "rate", "sample_rate", "samplerate", "sampling_rate", "freq", "hz", "fs")
_PERIODS = ("period", "dt", "interval", "sample_time")
_DEEPEST = 3
_SHORTEST_SERIES = 8
"""Pairs of time and value that make a series [1]: positions and sizes come in twos as well."""
_BEGINNING = 1 << 16
_HAS_LISTS = re.compile(rb'"(data|values|samples|value|y|times?|timestamps?)"\s*:\s*\[|:\s*\[\s*\[', re.IGNORECASE)
_Named = list[tuple[str, Mapping[str, Any]]]
"""Channels with their names, which may occur twice."""


def open_json_channels(path: Path, document: Any) -> RawRecording | None:
    """Open a document of this form, which was read from `path`; None if it has another."""
    with path.open("rb") as stream:
        if not _HAS_LISTS.search(stream.read(_BEGINNING)):
            return None
    channels = next(_groups(document, 0), None)
    if channels is None:
        return None
    refuse_many_columns(len(channels), path.name)
    unique, signals = UniqueNames(), {}
    for title, channel in channels:
        time, values = _samples(channel)
        name, unit = column_name_and_unit(title)
        name = unique.of(name or title)
        stated = next((str(channel[key]) for key in channel if key.lower() in ("unit", "units")), unit or "")
        known = find_unit(stated) if stated else None
        signals[name] = RawSignal(name, time, values, known.symbol if known else stated or None)
    numbered = ReadNote("channel names that occur twice, numbered", path.name, unique.renamed)
    return TableRecording(path.name, path, signals, notes=[numbered] if unique.renamed else [])


def _groups(node: Any, depth: int) -> Iterator[_Named]:
    """Yield the first objects that are channels, with their names."""
    if depth > _DEEPEST:
        return
    if isinstance(node, list):
        named = [(str(one.get(_key(one, _NAMES) or "", "")), one) for one in node if isinstance(one, dict)]
    elif isinstance(node, dict):
        channels = {key: {"values": one} if is_series(one) else one for key, one in node.items()}
        named = [(str(key), one) for key, one in channels.items() if isinstance(one, dict)]
    else:
        return
    found = [(name, one) for name, one in named if name and _holds_numbers(one)]
    if len(found) > 1:
        yield found
        return
    for _, one in named[:64]:
        yield from _groups(one, depth + 1)
    if isinstance(node, dict):
        for one in node.values():
            if isinstance(one, list):
                yield from _groups(one, depth + 1)


def _key(channel: Mapping[str, Any], names: tuple[str, ...]) -> str | None:
    return next((key for name in names for key in channel if key.lower() == name), None)


def _holds_numbers(channel: Mapping[str, Any]) -> bool:
    key = _key(channel, _VALUES)
    values = channel[key] if key is not None else None
    if is_series(values):
        return True
    return isinstance(values, list) and len(values) > 1 and bool(np.any(np.isfinite(_numbers(values[:64]))))


def is_channel(row: Mapping[str, Any]) -> bool:
    """Tell an object that is a channel, with its name in words and its numbers, from a row of several."""
    name = _key(row, _NAMES)
    return name is not None and isinstance(row[name], str) and _holds_numbers(row)


def is_series(values: Any) -> bool:
    """Tell a list of pairs of numbers, time and value: its first numbers never fall."""
    if not isinstance(values, list) or len(values) < _SHORTEST_SERIES:
        return False
    pairs = values[:_SHORTEST_SERIES]
    if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        return False
    first = _numbers([pair[0] for pair in pairs])
    return bool(np.all(np.isfinite(first)) and np.all(np.diff(first) >= 0.0) and first[-1] > first[0])


def _samples(channel: Mapping[str, Any]) -> tuple[np.ndarray | None, np.ndarray]:
    """Return times [s], None where the channel has none, and values of a channel, shapes (N,)."""
    values = channel[_key(channel, _VALUES)]
    if not is_series(values):
        return _clock(channel, len(values)), _numbers(values)
    pairs = [pair if isinstance(pair, list) and len(pair) == 2 else (math.nan, math.nan) for pair in values]
    time, values = (_numbers([pair[place] for pair in pairs]) for place in (0, 1))
    return time * find_unit(unit_of_time(time)).factor, values


def _numbers(values: list[Any]) -> np.ndarray:
    def number(value: Any) -> float:
        if isinstance(value, str) and len(value) < 64:
            return seconds_of(value)
        return plain_number(value)

    return np.fromiter((number(value) for value in values), dtype=float, count=len(values))


def _clock(channel: Mapping[str, Any], count: int) -> np.ndarray | None:
    """Return the times of a channel [s], by its own list, its rate or its period; None where it has neither."""
    key = _key(channel, _TIMES)
    if key is not None and isinstance(channel[key], list) and len(channel[key]) == count:
        time = _numbers(channel[key])
        return time * find_unit(unit_of_time(time)).factor
    for names, power in ((_RATES, -1.0), (_PERIODS, 1.0)):
        stated = channel.get(_key(channel, names) or "")
        if isinstance(stated, int | float) and 0.0 < stated < 1e12:
            return np.arange(count) * float(stated) ** power
    return None
