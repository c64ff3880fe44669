"""What the exported model step is compared with: Python's own integration plus the residual."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from split_cli.errors import ExportError
from split_cli.export.memory import Memory, exported_model, present
from split_cli.export.memory_check import Drives, MemoryModel, random_memory, roll_drives
from split_cli.export.reference import AnyReference
from split_cli.export.symbolic import NominalGraph
from split_cli.learning.training_set import TrainingSet
from split_cli.vehicle.integration import Situation, exact_step, integrate_recorded, phi_matrix
from split_cli.vehicle.single_track import SingleTrack

__all__ = [
    "RK4_SUBSTEPS",
    "STEP_TOLERANCE",
    "StepOracle",
    "Stepper",
    "compare_drives",
    "compare_features",
    "compare_linearisation",
    "compare_memory",
    "compare_states",
    "make_step_oracle",
    "rk4_substeps",
]

Stepper = Callable[[np.ndarray], np.ndarray]

STEP_TOLERANCE = {"double": 1e-9, "float": 1e-4}
"""Of the state after a step, relative to 1 + the change of the state (float: + the state): rounding only."""

LINEARISATION_TOLERANCE = {"double": 1e-5, "float": 1e-2}
"""Of an entry, relative to 1 + the entry; the reference's own residual slopes are finite differences."""

_DIFFERENCES_TOLERANCE = 1e-5
RK4_SUBSTEPS = 4
_STATES = 120


@dataclass(frozen=True)
class StepOracle:
    """States a car can be in, and where Python says they lead.

    Attributes
    ----------
    asked : ndarray, shape (N, n + 5)
        x (n), u (2), h, t, s; n is 8 without memory.
    exact : ndarray, shape (N, n)
        Linearised exact step, A from the traced model, SciPy's matrix exponential.
    runge_kutta : ndarray, shape (N, n)
        The model integrated in NumPy, without any tracing.
    linear : ndarray, shape (N, n, n + 2)
        Derivative by (x, u) with A and Phi held.
    features : ndarray, shape (N, D)
    drives : Drives or None
        Of a model with memory, as are the following.
    arrived : ndarray, shape (N, 2), or None
        What arrives of the commands of `asked`.
    rates : ndarray, shape (N, 8 + S), or None
        Right-hand side there.
    """

    asked: np.ndarray
    exact: np.ndarray
    runge_kutta: np.ndarray
    linear: np.ndarray
    features: np.ndarray
    drives: Drives | None = None
    arrived: np.ndarray | None = None
    rates: np.ndarray | None = None

    @property
    def size(self) -> int:
        """Size n of the whole state."""
        size: int = self.exact.shape[1]
        return size


def rk4_substeps(memory: Memory | None) -> int:
    """Return the substeps of the Runge-Kutta step that is compared: what states of terms need up to 100 m/s."""
    if memory is None:
        return RK4_SUBSTEPS
    standing, moving = memory.rates
    return max(RK4_SUBSTEPS, 1 + int(np.ceil((standing + 100.0 * moving) * memory.step)))


