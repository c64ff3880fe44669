"""CAN frames in tables of text, as SavvyCAN (GVRET), cabana and python-can write them: a frame a row."""

import base64
import binascii
import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_TITLES = re.compile(
    rb"^\s*(time stamp,id,extended,.*\bd1\b|time,addr,bus,data\b|timestamp,arbitration_id,)", re.IGNORECASE
)


@dataclass(frozen=True)
class TextFrame:
    """One frame, with what a frame of python-can has."""

    timestamp: float  # [s]
    arbitration_id: int
    data: bytes
    is_error_frame: bool = False
    is_remote_frame: bool = False


def is_table_of_frames(head: bytes) -> bool:
    """Tell a table of CAN frames by its titles."""
    return _TITLES.match(head.removeprefix(b"\xef\xbb\xbf")) is not None


def frames_of(path: Path) -> Iterator[TextFrame | None]:
    """Yield the frames of a table, None for a row that is none.

    Identifiers and bytes are hexadecimal, of python-can the bytes are in base 64. GVRET counts whole microseconds.
    """
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
        rows = csv.reader(stream)
        titles = [title.strip().lower() for title in next(rows)]
        by_byte = "d1" in titles
        first = titles.index("d1" if by_byte else "data")
        place = next(titles.index(title) for title in ("id", "addr", "arbitration_id") if title in titles)
        in_base_64 = titles[place] == "arbitration_id"
        while True:
            try:
                row = next(rows)
            except StopIteration:
                return
            except csv.Error:  # a cell without an end, or a quote that is never closed
                yield None
                continue
            try:
                time = float(row[0]) * (1e-6 if by_byte else 1.0)
                if by_byte:
                    size = int(row[titles.index("len")])
                    data = bytes(int(cell, 16) for cell in row[first : first + size])
                elif in_base_64:
                    data = base64.b64decode(row[first], validate=True)
                else:
                    data = bytes.fromhex(row[first].strip().removeprefix("0x"))
                yield TextFrame(time, int(row[place], 16), data)
            except (ValueError, IndexError, binascii.Error):
                yield None
