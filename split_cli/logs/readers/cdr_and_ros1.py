"""Decoding of ROS 1 and CDR payloads, thousands at a time.

A field's offset depends only on the lengths of the strings and lists before it. One message is walked to learn
the offsets of the wanted fields and where those lengths stand; every message of the same size with the same
lengths in the same places has the same offsets, and is read with array operations. Messages that differ are
walked in turn, so that the result never depends on how alike the messages are, only the speed does.
"""

from __future__ import annotations

import re
import struct
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from split_cli.logs.readers.definitions import SEQUENCE, Field, Layout, leaf_paths
from split_cli.logs.readers.payloads import STAMP_FIELDS, Columns

_SIZES = {
    "bool": 1,
    "int8": 1,
    "uint8": 1,
    "int16": 2,
    "uint16": 2,
    "int32": 4,
    "uint32": 4,
    "int64": 8,
    "uint64": 8,
    "float32": 4,
    "float64": 8,
}
_TYPE_CODES = {"bool": "u1", **{kind: f"{kind[0]}{size}" for kind, size in _SIZES.items() if kind != "bool"}}
_BATCH = 4096
_DIGITS_OF_AN_INDEX = 12  # no payload has as many elements
_LARGEST_PADDING = 7
# The second byte of a CDR payload: (little endian, largest alignment). Others carry member headers.
_ENCAPSULATIONS = {0: (False, 8), 1: (True, 8), 6: (False, 4), 7: (True, 4)}


class _UnreadableError(Exception):
    """A payload does not fit its definition."""


@dataclass(frozen=True)
class _Offsets:
    """Where the wanted fields of some messages are."""

    little: bool
    # Offsets of lengths, with the bytes that must stand there for the offsets below to hold.
    guards: tuple[tuple[int, bytes], ...]
    places: dict[str, tuple[int, str]]  # byte offset and kind of each wanted path that this message has


