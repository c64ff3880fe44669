"""Yaw rate of a car that records none, from its lateral acceleration.

r = (a_y - v_y')/v_x holds for every car on a flat road. Where v_y is not recorded either, the rear axle's nominal
tyres give both: the force that they make turns the body, and their slip is the direction of the rear axle's travel.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.logs.assembling.smoothing import derivative, smooth
from split_cli.logs.checking.plausible import NO_CAR_EXCEEDS
from split_cli.vehicle.parameters import Vehicle

_RISING = 0.95
"""Share of the rear tyres' peak force up to which slip follows from force [1]: the ellipse of the valid region."""
_SETTLING = 3.0
"""Time constants of the yaw motion that a run loses at its start, where r and v_y are guessed as steady [1]."""


@dataclass(frozen=True)
class Turning:
    """Yaw rate and lateral velocity from a lateral acceleration; NaN where they do not follow from it."""

    # r, vy: (N,): yaw rate [rad/s], lateral velocity at the CG [m/s].
    r: np.ndarray
    vy: np.ndarray
    slow: float  # share of the rows below the vehicle's minimum speed, or with an a_y that no car reaches [1]
    beyond: float = 0.0  # share of the rows that ask more of the rear axle than its nominal tyres have [1]
    most: float = 0.0  # what 99 % of the rows ask of the rear axle at most [N]


def turning_of_measured_lateral_velocity(
    columns: Mapping[str, np.ndarray], period: float, segments: Sequence[slice], vehicle: Vehicle
) -> Turning:
    """Return r = (a_y - v_y')/v_x from measured ``vx``, ``vy`` [m/s] and ``ay`` [m/s^2] at the CG, shape (N,)."""
    vx, vy = columns["vx"], columns["vy"]
    r = np.full(len(vx), np.nan)
    fast = _usable(columns, vehicle)
    for run in segments:
        across = columns["ay"][run] - derivative(smooth(vy[run]), period)
        r[run] = np.where(fast[run], across / np.where(fast[run], vx[run], 1.0), np.nan)
    return Turning(r, vy, float(np.mean(~fast)))


def turning_of_rear_tires(
    columns: Mapping[str, np.ndarray], period: float, segments: Sequence[slice], vehicle: Vehicle
) -> Turning:
    """Return r and v_y from ``vx`` [m/s] and ``ay`` [m/s^2] at the CG, shape (N,), and the nominal rear tyres.

    Notes
    -----
    v_y' = a_y - v_x r and I_z r' = l_f m a_y - L F_ry(alpha_r), with alpha_r = -atan((v_y - l_r r)/v_x): the single
    track whose front force is what a_y leaves, F_fy = m a_y - F_ry. It is stable at every speed while F_ry rises
    with the slip (eigenvalues of determinant L C_r/I_z and negative trace), so no initial guess stays. Neither the
    front tyres nor the steer angle is used: those are what such a recording can judge.
    """
    vx, ay = columns["vx"], columns["ay"]
    r, vy = np.full(len(vx), np.nan), np.full(len(vx), np.nan)
    fast = _usable(columns, vehicle)
    beyond = np.zeros(len(vx), dtype=bool)
    tire = _RearTires.of(vehicle)
    for run in segments:
        rows = np.arange(run.start, run.stop)
        edges = np.flatnonzero(np.diff(fast[rows])) + 1
        for part in np.split(rows, edges):
            if not fast[part[0]]:
                continue
            made, slip = _simulated(vx[part], ay[part], period, vehicle, tire)
            lost = min(len(part), math.ceil(_SETTLING * _time_constant(float(vx[part[0]]), vehicle) / period))
            beyond[part] = np.abs(slip) > tire.rising
            made[beyond[part]] = np.nan
            made[:lost] = np.nan
            vy[part], r[part] = made.T
    needed = vehicle.mass * vehicle.cg_to_front_axle / vehicle.wheelbase * np.abs(ay[fast])
    most = float(np.quantile(needed, 0.99)) if len(needed) else 0.0
    return Turning(r, vy, float(np.mean(~fast)), float(np.mean(beyond)), most)


def _usable(columns: Mapping[str, np.ndarray], vehicle: Vehicle) -> np.ndarray:
    """Return the rows from which a yaw rate follows, shape (N,): fast enough, and a_y that of a car."""
    return (columns["vx"] >= vehicle.minimum_speed) & (np.abs(columns["ay"]) <= NO_CAR_EXCEEDS["ay"][0])


