"""JSON that is held as a whole: a line, or a document of a bounded size."""

import json
import math
from pathlib import Path
from typing import Any

from split_cli.errors import LogError

LONGEST_ELEMENT = 4 << 20
"""Of one row [bytes]; judgement: a row of a thousand numbers has 30 kB."""
LARGEST_DOCUMENT = 32 << 20
"""Of a document [bytes]: objects take ten times as much memory."""


def parsed(text: bytes | str) -> Any:
    """Return what a text stands for; None of what is no JSON, is nested too deep or has endless numbers."""
    try:
        return json.loads(text.removeprefix(b"\xef\xbb\xbf") if isinstance(text, bytes) else text)
    except (ValueError, RecursionError):
        return None


def plain_number(value: Any) -> float:
    """Return a number, true and false as 1 and 0; NaN for anything else, and from 1e300 on."""
    return float(value) if isinstance(value, bool | int | float) and abs(value) < 1e300 else math.nan


def read_document(path: Path) -> Any:
    """Return what a file stands for as one document.

    Raises
    ------
    LogError
        If it is larger than `LARGEST_DOCUMENT`, cut off or damaged.
    """
    if path.stat().st_size > LARGEST_DOCUMENT:
        raise LogError(
            f"is one JSON document of more than {LARGEST_DOCUMENT >> 20} MB, which is held as a whole",
            where=path.name,
            advice="Write one object a line (JSON lines), which may have any length, or CSV or Parquet.",
        )
    document = parsed(path.read_bytes())
    if document is None:
        what = "is a JSON document that is cut off or damaged"
        raise LogError(what, where=path.name, advice="Copy or record it again, or close what is open at its end.")
    return document
