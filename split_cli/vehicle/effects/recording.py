"""Lags, delays and play along a whole recording, solved exactly between its samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from split_cli.compiled_code import compiled

__all__ = [
    "Handover",
    "KnownResults",
    "Recording",
    "first_order_from_means",
    "first_order_response",
    "over_samples",
    "play_response",
    "shifted",
]


@dataclass(frozen=True)
class Handover:
    """What terms remember where one piece of a recording ends and the next one begins."""

    row: int  # row of this piece at which the next one begins
    entering: Mapping[str, float]  # states at row 0; one that is not named begins steady
    leaving: dict[str, float] = field(default_factory=dict)  # states at `row`, filled while the piece is evaluated


class KnownResults:
    """Results for arrays that were given before: several models along one recording ask for much of the same.

    It holds all arrays that it was given, so it is made for a few models and cleared after them.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[Any, ...], tuple[tuple[Any, ...], Any]] = {}

    def clear(self) -> None:
        """Let go of all: a recording that is among what was given holds these results in turn."""
        self._known.clear()

    def __call__(self, made: Callable[..., Any], *given: Any) -> Any:
        """Return what is made of these very objects, which are not altered: as it was before, or made now."""
        key = (made, *(one if isinstance(one, float) else id(one) for one in given))
        if key not in self._known:
            # The objects are kept beside the result, so that no others can come to have their ids.
            self._known[key] = given, made(*given)
        return self._known[key][1]


@dataclass(frozen=True)
class Recording:
    """The clock of a recording that the model is evaluated along."""

    period: float  # sample period [s]
    # First row and one past the last, of every run without a gap; memory starts anew, steady, at each.
    segments: tuple[tuple[int, int], ...]
    # Whether the rows are means over the sample that begins there, instead of values at its begin.
    means: bool = False
    # Where the rows are a piece of a longer recording. The response is then the whole recording's, to the bit.
    # Shifts do not cross the piece's begin.
    memory: Handover | None = None
    # While several models are evaluated at the same arrays: what one has worked out, the next takes from there.
    known: KnownResults | None = field(default=None, compare=False)

    @classmethod
    def single(cls, period: float, length: int) -> Recording:
        """Return the clock of one run of `length` samples."""
        return cls(period, ((0, length),))


def shifted(source: Any, delay: float, recording: Recording) -> np.ndarray:
    """Return a recorded series as it was `delay` [s] before; linear between samples, held before the start.

    A negative delay looks ahead and holds the last value.
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
    """Return a recorded series as it was `delay` [s] before, by the phase of its spectrum, segment by segment.

    No frequency is damped, as `shifted` damps high ones between samples, so white noise stays white. A segment's
    ends meet.
    """
    values: np.ndarray = np.asarray(source, dtype=float)
    out = np.empty_like(values)
    for begin, end in recording.segments:
        turns = np.fft.rfftfreq(end - begin) * (delay / recording.period)
        spectrum = np.fft.rfft(values[begin:end]) * np.exp(-2j * np.pi * turns)
        out[begin:end] = np.fft.irfft(spectrum, end - begin)
    return out


def first_order_response(target: Any, rate: Any, recording: Recording, name: str = "") -> np.ndarray:
    """Return y with y' = rate (target - y), y steady at each start, exact for targets linear between samples.

    Parameters
    ----------
    target : array, shape (N,)
    rate : float or array of shape (N,)
        [1/s], not negative; taken as its mean over a sample.
    name : str
        By which the recording's memory, if it has one, knows y.

    Notes
    -----
    Over one sample with q = rate period: y+ = e^-q y + (1 - e^-q) u + (1 - (1 - e^-q)/q) (u+ - u).
    """
    if recording.known is not None and recording.memory is None:
        known: np.ndarray = recording.known(_response, target, rate, recording)
        return known
    return _response(target, rate, recording, name)


def _response(target: Any, rate: Any, recording: Recording, name: str = "") -> np.ndarray:
    target = np.ascontiguousarray(target, dtype=float)
    kept, mean = _weights(rate, recording) if recording.known is None else recording.known(_weights, rate, recording)
    kept, mean = (np.broadcast_to(one, (max(len(target) - 1, 0),)) for one in (kept, mean))
    return _recur(target, kept, mean, recording, _kept_as(name, recording))


def _weights(rate: Any, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return e^-q and (1 - e^-q)/q of each sample but the last, or of all together for one rate."""
    rate = np.asarray(rate, dtype=float)
    between = rate if rate.ndim == 0 else 0.5 * (rate[1:] + rate[:-1])
    q = np.maximum(between * recording.period, 0.0)
    kept = np.exp(-q)
    # (1 - e^-q)/q without cancellation at q near 0.
    return kept, np.where(q > 1e-8, -np.expm1(-q) / np.maximum(q, 1e-8), 1.0 - 0.5 * q)


