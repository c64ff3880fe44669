"""From a recording and a map to SI series, each on its own clock: sources found, units and signs converted."""

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from split_cli.errors import ClockError, LogError, MapError, nearest_names
from split_cli.logs.assembling.clean import USUAL_GAP, newest_first, pause_between_runs
from split_cli.logs.assembling.conversion import ConversionNotes, Converter, RawSeries, expected_unit
from split_cli.logs.assembling.marks_of_nothing import without_marks
from split_cli.logs.checking.plausible import DAMAGED
from split_cli.logs.map_entries import ChannelMap, SignalMap, SignalSource
from split_cli.logs.presets import preset_names
from split_cli.logs.raw import Clock, RawRecording, RawSignal, time_column, turned, unit_of_time
from split_cli.logs.readers.clock_of_day import over_midnight
from split_cli.logs.scratch import set_aside
from split_cli.logs.signal_map import read_map
from split_cli.signals import CHANNELS, REQUIRED_CHANNELS, convert_to_si, find_unit

_TIME_ADVICE = "Name the column as `time: {source: ..., unit: ...}`, or give `time: {period: SECONDS}`."
_SLOWEST = 2.0
"""Step of a table's rows from which on a wrong unit of time is likelier than so slow a recording [s]."""
_NUMBERS_RUNS = re.compile(r"(?i)(run|session|episode|trial|experiment|traj(ectory)?)([_ ]?(id|no|nr|num|number|idx))?")
"""Columns that number runs; a lap or a sector goes on where the one before ended."""
_SAME_STAMP = 1e-6
"""Up to which a stamp and a sample that repeats it differ by rounding [s]: no logger stamps more finely."""
_MOST_CHANGES = 0.01
"""Of the rows, up to which a number is that of a run [1]; judgement."""
_SUFFIXES = {
    "yaw_from_quaternion": ("x", "y", "z", "w"),
    "local_x": ("latitude", "longitude"),
    "local_y": ("latitude", "longitude"),
}


@dataclass(frozen=True)
class Gathered:
    """What a recording gave."""

    series: Mapping[str, tuple[RawSeries, ...]]  # channel to its sources; their sum is the channel
    maps: Mapping[str, ChannelMap]  # of the channels found
    origin: float  # what was subtracted from every time [s]
    clock: str  # in words
    conversions: tuple[str, ...]  # units, signs and frames converted
    assumed: tuple[str, ...]  # what neither file nor map said
    contradictions: tuple[str, ...]  # where file and map disagree
    skipped: tuple[str, ...]  # optional channels whose sources do not exist


def topic_of(name: str) -> str:
    """Return the topic of an addressed field, the column itself for a table."""
    return name.rsplit("/", 1)[0] if name.startswith("/") else name


