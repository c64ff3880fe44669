"""Files recorded together whose clocks count from different instants: brought together by what both measured."""

from itertools import product

import numpy as np

from split_cli.logs.drafting.naming import meanings
from split_cli.logs.raw import RawChannelInfo, RawRecording, RawSignal, ReadNote
from split_cli.logs.readers.joint import JointRecording

_RATE = 20.0
"""Of the common grid, ten times what the speed of a car follows [Hz]."""
_SHARED = ("vx", "r", "ax", "ay")
"""Channels that loggers of one car have in common, with their own sensors."""
_ALIKE = 0.97
"""Correlation of two sensors of one quantity over a drive [1]; judgement, real pairs of comma2k19 reach 0.999."""
_ONE_PLACE = 4.0
"""By how much the rest that the best shift leaves is less than that of any other [1]: laps alike leave two."""
_APART = 3.0
"""Shifts nearer than this are one [s]."""

_SINCE_1970 = 1e9
"""What a clock reads at least that counts from 1970, in 2001 [s]."""
_HALF_AN_HOUR, _FARTHEST_ZONES = 1800.0, 14 * 3600.0
"""By which time zones differ: multiples of the one, up to the other [s]; a quarter is kept by two countries."""
_IN_COMMON = 0.8
"""Share of the shorter of two files that lies within the other, once a time zone is taken off [1]; judgement."""
MOVED = "clock moved by"
"""How the note on a clock begins."""


def let_clocks_meet(recording: JointRecording) -> None:
    """Move the clocks of files that have no time in common with the first, where one shift is beyond doubt.

    Notes
    -----
    Of every pair of signals that mean one of `_SHARED`, in the first file and another, the correlation is
    taken at every shift that leaves half of the shorter. The scale of either does not matter. A shift is taken
    if the correlation there is high and at no other shift nearly so. Of several pairs the one is taken whose
    correlation falls soonest beside its best shift, for what it lacks of 1: a yaw rate tells time better than a
    speed, which changes slowly and which wheels measure with their slip. Ingest then tells what delay is left.
    """
    signals = {name: signal for name, signal in _of_motion(recording).items() if signal.time is not None}
    parts = {name: recording.part_of(name) for name in signals}
    first = recording.parts[0]
    for other in recording.parts[1:]:
        ours = [name for name, part in parts.items() if part is first]
        theirs = [name for name, part in parts.items() if part is other]
        clocks = [_clock_of(recording, part) for part in (first, other)]
        if any(clock is None for clock in clocks) or _meet(*clocks):
            continue
        found = [
            (*shift, a, b) for a, b in product(ours, theirs) if (shift := _shift(signals[a], signals[b])) is not None
        ]
        if found:
            _, correlation, shift, a, b = min(found)
            recording.move(other, shift)
            what = f"{MOVED} {shift:.2f} s, since {b} then goes with {a} (correlation {correlation:.4f})"
            recording.remark(ReadNote(what, other.name))
        elif not _alike(ours, theirs) and (zone := _zone(*clocks)):
            recording.move(other, zone)
            what = f"{MOVED} {zone / 3600.0:g} h: both count from 1970, and differ by the hours of a time zone. CHECK"
            recording.remark(ReadNote(what, other.name))


def _alike(ours: list[str], theirs: list[str]) -> bool:
    """Whether two files measure a quantity both: then they may be two drives, one behind the other."""
    kinds = [{m.channel for name in names for m in meanings(_bare(name))} & set(_SHARED) for names in (ours, theirs)]
    return bool(kinds[0] & kinds[1])


def _bare(name: str) -> RawChannelInfo:
    return RawChannelInfo(name, "column", None)


def _zone(one: np.ndarray, other: np.ndarray) -> float:
    """Return the half hours by which a clock of another time zone is moved to meet the first [s]; 0 where none."""
    spans = [(float(np.nanmin(time)), float(np.nanmax(time))) for time in (one, other)]
    if min(first for first, _ in spans) < _SINCE_1970:
        return 0.0
    (first, last), (begin, end) = spans
    shift = _HALF_AN_HOUR * round((first + last - begin - end) / 2.0 / _HALF_AN_HOUR)
    common = min(last, end + shift) - max(first, begin + shift)
    known = 0.0 < abs(shift) <= _FARTHEST_ZONES and common > _IN_COMMON * min(last - first, end - begin)
    return shift if known else 0.0


def _of_motion(recording: JointRecording) -> dict[str, RawSignal]:
    infos = [info for info in recording.channels() if info.type_name != "text"]
    named = [info.name for info in infos if {m.channel for m in meanings(info)} & set(_SHARED)]
    return recording.read(named)


def _clock_of(recording: JointRecording, part: RawRecording) -> np.ndarray | None:
    """Return the clock of the first channel of a file [s], shape (N,); None where it has none."""
    names = [i.name for i in recording.channels() if i.type_name != "text" and recording.part_of(i.name) is part]
    time = recording.read(names[:1])[names[0]].time if names else None
    return time if time is not None and np.isfinite(time).any() else None


def _meet(one: np.ndarray, other: np.ndarray) -> bool:
    return min(np.nanmax(one), np.nanmax(other)) > max(np.nanmin(one), np.nanmin(other))


def _shift(one: RawSignal, other: RawSignal) -> tuple[float, float, float] | None:
    """Return how far the best shift is open [s], the correlation, and the shift of the other's clock [s].

    None where in doubt. What is open is the shift at which as much is lost as the best one leaves.
    """
    from scipy.signal import correlate

    (start, a), (begin, b) = _on_grid(one), _on_grid(other)
    if min(len(a), len(b)) < 10.0 * _RATE:
        return None

    def summed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return correlate(x, y, mode="full", method="fft")

    ones = np.ones_like(a), np.ones_like(b)
    count, sx, sy = np.round(summed(*ones)), summed(a, ones[1]), summed(ones[0], b)
    within = (count * summed(a * a, ones[1]) - sx**2) * (count * summed(ones[0], b * b) - sy**2)
    enough = (count >= 0.5 * min(len(a), len(b))) & (within > 1e-6 * count**4)
    value = np.where(enough, (count * summed(a, b) - sx * sy) / np.sqrt(np.where(enough, within, 1.0)), 0.0)
    best = int(np.argmax(value))
    apart = np.abs(np.arange(len(value)) - best) > _APART * _RATE
    if value[best] < _ALIKE or np.any(1.0 - value[apart] < _ONE_PLACE * (1.0 - value[best])):
        return None
    left, top, right = value[max(best - 1, 0)], value[best], value[min(best + 1, len(value) - 1)]
    bend = left - 2.0 * top + right
    fraction = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    left_open = float(np.sqrt(2.0 * max(1.0 - top, 0.0) / -bend)) / _RATE if bend < 0.0 else np.inf
    return left_open, float(top), float(start - begin + (best - (len(b) - 1) + fraction) / _RATE)


def _on_grid(signal: RawSignal) -> tuple[float, np.ndarray]:
    """Return the first instant [s] and the samples on the common grid, of unit deviation."""
    good = np.isfinite(signal.time) & np.isfinite(signal.values)
    stamps, first = np.unique(signal.time[good], return_index=True)
    values = np.asarray(signal.values, dtype=np.float64)[good][first]
    if len(stamps) < 20 or np.std(values) == 0.0:
        return 0.0, np.zeros(0)
    grid = np.arange(stamps[0], stamps[-1], 1.0 / _RATE)
    return float(stamps[0]), (np.interp(grid, stamps, values) - values.mean()) / values.std()
