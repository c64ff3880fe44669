"""Several files that were recorded together, each with a clock of its own, as one recording."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.raw import (
    Clock,
    RawChannelInfo,
    RawRecording,
    RawSignal,
    ReadNote,
    SplitStamp,
    nearest_column,
    split_stamps,
    time_column,
    unit_of_time,
)
from split_cli.logs.readers.named_values import VALUES
from split_cli.signals import convert_to_si, find_unit


class JointRecording:
    """The channels of several tables; a name that occurs twice is addressed as ``file.name``.

    Attributes
    ----------
    paths : tuple of Path
        All files; of an archive that holds several, it once.
    """

    clocks: tuple[Clock, ...] = ()
    origin = 0.0

    def __init__(self, parts: Sequence[RawRecording]) -> None:
        self.parts = tuple(parts)
        self.paths = tuple(dict.fromkeys(part.path for part in parts))
        self.path = self.paths[0]
        self.name = "+".join(part.name for part in parts)
        self._own_notes: list[ReadNote] = []
        self._time: dict[int, RawChannelInfo] = {}
        self._split: dict[int, SplitStamp] = {}
        self._moved: dict[int, float] = {}
        self._places: dict[str, tuple[RawRecording, RawChannelInfo]] = {}
        clocks: dict[int, set[str]] = {}
        for part in parts:
            infos = part.channels()
            # Messages have times of their own; a stamp inside one topic is none of the others.
            time = None if part.clocks else time_column(infos)
            stamps = [] if part.clocks else split_stamps(infos)
            if time is None and not stamps and not part.clocks:
                time = rising_in_seconds(part, infos)
            clocks[id(part)] = {name for stamp in stamps for name in (stamp.whole, stamp.part)}
            if time is None and stamps:
                self._split[id(part)] = stamps[0]
            elif time is None and not part.clocks and not _own_clock(part, infos):
                what = "has no column of time, which several files together need"
                advice = "Name one of its columns `time`, or ingest the files one by one."
                raise LogError(what, where=part.name, advice=advice)
            if time is not None:
                self._time[id(part)] = time
        counts = Counter(info.name for part in parts for info in part.channels())
        for part in parts:
            for info in part.channels():
                if info != self._time.get(id(part)) and info.name not in clocks[id(part)]:
                    says_nothing = info.name.lower() in VALUES
                    alone = counts[info.name] == 1 and not (says_nothing and len(parts) > 1)
                    name = info.name if alone else f"{Path(part.name).stem}.{info.name}"
                    self._places[name] = (part, info)

    @property
    def notes(self) -> list[ReadNote]:
        """Notes of all files."""
        return [*self._own_notes, *(note for part in self.parts for note in part.notes)]

    def channels(self) -> list[RawChannelInfo]:
        """Return the channels of all files, without their columns of time."""
        return [RawChannelInfo(name, info.type_name, info.count, info.unit) for name, (_, info) in self._places.items()]

    def read(self, names: Sequence[str], clock: Clock | None = None) -> dict[str, RawSignal]:
        """Return the named signals, each on the clock of its file; see `Recording.read`."""
        read: dict[str, RawSignal] = {}
        places = {name: self._place_of(name) for name in names}
        for part in self.parts:
            own = {name: inside for name, (of, inside) in places.items() if of is part}
            if not own:
                continue
            time = self._time.get(id(part))
            split = self._split.get(id(part))
            clocks = [time.name] if time else [] if split is None else [split.whole, split.part]
            signals = part.read([*own.values(), *clocks], clock)
            stamps = None if time is None else self._seconds(part, signals[time.name])
            if split is not None:
                stamps = split.joined(signals[split.whole].values, signals[split.part].values)
                if stamps is None:
                    what = f"{split.part} reaches a whole second, so it is no part of {split.whole}"
                    raise LogError(what, where=part.name, advice="Name one of its columns `time`.")
            moved = self._moved.get(id(part), 0.0)
            for name, inside in own.items():
                signal = signals[inside]
                time = stamps if signal.time is None else signal.time + part.origin
                time = time if time is None or not moved else time + moved
                read[name] = RawSignal(name, time, signal.values, signal.unit)
        return {name: read[name] for name in names}

    def part_of(self, name: str) -> RawRecording:
        """Return the file that a channel is of."""
        return self._place_of(name)[0]

    def _place_of(self, name: str) -> tuple[RawRecording, str]:
        """Return the file that a name is of, and the name inside; of an array the first element is listed."""
        if name not in self._places and name.lower() in VALUES:
            # A map may name the only `value` of all files without its file.
            named = [address for address in self._places if address.endswith(f".{name}")]
            name = named[0] if len(named) == 1 else name
        listed = name if name in self._places else re.sub(r"\[\d+\]", "[0]", name)
        if listed not in self._places:
            listed = name
        part, info = nearest_column(self._places, listed, self.name)
        return part, info.name if listed == name else name[len(listed) - len(info.name) :]

    def move(self, part: RawRecording, seconds: float) -> None:
        """Add seconds to the clock of a file."""
        self._moved[id(part)] = seconds

    def remark(self, note: ReadNote) -> None:
        """Add what a reader of the drive must know."""
        self._own_notes.append(note)

    def _seconds(self, part: RawRecording, signal: RawSignal) -> np.ndarray:
        unit = signal.unit
        if unit is None or getattr(find_unit(unit), "si", "") != "s":
            unit = unit_of_time(signal.values)
            note = ReadNote(f"column {signal.name!r} taken as time in {unit}", part.name)
            if note not in self._own_notes:
                self._own_notes.append(note)
        return convert_to_si(signal.values, unit, where=part.name)


def rising_in_seconds(part: RawRecording, infos: Sequence[RawChannelInfo]) -> RawChannelInfo | None:
    """Return the first column that counts time and never falls, whatever it is called; None if there is none.

    It is in a unit of time, or counts since 1970.
    """
    for info in infos:
        stated = getattr(find_unit(info.unit or ""), "si", "")
        if info.type_name != "column" or stated not in ("", "s"):
            continue
        values = part.read([info.name])[info.name].values
        steps = np.diff(values[np.isfinite(values)])
        if np.any(steps > 0.0) and not np.any(steps < 0.0) and (stated or _counts_since_1970(values)):
            return info
    return None


def _counts_since_1970(values: np.ndarray) -> bool:
    """Whether all values lie between the years 2001 and 2100, in s, ms, us or ns."""
    finite = values[np.isfinite(values)]
    return any(finite.min() * unit >= 1e9 and finite.max() * unit <= 4.1e9 for unit in (1.0, 1e-3, 1e-6, 1e-9))


def _own_clock(part: RawRecording, infos: Sequence[RawChannelInfo]) -> bool:
    """Whether a table's signals carry their own times, as those of MATLAB's structures and of some tables do."""
    vectors = [info.name for info in infos if info.type_name in ("vector", "column")][:1]
    read = part.read(vectors) if vectors else {}
    return any(signal.time is not None for signal in read.values())
