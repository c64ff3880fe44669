"""Map a function over items in this process, in several processes or on a Dask cluster; results are the same."""

import contextlib
import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any, TypeVar

from split_cli.compiled_code import postponed_by_compiled_code
from split_cli.diagnosis.parallel import cores, use_threads
from split_cli.errors import SplitError, reason_of

_T = TypeVar("_T")
_R = TypeVar("_R")
_AHEAD = 2
"""Items handed out beyond those being worked on, per worker [1]; judgement: enough that no worker waits."""
_HELD = 2
"""Objects kept on every worker for further calls [1]; judgement: a diagnosis searches twice at most."""
_FAREWELL = 10.0
"""For a worker to remove its unfinished files when its parent has ended [s]; judgement."""
_MOST_UNASKED = 4
"""Processes that are started where nobody says how many [1]; judgement: each holds a recording in memory."""


@dataclass(frozen=True)
class Engine:
    """Applies a function to items; results come in the order of the items, whoever is done first."""

    name: str  # in words, for the report
    workers: int
    # ``apply(function, items)`` yields results in order; an error of an item is raised at its place.
    apply: Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]
    carries_closures: bool = False  # whether functions within functions can travel, too

    def map(self, function: Callable[[_T], _R], items: Iterable[_T]) -> Iterator[_R]:
        """Yield ``function(item)`` of every item, in order.

        `function` is a plain function of a module and items are values that can be pickled: they may travel.
        """
        yield from self.apply(function, list(items))


HERE = Engine("this process", 1, map)


@contextlib.contextmanager
def open_engine(name: str = "process", *, jobs: int | None = 1, scheduler: str | None = None) -> Iterator[Engine]:
    """Give an engine, and close what it opened.

    Parameters
    ----------
    name : {"process", "dask"}
    jobs : int or None
        Processes on this machine, one for each core and at most four if None; 1 works in this process, as a single
        item does. With ``dask`` and no scheduler, workers of a cluster of its own on this machine.
    scheduler : str, optional
        Address of a running Dask scheduler, ``tcp://HOST:PORT``. Its workers must see the same files.

    Raises
    ------
    SplitError
        If the package is missing or the scheduler does not answer.
    """
    jobs = min(cores(), _MOST_UNASKED) if jobs is None else jobs
    if name == "dask":
        with _dask(jobs, scheduler) as engine:
            yield engine
    elif scheduler is not None:
        raise SplitError("needs `--engine dask`", where="--scheduler", advice="Add it, or leave --scheduler out.")
    elif jobs <= 1:
        yield HERE
    else:
        processes = _Processes(jobs)
        try:
            yield Engine(f"{jobs} processes", jobs, processes.apply)
        except BaseException:
            processes.stop()  # Ctrl-C, say: nobody waits for what is under way
            raise
        finally:
            processes.close()


