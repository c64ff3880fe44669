"""Kill commands at random moments; see that the old or the new output is there, whole, and nothing stray stays.

Example: ``python -m tests.studies.kill --kills 200 --seed 1``. Prints a row a command: kills, how often the old
and how often the new output was found, and what broke a rule; exits with 1 if anything did.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from split_cli.logs.drive import write_drive
from split_cli.vehicle.parameters import write_vehicle
from tests.factories import MissingForce, make_drive, road_car


@dataclass(frozen=True)
class Case:
    """One command, run in a folder that holds its inputs and an old output.

    Attributes
    ----------
    name : str
    arguments : tuple of str
    output : str
        File or folder the command writes.
    """

    name: str
    arguments: tuple[str, ...]
    output: str


@dataclass
class Outcome:
    """What was found after the kills of one command."""

    kills: int = 0
    old: int = 0
    new: int = 0
    broken: list[str] = field(default_factory=list)


RACE = ("race", "--vehicle", "road_car.yaml", "--laps", "1", "--max-speed", "11", "-o", "race.parquet")
CASES = (
    Case("ingest", ("ingest", "lap.csv", "-o", "lap.parquet", "--rate", "40"), "lap.parquet"),
    Case("ingest folder", ("ingest", "archive", "-o", "drives", "--rate", "40"), "drives"),
    Case("train", ("train", "d0.parquet", "--vehicle", "car.yaml", "-o", "a.split", "--capacity", "5"), "a.split"),
    Case("append", ("train", "d1.parquet", "--vehicle", "car.yaml", "-o", "b.split", "--append"), "b.split"),
    Case(
        "diagnose",
        ("diagnose", "--real", "d1.parquet", "--vehicle", "car.yaml", "--out", "diagnosis"),
        "diagnosis",
    ),
    Case("race", RACE, "race.parquet"),
    Case("export", ("export", "new.split", "--target", "json", "-o", "export"), "export"),
)


def run(folder: Path, arguments: Sequence[str]) -> subprocess.Popen:
    """Start one command in a folder."""
    return subprocess.Popen(
        [sys.executable, "-m", "split_cli", *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def prepare(folder: Path, names: Collection[str]) -> None:
    """Write inputs, and an old output of every case of `names`."""
    from split_cli.workflows.simulate import SimulateSettings, simulate_log

    car = road_car()
    write_vehicle(car, folder / "car.yaml")
    shutil.copy(Path(__file__).parents[2] / "sample_logs" / "road_car.yaml", folder)
    for seed in range(2):
        terms = [MissingForce({"front_lateral": 150.0})]
        drive = make_drive(seed, segments=10, seconds=3.0, vehicle=car, terms=terms, name=f"d{seed}.parquet")
        write_drive(drive, folder / drive.name)
    (folder / "archive").mkdir()
    for seed in range(3):
        simulate_log(SimulateSettings(track="small", duration=6.0, seed=seed), folder / "archive" / f"{seed}.csv")
    shutil.copy(folder / "archive" / "0.csv", folder / "lap.csv")
    train = ("train", "d0.parquet", "--vehicle", "car.yaml", "-o")
    old = (
        ("ingest", "lap.csv", "-o", "lap.parquet"),
        ("ingest", "archive", "-o", "drives"),
        (*train, "a.split"),
        (*train, "b.split"),
        (*train, "new.split", "--capacity", "6"),
        ("export", "a.split", "--target", "json", "-o", "export"),
        *(
            (("diagnose", "--real", "d0.parquet", "--vehicle", "car.yaml", "--out", "diagnosis"),)
            if "diagnose" in names
            else ()
        ),
        *(((*RACE, "--seed", "2"),) if "race" in names else ()),
    )
    for arguments in old:
        if run(folder, arguments).wait() != 0:
            raise RuntimeError(f"could not prepare: split {' '.join(arguments)}")


def state(path: Path) -> str:
    """Return a digest of a file, or of all files of a folder with their names."""
    digest = hashlib.sha256()
    for file in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
        digest.update(f"{file.relative_to(path.parent)}\0".encode() + file.read_bytes())
    return digest.hexdigest()


def try_case(case: Case, ready: Path, kills: int, rng: random.Random) -> Outcome:
    """Kill one command at random moments of its duration."""
    outcome = Outcome()
    with tempfile.TemporaryDirectory() as name:
        whole = Path(name) / "whole"
        shutil.copytree(ready, whole)
        old = state(whole / case.output)
        begin = time.perf_counter()
        if run(whole, case.arguments).wait() != 0:
            outcome.broken.append("the command fails when it is left alone")
            return outcome
        duration, new = time.perf_counter() - begin, state(whole / case.output)
        if new == old:
            outcome.broken.append("old and new output cannot be told apart")
        inputs = {p.name for p in ready.iterdir()} | {case.output}
        for _ in range(kills):
            folder = Path(name) / "run"
            shutil.copytree(ready, folder)
            process = run(folder, case.arguments)
            # Most of a run is imports: three quarters of the kills fall into its last third, which writes.
            moment = duration * (rng.uniform(0.66, 1.02) if rng.random() < 0.75 else rng.uniform(0.0, 0.66))
            try:
                process.wait(moment)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
            outcome.kills += 1
            found = state(folder / case.output)
            outcome.old += found == old
            outcome.new += found == new
            if found not in (old, new):
                outcome.broken.append(f"after {moment:.3f} s the output is neither the old nor the new one")
            if outcome.kills % 8 == 0 and found == old:
                if run(folder, case.arguments).wait() != 0 or state(folder / case.output) != new:
                    outcome.broken.append("the next run does not give the new output")
                stray = {p.name for p in folder.iterdir()} - inputs
                if stray:
                    outcome.broken.append(f"left behind after the next run: {', '.join(sorted(stray))}")
            shutil.rmtree(folder)
    return outcome


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200, help="over all commands")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="commands whose name holds this")
    given = parser.parse_args()
    cases = [case for case in CASES if given.only in case.name]
    broken = 0
    with tempfile.TemporaryDirectory() as name:
        ready = Path(name) / "ready"
        ready.mkdir()
        prepare(ready, {case.name for case in cases})
        print(f"{'command':14} {'kills':>6} {'old':>6} {'new':>6} {'broken':>7}")
        for case in cases:
            rng = random.Random(f"{given.seed} {case.name}")
            outcome = try_case(case, ready, given.kills // len(cases), rng)
            broken += len(outcome.broken)
            counts = f"{outcome.kills:6} {outcome.old:6} {outcome.new:6} {len(outcome.broken):7}"
            print(f"{case.name:14} {counts}", flush=True)
            for line in outcome.broken:
                print(f"  {line}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
