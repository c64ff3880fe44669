"""Known faults in real recordings as one table: a fixed list of faults, search and findings, right or wrong.

Examples: ``python -m tests.studies.recorded_faults DATASETS OUT --list first``; `--only` takes some of its pairs.
With ``--seed 1`` in place of a list, pairs and faults are drawn that nobody chose.

Every row is kept in ``OUT/rows.jsonl`` with the sizes that the clean pair promises; rows that are there are not
computed again. The lists stand in `recorded_faults_lists.py`; a list is fixed before its first row is run.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.statement.document import diagnosis_to_mapping
from split_cli.errors import SplitError
from split_cli.logs.assembling.assemble import IngestSettings
from split_cli.logs.drive import Drive, read_drive
from split_cli.proof.injection import InjectedFault, faults_for, faults_of_sizes, inject
from split_cli.proof.outcome import Statement, judge
from split_cli.proof.scoring import statement_of
from split_cli.vehicle.parameters import Vehicle, read_vehicle, vehicle_file
from split_cli.workflows.ingesting.ingest import ingest_logs
from tests.foreign.natural import (
    AUTORALLY_CAR,
    DART_CAR,
    KTH_CAR,
    RUBBER,
    SLIPPERY,
    TAPE,
    autorally_drive,
    dart_drive,
    kth_drive,
)
from tests.studies.changing_faults import CHANGING
from tests.studies.recorded_faults_lists import LISTS, FaultRow, drawn_list

Prepared = Callable[[Path, Path], Drive]


def _ingested(source: str, preset: str, *, derive: Sequence[str] = (), delays: bool = False) -> Prepared:
    def drive(datasets: Path, folder: Path) -> Drive:
        path = folder / f"{Path(source).stem}.parquet"
        if not path.exists():
            settings = IngestSettings(derive=tuple(derive), estimate_delays=delays)
            ingest_logs(
                [datasets / source], path, maps=[preset], vehicle_path=vehicle_file(_LIBRARY[preset]), settings=settings
            )
        return read_drive(path)

    return drive


_LIBRARY = {"tum_sim": "tum_sim", "genesis_slow": "genesis", "av21_lvms": "av21"}
DRIVES: dict[str, tuple[Prepared, Path | str]] = {
    "tum": (_ingested("tum_sim/data_to_run.csv", "tum_sim"), "tum_sim"),
    "tum second file": (_ingested("tum_sim/data_to_train_12.csv", "tum_sim"), "tum_sim"),
    "genesis": (
        _ingested("genesis_slow/cpg_slow_lap.mat", "genesis_slow", derive=["torque-from-acceleration"]),
        "genesis",
    ),
    "av21": (
        _ingested("av21_lvms/LVMS_23_01_04_B.csv", "av21_lvms", derive=["torque-from-throttle-and-brake"], delays=True),
        "av21",
    ),
    "rubber": (lambda datasets, folder: dart_drive(datasets, RUBBER, folder), DART_CAR),
    "tape": (lambda datasets, folder: dart_drive(datasets, TAPE, folder), DART_CAR),
    "slippery": (lambda datasets, folder: dart_drive(datasets, SLIPPERY, folder), DART_CAR),
    "free": (lambda datasets, folder: dart_drive(datasets, "free_driving", folder), DART_CAR),
    "race": (lambda datasets, folder: dart_drive(datasets, "racetrack_lap_v_1", folder), DART_CAR),
    "steering": (lambda datasets, folder: dart_drive(datasets, "steer_id", folder), DART_CAR),
    "kth": (lambda datasets, folder: kth_drive(datasets, "038", folder), KTH_CAR),
    "kth step": (lambda datasets, folder: kth_drive(datasets, "040", folder), KTH_CAR),
    "autorally 5": (lambda datasets, folder: autorally_drive(datasets, 5, folder), AUTORALLY_CAR),
    "autorally 6": (lambda datasets, folder: autorally_drive(datasets, 6, folder), AUTORALLY_CAR),
}
"""By name, how a recording is prepared, and its vehicle file."""
AGAINST = "against "
"""Begins a split in which another recording, named after it, stands for the simulation."""


def dealt(drive: Drive, split: str) -> tuple[Drive, Drive]:
    """Return the part of a drive that stands for the simulation, and the part that gets the fault.

    Parameters
    ----------
    drive : Drive
    split : str
        ``halves`` in time; ``thirds``, the first and the last; or ``blocks`` of 10 s, or of another length as in
        ``blocks 6``, dealt in turn; ``swapped`` before any of them exchanges the two.
    """
    if split.startswith("swapped "):
        real, simulated = dealt(drive, split.removeprefix("swapped "))
        return simulated, real
    t = drive["t"] - drive["t"][0]
    if split in ("halves", "thirds"):
        parts = 2 if split == "halves" else 3
        return drive.select(t < t[-1] / parts), drive.select(t >= t[-1] * (1.0 - 1.0 / parts))
    length = float(split.removeprefix("blocks").strip() or 10.0)
    even = np.floor(t / length).astype(int) % 2 == 0
    return drive.select(even), drive.select(~even)


@dataclass(frozen=True)
class Told:
    """What became of one row; `promised` by term and parameter joined with a colon.

    `values` are the sizes put in, and `inside` tells of each fault that was named whether its interval holds it.
    """

    pair: str
    fault: str
    multiple: float | None
    values: tuple[float, ...]
    outcome: str
    said: str
    inside: tuple[bool, ...]
    seconds: float
    history: tuple[str, ...]
    summary: str
    promised: dict[str, float]


class Study:
    """Rows of one list, each computed once and kept in a file."""

    def __init__(self, datasets: Path, folder: Path) -> None:
        self.datasets, self.folder, self.path = datasets, folder, folder / "rows.jsonl"
        folder.mkdir(parents=True, exist_ok=True)
        lines = self.path.read_text(encoding="utf-8").splitlines() if self.path.exists() else []
        self.rows = [Told(**json.loads(line)) for line in lines]

    def row(self, row: FaultRow) -> Told:
        """Return a row, from the file or computed now."""
        for one in self.rows:
            if (one.pair, one.fault, one.multiple) == (row.pair, row.fault, row.multiple) and (
                row.value is None or [*one.values] == [row.value]
            ):
                return one
        told = self._computed(row)
        self.rows.append(told)
        with self.path.open("a", encoding="utf-8") as out:
            out.write(json.dumps(asdict(told)) + "\n")
        return told

    def _computed(self, row: FaultRow) -> Told:
        name, split = row.pair.split(", ")
        other = split.removeprefix(AGAINST) if split.startswith(AGAINST) else ""
        prepare, file = DRIVES[name]
        drive, vehicle = prepare(self.datasets, self.folder), read_vehicle(vehicle_file(file))
        faults = self._faults(row, drive, vehicle)
        empty = Told(row.pair, row.fault, row.multiple, (), "not put in", "", (), 0.0, (), "", {})
        if faults is None:
            return replace(empty, said="nothing is promised")
        faulty = drive
        try:
            for fault in faults:
                changing = CHANGING.get(fault.name)
                faulty = changing.put(faulty, fault.value, vehicle) if changing else inject(faulty, fault, vehicle)
        except SplitError as error:
            return replace(empty, said=str(error))
        begun = time.process_time()
        if other:
            simulated, real = DRIVES[other][0](self.datasets, self.folder), faulty
        else:
            simulated, real = dealt(drive, split)[0], dealt(faulty, split)[1]
        told = diagnose([real], vehicle, [simulated])
        mapping = diagnosis_to_mapping(told)
        return Told(
            pair=row.pair,
            fault=row.fault,
            multiple=row.multiple,
            values=tuple(fault.value for fault in faults),
            outcome=_outcome(faults, statement_of(mapping)),
            said=in_words(mapping),
            inside=tuple(
                bool(interval[0] <= fault.value <= interval[1])
                for fault in faults
                for interval in _of_the_true(mapping, fault)
            ),
            seconds=time.process_time() - begun,
            history=told.history,
            summary=told.summary,
            promised={
                f"{one['term']}:{key}": each["value"]
                for one in mapping["detectable"]
                for key, each in one["parameters"].items()
                if each["value"] is not None
            },
        )

    def _faults(self, row: FaultRow, drive: Drive, vehicle: Vehicle) -> list[InjectedFault] | None:
        """Return the faults of a row, none for a clean pair; None if one of them cannot be put in."""
        if row.fault == "none":
            return []
        found, parts = [], row.fault.split(" + ")
        for one in parts:
            name, _, size = one.partition("=")
            value = float(size) if size else row.value
            changing = CHANGING.get(name)
            if changing:
                kinds = [InjectedFault(name, changing.term, ((changing.parameter, np.nan),))]
            else:
                kinds = faults_for(drive, vehicle, [name])[1:2]
            if value is not None:
                kinds = [replace(one, parameters=tuple((each, value) for each, _ in one.parameters)) for one in kinds]
            else:
                beside = self.row(FaultRow(row.pair, " + ".join(each for each in parts if "=" in each) or "none"))
                promised = {tuple(key.split(":")): least for key, least in beside.promised.items()}
                kinds = faults_of_sizes(kinds, promised, [row.multiple])
            if not kinds:
                return None
            found += kinds
        return found


def _outcome(faults: Sequence[InjectedFault], said: Statement) -> str:
    """Return how a statement fares. A fault that changes has a term's name, or is rightly called unexplained."""
    outcome = judge([fault.term for fault in faults if fault.term], said)
    changing = any(fault.name in CHANGING for fault in faults)
    return outcome if outcome in ("exact", "class") and said.findings or not changing else judge([""], said)


