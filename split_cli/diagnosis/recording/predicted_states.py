"""States of a recording for evaluating a model: each sample as earlier samples predict it, and smoothed channels.

A model is evaluated at states that earlier samples predict. A smoothed state contains the noise of later samples, by
which the model is judged. A flexible correction would then follow that noise and learn too little damping. For a model
that is evaluated in the middle of a sample this is the drift term of Onsager and Machlup (1953).

Whitened innovations are summed over rows of several samples. So a state within a row may not contain the noise of the
row's other samples either, by which the row is judged.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from split_cli.vehicle.effects import Recording

#: Lengths of windows that are tried, shortest first [s].
_WINDOWS_SECONDS = (0.05, 0.08, 0.12, 0.18, 0.26, 0.36)
#: Degrees of polynomials through earlier samples that may predict the next one [1].
_DEGREES = (1, 2, 3)
#: Error of a prediction over the noise of a sample, beyond which smoothed states are used [1]: noise is then small
#: beside the motion. Judgement: a late steering makes predictions err by sqrt(2) times the noise, and smoothed states
#: then give too much yaw inertia (docs/decisions/0041-noise-within-rows.md).
_NEGLIGIBLE_NOISE = 3.0
#: A window is too long if what it removes has a deviation above the noise by this factor [1].
_SLACK = 1.04


def smoothed_by_cubics(values: np.ndarray, sigma: float, recording: Recording) -> np.ndarray:
    """Return values, shape (N,), smoothed by local cubics (Savitzky and Golay, 1964) within segments.

    Parameters
    ----------
    sigma : float
        Standard deviation of the noise of a sample. The longest window is taken that removes no more than that.
    """
    from scipy.signal import savgol_filter

    best = values
    for seconds in _WINDOWS_SECONDS:
        length = 2 * int(round(0.5 * seconds / recording.period)) + 1
        if length < 5:
            continue
        trial = values.copy()
        fitted = False
        for begin, end in recording.segments:
            if end - begin > length:
                trial[begin:end] = savgol_filter(values[begin:end], length, 3, mode="interp")
                fitted = True
        if not fitted or np.std(trial - values) > _SLACK * sigma:
            break
        best = trial
    return best


def predicted_channels(
    measured: np.ndarray, smooth: np.ndarray, noise: np.ndarray, recording: Recording, row: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Return `predicted_from_the_past` of every channel, shape (N, 3), and its rms prediction errors, shape (3,).

    Parameters
    ----------
    measured, smooth : ndarray, shape (N, 3)
        v_x, v_y [m/s] and r [rad/s] as recorded, and smoothed.
    noise : ndarray, shape (3,)
        Standard deviation of a sample of each.
    row : int
        Samples of a row.
    """
    columns = zip(measured.T, smooth.T, noise, strict=True)
    found = [predicted_from_the_past(*column, recording, row) for column in columns]
    return np.stack([one for one, _ in found], axis=1), np.array([error for _, error in found])


def predicted_from_the_past(
    values: np.ndarray, smooth: np.ndarray, sigma: float, recording: Recording, row: int = 1
) -> tuple[np.ndarray, float]:
    """Return each sample, shape (N,), as a polynomial through samples before its row predicts it, and the rms error.

    Window and degree are those with the smallest error. The smoothed value is kept where a segment begins. It is kept
    everywhere if every prediction errs by `_NEGLIGIBLE_NOISE` times the noise or more.

    Parameters
    ----------
    row : int
        Samples of a row. The first row begins with the segment, and the sample at which a row begins is known.
    """
    best, least = smooth, _NEGLIGIBLE_NOISE * sigma
    for seconds in _WINDOWS_SECONDS:
        length = int(round(seconds / recording.period))
        for degree in (one for one in _DEGREES if one < length):
            fitted = np.linalg.pinv(np.vander(np.arange(1 - length, 1) / length, degree + 1, increasing=True))
            # Of the samples of a row, one column each.
            weights = (np.vander(np.arange(1, row + 1) / length, degree + 1, increasing=True) @ fitted).T
            trial, known = smooth.copy(), np.zeros(len(values), dtype=bool)
            for begin, end in recording.segments:
                first = row * -(-(length - 1) // row)  # begin of the first row with a whole window up to it
                if end - begin > first + 1:
                    windows = sliding_window_view(values[begin:end], length)[first - (length - 1) :: row]
                    trial[begin + first + 1 : end] = (windows @ weights).ravel()[: end - begin - first - 1]
                    known[begin + first + 1 : end] = True
            error = float(np.sqrt(np.mean((values - trial)[known] ** 2))) if known.any() else np.inf
            if error < least:
                best, least = trial, error
    return best, least
