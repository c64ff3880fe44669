"""Sensor noise from differences at full rate, and what remains of it on the drive's clock."""

from math import comb

import numpy as np

from split_cli.logs.drive import NoiseEstimate
from split_cli.logs.scratch import PIECE

HELD = "held between updates"
"""Why there is no estimate of a channel that keeps its value until the next sample."""
_ORDERS = (3, 4, 5, 6)


def difference_noise(values: np.ndarray, runs: list[tuple[int, int]], order: int = 3) -> float:
    """Return the standard deviation of white noise that differences of an order show, robustly.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Evenly spaced samples.
    runs : list of (int, int)
        [start, end) of stretches without a gap.
    order : int
        Of the difference; 3 cancels everything that is a parabola over four samples.

    Notes
    -----
    The variance of the k-th difference of white noise is binomial(2k, k) times that of the noise. The median
    absolute value is taken, so that a few jolts do not count as noise.
    """
    parts = [np.diff(values[a:b], n=order) for a, b in runs if b - a > order]
    if not parts:
        return float("nan")
    differences = np.abs(np.concatenate(parts))
    return 1.4826 * float(np.median(differences)) / float(np.sqrt(comb(2 * order, order)))


def estimate_noise(
    channel: str,
    values: np.ndarray,
    runs: list[tuple[int, int]],
    *,
    gain: float = 1.0,
    autocorrelation: tuple[float, ...] = (1.0,),
) -> NoiseEstimate:
    """Estimate the noise of a channel at full rate and on the drive's clock.

    Parameters
    ----------
    values : ndarray, shape (N,)
        At full rate, SI.
    runs : list of (int, int)
        Stretches without a gap.
    gain, autocorrelation
        Of the filter, as `resample_together` gives them.

    Returns
    -------
    NoiseEstimate
        ``sigma`` is None, with the reason, where differences show something else than noise: resolution steps,
        held samples, or motion that the sample rate only just resolves. A signal without noise has sigma 0.
    """
    if sum(b - a for a, b in runs) < 50:
        return NoiseEstimate(channel, None, None, reason="fewer than 50 samples without a gap")
    span = float(np.max(values) - np.min(values))
    if span == 0.0:
        return NoiseEstimate(channel, None, None, reason="constant")
    unchanged = float(np.mean(np.diff(values) == 0.0))
    sigmas = [difference_noise(values, runs, order) for order in _ORDERS]
    sigma = sigmas[0]
    if unchanged > 0.35:
        return NoiseEstimate(
            channel, None, None, reason=f"{100.0 * unchanged:.0f} % of the samples repeat the one before"
        )
    step = resolution(values)
    if step is not None and sigma < 0.5 * step:
        return NoiseEstimate(channel, None, None, reason=f"recorded in steps of {step:.3g}, coarser than its noise")
    # White noise reads the same in differences of every order; motion fades by the squared ratio of its
    # frequency to the sample rate with each order. The highest order has seen the least of it.
    if sigmas[-1] < 0.6 * sigma:
        sigma = sigmas[-1]
        still_fading = sigmas[-1] < 0.8 * sigmas[-2]
        if sigma < 1e-9 * span:
            sigma = 0.0
        elif still_fading and sigma > 1e-5 * span:
            return NoiseEstimate(
                channel,
                None,
                None,
                reason="differences fade with their order: motion or a filter, not noise "
                f"(below {sigma:.2g} if there is any)",
            )
        elif still_fading:
            sigma = 0.0
    return NoiseEstimate(channel, float(sigma * gain), float(sigma), autocorrelation)


def sum_of_noise(channel: str, parts: list[NoiseEstimate]) -> NoiseEstimate:
    """Return the noise of a sum of independent sources; the autocorrelation weighted by variance."""
    unknown = next((part for part in parts if part.sigma is None), None)
    if unknown is not None:
        return NoiseEstimate(channel, None, None, reason=unknown.reason)
    if len(parts) == 1:
        return parts[0]
    variance = sum(part.sigma**2 for part in parts)
    raw = sum(part.sigma_raw**2 for part in parts)
    longest = max(len(part.autocorrelation) for part in parts)
    mixed = np.zeros(longest)
    for part in parts:
        weight = part.sigma**2 / variance if variance > 0 else 1.0 / len(parts)
        mixed[: len(part.autocorrelation)] += weight * np.asarray(part.autocorrelation)
    return NoiseEstimate(channel, float(np.sqrt(variance)), float(np.sqrt(raw)), tuple(mixed.tolist()))


def resolution(values: np.ndarray) -> float | None:
    """Return the step a signal is recorded in, None when its steps have no common unit.

    At most one in ten of the distinct steps of an unquantised signal is shared; of a quantised one nearly all.
    """
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0]
    if len(steps) < 20:
        return None
    smallest = float(np.quantile(steps, 0.02))
    small = multiples = 0
    for first in range(0, len(steps), PIECE):  # a long recording has no room for all ratios at once
        ratio = steps[first : first + PIECE] / smallest
        ratio = ratio[ratio < 20]
        small += len(ratio)
        multiples += np.count_nonzero(np.abs(ratio - np.round(ratio)) < 0.02 * np.maximum(1.0, 0.2 * ratio))
    return smallest if multiples > 0.9 * small else None
