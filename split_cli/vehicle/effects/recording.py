"""Responses of first-order lags, delays and play to a recorded signal, in closed form from sample to sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from split_cli.compiled_code import compiled

__all__ = [
    "Handover",
    "Recording",
    "ResultCache",
    "first_order_from_means",
    "first_order_response",
    "over_samples",
    "play_response",
    "shifted",
]


@dataclass(frozen=True)
class Handover:
    """States of the terms at the seam of two pieces of a recording, so that pieces give what the whole gives."""

    row: int  # row of this piece at which the next one begins
    entering: Mapping[str, float]  # states at row 0; one that is not named begins in steady state
    leaving: dict[str, float] = field(default_factory=dict)  # states at `row`, filled while the piece is evaluated


class ResultCache:
    """Cache of function results, keyed by the identity of the arguments, for several models of one recording.

    It keeps every argument alive, so it is made for a few models and cleared after them.
    """

    def __init__(self) -> None:
        self._results: dict[tuple[Any, ...], tuple[tuple[Any, ...], Any]] = {}

    def clear(self) -> None:
        """Drop all results and arguments: a recording among the arguments refers to this cache in turn."""
        self._results.clear()

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return ``function(*arguments)``, computed once for these very objects, which nobody may alter."""
        key = (function, *(one if isinstance(one, float) else id(one) for one in arguments))
        if key not in self._results:
            # The arguments are kept beside the result, so that no other object can come to have their ids.
            self._results[key] = arguments, function(*arguments)
        return self._results[key][1]


@dataclass(frozen=True)
class Recording:
    """Time base of a recording along which a model is evaluated: sample period and stretches without a gap."""

    period: float  # sample period [s]
    # (first row, one past the last) of every stretch without a gap; states start in steady state at each.
    segments: tuple[tuple[int, int], ...]
    # Whether row k is the mean over the sample period that begins at k, instead of the value at its begin.
    means: bool = False
    # Given where the rows are a piece of a longer recording: the response then equals that of the whole, bit by bit.
    # Shifts in time do not reach across the begin of the piece.
    memory: Handover | None = None
    # Given while several models are evaluated with the same arrays: they share results.
    cache: ResultCache | None = field(default=None, compare=False)

    @classmethod
    def single(cls, period: float, length: int) -> Recording:
        """Return the time base of `length` samples without a gap."""
        return cls(period, ((0, length),))


def shifted(source: Any, delay: float, recording: Recording) -> np.ndarray:
    """Return x(t - delay) of a recorded series x, shape (N,), with `delay` in s; linear between samples.

    Before the start of a segment its first value holds. A negative delay looks ahead and holds the last value.
    """
    values: np.ndarray = np.asarray(source, dtype=float)
    out = np.empty_like(values)
    offset = delay / recording.period
    for begin, end in recording.segments:
        rows = np.clip(np.arange(begin, end) - offset, begin, end - 1)
        left = np.minimum(rows.astype(np.int64), max(end - 2, begin))
        share = rows - left
        right = np.minimum(left + 1, end - 1)
        out[begin:end] = (1.0 - share) * values[left] + share * values[right]
    return out


def phase_shifted(source: Any, delay: float, recording: Recording) -> np.ndarray:
    """Return x(t - delay) of a recorded series x, shape (N,), with `delay` in s, by the phase of its spectrum.

    Unlike linear interpolation in `shifted`, it damps no frequency, so white noise stays white. Each segment is
    taken as periodic.
    """
    values: np.ndarray = np.asarray(source, dtype=float)
    out = np.empty_like(values)
    for begin, end in recording.segments:
        turns = np.fft.rfftfreq(end - begin) * (delay / recording.period)
        spectrum = np.fft.rfft(values[begin:end]) * np.exp(-2j * np.pi * turns)
        out[begin:end] = np.fft.irfft(spectrum, end - begin)
    return out


def first_order_response(target: Any, rate: Any, recording: Recording, name: str = "") -> np.ndarray:
    """Return y, shape (N,), with y' = rate (target - y) and y = target at the start of each segment.

    Exact for targets that are linear between samples.

    Parameters
    ----------
    target : array, shape (N,)
    rate : float or array of shape (N,)
        [1/s], not negative; the mean of a sample's two ends is taken.
    name : str
        Name of the state y in `Recording.memory`, where there is one.

    Notes
    -----
    Over one sample with q = rate period: y+ = e^-q y + (1 - e^-q) u + (1 - (1 - e^-q)/q) (u+ - u).
    """
    if recording.cache is not None and recording.memory is None:
        cached: np.ndarray = recording.cache(_response, target, rate, recording)
        return cached
    return _response(target, rate, recording, name)


def _response(target: Any, rate: Any, recording: Recording, name: str = "") -> np.ndarray:
    target = np.ascontiguousarray(target, dtype=float)
    kept, mean = _weights(rate, recording) if recording.cache is None else recording.cache(_weights, rate, recording)
    kept, mean = (np.broadcast_to(one, (max(len(target) - 1, 0),)) for one in (kept, mean))
    return _recur(target, kept, mean, recording, _kept_as(name, recording))


