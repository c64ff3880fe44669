"""The exported C, compiled and compared with Python: predictions, Jacobians and the model step."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg

from split_cli.errors import ExportError
from split_cli.export.c99 import CSource, fill, template
from split_cli.export.check import Answer, Oracle, PredictionCheck, check_predictions
from split_cli.export.compiler import STRICT_FLAGS, Compiler, Driver
from split_cli.export.symbolic import NominalGraph
from split_cli.learning.training_set import TrainingSet
from split_cli.vehicle.integration import exact_step, integrate_recorded, phi_matrix
from split_cli.vehicle.single_track import SingleTrack

__all__ = ["CCheck", "build_driver", "check_c", "driver_answer", "selftest_source"]

OPTIMISATION = "-O2"
SELFTEST_QUERIES = 64
STEP_TOLERANCE = {"double": 1e-9, "float": 1e-4}
"""Of the state after a step, relative to 1 + |change of the state| a unit: rounding of both sides only."""

DIFFERENCES_TOLERANCE = 1e-5
"""The same against `exact_step`, whose Jacobian comes from finite differences."""

_STATES = 300


@dataclass(frozen=True)
class CCheck:
    """What compiling and running the exported C found.

    Attributes
    ----------
    predictions : PredictionCheck
    step_error : float or None
        Largest error of step, Runge-Kutta step and linearisation, relative; None when there is no step.
    seconds_predict, seconds_jacobian : float
        Processor time of one query [s], for mean and variance, and for all three.
    code_bytes, constant_bytes : int or None
        As compiled here.
    compiler : str
    """

    predictions: PredictionCheck
    step_error: float | None
    seconds_predict: float
    seconds_jacobian: float
    code_bytes: int | None
    constant_bytes: int | None
    compiler: str


_CASES = """    case 1:
        @NAME@_step(in, in + 8@PLACE_TIME@, in[10], out);
        break;
    case 2:
        @NAME@_step_rk4(in, in + 8@PLACE_TIME@, in[10], 4, out);
        break;
    case 3:
        @NAME@_linearise(in, in + 8@PLACE_TIME@, in[10], out, out + 64);
        break;
    case 4:
        @NAME@_features(in, in + 8, out);
        break;
