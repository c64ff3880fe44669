"""Lines in the spectrum of the residuals, over time and over distance: oscillations faster than a row.

Vibration of an engine, an unbalanced wheel or a gear tooth are no smooth functions of the operating point. They are
spectral lines at a fixed frequency over time, or at a fixed wavelength over distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from split_cli.diagnosis.innovations.effect_to_noise import effect_to_noise
from split_cli.diagnosis.innovations.evidence import ROW_SECONDS, Evidence, integrated
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import Policy, Unnamed
from split_cli.vehicle.effects import Term

#: Numbers of bins of which the median is the noise around a line [1]; the larger median counts. A resonance raises the
#: noise in a narrow band only. The median of 51 bins has a standard error of a fifth, 1/(sqrt(51) ln 2).
_BACKGROUNDS = (201, 51)
_CHANNELS = ("v_x", "v_y", "r")
#: Whitened samples are clipped at so many standard deviations [1], since a jump of a sensor is no line. Judgement.
_LARGEST = 6.0
#: Frequencies, as shares of a line's, at which a line of the simulation is the same one [1]. Judgement: within 2 %.
_SAME = np.linspace(0.98, 1.02, 9)
#: Frequencies, as shares of a line's, at which the noise around it is measured [1]. Judgement: near, but clear of it.
_AROUND = (0.86, 0.89, 0.92, 0.95, 1.05, 1.08, 1.11, 1.14)


@dataclass(frozen=True)
class Line:
    """One line in a spectrum: a sinusoidal rate."""

    over: str  # ``time`` or ``distance``
    frequency: float  # [Hz] or [1/m]
    channel: str  # v_x, v_y or r
    amplitude: float  # of its rate, [m/s^2] or [rad/s^2]
    # Largest effect-to-noise ratio over the channels [1].
    effect_to_noise: float
    p_value: float  # of so strong a line in noise, corrected for the number of frequencies and channels

    def like(self, other: Line) -> float:
        """Return another line's amplitude if it is of the same channel and over the same variable, else 0."""
        return other.amplitude if (other.channel, other.over) == (self.channel, self.over) else 0.0

    def in_words(self) -> str:
        """Return the oscillating rate, its amplitude and its frequency or wavelength, in words."""
        unit = "rad/s^2" if self.channel == "r" else "m/s^2"
        often = f"at {self.frequency:.3g} Hz" if self.over == "time" else f"every {1 / self.frequency:.3g} m"
        return f"{self.channel}' oscillates by {self.amplitude:.2g} {unit} {often}"


def strongest_line(
    objective: MarginalLikelihood, terms: Sequence[Term], simulated: Sequence[Evidence] = ()
) -> Line | None:
    """Return the most significant line in the residuals of the real recordings that simulations do not show; or None.

    Notes
    -----
    Periodograms of whitened samples over their running median: a ratio above x ln 2 has probability exp(-x) in noise of
    any smooth spectrum (Brockwell and Davis, 1991, section 10.2). Only compared samples are used, and only up to the
    largest speed of the simulations: vibration grows with speed, so that a slower drive need not show it.
    """
    policy = objective.policy
    fastest = max((float(one.series.smooth[:, 0].max()) for one in simulated), default=np.inf)
    real = [
        _Remainder(one, _left(objective, one, terms), _compared(one, rows, fastest), policy)
        for one, rows in zip(objective.evidence, objective.keep, strict=True)
    ]
    lines = sorted(((line, one) for one in real for line in _lines(one)), key=lambda found: found[0].p_value)
    # If the simulation has lines too, another line of similar amplitude is no difference.
    others = [
        _Remainder(one, _left(objective, one, ()), np.ones(len(one.series) - 1, dtype=bool), policy)
        for one in (simulated if lines else ())
    ]
    # Resonances of the simulation count as lines, since a line in reality may be one.
    own = [line for other in others for line in _lines(other, _BACKGROUNDS[:1])]
    margin, common = policy.self_test.unnamed_margin, []
    for line, one in lines:
        if any(_is_one_swing(line, other, one) for other in common):
            continue
        here, there = _block_by_block(line, one, others) if others else (np.inf, 0.0)
        if line.amplitude > margin * max(map(line.like, own), default=0.0) and here > margin * there:
            return line
        common.append(line)
    return None


