"""How much a compressed or self-describing source may unfold into: bounds that no honest recording reaches."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import BinaryIO

from split_cli.errors import LogError

__all__ = [
    "MOST_FIELDS",
    "TooLargeError",
    "bounded_zlib_size",
    "most_bytes_out",
    "refuse_matlab_bombs",
    "refuse_unpacked_size",
]

_ALWAYS = 64 << 20
"""What any source may unfold into [bytes]; judgement: one chunk of a recorder has 1 to 8 MB."""
_MULTIPLE = 300
"""Bytes out for a byte in [1]; theory: lz4 reaches 255, a column that never changes comes near."""
_AT_MOST = 2 << 30
"""Of one chunk or variable [bytes]; theory: sizes in these formats are 32 bit, and half of that is a sign."""
MOST_FIELDS = 20_000
"""Numbers in one message type [1]; judgement: the largest of ROS has some 300, a full lidar's header 2,000."""
_BLOCK = 1 << 20


class TooLargeError(Exception):
    """A source unfolds into more than it may; the text says what and how much."""


def most_bytes_out(bytes_in: int) -> int:
    """Return how many bytes `bytes_in` compressed ones may become: at least 64 MB, 300 to one, at most 2 GB."""
    return min(max(_ALWAYS, _MULTIPLE * bytes_in), _AT_MOST)


def refuse_unpacked_size(size: int, bytes_in: int, what: str, where: str) -> None:
    """Refuse a size that a file claims for its content before memory is taken for it.

    Raises
    ------
    LogError
        If it is more than `most_bytes_out` of what is stored.
    """
    if size > most_bytes_out(bytes_in):
        raise LogError(
            f"{what} claims {size / 1e6:,.0f} MB, stored in {bytes_in / 1e6:.3g} MB: no recording is like that",
            where=where,
            advice="The file is damaged or made to exhaust memory; save it again without compression to read it.",
        )


def bounded_zlib_size(stream: BinaryIO, stored: int) -> int:
    """Return how many bytes a zlib stream becomes, without keeping them.

    Parameters
    ----------
    stream : binary file
        At the first byte; read by `stored` bytes at most.
    stored : int

    Raises
    ------
    TooLargeError
        As soon as it is more than `most_bytes_out(stored)`.
    """
    engine, size, left = zlib.decompressobj(), 0, stored
    limit = most_bytes_out(stored)
    while left > 0 and not engine.eof:
        packed = stream.read(min(_BLOCK, left))
        if not packed:
            break
        left -= len(packed)
        while packed:
            size += len(engine.decompress(packed, _BLOCK))
            packed = engine.unconsumed_tail
            if size > limit:
                raise TooLargeError(f"{stored:,} bytes become more than {limit >> 20} MB")
    return size


def refuse_matlab_bombs(path: Path) -> None:
    """Refuse a MAT file of version 5 with a compressed variable that unfolds into more than it may.

    The file is a row of elements, each with its type and size; those of type 15 are zlib streams (MATLAB,
    "MAT-File Format", version 5).

    Raises
    ------
    LogError
    """
    with path.open("rb") as stream:
        head = stream.read(128)
        if len(head) < 128 or not head.startswith(b"MATLAB 5.0"):
            return
        order = "little" if head[126:128] == b"IM" else "big"
        position, size = 128, path.stat().st_size
        while position + 8 <= size:
            stream.seek(position)
            tag = stream.read(8)
            kind, stored = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            if kind == 15:
                try:
                    bounded_zlib_size(stream, min(stored, size - position - 8))
                except TooLargeError as error:
                    raise LogError(
                        f"a variable is not read: {error}",
                        where=path.name,
                        advice="Save it again without compression.",
                    ) from error
                except zlib.error:
                    return  # damaged: the reader says so
            position += 8 + stored
