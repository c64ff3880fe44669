"""The clock of a drafted map: the column that counts time, the steps between rows, or the rate that yaw tells."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from split_cli.logs.assembling.clean import newest_first
from split_cli.logs.assembling.gather import row_rate_from_path, row_rate_from_speed, row_rate_from_yaw
from split_cli.logs.checking.plausible import NO_CAR_EXCEEDS
from split_cli.logs.drafting.draft import quoted
from split_cli.logs.drafting.meeting_clocks import MOVED
from split_cli.logs.drafting.naming import spelled_without_unit, stated_unit, words_of
from split_cli.logs.drafting.trial import TrialCandidate
from split_cli.logs.raw import (
    RawChannelInfo,
    RawRecording,
    RawSignal,
    counts_rows,
    split_stamps,
    time_column,
    unit_of_time,
)
from split_cli.logs.readers.clock_of_day import over_midnight
from split_cli.signals import find_unit

_OF_TIME = r"time|stamp|^t(?=_\d*(s|ms|us|ns)?$)"
"""Names that may count time, such as ``t_10ms``."""
_EVEN = 0.02
"""Of the step from row to row, which 99 of 100 keep where one period describes them [1]."""
_SHORTEST, _LONGEST = 5e-5, 10.0
"""Steps between rows of a drive, with margin [s]."""
_COUNTED = 1e-3
"""Of the step: what a logger counts for itself, not measures, keeps its step that closely [1]."""
_LOST_ROW = 0.5
"""Of the step, beyond which a row is missing: one period would hide the gap [1]."""
_TICKS = re.compile(r"(?<![a-z])(ticks?|counts?|cycles?|clk)(?![a-z])", re.IGNORECASE)
"""Names of columns that count something of a length of its own, in place of parts of a second."""
_OTHER_TICK = 0.2
"""Of the logarithm of two rates of rows, beyond which they are not one; the motion tells a rate to a few per cent."""
_FEWEST_STEPS = 10
"""Between rows, up to which nothing says whether a column counts [1]; judgement."""


def clock_of_rows(
    recording: RawRecording,
    infos: Sequence[RawChannelInfo],
    signals: Mapping[str, RawSignal],
    candidates: Sequence[TrialCandidate],
    row_rate: float | None,
) -> tuple[np.ndarray | None, str, bool]:
    """Return the clock of a table's rows [s], the map's line for it, and whether it is known."""
    bare = [s for s in signals.values() if s.time is None]
    if recording.clocks:
        return None, "# time: that of the messages", True
    if hasattr(recording, "paths"):
        moved = [f"; {n.where}: {n.what}" for n in recording.notes if n.what.startswith(MOVED)]
        return None, f"# time: that of each file{''.join(moved)}", True
    if signals and not bare:
        return None, "# time: each signal has its own", True
    needed = "# time: {period: SECONDS}   # no column of time: needed, or --row-rate HZ"
    if not bare:
        return None, needed, False
    count = len(bare[0].values)
    if row_rate is not None:
        return np.arange(count) / row_rate, f"time: {{period: {1.0 / row_rate:.6g}}}   # as given", True
    for stamp in split_stamps(infos):
        whole, part = (recording.read([name])[name].values for name in (stamp.whole, stamp.part))
        # A whole second of nanoseconds is none: the stamp of another clock, or one that was read wrongly.
        whole = over_midnight(whole)
        time = stamp.joined(whole, part, float(np.nanmin(whole)))
        if time is not None:
            line = f"time: {{source: {quoted(stamp.whole)}, {stamp.key}: {quoted(stamp.part)}}}"
            return time, line, True
    found = time_column(infos)
    rising = _rising(infos, signals, found)
    if rising:
        others = [info.name for info in rising[1:]]
        return _time_of_column(rising[0], signals, candidates, others)
    steps = _from_steps(infos, recording)
    if steps is not None:
        return steps
    rate, why = _rate_from_motion(candidates, signals)
    if rate is None:
        why = _by_distance(recording, infos) or _why_no_clock(found, signals) or needed
        return np.arange(count) * 0.01, why, False
    line = f"time: {{period: {1.0 / rate:.4g}}}   # CHECK: no column of time; {why}"
    return np.arange(count) / rate, line, True


def _rising(
    infos: Sequence[RawChannelInfo], signals: Mapping[str, RawSignal], found: RawChannelInfo | None
) -> list[RawChannelInfo]:
    """Return the columns that may count time, the likeliest first: by name and unit, then by what they hold."""
    timed = [i for i in infos if re.search(_OF_TIME, i.name, re.IGNORECASE) and not counts_rows(i.name)]
    clocks = [found] if found is not None else timed
    clocks = clocks or [i for i in infos if getattr(find_unit(stated_unit(i) or ""), "si", "") == "s"]
    # Whatever it is called, what counts evenly since 1970 is a clock. One of fewer digits than the rows come in
    # stands still between them; ingest drops what shares a stamp.
    for among, counts in ((clocks, _counts), (timed, _counts), (infos, _counts_since_1970), (clocks, _never_falls)):
        rising = [info for info in among if info.name in signals and counts(signals[info.name].values)]
        if rising:
            return rising
    return _first_that_counts(infos, signals)


def _time_of_column(
    info: RawChannelInfo, signals: Mapping[str, RawSignal], candidates: Sequence[TrialCandidate], others: Sequence[str]
) -> tuple[np.ndarray, str, bool]:
    """Return time and line of a column that counts it, in the unit of the file or of its steps."""
    values = signals[info.name].values
    unit = info.unit if find_unit(info.unit or "") and find_unit(info.unit).si == "s" else stated_unit(info)
    fits = unit_of_time(values)
    unit = unit if unit in ("s", "ms", "0.1ms", "us", "0.1us", "ns", "min", "d") else fits
    if fits != unit and not _SHORTEST < _usual_step(values) * find_unit(unit).factor < _LONGEST:
        remark = f"the file says {unit}, but its rows are as far apart as those of a drive in {fits}"
        line = f"time: {{source: {quoted(info.name)}, unit: {fits}}}   # CHECK: {remark}"
        return (values - np.nanmin(values)) * find_unit(fits).factor, line, True
    if unit == "s" and stated_unit(info) is None and bool(np.all(np.diff(values) == 1.0)):
        return _rows_or_seconds(info.name, values, _rate_from_motion(candidates, signals)[0])
    by_epoch = fits == "0.1us" or _counts_since_1970(values)
    if stated_unit(info) is None and unit == fits and _TICKS.search(info.name) and not by_epoch:
        return _of_ticks(info.name, values, unit, candidates, signals)
    also = f"   # also rises: {', '.join(others)}" if others else ""
    line = f"time: {{source: {quoted(info.name)}, unit: {unit}}}{also}"
    values = over_midnight(values, 1.0 / find_unit(unit).factor)
    return (values - np.nanmin(values)) * find_unit(unit).factor, line, True


def _of_ticks(
    name: str, values: np.ndarray, unit: str, candidates: Sequence[TrialCandidate], signals: Mapping[str, RawSignal]
) -> tuple[np.ndarray, str, bool]:
    """Return time and line of a column that counts ticks of no stated length: by the motion, or as `unit`."""
    rate, why = _rate_from_motion(candidates, signals)
    step = _usual_step(values) * find_unit(unit).factor
    if rate is not None and abs(np.log(rate * step)) > _OTHER_TICK:
        line = f"time: {{period: {1.0 / rate:.4g}}}   # CHECK: {name} counts no {unit}: {why}"
        return np.arange(len(values)) / rate, line, True
    line = f"time: {{source: {quoted(name)}, unit: {unit}}}   # CHECK: nobody says how long a tick is"
    return (values - np.nanmin(values)) * find_unit(unit).factor, line, True


def _rows_or_seconds(name: str, values: np.ndarray, rate: float | None) -> tuple[np.ndarray, str, bool]:
    """Return time and line of a column that rises by 1: it counts rows where the motion has another rate [Hz]."""
    if rate is not None and abs(rate - 1.0) > _LOST_ROW:
        line = f"time: {{period: {1.0 / rate:.4g}}}   # CHECK: {name} counts rows, by how v_x or yaw change"
        return np.arange(len(values)) / rate, line, True
    line = f"time: {{source: {quoted(name)}, unit: s}}   # CHECK: rises by 1 from row to row: seconds, or rows?"
    return values - np.nanmin(values), line, True


def _by_distance(recording: RawRecording, infos: Sequence[RawChannelInfo]) -> str:
    """Return the line for rows that are equally far apart along the track: no period is theirs; else nothing."""
    for info in infos:
        if info.type_name == "text" or "dist" not in info.name.lower():
            continue
        values = recording.read([info.name])[info.name].values
        steps = np.diff(values[np.isfinite(values)])
        usual = float(np.median(steps)) if len(steps) > _FEWEST_STEPS else 0.0
        if usual > 0.0 and float(np.quantile(np.abs(steps / usual - 1.0), 0.9)) < _EVEN:
            unit = stated_unit(info) or "of its units"
            return f"# time: needed: rows are {usual:.4g} {unit} apart by {info.name}, not in time: export them by time"
    return ""


def _why_no_clock(found: RawChannelInfo | None, signals: Mapping[str, RawSignal]) -> str:
    """Return the line for a column that is called time and cannot be it: one of too few digits stands still."""
    values = signals[found.name].values if found is not None and found.name in signals else np.zeros(0)
    if not len(values):
        return ""
    kept = len(np.unique(values[np.isfinite(values)]))
    if len(values) <= _FEWEST_STEPS + 1:
        few = f"{len(values)} rows are too few to see whether {found.name} counts time"
        return f"# time: {{period: SECONDS}}   # {few}"
    remark = f"{found.name} has {kept} different values in {len(values)} rows: too few digits to be the clock"
    remark = remark if 2 * kept < len(values) else f"{found.name} does not rise from row to row"
    return f"# time: {{period: SECONDS}}   # {remark}. Export it again, or state the period here"


def _from_steps(infos: Sequence[RawChannelInfo], recording: RawRecording) -> tuple[np.ndarray, str, bool] | None:
    """Return time and line of a table whose only column of time holds the steps between its rows; None if none."""
    for info in infos:
        if info.type_name == "text" or not {"dt", "delta_t", "deltat", "timestep", "time_step"} & {
            "_".join(words_of(info.name)),
            spelled_without_unit(info).lower(),
        }:
            continue
        steps = recording.read([info.name])[info.name].values
        steps = np.where(np.isfinite(steps), steps, np.nanmedian(steps))
        unit = stated_unit(info) if getattr(find_unit(stated_unit(info) or ""), "si", "") == "s" else None
        unit = unit or unit_of_time(np.cumsum(steps))
        step = float(np.median(steps)) * find_unit(unit).factor
        # The first row has none before it; loggers give it 0.
        if step <= 0.0 or not (steps[1:] > 0.0).all():
            continue
        off = np.abs(steps[1:] / np.median(steps) - 1.0)
        even = float(np.quantile(off, 0.99)) < _EVEN and float(off.max()) < _LOST_ROW
        entry = f"time: {{period: {step:.6g}}}   # CHECK: {info.name} holds the steps between rows, all alike"
        uneven = f"# time: needed: {info.name} holds steps of unlike size between rows; add a column with their sum"
        return np.cumsum(steps) * find_unit(unit).factor, entry if even else uneven, even
    return None


def _usual_step(values: np.ndarray) -> float:
    """Return the median of the steps that move on, in the column's unit."""
    step = np.abs(np.diff(values[np.isfinite(values)]))
    return float(np.median(step[step > 0.0])) if np.any(step > 0.0) else 0.0


