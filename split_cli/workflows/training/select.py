"""`split evaluate --select`: capacity, gain threshold, cell edge and features chosen on held-out blocks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from split_cli.errors import DriveError, SplitError
from split_cli.learning.cells import DEFAULT_CAPACITY, DEFAULT_THRESHOLD, learn
from split_cli.learning.features import parse_features
from split_cli.learning.in_memory import fitted_grid_and_kernel
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.region import Grid, Region
from split_cli.logs.drive import Drive, read_drive
from split_cli.prediction import make_predictor
from split_cli.scoring.application import time_per_query
from split_cli.scoring.selection import SelectionSettings, SetCandidate, SetSelection, choose, relative_error
from split_cli.scoring.splits import DEFAULT_BLOCKS, DEFAULT_GUARD, with_guards
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.recordings import RecordingCorrection, vehicle_warnings

_FOLDS = 3  # a third of the time is held out, as in `split evaluate`


@dataclass(frozen=True)
class _Part:
    """One drive as one feature set sees it: labels, features of every row, and the block of every row."""

    drive: Drive
    labels: Labels
    z: np.ndarray
    block: np.ndarray


def select_files(
    drives: Sequence[str | Path],
    vehicle: str | Path,
    settings: SelectionSettings,
    *,
    held: tuple[str, ...] = (),
    any_vehicle: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> SetSelection:
    """Read drives and vehicle, and choose; see `select`."""
    car = read_vehicle(vehicle)
    correct = RecordingCorrection(car)
    recorded = [correct(read_drive(path, held)) for path in drives]
    vehicle_warnings(recorded, car, any_vehicle)
    return select(recorded, car, settings, command=f"--vehicle {vehicle}", progress=progress)


def select(
    drives: Sequence[Drive],
    vehicle: Vehicle,
    settings: SelectionSettings,
    *,
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> SetSelection:
    """Try every combination of settings on held-out blocks of time, and choose one.

    Parameters
    ----------
    command : str
        What `split train` needs besides the settings chosen; for `Selection.command`.
    progress : callable
        Gets a line about what is being done.

    Notes
    -----
    Each drive is cut into ten blocks; each of three folds holds every third of them out, and trains on the others
    less a guard of 1 s, or of a third of a block in a drive of less than 30 s.
    Hyperparameters are fitted on the training blocks of the fold, once for every cell edge. All that the process
    has learned is believed: trust is found afterwards, for the settings chosen.

    Raises
    ------
    SplitError
        If a setting is out of its range or nothing can be scored.
    """
    if not all((settings.features, settings.capacities, settings.thresholds, settings.cell_edges)):
        advice = "Give values, or leave the option out."
        raise SplitError("--capacities, --thresholds or --cell-edges holds no value", advice=advice)
    if not all(0.0 < edge < np.inf for edge in settings.cell_edges):
        advice = "1 is the standard edge."
        raise SplitError(f"--cell-edges holds {settings.cell_edges}, every number must be positive", advice=advice)
    found: list[tuple[SetCandidate, np.ndarray]] = []
    for features in settings.features:
        parts = _parts(drives, vehicle, features, settings)
        for edge in settings.cell_edges:
            progress(f"{features}, cell edge {edge:g}: fitting hyperparameters on {_FOLDS} folds")
            folds = [_fold(parts, fold, vehicle, edge) for fold in range(_FOLDS)]
            for capacity, threshold in product(settings.capacities, settings.thresholds):
                progress(f"{features}, cell edge {edge:g}, capacity {capacity}, threshold {threshold:g}")
                blank = SetCandidate(features, capacity, threshold, edge, 0.0, 0.0, 0.0, np.zeros(3), 0.0, 0.0, 0.0)
                found.append(_try(blank, parts, folds, vehicle, settings.predictor))
    usual = (settings.features[0], DEFAULT_CAPACITY, DEFAULT_THRESHOLD, 1.0)
    candidates = tuple(
        replace(one, usual=(one.features, one.capacity, one.threshold, one.cell_edge) == usual) for one in choose(found)
    )
    best = next(one for one in candidates if one.chosen)
    options = f"--features {best.features} --capacity {best.capacity} --threshold {best.threshold:g}"
    edge = f" --cell-edge {best.cell_edge:g}" if best.cell_edge != 1.0 else ""
    names = " ".join(drive.name for drive in drives)
    tested = sum(int(np.isfinite(part.labels.y).all(axis=1).sum()) for part in parts)
    return SetSelection(
        vehicle=vehicle.name,
        drives=tuple(drive.name for drive in drives),
        labels=tested,
        blocks=len(found[0][1]),
        folds=_FOLDS,
        candidates=candidates,
        command=" ".join(f"split train {names} {command} {options}{edge} -o SET.split".split()),
    )


def _parts(drives: Sequence[Drive], vehicle: Vehicle, features: str, settings: SelectionSettings) -> list[_Part]:
    parsed, region, model = parse_features(features), Region.of(vehicle), SingleTrack(vehicle)
    parts, first = [], 0
    for drive in drives:
        labels = compute_labels(drive, vehicle, parsed, region, horizon=settings.horizon)
        block = first + np.arange(len(drive)) * DEFAULT_BLOCKS // len(drive)
        first += DEFAULT_BLOCKS
        parts.append(_Part(drive, labels, parsed.compute(model, drive), block))
    return parts


def _training(part: _Part, fold: int) -> Labels:
    """Return the labels of a fold's training blocks, less the guards beside the held-out ones."""
    test = part.block % DEFAULT_BLOCKS % _FOLDS == fold
    # A guard as long as a block would leave nothing of two training blocks in a row.
    margin = int(np.ceil(min(DEFAULT_GUARD / part.drive.period, len(test) / DEFAULT_BLOCKS / 3)))
    return part.labels.within(~with_guards(test, margin))


