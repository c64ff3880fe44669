"""Diagnose a simulation against reality and write what was found."""

import contextlib
import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.parallel import distributing_by
from split_cli.diagnosis.remainder.location import FORCES
from split_cli.diagnosis.statement.document import VEHICLES, diagnosis_to_text, vehicle_name
from split_cli.diagnosis.statement.improvement import Improvement
from split_cli.diagnosis.statement.result import Diagnosis, GapSeries, InputFile
from split_cli.diagnosis.statement.sentences import not_accepted
from split_cli.files import atomic_directory, refuse_what_cannot_be_a_folder, sha256_of_file, write_digests
from split_cli.learning.features import Z2
from split_cli.learning.label_file import label_columns
from split_cli.learning.labels import compute_labels
from split_cli.logs.drive import Drive, read_drive, unstated_inputs, with_inputs_alike
from split_cli.vehicle.parameters import EffectSpec, Vehicle, read_vehicle, vehicle_file, write_vehicle
from split_cli.workflows.drive_charts import diagnosis_charts
from split_cli.workflows.engine import HERE, Engine
from split_cli.workflows.recordings import RecordingCorrection, vehicle_warnings
from split_cli.workflows.report.page import report_page

_UNJUDGED = "Not judged: no held-out time to compare it with the vehicle given."
#: Models compared on held-out time, as `Improvement` and `HorizonErrors` name them.
STAGES = ("before", "physics", "split_only", "after", "persistence")
#: Of the table of held-out errors.
IMPROVEMENT_COLUMNS = ("horizon_s", "stage", "channel", "unit", "rmse", "low_95", "high_95")
CHANNELS, LABEL_UNITS, STATE_UNITS = ("v_x", "v_y", "r"), ("m/s^2", "m/s^2", "rad/s^2"), ("m/s", "m/s", "rad/s")
_ONE_STEP = 0.05
#: Rows of all drives from which on memory and time are announced [1]: 18,000 took 0.7 GB, 180,000 over 1.9 GB.
_LONG = 30_000
_GAP_REACH = 0.05  # [s] between a label and the row of the gap that is stored beside it


