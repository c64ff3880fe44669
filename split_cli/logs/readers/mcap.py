"""The MCAP container: index when it is sound, a linear scan when it is not, everything up to a damage.

The record layouts come from the `mcap` package. Messages are not read through it, because it neither recovers
what stands before a damage nor hands over payloads fast enough.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from split_cli.errors import LogError
from split_cli.logs.budget import Unfolded
from split_cli.logs.raw import NO_CHECKSUMS, ReadNote, note_once
from split_cli.logs.readers.messages import MessageBatch, Stream, in_batches
from split_cli.logs.scratch import let_go, mapped_file

MCAP_MAGIC = b"\x89MCAP0\r\n"
_READ_AT_ONCE = 1 << 22
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE_BYTES = 22
_FOOTER_BYTES = _RECORD.size + 20
_PIECE = 32 << 20
"""Of what stands outside of chunks [bytes]: read at once, and let go of."""
_HIGHEST_OPCODE = 0x0F
_PARSE_ERRORS = (McapError, struct.error, ValueError, MemoryError, OverflowError)


class _McapDamageError(Exception):
    """A record that cannot be what its header says."""


@dataclass(slots=True)
class _Segment:
    """A stretch of the file that holds messages: one chunk record, or records outside of chunks."""

    # start, stop: bytes of the file: of the chunk's content, or of the records.
    start: int
    stop: int
    chunk: bool
    channels: frozenset[int] | None = None  # channels with messages in it, where known


@dataclass
class _Contents:
    """What a file holds."""

    segments: list[_Segment] = field(default_factory=list)
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    first_time: int | None = None

    def add(self, record: Any) -> None:
        """Take in a definition; the first one of an id holds, as the format demands that repeats be equal."""
        if isinstance(record, records.Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, records.Channel):
            self.channels.setdefault(record.id, record)

    def see(self, time: int) -> None:
        """Take in the log time of a message."""
        self.first_time = time if self.first_time is None else min(time, self.first_time)


class McapContainer:
    """One MCAP file; see `Container`.

    Raises
    ------
    LogError
        If it is not an MCAP file, or no message in it can be read.
    """

    has_publish_times = True

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[ReadNote] = []
        with path.open("rb") as stream:
            if stream.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise LogError("does not begin like an MCAP file", where=path.name, advice="Copy it again.")
            self._file = mapped_file(stream)
        self._unfolded = Unfolded(len(self._file))
        self._data_has_checksum = False
        contents = self._indexed_contents() or self._scanned_contents()
        self._segments = contents.segments
        if not contents.counts or contents.first_time is None:
            detail = f" ({self.notes[0].what})" if self.notes else ""
            raise LogError(f"holds no readable message{detail}", where=path.name, advice="Record it again.")
        self.origin = contents.first_time
        self.streams = [
            self._stream(channel, contents) for key, channel in contents.channels.items() if contents.counts[key]
        ]

    def _stream(self, channel: records.Channel, contents: _Contents) -> Stream:
        schema = contents.schemas.get(channel.schema_id)
        return Stream(
            key=channel.id,
            topic=channel.topic,
            type_name=schema.name if schema else "",
            encoding=channel.message_encoding,
            schema_encoding=schema.encoding if schema else "",
            schema=schema.data if schema else b"",
            count=contents.counts[channel.id],
        )

    def batches(self, keys: frozenset[int]) -> Iterator[MessageBatch]:
        """Yield the messages of the streams `keys`; see `Container.batches`."""
        for segment in self._segments:
            if segment.channels is None or not keys.isdisjoint(segment.channels):
                content = self._content(segment)
                if not self._has_checksum(segment):
                    note_once(self.notes, f"messages without a checksum: {NO_CHECKSUMS}", self.path.name)
                yield from in_batches(
                    (key, log_time, publish_time, bytes(content[start:stop]))
                    for key, log_time, publish_time, start, stop in self._messages(content, segment)
                    if key in keys
                )

    # --- what the file says of itself ---

    def _indexed_contents(self) -> _Contents | None:
        """Return what the summary section tells, or None when there is none that can be trusted."""
        size = len(self._file)
        start = size - len(MCAP_MAGIC) - _FOOTER_BYTES
        if start < len(MCAP_MAGIC) or self._file[-len(MCAP_MAGIC) :] != MCAP_MAGIC:
            return None
        opcode, length = _RECORD.unpack_from(self._file, start)
        if opcode != Opcode.FOOTER or length != 20:
            return None
        summary, _, crc = struct.unpack_from("<QQI", self._file, start + _RECORD.size)
        if not len(MCAP_MAGIC) <= summary < start:
            return None
        if crc and zlib.crc32(self._file[summary : start + _RECORD.size + 16]) != crc:
            return None
        contents, statistics, indexes = _Contents(), None, []
        try:
            for opcode, begin, end in _walk_records(self._file, summary, start):
                record = _parse(opcode, self._file[begin:end])
                contents.add(record)
                if isinstance(record, records.Statistics):
                    statistics = record
                elif isinstance(record, records.ChunkIndex):
                    indexes.append(record)
        except _McapDamageError:
            return None
        return self._contents_of_index(contents, statistics, indexes, summary)

    def _contents_of_index(
        self,
        contents: _Contents,
        statistics: records.Statistics | None,
        indexes: list[records.ChunkIndex],
        summary: int,
    ) -> _Contents | None:
        if statistics is None or len(indexes) != statistics.chunk_count or not indexes:
            return None
        counts = Counter({key: n for key, n in statistics.channel_message_counts.items() if n})
        if sum(counts.values()) != statistics.message_count or not set(counts) <= set(contents.channels):
            return None
        for index in sorted(indexes, key=lambda index: index.chunk_start_offset):
            start = index.chunk_start_offset + _RECORD.size
            stop = index.chunk_start_offset + index.chunk_length
            if not len(MCAP_MAGIC) <= start <= stop <= summary:
                return None
            if any(segment.stop > start for segment in contents.segments[-1:]):
                return None
            # The format lets a writer leave the message index out; then any channel may be inside.
            channels = frozenset(index.message_index_offsets) or None
            contents.segments.append(_Segment(start, stop, True, channels))
        listed = {key for segment in contents.segments for key in segment.channels or ()}
        if all(segment.channels for segment in contents.segments) and not set(counts) <= listed:
            # Messages outside of chunks: only a scan finds them.
            return None
        contents.counts = counts
        contents.first_time = statistics.message_start_time
        return contents

    def _scanned_contents(self) -> _Contents:
        """Read the whole file once, in order, up to its end or to a damage."""
        contents = _Contents()
        outside = _Segment(len(MCAP_MAGIC), len(MCAP_MAGIC), False)
        unknown, closed = 0, False
        try:
            for opcode, begin, end in _walk_records(self._file, len(MCAP_MAGIC), len(self._file)):
                if opcode == Opcode.CHUNK:
                    contents.segments += [outside, _Segment(begin, end, True)]
                    outside = _Segment(end, end, False)
                    continue
                if opcode == Opcode.DATA_END:
                    self._check_data_section(begin, end)
                    closed = self._file[-len(MCAP_MAGIC) :] == MCAP_MAGIC
                    break
                unknown += opcode > _HIGHEST_OPCODE
                outside.stop = end
                if end - outside.start > _PIECE:
                    contents.segments.append(outside)
                    outside = _Segment(end, end, False)
                    let_go()
        except _McapDamageError as damage:
            position, opcode = damage.args
            self._note(f"the file is cut off or damaged at byte {position}: read up to there")
            closed = True
            if opcode == Opcode.CHUNK:
                contents.segments += [outside, _Segment(position + _RECORD.size, len(self._file), True)]
                outside = _Segment(len(self._file), len(self._file), False)
        if not closed:
            self._note("the recording was not closed, or its end is cut off: read without its index")
        if unknown:
            self._note("records of an unknown kind, skipped", unknown)
        contents.segments.append(outside)
        found = (segment for segment in contents.segments if segment.stop > segment.start)
        surveyed = (self._surveyed(segment, contents) for segment in found)
        contents.segments = [segment for segment in surveyed if segment.channels]
        homeless = sum(count for key, count in contents.counts.items() if key not in contents.channels)
        if homeless:
            self._note("messages of a channel that is not defined, left out", homeless)
        return contents

    def _check_data_section(self, begin: int, end: int) -> None:
        expected = struct.unpack("<I", self._file[begin : begin + 4])[0] if end - begin >= 4 else 0
        found, self._data_has_checksum = 0, bool(expected)
        for start in range(0, begin - _RECORD.size if expected else 0, _PIECE):
            found = zlib.crc32(self._file[start : min(start + _PIECE, begin - _RECORD.size)], found)
            let_go()
        if found != expected:
            self._note("the checksum of the whole recording does not match")

    def _note(self, what: str, count: int = 1) -> None:
        note_once(self.notes, what, self.path.name, count)

    def _surveyed(self, segment: _Segment, contents: _Contents) -> _Segment:
        """Note a segment's definitions, and which channels have messages in it."""
        present: Counter[int] = Counter()
        content = self._content(segment)
        for key, log_time, *_ in self._messages(content, segment, contents):
            present[key] += 1
            contents.see(log_time)
        contents.counts += present
        let_go()
        return replace(segment, channels=frozenset(present))

    # --- segments ---

    def _has_checksum(self, segment: _Segment) -> bool:
        if not segment.chunk:
            return self._data_has_checksum
        return segment.stop - segment.start < _CHUNK.size or _CHUNK.unpack_from(self._file, segment.start)[3] != 0

    def _content(self, segment: _Segment) -> bytes | memoryview:
        """Return a segment's records, decompressed; only what is left of them where it is damaged."""
        if not segment.chunk:
            return memoryview(self._file)[segment.start : segment.stop]
        try:
            if self._file[segment.start - _RECORD.size] != Opcode.CHUNK:
                raise _McapDamageError("its header is damaged")
            most = self._unfolded.most(segment.start, segment.stop - segment.start)
            plain = _decompressed(memoryview(self._file)[segment.start : segment.stop], most)
            self._unfolded.add(segment.start, len(plain))
            return plain
        except _McapDamageError as damage:
            note_once(self.notes, f"chunk left out: {damage}", f"{self.path.name}, byte {segment.start}")
            return b""

    def _messages(
        self, content: bytes | memoryview, segment: _Segment, contents: _Contents | None = None
    ) -> Iterator[tuple[int, int, int, int, int]]:
        """Yield channel, log time, publish time, and start and stop of the payload, of every message."""
        position, size = 0, len(content)
        unpack, header = _MESSAGE.unpack_from, _MESSAGE.size
        try:
            while position + header <= size:
                opcode, length, channel, _, log_time, publish_time = unpack(content, position)
                start = position + _RECORD.size
                stop = start + length
                if stop > size or opcode == 0:
                    raise _McapDamageError
                if opcode == Opcode.MESSAGE:
                    if length < _MESSAGE_BYTES:
                        raise _McapDamageError
                    yield channel, log_time, publish_time, start + _MESSAGE_BYTES, stop
                elif contents is not None and opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    contents.add(_parse(opcode, bytes(content[start:stop])))
                position = stop
            # A short last record can only be a definition.
            if contents is not None and position < size:
                for opcode, start, stop in _walk_records(content, position, size):
                    contents.add(_parse(opcode, bytes(content[start:stop])))
        except _McapDamageError:
            where = f"{self.path.name}, {'chunk at ' if segment.chunk else ''}byte {segment.start}"
            note_once(self.notes, "records cut off or damaged: read up to there", where)


