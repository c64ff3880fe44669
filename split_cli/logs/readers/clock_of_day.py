"""Clocks as loggers write them: of the day in one number (HHMMSS.sss, HHMMSSsss), or with counts behind the point."""

import re
from collections.abc import Sequence

import numpy as np

_DIGITS_BEHIND = (1.0, 100.0, 1000.0)
"""By which a number is divided to get HHMMSS: none, hundredths or thousandths of a second without a point [1]."""
_LAST = 235959.9995
_LAST_MINUTE = 2359.0
_MINUTE, _DAY, _WEEK = 60.0, 86400.0, 604800.0
"""[s]."""
_HALF_A_DAY = 43200.0
"""A clock that falls by more has passed midnight [s]."""
_FULL = 50.0
"""Seconds that a clock reaches which passes from minute to minute with rows every few seconds [s]."""


def seconds_of_day(clock: np.ndarray) -> np.ndarray:
    """Return seconds since midnight of HHMMSS.sss, a day added after each midnight, shape (N,)."""
    with np.errstate(invalid="ignore"):  # a clock that is no number
        hours, rest = np.divmod(clock, 10000.0)
    minutes, seconds = np.divmod(rest, 100.0)
    return np.round(over_midnight(hours * 3600.0 + minutes * 60.0 + seconds), 6)


def over_midnight(time: np.ndarray, second: float = 1.0) -> np.ndarray:
    """Return a clock of the day or of the week with each midnight passed added; any other as it is, shape (N,).

    A clock of the day lies between 0 and a day, and no run that starts again falls by half of one. One of the week,
    as satellite receivers count it, falls from its last minute to its first.

    Parameters
    ----------
    time : ndarray
        As recorded, shape (N,), NaN where missing.
    second : float
        What a second is in it [1].
    """
    kept = np.flatnonzero(np.isfinite(time))
    if not len(kept) or time[kept].min() < 0.0:
        return time
    time = over_a_full_counter(time)
    clock = time[kept] / second
    period = _DAY if clock.max() <= _DAY else _WEEK
    before, after = clock[:-1], clock[1:]
    fell = after - before < -_HALF_A_DAY
    if period == _WEEK:
        fell &= (before > _WEEK - _MINUTE) & (after < _MINUTE)
    if clock.max() > period or not fell.any():
        return time
    moved = np.array(time, dtype=np.float64)
    moved[kept[1:]] += period * second * np.cumsum(fell)
    return moved


_BITS = (16, 24, 32)
"""Of the counters of microcontrollers that are written as time: micros() of Arduino is full after 71.6 minutes."""
_STEPS_OVER_THE_END = 3.0
"""Usual steps within which a clock goes on over the end of its counter [1]; a row may be lost there."""


def over_a_full_counter(time: np.ndarray) -> np.ndarray:
    """Return a clock of whole numbers that goes on where its counter was full, shape (N,); any other as it is.

    A counter of 32 bits falls from near 2^32 to near 0, and the step over its end is as long as the others. A clock
    that starts again falls from anywhere.
    """
    kept = np.flatnonzero(np.isfinite(time))
    steps = np.diff(time[kept])
    fell = steps < 0.0
    if not fell.any() or np.any(time[kept] % 1.0 != 0.0) or not np.any(steps > 0.0):
        return time
    usual = float(np.median(steps[steps > 0.0]))
    for bits in _BITS:
        over = steps[fell] + 2.0**bits
        if time[kept].max() < 2.0**bits and np.all((over > 0.0) & (over <= _STEPS_OVER_THE_END * usual)):
            moved = np.array(time, dtype=np.float64)
            moved[kept[1:]] += 2.0**bits * np.cumsum(fell)
            return moved
    return time


