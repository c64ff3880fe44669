"""PX4's ULog: definitions of messages, then messages of many topics, each stamped in microseconds."""

from __future__ import annotations

import mmap
import re
import struct
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS, refuse_many_columns
from split_cli.logs.raw import LazyTableRecording, RawChannelInfo, RawRecording, RawSignal, ReadNote

MAGIC = b"ULog\x01\x12\x35"
_HEAD, _MESSAGE_HEAD = 16, struct.Struct("<HB")
_SYNCHRONISATION = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))
_KNOWN = frozenset(b"BFIMPQARDLCSO")
_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4",
    "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8", "bool": "u1", "char": "S1",
}  # fmt: skip
_FIELD = re.compile(r"(\w+)(?:\[(\d{1,6})\])? (\w+)")
_MOST_APPENDED = 3
_DEEPEST = 8
"""Messages inside one another [1]; judgement: those of PX4 hold one."""


class _Topic:
    """What was logged of one topic: where its messages stand and how they are laid out."""

    def __init__(self, layout: np.dtype) -> None:
        self.layout = layout  # names are addresses within the message; what pads its end is left out
        self.places = array("q")  # of each message's content in the file [bytes]


def open_ulog(path: Path) -> RawRecording:
    """Open a log; a field is addressed as ``/vehicle_attitude/q[0]``, of a second instance ``/gps_1/vel_m_s``.

    Raises
    ------
    LogError
        If its definitions are damaged, or no topic has messages.
    """
    notes: list[ReadNote] = []
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        topics = _index(data, path, notes)
    topics = {name: topic for name, topic in topics.items() if len(topic.places) > 1}
    if not topics:
        raise LogError("holds no topic with messages", where=path.name, advice="Record it again, armed.")
    refuse_many_columns(sum(len(topic.layout.names or ()) for topic in topics.values()), path.name)
    origin = min(_values(path, topic, "timestamp")[0] for topic in topics.values()) * 1e-6

    def load(names: Sequence[str]) -> dict[str, RawSignal]:
        made = {}
        for name in names:
            topic, field = name[1:].split("/", 1)
            time = _values(path, topics[topic], "timestamp") * 1e-6 - origin
            made[name] = RawSignal(name, time, _values(path, topics[topic], field).astype(float))
        return made

    infos = [
        RawChannelInfo(f"/{name}/{field}", name, len(topic.places))
        for name, topic in topics.items()
        for field in topic.layout.names or ()
        if field != "timestamp" and "_padding" not in field and topic.layout[field].kind != "S"
    ]
    return LazyTableRecording(path.name, path, infos, load, origin=float(origin), notes=notes)


def _values(path: Path, topic: _Topic, field: str) -> np.ndarray:
    """Return a field of all messages of a topic, as stored, shape (N,)."""
    data = np.memmap(path, np.uint8, "r")
    kind, offset = topic.layout.fields[field][:2]  # type: ignore[index]
    places = np.frombuffer(topic.places, np.int64)[:, None] + offset + np.arange(kind.itemsize)
    return data[places].view(kind)[:, 0]


