"""Decoding of protobuf and JSON payloads, message by message."""

import itertools
import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS
from split_cli.logs.readers.payloads import STAMP_FIELDS, Columns

_DEEPEST = 12
_LATEST_STAMP = 2**63  # of any unit [1]: nanoseconds have 64 bits with their sign
_LISTED_ELEMENTS = 64
_SECOND_NAMES = ("sec", "secs", "seconds")
_NANOSECOND_NAMES = ("nsec", "nsecs", "nanosec", "nanos", "nanoseconds")
_STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")
_NUMBERS = (bool, int, float)


def _steps(path: str) -> list[str | int]:
    return [name if name else int(index) for name, index in _STEP.findall(path)]


def _collect(
    payloads: Sequence[bytes],
    width: int,
    parse: Callable[[bytes], Any],
    getters: list[Callable[[Any], float]],
    stamp: Callable[[Any], int] | None,
    failures: tuple[type[Exception], ...],
) -> Columns:
    values = np.full((len(payloads), width), np.nan)
    stamps = np.zeros(len(payloads), dtype=np.int64) if stamp else None
    readable = np.zeros(len(payloads), dtype=bool)
    for row, payload in enumerate(payloads):
        try:
            message = parse(payload)
            values[row] = [getter(message) for getter in getters]
            if stamp is not None and stamps is not None:
                stamps[row] = stamp(message)
        except failures:
            values[row] = np.nan
            continue
        readable[row] = True
    return Columns(values, stamps, readable)


def _lengths(message: Any, paths: Sequence[str], inside: Callable[[Any, str], Any]) -> dict[str, int]:
    """Return how many elements the arrays of addresses have in one message; `inside` returns a field by its name."""
    found: dict[str, int] = {}
    for path in paths:
        value, address = message, ""
        for step in _steps(path):
            if isinstance(step, str):
                value = inside(value, step)
                address += f".{step}" if address else step
                continue
            found[address] = len(value) if isinstance(value, Sequence) and not isinstance(value, str) else 0
            value = value[step] if step < found[address] else None
            address += f"[{step}]"
    return found


def _time_fields(name: str, is_known: Callable[[str], bool]) -> tuple[str, str] | None:
    """Return the fields of a time stamp that hold seconds and nanoseconds; None where it has no such two."""
    pairs = ((f"{name}.{s}", f"{name}.{n}") for s in _SECOND_NAMES for n in _NANOSECOND_NAMES)
    return next((pair for pair in pairs if all(map(is_known, pair))), None)


