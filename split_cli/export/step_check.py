"""What the exported model step is compared with: Python's own integration plus the residual."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass

import numpy as np

from split_cli.errors import OUR_FAULT, ExportError
from split_cli.export.memory import present
from split_cli.export.reference import Reference
from split_cli.export.stepped_model import Drives, SteppedModel, random_memory, roll_drives
from split_cli.export.symbolic import NominalGraph
from split_cli.export.validity import is_valid_state
from split_cli.learning.running_trust import RunningTrust
from split_cli.learning.training_set import TrainingSet

Stepper = Callable[[np.ndarray], np.ndarray]

STEP_TOLERANCE = {"double": 1e-9, "float": 1e-4}
"""Of the state after a step, relative to 1 + the change of the state (float: + the state): rounding only."""

LINEARISATION_TOLERANCE = {"double": 1e-5, "float": 1e-2}
"""Of an entry, relative to 1 + the entry; the reference's own residual slopes are finite differences."""

OBSERVER_TOLERANCE = {"double": 1e-6, "float": 1e-2}
"""Of the running trust's numbers, relative to 1 + the number: slopes are finite differences."""

_STATES, _OBSERVED = 120, 40


@dataclass(frozen=True)
class StepOracle:
    """States a car can be in, and where Python says they lead."""

    asked: np.ndarray  # (N, n + 5): x (n), u (2), h, t, s; n is 8 without memory
    exact: np.ndarray  # (N, n): linearised exact step, A from the traced model, SciPy's matrix exponential
    runge_kutta: np.ndarray  # (N, n): the model integrated in NumPy, without any tracing
    linear: np.ndarray  # (N, n, n + 2): derivative by (x, u) with A and Phi held
    features: np.ndarray  # (N, D)
    drives: Drives | None  # of a model with memory
    arrived: np.ndarray  # (N, 2): what arrives of the commands of `asked`
    rates: np.ndarray  # (N, 8 + S): right-hand side there
    model: SteppedModel

    @property
    def size(self) -> int:
        """Size n of the whole state."""
        size: int = self.exact.shape[1]
        return size


@dataclass(frozen=True)
class Intervals:
    """Measured intervals, and what Python's running trust makes of them."""

    # (N, 2 n + 68): a row of `StepOracle.asked`, the measured end (n) and the trust before (63).
    asked: np.ndarray
    trust: np.ndarray  # (N, 63): the trust after it
    substeps: int  # of the nominal step

    def first(self, count: int) -> Intervals:
        """Return the first `count` of them."""
        return Intervals(self.asked[:count], self.trust[:count], self.substeps)


def make_step_oracle(
    graph: NominalGraph, training_set: TrainingSet, reference: Reference, dtype: type = np.float64
) -> StepOracle:
    """Step random states with random memories in Python, and drive from steady where there is a memory.

    Raises
    ------
    ExportError
        If the traced model is not the one NumPy evaluates.
    """
    model = SteppedModel(graph, training_set, reference)
    plain = _states(training_set, model.step, dtype)
    u, place_time = plain[:, 8:10], plain[:, 11:]
    x = random_memory(model, plain[:, :8], place_time).astype(dtype).astype(float)
    model.require_slopes(x, place_time)
    exact, recorded = model.one_step(x, u, place_time)
    first, _ = model.arrivals(x, u)
    acting = model.acting(x, first)
    z = model.features(acting, x[:, 6:8], u)[0]
    rates = model.rates(acting, u, model.situation(acting, x[:, 6:8], u, place_time))
    rates[:, 3:6] += reference.predict(z).mean
    asked, linear = np.column_stack([x, plain[:, 8:]]), model.derivative(x, u, place_time)
    drives = None if graph.memory is None else roll_drives(model)
    return StepOracle(asked, exact, recorded, linear, z, drives, first, rates, model)


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

    Raises
    ------
    ExportError
        If the error exceeds `STEP_TOLERANCE`.
    """
    asked = np.column_stack([oracle.asked, oracle.arrived])
    if name.endswith("start"):
        drives = present(oracle.drives)
        steady = drives.exact[0]
        asked = np.zeros((len(steady), asked.shape[1]))
        asked[:, :8] = steady[:, :8]
        asked[:, oracle.size + 3 : oracle.size + 5] = drives.place_time[0]
        expected = steady
    else:
        expected = oracle.rates if name.endswith("rates") else oracle.arrived
    size = np.abs(expected)
    if real == "float":
        # A force on its way to a steady one is a small difference of two that are rounded to seven digits.
        size = size + size.max(axis=0)
    return _require(answer(asked), expected, size, STEP_TOLERANCE[real], f"{what}: {name}")


def observed(oracle: StepOracle, substeps: int) -> Intervals:
    """Return intervals with any evidence before them, and Python's running trust after each."""
    asked, n, model = oracle.asked[:_OBSERVED], oracle.size, copy(oracle.model)
    model.substeps = substeps
    x, u, place_time = asked[:, :n], asked[:, n : n + 2], asked[:, n + 3 :]
    nominal, response = model.nominal_end(x, u, place_time)

    def slopes(apart: float) -> np.ndarray:
        ends = [
            model.nominal_end(x + move, u, place_time)[0] - model.nominal_end(x - move, u, place_time)[0]
            for move in apart * np.eye(n)[3:6]
        ]
        return np.stack(ends, axis=2) / (2.0 * apart)

    near, far = slopes(1e-4), slopes(2e-4)
    rng, count = np.random.default_rng(29), len(x)
    innovation = rng.normal(0.0, 0.1, (count, 3))
    # Evidence of all directions, so that no share rests on a rounding.
    evidence = rng.normal(0.0, 0.3, (count, 3, 4, 4))
    products = (evidence @ evidence.swapaxes(2, 3)).reshape(count, 48)
    before = np.column_stack([rng.uniform(0.0, 1.0, (count, 3)), rng.normal(0.0, 0.1, (count, 12)), products])
    trust, expected = RunningTrust((1.0, 1.0, 1.0), model.step), []
    for numbers, *interval in zip(before, near, innovation, response, strict=True):
        trust.numbers = numbers
        trust.observe(*interval)
        expected.append(trust.numbers)
    x_end = np.column_stack([x[:, :3], nominal + innovation, x[:, 6:]])
    smooth = np.abs(near - far).max(axis=(1, 2)) < OBSERVER_TOLERANCE["double"]  # no kink of the model between
    return Intervals(np.column_stack([asked, x_end, before])[smooth], np.array(expected)[smooth], substeps)