def _walk_records(content: Any, start: int, stop: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and stop of every record's content between two bytes."""
    position = start
    while position < stop:
        if position + _RECORD.size > stop:
            raise _McapDamageError(position, 0)
        opcode, length = _RECORD.unpack_from(content, position)
        begin = position + _RECORD.size
        if opcode == 0 or begin + length > stop:
            raise _McapDamageError(position, opcode)
        yield opcode, begin, begin + length
        position = begin + length


_PARSERS: dict[int, Any] = {
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.STATISTICS: records.Statistics,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
}


def _parse(opcode: int, content: bytes) -> Any:
    """Return a record of a kind this reader needs, else None."""
    kind = _PARSERS.get(opcode)
    if kind is None:
        return None
    try:
        return kind.read(ReadDataStream(BytesIO(content)))
    except _PARSE_ERRORS as error:
        raise _McapDamageError(0, opcode) from error


def _read_all(reader: Any, most: int) -> bytes:
    """Return what a stream holds, `most` bytes of it at the most; of a damaged one, what stands before that."""
    parts, left = [], most
    try:
        while left > 0 and (part := reader.read(min(left, _READ_AT_ONCE))):
            parts.append(part)
            left -= len(part)
    except zstandard.ZstdError:
        if not parts:
            raise
    return b"".join(parts)


def _decompressed(content: memoryview, most: int) -> bytes | memoryview:
    """Return the records of a chunk's content, `most` bytes; of a chunk that was cut off, those that are whole."""
    if len(content) < _CHUNK.size:
        raise _McapDamageError("it is cut off")
    _, _, plain_size, crc, name_length = _CHUNK.unpack_from(content)
    start = _CHUNK.size + name_length + 8
    if start > len(content) or plain_size > most:
        what = "its header is damaged, or claims more than a chunk, or a file, of so few bytes can hold"
        raise _McapDamageError(what)
    compression = bytes(content[_CHUNK.size : start - 8])
    stored = struct.unpack_from("<Q", content, start - 8)[0]
    cut = stored > len(content) - start
    packed = content[start : start + stored]
    try:
        if compression == b"":
            plain: bytes | memoryview = packed
        elif compression == b"zstd":
            # A byte more than it claims shows a chunk that is larger; more is never unpacked.
            reader = zstandard.ZstdDecompressor().stream_reader(packed)
            plain = _read_all(reader, plain_size + 1)
        elif compression == b"lz4":
            plain = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=plain_size + 1)
        else:
            raise _McapDamageError(f"its compression {compression[:20]!r} is not lz4 or zstd")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError, ValueError) as error:
        raise _McapDamageError("it cannot be decompressed") from error
    if cut:
        return plain
    if len(plain) != plain_size or (crc and zlib.crc32(plain) != crc):
        raise _McapDamageError("its checksum does not match")
    return plain
