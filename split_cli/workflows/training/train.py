"""Train a set from drives, or go on training one."""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.errors import SetError, SplitError
from split_cli.files import exclusive_access, refuse_overwriting_inputs
from split_cli.learning.cells import extend, warm_up
from split_cli.learning.features import parse_features
from split_cli.learning.hyperparameters import FEWEST_TO_FIT, KernelFit
from split_cli.learning.iol import LEARNER, extend_dictionary
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import DEFAULT_HORIZON
from split_cli.learning.region import Region
from split_cli.learning.training_set import SetSource, TrainingSet, read_set, write_set
from split_cli.learning.trust import Trust
from split_cli.scoring.circular import limits_of
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.engine import HERE, Engine
from split_cli.workflows.other_vehicle import trained_for_another
from split_cli.workflows.recordings import usable_drives
from split_cli.workflows.sources import DRIVE_SUFFIXES, enter_all, find_sources
from split_cli.workflows.training.labelled_drives import LabelledDrives, Labelling, drive_digest
from split_cli.workflows.training.laps import LapRow, check_laps, lap_rows
from split_cli.workflows.training.new_set import create_set
from split_cli.workflows.training.settings import TrainSettings


@dataclass(frozen=True)
class TrainRow:
    """What one drive, or all, did to the set."""

    drive: str
    # samples, accepted: labels, and those inside the valid region.
    samples: int
    accepted: int
    rejected: tuple[tuple[str, int], ...]  # by reason
    updates: int  # insertions and replacements
    # points, cells: set size and non-empty cells afterwards.
    points: int
    cells: int
    # Share of the valid region's cells that hold points; None for features other than z2.
    valid_share: float | None
    microseconds: float  # labelling and learning, a sample [us]
    megabytes: float  # memory of the set [MB]


@dataclass(frozen=True)
class TrainResult:
    """What training did."""

    output: str
    rows: tuple[TrainRow, ...]  # one a drive of this run
    total: TrainRow  # of all drives the set has seen; time is of this run
    horizons: tuple[float, ...]  # label interval of each drive of this run [s]
    kernel: Kernel
    fit: KernelFit | None
    trust: Trust  # how far each output of the set is believed
    notes: tuple[str, ...]
    laps: tuple[LapRow, ...] = ()  # with `per_lap`, one a lap of each drive
    failures: tuple[str, ...] = ()  # with `keep_going`, why drives were left out


def train_set(
    drive_paths: Sequence[str | Path],
    vehicle_path: str | Path,
    output: str | Path,
    settings: TrainSettings | None = None,
    *,
    append: bool = False,
    rows: Sequence[np.ndarray] | None = None,
    batch: int | None = None,
    per_lap: bool = False,
    keep_going: bool = False,
    engine: Engine = HERE,
    progress: Callable[[str], None] = lambda text: None,
) -> TrainResult:
    """Train a set from drives in the order given, and write it.

    Parameters
    ----------
    drive_paths : sequence of path
        Drives, and files of labels that `split label` wrote; folders, globs and addresses as `find_sources` takes
        them. Labels of a drive that is given too spare its labelling; labels alone train without their drive. Of
        a folder that is appended, only the drives that the set has not learned.
    output : path
        The set; with `append` it must exist and is continued.
    rows : sequence of ndarray of bool, optional
        For each drive, which rows may be learned; a label whose window touches another row is left out.
    batch : int, optional
        Samples offered at once; the result does not depend on it.
    per_lap : bool
        Also tell what each lap of the drives added; not for the dictionary of `iol`.
    keep_going : bool
        Leave out drives that cannot be read or are of another vehicle, instead of stopping; not with `rows`.
    engine : Engine
        Where drives are labelled; the set does not depend on it.
    progress : callable
        Called with a line of text at each step.

    Raises
    ------
    SplitError
        If an input is at fault; `output` is then as it was before.
    """
    settings = settings or TrainSettings()
    kernel_file = {settings.hyperparameters} - {None, "fit", "default"}
    refuse_overwriting_inputs((*drive_paths, vehicle_path, *kernel_file), output)
    sources = find_sources(drive_paths, DRIVE_SUFFIXES, what="drive")
    expanded = [source.address for source in sources] != [str(path) for path in drive_paths]
    # Two runs that append to one set take turns: each would write what it read, without the other's drives.
    with contextlib.ExitStack() as stack:
        if append:
            stack.enter_context(exclusive_access(output))
        absent: list[SplitError] = []
        paths = enter_all(sources, stack, absent if keep_going else None)
        changed: tuple[str, ...] = ()
        if append and expanded:
            paths, changed = _not_learned(paths, read_set(output))
        failures: tuple[str, ...] = ()
        if keep_going:
            paths, failures = usable_drives(paths, read_vehicle(vehicle_path), settings.held, settings.any_vehicle)
        result = _train_set(paths, vehicle_path, output, settings, append, rows, batch, per_lap, engine, progress)
        failures = (*map(str, absent), *failures)
        return replace(result, notes=(*changed, *result.notes), failures=failures)


