"""The exported C, compiled and compared with Python: predictions, Jacobians and the model step."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from split_cli.errors import OUR_FAULT, ExportError
from split_cli.export.c99 import CSource, fill, memory_parts, template
from split_cli.export.check import ExportAnswer, Oracle, PredictionCheck, check_predictions
from split_cli.export.compiler import STRICT_FLAGS, Compiler, Driver, run_program, section_bytes
from split_cli.export.step_check import (
    OBSERVER_TOLERANCE,
    Intervals,
    check_valid_states,
    compare_drives,
    compare_features,
    compare_linearisation,
    compare_memory,
    compare_observer,
    compare_states,
    make_step_oracle,
)
from split_cli.export.stepped_model import Drives, rk4_substeps
from split_cli.export.symbolic import NominalGraph
from split_cli.export.validity import is_valid
from split_cli.learning.training_set import TrainingSet

OPTIMISATION = "-O2"
SELFTEST_QUERIES = 64


@dataclass(frozen=True)
class CCheck:
    """What compiling and running the exported C found."""

    predictions: PredictionCheck
    # Largest error of step, Runge-Kutta step and linearisation, relative; None when there is no step.
    step_error: float | None
    seconds_predict: float  # processor time of one query, mean and variance [s]
    code_bytes: int | None  # as compiled here
    compiler: str


_CASES = """    case 1:
        @NAME@_step(in, in + @N@@PLACE_TIME@, in[@N@ + 2], out);
        break;
    case 2:
        @NAME@_step_rk4(in, in + @N@@PLACE_TIME@, in[@N@ + 2], @SUBSTEPS@, out);
        break;
    case 3:
        @NAME@_linearise(in, in + @N@@PLACE_TIME@, in[@N@ + 2], out, out + @N@ * @N@);
        break;
    case 4:
        @NAME@_features(in, in + @N@, out);
        break;
    case 13:
        out[0] = (@NAME@_real)@NAME@_valid_state(in, in + @N@);
        break;
    case 12: {
        @NAME@_trust trust;
        memcpy(&trust, in + 2 * @N@ + 5, sizeof trust);
        @NAME@_observe(in, in + @N@@PLACE_TIME@, in[@N@ + 2], @SUBSTEPS@, in + @N@ + 5, &trust);
        memcpy(out, &trust, sizeof trust);
        break;
    }
%if memory
    case 6: {
        int k;
        for (k = 0; k < 8; ++k) {
            out[k] = in[k];
        }
        @NAME@_start(out@PLACE_TIME@);
        break;
    }
    case 7:
        @NAME@_rates(in, in + @N@@ARRIVED@@PLACE_TIME@, out);
        break;
%end
%if delays
    case 8:
        @NAME@_arrived(in, out);
        break;
