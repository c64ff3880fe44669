"""Label a drive: what the nominal model gets wrong, sample by sample, into a file."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from split_cli.errors import SplitError
from split_cli.files import refuse_overwriting_inputs
from split_cli.learning.features import parse_features
from split_cli.learning.label_file import write_labels
from split_cli.learning.labels import DEFAULT_HORIZON, compute_labels
from split_cli.learning.region import Region, build_grid
from split_cli.logs.drive import Drive, open_drive, unstated_inputs
from split_cli.logs.drive_metadata import ingest_found
from split_cli.logs.scratch import in_pieces
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.engine import Engine
from split_cli.workflows.recordings import RecordingCorrection
from split_cli.workflows.sources import SourceFile, find_sources


@dataclass(frozen=True)
class LabelResult:
    """What became of a drive's samples."""

    drive: str
    horizon: float  # label interval [s], a whole number of samples
    window: int  # samples in it
    samples: int
    accepted: int
    rejected: tuple[tuple[str, int], ...]  # by reason, in the order of the tests
    rms: tuple[float, ...] | None  # root mean square of the accepted labels of v_x, v_y [m/s^2] and r [rad/s^2]
    notes: tuple[str, ...]  # what a reader should know of the labels


def label_drive(
    drive_path: str | Path,
    vehicle_path: str | Path,
    output: str | Path,
    *,
    features: str = "z2",
    horizon: float = DEFAULT_HORIZON,
    stride: int | None = None,
    plain: bool = False,
    held: Sequence[str] = (),
) -> LabelResult:
    """Compute the labels of a drive and write them as Parquet.

    Parameters
    ----------
    features : str
        ``z2``, ``z1`` or a comma-separated list of names.
    horizon, stride, plain
        As for `compute_labels`.
    held : sequence of str
        Inputs that keep their value between samples, whatever the file says.
    """
    refuse_overwriting_inputs((drive_path, vehicle_path), output)
    vehicle = read_vehicle(vehicle_path)
    correct = RecordingCorrection(vehicle)
    drive = correct(open_drive(drive_path, held))
    region = Region.of(vehicle)
    labels = compute_labels(
        drive, vehicle, parse_features(features), region, horizon=horizon, stride=stride, plain=plain
    )
    if labels.accepted.any():
        labels = labels.inside(build_grid(labels.features, vehicle, region, labels.z[labels.accepted]))
    write_labels(labels, output)
    accepted = labels.y[labels.accepted]
    return LabelResult(
        drive=drive.name,
        horizon=labels.horizon,
        window=labels.window,
        samples=len(labels),
        accepted=len(accepted),
        rejected=tuple(labels.counts().items()),
        rms=tuple(np.sqrt(np.mean(accepted**2, axis=0)).tolist()) if len(accepted) else None,
        notes=(*unstated_inputs([drive]), *drive_notes(drive), *correct.notes),
    )


def label_drives(
    addresses: Sequence[str | Path],
    vehicle_path: str | Path,
    folder: str | Path,
    *,
    engine: Engine | None = None,
    progress: Callable[[str], None] = lambda text: None,
    **settings: Any,
) -> tuple[LabelResult, ...]:
    """Label several drives, or folders of them, each in a process of the engine; the files are the same for any.

    Parameters
    ----------
    addresses : sequence of path-like or str
        Drives, folders, globs.
    folder : path
        The labels of ``a/lap.parquet`` become ``lap.labels.parquet`` in it, those of a drive in a folder below one
        that is given stand in the same folder below this one.
    engine : Engine, optional
        Where the work is done; by default in this process.
    progress : callable
        Takes ``[3/7] name`` as each is done.
    settings
        As for `label_drive`.

    Raises
    ------
    SplitError
        If two drives would have one label file, or a drive cannot be labelled.
    """
    sources = [s for s in find_sources(addresses, (".parquet",), what="drive") if ".labels" not in Path(s.place).name]
    if not sources:
        what = "there are label files and no drive"
        raise SplitError(what, where=", ".join(map(str, addresses)), advice="Name the drives, or their folder.")
    targets = [Path(folder) / PurePosixPath(s.place).with_suffix(".labels.parquet") for s in sources]
    twice = [target for target, count in Counter(targets).items() if count > 1]
    if twice:
        advice = "Label them into folders of their own."
        raise SplitError("two drives have this name", where=str(twice[0]), advice=advice)
    for target in targets:
        target.parent.mkdir(parents=True, exist_ok=True)
    jobs = [(source, vehicle_path, target, settings) for source, target in zip(sources, targets, strict=True)]
    apply = engine.map if engine is not None else map
    made = []
    for number, result in enumerate(apply(_label_one, jobs), 1):
        progress(f"[{number}/{len(jobs)}] {result.drive}")
        made.append(result)
    return tuple(made)


def _label_one(job: tuple[SourceFile, str | Path, Path, Mapping[str, Any]]) -> LabelResult:
    source, vehicle_path, target, settings = job
    with source.local() as path:
        return label_drive(path, vehicle_path, target, **settings)


def drive_notes(drive: Drive) -> tuple[str, ...]:
    """Return what a reader of labels should know of a drive's channels, in words."""
    known = drive.metadata
    said = {
        "v_x is of wheel speeds; the slip of their tyres is learned as an error of v_x": known.speed_is_of_wheels,
        "v_y is integrated from a_y; its label repeats a_y and errors of the integral": (
            known.lateral_velocity_is_integrated
        ),
        f"T is {known.kinds.get('T')}; the longitudinal label then says nothing": known.torque_follows_motion,
    }
    found = ingest_found(drive.name, (*known.faults, *known.remarks))
    found += tuple(f"{drive.name}: {text}" for text in _constant_channels(drive))
    return (*found, *(f"{drive.name}: {text}" for text, holds in said.items() if holds))


def _constant_channels(drive: Drive) -> Iterator[str]:
    """Yield which of the model's channels hold one value throughout, where no ingest has looked at them."""
    found = []
    for name in () if "consistency" in drive.metadata.quality else ("vx", "vy", "r", "T", "delta"):
        first, symbol = drive.part(name, 0, 1)[0], {"vx": "v_x", "vy": "v_y"}.get(name, name)
        if all((drive.part(name, piece.start, piece.stop) == first).all() for piece in in_pieces(len(drive))):
            found.append(f"{symbol} is {first:g}")
    if found:
        yield f"{', '.join(found)} in every row. If that was not recorded, the labels are wrong"
