"""Labels and points computed again from their drives, where these lie beside them."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.files import sha256_of_file
from split_cli.learning.cells import extend, without_points
from split_cli.learning.features import FeatureSet
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.region import Region
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive import open_drive
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.recordings import RecordingCorrection
from split_cli.workflows.verifying.verification import VerifiedItem, item

TOLERANCE = 1e-6
"""Of features and labels against those computed again, of 1 + their value [1]: other libraries round otherwise."""
_HELD = ((), ("T",), ("delta",), ("T", "delta"))


@dataclass(frozen=True)
class _StoredLabels:
    """What a file says of some rows of one drive: features z, shape (N, D), and labels y, shape (N, 3)."""

    row: np.ndarray
    z: np.ndarray
    y: np.ndarray
    features: FeatureSet
    region: Region
    horizon: float
    plain: bool


def points_against_drives(trained: TrainingSet, path: Path) -> tuple[VerifiedItem, ...]:
    """Compute the points of a set again from every drive that lies beside it."""
    items = []
    correct = RecordingCorrection(trained.nominal_vehicle)
    for number, source in enumerate(trained.sources):
        mine = trained.source == number
        drive = path.parent / Path(source.name).name
        # Where s begins depends on the drives that were given before.
        if not source.sha256 or not mine.any() or correct.counts_places or not _is_the(drive, source.sha256):
            continue
        how = trained.features, trained.region, source.horizon or trained.horizon, trained.plain
        stored = _StoredLabels(trained.row[mine], trained.z[mine], trained.y[mine], *how)
        items.append(_compared(f"points of {source.name}", drive, stored, trained.vehicle, correct))
    return tuple(items)


def sums_against_drives(trained: TrainingSet, path: Path) -> tuple[VerifiedItem, ...]:
    """Learn a set again and compare its sums over labels, where all of its drives lie beside it.

    Empty also where the drives, learned with the usual settings, give other counts or points: a set does not say
    which stretches of a drive were left out, and other libraries may choose other points.
    """
    drives = [path.parent / Path(source.name).name for source in trained.sources]
    correct = RecordingCorrection(trained.nominal_vehicle)
    named = all(_is_the(drive, source.sha256) for drive, source in zip(drives, trained.sources, strict=True))
    if trained.information is None or not drives or not named or correct.counts_places:
        return ()
    errors = [_error_of_sums(trained, drives, correct, held) for held in _HELD]
    worst = min((error for error in errors if error is not None), default=None)
    if worst is None:
        return ()
    text = f"they differ by at most {worst:.2g} of the largest from those learned again, {TOLERANCE:g} is allowed"
    return (item("sums over labels", worst <= TOLERANCE, text, text),)


def _error_of_sums(
    trained: TrainingSet, drives: Sequence[Path], correct: RecordingCorrection, held: tuple[str, ...]
) -> float | None:
    labels = (
        compute_labels(
            correct(open_drive(drive, held)),
            trained.vehicle,
            trained.features,
            trained.region,
            horizon=source.horizon or trained.horizon,
            plain=trained.plain,
        )
        for drive, source in zip(drives, trained.sources, strict=True)
    )
    try:
        again = extend(without_points(trained), labels)
    except SplitError:
        return None
    same = [(s.samples, s.accepted) for s in again.sources] == [(s.samples, s.accepted) for s in trained.sources]
    if not same or any(not np.array_equal(getattr(again, n), getattr(trained, n)) for n in ("row", "source")):
        return None
    pairs = zip(again.sums(), trained.sums(), strict=True)
    return max(float(np.abs(ours - theirs).max() / max(np.abs(ours).max(), 1e-300)) for ours, theirs in pairs)


def labels_against_drive(labels: Labels, path: Path) -> tuple[VerifiedItem, ...]:
    """Compute labels again, where their drive and their vehicle file lie beside them."""
    drive = path.parent / Path(labels.drive).name
    vehicle = next((v for v in _vehicles(path.parent) if v.digest() == labels.vehicle_digest), None)
    if vehicle is None or drive == path or not _is_the(drive, labels.sha256):
        return ()
    correct = RecordingCorrection(vehicle)
    used = labels.accepted
    how = labels.features, labels.region, labels.horizon, labels.plain
    stored = _StoredLabels(labels.row[used], labels.z[used], labels.y[used], *how)
    return (_compared(f"labels of {labels.drive}", drive, stored, vehicle, correct),) if used.any() else ()


def _is_the(path: Path, digest: str) -> bool:
    return os.path.isfile(path) and sha256_of_file(path) == digest


def _vehicles(folder: Path) -> Iterable[Vehicle]:
    for path in sorted(folder.glob("*.yaml")):
        try:
            yield read_vehicle(path)
        except SplitError:
            continue


def _compared(
    check: str, path: Path, stored: _StoredLabels, vehicle: Vehicle, correct: RecordingCorrection
) -> VerifiedItem:
    # Whether inputs were taken as held is not stored: some reading must give what the file says.
    worst = min(_largest_error(path, stored, vehicle, correct, held) for held in _HELD)
    text = f"{len(stored.row)} differ by at most {worst:.2g} from those computed again, {TOLERANCE:g} is allowed"
    return item(check, worst <= TOLERANCE, text, text)


def _largest_error(
    path: Path, stored: _StoredLabels, vehicle: Vehicle, correct: RecordingCorrection, held: tuple[str, ...]
) -> float:
    try:
        drive = correct(open_drive(path, held))
        again = compute_labels(
            drive, vehicle, stored.features, stored.region, horizon=stored.horizon, stride=1, plain=stored.plain
        )
    except SplitError:
        return np.inf
    at = np.searchsorted(again.row, stored.row)
    if (at >= len(again)).any() or (again.row[at] != stored.row).any():
        return np.inf
    errors = [
        np.abs(ours[at] - theirs) / (1.0 + np.abs(theirs))
        for ours, theirs in ((again.z, stored.z), (again.y, stored.y))
    ]
    worst = max(float(error.max()) for error in errors)
    return worst if np.isfinite(worst) else np.inf
