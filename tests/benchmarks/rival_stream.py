"""The stream that all contestants of `bench_rivals` get, and how they are timed and scored."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from split_cli.learning.cells import learn
from split_cli.learning.training_set import TrainingSet
from tests.factories import make_labels, make_training_set, smooth_residual, valid_features

NOISE = 0.1
QUERIES = 400
SLOW_QUERIES = 40


@dataclass(frozen=True)
class Row:
    """What one contestant did at one size; times in microseconds, None where it has no such thing.

    `spread` is the range of a median over repeats, as a share of it, where that is largest.
    """

    name: str
    size: int
    points: int | None = None
    build_s: float | None = None
    update_p50: float | None = None
    update_p99: float | None = None
    query_p50: float | None = None
    query_p99: float | None = None
    jacobian_p50: float | None = None
    jacobian_p99: float | None = None
    rmse: float | None = None
    nlpd: float | None = None
    coverage_95: float | None = None
    from_full: float | None = None
    megabytes: float | None = None
    code_kb: float | None = None
    compile_s: float | None = None
    spread: float | None = None


@dataclass(frozen=True)
class Stream:
    """Samples in order and what is asked afterwards."""

    z: np.ndarray
    y: np.ndarray
    queries: np.ndarray
    truth: np.ndarray
    trained: TrainingSet


def stream_of(size: int, length_scale: float) -> Stream:
    """Return `size` samples, the set SPLIT keeps of them, and queries with the truth."""
    start = make_training_set(0, 50, length_scale_cells=length_scale, noise=NOISE)
    z = valid_features(start.vehicle, start.region, size, seed=size)
    rng = np.random.default_rng(size)
    truth = smooth_residual(z)
    y = truth + NOISE * rng.normal(size=truth.shape)
    kernel = type(start.kernel)(start.kernel.length_scales, np.mean(truth**2, axis=0), np.full(3, NOISE**2))
    # Room for all of them, as a set of that size has by its own settings.
    capacity = 10 if size <= 10_000 else 60
    trained = learn([make_labels(z, y, start.vehicle)], vehicle=start.vehicle, grid=start.grid, kernel=kernel,
                    capacity=capacity)  # fmt: skip
    queries = valid_features(start.vehicle, start.region, QUERIES, seed=7)
    return Stream(z, y, queries, smooth_residual(queries), trained)


def percentiles(times: list[float]) -> tuple[float, float]:
    """Return the 50th and 99th percentile in microseconds."""
    return float(np.percentile(times, 50) * 1e6), float(np.percentile(times, 99) * 1e6)


def spent(call: Callable[[], object]) -> float:
    """Return the processor time of one call [s]: what else the machine does while it waits is not counted."""
    begin = time.thread_time()
    call()
    return max(0.0, time.thread_time() - begin - _CLOCK)


def _clock_cost() -> float:
    """Return the median time between two readings of the clock with nothing between them [s]."""
    readings = [(time.thread_time(), time.thread_time()) for _ in range(2001)]
    return float(np.median([after - before for before, after in readings]))


_CLOCK = _clock_cost()


def each(call: Callable, items: list) -> tuple[float, float]:
    """Return percentiles of the time of a call over items."""
    call(items[0])
    return percentiles([spent(lambda at=item: call(at)) for item in items])


def accuracy(mean: np.ndarray, variance: np.ndarray, stream: Stream, full: np.ndarray | None) -> dict:
    """Return error, density and coverage against the truth, without label noise, and against the full GP."""
    count = len(mean)
    error = (mean - stream.truth[:count]) / np.sqrt(stream.trained.kernel.signal_variance)
    spread = variance / stream.trained.kernel.signal_variance
    found = {
        "rmse": float(np.sqrt(np.mean(error**2))),
        "nlpd": float(np.mean(0.5 * np.log(2.0 * np.pi * spread) + 0.5 * error**2 / spread)),
        "coverage_95": float(np.mean(error**2 <= 3.841 * spread)),
    }
    if full is not None:
        scale = np.sqrt(stream.trained.kernel.signal_variance)
        found["from_full"] = float(np.sqrt(np.mean(((mean - full[:count]) / scale) ** 2)))
    return found
