"""What a reader hands over: named signals as recorded, each with its own clock, nothing converted."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from split_cli.errors import LogError, nearest_names, printable
from split_cli.signals import find_unit

TIME_COLUMNS = tuple(
    """
    t time timestamp timestamps elapsed_time sec seconds __time %time ts gps_tow tow itow gps_itow gps_time
    time_of_week sow logmonotime tempo timeus zeit zeitstempel 时间 时间戳 temps tiempo unix_time unix epoch utc
    utc_time time_utc elapsed seconds_elapsed datetime date_time date/time stamp cts
    時間 時刻 время
    """.split()
)
"""Names of columns that hold the time, in lower case, blanks as underscores, without ``_ms`` and the like."""

Clock = Literal["header", "publish", "log"]


@dataclass(frozen=True)
class RawChannelInfo:
    """One addressable channel of a recording."""

    # How a signal map addresses it: ``/topic/field.path`` (array elements as ``field[3]``) or a column name.
    name: str
    type_name: str  # message type or column type
    count: int | None  # messages or rows, where the file says so without decoding
    unit: str | None = None  # as the file states it
    group: str = ""  # what a row above the titles of a table calls several columns together


NO_CHECKSUMS = "a damaged number is seen only where it contradicts other channels"
"""What follows where neither the format nor the writer of a recording kept checksums."""


@dataclass(frozen=True)
class ReadNote:
    """Something a reader dropped, repaired or assumed: `count` of `what`, in `where`."""

    what: str
    where: str
    count: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "what", printable(self.what))
        object.__setattr__(self, "where", printable(self.where))


@dataclass(frozen=True)
class RawSignal:
    """Samples of one channel as recorded."""

    name: str  # as in `RawChannelInfo`
    # (N,): seconds of the chosen clock, relative to the recording's `origin`; None for a table without a clock.
    time: np.ndarray | None
    values: np.ndarray  # (N,): as recorded; missing values are NaN
    unit: str | None = None  # as the file states it


def turned(time: np.ndarray, signals: Mapping[str, RawSignal]) -> tuple[np.ndarray, dict[str, RawSignal]]:
    """Return the rows of a table in reverse order; signals with times of their own stay as they are.

    Views: what is turned round takes no memory.
    """
    columns = {
        name: signal if signal.time is not None else replace(signal, values=signal.values[::-1])
        for name, signal in signals.items()
    }
    return time[::-1], columns


class RawRecording(Protocol):
    """An opened log. Opening reads as little as the format allows."""

    name: str  # file or folder name
    path: Path
    # What was subtracted from every time [s]: the first log time, so that nanosecond epochs keep precision.
    origin: float
    # The clocks this recording has, best first; empty for tables (their time is a column).
    clocks: tuple[Clock, ...]
    notes: list[ReadNote]  # filled while reading: undecodable messages, truncated tails, repaired records

    def channels(self) -> list[RawChannelInfo]:
        """Return every addressable channel, fields expanded from the definitions inside the file."""
        ...

    def read(self, names: Sequence[str], clock: Clock | None = None) -> dict[str, RawSignal]:
        """Return the named signals, decoding only the topics that are needed.

        Raises
        ------
        LogError
            If a name does not exist (with the nearest that do) or the file is damaged beyond its first records.
        """
        ...


@dataclass
class TableRecording:
    """A recording whose channels are columns; shared by CSV, Parquet, MAT and MF4 without groups."""

    name: str
    path: Path
    signals: dict[str, RawSignal]  # in file order
    type_name: str = "column"
    origin: float = 0.0
    clocks: tuple[Clock, ...] = ()
    notes: list[ReadNote] = field(default_factory=list)
    unlisted: dict[str, Callable[[], RawSignal]] = field(default_factory=dict)  # far columns of matrices, by name only

    def channels(self) -> list[RawChannelInfo]:
        """Return the columns with their units."""
        return [RawChannelInfo(s.name, self.type_name, len(s.values), s.unit) for s in self.signals.values()]

    def element_counts(self) -> dict[str, int]:
        """Return how many columns the matrices have of which not all are listed."""
        counts: dict[str, int] = {}
        for name in self.unlisted:
            matrix, _, index = name.removesuffix("]").rpartition("[")
            counts[matrix] = int(index) + 1
        return counts

    def read(self, names: Sequence[str], clock: Clock | None = None) -> dict[str, RawSignal]:
        """Return the named columns; see `RawRecording.read`."""
        return {
            name: self.unlisted[name]() if name in self.unlisted else nearest_column(self.signals, name, self.name)
            for name in names
        }


@dataclass
class LazyTableRecording:
    """A recording of columns that are read only when asked for."""

    name: str
    path: Path
    infos: list[RawChannelInfo]  # in file order
    # Takes names that exist and returns their signals, in that order.
    load: Callable[[Sequence[str]], dict[str, RawSignal]]
    origin: float = 0.0
    clocks: tuple[Clock, ...] = ()
    notes: list[ReadNote] = field(default_factory=list)
    own_clocks: bool = False  # whether each column has times of its own, so that none is the time of all
    # Returns of a column of text a number for each row, shape (N,), and the texts that these numbers stand for.
    texts: Callable[[str], tuple[np.ndarray, list[str]]] | None = None

    def channels(self) -> list[RawChannelInfo]:
        """Return the columns with their units."""
        return list(self.infos)

    def read(self, names: Sequence[str], clock: Clock | None = None) -> dict[str, RawSignal]:
        """Return the named columns; see `RawRecording.read`."""
        known = {info.name: info for info in self.infos}
        for name in names:
            nearest_column(known, name, self.name)
        return self.load(list(dict.fromkeys(names)))


def time_column(infos: Sequence[RawChannelInfo]) -> RawChannelInfo | None:
    """Return the column that holds the time; None when there is none.

    One of a known name, the better known first; else one whose type is a time stamp (an index of pandas); else the
    only one whose name holds the word.
    """
    # T is a torque.
    named = [info for info in reversed(infos) if info.name.strip() != "T"]
    parted = {re.sub(r"(?<=[a-z0-9])(?=[A-Z])|[\s.]+", "_", info.name.strip()): info for info in named}
    names = {name.lower(): info for name, info in parted.items()}
    joined = {name.replace("_", ""): info for name, info in names.items()}
    bare = {re.sub(r"_(s|secs?|seconds|ms|us|ns)$", "", name).replace("_", ""): info for name, info in names.items()}
    for name in (name.replace("_", "") for name in TIME_COLUMNS):
        info = joined.get(name, bare.get(name))
        if info is not None and info.type_name != "text":
            return info
    stamped = [info for info in infos if info.type_name.startswith("timestamp[")]
    if stamped:
        return stamped[0]
    timed = [info for name, info in names.items() if re.search(r"(^|_)(time|timestamp)(_|$)", name)]
    timed = [info for info in timed if not counts_rows(info.name)]
    return timed[0] if len(timed) == 1 and timed[0].type_name != "text" else None


def counts_rows(name: str) -> bool:
    """Tell whether a column is called a counter (``time_step``, ``frame``), whose steps are no seconds.

    A ``frame_time`` is a time: what the last word says counts.
    """
    counter = r"(?<![a-z])((time)?steps?|frame|index|idx|count|counter|number)(?![a-z])(?!.*(time|stamp))"
    return bool(re.search(counter, name.lower()))


_DAYS = ((36892.0, 73051.0), (730852.0, 767011.0))
"""The years 2001 to 2100 in days as spreadsheets count them (from 30 December 1899), and as MATLAB's datenum does."""


