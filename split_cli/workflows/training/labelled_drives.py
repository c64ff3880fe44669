"""The drives of one training: read and corrected one at a time, labelled once, or with labels from a file."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.errors import DriveError, SetError
from split_cli.files import ScratchFolder, sha256_of_file
from split_cli.learning.features import FeatureSet
from split_cli.learning.label_file import drive_of_labels, read_labels, write_labels
from split_cli.learning.labels import Labels, compute_labels, window_samples
from split_cli.learning.region import Region
from split_cli.learning.shared_rows import EarlierDrives, shared_sources
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive import Drive, open_drive, unstated_inputs
from split_cli.logs.drive_metadata import ingest_found
from split_cli.logs.scratch import LONG, set_aside
from split_cli.scoring.evidence import MOST_ROWS, TrainingDrive, middle_rows
from split_cli.scoring.late_inputs import late_inputs
from split_cli.vehicle.parameters import Vehicle
from split_cli.workflows.engine import HERE, Engine
from split_cli.workflows.label import drive_notes
from split_cli.workflows.recordings import RecordingCorrection, vehicle_warnings

#: Labels kept in memory [bytes]; those beyond wait in a temporary folder, so that an archive of any size trains.
KEPT_BYTES = 256 * 2**20


@dataclass(frozen=True)
class Labelling:
    """How drives are labelled."""

    vehicle: Vehicle
    features: FeatureSet
    region: Region
    horizon: float  # label interval [s]
    stride: int | None = None  # samples between labels; the horizon if None
    plain: bool = False  # use the paper's plain difference
    exclude: tuple[tuple[float, float], ...] = ()  # stretches of time that are not learned [s]
    held: tuple[str, ...] = ()  # inputs that keep their value between samples, whatever the files say
    any_vehicle: bool = False  # warn, where a drive contradicts the vehicle, instead of refusing


@dataclass(frozen=True)
class _Source:
    """A drive, its labels from a file, or both; `position` is its place among the rows that may be learned."""

    position: int
    drive: Path | None
    labels: Path | None

    @property
    def name(self) -> str:
        return (self.drive or self.labels).name  # type: ignore[union-attr]


class LabelledDrives:
    """Drives and their labels, in the order given; memory holds one drive and a bounded share of the labels.

    Parameters
    ----------
    paths : sequence of Path
        Drives, and files that `split label` wrote. Labels of a drive that is given too spare its labelling.
    rows : sequence of ndarray of bool, optional
        For each drive, which rows may be learned; a label whose window touches another row is left out.
    progress : callable
        Called with a line of text at each step.
    engine : Engine
        Where drives are labelled, several at a time; its workers must see the same files.

    Raises
    ------
    SplitError
        If a label file is damaged, or two are of one drive.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        labelling: Labelling,
        rows: Sequence[np.ndarray] | None,
        progress: Callable[[str], None],
        engine: Engine = HERE,
    ) -> None:
        self.labelling, self.progress, self._engine = labelling, progress, engine
        self._rows = rows
        self._sources = _paired(paths)
        self._correct = RecordingCorrection(labelling.vehicle)
        self._checked: set[int] = set()
        self._notes: list[str] = []
        self._kept: dict[int, Labels | Path] = {}
        self._seconds: dict[int, float] = {}
        self._bytes = 0
        self._open: tuple[int, Drive] | None = None
        self._middle_only = False
        self._scratch: ScratchFolder | None = None

    def __len__(self) -> int:
        return len(self._sources)

    def labelled_for(self, vehicle: Vehicle, judged: int | None = None) -> LabelledDrives:
        """Return the same drives labelled for another vehicle, notes and all; files of labels are not of it.

        Only for drives of which all recordings are given.

        Parameters
        ----------
        judged : int, optional
            How many drives, the first ones, trust is found on. Then these alone are wanted, and of a longer drive
            the middle that trust is found on.
        """
        other = copy.copy(self)
        other.labelling = replace(self.labelling, vehicle=vehicle)
        other._sources = [replace(source, labels=None) for source in self._sources[:judged]]
        other._middle_only = judged is not None
        if other._open is not None:
            other._open = (other._open[0], _wanted(other._open[1], other._middle_only))
        other._kept, other._seconds, other._bytes, other._scratch = {}, {}, 0, None
        other.label_together()
        return other

    def label_together(self) -> None:
        """Label all drives ahead where there are several workers; one process labels each when it is asked for."""
        numbers = [n for n, source in enumerate(self._sources) if source.labels is None and n not in self._kept]
        # Places count along the first drive: one after the other.
        if self._engine.workers < 2 or len(numbers) < 2 or self._correct.counts_places:
            return
        self.progress(f"labelling {len(numbers)} drives on {self._engine.name}")
        jobs = [
            (self._sources[n].drive, self.labelling, self._rows_of(n), n not in self._checked, self._middle_only)
            for n in numbers
        ]
        for n, (labels, warnings, seconds) in zip(numbers, self._engine.map(_label_apart, jobs), strict=True):
            self._checked.add(n)
            self._notes += warnings
            self._seconds[n] = seconds
            self._keep(n, labels)

    def _rows_of(self, number: int) -> np.ndarray | None:
        if self._rows is None:
            return None
        return np.asarray(self._rows[self._sources[number].position], dtype=bool)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of the training should know of its drives."""
        return (*self._notes, *self._correct.notes)

    def note(self, *texts: str) -> None:
        """Add to the notes what is not there yet."""
        self._notes += [text for text in texts if text not in self._notes]

    def without_recording(self) -> tuple[str, ...]:
        """Return names of label files whose drives are not given."""
        return tuple(source.name for source in self._sources if source.drive is None)

    def drive(self, number: int) -> Drive | None:
        """Return a drive, its recording corrected as the vehicle file says; None where only labels are given."""
        source = self._sources[number]
        if source.drive is None:
            return None
        if self._open is not None and self._open[0] == number:
            return self._open[1]
        self.progress(f"reading {source.name}")
        drive = self._correct(open_drive(source.drive, self.labelling.held))
        drive = _wanted(drive, self._middle_only)
        # To open a long one takes longer than to hold it: its columns stay in its file.
        self._open = (number, drive) if drive.stays_in_file else None
        if number not in self._checked:
            self._checked.add(number)
            self._notes += vehicle_warnings([drive], self.labelling.vehicle, self.labelling.any_vehicle)
        return drive

    def labels(self, number: int, drive: Drive | None = None) -> Labels:
        """Return the labels that may be learned of a drive, made once; `drive` spares reading it again."""
        if number not in self._kept:
            self._keep(number, self._make(number, drive))
        kept = self._kept[number]
        labels = read_labels(kept) if isinstance(kept, Path) else kept
        if drive is not None and self._sources[number].labels is not None:
            _check_of_drive(labels, drive, str(self._sources[number].labels))
        return labels

    def seconds(self, number: int) -> float:
        """Return how long labelling took [s]."""
        return self._seconds[number]

    def leave_out_copies(self) -> None:
        """Leave out drives whose driving an earlier one holds: it would count twice, in trust above all.

        On held-out blocks a copy is no test: what is held out of one drive is learned from the other.
        """
        before = EarlierDrives()
        kept: list[int] = []
        for number in range(len(self._sources) if len(self._sources) > 1 else 0):
            labels = self.labels(number)
            earlier = before.holding(labels)
            if earlier is None:
                kept.append(number)
            else:
                what = f"is a copy of {earlier}, or a stretch of it, at this rate or another"
                self._notes.append(f"{labels.drive} {what}, and is left out: it would count twice")
        if 0 < len(kept) < len(self._sources):
            self._sources = [self._sources[old] for old in kept]
            self._kept = {new: self._kept[old] for new, old in enumerate(kept)}
            self._seconds = {new: self._seconds[old] for new, old in enumerate(kept)}
            self._checked = {new for new, old in enumerate(kept) if old in self._checked}
            self._open = None

    def remark(self, labels: Labels, drive: Drive | None, trained: TrainingSet) -> None:
        """Note what a reader should know of a drive that `trained` learns now."""
        if drive is None:
            self._notes.append(f"{labels.drive} is learned from its labels; the recording was not looked at")
            self._notes += ingest_found(labels.drive, (*labels.faults, *labels.remarks))
        else:
            self.note(*unstated_inputs([drive]))
            self._notes += drive_notes(drive)
            middle = TrainingDrive(drive, labels).middle(MOST_ROWS)
            self._notes += late_inputs(middle.drive, middle.labels, self.labelling.vehicle)
        same = [source.name for source in trained.sources if source.sha256 == labels.sha256]
        if same:
            self._notes.append(f"{labels.drive} was learned before, as {same[0]}, and counts twice now")
            return
        self._notes += [
            f"{labels.drive} holds driving that was learned before, from {trained.sources[n].name}: "
            f"{100.0 * share:.0f} % of the points kept of that drive are samples of both, and count twice now"
            for n, share in shared_sources(trained, labels.z, labels.t).items()
        ]

    def _keep(self, number: int, labels: Labels) -> None:
        long = len(labels) >= LONG
        if long:  # they lie outside memory as they are
            named = {name: getattr(labels, name) for name in ("t", "row", "z", "y")}
            labels = replace(
                labels, **{name: set_aside(values.reshape(-1)).reshape(values.shape) for name, values in named.items()}
            )
        self._bytes += 0 if long else labels.nbytes
        if long or self._bytes <= KEPT_BYTES:
            self._kept[number] = labels
            return
        self._scratch = self._scratch or ScratchFolder()
        path = self._scratch.path / f"{number}.parquet"
        write_labels(labels, path)
        self._kept[number] = path

    def _make(self, number: int, drive: Drive | None) -> Labels:
        source, how = self._sources[number], self.labelling
        if source.labels is None:
            drive = self.drive(number) if drive is None else drive
            start = time.perf_counter()
            labels = _labelled(drive, how)
        else:
            start = time.perf_counter()
            labels = _fitting(read_labels(source.labels), how, self._correct.counts_places, str(source.labels))
            labels = _outside(labels, how.exclude)
        labels = _learnable(labels, self._rows_of(number), self._middle_only)
        self._seconds[number] = time.perf_counter() - start
        return labels


def _labelled(drive: Drive, how: Labelling) -> Labels:
    labels = compute_labels(
        drive, how.vehicle, how.features, how.region, horizon=how.horizon, stride=how.stride, plain=how.plain
    )
    if how.exclude:
        spans = [(drive["t"] >= begin) & (drive["t"] < end) for begin, end in how.exclude]
        labels = labels.within(~np.any(spans, axis=0))
    return labels


def _wanted(drive: Drive, middle_only: bool) -> Drive:
    """Return a drive, or the middle of a long one that trust is found on."""
    return drive.stretch(*middle_rows(len(drive), MOST_ROWS)) if middle_only else drive


def _learnable(labels: Labels, rows: np.ndarray | None, middle_only: bool) -> Labels:
    """Return the labels on rows of a drive that may be learned, all if None; labels may be of the drive's middle."""
    if rows is None:
        return labels
    return labels.within(rows[slice(*middle_rows(len(rows), MOST_ROWS))] if middle_only else rows)