def diagnose_files(
    real: Sequence[str | Path],
    vehicle_path: str | Path,
    output: str | Path,
    *,
    simulated: Sequence[str | Path] = (),
    holdout: Sequence[str | Path] = (),
    held: Sequence[str] = (),
    engine: Engine = HERE,
    progress: Callable[[str], None] = lambda step: None,
    note: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Diagnose recordings and write `diagnosis.json`, `report.html`, figures, the corrected vehicle and the gap.

    Parameters
    ----------
    real, simulated, holdout : sequence of path
        Drives; without simulated ones the nominal model is the simulation.
    vehicle_path : path or str
        A vehicle file, or the name of one of the library.
    output : path
        Folder to write into.
    held : sequence of str
        Inputs (T, delta) that keep their value between samples, whatever the files say.
    engine : Engine
        A cluster does self-tests, fits of the search and sizes of silent effects; the result is the same.
    progress, note : callable
        Called with the name of each step, and with what a reader should know of the inputs.
    """
    refuse_what_cannot_be_a_folder(output)
    with distributing_by(engine.map) if engine.carries_closures else contextlib.nullcontext():
        diagnosis, vehicle, drives, modelled = read_and_diagnose(
            real, vehicle_path, simulated=simulated, holdout=holdout, held=held, progress=progress, note=note
        )
    progress("writing")
    write_diagnosis(diagnosis, vehicle, output, drives, modelled)
    return diagnosis


def read_and_diagnose(
    real: Sequence[str | Path],
    vehicle_path: str | Path,
    *,
    simulated: Sequence[str | Path] = (),
    holdout: Sequence[str | Path] = (),
    held: Sequence[str] = (),
    progress: Callable[[str], None] = lambda step: None,
    note: Callable[[str], None] = lambda text: None,
) -> tuple[Diagnosis, Vehicle, Sequence[Drive], Sequence[Drive]]:
    """Return a diagnosis, the vehicle, the real and the simulated drives, writing nothing.

    Parameters are those of `diagnose_files`.

    Faults of sensors that the vehicle file names are taken off the real drives; a simulation has no sensors.
    """
    vehicle_path = vehicle_file(vehicle_path)
    vehicle = read_vehicle(vehicle_path)
    groups = {"real": real, "sim": simulated, "holdout": holdout}
    read, alike = with_inputs_alike([[read_drive(path, held) for path in paths] for paths in groups.values()])
    drives = dict(zip(groups, read, strict=True))
    given = [drive for several in read for drive in several]
    # A car that differs from its file is what is looked for: said at once, and not refused.
    warnings = vehicle_warnings(drives["real"], vehicle, any_vehicle=True)
    for text in (*warnings, *alike, *unstated_inputs(given), *_long(given)):
        note(text)
    inputs = [InputFile(one.name, one.sha256, role) for role, several in drives.items() for one in several]
    inputs.append(InputFile(vehicle_path.name, sha256_of_file(vehicle_path), "vehicle"))
    correct = RecordingCorrection(vehicle)
    measured, holdouts = ([correct.sensors(drive) for drive in drives[role]] for role in ("real", "holdout"))
    diagnosis = diagnose(measured, vehicle, drives["sim"], holdouts, inputs=inputs, progress=progress)
    return diagnosis, vehicle, drives["real"], drives["sim"]


def _long(drives: Sequence[Drive]) -> tuple[str, ...]:
    """Return what to say of drives that are long for a diagnosis, which holds all of them."""
    rows = sum(len(drive) for drive in drives)
    if rows <= _LONG:
        return ()
    minutes = sum(len(drive) * drive.period for drive in drives) / 60.0
    return (
        f"{rows} rows ({minutes:.3g} minutes) are diagnosed: over {_LONG} rows take more than 1 GB of memory, "
        "180000 at least 2 GB, and many minutes; `split ingest --start --end` makes a shorter drive",
    )


def corrected_vehicle(diagnosis: Diagnosis, vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with the findings of the car as effects, see `CorrectedVehicle.values` and `.further`."""
    judged = diagnosis.corrected_vehicle
    alone, further = ({}, ()) if judged is None else (judged.values, judged.further)
    effects = [
        EffectSpec(f.term, alone.get(f.term, {name: p.value for name, p in f.parameters.items()}), f.variant)
        for f in diagnosis.findings
        if f.exported
    ]
    return vehicle.with_effects(*effects, *further)


def write_diagnosis(
    diagnosis: Diagnosis,
    vehicle: Vehicle,
    output: str | Path,
    drives: Sequence[Drive] = (),
    simulated: Sequence[Drive] = (),
) -> None:
    """Write a diagnosis into a folder, all files or none; figures of an earlier one there are taken away."""
    from split_cli.plots.draw import CHARTS, write_charts

    corrected = corrected_vehicle(diagnosis, vehicle)
    charts = diagnosis_charts(diagnosis, vehicle, corrected, drives, simulated)
    earlier = [*VEHICLES, "figures/help.csv", *(f"figures/{name}.png" for name in CHARTS)]
    with atomic_directory(output, without=earlier) as folder:
        (folder / "diagnosis.json").write_text(diagnosis_to_text(diagnosis), encoding="utf-8")
        if (name := vehicle_name(diagnosis)) is not None:
            write_vehicle(corrected, folder / name, comment=f"{_judged(diagnosis)}{diagnosis.summary}")
        _write_gap(diagnosis, drives, vehicle, folder / "gap.parquet")
        (folder / "report.html").write_text(report_page(diagnosis, charts), encoding="utf-8")
        (folder / "figures").mkdir()
        write_charts(charts, folder / "figures")
        if diagnosis.improvement is not None:
            _write_help(diagnosis.improvement, folder / "figures" / "help.csv")
        with contextlib.suppress(OSError):
            (folder / "figures").rmdir()  # where nothing was drawn
        write_digests(folder)


def _judged(diagnosis: Diagnosis) -> str:
    """Return the comment at the head of the corrected vehicle file: whether it predicts held-out time better."""
    corrected = diagnosis.corrected_vehicle
    if corrected is None:
        return f"{_UNJUDGED} "
    if corrected.accepted:
        return ""
    return f"NOT ACCEPTED. {not_accepted(corrected)} "


def improvement_rows(improvement: Improvement) -> list[tuple[object, ...]]:
    """Return held-out errors as rows of `IMPROVEMENT_COLUMNS`; an interval that is not known is None.

    The first step has a horizon of 0.05 s and its error in label units.
    """
    steps = [(_ONE_STEP, improvement, LABEL_UNITS)]
    steps += [(one.horizon, one, STATE_UNITS) for one in improvement.rollouts]
    rows: list[tuple[object, ...]] = []
    for horizon, errors, units in steps:
        for stage in (*STAGES, "noise_floor"):
            values = getattr(errors, stage)
            intervals = errors.confidence.get(stage) or [(None, None)] * 3
            if values is not None:
                rows += [
                    (horizon, stage, channel, unit, value, *interval)
                    for channel, unit, value, interval in zip(CHANNELS, units, values, intervals, strict=True)
                ]
    return rows


def _write_help(improvement: Improvement, path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(IMPROVEMENT_COLUMNS)
        writer.writerows(improvement_rows(improvement))


def _write_gap(diagnosis: Diagnosis, drives: Sequence[Drive], vehicle: Vehicle, path: Path) -> None:
    """Write labels of the real drives against the nominal model, with the gap as forces at each."""
    import pyarrow as pa
    import pyarrow.parquet

    # As `split label` reads them: with s for effects of place.
    correct = RecordingCorrection(vehicle)
    pairs = zip(diagnosis.gaps, map(correct, drives), strict=False)
    tables = [_gap_table(gap, drive, vehicle) for gap, drive in pairs if len(gap.t) > 1]
    if not tables:
        names = ("t", "s", *(f"{kind}_{force}" for kind in ("gap", "remainder") for force in FORCES))
        columns = {name: pa.array([], pa.float64()) for name in names}
        tables = [pa.table({"drive": pa.array([], pa.string()), **columns})]
    pyarrow.parquet.write_table(pa.concat_tables(tables), path, compression="zstd", write_page_checksum=True)


def _gap_table(gap: GapSeries, drive: Drive, vehicle: Vehicle):
    import pyarrow as pa

    labels = compute_labels(drive, vehicle, Z2)
    # By time, since rows that were no recording may have been left out; the forces are averages over 0.2 s.
    after = np.clip(np.searchsorted(gap.t, labels.t), 1, max(len(gap.t) - 1, 1))
    row = np.where(labels.t - gap.t[after - 1] < gap.t[after] - labels.t, after - 1, after)
    meets = np.abs(gap.t[row] - labels.t) < _GAP_REACH
    row = row[meets]
    columns = {"drive": pa.array([gap.drive] * len(row), pa.string())}
    columns |= label_columns(labels.take(np.flatnonzero(meets)))
    columns["s"] = pa.array(gap.s[row])
    for k, force in enumerate(FORCES):
        columns[f"gap_{force}"] = pa.array(gap.forces[row, k])
        columns[f"remainder_{force}"] = pa.array(gap.remainder[row, k])
    return pa.table(columns)
