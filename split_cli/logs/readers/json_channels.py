"""JSON with an object for each channel: numbers, or pairs of time and number, in a list; unit, times, rate."""

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import RawRecording, RawSignal, ReadNote, TableRecording, UniqueNames, seconds_a_tick
from split_cli.logs.readers.cells import seconds_of
from split_cli.logs.readers.json_document import JsonDocument, parsed, plain_number
from split_cli.logs.scratch import GrowingColumn
from split_cli.signals import split_name_and_unit, symbol_of

_VALUES = ("data", "values", "samples", "value", "y")
_NAMES = ("name", "channel", "signal", "id", "label", "title")
_TIMES = ("time", "times", "timestamp", "timestamps", "t", "x")
_RATES = ("frequency", "rate", "sample_rate", "samplerate", "sampling_rate", "freq", "hz", "fs")
_PERIODS = ("period", "dt", "interval", "sample_time")
_DEEPEST = 3
_SHORTEST_SERIES = 8
"""Pairs of time and value that make a series [1]: positions and sizes come in twos as well."""
LARGEST_DOCUMENT = 32 << 20
"""Of a document that is held as a whole [bytes]: objects take ten times as much memory."""
_BEGINNING = 1 << 16
_Named = list[tuple[str, Mapping[str, Any]]]
"""Channels with their names, which may occur twice."""


def open_json_channels(path: Path) -> RawRecording | None:
    """Open a document of this form; None if it has another.

    One too large to be held as a whole is read list by list.
    """
    with path.open("rb") as stream:
        begins = stream.read(_BEGINNING)
        if not re.search(
            rb'"(data|values|samples|value|y|times?|timestamps?)"\s*:\s*\[|:\s*\[\s*\[', begins, re.IGNORECASE
        ):
            return None
        large = path.stat().st_size > LARGEST_DOCUMENT
        document = None if large else parsed(begins + stream.read())
    notes: list[ReadNote] = []
    channels = _groups_of_lists(path, notes) if large else next(_groups(document, 0), None)
    if channels is None:
        return None
    refuse_many_columns(len(channels), path.name)
    unique, signals = UniqueNames(), {}
    for title, channel in channels:
        time, values = _samples(channel)
        name, unit = split_name_and_unit(title)
        name = unique.of(name or title)
        stated = next((str(channel[key]) for key in channel if key.lower() in ("unit", "units")), unit or "")
        signals[name] = RawSignal(name, time, values, symbol_of(stated))
    if unique.renamed:
        notes.append(ReadNote("channel names that occur twice, numbered", path.name, unique.renamed))
    return TableRecording(path.name, path, signals, notes=notes)


def _groups_of_lists(path: Path, notes: list[ReadNote]) -> _Named | None:
    """Return the channels of a long document with their names, and arrays for their lists; None of another form.

    They stand in an object by their names, or in a list with their names inside.

    Where it is damaged the channels before count, and a note says so.
    """
    found: dict[tuple[str, ...], dict[str, Any]] = {}
    try:
        for place, item in JsonDocument(path).items(_DEEPEST + 1):
            own = place[-1].lower() if place else ""
            refuse_many_columns(len(found), path.name)
            if not isinstance(item, Iterator):
                if own:
                    found.setdefault(place[:-1], {})[place[-1]] = item
                continue
            first = list(itertools.islice(item, _SHORTEST_SERIES))
            rest = itertools.chain(first, item)
            if is_series(first):
                channel = found.setdefault(place[:-1] if own in _VALUES else place, {})
                channel[_VALUES[0]], channel[_TIMES[0]] = _grown(rest, (1, 0))
            elif own in (*_VALUES, *_TIMES) and not any(isinstance(one, dict) for one in first):
                found.setdefault(place[:-1], {})[place[-1]] = _grown(rest, (None,))[0]
            elif isinstance(first[0] if first else None, dict) and is_channel(first[0]):
                whole = ((k, one) for k, one in enumerate(rest) if isinstance(one, dict) and _holds_numbers(one))
                found |= {(*place, f"[{k}]"): _with_arrays(one) for k, one in whole}
    except (ValueError, RecursionError):
        notes.append(ReadNote("the document is cut off or damaged: only channels before that are read", path.name))
    held = {place: one for place, one in found.items() if place and _key(one, _VALUES) is not None}
    # An object of a list is called by the name inside, others by their key.
    channels = [
        (str(one.get(_key(one, _NAMES) or "", place[-1])) if place[-1].startswith("[") else place[-1], one)
        for place, one in held.items()
    ]
    channels = [(name, one) for name, one in channels if np.size(one[_key(one, _VALUES)]) > 1]
    return channels if len(channels) > 1 else None


def _with_arrays(channel: Mapping[str, Any]) -> dict[str, Any]:
    """Return a channel with arrays for its values and times, which take a tenth of the memory."""
    if is_series(channel[_key(channel, _VALUES)]):
        time, values = _samples(channel)
        return {**channel, _key(channel, _VALUES): values, _TIMES[0]: time}
    arrays = {key for key, one in channel.items() if isinstance(one, list) and key.lower() in (*_VALUES, *_TIMES)}
    return {**channel, **{key: _numbers(channel[key]) for key in arrays}}


def _grown(elements: Iterator[Any], places: Sequence[int | None]) -> list[np.ndarray]:
    """Return the numbers of a list, or those at some places of its pairs, shape (N,) each."""
    columns = [GrowingColumn() for _ in places]
    while piece := list(itertools.islice(elements, 1 << 14)):
        for column, place in zip(columns, places, strict=True):
            if place is not None:
                piece_of = [pair[place] if isinstance(pair, list) and len(pair) == 2 else None for pair in piece]
            column.append(_numbers(piece if place is None else piece_of))
    return [column.finished() for column in columns]


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
    if isinstance(values, np.ndarray):
        return _clock(channel, len(values)), values
    if not is_series(values):
        return _clock(channel, len(values)), _numbers(values)
    pairs = [pair if isinstance(pair, list) and len(pair) == 2 else (math.nan, math.nan) for pair in values]
    time, values = (_numbers([pair[place] for pair in pairs]) for place in (0, 1))
    return time * seconds_a_tick(time), values


def _numbers(values: list[Any]) -> np.ndarray:
    def number(value: Any) -> float:
        if isinstance(value, str) and len(value) < 64:
            return seconds_of(value)
        return plain_number(value)

    return np.fromiter((number(value) for value in values), dtype=float, count=len(values))


def _clock(channel: Mapping[str, Any], count: int) -> np.ndarray | None:
    """Return the times of a channel [s], by its own list, its rate or its period; None where it has neither."""
    key = _key(channel, _TIMES)
    if key is not None and isinstance(channel[key], list | np.ndarray) and len(channel[key]) == count:
        time = channel[key] if isinstance(channel[key], np.ndarray) else _numbers(channel[key])
        return time * seconds_a_tick(time)
    for names, power in ((_RATES, -1.0), (_PERIODS, 1.0)):
        stated = channel.get(_key(channel, names) or "")
        if isinstance(stated, int | float) and 0.0 < stated < 1e12:
            return np.arange(count) * float(stated) ** power
    return None