class ProtobufDecoder:
    """Decodes one protobuf message type from the descriptors inside the recording.

    A submessage or optional field that a message leaves out reads as NaN; a plain proto3 number that was left
    out is zero, as that format defines.

    Parameters
    ----------
    type_name : str
        Full name of the message.
    schema : bytes
        Serialized ``FileDescriptorSet``.
    """

    def __init__(self, type_name: str, schema: bytes) -> None:
        from google.protobuf.message import DecodeError
        from mcap.records import Schema
        from mcap_protobuf.decoder import DecoderFactory

        try:
            record = Schema(id=1, data=schema, encoding="protobuf", name=type_name)
            parse = DecoderFactory().decoder_for("protobuf", record)
            self._descriptor = parse(b"").DESCRIPTOR
        except Exception as error:  # the descriptor pool raises whatever it likes at damaged descriptors
            problem = f"the protobuf descriptor of {type_name!r} cannot be used ({error})"
            raise LogError(problem, advice="Record it again with its descriptor, or as json messages.") from error
        self._parse = parse
        self._failures = (DecodeError, OverflowError, ValueError)
        self._paths = _listed(_protobuf_paths(self._descriptor, "", frozenset()))
        self.stamp = next((name for name in STAMP_FIELDS if _time_fields(name, self.has) is not None), None)

    def paths(self) -> list[str]:
        """Return the addresses of the numeric fields; see `PayloadDecoder.paths`."""
        return self._paths

    def has(self, path: str) -> bool:
        """Tell whether `path` addresses a numeric field; see `PayloadDecoder.has`."""
        return self._resolve(path) is not None

    def lengths(self, payload: bytes) -> dict[str, int]:
        """Return how many elements the arrays of one message have; see `PayloadDecoder.lengths`."""
        try:
            message = self._parse(payload)
        except self._failures:
            return {}
        return _lengths(message, self._paths, lambda value, name: getattr(value, name, None))

    def decode(self, payloads: Sequence[bytes], paths: Sequence[str]) -> Columns:
        """Decode many payloads; see `PayloadDecoder.decode`."""
        getters = [self._getter(path) for path in paths]
        stamp = self._stamp_getter() if self.stamp else None
        return _collect(payloads, len(paths), self._parse, getters, stamp, self._failures)

    def _resolve(self, path: str) -> list[tuple[Any, int | None]] | None:
        """Return (field descriptor, index) of each step of a path to a number, or None."""
        found: list[tuple[Any, int | None]] = []
        descriptor = self._descriptor
        for step in _steps(path):
            if isinstance(step, int):
                if not found or not _is_repeated(found[-1][0]) or found[-1][1] is not None:
                    return None
                found[-1] = (found[-1][0], step)
                continue
            field = descriptor.fields_by_name.get(step) if descriptor is not None else None
            if field is None:
                return None
            found.append((field, None))
            descriptor = field.message_type
        complete = found and all((index is not None) == _is_repeated(field) for field, index in found)
        return found if complete and _is_number(found[-1][0]) else None

    def _getter(self, path: str) -> Callable[[Any], float]:
        steps = self._resolve(path)
        if steps is None:
            return lambda message: math.nan
        plan = [(field.name, index, index is None and field.has_presence) for field, index in steps]

        def get(message: Any) -> float:
            for name, index, may_be_absent in plan:
                if may_be_absent and not message.HasField(name):
                    return math.nan
                message = getattr(message, name)
                if index is not None:
                    if index >= len(message):
                        return math.nan
                    message = message[index]
            return message

        return get

    def _stamp_getter(self) -> Callable[[Any], int]:
        names = _time_fields(self.stamp or "", self.has)
        seconds, nanoseconds = (self._getter(name) for name in names or ())

        def stamp(message: Any) -> int:
            whole = seconds(message)
            return 0 if whole != whole else int(whole) * 1_000_000_000 + int(nanoseconds(message))

        return stamp


def _is_repeated(field: Any) -> bool:
    return bool(field.is_repeated)


def _is_number(field: Any) -> bool:
    return field.cpp_type not in (field.CPPTYPE_STRING, field.CPPTYPE_MESSAGE)


def _listed(paths: Iterator[str | None]) -> list[str]:
    """Return the addresses, if they and the messages around them (None) are few enough to be listed."""
    found = list(itertools.islice(paths, MOST_FIELDS + 1))
    if len(found) > MOST_FIELDS:
        advice = "Leave its topic out of the recording."
        raise LogError(f"a message type has more than {MOST_FIELDS:,} fields", advice=advice)
    return [path for path in found if path is not None]


def _protobuf_paths(descriptor: Any, prefix: str, above: frozenset[str]) -> Iterator[str | None]:
    """Yield the addresses of numbers, None for a message; a type inside itself is not followed."""
    if len(above) > _DEEPEST or len(prefix) > LONGEST_NAME:
        return
    above |= {descriptor.full_name}
    for field in descriptor.fields:
        name = f"{prefix}{field.name}" + ("[0]" if _is_repeated(field) else "")
        if field.message_type is not None:
            recursive = field.message_type.full_name in above or field.message_type.GetOptions().map_entry
            if not recursive:
                yield None
                yield from _protobuf_paths(field.message_type, name + ".", above)
        elif _is_number(field):
            yield name