def gather(
    recording: RawRecording,
    signal_map: SignalMap,
    *,
    clock: Clock | None = None,
    wheel_radius: float | None = None,
    needed: Sequence[str] = (),
    gap: float = USUAL_GAP,
) -> Gathered:
    """Read every channel of the map from a recording.

    Parameters
    ----------
    clock : str, optional
        ``header``, ``publish`` or ``log``; overrides the map's.
    wheel_radius : float, optional
        Turns wheel speeds in rad/s into m/s [m].
    needed : sequence of str
        Channels that must not be skipped even where the map calls them optional.
    gap : float
        Longest step that is bridged [s]; runs are further apart.

    Raises
    ------
    MapError
        If a source does not exist (nearest names are reported), or its unit does not fit the channel.
    LogError
        If the recording is empty or has no usable time.
    """
    infos = {info.name: info for info in recording.channels()}
    if not infos:
        raise LogError("holds no channels", where=recording.name, advice="Is the recording empty?")
    resolver = _Resolver(recording.name, infos, signal_map)
    found, skipped = resolver.resolve_all(needed)
    extras = _extra_columns(infos, found, signal_map)
    wanted = list(dict.fromkeys([*(name for f in found.values() for names in f for name in names), *extras]))
    chosen = clock or signal_map.time.clock
    if chosen and chosen not in recording.clocks:
        have = ", ".join(recording.clocks) or "none: its time is a column"
        raise MapError(f"has no {chosen} clock", where=recording.name, advice=f"It has {have}.")
    time_column = _time_column(infos, signal_map, recording)
    part = signal_map.time.stamp
    clocks = [name for name in (time_column, part.part if part else None) if name]
    signals = recording.read(list(dict.fromkeys([*wanted, *clocks])), chosen)
    notes = ConversionNotes([], [], [])
    if time_column is None and not signal_map.time.period and signal_map.extras is None:
        # Beside signals with clocks of their own, what has none is no channel: a vector of times, for instance.
        mapped = {name for groups in found.values() for names in groups for name in names}
        if all(signals[name].time is not None for name in mapped & signals.keys()):
            extras = [name for name in extras if signals[name].time is not None]
            signals = {name: signal for name, signal in signals.items() if signal.time is not None}
    signals = _without_marks(signals, clocks, notes)
    found, absent = resolver.without_absent_elements(found, signals, needed)
    skipped += absent
    common, origin, words = _common_time(signals, time_column, signal_map, recording, notes)
    if common is not None and newest_first(common):
        common, signals = turned(common, signals)
        notes.conversions.append("rows in reverse order, the newest first: turned round")
    common = None if common is None else set_aside(_parted_by_runs(common, signals, notes, gap))
    converter = Converter(recording.name, signal_map, wheel_radius, notes)
    others = [column for column in extras if column not in clocks and not _is_its_own_clock(signals.get(column))]
    maps, series = _converted(found, others, signals, Counter(extras) + Counter(clocks), converter, common)
    if chosen or recording.clocks:
        words = f"{chosen or recording.clocks[0]} time of the messages"
    return Gathered(
        series,
        maps,
        recording.origin + origin,
        words,
        tuple(dict.fromkeys(notes.conversions)),
        tuple(dict.fromkeys(notes.assumed)),
        tuple(dict.fromkeys(notes.contradictions)),
        tuple(skipped),
    )


def _without_marks(
    signals: Mapping[str, RawSignal], clocks: Sequence[str], notes: ConversionNotes
) -> dict[str, RawSignal]:
    """Return the signals without marks of missing values, each said once; a clock has none."""
    kept = {}
    for name, signal in signals.items():
        kept[name], said = (signal, "") if name in clocks else without_marks(signal)
        notes.conversions.extend([said] if said else [])
    return kept


def _converted(
    found: Mapping[str, list[list[str]]],
    others: Sequence[str],
    signals: dict[str, RawSignal],
    uses: Counter[str],
    converter: Converter,
    common: np.ndarray | None,
) -> tuple[dict[str, ChannelMap], dict[str, tuple[RawSeries, ...]]]:
    """Return maps and series of channels and of other columns; `uses` counts those of signals elsewhere.

    A signal goes with its last use, so that a long recording is not held twice.
    """
    uses = uses + Counter(name for groups in found.values() for names in groups for name in names)

    def use(name: str) -> RawSignal:
        uses[name] -= 1
        return signals[name] if uses[name] else signals.pop(name)

    series: dict[str, tuple[RawSeries, ...]] = {}
    maps: dict[str, ChannelMap] = {}
    for channel, names_of_sources in found.items():
        entry = converter.map.channel(channel)
        # North-east-down logs name north X; here X is east.
        is_ned = (entry.sources[0].world or converter.map.world) == "ned"
        name = {"X": "Y", "Y": "X"}.get(channel, channel) if is_ned else channel
        maps[name] = replace(entry, channel=name)
        series[name] = tuple(
            converter.convert(name, source, [use(n) for n in names], common)
            for source, names in zip(entry.sources, names_of_sources, strict=True)
        )
    for column in others:
        if column not in series:
            signal = use(column)
            time = common if signal.time is None else signal.time
            maps[column] = ChannelMap(column, (SignalSource((column,), unit=signal.unit),), optional=True)
            series[column] = (RawSeries(column, column, time, signal.values),)
    return maps, series


