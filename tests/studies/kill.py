"""Kill commands; see that the old or the new output is there, whole, and nothing stray stays after the next run.

Example: ``python -m tests.studies.kill --kills 200 --seed 1`` kills at random moments, ``--steps`` before every
step that a command takes on the disk. Prints a row a command: kills, how often the old and the new output was
found, and what broke a rule; exits with 1 if anything did.
"""

import argparse
import hashlib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from split_cli.errors import SplitError
from split_cli.logs.drive import write_drive
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.verifying.verify import verify
from tests.factories import MissingForce, make_drive, road_car
from tests.studies.snapshots import leftovers_of_kills


@dataclass(frozen=True)
class Killed:
    """One command, run in a folder that holds its inputs and an old output.

    Attributes
    ----------
    name : str
    arguments : tuple of str
    outputs : tuple of str
        Files or folders the command writes, each whole or not at all.
    written_twice : tuple of str
        Outputs that the command writes several times, each time whole: a race keeps its set after each lap.
    repeats : bool
        Whether two runs write the same bytes. A page that tells times of computing does not repeat, and a set to
        which a drive is appended twice has learned it twice.
    """

    name: str
    arguments: tuple[str, ...]
    outputs: tuple[str, ...]
    repeats: bool = True
    written_twice: tuple[str, ...] = ()

    def state(self, folder: Path) -> tuple[str, ...]:
        """Return a digest of each output."""
        return tuple(state(folder / output) for output in self.outputs)


@dataclass
class KillOutcome:
    """What was found after the kills of one command."""

    kills: int = 0
    old: int = 0
    new: int = 0
    broken: list[str] = field(default_factory=list)


# A model car's lap needs a fourth of the steps of a road car's.
RACE = tuple(
    """
    race --vehicle f1tenth_car.yaml --car f1tenth_car --track f1tenth --max-speed 4 --laps 1 --report race.html --set
    race.split -o race.parquet
    """.split()
)
MANEUVER = ("maneuver", "brake-avoid", "--vehicle", "road_car.yaml", "--set", "turn.split", "-o", "turn.parquet")
EXPORT = ("export", "--target", "json", "--queries", "200", "-o", "export")
CASES = (
    Killed("ingest", ("ingest", "lap.csv", "-o", "lap.parquet", "--rate", "40"), ("lap.parquet",)),
    Killed("ingest folder", ("ingest", "archive", "-o", "drives", "--rate", "40"), ("drives",)),
    Killed("train", ("train", "d0.parquet", "--vehicle", "car.yaml", "-o", "a.split", "--capacity", "5"), ("a.split",)),
    Killed("append", ("train", "d1.parquet", "--vehicle", "car.yaml", "-o", "b.split", "--append"), ("b.split",)),
    Killed(
        "evaluate",
        ("evaluate", "d1.parquet", "--vehicle", "car.yaml", "-o", "evaluation"),
        ("evaluation",),
        repeats=False,
    ),
    Killed(
        "diagnose", ("diagnose", "--real", "d1.parquet", "--vehicle", "car.yaml", "--out", "diagnosis"), ("diagnosis",)
    ),
    Killed("race", RACE, ("race.parquet", "race.split", "race.html"), repeats=False, written_twice=("race.split",)),
    Killed("maneuver", MANEUVER, ("turn.parquet", "turn.split")),
    Killed("export", (*EXPORT, "new.split"), ("export",)),
)


def start(folder: Path, arguments: Sequence[str]) -> subprocess.Popen:
    """Start one command in a folder, whose folder ``tmp`` serves as the system's for temporary files."""
    (folder / "tmp").mkdir(exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "split_cli", *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "TMPDIR": str(folder / "tmp")},
    )


def run(folder: Path, arguments: Sequence[str]) -> int:
    """Run one command in a folder; return its exit code."""
    return start(folder, arguments).wait()


def prepare(
    folder: Path,
    names: Collection[str],
    made: Callable[[Path, Sequence[str]], int] = run,
    segments: int = 10,
    logs: bool = True,
) -> None:
    """Write inputs, and an old output of every case of `names`; `made` runs a command, drives have `segments`."""
    from split_cli.workflows.simulate import SimulateSettings, simulate_log

    car = road_car()
    write_vehicle(car, folder / "car.yaml")
    for name in ("road_car.yaml", "f1tenth_car.yaml"):
        shutil.copy(Path(__file__).parents[2] / "sample_logs" / name, folder)
    for seed in range(2):
        terms = [MissingForce({"front_lateral": 150.0})]
        drive = make_drive(seed, segments, seconds=3.0, vehicle=car, terms=terms, name=f"d{seed}.parquet")
        write_drive(drive, folder / drive.name)
    if logs:
        (folder / "archive").mkdir()
        for seed in range(3):
            settings = SimulateSettings(track="small", duration=6.0, seed=seed)
            simulate_log(settings, folder / "archive" / f"{seed}.csv")
        shutil.copy(folder / "archive" / "0.csv", folder / "lap.csv")
    train = ("train", "d0.parquet", "--vehicle", "car.yaml", "-o")
    old: dict[str, tuple[tuple[str, ...], ...]] = {
        "ingest": (("ingest", "lap.csv", "-o", "lap.parquet"),),
        "ingest folder": (("ingest", "archive", "-o", "drives"),),
        "train": ((*train, "a.split"),),
        "append": ((*train, "b.split"),),
        "export": ((*train, "b.split"), (*train, "new.split", "--capacity", "6"), (*EXPORT, "b.split")),
        "diagnose": (("diagnose", "--real", "d0.parquet", "--vehicle", "car.yaml", "--out", "diagnosis"),),
        "evaluate": (("evaluate", "d0.parquet", "--vehicle", "car.yaml", "--features", "z1,z2", "-o", "evaluation"),),
        "race": ((*RACE, "--seed", "2"),),
        "maneuver": ((*MANEUVER, "--seed", "2"),),
    }
    for arguments in dict.fromkeys(arguments for name in names for arguments in old[name]):
        if made(folder, arguments) != 0:
            raise RuntimeError(f"could not prepare: split {' '.join(arguments)}")