def make_step_oracle(
    graph: NominalGraph, training_set: TrainingSet, reference: AnyReference, dtype: type = np.float64
) -> StepOracle:
    """Step random states in Python.

    Raises
    ------
    ExportError
        If the traced model is not the one NumPy evaluates.
    """
    if graph.memory is not None:
        return _memory_oracle(graph, training_set, reference, dtype)
    model, h = exported_model(SingleTrack(training_set.vehicle)), training_set.horizon
    asked = _states(training_set, h, dtype)
    x, u = asked[:, :8], asked[:, 8:10]
    rates = [np.array(value) for value in graph.rates.map(len(x))(x[:, 2:].T, asked[:, 11:].T)]
    jacobian = rates[1].reshape(3, len(x), 6).transpose(1, 0, 2)
    z, slopes = (np.array(value) for value in present(graph.features).map(len(x))(x.T, u.T))
    z, slopes = z.T, slopes.reshape(-1, len(x), 10).transpose(1, 0, 2)
    phi = phi_matrix(jacobian[:, :, 1:4], h)
    if training_set.plain:
        phi = np.broadcast_to(np.eye(3), phi.shape)
    change = np.zeros((len(x), 8))
    change[:, 3:6] = h * (phi @ reference.predict(z).mean[:, :, None])[..., 0]
    moved, by_state, by_input = _exponential(*_whole(x, u, rates[0].T, jacobian), h)
    if not graph.needs_place_and_time:
        by_differences = exact_step(model, x, u[:, 0], u[:, 1], h)
        _require(x + moved, by_differences, np.abs(moved), _DIFFERENCES_TOLERANCE, "the traced model")
    torque, steer = (x[:, [6 + k]] + u[:, [k]] * h * np.array([0.0, 1.0]) for k in (0, 1))
    recorded = integrate_recorded(
        model,
        x[:, [0, 1, 2, 3, 4, 5]],
        torque,
        steer,
        h,
        RK4_SUBSTEPS,
        Situation(t=asked[:, 11], s=asked[:, 12]),
    )
    linear = np.concatenate([by_state, by_input], axis=2)
    linear[:, 3:6] += h * phi @ reference.jacobian_by_differences(z) @ slopes
    runge_kutta = np.concatenate([recorded, x[:, 6:] + h * u], axis=1) + change
    return StepOracle(asked, x + moved + change, runge_kutta, linear, z)


def compare_states(found: np.ndarray, expected: np.ndarray, oracle: StepOracle, real: str, what: str) -> float:
    """Return the largest relative error of states after a step.

    Raises
    ------
    ExportError
        If it exceeds `STEP_TOLERANCE`.
    """
    x = oracle.asked[:, : oracle.size]
    # Single precision keeps seven digits of the state, double precision nearly all of its change.
    size = np.abs(expected - x) + (np.abs(x) if real == "float" else 0.0)
    return _require(found, expected, size, STEP_TOLERANCE[real], what)


def compare_drives(step: Stepper, oracle: StepOracle, kind: str, real: str, what: str) -> float:
    """Let an exported step drive from the start, and return the largest relative error on the way.

    Parameters
    ----------
    step : callable
        Rows (N, n + 5) as `StepOracle.asked` to states (N, n).
    oracle : StepOracle
        With drives.
    kind : {"exact", "runge_kutta"}
        Which discretisation `step` is.
    real, what : str

    Raises
    ------
    ExportError
        If it exceeds `STEP_TOLERANCE`, in single precision 50 times that: errors of 40 steps add up.
    """
    drives, h = present(oracle.drives), oracle.asked[0, oracle.size + 2]
    expected: np.ndarray = getattr(drives, kind)
    x, path = expected[0], [expected[0]]
    for u, place_time in zip(drives.u, drives.place_time, strict=True):
        x = step(np.column_stack([x, u, np.full(len(x), h), place_time]))
        path.append(x)
    tolerance = STEP_TOLERANCE[real] * (50.0 if real == "float" else 1.0)
    return _require(np.stack(path), expected, np.abs(expected), tolerance, what)


def compare_memory(name: str, answer: Stepper, oracle: StepOracle, real: str, what: str) -> float:
    """Compare start, right-hand side or arriving commands, whichever `name` ends in, with Python.

    Parameters
    ----------
    name : str
        Ends in ``start``, ``rates`` or ``arrived``.
    answer : callable
        Rows (N, n + 7), as `StepOracle.asked` with what arrives appended, to answers.
    oracle : StepOracle
    real, what : str

    Raises
    ------
    ExportError
        If the error exceeds `STEP_TOLERANCE`.
    """
    asked = np.column_stack([oracle.asked, present(oracle.arrived)])
    if name.endswith("start"):
        drives = present(oracle.drives)
        steady = drives.exact[0]
        asked = np.zeros((len(steady), asked.shape[1]))
        asked[:, :8] = steady[:, :8]
        asked[:, oracle.size + 3 : oracle.size + 5] = drives.place_time[0]
        expected = steady
    else:
        expected = present(oracle.rates if name.endswith("rates") else oracle.arrived)
    size = np.abs(expected)
    if real == "float":
        # A force on its way to a steady one is a small difference of two that are rounded to seven digits.
        size = size + size.max(axis=0)
    return _require(answer(asked), expected, size, STEP_TOLERANCE[real], f"{what}: {name}")


