"""Time of one prediction in every exported form, beside the numba predictor they are exported from.

    python tests/benchmarks/bench_export.py [POINTS]

One run, one thread, the same queries: half on points with a random offset, half uniform over the valid box. What
is compared are ratios; machines differ. Jacobian columns are mean, variance and Jacobian together, but for numba,
whose Jacobian is a call of its own.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from time import perf_counter

import casadi
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from split_cli.export.c99 import c_source  # noqa: E402
from split_cli.export.c_check import build_driver  # noqa: E402
from split_cli.export.casadi_function import CasadiFunctions, committee, generate_c, model_step  # noqa: E402
from split_cli.export.compiler import find_compiler, section_bytes  # noqa: E402
from split_cli.export.provenance import provenance_of  # noqa: E402
from split_cli.export.symbolic import build_nominal  # noqa: E402
from split_cli.export.tables import build_tables  # noqa: E402
from split_cli.export.validity import valid_function  # noqa: E402
from split_cli.prediction.bcm import BcmPredictor  # noqa: E402
from split_cli.vehicle.single_track import SingleTrack  # noqa: E402
from tests.factories import make_training_set  # noqa: E402

REPEATS = 3


def best(run, queries) -> float:
    """Return the least time a query of several runs [s]."""
    times = []
    for _ in range(REPEATS):
        begin = perf_counter()
        run(queries)
        times.append((perf_counter() - begin) / len(queries))
    return min(times)


def generated_times(functions: CasadiFunctions, folder: Path, compiler, queries: np.ndarray, flag: str) -> tuple:
    """Return seconds a query of CasADi's C, without and with Jacobian, and its object's bytes."""
    generate_c(functions, "car", folder)
    started = perf_counter()
    shared = folder / "car_casadi.so"
    compiler.build([folder / "car_casadi.c"], shared, ["-std=c99", flag, "-shared", "-fPIC"])
    compiled = perf_counter() - started
    with_value = casadi.external("car_mean_variance", str(shared))
    with_slopes = casadi.external("car_mean_variance_jacobian", str(shared))
    # Buffers, so that what is timed is the generated code and not the making of Python objects.
    times = []
    for function in (with_value, with_slopes):
        buffer, trigger = function.buffer()
        z = np.zeros(queries.shape[1])
        outputs = [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
        buffer.set_arg(0, memoryview(z))
        for k, out in enumerate(outputs):
            buffer.set_res(k, memoryview(out))

        def run(rows, z=z, trigger=trigger):
            for row in rows:
                z[:] = row
                trigger()

        times.append(best(run, queries))
    return *times, sum(section_bytes(compiler.compile(folder / "car_casadi.c", folder, [flag]))), compiled


def main() -> None:
    points = int(sys.argv[1]) if len(sys.argv) > 1 else 6000
    training_set = make_training_set(seed=1, points=points)
    rng = np.random.default_rng(0)
    near = training_set.z[rng.integers(0, training_set.size, 1000)] + rng.normal(size=(1000, 3)) * [
        0.01,
        0.01,
        0.05,
    ]
    low, high = training_set.z.min(axis=0), training_set.z.max(axis=0)
    queries = np.concatenate([near, rng.uniform(low, high, (1000, 3))])
    print(
        f"{training_set.size} points in {training_set.cell_count} cells, {len(queries)} queries, best of {REPEATS}"
    )
    rows = []
    predictor = BcmPredictor(training_set)
    predictor.predict(queries[:2]), predictor.jacobian(queries[:2])
    rows.append(
        ("numba bcm, batch", best(predictor.predict, queries), best(predictor.jacobian, queries[:500]), None)
    )
    compiler = find_compiler()
    if compiler is None:
        sys.exit("there is no C compiler here")
    graph = build_nominal(SingleTrack(training_set.vehicle), training_set.features)
    provenance = provenance_of(training_set, "bcm")
    tables = build_tables(training_set)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for real in ("double", "float"):
            constants, valid = build_tables(training_set, real), valid_function(training_set)
            source = c_source(constants, graph, provenance, "car", valid)
            for flag in ("-O2", "-O3"):
                driver = build_driver(source, folder, compiler, (flag,))
                times = [min(driver.seconds_per_query(queries, j) for _ in range(REPEATS)) for j in (False, True)]
                rows.append((f"C99 {real} {flag}", *times, sum(section_bytes(folder / "car.o"))))
        predict = committee(tables, "car")
        functions = CasadiFunctions(predict, model_step(predict, graph, "car_step"))
        z = casadi.MX.sym("z", 3)
        slopes = casadi.Function("slopes", [z], [*predict(z), casadi.jacobian(predict(z)[0], z)])
        some = queries[::4]
        value, with_slopes = (best(lambda rows, f=f: [f(row) for row in rows], some) for f in (predict, slopes))
        rows.append(("CasADi function, virtual machine", value, with_slopes, None))
        *times, size, compiled = generated_times(functions, folder, compiler, some, "-O2")
        rows.append((f"CasADi's C -O2 ({compiled:.0f} s to compile)", *times, size))
    print(f"{'form':40s} {'us':>8s} {'us with J':>10s} {'numba/this':>11s} {'object kB':>10s}")
    for form, value, with_jacobian, size in rows:
        kilobytes = "-" if size is None else f"{size / 1e3:.0f}"
        ratio = rows[0][1] / value
        print(f"{form:40s} {value * 1e6:8.1f} {with_jacobian * 1e6:10.1f} {ratio:11.2f} {kilobytes:>10s}")


if __name__ == "__main__":
    main()
