"""One cell of a text as a number: with marks between thousands, a coordinate, a time in words, or with its unit."""

import re
from collections.abc import Sequence

import numpy as np

from split_cli.logs.readers.dialect import is_grouped, plain_sign, quantity_of

_TRUE, _FALSE = {"true", "on", "yes"}, {"false", "off", "no"}


def _ungrouped(cell: str) -> str:
    """Return a number without what stands between its thousands: its last mark that is no digit is the decimal."""
    whole, mark, part = re.fullmatch(r"(.*)([.,])(\d+)", cell.strip()).groups()
    return re.sub(r"[^\d+-]", "", whole) + mark + part


def number_of(cell: str, decimal: str) -> float:
    """Return a cell as a number: true and false as 1 and 0, coordinates in degrees, times in seconds, and
    what has its unit behind it in SI; else NaN.
    """
    cell = plain_sign(cell)
    if is_grouped(cell, decimal):
        cell = _ungrouped(cell)
    try:
        # Python takes 1_5 for 15; no logger writes that.
        return float(cell.replace(decimal, ".") if decimal != "." else cell) if "_" not in cell else seconds_of(cell)
    except ValueError:
        folded = cell.lower()
        if folded in _TRUE or folded in _FALSE:
            return float(folded in _TRUE)
        angle = degrees_of(cell)
        if np.isfinite(angle):
            return angle
        quantity = quantity_of(cell, decimal)
        return seconds_of(cell) if quantity is None else quantity[0]


_HALVES = {"N": 1.0, "E": 1.0, "S": -1.0, "W": -1.0}
_ANGLE = re.compile(
    r"([NSEW])? *(\d{1,3})°? *"
    r"(?:(\d{1,2}(?:[.,]\d+)?) *['′’] *(?:(\d{1,2}(?:[.,]\d+)?) *(?:[\"″”]|''))?)? *([NSEW])?$"
    r"|([NSEW])? *(\d{1,3}[.,]\d+) *° *([NSEW])?$"
)


def degrees_of(cell: str) -> float:
    """Return a geographic coordinate as degrees, south and west negative; NaN for what is none.

    ``52°06.1234' N``, ``N 52° 6' 7.4"`` or ``52.1057° N``: with the half of the globe that it is on. The letter O
    is east in German and west in French, so that no value is read from it.
    """
    found = _ANGLE.match(cell)
    if found is None:
        return float("nan")
    before, degrees, minutes, seconds, behind, first, decimal, last = found.groups()
    half = next((letter for letter in (before, behind, first, last) if letter), None)
    if half is None:
        return float("nan")
    if decimal:
        return _HALVES[half] * float(decimal.replace(",", "."))
    parts = [float((part or "0").replace(",", ".")) for part in (degrees, minutes, seconds)]
    return _HALVES[half] * (parts[0] + parts[1] / 60.0 + parts[2] / 3600.0)


def with_halves(values: np.ndarray, letters: Sequence[str]) -> np.ndarray:
    """Return coordinates in degrees, shape (N,): negative where a column beside them says south or west.

    Receivers write degrees and minutes in one number there, ddmm.mmmm, as NMEA 0183 does; degrees otherwise.

    Parameters
    ----------
    values : ndarray
        As recorded, shape (N,), NaN where missing.
    letters : sequence of str
        N, S, E or W, of each row.
    """
    signs = np.array([_HALVES.get(letter.strip(), np.nan) for letter in letters])
    limit = 180.0 if {"E", "W"} & {letter.strip() for letter in letters} else 90.0
    finite = values[np.isfinite(values)]
    if not len(finite) or finite.max() <= limit:
        return signs * values
    with np.errstate(invalid="ignore"):
        degrees, minutes = np.divmod(values, 100.0)
    return signs * (degrees + minutes / 60.0)


