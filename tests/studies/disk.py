"""Run every command that writes onto a disk that is full, and into a place that is read-only.

Example: ``python -m tests.studies.disk --only export`` (as root on Linux: it mounts small file systems of memory).
The disk holds an old output of the command and has room for half of the largest new file. Allowed is one line of
error, and each output as it was or, of several that were named one by one, new and whole; nothing lies beside them.
Prints a row for each command; exits with 1 if anything else happened.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.studies.kill import CASES, Killed, prepare, run, state, verified

_PAGE, _FILLER = 4096, "filler"
CAR = ("--vehicle", "car.yaml")
MORE = (
    Killed("label", ("label", "d1.parquet", *CAR, "-o", "l.parquet"), ("l.parquet",)),
    Killed("compare", ("compare", "car.yaml", "road_car.yaml", "--on", "d1.parquet", "-o", "compared"), ("compared",)),
    Killed("calibrate", ("calibrate", "d1.parquet", *CAR, "--fit", "tires", "-o", "fitted.yaml"), ("fitted.yaml",)),
    Killed("init", ("init", "lap.csv", "-o", "project"), ("project",)),
    Killed("simulate", ("simulate", "--track", "small", "--duration", "5", "-o", "sim.csv"), ("sim.csv",)),
    Killed("page", ("ingest", "lap.csv", "-o", "p.parquet", "--report", "p.html"), ("p.parquet", "p.html")),
)


@contextmanager
def small_disk(place: Path, size: int, read_only: bool = False) -> Iterator[None]:
    """Mount a file system of `size` bytes on a folder, with what the folder holds."""
    with tempfile.TemporaryDirectory() as name:
        kept = Path(name) / "kept"
        shutil.copytree(place, kept)
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)], check=True)
        try:
            shutil.copytree(kept, place, dirs_exist_ok=True)
            if read_only:
                subprocess.run(["mount", "-o", "remount,ro", str(place)], check=True)
            yield
        finally:
            subprocess.run(["umount", str(place)], check=True)


def moved(case: Killed) -> tuple[str, ...]:
    """Return the arguments with every output in the folder ``disk``."""
    command, *others = case.arguments
    return (command, *(f"disk/{text}" if text in case.outputs else text for text in others))


def attempt(case: Killed, folder: Path) -> list[str]:
    """Run one command alone, on a full disk and on a read-only one; return what broke a rule."""
    disk, arguments, broken = folder / "disk", moved(case), []
    shutil.rmtree(disk, ignore_errors=True)
    disk.mkdir()
    # An append needs its set; whatever else is there already is the old output.
    for output in case.outputs:
        if (folder / output).is_dir():
            shutil.copytree(folder / output, disk / output)
        elif (folder / output).exists():
            shutil.copy(folder / output, disk / output)
    old = sum(_blocks(path) for path in disk.rglob("*") if path.is_file())
    with tempfile.TemporaryDirectory() as name:
        alone = Path(name) / "alone"
        shutil.copytree(folder, alone)
        if run(alone, arguments) not in (0, 3):
            return ["the command fails when it is left alone"]
        after = [path for path in (alone / "disk").rglob("*") if path.is_file()]
        written = [path for path in after if not _is_kept(path, disk / path.relative_to(alone / "disk"))]
        sizes = [_blocks(path) for path in written]
        new = sum(sizes)
    # Files that are named one by one are exchanged one by one. Whole pages: no room for a file of one page.
    room = max(sizes) // 2 // _PAGE * _PAGE
    for what, size, read_only in (("full", old + room + _PAGE, False), ("read-only", old + 2 * new, True)):
        with small_disk(disk, size, read_only):
            if not read_only:
                (disk / _FILLER).write_bytes(bytes(_PAGE))
            before = state(disk)
            done = _asked(folder, arguments)
            lines = [line for line in done.stderr.splitlines() if line.startswith("split: ")]
            if done.returncode in (0, 3) or not lines or "Traceback" in done.stderr or "of this program" in done.stderr:
                broken.append(f"{what}: exit {done.returncode}, {done.stderr[-300:]!r}")
            if state(disk) != before and (len(case.outputs) == 1 or _stray_or_damaged(case, disk)):
                broken.append(f"{what}: the disk holds something else than before: {sorted(disk.rglob('*'))}")
            if read_only is False:
                print(f"  {case.name}: {(lines or [''])[-1][:150]}", file=sys.stderr)
    return broken


def _stray_or_damaged(case: Killed, disk: Path) -> bool:
    return any(path.name not in case.outputs or verified(path) for path in disk.iterdir() if path.name != _FILLER)


def _is_kept(path: Path, old: Path) -> bool:
    return old.is_file() and old.read_bytes() == path.read_bytes()


def _blocks(path: Path) -> int:
    return -(-path.stat().st_size // _PAGE) * _PAGE


def _asked(folder: Path, arguments: tuple[str, ...]) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "split_cli", *arguments]
    environment = {**os.environ, "TMPDIR": str(folder / "tmp")}
    (folder / "tmp").mkdir(exist_ok=True)
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="commands whose name holds one of these, with commas between")
    given = parser.parse_args()
    cases = [one for one in (*CASES, *MORE) if any(word in one.name for word in given.only.split(","))]
    failed = False
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "ready"
        folder.mkdir()
        prepare(folder, {one.name for one in cases if one not in MORE})
        for case in cases:
            broken = attempt(case, folder)
            failed |= bool(broken)
            print(f"{case.name:14} {'; '.join(broken) or 'one line of error, the old output stays'}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
