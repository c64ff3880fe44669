"""Recordings made of messages on topics, whatever the container and the encoding."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from split_cli.errors import LogError, nearest_names
from split_cli.logs.raw import Clock, RawChannelInfo, RawSignal, ReadNote, note_once
from split_cli.logs.readers.cdr_and_ros1 import SerializedDecoder
from split_cli.logs.readers.definitions import FILLER, Definitions
from split_cli.logs.readers.payloads import Columns, PayloadDecoder
from split_cli.logs.readers.protobuf_and_json import JsonDecoder, ProtobufDecoder
from split_cli.logs.scratch import GrowingColumn, let_go, set_aside

_FLUSH_BYTES = 32 << 20
_BATCH_BYTES = 1 << 20
MOST_CHANNELS = 200_000
"""Fields of all topics [1], 100 MB of names; judgement: a car with 300 topics has 30,000."""
_BYTES_OF_A_MESSAGE = 128
"""Beside its payload [bytes]: the objects that hold it and its two times."""
_SCHEMAS_OF_ENCODING = {"cdr": ("ros2msg", "ros2idl", "omgidl"), "ros1": ("ros1msg",)}


@dataclass(frozen=True)
class Stream:
    """Messages of one type on one topic."""

    key: int  # the container's own number for it
    topic: str
    type_name: str
    encoding: str  # of the messages: ``cdr``, ``ros1``, ``protobuf``, ``json``
    schema_encoding: str  # of the definition: ``ros2msg``, ``ros2idl``, ``ros1msg``, ``protobuf``, ``jsonschema``
    schema: bytes  # the definition stored in the recording; may be empty
    count: int | None  # messages, where the container says so


@dataclass(frozen=True)
class MessageBatch:
    """Consecutive messages of one stream, with their log and publish times [ns]."""

    key: int
    log_times: list[int]
    publish_times: list[int]
    payloads: list[bytes]


def in_batches(messages: Iterable[tuple[int, int, int, bytes]]) -> Iterator[MessageBatch]:
    """Yield messages (stream, log time, publish time, payload) by stream, about a megabyte at a time.

    A file may hold all its messages in one chunk, or outside of any.
    """
    found: dict[int, MessageBatch] = {}
    waiting = 0
    for key, log_time, publish_time, payload in messages:
        batch = found.get(key)
        if batch is None:
            batch = found[key] = MessageBatch(key, [], [], [])
        batch.log_times.append(log_time)
        batch.publish_times.append(publish_time)
        batch.payloads.append(payload)
        waiting += len(payload)
        if waiting > _BATCH_BYTES:
            yield from found.values()
            found, waiting = {}, 0
    yield from found.values()


class Container(Protocol):
    """A file, or several in a row, that holds messages."""

    streams: list[Stream]
    origin: int  # first log time [ns]
    has_publish_times: bool
    notes: list[ReadNote]

    def batches(self, keys: frozenset[int]) -> Iterator[MessageBatch]:
        """Yield the messages of the streams `keys`, in the order of the file."""
        ...


class MessageRecording:
    """A `RawRecording` over a container; see `split_cli.logs.raw.RawRecording`."""

    def __init__(self, path: Path, container: Container, definitions: Definitions) -> None:
        self.name = path.name
        self.path = path
        self.notes = container.notes
        self.origin = container.origin * 1e-9
        self._container = container
        self._definitions = definitions
        self._decoders: dict[int, PayloadDecoder | LogError] = {}
        self._fields = 0
        self._topics: dict[str, list[Stream]] = defaultdict(list)
        for stream in container.streams:
            self._topics[stream.topic].append(stream)

    @property
    def clocks(self) -> tuple[Clock, ...]:
        """The clocks there are: header where any readable topic has a stamp, publish where the format has it."""
        found: list[Clock] = ["header"] if any(d.stamp for d in self._readable_decoders()) else []
        if self._container.has_publish_times:
            found.append("publish")
        return (*found, "log")

    def channels(self) -> list[RawChannelInfo]:
        """Return every numeric field of every topic; an unreadable topic stands for itself, with a note."""
        listed: list[RawChannelInfo] = []
        for topic, streams in self._topics.items():
            counts = [stream.count for stream in streams]
            total = None if None in counts else sum(count for count in counts if count is not None)
            seen: dict[str, str] = {}
            for stream in streams:
                try:
                    for path in self._decoder(stream).paths():
                        seen.setdefault(path, stream.type_name)
                except LogError as error:
                    note_once(self.notes, f"not readable: {error}", topic)
            if [*seen] == [FILLER]:
                continue  # std_msgs/Empty holds nothing that could be mapped
            if not seen:
                listed.append(RawChannelInfo(topic, streams[0].type_name, total))
            listed += [RawChannelInfo(f"{topic}/{path}", kind, total) for path, kind in seen.items()]
        return listed

    def read(self, names: Sequence[str], clock: Clock | None = None) -> dict[str, RawSignal]:
        """Return the named signals in the order of the file, which tells where a clock went back."""
        if clock is None:
            clock = self.clocks[0]
        if clock not in self.clocks:
            advice = f"Choose one of: {', '.join(self.clocks)}."
            raise LogError(f"has no {clock} time", where=self.name, advice=advice)
        wanted: dict[str, list[str]] = defaultdict(list)
        for name in dict.fromkeys(names):
            topic, path = self._split(name)
            wanted[topic].append(path)
        samples = self._decode({topic: tuple(paths) for topic, paths in wanted.items()})
        signals: dict[str, RawSignal] = {}
        for topic, paths in wanted.items():
            time, columns = self._assemble(topic, samples.pop(topic), clock)
            for path, values in zip(paths, columns, strict=True):
                name = f"{topic}/{path}"
                signals[name] = RawSignal(name, time, values)
        return {name: signals[name] for name in names}

    def element_counts(self) -> dict[str, int]:
        """Return how many elements the arrays of the first message of each topic have, by address."""
        found: dict[str, int] = {}
        for topic, streams in self._topics.items():
            for stream in streams:
                with suppress(LogError):
                    decoder = self._decoder(stream)
                    if stream.count != 0 and any("[" in path for path in decoder.paths()):
                        lengths = decoder.lengths(self._first_payload(stream.key))
                        found |= {f"{topic}/{path}": count for path, count in lengths.items()}
        return found

    def _split(self, name: str) -> tuple[str, str]:
        """Return topic and field of a name that exists, or raise."""
        # The longest beginning of it that is a topic.
        topic, below = name, "/"
        while topic not in self._topics and below:
            topic, below, _ = topic.rpartition("/")
        if not below or topic not in self._topics:
            advice = _nearest_topics(name, list(self._topics))
            raise LogError(f"no topic of {name!r}", where=self.name, advice=advice)
        path = name[len(topic) + 1 :]
        decoders, problem = [], None
        for stream in self._topics[topic]:
            try:
                decoders.append(self._decoder(stream))
            except LogError as error:
                problem = error
        if not decoders and problem is not None:
            raise LogError(problem.what, where=f"{self.name}, topic {topic}", advice=problem.advice)
        if not any(decoder.has(path) for decoder in decoders):
            fields = [field for decoder in decoders for field in decoder.paths()]
            what = f"topic {topic} ({self._topics[topic][0].type_name}) has no numeric field {path!r}"
            raise LogError(what, where=self.name, advice=nearest_names(path, fields))
        return topic, path

    def _decode(self, wanted: dict[str, tuple[str, ...]]) -> dict[str, _Samples]:
        by_key = {stream.key: stream for topic in wanted for stream in self._topics[topic]}
        samples = {topic: _Samples(len(paths)) for topic, paths in wanted.items()}
        pending: dict[int, list[MessageBatch]] = defaultdict(list)
        waiting = 0
        for batch in self._container.batches(frozenset(by_key)):
            pending[batch.key].append(batch)
            waiting += sum(map(len, batch.payloads)) + _BYTES_OF_A_MESSAGE * len(batch.payloads)
            if waiting > _FLUSH_BYTES:
                self._flush(pending, by_key, wanted, samples)
                waiting = 0
                let_go()
        self._flush(pending, by_key, wanted, samples)
        return samples

    def _flush(
        self,
        pending: dict[int, list[MessageBatch]],
        by_key: dict[int, Stream],
        wanted: dict[str, tuple[str, ...]],
        samples: dict[str, _Samples],
    ) -> None:
        for key, batches in pending.items():
            stream = by_key[key]
            payloads = [payload for batch in batches for payload in batch.payloads]
            log = np.array([time for batch in batches for time in batch.log_times], dtype=np.uint64)
            publish = np.array([time for batch in batches for time in batch.publish_times], dtype=np.uint64)
            try:
                columns = self._decoder(stream).decode(payloads, wanted[stream.topic])
            except LogError as error:
                note_once(self.notes, f"not readable: {error}", stream.topic, len(payloads))
                continue
            samples[stream.topic].add(log, publish, columns)
        pending.clear()

    def _assemble(self, topic: str, samples: _Samples, clock: Clock) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return time and the columns of a topic, shapes (N,), without the messages that could not be decoded."""
        if samples.lost:
            what = "messages that do not fit their definition, left out"
            note_once(self.notes, what, topic, samples.lost)
        if samples.lost and not samples.kept:
            raise LogError(
                f"none of the {samples.lost} messages of topic {topic} fits the definition of "
                f"{self._topics[topic][0].type_name}",
                where=self.name,
                advice="The definition is of another version, or the payloads are damaged. Give the right .msg "
                "files with --msg-path.",
            )
        log = times = samples.log.finished()
        if clock == "publish" and self._container.has_publish_times:
            times = samples.publish.finished()
        if clock == "header":
            times = self._header_times(topic, samples, log)
        # Wrapping subtraction of unsigned nanoseconds, read as signed, is exact over 292 years.
        since = (times.astype(np.uint64) - np.uint64(self._container.origin)).view(np.int64)
        columns = [column.finished() for column in samples.columns]
        return set_aside(since * 1e-9), columns

    def _header_times(self, topic: str, samples: _Samples, log: np.ndarray) -> np.ndarray:
        if not samples.all_stamped:
            note_once(self.notes, "messages without a time stamp of their own: log time used", topic, len(log))
            return log
        stamps = samples.stamps.finished()
        if not stamps.any():
            note_once(self.notes, "time stamps that were never set (zero): log time used", topic, len(log))
            return log
        return stamps

    def _decoder(self, stream: Stream) -> PayloadDecoder:
        if stream.key not in self._decoders:
            try:
                self._decoders[stream.key] = self._counted(stream)
            except LogError as error:
                self._decoders[stream.key] = error
        decoder = self._decoders[stream.key]
        if isinstance(decoder, LogError):
            raise decoder
        return decoder

    def _counted(self, stream: Stream) -> PayloadDecoder:
        """Make a decoder, unless its fields are too many beside those of other topics."""
        if self._fields <= MOST_CHANNELS:
            decoder = self._make_decoder(stream)
            self._fields += len(decoder.paths())
            if self._fields <= MOST_CHANNELS:
                return decoder
        advice = "Leave topics out of the recording."
        raise LogError(f"with this topic there are more than {MOST_CHANNELS:,} fields", advice=advice)

    def _make_decoder(self, stream: Stream) -> PayloadDecoder:
        expected = _SCHEMAS_OF_ENCODING.get(stream.encoding)
        if expected is not None:
            encoding = stream.schema_encoding if stream.schema else expected[0]
            if encoding not in expected:
                problem = f"{stream.encoding} messages with a {stream.schema_encoding!r} definition are not read"
                raise LogError(problem, advice=f"Record them with a definition in {expected[0]}.")
            layout = self._definitions.layout(stream.type_name, encoding, stream.schema)
            return SerializedDecoder(layout, cdr=stream.encoding == "cdr")
        if stream.encoding == "protobuf" and stream.schema_encoding == "protobuf":
            return ProtobufDecoder(stream.type_name, stream.schema)
        if stream.encoding == "json":
            decoder = JsonDecoder(stream.schema, self._first_payload(stream.key), self._container.origin)
            if decoder.assumption:
                note_once(self.notes, decoder.assumption, stream.topic)
            return decoder
        raise LogError(
            f"messages are encoded as {stream.encoding[:40] or 'nothing in particular'!r} "
            f"(definition: {stream.schema_encoding[:40] or 'none'}), which is not supported",
            advice="Supported are cdr, ros1, protobuf and json; convert the recording.",
        )

    def _first_payload(self, key: int) -> bytes:
        batch = next(self._container.batches(frozenset([key])), None)
        return batch.payloads[0] if batch else b"{}"

    def _readable_decoders(self) -> Iterator[PayloadDecoder]:
        for streams in self._topics.values():
            for stream in streams:
                try:
                    yield self._decoder(stream)
                except LogError:
                    continue