"""


def build_driver(
    source: CSource, folder: Path, compiler: Compiler, flags: tuple[str, ...] = (OPTIMISATION,)
) -> Driver:
    """Write the C and a driver into `folder`, compile them strictly, return the program.

    Raises
    ------
    ExportError
        If they do not compile without a warning.
    """
    place_time = ", in[11], in[12]" if source.place_time else ""
    cases = fill(_CASES, {"NAME": source.name, "PLACE_TIME": place_time}) if source.with_step else ""
    values = {"NAME": source.name, "DIMENSION": str(source.dimension), "STEP_CASES": cases.rstrip("\n")}
    (folder / f"{source.name}.h").write_text(source.header)
    (folder / f"{source.name}.c").write_text(source.source)
    driver = folder / "driver.c"
    driver.write_text(fill(template("driver.c.in"), values))
    program = folder / "driver"
    compiler.build([folder / f"{source.name}.c", driver], program, [*STRICT_FLAGS, *flags])
    return Driver(program, source.real)


def driver_answer(driver: Driver, dimension: int) -> Answer:
    """Return the compiled predictor as something `check_predictions` can ask."""

    def answer(z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        out = driver.answers(0, z, 6 + 3 * dimension)
        return out[:, :3], out[:, 3:6], out[:, 6:].reshape(-1, 3, dimension)

    return answer


def check_c(
    source: CSource, graph: NominalGraph, training_set: TrainingSet, oracle: Oracle, compiler: Compiler, folder: Path
) -> CCheck:
    """Compile, run and compare everything the C offers, its self-test included.

    Raises
    ------
    ExportError
        If it does not compile, stops, or differs from Python.
    """
    driver = build_driver(source, folder, compiler)
    answer = driver_answer(driver, source.dimension)
    predictions = check_predictions(answer, oracle, source.real, "C")
    step_error = _check_step(source, graph, training_set, oracle, driver) if source.with_step else None
    selftest = folder / f"{source.name}_selftest.c"
    selftest.write_text(selftest_source(source, oracle))
    run_selftest(compiler, folder, source.name)
    inside = oracle.z[np.isfinite(oracle.z).all(axis=1) & (np.abs(oracle.z) < 1e4).all(axis=1)]
    sizes = compiler.text_bytes(folder / f"{source.name}.c", folder, [*STRICT_FLAGS, OPTIMISATION])
    return CCheck(
        predictions,
        step_error,
        driver.seconds_per_query(inside),
        driver.seconds_per_query(inside, with_jacobian=True),
        *(sizes or (None, None)),
        compiler.version,
    )


def run_selftest(compiler: Compiler, folder: Path, name: str) -> str:
    """Compile and run an exported self-test, and return the line it prints.

    Raises
    ------
    ExportError
        If it fails.
    """
    import subprocess

    program = folder / "selftest"
    compiler.build([folder / f"{name}.c", folder / f"{name}_selftest.c"], program, [*STRICT_FLAGS, OPTIMISATION])
    done = subprocess.run([str(program)], capture_output=True, text=True, timeout=120, check=False)
    if done.returncode:
        raise ExportError(f"the self-test fails: {done.stdout.strip() or done.stderr.strip()}", where=name)
    return done.stdout.strip()


def selftest_source(source: CSource, oracle: Oracle) -> str:
    """Return the self-test program: queries with Python's answers, no input needed."""
    finite = np.flatnonzero((np.abs(oracle.z) < 1e4).all(axis=1))
    rows = finite[:: max(1, len(finite) // SELFTEST_QUERIES)][:SELFTEST_QUERIES]

    def array(name: str, values: np.ndarray) -> str:
        lines = ",\n    ".join("{" + ", ".join(repr(float(v)) for v in row) + "}" for row in values)
        return f"static const double {name}[COUNT][{values.shape[1]}] = {{\n    {lines}\n}};\n"

    queries = array("query", oracle.z[rows])
    queries += array("expected_mean", oracle.mean[rows]) + array("expected_variance", oracle.variance[rows])
    return fill(
        template("selftest.c.in"),
        {
            "NAME": source.name,
            "COUNT": str(len(rows)),
            "DIMENSION": str(source.dimension),
            # Another machine's library may round the exponential differently: ten times what is asked here.
            "TOLERANCE": "1e-11" if source.real == "double" else "1e-4",
            "SIGNAL": ", ".join(repr(float(v)) for v in oracle.reference.deviation**2),
            "QUERIES": queries,
        },
    )


def _check_step(
    source: CSource, graph: NominalGraph, training_set: TrainingSet, oracle: Oracle, driver: Driver
) -> float:
    """Compare both steps and the linearisation with Python; return the largest relative error."""
    model, h = SingleTrack(training_set.vehicle), training_set.horizon
    asked = _states(training_set, driver.dtype)
    x, u = asked[:, :8], asked[:, 8:10]
    rates = [np.array(value) for value in graph.rates.map(len(x))(x[:, 2:].T, asked[:, 11:13].T)]
    jacobian = rates[1].reshape(3, len(x), 6).transpose(1, 0, 2)
    z, slopes = (np.array(value) for value in graph.features.map(len(x))(x.T, u.T))
    z, slopes = z.T, slopes.reshape(source.dimension, len(x), 10).transpose(1, 0, 2)
    g = oracle.reference.predict(z).mean
    phi = np.eye(3) if training_set.plain else phi_matrix(jacobian[:, :, 1:4], h)
    change = np.zeros((len(x), 8))
    change[:, 3:6] = h * np.einsum("nij,nj->ni", np.broadcast_to(phi, (len(x), 3, 3)), g)
    A, f = _whole(x, u, rates[0].T, jacobian)
    discrete = _exponential(A, f, h)
    errors = [_relative(driver.answers(1, asked, 8), x + discrete[0] + change, x, source.real, "step")]
    place_time = {"time": asked[:, 11], "track_position": asked[:, 12]}
    if not source.place_time:
        by_differences = exact_step(model, x, u[:, 0], u[:, 1], h) + change
        slack = max(DIFFERENCES_TOLERANCE, STEP_TOLERANCE[source.real])
        _relative(driver.answers(1, asked, 8), by_differences, x, source.real, "step", slack)
    torque, steer = (x[:, [6 + k]] + u[:, [k]] * h * np.array([0.0, 1.0]) for k in (0, 1))
    recorded = integrate_recorded(model, x[:, :6], torque, steer, h, 4, **place_time)
    recorded = np.concatenate([recorded, x[:, 6:] + h * u], axis=1) + change
    errors.append(_relative(driver.answers(2, asked, 8), recorded, x, source.real, "Runge-Kutta step"))
    reference = oracle.reference.jacobian_by_differences(z)
    linear = np.concatenate([discrete[1], discrete[2]], axis=2)
    linear[:, 3:6] += h * np.broadcast_to(phi, (len(x), 3, 3)) @ reference @ slopes
    found = driver.answers(3, asked, 80)
    found = np.concatenate([found[:, :64].reshape(-1, 8, 8), found[:, 64:].reshape(-1, 8, 2)], axis=2)
    scale = 1.0 + np.abs(linear)
    worst = float((np.abs(found - linear) / scale).max())
    allowed = 1e-5 if source.real == "double" else 1e-2
    if not worst <= allowed:
        raise ExportError(f"C: the linearisation is {worst:.3g} off Python where {allowed:g} is allowed")
    return max(errors)


def _states(training_set: TrainingSet, dtype: type) -> np.ndarray:
    """Return random [x, u, h, t, s] a car can be in, rounded to `dtype`, shape (N, 13)."""
    rng = np.random.default_rng(11)
    car = training_set.vehicle
    speed = rng.uniform(training_set.region.minimum_speed, 8.0 * training_set.region.minimum_speed, _STATES)
    columns = [
        rng.uniform(-100.0, 100.0, (2, _STATES)),
        rng.uniform(-np.pi, np.pi, (1, _STATES)),
        [speed, speed * rng.uniform(-0.1, 0.1, _STATES)],
        [speed / car.wheelbase * rng.uniform(-0.08, 0.08, _STATES)],
        [rng.uniform(-car.max_brake_torque, car.max_torque, _STATES), rng.uniform(-0.15, 0.15, _STATES)],
        [rng.uniform(-1.0, 1.0, _STATES) * car.max_torque, rng.uniform(-0.5, 0.5, _STATES)],
        [np.full(_STATES, training_set.horizon), rng.uniform(0.0, 60.0, _STATES), rng.uniform(0.0, 900.0, _STATES)],
    ]
    return np.concatenate([np.asarray(column) for column in columns]).T.astype(dtype).astype(float)


def _whole(x: np.ndarray, u: np.ndarray, rates: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return A (N, 8, 8) and f (N, 8) of the whole state from the velocities' rates and Jacobian."""
    sine, cosine = np.sin(x[:, 2]), np.cos(x[:, 2])
    east, north = x[:, 3] * cosine - x[:, 4] * sine, x[:, 3] * sine + x[:, 4] * cosine
    A = np.zeros((len(x), 8, 8))
    A[:, 0, 2], A[:, 0, 3], A[:, 0, 4] = -north, cosine, -sine
    A[:, 1, 2], A[:, 1, 3], A[:, 1, 4] = east, sine, cosine
    A[:, 2, 5] = 1.0
    A[:, 3:6, 2:8] = jacobian
    return A, np.column_stack([east, north, x[:, 5], rates, u])


def _exponential(A: np.ndarray, f: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return phi_1(A h) h f, exp(A h) and the response to each input's rate, by SciPy's matrix exponential."""
    augmented = np.zeros((len(A), 11, 11))
    augmented[:, :8, :8] = A
    augmented[:, :8, 8] = f
    augmented[:, 6, 9] = augmented[:, 7, 10] = 1.0
    exponential = scipy.linalg.expm(augmented * h)
    return exponential[:, :8, 8], exponential[:, :8, :8], exponential[:, :8, 9:]


def _relative(
    found: np.ndarray, expected: np.ndarray, x: np.ndarray, real: str, what: str, tolerance: float | None = None
) -> float:
    tolerance = STEP_TOLERANCE[real] if tolerance is None else tolerance
    # Single precision keeps seven digits of the state itself, double precision of its change.
    size = np.abs(x) + np.abs(expected - x) if real == "float" else np.abs(expected - x)
    worst = float((np.abs(found - expected) / (1.0 + size)).max())
    if not worst <= tolerance:
        raise ExportError(f"C: the {what} is {worst:.3g} off Python where {tolerance:g} is allowed")
    return worst


def public_functions(header: str) -> tuple[str, ...]:
    """Return the names of the functions a header declares."""
    return tuple(re.findall(r"^void (\w+)\(", header, re.MULTILINE))
