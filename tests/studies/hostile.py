"""Give every option of every command what a hostile or hurried user might; see that each run ends as it should.

Example: ``python -m tests.studies.hostile --only train``. A run may end with 0 to 3, or is stopped when it works
on; it prints no traceback and no control characters, waits for nothing, and stays below 1 GB. A run that fails
leaves every file as it was, and no run changes an input. Prints a row a command, and each run that broke a rule.
Run as root, commands lose root's capabilities, so that folders may be closed to them. ``--random 40 --seed 1``
tries 40 runs of each command instead, with several arguments exchanged at a time and an input damaged.
"""

import argparse
import ctypes
import importlib
import itertools
import os
import random
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from split_cli.cli.main import COMMANDS, main
from split_cli.files import sha256_of_file
from tests.studies.fuzz import mutant
from tests.studies.kill import prepare

NUMBERS = ("nan", "inf", "-inf", "1e308", "-1e308", "1e-308", "-0", "0", "-1", "", "1e400", "9" * 20, "9" * 5000)
WORDS = ("", " ", ",", "nan", "-1", "1e308", "0", "a\nb", "\x1b[31mx", "u\u202ex", "x" * 100_000, "../x", "{[", "a=nan")
INPUTS = (
    "",
    "-",
    "missing",
    ".",
    "/",
    "fifo",
    "socket",
    "loop",
    "closed/car.yaml",
    "/dev/zero",
    "/dev/full",
    "new\nline",
    "u\u202e\x1b[31m.parquet",
    "empty",
    "x" * 300,
    "car.yaml/below",
    "lap.csv",
    "a.split",
    "d0.parquet",
    "circle",
)
OUTPUTS = (
    "",
    "-",
    ".",
    "/",
    "fifo",
    "socket",
    "loop",
    "closed/out",
    "closed",
    "/dev/full",
    "missing/deeper/out",
    "x" * 300,
    "car.yaml/below",
    "new\nline",
    "u\u202e.x",
    "archive",
    "circle",
    "/proc/out",
)
BASE = {
    "init": ("lap.csv", "-o", "out"),
    "ingest": ("lap.csv", "-o", "out.parquet"),
    "label": ("d0.parquet", "--vehicle", "car.yaml", "-o", "out.parquet"),
    "train": ("d0.parquet", "--vehicle", "car.yaml", "-o", "out.split"),
    "evaluate": ("d1.parquet", "--vehicle", "car.yaml", "--set", "a.split"),
    "compare": ("car.yaml", "a.split", "--on", "d1.parquet"),
    "export": ("a.split", "--target", "json", "-o", "out"),
    "calibrate": ("d0.parquet", "--vehicle", "car.yaml", "-o", "out.yaml"),
    "diagnose": ("--real", "d1.parquet", "--vehicle", "car.yaml", "--out", "out"),
    "prove generate": ("out", "--seed", "1", "--cases", "1"),
    "prove identify": ("archive",),
    "prove score": ("archive",),
    "prove recording": ("d0.parquet", "--vehicle", "car.yaml", "-o", "out"),
    "race": ("--vehicle", "road_car.yaml", "--laps", "0", "--max-speed", "11"),
    "maneuver": ("brake-avoid", "--vehicle", "road_car.yaml"),
    "simulate": ("--track", "small", "--duration", "3", "-o", "out.csv"),
    "explain": ("train",),
    "info": ("car.yaml",),
    "verify": ("a.split",),
    "demo": ("-o", "out"),
}
"""Arguments of every command with which it succeeds, or fails for want of something else."""
KEEPS = ("demo", "prove generate", "prove recording", "prove identify")
"""Commands of many steps: what is stopped keeps what its finished steps wrote."""
SOMEONE_ELSE = 65534
NO_CAPABILITIES = ((ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)())  # what capset takes


