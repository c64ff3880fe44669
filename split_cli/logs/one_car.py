"""Tables with the rows of several cars (a race, a street seen from above): which there are, and the rows of one.

It may import `split_cli.logs.raw` and the errors.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.errors import MapError
from split_cli.logs.raw import Clock, RawChannelInfo, RawRecording, RawSignal, ReadNote, time_column

NAMES_OF_CARS = frozenset(
    """
    car car_id car_number car_no car_idx car_index carid vehicle vehicle_id vehicle_number vehicle_no
    original_vehicle_id
    vehicleid driver driver_id driver_number driver_no driverid track_id trackid agent_id agentid object_id objectid
    obj_id actor actor_id participant participant_id participantid robot robot_id veh_id vehid rider rider_id
    """.split()
)
"""Titles, in lower case with blanks as underscores, of the column that says whose row it is."""
_OF_A_LAP = re.compile(r"(?i)lap|sector|stint|run|runde")
_OF_A_PICTURE = re.compile(r"(?i)frame([_ ]?(id|no|nr|num|number|idx|index))?")
_MOST_CARS = 10_000
_FEWEST_ROWS = 2
_FEWEST_STAMPS, _MOST_WORDS, _LOOKED_AT = 20, 100, 12
"""Different times, words of a column, and columns of numbers that are looked at [1]; judgement."""
_HALF = 0.5
"""Of the rows of a word that have a number, and of the columns in which all words have one [1]."""
_ALONE, _SHARED = 0.95, 0.8
"""Share of the rows that time and word tell apart, and of the words that a stamp has a row of [1]; judgement."""
_SHOWN = 6
_LONGEST_RUN = 50
"""Rows of one car between those of others, on average [1]; judgement: cars are recorded at up to ten times the rate of
another, and a driver stays for minutes."""


@dataclass(frozen=True)
class SeveralCars:
    """What tells the rows of several cars apart."""

    column: str
    counts: dict[str, int]  # rows of each car by what the column says of it, the most rows first

    def describe(self) -> str:
        """Return how many cars there are, by which column, and what the first of them are called."""
        shown = ", ".join([*self.counts][:_SHOWN]) + (", ..." if len(self.counts) > _SHOWN else "")
        return f"holds the rows of {len(self.counts)} cars by its column {self.column!r} ({shown})"


def several_cars(recording: RawRecording) -> SeveralCars | None:
    """Return what tells several cars apart; None of one car, and of drivers who take turns in it.

    Two cars drive at the same time: rows of one lie between the first and the last of another.
    """
    infos = recording.channels()
    named = [info for info in infos if "_".join(info.name.strip().lower().split()) in NAMES_OF_CARS]
    for info in named:
        found = _cars_of(recording, info)
        if found is None:
            continue
        cars, names = found
        counts = np.bincount(cars, minlength=len(names))
        filled = [n for n in np.argsort(-counts, kind="stable") if counts[n] >= _FEWEST_ROWS and names[n]]
        if len(filled) > 1 and _at_the_same_time(cars, filled, _time_of(recording, infos, len(cars))):
            return SeveralCars(info.name, {names[n]: int(counts[n]) for n in filled})
    return _by_shared_stamps(recording, infos)


def _by_shared_stamps(recording: RawRecording, infos: Sequence[RawChannelInfo]) -> SeveralCars | None:
    """Return the column of words that alone tells apart rows of one time, whatever it is called; None of others.

    One car is in one state at a time: rows that have their stamps in common are of several, where each stamp has a
    row for each word.
    """
    clock = time_column(infos)
    texts = [info for info in infos if info.type_name == "text"]
    if clock is None or clock.type_name == "text" or not texts:
        return None
    signal = recording.read([clock.name])[clock.name]
    stamps, at, rows = np.unique(signal.values, return_inverse=True, return_counts=True)
    # Rows of one moment stand together; laps whose clock starts again have their stamps in common far apart.
    together = np.count_nonzero(at[1:] == at[:-1])
    if signal.time is not None or len(stamps) < _FEWEST_STAMPS or together < _SHARED * (len(at) - len(stamps)):
        return None
    if np.median(rows) < _FEWEST_ROWS:
        return None
    for info in texts:
        found = _cars_of(recording, info, most=_MOST_WORDS)
        if found is None or len(found[0]) != len(at):
            continue
        words, names = found
        pairs = np.unique(at.astype(np.int64) * len(names) + words)
        apart = len(pairs) > _ALONE * len(at) and np.mean(rows) > _SHARED * len(np.unique(words))
        if apart and _all_fill_the_same(recording, [i for i in infos if i.type_name != "text" and i != clock], words):
            counts = np.bincount(words, minlength=len(names))
            filled = [n for n in np.argsort(-counts, kind="stable") if counts[n] >= _FEWEST_ROWS and names[n]]
            return SeveralCars(info.name, {names[n]: int(counts[n]) for n in filled})
    return None


def _all_fill_the_same(recording: RawRecording, infos: Sequence[RawChannelInfo], words: np.ndarray) -> bool:
    """Whether the rows of all words have numbers in the same columns; those of different messages have not."""
    read = recording.read([info.name for info in infos[:_LOOKED_AT]])
    filled = []
    for signal in read.values():
        known = np.isfinite(signal.values)
        if len(known) == len(words) and known.any():
            filled.append(min(np.mean(known[words == word]) for word in np.unique(words)) > _HALF)
    return len(filled) > 0 and np.mean(filled) > _HALF


def of_one_car(recording: RawRecording, rows: Mapping[str, str]) -> RawRecording:
    """Return the rows of the car that a map chooses with `rows`, or the recording where it holds one car.

    Raises
    ------
    MapError
        If the recording holds several cars and the map chooses none, or one that has no rows.
    """
    for column, value in rows.items():
        info = next((info for info in recording.channels() if info.name == column), None)
        found = _cars_of(recording, info, most=None) if info is not None else None
        if found is None or value not in found[1]:
            known = ", ".join(found[1][:_SHOWN]) if found is not None else ""
            advice = f"Its rows are of {known}." if known else "`split ingest LOG --list` shows the columns."
            raise MapError(f"no row has {value!r} in the column {column!r}", where=recording.name, advice=advice)
        kept = found[0] == found[1].index(value)
        recording = RowsOfOneCar(recording, kept, f"rows in which {column} is not {value}, left out")
    if rows or hasattr(recording, "parts"):
        return recording
    several = several_cars(recording)
    if several is not None:
        first = next(iter(several.counts))
        advice = f"Choose one in the map: `rows: {{{several.column}: {first}}}`."
        raise MapError(f"{several.describe()}, and a drive is of one", where=recording.name, advice=advice)
    return recording


class RowsOfOneCar:
    """The rows of a table that are chosen; see `RawRecording`."""

    def __init__(self, inner: RawRecording, kept: np.ndarray, what: str) -> None:
        self._inner, self._kept = inner, kept
        self._note = ReadNote(what, inner.name, int(np.count_nonzero(~kept)))
        self.name: str = inner.name
        self.path: Path = inner.path
        self.origin, self.clocks = inner.origin, inner.clocks

    @property
    def notes(self) -> list[ReadNote]:
        """Notes of the table, and how many rows are left out."""
        return [self._note, *self._inner.notes]

    def channels(self) -> list[RawChannelInfo]:
        """Return the columns; how many rows they have is not said."""
        return [replace(info, count=None) for info in self._inner.channels()]

    def read(self, names: Sequence[str], clock: Clock | None = None) -> dict[str, RawSignal]:
        """Return the named columns in the rows that are chosen; see `RawRecording.read`."""
        return {name: self._of_rows(signal) for name, signal in self._inner.read(names, clock).items()}

    def _of_rows(self, signal: RawSignal) -> RawSignal:
        if len(signal.values) != len(self._kept):
            return signal
        time = signal.time if signal.time is None else signal.time[self._kept]
        return replace(signal, time=time, values=signal.values[self._kept])


def _cars_of(
    recording: RawRecording, info: RawChannelInfo, most: int | None = _MOST_CARS
) -> tuple[np.ndarray, list[str]] | None:
    """Return a number for each row, shape (N,), and what the column says of the cars of these numbers.

    None where it cannot be read, says one thing of all rows, or more than `most`.
    """
    if info.type_name == "text":
        texts = getattr(recording, "texts", None)
        found = texts(info.name) if texts is not None else (np.zeros(0, np.int32), [])
        return None if len(found[1]) < 2 or (most is not None and len(found[1]) > most) else found
    signal = recording.read([info.name])[info.name]
    finite = signal.values[np.isfinite(signal.values)]
    if signal.time is not None or not len(finite) or finite.min() == finite.max() or np.any(finite % 1.0 != 0.0):
        return None
    cars, rows = np.unique(signal.values, return_inverse=True)
    if most is not None and len(cars) > most:
        return None
    return rows.astype(np.int32), [f"{car:.0f}" if np.isfinite(car) else "" for car in cars]


def _time_of(recording: RawRecording, infos: Sequence[RawChannelInfo], count: int) -> np.ndarray:
    """Return the clock of the rows in its own unit, shape (N,); their numbers where no column counts time.

    A clock of the lap starts again for one car too. Where none counts time, the number of a picture does.
    """
    found = time_column(infos)
    found = None if found is not None and _OF_A_LAP.search(found.name) else found
    found = found or next((info for info in infos if _OF_A_PICTURE.fullmatch(info.name.strip())), None)
    values = recording.read([found.name])[found.name].values if found is not None else np.zeros(0)
    return values if len(values) == count else np.arange(float(count))


def _at_the_same_time(cars: np.ndarray, among: Sequence[int], time: np.ndarray) -> bool:
    """Whether the rows of two cars lie in one stretch of time, by half of the shorter, and take turns there.

    An object that a radar sees comes back, and a driver does: their rows stand together for seconds.
    """
    in_order = cars[np.argsort(time, kind="stable")]
    if len(cars) > _LONGEST_RUN * (1 + np.count_nonzero(in_order[1:] != in_order[:-1])):
        return False
    spans = []
    for car in among[:_SHOWN]:
        own = time[(cars == car) & np.isfinite(time)]
        if len(own) >= _FEWEST_ROWS:
            spans.append((float(own.min()), float(own.max())))
    for n, (first, last) in enumerate(spans):
        for begin, end in spans[n + 1 :]:
            if min(last, end) - max(first, begin) > 0.5 * min(last - first, end - begin):
                return True
    return False