class SerializedDecoder:
    """Decodes the payloads of one ROS message type.

    Parameters
    ----------
    cdr : bool
        CDR (ROS 2) with an encapsulation header and alignment, or the packed format of ROS 1.
    """

    def __init__(self, layout: Layout, cdr: bool) -> None:
        self._layout = layout
        self._cdr = cdr
        self._paths = list(leaf_paths(layout.fields))
        self._listed = set(self._paths)
        self.stamp = next((s for s in STAMP_FIELDS if {f"{s}.sec", f"{s}.nanosec"} <= self._listed), None)
        self._known: dict[tuple[int, frozenset[str]], list[_Offsets]] = defaultdict(list)

    def paths(self) -> list[str]:
        """Return the addresses of the numeric fields; see `PayloadDecoder.paths`."""
        return self._paths

    def has(self, path: str) -> bool:
        """Tell whether `path` addresses a numeric field; see `PayloadDecoder.has`."""
        return path in self._listed or _exists(self._layout.fields, path)

    def lengths(self, payload: bytes) -> dict[str, int]:
        """Return how many elements the arrays of one message have; see `PayloadDecoder.lengths`."""
        try:
            walk = _Walk(payload, self._cdr, _Wanted.of(()), stop_early=False)
            walk.struct(self._layout.fields, "")
        except _UnreadableError:
            return {}
        return walk.lengths

    def decode(self, payloads: Sequence[bytes], paths: Sequence[str]) -> Columns:
        """Decode many payloads; see `PayloadDecoder.decode`."""
        wanted = list(paths)
        if self.stamp is not None:
            wanted += [f"{self.stamp}.sec", f"{self.stamp}.nanosec"]
        values = np.full((len(payloads), len(wanted)), np.nan)
        readable = np.zeros(len(payloads), dtype=bool)
        for start in range(0, len(payloads), _BATCH):
            by_size: dict[int, list[int]] = defaultdict(list)
            for row in range(start, min(start + _BATCH, len(payloads))):
                by_size[len(payloads[row])].append(row)
            for size, rows in by_size.items():
                self._decode_equal_sizes(payloads, np.array(rows), size, wanted, values, readable)
        if self.stamp is None:
            return Columns(values, None, readable)
        parts = np.where(readable[:, None], values[:, -2:], 0.0).astype(np.int64)
        return Columns(values[:, :-2], parts[:, 0] * 1_000_000_000 + parts[:, 1], readable)

    def _decode_equal_sizes(
        self,
        payloads: Sequence[bytes],
        rows: np.ndarray,
        size: int,
        wanted: list[str],
        values: np.ndarray,
        readable: np.ndarray,
    ) -> None:
        joined = payloads[rows[0]] if len(rows) == 1 else b"".join([payloads[row] for row in rows])
        octets = np.frombuffer(joined, dtype=np.uint8).reshape(len(rows), size)
        known = self._known[size, frozenset(wanted)]
        left = np.arange(len(rows))
        for offsets in known:
            left = self._apply(offsets, octets, left, rows, wanted, values, readable)
        compared = False
        while len(left):
            try:
                offsets = self._walk(octets[left[0]].tobytes(), _Wanted.of(tuple(wanted)))
            except _UnreadableError:
                # What equals it byte for byte fails too: a million empty messages are one. Compared once, so that
                # the work stays in proportion.
                left = left[1:] if compared else left[(octets[left] != octets[left[0]]).any(axis=1)]
                compared = True
                continue
            # Lists whose length changes with every message would make this cache grow without bound.
            if len(known) < 16:
                known.append(offsets)
            left = self._apply(offsets, octets, left, rows, wanted, values, readable)

    def _apply(
        self,
        offsets: _Offsets,
        octets: np.ndarray,
        left: np.ndarray,
        rows: np.ndarray,
        wanted: list[str],
        values: np.ndarray,
        readable: np.ndarray,
    ) -> np.ndarray:
        if not len(left):
            return left
        whole = len(left) == len(octets)
        fits = np.ones(len(left), dtype=bool)
        for offset, expected in offsets.guards:
            found = octets[:, offset : offset + len(expected)]
            fits &= ((found if whole else found[left]) == np.frombuffer(expected, np.uint8)).all(axis=1)
        chosen = left[fits]
        if len(chosen):
            readable[rows[chosen]] = True
            order = "<" if offsets.little else ">"
            for column, path in enumerate(wanted):
                if path not in offsets.places:
                    continue
                offset, kind = offsets.places[path]
                cells = octets[:, offset : offset + _SIZES[kind]]
                cells = np.ascontiguousarray(cells if len(chosen) == len(octets) else cells[chosen])
                numbers = cells.view(order + _TYPE_CODES[kind])[:, 0]
                values[rows[chosen], column] = numbers != 0 if kind == "bool" else numbers
        return left[~fits]

    def _walk(self, payload: bytes, wanted: _Wanted) -> _Offsets:
        # Without an early stop the whole definition is held against the payload.
        walk = _Walk(payload, self._cdr, wanted, stop_early=self._layout.embedded)
        walk.struct(self._layout.fields, "")
        if not self._layout.embedded and len(payload) - walk.offset > _LARGEST_PADDING:
            raise _UnreadableError
        return _Offsets(walk.little, tuple(walk.guards), walk.places)


@dataclass(frozen=True)
class _Wanted:
    """Addresses of numbers."""

    paths: frozenset[str]
    elements: dict[str, list[tuple[int, str]]]  # of each array: index and address of its elements that are wanted

    @staticmethod
    @lru_cache(maxsize=8)
    def of(paths: tuple[str, ...]) -> _Wanted:
        """Sort addresses by their arrays, once for many messages."""
        elements: dict[str, list[tuple[int, str]]] = defaultdict(list)
        for path in paths:
            array, _, index = path.removesuffix("]").rpartition("[")
            if path.endswith("]") and index.isdecimal() and len(index) < _DIGITS_OF_AN_INDEX:
                elements[array].append((int(index), path))
        return _Wanted(frozenset(paths), dict(elements))


