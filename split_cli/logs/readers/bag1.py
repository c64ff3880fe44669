"""ROS 1 bags (version 2.0), also those that were never closed or are cut off.

A bag is a row of records; the messages are in chunks, each followed by an index that tells what is in it. That
index is used rather than the one at the end, which a killed recorder never wrote.
"""

import bz2
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np

from split_cli.errors import LogError
from split_cli.logs.budget import Unfolded
from split_cli.logs.raw import ReadNote, note_once
from split_cli.logs.readers.messages import MessageBatch, Stream, in_batches
from split_cli.logs.scratch import let_go, mapped_file

BAG1_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _INDEX, _CHUNK, _CONNECTION = 2, 4, 5, 7
_SIZE = struct.Struct("<I")
_INDEX_ENTRY = np.dtype([("sec", "<u4"), ("nanosec", "<u4"), ("offset", "<u4")])


class _BagDamageError(Exception):
    """A record that cannot be what it says."""


@dataclass
class _Chunk:
    """A chunk's bytes in the file, and how many messages of each connection are in it."""

    start: int
    stop: int
    compression: bytes
    whole: bool = True
    counts: Counter[int] = field(default_factory=Counter)


class Bag1Container:
    """A ROS 1 bag; see `Container`. It knows log times only.

    Raises
    ------
    LogError
        If no message in it can be read.
    """

    has_publish_times = False

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[ReadNote] = []
        self._chunks: list[_Chunk] = []
        self._connections: dict[int, tuple[str, str, bytes]] = {}
        self._first_time: int | None = None
        with path.open("rb") as stream:
            self._file = mapped_file(stream)
        self._unfolded = Unfolded(len(self._file))
        self._survey()
        counts: Counter[int] = sum((chunk.counts for chunk in self._chunks), Counter())
        self.streams = [
            Stream(key, topic, kind, "ros1", "ros1msg", definition, counts[key])
            for key, (topic, kind, definition) in self._connections.items()
            if counts[key]
        ]
        if not self.streams or self._first_time is None:
            detail = f" ({self.notes[0].what})" if self.notes else ""
            raise LogError(f"holds no readable message{detail}", where=path.name, advice="Record it again.")
        self.origin = self._first_time

    def batches(self, keys: frozenset[int]) -> Iterator[MessageBatch]:
        """Yield the messages of the streams `keys`; see `Container.batches`."""
        for chunk in self._chunks:
            if keys.isdisjoint(chunk.counts):
                continue
            yield from in_batches(
                (key, time, time, bytes(payload)) for key, time, payload in self._messages(chunk) if key in keys
            )

    def _survey(self) -> None:
        """Find the chunks and connections, without decompressing what has an index of its own."""
        try:
            for header, start, stop in _records(self._file, len(BAG1_MAGIC), len(self._file)):
                self._take_in(header, start, stop)
        except _BagDamageError as damage:
            self._note(f"the file is cut off or damaged at byte {damage.args[0]}: read up to there")
            if len(damage.args) > 1:
                start, compression = damage.args[1:]
                self._chunks.append(_Chunk(start, len(self._file), compression, whole=False))
        known = set(self._connections)
        for chunk in self._chunks:
            if not chunk.counts or not known.issuperset(chunk.counts):
                chunk.counts = Counter()
                for key, time, _ in self._messages(chunk):
                    chunk.counts[key] += 1
                    self._see(time)
                let_go()

    def _take_in(self, header: dict[bytes, bytes], start: int, stop: int) -> None:
        kind = _operation(header)
        if kind == _CHUNK:
            self._chunks.append(_Chunk(start, stop, header.get(b"compression", b"none")))
        elif kind == _CONNECTION:
            self._add_connection(header, bytes(self._file[start:stop]))
        elif kind == _INDEX and self._chunks:
            count = (stop - start) // _INDEX_ENTRY.itemsize
            entries = np.frombuffer(self._file[start:stop], dtype=_INDEX_ENTRY, count=count)
            if count:
                self._chunks[-1].counts[_number(header, b"conn")] += count
                times = entries["sec"].astype(np.int64) * 1_000_000_000 + entries["nanosec"]
                self._see(int(times.min()))

    def _add_connection(self, header: dict[bytes, bytes], content: bytes) -> None:
        described = _fields(content, 0, len(content))
        topic = header.get(b"topic", b"").decode("utf-8", "replace")
        kind = described.get(b"type", b"").decode("utf-8", "replace")
        definition = described.get(b"message_definition", b"")
        self._connections.setdefault(_number(header, b"conn"), (topic, kind, definition))

    def _messages(self, chunk: _Chunk) -> Iterator[tuple[int, int, Any]]:
        """Yield connection, log time [ns] and payload of every message, as far as the chunk is sound."""
        try:
            most = self._unfolded.most(chunk.start, chunk.stop - chunk.start)
            content = _decompressed(memoryview(self._file)[chunk.start : chunk.stop], chunk.compression, most)
            self._unfolded.add(chunk.start, len(content))
            for header, start, stop in _records(content, 0, len(content)):
                kind = _operation(header)
                if kind == _MESSAGE:
                    sec, nanosec = struct.unpack("<II", header[b"time"])
                    yield _number(header, b"conn"), sec * 1_000_000_000 + nanosec, content[start:stop]
                elif kind == _CONNECTION:
                    self._add_connection(header, bytes(content[start:stop]))
        except (_BagDamageError, KeyError, struct.error):
            if chunk.whole:
                where = f"{self.path.name}, chunk at byte {chunk.start}"
                note_once(self.notes, "records cut off or damaged: read up to there", where)

    def _see(self, time: int) -> None:
        self._first_time = time if self._first_time is None else min(time, self._first_time)

    def _note(self, what: str) -> None:
        note_once(self.notes, what, self.path.name)


