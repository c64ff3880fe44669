"""One recording and a map to a drive: gathered, cleaned, put on one clock, moved to the CG, derived, judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.errors import DriveError, LogError, MapError, nearest_names
from split_cli.files import sha256_of_file
from split_cli.logs.clean import CleanSeries, clean_series, join_clock_resets
from split_cli.logs.consistency import check_consistency
from split_cli.logs.delay import DelayEstimate, estimate_delays
from split_cli.logs.derive import DERIVATIONS, Derived, Situation, derivation_named
from split_cli.logs.drive import Drive, DriveMetadata, NoiseEstimate, Source
from split_cli.logs.gather import Gathered, Series, gather, topic_of
from split_cli.logs.noise import estimate_noise, sum_of_noise
from split_cli.logs.placing import move_to_cg
from split_cli.logs.quality import ChannelQuality, QualityReport, source_quality
from split_cli.logs.raw import Clock, Recording
from split_cli.logs.resample import (
    HIGHEST_RATE,
    Grid,
    Resampled,
    is_sampled_and_held,
    make_grid,
    resample_continuous,
    resample_held,
    runs_of,
)
from split_cli.logs.signal_map import ChannelMap, SignalMap
from split_cli.signals import CHANNELS, REQUIRED_CHANNELS
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Assembled", "IngestSettings", "assemble_drive"]

_DELAY_PASSES = 6
"""At most so many; identities of three channels are right only once all three are in time."""


@dataclass(frozen=True)
class IngestSettings:
    """What a user may set beside the map.

    Attributes
    ----------
    clock : str or None
        ``header``, ``publish`` or ``log``.
    gap : float
        Nothing is interpolated across a longer step; a new segment starts there [s].
    rate : float or None
        Of the drive [Hz]; None takes the slowest continuous required channel's, at most 100 Hz.
    delays : mapping of str to float
        Channel to delay [s], over the map's.
    estimate_delays : bool
    derive : tuple of str
        Names of derivations.
    """

    clock: Clock | None = None
    gap: float = 0.1
    rate: float | None = None
    delays: Mapping[str, float] | None = None
    estimate_delays: bool = False
    derive: tuple[str, ...] = ()


@dataclass(frozen=True)
class Assembled:
    """A drive and the report that its metadata holds as plain values."""

    drive: Drive
    quality: QualityReport


@dataclass(frozen=True)
class _Channels:
    """Cleaned sources by channel, and how each is resampled."""

    clean: dict[str, list[CleanSeries]]
    modes: dict[str, list[str]]
    maps: dict[str, ChannelMap]


def assemble_drive(
    recording: Recording,
    signal_map: SignalMap,
    vehicle: Vehicle | None = None,
    settings: IngestSettings | None = None,
) -> Assembled:
    """Make a drive of a recording.

    Parameters
    ----------
    recording : Recording
    signal_map : SignalMap
    vehicle : Vehicle, optional
        Needed for sensor places given by an axle, for derived torque, and for some checks.
    settings : IngestSettings, optional

    Raises
    ------
    MapError
        If sources are missing or of the wrong unit, or a required channel is neither mapped nor derived.
    LogError
        If nothing usable remains.
    """
    settings = settings or IngestSettings()
    derivations = _ordered([derivation_named(name).name for name in settings.derive])
    needed = _needed_channels(signal_map, derivations)
    gathered = gather(
        recording,
        signal_map,
        clock=settings.clock,
        wheel_radius=vehicle.wheel_radius if vehicle else None,
        needed=needed,
    )
    _check_required(gathered, derivations, signal_map, recording.name)
    series, joined = join_clock_resets(_with_delays(gathered, settings), settings.gap)
    channels, unusable = _clean_all(series, gathered.maps, needed, signal_map.despike)
    estimates: tuple[DelayEstimate, ...] = ()
    if settings.estimate_delays:
        channels, estimates = _apply_delays(channels, needed, settings, vehicle, recording.name)
    grid, too_short = _grid(channels, needed, settings, recording.name)
    resampled = _resample_all(channels, grid, settings, needed)
    noise, qualities = _noise_and_quality(channels, resampled, settings, needed)
    columns = _columns(channels, resampled)
    grid, columns, dropped = _without_missing(grid, columns, needed)
    slices = _slices(grid.segment)
    conversions = [*gathered.conversions, *joined]
    move_to_cg(columns, gathered.maps, vehicle, grid.period, slices, noise, conversions, before=True)
    made = _derive(derivations, columns, grid, slices, vehicle, signal_map)
    move_to_cg(columns, gathered.maps, vehicle, grid.period, slices, noise, conversions, before=False)
    made += _derive(derivations, columns, grid, slices, vehicle, signal_map, skip=len(made))
    kinds, warnings = _kinds(gathered, made, columns)
    for name, derived in made:
        for channel in derived.columns:
            noise[channel] = NoiseEstimate(channel, None, None, reason=f"derived ({name})")
    warnings += unusable
    if too_short or dropped:
        warnings.append(f"{too_short + dropped} rows of stretches too short to use were left out")
    drive = _drive(recording, grid, columns, vehicle)
    consistency = check_consistency(drive, vehicle, kinds)
    quality = QualityReport(
        channels=tuple(qualities),
        segments=len(slices),
        duration=len(drive) * grid.period,
        recorded=max(
            (float(part.time[-1] - part.time[0]) for c in needed for part in channels.clean.get(c, [])),
            default=0.0,
        ),
        origin=gathered.origin + float(grid.time[0]),
        clock=gathered.clock,
        consistency=consistency,
        delays=estimates,
        assumed=gathered.assumed,
        contradictions=gathered.contradictions,
        skipped=gathered.skipped,
        warnings=tuple([*warnings, *(f"{n.where}: {n.count} x {n.what}" for n in recording.notes)]),
    )
    metadata = DriveMetadata(
        sources=(Source(recording.name, sha256_of_file(recording.path) if recording.path.exists() else ""),),
        vehicle=vehicle.name if vehicle else "",
        kinds=kinds,
        signal_map={"map": signal_map.name, **signal_map.content},
        conversions=tuple(dict.fromkeys(conversions)),
        noise=tuple(noise[channel] for channel in columns if channel in noise),
        quality=quality.to_mapping(),
    )
    return Assembled(replace(drive, metadata=metadata), quality)


def _ordered(names: Sequence[str]) -> list[str]:
    return [name for name in DERIVATIONS if name in names]


def _needed_channels(signal_map: SignalMap, derivations: Sequence[str]) -> list[str]:
    """Return the channels that must be recorded: required ones, less what is derived, plus what that takes."""
    mapped = {entry.channel for entry in signal_map.channels}
    needed = list(REQUIRED_CHANNELS)
    for name in reversed(derivations):
        derivation = DERIVATIONS[name]
        needed = [c for c in needed if c not in derivation.makes or (c in mapped and len(derivation.makes) > 1)]
        settings = signal_map.derivations.get(name.replace("-", "_"), {})
        for key in settings:
            if key not in derivation.settings:
                raise MapError(
                    f"unknown key {key!r} in derivations.{name.replace('-', '_')}",
                    where=signal_map.name,
                    advice=nearest_names(key, derivation.settings),
                )
        needed += [channel for channel in derivation.inputs(settings, mapped) if channel not in needed]
    return needed


def _check_required(gathered: Gathered, derivations: Sequence[str], signal_map: SignalMap, where: str) -> None:
    made = {channel for name in derivations for channel in DERIVATIONS[name].makes}
    missing = [c for c in REQUIRED_CHANNELS if c not in gathered.series and c not in made]
    if not missing:
        return
    ways = [name for name, entry in DERIVATIONS.items() if missing[0] in entry.makes]
    configured = [name for name in ways if name.replace("-", "_") in signal_map.derivations]
    how = (
        f"Or derive it: {', '.join('--derive ' + name for name in configured or ways)}."
        if ways
        else "Map it to a recorded signal."
    )
    skipped = next((text for text in gathered.skipped if text.startswith(f"{missing[0]}:")), None)
    raise MapError(
        f"the required channel {missing[0]} is {'not recorded (' + skipped + ')' if skipped else 'not mapped'}"
        + (f" (also {', '.join(missing[1:])})" if missing[1:] else ""),
        where=where,
        advice=f"{how} `split ingest LOG --list` shows what is recorded.",
    )


def _with_delays(gathered: Gathered, settings: IngestSettings) -> dict[str, tuple[Series, ...]]:
    given = dict(settings.delays or {})
    for channel in given:
        if channel not in gathered.series:
            raise MapError(f"a delay is given for {channel!r}", advice=nearest_names(channel, gathered.series))
    return {
        channel: tuple(replace(part, delay=given.get(channel, part.delay)) for part in parts)
        for channel, parts in gathered.series.items()
    }


def _clean_all(
    series: Mapping[str, Sequence[Series]],
    maps: Mapping[str, ChannelMap],
    needed: Sequence[str],
    despike: bool,
) -> tuple[_Channels, list[str]]:
    """Clean every source; an optional channel that holds nothing usable is left out, and said."""
    left_out: list[str] = []
    clean: dict[str, list[CleanSeries]] = {}
    modes: dict[str, list[str]] = {}
    for channel, parts in series.items():
        entry = maps[channel]
        held = entry.resample == "held" or entry.kind == "command"
        try:
            cleaned = [clean_series(part, despike=despike, held=held or _may_hold(channel)) for part in parts]
        except LogError as error:
            if channel in needed:
                raise
            left_out.append(f"{channel} was left out: {error.what}")
            continue
        if channel == "yaw":
            cleaned = [replace(part, values=np.unwrap(part.values)) for part in cleaned]
        clean[channel] = cleaned
        modes[channel] = [_mode(channel, entry, part) for part in cleaned]
    return _Channels(clean, modes, {name: maps[name] for name in clean}), left_out


def _may_hold(channel: str) -> bool:
    """Whether a channel may be an input, whose steps are its nature: steer angle, torque, or one not known."""
    return channel not in CHANNELS or CHANNELS[channel].kind == "held"


def _mode(channel: str, entry: ChannelMap, part: CleanSeries) -> str:
    if entry.resample:
        return entry.resample
    if entry.kind == "command":
        return "held"
    if _may_hold(channel):
        return "held" if is_sampled_and_held(part.values) else "continuous"
    return CHANNELS[channel].kind


def _gap_of(part: CleanSeries, mode: str, needed: bool, gap: float) -> float:
    """Return the longest step of a source that is bridged [s]; slow optional channels and commands get more."""
    if mode == "held":
        return max(gap, 5.0 * part.period)
    return gap if needed else max(gap, 2.5 * part.period)


def _grid(channels: _Channels, needed: Sequence[str], settings: IngestSettings, where: str) -> tuple[Grid, int]:
    spans, slowest = [], 0.0
    for channel in needed:
        for part, mode in zip(channels.clean[channel], channels.modes[channel], strict=True):
            gap = _gap_of(part, mode, True, settings.gap)
            if mode != "held":
                if part.period > gap:
                    raise LogError(
                        f"{channel} comes every {part.period:.3g} s, longer than the gap of {gap:g} s",
                        where=part.source,
                        advice=f"Set --gap {2.5 * part.period:.2g} to interpolate it.",
                    )
                slowest = max(slowest, _true_period(part, gap))
            reach = gap if mode == "held" else 0.0
            spans.append(
                [(float(part.time[a]), float(part.time[b - 1]) + reach) for a, b in runs_of(part.time, gap)]
            )
    slowest = slowest or max(_true_period(p, settings.gap) for c in needed for p in channels.clean[c])
    period = _period(slowest, settings.rate, where)
    grid, left_out = make_grid(spans, period)
    if not len(grid.index):
        raise LogError(
            "no time is covered by all required channels without a gap",
            where=where,
            advice=_coverage(channels, needed),
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
            raise LogError(f"the rate is {rate:g} Hz, it must be positive", where=where)
        if 1.0 / rate < slowest * 0.99:
            raise LogError(
                f"a rate of {rate:g} Hz is above the slowest required channel's {1.0 / slowest:.4g} Hz",
                where=where,
                advice="A drive is never upsampled.",
            )
        return 1.0 / rate
    period = max(slowest, 1.0 / HIGHEST_RATE)
    # A clock that is nominally 25 Hz reads 24.998: within 1 %, the round figure is what the logger meant.
    for nice in (1.0 / round(1.0 / period), round(period, 3), round(period, 4)):
        if nice > 0 and abs(nice - period) < 0.01 * period:
            return nice
    return period


def _coverage(channels: _Channels, needed: Sequence[str]) -> str:
    parts = [part for channel in needed for part in channels.clean[channel]]
    return "; ".join(f"{p.channel}: {p.time[0]:.2f} to {p.time[-1]:.2f} s, {1.0 / p.period:.3g} Hz" for p in parts)


def _resample_all(
    channels: _Channels, grid: Grid, settings: IngestSettings, needed: Sequence[str]
) -> dict[tuple[str, int], Resampled]:
    """Bring every source onto the drive's clock; sources that share a clock share the work."""
    results: dict[tuple[str, int], Resampled] = {}
    together: list[tuple[CleanSeries, float, list[tuple[str, int]]]] = []
    for channel, parts in channels.clean.items():
        for index, (part, mode) in enumerate(zip(parts, channels.modes[channel], strict=True)):
            gap = _gap_of(part, mode, channel in needed, settings.gap)
            if mode == "held":
                held = resample_held(part.time, part.values, grid, longest=gap)
                results[channel, index] = Resampled(held, 1.0, (1.0,), False)
                continue
            alike = (m for p, g, m in together if g == gap and np.array_equal(p.time, part.time))
            members = next(alike, None)
            if members is None:
                together.append((part, gap, [(channel, index)]))
            else:
                members.append((channel, index))
    for part, gap, members in together:
        values = np.stack([channels.clean[channel][index].values for channel, index in members], axis=1)
        joint = resample_continuous(part.time, values, grid, gap=gap)
        for column, key in enumerate(members):
            results[key] = replace(joint, values=joint.values[:, column])
    return results


