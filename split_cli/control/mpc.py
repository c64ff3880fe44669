"""Model predictive control that tracks a line at a given speed; of the steering alone, or of torque as well."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from split_cli.control.limits import Limits
from split_cli.control.model import ControlModel, Linearization
from split_cli.control.path import Path, PathPoint
from split_cli.control.receding_horizon import Actuators, Plan, RecedingController, Weights, _stages


@dataclass(frozen=True)
class MpcSettings:
    """How the tracking controller weighs."""

    horizon: int = 50  # N; the paper's 50 for steering alone, 25 for both
    step: float = 0.04  # [s]; the paper's 0.04
    weights: Weights = Weights(contour=4.0, lag=1.0, torque_rate=0.02, steer_rate=1.0)
    direction: float = 4.0  # of the squared angle between car and line [1/rad^2]
    speed: float = 0.5  # of the squared speed error [s^2/m^2]; not used for steering alone
    yaw_rate: float = 0.1  # of the squared difference from what the line's curvature asks for [s^2/rad^2]
    limits: Limits = Limits()
    margin: float = 0.05  # kept between the car's side and the border [m]
    steering_alone: bool = True  # leave the torque to a speed controller; in the prediction it stays as it is


class Mpc(RecedingController):
    """Tracks the line in the model's own states.

    Parameters
    ----------
    model, path, actuators, settings
    width : float
        Of the car [m].
    speed : callable
        Wanted speed [m/s] at arc lengths [m], arrays of one shape.

    Notes
    -----
    SPLIT paper, the MPC formulation: |x - x_ref|^2_Q + |u - u_ref|^2_R. The reference point of stage k is where
    the car is by then at the wanted speed. The position's error is weighed along and across the line, which is
    the error of X and Y in another frame. With the steering alone, points move with the car's own speed.
    """

    def __init__(
        self,
        model: ControlModel,
        path: Path,
        actuators: Actuators,
        settings: MpcSettings,
        width: float,
        speed: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        self.settings, self.speed = settings, speed
        super().__init__(
            model, path, actuators, settings.weights, settings.limits, settings.horizon, 0.5 * width + settings.margin
        )
        self.s = np.zeros(settings.horizon + 1)

    def first_plan(self, x: np.ndarray, s: float) -> Plan:
        """Return a roll along the line at the wanted speed."""
        self._place(x, s)
        states = self.rolling_states(self.path.at(self.s), self.wanted, x[6])
        plan = Plan(states, np.zeros((self.horizon, self.m)))
        plan.x[0] = x
        return plan

    def _place(self, x: np.ndarray, near: float) -> None:
        """Put the reference points ahead of state `x`."""
        s = self.path.project(x[0], x[1], near)
        self.s[0] = s
        if self.settings.steering_alone:
            self.wanted = np.full(self.horizon + 1, float(x[3]))
            self.s = s + self.settings.step * float(x[3]) * np.arange(self.horizon + 1)
            return
        for k in range(self.horizon):
            self.s[k + 1] = self.s[k] + self.settings.step * float(self.speed(self.s[k : k + 1])[0])
        self.wanted = self.speed(self.s)

    @property
    def place(self) -> float:
        """Return the first reference point."""
        return float(self.s[0])

    def reference(self) -> tuple[np.ndarray, PathPoint]:
        """Return the reference points."""
        return self.s, self.path.at(self.s)

    def extend_state(self, x: np.ndarray) -> np.ndarray:
        """Return the state itself, and move the reference points to where the car is."""
        self._place(x, self.s[0])
        return x

    def cost(self, s: np.ndarray, point: PathPoint) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the stage costs about the plan."""
        w, p, N = self.weights, self.settings, self.horizon
        at, x = _stages(point, slice(1, N + 1)), self.plan.x[1:]
        Q, q = self.contour_cost(s[1:], at, 0.0 if p.steering_alone else w.lag)
        wanted = self.wanted[1:]
        states = (
            (2, p.direction, x[:, 2] - at.direction),
            (3, 0.0 if p.steering_alone else p.speed, x[:, 3] - wanted),
            (5, p.yaw_rate, x[:, 5] - wanted * at.curvature),
        )
        for index, weight, error in states:
            Q[:, index, index] += 2.0 * weight
            q[:, index] += 2.0 * weight * error
        R = np.empty((N, self.m))
        R[:] = 2.0 * np.array([w.torque_rate / self.u_scale[0] ** 2, w.steer_rate])
        return Q, q, R, R * self.plan.u

    def dynamics(self, found: Linearization) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the model's dynamics; with the steering alone torque does not answer."""
        A, B, c = super().dynamics(found)
        if self.settings.steering_alone:
            B[:, :, 0] = 0.0
        return A, B, c

    def bounds(self, found: Linearization) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the commands' bounds; with the steering alone the torque stays where it is, wherever that is."""
        x_lower, x_upper, u_lower, u_upper = super().bounds(found)
        if self.settings.steering_alone:
            now = self.plan.x[0, 6]
            x_lower[:, 6], x_upper[:, 6] = np.minimum(x_lower[:, 6], now), np.maximum(x_upper[:, 6], now)
        return x_lower, x_upper, u_lower, u_upper


@dataclass
class SpeedController:
    """A proportional-integral controller of the speed through the torque."""

    speed: float  # wanted [m/s]
    # mass, wheel_radius: [kg], [m]
    mass: float
    wheel_radius: float
    # proportional, integral: of the acceleration asked for, per speed error [1/s] and its integral [1/s^2].
    proportional: float = 1.5
    integral: float = 0.3
    sum: float = 0.0

    def scaled(self, scale: float) -> Self:
        """Return a controller that is as fast on a course of `scale` [1], where times go with its root."""
        return replace(self, proportional=self.proportional / np.sqrt(scale), integral=self.integral / scale)

    def torque(self, vx: float, step: float, actuators: Actuators) -> float:
        """Return the torque [N m] for the next `step` seconds."""
        error = self.speed - vx
        asked = self.mass * self.wheel_radius * (self.proportional * error + self.integral * self.sum)
        torque = float(np.clip(asked, -actuators.max_brake_torque, actuators.max_torque))
        if torque == asked:  # the sum stands still while the torque is at its bound
            self.sum += error * step
        return torque