def _not_learned(paths: Sequence[Path], known: TrainingSet) -> tuple[list[Path], tuple[str, ...]]:
    """Return the drives of a grown folder that the set has not learned, and what to say of the others.

    Raises
    ------
    SetError
        If there is none: the set would stay as it is.
    """
    learned = {source.sha256 for source in known.sources}
    digests = {path: drive_digest(path) for path in paths}
    new = [path for path in paths if digests[path] not in learned]
    gone = {source.name for source in known.sources if source.sha256 not in digests.values()}
    if not new:
        advice = "Give drives that are new."
        raise SetError(f"all {len(paths)} drives were learned before; the set is as it was", advice=advice)
    skipped = len(paths) - len(new)
    known_before = (f"{skipped} of {len(paths)} drives were learned before and are left out",) if skipped else ()
    return new, known_before + tuple(
        f"{path.name} has changed since the set learned it, and is learned again; what was learned of it before "
        "stays (train anew to leave it out)"
        for path in new
        if path.name in gone
    )


def _train_set(
    drive_paths: Sequence[str | Path],
    vehicle_path: str | Path,
    output: str | Path,
    settings: TrainSettings,
    append: bool,
    rows: Sequence[np.ndarray] | None,
    batch: int | None,
    per_lap: bool,
    engine: Engine,
    progress: Callable[[str], None],
) -> TrainResult:
    vehicle = read_vehicle(vehicle_path)
    known = read_set(output) if append else None
    if known is not None:
        _check_continues(known, vehicle, settings, str(output))
    drives = LabelledDrives(
        [Path(path) for path in drive_paths], _labelling(vehicle, settings, known), rows, progress, engine
    )
    if per_lap and drives.without_recording():
        advice = "Give the drive itself, or leave out --per-lap."
        raise SetError(f"{drives.without_recording()[0]} holds labels only: laps need the drive", advice=advice)
    if per_lap:
        check_laps(drives, vehicle)
    warm_up()
    drives.label_together()
    drives.leave_out_copies()
    trained, fit = known, None
    if trained is None:
        trained, fit, drives = create_set(drives, settings)
    seconds, table, laps = 0.0, [], []
    for number in range(len(drives)):
        drive = drives.drive(number)
        labels = drives.labels(number, drive)
        drives.remark(labels, drive, trained)
        progress(f"[{number + 1}/{len(drives)}] learning {labels.drive}")
        if per_lap and drive is not None and trained.learner != LEARNER:
            laps += lap_rows(drive, labels, trained)
        start = time.perf_counter()
        if trained.learner == LEARNER:
            trained = extend_dictionary(trained, [labels])
        else:
            trained = extend(trained, [labels], batch=batch)
        spent = drives.seconds(number) + time.perf_counter() - start
        seconds += spent
        table.append(_row(trained, [trained.sources[-1]], labels.drive, spent))
    write_set(trained, output)
    offered = sum(row.samples for row in table)
    total = _row(trained, trained.sources, "total", seconds, offered)
    horizons = tuple(source.horizon for source in trained.sources[-len(table) :])
    notes = (*_too_few(total), *drives.notes, *limits_of(trained), *notes_on_rejections(total, trained.region))
    return TrainResult(
        str(output), tuple(table), total, horizons, trained.kernel, fit, trained.trust, notes, tuple(laps)
    )


def _too_few(total: TrainRow) -> tuple[str, ...]:
    """Return a warning where a set has learned too little to correct anything."""
    if total.accepted >= FEWEST_TO_FIT:
        return ()
    labels = "1 label" if total.accepted == 1 else f"{total.accepted} labels"
    return (
        f"WARNING: the set has learned {labels}, and at least {FEWEST_TO_FIT} are needed: it corrects next to nothing, "
        "and `split export` stops at it. Append drives whose samples lie in the valid region",
    )