def _rises(values: np.ndarray) -> bool:
    step = np.diff(values[np.isfinite(values)])
    return len(step) > _FEWEST_STEPS and np.mean(step > 0) > 0.95


def _never_falls(values: np.ndarray) -> bool:
    step = np.diff(values[np.isfinite(values)])
    return np.count_nonzero(step > 0) > _FEWEST_STEPS and not np.any(step < 0)


def _counts(values: np.ndarray) -> bool:
    """Whether a column counts up, or down where the newest row stands first."""
    return _rises(values) or newest_first(values)


def _first_that_counts(infos: Sequence[RawChannelInfo], signals: Mapping[str, RawSignal]) -> list[RawChannelInfo]:
    """Return the first column if it rises in steps all alike, whatever it is called: no measured position does.

    One step in a hundred may be another, where runs stand one behind the other. Steps of 1 number the rows, and a
    column in another unit than of time is a distance.
    """
    info = next((i for i in infos if i.type_name != "text"), None)
    if info is None or info.name not in signals or counts_rows(info.name):
        return []
    other = stated_unit(info) is not None and getattr(find_unit(stated_unit(info)), "si", "") != "s"
    values = signals[info.name].values
    step = np.diff(values[np.isfinite(values)])
    if other or not _rises(values) or "distance" in info.name.lower():
        return []
    usual = float(np.median(step))
    off = np.abs(step - usual) - 1e-9 * float(np.nanmax(np.abs(values)))
    counts_time = usual > 0.0 and abs(usual - 1.0) >= _COUNTED
    return [info] if counts_time and float(np.quantile(off, 0.99)) < _COUNTED * usual else []


