"""The seam between containers and encodings: many serialized messages in, columns of numbers out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

__all__ = ["STAMP_FIELDS", "Columns", "PayloadDecoder"]

STAMP_FIELDS = ("header.stamp", "stamp", "timestamp", "header.timestamp")


@dataclass(frozen=True)
class Columns:
    """Decoded fields of a run of messages.

    Attributes
    ----------
    values : ndarray of float64, shape (N, P)
        One column a path; NaN where a message lacks the field (a list that is too short).
    stamps : ndarray of int64, shape (N,), or None
        The message's own time [ns]; None where the type has none.
    readable : ndarray of bool, shape (N,)
        False for messages that do not fit their definition; their values are NaN.
    """

    values: np.ndarray
    stamps: np.ndarray | None
    readable: np.ndarray


class PayloadDecoder(Protocol):
    """Decodes the messages of one type.

    Attributes
    ----------
    stamp : str or None
        The field that holds the message's own time.
    """

    stamp: str | None

    def paths(self) -> list[str]:
        """Return the addresses of the numeric fields, in the order of the definition."""
        ...

    def has(self, path: str) -> bool:
        """Tell whether `path` addresses a numeric field; any index into a list of variable length does."""
        ...

    def decode(self, payloads: Sequence[bytes], paths: Sequence[str]) -> Columns:
        """Decode `paths`, and the stamp, from every payload."""
        ...
