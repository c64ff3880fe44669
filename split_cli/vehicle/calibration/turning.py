"""Yaw inertia and torque splits, from the turns and transients that show them."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from split_cli.vehicle.calibration.least_squares import solve
from split_cli.vehicle.calibration.samples import MotionSamples, axle_lateral_forces
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import MagicFormula, lateral_force, lateral_force_slope


@dataclass(frozen=True)
class IntervalEstimate:
    """One number with its 95 % interval."""

    name: str  # key of the vehicle file
    # value, error: estimate and half width, in the key's unit.
    value: float
    error: float
    settled: bool  # whether the data settle it; if not, the start value is kept


def _tire_columns(slip: np.ndarray, tire: MagicFormula) -> np.ndarray:
    """Return dF/d(log K, log D) of an axle [N], the directions in which its curve may give way."""
    force = lateral_force(tire.B, tire.C, tire.D, slip)
    along = lateral_force_slope(tire.B, tire.C, tire.D, slip) * slip
    return np.column_stack([along, force - along])


def estimate_yaw_inertia(samples: MotionSamples, vehicle: Vehicle) -> IntervalEstimate:
    """Estimate I_z with both axles' curves free to give way, linearised about `vehicle`.

    Notes
    -----
    In F_f = (m a_y l_r + I_z r')/L and F_r = (m a_y l_f - I_z r')/L the inertia multiplies r', which steady
    turning lacks; settled when the interval's half width is below 10 %. Noise in r' shrinks the estimate by the
    share it has in what is left of r' beside the other columns, so that share is given back.
    """
    front_tire, rear_tire = vehicle.front_tire, vehicle.rear_tire
    front, rear = axle_lateral_forces(samples, vehicle)
    lever = samples.yaw_acceleration / vehicle.wheelbase
    count = len(samples)
    jacobian = np.zeros((2 * count, 5))
    jacobian[:count, :2], jacobian[:count, 4] = _tire_columns(samples.slip_front, front_tire), -lever
    jacobian[count:, 2:4], jacobian[count:, 4] = _tire_columns(samples.slip_rear, rear_tire), lever
    error = np.concatenate(
        [
            lateral_force(front_tire.B, front_tire.C, front_tire.D, samples.slip_front) - front,
            lateral_force(rear_tire.B, rear_tire.C, rear_tire.D, samples.slip_rear) - rear,
        ]
    )
    change, half_width = _linear(jacobian, error, np.tile(samples.block, 2))
    others = jacobian[:, :4]
    alone = jacobian[:, 4] - others @ np.linalg.lstsq(others, jacobian[:, 4], rcond=None)[0]
    noise = float(np.mean(samples.yaw_acceleration_noise**2)) / vehicle.wheelbase**2
    share = noise / max(float(np.mean(alone**2)), 1e-300)
    if share > 0.5:
        return IntervalEstimate("yaw_inertia", vehicle.yaw_inertia, float("inf"), False)
    seen = vehicle.yaw_inertia + change
    value = seen / (1.0 - share)
    # The noise level itself is known to about half.
    width = float(np.hypot(half_width, 0.5 * (value - seen)))
    return IntervalEstimate("yaw_inertia", value, width, value > 0 and width < 0.1 * value)


def estimate_splits(samples: MotionSamples, vehicle: Vehicle) -> tuple[IntervalEstimate, ...]:
    """Estimate the front share of driving and of braking torque from what it adds across the car in turns.

    Notes
    -----
    P_f = F_fy cos delta + (kappa T/r_e - C_fr) sin delta; kappa is seen through T sin delta alone, so it needs
    torque in tight turns. Settled when the interval's half width is below 0.1.
    """
    across, _ = axle_lateral_forces(samples, vehicle)
    tire = vehicle.front_tire
    error = lateral_force(tire.B, tire.C, tire.D, samples.slip_front) - across
    # axle_lateral_forces divides by cos delta, and so does what kappa adds.
    lever = samples.T / vehicle.wheel_radius * np.tan(samples.delta)
    estimates = []
    for name, rows in (("drive_split_front", samples.T >= 0.0), ("brake_split_front", samples.T < 0.0)):
        start = getattr(vehicle, name)
        if np.count_nonzero(rows) < 60 or len(np.unique(samples.block[rows])) < 6:
            estimates.append(IntervalEstimate(name, start, float("inf"), False))
            continue
        jacobian = np.column_stack([_tire_columns(samples.slip_front, tire), np.where(rows, lever, 0.0)])
        change, half_width = _linear(jacobian, error, samples.block)
        value = float(np.clip(start + change, 0.0, 1.0))
        estimates.append(IntervalEstimate(name, value, half_width, half_width < 0.1))
    return tuple(estimates)


def _linear(jacobian: np.ndarray, error: np.ndarray, block: np.ndarray) -> tuple[float, float]:
    """Return the robust estimate of the last coefficient and the half width of its 95 % interval."""
    size = np.sqrt(np.mean(jacobian**2, axis=0))
    scaled = jacobian / np.where(size > 0, size, 1.0)

    def residual(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return error + scaled @ p, scaled

    unbounded = np.full(jacobian.shape[1], np.inf)
    fit = solve(residual, np.zeros(jacobian.shape[1]), -unbounded, unbounded)
    if size[-1] == 0:
        return 0.0, float("inf")
    return float(fit.parameters[-1] / size[-1]), 1.96 * float(np.sqrt(fit.covariance(block)[-1, -1]) / size[-1])


def with_estimates(vehicle: Vehicle, estimates: tuple[IntervalEstimate, ...]) -> Vehicle:
    """Return the vehicle with the settled estimates in it."""
    settled: dict[str, Any] = {e.name: e.value for e in estimates if e.settled}
    return replace(vehicle, **settled)
