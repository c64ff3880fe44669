"""Lines and blocks of text that hold objects by name: messages with their topic, brackets of games, printed messages.

``1718000000.1 car/imu {"ax": 0.1}`` as MQTT clients print it, ``(speedX 80.1)(steer 0.02)`` of TORCS and SCRC, and
messages of Protocol Buffers in text (``pose { position { x: 1 } }``) as Gazebo and Apollo print them.
"""

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from split_cli.logs.raw import RawRecording, ReadNote, note_once
from split_cli.logs.readers.cells import number_of
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.dialect import LONGEST_LINE
from split_cli.logs.readers.json_document import parsed
from split_cli.logs.readers.json_rows import table_of_rows
from split_cli.logs.readers.json_topics import rows_by_topic

_TOPIC = re.compile(
    r"(?:(?P<time>\S+(?:[ T]\d\d:\S+)?)[ \t]+)?(?P<topic>[\w/.:-]*[A-Za-z][\w/.:-]*)[ \t]+(?P<object>\{.*\})\s*"
)
_BRACKETS = re.compile(r"\(([A-Za-z]\w*) ([^()]*)\)")
_OPENS = re.compile(r"([A-Za-z_]\w*)\s*:?\s*\{")
_FIELD = re.compile(r'([A-Za-z_]\w*)\s*:\s*("(?:[^"\\]|\\.)*"|\S+)')
_SHOWN, _FEWEST = 40, 3
"""Lines that are looked at, and those of one form that show it [1]; judgement."""
_DEEPEST = 20


def form_of_objects(head: bytes) -> str:
    """Return ``topics``, ``brackets`` or ``blocks`` by the first bytes of a file; empty of any other text."""
    lines = [line.strip() for line in decoded(head).splitlines()[:-1] if line.strip()][:_SHOWN]
    if len(lines) < _FEWEST:
        return ""
    if all((found := _TOPIC.fullmatch(line)) and isinstance(parsed(found["object"]), dict) for line in lines):
        return "topics"
    if all(len(_BRACKETS.findall(line)) > 1 and not _BRACKETS.sub("", line).strip() for line in lines):
        return "brackets"
    said = [bool(_OPENS.fullmatch(line)) or bool(_FIELD.fullmatch(line)) or line == "}" for line in lines]
    return "blocks" if all(said) and any(map(_OPENS.fullmatch, lines)) and "}" in lines else ""


def open_objects(path: Path, form: str) -> RawRecording:
    """Open text of a form that `form_of_objects` tells.

    Raises
    ------
    LogError
        If it holds no number.
    """
    notes: list[ReadNote] = []
    if form == "topics":
        return table_of_rows(path, lambda: rows_by_topic(_of_topics(path, notes), "topic"), notes)
    return table_of_rows(path, lambda: (_of_brackets if form == "brackets" else _of_blocks)(path, notes), notes)


def _lines(path: Path) -> Iterator[str]:
    with path.open("rb") as stream:
        while raw := stream.readline(LONGEST_LINE):
            if not raw.isspace():
                yield decoded(raw).strip()


def _of_topics(path: Path, notes: list[ReadNote]) -> Iterator[dict[str, Any]]:
    others = 0
    for line in _lines(path):
        found = _TOPIC.fullmatch(line)
        content = parsed(found["object"]) if found else None
        if found is None or not isinstance(content, dict):
            others += 1
            continue
        time = {"time": number_of(found["time"], ".")} if found["time"] else {}
        yield {**time, "topic": found["topic"], "content": content}
    _note(notes, path, others)


def _of_brackets(path: Path, notes: list[ReadNote]) -> Iterator[dict[str, Any]]:
    others = 0
    for line in _lines(path):
        row = {}
        for name, text in _BRACKETS.findall(line):
            values = [number_of(cell, ".") for cell in text.split()]
            row[name] = values[0] if len(values) == 1 else values
        others += not row
        if row:
            yield row
    _note(notes, path, others)


def _of_blocks(path: Path, notes: list[ReadNote]) -> Iterator[dict[str, Any]]:
    """Yield a message each time that a name of the outermost level occurs again, or a line of dashes stands."""
    message: dict[str, Any] = {}
    inside: list[dict[str, Any]] = []
    others = 0
    for line in itertools.chain(_lines(path), ["---"]):
        level = inside[-1] if inside else message
        opens, field = _OPENS.fullmatch(line), _FIELD.fullmatch(line)
        name = opens[1] if opens else field[1] if field else ""
        if not inside and message and (name in message or line.startswith("---")):
            yield message
            message = level = {}
        if opens and len(inside) < _DEEPEST:
            inside.append(level.setdefault(name, {}) if isinstance(level.get(name, {}), dict) else {})
        elif field:
            level[name] = number_of(field[2].strip('"'), ".")
        elif line == "}" and inside:
            _with_zeros(inside.pop())
        elif not line.startswith("---"):
            others += 1
    _note(notes, path, others)


def _with_zeros(vector: dict[str, Any]) -> None:
    """Add the parts of a vector or a quaternion that were not printed: by this format they are 0."""
    axes = "xyzw" if "w" in vector else "xyz"
    if vector and set(vector) <= set(axes):
        vector.update({axis: 0.0 for axis in axes if axis not in vector})


def _note(notes: list[ReadNote], path: Path, others: int) -> None:
    if others:
        note_once(notes, "lines of another form, left out", path.name, others)
