"""`split calibrate`: a vehicle file from gentle drives, or from another project's parameter file."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import yaml

from split_cli.errors import DriveError, SplitError
from split_cli.files import atomic_path, refuse_overwriting_inputs
from split_cli.logs.drive import Drive, read_drive
from split_cli.scoring.splits import hold_out_blocks
from split_cli.vehicle.calibration.calibrate import ACROSS, ALONG, Calibration, CalibrationSettings, calibrate_vehicle
from split_cli.vehicle.calibration.samples import MotionRun
from split_cli.vehicle.converters import Conversion, convert_parameters
from split_cli.vehicle.parameter_export import ForeignParameters, foreign_parameters
from split_cli.vehicle.parameters import read_vehicle, write_vehicle


@dataclass(frozen=True)
class DriveUse:
    """How much of a drive the calibration used."""

    name: str
    sha256: str
    seconds: float  # of what was used [s]


def calibrate_files(
    drives: Sequence[str | Path],
    start: str | Path,
    output: str | Path | None,
    settings: CalibrationSettings | None = None,
    *,
    training_blocks: bool = False,
    measured_lateral_acceleration: bool = False,
    only_what_can_be_fitted: bool = False,
) -> tuple[Calibration, tuple[DriveUse, ...]]:
    """Calibrate a vehicle file from drives and write it.

    Parameters
    ----------
    start : path
        Vehicle file (or name in the library) with mass, geometry and inertia.
    output : path or None
        Vehicle YAML to write; None writes nothing.
    training_blocks : bool
        Leave out the blocks of time (and their guards) that `split evaluate` holds out by default, so that an
        evaluation on the same drives stays clean.
    measured_lateral_acceleration : bool
        Take the channel ``ay`` in place of v_y' + v_x r: right on a banked road.
    only_what_can_be_fitted : bool
        Leave drag and rolling resistance out, with a note, where all torques were derived with those of the file.

    Raises
    ------
    SplitError
        If a file cannot be read or too little of the drives can be used.
    """
    settings = settings or CalibrationSettings()
    if output is not None:
        refuse_overwriting_inputs(drives, output)
    vehicle = read_vehicle(start)
    runs, used, silent = [], [], []
    for path in drives:
        drive = read_drive(path)
        found = motion_runs(drive, training_blocks, measured_lateral_acceleration)
        runs += found
        used.append(DriveUse(drive.name, drive.sha256, sum(len(run.vx) * run.period for run in found)))
        silent.append((drive.name, _silent_parts(drive)))
    settings, notes = _what_can_be_fitted(settings, silent, only_what_can_be_fitted)
    calibration = calibrate_vehicle(runs, vehicle, settings)
    calibration = replace(calibration, notes=(*notes, *calibration.notes))
    if output is not None:
        write_vehicle(calibration.vehicle, output, comment=_provenance(used, settings, training_blocks))
    return calibration, tuple(used)


def _silent_parts(drive: Drive) -> frozenset[str]:
    """Return of which parts a drive says nothing, since a channel was derived with those of the vehicle file."""
    across = ACROSS if drive.metadata.sideslip_is_of_tires else ()
    return frozenset((*across, *(ALONG if drive.metadata.torque_follows_motion else ())))


def _what_can_be_fitted(
    settings: CalibrationSettings, silent: Sequence[tuple[str, frozenset[str]]], give_up_resistance: bool
) -> tuple[CalibrationSettings, tuple[str, ...]]:
    """Return the settings without parts of which no drive says anything, and notes on drives left out for a part.

    Raises
    ------
    DriveError
        If no drive says anything of a group of parts. Drag and rolling resistance may be given up instead, where
        something else is asked for.
    """
    notes: list[str] = []
    for group, what, why, advice in (
        (
            ACROSS,
            "tyres are fitted without {names}",
            "r and v_y were derived with the rear tyres of the vehicle file; they cannot determine tyres",
            "Take a drive with a gyro or a heading, and a recorded or integrated v_y.",
        ),
        (
            ALONG,
            "drag and rolling resistance are fitted without {names}",
            "the torque was derived from the motion with drag and rolling resistance of the vehicle file, or the "
            "drive does not say from what; it cannot determine them",
            "Calibrate the tyres alone: --fit tires.",
        ),
    ):
        without = [name for name, parts in silent if parts & set(group)]
        if not without or not set(group) & set(settings.parts):
            continue
        names = ", ".join(sorted(without))
        if len(without) < len(silent):
            notes.append(f"{what.format(names=names)}: {why}")
        elif group is ALONG and give_up_resistance and "tires" in settings.parts:
            settings = replace(settings, parts=tuple(part for part in settings.parts if part not in ALONG))
            why = f"the torque of {names} was derived with those of the vehicle file"
            notes.append(f"drag and rolling resistance are not fitted: {why}")
        else:
            raise DriveError(why, where=names, advice=advice)
    return settings, tuple(notes)


def motion_runs(
    drive: Drive, training_blocks: bool = False, measured_lateral_acceleration: bool = False
) -> list[MotionRun]:
    """Return a drive's stretches without a gap, all of it or its training blocks.

    Raises
    ------
    DriveError
        If the measured lateral acceleration is asked for and not there.
    """
    if measured_lateral_acceleration and "ay" not in drive:
        raise DriveError("has no channel ay", where=drive.name, advice="Leave out --measured-ay.")
    if training_blocks:
        drive = drive.select(hold_out_blocks(drive).train)
    runs = []
    for rows in drive.segments():
        columns = {name: drive[name][rows] for name in ("vx", "vy", "r", "T", "delta")}
        ay = drive["ay"][rows] if measured_lateral_acceleration else None
        runs.append(MotionRun(drive.period, **columns, ay=ay, silent=_silent_parts(drive)))
    return runs


def _provenance(used: Sequence[DriveUse], settings: CalibrationSettings, training_blocks: bool) -> str:
    options = f"--fit {','.join(settings.parts)}"
    options += " --offsets" * settings.offsets + " --training-blocks" * training_blocks
    lines = [f"Calibrated by `split calibrate {options}` from"]
    lines += [f"  {use.name} ({use.seconds:.0f} s, sha256 {use.sha256[:16]})" for use in used]
    if training_blocks:
        lines.append("without the blocks of time that `split evaluate` holds out.")
    return "\n".join(lines)


def convert_files(sources: Sequence[str | Path], output: str | Path, *, alpha_max: float = 0.18) -> Conversion:
    """Convert another project's parameter file, or files that belong together, to a vehicle file.

    Raises
    ------
    SplitError
        If the files cannot be read or are of no known kind.
    """
    if not sources:
        raise SplitError("no parameter file was named", advice="Name the CommonRoad, F1TENTH or ForzaETH file.")
    refuse_overwriting_inputs(sources, output)
    conversion = convert_parameters(sources, alpha_max=alpha_max)
    names = ", ".join(Path(source).name for source in sources)
    write_vehicle(conversion.vehicle, output, comment=f"Converted by `split calibrate --convert` from {names}.")
    return conversion


def write_foreign(source: str | Path, output: str | Path, kind: str, *, alpha_max: float = 0.18) -> ForeignParameters:
    """Write a vehicle file as another project's parameters, YAML.

    Raises
    ------
    SplitError
        If the vehicle file cannot be read or the format is not known.
    """
    refuse_overwriting_inputs([source], output)
    written = foreign_parameters(read_vehicle(source), kind, alpha_max)
    with atomic_path(output) as temporary:
        temporary.write_text(yaml.safe_dump(written.content, sort_keys=False), encoding="utf-8")
    return written
