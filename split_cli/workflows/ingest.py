"""From recordings to drives: open, assemble, write whole or not at all."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from split_cli.errors import LogError, MapError, SplitError, nearest_names
from split_cli.files import atomic_directory, refuse_overwriting_inputs
from split_cli.logs.assemble import Assembled, IngestSettings, assemble_drive
from split_cli.logs.drive import Drive, DriveMetadata, read_drive, write_drive
from split_cli.logs.gather import topic_of
from split_cli.logs.presets import preset_abouts
from split_cli.logs.quality import QualityReport, render_quality
from split_cli.logs.raw import RawChannelInfo, Recording
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import SignalMap, read_map
from split_cli.signals import REQUIRED_CHANNELS
from split_cli.vehicle.parameters import Vehicle, read_vehicle

__all__ = [
    "IngestFailure",
    "IngestResult",
    "IngestSettings",
    "ingest_logs",
    "list_channels",
    "list_maps",
    "suggest_map_for",
]


@dataclass(frozen=True)
class IngestResult:
    """One recording made a drive.

    Attributes
    ----------
    log : str
    drive_path : Path
    rows : int
    period : float
        [s].
    quality : QualityReport
    metadata : DriveMetadata
    """

    log: str
    drive_path: Path
    rows: int
    period: float
    quality: QualityReport
    metadata: DriveMetadata

    @property
    def drive(self) -> Drive:
        """The drive, read from its file, for whoever draws it."""
        return read_drive(self.drive_path)

    def to_text(self) -> str:
        """Return the report for a terminal."""
        head = f"{self.log} -> {self.drive_path}: {self.rows} rows at {1.0 / self.period:g} Hz"
        kinds = ", ".join(f"{channel} {kind}" for channel, kind in self.metadata.kinds.items())
        converted = [f"  {text}" for text in self.metadata.conversions]
        return "\n".join(
            [
                head,
                f"kinds: {kinds}",
                render_quality(self.quality),
                *(["converted:", *converted] if converted else []),
            ]
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
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[tuple[IngestResult, ...], tuple[IngestFailure, ...]]:
    """Make a drive of every recording.

    Parameters
    ----------
    logs : sequence of path-like
        Recordings; a folder that is no rosbag2 stands for the recordings in it.
    output : path-like
        The drive's file for one log; for several a folder, one Parquet a log named after it.
    maps : sequence of path-like
        Presets or files, later over earlier; none for a table whose columns are named as a drive's.
    vehicle_path : path-like, optional
        Vehicle YAML or name of the library.
    settings : IngestSettings, optional
    topics : dict of str to str, optional
        Over the map's ``topics``.
    message_paths : sequence of path-like
        Folders of ``.msg`` files.
    keep_going : bool
        Write the drives that can be made when some recordings fail.
    progress : callable
        Told in words what is being done.

    Returns
    -------
    results, failures : tuple of IngestResult, tuple of IngestFailure
        Failures only with `keep_going`.

    Raises
    ------
    SplitError
        If a recording, the map or the vehicle is at fault; nothing is written then.
    """
    vehicle = read_vehicle(vehicle_path) if vehicle_path is not None else None
    paths = _expand(logs)
    output = Path(output)
    single = len(paths) == 1 and not output.is_dir() and output.suffix.lower() in (".parquet", ".pq")
    if not single:
        _check_folder(output, paths)
    for path in paths:
        refuse_overwriting_inputs(output if single else output / f"{path.stem}.parquet", paths)
    signal_map = read_map(maps) if maps else None
    results: list[IngestResult] = []
    failures: list[IngestFailure] = []
    # Each drive is written as soon as it is made, so that memory holds one; a folder is shown only when all are.
    with contextlib.ExitStack() as stack:
        folder = None if single else stack.enter_context(atomic_directory(output))
        for number, path in enumerate(paths, 1):
            progress(f"[{number}/{len(paths)}] {path.name}")
            try:
                made = _assemble(path, signal_map, vehicle, settings, topics or {}, message_paths)
            except SplitError as error:
                if not keep_going:
                    raise
                failures.append(IngestFailure(path.name, error))
                continue
            target = output if folder is None else folder / f"{path.stem}.parquet"
            write_drive(made.drive, target)
            results.append(_result(path, output if folder is None else output / target.name, made))
    return tuple(results), tuple(failures)


def list_channels(
    log: str | Path, *, message_paths: Sequence[str | Path] = ()
) -> tuple[tuple[RawChannelInfo, ...], tuple[str, ...]]:
    """Return every channel of a recording, and the clocks it has."""
    recording = open_recording(log, message_paths=message_paths)
    return tuple(recording.channels()), tuple(recording.clocks)


def list_maps() -> dict[str, str]:
    """Return the signal maps that come with the project, and what each is for."""
    return preset_abouts()


def suggest_map_for(log: str | Path, *, message_paths: Sequence[str | Path] = ()) -> str:
    """Return a draft of a signal map for a recording, as YAML, with guesses marked as such."""
    from split_cli.logs.suggest import suggest_map

    return suggest_map(open_recording(log, message_paths=message_paths))


def _assemble(
    path: Path,
    signal_map: SignalMap | None,
    vehicle: Vehicle | None,
    settings: IngestSettings | None,
    topics: dict[str, str],
    message_paths: Sequence[str | Path],
) -> Assembled:
    recording = open_recording(path, message_paths=message_paths)
    try:
        return _assemble_recording(recording, path, signal_map, vehicle, settings, topics)
    except SplitError as error:
        raise _told_of(error, recording) from error


def _told_of(error: SplitError, recording: Recording) -> SplitError:
    """Return the error with the recording's name, and with what reading it had to leave out."""
    where, advice = error.where or "", error.advice or ""
    if recording.name not in str(error):
        where = f"{recording.name}, {where}" if where else recording.name
    if isinstance(error, LogError) and recording.notes:
        left_out = "; ".join(f"{note.count} x {note.what}" for note in recording.notes[:3])
        advice = f"{advice.rstrip('.')}{'. ' if advice else ''}While reading: {left_out}."
    return type(error)(error.what, where=where, advice=advice or None)