def _weights(rate: Any, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return e^-q and (1 - e^-q)/q of each sample but the last, or of all together for one rate."""
    rate = np.asarray(rate, dtype=float)
    between = rate if rate.ndim == 0 else 0.5 * (rate[1:] + rate[:-1])
    q = np.maximum(between * recording.period, 0.0)
    # 1 - e^-q without cancellation at q near 0; the exponential is the costly part of a response.
    lost = -np.expm1(-q)
    return 1.0 - lost, np.where(q > 1e-8, lost / np.maximum(q, 1e-8), 1.0 - 0.5 * q)


def first_order_from_means(target: Any, rate: Any, recording: Recording, name: str = "") -> np.ndarray:
    """Return y, shape (N,), at the begin of every sample, of targets (N,) that are means over the samples.

    Notes
    -----
    y+ = e^-q y + (1 - e^-q) u with q = rate period: exact where the target is constant over each sample, as a held
    command is. y = target at the start of each segment.
    """
    target = np.ascontiguousarray(target, dtype=float)
    rate = np.broadcast_to(np.asarray(rate, dtype=float), target.shape)[:-1]
    kept = np.exp(-np.maximum(rate * recording.period, 0.0))
    # With (1 - e^-q)/q set to 1 the last term of `first_order_response`, that of the slope, vanishes.
    return _recur(target, kept, np.ones_like(kept), recording, f"{name} at the begin")


def over_samples(values: np.ndarray, recording: Recording) -> np.ndarray:
    """Return the trapezoidal mean over the sample that begins at each row, shape as `values` (N, ...).

    The last row of a segment begins no sample; it keeps its value.
    """
    out = np.array(values, dtype=float)
    out[:-1] += 0.5 * np.diff(values, axis=0)
    for _, end in recording.segments:
        out[end - 1] = values[end - 1]
    return out


def play_response(source: Any, width: float, recording: Recording, name: str = "") -> np.ndarray:
    """Return the output y, shape (N,), of a play (backlash) operator of total `width`, in the unit of `source` u.

    Notes
    -----
    y+ = clip(y, u+ - width/2, u+ + width/2), centred (y = u) at the start of each segment.
    """
    source = np.ascontiguousarray(source, dtype=float)
    half, starts = 0.5 * float(width), _starts(recording)
    return _continued(lambda begin: _kernels()[1](source, half, starts, begin), recording, _kept_as(name, recording))


def _kept_as(name: str, recording: Recording) -> str:
    """Return a state's name in `Handover`: with means over samples a state is followed by values and by means."""
    return f"{name} of {'means' if recording.means else 'values'}"


def _starts(recording: Recording) -> np.ndarray:
    return np.array([begin for begin, _ in recording.segments], dtype=np.int64)


def _recur(target: np.ndarray, kept: np.ndarray, mean: np.ndarray, recording: Recording, name: str) -> np.ndarray:
    return _continued(lambda begin: _kernels()[0](target, kept, mean, _starts(recording), begin), recording, name)


def _continued(run: Callable[[float], np.ndarray], recording: Recording, name: str) -> np.ndarray:
    """Return ``run(state at row 0)``, NaN for steady state, and store the state at the seam in the handover."""
    memory = recording.memory
    if memory is None:
        return run(np.nan)
    out = run(memory.entering.get(name, np.nan))
    memory.leaving[name] = float(out[memory.row])
    return out


@lru_cache(maxsize=1)
def _kernels() -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """Compile the recursions of lag and play on first use, since loading numba takes time."""

    @compiled(cache=True, nogil=True)
    def recur(target: np.ndarray, kept: np.ndarray, mean: np.ndarray, starts: np.ndarray, begin: float) -> np.ndarray:
        out = np.empty_like(target)
        for number in range(len(starts)):
            first = starts[number]
            last = starts[number + 1] if number + 1 < len(starts) else len(target)
            y = begin if first == 0 and not np.isnan(begin) else target[first]
            out[first] = y
            # Free of branches, so that only one product and one sum of a row wait for the last y.
            for k in range(first + 1, last):
                before, stays = target[k - 1], kept[k - 1]
                y = stays * y + ((1.0 - stays) * before + (1.0 - mean[k - 1]) * (target[k] - before))
                out[k] = y
        return out

    @compiled(cache=True, nogil=True)
    def drag(source: np.ndarray, half: float, starts: np.ndarray, begin: float) -> np.ndarray:
        out = np.empty_like(source)
        upcoming = 0
        for k in range(len(source)):
            if upcoming < len(starts) and starts[upcoming] == k:
                out[k] = begin if k == 0 and not np.isnan(begin) else source[k]
                upcoming += 1
            else:
                out[k] = min(max(out[k - 1], source[k] - half), source[k] + half)
        return out

    return recur, drag