def _columns(channels: _Channels, resampled: Mapping[tuple[str, int], Resampled]) -> dict[str, np.ndarray]:
    return {
        channel: np.sum([resampled[channel, index].values for index in range(len(parts))], axis=0)
        for channel, parts in channels.clean.items()
    }


def _noise_and_quality(
    channels: _Channels,
    resampled: Mapping[tuple[str, int], Resampled],
    settings: IngestSettings,
    needed: Sequence[str],
) -> tuple[dict[str, NoiseEstimate], list[ChannelQuality]]:
    noise: dict[str, NoiseEstimate] = {}
    qualities: list[ChannelQuality] = []
    for channel, parts in channels.clean.items():
        estimates = []
        for index, (part, mode) in enumerate(zip(parts, channels.modes[channel], strict=True)):
            gap = _gap_of(part, mode, channel in needed, settings.gap)
            result = resampled[channel, index]
            words = "held" if mode == "held" else "low-passed" if result.low_passed else "interpolated"
            qualities.append(source_quality(part, gap, words))
            if channel not in CHANNELS:
                continue
            if mode == "held":
                estimates.append(NoiseEstimate(channel, None, None, reason="held between updates"))
                continue
            runs = runs_of(part.time, gap)
            filtered = {"gain": result.gain, "autocorrelation": result.autocorrelation}
            estimates.append(estimate_noise(channel, part.values, runs, **filtered))
        if estimates:
            noise[channel] = sum_of_noise(channel, estimates)
    return noise, qualities


