"""Named arrays as a recording: what MATLAB files and NumPy archives have in common."""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.raw import RawRecording, RawSignal, ReadNote, TableRecording, note_once, seconds_a_tick
from split_cli.logs.scratch import set_aside
from split_cli.signals import STANDARD_GRAVITY, find_unit, split_name_and_unit

_MOST_COLUMNS = 64
"""Of a matrix, that are listed [1]; judgement: a state of a car has fewer, and the others are read by their name."""
_TIME_NAMES = ("time", "Time", "t", "tout")
_TIME_FIELD = re.compile(r"(?:t|time|timestamps?|stamp|tout)(?:_?(s|sec|ms|us|ns))?", re.IGNORECASE)
_TITLED_FIELDS = (".Value", ".Values", ".value", ".values")
VALUE_FIELDS = (*_TITLED_FIELDS, ".data", ".Data")
_UNIT = 1e-3
"""By which the length of a unit quaternion may vary [1]; judgement: it is saved in four digits or more."""
_NEAR_GRAVITY = 0.25
"""Of gravity, by which half of the sizes of three accelerations may be off [1]; judgement: a car mostly rolls."""
_FEWEST_ROWS = 20
"""From which on the layout of a matrix is looked for [1]; judgement."""
_STATE = 4
"""Columns of a matrix, all of which are 0 together only where nothing was written [1]; judgement: with three a car
may stand at its origin."""
_RISES = 0.95
"""Share of the steps of a time that are forward [1]."""
_VALUE_NAMES = ("signals.values", "values", "data", "Data")


def is_time(name: str) -> bool:
    """Whether an array is called a time, as ``t`` and ``timestamps`` are."""
    return _TIME_FIELD.fullmatch(name) is not None


def recording_of_vectors(
    path: Path, leaves: Sequence[tuple[str, np.ndarray]], notes: list[ReadNote], empty: str, kind: str = "column"
) -> RawRecording:
    """Return a recording of named arrays: vectors as they are, the columns of a matrix as ``name[0]``.

    An array takes its time from the one that stands beside it in its structure (``imu.t`` for ``imu.r``), or,
    where there are times of several lengths, from the only one of its length.

    Parameters
    ----------
    leaves : sequence of (str, ndarray)
        Names, and vectors (N,), (N, 1), (1, N) or matrices (N, K), in the units of their names. Lists of texts are
        the titles and units of a matrix with as many columns that stands beside them.
    notes : list of ReadNote
        What was lost so far; what is found here is added.
    empty : str
        What to do if no array has two numbers.
    kind : str
        What a listing calls each.

    Raises
    ------
    LogError
        If none has.
    """
    leaves = _with_titles(leaves)
    arrays = {name: values for name, values in leaves if values.size > 1 and values.ndim <= 2}
    clocks = _clocks_of_lengths(arrays) | _own_clocks(arrays)
    titles = _of_one_value(arrays, clocks)
    rows = max((v.size for n, v in arrays.items() if _is_clock(n, v)), default=0)
    signals: dict[str, RawSignal] = {}
    unlisted: dict[str, Callable[[], RawSignal]] = {}
    wide: list[str] = []
    unwritten = 0
    for name, values in arrays.items():
        if len(values) == 2 and values.ndim == 2 and name not in clocks and _rises_evenly(values[0]):
            # Simulink's To File: the first of two rows is the time.
            signals[name] = RawSignal(name, values[0].astype(np.float64), values[1].astype(np.float64), None)
            note_once(notes, "matrices of two rows, the first taken as time in s", path.name)
            continue
        if name in titles and titles[name] is None:
            continue
        if (blank := _rows_not_written(values)) is not None:
            unwritten = max(unwritten, int(np.count_nonzero(blank)))
        columns = _columns(titles.get(name) or name, values)
        for column_name, take in islice(columns, _MOST_COLUMNS):
            signal = _signal(column_name, take, clocks.get(name), blank, rows)
            signals[signal.name] = signal
        further = {split_name_and_unit(full)[0]: (full, take) for full, take in columns}
        wide += [f"{next(iter(further))} to {next(reversed(further))}"] if further else []
        for bare, (full, take) in further.items():
            unlisted[bare] = partial(_signal, full, take, clocks.get(name), blank, rows)
    if unwritten:
        what = "rows at the end of a matrix that hold 0 alone, which was not filled: left out"
        note_once(notes, what, path.name, unwritten)
    scalars = sum(values.size <= 1 for _, values in leaves)
    if scalars:
        note_once(notes, "variables of a single value, not listed", path.name, scalars)
    deep = sum(values.size > 1 and values.ndim > 2 for _, values in leaves)
    if deep:
        note_once(notes, "arrays of three dimensions or more, left out", path.name, deep)
    if wide:
        shown = ", ".join(wide[:3]) + (", ..." if len(wide) > 3 else "")
        what = f"columns of a matrix that are not listed, but that a map may name: {shown}"
        note_once(notes, what, path.name, len(unlisted))
    if not signals:
        raise LogError("holds no vector of numbers", where=path.name, advice=empty)
    return TableRecording(path.name, path, signals, type_name=kind, notes=notes, unlisted=unlisted)