def _of_the_true(mapping: dict[str, Any], fault: InjectedFault) -> list[tuple[float, float]]:
    return [
        tuple(finding["parameters"][fault.parameters[0][0]]["interval_95"])
        for finding in mapping["findings"]
        if fault.term == finding["term"] and fault.parameters[0][0] in finding["parameters"]
    ]


def in_words(mapping: dict[str, Any]) -> str:
    """Return verdict, names with values and alternatives, and whether more is unexplained."""
    p = mapping["p_value"]
    words = [mapping["verdict"] + ("" if p is None else f", p = {p:.1g}")]
    for one in mapping["findings"]:
        values = ", ".join(
            f"{name} {each['value']:.3g} ({each['interval_95'][0]:.3g} to {each['interval_95'][1]:.3g})"
            for name, each in one["parameters"].items()
        )
        others = f", or {', '.join(one['alternatives'])}" if one["alternatives"] else ""
        words.append(f"{one['term']} {values}{others}")
    if mapping["unexplained"]:
        words.append("more is unexplained")
    words += [f"lead {one['term']}: {one['sentence']}" for one in mapping["leads"]]
    return "; ".join(words)


def main() -> None:
    """Run what is not there yet of a list, and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("datasets", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--list", choices=sorted(LISTS), default="first")
    parser.add_argument("--seed", type=int, help="of pairs and faults that are drawn, in place of a list")
    parser.add_argument("--pairs", type=int, default=12, help="how many pairs are drawn (default: 12)")
    parser.add_argument("--only", nargs="*", help="pairs, such as 'tum, blocks'")
    parser.add_argument("--faults", nargs="*")
    arguments = parser.parse_args()
    study, told = Study(arguments.datasets, arguments.out), []
    drawn = None if arguments.seed is None else drawn_list(arguments.seed, arguments.pairs, [*DRIVES])
    for row in LISTS[arguments.list] if drawn is None else drawn:
        wanted = not arguments.only or row.pair in arguments.only
        if wanted and (not arguments.faults or row.fault in arguments.faults):
            told.append(one := study.row(row))
            size = "".join(f" {value:.4g}" for value in one.values)
            print(f"| {one.pair} | {one.fault}{size} | {one.outcome} | {one.said} | {one.seconds:.0f} s |", flush=True)
    for outcome in dict.fromkeys(one.outcome for one in told):
        count = sum(one.outcome == outcome for one in told)
        print(f"{outcome}: {count} of {len(told)}")
    inside = [each for one in told for each in one.inside]
    print(f"intervals that hold the truth: {sum(inside)} of {len(inside)}")


if __name__ == "__main__":
    main()
