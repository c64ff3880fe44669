"""Time stamps and samples made fit for resampling; whatever is dropped or moved is counted."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.assembling.conversion import RawSeries
from split_cli.logs.checking.plausible import is_damaged
from split_cli.logs.scratch import LONG, PIECE, let_go, room, set_aside
from split_cli.signals import CHANNELS

_RESET_WINDOW = 10
_BACK_SHARE = 0.05
"""Of a clock's stamps that may lie far before the one before [1]; judgement: two clocks by turns make a half."""
_DUPLICATE_SHARE = 1e-3
_FAR_OUT = 3.0
"""Times the range of nine tenths of a signal, by which no motion leaves its neighbours for two samples [1]."""
_SPIKE_SIGMAS = 25.0
_LONGEST_SPIKE = 2
USUAL_GAP = 0.1
"""Longest step that is interpolated unless said otherwise [s]."""
_PAUSE = 1.0
"""Least pause between runs that are joined [s]."""
_BRIDGED = 5.0
"""Samples of a slow source, over which it is held or interpolated at most [1]; see `Channels.gap_of`."""
_EXTRAS_LIMIT = 1e100
"""Of channels without a meaning known here; squares of it are still finite."""


@dataclass(frozen=True)
class Drop:
    """`count` samples of `source` that were dropped or moved, and why."""

    source: str
    reason: str
    count: int


_FEWEST_CHANGES, _IRREGULAR = 20, 3.0
"""Changes, and ratio of long steps of time to short ones, from which on a signal is written on change [1]."""
_OF_BURSTS = 5
"""Steps over which messages that a network delivered in bursts are even again [1]; steps that owe nothing to each
other are then less uneven, about by the root of the number. Judgement."""


@dataclass(frozen=True)
class CleanSeries:
    """A series with finite values at strictly increasing times, delay removed."""

    channel: str
    source: str
    # time, values: (N,): [s], SI unit.
    time: np.ndarray
    values: np.ndarray
    period: float  # median distance of two samples [s]
    # How often each sample of a sampled-and-held sensor was repeated (1: not at all); the repeats are gone.
    repeats: int = 1
    spikes: int = 0  # isolated spikes that were found
    drops: tuple[Drop, ...] = ()
    command: bool = False  # whether the map says so
    # When the recording went on behind a pause [s], which a value that is written on change does not outlast.
    resumed: tuple[float, ...] = ()

    @cached_property
    def on_change(self) -> bool:
        """Whether it is written only where it changes, see `written_on_change`."""
        return written_on_change(self.time, self.values, self.command)


def written_on_change(time: np.ndarray, values: np.ndarray, command: bool = False) -> bool:
    """Tell a signal that is written only where it changes, so that between two samples nothing is missing.

    Then no value stands twice in a row, the values are few, and the steps of time are as different as a drive is.
    Messages that come regularly have one usual step, and those of a noisy sensor hardly repeat a value. A
    `command` has no noise, and its message is also written where another of its fields changes: the steps alone
    tell, and over `_OF_BURSTS` messages too, which a network may deliver in bursts.
    """
    if len(time) <= _FEWEST_CHANGES or (not command and np.any(np.diff(values) == 0.0)):
        return False
    if not _uneven(time, 1, _IRREGULAR):
        return False
    return _uneven(time, _OF_BURSTS, _IRREGULAR**0.5) if command else len(np.unique(values)) <= 0.5 * len(values)


def _uneven(time: np.ndarray, count: int, ratio: float) -> bool:
    """Whether of the spans of `count` steps of time the long ones exceed the short ones by a ratio."""
    short, long = np.quantile(time[count:] - time[:-count], [0.1, 0.9])
    return bool(long > ratio * short)


