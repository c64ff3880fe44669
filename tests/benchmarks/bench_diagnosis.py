"""Time and memory of `split diagnose`, the whole command, on one core and on all of them.

    python -m tests.benchmarks.bench_diagnosis [SECONDS]

A pair of recordings of the plant at 100 Hz, 180 s each by default, with weaker brakes concealed. The first run
compiles and is not counted. What is compared are ratios within one run; machines differ.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parents[2]
CAR = ROOT / "sample_logs" / "road_car.yaml"
REPEATS = 2


def split(*arguments: object, cores: Sequence[int] = ()) -> tuple[float, float]:
    """Run a command; returns wall time [s] and the most memory it held [MB]."""
    begin = perf_counter()
    run = subprocess.Popen(
        [sys.executable, "-m", "split_cli", *map(str, arguments)],
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        preexec_fn=(lambda: os.sched_setaffinity(0, cores)) if cores else None,
    )  # fmt: skip
    _, status, usage = os.wait4(run.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(map(str, arguments))}: exit status {status}")
    return perf_counter() - begin, usage.ru_maxrss / 1024.0


def record(folder: Path, name: str, seconds: float, *options: object) -> Path:
    """Drive the plant and ingest what was recorded."""
    log, drive = folder / f"{name}_log.parquet", folder / f"{name}.parquet"
    split("simulate", "--track", "small", "--duration", seconds, "--lead-in", 1, *options, "-o", log)
    split("ingest", log, "--vehicle", CAR, "--map", "split_sim_table", "-o", drive)
    return drive


def main() -> None:
    """Print a table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 180.0
    everything = sorted(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        brakes = ("--effect", "drive_gain:brake_gain=0.85")
        real = record(folder, "real", seconds, "--driver", "brisk", "--aggressiveness", 0.7, "--seed", 1, *brakes)
        sim = record(folder, "sim", seconds, "--driver", "racer", "--aggressiveness", 0.7, "--seed", 2)
        command = ("diagnose", "--real", real, "--sim", sim, "--vehicle", CAR, "--out", folder / "told")
        split(*command)
        print(f"two recordings of {seconds:.0f} s at 100 Hz, the least of {REPEATS} runs")
        print("| cores | wall [s] | memory [MB] | over one core | driving over wall |\n|---|---|---|---|---|")
        first = None
        for cores in (everything[:1], everything):
            runs = [split(*command, cores=cores) for _ in range(REPEATS)]
            wall, memory = min(run[0] for run in runs), max(run[1] for run in runs)
            first = first or wall
            ratios = f"{wall / first:.2f} | {2.0 * seconds / wall:.0f}"
            print(f"| {len(cores)} | {wall:.1f} | {memory:.0f} | {ratios} |")


if __name__ == "__main__":
    main()