class JsonDecoder:
    """Decodes JSON messages; the fields are those of the schema and of the first message.

    A time stamp that is one number is taken to be in the unit (s, ms, us, ns) that brings the first message
    nearest to its log time.

    Parameters
    ----------
    schema : bytes
        JSON schema; may be empty.
    first : bytes
        The first message.
    origin : int
        First log time of the recording [ns].

    Attributes
    ----------
    assumption : str or None
        What was taken for granted about the time stamp.
    """

    def __init__(self, schema: bytes, first: bytes, origin: int) -> None:
        try:
            described = json.loads(schema) if schema.strip() else {}
        except (ValueError, RecursionError):
            described = {}
        try:
            example = json.loads(first)
        except (ValueError, RecursionError):
            example = {}
        paths = _listed(itertools.chain(_schema_paths(described, "", 0), _value_paths(example, "", 0)))
        self._paths = list(dict.fromkeys(paths))
        self._known = {_without_indices(path) for path in self._paths}
        self._lengths = _lengths(example, self._paths, lambda value, name: _member(value, name))
        self._origin = origin
        self._unit = 0
        self.assumption: str | None = None
        self.stamp = next((name for name in STAMP_FIELDS if self._stamp_getter(name, example)), None)

    def paths(self) -> list[str]:
        """Return the addresses of the numeric fields; see `PayloadDecoder.paths`."""
        return self._paths

    def has(self, path: str) -> bool:
        """Tell whether `path` addresses a numeric field; see `PayloadDecoder.has`."""
        return bool(path) and _without_indices(path) in self._known

    def lengths(self, payload: bytes) -> dict[str, int]:
        """Return how many elements the arrays of the first message have; see `PayloadDecoder.lengths`."""
        return self._lengths

    def decode(self, payloads: Sequence[bytes], paths: Sequence[str]) -> Columns:
        """Decode many payloads; see `PayloadDecoder.decode`."""
        getters = [_json_getter(path) for path in paths]
        stamp = self._stamp_getter(self.stamp, None) if self.stamp else None
        failures = (ValueError, TypeError, AttributeError, OverflowError, RecursionError)
        return _collect(payloads, len(paths), _json_message, getters, stamp, failures)

    def _stamp_getter(self, name: str, example: Any) -> Callable[[Any], int] | None:
        pair = _time_fields(name, self._known.__contains__)
        if pair is not None:
            whole, rest = map(_json_getter, pair)
            return lambda message: int(whole(message)) * 1_000_000_000 + int(rest(message))
        if name not in self._known:
            return None
        number = _json_number(name)
        if example is not None:
            value = number(example)
            if value is None or abs(value) > _LATEST_STAMP:
                return None
            units = {1_000_000_000: "s", 1_000_000: "ms", 1_000: "us", 1: "ns"}
            self._unit = min(units, key=lambda unit: abs(float(value) * unit - self._origin))
            self.assumption = f"{name} has no unit, taken to be in {units[self._unit]}"
        unit = self._unit

        def stamp(message: Any) -> int:
            value = number(message)
            if value is None:
                raise ValueError(name)
            return value * unit if isinstance(value, int) else round(value * unit)

        return stamp


def _json_message(payload: bytes) -> Any:
    message = json.loads(payload)
    if not isinstance(message, dict):
        raise ValueError("not an object")
    return message


def _json_number(path: str) -> Callable[[Any], Any]:
    steps = _steps(path)

    def get(value: Any) -> Any:
        for step in steps:
            if isinstance(step, int):
                if not isinstance(value, list) or step >= len(value):
                    return None
                value = value[step]
            elif not isinstance(value, dict) or step not in value:
                return None
            else:
                value = value[step]
        return value if isinstance(value, _NUMBERS) else None

    return get


def _member(value: Any, name: str) -> Any:
    return value.get(name) if isinstance(value, dict) else None


def _json_getter(path: str) -> Callable[[Any], float]:
    number = _json_number(path)

    def get(message: Any) -> float:
        value = number(message)
        return math.nan if value is None else float(value)

    return get


def _without_indices(path: str) -> str:
    return re.sub(r"\[\d+\]", "[]", path)


def _value_paths(value: Any, prefix: str, depth: int) -> Iterator[str]:
    if depth > _DEEPEST or len(prefix) > LONGEST_NAME:
        return
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _value_paths(item, f"{prefix}.{key}" if prefix else str(key), depth + 1)
    elif isinstance(value, list) and prefix:
        for index, item in enumerate(value[:_LISTED_ELEMENTS]):
            yield from _value_paths(item, f"{prefix}[{index}]", depth + 1)
    elif isinstance(value, _NUMBERS) and prefix:
        yield prefix


def _schema_paths(schema: Any, prefix: str, depth: int) -> Iterator[str]:
    if depth > _DEEPEST or len(prefix) > LONGEST_NAME or not isinstance(schema, dict):
        return
    kinds = schema.get("type")
    kinds = kinds if isinstance(kinds, list) else [kinds]
    properties = schema.get("properties")
    if isinstance(properties, dict):
        for key, item in properties.items():
            yield from _schema_paths(item, f"{prefix}.{key}" if prefix else str(key), depth + 1)
    elif "array" in kinds and prefix:
        yield from _schema_paths(schema.get("items"), f"{prefix}[0]", depth + 1)
    elif prefix and not {"number", "integer", "boolean"}.isdisjoint(k for k in kinds if isinstance(k, str)):
        yield prefix