def compare_linearisation(found: np.ndarray, oracle: StepOracle, real: str, what: str) -> float:
    """Return the largest relative error of [A, B], shape (N, n, n + 2); raise as `compare_states` does."""
    return _require(found, oracle.linear, np.abs(oracle.linear), LINEARISATION_TOLERANCE[real], what)


def compare_features(found: np.ndarray, oracle: StepOracle, real: str) -> float:
    """Return the largest relative error of features computed from states; raise as `compare_states` does."""
    tolerance = 1e-12 if real == "double" else 1e-5
    return _require(found, oracle.features, np.abs(oracle.features), tolerance, "C: a feature")


def _require(found: np.ndarray, expected: np.ndarray, size: np.ndarray, tolerance: float, what: str) -> float:
    error = np.abs(found - expected) / (1.0 + size)
    worst = float(np.where(np.isnan(error), np.inf, error).max())
    if not worst <= tolerance:
        raise ExportError(f"{what} is {worst:.3g} off Python where {tolerance:g} is allowed; nothing was written")
    return worst


def _memory_oracle(
    graph: NominalGraph, training_set: TrainingSet, reference: AnyReference, dtype: type
) -> StepOracle:
    """Step random states with random memories, and drive from steady, in Python."""
    memory = present(graph.memory)
    h = memory.step
    plain = _states(training_set, h, dtype)
    place_time, u = plain[:, 11:], plain[:, 8:10]
    x = random_memory(graph, plain[:, :8], place_time).astype(dtype).astype(float)
    model = MemoryModel(graph, training_set, reference, rk4_substeps(memory))
    model.require_slopes(x, place_time)
    exact, recorded = model.one_step(x, u, place_time)
    first, _ = model.arrivals(x, u)
    acting = np.column_stack([x[:, :6], first, x[:, 8 : memory.continuous]])
    z = model.features(acting, x[:, 6:8], u)[0]
    asked = np.column_stack([x, plain[:, 8:]])
    linear = model.derivative(x, u, place_time)
    rates = model.rates(acting, u, place_time)
    rates[:, 3:6] += reference.predict(z).mean
    return StepOracle(asked, exact, recorded, linear, z, roll_drives(model), first, rates)


def _states(training_set: TrainingSet, h: float, dtype: type) -> np.ndarray:
    """Return random [x, u, h, t, s] rounded to `dtype`, shape (N, 13)."""
    rng = np.random.default_rng(11)
    car, slowest = training_set.vehicle, training_set.region.minimum_speed

    def between(low: float, high: float) -> np.ndarray:
        return rng.uniform(low, high, _STATES)

    vx = between(slowest, 8.0 * slowest)
    columns = [
        between(-100.0, 100.0),
        between(-100.0, 100.0),
        between(-np.pi, np.pi),
        vx,
        vx * between(-0.1, 0.1),
        vx / car.wheelbase * between(-0.08, 0.08),
        between(-car.max_brake_torque, car.max_torque),
        between(-0.15, 0.15),
        car.max_torque * between(-1.0, 1.0),
        between(-0.5, 0.5),
        np.full(_STATES, h),
        between(0.0, 60.0),
        between(0.0, 900.0),
    ]
    return np.column_stack(columns).astype(dtype).astype(float)


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
    """Return phi_1(A h) h f, exp(A h) and the response to each input's rate."""
    augmented = np.zeros((len(A), 11, 11))
    augmented[:, :8, :8] = A
    augmented[:, :8, 8] = f
    augmented[:, 6, 9] = augmented[:, 7, 10] = 1.0
    exponential = scipy.linalg.expm(augmented * h)
    return exponential[:, :8, 8], exponential[:, :8, :8], exponential[:, :8, 9:]
