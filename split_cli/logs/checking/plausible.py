"""What no car on wheels reaches, and samples so far beyond all others that they are damaged."""

import numpy as np

NO_CAR_EXCEEDS = {
    "vx": (130.0, "m/s"),
    "r": (15.0, "rad/s"),
    "delta": (1.3, "rad"),
    "ax": (70.0, "m/s^2"),
    "ay": (70.0, "m/s^2"),
}
"""99 % quantiles of |channel| that no car on wheels reaches, from 1:43 models to dragsters."""
DAMAGED = 10.0
"""Times the 90 % quantile of a channel, beyond which a few samples are damaged, not moved [1]; judgement."""
_FARTHEST = 1e5
"""From the middle of a drive, beyond which and far beyond all others a position is none [m]; judgement:
no drive leads that far."""
_BODY = ("vx", "r")
"""What the car's inertia keeps from jumping; accelerometers do reach more, by vibration."""


def reach_of(values: np.ndarray, raw: np.ndarray) -> float:
    """Return the 99 % quantile of |values|; where damaged samples make it, the 90 % quantile of |raw|.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Smoothed.
    raw : ndarray, shape (N,)
        The same as recorded: smoothing spreads what is damaged over its neighbours.

    Notes
    -----
    What stands far out of nearly all samples is damaged; a wrong unit changes all of them.
    """
    most, reach = float(np.nanquantile(np.abs(raw), 0.9)), float(np.nanquantile(np.abs(values), 0.99))
    return most if most > 0.0 and reach > DAMAGED * most else reach


def is_damaged(channel: str, values: np.ndarray) -> np.ndarray:
    """Return which samples no car reaches, though nearly all others are far below, shape (N,).

    Parameters
    ----------
    channel : str
        Only motion of the body and its position are judged.
    values : ndarray, shape (N,)
        SI, finite.
    """
    if channel not in (*_BODY, "X", "Y") or not len(values):
        return np.zeros(len(values), dtype=bool)
    if channel in ("X", "Y"):
        size = np.abs(values - np.median(values))
        return size > max(_FARTHEST, DAMAGED * float(np.quantile(size, 0.9)))
    size = np.abs(values)
    return size > max(NO_CAR_EXCEEDS[channel][0], DAMAGED * float(np.quantile(size, 0.9)))
