"""Train a set from drives, or go on training one."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.errors import SetError
from split_cli.files import exclusive_access, refuse_overwriting_inputs, sha256_of_file
from split_cli.learning.cells import DEFAULT_CAPACITY, DEFAULT_THRESHOLD, empty_set, extend, warm_up
from split_cli.learning.features import parse_features
from split_cli.learning.hyperparameters import (
    FEWEST_TO_FIT,
    KernelFit,
    default_kernel,
    fit_kernel,
    longest_scale,
    scatter_variance,
)
from split_cli.learning.iol import DEFAULT_DICTIONARY, LEARNER, empty_dictionary, extend_dictionary
from split_cli.learning.kernel import Kernel
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.labels import DEFAULT_HORIZON, Labels, compute_labels
from split_cli.learning.region import Grid, Region, build_grid
from split_cli.learning.training_set import SetSource, TrainingSet, read_set, write_set
from split_cli.learning.trust import Trust
from split_cli.logs.drive import Drive, read_drive, untold_inputs
from split_cli.logs.quality import stored_faults
from split_cli.scoring.evidence import MOST_ROWS, TrainingDrive
from split_cli.scoring.hints import late_inputs
from split_cli.scoring.trust import estimate_trust
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.label import drive_notes
from split_cli.workflows.laps import LapRow, lap_rows
from split_cli.workflows.recordings import RecordingCorrection, vehicle_doubts
from split_cli.workflows.sources import DRIVE_SUFFIXES, find_sources

__all__ = ["TrainResult", "TrainRow", "TrainSettings", "parse_trust", "train_set", "trust_notes"]


@dataclass(frozen=True)
class TrainSettings:
    """How to train; None means the default for a new set, and the set's own when appending.

    Attributes
    ----------
    features : str or None
        ``z2`` (default), ``z1`` or a comma-separated list of names.
    hyperparameters : str or None
        ``fit`` (default), ``default``, or a YAML file; only for a new set.
    horizon : float or None
        Label interval [s], 0.05 by default.
    stride : int or None
        Samples between labels; the horizon by default.
    capacity : int or None
        Points a cell, 10 by default.
    threshold : float or None
        Gain that a point needs to enter a cell with room, 1e-3 by default.
    forgetting : float or None
        Time constant [s]; off by default.
    plain : bool
        Use the paper's plain difference as label.
    exclude : tuple of (float, float)
        Stretches of time of every drive [s] that are not learned.
    learner : str or None
        ``split`` (default), or ``iol``: one dictionary of `capacity` points, 300 by default.
    held : tuple of str
        Inputs that keep their value between samples, whatever the files say.
    trust : str or None
        ``held-out`` (default): found on held-out blocks of the drives; ``full``: the plain method; or three
        numbers from 0 to 1 for v_x, v_y and r, separated by commas. Only for a new set.
    any_vehicle : bool
        Learn drives that contradict the vehicle all the same, with a warning.
    """

    features: str | None = None
    hyperparameters: str | None = None
    horizon: float | None = None
    stride: int | None = None
    capacity: int | None = None
    threshold: float | None = None
    forgetting: float | None = None
    plain: bool = False
    exclude: tuple[tuple[float, float], ...] = ()
    learner: str | None = None
    held: tuple[str, ...] = ()
    trust: str | None = None
    any_vehicle: bool = False


@dataclass(frozen=True)
class TrainRow:
    """What one drive, or all, did to the set.

    Attributes
    ----------
    drive : str
    samples, accepted : int
        Labels, and those inside the valid region.
    rejected : tuple of (str, int)
        By reason.
    updates : int
        Insertions and replacements.
    points, cells : int
        Set size and non-empty cells afterwards.
    valid_share : float or None
        Share of the valid region's cells that hold points; None for features other than z2.
    microseconds : float
        Labelling and learning, a sample [us].
    megabytes : float
        Memory of the set [MB].
    """

    drive: str
    samples: int
    accepted: int
    rejected: tuple[tuple[str, int], ...]
    updates: int
    points: int
    cells: int
    valid_share: float | None
    microseconds: float
    megabytes: float


@dataclass(frozen=True)
class TrainResult:
    """What training did.

    Attributes
    ----------
    output : str
    rows : tuple of TrainRow
        One a drive of this run.
    total : TrainRow
        Of all drives the set has seen; time is of this run.
    horizons : tuple of float
        Label interval of each drive of this run [s].
    kernel : Kernel
    fit : KernelFit or None
    trust : Trust
        How far each output of the set is believed.
    notes : tuple of str
    laps : tuple of LapRow
        With `per_lap`, one a lap of each drive.
    """

    output: str
    rows: tuple[TrainRow, ...]
    total: TrainRow
    horizons: tuple[float, ...]
    kernel: Kernel
    fit: KernelFit | None
    trust: Trust
    notes: tuple[str, ...]
    laps: tuple[LapRow, ...] = ()


def train_set(
    drive_paths: Sequence[str | Path],
    vehicle_path: str | Path,
    output: str | Path,
    settings: TrainSettings = TrainSettings(),
    *,
    append: bool = False,
    rows: Sequence[np.ndarray] | None = None,
    batch: int | None = None,
    per_lap: bool = False,
    progress: Callable[[str], None] | None = None,
) -> TrainResult:
    """Train a set from drives in the order given, and write it.

    Parameters
    ----------
    drive_paths : sequence of path
        Drives; folders, globs and addresses as `find_sources` takes them. Of a folder that is appended, only the
        drives that the set has not learned.
    vehicle_path : path
    output : path
        The set; with `append` it must exist and is continued.
    settings : TrainSettings
    append : bool
    rows : sequence of ndarray of bool, optional
        For each drive, which rows may be learned; a label whose window touches another row is left out.
    batch : int, optional
        Samples offered at once; the result does not depend on it.
    per_lap : bool
        Also tell what each lap of the drives added; not for the dictionary of `iol`.
    progress : callable, optional
        Told what is being done.

    Returns
    -------
    TrainResult

    Raises
    ------
    SplitError
        If an input is at fault; `output` is then as it was before.
    """
    say = progress or (lambda text: None)
    kernel_file = {settings.hyperparameters} - {None, "fit", "default"}
    refuse_overwriting_inputs(output, (*drive_paths, vehicle_path, *kernel_file))
    sources = find_sources(drive_paths, DRIVE_SUFFIXES, what="drive")
    expanded = [source.address for source in sources] != [str(path) for path in drive_paths]
    # Two runs that append to one set take turns: each would write what it read, without the other's drives.
    with contextlib.ExitStack() as stack:
        if append:
            stack.enter_context(exclusive_access(output))
        paths = [stack.enter_context(source.local()) for source in sources]
        if append and expanded:
            paths = _not_learned(paths, read_set(output))
        return _train_set(paths, vehicle_path, output, settings, append, rows, batch, per_lap, say)


def _not_learned(paths: Sequence[Path], known: TrainingSet) -> list[Path]:
    """Return the drives of a grown folder that the set has not learned.

    Raises
    ------
    SetError
        If there is none: the set would stay as it is.
    """
    learned = {source.sha256 for source in known.sources}
    new = [path for path in paths if sha256_of_file(path) not in learned]
    if not new:
        raise SetError(f"all {len(paths)} drives were learned before; the set is as it was")
    return new


def _train_set(
    drive_paths: Sequence[str | Path],
    vehicle_path: str | Path,
    output: str | Path,
    settings: TrainSettings,
    append: bool,
    rows: Sequence[np.ndarray] | None,
    batch: int | None,
    per_lap: bool,
    say: Callable[[str], None],
) -> TrainResult:
    vehicle = read_vehicle(vehicle_path)
    known = read_set(output) if append else None
    if known is not None:
        _check_continues(known, vehicle, settings, str(output))
    run = _Run(tuple(Path(path) for path in drive_paths), vehicle, settings, rows, known, say)
    warm_up()
    begin_set, fit = (known, None) if known is not None else run.create()
    trained, seconds, table, laps = begin_set, 0.0, [], []
    for labels, labelling in run.labels():
        say(f"learning {labels.drive}")
        if per_lap and trained.learner != LEARNER:
            laps += lap_rows(run.drive(len(table)), labels, trained)
        start = time.perf_counter()
        if trained.learner == LEARNER:
            trained = extend_dictionary(trained, [labels])
        else:
            trained = extend(trained, [labels], batch=batch)
        if run.faults:
            last = replace(trained.sources[-1], faults=run.faults)
            trained = replace(trained, sources=(*trained.sources[:-1], last))
        spent = labelling + time.perf_counter() - start
        seconds += spent
        table.append(_row(trained, [trained.sources[-1]], labels.drive, spent))
    write_set(trained, output)
    offered = sum(row.samples for row in table)
    total = _row(trained, trained.sources, "total", seconds, offered)
    horizons = tuple(source.horizon for source in trained.sources[-len(table) :])
    return TrainResult(
        str(output), tuple(table), total, horizons, trained.kernel, fit, trained.trust,
        (*run.notes, *run.correct.notes), tuple(laps),
    )  # fmt: skip


class _Run:
    """The drives of one run, read and labelled one at a time so that memory holds one."""

    def __init__(
        self,
        paths: tuple[Path, ...],
        vehicle: Vehicle,
        settings: TrainSettings,
        rows: Sequence[np.ndarray] | None,
        known: TrainingSet | None,
        say: Callable[[str], None],
    ) -> None:
        self.paths, self.vehicle, self.settings, self.rows, self.say = paths, vehicle, settings, rows, say
        if known is not None:
            self.features, self.region, self.plain = known.features, known.region, known.plain
            self.horizon = known.horizon if settings.horizon is None else settings.horizon
        else:
            self.features = parse_features("z2" if settings.features is None else settings.features)
            self.region, self.plain = Region.of(vehicle), settings.plain
            self.horizon = DEFAULT_HORIZON if settings.horizon is None else settings.horizon
        self.seen = {source.sha256: source.name for source in known.sources} if known else {}
        self.notes: list[str] = []
        self.faults: tuple[str, ...] = ()
        self.checked: set[int] = set()
        self.correct = RecordingCorrection(vehicle)

    def labels(self) -> Iterator[tuple[Labels, float]]:
        """Yield the labels of each drive and the seconds that labelling took."""
        for position in range(len(self.paths)):
            drive = self.drive(position)
            self._take_notes(drive)
            start = time.perf_counter()
            labels = self._label(drive, position)
            spent = time.perf_counter() - start
            self.notes += late_inputs(drive, labels, self.vehicle)
            yield labels, spent

    def create(self) -> tuple[TrainingSet, KernelFit | None]:
        """Return an empty set: its grid from the first drive with valid samples, its kernel as asked for."""
        settings = self.settings
        asked = settings.hyperparameters or "fit"
        first = self._first_valid()
        valid = first.accepted
        grid = build_grid(self.features, self.vehicle, self.region, first.z[valid])
        kernel, fit = default_kernel(grid, first.y[valid], scatter_variance(first)), None
        if asked == "fit":
            fit = self._fit(grid, kernel)
            kernel = kernel if fit is None else fit.kernel
        elif asked != "default":
            kernel = read_kernel(asked, self.features)
        dictionary = settings.learner == LEARNER
        empty = empty_set(
            self.vehicle,
            self.features,
            self.region,
            grid,
            kernel,
            horizon=self.horizon,
            capacity=DEFAULT_CAPACITY if settings.capacity is None or dictionary else settings.capacity,
            threshold=DEFAULT_THRESHOLD if settings.threshold is None else settings.threshold,
            forgetting=settings.forgetting,
            plain=self.plain,
        )
        if dictionary:
            points = DEFAULT_DICTIONARY if settings.capacity is None else settings.capacity
            return empty_dictionary(replace(empty, trust=self._trust(empty, "full")), points), fit
        return replace(empty, trust=self._trust(empty, "held-out")), fit

    def _trust(self, empty: TrainingSet, usual: str) -> Trust:
        """Return the trust asked for, else the usual one of the learner; the rival's way is to believe all."""
        asked = self.settings.trust or usual
        if asked != "held-out":
            return parse_trust(asked)
        parts, rows = [], 0
        for position in range(len(self.paths)):
            drive = self.drive(position)
            rows += len(drive)
            if parts and rows > MOST_ROWS:
                self.notes.append(f"trust was found on the first {len(parts)} of {len(self.paths)} drives")
                break
            parts.append(TrainingDrive(drive, self._label(drive, position)))
        trust = estimate_trust(parts, empty, say=self.say)
        self.notes += trust_notes(trust)
        return trust

    def _fit(self, grid: Grid, start: Kernel) -> KernelFit | None:
        """Fit to the valid labels of all drives; None, with a note, when they are too few."""
        z, y = [], []
        for position in range(len(self.paths)):
            labels = self._label(self.drive(position), position).inside(grid)
            z.append(labels.z[labels.accepted])
            y.append(labels.y[labels.accepted])
        z, y = np.concatenate(z), np.concatenate(y)
        if len(z) < FEWEST_TO_FIT:
            self.notes.append(
                f"{len(z)} valid labels are too few to fit hyperparameters to; the defaults are kept"
            )
            return None
        self.say(f"fitting hyperparameters to {len(z)} labels")
        fit = fit_kernel(z, y, grid, start, longest=longest_scale(grid))
        scales = {f"length scale {i + 1}": f"length scale of {name}" for i, name in enumerate(self.features.names)}
        self.notes += [f"the {scales.get(name, name)} ended on a bound of the fit" for name in fit.at_bound]
        return fit

    def _first_valid(self) -> Labels:
        for position in range(len(self.paths)):
            labels = self._label(self.drive(position), position)
            if labels.accepted.any():
                return labels
        counts = ", ".join(f"{count} {reason}" for reason, count in labels.counts().items()) or "no samples"
        raise SetError(
            f"no sample is inside the valid region (rejected: {counts})",
            where=labels.drive,
            advice="Check units and signs with `split info`, and that the vehicle file is of this car.",
        )

    def drive(self, position: int) -> Drive:
        """Return a drive of the run, its recording corrected as the vehicle file says."""
        self.say(f"reading {self.paths[position].name}")
        drive = self.correct(read_drive(self.paths[position], self.settings.held))
        if position not in self.checked:
            self.checked.add(position)
            self.notes += vehicle_doubts([drive], self.vehicle, self.settings.any_vehicle)
        return drive

    def _label(self, drive: Drive, position: int) -> Labels:
        labels = compute_labels(
            drive,
            self.vehicle,
            self.features,
            self.region,
            horizon=self.horizon,
            stride=self.settings.stride,
            plain=self.plain,
        )
        allowed = (
            np.ones(len(drive), dtype=bool) if self.rows is None else np.asarray(self.rows[position], dtype=bool)
        )
        for begin, end in self.settings.exclude:
            allowed = allowed & ~((drive["t"] >= begin) & (drive["t"] < end))
        return labels.within(allowed)

    def _take_notes(self, drive: Drive) -> None:
        self.notes += [note for note in untold_inputs([drive]) if note not in self.notes]
        self.notes += drive_notes(drive)
        self.faults = stored_faults(drive.metadata.quality)
        if drive.sha256 in self.seen:
            self.notes.append(f"{drive.name} was learned before, as {self.seen[drive.sha256]}")
        self.seen[drive.sha256] = drive.name


