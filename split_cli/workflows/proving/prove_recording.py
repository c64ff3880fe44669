"""Known faults in real recordings: put in, diagnosed on top of everything else that is real, and compared."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from split_cli.diagnosis.statement.document import diagnosis_to_mapping
from split_cli.errors import SplitError
from split_cli.logs.drive import Drive, read_drive, write_drive
from split_cli.proof.injection import (
    InjectedFault,
    faults_for,
    faults_of_sizes,
    inject,
    split_in_blocks,
    split_in_halves,
)
from split_cli.proof.outcome import Statement, judge
from split_cli.proof.scoring import in_short, statement_of
from split_cli.vehicle.parameters import Vehicle, read_vehicle, write_vehicle
from split_cli.workflows.diagnose import diagnose_files


@dataclass(frozen=True)
class InjectionResult:
    """What became of one fault."""

    drive: str
    fault: str
    term: str  # that names it
    value: float | None  # what was put in; None for the pair without a fault
    # Of `proof.outcome.OUTCOMES`, or ``not put in`` where the car with the fault could not have made the drive.
    outcome: str
    said: str
    found: float | None  # the named parameter
    interval: str  # its 95 % interval


def prove_recording(
    drives: Sequence[str | Path],
    vehicle_path: str | Path,
    output: Path,
    *,
    only: Sequence[str] | None = None,
    block: float = 10.0,
    halves: bool = False,
    multiples: Sequence[float] = (),
    count: Callable[[int, int], None] = lambda done, total: None,
) -> list[InjectionResult]:
    """Put faults into drives and diagnose each.

    Parameters
    ----------
    drives : sequence of path
        Drives that `split ingest` wrote.
    output : Path
        Folder; gets the pairs of drives and a diagnosis each.
    only : sequence of str, optional
        Names of `injection.FAULTS`.
    block : float
        Length of the blocks of time that are dealt in turn to reference and fault [s].
    halves : bool
        Deal the first half of the time to the reference and the second to the fault instead.
    multiples : sequence of float
        Sizes of the faults as multiples of what the pair without a fault promises to name; else three fixed ones.
    """
    vehicle = read_vehicle(vehicle_path)
    length = None if halves else block
    planned = []
    for path in map(Path, drives):
        drive = read_drive(path)
        _deal(drive, length)  # one that is too short is refused before anything is written
        planned.append((path, *faults_for(drive, vehicle, only)))
    output.mkdir(parents=True, exist_ok=True)
    # The vehicle may be one of the library's names; every pair is diagnosed with one file.
    write_vehicle(vehicle, output / "vehicle.yaml")
    results = []
    for path, clean, *faults in planned:
        done = len(results)
        results.append(_one(path, clean, vehicle, done, output, length))
        if multiples:
            faults = faults_of_sizes(faults, _promised(output / f"{done + 1:03d}"), multiples)
        for number, fault in enumerate(faults, start=1):
            results.append(_one(path, fault, vehicle, done + number, output, length))
            count(number, len(faults))
    return results


def _promised(folder: Path) -> Mapping[tuple[str, str], float]:
    """Return the sizes that a diagnosis promises to name, by term and parameter."""
    path = folder / "diagnosis" / "diagnosis.json"
    document = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"detectable": []}
    values = {
        (one["term"], name): each["value"] for one in document["detectable"] for name, each in one["parameters"].items()
    }
    return {key: value for key, value in values.items() if value is not None}


def _one(
    path: Path, fault: InjectedFault, vehicle: Vehicle, number: int, output: Path, block: float | None
) -> InjectionResult:
    drive = read_drive(path)
    try:
        faulty = inject(drive, fault, vehicle)
    except SplitError as error:
        return InjectionResult(path.name, fault.name, fault.term, fault.value, "not put in", str(error), None, "")
    reference, faulted = _deal(drive, block)[0], _deal(faulty, block)[1]
    said, words = diagnose_pair(output / f"{number + 1:03d}", output / "vehicle.yaml", reference, faulted)
    return injection_result(path.name, fault.name, fault.term, fault.parameters, said, words)


def _deal(drive: Drive, block: float | None) -> tuple[Drive, Drive]:
    return split_in_halves(drive) if block is None else split_in_blocks(drive, block)


def diagnose_pair(folder: Path, vehicle_path: Path, reference: Drive, faulted: Drive) -> tuple[Statement, str]:
    """Write two drives into a folder, diagnose the second by the first, and return what is said, also in words."""
    folder.mkdir(parents=True, exist_ok=True)
    write_drive(replace(reference, name="sim.parquet"), folder / "sim.parquet")
    write_drive(replace(faulted, name="real.parquet"), folder / "real.parquet")
    try:
        document = diagnosis_to_mapping(
            diagnose_files(
                [folder / "real.parquet"], vehicle_path, folder / "diagnosis", simulated=[folder / "sim.parquet"]
            )
        )
    except SplitError as error:
        return Statement("undecided"), f"error: {error}"
    except Exception as error:
        # A fault of the diagnosis is a result too; the other faults are still tried.
        return Statement("undecided"), f"failed: {type(error).__name__}: {error}"
    said = statement_of(document)
    return said, in_short(said)


def injection_result(
    drive: str,
    fault: str,
    term: str,
    parameters: Sequence[tuple[str, float]],
    said: Statement,
    words: str,
    *,
    in_catalogue: bool = True,
) -> InjectionResult:
    """Return what became of a fault; the first of its parameters that was found is reported.

    Where the catalogue has no name for it (`in_catalogue` is false) it is its own truth.
    """
    truth = [term] if term else [] if in_catalogue else [fault]
    finding = next((f for f in said.findings if f.term == term), None)
    value, low, high = next(
        (finding.parameters[name] for name, _ in parameters if finding and name in finding.parameters),
        (None, None, None),
    )
    return InjectionResult(
        drive=drive,
        fault=fault,
        term=term,
        value=parameters[0][1] if parameters else None,
        outcome=judge(truth, said, in_catalogue=in_catalogue),
        said=words,
        found=value,
        interval="" if low is None else f"{low:.4g} to {high:.4g}",
    )
