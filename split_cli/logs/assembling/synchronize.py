"""Cleaned sources onto one clock: how each is resampled, which rows are covered, what noise is left."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.errors import ClockError, LogError
from split_cli.logs.assembling.clean import CleanSeries, clean_series, may_hold
from split_cli.logs.assembling.conversion import RawSeries
from split_cli.logs.assembling.noise import HELD, estimate_noise, sum_of_noise
from split_cli.logs.assembling.quality import ChannelQuality, source_quality
from split_cli.logs.assembling.resample import (
    HIGHEST_RATE,
    Resampled,
    SampleClock,
    is_sampled_and_held,
    make_grid,
    resample_held,
    resample_together,
    runs_of,
)
from split_cli.logs.drive import NoiseEstimate
from split_cli.logs.map_entries import ChannelMap
from split_cli.logs.scratch import PIECE, are_finite, equal, let_go, room, set_aside
from split_cli.signals import CHANNELS

SLOWEST_PERIOD = 0.125
"""Of a needed channel that is bridged over two and a half samples unasked [s]: 10 Hz, the rate of satellite
receivers and of many loggers, with a quarter for jitter. What is slower misses the car's own motion."""
BRIDGED_SAMPLES = 2.5
"""Over which such a channel is bridged [1]: one lost sample, with a quarter of a step for jitter."""

_OF_THE_POSE = {"vx", "vy", "r", "ax", "ay"}
"""Channels that X, Y and yaw give by differentiation, or that a drive can do without."""
_COSTLY = 0.05
"""Share of what is recorded that one channel cuts off, from which on it is reported [1]: judgement."""


@dataclass(frozen=True)
class Channels:
    """Cleaned sources by channel."""

    clean: dict[str, list[CleanSeries]]  # a channel is the sum of its sources
    modes: Mapping[str, list[str]]  # how each source is resampled: ``continuous``, ``held`` or ``angle``
    maps: Mapping[str, ChannelMap]
    needed: tuple[str, ...]  # channels without which a row is not kept
    gap: float  # longest step that is bridged [s]
    # Whether a needed channel that comes more slowly is bridged over more, see `SLOWEST_PERIOD`.
    widened: bool = False

    def gap_of(self, channel: str, index: int) -> float:
        """Return the longest step of a source that is bridged [s]; more for commands and slow optional ones.

        What is written only where it changes holds until its next sample.
        """
        part = self.clean[channel][index]
        period = part.period
        if self.modes[channel][index] == "held":
            whole = float(part.time[-1] - part.time[0]) if part.on_change else 0.0
            return max(self.gap, 5.0 * period, whole)
        if channel in self.needed and not (self.widened and period <= SLOWEST_PERIOD):
            return self.gap
        return max(self.gap, BRIDGED_SAMPLES * period)

    def bridged(self) -> list[str]:
        """Return in words which needed channels come so slowly that more than the gap is bridged."""
        slow: dict[str, dict[str, None]] = {}
        periods: dict[str, float] = {}
        for channel in self.needed:
            for index, part in enumerate(self.clean[channel]):
                gap = self.gap_of(channel, index)
                if self.modes[channel][index] != "held" and gap > self.gap:
                    note = f"at {1.0 / part.period:.3g} Hz: steps up to {gap:.2g} s are bridged (--gap)"
                    slow.setdefault(note, {})[channel] = None
                    periods[channel] = part.period
        notes = [f"{', '.join(names)} {'comes' if len(names) == 1 else 'come'} {how}" for how, names in slow.items()]
        return [*notes, *self._faster_by_the_pose(periods)]

    def _faster_by_the_pose(self, slow: Mapping[str, float]) -> list[str]:
        """Return in words that the pose alone gives a faster drive, where only what it can give comes slowly."""
        pose = [part.period for channel in ("X", "Y", "yaw") for part in self.clean.get(channel, ())]
        if not slow or len(pose) < 3 or not slow.keys() <= _OF_THE_POSE or max(pose) > 0.5 * min(slow.values()):
            return []
        rate, names = f"{1.0 / max(pose):.3g} Hz", ", ".join(slow)
        advice = f"without {names} in the map, `--derive velocity-from-pose` makes a drive at that rate"
        return [f"X, Y and yaw come at {rate}: {advice}"]

    def cut_short(self) -> list[str]:
        """Return in words which needed channel begins or ends the drive, where it costs much of the others."""
        parts = [part for channel in self.needed for part in self.clean[channel] if not part.on_change]
        spans = {part.channel: (part.time[0], part.time[-1]) for part in parts}
        latest, soonest = max(spans, key=lambda c: spans[c][0]), min(spans, key=lambda c: spans[c][1])
        late = spans[latest][0] - min(begin for begin, _ in spans.values())
        early = max(end for _, end in spans.values()) - spans[soonest][1]
        whole = max(end for _, end in spans.values()) - min(begin for begin, _ in spans.values())
        losses = [(late, f"{latest} begins {late:.1f} s after"), (early, f"{soonest} ends {early:.1f} s before")]
        return [f"{text} the other channels that a drive needs" for cost, text in losses if cost > _COSTLY * whole]


