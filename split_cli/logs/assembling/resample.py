"""One uniform clock: continuous signals low-passed and interpolated, held ones held, gaps left as gaps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.logs.scratch import let_go, room, set_aside

HIGHEST_RATE = 100.0
"""Of a drive [Hz], unless the user asks for more."""

_DECIMATION = 1.2
"""Above this ratio of rates a signal is low-passed; below it is interpolated."""

_HALF_WIDTH = 2.5
"""Of the low-pass window, in periods of the drive: half amplitude at 0.38, 18 % at 0.5, under 3 % above 0.6 of
the drive's rate; 0.5 % off at a tenth of it."""

_CHUNK = 20000
_CHUNKS_HELD = 20  # of columns outside memory
_FEWEST = 4  # samples that a stretch needs
_LONGEST_LAG = 12
_ENOUGH_ROWS = 20000


@dataclass(frozen=True)
class SampleClock:
    """The clock of a drive: rows at origin + index * period, in segments."""

    origin: float  # [s]
    period: float  # [s]
    index: np.ndarray  # int64 (N,)
    segment: np.ndarray  # int32 (N,)

    @property
    def time(self) -> np.ndarray:
        """Shape (N,) [s]."""
        return self.time_of(slice(None))

    def time_of(self, rows: slice) -> np.ndarray:
        """Return the times of some rows [s]."""
        return self.origin + self.index[rows] * self.period


@dataclass(frozen=True)
class Resampled:
    """A signal on the drive's clock."""

    values: np.ndarray  # (N,): NaN where the signal has a gap
    gain: float  # standard deviation of the output for white noise of unit deviation at the input [1]
    # Of the filtered noise at lags 0, 1, 2, ... rows.
    autocorrelation: tuple[float, ...]
    low_passed: bool


def runs_of(time: np.ndarray, gap: float) -> list[tuple[int, int]]:
    """Return [start, end) of every stretch of at least four samples without a step longer than `gap` [s]."""
    # A clock that ticks every 0.1 s exactly must not break on rounding.
    cuts = np.flatnonzero(np.diff(time) > gap * (1.0 + 1e-6)) + 1
    edges = [0, *cuts.tolist(), len(time)]
    return [(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True) if b - a >= _FEWEST]


def make_grid(spans: Sequence[Sequence[tuple[float, float]]], period: float) -> tuple[SampleClock, int]:
    """Lay a uniform clock over the times that every required signal covers.

    Parameters
    ----------
    spans : sequence of sequences of (float, float)
        For each required signal the [start, end] times of its stretches without a gap [s].
    period : float
        [s]. A segment with fewer than four rows is left out.

    Returns
    -------
    grid : SampleClock
        Its origin is the first time that all signals cover.
    left_out : int
        Rows of segments that were too short.
    """
    common = list(spans[0])
    for other in spans[1:]:
        common = _intersect(common, list(other))
    if not common:
        return SampleClock(0.0, period, np.empty(0, np.int64), np.empty(0, np.int32)), 0
    origin = common[0][0]
    tolerance = 1e-6  # [rows]: a stretch that ends on a row keeps it in spite of rounding
    index, segment, left_out = [], [], 0
    for start, end in common:
        first = int(np.ceil((start - origin) / period - tolerance))
        last = int(np.floor((end - origin) / period + tolerance))
        if last - first + 1 < _FEWEST:
            left_out += max(0, last - first + 1)
            continue
        segment.append(np.full(last - first + 1, len(segment), dtype=np.int32))
        index.append(np.arange(first, last + 1, dtype=np.int64))
    if not index:
        return SampleClock(origin, period, np.empty(0, np.int64), np.empty(0, np.int32)), left_out
    return SampleClock(origin, period, set_aside(np.concatenate(index)), np.concatenate(segment)), left_out


def _intersect(one: list[tuple[float, float]], other: list[tuple[float, float]]) -> list[tuple[float, float]]:
    result, i, j = [], 0, 0
    while i < len(one) and j < len(other):
        start, end = max(one[i][0], other[j][0]), min(one[i][1], other[j][1])
        if end > start:
            result.append((start, end))
        if one[i][1] < other[j][1]:
            i += 1
        else:
            j += 1
    return result


