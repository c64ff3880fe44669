"""Lines in the spectrum of what is left, over time and over distance: what swings faster than rows can see.

An engine that shakes, a wheel out of balance and a gear tooth leave no trace in smooth functions of the operating
point. They are lines: over time at a fixed frequency, over distance at a fixed share of a wheel's turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from split_cli.diagnosis.innovations.effect_to_noise import effect_to_noise
from split_cli.diagnosis.innovations.evidence import Evidence, integrated
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import Policy, Unnamed
from split_cli.vehicle.effects import Term

__all__ = ["Line", "strongest_line"]

_BACKGROUND = 201  # bins
_CHANNELS = ("v_x", "v_y", "r")


@dataclass(frozen=True)
class Line:
    """One line."""

    over: str  # ``time`` or ``distance``
    frequency: float  # [Hz] or [1/m]
    channel: str  # v_x, v_y or r
    amplitude: float  # of its rate, [m/s^2] or [rad/s^2]
    # Root mean square of its 0.05 s prediction error over that of sensor noise, in the worst channel.
    effect_to_noise: float
    p_value: float  # of a line as strong as this in noise, all frequencies and channels counted

    def like(self, other: Line) -> float:
        """Return another line's amplitude where it is of the same channel and clock, else 0."""
        return other.amplitude if (other.channel, other.over) == (self.channel, self.over) else 0.0

    def in_words(self) -> str:
        """Return what swings, and how often."""
        unit = "rad/s^2" if self.channel == "r" else "m/s^2"
        often = (
            f"{self.frequency:.3g} times a second" if self.over == "time" else f"every {1 / self.frequency:.3g} m"
        )
        return f"{self.channel}' swings by {self.amplitude:.2g} {unit}, {often}"


def strongest_line(
    objective: MarginalLikelihood, terms: Sequence[Term], simulated: Sequence[Evidence] = ()
) -> Line | None:
    """Return the most significant line that terms leave in the real recordings, and simulations do not show.

    Notes
    -----
    Periodograms of whitened samples over their running median: a ratio above x ln 2 has probability exp(-x) in
    noise of any smooth spectrum (Brockwell and Davis, 1991, section 10.2).
    """
    policy = objective.policy
    lines = [line for one in objective.evidence for line in _lines(one, _left(objective, one, terms), policy)]
    # A simulation that has lines of its own is a recording: another line of their size is no difference.
    own = [line for one in simulated for line in _lines(one, _left(objective, one, ()), policy)] if lines else []
    lines = [
        line
        for line in lines
        if line.amplitude > policy.self_test.unnamed_margin * max(map(line.like, own), default=0.0)
    ]
    for line in sorted(lines, key=lambda line: line.p_value):
        if not any(_shows(objective, one, line) for one in simulated):
            return line
    return None


def _left(objective: MarginalLikelihood, one: Evidence, terms: Sequence[Term]) -> np.ndarray:
    """Return the defects that terms and discrepancy leave, shape (N - 1, 3); 0 where wheels spin or lock."""
    known = objective.posterior
    left = one.left(
        terms, None if known is None else objective.discrepancy.rates(one.series, known.weights, terms)
    )
    left[~one.rolls[1:]] = 0.0
    return left


def _lines(one: Evidence, left: np.ndarray, policy: Policy) -> list[Line]:
    """Return the strongest line of each channel, over time and over distance."""
    if len(left) < policy.unnamed.fewest:
        return []
    white = one.whitener.of_every_sample()(left)
    white = np.clip(white, -6.0, 6.0)
    found = []
    for over in ("time", "distance"):
        clock = _clock(one, over)
        step = (clock[-1] - clock[0]) / (len(clock) - 1)
        grid = clock[0] + step * np.arange(len(clock))
        even = white if over == "time" else np.stack([np.interp(grid, clock, row) for row in white.T], axis=1)
        power = np.abs(np.fft.rfft(even * np.hanning(len(even))[:, None], axis=0)) ** 2
        frequency = np.fft.rfftfreq(len(even), step)
        background = median_filter(power, size=(_BACKGROUND, 1), mode="reflect") / np.log(2.0) + 1e-300
        ratio = power / background
        allowed = _fast_enough(one, over, frequency, policy.unnamed)
        count = max(3 * int(allowed.sum()), 1)
        for channel in range(3):
            strength = np.where(allowed, ratio[:, channel], 0.0)
            peak = int(np.argmax(strength))
            p_value = float(min(1.0, 2.0 * count * np.exp(-strength[peak])))
            if p_value < policy.comparison.level:
                amplitude, size = _size(one, left, clock, float(frequency[peak]), channel)
                found.append(Line(over, float(frequency[peak]), _CHANNELS[channel], amplitude, size, p_value))
    return found


def _clock(one: Evidence, over: str) -> np.ndarray:
    """Return time [s] or the way driven [m] at each transition, shape (N - 1,)."""
    if over == "time":
        return one.series.t[:-1]
    return np.cumsum(np.maximum(one.series.smooth[:-1, 0], 0.0)) * one.series.period


def _fast_enough(one: Evidence, over: str, frequency: np.ndarray, rules: Unnamed) -> np.ndarray:
    wheelbase = one.vehicle.wheelbase
    if over == "time":
        return frequency > rules.slowest * np.sqrt(2.7 / wheelbase)
    # Shorter waves than a few samples at speed are not seen evenly.
    shortest = 3.0 * float(np.quantile(one.series.smooth[:, 0], 0.9)) * one.series.period
    return (frequency > 1.0 / (rules.longest * wheelbase)) & (frequency < 1.0 / shortest)


def _size(
    one: Evidence, left: np.ndarray, clock: np.ndarray, frequency: float, channel: int
) -> tuple[float, float]:
    """Return the amplitude of a line's rate and its effect-to-noise ratio, by whitened least squares."""
    angle = 2.0 * np.pi * frequency * np.append(clock, clock[-1])
    rates = np.zeros((len(angle), 3, 2))
    rates[:, channel, 0], rates[:, channel, 1] = np.sin(angle), np.cos(angle)
    columns = integrated(one.series, rates)
    whiten = one.whitener.of_every_sample()
    offered = whiten(columns).reshape(-1, 2)
    weights = np.linalg.lstsq(offered, whiten(left).reshape(-1), rcond=None)[0]
    return float(np.hypot(*weights)), effect_to_noise(one.series, columns @ weights)


def _shows(objective: MarginalLikelihood, one: Evidence, line: Line) -> bool:
    """Return whether a simulation shows a line there too."""
    left, clock = _left(objective, one, ()), _clock(one, line.over)
    channel = _CHANNELS.index(line.channel)
    nearby = line.frequency * np.linspace(0.98, 1.02, 9)
    return (
        max(_size(one, left, clock, f, channel)[0] for f in nearby)
        > line.amplitude / objective.policy.self_test.unnamed_margin
    )
