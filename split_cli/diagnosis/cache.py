"""A cache of the last few results for a search, and the way to return freed memory to the system."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

_Made = TypeVar("_Made")


class RecentResults(Generic[_Made]):
    """Results by key; the one that was asked for longest ago is forgotten first.

    Safe between threads: at worst two of them work out the same.

    Parameters
    ----------
    most : int
        How many results are kept.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._known: dict[Hashable, _Made] = {}

    def __len__(self) -> int:
        return len(self._known)

    def clear(self) -> None:
        """Forget all results."""
        self._known.clear()

    def __reduce__(self) -> tuple[type[RecentResults], tuple[int]]:
        # Keys may hold ids of objects, which another process gives to others.
        return type(self), (self.most,)

    def __call__(self, key: Hashable, made: Callable[[], _Made]) -> _Made:
        """Return the result of a key: as it was made before, or made now."""
        found = self._known.pop(key, None)
        if found is None:
            found = made()
            for oldest in list(self._known)[: max(len(self._known) + 1 - self.most, 0)]:
                self._known.pop(oldest, None)
        self._known[key] = found
        return found


def release_memory() -> None:
    """Return freed memory to the system where the C library can; elsewhere nothing happens.

    A library that allocates keeps what lies between arrays in use, and a search frees arrays of all lengths: of a
    recording of eleven minutes half as much stayed as was in use.
    """
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc alone
        if trim is not None:
            trim(0)
