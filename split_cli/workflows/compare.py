"""Set models side by side on the same drives: vehicles, trained sets, predictors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from split_cli.errors import DriveError, SplitError
from split_cli.learning.pieces import features_along
from split_cli.learning.training_set import TrainingSet, read_set
from split_cli.logs.drive import Drive, read_drive, unstated_inputs
from split_cli.prediction import DEFAULT_PREDICTOR, make_predictor
from split_cli.scoring.application import Correction, correction_from
from split_cli.scoring.comparison import ModelScore, RunErrors, rank, worse_than
from split_cli.scoring.rollouts import hold_velocity, roll_out, rollout_starts
from split_cli.scoring.verdict import number_blocks
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.evaluation_notes import in_sample, overlap_notes
from split_cli.workflows.recordings import RecordingCorrection

STEP = 0.05
_VELOCITIES = ("vx", "vy", "r")


@dataclass(frozen=True)
class ComparedModel:
    """A model for open-loop simulation: a vehicle, with a trained set's correction or without."""

    name: str
    vehicle: Vehicle
    trained: TrainingSet | None = None
    predictor: str = ""  # name of the predictor; empty without a set


@dataclass(frozen=True)
class ModelComparison:
    """What was compared, and what came out."""

    models: tuple[str, ...]
    drives: tuple[str, ...]
    # starts, diverged: free runs that count, and those left out for all since some model left the finite numbers.
    starts: int
    diverged: int
    scores: tuple[ModelScore, ...]  # over all drives, horizon by horizon
    by_drive: tuple[tuple[str, tuple[ModelScore, ...]], ...]  # drive by drive, where there are several
    worse: tuple[str, ...]  # where the first model is worse than another one beyond chance
    notes: tuple[str, ...]
    in_sample: tuple[str, ...] = ()  # models that were trained on a drive they are compared on


def read_model(text: str) -> ComparedModel:
    """Return the model that a word of the command line names.

    Parameters
    ----------
    text : str
        ``car.yaml`` or the name of a vehicle of the library, ``car.split``, ``car.split:full`` for another
        predictor than projected; ``NAME=`` before it gives it a name.

    Raises
    ------
    SplitError
        If the file cannot be read or the predictor is unknown.
    """
    name, sign, rest = text.partition("=")
    path = rest if sign else text
    shown = name if sign else ""
    if ".split" not in path:
        return ComparedModel(shown or Path(path).name, read_vehicle(path))
    file, _, predictor = path.rpartition(":") if ".split:" in path else (path, "", DEFAULT_PREDICTOR)
    trained = read_set(file)
    if make_predictor(predictor, trained).needs_context:
        what = f"{predictor} needs the future of a drive, which no controller knows"
        advice = "Compare projected, bcm, rbcm, grbcm, local, weights, table or full."
        raise SplitError(what, where=text, advice=advice)
    return ComparedModel(shown or f"{Path(file).name} ({predictor})", trained.vehicle, trained, predictor)


