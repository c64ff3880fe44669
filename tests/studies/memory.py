"""Peak memory and time of commands on ever longer recordings.

Example: ``python -m tests.studies.memory --rows 100000,1000000 --do label,train,ingest-parquet``. The recording is
a lap of the samples, repeated with different sensor noise, as a log of any kind of `tests.studies.long_logs`
(``ingest-bag``); ``ingest-folder`` reads a tenth of it ten times with two processes, and tells the larger one's
memory and the time of both. ``learn`` offers labels made at random to a set: no drive is read. Prints a row a
command: rows, peak resident memory, wall and processor time, and the time a row.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.studies.long_logs import LoggedLap, arguments_of, write_log

ROOT = Path(__file__).parents[2]
CAR = ROOT / "sample_logs" / "road_car.yaml"
LAP = ROOT / "sample_logs" / "road_handling_moderate.mcap"
_MEASURED = """
import resource, sys
from {module} import {function}
try:
    {function}({arguments})
finally:
    own, others = (resource.getrusage(whose) for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
    peak = max(int(peak.split()[1]), others.ru_maxrss)
    used = own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime
    print("measured", peak * 1024, used, file=sys.stderr)
"""
LEARNERS_BATCH = 100_000


def make_log(path: Path, rows: int, kind: str) -> None:
    """Write a recording of `rows` rows: a ``drive`` of ours, or a log of one of `long_logs.KINDS`."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet

    from split_cli.workflows.ingesting.ingest import ingest_logs

    source = path.with_name("lap.parquet")
    if not source.exists():
        ingest_logs([LAP], source, maps=["split_sim"], vehicle_path=CAR)
    table = pa.parquet.read_table(source)
    lap = LoggedLap({name: table[name].to_numpy() for name in table.column_names if name != "segment"})
    if kind != "drive":
        return write_log(kind, path, lap, rows)
    with pa.parquet.ParquetWriter(path, table.schema, compression="zstd") as writer:
        for number, part in enumerate(lap.parts(rows)):
            part["segment"] = np.full(len(part["t"]), number, dtype=np.int32)
            writer.write_table(pa.table([pa.array(part[name]) for name in table.schema.names], schema=table.schema))
    return None


def learn(count: int) -> None:
    """Offer `count` labels made at random to a set, some at a time, as a recording that never ends would."""
    import numpy as np

    from split_cli.learning.cells import empty_set, extend
    from split_cli.learning.features import Z2
    from split_cli.learning.kernel import Kernel
    from split_cli.learning.region import Region, z2_grid
    from tests.factories import make_labels, road_car, smooth_residual, valid_features

    car, region = road_car(), Region.of(road_car())
    grid = z2_grid(car, region)
    kernel = Kernel(np.array(grid.edges), np.ones(3), 0.1 * np.ones(3))
    trained = empty_set(car, Z2, region, grid, kernel, horizon=0.05)
    known = valid_features(car, region, LEARNERS_BATCH, 0)
    rng = np.random.default_rng(0)
    for number in range(-(-count // LEARNERS_BATCH)):
        z = np.clip(known + rng.normal(0.0, 1e-3, known.shape), known.min(axis=0), known.max(axis=0))
        z = z[: min(LEARNERS_BATCH, count - number * LEARNERS_BATCH)]
        trained = extend(trained, [make_labels(z, smooth_residual(z), car)])
    print(f"{trained.size} points in {trained.cell_count} cells")


def measure(what: str, rows: int, folder: Path) -> tuple[int, float, float]:
    """Return peak memory [bytes], wall and processor time [s] of one command."""
    kind = what.removeprefix("ingest-") if what.startswith("ingest-") else "drive"
    log = folder / f"{rows}.{'parquet' if kind == 'drive' else 'log.' + kind}"
    if what != "learn" and not log.exists():
        if kind == "folder":
            log.mkdir()
            make_log(folder / "tenth.parquet", rows // 10, "parquet")
            for number in range(10):
                os.link(folder / "tenth.parquet", log / f"{number}.parquet")
        else:
            make_log(log, rows, kind)
    car = str(CAR)
    arguments = {
        "label": ["label", str(log), "--vehicle", car, "-o", str(folder / "labels.parquet")],
        "train": ["train", str(log), "--vehicle", car, "-o", str(folder / "a.split")],
        "evaluate": ["evaluate", str(log), "--vehicle", car, "-o", str(folder / "evaluation")],
        "diagnose": ["diagnose", "--real", str(log), "--vehicle", car, "--out", str(folder / "diagnosis")],
        "learn": [],
    }.get(what, ["ingest", str(log), "--vehicle", car, "-o", str(folder / "out.parquet")])
    if kind == "folder":
        arguments = ["ingest", str(log), "--vehicle", car, "-o", str(folder / "drives"), "--jobs", "2"]
    elif kind != "drive":
        arguments += arguments_of(kind, folder)
    module, function, given = (
        ("tests.studies.memory", "learn", str(rows))
        if what == "learn"
        else ("split_cli.cli.main", "main", repr(arguments))
    )
    code = _MEASURED.format(module=module, function=function, arguments=given)
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - begin
    told = [line.split() for line in done.stderr.splitlines() if line.startswith("measured")]
    if not told or done.returncode:
        raise RuntimeError(f"{what} of {rows} rows failed: {done.stderr[-500:]}")
    return int(told[0][1]), seconds, float(told[0][2])


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", default="100000,1000000")
    parser.add_argument("--do", default="label,train,ingest-parquet,ingest-csv,ingest-mcap,learn")
    parser.add_argument("--folder", type=Path, help="where recordings are kept for the next run")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = given.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        print(f"{'command':16} {'rows':>11} {'peak MB':>8} {'wall s':>8} {'cpu s':>8} {'us a row':>9}")
        for what in given.do.split(","):
            for rows in (int(float(text)) for text in given.rows.split(",")):
                peak, wall, cpu = measure(what, rows, folder)
                spent = f"{wall:8.1f} {cpu:8.1f} {1e6 * cpu / rows:9.2f}"
                print(f"{what:16} {rows:11} {peak / 1e6:8.0f} {spent}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