def hostile_runs(only: str = "") -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield command and arguments, with one argument of the base exchanged, or one option added."""
    for name, base in BASE.items():
        if only not in name:
            continue
        command = importlib.import_module(f"split_cli.cli.{name.split()[0]}").command
        for part in name.split()[1:]:
            command = command.commands[part]
        yield name, base
        for parameter in command.params:
            if getattr(parameter, "is_flag", False):
                continue
            option = parameter.opts[-1] if isinstance(parameter, click.Option) else None
            given = [at for at, word in enumerate(base) if option is not None and word in parameter.opts]
            for value in _values(parameter.type, [word for word in base if "." in word]):
                if option is None:
                    yield name, (value, *base[1:])
                elif given:
                    yield name, (*base[: given[0] + 1], value, *base[given[0] + 2 :])
                else:
                    yield name, (*base, option, value)


def random_runs(only: str, count: int, rng: random.Random) -> Iterator[tuple[str, tuple[str, ...], str]]:
    """Yield command, arguments with up to two exchanged or added, and the input to damage, if any."""
    for name, runs in itertools.groupby(hostile_runs(only), key=lambda run: run[0]):
        base, *others = [arguments for _, arguments in runs]
        inputs = [word for word in base if "." in word and not word.startswith("out")]
        for _ in range(count):
            changes = rng.sample(others, rng.randrange(3))
            words = list(base)
            for changed in changes:
                words[: len(base)] = [
                    new if new != old else word for new, old, word in zip(changed, base, words, strict=False)
                ]
                words += changed[len(base) :]
            yield name, tuple(words), rng.choice(inputs) if inputs and (not changes or rng.random() < 0.7) else ""


def _values(kind: click.ParamType, of_base: list[str]) -> tuple[str, ...]:
    if isinstance(kind, click.Path):
        return (*OUTPUTS, *of_base) if "Output" in type(kind).__name__ else INPUTS
    if kind.name in ("float", "integer", "float range", "integer range"):
        return NUMBERS
    return (*WORDS, *INPUTS[3:9]) if kind.name == "text" else WORDS


def make_strange(folder: Path) -> None:
    """Make what no command expects in the folder in which it runs."""
    os.mkfifo(folder / "fifo")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(folder / "socket"))
    (folder / "loop").symlink_to("loop")
    (folder / "circle").mkdir()
    (folder / "circle" / "again").symlink_to("..")
    (folder / "empty").write_bytes(b"")
    for name in ("new\nline", "u\u202e\x1b[31m.parquet"):
        shutil.copy(folder / "d0.parquet", folder / name)
    (folder / "closed").mkdir()
    shutil.copy(folder / "car.yaml", folder / "closed" / "car.yaml")


def state(folder: Path) -> dict[str, str]:
    """Return a digest of every file in and below a folder."""
    return {
        str(path.relative_to(folder)): sha256_of_file(path) if path.is_file() else "-"
        for path in folder.rglob("*")
        if "again" not in path.parts
    }


def try_run(
    source: Path,
    work: Path,
    name: str,
    arguments: tuple[str, ...],
    patience: float,
    damage: Callable[[Path], None] = lambda folder: None,
) -> tuple[str, str]:
    """Run one command on a fresh copy of the inputs; return how it ended, and which rule it broke, if any."""
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(source, work, symlinks=True)
    make_strange(work)
    damage(work)
    printed = work.parent / "printed"
    (work / "closed").chmod(0)
    if os.getuid() == 0:
        os.chown(work / "closed", SOMEONE_ELSE, SOMEONE_ELSE)
    before = state(work)
    process = os.fork()
    if process == 0:
        _become(work, printed, name, arguments)
    ended, status, used = _wait(process, patience)
    stopped = not ended
    if stopped:
        os.kill(process, signal.SIGTERM)
        ended, status, used = _wait(process, 15.0)
    if not ended:
        os.killpg(process, signal.SIGKILL)
        os.waitpid(process, 0)
        return "stopped", "does not end when it is stopped"
    code, text = os.waitstatus_to_exitcode(status), printed.read_text(encoding="utf-8", errors="replace")
    after = state(work)
    failed = code not in (0, 3)
    changed = sorted(p for p in {*before, *after} if before.get(p) != after.get(p))
    if not failed:  # what is named once, as the output, may be written over
        changed = [p for p in changed if p in before and arguments.count(p) != 1]
    changed += sorted(path.name for path in (work.parent / "tmp").iterdir())
    how = "stopped" if stopped else {0: "done", 1: "refused", 2: "usage", 3: "done"}.get(code, "other")
    if code not in (0, 1, 2, 3, 130) or (code == 130 and not stopped):
        return how, f"exit code {code}"
    if "Traceback" in text or "error of this program" in text:
        return how, text.strip().splitlines()[-1][:300]
    if not text.replace("\n", "").replace("\r", "").isprintable():
        return how, "prints control characters"
    if changed and not (stopped and name in KEEPS):
        return how, f"leaves or changes {changed[:3]}"
    if used.ru_maxrss > 1 << 20:
        return how, f"takes {used.ru_maxrss >> 10} MB"
    if stopped and used.ru_utime + used.ru_stime < 0.02 * patience:
        return how, "waits"
    return how, ""


def _become(work: Path, printed: Path, name: str, arguments: tuple[str, ...]) -> None:
    """Be the command, in a process that was forked for it."""
    os.setsid()
    os.chdir(work)
    stream = os.open(printed, os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
    for number, target in enumerate((os.open(os.devnull, os.O_RDONLY), stream, stream)):
        os.dup2(target, number)
    if os.getuid() == 0:
        ctypes.CDLL(None).capset(*NO_CAPABILITIES)
    code = 99
    try:
        main([*name.split(), *arguments])
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else 0
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _wait(process: int, seconds: float) -> tuple[bool, int, object]:
    """Wait for a process to end, for `seconds` of its processor time, and eight times as long by the clock."""
    end = time.monotonic() + 8.0 * seconds
    while time.monotonic() < end:
        found, status, used = os.wait4(process, os.WNOHANG)
        if found:
            return True, status, used
        counted = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
        if sum(map(int, counted)) > seconds * os.sysconf("SC_CLK_TCK"):
            break
        time.sleep(0.02)
    return False, 0, None


def load_commands() -> None:
    """Import every command, so that the processes that are forked need not."""
    for name in COMMANDS:
        importlib.import_module(f"split_cli.cli.{name}")


@contextmanager
def prepared_folders() -> Iterator[tuple[Path, Path]]:
    """Yield a folder with what `train` needs, and one for each run to work in; processes have no other place."""
    with tempfile.TemporaryDirectory() as place:
        source, work = Path(place) / "source", Path(place) / "work"
        for folder in (source, Path(place) / "tmp"):
            folder.mkdir()
        os.environ |= {"TMPDIR": f"{place}/tmp", "HOME": f"{place}/home"}
        prepare(source, ["train"], segments=2)  # of 3 s: what every command reads in a moment
        yield source, work


def damaging(name: str, rng: random.Random) -> Callable[[Path], None]:
    """Return what mutates one file of a folder, if it has a name."""

    def damage(folder: Path) -> None:
        if name:
            others = [path.read_bytes() for path in folder.iterdir() if path.suffix and path.is_file()]
            (folder / name).write_bytes(mutant(folder / name, (folder / name).read_bytes(), others, rng))

    return damage


def run(only: str, patience: float, every: int = 1, at_random: int = 0, seed: int = 1) -> list[str]:
    """Try every so many runs of the commands whose name holds `only`, or some at random; return what broke."""
    rng = random.Random(f"{seed} {only}")
    runs = random_runs(only, at_random, rng) if at_random else ((*known, "") for known in hostile_runs(only))
    broken: list[str] = []
    with prepared_folders() as (source, work):
        shutil.rmtree(source / "tmp")
        counts: dict[str, Counter[str]] = {}
        for name, arguments, damaged in itertools.islice(runs, 0, None, every):
            how, fault = try_run(source, work, name, arguments, patience, damaging(damaged, rng))
            counts.setdefault(name, Counter())[how] += 1
            if fault:
                counts[name]["broken"] += 1
                with_ = f" with {damaged} damaged" if damaged else ""
                broken.append(f"split {name} {' '.join(ascii(word)[:80] for word in arguments)}{with_}: {fault}")
                print(broken[-1], flush=True)
        hows = ("done", "refused", "usage", "stopped", "other", "broken")
        print(f"{'command':18}" + "".join(f"{how:>9}" for how in ("runs", *hows)))
        for name, count in counts.items():
            runs = count.total() - count["broken"]
            print(f"{name:18}{runs:9}" + "".join(f"{count[how]:9}" for how in hows))
    return broken


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="commands whose name holds this")
    parser.add_argument("--patience", type=float, default=20.0, help="processor time after which a run is stopped [s]")
    parser.add_argument("--every", type=int, default=1, help="try only each run of this many")
    parser.add_argument("--random", type=int, default=0, help="instead, so many runs of each command at random")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    load_commands()
    sys.exit(1 if run(given.only, given.patience, given.every, given.random, given.seed) else 0)