def _without_missing(
    grid: Grid, columns: dict[str, np.ndarray], needed: Sequence[str]
) -> tuple[Grid, dict[str, np.ndarray], int]:
    """Leave out rows where a required channel is missing, and number segments anew."""
    present = np.all([np.isfinite(columns[channel]) for channel in needed], axis=0)
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
    kept = Grid(grid.origin, grid.period, grid.index[rows], segment)
    return kept, {name: values[rows] for name, values in columns.items()}, len(present) - len(rows)


def _slices(segment: np.ndarray) -> list[slice]:
    edges = [0, *(np.flatnonzero(np.diff(segment)) + 1).tolist(), len(segment)]
    return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]


def _derive(
    derivations: Sequence[str],
    columns: dict[str, np.ndarray],
    grid: Grid,
    slices: list[slice],
    vehicle: Vehicle | None,
    signal_map: SignalMap,
    skip: int | None = None,
) -> list[tuple[str, Derived]]:
    """Run the derivations whose turn it is: velocities first (`skip` None), then all others."""
    first = [name for name in derivations if name == "velocity-from-pose"]
    made = []
    for name in first if skip is None else derivations[len(first) :]:
        derivation = DERIVATIONS[name]
        missing = [channel for channel in derivation.needs if channel not in columns]
        if missing:
            raise MapError(f"--derive {name} needs {', '.join(missing)}", advice="Map or derive it too.")
        settings = signal_map.derivations.get(name.replace("-", "_"), {})
        derived = derivation.run(Situation(columns, grid.period, slices, vehicle, settings))
        columns.update(derived.columns)
        made.append((name, derived))
    return made


