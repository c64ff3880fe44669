"""Physics that simulation and reality share and the nominal model lacks: a dictionary with priors.

Tangents of catalogue terms come first, since what a single track lacks against a real car is mostly of that kind;
smooth functions of slip angles, torque and speed, mirror-symmetric, take the rest. The weights are learned on the
simulation; reality is judged with what the simulation leaves uncertain about them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from split_cli.diagnosis.series import Series, extended_model
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.effects.recording import first_order_response
from split_cli.vehicle.parameters import Vehicle

__all__ = ["CommonPhysics", "build_common_physics"]

# (term, variant, parameter, step from neutral): the step is both the tangent's width and the prior deviation.
_TANGENTS = (
    ("combined_slip", "", "strength", 0.5),
    ("load_transfer", "", "cg_height", 0.2),
    ("load_transfer", "peak", "cg_height", 0.2),
    ("friction_scale", "", "scale", -0.15),
    ("tire_stiffness", "", "front_scale", 0.15),
    ("tire_stiffness", "", "rear_scale", 0.15),
    ("aero_downforce", "", "front", 0.3),
    ("aero_downforce", "", "rear", 0.3),
    ("aero_drag", "", "drag", 0.2),
    ("rolling_resistance", "", "force", 0.01),
    ("yaw_moment_differential", "", "yaw_damping", 0.2),
    ("drive_gain", "", "drive_gain", 0.1),
    ("drive_gain", "", "brake_gain", 0.1),
    ("drive_lag", "", "tau", 0.03),
    ("drive_lag", "", "tau", 0.10),
    ("steer_gain", "", "gain", 0.05),
    ("steer_lag", "", "tau", 0.02),
    ("steer_lag", "", "tau", 0.06),
    ("tire_relaxation", "", "length", 0.15),
    ("tire_relaxation", "", "length", 0.5),
    ("mass", "", "scale", 0.1),
    ("yaw_inertia", "", "scale", 0.1),
    ("cg_shift", "", "dx", 0.03),
)  # fmt: skip
_SMOOTH_DEVIATION = 0.03  # prior deviation of a smooth function's weight, as a share of an axle's peak

_MEMORY_SECONDS = (0.03, 0.1, 0.35)  # for a full-size car; times shrink with the root of length


@dataclass(frozen=True)
class CommonPhysics:
    """The dictionary, scaled so that every weight has a standard normal prior.

    Attributes
    ----------
    vehicle : Vehicle
    center, width : ndarray, shape (4,)
        Of alpha_f, alpha_r [rad], T/T_max [1] and v_x [m/s], for the smooth functions.
    """

    vehicle: Vehicle
    center: np.ndarray
    width: np.ndarray

    @property
    def _peak(self) -> float:
        return 0.5 * (self.vehicle.front_tire.D + self.vehicle.rear_tire.D)

    def columns(self, series: Series) -> np.ndarray:
        """Return the rates each entry adds along a recording, shape (N, 3, C) [m/s^2], [m/s^2], [rad/s^2]."""
        plain = series.rates(extended_model(self.vehicle))
        columns = [self._tangent(series, plain, *entry) for entry in _TANGENTS]
        columns += self._smooth(series)
        columns += self._memory(series)
        return np.stack(columns, axis=2)

    def rates(self, series: Series, weights: np.ndarray, terms: Sequence[Term] = ()) -> np.ndarray:
        """Return what the weights add along a recording, shape (N, 3), where `terms` alter inputs or sensors.

        What the actuators really did, and where the car really was, is what common physics answers to.
        """
        _, smooth = series.corrected(terms)
        flow = series.flow(extended_model(self.vehicle, terms), smooth)
        actual = replace(
            series, smooth=smooth, torque=flow.T + 0.0 * series.t, steer_angle=flow.delta + 0.0 * series.t
        )
        return self.columns(actual) @ weights

    def _tangent(self, series, plain, name, variant, parameter, step) -> np.ndarray:
        kind, car = CATALOGUE[name], self.vehicle
        scaled = step * natural_unit(car, name, parameter)
        neutral = {key: kind.neutral[key] for key in kind.units}
        term = kind({**neutral, parameter: kind.neutral[parameter] + scaled}, variant)
        return series.rates(extended_model(car, (term,))) - plain

    def _smooth(self, series: Series) -> list[np.ndarray]:
        a, b, c, v = _squash(features(series, self.vehicle), self.center, self.width).T
        direction = self.vehicle.force_matrix() * self._peak * _SMOOTH_DEVIATION
        even, odd = [], []
        for i, j, k, m in product(range(5), range(5), range(5), range(5)):
            if i + j + k + m > 4:
                continue
            function = a**i * b**j * c**k * v**m
            (odd if (i + j) % 2 else even).append(function)
        even.append(np.abs(c))
        odd += [a * np.abs(c), b * np.abs(c), np.abs(a) * a, np.abs(b) * b]
        out = [f[:, None] * direction[:, 0] for f in even]
        out += [f[:, None] * direction[:, 1] for f in odd]
        out += [f[:, None] * direction[:, 2] for f in odd]
        return out

    def _memory(self, series: Series) -> list[np.ndarray]:
        """Slow parts of steering, torque and slip: suspension, actuators and tyres answer late in any real car."""
        a, b, c, v = _squash(features(series, self.vehicle), self.center, self.width).T
        delta = series.steer_angle / max(float(np.quantile(np.abs(series.steer_angle), 0.99)), 1e-6)
        clock = series.recording
        scale = np.sqrt(self.vehicle.wheelbase / 2.7)
        along, side = [], []
        for tau in _MEMORY_SECONDS:
            late = [first_order_response(x, 1.0 / (tau * scale), clock) - x for x in (a, b, c, delta, a * a)]
            along += [late[2], late[4]]
            side += [late[0], late[1], late[3], late[2] * a, late[2] * b, late[0] * v]
        direction = self.vehicle.force_matrix() * _SMOOTH_DEVIATION * self._peak
        out = [f[:, None] * direction[:, 0] for f in along]
        return out + [f[:, None] * direction[:, axle] for axle in (1, 2) for f in side]


def build_common_physics(vehicle: Vehicle, series: Series) -> CommonPhysics:
    """Return the dictionary, its smooth functions scaled to where `series` (a simulation) has been."""
    z = features(series, vehicle)
    width = np.maximum(np.quantile(np.abs(z[:, :2]), 0.995, axis=0), 1e-3)
    low, high = np.quantile(z[:, 2:], [0.005, 0.995], axis=0)
    center = np.array([0.0, 0.0, *(0.5 * (low + high))])
    return CommonPhysics(vehicle, center, np.array([*width, *np.maximum(0.5 * (high - low), 1e-3)]))


def features(series: Series, vehicle: Vehicle) -> np.ndarray:
    """Return alpha_f, alpha_r [rad], T/T_max [1] and v_x [m/s] at the smoothed states, shape (N, 4)."""
    flow = series.flow(extended_model(vehicle))
    ratio = series.torque / vehicle.max_torque
    return np.stack([flow.front.slip_angle, flow.rear.slip_angle, ratio, series.smooth[:, 0]], axis=1)


def natural_unit(vehicle: Vehicle, term: str, parameter: str) -> float:
    """Return a size of a parameter that matters for this vehicle: what 1 means in tables written for all cars."""
    weight = vehicle.mass * 9.80665
    length = vehicle.wheelbase / 2.7
    capacity = vehicle.front_tire.D + vehicle.rear_tire.D
    speed2 = 400.0 * length  # (20 m/s)^2 for a full-size car; speeds scale with the root of length
    units = {
        ("aero_downforce", "front"): 0.5 * weight / speed2,
        ("aero_downforce", "rear"): 0.5 * weight / speed2,
        ("aero_drag", "drag"): 0.1 * weight / speed2,
        ("rolling_resistance", "force"): weight,
        ("wind", "wx"): np.sqrt(speed2),
        ("wind", "wy"): np.sqrt(speed2),
        # Damping that takes a tenth of what the tyres damp at that speed.
        ("yaw_moment_differential", "yaw_damping"): 0.25 * capacity * vehicle.wheelbase**2 / np.sqrt(speed2),
        ("load_transfer", "cg_height"): vehicle.wheelbase,
        ("cg_shift", "dx"): vehicle.wheelbase,
        ("sensor_lever_arm", "dx"): vehicle.wheelbase,
        ("tire_relaxation", "length"): vehicle.wheelbase / 2.7,
    }
    return float(units.get((term, parameter), 1.0))


def _squash(z: np.ndarray, center: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Scale to about [-1, 1] inside and level off outside, so that nothing is extrapolated."""
    x = (z - center) / width
    return np.where(np.abs(x) <= 1.0, x, np.sign(x) * (1.0 + np.tanh(np.abs(x) - 1.0)))
