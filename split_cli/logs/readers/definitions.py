"""Message definitions (ROS 1 and ROS 2 ``.msg``, ROS 2 ``.idl``) as trees of fields."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from split_cli.errors import LogError, nearest_names, reason_of
from split_cli.files import read_text
from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS

SEQUENCE = -1
FILLER = "structure_needs_at_least_one_member"
"""What ROS 2 calls the one byte that it puts into a message without fields."""
_LISTED_ELEMENTS = 64
_DEEPEST = 24
MOST_TEXT = 2 << 20
"""Of all definitions of a recording [bytes], 4 s of parsing a megabyte; judgement: 300 types have 1 MB."""
_RULE = "=" * 80


@dataclass(frozen=True)
class Field:
    """One field of a message."""

    name: str
    kind: str  # ``float64``, ``int8`` and so on, ``bool``, ``string``, ``wstring``, or ``struct``
    fields: tuple[Field, ...] = ()  # the members of a struct; empty otherwise
    length: int | None = None  # None for one value, the length of a fixed array, or `SEQUENCE`


@dataclass(frozen=True)
class Layout:
    """The definition of one message type."""

    type_name: str
    fields: tuple[Field, ...]
    # Whether it came from inside the recording; a definition from elsewhere may be of another version, so that
    # payloads are checked against its full length.
    embedded: bool


class Definitions:
    """Finds the definition of a message type.

    Order: inside the recording, then the folders the user gave, then the common interfaces of ROS.

    Parameters
    ----------
    message_paths : sequence of path-like
        Folders searched recursively for ``package/msg/Type.msg`` or ``package/Type.msg``, or single files.
    """

    def __init__(self, message_paths: Sequence[str | Path] = ()) -> None:
        self._cache: dict[tuple[str, str, bytes], Layout] = {}
        self._given = _types_in_folders(message_paths)
        self._text = 0
        self._builtin: dict[bool, dict[str, Any]] = {}

    def layout(self, type_name: str, schema_encoding: str, schema: bytes) -> Layout:
        """Return the definition of `type_name`.

        Parameters
        ----------
        type_name : str
            ``package/Type`` or ``package/msg/Type``.
        schema_encoding : {"ros1msg", "ros2msg", "ros2idl", "omgidl"}
        schema : bytes
            The text stored in the recording; empty where it stores none.

        Raises
        ------
        LogError
            If the text cannot be parsed, no definition of the type is known, or the texts together are too long.
        """
        key = (type_name, schema_encoding, schema)
        if key not in self._cache:
            self._text += len(schema)
            if self._text > MOST_TEXT:
                what = f"the definitions of message types have more than {MOST_TEXT >> 20} MB together"
                raise LogError(what, advice="Leave its topic out of the recording.")
            self._cache[key] = self._find(type_name, schema_encoding, schema)
        return self._cache[key]

    def _find(self, type_name: str, schema_encoding: str, schema: bytes) -> Layout:
        wanted = _full_name(type_name)
        ros1 = schema_encoding == "ros1msg"
        inside: dict[str, Any] = {}
        try:
            inside = _parse(wanted, schema_encoding, schema) if schema.strip() else {}
        except LogError:
            # The advice in that error is to give the definition, so one that is given must do.
            if wanted not in self._given:
                raise
        if wanted in inside:
            try:
                return Layout(wanted, _bounded(wanted, inside, ros1), embedded=True)
            except LogError:
                # Some writers leave out the types every installation has (std_msgs/Header).
                pass
        known = {**self._builtin_types(ros1), **self._given, **inside}
        if wanted not in known:
            raise LogError(
                f"the recording holds no definition of message type {type_name!r}, and it is not a common one",
                advice="Give the folder of its .msg files with --msg-path, or convert the recording to MCAP "
                "where the types are installed. " + nearest_names(wanted, known),
            )
        return Layout(wanted, _bounded(wanted, known, ros1), embedded=False)

    def _builtin_types(self, ros1: bool) -> dict[str, Any]:
        if ros1 not in self._builtin:
            from rosbags.typesys import Stores, get_typestore

            store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
            self._builtin[ros1] = dict(store.fielddefs)
        return self._builtin[ros1]


def _endless(type_name: str) -> LogError:
    what = f"the definition of {type_name!r} contains itself or is nested over {_DEEPEST} deep"
    return LogError(what, advice="Leave its topic out of the recording, or give its .msg file with --msg-path.")


def leaf_paths(fields: Sequence[Field], prefix: str = "") -> Iterator[str]:
    """Yield the addresses of all numeric values: ``pose.position.x``, ``covariance[0]``.

    Sequences, whose length only a message tells, and arrays of over 64 elements are represented by their
    first element.
    """
    for field in fields:
        base = prefix + field.name
        if field.length is None:
            names = [base]
        else:
            listed = field.length if 0 <= field.length <= _LISTED_ELEMENTS else 1
            names = [f"{base}[{index}]" for index in range(listed)]
        for name in names:
            if field.kind == "struct":
                yield from leaf_paths(field.fields, name + ".")
            elif field.kind not in ("string", "wstring"):
                yield name


def _full_name(name: str) -> str:
    package, _, short = name.rpartition("/")
    if not package or package.endswith(("/msg", "/srv", "/action")):
        return name.replace("::", "/")
    return f"{package}/msg/{short}"


def _parse(type_name: str, schema_encoding: str, schema: bytes) -> dict[str, Any]:
    from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

    try:
        text = schema.decode("utf-8").replace("\r\n", "\n")
        if schema_encoding in ("ros1msg", "ros2msg"):
            # Writers differ in the length of the rule between definitions; the parser insists on 80.
            text = re.sub(r"^={20,}[ \t]*$", _RULE, text, flags=re.MULTILINE)
            return get_types_from_msg(text, type_name)
        known: dict[str, Any] = {}
        parts = re.split(r"^={20,}[ \t]*\n(?:IDL: \S+[ \t]*\n)?", text, flags=re.MULTILINE)
        for part in parts:
            if part.strip():
                known.update(get_types_from_idl(re.sub(r"^IDL: \S+[ \t]*\n", "", part)))
        return known
    except (TypesysError, AssertionError, ValueError, KeyError, IndexError, RecursionError) as error:
        raise LogError(
            f"the definition of {type_name!r} stored in the recording ({schema_encoding}) cannot be parsed: "
            f"{reason_of(error)}",
            advice="Record with ros2msg definitions, or give the type's .msg file with --msg-path.",
        ) from error


def _bounded(type_name: str, known: dict[str, Any], ros1: bool) -> tuple[Field, ...]:
    """Return the fields of a type whose numbers are few enough to be listed.

    Two fields a level are sixteen million after 24 levels, and so are arrays of arrays; they are counted type by
    type, each once, before anything is expanded.
    """
    _count_leaves(type_name, known, {}, set())
    return _expand(type_name, known, ros1, 0)


def _count_leaves(type_name: str, known: dict[str, Any], counted: dict[str, int], above: set[str]) -> int:
    from rosbags.interfaces import Nodetype

    if type_name in counted:
        return counted[type_name]
    if type_name in above or len(above) > _DEEPEST:
        raise _endless(type_name)
    total = 0
    for name, (node, content) in known[type_name][1]:
        if len(name) > LONGEST_NAME:
            what = f"a field of {type_name[:LONGEST_NAME]!r} has a name of {len(name):,} characters"
            raise LogError(what, advice="Leave its topic out of the recording.")
        times = 1
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            times = content[1] if node == Nodetype.ARRAY and content[1] <= _LISTED_ELEMENTS else 1
            node, content = content[0]
        nested = str(content) if node == Nodetype.NAME else ""
        inside = _count_leaves(nested, known, counted, above | {type_name}) if nested in known else 1
        total += times * max(inside, 1)
        if total > MOST_FIELDS:
            advice = "Leave its topic out of the recording."
            raise LogError(f"the definition of {type_name!r} has more than {MOST_FIELDS:,} numbers", advice=advice)
    counted[type_name] = total
    return total


def _expand(type_name: str, known: dict[str, Any], ros1: bool, depth: int) -> tuple[Field, ...]:
    if type_name in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
        first = "uint32" if ros1 and type_name.endswith("Time") else "int32"
        second = "int32" if ros1 and type_name.endswith("Duration") else "uint32"
        return Field("sec", first), Field("nanosec", second)
    if depth > _DEEPEST:
        raise _endless(type_name)
    fields = tuple(_field(name, described, known, ros1, depth) for name, described in known[type_name][1])
    if not fields and not ros1:
        return (Field(FILLER, "uint8"),)
    return fields


def _field(name: str, described: Any, known: dict[str, Any], ros1: bool, depth: int) -> Field:
    from rosbags.interfaces import Nodetype

    length: int | None = None
    node, content = described
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        length = content[1] if node == Nodetype.ARRAY else SEQUENCE
        node, content = content[0]
    if node == Nodetype.BASE:
        kind = {"byte": "int8" if ros1 else "uint8", "char": "uint8"}.get(content[0], content[0])
        return Field(name, kind, length=length)
    nested = str(content)
    if nested not in known:
        if nested.endswith("/wstring"):
            return Field(name, "wstring", length=length)
        what = f"the definition of message type {nested!r}, used by field {name!r}, is missing"
        raise LogError(what, advice="Give the folder of its .msg files with --msg-path.")
    return Field(name, "struct", _expand(nested, known, ros1, depth + 1), length)


def _types_in_folders(paths: Sequence[str | Path]) -> dict[str, Any]:
    known: dict[str, Any] = {}
    for path in map(Path, paths):
        if not path.exists():
            what = "the folder of message definitions does not exist"
            raise LogError(what, where=str(path), advice="Give --msg-path the folder above msg/.")
        files = sorted(path.rglob("*.msg")) if path.is_dir() else [path]
        if not files:
            what = "there are no .msg files in this folder"
            raise LogError(what, where=str(path), advice="Give --msg-path the folder above msg/.")
        for file in files:
            parts = file.parent.parts
            package = parts[-2] if len(parts) > 1 and parts[-1] == "msg" else parts[-1] if parts else ""
            try:
                text = read_text(file, MOST_TEXT, LogError).encode()
                known.update(_parse(f"{package}/msg/{file.stem}", "ros2msg", text))
            except (LogError, OSError, ValueError) as error:
                advice = "Mend it, or leave it out of the folder."
                raise LogError("is no message definition of ROS", where=str(file), advice=advice) from error
    return known