_SPAN = re.compile(r"(\d+(?:\.\d+)?(?:[eE][+-]?\d+)?) (sec|min|hr)$")
"""A duration as MATLAB writes it."""
_SECONDS = {"sec": 1.0, "min": 60.0, "hr": 3600.0}
_ZONE = re.compile(r"\[[A-Za-z_]+(?:/[A-Za-z_+-]+)*\]$")
"""The name of a time zone that Java writes behind the offset: 14:03:40+01:00[Europe/Berlin]."""
_DAYS = re.compile(r"([+-]?\d+) days?,? \+?(\d{1,2}:\d{2}:\d{2}(?:\.\d+)?)$")
"""A duration as Python and pandas write it: 0 days 00:00:00.010000."""
_CLOCK = re.compile(r"(?:(\d{1,3}):)?(\d{1,2}):(\d{1,2}(?:[.,]\d+|:\d{3})?)(?:\s*([AaPp])\.?[Mm]\.?)?$")
_MONTH = re.compile(r"(\d{1,2})([-/. ])([A-Za-z]{3})[a-z]*\2(\d{2,4})")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_OF_A_PROGRAM = re.compile(
    r"[A-Z][a-z]{2} ([A-Z][a-z]{2}) +(\d{1,2}) (\d{1,2}:\d{2}:\d{2}(?:\.\d+)?) "
    r"(?:[A-Z]{1,5})?(?:([+-])(\d{2}):?(\d{2}))? ?(\d{4})$"
)
_DATE = re.compile(r"(\d{1,4})([./-])(\d{1,2})\2(\d{1,4})[ T]+(.+)$")
_STAMP = re.compile(r"(20\d\d)[-_]?(\d\d)[-_]?(\d\d)[-_T ](\d\d)[-_]?(\d\d)[-_]?(\d\d)(?:[-_.](\d{1,9}))?$")
"""A moment as it is written in names of files: 2024_04_23_13_15_46_619, 20240423_131546."""


def seconds_of(cell: str) -> float:
    """Return a time written in words as seconds, else NaN.

    ISO 8601 counts from 1970, in UTC where it names no zone. A date in another order does so too; its day comes
    first where both readings are possible; its month may be a name (``14-Mar-2026``), or it is written as programs
    print it (``Wed Feb 23 06:51:06 GMT+08:00 2022``). A clock without a date
    (``10:15:03.25``, ``1:03.25``, ``10:15:03 PM``) counts from 0, as does a span (``0.25 sec``).
    """
    from datetime import UTC, datetime

    cell = _ZONE.sub("", cell)
    clock = _CLOCK.match(cell)
    if clock:
        hours, minutes, seconds, half = clock.groups()
        hour = float(hours or 0)
        if half:
            hour = hour % 12.0 + (12.0 if half in "Pp" else 0.0)
        return 3600.0 * hour + 60.0 * float(minutes) + float(re.sub("[,:]", ".", seconds))
    if days := _DAYS.match(cell):
        return 86400.0 * float(days[1]) + seconds_of(days[2])
    span = _SPAN.match(cell)
    if span:
        return float(span[1]) * _SECONDS[span[2]]
    if len(cell) < 14:
        return float("nan")
    if stamp := _STAMP.match(cell):
        year, month, day, hour, minute, second, part = stamp.groups()
        cell = f"{year}-{month}-{day}T{hour}:{minute}:{second}.{(part or '0')[:6]}"
    spoken = _OF_A_PROGRAM.match(cell)
    if spoken and spoken[1].lower() in _MONTHS:
        month, day, clock_of_day, sign, hours, minutes, year = spoken.groups()
        zone = f"{sign}{hours}:{minutes}" if sign else "+00:00"
        cell = f"{year}-{_MONTHS.index(month.lower()) + 1:02}-{int(day):02}T{clock_of_day.zfill(8)}{zone}"
    named = _MONTH.match(cell)
    if named and named[3].lower() in _MONTHS:
        cell = f"{named[1]}/{_MONTHS.index(named[3].lower()) + 1}/{named[4]}{cell[named.end() :]}"
    try:
        moment = datetime.fromisoformat(cell.replace("/", "-").replace(",", "."))
    except ValueError:
        dated = _DATE.match(cell)
        clock = _CLOCK.match(dated[5].strip()) if dated else None
        if dated is None or clock is None:
            return float("nan")
        first, second, third = int(dated[1]), int(dated[3]), int(dated[4])
        year, month, day = (first, second, third) if first > 31 else (third, second, first)
        month, day = (day, month) if month > 12 else (month, day)
        try:
            moment = datetime(year + 2000 if year < 100 else year, month, day, tzinfo=UTC)
        except ValueError:
            return float("nan")
        return moment.timestamp() + seconds_of(dated[5].strip())
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
