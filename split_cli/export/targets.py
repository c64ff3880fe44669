"""One export: every target written into a folder and compared with Python before anyone sees it."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from split_cli.errors import ExportError, nearest_names
from split_cli.export.c99 import c_identifier, c_source, fill, memory_parts, template
from split_cli.export.c_check import check_c, selftest_source
from split_cli.export.casadi_function import (
    CasadiFunctions,
    check_casadi,
    correction_function,
    generate_c,
    model_step,
    predictor_function,
)
from split_cli.export.casadi_step import casadi_substeps, memory_functions
from split_cli.export.casadi_trust import trust_functions
from split_cli.export.check import Oracle, PredictionCheck, check_predictions, make_oracle
from split_cli.export.compiler import Compiler, find_compiler
from split_cli.export.documents import (
    Document,
    document_answer,
    document_of,
    read_json,
    read_npz,
    require_equal,
    schema_text,
    write_json,
    write_npz,
)
from split_cli.export.generated_check import check_generated
from split_cli.export.ggv import limits_over_speed, write_ggv
from split_cli.export.projection import projection_data
from split_cli.export.provenance import Provenance
from split_cli.export.step_check import Intervals, StepOracle, make_step_oracle, observed
from split_cli.export.stepped_model import Drives, SteppedModel, roll_drives
from split_cli.export.symbolic import NominalGraph, build_nominal
from split_cli.export.tables import Constants, TableData, build_tables, require_usable, table_data
from split_cli.export.validity import valid_function, valid_state_function
from split_cli.files import ScratchFolder, sha256_of_file
from split_cli.learning.training_set import TrainingSet
from split_cli.learning.trust import supported_variance
from split_cli.prediction import Predictor, make_predictor
from split_cli.prediction.projected import ProjectedPredictor
from split_cli.prediction.table import TablePredictor
from split_cli.prediction.trusted import untrusted
from split_cli.vehicle.single_track import SingleTrack

TARGETS = ("c", "casadi", "npz", "json", "ggv")
PREDICTORS = ("bcm", "rbcm", "table", "projected")
MANIFEST = "manifest.json"
MANIFEST_FORMAT = "split-export-manifest/1"
CHECK_POINTS, CHECK_INTERVALS = 64, 4


@dataclass(frozen=True)
class ExportPlan:
    """What is asked for."""

    targets: tuple[str, ...]  # of `TARGETS`
    name: str  # prefix of files and functions; turned into a C identifier
    real: str = "double"  # {"double", "float"} Numbers of the C target
    queries: int = 10_000  # size of the comparison with Python
    # Interval of the discrete step that delays are kept for [s]; None for the set's label interval.
    step: float | None = None
    predictor: str = "bcm"  # of `PREDICTORS`


@dataclass(frozen=True)
class TargetResult:
    """What one target came to."""

    target: str
    files: tuple[str, ...]
    check: PredictionCheck | None  # None when the C could not be compiled here
    step_error: float | None  # largest relative error of the model step
    seconds_per_query: float | None  # mean and variance of one query [s]
    table_bytes: int  # constants, as the target stores them
    code_bytes: int | None  # compiled code, where there is some
    note: str  # compiler, or why something was not verified


def plan_export(
    targets: Sequence[str], name: str, real: str, queries: int, predictor: str, step: float | None = None
) -> ExportPlan:
    """Return a plan, or say which word of it is not known.

    Raises
    ------
    ExportError
        For an unknown target, precision or predictor, too few queries, or a step that is no interval.
    """
    for target in targets:
        if target not in TARGETS:
            raise ExportError(f"no target {target!r}", advice=nearest_names(target, TARGETS))
    if not targets:
        raise ExportError("no target was named", advice=f"Choose of {', '.join(TARGETS)}.")
    if real not in ("double", "float"):
        raise ExportError(f"no real number {real!r}", advice="double or float.")
    if predictor not in PREDICTORS:
        advice = nearest_names(predictor, PREDICTORS)
        raise ExportError(f"the predictor {predictor!r} has no export", advice=advice)
    if queries < 100:
        raise ExportError(f"{queries} queries verify nothing", advice="Use at least 100; 10000 is the default.")
    if step is not None and not 0.0 < step < np.inf:
        raise ExportError(f"a step of {step!r} s", advice="Give the controller's interval in seconds.")
    return ExportPlan(tuple(dict.fromkeys(targets)), c_identifier(name), real, queries, step, predictor)


def write_export(
    training_set: TrainingSet,
    plan: ExportPlan,
    provenance: Provenance,
    folder: Path,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[TargetResult, ...]:
    """Write every target into `folder`, which should be temporary, each verified; the manifest last.

    Parameters
    ----------
    folder : Path
        Exists and is empty.
    progress : callable
        Told what happens.

    Raises
    ------
    ExportError
        If a target differs from Python, does not compile, or the set is empty.
    """
    step = training_set.horizon if plan.step is None else plan.step
    graph = build_nominal(SingleTrack(training_set.vehicle), training_set.features, step)
    if graph.memory is not None:
        provenance = replace(provenance, memory=graph.memory.to_mapping())
    require_usable(training_set)
    if plan.predictor == "table":
        progress("filling the table")
    predictor = make_predictor(plan.predictor, training_set)
    tables = predictor_tables(predictor)
    progress(f"answering {plan.queries} queries in Python")
    oracle = make_oracle(predictor, plan.queries)
    drives = _drives(graph, training_set, oracle)
    steps, intervals = None, None
    if graph.features is not None and {"c", "casadi"} & set(plan.targets):
        steps = make_step_oracle(graph, training_set, oracle.reference)
        found = observed(steps, casadi_substeps(graph)).first(CHECK_INTERVALS)
        intervals = found if len(found.asked) else None
    compiler = find_compiler()
    results = []
    document_check = None
    for target in plan.targets:
        progress(f"writing and verifying {target}")
        if target == "c":
            oracle_c = make_oracle(predictor, plan.queries, "float") if plan.real == "float" else oracle
            constants = predictor_tables(predictor, plan.real)
            results.append(
                _write_c(
                    training_set, plan, provenance, graph, constants, oracle_c, drives, intervals, compiler, folder
                )
            )
        elif target == "casadi":
            functions = casadi_functions(tables, graph, plan.name, training_set)
            results.append(_write_casadi(training_set, plan, graph, functions, oracle, steps, compiler, folder))
        elif target == "ggv":
            files = write_ggv(limits_over_speed(training_set.vehicle, training_set.region), folder, plan.name)
            size = sum((folder / file).stat().st_size for file in files)
            note = "limits of the vehicle file over speed; nothing learned is in them"
            results.append(TargetResult("ggv", files, None, None, None, size, None, note))
        else:
            document = document_of(training_set, provenance, tables)
            result = _write_document(document, plan, oracle, target, folder, document_check)
            # What reads back bit for bit predicts the same: npz and json share one comparison.
            document_check = result.check
            results.append(result)
    _write_check_points(oracle, drives, intervals, folder / f"{plan.name}_check.json")
    manifest = _manifest(training_set, plan, provenance, tables, oracle, results, folder)
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return tuple(results)


def _drives(graph: NominalGraph, training_set: TrainingSet, oracle: Oracle) -> Drives | None:
    """Return drives of a step with memory, None where it has none."""
    if graph.memory is None or graph.features is None:
        return None
    return roll_drives(SteppedModel(graph, training_set, oracle.reference))


def _write_c(
    training_set: TrainingSet,
    plan: ExportPlan,
    provenance: Provenance,
    graph: NominalGraph,
    constants: Constants,
    oracle: Oracle,
    drives: Drives | None,
    intervals: Intervals | None,
    compiler: Compiler | None,
    folder: Path,
) -> TargetResult:
    valid = valid_function(training_set)
    clearest = training_set.kernel.clearest
    source = c_source(constants, graph, provenance, plan.name, valid, training_set.plain, clearest)
    written = {
        f"{plan.name}.h": source.header,
        f"{plan.name}.c": source.source,
        f"{plan.name}_selftest.c": selftest_source(source, oracle, drives, intervals),
    }
    for name, text in written.items():
        (folder / name).write_text(text, encoding="ascii")
    missing = "" if source.with_step else f"no model step: {', '.join(graph.foreign_features)} is not in the state; "
    if compiler is None:
        note = f"{missing}not compiled, hence not verified: there is no C compiler here"
        return TargetResult("c", tuple(written), None, None, None, source.table_bytes, None, note)
    with ScratchFolder() as scratch:
        found = check_c(source, graph, training_set, oracle, compiler, scratch, written[f"{plan.name}_selftest.c"])
    return TargetResult(
        "c",
        tuple(written),
        found.predictions,
        found.step_error,
        found.seconds_predict,
        source.table_bytes,
        found.code_bytes,
        f"{missing}{plan.real}, {found.compiler}",
    )


def predictor_tables(predictor: Predictor, real: str = "double") -> Constants:
    """Return the constants of a predictor, rounded to `real`."""
    inner = untrusted(predictor)
    if isinstance(inner, TablePredictor):
        return table_data(inner, real)
    if isinstance(inner, ProjectedPredictor):
        return projection_data(inner, real)
    return build_tables(inner.training_set, real, robust=inner.name == "rbcm")


def casadi_functions(tables: Constants, graph: NominalGraph, name: str, training_set: TrainingSet) -> CasadiFunctions:
    """Return the predictor, the model step and the valid region as CasADi functions."""
    predict = predictor_function(tables, name)
    correction = correction_function(tables, training_set.kernel.clearest if graph.asks_knowledge else None)
    step = model_step(correction, graph, f"{name}_step", training_set.plain)
    valid = valid_function(training_set, f"{name}_valid")
    state = (
        valid_state_function(training_set, graph, valid, f"{name}_valid_state") if graph.features is not None else None
    )
    trust = trust_functions(correction, graph, name, training_set.plain)
    return CasadiFunctions(predict, step, memory_functions(correction, graph, name), trust, valid, state)


def acados_source(name: str, graph: NominalGraph, horizon: float) -> str:
    """Return the adapter of the step for acados: its generic external functions."""
    memory = graph.memory
    n = 8 if memory is None else memory.whole
    step = memory.step if memory is not None and memory.line else horizon
    values = {"NAME": name, "UPPER": name.upper(), "HORIZON": repr(float(step)), "N": str(n), "NV": str(n + 2)}
    values["MEMORY"] = "".join(f"\n *   x[{8 + k}]  {label}" for k, label in enumerate(memory.labels)) if memory else ""
    kept = [*memory_parts(memory), *(["place_time"] if graph.needs_place_and_time else [])]
    return fill(template("acados.c.in"), values, kept)


def _write_casadi(
    training_set: TrainingSet,
    plan: ExportPlan,
    graph: NominalGraph,
    functions: CasadiFunctions,
    oracle: Oracle,
    steps: StepOracle | None,
    compiler: Compiler | None,
    folder: Path,
) -> TargetResult:
    # Saved before anything asks for derivatives: CasADi would save those of a spline too, twelve times its size.
    written = [f"{plan.name}.casadi"]
    functions.predict.save(str(folder / written[0]))
    for region in (functions.valid, functions.valid_state):
        if region is not None:
            written.append(f"{region.name()}.casadi")
            region.save(str(folder / written[-1]))
    if functions.step is not None:
        for function in (functions.step, *functions.memory, *functions.trust):
            written.append(f"{function.name()}.casadi")
            function.save(str(folder / written[-1]))
    check, step_error = check_casadi(functions, oracle, steps)
    written += [path.name for path in generate_c(functions, plan.name, folder)]
    if functions.step is not None:
        written.append(f"{plan.name}_acados.c")
        (folder / written[-1]).write_text(acados_source(plan.name, graph, training_set.horizon), encoding="ascii")
    note = "the generated C was not compiled, hence not verified: there is no C compiler here"
    code = None
    if compiler is not None:
        with ScratchFolder() as scratch:
            code = check_generated(plan.name, folder, scratch, compiler, oracle, functions.step is not None, steps)
        note = f"generated C verified with {compiler.version}"
    inside = oracle.slope_z
    begin = perf_counter()
    for query in inside:
        functions.predict(query)
    seconds = (perf_counter() - begin) / len(inside)
    size = (folder / written[0]).stat().st_size
    return TargetResult("casadi", tuple(written), check, step_error, seconds, size, code, note)


def _write_document(
    document: Document, plan: ExportPlan, oracle: Oracle, target: str, folder: Path, check: PredictionCheck | None
) -> TargetResult:
    path = folder / f"{plan.name}.{target}"
    written = [path.name]
    if target == "npz":
        write_npz(document, path)
        found = read_npz(path)
    else:
        write_json(document, path)
        found = read_json(path)
        written.append("split-export.schema.json")
        (folder / written[1]).write_text(schema_text(), encoding="utf-8")
    require_equal(document, found, target)
    check = check or check_predictions(document_answer(found), oracle, "double", target)
    return TargetResult(target, tuple(written), check, None, None, path.stat().st_size, None, "numbers only")


def _write_check_points(oracle: Oracle, drives: Drives | None, intervals: Intervals | None, path: Path) -> None:
    """Write some queries and answers, for `split verify` and for whoever ports the numbers elsewhere.

    Where the step has a memory, drives of it as well: input, t and s of every step, and states from the start. Of
    any step, a few `observed` intervals and the running trust after them.
    """
    usable = np.flatnonzero((np.abs(oracle.z) < 1e4).all(axis=1))
    rows = usable[:: max(1, len(usable) // CHECK_POINTS)][:CHECK_POINTS]
    content = {
        "z": oracle.z[rows].tolist(),
        "mean": oracle.mean[rows].tolist(),
        "variance": oracle.variance[rows].tolist(),
        "signal_variance": (oracle.reference.deviation**2).tolist(),
        "accuracy": oracle.reference.accuracy,
    }
    if drives is not None:
        places = {"u": drives.u, "place_time": drives.place_time, "x": drives.exact}
        content["drives"] = {"h": drives.step, **{key: values.tolist() for key, values in places.items()}}
    if intervals is not None:
        content["observed"] = {"asked": intervals.asked.tolist(), "trust": intervals.trust.tolist()}
    path.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")


def _manifest(
    training_set: TrainingSet,
    plan: ExportPlan,
    provenance: Provenance,
    tables: Constants,
    oracle: Oracle,
    results: Sequence[TargetResult],
    folder: Path,
) -> dict[str, Any]:
    """Return the manifest: provenance, verification and a SHA-256 a file; no times, so equal exports are equal."""
    verification = {
        result.target: {
            "verified": result.check is not None,
            **(asdict(result.check) if result.check else {}),
            "step_error": result.step_error,
            "note": result.note,
        }
        for result in results
    }
    files = sorted(path.name for path in folder.iterdir() if path.is_file())
    return {
        "format": MANIFEST_FORMAT,
        "name": plan.name,
        "targets": list(plan.targets),
        "real": plan.real,
        "split_version": provenance.version,
        "predictor": provenance.predictor,
        "set": {"name": provenance.set_name, "sha256": provenance.set_sha256},
        "features": list(provenance.features),
        "horizon": provenance.horizon,
        "points": training_set.size,
        "cells": training_set.cell_count,
        "vehicle": provenance.vehicle,
        "vehicle_digest": provenance.vehicle_digest,
        # How many of the vehicle's effects, the last ones, training found beyond the vehicle file.
        **({"found_effects": training_set.found_effects} if training_set.found_effects else {}),
        "conventions": provenance.conventions,
        **({"memory": provenance.memory} if provenance.memory is not None else {}),
        "trust": list(training_set.trust.share),
        "reservations": list(provenance.reservations),
        "supported_variance": supported_variance(tables.trust, tables.doubt, tables.signal_variance).tolist(),
        "tables_sha256": tables.digest(),
        "predictor_error": oracle.predictor_error,
        **({"table": tables.error} if isinstance(tables, TableData) else {}),
        "verification": verification,
        "files": {name: sha256_of_file(folder / name) for name in files},
    }
