"""A cache of the most recent results, and the return of freed memory to the system."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

_Made = TypeVar("_Made")


class RecentResults(Generic[_Made]):
    """The most recently used results by key (least recently used are dropped first).

    Safe between threads: at worst two of them compute the same result.

    Parameters
    ----------
    most : int
        Number of results that are kept.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._known: dict[Hashable, _Made] = {}

    def __len__(self) -> int:
        return len(self._known)

    def clear(self) -> None:
        """Drop all results."""
        self._known.clear()

    def __reduce__(self) -> tuple[type[RecentResults], tuple[int]]:
        # Keys may contain ids of objects, which are not unique across processes.
        return type(self), (self.most,)

    def __call__(self, key: Hashable, made: Callable[[], _Made]) -> _Made:
        """Return the cached result of a key, or call `made` and keep its result."""
        found = self._known.pop(key, None)
        if found is None:
            found = made()
            for oldest in list(self._known)[: max(len(self._known) + 1 - self.most, 0)]:
                self._known.pop(oldest, None)
        self._known[key] = found
        return found


def release_memory() -> None:
    """Return freed memory to the system with the C library of GNU; elsewhere do nothing.

    The allocator keeps freed memory between arrays in use. On a recording of eleven minutes half as much was kept as
    was in use.
    """
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc alone
        if trim is not None:
            trim(0)