def packed_clock(values: np.ndarray) -> np.ndarray | None:
    """Return the seconds of a column that writes hours, minutes and seconds in one number; None of any other.

    Such a number jumps by 40 where a minute is full: no value lies between 60 and 99 of a hundred, though the
    column passes several hundreds. A count of seconds, or a distance, passes through all of them.

    Parameters
    ----------
    values : ndarray
        As recorded, shape (N,), NaN where missing.

    Returns
    -------
    ndarray or None
        Seconds since midnight [s], shape (N,).
    """
    kept = np.isfinite(values)
    finite = values[kept]
    if len(finite) < 2 or finite.min() < 0.0:
        return None
    for scale in _DIGITS_BEHIND:
        clock = finite / scale
        if clock.max() > _LAST or (scale > 1.0 and np.any(finite % 1.0 != 0.0)):
            continue
        seconds, minutes = clock % 100.0, clock // 100.0
        steps = np.diff(minutes)
        midnight = (minutes[:-1] == _LAST_MINUTE) & (minutes[1:] == 0.0)
        fills = bool(np.any(steps > 0.0) or np.any(midnight)) and seconds.max() > _FULL and minutes.max() >= 1.0
        if not fills or seconds.max() >= 60.0 or (minutes % 100.0).max() >= 60.0:
            continue
        whole = np.full(len(values), np.nan)
        whole[kept] = seconds_of_day(clock)
        moved = np.diff(whole[kept])
        # Rows that are minutes apart skip the hundreds by chance.
        if np.all(moved >= 0.0) and float(np.quantile(moved, 0.99)) < 60.0 - _FULL:
            return whole
    return None


_COUNTED = re.compile(r"(\d+)[.,](\d{1,9})")
_FEWEST_FALLS = 3
"""Of a clock within a second, from which on its digits are looked at [1]: twice may be rows out of order."""


def falls_within_seconds(values: np.ndarray) -> bool:
    """Tell whether a clock falls by less than a second again and again, shape (N,) [s]."""
    steps = np.diff(values[np.isfinite(values)])
    return bool(np.count_nonzero((steps < 0.0) & (steps > -1.0)) >= _FEWEST_FALLS)


def counted_clock(cells: Sequence[str]) -> np.ndarray | None:
    """Return the seconds of a clock that has a count behind its point: 12.5 is 12.005 s, and 12.50 is 12.05 s.

    Programs print whole seconds and milliseconds or microseconds so, one after the other, without leading zeros.
    Such a clock rises from row to row once it is read so; None for cells of which that is not true.
    """
    found = [_COUNTED.fullmatch(cell.strip()) for cell in cells]
    if not any(found):
        return None
    second = 10.0 ** max(len(match[2]) for match in found if match)
    time = np.array([int(match[1]) + int(match[2]) / second if match else np.nan for match in found])
    return time if np.all(np.diff(time[np.isfinite(time)]) >= 0.0) else None


_FEWEST_SECONDS = 10
_ALIKE = 0.2
"""Share by which the rows of a second may differ from the usual number [1], or by one."""


def spread_over_seconds(time: np.ndarray) -> np.ndarray | None:
    """Return a clock of whole seconds with the rows of each second spread evenly over it, shape (N,) [s].

    Rows that come at a steady rate are then no later and no earlier than their distance. None for a clock with parts
    of seconds, or whose seconds have unlike numbers of rows.
    """
    if len(time) < 2 * _FEWEST_SECONDS or not np.all(np.isfinite(time)) or np.any(time != np.floor(time)):
        return None
    seconds, first, counts = np.unique(time, return_index=True, return_counts=True)
    usual = float(np.median(counts))
    inner = counts[1:-1]
    alike = np.abs(inner - usual) <= max(_ALIKE * usual, 1.0)
    if len(seconds) < _FEWEST_SECONDS or usual < 2.0 or np.any(np.diff(time) < 0.0) or np.mean(alike) < 1.0 - _ALIKE:
        return None
    # A second that lacks rows has them at their usual distance; the first one ends with the second.
    rows = np.maximum(counts, usual)
    place = np.arange(len(time)) - np.repeat(first, counts)
    late = np.where(np.arange(len(seconds)) == 0, rows - counts, 0.0)
    return time + (place + np.repeat(late, counts)) / np.repeat(rows, counts)