def fitting_presets(recording: RawRecording, still: Collection[str] = ()) -> tuple[str, ...]:
    """Return the presets whose sources a recording has, and that give vx, r and delta of it.

    One that would take a required channel from a signal in `still`, which never changes, does not fit.
    """
    infos = {info.name: info for info in recording.channels()}
    resolver, fitting = _Resolver(recording.name, infos, SignalMap("", ())), []
    own = getattr(recording, "own_clocks", False)
    for name in preset_names():
        resolver.map = _preset(name)
        with suppress(MapError):
            found, _ = resolver.resolve_all(())
            required = {name for c in REQUIRED_CHANNELS for group in found.get(c, ()) for name in group}
            if (
                required.isdisjoint(still)
                and {"vx", "r", "delta"} <= found.keys()
                and (own or (resolver.map.time.source or next(iter(infos))) in infos)
            ):
                fitting.append(name)
    return tuple(fitting)


@cache
def _preset(name: str) -> SignalMap:
    return read_map(name)


class _Resolver:
    """Finds the recorded names that a map's sources mean."""

    def __init__(self, where: str, infos: Mapping, signal_map: SignalMap) -> None:
        self.where = where
        self.infos = infos
        self.map = signal_map
        self.by_type: dict[str, list[str]] = {}
        for info in infos.values():
            topics = self.by_type.setdefault(_type_name(info.type_name), [])
            if info.name.startswith("/") and topic_of(info.name) not in topics:
                topics.append(topic_of(info.name))

    def resolve_all(self, needed: Sequence[str]) -> tuple[dict[str, list[list[str]]], list[str]]:
        found: dict[str, list[list[str]]] = {}
        skipped: list[str] = []
        missing: list[tuple[str, str]] = []
        for entry in self.map.channels:
            names = [[self._resolve(name) for name in self._expand(source)] for source in entry.sources]
            absent = [name for group in names for name in group if not self._recorded(name)]
            if not absent:
                found[entry.channel] = names
            elif entry.optional and entry.channel not in needed:
                skipped.append(f"{entry.channel}: the recording has no {absent[0]}")
            else:
                missing.append((entry.channel, absent[0]))
        if missing:
            channel, absent = missing[0]
            more = f" (also missing: {', '.join(name for _, name in missing[1:6])})" if missing[1:] else ""
            what = f"the recording has no {absent!r}, mapped to {channel}{more}"
            advice = f"{nearest_names(absent, self.infos)} `split ingest LOG --list` shows all."
            raise MapError(what, where=self.where, advice=advice)
        return found, skipped

    def without_absent_elements(
        self, found: Mapping[str, list[list[str]]], signals: Mapping[str, RawSignal], needed: Sequence[str]
    ) -> tuple[dict[str, list[list[str]]], list[str]]:
        """Leave out elements past the end of every list, which only reading can tell where lengths vary."""
        kept, skipped = dict(found), []
        for channel, groups in found.items():
            names = [name for group in groups for name in group if name not in self.infos]
            absent = next((name for name in names if np.isnan(signals[name].values).all()), None)
            if absent is None:
                continue
            if not self.map.channel(channel).optional or channel in needed:
                what = f"no message has an element {absent!r}, mapped to {channel}"
                raise MapError(what, where=self.where, advice="`split ingest LOG --list` shows the lists.")
            del kept[channel]
            skipped.append(f"{channel}: no message has an element {absent}")
        return kept, skipped

    def _recorded(self, name: str) -> bool:
        """Whether a name is listed; a list of a message whose length varies is listed by its first element."""
        return name in self.infos or re.sub(r"\[\d+\]", "[0]", name) in self.infos

    def _expand(self, source: SignalSource) -> list[str]:
        suffixes = _SUFFIXES.get(source.convert, ())
        if len(source.names) == 1 and suffixes:
            base = source.names[0]
            tail = base.rsplit("/", 1)[-1] if base.startswith("/") else base.rsplit(":", 1)[-1]
            groups = {name.rsplit(".", 1)[0] for name in self.infos if "." in name}
            joint = "." if "." in tail or base in groups or not base.startswith("/") else "/"
            if ":" in base and not base.startswith("/") and not tail:
                joint = ""
            return [f"{base}{joint}{suffix}" for suffix in suffixes]
        if suffixes and len(source.names) != len(suffixes):
            what = f"{source.convert} takes {', '.join(suffixes)}, but {len(source.names)} sources are given"
            advice = "Name them in this order, or only what stands before their last letter."
            raise MapError(what, where=self.where, advice=advice)
        return list(source.names)

    def _resolve(self, name: str) -> str:
        """Return the address with its type or topic replaced as the map's `topics` says, or by the only one."""
        topic = topic_of(name)
        if name.startswith("/") and topic in self.map.topics:
            return self.map.topics[topic] + name[len(topic) :]
        if name in self.infos:
            return name
        if not name.startswith("/") and ":" in name:
            type_name, field_path = name.split(":", 1)
            if type_name in self.map.topics:
                return f"{self.map.topics[type_name]}/{field_path}"
            topics = self.by_type.get(_type_name(type_name), [])
            if len(topics) > 1:
                what = f"{len(topics)} topics are of type {type_name}: {', '.join(topics[:8])}"
                raise MapError(what, where=self.where, advice=f"Say which: `--topic {type_name}={topics[0]}`.")
            return f"{topics[0]}/{field_path}" if topics else name
        return name