class _Walk:
    """Walks one payload along its definition."""

    def __init__(self, payload: bytes, cdr: bool, wanted: _Wanted, stop_early: bool) -> None:
        self.payload = payload
        self.wanted = wanted.paths
        self.elements = wanted.elements
        self.stop_early = stop_early
        self.guards: list[tuple[int, bytes]] = []
        self.places: dict[str, tuple[int, str]] = {}
        self.lengths: dict[str, int] = {}
        self.done = False
        self.offset = 0
        self.little = True
        self.alignment = 1
        if cdr:
            if len(payload) < 4 or payload[0] != 0 or payload[1] not in _ENCAPSULATIONS:
                raise _UnreadableError
            self.little, self.alignment = _ENCAPSULATIONS[payload[1]]
            self.guards.append((0, payload[:2]))
            self.offset = 4
        self.base = self.offset

    def struct(self, fields: Sequence[Field], prefix: str) -> None:
        for field in fields:
            self._field(field, prefix + field.name)
            if self.done:
                return

    def _field(self, field: Field, path: str) -> None:
        count = field.length
        if count is None:
            return self._value(field, path)
        if count == SEQUENCE:
            count = self._length()
        self.lengths[path] = count
        if field.kind in _SIZES:
            return self._numbers(field.kind, path, count)
        # Nearly every struct and string takes a byte, so a corrupt length cannot start an endless loop.
        if count > len(self.payload) - self.offset and count > 1:
            raise _UnreadableError
        for index in range(count):
            before = self.offset
            self._value(field, f"{path}[{index}]")
            # A structure of nothing, as ROS 1 has it, would be walked a million times a million within others.
            if self.done or self.offset == before:
                return None
        return None

    def _value(self, field: Field, path: str) -> None:
        if field.kind == "struct":
            self.struct(field.fields, path + ".")
        elif field.kind == "string":
            self._skip(self._length())
        elif field.kind in _SIZES:
            self._skip_to_multiple(_SIZES[field.kind])
            self._place(path, self.offset, field.kind)
            self._skip(_SIZES[field.kind])
        else:
            # The width of a wide character depends on the middleware that wrote it.
            raise _UnreadableError

    def _numbers(self, kind: str, path: str, count: int) -> None:
        size = _SIZES[kind]
        if count:
            self._skip_to_multiple(size)
        start = self.offset
        self._skip(count * size)
        for index, name in self.elements.get(path, ()):
            if index < count:
                self._place(name, start + index * size, kind)

    def _place(self, path: str, offset: int, kind: str) -> None:
        if path in self.wanted:
            self.places[path] = (offset, kind)
            self.done = self.stop_early and len(self.places) == len(self.wanted)

    def _length(self) -> int:
        self._skip_to_multiple(4)
        start = self.offset
        self._skip(4)
        raw = self.payload[start : start + 4]
        self.guards.append((start, raw))
        return struct.unpack("<I" if self.little else ">I", raw)[0]

    def _skip_to_multiple(self, size: int) -> None:
        step = min(size, self.alignment)
        self.offset += -(self.offset - self.base) % step

    def _skip(self, count: int) -> None:
        self.offset += count
        if self.offset > len(self.payload):
            raise _UnreadableError


_STEP = re.compile(r"^(?P<name>[^\[\].]+)(?:\[(?P<index>\d+)\])?$")


def _exists(fields: Sequence[Field], path: str) -> bool:
    step, _, rest = path.partition(".")
    match = _STEP.match(step)
    field = next((f for f in fields if match and f.name == match["name"]), None)
    if match is None or field is None or (match["index"] is None) != (field.length is None):
        return False
    if field.length is not None and field.length != SEQUENCE and int(match["index"]) >= field.length:
        return False
    if field.kind == "struct":
        return bool(rest) and _exists(field.fields, rest)
    return not rest and field.kind in _SIZES
