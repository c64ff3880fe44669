"""One recording and a map to a drive: gathered, cleaned, put on one clock, moved to the CG, derived, judged."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from split_cli.errors import ClockError, DriveError, MapError, SplitError, nearest_names
from split_cli.files import sha256_of_file
from split_cli.logs.assembling.clean import USUAL_GAP, join_clock_resets, resumptions
from split_cli.logs.assembling.conversion import RawSeries
from split_cli.logs.assembling.derivation import DerivationInputs, Derived
from split_cli.logs.assembling.derivations import DERIVATIONS, WITHOUT_RATE, can_derive, derivation_named, reachable
from split_cli.logs.assembling.gather import Gathered, gather, topic_of
from split_cli.logs.assembling.kinds import between_of, kinds_of, unlike_a_sensor
from split_cli.logs.assembling.moving_to_cg import move_to_cg
from split_cli.logs.assembling.quality import EARLIER, UNSTATED, QualityReport
from split_cli.logs.assembling.repeated_rows import without_repeated_rows
from split_cli.logs.assembling.resample import SampleClock
from split_cli.logs.assembling.standstills import standstills_of, stopped
from split_cli.logs.assembling.synchronize import (
    Channels,
    bring_to_clock,
    clean_channels,
    lay_grid,
    moved_earlier,
    resample_channels,
    slices_of,
    sum_sources,
    without_absent,
    without_missing,
)
from split_cli.logs.assembling.trim import first_sample, trim
from split_cli.logs.checking.channel_delays import DelayEstimate, estimate_delays
from split_cli.logs.checking.checks import NOT_RECORDED
from split_cli.logs.checking.consistency import Consistency, check_consistency
from split_cli.logs.checking.copies import copied_channels
from split_cli.logs.checking.late_channels import late_channels
from split_cli.logs.drive import Drive, DriveMetadata, NoiseEstimate, Source, metadata_of_drive
from split_cli.logs.drive_metadata import yaw_rate_is_of_acceleration
from split_cli.logs.map_entries import EXTRA_UNITS, SignalMap, TimeBase
from split_cli.logs.one_car import of_one_car
from split_cli.logs.raw import NO_CHECKSUMS, Clock, RawRecording
from split_cli.logs.scratch import set_aside
from split_cli.signals import CHANNELS, REQUIRED_CHANNELS
from split_cli.vehicle.parameters import Vehicle

MOST_CHECKED = 2**20
"""Rows in the middle of a drive whose channels are checked against each other: hours show any wrong unit."""
_MOST_BESIDE_A_CLOCK = 3
"""Findings that are reported beside a clock in another unit [1]: an error is a line."""
_SAME_START = 0.01
"""Within which a drive begins with its recording: as exactly as times are known [s]."""
_DELAY_PASSES = 6
"""At most so many; identities of three channels are right only once all three are in time."""


@dataclass(frozen=True)
class IngestSettings:
    """What a user may set beside the map."""

    clock: Clock | None = None  # ``header``, ``publish`` or ``log``
    # Nothing is interpolated across a longer step; a new segment starts there [s]. None takes 0.1 s, and two and a
    # half samples of a needed channel that comes at about 10 Hz.
    gap: float | None = None
    # Of the drive [Hz]; None takes the slowest continuous required channel's, at most 100 Hz.
    rate: float | None = None
    delays: Mapping[str, float] | None = None  # channel to delay [s], over the map's
    estimate_delays: bool = False
    derive: tuple[str, ...] = ()  # names of derivations
    row_rate: float | None = None  # rows a second of a table without a column of time [Hz], over the map's period
    # start, end: what is before and after is left out, from the recording's first sample [s].
    start: float | None = None
    end: float | None = None
    # What is between is left out, from the recording's first sample [s]; a new segment starts after it.
    cuts: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Assembled:
    """A drive and the report that its metadata holds as plain values."""

    drive: Drive
    quality: QualityReport


def assemble_drive(
    recording: RawRecording,
    signal_map: SignalMap,
    vehicle: Vehicle | None = None,
    settings: IngestSettings | None = None,
) -> Assembled:
    """Make a drive of a recording.

    Parameters
    ----------
    vehicle : Vehicle, optional
        Needed for sensor places given by an axle, for derived torque, and for some checks.

    Raises
    ------
    MapError
        If sources are missing or of the wrong unit, or a required channel is neither mapped nor derived.
    LogError
        If nothing usable remains, or the time is in another unit: with what the checks say with the right one.
    """
    settings = settings or IngestSettings()
    recording = of_one_car(recording, signal_map.rows)
    try:
        return _assemble(recording, signal_map, vehicle, settings)
    except ClockError as error:
        if not error.unit:
            raise
        right = replace(signal_map, time=replace(signal_map.time, unit=error.unit))
        try:
            if right == signal_map:
                raise error
            more = _said_then(lambda: _assemble(recording, right, vehicle, settings))
        except ClockError as again:
            advice = "No unit of time makes a drive of it: map another column in the entry `time:`."
            raise ClockError(error.what, where=error.where, advice=advice) from again
        advice = f"{error.advice}{more and f' With the time in {error.unit}: {more}'}"
        raise ClockError(error.what, where=error.where, advice=advice) from error


def _said_then(assemble: Callable[[], Assembled]) -> str:
    """Return what else is wrong with a log once its clock is right; empty where nothing is."""
    try:
        found = assemble().quality.consistency.findings
    except ClockError:
        raise
    except SplitError as error:
        return str(error)
    return " ".join(f"{finding.channel}: {finding.text}" for finding in found[:_MOST_BESIDE_A_CLOCK])


def _assemble(
    recording: RawRecording, signal_map: SignalMap, vehicle: Vehicle | None, settings: IngestSettings
) -> Assembled:
    gap, signal_map = _gap_and_map(settings, signal_map)
    asked = {derivation_named(name).name for name in settings.derive}
    derivations = [name for name in DERIVATIONS if name in asked]
    needed = _needed_channels(signal_map, derivations)
    gathered = gather(
        recording,
        signal_map,
        clock=settings.clock,
        wheel_radius=vehicle.wheel_radius if vehicle else None,
        needed=needed,
        gap=gap,
    )
    _check_required(gathered, derivations, signal_map, recording.name)
    delayed, twice = without_repeated_rows(_with_delays(gathered, settings), gap)
    series, joined = join_clock_resets(delayed, gap)
    paused = _pauses(delayed, series) if joined else 0.0
    del delayed
    resumed = resumptions(series, gap)
    zero = first_sample(series)
    series, trimmed = trim(series, settings.start, settings.end, settings.cuts, gap)
    gathered = replace(gathered, series={})  # each stage lets go of what the one before held
    widened = settings.gap is None
    channels, unusable = clean_channels(
        series, gathered.maps, needed, gap=gap, despike=signal_map.despike, widened=widened, resumed=resumed
    )
    del series
    estimates: tuple[DelayEstimate, ...] = ()
    if settings.estimate_delays:
        channels, estimates = _apply_delays(channels, settings, vehicle, recording.name)
    grid, too_short = lay_grid(channels, settings.rate, recording.name)
    cut_short = channels.cut_short()
    standing = standstills_of(channels)
    columns, noise, qualities = bring_to_clock(channels, grid)
    grid, columns, dropped = without_missing(grid, columns, needed)
    unusable += without_absent(channels, columns, grid, recording.clocks)
    conversions = [*gathered.conversions, *twice, *joined, *trimmed]
    made, grid = _place_and_derive(derivations, columns, grid, vehicle, signal_map, gathered, noise, conversions)
    before = metadata_of_drive(recording.path)
    kinds, warnings = kinds_of(gathered, made, columns, before, noise)
    if too_short or dropped:
        warnings.append(f"{too_short + dropped} rows of stretches too short to use were left out")
    drive = _drive(recording, grid, columns)
    consistency = _checked(drive, vehicle, kinds, signal_map, settings, warnings)
    failed = stopped(standing, drive, float(grid.time[0]))
    named = {finding.channel for finding in failed}
    others = (f for f in consistency.findings if f.check != "stopped" or f.channel not in named)
    consistency = replace(consistency, findings=(*others, *failed))
    warnings += unlike_a_sensor(drive, kinds, noise, qualities)
    warnings += _beginning(consistency, float(grid.time[0]) - zero)
    quality = QualityReport(
        channels=tuple(qualities),
        segments=len(slices_of(grid.segment)),
        duration=len(drive) * grid.period,
        recorded=max(float(part.time[-1] - part.time[0]) for c in needed for part in channels.clean[c]) - paused,
        origin=gathered.origin + float(grid.time[0]),
        clock=gathered.clock,
        consistency=consistency,
        delays=estimates,
        assumed=(*_assumed_before(before), *_assumed_now(gathered.assumed, before)),
        contradictions=gathered.contradictions,
        skipped=gathered.skipped,
        warnings=(
            *warnings,
            *channels.bridged(),
            *cut_short,
            *unusable,
            *(f"{n.where}: {f'{n.count} x ' * (n.count > 1)}{n.what}" for n in recording.notes),
        ),
    )
    quality = replace(quality, unverified=_unverified(recording.path, before))
    metadata = DriveMetadata(
        sources=_sources(recording),
        vehicle=vehicle.name if vehicle else "",
        kinds=kinds,
        signal_map={"map": signal_map.name, **signal_map.content},
        conversions=tuple(dict.fromkeys([*(before.conversions if before is not None else ()), *conversions])),
        noise=tuple(noise[channel] for channel in columns if channel in noise),
        quality=quality.to_mapping(),
        between=between_of(channels, made, columns),
    )
    return Assembled(replace(drive, metadata=metadata), quality)


def _gap_and_map(settings: IngestSettings, signal_map: SignalMap) -> tuple[float, SignalMap]:
    """Return the longest step that is bridged [s], and the map with the rate of rows that was asked for."""
    gap = USUAL_GAP if settings.gap is None else settings.gap
    if not gap > 0:
        raise MapError(f"the gap is {gap:g} s, it must be positive", advice="Give --gap in seconds.")
    if settings.row_rate is None:
        return gap, signal_map
    if not settings.row_rate > 0:
        raise MapError(f"the row rate is {settings.row_rate:g} Hz", advice="Give --row-rate in rows a second.")
    return gap, replace(signal_map, time=TimeBase(period=1.0 / settings.row_rate))


def _checked(
    drive: Drive,
    vehicle: Vehicle | None,
    kinds: Mapping[str, str],
    signal_map: SignalMap,
    settings: IngestSettings,
    warnings: list[str],
) -> Consistency:
    """Check channels against each other, of a long drive on its middle, which is a warning."""
    checked = drive
    if len(drive) > MOST_CHECKED:
        first = (len(drive) - MOST_CHECKED) // 2
        checked = drive.stretch(first, first + MOST_CHECKED)
        minutes = len(checked) * drive.period / 60.0
        warnings.append(f"channels were checked against each other on the middle {minutes:.3g} minutes")
    copied = copied_channels(checked, kinds)
    # A copy was not measured and contradicts nobody.
    measured = {**kinds, **{finding.channel: NOT_RECORDED for finding in copied}}
    consistency = check_consistency(checked, vehicle, measured, _certain(signal_map))
    found = consistency.findings
    if yaw_rate_is_of_acceleration(kinds):
        also = " r was derived from a_y, so the mistake may be one of a_y instead."
        found = tuple(
            replace(f, text=f.text + also) if f.channel == "delta" and f.check in ("scale", "sign") else f
            for f in found
        )
    consistency = replace(consistency, findings=(*copied, *found))
    if settings.estimate_delays:
        return consistency
    late, unseen = late_channels(checked, vehicle, measured, consistency)
    findings, unjudged = (*consistency.findings, *late), (*consistency.unjudged, *unseen)
    return replace(consistency, findings=findings, unjudged=unjudged)


def _beginning(found: Consistency, offset: float) -> list[str]:
    """Say from where ``--cut`` counts, `offset` [s] before the drive, where a finding advises it."""
    if abs(offset) < _SAME_START or not any("--cut" in finding.text for finding in found.findings):
        return []
    return [f"t = 0 is {offset:.2f} s after the recording's first sample, from which --start, --end and --cut count"]


def _sources(recording: RawRecording) -> tuple[Source, ...]:
    joined = getattr(recording, "paths", None)
    paths = joined or (recording.path,)
    return tuple(
        Source(path.name if joined else recording.name, sha256_of_file(path) if path.exists() else "") for path in paths
    )


def _certain(signal_map: SignalMap) -> frozenset[str]:
    """Return what the checks look for no mistake in: X, Y of a satellite fix are east and north."""
    converts = {entry.channel: entry.sources[0].convert for entry in signal_map.channels if entry.sources}
    fixed = converts.get("X") == "local_x" and converts.get("Y") == "local_y"
    return frozenset({"hand"}) if fixed else frozenset()


_WITH_CHECKSUMS = (".mcap", ".mcap.zstd", ".mcap.zst", ".npz", ".gz", ".bz2", ".xz", ".zip")
"""Ends of names of formats with checksums that are compared; the reader of MCAP notes messages that have none."""
_PARTS_WITHOUT = (".db3", ".db3.zstd", ".npy")
"""Ends of names of files, of which folders are one recording, without any."""


def _unverified(path: Path, before: DriveMetadata | None) -> str:
    """Return what to say of a source without checksums; drives of ours have them."""
    if before is not None or not path.exists():
        return ""
    if path.is_dir():
        unchecked = any(file.name.lower().endswith(_PARTS_WITHOUT) for file in path.iterdir())
    else:
        unchecked = not path.name.lower().endswith(_WITH_CHECKSUMS)
    return f"the file has no checksums: {NO_CHECKSUMS}" if unchecked else ""


def _assumed_now(assumed: Sequence[str], before: DriveMetadata | None) -> tuple[str, ...]:
    """Return what this ingest assumes; columns of a drive are in SI by definition."""
    return tuple(text for text in assumed if before is None or not text.endswith(UNSTATED))


def _assumed_before(before: DriveMetadata | None) -> tuple[str, ...]:
    assumed = before.quality.get("assumed", ()) if before is not None else ()
    return tuple(text if text.endswith(EARLIER) else f"{text}{EARLIER}" for text in map(str, assumed))


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
                what = f"unknown key {key!r} in derivations.{name.replace('-', '_')}"
                raise MapError(what, where=signal_map.name, advice=nearest_names(key, derivation.settings))
        needed += [channel for channel in derivation.inputs(settings, mapped) if channel not in needed]
    return needed


def _misspelt(channel: str, signal_map: SignalMap) -> str:
    """Return the names of the map that no program knows as a channel, or the one spelled nearly as a required one."""
    others = [one.channel for one in signal_map.channels if one.channel not in CHANNELS]
    close = get_close_matches(channel, others)[:1] or [name for name in others if name not in EXTRA_UNITS]
    named = ", ".join(map(repr, close[:3]))
    which = "are no channels: is one of them" if len(close) > 1 else "is no channel: is it"
    return f" The map has {named}, which {which} meant?" if close else ""


def _check_required(gathered: Gathered, derivations: Sequence[str], signal_map: SignalMap, where: str) -> None:
    made = {channel for name in derivations for channel in DERIVATIONS[name].makes}
    missing = [c for c in REQUIRED_CHANNELS if c not in gathered.series and c not in made]
    if not missing:
        return
    skipped = [text for text in gathered.skipped if text.partition(":")[0] in missing]
    many = len(missing) > 1
    reached = reachable({*gathered.series, *made})
    raise MapError(
        f"{' and '.join([', '.join(missing[:-1]), missing[-1]] if many else missing)} {'are' if many else 'is'} "
        f"required and not mapped{' (not recorded: ' + '; '.join(skipped) + ')' if skipped else ''}",
        where=where,
        advice=" ".join(_way_to(channel, signal_map, reached) + _misspelt(channel, signal_map) for channel in missing)
        + " `split ingest LOG --list` shows what is recorded.",
    )


def _way_to(channel: str, signal_map: SignalMap, reached: Collection[str]) -> str:
    """Return how a required channel comes into the drive: as the map configures, or the recording allows."""
    ways = [name for name, entry in DERIVATIONS.items() if channel in entry.makes and channel not in entry.needs]
    ways = [name for name in ways if name.replace("-", "_") in signal_map.derivations] or ways
    if channel == "vy":
        ways = [name for name in ways if name != WITHOUT_RATE]  # named for r, of which it makes v_y as well
    possible = [name for name in ways if can_derive(name, channel, reached)]
    if channel == "delta" and "steering_wheel_angle" in reached:
        return "delta: map the steering wheel's angle once more, with `scale: 1/RATIO`."
    if possible or not ways:
        derived = f", or derive it with --derive {' or '.join(possible)}" if possible else ""
        return f"{channel}: map a recorded signal{derived}."
    takes = [f"{name} takes {', '.join(DERIVATIONS[name].needs) or 'settings in the map'}" for name in ways]
    return f"{channel}: map a recorded signal, or map what derives it ({'; '.join(takes)})."


def _pauses(before: Mapping[str, Sequence[RawSeries]], after: Mapping[str, Sequence[RawSeries]]) -> float:
    """Return what was put between runs whose clock starts again [s]: nothing was recorded then."""
    channel = next(iter(after))
    clocks = [parts[channel][0].time for parts in (before, after)]
    steps = [np.diff(clock[np.isfinite(clock)]) for clock in clocks]
    return max(float(np.sum(steps[1]) - np.sum(steps[0][steps[0] > 0.0])), 0.0)


def _with_delays(gathered: Gathered, settings: IngestSettings) -> dict[str, tuple[RawSeries, ...]]:
    given = dict(settings.delays or {})
    for channel in given:
        if channel not in gathered.series:
            advice = nearest_names(channel, gathered.series)
            raise MapError(f"--delay names {channel!r}, which is no channel of this drive", advice=advice)
    return {
        channel: tuple(replace(part, delay=given.get(channel, part.delay)) for part in parts)
        for channel, parts in gathered.series.items()
    }


def _place_and_derive(
    derivations: Sequence[str],
    columns: dict[str, np.ndarray],
    grid: SampleClock,
    vehicle: Vehicle | None,
    signal_map: SignalMap,
    gathered: Gathered,
    noise: dict[str, NoiseEstimate],
    conversions: list[str],
) -> tuple[list[tuple[str, Derived]], SampleClock]:
    """Move sensors to the CG and compute what was asked for: position first, since velocities may come from it.

    Returns what was made and the clock of the rows that are left: where a derived channel is not known, they go.
    """
    made: list[tuple[str, Derived]] = []
    slices = slices_of(grid.segment)

    def derive(name: str) -> None:
        nonlocal grid, slices
        missing = [channel for channel in DERIVATIONS[name].needs if channel not in columns]
        if missing:
            raise MapError(f"--derive {name} needs {', '.join(missing)}", advice="Map or derive it too.")
        settings = signal_map.derivations.get(name.replace("-", "_"), {})
        time = (grid.index - grid.index[0]) * grid.period
        derived = DERIVATIONS[name].run(DerivationInputs(columns, grid.period, slices, vehicle, settings, time))
        for channel, values in derived.columns.items():
            columns[channel] = set_aside(_within_limit(channel, values, conversions))
        if name == "lateral-velocity-from-sideslip" and "sideslip" in gathered.maps:
            # It is v_y where the angle was measured.
            there = {"vy": gathered.maps["sideslip"]}
            move_to_cg(columns, there, vehicle, grid.period, slices, noise, conversions, before=False)
        for channel in derived.columns:
            if not derived.keeps_noise:
                noise[channel] = NoiseEstimate(channel, None, None, reason=f"derived ({name})")
        made.append((name, derived))
        grid, _, dropped = without_missing(grid, columns, list(derived.columns))
        slices = slices_of(grid.segment) if dropped else slices

    rest = list(derivations)
    move_to_cg(columns, gathered.maps, vehicle, grid.period, slices, noise, conversions, before=True)
    if rest and rest[0] == "velocity-from-pose":
        derive(rest.pop(0))
    # What was derived from a pose at the CG is at the CG, whatever place the map gives the sensor it replaces.
    at_cg = {channel for _, derived in made for channel in derived.columns}
    measured = {channel: entry for channel, entry in gathered.maps.items() if channel not in at_cg}
    move_to_cg(columns, measured, vehicle, grid.period, slices, noise, conversions, before=False)
    for name in rest:
        derive(name)
    return made, grid


def _within_limit(channel: str, values: np.ndarray, conversions: list[str]) -> np.ndarray:
    """Return a derived channel, missing where no number is a measurement: of channels that contradict each other."""
    limit = CHANNELS[channel].limit if channel in CHANNELS else np.inf
    beyond = np.abs(values) > limit
    if not beyond.any():
        return values
    conversions.append(f"{channel}: {np.count_nonzero(beyond)} rows left out, derived as more than {limit:g}")
    return np.where(beyond, np.nan, values)


def _drive(recording: RawRecording, grid: SampleClock, columns: Mapping[str, np.ndarray]) -> Drive:
    ordered = {"t": set_aside((grid.index - grid.index[0]) * grid.period)}
    for name in (*CHANNELS, *columns):
        if name in columns and name != "t":
            ordered[name] = columns[name]
    try:
        return Drive(recording.name, ordered, grid.segment, grid.period)
    except DriveError as error:
        raise MapError(error.what, where=recording.name, advice=error.advice) from error


def _apply_delays(
    channels: Channels, settings: IngestSettings, vehicle: Vehicle | None, where: str
) -> tuple[Channels, tuple[DelayEstimate, ...]]:
    """Estimate delays on the drive's clock and move the raw times, until another estimate finds nothing more."""
    fixed = frozenset(settings.delays or {})
    commands = frozenset(c for c, entry in channels.maps.items() if entry.kind == "command")
    total: dict[str, DelayEstimate] = {}
    for _ in range(_DELAY_PASSES):
        moved = moved_earlier(channels, {channel: estimate.delay for channel, estimate in total.items()})
        grid, _ = lay_grid(moved, settings.rate, where)
        columns = sum_sources(moved, resample_channels(moved, grid))
        slices = slices_of(grid.segment)
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
    return moved_earlier(channels, applied), tuple(total.values())
