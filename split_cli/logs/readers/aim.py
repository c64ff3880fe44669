"""Recordings of AiM loggers (.xrk, .xrz), through libxrk (extra ``aim``)."""

import contextlib
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from split_cli.logs.raw import RawRecording, ReadNote
from split_cli.logs.readers.apart import ColumnApart, TableApart, open_apart, write_table
from split_cli.signals import symbol_of

_SUFFIXES = (".xrk", ".xrz")
_TICK = 1e-3
"""Of the logger's clock [s]."""


def is_aim(path: Path, head: bytes) -> bool:
    """Whether a file is a recording of AiM: messages, each of which begins with its name, or those in zlib."""
    packed = head[:1] == b"\x78" and path.suffix.lower() == ".xrz"
    return head.startswith(b"<hCNF\0") or (path.suffix.lower() in _SUFFIXES and (head.startswith(b"<h") or packed))


def open_aim(path: Path) -> RawRecording:
    """Open a recording of AiM. Each channel has its own clock, from the start of the recording.

    Raises
    ------
    LogError
        If libxrk is not installed, or the file is damaged or holds no samples.
    """
    return open_apart(path, hand_over_aim, "libxrk", "a recording of AiM", "aim")


def hand_over_aim(path: Path, folder: str) -> None:
    """Read a recording and write its columns: what a process of its own does."""
    write_table(path, folder, _read)


def _read(path: Path) -> TableApart:
    # Of its two parsers the one in Rust: it reads recordings without a satellite fix, and tells what it skips.
    os.environ["LIBXRK_BACKEND"] = "rust"
    from libxrk import ChannelMetadata, aim_xrk

    with _what_is_printed() as printed:
        log = aim_xrk(str(path))
    columns = []
    for name, table in sorted(log.channels.items()):  # the parser gives them in no order
        values = table.column(name).to_numpy()
        if values.dtype.kind in "biuf":
            unit = ChannelMetadata.from_channel_table(table).units
            time = table.column("timecodes").to_numpy() * _TICK
            columns.append(ColumnApart(name, symbol_of(unit) or "", time, values))
    skipped = sum(int(count) for line in printed for count in re.findall(rb"Bad bytes\((\d+) at", line))
    notes = [ReadNote("bytes that are no message of the logger, skipped", path.name, skipped)] if skipped else []
    return TableApart(columns, notes)


@contextlib.contextmanager
def _what_is_printed() -> Iterator[list[bytes]]:
    """Give the lines that compiled code prints to standard error, once the body has ended."""
    printed: list[bytes] = []
    own = os.dup(2)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            yield printed
        finally:
            os.dup2(own, 2)
            os.close(own)
            file.seek(0)
            printed += file
