"""What stands beside a dataset of HDF5: titles of its columns, and how its whole numbers are scaled."""

import pickletools
from collections.abc import Mapping
from typing import Any

import numpy as np

from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS

_LONGEST = 1 << 20
"""Of a pickled list of titles that is looked at [bytes]: a thousand names have 0.1 MB."""
_TITLES = ("columns", "column_names", "columnnames", "colnames", "names", "channels", "channel_names", "labels")
_VALUES = (
    "INT",
    "BININT",
    "LONG",
    "BINLONG",
    "FLOAT",
    "BINFLOAT",
    "STRING",
    "UNICODE",
    "BINUNICODE",
    "SHORT_BINUNICODE",
)
"""Instructions that put a number or a text on the stack, by how their names begin."""
_FILLS = ("_fillvalue", "missing_value")


def _plain(value: Any) -> Any:
    """Return lists, dictionaries, texts and numbers that PyTables stored in an attribute; None of anything else.

    It stores them as Python's serialization, of whose instructions only those that make such values are followed:
    none that imports or calls.
    """
    raw = bytes(value) if isinstance(value, bytes | np.bytes_) else b""
    if not 0 < len(raw) <= _LONGEST:
        return None
    try:
        return _followed(raw)
    except Exception:  # the instructions of what is none may be anything
        return None


def _followed(raw: bytes) -> Any:
    stack: list[Any] = []
    marks: list[int] = []
    memo: dict[int, Any] = {}

    def since_mark() -> list[Any]:
        begin = marks.pop()
        taken, stack[begin:] = stack[begin:], []
        return taken

    for opcode, argument, _ in pickletools.genops(raw):
        name = opcode.name
        if name == "STOP":
            return stack[-1]
        if name == "MARK":
            marks.append(len(stack))
        elif name in ("LIST", "TUPLE"):
            stack.append(since_mark())
        elif name == "DICT":
            items = since_mark()
            stack.append(dict(zip(items[::2], items[1::2], strict=True)))
        elif name in ("EMPTY_LIST", "EMPTY_TUPLE", "EMPTY_DICT"):
            stack.append({} if name == "EMPTY_DICT" else [])
        elif name in ("APPEND", "APPENDS"):
            added = since_mark() if name == "APPENDS" else [stack.pop()]
            stack[-1].extend(added)
        elif name in ("SETITEM", "SETITEMS"):
            items = since_mark() if name == "SETITEMS" else [stack.pop(-2), stack.pop()]
            stack[-1].update(zip(items[::2], items[1::2], strict=True))
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            count = int(name[-1])
            taken, stack[-count:] = stack[-count:], []
            stack.append(taken)
        elif name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
            memo[len(memo) if argument is None else int(argument)] = stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET") and argument is not None:
            stack.append(memo[int(argument)])
        elif name in ("NONE", "NEWTRUE", "NEWFALSE"):
            stack.append({"NONE": None, "NEWTRUE": True, "NEWFALSE": False}[name])
        elif isinstance(argument, str | int | float) and opcode.arg is not None and name.startswith(_VALUES):
            stack.append(argument)
        elif name not in ("PROTO", "FRAME"):
            return None
    return None


def titles_of_block(attributes: Mapping[str, Any], field: str, width: int) -> list[str]:
    """Return the titles of a block of a table of pandas, which stand in its attribute; empty where it has none.

    Parameters
    ----------
    field : str
        Name of the block: ``values_block_0``.
    width : int
        Columns that it has.
    """
    titles = _plain(attributes.get(f"{field}_kind"))
    if not isinstance(titles, list) or len(titles) != width:
        return []
    return [title if isinstance(title, str) else " ".join(map(str, np.ravel(title)))[:LONGEST_NAME] for title in titles]


def name_of_index(attributes: Mapping[str, Any]) -> str:
    """Return what pandas calls the index of a table, by the attributes of its group; empty where it has no name."""
    info = _plain(attributes.get("info"))
    index = info.get("index") if isinstance(info, dict) else None
    name = index.get("index_name") if isinstance(index, dict) else None
    return name if isinstance(name, str) else ""


def titles_of_matrix(attributes: Mapping[str, Any], width: int) -> list[str]:
    """Return the titles of the columns of a matrix, where an attribute lists as many texts; else empty."""
    for key in attributes:
        if key.lower() not in _TITLES or not 1 < width <= MOST_FIELDS:
            continue
        texts = [t.decode(errors="replace") if isinstance(t, bytes) else t for t in np.ravel(attributes[key])]
        if len(texts) == width and all(isinstance(text, str) for text in texts):
            return [text.strip()[:LONGEST_NAME] for text in texts]
    return []


def unpacked(values: np.ndarray, attributes: Mapping[str, Any]) -> np.ndarray | None:
    """Return numbers by the scale, the offset and the fill value in the attributes (CF conventions, section 8.1).

    Returns
    -------
    ndarray or None
        None where the attributes state none of the three.
    """
    known = {key.lower(): attributes[key] for key in attributes}
    scale, offset = (_number(known.get(key)) for key in ("scale_factor", "add_offset"))
    fills = [number for key in _FILLS if (number := _number(known.get(key))) is not None]
    missing = np.isin(values, fills) if fills else np.zeros(1, dtype=bool)
    if scale is None and offset is None and not np.any(missing):
        return None
    made = values.astype(np.float64) * (1.0 if scale is None else scale) + (offset or 0.0)
    return np.where(missing, np.nan, made)


def _number(value: Any) -> float | None:
    if value is None or np.size(value) != 1 or np.asarray(value).dtype.kind not in "iuf":
        return None
    number = float(np.ravel(value)[0])
    return number if np.isfinite(number) else None


_RATES = ("sample_rate", "samplerate", "sampling_rate", "sampling_frequency", "rate", "frequency", "fs", "rate_hz")
_PERIODS = ("dt", "period", "sample_time", "sample_period", "increment", "wf_increment")
_STARTS = ("t0", "start", "start_time", "start_offset", "wf_start_offset")
"""Attributes that say how a vector was sampled: its rate [Hz], or its period [s], and its first instant [s]."""


def clock_of_samples(attributes: Mapping[str, Any], count: int) -> np.ndarray | None:
    """Return the time of `count` values sampled as the attributes of their dataset say [s]; None where none does."""
    said = {}
    for key in attributes:
        value = np.asarray(attributes[key])
        if value.size == 1 and value.dtype.kind in "fiu" and np.isfinite(float(value.ravel()[0])):
            said[key.lower()] = float(value.ravel()[0])
    rate = next((said[key] for key in _RATES if said.get(key, 0.0) > 0.0), 0.0)
    period = next((said[key] for key in _PERIODS if said.get(key, 0.0) > 0.0), 1.0 / rate if rate else 0.0)
    start = next((said[key] for key in _STARTS if key in said), 0.0)
    return start + period * np.arange(count) if period else None