def join_clock_resets(
    series: Mapping[str, Sequence[RawSeries]], largest_step_back: float
) -> tuple[dict[str, tuple[RawSeries, ...]], tuple[str, ...]]:
    """Move what follows a backward clock jump behind what was before it, all channels by the same time.

    A few samples out of order are no jump: they are sorted later. A jump leaves at least `_RESET_WINDOW` samples
    behind the clock's highest reading. A few stamps that fit neither those before nor those behind are no jump
    either: they are left out.

    Raises
    ------
    LogError
        If channels do not agree on how often the clock jumped, or one jumps again and again.
    """
    series, said = _without_stray_stamps(series, largest_step_back)
    clocks = {id(part.time): part.time for parts in series.values() for part in parts}
    found_in = {key: clock_resets(time, largest_step_back) for key, time in clocks.items()}
    boundaries = {
        (channel, index): found_in[id(part.time)]
        for channel, parts in series.items()
        for index, part in enumerate(parts)
    }
    counts = {len(found) for found in boundaries.values()}
    if counts <= {0}:
        return {channel: tuple(parts) for channel, parts in series.items()}, tuple(said)
    if len(counts) > 1:
        worst = max(boundaries, key=lambda key: len(boundaries[key]))
        what = f"the clock of {worst[0]} jumps back {len(boundaries[worst])} times, those of other channels do not"
        advice = "Choose another clock with --clock, or cut the recording there."
        raise LogError(what, where=series[worst[0]][worst[1]].source, advice=advice)
    pause = pause_between_runs(
        [(part.time, part.values) for parts in series.values() for part in parts], largest_step_back
    )
    eras = counts.pop() + 1
    pieces = {key: np.split(np.arange(len(series[key[0]][key[1]].time)), found) for key, found in boundaries.items()}
    times = {key: series[key[0]][key[1]].time.copy() for key in boundaries}
    shift = 0.0
    for era in range(1, eras):
        end = max(np.nanmax(times[key][pieces[key][era - 1]]) for key in pieces)
        start = min(np.nanmin(times[key][pieces[key][era]]) for key in pieces)
        back, shift = end - shift - start, end - start + pause
        for key in pieces:
            times[key][pieces[key][era]] += shift
        said.append(f"the clock jumps back by {back:.3f} s: what follows was moved behind it, as a new segment")
    joined = {
        channel: tuple(replace(part, time=times[channel, index]) for index, part in enumerate(parts))
        for channel, parts in series.items()
    }
    return joined, tuple(said)


def may_hold(channel: str) -> bool:
    """Whether a channel may be an input, whose steps are its nature: steer angle, torque, or one not known."""
    return channel not in CHANNELS or CHANNELS[channel].kind == "held"


def resumptions(series: Mapping[str, Sequence[RawSeries]], gap: float) -> tuple[float, ...]:
    """Return when a recording went on behind a pause [s], if it has a signal that is written on change.

    What such a signal became in the pause, or is in the next of several runs, nobody has written. A pause is where
    the fastest of the other signals has none of five samples, for longer than `gap`, and no signal has any.
    """
    parts = [(channel, part) for channel, sources in series.items() for part in sources]
    on_change = [may_hold(channel) and _is_written_on_change(part) for channel, part in parts]
    if all(on_change) or not any(on_change):
        return ()
    times = [set_aside(np.sort(part.time[np.isfinite(part.time) & np.isfinite(part.values)])) for _, part in parts]
    regular = [time for time, irregular in zip(times, on_change, strict=True) if not irregular and len(time) > 1]
    fastest = max(regular, key=len, default=np.empty(0))
    step = np.diff(fastest)
    paused = np.flatnonzero(step > max(gap, _BRIDGED * float(np.median(step)))) if len(step) else []
    ends = [(fastest[at], fastest[at + 1]) for at in paused]
    return tuple(
        float(end)
        for begin, end in ends
        if all(np.searchsorted(time, begin, "right") == np.searchsorted(time, end) for time in times)
    )


def _is_written_on_change(part: RawSeries) -> bool:
    known = np.isfinite(part.time) & np.isfinite(part.values)
    time, values = part.time[known], part.values[known]
    if len(known) >= LONG:
        let_go()  # copies stay
    return written_on_change(time, values, part.command)


def pause_between_runs(sources: Iterable[tuple[np.ndarray, np.ndarray]], gap: float) -> float:
    """Return the pause between runs that are joined [s]: so long that no source is interpolated over it.

    Parameters
    ----------
    sources : iterable of (ndarray, ndarray)
        Times [s] and values of each, shapes (N,).
    gap : float
        Longest step that is bridged [s]; of a slow source up to five of its samples are.
    """
    longest = gap
    for time, values in sources:
        step = np.diff(time)
        step = step[step > 0.0]
        if len(step):
            longest = max(longest, _BRIDGED * float(np.median(step)) * longest_repeat(values))
    return max(_PAUSE, 2.0 * longest)


def _without_stray_stamps(
    series: Mapping[str, Sequence[RawSeries]], largest_step_back: float
) -> tuple[dict[str, tuple[RawSeries, ...]], list[str]]:
    """Return the series without the few stamps that do not fit those around them, and what was left out.

    Raises
    ------
    LogError
        If a clock goes back so often that its stamps are of several clocks.
    """
    clocks = {id(part.time): (part.time, part.source) for parts in series.values() for part in parts}
    said, cleaned = set(), {}
    for key, (time, source) in clocks.items():
        stray = _stray_stamps(time, largest_step_back)
        cleaned[key] = np.where(stray, np.nan, time) if stray.any() else time
        if stray.any():
            said.add(f"{np.count_nonzero(stray)} stamps that fit neither those before nor behind were left out")
        back = int(np.count_nonzero(np.diff(cleaned[key]) < -largest_step_back))
        if back > _BACK_SHARE * len(time):
            what = f"the clock goes back by more than {largest_step_back:g} s {back} times in {len(time)} rows"
            advice = "Devices with clocks of their own may have written it. Choose another clock."
            raise LogError(what, where=source, advice=advice)
    new = {
        channel: tuple(replace(part, time=cleaned[id(part.time)]) for part in parts)
        for channel, parts in series.items()
    }
    return new, sorted(said)