def _type_name(name: str) -> str:
    return name.replace("/msg/", "/").replace("::msg::", "/").replace("::", "/").rstrip("_")


def _is_its_own_clock(signal: RawSignal | None) -> bool:
    """Tell whether a signal holds its own time stamps, as the clock of a MATLAB structure does: it is no channel."""
    if signal is None or signal.time is None or signal.values.dtype.kind not in "fiu":
        return False
    values, time = signal.values, signal.time
    if len(values) < 2 or not np.isfinite(values).all() or values[0] == values[-1]:
        return False
    second = float((values[-1] - values[0]) / (time[-1] - time[0])) if time[0] != time[-1] else 0.0
    unit = next((one for one in (1.0, 1e3, 1e6, 1e9) if abs(second / one - 1.0) < 1e-3), None)
    return unit is not None and float(np.ptp(values / unit - time)) <= _SAME_STAMP


def _extra_columns(infos: Mapping, found: Mapping, signal_map: SignalMap) -> list[str]:
    mapped = {name for groups in found.values() for names in groups for name in names}
    if signal_map.extras is not None:
        for name in signal_map.extras:
            if name not in infos:
                raise MapError(f"extras names {name!r}, which is not recorded", advice=nearest_names(name, infos))
        return [name for name in signal_map.extras if name not in mapped]
    if any(name.startswith("/") for name in infos):
        return []
    taken = {*CHANNELS, "segment", *found}
    return [name for name in infos if name not in mapped and name not in taken and infos[name].type_name != "text"]


def _time_column(infos: Mapping, signal_map: SignalMap, recording: RawRecording) -> str | None:
    if recording.clocks and (signal_map.time.source or signal_map.time.period):
        key = "source" if signal_map.time.source else "period"
        raise MapError(
            f"time: {{{key}: ...}} is for tables, its messages have times of their own",
            where=recording.name,
            advice=f"Give time: {{clock: ...}}, one of {', '.join(recording.clocks)}.",
        )
    own = getattr(recording, "own_clocks", False)  # a preset for a program's tables fits its logs, too
    if own or recording.clocks or signal_map.time.period or hasattr(recording, "paths"):
        return None
    if signal_map.time.source:
        stamp = signal_map.time.stamp
        for name in (signal_map.time.source, *([stamp.part] if stamp else [])):
            if name not in infos:
                advice = nearest_names(name, infos)
                raise MapError(f"the recording has no time column {name!r}", where=recording.name, advice=advice)
        return signal_map.time.source
    found = time_column(list(infos.values()))
    return found.name if found is not None else None


