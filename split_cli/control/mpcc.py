"""Model predictive contouring control: planning and tracking in one programme that wants progress."""

from dataclasses import dataclass

import numpy as np

from split_cli.control.limits import Limits
from split_cli.control.model import ControlModel, Linearization
from split_cli.control.path import Path, PathPoint
from split_cli.control.policy import PROGRESS_ACCELERATION
from split_cli.control.receding_horizon import Actuators, Plan, RecedingController, Weights, _stages


@dataclass(frozen=True)
class MpccSettings:
    """How the contouring controller weighs."""

    horizon: int = 80  # N; the paper's 80
    step: float = 0.05  # [s]; the paper's 0.05
    weights: Weights = Weights(contour=0.02, lag=40.0, torque_rate=0.02, steer_rate=4.0)
    progress: float = 1.0  # q_v, of the progress speed [s/m]
    progress_rate: float = 1e-3  # of the squared acceleration of the progress [s^4/m^2]
    max_speed: float = 30.0  # of the progress and of the car [m/s]
    limits: Limits = Limits()
    margin: float = 0.3  # kept between the car's side and the border [m]


class Mpcc(RecedingController):
    """The model's states with theta, the progress along the line [m], and v_s, its rate [m/s].

    Notes
    -----
    SPLIT paper, the MPCC formulation: the cost of a stage is q_l e_l^2 + q_c e_c^2 - q_v v_s + |u|^2_R with
    u = [dT, ddelta, dv_s]; errors are linearised about the plan's own theta. All rows are soft; see `limits`.
    """

    EXTRA_STATES = 2
    EXTRA_INPUTS = 1

    def __init__(
        self,
        model: ControlModel,
        path: Path,
        actuators: Actuators,
        settings: MpccSettings,
        width: float,
        tightening: float = 0.0,
    ) -> None:
        self.settings = settings
        super().__init__(
            model,
            path,
            actuators,
            settings.weights,
            settings.limits,
            settings.horizon,
            0.5 * width + settings.margin,
            tightening,
        )

    def first_plan(self, x: np.ndarray, s: float) -> Plan:
        """Return a roll along the line at constant speed."""
        N, h, v = self.horizon, self.settings.step, float(x[3])
        theta = self.path.project(x[0], x[1], s) + v * h * np.arange(N + 1)
        point = self.path.at(theta)
        plan = Plan(np.zeros((N + 1, self.n)), np.zeros((N, self.m)))
        plan.x[:, : self.n_model] = self.rolling_states(point, np.full(N + 1, v), x[6])
        plan.x[:, -2], plan.x[:, -1] = theta, min(v, self.settings.max_speed)
        begin = np.array(x, dtype=float)
        begin[2] += 2.0 * np.pi * np.round((point.direction[0] - begin[2]) / (2.0 * np.pi))
        plan.x[0, : self.n_model] = begin
        return plan

    @property
    def place(self) -> float:
        """Return the plan's own progress at its begin."""
        return float(self.plan.x[0, -2])

    def reference(self) -> tuple[np.ndarray, PathPoint]:
        """Return the plan's own progress and the line there."""
        theta = self.plan.x[:, -2]
        return theta, self.path.at(theta)

    def extend_state(self, x: np.ndarray) -> np.ndarray:
        """Return the state with its progress projected anew; the progress speed goes on."""
        before = self.plan.x[0]
        theta = self.path.project(x[0], x[1], before[-2])
        return np.concatenate([x, [theta, before[-1]]])

    def contour_rows(self, s: np.ndarray, point: PathPoint) -> tuple[np.ndarray, ...]:
        """Return errors and their slopes, those by theta included."""
        contour, lag, of_contour, of_lag = super().contour_rows(s, point)
        of_contour[:, -2] = -point.curvature * lag
        of_lag[:, -2] = 1.0 + point.curvature * contour
        return contour, lag, of_contour, of_lag

    def cost(self, s: np.ndarray, point: PathPoint) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the stage costs about the plan."""
        w, p, N = self.weights, self.settings, self.horizon
        Q, q = self.contour_cost(s[1:], _stages(point, slice(1, N + 1)), w.lag)
        q[:, -1] -= p.progress
        R = np.empty((N, self.m))
        R[:] = 2.0 * np.array([w.torque_rate / self.u_scale[0] ** 2, w.steer_rate, p.progress_rate])
        return Q, q, R, R * self.plan.u

    def dynamics(self, found: Linearization) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the model's dynamics with those of the progress, a double integrator."""
        A, B, c = super().dynamics(found)
        h, x, u = self.settings.step, self.plan.x, self.plan.u
        A[:, -2, -2] = A[:, -1, -1] = 1.0
        A[:, -2, -1] = h
        B[:, -2, -1], B[:, -1, -1] = 0.5 * h * h, h
        c[:, -2] = x[:-1, -2] + h * x[:-1, -1] + 0.5 * h * h * u[:, -1] - x[1:, -2]
        c[:, -1] = x[:-1, -1] + h * u[:, -1] - x[1:, -1]
        return A, B, c

    def bounds(self, found: Linearization) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the commands' bounds with those of the progress."""
        x_lower, x_upper, u_lower, u_upper = super().bounds(found)
        x_lower[:, -1], x_upper[:, -1] = 0.0, max(self.settings.max_speed, self.plan.x[0, -1])
        u_lower[:, -1], u_upper[:, -1] = -PROGRESS_ACCELERATION, PROGRESS_ACCELERATION
        return x_lower, x_upper, u_lower, u_upper

    def _one_more(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        following = super()._one_more(x, u)
        following[-2] = x[-2] + self.settings.step * x[-1]
        return following