def _records(content: Any, start: int, stop: int) -> Iterator[tuple[dict[bytes, bytes], int, int]]:
    """Yield the header fields, and start and stop of the content, of every record between two bytes."""
    position = start
    headers = _Headers()
    while position < stop:
        if position + 8 > stop:
            raise _BagDamageError(position)
        header_stop = position + 4 + _SIZE.unpack_from(content, position)[0]
        if header_stop + 4 > stop:
            raise _BagDamageError(position)
        header = headers.fields(content, position + 4, header_stop)
        begin = header_stop + 4
        end = begin + _SIZE.unpack_from(content, header_stop)[0]
        if end > stop:
            if header.get(b"op") == bytes([_CHUNK]):
                raise _BagDamageError(position, begin, header.get(b"compression", b"none"))
            raise _BagDamageError(position)
        yield header, begin, end
        position = end


class _Headers:
    """Fields of headers that differ from one seen before in their time alone, as a topic's messages do."""

    _MOST = 4096
    """Headers kept; a bag has one for each connection, an attacker's as many as messages [1]."""

    def __init__(self) -> None:
        self._time_of: dict[int, int] = {}
        self._seen: dict[tuple[bytes, bytes], dict[bytes, bytes]] = {}

    def fields(self, content: Any, start: int, stop: int) -> dict[bytes, bytes]:
        """Return the fields of the header between two bytes."""
        raw = bytes(content[start:stop])
        at = self._time_of.get(len(raw), -1)
        if at >= 0 and (alike := self._seen.get((raw[:at], raw[at + 8 :]))) is not None:
            return {**alike, b"time": raw[at : at + 8]}
        fields = _fields(content, start, stop)
        if raw.count(b"time=") == 1 and len(fields.get(b"time", b"")) == 8 and len(self._seen) < self._MOST:
            at = self._time_of.setdefault(len(raw), raw.index(b"time=") + 5)
            if raw[at - 5 : at] == b"time=":
                self._seen[raw[:at], raw[at + 8 :]] = fields
        return fields


def _fields(content: Any, start: int, stop: int) -> dict[bytes, bytes]:
    fields = {}
    while start < stop:
        if start + 4 > stop:
            raise _BagDamageError(start)
        end = start + 4 + _SIZE.unpack_from(content, start)[0]
        if end > stop:
            raise _BagDamageError(start)
        name, equals, value = bytes(content[start + 4 : end]).partition(b"=")
        if not equals:
            raise _BagDamageError(start)
        fields[name] = value
        start = end
    return fields


def _operation(header: dict[bytes, bytes]) -> int:
    value = header.get(b"op", b"")
    return value[0] if len(value) == 1 else 0


def _number(header: dict[bytes, bytes], name: bytes) -> int:
    value = header.get(name, b"")
    if len(value) != 4:
        raise _BagDamageError(0)
    return _SIZE.unpack(value)[0]


def _decompressed(packed: memoryview, compression: bytes, most: int) -> Any:
    """Return a chunk's records, `most` bytes of them; of one that was cut off, those that can be had."""
    try:
        if compression == b"none":
            return packed
        if most == 0:
            raise _BagDamageError(0)
        if compression == b"bz2":
            return bz2.BZ2Decompressor().decompress(packed, max_length=most)
        if compression == b"lz4":
            return lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most)
    except (OSError, EOFError, RuntimeError, ValueError, MemoryError) as error:
        raise _BagDamageError(0) from error
    raise _BagDamageError(0)
