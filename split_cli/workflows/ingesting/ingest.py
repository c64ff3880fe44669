"""From recordings to drives: open, assemble, write whole or not at all."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from split_cli.errors import LogError, MapError, SplitError, nearest_names
from split_cli.files import atomic_directory, refuse_overwriting_inputs
from split_cli.logs.assembling.assemble import Assembled, IngestSettings, assemble_drive
from split_cli.logs.assembling.gather import fitting_presets, topic_of
from split_cli.logs.assembling.quality import QualityReport, render_quality
from split_cli.logs.drafting.meeting_clocks import let_clocks_meet
from split_cli.logs.drive import Drive, DriveMetadata, open_drive, read_drive, write_drive
from split_cli.logs.listing import ListedChannel, listed_channels
from split_cli.logs.map_entries import SignalMap
from split_cli.logs.raw import RawRecording, ReadNote
from split_cli.logs.readers.joint import JointRecording
from split_cli.logs.readers.opening import holds_titles_alone, open_parts, open_recording
from split_cli.logs.readers.unpacking import plain_name
from split_cli.logs.signal_map import read_map
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.engine import HERE, Engine
from split_cli.workflows.ingesting.ingest_manifest import IngestManifest, settings_digest
from split_cli.workflows.sources import SourceFile, enter_all, find_sources, is_remote

__all__ = [
    "IngestFailure",
    "IngestResult",
    "IngestRun",
    "IngestSettings",
    "ingest_logs",
    "open_listed",
    "suggest_map_for",
]

_OWN_MAPS = ("canonical", "split_sim")
"""Presets used without ``--map``: columns named as a drive's; messages of `split simulate` and `split race`."""