def first_order_from_means(target: Any, rate: Any, recording: Recording, name: str = "") -> np.ndarray:
    """Return y at the begin of every sample, of targets (N,) given by their means over samples; steady at starts.

    Notes
    -----
    y+ = e^-q y + (1 - e^-q) u with q = rate period: exact where the target is constant over each sample, as a held
    command is.
    """
    target = np.ascontiguousarray(target, dtype=float)
    rate = np.broadcast_to(np.asarray(rate, dtype=float), target.shape)[:-1]
    kept = np.exp(-np.maximum(rate * recording.period, 0.0))
    # Means of 1 take the slope between rows out of the recursion for straight lines.
    return _recur(target, kept, np.ones_like(kept), recording, f"{name} at the begin")


def over_samples(values: np.ndarray, recording: Recording) -> np.ndarray:
    """Return the mean over the sample that begins at each row, of straight lines between rows, shape as `values`.

    The last row of a segment begins no sample; it keeps its value.
    """
    out = np.array(values, dtype=float)
    out[:-1] += 0.5 * np.diff(values, axis=0)
    for _, end in recording.segments:
        out[end - 1] = values[end - 1]
    return out


def play_response(source: Any, width: float, recording: Recording, name: str = "") -> np.ndarray:
    """Return what a play of total `width` lets through: y+ = clip(y, u+ - width/2, u+ + width/2).

    It is centred at each start.
    """
    source = np.ascontiguousarray(source, dtype=float)
    half, starts = 0.5 * float(width), _starts(recording)
    return _continued(lambda begin: _kernels()[1](source, half, starts, begin), recording, _kept_as(name, recording))


def _kept_as(name: str, recording: Recording) -> str:
    """Return a state's name in the memory: a held recording is followed both by values and by means."""
    return f"{name} of {'means' if recording.means else 'values'}"


def _starts(recording: Recording) -> np.ndarray:
    return np.array([begin for begin, _ in recording.segments], dtype=np.int64)


def _recur(target: np.ndarray, kept: np.ndarray, mean: np.ndarray, recording: Recording, name: str) -> np.ndarray:
    return _continued(lambda begin: _kernels()[0](target, kept, mean, _starts(recording), begin), recording, name)


def _continued(run: Callable[[float], np.ndarray], recording: Recording, name: str) -> np.ndarray:
    """Return what `run` makes of the state a piece begins with (NaN: steady), and keep what the next needs."""
    memory = recording.memory
    if memory is None:
        return run(np.nan)
    out = run(memory.entering.get(name, np.nan))
    memory.leaving[name] = float(out[memory.row])
    return out


@lru_cache(maxsize=1)
def _kernels() -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """Compile the two recursions on first use; numba is not worth loading for models without memory."""

    @compiled(cache=True, nogil=True)
    def recur(target: np.ndarray, kept: np.ndarray, mean: np.ndarray, starts: np.ndarray, begin: float) -> np.ndarray:
        out = np.empty_like(target)
        for number in range(len(starts)):
            first = starts[number]
            last = starts[number + 1] if number + 1 < len(starts) else len(target)
            y = begin if first == 0 and not np.isnan(begin) else target[first]
            out[first] = y
            # Without a branch, all but one product and one sum of a row is worked out ahead of y.
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
