"""Updates and queries of every predictor and of rivals on one stream, in one run: ratios, medians, tails.

    python -m tests.benchmarks.bench_rivals [--sizes 100,1000,4151] [--length-scale 2 | --tuned] [--json F]
    python -m tests.benchmarks.bench_rivals --drive lap.parquet --vehicle car.yaml

One process, one thread, pinned to one processor; processor time of every single call less that of reading the
clock, 50th and 99th percentile, the median over repeats of the whole. Samples are spread over the valid region
of the road car, their labels a smooth function with noise, so that truth is known; every contestant has the
kernel that the labels were made for, or with `--tuned` one that was fitted to them. With `--drive` the training
blocks of a drive are learned, and the labels of its held-out blocks are asked. Rivals that are not installed are
left out. `--log-gp` and `--sky-gp` name
folders with code of two streaming learners, which is no part of this project: `LoGGP.py`
(github.com/alederer25/LoG-GPs, folder Python) and `models/SkyGP_BCM.py` (github.com/Zewen-Yang/SkyGP).
`--stream` writes the samples and queries for programs that are measured beside this one.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import json  # noqa: E402
import platform  # noqa: E402
import subprocess  # noqa: E402
import tempfile  # noqa: E402
import time  # noqa: E402
from dataclasses import asdict, replace  # noqa: E402
from functools import partial  # noqa: E402
from pathlib import Path  # noqa: E402

import click  # noqa: E402
import numpy as np  # noqa: E402

from split_cli.export.c99 import c_source  # noqa: E402
from split_cli.export.compiler import Compiler, find_compiler, section_bytes  # noqa: E402
from split_cli.export.provenance import provenance_of  # noqa: E402
from split_cli.export.symbolic import build_nominal  # noqa: E402
from split_cli.export.targets import predictor_tables  # noqa: E402
from split_cli.export.validity import valid_function  # noqa: E402
from split_cli.learning.cells import without_points  # noqa: E402
from split_cli.learning.iol import Dictionary  # noqa: E402
from split_cli.learning.online import OnlineSet  # noqa: E402
from split_cli.prediction import make_predictor  # noqa: E402
from split_cli.prediction.online import OnlineCommittee  # noqa: E402
from split_cli.prediction.online_process import OnlineProcess  # noqa: E402
from split_cli.prediction.table import TablePredictor  # noqa: E402
from split_cli.vehicle.parameters import read_vehicle  # noqa: E402
from split_cli.vehicle.single_track import SingleTrack  # noqa: E402
from tests.benchmarks.gpytorch_rival import gpytorch_rows  # noqa: E402
from tests.benchmarks.rival_stream import (  # noqa: E402
    SLOW_QUERIES,
    Samples,
    Timed,
    accuracy,
    each,
    percentiles,
    recorded_stream,
    spent,
    stream_of,
)
from tests.benchmarks.streaming_rivals import log_gp_rows, sky_gp_rows  # noqa: E402
from tests.factories import make_labels  # noqa: E402
from tests.printed_learner import PrintedLearner  # noqa: E402

_TIMER = """
#include "@NAME@.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}
int main(int argc, char **argv)
{
    const long count = atol(argv[1]);
    const int slopes = argc > 2 && atoi(argv[2]);
    const int certain = argc > 3 && atoi(argv[3]);
    @NAME@_real *z = malloc((size_t)count * 3 * sizeof *z);
    @NAME@_real out[15];
    double *empty = malloc((size_t)count * sizeof *empty), *all = malloc((size_t)count * sizeof *all);
    @NAME@_real first = 0;
    if (fread(z, sizeof *z, (size_t)count * 3, stdin) == 0) { return 1; }
    for (int round = 0; round < 5; ++round) {
        for (long k = 0; k < count; ++k) {
            struct timespec a, b, c;
            clock_gettime(CLOCK_THREAD_CPUTIME_ID, &a);
            clock_gettime(CLOCK_THREAD_CPUTIME_ID, &b);
            @NAME@_evaluate(z + 3 * k, out, certain ? NULL : out + 3, slopes ? out + 6 : NULL);
            clock_gettime(CLOCK_THREAD_CPUTIME_ID, &c);
            empty[k] = 1e9 * (double)(b.tv_sec - a.tv_sec) + (double)(b.tv_nsec - a.tv_nsec);
            all[k] = 1e9 * (double)(c.tv_sec - b.tv_sec) + (double)(c.tv_nsec - b.tv_nsec);
            first += out[0];
        }
        qsort(empty, (size_t)count, sizeof *empty, ascending);
        for (long k = 0; k < count; ++k) { printf("%.0f %.3g\\n", all[k] - empty[count / 2], (double)first); }
    }
    free(empty);
    free(all);
    free(z);
    return 0;
}
"""


# ---- ours ------------------------------------------------------------------------------------------------------


def our_update(stream: Samples) -> list[Timed]:
    """Time every sample of the stream offered alone to the compiled update, as `OnlineSet` does.

    The second row is the mean over those that are taken, offered one by one in a compiled loop: without what Python
    takes to hand over arrays.
    """
    from numba import njit

    from split_cli.learning._compiled import update_cell

    s = stream.trained
    numbers = s.grid.pack(s.grid.index(stream.z)[0])
    cells = np.unique(numbers, return_inverse=True)[1]
    shape = (int(cells.max()) + 1, s.capacity)
    settings = (np.concatenate([stream.z, stream.y], axis=1), 1.0 / s.kernel.length_scales, s.threshold, 0.0)
    state = (
        np.zeros(shape[0], dtype=np.int64), np.zeros((*shape, 5)), np.zeros((*shape, s.capacity + 3)),
    )  # fmt: skip
    times, taken = [], []
    for sample, cell in enumerate(cells.tolist()):
        became: list[int] = []
        took = spent(lambda at=cell, k=sample, out=became: out.extend(update_cell(at, k, 0.0, *settings, *state)))
        if became[0]:
            times.append(took)
            taken.append(sample)

    @njit
    def loop(cells, taken, samples, inverse_scales, threshold, forgetting, count, points, sums):
        for sample in taken:
            at = cells[sample]
            update_cell(at, sample, 0.0, samples, inverse_scales, threshold, forgetting, count, points, sums)

    rows, means = np.array(taken), []
    for _ in range(5):
        for values in state:
            values[:] = 0
        means.append(spent(lambda: loop(cells, rows, *settings, *state)) / len(rows))
    mean = 1e6 * float(np.median(means[1:]))  # the first one compiles
    return [
        Timed("split update (numba), accepted", len(stream.z), s.size, None, *percentiles(times[10:])),
        Timed("split update (numba), accepted, in a compiled loop (mean)", len(stream.z), s.size, None, mean, mean),
    ]


def offered(stream: Samples) -> Timed:
    """Time every sample that a controller offers to its set from numbers alone, where it is taken."""
    online = OnlineSet(without_points(stream.trained))
    online.begin_drive("stream", 0.0)
    times = []
    for sample, (z, y) in enumerate(zip(stream.z, stream.y, strict=True)):
        became: list[int] = []
        took = spent(lambda z=z, y=y, at=sample, out=became: out.append(online.offer_one(z, y, 0.0, at).updates))
        if became[0]:
            times.append(took)
    name = "split, offer_one of OnlineSet (Python), accepted"
    return Timed(name, len(stream.z), online.size, None, *percentiles(times[10:]))


def online_update(stream: Samples) -> Timed:
    """Time every sample offered to a set while driving, the committee decomposing the cell it changes."""
    empty = without_points(stream.trained)
    online = OnlineSet(empty)
    online.begin_drive("stream", 0.0)
    committee = OnlineCommittee(online)
    labels = [make_labels(stream.z[k : k + 1], stream.y[k : k + 1], empty.vehicle) for k in range(len(stream.z))]
    times = [spent(lambda one=one: committee.update(online.offer(one).changed)) for one in labels]
    return Timed(
        "split online, update and committee (Python)", len(stream.z), online.size, None, *percentiles(times[10:])
    )


def projected(stream: Samples, full: np.ndarray | None) -> Timed:
    """Time every sample absorbed by the online process, and its answers of mean, variance and Jacobian at once."""
    make = partial(OnlineProcess, stream.trained.kernel)
    make().learn(stream.z[:1], stream.y[:1])
    process = make()
    times = [
        spent(lambda at=k: process.learn(stream.z[at : at + 1], stream.y[at : at + 1])) for k in range(len(stream.z))
    ]
    query = each(process.along, [z[None] for z in stream.queries])
    mean, variance, _ = process.along(stream.queries)
    return Timed("projected, online (Python)", len(stream.z), process.count, None, *percentiles(times[10:]), *query,
               *query, **accuracy(mean, variance, stream, full),
               megabytes=process.nbytes / 1e6)  # fmt: skip


def printed_update(stream: Samples) -> Timed:
    """Time the update as the paper prints it, one inversion a point."""
    s = stream.trained
    printed = PrintedLearner(s.kernel.length_scales, s.capacity, s.threshold)
    numbers = s.grid.pack(s.grid.index(stream.z)[0]).tolist()
    items = list(range(len(stream.z)))
    p50, p99 = each(lambda k: printed.offer(k, numbers[k], stream.z[k]), items)
    return Timed("split update, as printed (NumPy)", len(stream.z), None, None, p50, p99)


def iol_update(stream: Samples, capacity: int, full: np.ndarray) -> Timed:
    """Time the dictionary, and what a process on it predicts."""
    s = stream.trained
    dictionary = Dictionary(s.kernel, capacity, s.threshold)
    items = list(range(len(stream.z)))
    p50, p99 = each(lambda k: dictionary.offer(stream.z[k], stream.y[k]), items)
    predictor = make_predictor("iol", s, capacity=capacity)
    queries = [z[None] for z in stream.queries[:SLOW_QUERIES]]
    asked = predictor.predict(stream.queries)
    query = each(predictor.predict, queries)
    jacobian = each(predictor.jacobian, queries)
    found = accuracy(asked.mean, asked.variance, stream, full)
    return Timed(f"iol, {capacity} points", len(stream.z), len(dictionary), None, p50, p99, *query, *jacobian,
               **found, megabytes=8e-6 * len(dictionary) ** 2)  # fmt: skip


def python_predictor(name: str, stream: Samples, full: np.ndarray) -> Timed:
    """Time one of the predictors, asked one query at a time from Python."""
    begin = time.perf_counter()
    predictor = make_predictor(name, stream.trained)
    predictor.predict(stream.queries[:1])
    build = time.perf_counter() - begin
    asked = predictor.predict(stream.queries)
    quick = name in ("bcm", "rbcm", "table")
    queries = [z[None] for z in stream.queries[: None if quick else SLOW_QUERIES]]
    query, jacobian = each(predictor.predict, queries), each(predictor.jacobian, queries)
    memory = predictor.nbytes / 1e6 if name == "table" else None
    return Timed(f"{name} (Python)", len(stream.z), stream.trained.size, build, None, None, *query, *jacobian,
               **accuracy(asked.mean, asked.variance, stream, full), megabytes=memory)  # fmt: skip


def exported(name: str, real: str, stream: Samples, table: TablePredictor, compiler: Compiler) -> list[Timed]:
    """Time the exported C: mean and variance, these with the Jacobian, and mean and Jacobian alone."""
    s = stream.trained
    graph = build_nominal(SingleTrack(s.vehicle), s.features)
    tables = predictor_tables(table if name == "table" else make_predictor(name, s), real)
    source = c_source(tables, graph, provenance_of(s, name), "car", valid_function(s))
    dtype = np.float32 if real == "float" else np.float64
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "car.h").write_text(source.header)
        (folder / "car.c").write_text(source.source)
        (folder / "timer.c").write_text(_TIMER.replace("@NAME@", "car"))
        begin = time.perf_counter()
        compiled = compiler.compile(folder / "car.c", folder, ["-std=gnu99", "-O3"])
        seconds = time.perf_counter() - begin
        compiler.build([compiled, folder / "timer.c"], folder / "timer", ["-std=gnu99", "-O2"])
        measured = []
        for asked in ("00", "10", "11"):
            command = [str(folder / "timer"), str(len(stream.queries)), *asked]
            given = np.ascontiguousarray(stream.queries, dtype=dtype).tobytes()
            text = subprocess.run(command, input=given, capture_output=True, check=True).stdout.split()
            measured += percentiles([1e-9 * float(t) for t in text[::2][len(stream.queries) :]])
        sizes = section_bytes(compiled) or (0, 0)
    size, title = len(stream.z), f"{name} (C, {real})"
    whole = Timed(title, size, s.size, None, None, None, *measured[:4],
                megabytes=source.table_bytes / 1e6, code_kb=sizes[0] / 1e3, compile_s=seconds)  # fmt: skip
    return [whole, Timed(f"{title}, without variance", size, s.size, None, None, None, None, None, *measured[4:])]


# ---- rivals ----------------------------------------------------------------------------------------------------


def scikit_learn(stream: Samples, full: np.ndarray) -> Timed | None:
    """Time scikit-learn's exact process, one an output."""
    try:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel
    except ImportError:
        return None
    s, (z, y), models = stream.rivals, stream.points, []
    begin = time.perf_counter()
    for output in range(3):
        kernel = ConstantKernel(s.signal_variance[output]) * RBF(s.length_scales[output])
        model = GaussianProcessRegressor(kernel, alpha=s.noise_variance[output], optimizer=None)
        models.append(model.fit(z, y[:, output]))
    build = time.perf_counter() - begin

    def predict(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean, deviation = zip(*(model.predict(z, return_std=True) for model in models), strict=True)
        return np.stack(mean, axis=1), np.stack(deviation, axis=1) ** 2

    query = each(predict, [z[None] for z in stream.queries[:SLOW_QUERIES]])
    found = accuracy(*predict(stream.queries), stream, full, ours=False)
    return Timed("scikit-learn, exact", len(stream.z), len(z), build, None, None, *query, **found)


def casadi_full(stream: Samples, compiler: Compiler) -> Timed:
    """Time the mean of the full process as C that CasADi writes, with its Jacobian."""
    import casadi

    s = stream.trained
    weights = make_predictor("full", s).weights
    z = casadi.MX.sym("z", 3)
    squared = 0
    for feature, scale in enumerate(s.kernel.length_scales):
        squared = squared + (z[feature] / scale - casadi.DM(s.z[:, feature] / scale)) ** 2
    mean = casadi.mtimes(casadi.DM(weights.T), casadi.exp(-0.5 * squared))
    both = casadi.Function("full", [z], [mean, casadi.jacobian(mean, z)])
    with tempfile.TemporaryDirectory() as scratch:
        here = Path.cwd()
        os.chdir(scratch)
        try:
            both.generate("full.c")
        finally:
            os.chdir(here)
        begin = time.perf_counter()
        compiler.build([Path(scratch) / "full.c"], Path(scratch) / "full.so", ["-O2", "-shared", "-fPIC"])
        seconds = time.perf_counter() - begin
        function = casadi.external("full", str(Path(scratch) / "full.so"))
        buffer, evaluate = function.buffer()
        asked, answer, slope = np.zeros(3), np.zeros(3), np.zeros((3, 3))
        buffer.set_arg(0, memoryview(asked))
        buffer.set_res(0, memoryview(answer))
        buffer.set_res(1, memoryview(slope))

        def call(at: np.ndarray) -> None:
            asked[:] = at
            evaluate()

        times = each(call, list(stream.queries))
        size = (Path(scratch) / "full.c").stat().st_size / 1e6
    name = "full GP, CasADi's C, mean and Jacobian"
    return Timed(name, len(stream.z), s.size, None, None, None, None, None, *times, megabytes=size, compile_s=seconds)


def measure(
    stream: Samples, repeats: int, compiler: Compiler | None, log_gp: Path | None = None, sky_gp: Path | None = None
) -> list[Timed]:
    """Return the rows of one stream; every contestant `repeats` times, the median taken of each figure."""
    size, dense = len(stream.z), stream.trained.size <= 6000
    full = make_predictor("full", stream.trained).mean(stream.queries) if dense else None
    begin = time.perf_counter()
    table = TablePredictor(stream.trained)
    build = time.perf_counter() - begin
    rows: list[list[Timed]] = []
    for _ in range(repeats):
        found = [*our_update(stream), offered(stream), online_update(stream), projected(stream, full)]
        if size <= 5000:
            found += [printed_update(stream), iol_update(stream, 300, full)]
        names = ["bcm", "rbcm", "projected"] + (["full", "weights", "local", "grbcm"] if dense else [])
        found += [python_predictor(name, stream, full) for name in names]
        asked = table.predict(stream.queries)
        singles = [q[None] for q in stream.queries]
        times = (*each(table.predict, singles), *each(table.jacobian, singles))
        found.append(Timed("table (Python)", size, stream.trained.size, build, None, None, *times,
                         **accuracy(asked.mean, asked.variance, stream, full),
                         megabytes=table.nbytes / 1e6))  # fmt: skip
        if compiler is not None:
            for name, real in (("bcm", "double"), ("rbcm", "double"), ("projected", "double"),
                               ("projected", "float"), ("table", "double"), ("table", "float")):  # fmt: skip
                found += exported(name, real, stream, table, compiler)
            if size <= 1000:
                found.append(casadi_full(stream, compiler))
        if log_gp is not None:
            found += log_gp_rows(log_gp, stream, full)
        if sky_gp is not None:
            found += sky_gp_rows(sky_gp, stream, full)
        if dense:
            found += [row for row in (scikit_learn(stream, full), *gpytorch_rows(stream, full)) if row]
        rows.append(found)
    return [_median(list(same)) for same in zip(*rows, strict=True)]


def measure_streaming(stream: Samples, log_gp: Path | None, sky_gp: Path | None) -> list[Timed]:
    """Return rows of the contestants that learn sample by sample, once each, at any size."""
    rows = [*our_update(stream), offered(stream), online_update(stream), projected(stream, None)]
    rows += [] if log_gp is None else log_gp_rows(log_gp, stream, None)
    return rows + ([] if sky_gp is None else sky_gp_rows(sky_gp, stream, None))


def measure_table(stream: Samples, repeats: int, compiler: Compiler) -> list[Timed]:
    """Return the rows of the table in C at any size, medians of `repeats`."""
    table = TablePredictor(stream.trained)
    found = [
        [row for real in ("double", "float") for row in exported("table", real, stream, table, compiler)]
        for _ in range(repeats)
    ]
    return [_median(list(same)) for same in zip(*found, strict=True)]


def _median(rows: list[Timed]) -> Timed:
    def of(name: str) -> object:
        values = [getattr(row, name) for row in rows]
        return values[0] if not isinstance(values[0], float) else float(np.median(values))

    typical = Timed(**{name: of(name) for name in asdict(rows[0])})
    medians = ("update_p50", "query_p50", "jacobian_p50")
    times = [[getattr(row, name) for row in rows] for name in medians if getattr(typical, name)]
    return replace(typical, spread=max((max(t) - min(t)) / np.median(t) for t in times) if times else None)


def machine() -> dict:
    """Return what the figures were measured on."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {"processor": model, "processors": os.cpu_count(), "load": os.getloadavg()[0],
            "python": platform.python_version(), "numpy": np.__version__}  # fmt: skip


def table_text(rows: list[Timed]) -> str:
    """Return the rows as a Markdown table; ratios are to the plain committee in C of the same size."""

    def cell(value: object) -> str:
        return "" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)

    base = {row.size: row.query_p50 for row in rows if row.name == "bcm (C, double)"}
    lines = [
        "| size | contestant | update p50/p99 us | query p50/p99 us | over bcm in C | with Jacobian p50/p99 us "
        "| spread | RMSE | from full | NLPD | in 95 % | MB | build s |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        ratio = row.query_p50 / base[row.size] if row.query_p50 and base.get(row.size) else None
        pairs = [
            "/".join(cell(v) for v in pair) if pair[0] is not None else ""
            for pair in ((row.update_p50, row.update_p99), (row.query_p50, row.query_p99),
                         (row.jacobian_p50, row.jacobian_p99))
        ]  # fmt: skip
        parts = [str(row.size), row.name, pairs[0], pairs[1], cell(ratio), pairs[2],
                 "" if row.spread is None else f"{100.0 * row.spread:.0f} %", cell(row.rmse),
                 cell(row.from_full), cell(row.nlpd), cell(row.coverage_95), cell(row.megabytes),
                 cell(row.build_s)]  # fmt: skip
        lines.append("| " + " | ".join(parts) + " |")
    return "\n".join(lines)


@click.command()
@click.option("--sizes", default="100,1000,4151", show_default=True, help="Samples of the stream.")
@click.option("--length-scale", default=2.0, show_default=True, help="In cells.")
@click.option("--repeats", default=3, show_default=True)
@click.option("--streaming", is_flag=True, help="Only those that learn sample by sample, once each.")
@click.option("--table", is_flag=True, help="Only the table in C, at any size.")
@click.option("--gpytorch", is_flag=True, help="Only GPyTorch, one output after the other, at any size.")
@click.option("--tuned", is_flag=True, help="Ours and the others fit hyperparameters of their own.")
@click.option("--drive", "recording", type=click.Path(exists=True, path_type=Path),
              help="Learn its training blocks, ask its held-out ones; others are tuned.")  # fmt: skip
@click.option("--vehicle", type=click.Path(exists=True, path_type=Path), help="Vehicle file of the drive.")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Rows and machine.")
@click.option("--stream", "stream_path", type=click.Path(path_type=Path), help="Samples and queries, npz.")
@click.option("--log-gp", type=click.Path(exists=True, path_type=Path), help="Folder that holds LoGGP.py.")
@click.option("--sky-gp", type=click.Path(exists=True, path_type=Path), help="Folder that holds models/SkyGP_BCM.py.")
def main(
    sizes: str,
    length_scale: float,
    repeats: int,
    streaming: bool,
    table: bool,
    gpytorch: bool,
    tuned: bool,
    recording: Path | None,
    vehicle: Path | None,
    json_path: Path | None,
    stream_path: Path | None,
    log_gp: Path | None,
    sky_gp: Path | None,
) -> None:
    """Print the table."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    compiler = find_compiler()
    rows: list[Timed] = []
    if (recording is None) != (vehicle is None):
        raise click.UsageError("--drive and --vehicle need each other")
    if recording is not None:
        streams = iter([recorded_stream(recording, read_vehicle(vehicle))])
    else:
        streams = (stream_of(int(size), length_scale, tuned) for size in sizes.split(","))
    for s in streams:
        if stream_path is not None:
            np.savez(stream_path, z=s.z, y=s.y, queries=s.queries, truth=s.truth, kept_z=s.trained.z,
                     kept_y=s.trained.y, **{k: getattr(s.trained.kernel, k) for k in
                     ("length_scales", "signal_variance", "noise_variance")})  # fmt: skip
        if gpytorch:
            rows += gpytorch_rows(s, None, alone=True)
        elif table and compiler is not None:
            rows += measure_table(s, repeats, compiler)
        elif streaming:
            rows += measure_streaming(s, log_gp, sky_gp)
        else:
            rows += measure(s, repeats, compiler, log_gp, sky_gp)
        if json_path is not None:
            json_path.write_text(json.dumps({"machine": machine(), "rows": [asdict(r) for r in rows]}, indent=1))
    click.echo(json.dumps(machine()))
    click.echo(table_text(rows))


if __name__ == "__main__":
    main()