@dataclass(frozen=True)
class IngestResult:
    """One recording made a drive."""

    log: str
    drive_path: Path
    rows: int
    period: float  # [s]
    quality: QualityReport
    metadata: DriveMetadata
    fingerprint: str = ""  # of the recording, as `SourceFile.fingerprint` has it

    @property
    def drive(self) -> Drive:
        """The drive, read from its file, for whoever draws it."""
        return read_drive(self.drive_path)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """What the checks found that makes whatever is learned from the drive wrong, and the map can mend."""
        return self.metadata.contradictions

    def reaches(self, speed: float) -> bool:
        """Whether v_x exceeds `speed` [m/s] anywhere in the drive."""
        return bool((open_drive(self.drive_path)["vx"] > speed).any())

    def to_text(self) -> str:
        """Return the report for a terminal."""
        head = f"{self.log} -> {self.drive_path}: {self.rows} rows at {1.0 / self.period:g} Hz"
        kinds = "; ".join(self.metadata.reported_kinds)
        converted = [f"  {text}" for text in self.metadata.conversions]
        return "\n".join(
            [head, f"kinds: {kinds}", render_quality(self.quality), *(["converted:", *converted] if converted else [])]
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return what ``--json`` prints: no samples."""
        metadata = self.metadata
        return {
            "log": self.log,
            "drive": str(self.drive_path),
            "rows": self.rows,
            "period": self.period,
            "kinds": dict(metadata.kinds),
            "conversions": list(metadata.conversions),
            "noise": [
                {"channel": n.channel, "sigma": n.sigma, "sigma_raw": n.sigma_raw, "reason": n.reason}
                for n in metadata.noise
            ],
            "quality": self.quality.to_mapping(),
        }


@dataclass(frozen=True)
class IngestFailure:
    """A recording that gave no drive, where the others were to be made all the same."""

    log: str
    error: SplitError


class IngestRun(NamedTuple):
    """What became of the recordings."""

    results: tuple[IngestResult, ...]  # drives that were made
    failures: tuple[IngestFailure, ...]  # only with `keep_going`
    unchanged: tuple[str, ...]  # sources whose drive was there already


def ingest_logs(
    logs: Sequence[str | Path],
    output: str | Path,
    *,
    maps: Sequence[str | Path] = (),
    vehicle_path: str | Path | None = None,
    settings: IngestSettings | None = None,
    topics: dict[str, str] | None = None,
    message_paths: Sequence[str | Path] = (),
    keep_going: bool = False,
    engine: Engine | None = None,
    together: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> IngestRun:
    """Make a drive of every recording.

    Parameters
    ----------
    logs : sequence of path-like
        Recordings; folders, globs and addresses as `find_sources` takes them.
    output : path-like
        The drive's file for one log; for several a folder, one Parquet a log named after it, and a manifest: a
        source that is there already, unchanged and with the same settings, is not read again.
    maps : sequence of path-like
        Presets or files, later over earlier; none for a table whose columns are named as a drive's.
    vehicle_path : path-like, optional
        Vehicle YAML or name of the library.
    topics : dict of str to str, optional
        Over the map's ``topics``.
    message_paths : sequence of path-like
        Folders of ``.msg`` files, and CAN databases.
    keep_going : bool
        Write each drive as soon as it is made, whatever becomes of the others.
    together : bool
        All recordings make one drive: tables with clocks of their own that count from one instant.
    engine : Engine, optional
        Where recordings are read; by default in this process.
    progress : callable
        Called with a line of text at each step.

    Raises
    ------
    SplitError
        If a recording, the map or the vehicle is at fault; nothing is written then, unless `keep_going`.
    """
    engine = engine or HERE
    vehicle = read_vehicle(vehicle_path) if vehicle_path is not None else None
    output = Path(output)
    sources = find_sources(logs, outside=output)
    signal_map = read_map(maps) if maps else None
    prepared = _Job(signal_map, vehicle, settings, tuple((topics or {}).items()), tuple(map(str, message_paths)))
    if together:
        with contextlib.ExitStack() as stack:
            return IngestRun((_ingest_together(enter_all(sources, stack), output, prepared),), (), ())
    single = len(sources) == 1 and not output.is_dir() and output.suffix.lower() in (".parquet", ".pq")
    if not single:
        _check_folder(output, sources)
    inputs = [source.address for source in sources if not is_remote(source.address)]
    refuse_overwriting_inputs(inputs, output, *(() if single else (output / _drive_name(one) for one in sources)))
    if single:
        progress(sources[0].name)
        made = _make_drive(replace(prepared, source=sources[0], target=str(output), shown=str(output)))
        if not isinstance(made, IngestFailure):
            return IngestRun((made,), (), ())
        if not keep_going:
            raise made.error
        return IngestRun((), (made,), ())
    if keep_going:
        existed = output.is_dir()
        output.mkdir(exist_ok=True)
        try:
            return _into_folder(prepared, sources, output, output, engine, keep_going, progress)
        finally:
            if not existed:
                _remove_if_empty(output)
    # A folder is shown only when all of its drives are made.
    try:
        with atomic_directory(output) as folder:
            return _into_folder(prepared, sources, output, folder, engine, keep_going, progress)
    except MapError as error:
        raise _or_together(error, inputs, signal_map, message_paths) from error


def _or_together(
    error: MapError, paths: Sequence[str], signal_map: SignalMap | None, message_paths: Sequence[str | Path]
) -> MapError:
    """Return the error, with the way out where no log has all that is mapped and all of them together do."""
    if signal_map is None:
        return error
    mapped = {name for entry in signal_map.channels for source in entry.sources for name in source.names}
    recorded = []
    for path in paths:
        with contextlib.suppress(SplitError):
            recorded.append({c.name for c in open_recording(path, message_paths=message_paths).channels()})
    if not mapped <= set().union(*recorded) or any(mapped <= names for names in recorded):
        return error
    advice = "Each log holds a part of what is mapped: `--together` makes one drive of them."
    return MapError(error.what, where=error.where, advice=advice)


def _remove_if_empty(folder: Path) -> None:
    """Remove a folder in which no log left a drive, with the empty folders in it."""
    for path in sorted((p for p in folder.rglob("*") if p.is_dir()), reverse=True):
        with contextlib.suppress(OSError):
            path.rmdir()
    with contextlib.suppress(OSError):
        folder.rmdir()


@dataclass(frozen=True)
class _Job:
    """One recording to read, with all that reading it needs; travels to other processes.

    `target` is where the drive is written, `shown` where it will be found.
    """

    signal_map: SignalMap | None
    vehicle: Vehicle | None
    settings: IngestSettings | None
    topics: tuple[tuple[str, str], ...]
    message_paths: tuple[str, ...]
    source: SourceFile = SourceFile("", "")
    target: str = ""
    shown: str = ""


def _into_folder(
    prepared: _Job,
    sources: Sequence[SourceFile],
    output: Path,
    folder: Path,
    engine: Engine,
    keep_going: bool,
    progress: Callable[[str], None],
) -> IngestRun:
    """Make the drives that `output` lacks, in `folder`, and enter them in its manifest."""
    manifest = IngestManifest.of(output)
    digest = settings_digest(prepared.signal_map, prepared.vehicle, prepared.settings, dict(prepared.topics))
    results: list[IngestResult] = []
    failures: list[IngestFailure] = []
    unchanged: list[str] = []
    jobs: list[_Job] = []
    if manifest.entries:
        progress(f"comparing {len(sources)} recordings with those that were read before")
    for source in sources:
        if manifest.is_done(source.place, source.fingerprint, digest):
            unchanged.append(source.place)
            continue
        name = _drive_name(source)
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        jobs.append(replace(prepared, source=source, target=str(folder / name), shown=str(output / name)))
    for number, (job, made) in enumerate(zip(jobs, engine.map(_make_drive, jobs), strict=True), 1):
        progress(f"[{number}/{len(jobs)}] {job.source.place}")
        if isinstance(made, IngestFailure):
            if not keep_going:
                raise made.error
            failures.append(made)
            continue
        results.append(made)
        manifest.add(job.source.place, made.fingerprint, digest, _drive_name(job.source), Path(job.target))
        if keep_going:
            manifest.write(now_and_then=True)
    if results:
        manifest.write(folder)
    return IngestRun(tuple(results), tuple(failures), tuple(unchanged))


def _make_drive(job: _Job) -> IngestResult | IngestFailure:
    """Read one recording and write its drive, whole or not at all; an error is returned, to be reported in order."""
    try:
        with job.source.local() as path:
            with _unchanged([path]):
                fingerprint = job.source.fingerprint()
                made = _assemble(open_recording(path, message_paths=job.message_paths), path, job)
            write_drive(made.drive, job.target)
            return replace(_result(path, Path(job.shown), made), fingerprint=fingerprint)
    except SplitError as error:
        return IngestFailure(job.source.place, job.source.in_its_folder(error))


@contextlib.contextmanager
def _unchanged(paths: Sequence[Path]) -> Iterator[None]:
    """Refuse recordings that are written or replaced while the body reads them: parts of two states."""
    before, raised = _states(paths), None
    try:
        yield
    except SplitError as error:
        raised = error
    later = _states(paths)
    changed = next((str(path) for path, state in before.items() if later.get(path) != state), None)
    if changed is not None:
        advice = "Ingest it when whatever writes it has ended."
        raise LogError("was changed while it was read", where=changed, advice=advice) from raised
    if raised is not None:
        raise raised


def _states(paths: Sequence[Path]) -> dict[Path, tuple[int, int, int]]:
    """Return inode, size and time of change [ns] of files, and of each file of folders."""
    states = {}
    for part in (part for path in paths for part in (path.rglob("*") if path.is_dir() else (path,))):
        # Of a database with a write-ahead log, whoever reads it keeps an index.
        with contextlib.suppress(OSError):
            if part.is_file() and not part.name.endswith("-shm"):
                stat = part.stat()
                states[part] = stat.st_ino, stat.st_size, stat.st_mtime_ns
    return states


def _drive_name(source: SourceFile) -> str:
    return str(PurePosixPath(plain_name(source.place)).with_suffix(".parquet"))


def _ingest_together(paths: Sequence[Path], output: Path, job: _Job) -> IngestResult:
    """Make one drive of several files; see `ingest_logs`."""
    refuse_overwriting_inputs(paths, output)
    with _unchanged(paths):
        recording = open_logs(paths, job.message_paths)
        made = _assemble(recording, paths[0], job)
    write_drive(made.drive, output)
    return _result(Path(recording.name), output, made)


def open_logs(log: str | Path | Sequence[str | Path], message_paths: Sequence[str | Path] = ()) -> RawRecording:
    """Open a recording, or several files that are one: clocks that do not meet are brought together."""
    if isinstance(log, str | Path):
        return open_recording(log, message_paths=message_paths)
    paths = [Path(path) for path in log]
    empty = [path for path in paths if path.is_file() and holds_titles_alone(path)]
    empty = empty if len(empty) < len(paths) else []
    opened = (open_parts(path, message_paths=message_paths) for path in paths if path not in empty)
    joined = JointRecording([part for parts in opened for part in parts])
    for path in empty:
        joined.remark(ReadNote("holds titles alone, left out", path.name))
    let_clocks_meet(joined)
    return joined


def open_listed(
    log: str | Path | Sequence[str | Path], *, message_paths: Sequence[str | Path] = ()
) -> tuple[RawRecording, list[ListedChannel]]:
    """Open a recording (or several files together), and return it with the lines of a listing of its channels."""
    recording = open_logs(log, message_paths)
    return recording, listed_channels(recording)


def suggest_map_for(
    log: str | Path | Sequence[str | Path],
    *,
    message_paths: Sequence[str | Path] = (),
    row_rate: float | None = None,
    vehicle_path: str | Path | None = None,
) -> str:
    """Return a draft of a signal map for a recording, as YAML: each channel with its evidence or left open."""
    from split_cli.logs.drafting.suggest import suggest_map

    vehicle = read_vehicle(vehicle_path) if vehicle_path is not None else None
    return suggest_map(open_logs(log, message_paths), row_rate=row_rate, vehicle=vehicle)


def _assemble(recording: RawRecording, path: Path, job: _Job) -> Assembled:
    try:
        return _assemble_recording(recording, path, job)
    except SplitError as error:
        raise _with_notes(error, recording) from error


def _with_notes(error: SplitError, recording: RawRecording) -> SplitError:
    """Return the error with the recording's name, and with what reading it had to leave out."""
    where, advice = error.where or "", error.advice or ""
    if recording.name not in str(error):
        where = f"{recording.name}, {where}" if where else recording.name
    if isinstance(error, LogError) and recording.notes:
        counted = ((note.what, note.count) for note in recording.notes[:3])
        noted = "; ".join(f"{what}{f' ({count} times)' * (count > 1)}" for what, count in counted)
        advice = f"{advice.rstrip('.')}{'. ' if advice else ''}Found while reading: {noted}."
    return type(error)(error.what, where=where, advice=advice or None)


def _assemble_recording(recording: RawRecording, path: Path, job: _Job) -> Assembled:
    signal_map, topics = job.signal_map, dict(job.topics)
    if signal_map is None:
        presets = fitting_presets(recording)
        own = next((name for name in _OWN_MAPS if name in presets), None)
        if own is None:
            fit = f"--map {presets[0]} fits: its channels are recorded. " if presets else ""
            what = "needs a signal map: its channels are not named as a drive's"
            advice = f"{fit}`split ingest {path} --suggest-map` drafts one; `--list-maps` lists presets."
            raise MapError(what, where=path.name, advice=advice)
        signal_map = read_map(own)
    if topics:
        _check_topics(topics, signal_map)
        signal_map = replace(signal_map, topics={**signal_map.topics, **topics})
    return assemble_drive(recording, signal_map, job.vehicle, job.settings)


def _check_topics(topics: dict[str, str], signal_map: SignalMap) -> None:
    """Refuse a ``--topic`` whose name no source of the map uses: it would change nothing."""
    names = [name for entry in signal_map.channels for source in entry.sources for name in source.names]
    used = {topic_of(name) if name.startswith("/") else name.split(":", 1)[0] for name in names}
    for name in topics:
        if name not in used:
            advice = nearest_names(name, used)
            raise MapError(f"no source of the map is of {name!r}", where="--topic", advice=advice)


#: What a name ends in that a user means as a file, and not as a folder of drives.
_NO_FOLDERS = (".csv", ".txt", ".mcap", ".feather", ".mat")


def _check_folder(output: Path, sources: Sequence[SourceFile]) -> None:
    if output.suffix.lower() in _NO_FOLDERS and not output.is_dir():
        what = f"a drive is written as Parquet, not as {output.suffix}"
        raise SplitError(what, where=str(output), advice=f"Name {output.with_suffix('.parquet')}, or a folder.")
    if len(sources) > 1 and output.suffix.lower() in (".parquet", ".pq"):
        advice = "Name a folder."
        raise SplitError(f"{len(sources)} recordings cannot go into one drive", where=str(output), advice=advice)
    names = [_drive_name(source) for source in sources]
    twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < len(names) else None
    if twice:
        what = f"two recordings are called {twice.removesuffix('.parquet')}"
        raise SplitError(what, where=str(output), advice="Ingest them into two folders.")


def _result(path: Path, drive_path: Path, assembled: Assembled) -> IngestResult:
    drive = assembled.drive
    return IngestResult(path.name, drive_path, len(drive), drive.period, assembled.quality, drive.metadata)