def resample_together(
    time: np.ndarray, signals: Sequence[np.ndarray], grid: SampleClock, *, gap: float
) -> list[Resampled]:
    """Bring continuous signals that share a clock onto the drive's with zero phase.

    Parameters
    ----------
    time : ndarray, shape (M,)
        Strictly increasing; the clock may jitter.
    signals : sequence of ndarray, shape (M,)
    gap : float
        Nothing is interpolated across a step longer than this [s].

    Notes
    -----
    Faster signals: weighted local cubic regression at each row (Blackman weights over +-2.5 periods of the
    drive), which is a low-pass that needs no uniform input and is exact for cubics up to the ends of a stretch.
    Others: the cubic through the four nearest samples, the sample itself where the clocks agree. Both are linear
    in the samples, so the noise on the drive's clock follows from the weights.
    """
    outputs = [room(len(grid.index)) for _ in signals]
    rows_time = set_aside(grid.time)
    slack = 1e-6 * grid.period
    noise = _NoiseOfWeights()
    low_passed = False
    for start, end in runs_of(time, gap):
        a = int(np.searchsorted(rows_time, time[start] - slack))
        b = int(np.searchsorted(rows_time, time[end - 1] + slack, side="right"))
        if b <= a:
            continue
        run_time = time[start:end]
        decimates = grid.period > _DECIMATION * float(np.median(np.diff(run_time)))
        low_passed |= decimates
        weights_at = _regression_weights if decimates else _cubic_weights
        for low in range(a, b, _CHUNK):
            at = rows_time[low : min(low + _CHUNK, b)]
            first, weights = weights_at(run_time, at, grid.period)
            columns = start + np.minimum(first[:, None] + np.arange(weights.shape[1]), len(run_time) - 1)
            begin = int(columns.min())
            near = np.stack([values[begin : int(columns.max()) + 1] for values in signals], axis=1)
            found = np.einsum("nk,nkc->nc", weights, near[columns - begin])
            for output, values in zip(outputs, found.T, strict=True):
                output[low : low + len(at)] = values
            noise.add(first, weights)
            if (low - a) // _CHUNK % _CHUNKS_HELD == 0:
                let_go()
    gain, autocorrelation = noise.result()
    return [Resampled(output, gain, autocorrelation, low_passed) for output in outputs]


def resample_held(
    time: np.ndarray, values: np.ndarray, grid: SampleClock, *, longest: float, resumed: Sequence[float] = ()
) -> np.ndarray:
    """Return what a held signal is on average from each row to the next, shape (N,).

    NaN before the first sample, and where the last one lies more than `longest` [s] before a row. No value is held
    beyond one of the times `resumed` [s].

    Notes
    -----
    A row's input lasts until the next row. Taken at the row alone, a sample that comes just after it would act a
    whole period late: where stamps jitter, that depends on the jitter of the first one.
    """
    # Rows and samples of equal clocks differ by rounding, of seconds since 1970 by 0.2 us: within the slack a row
    # takes its sample alone.
    slack = 1e-3 * grid.period
    result = room(len(grid.index))
    for first in range(0, len(result), _CHUNKS_HELD * _CHUNK):
        piece = slice(first, first + _CHUNKS_HELD * _CHUNK)
        at = grid.time_of(piece)
        row = np.searchsorted(time, at + slack, side="right") - 1
        last = np.searchsorted(time, at + grid.period - slack) - 1
        known = row >= 0
        row = np.maximum(row, 0)
        if len(resumed):
            run = np.searchsorted(resumed, time[row], "right")
            known &= run == np.searchsorted(resumed, at + slack, "right")
            last = np.where(run == np.searchsorted(resumed, time[last], "right"), last, row)
        held = values[row]
        rest = np.flatnonzero(known & (last > row))
        sample = row[rest]
        while len(rest):  # each sample within the row's period changes what is held for the rest of it
            sample = sample + 1
            left = (at[rest] + grid.period - time[sample]) / grid.period
            held[rest] += (values[sample] - values[sample - 1]) * left
            more = last[rest] > sample
            rest, sample = rest[more], sample[more]
        result[piece] = np.where(known & (at - time[row] <= longest), held, np.nan)
        let_go()
    return result


def is_sampled_and_held(values: np.ndarray) -> bool:
    """Tell whether a signal stays put between updates that are larger than its resolution.

    A quantised but fast sensor repeats values too; its changes are single steps of its resolution.
    """
    step = np.abs(np.diff(values))
    changes = step[step > 0]
    if len(changes) < 10:
        return len(changes) < len(step)
    moving = np.flatnonzero(step > 0)
    inside = step[moving[0] : moving[-1] + 1]
    resolution = float(np.quantile(changes, 0.01))
    return np.mean(inside == 0) > 0.4 and float(np.median(changes)) > 1.5 * resolution