def _signal(
    name: str, take: Callable[[], np.ndarray], time: np.ndarray | None, blank: np.ndarray | None, rows: int
) -> RawSignal:
    """Return a column with its time [s] and unit; `blank` are rows that nobody wrote, `rows` those of the only time."""
    bare, unit = split_name_and_unit(name)
    column = take()
    if blank is not None:
        column = set_aside(np.where(blank, np.nan, column))
    if len(column) == (rows if time is None else len(time)) - 1:
        # A simulation has one state more than inputs: each of these lasts until the next state.
        column = np.append(column, column[-1])
    if time is not None and len(time) != len(column):
        time = None
    return RawSignal(bare, time, column, unit)


def _with_titles(leaves: Sequence[tuple[str, np.ndarray]]) -> list[tuple[str, np.ndarray]]:
    """Return the arrays, with a matrix taken apart where a list of as many titles stands beside it.

    So a timetable is saved by its parts, and ``importdata`` returns a table. Beside is the same structure, or one
    within it (``Properties.VariableNames``). A list in which most are units is that of the units.
    """
    lists = {name: [str(text).strip() for text in np.ravel(v)] for name, v in leaves if v.dtype.kind == "U"}
    found: list[tuple[str, np.ndarray]] = []
    for name, values in leaves:
        if values.dtype.kind == "U":
            continue
        structure = name.rpartition(".")[0]
        beside = [
            texts
            # Of several lists the one named most like the matrix: pandas stores block1_values and block1_items.
            for place, texts in sorted(lists.items(), key=lambda entry: -len(os.path.commonprefix([entry[0], name])))
            if structure in ((inside := place.rpartition(".")[0]), inside.rpartition(".")[0])
            and values.ndim == 2
            and values.shape.count(len(texts)) == 1
        ]
        known = {id(texts): sum(find_unit(text) is not None for text in texts) > len(texts) / 2 for texts in beside}
        titles = next((texts for texts in beside if not known[id(texts)] and len(set(texts)) == len(texts)), None)
        if titles is None:
            found.append((name, values))
            continue
        units = next((texts for texts in beside if known[id(texts)]), [""] * len(titles))
        along = values if values.shape[1] == len(titles) else values.T
        front = f"{structure}." if structure else ""
        found += [
            (f"{front}{title.replace('.', '_')}" + (f" [{unit.replace('.', ' ')}]" if unit else ""), along[:, [k]])
            for k, (title, unit) in enumerate(zip(titles, units, strict=True))
        ]
    return found


def _of_one_value(arrays: dict[str, np.ndarray], clocks: dict[str, np.ndarray]) -> dict[str, str | None]:
    """Return the titles of structures of one value and its time (MoTeC): the structure's; None for the time."""
    fields: dict[str, list[str]] = {}
    for name in arrays:
        fields.setdefault(name.split(" [")[0].rpartition(".")[0], []).append(name)
    titles: dict[str, str | None] = {}
    for structure, names in fields.items():
        value = next((name for name in names if name.split(" [")[0].endswith(_TITLED_FIELDS)), None)
        if structure and value in clocks and len(names) == 2:
            unit = value.partition(" [")[2]
            titles |= {name: f"{structure} [{unit}" if unit and name == value else None for name in names}
            titles[value] = titles[value] or structure
    return titles