def _stray_stamps(time: np.ndarray, largest_step_back: float) -> np.ndarray:
    """Flag a few wrong stamps in a row, fewer than a jump has, shape (N,).

    The stamps around them leave room for just as many samples. A late message leaves no room where it stands: it
    is missing where it belongs. At the beginning, stamps ahead of what follows are flagged.
    """
    stray, finite = np.zeros(len(time), dtype=bool), np.isfinite(time)
    if finite.all() and not np.any(np.diff(time) < -largest_step_back):
        return stray  # as of nearly every log, and without copies of a long one
    rows = np.flatnonzero(finite)
    step = np.diff(time[rows])
    typical = float(np.median(step[step > 0.0])) if np.any(step > 0.0) else 0.0
    breaks = np.flatnonzero((step < 0.0) | (step > typical + largest_step_back))
    first, last = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(rows) - 1]])
    long = last - first + 1 >= _RESET_WINDOW
    first, last = first[long], last[long]
    if not len(first):
        return stray
    at = time[rows]
    stray[rows[: first[0]]] = at[: first[0]] > at[first[0]] + largest_step_back
    between = first[1:] - last[:-1] - 1
    away = at[first[1:]] - at[last[:-1]]
    fits = (away > (between + 0.5) * typical) & (away < (between + 1) * typical + largest_step_back)
    for index in np.flatnonzero(fits & (between > 0) & (between < _RESET_WINDOW)):
        stray[rows[last[index] + 1 : first[index + 1]]] = True
    return stray


def newest_first(time: np.ndarray) -> bool:
    """Tell whether a table's rows stand in reverse order: nearly every step of its time is backward."""
    step = np.diff(time[np.isfinite(time)])
    return len(step) > 10 and float(np.mean(step < 0.0)) > 0.95


def clock_resets(time: np.ndarray, largest_step_back: float) -> list[int]:
    """Return the rows at which the clock jumped back for good."""
    found: list[int] = []
    start = 0
    while True:
        part = time[start:]
        finite = np.where(np.isfinite(part), part, -np.inf)
        highest = np.maximum.accumulate(finite)
        behind = np.isfinite(part) & (finite < highest - largest_step_back)
        runs = _runs(behind)
        lasting = [a for a, b in runs if b - a >= min(_RESET_WINDOW, max(2, len(part) - a))]
        if not lasting:
            return found
        start += lasting[0]
        found.append(start)


def clean_series(
    series: RawSeries, *, despike: bool = True, held: bool = False, steps: bool | None = None
) -> CleanSeries:
    """Drop impossible samples and duplicate times, sort, remove spikes and the repeats of a held sensor.

    Parameters
    ----------
    despike : bool
        Drop isolated spikes instead of only counting them.
    held : bool
        The channel is a command: its repeats are no sign of a slow sensor.
    steps : bool, optional
        Whether its steps are its nature, so that no sample is a spike; as `held` by default.

    Raises
    ------
    LogError
        If fewer than four samples remain.
    """
    drops: list[tuple[str, int]] = []
    # Channels of a table share their time; it is copied only where one has a delay or loses a sample.
    time, values = series.time - series.delay if series.delay else series.time, series.values

    def keep(mask: np.ndarray, reason: str) -> None:
        nonlocal time, values
        dropped = int(np.count_nonzero(~mask))
        if dropped:
            drops.append((reason, dropped))
            time, values = time[mask], values[mask]

    keep(np.isfinite(time), "time not finite")
    keep(~np.isnan(values), "NaN")
    keep(np.isfinite(values), "infinite")
    limit = CHANNELS[series.channel].limit if series.channel in CHANNELS else _EXTRAS_LIMIT
    keep(np.abs(values) <= limit, f"beyond {limit:g}, no measurement")
    backward = int(np.count_nonzero(np.diff(time) < 0))
    if backward:
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
        drops.append(("out of order, sorted", backward))
    if len(time) > 1:
        step = np.diff(time)
        onward = step > 0
        typical = float(np.median(step if onward.all() else step[onward])) if onward.any() else 0.0
        del onward
        keep(np.concatenate([[True], step > _DUPLICATE_SHARE * typical]), "duplicate time")
        del step  # of a long recording each column counts
    steps = held if steps is None else steps
    if steps:
        spikes = np.zeros(len(values), dtype=bool)
    else:
        spikes = _spikes_between_updates(values) if held else isolated_spikes(values)
    if despike:
        keep(~spikes, "spike")
        keep(~is_damaged(series.channel, values), "beyond what any car reaches, and far beyond the others")
    repeats = 1 if held else longest_repeat(values)
    if repeats > 1:
        keep(_first_of_repeats(values, repeats), f"repeat of a held sample ({repeats} of each)")
    if len(time) < 4:
        dropped = "; ".join(f"{count} {reason}" for reason, count in drops)
        why = f"Dropped: {dropped}" if dropped else "The recording is nearly empty"
        what = f"{len(time)} usable samples of {series.channel} remain"
        raise LogError(what, where=series.source, advice=f"{why}. Map another channel for it.")
    return CleanSeries(
        channel=series.channel,
        source=series.source,
        time=set_aside(time),
        values=set_aside(values),
        period=float(np.median(np.diff(time), overwrite_input=True)),
        repeats=repeats,
        spikes=int(np.count_nonzero(spikes)),
        drops=tuple(Drop(series.source, reason, count) for reason, count in drops),
        command=series.command,
    )


