"""The model inside a controller: nominal single track plus residual, linearised and discretised exactly."""

from __future__ import annotations

from dataclasses import dataclass, fields

import casadi
import numpy as np

from split_cli.control._compiled import discretize
from split_cli.control.generated import Batch, as_compiled_c
from split_cli.control.policy import SLOWEST
from split_cli.control.residual import Residual, ResidualValues
from split_cli.errors import VehicleError
from split_cli.export.memory import exported_model
from split_cli.export.symbolic import CASADI, build_nominal
from split_cli.learning.features import Z2, FeatureSet
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack


@dataclass(frozen=True)
class Linearization:
    """The discrete model about N states and inputs, with n = 8 + S states."""

    A: np.ndarray  # (N, n, n): x_{k+1} = following_k + A_k (x - x_k) + B_k (u - u_k)
    B: np.ndarray  # (N, n, 2)
    following: np.ndarray  # (N, n): one step on from each of the states
    slip: np.ndarray  # (N, 2): nominal front and rear slip angle [rad]
    slip_slope: np.ndarray  # (N, 2, n)
    residual: ResidualValues
    # (N, 2, 3): B [1/rad], C [1] and D [N] of front and rear, as the vehicle's terms leave them there.
    curve: np.ndarray
    force: np.ndarray  # (N, 2): longitudinal force of front and rear, of the torque that has arrived [N]
    force_slope: np.ndarray  # (N, 2, n)

    def stages(self, which: slice) -> Linearization:
        """Return the model at some of the stages."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        residual = values.pop("residual")
        return Linearization(residual=residual.stages(which), **{name: v[which] for name, v in values.items()})


class ControlModel:
    """x = [X, Y, yaw, v_x, v_y, r, T, delta, states of terms], u = [dT, ddelta], over a step h.

    Parameters
    ----------
    vehicle : Vehicle
        With its named terms, if it has any.
    residual : Residual
        May be replaced between steps, as long as its features stay.
    step : float
        h [s].
    compile_c : bool
        Whether the model's functions become compiled C where a compiler is present. ``not_compiled`` says
        why they did not. Both ways give the same numbers but for rounding.

    Raises
    ------
    VehicleError
        If a term has a delay or a play, which this controller does not follow, or reads time or track position.

    Attributes
    ----------
    scale : ndarray, shape (n,)
        Size of the states on a drive, in their units. In these units the rates of a state are alike, and an
        exponential takes few squarings.

    Notes
    -----
    x' = f(x, u) + B_d g(z(x)) is linearised, A = df/dx + B_d dg/dz dz/dx, and solved exactly over h with the
    inputs held: x+ = x + G f + exp(A h) dx + G B du with G = int_0^h exp(A s) ds. For g alone that is
    h B_d Phi g, the prediction that labels are made for (docs/nomenclature.md).
    """

    def __init__(self, vehicle: Vehicle, residual: Residual, step: float, *, compile_c: bool = True) -> None:
        self.vehicle, self.residual, self.step = vehicle, residual, step
        graph = build_nominal(SingleTrack(vehicle), Z2, step)
        where = f"vehicle {vehicle.name}, effects"
        if graph.jumps is not None or (graph.memory is not None and graph.memory.line):
            what = "has a delay or a play among its effects, and a controller here follows neither"
            raise VehicleError(what, where=where, advice="Drive with a vehicle file without it.")
        if graph.needs_place_and_time:
            what = "has an effect that depends on time or track position, which a controller here does not know"
            raise VehicleError(what, where=where, advice="Drive with a vehicle file without it.")
        check_features(vehicle, residual.features, step)
        self.start, self._asks_knowledge = graph.start, graph.asks_knowledge
        self.memory = graph.rates.size1_in(0) - 6
        self.states = 8 + self.memory
        self._stage, self.not_compiled = _stage_function(vehicle, residual.features, step), "was not asked for"
        if compile_c:
            self._stage, self.not_compiled = as_compiled_c(self._stage)
        self._batches: dict[int, Batch] = {}
        torque = max(vehicle.max_torque, vehicle.max_brake_torque)
        # Terms' states are torques, angles and forces; the size each takes on a drive is not known before.
        size = np.abs(self.steady_states(np.array([0, 0, 0, 10.0, 0.1, 0.1, 0.3 * torque, 0.05])))[8:]
        self.scale = np.concatenate([[1.0, 1.0, 0.1, 1.0, 1.0, 1.0, torque, 0.1], np.maximum(size, 1e-2)])
        self._units = self.scale / self.scale[:, None]

    def steady_states(self, x: np.ndarray) -> np.ndarray:
        """Return the state, shape (n,), whose first eight entries are `x`, with the terms' states settled."""
        if self.start is None:
            return np.asarray(x[:8], dtype=float)
        return np.concatenate([x[:8], np.asarray(self.start(x[2:8], [0.0, 0.0])).ravel()])

    def linearize(self, x: np.ndarray, u: np.ndarray) -> Linearization:
        """Return the discrete model about states `x`, shape (N, n), and inputs `u`, shape (N, 2)."""
        x = np.array(x, dtype=float)
        slow = x[:, 3] < SLOWEST
        kept = x[:, 3].copy()
        x[slow, 3] = SLOWEST
        rates, jacobian, slip, slip_slope, z, z_slope, curve, force, force_slope = self._evaluate(x)
        found = self.residual.along(z)
        if self._asks_knowledge:
            # A lag that training found acts as far as is known at z, of the output that labels show best.
            rates, jacobian, *_ = self._evaluate(x, found.knowledge.max(axis=1))
        f, A = self._whole(x, rates, jacobian)
        f[:, 6:8] = u
        f[:, 3:6] += found.mean
        A[:, 3:6, :] += np.einsum("kij,kjn->kin", found.slope, z_slope)
        E, G = discretize(A * self._units, self.step)
        E, G = E / self._units, G / self._units
        x[:, 3] = kept
        following = x + np.einsum("kij,kj->ki", G, f)
        B, curve = np.ascontiguousarray(G[:, :, 6:8]), curve.reshape(-1, 2, 3)
        return Linearization(E, B, following, slip, slip_slope, found, curve, force, force_slope)

    def follow(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the states, shape (N + 1, n), that inputs `u`, shape (N, 2), lead to from `x`, shape (n,)."""
        states = np.empty((len(u) + 1, self.states))
        states[0] = x
        for k, input_now in enumerate(u):
            states[k + 1] = self.linearize(states[k : k + 1], input_now[None]).following[0]
        return states

    def _evaluate(self, x: np.ndarray, knowledge: np.ndarray | float = 1.0) -> list[np.ndarray]:
        """Evaluate the stage function at N states at once; `knowledge` (N,) counts where a term asks."""
        count = len(x)
        if count not in self._batches:
            self._batches[count] = Batch(self._stage, count)
        given = np.column_stack([x, np.broadcast_to(knowledge, count)]) if self._asks_knowledge else x
        return [a[:, :, 0] if a.shape[2] == 1 else a for a in self._batches[count](given)]

    def _whole(self, x: np.ndarray, rates: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return f without inputs, shape (N, n), and its Jacobian, shape (N, n, n)."""
        count, n = x.shape
        yaw, vx, vy, r = x[:, 2], x[:, 3], x[:, 4], x[:, 5]
        sine, cosine = np.sin(yaw), np.cos(yaw)
        f, A = np.zeros((count, n)), np.zeros((count, n, n))
        f[:, 0], f[:, 1], f[:, 2] = vx * cosine - vy * sine, vx * sine + vy * cosine, r
        A[:, 0, 2], A[:, 0, 3], A[:, 0, 4] = -f[:, 1], cosine, -sine
        A[:, 1, 2], A[:, 1, 3], A[:, 1, 4] = f[:, 0], sine, cosine
        A[:, 2, 5] = 1.0
        moving = [3, 4, 5, *range(8, n)]
        f[:, moving] = rates
        A[:, moving, 2:] = jacobian
        return f, A


def check_features(vehicle: Vehicle, features: FeatureSet, step: float) -> None:
    """Refuse features that no state of a controller determines.

    Raises
    ------
    VehicleError
        Naming them.
    """
    foreign = build_nominal(SingleTrack(vehicle), features, step).foreign_features
    if foreign:
        what = f"the correction needs {', '.join(foreign)}, which the states of the controller do not determine"
        advice = "Use z2, z1, vx, vy, r, delta, T, or states of the terms in the vehicle file."
        raise VehicleError(what, where=f"vehicle {vehicle.name}", advice=advice)


def _stage_function(vehicle: Vehicle, features: FeatureSet, step: float) -> casadi.Function:
    """Return x, and knowledge where a term asks, to what `ControlModel.linearize` needs of one state.

    Rates and their Jacobian by x[2:]; slip angles and theirs by x; features and theirs; the axles' B, C, D;
    longitudinal forces and their Jacobian by x.
    """
    track = SingleTrack(vehicle)
    basic, asked = build_nominal(track, Z2, step), build_nominal(track, features, step)
    n = 2 + basic.rates.size1_in(0)
    x = casadi.SX.sym("x", n)
    known = casadi.SX.sym("k", basic.rates.size1_in(1) - 2)
    rates, jacobian = basic.rates(x[2:], casadi.vertcat(casadi.SX.zeros(2), known))
    given = x if basic.memory is None else casadi.vertcat(x, x[6:8])
    still = casadi.SX.zeros(2)
    z2, z = basic.features(given, still)[0], asked.features(given, still)[0]
    slip = z2[:2]
    curve, force = _axles(track, x)
    outputs = [
        rates,
        jacobian,
        slip,
        casadi.jacobian(slip, x),
        z,
        casadi.jacobian(z, x),
        curve,
        force,
        casadi.jacobian(force, x),
    ]
    return casadi.Function("stage", [casadi.vertcat(x, known)], [casadi.densify(o) for o in outputs], {"cse": True})


def _axles(track: SingleTrack, x: casadi.SX) -> tuple[casadi.SX, casadi.SX]:
    """Return B, C, D of front and rear, shape (6,), and their longitudinal forces [N], shape (2,)."""
    model = exported_model(track)
    states = {name: x[8 + k] for k, name in enumerate(model.state_names)} or None
    flow = model.flow(*(x[i] for i in range(3, 8)), yaw=x[2], ops=CASADI, states=states)
    axles = flow.front, flow.rear
    curve = casadi.vertcat(*(value for axle in axles for value in (axle.B, axle.C, axle.D)))
    return curve, casadi.vertcat(*(axle.longitudinal_force for axle in axles))