@dataclass(frozen=True)
class _RearTires:
    """The nominal rear axle's force, continued in a straight line where it nears its peak."""

    B: float  # [1/rad]
    C: float  # [1]
    D: float  # [N]
    rising: float  # slip angle up to which it is the nominal tyre [rad]
    slope: float  # there [N/rad]

    @classmethod
    def of(cls, vehicle: Vehicle) -> "_RearTires":
        tire = vehicle.rear_tire
        reduced = math.tan(math.asin(_RISING) / tire.C) if math.asin(_RISING) < tire.C * 0.5 * math.pi else math.inf
        rising = min(reduced / tire.B, 0.5)
        inner = tire.C * math.atan(tire.B * rising)
        slope = tire.cornering_stiffness * math.cos(inner) / (1.0 + (tire.B * rising) ** 2)
        return cls(tire.B, tire.C, tire.D, rising, slope)

    def force(self, slip: float) -> float:
        """Return F_ry [N] at a slip angle [rad]."""
        inside = max(-self.rising, min(slip, self.rising))
        return self.D * math.sin(self.C * math.atan(self.B * inside)) + self.slope * (slip - inside)

    def slip(self, force: float) -> float:
        """Return the slip angle [rad] of a force [N]: the inverse of `force`."""
        most = self.force(self.rising)
        if abs(force) > most:
            return math.copysign(self.rising + (abs(force) - most) / self.slope, force)
        return math.tan(math.asin(force / self.D) / self.C) / self.B


def _time_constant(speed: float, vehicle: Vehicle) -> float:
    """Return the time in which a wrong initial guess falls to 1/e [s]: the slower of the two eigenvalues."""
    stiffness = vehicle.wheelbase * vehicle.rear_tire.cornering_stiffness / vehicle.yaw_inertia
    half = 0.5 * stiffness * vehicle.cg_to_rear_axle / speed
    return 1.0 / half if half * half <= stiffness else 1.0 / (half - math.sqrt(half * half - stiffness))


def _simulated(
    vx: np.ndarray, ay: np.ndarray, period: float, vehicle: Vehicle, tire: _RearTires
) -> tuple[np.ndarray, np.ndarray]:
    """Return v_y, r (N, 2) and the rear slip angle (N,) [rad] of one run, by RK4 over straight lines of the inputs.

    Substeps keep the product of step and fastest eigenvalue below 1.
    """
    mass, front, rear = vehicle.mass, vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle
    base, inertia = vehicle.wheelbase, vehicle.yaw_inertia
    fastest = base * vehicle.rear_tire.cornering_stiffness * rear / inertia / float(vx.min())
    steps = max(1, math.ceil(period * max(fastest, math.sqrt(fastest * float(vx.min()) / rear))))
    h = period / steps

    def rates(vy: float, r: float, speed: float, across: float) -> tuple[float, float]:
        slip = -math.atan2(vy - rear * r, speed)
        return across - speed * r, (front * mass * across - base * tire.force(slip)) / inertia

    # A run may begin with the shocks of an accelerometer that is switched on: the guess keeps within the car's grip.
    steady = max(-vehicle.lateral_grip, min(float(ay[0]), vehicle.lateral_grip))
    r = steady / float(vx[0])
    vy = rear * r - float(vx[0]) * math.tan(tire.slip(mass * front / base * steady))
    out = np.empty((len(vx), 2))
    out[0] = vy, r
    speeds, accelerations = vx.tolist(), ay.tolist()
    for row in range(1, len(speeds)):
        v0, a0 = speeds[row - 1], accelerations[row - 1]
        dv, da = (speeds[row] - v0) / steps, (accelerations[row] - a0) / steps
        for step in range(steps):
            v1, a1 = v0 + step * dv, a0 + step * da
            vm, am, v2, a2 = v1 + 0.5 * dv, a1 + 0.5 * da, v1 + dv, a1 + da
            k1 = rates(vy, r, v1, a1)
            k2 = rates(vy + 0.5 * h * k1[0], r + 0.5 * h * k1[1], vm, am)
            k3 = rates(vy + 0.5 * h * k2[0], r + 0.5 * h * k2[1], vm, am)
            k4 = rates(vy + h * k3[0], r + h * k3[1], v2, a2)
            vy += h / 6.0 * (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0])
            r += h / 6.0 * (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1])
        out[row] = vy, r
    return out, -np.arctan2(out[:, 0] - rear * out[:, 1], vx)