def clean_channels(
    series: Mapping[str, Sequence[RawSeries]],
    maps: Mapping[str, ChannelMap],
    needed: Sequence[str],
    *,
    gap: float,
    despike: bool,
    widened: bool = False,
    resumed: Sequence[float] = (),
) -> tuple[Channels, list[str]]:
    """Clean every source; an optional channel that holds nothing usable is left out, and said.

    What is written on change is not held beyond one of the times `resumed` [s], see `resumptions`.

    Raises
    ------
    LogError
        If that happens to a needed channel.
    """
    left_out: list[str] = []
    clean: dict[str, list[CleanSeries]] = {}
    modes: dict[str, list[str]] = {}
    for channel, parts in series.items():
        entry = maps[channel]
        held = entry.resample == "held" or entry.kind == "command" or may_hold(channel)
        if channel == "yaw" or entry.resample == "angle":
            # Before spikes are looked for: a car that drives along the cut of the angle is no faulty sensor.
            parts = [replace(part, values=set_aside(_unwrapped(part.values))) for part in parts]
        try:
            # No car steers out and back within two samples: a measured steer angle has spikes like any sensor.
            steps = held and (channel != "delta" or entry.kind == "command")
            cleaned = [
                replace(
                    clean_series(part, despike=despike, held=held, steps=steps),
                    resumed=tuple(at - part.delay for at in resumed),
                )
                for part in parts
            ]
        except LogError as error:
            if channel in needed:
                raise
            left_out.append(f"{channel} was left out: {error.what}")
            continue
        clean[channel] = cleaned
        modes[channel] = [_mode(channel, entry, part) for part in cleaned]
    return Channels(clean, modes, {name: maps[name] for name in clean}, tuple(needed), gap, widened), left_out


def _unwrapped(angle: np.ndarray) -> np.ndarray:
    """Return an angle without its jumps by a turn, as `np.unwrap` does; a long one piece by piece."""
    result, before, turned = room(len(angle)), np.empty(0), 0.0
    for first in range(0, len(angle), PIECE):
        piece = angle[first : first + PIECE]
        finite = np.isfinite(piece)
        own = np.concatenate([before, piece[finite]])
        step = np.diff(own)
        back = np.mod(step + np.pi, 2.0 * np.pi) - np.pi
        back[(back == -np.pi) & (step > 0.0)] = np.pi
        turns = np.where(np.abs(step) < np.pi, 0.0, back - step)
        turns = np.cumsum(np.concatenate([[turned], turns]))
        result[first : first + PIECE] = piece
        result[first : first + PIECE][finite] = (own + turns)[len(before) :]
        before, turned = own[-1:], float(turns[-1]) if len(own) else turned
    return result


def _mode(channel: str, entry: ChannelMap, part: CleanSeries) -> str:
    if entry.resample:
        return entry.resample
    if entry.kind == "command":
        return "held"
    if may_hold(channel):
        return "held" if part.on_change or is_sampled_and_held(part.values) else "continuous"
    return CHANNELS[channel].kind


_DENSE, _SHORT = 5e-4, 2.0
"""Step of the rows and length of a log that together are no drive: the clock counts too slow [s]."""


