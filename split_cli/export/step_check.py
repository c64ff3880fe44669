"""What the exported model step is compared with: Python's own integration plus the residual."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from split_cli.errors import ExportError
from split_cli.export.reference import Reference
from split_cli.export.symbolic import NominalGraph
from split_cli.learning.training_set import TrainingSet
from split_cli.vehicle.integration import exact_step, integrate_recorded, phi_matrix
from split_cli.vehicle.single_track import SingleTrack

__all__ = [
    "RK4_SUBSTEPS",
    "STEP_TOLERANCE",
    "StepOracle",
    "compare_features",
    "compare_linearisation",
    "compare_states",
    "make_step_oracle",
]

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
    asked : ndarray, shape (N, 13)
        x (8), u (2), h, t, s.
    exact : ndarray, shape (N, 8)
        Linearised exact step, A from the traced model, SciPy's matrix exponential.
    runge_kutta : ndarray, shape (N, 8)
        The model integrated in NumPy, without any tracing.
    linear : ndarray, shape (N, 8, 10)
        Derivative by (x, u) with A and Phi held.
    features : ndarray, shape (N, D)
    """

    asked: np.ndarray
    exact: np.ndarray
    runge_kutta: np.ndarray
    linear: np.ndarray
    features: np.ndarray


def make_step_oracle(
    graph: NominalGraph, training_set: TrainingSet, reference: Reference, dtype: type = np.float64
) -> StepOracle:
    """Step random states in Python.

    Raises
    ------
    ExportError
        If the traced model is not the one NumPy evaluates.
    """
    model, h = SingleTrack(training_set.vehicle), training_set.horizon
    asked = _states(training_set, dtype)
    x, u = asked[:, :8], asked[:, 8:10]
    rates = [np.array(value) for value in graph.rates.map(len(x))(x[:, 2:].T, asked[:, 11:].T)]
    jacobian = rates[1].reshape(3, len(x), 6).transpose(1, 0, 2)
    z, slopes = (np.array(value) for value in graph.features.map(len(x))(x.T, u.T))
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
        time=asked[:, 11],
        track_position=asked[:, 12],
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
    x = oracle.asked[:, :8]
    # Single precision keeps seven digits of the state, double precision nearly all of its change.
    size = np.abs(expected - x) + (np.abs(x) if real == "float" else 0.0)
    return _require(found, expected, size, STEP_TOLERANCE[real], what)


def compare_linearisation(found: np.ndarray, oracle: StepOracle, real: str, what: str) -> float:
    """Return the largest relative error of [A, B], shape (N, 8, 10); raise as `compare_states` does."""
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


def _states(training_set: TrainingSet, dtype: type) -> np.ndarray:
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
        np.full(_STATES, training_set.horizon),
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