def _label_apart(job: tuple[Path, Labelling, np.ndarray | None, bool, bool]) -> tuple[Labels, tuple[str, ...], float]:
    """Return the labels of a drive, warnings about it, and the time that labelling took [s]."""
    path, how, rows, check, middle_only = job
    drive = _wanted(RecordingCorrection(how.vehicle)(open_drive(path, how.held)), middle_only)
    warnings = vehicle_warnings([drive], how.vehicle, how.any_vehicle) if check else ()
    start = time.perf_counter()
    labels = _learnable(_labelled(drive, how), rows, middle_only)
    return labels, warnings, time.perf_counter() - start


def drive_digest(path: Path) -> str:
    """Return the SHA-256 of a drive, or of the drive that a label file is of."""
    return drive_of_labels(path) or sha256_of_file(path)


def _paired(paths: Sequence[Path]) -> list[_Source]:
    """Return the drives with the label files that are of them, then what labels are left, in the order given."""
    files: dict[str, Path] = {}
    drives: list[tuple[int, Path]] = []
    order: list[tuple[int, str]] = []
    for position, path in enumerate(paths):
        digest = drive_of_labels(path)
        if digest is None:
            drives.append((position, path))
        elif digest in files:
            advice = "Give one of them."
            raise SetError(f"and {files[digest].name} are labels of one drive", where=str(path), advice=advice)
        else:
            files[digest] = path
            order.append((position, digest))
    digests = {position: sha256_of_file(path) for position, path in drives} if files else {}
    sources = [_Source(position, path, files.get(digests.get(position, ""))) for position, path in drives]
    given = set(digests.values())
    sources += [_Source(position, None, files[digest]) for position, digest in order if digest not in given]
    return sorted(sources, key=lambda source: source.position)


