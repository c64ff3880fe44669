"""Write a trained set for controllers and for other programs, verified before it is there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from split_cli.errors import SetError
from split_cli.export.provenance import provenance_of
from split_cli.export.targets import TargetResult, plan_export, write_export
from split_cli.files import atomic_directory, sha256_of_file
from split_cli.learning.hyperparameters import FEWEST_TO_FIT
from split_cli.learning.training_set import TrainingSet, read_set
from split_cli.logs.drive_metadata import ingest_found
from split_cli.prediction import DEFAULT_PREDICTOR


@dataclass(frozen=True)
class ExportResult:
    """What was exported."""

    folder: str
    name: str
    set_sha256: str
    points: int
    cells: int
    targets: tuple[TargetResult, ...]
    doubts: tuple[str, ...] = ()  # why the set should not drive a car yet, exported because the user insisted
    reservations: tuple[str, ...] = ()  # where its correction may do harm


def export_doubts(training_set: TrainingSet) -> tuple[str, ...]:
    """Return why a set should not drive a car yet; empty when nothing known speaks against it."""
    doubts = [text for s in training_set.sources for text in ingest_found(s.name, s.faults)]
    accepted = sum(source.accepted for source in training_set.sources)
    if training_set.sources and accepted < FEWEST_TO_FIT:
        doubts.append(f"{accepted} labels were learned, fewer than the {FEWEST_TO_FIT} that fitting a kernel needs")
    if not any(training_set.trust.share):
        doubts.append("the correction helped no output on held-out driving, so the export would be the nominal model")
    return tuple(doubts)


def export_set(
    set_path: str | Path,
    output: str | Path,
    targets: Sequence[str],
    *,
    predictor: str = DEFAULT_PREDICTOR,
    name: str | None = None,
    real: str = "double",
    queries: int = 10_000,
    step: float | None = None,
    insist: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> ExportResult:
    """Export a trained set into a folder.

    Parameters
    ----------
    set_path : path
        A ``.split`` file.
    output : path
        Folder; created if its parent exists. Files of the same names are replaced when all targets verified.
    targets : sequence of str
        Of c, casadi, npz, json.
    name : str, optional
        Prefix of files and functions; by default the set's file name.
    real : {"double", "float"}
        Numbers of the C target.
    queries : int
        Size of the comparison with Python.
    step : float, optional
        Interval of the controller [s], for vehicles whose commands arrive late: past commands are kept at it. By
        default the set's label interval.
    insist : bool
        Export in spite of `export_doubts`.
    progress : callable
        Called with a line of text at each step.

    Raises
    ------
    SplitError
        If the set cannot be read, a word is unknown, an export differs from Python, or the set should not drive a
        car yet and the user does not insist; nothing is written then.
    """
    set_path = Path(set_path)
    plan = plan_export(targets, name or set_path.stem, real, queries, predictor, step)
    training_set = read_set(set_path)
    doubts = export_doubts(training_set)
    if doubts and not insist:
        advice = "Correct the signal map or record more, train again, or export it all the same with --insist."
        raise SetError(f"should not drive a car: {'; '.join(doubts)}", where=str(set_path), advice=advice)
    digest = sha256_of_file(set_path)
    provenance = provenance_of(training_set, predictor, set_path.name, digest)
    with atomic_directory(output) as folder:
        results = write_export(training_set, plan, provenance, folder, progress)
    size, cells = training_set.size, training_set.cell_count
    said = (doubts, provenance.reservations)
    return ExportResult(str(output), plan.name, digest, size, cells, results, *said)
