"""A clock of the day in one number, as loggers write it: HHMMSS.sss, or HHMMSSsss without the point."""

import numpy as np

_DIGITS_BEHIND = (1.0, 100.0, 1000.0)
"""By which a number is divided to get HHMMSS: none, hundredths or thousandths of a second without a point [1]."""
_LAST = 235959.9995
_DAY = 86400.0
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


def over_midnight(time: np.ndarray) -> np.ndarray:
    """Return a clock of the day with a day added after each midnight; any other as it is, shape (N,) [s].

    A clock of the day lies between 0 and a day, and no run that starts again falls by half of one.
    """
    kept = np.flatnonzero(np.isfinite(time))
    passed = np.cumsum(np.diff(time[kept], prepend=time[kept[:1]]) < -_HALF_A_DAY)
    if not len(kept) or not passed[-1] or time[kept].min() < 0.0 or time[kept].max() > _DAY:
        return time
    moved = np.array(time, dtype=np.float64)
    moved[kept] += _DAY * passed
    return moved


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
        fills = bool(np.any(steps > 0.0)) and seconds.max() > _FULL and minutes.max() >= 1.0
        if not fills or seconds.max() >= 60.0 or (minutes % 100.0).max() >= 60.0:
            continue
        whole = np.full(len(values), np.nan)
        whole[kept] = seconds_of_day(clock)
        moved = np.diff(whole[kept])
        # Rows that are minutes apart skip the hundreds by chance.
        if np.all(moved >= 0.0) and float(np.quantile(moved, 0.99)) < 60.0 - _FULL:
            return whole
    return None
