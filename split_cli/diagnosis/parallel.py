"""Parallel execution within one diagnosis: in threads, or by an engine that the caller passes.

NumPy and compiled loops let go of Python's lock, so threads are enough on one machine.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

_Item = TypeVar("_Item")
_Out = TypeVar("_Out")
_Held = TypeVar("_Held")

_MOST = 4  # beyond it Python's lock is what is waited for
_threads = 0
_apply: Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]] | None = None


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


@contextmanager
def handing_out(apply: Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]) -> Iterator[None]:
    """Let ``apply(function, items)`` do what `apart` is given, in the body."""
    global _apply
    _apply = apply
    try:
        yield
    finally:
        _apply = None


def apart(function: Callable[[_Item], _Out], items: Iterable[_Item]) -> list[_Out]:
    """Return the function of each item, in order, as `together` does; for pieces that are worth a journey.

    What they return is plain, and nothing they alter is needed: both may have been copied. What every piece needs,
    and many calls share, travels once where the function is a `functools.partial` of it: see `apart_with`.
    """
    items = list(items)
    if _apply is None or len(items) < 2:
        return together(function, items)
    return list(_apply(function, items))


def apart_with(held: _Held, function: Callable[[_Held, _Item], _Out], items: Iterable[_Item]) -> list[_Out]:
    """Return ``function(held, item)`` of each item as `apart` does; `held` travels once for all calls with it."""
    return apart(partial(function, held), items)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
