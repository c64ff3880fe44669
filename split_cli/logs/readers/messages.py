"""Recordings made of messages on topics, whatever the container and the encoding."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from split_cli.errors import LogError, nearest_names
from split_cli.logs.raw import Clock, RawChannelInfo, RawSignal, ReadNote, note_once
from split_cli.logs.readers.definitions import Definitions
from split_cli.logs.readers.objects import JsonDecoder, ProtobufDecoder
from split_cli.logs.readers.payloads import PayloadDecoder
from split_cli.logs.readers.serialized import SerializedDecoder

__all__ = ["Container", "MessageBatch", "MessageRecording", "Stream"]

_FLUSH_BYTES = 32 << 20
_SCHEMAS_OF_ENCODING = {"cdr": ("ros2msg", "ros2idl", "omgidl"), "ros1": ("ros1msg",)}


@dataclass(frozen=True)
class Stream:
    """Messages of one type on one topic.

    Attributes
    ----------
    key : int
        The container's own number for it.
    topic, type_name : str
    encoding : str
        Of the messages: ``cdr``, ``ros1``, ``protobuf``, ``json``.
    schema_encoding : str
        Of the definition: ``ros2msg``, ``ros2idl``, ``ros1msg``, ``protobuf``, ``jsonschema``.
    schema : bytes
        The definition stored in the recording; may be empty.
    count : int or None
        Messages, where the container says so.
    """

    key: int
    topic: str
    type_name: str
    encoding: str
    schema_encoding: str
    schema: bytes
    count: int | None


@dataclass(frozen=True)
class MessageBatch:
    """Consecutive messages of one stream, with their log and publish times [ns]."""

    key: int
    log_times: list[int]
    publish_times: list[int]
    payloads: list[bytes]


class Container(Protocol):
    """A file, or several in a row, that holds messages.

    Attributes
    ----------
    streams : list of Stream
    origin : int
        First log time [ns].
    has_publish_times : bool
    notes : list of ReadNote
    """

    streams: list[Stream]
    origin: int
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
        self._decoders: dict[int, PayloadDecoder] = {}
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
                    note_once(self.notes, ReadNote(f"not readable: {error}", topic))
            if not seen:
                listed.append(RawChannelInfo(topic, streams[0].type_name, total))
            listed += [RawChannelInfo(f"{topic}/{path}", kind, total) for path, kind in seen.items()]
        return listed

    def read(self, names: Sequence[str], clock: Clock | None = None) -> dict[str, RawSignal]:
        """Return the named signals in order of log time; see `Recording.read`."""
        if clock is None:
            clock = self.clocks[0]
        if clock not in self.clocks:
            raise LogError(
                f"has no {clock} time", where=self.name, advice=f"Choose one of: {', '.join(self.clocks)}."
            )
        wanted: dict[str, list[str]] = defaultdict(list)
        for name in dict.fromkeys(names):
            topic, path = self._split(name)
            wanted[topic].append(path)
        parts = self._decode({topic: tuple(paths) for topic, paths in wanted.items()})
        signals: dict[str, RawSignal] = {}
        for topic, paths in wanted.items():
            time, values = self._assemble(topic, parts[topic], len(paths), clock)
            for column, path in enumerate(paths):
                name = f"{topic}/{path}"
                signals[name] = RawSignal(name, time, np.ascontiguousarray(values[:, column]))
        return {name: signals[name] for name in names}

    def _split(self, name: str) -> tuple[str, str]:
        """Return topic and field of a name that exists, or raise."""
        candidates = [topic for topic in self._topics if name == topic or name.startswith(topic + "/")]
        if not candidates:
            raise LogError(
                f"no topic of {name!r}", where=self.name, advice=_nearest_topics(name, list(self._topics))
            )
        topic = max(candidates, key=len)
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
            raise LogError(
                f"topic {topic} ({self._topics[topic][0].type_name}) has no numeric field {path!r}",
                where=self.name,
                advice=nearest_names(path, fields),
            )
        return topic, path

    def _decode(self, wanted: dict[str, tuple[str, ...]]) -> dict[str, list[_Part]]:
        by_key = {stream.key: stream for topic in wanted for stream in self._topics[topic]}
        parts: dict[str, list[_Part]] = {topic: [] for topic in wanted}
        pending: dict[int, list[MessageBatch]] = defaultdict(list)
        waiting = 0
        for batch in self._container.batches(frozenset(by_key)):
            pending[batch.key].append(batch)
            waiting += sum(map(len, batch.payloads))
            if waiting > _FLUSH_BYTES:
                self._flush(pending, by_key, wanted, parts)
                waiting = 0
        self._flush(pending, by_key, wanted, parts)
        return parts

    def _flush(
        self,
        pending: dict[int, list[MessageBatch]],
        by_key: dict[int, Stream],
        wanted: dict[str, tuple[str, ...]],
        parts: dict[str, list[_Part]],
    ) -> None:
        for key, batches in pending.items():
            stream = by_key[key]
            payloads = [payload for batch in batches for payload in batch.payloads]
            log = np.array([time for batch in batches for time in batch.log_times], dtype=np.uint64)
            publish = np.array([time for batch in batches for time in batch.publish_times], dtype=np.uint64)
            try:
                columns = self._decoder(stream).decode(payloads, wanted[stream.topic])
            except LogError as error:
                note_once(self.notes, ReadNote(f"not readable: {error}", stream.topic, len(payloads)))
                continue
            parts[stream.topic].append(_Part(log, publish, columns.stamps, columns.values, columns.readable))
        pending.clear()

    def _assemble(self, topic: str, parts: list[_Part], width: int, clock: Clock) -> tuple[np.ndarray, np.ndarray]:
        """Return time (N,) and values (N, P) of a topic, without the messages that could not be decoded."""
        if not parts:
            return np.empty(0), np.empty((0, width))
        readable = np.concatenate([part.readable for part in parts])
        lost = int(len(readable) - readable.sum())
        if lost:
            note_once(self.notes, ReadNote("messages that do not fit their definition, left out", topic, lost))
        if lost == len(readable):
            raise LogError(
                f"none of the {lost} messages of topic {topic} fits the definition of "
                f"{self._topics[topic][0].type_name}",
                where=self.name,
                advice="The definition is of another version, or the payloads are damaged. Give the right .msg "
                "files with --msg-path.",
            )
        log = np.concatenate([part.log for part in parts])[readable]
        values = np.concatenate([part.values for part in parts])[readable]
        times = log
        if clock == "publish" and self._container.has_publish_times:
            times = np.concatenate([part.publish for part in parts])[readable]
        if clock == "header":
            times = self._header_times(topic, parts, readable, log)
        order = np.argsort(log, kind="stable")
        # Wrapping subtraction of unsigned nanoseconds, read as signed, is exact over 292 years.
        since = (times.astype(np.uint64) - np.uint64(self._container.origin)).view(np.int64)
        return since[order] * 1e-9, values[order]

    def _header_times(self, topic: str, parts: list[_Part], readable: np.ndarray, log: np.ndarray) -> np.ndarray:
        if any(part.stamps is None for part in parts):
            note_once(
                self.notes,
                ReadNote("messages without a time stamp of their own: log time used", topic, len(log)),
            )
            return log
        stamps = np.concatenate([part.stamps for part in parts if part.stamps is not None])[readable]
        if not stamps.any():
            note_once(
                self.notes, ReadNote("time stamps that were never set (zero): log time used", topic, len(log))
            )
            return log
        return stamps

    def _decoder(self, stream: Stream) -> PayloadDecoder:
        if stream.key not in self._decoders:
            self._decoders[stream.key] = self._make_decoder(stream)
        return self._decoders[stream.key]

    def _make_decoder(self, stream: Stream) -> PayloadDecoder:
        expected = _SCHEMAS_OF_ENCODING.get(stream.encoding)
        if expected is not None:
            encoding = stream.schema_encoding if stream.schema else expected[0]
            if encoding not in expected:
                raise LogError(f"{stream.encoding} messages with a {stream.schema_encoding!r} definition")
            layout = self._definitions.layout(stream.type_name, encoding, stream.schema)
            return SerializedDecoder(layout, cdr=stream.encoding == "cdr")
        if stream.encoding == "protobuf" and stream.schema_encoding == "protobuf":
            return ProtobufDecoder(stream.type_name, stream.schema)
        if stream.encoding == "json":
            decoder = JsonDecoder(stream.schema, self._first_payload(stream.key), self._container.origin)
            if decoder.assumption:
                note_once(self.notes, ReadNote(decoder.assumption, stream.topic))
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


@dataclass(frozen=True)
class _Part:
    """A decoded run of messages of a topic; times in ns."""

    log: np.ndarray
    publish: np.ndarray
    stamps: np.ndarray | None
    values: np.ndarray
    readable: np.ndarray


def _nearest_topics(name: str, topics: Sequence[str]) -> str:
    """Return suggestions for the topic part of `name`, whose own length is not known."""
    pieces = name.split("/")
    openings = ["/".join(pieces[:count]) for count in range(len(pieces), 0, -1)]
    for opening in openings:
        advice = nearest_names(opening, topics) if opening else ""
        if advice.startswith("Did you mean"):
            return advice
    return nearest_names(name, topics)