class _Samples:
    """The messages of a topic that could be decoded, times in ns, and how many could not."""

    def __init__(self, width: int) -> None:
        self.log, self.publish = GrowingColumn(np.uint64), GrowingColumn(np.uint64)
        self.stamps = GrowingColumn(np.int64)
        self.columns = [GrowingColumn() for _ in range(width)]
        self.all_stamped = True
        self.kept = self.lost = 0

    def add(self, log: np.ndarray, publish: np.ndarray, decoded: Columns) -> None:
        readable = decoded.readable
        kept = int(np.count_nonzero(readable))
        self.kept, self.lost = self.kept + kept, self.lost + len(readable) - kept
        self.log.append(log[readable])
        self.publish.append(publish[readable])
        if decoded.stamps is None:
            self.all_stamped = False
        else:
            self.stamps.append(decoded.stamps[readable])
        for column, values in zip(self.columns, decoded.values.T, strict=True):
            column.append(values[readable])


def _nearest_topics(name: str, topics: Sequence[str]) -> str:
    """Return suggestions for the topic part of `name`, whose own length is not known."""
    pieces = name.split("/")
    openings = ["/".join(pieces[:count]) for count in range(len(pieces), 0, -1)]
    for opening in openings:
        advice = nearest_names(opening, topics) if opening else ""
        if advice.startswith("Did you mean"):
            return advice
    return nearest_names(name, topics)