%end
"""


def build_driver(source: CSource, folder: Path, compiler: Compiler, flags: tuple[str, ...] = (OPTIMISATION,)) -> Driver:
    """Write the C and a driver into `folder`, compile them strictly, return the program.

    Raises
    ------
    ExportError
        If they do not compile without a warning.
    """
    memory = source.memory
    n = 8 if memory is None else memory.whole
    values = {
        "NAME": source.name,
        "DIMENSION": str(source.dimension),
        "N": str(n),
        "PLACE_TIME": f", in[{n} + 3], in[{n} + 4]" if source.place_time else "",
        "SUBSTEPS": str(rk4_substeps(memory)),
        "ARRIVED": f", in + {n} + 5" if memory and memory.line else "",
        "WIDEST_IN": str(max(64, 2 * n + 68)),
        "WIDEST_OUT": str(max(128, n * (n + 2))),
    }
    cases = fill(_CASES, values, memory_parts(memory)) if source.with_step else ""
    values["STEP_CASES"] = cases.rstrip("\n")
    (folder / f"{source.name}.h").write_text(source.header)
    (folder / f"{source.name}.c").write_text(source.source)
    driver = folder / "driver.c"
    driver.write_text(fill(template("driver.c.in"), values))
    program = folder / "driver"
    compiled = compiler.compile(folder / f"{source.name}.c", folder, [*STRICT_FLAGS, *flags])
    compiler.build([compiled, driver], program, [*STRICT_FLAGS, *flags])
    return Driver(program, source.real)


def driver_answer(driver: Driver, dimension: int) -> ExportAnswer:
    """Return the compiled predictor as something `check_predictions` can ask."""

    def predict(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        out = driver.answers(0, z, 6)
        return out[:, :3], out[:, 3:]

    def jacobian(z: np.ndarray) -> np.ndarray:
        return driver.answers(5, z, 3 * dimension).reshape(-1, 3, dimension)

    return ExportAnswer(predict, jacobian)


def check_c(
    source: CSource,
    graph: NominalGraph,
    training_set: TrainingSet,
    oracle: Oracle,
    compiler: Compiler,
    folder: Path,
    selftest: str | None = None,
) -> CCheck:
    """Compile, run and compare everything the C offers, its self-test included.

    Parameters
    ----------
    folder : Path
        For what is compiled.
    selftest : str, optional
        Its source; without it one of predictions alone is run.

    Raises
    ------
    ExportError
        If it does not compile, stops, or differs from Python.
    """
    driver = build_driver(source, folder, compiler)
    answer = driver_answer(driver, source.dimension)
    predictions = check_predictions(answer, oracle, source.real, "C")
    _check_valid(training_set, oracle, driver)
    step_error = _check_step(source, graph, training_set, oracle, driver) if source.with_step else None
    (folder / f"{source.name}_selftest.c").write_text(selftest or selftest_source(source, oracle))
    run_selftest(compiler, folder, source.name)
    inside = oracle.z[np.isfinite(oracle.z).all(axis=1) & (np.abs(oracle.z) < 1e4).all(axis=1)]
    sizes = section_bytes(folder / f"{source.name}.o")
    return CCheck(
        predictions, step_error, driver.seconds_per_query(inside), sizes[0] if sizes else None, compiler.version
    )


def _check_valid(training_set: TrainingSet, oracle: Oracle, driver: Driver) -> None:
    """Compare the valid region with the one training uses, away from its border by more than rounding."""
    slack = 1e-5 if driver.real == "float" else 1e-12
    expected = is_valid(training_set, oracle.z)
    inner, outer = (is_valid(training_set, oracle.z * factor) for factor in (1.0 - slack, 1.0 + slack))
    clear = (inner == expected) & (outer == expected)
    found = driver.answers(11, oracle.z, 1)[:, 0] > 0.5
    wrong = int((found != expected)[clear].sum())
    if wrong or clear.mean() < 0.5:
        what = f"C: the valid region differs at {wrong} of {int(clear.sum())} queries"
        raise ExportError(what, advice=OUR_FAULT)


def run_selftest(compiler: Compiler, folder: Path, name: str) -> str:
    """Compile and run an exported self-test, and return the line it prints.

    Raises
    ------
    ExportError
        If it fails.
    """
    program = folder / "selftest"
    compiled = folder / f"{name}.o"
    if not compiled.is_file():
        compiler.compile(folder / f"{name}.c", folder, [*STRICT_FLAGS, OPTIMISATION])
    compiler.build([compiled, folder / f"{name}_selftest.c"], program, [*STRICT_FLAGS, OPTIMISATION])
    done = run_program([str(program)], b"", "the self-test")
    said: str = done.stdout.decode(errors="replace").strip()
    if done.returncode:
        what = f"the self-test fails: {said or done.stderr.decode(errors='replace').strip()}"
        raise ExportError(what, where=name, advice=OUR_FAULT)
    return said


def selftest_source(
    source: CSource, oracle: Oracle, drives: Drives | None = None, intervals: Intervals | None = None
) -> str:
    """Return the self-test program: Python's answers to queries, drives of a memory, and its running trust."""
    finite = np.flatnonzero((np.abs(oracle.z) < 1e4).all(axis=1))
    rows = finite[:: max(1, len(finite) // SELFTEST_QUERIES)][:SELFTEST_QUERIES]

    def array(name: str, values: np.ndarray) -> str:
        lines = ",\n    ".join("{" + ", ".join(repr(float(v)) for v in row) + "}" for row in values)
        return f"static const double {name}[COUNT][{values.shape[1]}] = {{\n    {lines}\n}};\n"

    queries = array("query", oracle.z[rows])
    queries += array("expected_mean", oracle.mean[rows]) + array("expected_variance", oracle.variance[rows])
    drive = drives if source.memory is not None else None
    if drive is not None:
        count, n = drive.exact.shape[1:]
        # All steps of one drive after the other; states at the start and at the end.
        given = {"drive_u": drive.u, **({"drive_place_time": drive.place_time} if source.place_time else {})}
        for label, values in given.items():
            queries += array(label, values.transpose(1, 0, 2).reshape(-1, 2)).replace("COUNT", "DRIVES * STEPS")
        queries += array("drive_start", drive.exact[0]).replace("COUNT", "DRIVES")
        queries += array("drive_end", drive.exact[-1]).replace("COUNT", "DRIVES")
        queries = f"enum {{ DRIVES = {count}, STEPS = {len(drive.u)}, STATES = {n} }};\n" + queries
    parts = [] if drive is None else ["memory"]
    if intervals is not None:
        parts.append("trust")
        for label, values in (("interval", intervals.asked), ("trust_after", intervals.trust)):
            queries += array(label, values).replace("COUNT", "INTERVALS")
        size = (intervals.asked.shape[1] - 68) // 2
        queries = f"enum {{ INTERVALS = {len(intervals.asked)}, WHOLE = {size} }};\n" + queries
    return fill(
        template("selftest.c.in"),
        {
            "TRUST_TOLERANCE": f"{10.0 * OBSERVER_TOLERANCE[source.real]:g}",
            "SUBSTEPS": str(intervals.substeps if intervals else 0),
            "PLACE_TIME_AT": ", (@NAME@_real)at[0], (@NAME@_real)at[1]".replace("@NAME@", source.name)
            if source.place_time
            else "",
            "DRIVE_TOLERANCE": "1e-8" if source.real == "double" else "1e-2",
            "STEP": repr(float(drive.step)) if drive is not None else "",
            "NAME": source.name,
            "COUNT": str(len(rows)),
            "DIMENSION": str(source.dimension),
            # Another machine's library may round the exponential differently: ten times what is asked here.
            "TOLERANCE": "1e-11" if source.real == "double" else "1e-4",
            "SIGNAL": ", ".join(repr(float(v)) for v in oracle.reference.deviation**2),
            "QUERIES": queries,
        },
        (*parts, *(["measured"] if parts else []), *(["place_time"] if source.place_time else [])),
    )


def _check_step(
    source: CSource, graph: NominalGraph, training_set: TrainingSet, oracle: Oracle, driver: Driver
) -> float:
    """Compare features, both steps and the linearisation with Python; return the states' largest error."""
    steps = make_step_oracle(graph, training_set, oracle.reference, driver.dtype)
    real, n = source.real, steps.size
    features = driver.answers(4, steps.asked, source.dimension)
    compare_features(features, steps, real)
    check_valid_states(lambda asked: driver.answers(13, asked, 1)[:, 0] > 0.5, steps, real, "C")
    linear = driver.answers(3, steps.asked, n * (n + 2))
    parts = [linear[:, : n * n].reshape(-1, n, n), linear[:, n * n :].reshape(-1, n, 2)]
    compare_linearisation(np.concatenate(parts, axis=2), steps, real)
    errors = []
    substeps = rk4_substeps(source.memory)
    compare_observer(lambda asked: driver.answers(12, asked, 63), steps, substeps, real, "C: the running trust")
    if source.memory is not None:
        for function, name, width in ((6, "start", n), (7, "rates", source.memory.continuous), (8, "arrived", 2)):
            if name != "arrived" or source.memory.line:

                def answer(asked: np.ndarray, function: int = function, width: int = width) -> np.ndarray:
                    return driver.answers(function, asked, width)

                errors.append(compare_memory(name, answer, steps, real, "C"))
    for function, kind, what in ((1, "exact", "the step"), (2, "runge_kutta", "the Runge-Kutta step")):

        def step(asked: np.ndarray, function: int = function) -> np.ndarray:
            return driver.answers(function, asked, n)

        errors.append(compare_states(step(steps.asked), getattr(steps, kind), steps, real, f"C: {what}"))
        if steps.drives is not None:
            errors.append(compare_drives(step, steps, kind, real, f"C: {what} over a drive"))
    return max(errors)