def compare_observer(observe: Stepper, oracle: StepOracle, substeps: int, real: str, what: str) -> float:
    """Return the largest relative error of the trust after the intervals of `observed`; raise as `compare_states`.

    `observe` takes rows to rows; its tolerance is `OBSERVER_TOLERANCE`.
    """
    intervals = observed(oracle, substeps)
    if not len(intervals.asked):
        return 0.0
    after = intervals.trust
    return _require(observe(intervals.asked), after, np.abs(after), OBSERVER_TOLERANCE[real], what)


def compare_linearisation(found: np.ndarray, oracle: StepOracle, real: str) -> float:
    """Return the largest relative error of [A, B], shape (N, n, n + 2); raise as `compare_states` does."""
    return _require(found, oracle.linear, np.abs(oracle.linear), LINEARISATION_TOLERANCE[real], "C: the linearisation")


def check_valid_states(answer: Callable[[np.ndarray], np.ndarray], oracle: StepOracle, real: str, what: str) -> None:
    """Compare which states are valid with Python, at the states of the oracle and at lower speeds to a standstill.

    Parameters
    ----------
    answer : callable
        Rows (N, n + 5) as `StepOracle.asked` to bool (N,).

    Raises
    ------
    ExportError
        If one differs, away from a border by more than rounding.
    """
    trained = oracle.model.training_set
    asked = np.concatenate([oracle.asked] * 4)
    count, slowest = len(oracle.asked), trained.region.minimum_speed
    for k, share in enumerate((0.0, 0.5, 0.99)):
        asked[k * count : (k + 1) * count, 3] = share * slowest
    z = np.concatenate([oracle.features] * 4)
    expected = is_valid_state(trained, z, asked[:, 3])
    slack = 1e-4 if real == "float" else 1e-9
    clear = np.all(
        [is_valid_state(trained, z * factor, asked[:, 3]) == expected for factor in (1 - slack, 1 + slack)], 0
    )
    wrong = int((answer(asked) != expected)[clear].sum())
    if wrong:
        raise ExportError(f"{what}: which states are valid differs at {wrong} of {len(asked)}", advice=OUR_FAULT)


def compare_features(found: np.ndarray, oracle: StepOracle, real: str) -> float:
    """Return the largest relative error of features computed from states; raise as `compare_states` does."""
    tolerance = 1e-12 if real == "double" else 1e-5
    return _require(found, oracle.features, np.abs(oracle.features), tolerance, "C: a feature")


def _require(found: np.ndarray, expected: np.ndarray, size: np.ndarray, tolerance: float, what: str) -> float:
    error = np.abs(found - expected) / (1.0 + size)
    worst = float(np.where(np.isnan(error), np.inf, error).max())
    if not worst <= tolerance:
        raise ExportError(
            f"{what} is {worst:.3g} off Python where {tolerance:g} is allowed; nothing was written", advice=OUR_FAULT
        )
    return worst


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