def _is_one_swing(line: Line, other: Line, asked: _Remainder) -> bool:
    """Return whether a line over time and one over distance are the same oscillation at a speed of the drive."""
    if line.over == other.over or line.channel != other.channel:
        return False
    over_time, over_distance = (line, other) if line.over == "time" else (other, line)
    speed = asked.one.series.smooth[:-1, 0][asked.used]
    return bool(speed.min() <= over_time.frequency / over_distance.frequency <= speed.max())


@dataclass(frozen=True)
class _Remainder:
    """Defects that terms leave of one recording, and the transitions that are searched for lines."""

    one: Evidence
    left: np.ndarray  # (N - 1, 3): defects [m/s], [m/s], [rad/s]
    used: np.ndarray  # bool (N - 1,): transitions that are searched
    policy: Policy


def _left(objective: MarginalLikelihood, one: Evidence, terms: Sequence[Term]) -> np.ndarray:
    """Return the defects that terms and discrepancy leave, (N - 1, 3); 0 where wheels spin or lock."""
    known = objective.posterior
    left = one.defects(terms, None if known is None else objective.discrepancy.rates(one.series, known.weights, terms))
    left[~one.rolls[1:]] = 0.0
    return left


def _compared(one: Evidence, rows: np.ndarray, fastest: float) -> np.ndarray:
    """Return the transitions of compared rows (G,) that are no faster than `fastest` [m/s], bool (N - 1,)."""
    group = one.whitener.group
    return (group >= 0) & rows[group] & (one.series.smooth[:-1, 0] <= fastest)


def _lines(asked: _Remainder, backgrounds: Sequence[int] = _BACKGROUNDS) -> list[Line]:
    """Return the strongest line of each channel, over time and over distance, in the used transitions."""
    one, policy = asked.one, asked.policy
    if asked.used.sum() < policy.unnamed.fewest:
        return []
    white = one.whitener.of_every_sample()(asked.left)
    white = np.clip(white, -_LARGEST, _LARGEST) * asked.used[:, None]
    found = []
    for over in ("time", "distance"):
        clock = _clock(one, over)
        step = (clock[-1] - clock[0]) / (len(clock) - 1)
        grid = clock[0] + step * np.arange(len(clock))
        even = white if over == "time" else np.stack([np.interp(grid, clock, row) for row in white.T], axis=1)
        power = np.abs(np.fft.rfft(even * np.hanning(len(even))[:, None], axis=0)) ** 2
        frequency = np.fft.rfftfreq(len(even), step)
        medians = [median_filter(power, size=(bins, 1), mode="reflect") for bins in backgrounds]
        ratio = power / (np.max(medians, axis=0) / np.log(2.0) + 1e-300)
        allowed = _fast_enough(one, over, frequency, policy.unnamed)
        count = max(3 * int(allowed.sum()), 1)
        for channel in range(3):
            strength = np.where(allowed, ratio[:, channel], 0.0)
            peak = int(np.argmax(strength))
            p_value = float(min(1.0, 2.0 * count * np.exp(-strength[peak])))
            if p_value < policy.comparison.level:
                amplitude, size = _size(asked, over, float(frequency[peak]), channel)
                found.append(Line(over, float(frequency[peak]), _CHANNELS[channel], amplitude, size, p_value))
    return found


def _clock(one: Evidence, over: str) -> np.ndarray:
    """Return time [s] or distance travelled [m] at each transition, shape (N - 1,)."""
    if over == "time":
        return one.series.t[:-1]
    return np.cumsum(np.maximum(one.series.smooth[:-1, 0], 0.0)) * one.series.period