def isolated_spikes(values: np.ndarray) -> np.ndarray:
    """Flag at most two samples in a row that stand out of a running median by far more than noise and motion do.

    The scale is the 99 % quantile of the deviation, so that a rough but honest signal has no spikes. Where more
    samples than that are damaged, they stand out of nine tenths of the signal by several times its range.
    """
    if len(values) < 50:
        return np.zeros(len(values), dtype=bool)
    from scipy.ndimage import median_filter

    deviation = room(len(values))
    for first in range(0, len(values), PIECE):  # with the neighbours that the filter looks at
        last, before = min(first + PIECE, len(values)), max(first - 3, 0)
        near = np.asarray(values[before : last + 3], dtype=float)
        smooth = median_filter(near, size=7, mode="nearest")
        deviation[first:last] = np.abs(near - smooth)[first - before : last - before]
        let_go()
    scale = max(float(np.quantile(deviation, 0.99)) / 2.576, 1.4826 * float(np.median(deviation)))
    let_go()
    span = float(np.subtract(*np.quantile(values, [0.99, 0.01])))
    flagged = deviation > max(_SPIKE_SIGMAS * scale, 0.25 * span, 1e-9)
    most = float(np.quantile(deviation, 0.95)) / 1.96
    range_of_most = float(np.subtract(*np.quantile(values, [0.95, 0.05])))
    if most > 0.0 and range_of_most > 0.0:
        flagged |= deviation > max(_SPIKE_SIGMAS * most, _FAR_OUT * range_of_most)
    for start, end in _runs(flagged):
        if end - start > _LONGEST_SPIKE:
            flagged[start:end] = False
    return flagged


def _spikes_between_updates(values: np.ndarray) -> np.ndarray:
    """Flag spikes of a signal that may keep its value over several samples: judged by its updates."""
    new = np.concatenate([[True], np.diff(values) != 0.0])
    return isolated_spikes(values[new])[np.cumsum(new) - 1]


def longest_repeat(values: np.ndarray) -> int:
    """Return how many times a sensor slower than its log repeats each sample; 1 for a sensor that does not.

    A quantised signal repeats values too, but in runs of any length: here nine of ten runs of a moving signal
    have the same length, give or take one.
    """
    lengths, counts = _between_changes(values)
    total = int(counts.sum())
    if total < 19:
        return 1
    middle = np.searchsorted(np.cumsum(counts), [(total - 1) // 2 + 1, total // 2 + 1])
    typical = int(0.5 * float(lengths[middle].sum()))
    if typical < 2:
        return 1
    regular = int(counts[np.abs(lengths - typical) <= 1].sum()) / total
    return typical if regular >= 0.9 else 1


def _between_changes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how many samples lie between changes, ascending, and how often; a long signal piece by piece."""
    found: Counter[int] = Counter()
    latest: list[int] = []  # change
    for first in range(0, len(values), PIECE):
        change = first + np.flatnonzero(np.diff(values[first : first + PIECE + 1]) != 0.0)
        apart, count = np.unique(np.diff(np.concatenate([latest, change])), return_counts=True)
        found.update(dict(zip(apart.astype(int).tolist(), count.tolist(), strict=True)))
        latest = change[-1:].tolist() or latest
    lengths = sorted(found)
    return np.array(lengths, dtype=int), np.array([found[length] for length in lengths], dtype=int)


def _first_of_repeats(values: np.ndarray, repeats: int) -> np.ndarray:
    new = np.concatenate([[True], np.diff(values) != 0.0])
    since = np.arange(len(values)) - np.maximum.accumulate(np.where(new, np.arange(len(values)), 0))
    return since % repeats == 0


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