def parse_trust(text: str) -> Trust:
    """Return the trust that ``full`` or ``0.5,0.6,1`` stands for.

    Raises
    ------
    SetError
        If it is neither.
    """
    if text == "full":
        return Trust.full()
    try:
        return Trust(tuple(float(part) for part in text.split(",")), "given")
    except ValueError:
        raise SetError(
            f"the trust {text!r} cannot be read",
            advice="Give held-out, full, or three numbers from 0 to 1 for v_x, v_y and r, such as 0.5,0.8,1.",
        ) from None


def trust_notes(trust: Trust) -> list[str]:
    """Return what the reader of a training must know of its trust."""
    if trust.origin == "unjudged":
        return [
            "the drives are too short to judge the correction on held-out blocks, so none of it is applied; "
            "record more driving, or say --trust full"
        ]
    left_out = [n for n, share in zip(("v_x", "v_y", "r"), trust.share, strict=True) if share == 0.0]
    if not left_out:
        return []
    return [
        f"no correction of {', '.join(left_out)} is applied: on held-out blocks it did not help beyond chance, or "
        "made some of the driving worse"
    ]


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
    if known.vehicle.digest() != vehicle.digest():
        raise SetError(
            f"was trained for the vehicle {known.vehicle.name!r} (physics {known.vehicle.digest()[:12]}), not for "
            f"{vehicle.name!r} ({vehicle.digest()[:12]})",
            where=where,
            advice="Give the vehicle file it was trained with, or train a set of its own.",
        )
    if settings.hyperparameters is not None:
        raise SetError(
            f"keeps its hyperparameters ({known.kernel.origin}) when appended to",
            where=where,
            advice="Leave out --hyperparameters, or train anew with all drives.",
        )
    if settings.trust is not None:
        raise SetError(
            f"keeps its trust, {known.trust.words()}, when appended to",
            where=where,
            advice="Leave out --trust, or train anew with all drives.",
        )
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