def _index(data: mmap.mmap, path: Path, notes: list[ReadNote]) -> dict[str, _Topic]:
    """Find the messages of all topics; losses that the log states, and damaged stretches, are counted."""
    formats: dict[str, str] = {}
    topics: dict[str, _Topic] = {}
    layouts: dict[str, np.dtype | None] = {}
    numbered: dict[int, _Topic] = {}
    lost = damaged = undefined = fields = 0
    appended: list[int] = []

    def subscribed(instance: int, name: str) -> _Topic | None:
        """Return the topic that a subscription names, made if it is new; None if its definition is damaged."""
        nonlocal fields
        called = f"{name}_{instance}" if instance else name
        if called not in topics:
            if name not in layouts:
                layouts[name] = _layout(name, formats)
            layout = layouts[name]
            if layout is None:
                return None
            fields += len(layout.names or ())
            refuse_many_columns(fields, path.name)  # before a short file lists a long message many times
            topics[called] = _Topic(layout)
        return topics[called]

    at = _HEAD
    while at + _MESSAGE_HEAD.size <= len(data):
        size, kind = _MESSAGE_HEAD.unpack_from(data, at)
        begin, end = at + _MESSAGE_HEAD.size, at + _MESSAGE_HEAD.size + size
        if appended and end > appended[0]:
            at = appended.pop(0)  # the power cut the message short: what was appended begins there
            continue
        if kind not in _KNOWN or end > len(data):
            damaged += 1
            found = data.find(_SYNCHRONISATION, begin)
            if found < 0:
                break
            at = found + len(_SYNCHRONISATION)
            continue
        if kind == ord("D") and size > 2:
            topic = numbered.get(data[begin] | data[begin + 1] << 8)
            if topic is not None and size - 2 >= topic.layout.itemsize:
                topic.places.append(begin + 2)
            else:
                damaged += 1
        elif kind == ord("F"):
            name, _, content = data[begin:end].decode("utf-8", "replace").partition(":")
            formats[name] = content
        elif kind == ord("A") and size > 3:
            topic = subscribed(data[begin], data[begin + 3 : end].decode("utf-8", "replace"))
            if topic is None:
                undefined += 1
            else:
                numbered[data[begin + 1] | data[begin + 2] << 8] = topic
        elif kind == ord("O"):
            lost += 1
        elif kind == ord("B") and size >= 40 and data[begin + 8] & 1:
            places = struct.unpack_from(f"<{_MOST_APPENDED}Q", data, begin + 16)
            appended = [place for place in sorted(places) if end <= place < len(data)]
        at = end
    losses = (
        (lost, "dropouts that the log states"),
        (undefined, "topics without a sound definition, left out"),
        (damaged, "messages that are damaged, or of no topic that is known, left out"),
    )
    for count, what in losses:
        if count:
            notes.append(ReadNote(what, path.name, count))
    return topics


def _layout(name: str, formats: dict[str, str]) -> np.dtype | None:
    """Return where the numbers of a message stand, by address; None where its definition is damaged."""
    try:
        fields = list(_fields(name, formats, "", 0, [0]))
    except ValueError:
        return None
    while fields and "_padding" in fields[-1][0]:
        fields.pop()  # not written at the end of a message
    offsets = np.cumsum([0, *(np.dtype(kind).itemsize for _, kind in fields)])
    kept = {field: (kind, offset) for (field, kind), offset in zip(fields, offsets, strict=False)}
    if kept.get("timestamp", ("",))[0] != "<u8":
        return None
    return np.dtype({
        "names": list(kept), "formats": [kind for kind, _ in kept.values()],
        "offsets": [int(offset) for _, offset in kept.values()], "itemsize": int(offsets[-1]),
    })  # fmt: skip


def _fields(
    name: str, formats: dict[str, str], prefix: str, depth: int, counted: list[int]
) -> Iterator[tuple[str, str]]:
    """Yield address and type of every number of a message, with those of the messages inside it.

    Raises
    ------
    ValueError
        If a definition is missing or damaged, holds itself, or has more than `MOST_FIELDS`.
    """
    if name not in formats or depth > _DEEPEST:
        raise ValueError(name)
    for part in filter(None, formats[name].split(";")):
        match = _FIELD.fullmatch(part)
        if match is None:
            raise ValueError(part)
        kind, count, field = match[1], match[2], match[3]
        for index in range(int(count or 1)):
            address = f"{prefix}{field}" + (f"[{index}]" if count else "")
            counted[0] += 1
            if counted[0] > MOST_FIELDS or len(address) > LONGEST_NAME:
                raise ValueError(address)
            if kind in _TYPES:
                yield address, _TYPES[kind]
            else:
                yield from _fields(kind, formats, f"{address}.", depth + 1, counted)