_TENTHS = ((1.26e17, 1.58e17), (6.31e17, 6.63e17))
"""The same years in tenths of microseconds, as Windows counts them (from 1601), and .NET (from the year 1)."""


_OF_A_DAY = 1.5e-5
"""Steps of a clock between 0 and 1, up to which it is the part of a day that a spreadsheet stores [1]: no log has rows
at 70 kHz for a second."""
_FASTEST_BY_DAYS = 4e-3
"""Steps [s] below which a clock between 0 and 1 is no part of a day; judgement: spreadsheets hold slow logs."""
_BETWEEN_BURSTS, _OF_A_BURST = 0.75, 100.0
"""Share of the steps below the one that is looked at, and by how much it exceeds the median where rows come in
bursts: three messages of one instant each, for instance [1]; judgement."""


def unit_of_time(values: np.ndarray) -> str:
    """Return the unit of a clock that states none.

    No other clock gets as far as nanoseconds since 1970, in the years 2001 to 2100, or as the ticks of Windows. They
    show it where rows were written in bursts, too. With other clocks the samples of a drive are 0.2 ms to 1.5 s apart.
    Spreadsheets and MATLAB count days: what moves by less than a second of them, from a day of those years, is such
    a date.
    """
    finite = values[np.isfinite(values)]
    steps = np.diff(finite)
    steps = steps[steps != 0.0]  # rows that share a stamp of few digits
    step = abs(float(np.median(steps))) if len(steps) else 1.0
    # Of rows that come in bursts the steps between these tell the unit.
    between = float(np.quantile(np.abs(steps), _BETWEEN_BURSTS)) if len(steps) else 1.0
    step = between if between > _OF_A_BURST * step else step
    sizes = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    if len(finite) and 1e18 <= finite[0] <= 4.1e18:
        return "ns"
    if len(finite) and any(first <= finite[0] <= last for first, last in _TENTHS):
        return "0.1us"
    if len(finite) and any(first <= finite[0] <= last for first, last in _DAYS) and 2e-4 < step * 86400.0 < 1.5:
        return "d"
    of_a_day = len(finite) and finite.min() >= 0.0 and finite.max() <= 1.0 and step < _OF_A_DAY
    if of_a_day and _FASTEST_BY_DAYS < step * 86400.0 < 1.5:
        return "d"
    return next((unit for unit, size in sizes.items() if 2e-4 < step * size < 1.5), "s")


