"""What MPC and MPCC share: a plan that moves on with time, one linearised programme a step, and a fallback."""

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from split_cli.control.limits import SLIP_ROWS, Limits, load_shift, slip_rows, torque_limit
from split_cli.control.model import ControlModel, Linearization
from split_cli.control.path import Path, PathPoint, contour_and_lag
from split_cli.control.policy import (
    ANEW,
    ELLIPSE_SLACK,
    FAR,
    FIRST_STEPS,
    FREE,
    MAX_STEER,
    PATIENCE,
    PROXIMAL,
    RETURN_SHARE,
    ROOM_SHARE,
    SLIP_DIFFERENCE_SLACK,
    STEER_RATE,
    TORQUE_RATE,
    TRACK_SLACK,
)
from split_cli.control.qp import QPData, StageQP
from split_cli.errors import SplitError


class ControllerLost(SplitError):
    """The controller has no plan any more: its programmes failed for too long, or the car is elsewhere."""


@dataclass(frozen=True)
class Actuators:
    """What commands may be."""

    # max_torque, max_brake_torque: both positive [N m].
    max_torque: float
    max_brake_torque: float
    max_steer: float = MAX_STEER  # [rad]
    torque_rate: float = TORQUE_RATE  # [N m/s]
    steer_rate: float = STEER_RATE  # [rad/s]


@dataclass(frozen=True)
class Weights:
    """Weights that MPC and MPCC have in common."""

    # contour, lag: of squared errors [1/m^2].
    contour: float
    lag: float
    # torque_rate, steer_rate: of squared inputs, in units of full torque a second and of 1 rad/s.
    torque_rate: float
    steer_rate: float
    # track, ellipse, slip_difference: of squared slacks: contour beyond the border [1/m^2], slip angle beyond the
    # ellipse [1/rad^2], difference of slip angles beyond its bound [1/rad^2].
    track: float = TRACK_SLACK
    ellipse: float = ELLIPSE_SLACK
    slip_difference: float = SLIP_DIFFERENCE_SLACK
    proximal: float = PROXIMAL  # of squared steps of the scaled states from one plan to the next


@dataclass
class Plan:
    """States x, shape (N + 1, n), and inputs u, shape (N, m), from now on."""

    x: np.ndarray
    u: np.ndarray


@dataclass(frozen=True)
class StepInfo:
    """What one step of a controller took."""

    solved: bool
    # solver_seconds, total_seconds: of HPIPM, and of everything: residual, model, assembly and solver [s].
    solver_seconds: float
    total_seconds: float
    residual_seconds: float  # of model and residual together, part of the total [s]


