"""Frames of pandas in JSON: a column by the numbers of its rows, a row by its number, or titles beside the rows."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.logs.readers.json_document import parsed, plain_number

_FEWEST_ROWS = 20
"""Of a frame that is a log [1]; judgement."""


def frame_of_pandas(path: Path) -> dict[str, np.ndarray] | None:
    """Return the columns of a frame as `to_json` writes it by default, or with `orient` index or split; else None."""
    with path.open("rb") as stream:
        document = parsed(stream.read())
    if not isinstance(document, dict):
        return None
    titles, rows = document.get("columns"), document.get("data")
    if isinstance(titles, list) and isinstance(rows, list) and len(rows) >= _FEWEST_ROWS:
        fit = all(isinstance(row, list) and len(row) == len(titles) for row in rows)
        return {str(t): _numbers([row[k] for row in rows]) for k, t in enumerate(titles)} if fit else None
    inner = [value for value in document.values() if isinstance(value, dict)]
    if not inner or len(inner) < len(document) or any(value.keys() != inner[0].keys() for value in inner):
        return None
    if len(inner[0]) >= _FEWEST_ROWS and _counts(inner[0]):
        return {str(title): _numbers(list(column.values())) for title, column in document.items()}
    if len(document) >= _FEWEST_ROWS and _counts(document):
        return {title: _numbers([row[title] for row in inner]) for title in inner[0]}
    return None


def _counts(keys: Mapping[str, Any]) -> bool:
    """Whether keys are an index: whole numbers that rise."""
    if not all(key.isdigit() for key in keys):
        return False
    numbers = [int(key) for key in keys]
    return all(after > before for before, after in zip(numbers, numbers[1:], strict=False))


def _numbers(values: list[Any]) -> np.ndarray:
    return np.array([plain_number(value) for value in values])