def _common_time(
    signals: Mapping[str, RawSignal],
    column: str | None,
    signal_map: SignalMap,
    recording: RawRecording,
    notes: ConversionNotes,
) -> tuple[np.ndarray | None, float, str]:
    """Return the clock that a table's columns share [s], what was subtracted, and the clock in words."""
    bare = [signal for signal in signals.values() if signal.time is None]
    if not bare:
        return None, 0.0, "time of each signal"
    if signal_map.time.period:
        period = signal_map.time.period
        notes.assumed.append(f"no time column: samples are {period:g} s apart, as the map says")
        return np.arange(len(bare[0].values)) * period, 0.0, f"row number times {period:g} s"
    if column is None:
        advice = f"{_TIME_ADVICE} Or give `--row-rate HZ`.{_rate_from_yaw(signal_map, signals)}"
        raise MapError("no column of time was found", where=recording.name, advice=advice)
    raw = signals[column]
    unit = signal_map.time.unit or raw.unit
    if unit is None:
        notes.assumed.append(f"time column {column!r} in s (neither file nor map says)")
    elif getattr(find_unit(unit), "si", "") != "s":
        raise MapError(f"time column {column!r} is in {unit!r}", where=recording.name, advice=_TIME_ADVICE)
    finite = np.isfinite(raw.values)
    if not finite.any():
        raise LogError(f"the time column {column!r} holds no number", where=recording.name, advice=_TIME_ADVICE)
    if stamp := signal_map.time.stamp:
        first = float(np.floor(raw.values[finite][0]))
        joined = stamp.joined(over_midnight(raw.values), signals[stamp.part].values, first)
        if joined is None:
            what, advice = f"{stamp.part} reaches a whole second", f"Name the column that holds the {stamp.key}."
            raise MapError(what, where=recording.name, advice=advice)
        return joined, first, f"columns {column} and {stamp.part}"
    first = float(raw.values[finite][0])
    values = over_midnight(raw.values, 1.0 / find_unit(unit or "s").factor)
    # Subtract before the conversion: nanoseconds since 1970 lose nothing then.
    time = convert_to_si(values - first, unit or "s", where=recording.name)
    step = float(np.median(np.abs(np.diff(time[finite])))) if finite.sum() > 1 else 0.0
    fits = unit_of_time(raw.values[finite])
    if step > _SLOWEST or (unit in (None, "s") and fits == "d"):
        error = ClockError(
            f"samples of {column!r} are {step:.3g} s apart, its unit being taken as {unit or 's'}",
            where=recording.name,
            advice=f"No drive is recorded so: it is probably in {fits}. "
            f"Set `time: {{source: {column}, unit: {fits}}}`.",
        )
        error.unit = fits
        raise error
    return time, float(convert_to_si(np.array([first]), unit or "s")[0]), f"column {column}"


def _parted_by_runs(
    common: np.ndarray, signals: Mapping[str, RawSignal], notes: ConversionNotes, gap: float
) -> np.ndarray:
    """Return the clock with a pause wherever a column that numbers runs changes and the clock goes on [s].

    In a table of several runs with one clock the motion jumps from the end of one to the beginning of the next.
    """
    for name, signal in signals.items():
        values = signal.values
        if signal.time is not None or not _NUMBERS_RUNS.fullmatch(name.strip()) or not np.isfinite(values).all():
            continue
        changes = np.flatnonzero(np.diff(values))
        step = np.diff(common)
        joined = changes[np.abs(step[changes]) < 2.0 * np.nanmedian(step)]
        if len(joined) and len(changes) < _MOST_CHANGES * len(values):
            apart = pause_between_runs([(common, s.values) for s in signals.values() if s.time is None], gap)
            pause = np.zeros(len(values))
            pause[joined + 1] = apart
            said = f"{name} changes {len(joined)} times while the time goes on"
            notes.conversions.append(f"{said}: each run is a segment, {apart:g} s behind the one before")
            return common + np.cumsum(pause)
    return common