class _Processes:
    """Worker processes that start when there is more than one item to work on."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: ProcessPoolExecutor | None = None
        self._context = multiprocessing.get_context("spawn")
        self._lifeline, self._alive = self._context.Pipe(duplex=False)

    def apply(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        if len(items) < 2:
            return map(function, items)
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self._count, mp_context=self._context, initializer=_start_worker, initargs=(self._lifeline,)
            )
        return self._results(self._pool, partial(_work, function), items)

    def _results(
        self, pool: ProcessPoolExecutor, function: Callable[[Any], Any], items: Sequence[Any]
    ) -> Iterator[Any]:
        try:
            with _interrupts_wait():
                results = pool.map(function, items)
            yield from results
        except BrokenProcessPool as error:
            what = "a worker process was ended from outside, or for lack of memory"
            advice = "Use fewer processes; --jobs 1 works in this one."
            raise SplitError(what, where="--jobs", advice=advice) from error

    def stop(self) -> None:
        """Have workers drop what they are doing, unfinished files removed."""
        self._alive.close()

    def close(self) -> None:
        try:
            if self._pool is not None:
                self._pool.shutdown(cancel_futures=True)
        finally:
            self._alive.close()
            self._lifeline.close()


@contextlib.contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Hold Ctrl-C back while workers are started: they never see it, and print no traceback while they load."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_stopped = threading.Event()  # of a worker: it begins nothing more


def _start_worker(lifeline: Connection) -> None:
    """Let the parent decide about interrupts; one thread each, since there is a process a core.

    The other end of `lifeline` closes when the parent stops its workers, or ends.
    """

    def stop(number: int, frame: FrameType | None) -> None:
        _stopped.set()
        if not postponed_by_compiled_code(number, frame):
            sys.exit(128 + number)

    def listen() -> None:
        lifeline.poll(None)
        os.kill(os.getpid(), signal.SIGTERM)
        # A main thread that waits for what a killed sibling holds never comes to the signal.
        time.sleep(_FAREWELL)
        os._exit(128 + signal.SIGTERM)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    threading.Thread(target=listen, daemon=True).start()
    # Last: a run that has ended ends a worker that starts without a word, where leaving would print a traceback.
    signal.signal(signal.SIGTERM, stop)


def _work(function: Callable[[Any], Any], item: Any) -> Any:
    if _stopped.is_set():
        sys.exit(1)
    return function(item)


@contextlib.contextmanager
def _dask(jobs: int, scheduler: str | None) -> Iterator[Engine]:
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        what = "needs the packages dask and distributed"
        advice = "Install them with `pip install 'split-cli[cluster]'`."
        raise SplitError(what, where="--engine dask", advice=advice) from error
    with contextlib.ExitStack() as stack:
        try:
            if scheduler is None:
                # A failed task raises here. What its workers say of dropped tasks, or of a scheduler that is gone
                # when a run ends early, tells a user nothing more.
                quiet = {"dashboard_address": None, "silence_logs": logging.CRITICAL}
                cluster = stack.enter_context(LocalCluster(n_workers=max(jobs, 1), threads_per_worker=1, **quiet))
                client = stack.enter_context(Client(cluster))
            else:
                client = stack.enter_context(Client(scheduler, timeout=5))
                client.wait_for_workers(1, timeout=30)
        except (OSError, TimeoutError, ValueError) as error:
            what = f"no Dask scheduler with workers answers ({reason_of(error)})"
            advice = "Start one with `dask scheduler` and `dask worker`."
            raise SplitError(what, where=str(scheduler or "--engine dask"), advice=advice) from error
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        name = f"Dask, {workers} workers"
        held = _Held(client)
        yield Engine(name, workers, lambda function, items: _on_cluster(client, held, function, items), True)


class _Held:
    """Objects that many calls share, sent to the workers once instead of with each call."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._known: list[tuple[Any, Any]] = []

    def __call__(self, held: Any) -> Any:
        """Return a future of an object; only the last few are kept, since each takes memory of every worker."""
        for known, future in self._known:
            if known is held:
                return future
        future = self._client.scatter([held], broadcast=True, hash=False)[0]
        self._known = [*self._known[-_HELD + 1 :], (held, future)]
        return future


def _on_cluster(client: Any, held: _Held, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
    """Yield results in order with a bounded number of items under way, so that memory here does not grow."""
    from distributed import KilledWorker
    from distributed.comm import CommClosedError

    workers = max(len(client.scheduler_info(n_workers=-1)["workers"]), 1)
    waiting: list[Any] = []
    rest = iter(items)
    carried = _carried(client, held, function)

    def hand_out() -> None:
        for item in rest:
            # Not pure: a source may have changed since a task of the same arguments ran.
            waiting.append(client.submit(*carried, item, pure=False))
            return

    for _ in range(workers * (1 + _AHEAD)):
        hand_out()
    while waiting:
        future = waiting.pop(0)
        try:
            result = future.result()
        except (KilledWorker, CancelledError, CommClosedError) as error:
            what = "a worker or the scheduler was ended from outside, or for lack of memory"
            advice = "Look at its log, and begin again."
            raise SplitError(what, where="--engine dask", advice=advice) from error
        future.release()
        hand_out()
        yield result


def _carried(client: Any, held: _Held, function: Callable[[Any], Any]) -> tuple[Any, ...]:
    """Return a function with what it is called with first; what a local one holds travels once, not each time."""
    if isinstance(function, partial):
        (first,) = function.args
        return _call_with, held(first), function.func
    if "<locals>" not in function.__qualname__:
        return (function,)
    import cloudpickle

    return _call, client.scatter(cloudpickle.dumps(function), broadcast=True, hash=False)


def _call_with(held: Any, function: Callable[[Any, Any], Any], item: Any) -> Any:
    use_threads(1)
    return function(held, item)


def _call(pickled: bytes, item: Any) -> Any:
    import cloudpickle

    use_threads(1)
    return cloudpickle.loads(pickled)(item)