def lay_grid(channels: Channels, rate: float | None, where: str) -> tuple[SampleClock, int]:
    """Return the drive's clock over what all needed channels cover, and the rows of stretches too short to keep.

    Parameters
    ----------
    rate : float or None
        [Hz]; None takes the slowest continuous needed channel's, at most `HIGHEST_RATE`.
    where : str
        The recording, for errors.

    Raises
    ------
    LogError
        If a needed channel is slower than the gap, the rate above the slowest, or no time covered by all.
    """
    spans, slowest = [], 0.0
    for channel in channels.needed:
        for index, (part, mode) in enumerate(zip(channels.clean[channel], channels.modes[channel], strict=True)):
            gap = channels.gap_of(channel, index)
            if mode != "held":
                if part.period > gap:
                    what = f"{channel} comes every {part.period:.3g} s, longer than the gap of {gap:g} s"
                    advice = f"Set --gap {BRIDGED_SAMPLES * part.period:.2g} to interpolate it."
                    raise LogError(what, where=part.source, advice=advice)
                slowest = max(slowest, _true_period(part, gap))
            reach = gap if mode == "held" else 0.0
            spans.append([(float(part.time[a]), float(part.time[b - 1]) + reach) for a, b in runs_of(part.time, gap)])
    slowest = slowest or max(_true_period(p, channels.gap) for c in channels.needed for p in channels.clean[c])
    ends = [end for span in spans for run in span for end in run]
    lasts = max(ends, default=0.0) - min(ends, default=0.0)
    if slowest < _DENSE and lasts < _SHORT:
        error = ClockError(
            f"lasts {lasts:.3g} s, with rows {slowest:.3g} s apart: no drive is recorded like that",
            where=where,
            advice="The time is probably in s, not in ms or us. Set its unit in the entry `time:` of the map.",
        )
        error.unit = "s"
        raise error
    period = _period(slowest, rate, where)
    grid, left_out = make_grid(spans, period)
    if not len(grid.index):
        raise LogError(
            "no time is covered by all required channels without a gap", where=where, advice=_coverage(channels)
        )
    return grid, left_out


def _true_period(part: CleanSeries, gap: float) -> float:
    """Return the mean distance of samples inside stretches without a gap [s]; jitter does not bias it."""
    step = np.diff(part.time)
    inside = step[step <= gap]
    return float(np.mean(inside)) if len(inside) else part.period


def _period(slowest: float, rate: float | None, where: str) -> float:
    if rate is not None:
        if not rate > 0:
            advice = "Give --rate in samples a second."
            raise LogError(f"the rate is {rate:g} Hz, it must be positive", where=where, advice=advice)
        if 1.0 / rate < slowest * 0.99:
            what = f"a rate of {rate:g} Hz is above the slowest required channel's {1.0 / slowest:.4g} Hz"
            raise LogError(what, where=where, advice="A drive is never upsampled.")
        return 1.0 / rate
    period = max(slowest, 1.0 / HIGHEST_RATE)
    # A clock that is nominally 25 Hz reads 24.998: within 1 %, the round figure is what the logger meant.
    for nice in (1.0 / round(1.0 / period), round(period, 3), round(period, 4)):
        if nice > 0 and abs(nice - period) < 0.01 * period:
            return nice
    return period


def _coverage(channels: Channels) -> str:
    parts = [part for channel in channels.needed for part in channels.clean[channel]]
    return "; ".join(f"{p.channel}: {p.time[0]:.2f} to {p.time[-1]:.2f} s, {1.0 / p.period:.3g} Hz" for p in parts)


def resample_channels(channels: Channels, grid: SampleClock) -> dict[tuple[str, int], Resampled]:
    """Bring every source onto the drive's clock; sources that share a clock share the work."""
    results: dict[tuple[str, int], Resampled] = {}
    together: list[tuple[CleanSeries, float, list[tuple[str, int]]]] = []
    for channel, parts in channels.clean.items():
        for index, (part, mode) in enumerate(zip(parts, channels.modes[channel], strict=True)):
            gap = channels.gap_of(channel, index)
            if mode == "held":
                resumed = part.resumed if part.on_change else ()
                held = resample_held(part.time, part.values, grid, longest=gap, resumed=resumed)
                results[channel, index] = Resampled(held, 1.0, (1.0,), False)
                continue
            alike = (m for p, g, m in together if g == gap and equal(p.time, part.time))
            members = next(alike, None)
            if members is None:
                together.append((part, gap, [(channel, index)]))
            else:
                members.append((channel, index))
    for part, gap, members in together:
        signals = [channels.clean[channel][index].values for channel, index in members]
        results |= zip(members, resample_together(part.time, signals, grid, gap=gap), strict=True)
    return results


def sum_sources(channels: Channels, resampled: Mapping[tuple[str, int], Resampled]) -> dict[str, np.ndarray]:
    """Return the channels on the drive's clock, each the sum of its sources, shapes (N,).

    The values of each first source become the channel's: a long recording has no room for both.
    """
    sums = {}
    for channel, parts in channels.clean.items():
        sums[channel] = resampled[channel, 0].values
        sums[channel] += 0.0  # -0 becomes 0
        for index in range(1, len(parts)):
            sums[channel] += resampled[channel, index].values
        let_go()
    return sums