def _rate_from_yaw(signal_map: SignalMap, signals: Mapping[str, RawSignal]) -> str:
    """Return in words the rate at which yaw turns as the yaw rate says; empty where the two do not tell."""
    entries = [signal_map.channel("yaw"), signal_map.channel("r")]
    if any(e is None or len(e.sources) != 1 or len(e.sources[0].names) != 1 for e in entries):
        return ""
    made = []
    for entry in entries:
        source = entry.sources[0]
        signal = signals[source.names[0]]
        unit = find_unit(source.unit or signal.unit or expected_unit(entry.channel) or "1")
        made.append((signal.values * source.scale + source.offset) * (unit.factor if unit else 1.0))
    rate = row_rate_from_yaw(*made)
    return f" Its yaw turns as its yaw rate says at {rate:.4g} Hz." if rate else ""


def row_rate_from_yaw(yaw: np.ndarray, r: np.ndarray) -> float | None:
    """Return the rows a second at which dyaw/dt = r [Hz]; None where the two do not go together.

    Parameters
    ----------
    yaw, r : ndarray, shape (N,)
        [rad], [rad/s], one value a row. Columns that hold their values over several rows are allowed.
    """
    good = np.isfinite(yaw) & np.isfinite(r)
    return _row_rate(np.unwrap(yaw[good]), r[good])


def row_rate_from_path(X: np.ndarray, Y: np.ndarray, vx: np.ndarray, vy: np.ndarray | None = None) -> float | None:
    """Return the rows a second at which the path grows as v_x says [Hz]; None where the two do not go together.

    Parameters
    ----------
    X, Y, vx, vy : ndarray, shape (N,)
        [m], [m/s], one value a row. Columns that hold their values over several rows are allowed. Without v_y a
        sliding car's path is longer than v_x says.
    """
    speed = np.abs(vx) if vy is None else np.hypot(vx, vy)
    good = np.isfinite(X) & np.isfinite(Y) & np.isfinite(speed)
    steps = np.hypot(np.diff(X[good]), np.diff(Y[good]))
    return _row_rate(np.concatenate([[0.0], np.cumsum(steps)]), speed[good])


def row_rate_from_speed(vx: np.ndarray, ax: np.ndarray) -> float | None:
    """Return the rows a second at which dv_x/dt = a_x [Hz], v_y r left out; None where the two do not go together.

    Parameters
    ----------
    vx, ax : ndarray, shape (N,)
        [m/s], [m/s^2], one value a row.
    """
    good = np.isfinite(vx) & np.isfinite(ax)
    return _row_rate(vx[good], ax[good])


def _row_rate(grown: np.ndarray, rate: np.ndarray) -> float | None:
    """Return the rows a second at which `grown` grows by `rate` a second [Hz]; None where it does not."""
    if len(rate) < 200:
        return None
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))])
    # Over a fiftieth of the rows: noise and held samples average out, and a drift of yaw rate stays small.
    step = max(len(grown) // 50, 2)
    a, b = grown[step:] - grown[:-step], summed[step:] - summed[:-step]
    # What explodes at the end of a log tells no rate.
    sound = np.all([np.abs(v) <= DAMAGED * np.quantile(np.abs(v), 0.9) for v in (a, b)], axis=0)
    a, b = a[sound], b[sound]
    if np.std(a) == 0.0 or np.std(b) == 0.0 or abs(np.corrcoef(a, b)[0, 1]) < 0.98:
        return None
    slope = float(np.sqrt(np.mean(b * b) / np.mean(a * a)))
    return float(f"{slope:.3g}")
