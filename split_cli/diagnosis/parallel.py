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


def map_in_threads(function: Callable[[_Item], _Out], items: Iterable[_Item]) -> list[_Out]:
    """Return the function of each item, in order; the first error is raised as if they were done in turn."""
    items = list(items)
    count = min(len(items), _threads or min(cores(), _MOST))
    if count < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(function, items))


@contextmanager
def distributing_by(apply: Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]) -> Iterator[None]:
    """Let ``apply(function, items)`` do what `map_distributed` is given, in the body."""
    global _apply
    _apply = apply
    try:
        yield
    finally:
        _apply = None


def map_distributed(function: Callable[[_Item], _Out], items: Iterable[_Item]) -> list[_Out]:
    """Return the function of each item, in order, as `map_in_threads` does; for pieces that are worth sending.

    What they return can be pickled, and nothing that they alter is needed: both may be copies. What every piece
    needs travels once where the function is a `functools.partial` of it: see `map_distributed_with`.
    """
    items = list(items)
    if _apply is None or len(items) < 2:
        return map_in_threads(function, items)
    return list(_apply(function, items))


def map_distributed_with(held: _Held, function: Callable[[_Held, _Item], _Out], items: Iterable[_Item]) -> list[_Out]:
    """Return ``function(held, item)`` of each item as `map_distributed` does; `held` travels once."""
    return map_distributed(partial(function, held), items)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
