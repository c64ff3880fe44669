"""Messages that were printed as YAML, a document each, as ``ros2 topic echo`` and ``rostopic echo`` do."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from split_cli.logs.raw import RawRecording, ReadNote, note_once
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.dialect import LONGEST_LINE
from split_cli.logs.readers.json_rows import table_of_rows

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_LONGEST = 1 << 20
"""Of one document [bytes]: messages with arrays of numbers have some kB."""
_KEY = re.compile(r"\s*(- )?[A-Za-z_][\w.%/-]*:(\s|$)|\s*- |\s*['\"\[]|\s*$")
_ALIAS = re.compile(r"(^|[\s\[,])[&*][A-Za-z0-9]")
_SHARE = 0.9


def is_yaml_documents(head: bytes) -> bool:
    """Tell documents of YAML by the first bytes of a file: lines of keys, nested, and a line of dashes behind."""
    lines = decoded(head).splitlines()[:-1] if b"\0" not in head else []
    keys = [line for line in lines if line.strip() and line.strip() != "---"]
    dashed = any(line.rstrip() == "---" for line in lines)
    nested = any(line.startswith(("  ", "- ")) for line in keys)
    known = sum(bool(_KEY.match(line)) for line in keys)
    return (dashed or len(head) >= 4096) and nested and len(keys) > 3 and known >= _SHARE * len(keys)


def open_yaml_documents(path: Path) -> RawRecording:
    """Open messages printed as YAML: a column for each number, ``twist.linear.x``, a row for each document or item.

    Raises
    ------
    LogError
        If no document holds a number.
    """
    notes: list[ReadNote] = []

    def rows() -> Iterator[dict[str, Any]]:
        damaged = 0
        for text in _documents(path):
            try:
                # An alias may make one line as large as any file.
                row = None if _ALIAS.search(text) else yaml.load(text, Loader=_LOADER)
            except (yaml.YAMLError, ValueError, RecursionError):
                row = None
            if isinstance(row, dict):
                yield {str(key): value for key, value in row.items()}
            else:
                damaged += bool(text.strip())
        if damaged:
            note_once(notes, "documents of YAML that cannot be read, left out", path.name, damaged)

    return table_of_rows(path, rows, notes)


def _documents(path: Path) -> Iterator[str]:
    """Yield the documents of a file, or the items of a list that is all that a file holds."""
    held: list[str] = []
    size = 0
    with path.open("rb") as stream:
        is_list = stream.readline(LONGEST_LINE).startswith(b"- ")
        stream.seek(0)
        while raw := stream.readline(LONGEST_LINE):
            if is_list and raw.startswith(b"- "):
                yield "".join(held)
                held, size, raw = [], 0, b"  " + raw[2:]
            if raw.rstrip() in (b"---", b"..."):
                yield "".join(held)
                held, size = [], 0
            elif size < _LONGEST:
                held.append(decoded(raw))
                size += len(raw)
    yield "".join(held)