def state(path: Path) -> str:
    """Return a digest of a file, or of all files of a folder with their names."""
    digest = hashlib.sha256()
    for file in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
        digest.update(f"{file.relative_to(path.parent)}\0".encode() + file.read_bytes())
    return digest.hexdigest()


def try_moments(case: Killed, ready: Path, kills: int, rng: random.Random) -> KillOutcome:
    """Kill one command at random moments of its duration."""
    outcome = KillOutcome()
    with tempfile.TemporaryDirectory() as name:
        whole = Path(name) / "whole"
        shutil.copytree(ready, whole)
        old = case.state(whole)
        begin = time.perf_counter()
        if run(whole, case.arguments) != 0:
            outcome.broken.append("the command fails when it is left alone")
            return outcome
        duration, new = time.perf_counter() - begin, case.state(whole)
        for _ in range(kills):
            folder = Path(name) / "run"
            shutil.copytree(ready, folder)
            process = start(folder, case.arguments)
            # Most of a run is imports: three quarters of the kills fall into its last third, which writes.
            moment = duration * (rng.uniform(0.66, 1.02) if rng.random() < 0.75 else rng.uniform(0.0, 0.66))
            try:
                process.wait(moment)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
            _look(outcome, case, folder, old, new, f"after {moment:.3f} s")
            if outcome.kills % 8 == 0:
                _run_again(outcome, case, folder, ready, old, new, f"after {moment:.3f} s")
            shutil.rmtree(folder)
    return outcome


def try_steps(case: Killed, ready: Path, place: Path, again: Callable[[Path, Sequence[str]], int] = run) -> KillOutcome:
    """Kill one command before each of its steps on the disk.

    The next run is tried after each kind of state: the outputs, and what lies beside them. `place` is an empty
    folder to work in, `again` runs a command.
    """
    outcome, whole = KillOutcome(), place / "whole"
    shutil.copytree(ready, whole)
    old = case.state(whole)
    left = leftovers_of_kills(whole, case.arguments, place / "copies")
    new = case.state(whole)
    kinds = set()
    for number, folder in enumerate(left):
        moment = f"before step {number}"
        _look(outcome, case, folder, old, new, moment)
        names = {re.sub(r"[.][a-z0-9_]{8}[.]part", ".*.part", p.name) for p in folder.iterdir()}
        kind = (case.state(folder), frozenset(names))
        if kind not in kinds:
            kinds.add(kind)
            _run_again(outcome, case, folder, ready, old, new, moment, again)
    return outcome


def _look(outcome: KillOutcome, case: Killed, folder: Path, old: tuple, new: tuple, moment: str) -> None:
    """See that each output is the old or the new one and is what `split verify` takes for whole."""
    outcome.kills += 1
    found = case.state(folder)
    outcome.old += found == old
    outcome.new += found == new
    if new == old:
        outcome.broken.append("old and new output cannot be told apart")
    # Of a run that does not repeat, and of which no copies were made, there is nothing to compare its output with.
    compared = case.repeats or not moment.startswith("after")
    for output, now, before, after in zip(case.outputs, found, old, new, strict=True):
        if compared and now not in (before, after) and output not in case.written_twice:
            outcome.broken.append(f"{moment} {output} is neither the old nor the new one")
        problem = verified(folder / output)
        if problem:
            outcome.broken.append(f"{moment} {output}: {problem}")


def verified(output: Path) -> str:
    """Return what `split verify` finds wrong with an output."""
    try:
        return "; ".join(i.detail for i in verify(output).items if i.passed is False)
    except SplitError as error:
        return str(error)


def _run_again(
    outcome: KillOutcome,
    case: Killed,
    folder: Path,
    ready: Path,
    old: tuple,
    new: tuple,
    moment: str,
    again: Callable[[Path, Sequence[str]], int] = run,
) -> None:
    """See that the next run works, gives the new output, and leaves nothing stray."""
    found = case.state(folder)
    code = again(folder, case.arguments)
    if code != 0:
        outcome.broken.append(f"{moment} the next run ends with {code}")
    elif case.repeats and (found == old or case.name != "append") and case.state(folder) != new:
        outcome.broken.append(f"{moment} the next run does not give the new output")
    known = {p.name for p in ready.iterdir()} | {*case.outputs, "tmp"}
    stray = {p.name for p in folder.iterdir()} - known | {
        p.name for p in (folder / "tmp").iterdir() if not _is_cache(p)
    }
    stray |= {p.name for p in folder.rglob("*.part")}
    if stray:
        outcome.broken.append(f"{moment} the next run leaves {', '.join(sorted(stray))}")


def _is_cache(path: Path) -> bool:
    """Tell whether compiled code is kept there for the next run, as in a read-only installation."""
    return path.name.startswith("split-compiled-")


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200, help="over all commands")
    parser.add_argument("--steps", action="store_true", help="before every step on the disk")
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
            if given.steps:
                with tempfile.TemporaryDirectory() as place:
                    outcome = try_steps(case, ready, Path(place))
            else:
                rng = random.Random(f"{given.seed} {case.name}")
                outcome = try_moments(case, ready, given.kills // len(cases), rng)
            broken += len(outcome.broken)
            counts = f"{outcome.kills:6} {outcome.old:6} {outcome.new:6} {len(outcome.broken):7}"
            print(f"{case.name:14} {counts}", flush=True)
            for line in outcome.broken:
                print(f"  {line}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