def bring_to_clock(
    channels: Channels, grid: SampleClock
) -> tuple[dict[str, np.ndarray], dict[str, NoiseEstimate], list[ChannelQuality]]:
    """Return the channels on the drive's clock, their noise and the quality of their sources.

    The values of `channels` are given up.
    """
    resampled = resample_channels(channels, grid)
    noise, qualities = judge_sources(channels, resampled)
    for name, parts in channels.clean.items():
        channels.clean[name] = [replace(part, values=np.empty(0)) for part in parts]
    return sum_sources(channels, resampled), noise, qualities


def judge_sources(
    channels: Channels, resampled: Mapping[tuple[str, int], Resampled]
) -> tuple[dict[str, NoiseEstimate], list[ChannelQuality]]:
    """Return the noise of every canonical channel, and the quality of every source."""
    noise: dict[str, NoiseEstimate] = {}
    qualities: list[ChannelQuality] = []
    for channel, parts in channels.clean.items():
        estimates = []
        for index, (part, mode) in enumerate(zip(parts, channels.modes[channel], strict=True)):
            let_go()  # of the source before
            gap = channels.gap_of(channel, index)
            result = resampled[channel, index]
            words = "held" if mode == "held" else "low-passed" if result.low_passed else "interpolated"
            qualities.append(source_quality(part, gap, words))
            if channel not in CHANNELS:
                continue
            if mode == "held":
                estimates.append(NoiseEstimate(channel, None, None, reason=HELD))
                continue
            runs = runs_of(part.time, gap)
            filtered = {"gain": result.gain, "autocorrelation": result.autocorrelation}
            estimates.append(estimate_noise(channel, part.values, runs, **filtered))
        if estimates:
            noise[channel] = sum_of_noise(channel, estimates)
    let_go()
    return noise, qualities


def without_missing(
    grid: SampleClock, columns: dict[str, np.ndarray], needed: Sequence[str]
) -> tuple[SampleClock, dict[str, np.ndarray], int]:
    """Leave out rows where a required channel is missing, of `columns` itself too, and number segments anew."""
    present = np.all([are_finite(columns[channel]) for channel in needed], axis=0)
    if present.all():
        return grid, columns, 0
    starts = np.flatnonzero(np.diff(present.astype(int), prepend=0) == 1)
    for start in starts:
        end = start + int(np.argmin(np.append(present[start:], False)))
        if end - start < 4:
            present[start:end] = False
    if not present.any():
        raise LogError("no row has all required channels", advice="See the rates and gaps of `--list`.")
    rows = np.flatnonzero(present)
    broken = np.diff(rows, prepend=rows[0] - 1) != 1
    changed = np.diff(grid.segment[rows], prepend=grid.segment[rows[0]]) != 0
    segment = np.cumsum(broken | changed).astype(np.int32)
    kept = SampleClock(grid.origin, grid.period, grid.index[rows], segment)
    for name in columns:  # one by one: a long recording has no room for both
        columns[name] = set_aside(columns[name][rows])
    return kept, columns, len(present) - len(rows)


def without_absent(
    channels: Channels, columns: dict[str, np.ndarray], grid: SampleClock, clocks: Sequence[str]
) -> list[str]:
    """Take out of `columns` what holds no value in any row, and say so: its clock is mostly another one."""
    absent = [name for name, values in columns.items() if not are_finite(values).any()]
    other = f"; with `--clock {clocks[-1]}` they may share one" if len(clocks) > 1 else ""
    reports = []
    for name in absent:
        del columns[name]
        time = channels.clean[name][0].time
        early = float(grid.time[0]) - float(time[-1])
        apart = max(early, float(time[0]) - float(grid.time[-1]))
        when = f"ends {apart:.6g} s before the drive begins" if early > 0.0 else f"begins {apart:.6g} s after its end"
        reports.append(
            f"{name} was left out: it {when if apart > 0.0 else 'has no sample in the rows of the drive'}{other}"
        )
    return reports


def slices_of(segment: np.ndarray) -> list[slice]:
    """Return the runs of rows of one segment, in order."""
    edges = [0, *(np.flatnonzero(np.diff(segment)) + 1).tolist(), len(segment)]
    return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]


def moved_earlier(channels: Channels, delays: Mapping[str, float]) -> Channels:
    """Return the channels with their times moved earlier by `delays` [s]."""

    def moved(part: CleanSeries, by: float) -> CleanSeries:
        return replace(part, time=part.time - by, resumed=tuple(at - by for at in part.resumed))

    clean = {
        channel: [moved(part, delays.get(channel, 0.0)) for part in parts] for channel, parts in channels.clean.items()
    }
    return replace(channels, clean=clean)