def _counts_since_1970(values: np.ndarray) -> bool:
    """Whether values rise evenly between the years 2001 and 2100, in s, ms, us or ns."""
    if not _rises(values):
        return False
    first = float(values[np.isfinite(values)][0])
    return any(1e9 <= first * unit <= 4.1e9 for unit in (1.0, 1e-3, 1e-6, 1e-9))


def _rate_from_motion(
    candidates: Sequence[TrialCandidate], signals: Mapping[str, RawSignal]
) -> tuple[float | None, str]:
    """Return the rows a second that the motion tells [Hz], and how; None where nothing does."""
    rate = _rate_from_yaw(candidates, signals)
    if rate is not None:
        return rate, "yaw turns as yaw rate says so"
    for row_rate, channels, how in (
        (row_rate_from_path, ("X", "Y", "vx", "vy"), "the path grows as v_x and v_y say so, a few per cent are open"),
        (row_rate_from_path, ("X", "Y", "vx"), "the path grows as v_x says so, a few per cent are open"),
        (row_rate_from_speed, ("vx", "ax"), "v_x changes as a_x says so, a few per cent are open"),
    ):
        found = _read_as_named(channels, candidates, signals)
        rate = None if found is None else row_rate(*found)
        if rate is not None:
            return rate, how
    return None, ""