def _fold(parts: Sequence[_Part], fold: int, vehicle: Vehicle, cell_edge: float) -> tuple[list[Labels], Grid, Kernel]:
    """Return a fold's training labels, the grid, and the kernel fitted to them."""
    labels = [_training(part, fold) for part in parts]
    return labels, *fitted_grid_and_kernel(labels, vehicle, cell_edge)


def _try(
    candidate: SetCandidate,
    parts: Sequence[_Part],
    folds: Sequence[tuple[list[Labels], Grid, Kernel]],
    vehicle: Vehicle,
    predictor: str,
) -> tuple[SetCandidate, np.ndarray]:
    """Return the candidate with its cost, and its error block by block."""
    errors, nominal, blocks, sizes, times = [], [], [], [], []
    for fold, (labels, grid, kernel) in enumerate(folds):
        learned = learn(
            labels,
            vehicle=vehicle,
            grid=grid,
            kernel=kernel,
            capacity=candidate.capacity,
            threshold=candidate.threshold,
        )
        asked = make_predictor(predictor, learned)
        sizes.append((learned.size, learned.cell_count))
        for part in parts:
            test = part.block % DEFAULT_BLOCKS % _FOLDS == fold
            tested = part.labels.within(test)
            tested = tested.take(np.isfinite(tested.y).all(axis=1))
            if len(tested):
                errors.append(tested.y - asked.predict(part.z[tested.row]).mean)
                nominal.append(tested.y)
                blocks.append(part.block[tested.row])
                times.append(time_per_query(asked, part.drive, part.z, tested.row))
    if not errors:
        advice = "`split label` counts why; look at units and signs with `split info`."
        raise DriveError("no test sample can be scored: all are in gaps, too slow or not finite", advice=advice)
    share, rmse = relative_error(np.concatenate(errors), np.concatenate(nominal), np.concatenate(blocks))
    points, cells = np.mean(sizes, axis=0)
    scored = replace(
        candidate, rmse=rmse, points=float(points), cells=float(cells), microseconds=1e6 * float(np.median(times))
    )
    return scored, share
