"""What several export tests make: the C of a set, smaller sets, and a caller in place of acados."""

import subprocess
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from split_cli.export.c99 import CSource, c_source
from split_cli.export.check import Oracle, make_oracle
from split_cli.export.compiler import Compiler
from split_cli.export.provenance import provenance_of
from split_cli.export.symbolic import build_nominal
from split_cli.export.targets import predictor_tables
from split_cli.export.validity import valid_function
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction import make_predictor
from split_cli.vehicle.single_track import SingleTrack

#: acados and blasfeo are not here: their few types and calls are stood in for.
BLASFEO = """
#include <stdio.h>
struct blasfeo_dvec { double pa[64]; };
struct blasfeo_dmat { double pA[1024]; int rows; };
struct blasfeo_dvec_args { struct blasfeo_dvec *x; int xi; };
struct blasfeo_dmat_args { struct blasfeo_dmat *A; int ai; int aj; };
static void blasfeo_unpack_dvec(int m, struct blasfeo_dvec *s, int i, double *x, int inc)
{ for (int k = 0; k < m; ++k) { x[k * inc] = s->pa[i + k]; } }
static void blasfeo_pack_dvec(int m, double *x, int inc, struct blasfeo_dvec *s, int i)
{ for (int k = 0; k < m; ++k) { s->pa[i + k] = x[k * inc]; } }
static void blasfeo_pack_dmat(int m, int n, double *a, int lda, struct blasfeo_dmat *s, int i, int j)
{ for (int q = 0; q < n; ++q) { for (int p = 0; p < m; ++p) {
    s->pA[(j + q) * s->rows + i + p] = a[p + q * lda]; } } }
"""


def source_of(training_set: TrainingSet, real: str = "double", name: str = "car", predictor: str = "bcm") -> CSource:
    """Return the exported C of a set."""
    graph = build_nominal(SingleTrack(training_set.vehicle), training_set.features)
    tables = predictor_tables(make_predictor(predictor, training_set), real)
    provenance = provenance_of(training_set, predictor)
    clearest = training_set.kernel.clearest
    return c_source(tables, graph, provenance, name, valid_function(training_set), training_set.plain, clearest)


def oracle_of(training_set: TrainingSet, queries: int, real: str = "double", predictor: str = "bcm") -> Oracle:
    """Return what Python answers to the queries of a check."""
    return make_oracle(make_predictor(predictor, training_set), queries, real)


def take_cells(training_set: TrainingSet, cells: int, points: int | None = None) -> TrainingSet:
    """Return a set of the first `cells` cells, at most `points` points in each, that has absorbed no label."""
    rows, offsets = [], [0]
    for cell in range(cells):
        first, last = training_set.offsets[cell : cell + 2]
        kept = np.arange(first, last)[:points]
        rows.append(kept)
        offsets.append(offsets[-1] + len(kept))
    chosen = np.concatenate(rows) if rows else np.empty(0, dtype=np.int64)
    arrays = {name: getattr(training_set, name)[chosen] for name in ("z", "y", "gamma", "t", "source", "row")}
    return replace(
        training_set,
        cell_numbers=training_set.cell_numbers[:cells],
        offsets=np.array(offsets, dtype=np.int64),
        information=None,
        absorbed=None,
        **arrays,
    )


def build_acados_caller(compiler: Compiler, caller: str, folder: Path) -> Callable[[Sequence[float]], np.ndarray]:
    """Compile C that calls the adapter in `folder` as acados would; return what it answers to numbers."""
    (folder / "acados" / "utils").mkdir(parents=True)
    (folder / "acados" / "utils" / "external_function_generic.h").write_text("")
    (folder / "blasfeo_d_aux.h").write_text(BLASFEO)
    (folder / "caller.c").write_text(caller)
    compiler.build([folder / "caller.c"], folder / "caller", ["-std=gnu11", "-O0", f"-I{folder}"])

    def ask(numbers: Sequence[float]) -> np.ndarray:
        text = " ".join(repr(float(number)) for number in numbers)
        done = subprocess.run([str(folder / "caller")], input=text, capture_output=True, text=True, check=True)
        return np.array(done.stdout.split(), dtype=float)

    return ask