def seconds_a_tick(values: np.ndarray, stated: str | None = None) -> float:
    """Return how long one unit of a clock is [s]: as stated, or if no unit of time is, as its steps tell.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Of the clock.
    stated : str, optional
        Symbol of a unit, which need not be one of time.
    """
    unit = find_unit(stated or "")
    if unit is None or unit.si != "s":
        unit = find_unit(unit_of_time(values))
    return 1.0 if unit is None else unit.factor


@dataclass(frozen=True)
class SplitStamp:
    """A time stamp in two columns: whole seconds, and what is left of a second in a smaller unit."""

    whole: str
    part: str
    key: str  # of `STAMP_PARTS`: what the part counts

    def joined(self, whole: np.ndarray, part: np.ndarray, first: float = 0.0) -> np.ndarray | None:
        """Return the time since `first` [s]; None where a part reaches a whole second: it is another clock's.

        Beside a time that counts parts of a second itself, milliseconds say the same again.
        """
        size = STAMP_PARTS[self.key]
        again = self.key == "milliseconds" and np.any(whole % 1.0 > 0.0)
        return None if again or np.any(part * size >= 1.0) else (whole - first) + size * part


STAMP_PARTS = {"nanoseconds": 1e-9, "microseconds": 1e-6, "milliseconds": 1e-3}
"""What the second column of a split stamp counts, by its key in a map [s]."""
_PART_WORDS = {"n": "nanoseconds", "u": "microseconds", "m": "microseconds"}


_MILLISECONDS = re.compile(r"milli(second)?s?|msecs?|ms", re.IGNORECASE)
"""Names of a column that holds what is left of a second beside a clock of whole ones."""


def split_stamps(infos: Sequence[RawChannelInfo]) -> list[SplitStamp]:
    """Return the stamps written out flat in two columns, as ROS, POSIX and OpenDLV have it.

    What is called a stamp or a time stands first: others may be the instants of sending and of receiving.
    """
    names = {info.name for info in infos if info.type_name != "text"}
    called, others = [], []
    for name in sorted(names, key=len):
        match = re.fullmatch(r"(.*?)((n|u)s|(n|u)secs?|(nano|micro)sec(ond)?s?)", name, re.IGNORECASE)
        if match is None:
            continue
        timed = re.fullmatch(r"(.*(stamp|time|header))?[._/ ]?|(.*[._/ ])?tv_", match[1], re.IGNORECASE)
        words = ("sec", "secs", "seconds", *(("s", "S") if timed else ()))
        whole = next((match[1] + word for word in words if match[1] + word in names), None)
        if whole is not None:
            (called if timed else others).append(SplitStamp(whole, name, _PART_WORDS[match[2][0].lower()]))
    clock, parts = time_column(infos), [name for name in names if _MILLISECONDS.fullmatch(name.strip())]
    if clock is not None and len(parts) == 1 and clock.name != parts[0]:
        others.append(SplitStamp(clock.name, parts[0], "milliseconds"))
    return [*called, *others]


def nearest_column(known: Mapping[str, Any], name: str, where: str) -> Any:
    """Return what is known by `name`.

    Raises
    ------
    LogError
        If nothing is; names the nearest.
    """
    if name not in known:
        raise LogError(f"no column {name!r}", where=where, advice=nearest_names(name, known))
    return known[name]


def note_once(notes: list[ReadNote], what: str, where: str, count: int = 1) -> None:
    """Add a note; one about the same thing in the same place is replaced, so that reading twice counts once."""
    note = ReadNote(what, where, count)
    notes[:] = [other for other in notes if (other.what, other.where) != (note.what, note.where)]
    notes.append(note)


class Words:
    """The texts of a column as numbers, piece by piece: a long column repeats few texts."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._pieces: list[np.ndarray] = []

    def append(self, texts: Sequence[str | None], places: np.ndarray | None = None) -> None:
        """Add rows: their texts, or those of a dictionary with the place of each row's text in it."""
        number = np.array([self._numbers.setdefault((t or "").strip(), len(self._numbers)) for t in texts], np.int32)
        self._pieces.append(number if places is None else number[places])

    def finished(self) -> tuple[np.ndarray, list[str]]:
        """Return a number for each row, shape (N,), and the texts that these numbers stand for."""
        return np.concatenate([np.zeros(0, np.int32), *self._pieces]), list(self._numbers)


class UniqueNames:
    """Names of columns, each once: one that occurs again is numbered (``speed``, ``speed_2``).

    The work grows with the number of names, not with its square, however many are alike.

    Attributes
    ----------
    renamed : int
        How many got a number.
    """

    def __init__(self) -> None:
        self._taken: set[str] = set()
        self._next: dict[str, int] = {}
        self.renamed = 0

    def of(self, name: str) -> str:
        """Return `name`, or it with the first number that is free; it is taken from then on."""
        unique, number = name, self._next.get(name, 2)
        while unique in self._taken:
            unique, number = f"{name}_{number}", number + 1
        if unique != name:
            self.renamed += 1
            self._next[name] = number
        self._taken.add(unique)
        return unique
