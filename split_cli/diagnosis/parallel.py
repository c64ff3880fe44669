"""Parallel execution within one diagnosis: in threads, or by an engine that the caller passes.

NumPy and compiled loops release the global interpreter lock, so threads are sufficient on one machine.
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

_MOST = 4  # threads at most by default [1]: more would wait for the global interpreter lock
_threads = 0
_apply: Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]] | None = None


def use_threads(count: int) -> None:
    """Use at most `count` threads from now on; 0 for one a core, up to four."""
    global _threads
    _threads = count


def map_in_threads(function: Callable[[_Item], _Out], items: Iterable[_Item]) -> list[_Out]:
    """Return the function of each item, in order. An error of an item is raised as in a loop."""
    items = list(items)
    count = min(len(items), _threads or min(cores(), _MOST))
    if count < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(function, items))


@contextmanager
def distributing_by(apply: Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]) -> Iterator[None]:
    """Let `map_distributed` use ``apply(function, items)`` within the context."""
    global _apply
    _apply = apply
    try:
        yield
    finally:
        _apply = None


def map_distributed(function: Callable[[_Item], _Out], items: Iterable[_Item]) -> list[_Out]:
    """Return the function of each item, in order, possibly computed by other processes.

    Items, results and function must be picklable. They may be copies, so changes of them are lost. Data that all items
    need are sent once with `map_distributed_with`.
    """
    items = list(items)
    if _apply is None or len(items) < 2:
        return map_in_threads(function, items)
    return list(_apply(function, items))


def map_distributed_with(held: _Held, function: Callable[[_Held, _Item], _Out], items: Iterable[_Item]) -> list[_Out]:
    """Return ``function(held, item)`` of each item as `map_distributed` does; `held` is sent once."""
    return map_distributed(partial(function, held), items)


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