def _fitting(labels: Labels, how: Labelling, counts_places: bool, where: str) -> Labels:
    """Return labels of a file for a training; refuse those that were made for another one."""
    label_again = "Write them again with `split label`, or give the drive itself."
    if labels.vehicle_digest != how.vehicle.digest():
        raise SetError(
            f"holds labels of another vehicle file (physics {labels.vehicle_digest[:12]}, that of "
            f"{how.vehicle.name!r} is {how.vehicle.digest()[:12]})",
            where=where,
            advice=label_again,
        )
    if how.held:
        raise SetError("holds labels; --held cannot change them", where=where, advice=label_again)
    if counts_places:
        raise SetError(
            "holds labels, but the vehicle file has effects at track positions, which need the drives",
            where=where,
            advice="Give the drives themselves.",
        )
    window = window_samples(how.horizon, labels.horizon / labels.window)
    asked = min(np.diff(labels.row), default=None)
    for what, theirs, ours in (
        ("features", ", ".join(labels.features.names), ", ".join(how.features.names)),
        ("valid region", labels.region, how.region),
        ("plain labels", labels.plain, how.plain),
        ("label interval in samples", labels.window, window),
        ("stride", asked if how.stride and asked is not None else how.stride, how.stride),
    ):
        if theirs != ours:
            raise SetError(f"its {what}: {theirs}; asked for: {ours}", where=where, advice=label_again)
    return labels.without_grid()


def _outside(labels: Labels, spans: Sequence[tuple[float, float]]) -> Labels:
    """Return the labels without a sample, first and last included, in any span [begin, end)."""
    period = labels.horizon / labels.window
    for begin, end in spans:
        first = np.clip(np.ceil((begin - labels.t) / period - 1e-6), 0.0, None)
        touched = (first <= labels.window) & (labels.t + first * period < end - 1e-6 * period)
        labels = labels.take(~touched)
    return labels


def _check_of_drive(labels: Labels, drive: Drive, where: str) -> None:
    """Make sure that labels lie on the rows of their drive."""
    if len(labels) and (
        labels.row[-1] + labels.window >= len(drive) or not np.array_equal(drive["t"][labels.row], labels.t)
    ):
        advice = "Label the drive again with `split label`."
        raise DriveError(f"does not lie on the rows of {drive.name}", where=where, advice=advice)
