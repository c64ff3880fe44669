"""Diagnose a simulation against reality and write what was found."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from split_cli.diagnosis.document import diagnosis_to_text
from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.result import Diagnosis, Improvement, InputFile
from split_cli.files import atomic_directory, refuse_what_cannot_be_written, sha256_of_file
from split_cli.logs.drive import read_drive
from split_cli.vehicle.parameters import EffectSpec, Vehicle, read_vehicle, vehicle_file, write_vehicle
from split_cli.workflows.report.page import report_page

__all__ = ["FIGURES", "STAGES", "corrected_vehicle", "diagnose_files", "read_and_diagnose", "write_diagnosis"]

#: What may lie in the folder ``figures``.
FIGURES = frozenset({"where.png", "what.png", "help.png", "help.csv"})
#: Models compared on held-out time, as `Improvement` and `HorizonErrors` name them.
STAGES = ("before", "physics", "split_only", "after", "persistence")
CHANNELS, LABEL_UNITS, STATE_UNITS = ("v_x", "v_y", "r"), ("m/s^2", "m/s^2", "rad/s^2"), ("m/s", "m/s", "rad/s")
_ONE_STEP = 0.05


def diagnose_files(
    real: Sequence[str | Path],
    vehicle_path: str | Path,
    output: str | Path,
    *,
    simulated: Sequence[str | Path] = (),
    holdout: Sequence[str | Path] = (),
    progress: Callable[[str], None] = lambda step: None,
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
    progress : callable
        Called with the name of each step.
    """
    if not Path(output).is_dir():
        refuse_what_cannot_be_written(output)
    diagnosis, vehicle = read_and_diagnose(
        real, vehicle_path, simulated=simulated, holdout=holdout, progress=progress
    )
    progress("writing")
    write_diagnosis(diagnosis, vehicle, output)
    return diagnosis


def read_and_diagnose(
    real: Sequence[str | Path],
    vehicle_path: str | Path,
    *,
    simulated: Sequence[str | Path] = (),
    holdout: Sequence[str | Path] = (),
    progress: Callable[[str], None] = lambda step: None,
) -> tuple[Diagnosis, Vehicle]:
    """Diagnose recordings without writing anything; parameters as for `diagnose_files`."""
    vehicle_path = vehicle_file(vehicle_path)
    vehicle = read_vehicle(vehicle_path)
    groups = {"real": real, "sim": simulated, "holdout": holdout}
    drives = {role: [read_drive(path) for path in paths] for role, paths in groups.items()}
    inputs = [InputFile(one.name, one.sha256, role) for role, several in drives.items() for one in several]
    inputs.append(InputFile(vehicle_path.name, sha256_of_file(vehicle_path), "vehicle"))
    told = diagnose(drives["real"], vehicle, drives["sim"], drives["holdout"], inputs=inputs, progress=progress)
    return told, vehicle


def corrected_vehicle(diagnosis: Diagnosis, vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with the findings that belong to the car as effects."""
    effects = [
        EffectSpec(f.term, {name: p.value for name, p in f.parameters.items()}, f.variant)
        for f in diagnosis.findings
        if f.exported
    ]
    return vehicle.with_effects(*effects)


def write_diagnosis(diagnosis: Diagnosis, vehicle: Vehicle, output: str | Path) -> None:
    """Write a diagnosis into a folder, all files or none; figures of an earlier one there are taken away."""
    from split_cli.plots.diagnosis import diagnosis_figures
    from split_cli.plots.style import save

    comment = diagnosis.summary or "No terms were added."
    produced = set()
    with atomic_directory(output) as folder:
        (folder / "diagnosis.json").write_text(diagnosis_to_text(diagnosis), encoding="utf-8")
        write_vehicle(corrected_vehicle(diagnosis, vehicle), folder / "vehicle_corrected.yaml", comment=comment)
        _write_gap(diagnosis, folder / "gap.parquet")
        (folder / "report.html").write_text(report_page(diagnosis), encoding="utf-8")
        (folder / "figures").mkdir()
        for name, figure in diagnosis_figures(diagnosis):
            save(figure, folder / "figures" / f"{name}.png")
            produced.add(f"{name}.png")
        if diagnosis.improvement is not None:
            _write_help(diagnosis.improvement, folder / "figures" / "help.csv")
            produced.add("help.csv")
        if not produced:
            (folder / "figures").rmdir()
    for name in FIGURES - produced:
        (Path(output) / "figures" / name).unlink(missing_ok=True)


def _write_help(improvement: Improvement, path: Path) -> None:
    """Write held-out errors as a table; the first step has a horizon of 0.05 s and its error in label units."""
    steps = [(_ONE_STEP, improvement, LABEL_UNITS)]
    steps += [(one.horizon, one, STATE_UNITS) for one in improvement.rollouts]
    rows = []
    for horizon, errors, units in steps:
        for stage in (*STAGES, "noise_floor"):
            values = getattr(errors, stage)
            intervals = errors.confidence.get(stage) or [("", "")] * 3
            if values is not None:
                rows += [
                    (horizon, stage, channel, unit, value, *interval)
                    for channel, unit, value, interval in zip(CHANNELS, units, values, intervals, strict=True)
                ]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("horizon_s", "stage", "channel", "unit", "rmse", "low_95", "high_95"))
        writer.writerows(rows)


def _write_gap(diagnosis: Diagnosis, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    empty = np.empty(0)
    gaps = diagnosis.gaps

    def joined(pick: Callable) -> np.ndarray:
        return np.concatenate([pick(gap) for gap in gaps]) if gaps else empty

    names = [gap.drive for gap in gaps for _ in gap.t]
    columns = {"drive": pa.array(names, pa.string())}
    for name in ("t", "row", "s"):
        columns[name] = pa.array(joined(lambda gap, name=name: getattr(gap, name)))
    for k, force in enumerate(("longitudinal", "front_lateral", "rear_lateral")):
        columns[f"gap_{force}"] = pa.array(joined(lambda gap, k=k: gap.forces[:, k]))
        columns[f"remainder_{force}"] = pa.array(joined(lambda gap, k=k: gap.remainder[:, k]))
    pyarrow.parquet.write_table(pa.table(columns), path, compression="zstd")
