"""Labels and points computed again from their drives, where these lie beside them."""

import contextlib
import os
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.files import sha256_of_file
from split_cli.learning.cells import extend, without_points
from split_cli.learning.features import FeatureSet
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.late_labels import freed_of_late_torque
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


def set_against_drives(trained: TrainingSet, path: Path) -> tuple[VerifiedItem, ...]:
    """Compute the labels of a set's drives that lie beside it again, and compare its points and sums with them.

    Sums are compared where all of its drives are there. They are left out where these, learned with the usual
    settings, give other counts or points: a set does not say which stretches of a drive were left out, and other
    libraries may choose other points.
    """
    correct = RecordingCorrection(trained.nominal_vehicle)
    # Where s begins depends on the drives that were given before.
    found = {} if correct.counts_places else _drives_beside(trained, path)
    errors = dict.fromkeys((n for n in found if (trained.source == n).any()), np.inf)
    comparable = trained.information is not None and len(found) == len(trained.sources) > 0

    def again(held: tuple[str, ...]) -> Iterator[Labels]:
        for number, drive in found.items():
            mine, source = trained.source == number, trained.sources[number]
            how = trained.features, trained.region, source.horizon or trained.horizon, trained.plain
            stored = _StoredLabels(trained.row[mine], trained.z[mine], trained.y[mine], *how)
            try:
                labels = _labels_of(drive, stored, trained.vehicle, correct, held)
                if number in errors:
                    # Of rows beyond those of the usual stride, the stride is not stored.
                    apart = not np.isin(stored.row, labels.row).all()
                    all_rows = _labels_of(drive, stored, trained.vehicle, correct, held, 1) if apart else labels
                    errors[number] = min(errors[number], _largest_error(all_rows, stored))
                    if trained.found_effects:
                        freed = _error_beside_a_lag(trained, source.samples, labels, all_rows, stored)
                        errors[number] = min(errors[number], freed)
            except SplitError:
                continue
            yield labels

    sums: float | None = None
    for held in _HELD:
        labels = again(held)
        error = _error_of_sums(trained, labels) if comparable else None
        deque(labels, maxlen=0)  # points are compared on the way, also those that learning did not come to
        if error is not None:
            sums = error if sums is None else min(sums, error)
        if max(errors.values(), default=0.0) <= TOLERANCE and (error is None or error <= TOLERANCE):
            break
    items = [
        _comparison(f"points of {trained.sources[n].name}", int((trained.source == n).sum()), errors[n]) for n in errors
    ]
    if sums is not None:
        text = f"they differ by at most {sums:.2g} of the largest from those learned again, {TOLERANCE:g} is allowed"
        items.append(item("sums over labels", sums <= TOLERANCE, text, text))
    missing = len(trained.sources) - len(found)
    if missing:
        text = f"{missing} of {len(trained.sources)} drives do not lie beside it, or places on the track are corrected"
        items.append(VerifiedItem("labels and sums", None, f"not computed again: {text}"))
    return tuple(items)


def _drives_beside(trained: TrainingSet, path: Path) -> dict[int, Path]:
    beside = {n: path.parent / Path(source.name).name for n, source in enumerate(trained.sources)}
    return {n: drive for n, drive in beside.items() if _is_the(drive, trained.sources[n].sha256)}


def _error_of_sums(trained: TrainingSet, labels: Iterable[Labels]) -> float | None:
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
    worst = np.inf
    # Whether inputs were taken as held is not stored: some reading must give what the file says.
    for held in _HELD if used.any() else ():
        with contextlib.suppress(SplitError):
            worst = min(worst, _largest_error(_labels_of(drive, stored, vehicle, correct, held, 1), stored))
        if worst <= TOLERANCE:
            break
    return (_comparison(f"labels of {labels.drive}", len(stored.row), worst),) if used.any() else ()


def _is_the(path: Path, digest: str) -> bool:
    return os.path.isfile(path) and sha256_of_file(path) == digest


def _vehicles(folder: Path) -> Iterable[Vehicle]:
    for path in sorted(folder.glob("*.yaml")):
        try:
            yield read_vehicle(path)
        except SplitError:
            continue


def _labels_of(
    path: Path,
    stored: _StoredLabels,
    vehicle: Vehicle,
    correct: RecordingCorrection,
    held: tuple[str, ...],
    stride: int | None = None,
) -> Labels:
    return compute_labels(
        correct(open_drive(path, held)),
        vehicle,
        stored.features,
        stored.region,
        horizon=stored.horizon,
        stride=stride,
        plain=stored.plain,
    )


def _largest_error(again: Labels, stored: _StoredLabels) -> float:
    at = np.searchsorted(again.row, stored.row)
    if (at >= len(again)).any() or (again.row[at] != stored.row).any():
        return np.inf
    errors = [
        np.abs(ours[at] - theirs) / (1.0 + np.abs(theirs))
        for ours, theirs in ((again.z, stored.z), (again.y, stored.y))
    ]
    worst = max(float(error.max()) for error in errors)
    return worst if np.isfinite(worst) else np.inf


def _error_beside_a_lag(
    trained: TrainingSet, samples: int, labels: Labels, all_rows: Labels, stored: _StoredLabels
) -> float:
    """Return the largest error of points whose labels are freed of the torque's lag.

    That depends on all labels that were learned together. Where others were than are here, only features are
    compared.
    """
    if len(labels) == samples:
        return _largest_error(freed_of_late_torque(trained, labels), stored)
    return _largest_error(replace(all_rows, y=np.zeros_like(all_rows.y)), replace(stored, y=np.zeros_like(stored.y)))


def _comparison(check: str, count: int, worst: float) -> VerifiedItem:
    text = f"{count} differ by at most {worst:.2g} from those computed again, {TOLERANCE:g} is allowed"
    return item(check, worst <= TOLERANCE, text, text)
