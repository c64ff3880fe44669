"""Integrals and changes of channels over short windows of a recording, compiled, for the search of sensor faults."""

from collections.abc import Sequence

import numpy as np
from numba import njit

LEAST_WINDOWS = 12
"""Least number of windows for a comparison of redundant channels [1]. Judgement: 6 s give a deviation to a fifth."""
_WINDOW_SECONDS, _EDGE_SECONDS = 0.5, 0.1
"""Length of a window, and half the length over which its ends are averaged [s]. Judgement: a car moves in 0.5 s by far
more than the noise of its position, and averaging over 0.2 s reduces that noise."""


def edge_of(period: float) -> int:
    """Return the number of samples by which windows are shifted to either side to average their ends."""
    return max(1, int(round(_EDGE_SECONDS / period)))


def windows_within(segments: Sequence[tuple[int, int]], period: float) -> tuple[np.ndarray, int]:
    """Return the first samples of windows of 0.5 s, int64 (W,), and their length; ends of segments are left free."""
    size, edge = max(4, int(round(_WINDOW_SECONDS / period))), edge_of(period)
    begins = [np.arange(first + edge, end - size - edge, size) for first, end in segments]
    return np.concatenate([*begins, np.zeros(0)]).astype(np.int64), size


def integrals(rate: np.ndarray, begin: np.ndarray, end: np.ndarray, edge: int = 0) -> np.ndarray:
    """Return sums of a rate over windows by the trapezoidal rule, shape (W,), in units of rate times samples.

    Parameters
    ----------
    rate : ndarray, shape (N,)
    begin, end : ndarray of int64, shape (W,)
        First and last row of every window.
    edge : int
        The mean over windows shifted by up to so many samples is returned; shifts stop at the ends of the recording.
    """
    return _integrals(np.ascontiguousarray(rate), begin, end, edge)


def changes(values: np.ndarray, begin: np.ndarray, end: np.ndarray, edge: int) -> np.ndarray:
    """Return the change of values (N,) over windows, shape (W,), in their unit; parameters as of `integrals`."""
    return _changes(np.ascontiguousarray(values), begin, end, edge)


def displacements(
    velocity: np.ndarray, sine: np.ndarray, cosine: np.ndarray, begin: np.ndarray, end: np.ndarray, edge: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements along the world axes X and Y over windows, shape (W,) each, in velocity times samples.

    Parameters
    ----------
    velocity : ndarray, shape (N, 2 or more)
        v_x and v_y in the first columns.
    sine, cosine : ndarray, shape (N,)
        Of the yaw angle.
    begin, end, edge
        As of `integrals`.
    """
    return _displacements(np.ascontiguousarray(velocity), sine, cosine, begin, end, edge)


@njit(cache=True, nogil=True)
def _changes(values, begin, end, edge):
    last = len(values) - 1
    out = np.empty(len(begin))
    for w in range(len(begin)):
        total = 0.0
        for k in range(-edge, edge + 1):
            total += values[min(max(end[w] + k, 0), last)] - values[min(max(begin[w] + k, 0), last)]
        out[w] = total / (2 * edge + 1)
    return out


@njit(cache=True, nogil=True)
def _integrals(rate, begin, end, edge):
    total = np.empty(len(rate))
    total[0] = 0.0
    for k in range(1, len(rate)):
        total[k] = total[k - 1] + 0.5 * (rate[k] + rate[k - 1])
    return _changes(total, begin, end, edge)


@njit(cache=True, nogil=True)
def _displacements(velocity, sine, cosine, begin, end, edge):
    x, y = np.empty(len(velocity)), np.empty(len(velocity))
    for k in range(len(velocity)):
        x[k] = velocity[k, 0] * cosine[k] - velocity[k, 1] * sine[k]
        y[k] = velocity[k, 0] * sine[k] + velocity[k, 1] * cosine[k]
    return _integrals(x, begin, end, edge), _integrals(y, begin, end, edge)