def is_cut_in_degrees(angle: np.ndarray) -> bool:
    """Tell an angle in degrees by a step of a whole turn, 60 degrees more or less, from row to row."""
    steps = np.abs(np.diff(angle[np.isfinite(angle)]))
    return bool(np.any((steps > 300.0) & (steps < 420.0)))


def _rate_from_yaw(candidates: Sequence[TrialCandidate], signals: Mapping[str, RawSignal]) -> float | None:
    for yaw in (c for c in candidates if c.channel == "yaw" and c.sources[0] in signals):
        for rate in (c for c in candidates if c.channel == "r" and c.sources[0] in signals):
            pair = [signals[c.sources[0]].values * (find_unit(c.unit).factor if c.unit else 1.0) for c in (yaw, rate)]
            in_degrees = not rate.unit and float(np.nanquantile(np.abs(pair[1]), 0.99)) > NO_CAR_EXCEEDS["r"][0]
            if in_degrees:
                pair[1] = np.radians(pair[1])
            # One who counts turning in degrees counts the angle so too.
            if not yaw.unit and (in_degrees or is_cut_in_degrees(pair[0])):
                pair[0] = np.radians(pair[0])
            found = row_rate_from_yaw(*pair)
            if found and _SHORTEST < 1.0 / found < _LONGEST:
                return found
    return None


def _read_as_named(
    channels: Sequence[str], candidates: Sequence[TrialCandidate], signals: Mapping[str, RawSignal]
) -> list[np.ndarray] | None:
    """Return channels in the units of their names or in SI; None without one, or for a satellite fix."""
    found = []
    for channel in channels:
        plain = [c for c in candidates if c.channel == channel and not c.convert and c.sources[0] in signals]
        if not plain:
            return None
        first = max(plain, key=lambda c: c.weight)
        found.append(signals[first.sources[0]].values * (find_unit(first.unit).factor if first.unit else 1.0))
    return found