def notes_on_rejections(total: TrainRow, region: Region) -> tuple[str, ...]:
    """Return what the limits of the valid region leave out, if that is most of the driving.

    Parameters
    ----------
    total : TrainRow
        Of all drives.
    region : Region
        Its limits.
    """
    limits = {
        "speed": f"slower than {region.minimum_speed:.3g} m/s",
        "ellipse": f"at more than {100.0 * region.p_ellipse:.0f} % of an axle's grip by the vehicle file",
        "slip": f"with a slip angle over {region.alpha_max:g} rad",
        "slip difference": f"with slip angles of front and rear that differ by over {region.dalpha_max:g} rad",
    }
    left_out = [(count, limits[reason]) for reason, count in total.rejected if reason in limits and count]
    whole = sum(count for count, _ in left_out)
    if 2 * whole <= total.samples:
        return ()
    each = ", ".join(f"{count} {where}" for count, where in sorted(left_out, reverse=True))
    advice = ""
    if max(left_out)[1] == limits["ellipse"]:
        advice = ". Where the tyres carry more than the file says, `split calibrate` with --fit tires finds it"
    return (
        f"{whole} of {total.samples} samples are outside the valid region, in which alone the nominal model is "
        f"corrected: {each}{advice}",
    )


def _labelling(vehicle: Vehicle, settings: TrainSettings, known: TrainingSet | None) -> Labelling:
    """Return how drives are labelled: as the set says that is continued, else as asked for."""
    if known is not None:
        vehicle = known.vehicle
        features, region, plain, usual = known.features, known.region, known.plain, known.horizon
    else:
        features = parse_features("z2" if settings.features is None else settings.features)
        region, plain, usual = Region.of(vehicle), settings.plain, DEFAULT_HORIZON
    return Labelling(
        vehicle,
        features,
        region,
        usual if settings.horizon is None else settings.horizon,
        settings.stride,
        plain,
        settings.exclude,
        settings.held,
        settings.any_vehicle,
    )


def _row(
    trained: TrainingSet, sources: Sequence[SetSource], name: str, seconds: float, offered: int | None = None
) -> TrainRow:
    reasons: dict[str, int] = {}
    for source in sources:
        for reason, count in source.rejected.items():
            reasons[reason] = reasons.get(reason, 0) + count
    samples = sum(source.samples for source in sources)
    return TrainRow(
        drive=name,
        samples=samples,
        accepted=sum(source.accepted for source in sources),
        rejected=tuple(reasons.items()),
        updates=sum(source.insertions + source.replacements for source in sources),
        points=trained.size,
        cells=trained.cell_count,
        valid_share=trained.valid_share(),
        microseconds=1e6 * seconds / max(offered or samples, 1),
        megabytes=trained.nbytes / 1e6,
    )


def _check_continues(known: TrainingSet, vehicle: Vehicle, settings: TrainSettings, where: str) -> None:
    """Refuse to continue a set with another car or other settings."""
    nominal = known.nominal_vehicle
    if nominal.digest() != vehicle.digest():
        raise SetError(
            trained_for_another(nominal, vehicle),
            where=where,
            advice="Give the vehicle file it was trained with, or train a set of its own.",
        )
    for option, given, kept in (
        ("--hyperparameters", settings.hyperparameters, f"its hyperparameters ({known.kernel.origin})"),
        ("--cell-edge", settings.cell_edge, "its cells"),
        ("--trust", settings.trust, f"its trust, {known.trust.words()},"),
        ("--lag", settings.lag, "the lag of its torque, found or none,"),
    ):
        if given is not None:
            advice = f"Leave out {option}, or train anew with all drives."
            raise SetError(f"keeps {kept} when appended to", where=where, advice=advice)
    asked = parse_features(settings.features).names if settings.features is not None else known.features.names
    for what, theirs, ours in (
        ("features", asked, known.features.names),
        ("capacity", settings.capacity, known.capacity),
        ("threshold", settings.threshold, known.threshold),
        ("forgetting", settings.forgetting, known.forgetting),
        ("plain labels", settings.plain or None, known.plain),
        ("learner", settings.learner, known.learner),
    ):
        if theirs is not None and theirs != ours:
            shown = [", ".join(v) if isinstance(v, tuple) else v for v in (ours, theirs)]
            raise SetError(
                f"its {what}: {shown[0]}; asked for: {shown[1]}", where=where, advice="Train a set of its own."
            )
