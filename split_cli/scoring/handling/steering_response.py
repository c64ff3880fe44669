"""How yaw rate follows the steering over frequency, for a recording and for a model."""

from dataclasses import dataclass

import numpy as np

from split_cli.logs.drive import Drive

WINDOW = 8.0
_LEAST_COHERENCE = 0.6
_HIGHEST = 5.0
_LEAST_INPUT = 1e-3  # of the largest input power: below, the steering says nothing at a frequency
_FEWEST_WINDOWS = 3
_HALF = 1.959964


@dataclass(frozen=True)
class SteeringResponse:
    """Frequency response from road-wheel angle to yaw rate.

    Attributes
    ----------
    frequency : ndarray, shape (F,)
        [Hz], only where steering and yaw rate are coherent.
    gain : ndarray, shape (F,)
        [1/s]
    gain_low, gain_high : ndarray, shape (F,)
        95 % interval.
    phase : ndarray, shape (F,)
        [deg]; negative where yaw rate comes late.
    coherence : ndarray, shape (F,)
    windows : int
        Stretches of 8 s that were averaged.
    """

    frequency: np.ndarray
    gain: np.ndarray
    gain_low: np.ndarray
    gain_high: np.ndarray
    phase: np.ndarray
    coherence: np.ndarray
    windows: int


def steering_response(drive: Drive, minimum_speed: float = 0.0) -> SteeringResponse | None:
    """Return the steering response of a drive, None where fewer than three stretches of 8 s can be averaged.

    Notes
    -----
    H = S_delta,r/S_delta,delta by Welch's method: Hann windows of 8 s inside segments, half overlapping in a
    recording. The random error of |H| is sqrt((1 - c)/(2 n c)) with c the coherence (Bendat and Piersol, Random
    Data). The mean is taken out of each window, so that a circle leaves no leak.
    """
    length = round(WINDOW / drive.period)
    window = np.hanning(length + 1)[:-1]
    power_in, power_out = np.zeros((2, length // 2 + 1))
    cross, count = np.zeros(length // 2 + 1, dtype=complex), 0
    for run in drive.segments():
        for begin in range(run.start, run.stop - length + 1, max(1, length // 2)):
            part = slice(begin, begin + length)
            if drive["vx"][part].min() < minimum_speed:
                continue
            steer, yaw = (
                np.fft.rfft(window * (drive[name][part] - drive[name][part].mean())) for name in ("delta", "r")
            )
            power_in, power_out = power_in + np.abs(steer) ** 2, power_out + np.abs(yaw) ** 2
            cross = cross + np.conj(steer) * yaw
            count += 1
    if count < _FEWEST_WINDOWS or not np.max(power_in) > 0.0:
        return None
    frequency = np.fft.rfftfreq(length, drive.period)
    response = cross / np.maximum(power_in, 1e-300)
    coherence = np.abs(cross) ** 2 / np.maximum(power_in * power_out, 1e-300)
    clear = (frequency >= 1.5 / WINDOW) & (frequency <= min(_HIGHEST, 0.4 / drive.period))
    clear &= (coherence >= _LEAST_COHERENCE) & (power_in > _LEAST_INPUT * power_in.max())
    if not clear.any():
        return None
    gain, coherent = np.abs(response[clear]), coherence[clear]
    half = _HALF * np.sqrt(np.maximum(1.0 - coherent, 0.0) / (2.0 * count * coherent))
    phase = np.degrees(np.unwrap(np.angle(response[clear])))
    return SteeringResponse(
        frequency[clear], gain, gain * np.maximum(1.0 - half, 0.0), gain * (1.0 + half), phase, coherent, count
    )
