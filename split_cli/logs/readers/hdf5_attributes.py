"""What stands beside a dataset of HDF5: titles of its columns, and how its whole numbers are scaled."""

import io
import pickle
from collections.abc import Mapping
from typing import Any

import numpy as np

from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS

_LONGEST = 1 << 20
"""Of a pickled list of titles that is looked at [bytes]: a thousand names have 0.1 MB."""
_TITLES = ("columns", "column_names", "columnnames", "colnames", "names", "channels", "channel_names", "labels")
_FILLS = ("_fillvalue", "missing_value")


class _OnlyPlain(pickle.Unpickler):
    """Lists, tuples, texts and numbers: whatever names a class or a function of Python is refused."""

    def find_class(self, module_name: str, global_name: str) -> Any:
        """Refuse all."""
        raise pickle.UnpicklingError(f"{module_name}.{global_name} is no plain value")


def _plain(value: Any) -> Any:
    """Return what PyTables pickled into an attribute, of plain values only; None of anything else."""
    raw = bytes(value) if isinstance(value, bytes | np.bytes_) else b""
    if not 0 < len(raw) <= _LONGEST:
        return None
    try:
        return _OnlyPlain(io.BytesIO(raw), encoding="utf-8").load()
    except Exception:  # pickle raises anything on what is none
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