def _cubic_weights(time: np.ndarray, at: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the first of four samples and their Lagrange weights for each row; linear on a very uneven clock."""
    right = np.clip(np.searchsorted(time, at + 1e-6 * period, side="right"), 1, len(time) - 1)
    first = np.clip(right - 2, 0, len(time) - 4)
    nodes = time[first[:, None] + np.arange(4)] - at[:, None]
    weights = np.ones_like(nodes)
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[:, i] *= -nodes[:, j] / (nodes[:, i] - nodes[:, j])
    spacing = np.diff(nodes, axis=1)
    uneven = spacing.max(axis=1) > 4.0 * spacing.min(axis=1)
    if uneven.any():
        place = (right - 1 - first)[uneven]
        rows = np.arange(len(place))
        left, following = nodes[uneven][rows, place], nodes[uneven][rows, place + 1]
        linear = np.zeros((len(place), 4))
        linear[rows, place] = following / (following - left)
        linear[rows, place + 1] = -left / (following - left)
        weights[uneven] = linear
    # A row that falls on a sample takes it: rounding must not leave 1e-10 of its neighbours in it.
    on_sample = np.abs(nodes) < 1e-6 * period
    hit = on_sample.any(axis=1)
    weights[hit] = on_sample[hit]
    return first, weights


def _regression_weights(time: np.ndarray, at: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the first sample and the weights of the local regression for each row, zero-padded on the right."""
    width = _HALF_WIDTH * period
    first = np.searchsorted(time, at - width)
    last = np.searchsorted(time, at + width, side="right")
    count = max(4, int(np.max(last - first)))
    columns = first[:, None] + np.arange(count)
    inside = columns < last[:, None]
    reduced = (time[np.minimum(columns, len(time) - 1)] - at[:, None]) / width
    kernel = 0.42 + 0.5 * np.cos(np.pi * reduced) + 0.08 * np.cos(2.0 * np.pi * reduced)
    kernel = np.where(inside, np.maximum(kernel, 1e-9), 0.0)
    basis = reduced[:, :, None] ** np.arange(4)
    weighted = basis * kernel[:, :, None]
    moments = np.einsum("nki,nkj->nij", weighted, basis)
    moments += 1e-13 * np.trace(moments, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    # Where a clock lost most of its window a cubic through what is left would be ill-posed: interpolate there.
    sparse = inside.sum(axis=1) < 6
    moments[sparse] = np.eye(4)
    unit = np.zeros((len(moments), 4, 1))
    unit[:, 0] = 1.0
    weights = np.einsum("nki,ni->nk", weighted, np.linalg.solve(moments, unit)[:, :, 0])
    if sparse.any():
        first = first.copy()
        first[sparse], four = _cubic_weights(time, at[sparse], period)
        weights[sparse] = 0.0
        weights[np.flatnonzero(sparse)[:, None], np.arange(4)] = four
    return first, weights


class _NoiseOfWeights:
    """Sums the products of the weights of rows some lags apart: the covariance that white noise would get."""

    def __init__(self) -> None:
        self.sums = np.zeros(_LONGEST_LAG + 1)
        self.counts = np.zeros(_LONGEST_LAG + 1)

    def add(self, first: np.ndarray, weights: np.ndarray) -> None:
        if self.counts[0] > _ENOUGH_ROWS:
            return
        stride = max(1, len(first) // 2000)
        for lag in range(min(_LONGEST_LAG + 1, len(first))):
            a = np.arange(0, len(first) - lag, stride)
            shift = (first[a + lag] - first[a])[:, None]
            columns = np.arange(weights.shape[1])[None, :] - shift
            overlap = (columns >= 0) & (columns < weights.shape[1])
            other = np.take_along_axis(weights[a + lag], np.clip(columns, 0, weights.shape[1] - 1), axis=1)
            self.sums[lag] += np.sum(weights[a] * other * overlap)
            self.counts[lag] += len(a)

    def result(self) -> tuple[float, tuple[float, ...]]:
        if self.counts[0] == 0 or self.sums[0] <= 0:
            return 1.0, (1.0,)
        covariance = self.sums / np.maximum(self.counts, 1)
        correlation = covariance / covariance[0]
        significant = np.flatnonzero(np.abs(correlation) > 1e-3)
        return float(np.sqrt(covariance[0])), tuple(float(round(c, 6)) for c in correlation[: significant[-1] + 1])