def _kinds(
    gathered: Gathered, made: Sequence[tuple[str, Derived]], columns: Mapping[str, np.ndarray]
) -> tuple[dict[str, str], list[str]]:
    kinds: dict[str, str] = {}
    warnings: list[str] = []
    for channel in columns:
        if channel in CHANNELS:
            entry = gathered.maps.get(channel)
            kinds[channel] = (entry.kind if entry else None) or "measured"
            if channel in ("T", "delta") and entry is not None and entry.kind is None:
                warnings.append(f"{channel} was taken as measured (the map says neither command nor measured)")
    for _, derived in made:
        for channel in derived.columns:
            kinds[channel] = f"derived: {derived.how}"
        if derived.warning:
            warnings.append(derived.warning)
    return kinds, warnings


def _drive(recording: Recording, grid: Grid, columns: Mapping[str, np.ndarray], vehicle: Vehicle | None) -> Drive:
    ordered = {"t": (grid.index - grid.index[0]) * grid.period}
    for name in (*CHANNELS, *columns):
        if name in columns and name != "t":
            ordered[name] = columns[name]
    try:
        return Drive(recording.name, ordered, grid.segment, grid.period)
    except DriveError as error:
        raise MapError(error.what, where=recording.name, advice=error.advice) from error


def _apply_delays(
    channels: _Channels,
    needed: Sequence[str],
    settings: IngestSettings,
    vehicle: Vehicle | None,
    where: str,
) -> tuple[_Channels, tuple[DelayEstimate, ...]]:
    """Estimate delays on the drive's clock and move the raw times, until another estimate finds nothing more."""
    fixed = frozenset(settings.delays or {})
    commands = frozenset(c for c, entry in channels.maps.items() if entry.kind == "command")
    total: dict[str, DelayEstimate] = {}
    for _ in range(_DELAY_PASSES):
        moved = _moved(channels, {channel: estimate.delay for channel, estimate in total.items()})
        grid, _ = _grid(moved, needed, settings, where)
        columns = _columns(moved, _resample_all(moved, grid, settings, needed))
        slices = _slices(grid.segment)
        for before in (True, False):
            move_to_cg(columns, channels.maps, vehicle, grid.period, slices, {}, [], before=before)
        topics = {c: topic_of(parts[0].source) for c, parts in channels.clean.items()}
        found = estimate_delays(columns, grid.period, slices, vehicle, topics, fixed, commands)
        for estimate in found:
            known = total.get(estimate.channel)
            total[estimate.channel] = estimate if known is None else known.refined(estimate)
        if all(e.refusal or abs(e.delay) < max(0.1 * e.error, 1e-4) for e in found):
            break
    applied = {channel: estimate.applied for channel, estimate in total.items()}
    return _moved(channels, applied), tuple(total.values())


def _moved(channels: _Channels, delays: Mapping[str, float]) -> _Channels:
    """Return the channels with their times moved earlier by `delays` [s]."""
    clean = {
        channel: [replace(part, time=part.time - delays.get(channel, 0.0)) for part in parts]
        for channel, parts in channels.clean.items()
    }
    return replace(channels, clean=clean)