def _assemble_recording(
    recording: Recording,
    path: Path,
    signal_map: SignalMap | None,
    vehicle: Vehicle | None,
    settings: IngestSettings | None,
    topics: dict[str, str],
) -> Assembled:
    if signal_map is None:
        names = {info.name for info in recording.channels()}
        if not set(REQUIRED_CHANNELS) - {"T"} <= names:
            raise MapError(
                "needs a signal map: its channels are not named as a drive's",
                where=path.name,
                advice=f"`split ingest {path} --suggest-map` drafts one; presets are listed by `--list-maps`.",
            )
        signal_map = read_map("canonical")
    if topics:
        _check_topics(topics, signal_map)
        signal_map = replace(signal_map, topics={**signal_map.topics, **topics})
    return assemble_drive(recording, signal_map, vehicle, settings)


def _check_topics(topics: dict[str, str], signal_map: SignalMap) -> None:
    """Refuse a ``--topic`` whose name no source of the map uses: it would change nothing."""
    names = [name for entry in signal_map.channels for source in entry.sources for name in source.names]
    used = {topic_of(name) if name.startswith("/") else name.split(":", 1)[0] for name in names}
    for name in topics:
        if name not in used:
            raise MapError(
                f"no source of the map is of {name!r}", where="--topic", advice=nearest_names(name, used)
            )


def _expand(logs: Sequence[str | Path]) -> list[Path]:
    paths: list[Path] = []
    for log in logs:
        path = Path(log)
        is_bag = (path / "metadata.yaml").is_file() or any(path.glob("*.db3"))
        if path.is_dir() and not is_bag:
            inside = sorted(p for p in path.iterdir() if not p.name.startswith(".") and p.suffix in _LOG_SUFFIXES)
            if not inside:
                raise SplitError(
                    "holds no recording", where=str(path), advice=f"Known are {', '.join(_LOG_SUFFIXES)}."
                )
            paths.extend(inside)
        else:
            paths.append(path)
    return paths


_LOG_SUFFIXES = (".mcap", ".bag", ".db3", ".csv", ".parquet", ".mat", ".mf4")


def _check_folder(output: Path, paths: Sequence[Path]) -> None:
    if len(paths) > 1 and output.suffix.lower() in (".parquet", ".pq"):
        raise SplitError(
            f"{len(paths)} recordings cannot go into one drive", where=str(output), advice="Name a folder."
        )
    stems = [path.stem for path in paths]
    twice = next((stem for stem in stems if stems.count(stem) > 1), None)
    if twice:
        raise SplitError(
            f"two recordings are called {twice}", where=str(output), advice="Ingest them into two folders."
        )


def _result(path: Path, drive_path: Path, assembled: Assembled) -> IngestResult:
    drive = assembled.drive
    return IngestResult(path.name, drive_path, len(drive), drive.period, assembled.quality, drive.metadata)
