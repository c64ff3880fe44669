"""Moving means within the segments of a drive, so that nothing is averaged across a gap."""

import numpy as np

from split_cli.logs.drive import Drive

SMOOTHED_SECONDS = 0.2  # over which samples are averaged before they are compared


def smoothed(drive: Drive, values: np.ndarray) -> np.ndarray:
    """Return the centred moving mean of values, shape (N,), over 0.2 s."""
    return moving_mean_by_segment(drive, values, _width(drive))


def less_slow_part(drive: Drive, values: np.ndarray, seconds: float) -> np.ndarray:
    """Return values, shape (N,), less their centred moving mean over so many seconds: their fast part."""
    return values - moving_mean_by_segment(drive, values, max(3, round(seconds / drive.period)))


def moving_mean_by_segment(drive: Drive, values: np.ndarray, width: int) -> np.ndarray:
    """Return the centred moving mean of values, shape (N,), over `width` samples; ends continue their last value."""
    from scipy.ndimage import uniform_filter1d

    out = np.array(values, dtype=float)
    for run in drive.segments():
        out[run] = uniform_filter1d(out[run], width, mode="nearest")
    return out


def away_from_ends(drive: Drive) -> np.ndarray:
    """Return which samples are further from both ends of their segment than `smoothed` reaches, bool (N,)."""
    inner, width = np.zeros(len(drive), dtype=bool), _width(drive)
    for run in drive.segments():
        inner[run.start + width : max(run.stop - width, run.start + width)] = True
    return inner


def _width(drive: Drive) -> int:
    return max(3, int(round(SMOOTHED_SECONDS / drive.period)))