class RecedingController(ABC):
    """A controller that solves one linearised programme a step about its last plan (real-time iteration).

    Parameters
    ----------
    horizon : int
        N.
    half_width : float
        Of the car, kept inside the borders together with a margin [m].
    tightening : float
        How many standard deviations of the position, as the residual's variance makes it, the borders are moved
        in; 0 for none.

    Attributes
    ----------
    grip : ndarray, shape (2,)
        Peak of front and rear over the model's, by which the slip limits are moved [1].
    load_shift : ndarray, shape (2,)
        What driving and braking move of it [1/N].
    deviation : float
        By how much more than `half_width` the borders are moved in, for what a drive does otherwise than planned
        [m].

    Notes
    -----
    When a programme fails, the plan of the step before goes on (its next input is applied) and the step counts as
    a failure. So does a step whose plan spins, and there planning begins anew from the line. After `PATIENCE`
    failures in a row `ControllerLost` is raised.

    A tangent of the slip limit says nothing of how the limit falls away from it: at no torque it is flat, and far
    from there it rises beyond its top. With tangents alone plans jump from one to the other. So the cost of a
    programme has the second derivative of the limits, times the multipliers of the programme before: sequential
    convex quadratic programming (Verschueren et al., Exploiting convexity in direct optimal control, CDC 2016).
    """

    EXTRA_STATES = 0
    EXTRA_INPUTS = 0

    def __init__(
        self,
        model: ControlModel,
        path: Path,
        actuators: Actuators,
        weights: Weights,
        limits: Limits,
        horizon: int,
        half_width: float,
        tightening: float = 0.0,
    ) -> None:
        self.model, self.path, self.actuators, self.weights, self.limits = model, path, actuators, weights, limits
        self.horizon, self.half_width, self.tightening = horizon, half_width, tightening
        self.n_model = model.states
        self.n = model.states + self.EXTRA_STATES
        self.m = 2 + self.EXTRA_INPUTS
        self.x_scale = np.concatenate([model.scale, np.ones(self.EXTRA_STATES)])
        self.u_scale = np.ones(self.m)
        self.u_scale[0] = max(actuators.max_torque, actuators.max_brake_torque)
        self.programme = StageQP(horizon, self.n, self.m, 1 + SLIP_ROWS)
        self.grip = np.ones(2)
        self.load_shift = load_shift(model.vehicle)
        self.deviation = 0.0
        self.plan: Plan | None = None
        self.slack = np.zeros((horizon - 1, 1 + SLIP_ROWS))  # of the last programme's rows
        self.failures_in_a_row = 0

    @abstractmethod
    def first_plan(self, x: np.ndarray, s: float) -> Plan:
        """Return a guess from the model's state `x`, shape (n_model,), at arc length `s` [m]."""

    def rolling_states(self, point: PathPoint, speed: np.ndarray, torque: float) -> np.ndarray:
        """Return the model's steady states where a car rolls along a line, shape (N + 1, n of the model)."""
        wheelbase = self.model.vehicle.wheelbase
        states = []
        for x, y, direction, bend, v in zip(point.x, point.y, point.direction, point.curvature, speed, strict=True):
            here = np.array([x, y, direction, v, 0.0, v * bend, torque, np.arctan(wheelbase * bend)])
            states.append(self.model.steady_states(here))
        return np.array(states)

    @property
    @abstractmethod
    def place(self) -> float:
        """Arc length at which the plan begins [m]."""

    @abstractmethod
    def reference(self) -> tuple[np.ndarray, PathPoint]:
        """Return arc lengths (N + 1,) of the plan's reference points, and the line there."""

    @abstractmethod
    def cost(self, s: np.ndarray, point: PathPoint) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return Q (N, n, n), q (N, n), R (N, m), r (N, m) of a step about the plan, in SI units."""

    @abstractmethod
    def extend_state(self, x: np.ndarray) -> np.ndarray:
        """Return the controller's whole state, shape (n,), for the model's state `x`, shape (n_model,)."""

    def begin(self, x: np.ndarray, s: float, iterations: int = 30) -> None:
        """Find a first plan from state `x`, shape (n_model,), at arc length `s` [m].

        The guess may be far from a plan that the car can follow, and whole steps from there may lead to one that
        spins, about which no programme has a solution. Then the search begins again with shorter steps.

        Raises
        ------
        ControllerLost
            If no plan is found, or the first plan breaks its bounds by much: an infeasible start.
        """
        solved = False
        for share in FIRST_STEPS:
            self._guess(np.asarray(x, dtype=float), s)
            for _ in range(iterations):
                solved = self._iterate(share)[0]
                if not solved:
                    break
            if solved:
                break
        if not solved:
            what = f"no plan was found from {x[3]:.1f} m/s at {s:.0f} m"
            advice = "Start slower, or inside the track and along it."
            raise ControllerLost(what, where=self.path.name, advice=advice)
        self.failures_in_a_row = 0

    def _guess(self, x: np.ndarray, s: float) -> None:
        """Begin with a guess of the plan, of which no programme has told a slack."""
        self.plan = self.first_plan(x, s)
        self.slack[:] = 0.0

    def step(self, x: np.ndarray) -> tuple[np.ndarray, StepInfo]:
        """Move the plan on by one interval, begin it at state `x`, shape (n_model,), and solve once.

        Returns
        -------
        ndarray, shape (2,)
            The input to apply from `x` on: dT [N m/s], ddelta [rad/s].
        StepInfo

        Raises
        ------
        ControllerLost
            After `PATIENCE` failures in a row.
        """
        if self.plan is None:
            raise ControllerLost("has no first plan", advice="Call begin().")
        start = time.thread_time()
        self._shift(x)
        solved, solver_seconds, residual_seconds = self._iterate()
        solved = solved and not self._spins()
        if solved:
            self.failures_in_a_row = 0
        else:
            self.failures_in_a_row += 1
            if self.failures_in_a_row >= PATIENCE:
                raise ControllerLost(f"{self.failures_in_a_row} quadratic programmes in a row had no solution")
            if self._spins():
                solver, residual = self._begin_anew()
                solver_seconds, residual_seconds = solver_seconds + solver, residual_seconds + residual
        info = StepInfo(solved, solver_seconds, time.thread_time() - start, residual_seconds)
        return self.plan.u[0, :2].copy(), info

    def _shift(self, x: np.ndarray) -> None:
        plan = self.plan
        x = np.array(x, dtype=float)
        x[2] += 2.0 * np.pi * np.round((plan.x[1, 2] - x[2]) / (2.0 * np.pi))
        last = self._one_more(plan.x[-1], plan.u[-1])
        plan.x[:-1], plan.u[:-1] = plan.x[1:], plan.u[1:]
        self.slack[:-1] = self.slack[1:]
        plan.x[-1] = last
        plan.u[-1] = 0.0
        plan.x[0] = self.extend_state(x)

    def _one_more(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the state one step after the plan's last, its inputs at rest."""
        following = x.copy()
        following[: self.n_model] = self.model.linearize(x[None, : self.n_model], np.zeros((1, 2))).following[0]
        return following

    def _spins(self) -> bool:
        """Return whether the plan moves more sideways than forward somewhere, or backwards, and so is none."""
        vx, vy = self.plan.x[1:, 3], self.plan.x[1:, 4]
        return bool((np.abs(vy) > vx).any())

    def _begin_anew(self) -> tuple[float, float]:
        """Plan from the state as it is, as at the start; return the solver's and the model's time [s].

        Steps of single programmes can lead a plan to where its linearisation means nothing; from there no further
        step leads back.
        """
        now = self.plan.x[0]
        self._guess(now[: self.n_model], self.place)
        tries = [self._iterate() for _ in range(ANEW)]
        return sum(one[1] for one in tries), sum(one[2] for one in tries)

    def _iterate(self, share: float = 1.0) -> tuple[bool, float, float]:
        """Solve one programme about the plan and take a share of its step [1]."""
        plan, N = self.plan, self.horizon
        start = time.thread_time()
        found = self.model.linearize(plan.x[:N, : self.n_model], plan.u[:, :2])
        residual_seconds = time.thread_time() - start
        solution = self.programme.solve(self._assemble(found))
        if not solution.solved:
            return False, solution.seconds, residual_seconds
        plan.x[1:] += share * solution.x * self.x_scale
        plan.u += share * solution.u * self.u_scale
        self.slack = solution.slack
        return True, solution.seconds, residual_seconds

    def dynamics(self, found: Linearization) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return A (N, n, n), B (N, n, m) and c (N, n) of the whole state, in SI units."""
        n, N = self.n_model, self.horizon
        A, B = np.zeros((N, self.n, self.n)), np.zeros((N, self.n, self.m))
        A[:, :n, :n], B[:, :n, :2] = found.A, found.B
        c = np.zeros((N, self.n))
        c[:, :n] = found.following - self.plan.x[1:, :n]
        return A, B, c

    def _assemble(self, found: Linearization) -> QPData:
        plan, weights = self.plan, self.weights
        A, B, c = self.dynamics(found)
        s, point = self.reference()
        Q, q, R, r = self.cost(s, point)
        C, lower, upper, bend = self._rows(found, s, point)
        x_lower, x_upper, u_lower, u_upper = self.bounds(found)
        xs, us, n = self.x_scale, self.u_scale, self.n_model
        # The multiplier of a softened row is the slope of its price, 2 w |s|; both sides of an axle bend alike.
        pressed = 2.0 * weights.ellipse * np.abs(self.slack[:, 1:5]).reshape(-1, 2, 2).sum(axis=2)
        Q[:-1, :n, :n] += (pressed[:, :, None, None] * bend).sum(axis=1)
        Q = Q * xs[:, None] * xs
        Q[:, np.arange(self.n), np.arange(self.n)] += 2.0 * weights.proximal
        slack = np.array([weights.track, *(4 * [weights.ellipse]), weights.slip_difference])
        return QPData(
            A=A * xs / xs[:, None],
            B=B * us / xs[:, None],
            c=c / xs,
            Q=Q,
            q=q * xs,
            R=R * us * us,
            r=r * us,
            C=C * xs,
            row_lower=lower,
            row_upper=upper,
            slack_weight=slack,
            x_lower=(x_lower - plan.x[1:]) / xs,
            x_upper=(x_upper - plan.x[1:]) / xs,
            u_lower=(u_lower - plan.u) / us,
            u_upper=(u_upper - plan.u) / us,
        )

    def contour_rows(self, s: np.ndarray, point: PathPoint) -> tuple[np.ndarray, ...]:
        """Return e_c, e_l (N,) of stages 1 to N, and their slopes by the state (N, n)."""
        x = self.plan.x[1:]
        contour, lag = contour_and_lag(point, x[:, 0], x[:, 1])
        sine, cosine = np.sin(point.direction), np.cos(point.direction)
        of_contour, of_lag = np.zeros_like(x), np.zeros_like(x)
        of_contour[:, 0], of_contour[:, 1] = sine, -cosine
        of_lag[:, 0], of_lag[:, 1] = -cosine, -sine
        return contour, lag, of_contour, of_lag

    def contour_cost(self, s: np.ndarray, point: PathPoint, along: float) -> tuple[np.ndarray, np.ndarray]:
        """Return Q (N, n, n) and q (N, n) of both errors, that along the line weighed by `along`."""
        across = self.weights.contour
        contour, lag, of_contour, of_lag = self.contour_rows(s, point)
        Q = 2.0 * (
            across * of_contour[:, :, None] * of_contour[:, None, :] + along * of_lag[:, :, None] * of_lag[:, None, :]
        )
        return Q, 2.0 * (across * contour[:, None] * of_contour + along * lag[:, None] * of_lag)

    def _rows(self, found: Linearization, s: np.ndarray, point: PathPoint) -> tuple[np.ndarray, ...]:
        """Return rows of stages 1 to N - 1 (border, slip angles, their difference), and how `slip_rows` bend."""
        N = self.horizon
        C = np.zeros((N - 1, 1 + SLIP_ROWS, self.n))
        lower, upper = np.empty((N - 1, 1 + SLIP_ROWS)), np.empty((N - 1, 1 + SLIP_ROWS))
        at = _stages(point, slice(1, N + 1))
        contour, _, of_contour, _ = self.contour_rows(s[1:], at)
        inside = self._tightened(found, at)
        C[:, 0] = of_contour[:-1]
        lower[:, 0] = -(at.left - inside)[:-1] - contour[:-1]
        upper[:, 0] = (at.right - inside)[:-1] - contour[:-1]
        C[:, 1:, : self.n_model], lower[:, 1:], upper[:, 1:], bend = slip_rows(
            self.limits, found.stages(slice(1, None)), FREE, self.grip, self._shift_of_load
        )
        return C, lower, upper, bend

    def _tightened(self, found: Linearization, point: PathPoint) -> np.ndarray:
        """Return how far from the borders the CG has to stay [m], shape (N,).

        Notes
        -----
        The residual's variance adds up along the plan, Sigma+ = A Sigma A^T + h^2 B_d diag(variance) B_d^T
        (Hewing et al., Cautious model predictive control using Gaussian process regression, 2020, eq. 13 with the
        input uncertainty left out). `deviation` comes on top; together they take at most half the room.
        """
        inside = np.full(self.horizon, self.half_width)
        room = self.room(point)
        if not self.tightening:
            return inside + np.minimum(self.deviation, room)
        n, step = self.n_model, self.model.step
        spread = np.zeros((n, n))
        deviation = np.empty(self.horizon)
        for k in range(self.horizon):
            spread = found.A[k] @ spread @ found.A[k].T
            spread[[3, 4, 5], [3, 4, 5]] += step**2 * found.residual.variance[k]
            across = np.array([np.sin(point.direction[k]), -np.cos(point.direction[k])])
            deviation[k] = np.sqrt(max(across @ spread[:2, :2] @ across, 0.0))
        return inside + np.minimum(self.tightening * deviation + self.deviation, room)

    def room(self, point: PathPoint) -> np.ndarray:
        """Return by how much more than `half_width` the borders can be moved in at places of the line [m]."""
        return ROOM_SHARE * np.maximum(np.minimum(point.left, point.right) - self.half_width, 0.0)

    @property
    def _shift_of_load(self) -> np.ndarray | float:
        return self.load_shift if self.limits.guarded else 0.0

    def bounds(self, found: Linearization) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return bounds of x, shape (N, n), and u, shape (N, m), in SI units; only commands have some."""
        a, N = self.actuators, self.horizon
        # So far from the plan that it is no bound, and near enough for the solver's scaling.
        far = FAR * self.x_scale
        x_lower, x_upper = self.plan.x[1:] - far, self.plan.x[1:] + far
        now = self.plan.x[0]
        x_lower[:, 6], x_upper[:, 6] = min(-a.max_brake_torque, now[6]), max(a.max_torque, now[6])
        if self.limits.guarded:
            # A torque that is beyond its bound already comes back to it at a rate that is sure to be allowed.
            back = RETURN_SHARE * a.torque_rate * self.model.step * np.arange(1, N + 1)
            braking, driving = (
                np.append(one[1:], one[-1])
                for one in torque_limit(self.limits, found, self.model.vehicle, self.grip, self.load_shift)
            )
            x_lower[:, 6] = np.minimum(-np.minimum(braking, a.max_brake_torque), now[6] + back)
            x_upper[:, 6] = np.maximum(np.minimum(driving, a.max_torque), now[6] - back)
        x_lower[:, 7], x_upper[:, 7] = min(-a.max_steer, now[7]), max(a.max_steer, now[7])
        u_upper = np.full((N, self.m), np.inf)
        u_upper[:, 0], u_upper[:, 1] = a.torque_rate, a.steer_rate
        return x_lower, x_upper, -u_upper, u_upper


def _stages(point: PathPoint, which: slice) -> PathPoint:
    return PathPoint(*(getattr(point, name)[which] for name in PathPoint.__dataclass_fields__))