def _is_clock(name: str, values: np.ndarray) -> bool:
    """Whether an array is a vector called a time, in a structure or not."""
    return is_time(name.split(" [")[0].rpartition(".")[2]) and min(values.shape, default=0) == 1


def _rows_not_written(values: np.ndarray) -> np.ndarray | None:
    """Return which rows, shape (N,), of a state are 0 in every column up to the end; None where there are none.

    Programs make their matrices as long as the longest run may get, and a run may end early.
    """
    if values.ndim != 2 or min(values.shape) < _STATE:
        return None
    along = values if values.shape[0] >= values.shape[1] else values.T
    written = np.flatnonzero(np.any(along != 0.0, axis=1))
    if not len(written) or written[-1] == len(along) - 1:
        return None
    return np.arange(len(along)) > written[-1]


def _rises_evenly(row: np.ndarray) -> bool:
    """Whether a row counts up in equal steps, as a time does."""
    step = np.diff(np.asarray(row, dtype=np.float64))
    return len(step) > 10 and bool(np.all(step > 0.0)) and float(np.ptp(step)) < 1e-3 * float(step.mean())


def _own_clocks(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the time of each array that stands beside one of its own: of Simulink, of a sensor, or called after it."""
    clocks = _clocks_of_first_words(arrays) | _clocks_of_structures(arrays) | _clocks_called_after(arrays)
    for name in arrays:
        for ending in _VALUE_NAMES:
            if not name.endswith("." + ending):
                continue
            structure = name[: -len(ending)]
            beside = next((arrays[structure + t] for t in _TIME_NAMES if structure + t in arrays), None)
            if beside is not None:
                clocks[name] = np.asarray(beside, dtype=np.float64).ravel()
    return clocks


def _clocks_of_first_words(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return for each array the rising vector that begins as it does: ``imu_t`` for ``imu_acc`` and ``imu_gyro_z``.

    Where one time has all lengths, or one alone is so called, nothing is told apart.
    """
    times: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        front, _, last = name.rpartition("_")
        if front and "." not in name and _TIME_FIELD.fullmatch(last) and min(values.shape, default=0) == 1:
            time = np.asarray(values, dtype=np.float64).ravel()
            step = np.diff(time[np.isfinite(time)])
            if len(step) and np.mean(step > 0) > _RISES:
                times[front] = _in_seconds(time, None)
    clocks: dict[str, np.ndarray] = {}
    if len(times) < 2 or len({len(time) for time in times.values()}) < 2:
        return clocks
    for name, values in arrays.items():
        front = next((f for f in sorted(times, key=len, reverse=True) if name.startswith(f"{f}_")), "")
        if front and len(times[front]) in values.shape:
            clocks[name] = times[front]
    return clocks


def _clocks_called_after(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return for each vector the rising one of its length that is called after it: ``t_vx``, ``vx_time``."""
    clocks: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        structure, dot, field = split_name_and_unit(name)[0].rpartition(".")
        if min(values.shape, default=0) != 1 and values.ndim > 1:
            continue
        for called in (f"t_{field}", f"time_{field}", f"{field}_t", f"{field}_time", f"{field}_Time", f"{field}_ts"):
            beside = arrays.get(f"{structure}{dot}{called}")
            if beside is None or beside.size != values.size:
                continue
            time = np.asarray(beside, dtype=np.float64).ravel()
            step = np.diff(time[np.isfinite(time)])
            if len(step) and np.mean(step > 0) > 0.95:
                clocks[name] = clocks[f"{structure}{dot}{called}"] = _in_seconds(time, None)
                break
    return clocks


def _clocks_of_structures(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return for each vector of a structure (``imu.r``) the structure's rising vector of time (``imu.t``)."""
    times: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        bare, unit = split_name_and_unit(name)
        structure, _, field = bare.rpartition(".")
        match = _TIME_FIELD.fullmatch(field)
        if not structure or match is None or structure in times or min(values.shape, default=0) != 1:
            continue
        time = np.asarray(values, dtype=np.float64).ravel()
        step = np.diff(time[np.isfinite(time)])
        if len(step) and np.mean(step > 0) > 0.95:
            times[structure] = _in_seconds(time, match[1] or unit)
    clocks = {}
    for name, values in arrays.items():
        time = times.get(name.split(" [")[0].rpartition(".")[0])
        if time is not None and {len(time), len(time) - 1} & set(values.shape):
            clocks[name] = time
    return clocks


def _clocks_of_lengths(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the time of each array by its length, where times of several lengths have a time in their name."""
    times: dict[int, list[np.ndarray]] = {}
    for name, values in arrays.items():
        words = re.split(r"[._/ ]", name.split(" [")[0])
        match = next(filter(None, map(_TIME_FIELD.fullmatch, words)), None)
        if match is not None and min(values.shape, default=0) == 1:
            times.setdefault(values.size, []).append(_in_seconds(values, match[1]))
    if len(times) < 2 or any(len(found) > 1 for found in times.values()):
        return {}
    return {name: times[n][0] for name, values in arrays.items() for n in values.shape if n in times}


def _in_seconds(values: np.ndarray, unit: str | None) -> np.ndarray:
    """Return a time in seconds; a clock that states no unit tells it by its steps."""
    time = np.asarray(values, dtype=np.float64).ravel()
    return time * seconds_a_tick(time, unit)


def _columns(name: str, values: np.ndarray) -> Iterator[tuple[str, Callable[[], np.ndarray]]]:
    """Yield a vector as itself and a matrix as the vectors along its longer side, each taken when it is called."""
    with np.errstate(over="ignore"):
        # Of a damaged long double; what is infinite is dropped and counted later.
        values = np.asarray(values, dtype=np.float64)
    if min(values.shape) == 1 or values.ndim == 1:
        yield name, values.ravel
        return
    along = values if values.shape[0] >= values.shape[1] else values.T
    titles = _layout(name, along)
    for index in range(along.shape[1]):
        yield name + (titles[index] if titles else f"[{index}]"), partial(_column, along, index)


def _column(values: np.ndarray, index: int) -> np.ndarray:
    return set_aside(values[:, index].copy())


def _layout(name: str, values: np.ndarray) -> list[str]:
    """Return names of the columns of a message of ROS that was saved as a matrix; empty where it is none.

    nav_msgs/Odometry has 13 numbers, of which a unit quaternion stands behind the position. sensor_msgs/Imu
    without its quaternion has 6, and is called so: the three that read gravity are the accelerations.
    """
    finite = values[np.isfinite(values).all(axis=1)]
    if len(finite) < _FEWEST_ROWS:
        return []
    turn, push = ([f".{of}.{axis}" for axis in "xyz"] for of in ("angular_velocity", "linear_acceleration"))
    if values.shape[1] == 13 and np.ptp(np.linalg.norm(finite[:, 3:7], axis=1) - 1.0) < _UNIT:
        place = [f".pose.position.{axis}" for axis in "xyz"] + [f".pose.orientation.{axis}" for axis in "xyzw"]
        return place + [f".twist.linear.{axis}" for axis in "xyz"] + [f".twist.angular.{axis}" for axis in "xyz"]
    if values.shape[1] == 6 and "imu" in name.lower():
        of_first, of_last = (np.linalg.norm(finite[:, k : k + 3], axis=1) for k in (0, 3))
        if _reads_gravity(of_first) != _reads_gravity(of_last):
            return push + turn if _reads_gravity(of_first) else turn + push
    return []


def _reads_gravity(size: np.ndarray) -> bool:
    """Whether half of the sizes of three accelerations [m/s^2], shape (N,), are near gravity."""
    off = np.abs(np.quantile(size, [0.25, 0.75]) / STANDARD_GRAVITY - 1.0)
    return bool(np.all(off < _NEAR_GRAVITY))