def _fast_enough(one: Evidence, over: str, frequency: np.ndarray, rules: Unnamed) -> np.ndarray:
    """Return which frequencies are too fast for a driver or the track, and still resolved, bool."""
    wheelbase = one.vehicle.wheelbase
    if over == "time":
        return frequency > rules.slowest * np.sqrt(2.7 / wheelbase)
    # Waves shorter than three samples at high speed are not resolved evenly.
    shortest = 3.0 * float(np.quantile(one.series.smooth[:, 0], 0.9)) * one.series.period
    return (frequency > 1.0 / (rules.longest * wheelbase)) & (frequency < 1.0 / shortest)


def _size(asked: _Remainder, over: str, frequency: float, channel: int) -> tuple[float, float]:
    """Return the amplitude of a line's rate and its effect-to-noise ratio, by whitened least squares."""
    columns, offered, left = _swing(asked, over, frequency, channel)
    weights = np.linalg.lstsq(offered.reshape(-1, 2), left.reshape(-1), rcond=None)[0]
    return float(np.hypot(*weights)), effect_to_noise(asked.one.series, columns @ weights)


def _swing(asked: _Remainder, over: str, frequency: float, channel: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return defects by sine and cosine of a rate, (N - 1, 3, 2); these, and the residuals, whitened and searched."""
    clock, one = _clock(asked.one, over), asked.one
    angle = 2.0 * np.pi * frequency * np.append(clock, clock[-1])
    rates = np.zeros((len(angle), 3, 2))
    rates[:, channel, 0], rates[:, channel, 1] = np.sin(angle), np.cos(angle)
    columns, whiten = integrated(one.series, rates, one.linear), one.whitener.of_every_sample()
    return columns, whiten(columns)[asked.used], whiten(asked.left)[asked.used]


def _block_by_block(line: Line, asked: _Remainder, others: Sequence[_Remainder]) -> tuple[float, float]:
    """Return the amplitudes of a line's rate in a recording and in `others`, with a phase for each block of time.

    Vibration grows with speed and may occur in a few blocks only. So each block of the recording is compared with that
    block of the others whose speed is nearest. If all are slower, its amplitude is scaled to the speed.

    Notes
    -----
    The force of an unbalanced mass grows with the square of its rotational speed.
    """
    speed, square = _blocks(line, asked)
    found = [_blocks(line, other) for other in others]
    speeds, squares = (np.concatenate([one[k] for one in found]) for k in (0, 1))
    nearest = np.argmin(np.abs(speed[:, None] - speeds), axis=1)
    there = squares[nearest] * np.maximum(speed / max(float(speeds.max()), 1e-9), 1.0) ** 4
    return float(np.sqrt(max(np.mean(square), 0.0))), float(np.sqrt(max(np.mean(there), 0.0)))


def _blocks(line: Line, asked: _Remainder) -> tuple[np.ndarray, np.ndarray]:
    """Return the speed of each block [m/s] and the square of a line's amplitude there, both (B,).

    Notes
    -----
    Blocks have equal numbers of used samples, in order of time. The squares are taken at that of the frequencies
    `_SAME` with the largest mean, less the noise at the frequencies `_AROUND`.
    """
    series, used = asked.one.series, int(asked.used.sum())
    count = max(1, int(used * series.period / (asked.policy.comparison.least_rows * ROW_SECONDS)))
    block = np.arange(used) * count // used
    speed = np.bincount(block, series.smooth[:-1, 0][asked.used]) / np.bincount(block)

    def squares(share: float) -> np.ndarray:
        _, offered, left = _swing(asked, line.over, share * line.frequency, _CHANNELS.index(line.channel))
        normal, right = np.zeros((count, 2, 2)), np.zeros((count, 2))
        np.add.at(normal, block, np.einsum("nci,ncj->nij", offered, offered))
        np.add.at(right, block, np.einsum("nci,nc->ni", offered, left))
        return np.sum(np.einsum("bij,bj->bi", np.linalg.pinv(normal), right) ** 2, axis=1)

    around = np.median([squares(share) for share in _AROUND], axis=0)
    return speed, max(map(squares, _SAME), key=np.mean) - around
