"""Several pieces of one diagnosis at a time, in threads: numpy and compiled loops let go of Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

__all__ = ["cores", "together", "use_threads"]

_Item = TypeVar("_Item")
_Out = TypeVar("_Out")

_MOST = 4  # beyond it Python's lock is what is waited for
_threads = 0


def use_threads(count: int) -> None:
    """Use so many threads at most from now on; 0 for as many as there are cores, up to four."""
    global _threads
    _threads = count


def together(function: Callable[[_Item], _Out], items: Iterable[_Item]) -> list[_Out]:
    """Return the function of each item, in order; the first error is raised as if they were done in turn."""
    items = list(items)
    count = min(len(items), _threads or min(cores(), _MOST))
    if count < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(function, items))


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
