"""The valid region of a trained model as one loop-free function."""

import casadi
import numpy as np

from split_cli.export.casadi_step import features_of, step_arguments
from split_cli.export.symbolic import NominalGraph
from split_cli.learning.training_set import TrainingSet


def valid_function(training_set: TrainingSet, name: str = "valid") -> casadi.Function:
    """Return z (D) to 1 where training would have accepted it, 0 elsewhere and for what is not a number.

    A feature lies within its grid, or, where the grid has no bound, within the range of the points. For z2 the
    slip angles, their difference and the force ellipse of both axles hold as well (`learning.region.Region`).
    Speed is no feature of z2: `valid_state_function` asks for it too.
    """
    s = training_set
    z = casadi.SX.sym("z", len(s.features.names))
    lower, upper = _bounds(s)
    conditions = [z[d] >= float(lower[d]) for d in range(len(lower))]
    conditions += [z[d] <= float(upper[d]) for d in range(len(upper))]
    if s.features.is_z2:
        conditions += _region(s, z[0], z[1], z[2])
    valid = conditions[0]
    for condition in conditions[1:]:
        valid = casadi.logic_and(valid, condition)
    return casadi.Function(name, [z], [valid], ["z"], ["valid"])


def valid_state_function(
    training_set: TrainingSet, graph: NominalGraph, valid: casadi.Function, name: str = "valid_state"
) -> casadi.Function:
    """Return (x, u) to 1 where training would have accepted the state, its speed included, 0 elsewhere.

    Parameters
    ----------
    graph : NominalGraph
        With features; x is the whole state of its step.
    valid : casadi.Function
        As `valid_function` returns it.
    """
    given = step_arguments(graph)
    x, u = given["x"], given["u"]
    z = features_of(graph, x, u)
    fast = x[3] > training_set.region.minimum_speed
    return casadi.Function(name, [x, u], [casadi.logic_and(fast, valid(z))], ["x", "u"], ["valid"])


def is_valid_state(training_set: TrainingSet, z: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return what `valid_state_function` must answer, of features (N, D) and v_x (N,) [m/s], bool shape (N,)."""
    inside: np.ndarray = is_valid(training_set, z) & (speed > training_set.region.minimum_speed)
    return inside


def is_valid(training_set: TrainingSet, z: np.ndarray) -> np.ndarray:
    """Return what `valid_function` must answer, from the region's own NumPy, bool shape (N,)."""
    s, region = training_set, training_set.region
    lower, upper = _bounds(s)
    with np.errstate(invalid="ignore", over="ignore"):
        inside: np.ndarray = np.all((z >= lower) & (z <= upper), axis=1)
        if s.features.is_z2:
            inside &= region.inside_slip(z[:, 0], z[:, 1]) & region.inside_slip_difference(z[:, 0], z[:, 1])
            inside &= region.inside_ellipse(s.vehicle, z[:, 0], z[:, 1], z[:, 2] * s.vehicle.max_torque)
    return inside


def _bounds(s: TrainingSet) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = np.array(s.grid.lower), np.array(s.grid.upper)
    return (np.where(np.isfinite(lower), lower, s.z.min(axis=0)), np.where(np.isfinite(upper), upper, s.z.max(axis=0)))


def _region(s: TrainingSet, front: casadi.SX, rear: casadi.SX, ratio: casadi.SX) -> list[casadi.SX]:
    region, car = s.region, s.vehicle
    conditions = [casadi.fabs(front) <= region.alpha_max, casadi.fabs(rear) <= region.alpha_max]
    conditions.append(casadi.fabs(front - rear) <= region.dalpha_max)
    torque = ratio * car.max_torque
    kappa = casadi.if_else(torque < 0.0, car.brake_split_front, car.drive_split_front)
    force = torque / car.wheel_radius
    for tire, alpha, force_x in (
        (car.front_tire, front, kappa * force - car.rolling_resistance_front),
        (car.rear_tire, rear, (1.0 - kappa) * force - car.rolling_resistance_rear),
    ):
        force_y = tire.D * casadi.sin(tire.C * casadi.atan(tire.B * alpha))
        conditions.append((region.p_long * force_x) ** 2 + force_y**2 <= (region.p_ellipse * tire.D) ** 2)
    return conditions
