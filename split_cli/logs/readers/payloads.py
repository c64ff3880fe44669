"""The seam between containers and encodings: many serialized messages in, columns of numbers out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

STAMP_FIELDS = ("header.stamp", "stamp", "timestamp", "header.timestamp")


@dataclass(frozen=True)
class Columns:
    """Decoded fields of a run of messages."""

    values: np.ndarray  # (N, P): one column a path; NaN where a message lacks the field (a list that is too short)
    stamps: np.ndarray | None  # int64 (N,): the message's own time [ns]; None where the type has none
    readable: np.ndarray  # bool (N,): False for messages that do not fit their definition; their values are NaN


class PayloadDecoder(Protocol):
    """Decodes the messages of one type."""

    stamp: str | None  # the field that holds the message's own time

    def paths(self) -> list[str]:
        """Return the addresses of the numeric fields, in the order of the definition."""
        ...

    def has(self, path: str) -> bool:
        """Tell whether `path` addresses a numeric field; any index into a list of variable length does."""
        ...

    def lengths(self, payload: bytes) -> dict[str, int]:
        """Return how many elements the arrays of one message have, by address; of others, only of the first."""
        ...

    def decode(self, payloads: Sequence[bytes], paths: Sequence[str]) -> Columns:
        """Decode `paths`, and the stamp, from every payload."""
        ...