def compare_files(
    models: Sequence[str],
    drives: Sequence[str | Path],
    horizons: Sequence[float] = (0.05, 0.5, 2.0),
    held: Sequence[str] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[ModelComparison, tuple[ComparedModel, ...], tuple[Drive, ...]]:
    """Read models and drives and compare; see `read_model` and `compare_models`."""
    read = tuple(read_model(text) for text in models)
    recordings = tuple(read_drive(path, held) for path in drives)
    return compare_models(read, recordings, horizons, progress), read, recordings


def compare_models(
    models: Sequence[ComparedModel],
    drives: Sequence[Drive],
    horizons: Sequence[float] = (0.05, 0.5, 2.0),
    progress: Callable[[str], None] = lambda text: None,
) -> ModelComparison:
    """Simulate every model open-loop from the same starts on the same drives, and compare the ends.

    Parameters
    ----------
    horizons : sequence of float
        [s], rounded to whole steps of about 0.05 s.
    progress : callable
        Gets a line about what is being done.

    Raises
    ------
    SplitError
        If two models have one name, a horizon is no positive time, or no drive has a stretch that long.

    Notes
    -----
    States are compared, not labels: labels are in units of one vehicle's dynamics. Faults of sensors that a
    vehicle file names are taken off the recording for that vehicle. Drives that a set was trained on are named.
    """
    names = [model.name for model in models]
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    if twice:
        raise SplitError(f"two models are called {twice[0]!r}", advice="Name them: NEW=car.split.")
    if not models:
        raise SplitError("no model was named", advice="Name a vehicle file or a trained set.")
    if not horizons or not all(0.0 < time < np.inf for time in horizons):
        given = ", ".join(f"{time:g}" for time in horizons) or "nothing"
        raise SplitError(f"is {given}, positive times were expected", where="--horizon", advice="Give seconds.")
    horizons = sorted(set(horizons))
    drives, repeated = _without_copies(drives)
    parts: list[tuple[str, list[RunErrors], int]] = []
    first_block = 0
    for drive in drives:
        progress(f"free runs on {drive.name}")
        block = number_blocks(drive["t"], drive.segment, first_block)
        first_block = int(block.max()) + 1
        found, diverged = _run_on(models, drive, horizons, block)
        if found:
            parts.append((drive.name, found, diverged))
    if not parts:
        longest = horizons[-1]
        what = f"no stretch without a gap is longer than {longest:g} s and fast enough"
        advice = "Ask for shorter --horizon."
        raise DriveError(what, where=", ".join(drive.name for drive in drives), advice=advice)
    pooled = [_pooled([found[k] for _, found, _ in parts]) for k in range(len(horizons))]
    scores = rank(pooled)
    by_drive = tuple((name, rank(found)) for name, found, _ in parts) if len(parts) > 1 else ()
    return ModelComparison(
        tuple(names),
        tuple(name for name, *_ in parts),
        len(pooled[0].held),
        sum(d for *_, d in parts),
        scores,
        by_drive,
        worse_than(scores, pooled, names[0]),
        (*repeated, *_notes(models, drives, parts)),
        tuple(model.name for model in models if _learned(model, drives)),
    )


def _without_copies(drives: Sequence[Drive]) -> tuple[list[Drive], list[str]]:
    """Return the drives without those of equal content, and a line about each that is left out."""
    kept: dict[str | int, Drive] = {}
    lines = []
    for drive in drives:
        first = kept.setdefault(drive.sha256 or id(drive), drive)
        if first is not drive:
            same = "was given twice" if first.name == drive.name else f"is a copy of {first.name}"
            lines.append(f"{drive.name} {same}: it counts once")
    return list(kept.values()), lines


def _run_on(
    models: Sequence[ComparedModel], drive: Drive, horizons: Sequence[float], block: np.ndarray
) -> tuple[list[RunErrors], int]:
    window = max(1, round(STEP / drive.period))
    # A horizon beyond the drive's end asks for more steps than there are; no number of them is too large to count.
    steps = [max(1, round(min(time / (window * drive.period), len(drive)))) for time in horizons]
    length = steps[-1]
    slowest = max(model.vehicle.minimum_speed for model in models)
    starts = rollout_starts(drive, np.ones(len(drive), dtype=bool), length * window, slowest)
    if not len(starts):
        return [], 0
    ends = starts[:, None] + window * np.arange(1, length + 1)
    errors = {}
    for model in models:
        own = RecordingCorrection(model.vehicle)(drive)
        measured = np.stack([own[name][ends] for name in _VELOCITIES], axis=2)
        path = roll_out(SingleTrack(model.vehicle), own, starts, length, window, _correction(model, own, starts))
        errors[model.name] = path[:, :, -3:] - measured
    measured = np.stack([drive[name][ends] for name in _VELOCITIES], axis=2)
    held = hold_velocity(drive, starts, length, window)[:, :, -3:] - measured
    kept = np.all([np.isfinite(one).all(axis=(1, 2)) for one in errors.values()], axis=0)
    if not kept.any():
        return [], len(starts)
    found = []
    for time, step in zip(horizons, steps, strict=True):
        ends = {name: one[kept, step - 1] for name, one in errors.items()}
        made = step * window * drive.period
        # As it was asked for, where whole samples come within 1 % of it.
        asked = time if abs(made - time) <= 0.01 * time else made
        parts = held[kept, step - 1], measured[kept, step - 1], block[starts[kept]]
        found.append(RunErrors(asked, ends, *parts))
    return found, int((~kept).sum())


def _correction(model: ComparedModel, drive: Drive, starts: np.ndarray) -> Correction | None:
    if model.trained is None:
        return None
    z = model.trained.features.compute(SingleTrack(model.vehicle), drive)
    return correction_from(make_predictor(model.predictor, model.trained), drive, z, starts)


def _pooled(parts: Sequence[RunErrors]) -> RunErrors:
    """Pool drives by their samples: squares are summed, never averages of averages."""

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(one, name) for one in parts])

    errors = {name: np.concatenate([one.errors[name] for one in parts]) for name in parts[0].errors}
    return RunErrors(parts[0].horizon, errors, joined("held"), joined("measured"), joined("block"))


def _learned(model: ComparedModel, drives: Sequence[Drive]) -> list[Drive]:
    """Return the drives that a model was trained on."""
    known = {source.sha256 for source in model.trained.sources} if model.trained is not None else set()
    return [drive for drive in drives if drive.sha256 and drive.sha256 in known]


def _notes(models: Sequence[ComparedModel], drives: Sequence[Drive], parts: Sequence) -> tuple[str, ...]:
    notes = list(unstated_inputs(list(drives)))
    for model in models:
        if model.trained is None:
            continue
        notes += [in_sample(model.name, drive.name) for drive in _learned(model, drives)]
        for drive in drives:
            z = features_along(SingleTrack(model.vehicle), drive, model.trained.features)
            notes += overlap_notes(model.name, model.trained, drive, z)
    scored = {name for name, *_ in parts}
    missing = [drive.name for drive in drives if drive.name not in scored]
    notes += [f"{name} has no stretch that is long and fast enough" for name in missing]
    return tuple(notes)
