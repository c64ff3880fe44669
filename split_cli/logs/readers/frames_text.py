"""Lines of CAN frames as any program writes them: a time, an identifier, a count, and so many bytes.

So write candump without ``-L``, BusMaster, Kvaser, PCAN and tables with a column for each byte.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from split_cli.logs.raw import unit_of_time
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.dialect import LONGEST_LINE
from split_cli.logs.readers.frames_csv import TextFrame
from split_cli.signals import find_unit, split_name_and_unit

_PARTS = re.compile(r"[^\s,;()\[\]\"]+")
_BYTE = re.compile(r"(?:0x)?[0-9A-Fa-f]{2}")
_ID = re.compile(r"(?:0x)?[0-9A-Fa-f]{2,8}[xh]?")
_SECONDS = re.compile(r"[0-9]+[.,][0-9]+")
_CLOCK = re.compile(r"([0-9]{1,2}):([0-9]{1,2}):([0-9]{1,2})[.:,]([0-9]{1,6})")
_WORDS = frozenset("rx tx r t s x d f b".split())
"""Parts that say where a frame went, or of what kind it is; d, f and b are no identifiers."""
_LINES, _FEWEST, _SHARE = 60, 5, 0.8
"""Lines that are looked at, those of frames that show the form, and their share of lines with digits [1]; judgement."""
_MOST_BYTES = 64
_MIDNIGHT = 86_400.0


@dataclass(frozen=True)
class _Parts:
    """What a line says of a frame."""

    time: str
    identifier: str
    data: tuple[str, ...]


def is_text_of_frames(head: bytes) -> bool:
    """Tell lines of frames by the first bytes of a file: most lines with digits are one, and bytes hold letters."""
    if b"\0" in head:
        return False
    lines = [line for line in decoded(head.removeprefix(b"\xef\xbb\xbf")).splitlines()[:-1] if re.search(r"\d", line)]
    lines = [line for line in lines if not line.lstrip().startswith(("*", "#", "/"))][:_LINES]
    found = [parts for parts in map(_parts, lines) if parts is not None]
    if len(found) < max(_FEWEST, _SHARE * len(lines)):
        return False
    text = [cell.removeprefix("0x") for parts in found for cell in parts.data]
    # Bytes in hexadecimal keep their zero in front, which numbers in a table do not.
    return sum(bool(re.search(r"[A-Fa-f]|^0", cell)) for cell in text) > 0.1 * len(text)


def frames_in_lines(path: Path) -> Iterator[TextFrame | None]:
    """Yield the frames of a file of lines, None for a line with digits that is none.

    Identifiers and bytes are hexadecimal. A clock of the day goes on over midnight; another time is in seconds,
    or in the unit that a title states.
    """
    factor = _factor(path)
    day, before = 0.0, -1.0
    with path.open("rb") as stream:
        first = True
        while raw := stream.readline(LONGEST_LINE):
            line = decoded(raw.removeprefix(b"\xef\xbb\xbf") if first else raw)
            first = False
            parts = _parts(line)
            if parts is None:
                if re.match(r"\s*[(\d]", line):
                    yield None
                continue
            clock = _CLOCK.fullmatch(parts.time)
            if clock:
                time = 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + int(clock[3]) + float(f"0.{clock[4]}") + day
                if time < before - 0.5 * _MIDNIGHT:
                    day, time = day + _MIDNIGHT, time + _MIDNIGHT
                before = time
            else:
                time = float(parts.time.replace(",", ".")) * factor
            identifier = int(parts.identifier.lower().removeprefix("0x").rstrip("xh"), 16)
            yield TextFrame(time, identifier, bytes(int(cell, 16) for cell in parts.data))


def _parts(line: str) -> _Parts | None:
    """Return time, identifier and bytes of a line; None of one that holds no frame.

    The count is followed by as many bytes, and by no further one; the identifier stands before the count.
    """
    parts = _PARTS.findall(line)
    for place, part in enumerate(parts[1:-1], 1):
        if not (part.isdecimal() and part.isascii() and len(part) < 3 and 0 < int(part) <= _MOST_BYTES):
            continue
        data = parts[place + 1 : place + 1 + int(part)]
        behind = parts[place + 1 + int(part) :]
        if len(data) < int(part) or not all(map(_BYTE.fullmatch, data)) or (behind and _BYTE.fullmatch(behind[0])):
            continue
        before = parts[:place]
        known = [n for n, cell in enumerate(before) if _ID.fullmatch(cell) and cell.lower() not in _WORDS]
        if not known:
            continue
        identifier = known[-1]
        timed = [cell for n, cell in enumerate(before) if n != identifier] + behind
        time = next((cell for cell in timed if _SECONDS.fullmatch(cell) or _CLOCK.fullmatch(cell)), None)
        time = time or next((cell for cell in timed if cell.isdecimal() and cell.isascii() and len(cell) > 2), None)
        if time is not None:
            return _Parts(time, before[identifier], tuple(data))
    return None


def _factor(path: Path) -> float:
    """Return what a time of the file counts [s]: as its title says, or as the steps between frames tell."""
    import numpy as np

    with path.open("rb") as stream:
        lines = [decoded(stream.readline(LONGEST_LINE)) for _ in range(10 * _LINES)]
    for line in lines[:_LINES]:
        titles = [title for title in re.split(r"[,;\t]", line) if "time" in title.lower()]
        unit = find_unit(split_name_and_unit(titles[0])[1] or "") if titles and _parts(line) is None else None
        if unit is not None and unit.si == "s":
            return unit.factor
    times = [parts.time for parts in map(_parts, lines) if parts is not None]
    if any("." in time or "," in time or ":" in time for time in times):
        return 1.0
    unit = find_unit(unit_of_time(np.array([float(time) for time in times])))
    return unit.factor if unit is not None else 1.0
