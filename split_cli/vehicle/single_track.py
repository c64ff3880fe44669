"""The nominal single-track model, staged so that named terms can be added between the stages.

One evaluation runs: actuate (what a command becomes), body (mass, inertia, CG), slip angles and longitudinal
forces, tire (B, C, D of an axle), lateral forces, lateral (what becomes of them), external forces, balance.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from split_cli.vehicle.compiled_operations import CompiledOperations, with_change
from split_cli.vehicle.effects import build_terms
from split_cli.vehicle.flow import AxleFlow, Flow, FlowTerm
from split_cli.vehicle.operations import NUMPY, Operations
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import lateral_force, lateral_force_slope

#: v_x', v_y', r': arrays or symbols.
Rates = tuple[Any, Any, Any]

# What the balance is linear in, and what else it asks for.
_FORCES = {
    "front_longitudinal": attrgetter("front.longitudinal_force"),
    "front_lateral": attrgetter("front.lateral_force"),
    "rear_longitudinal": attrgetter("rear.longitudinal_force"),
    "rear_lateral": attrgetter("rear.lateral_force"),
    **{name: attrgetter(name) for name in ("force_x", "force_y", "moment")},
}
_BALANCED_BY = ("mass", "yaw_inertia", "l_f", "l_r", "rotating_mass", "sine", "cosine")


def slip_angles(vx: Any, vy: Any, r: Any, delta: Any, l_f: Any, l_r: Any, ops: Operations = NUMPY) -> tuple[Any, Any]:
    """Return front and rear slip angle [rad]; a positive angle gives a positive (leftward) force.

    Notes
    -----
    alpha_f = delta - atan((v_y + l_f r)/v_x), alpha_r = -atan((v_y - l_r r)/v_x). The front angle is the
    negative of the one the SPLIT paper prints (docs/errata.md).
    """
    return delta - ops.atan2(vy + l_f * r, vx), -ops.atan2(vy - l_r * r, vx)


def _turned_further(slip_angle: Any, delta: Any, before: Any) -> Any:
    return slip_angle + (delta - before)


def complete(axle: AxleFlow, ops: Operations) -> None:
    """Work out the lateral force of an axle where it was left open."""
    if axle.lateral_force is None:
        axle.lateral_force = lateral_force(axle.B, axle.C, axle.D, axle.slip_angle, ops)


def _same_shape(axle: AxleFlow, other: AxleFlow) -> bool:
    """Return whether the forces of two axles differ by the ratio of their peaks alone."""
    return axle.slip_angle is other.slip_angle and _same(axle.B, other.B) and _same(axle.C, other.C)


def _same(one: Any, other: Any) -> bool:
    return one is other or (isinstance(one, float) and isinstance(other, float) and one == other)


class SingleTrack:
    """Continuous single-track model with the terms the vehicle file names.

    Parameters
    ----------
    terms : sequence of FlowTerm, optional
        Terms to include, in order; by default those of ``vehicle.effects``.
    """

    def __init__(self, vehicle: Vehicle, terms: Sequence[FlowTerm] | None = None) -> None:
        self.vehicle = vehicle
        chosen: Sequence[FlowTerm] = build_terms(vehicle) if terms is None else terms
        # Sorting is stable: terms of one order act as listed.
        self.terms: tuple[FlowTerm, ...] = tuple(sorted(chosen, key=lambda term: getattr(term, "order", 5)))
        self.state_names: tuple[str, ...] = tuple(
            name for term in self.terms for name in getattr(term, "state_names", ())
        )

    @cached_property
    def asks_knowledge(self) -> bool:
        """Whether a term acts only as far as a trained set has learned: then `flow` is to be given `knowledge`."""
        return any(getattr(term, "asks_knowledge", False) for term in self.terms)

    @cached_property
    def memory_feeds_back(self) -> bool:
        """Whether a velocity moves what the terms remember, as that of a tyre's force that builds up."""
        names, car = self.state_names, self.vehicle
        if not names:
            return False
        slow = np.array([2.0 * car.minimum_speed])
        moving = slow, 0.02 * slow, 0.02 * slow / car.wheelbase, np.array([0.1 * car.max_torque]), np.array([0.02])
        settled = {name: self.flow(*moving).values[name] + np.zeros(1) for name in names}
        return bool(self.jacobian_with_memory(*moving, states=settled)[0, 3:, :3].any())

    @cached_property
    def in_motion(self) -> "SingleTrack":
        """The model without terms that change no motion, see `Term.moves_car`."""
        moving = [term for term in self.terms if getattr(term, "moves_car", True)]
        return self if len(moving) == len(self.terms) else SingleTrack(self.vehicle, moving)

    def flow(
        self,
        vx: Any,
        vy: Any,
        r: Any,
        T: Any,
        delta: Any,
        *,
        yaw: Any = 0.0,
        t: Any = 0.0,
        s: Any = 0.0,
        knowledge: Any = 1.0,
        ops: Operations = NUMPY,
        states: Mapping[str, Any] | None = None,
        recording: Any = None,
        bare: Flow | None = None,
        arrived: Flow | None = None,
    ) -> Flow:
        """Evaluate every stage and return the flow with all forces, before the balance.

        Parameters are arrays of one shape, in the units of `Flow`. With `recording` they are a whole recording,
        shape (N,), and states and delays are solved along it. `bare` is a flow of the same vehicle without terms
        at the very same arrays: what the terms leave as it was is taken from there instead of being computed anew.
        `arrived` is the same with those of the terms that act on commands, which then have acted already.
        """
        car = self.vehicle
        acted, nominal = self, bare
        if arrived is not None:
            acted, bare, T, delta = SingleTrack(car, ()), arrived, arrived.T, arrived.delta
        flow = acted.actuated(
            vx, vy, r, T, delta, yaw=yaw, t=t, s=s, knowledge=knowledge, ops=ops, states=states, recording=recording
        )
        for term in self.terms:
            term.body(flow)
        front, rear = flow.front, flow.rear
        self._turn(flow, bare)
        if bare is not None and flow.T is bare.T:
            front.longitudinal_force = bare.front.longitudinal_force
            rear.longitudinal_force = bare.rear.longitudinal_force
        else:
            forces = flow.cached(self._longitudinal_forces, car, flow.T, ops)
            front.longitudinal_force, rear.longitudinal_force = forces
        for term in self.terms:
            term.tire(flow)
        known_axles = (None, None) if bare is None else (bare.front, bare.rear)
        for axle, known in zip((front, rear), known_axles, strict=True):
            if known is not None and _same_shape(axle, known):
                complete(known, ops)
                same_peak = _same(axle.D, known.D)
                axle.lateral_force = known.lateral_force if same_peak else axle.D / known.D * known.lateral_force
            else:
                axle.lateral_force = flow.cached(lateral_force, axle.B, axle.C, axle.D, axle.slip_angle, ops)
        for term in self.terms:
            term.lateral(flow)
        if nominal is not None and vx is nominal.vx:
            flow.force_x = nominal.force_x
        else:
            flow.force_x = -car.drag_coefficient * vx * vx
        for term in self.terms:
            term.external(flow)
        return flow

    def turned(self, bare: Flow, vx: Any, vy: Any, r: Any) -> Flow:
        """Return the flow without terms at other velocities, its lateral forces left open until `complete`.

        `bare` is the same at the recorded ones. Terms that alter tyres have forces of their own.
        """
        flow = self.actuated(
            vx, vy, r, bare.T, bare.delta, yaw=bare.yaw, t=bare.t, s=bare.s, ops=bare.ops, recording=bare.recording
        )
        self._turn(flow, bare)
        flow.force_x = -self.vehicle.drag_coefficient * vx * vx
        for axle, known in ((flow.front, bare.front), (flow.rear, bare.rear)):
            axle.longitudinal_force, axle.lateral_force = known.longitudinal_force, None
        return flow

    def actuated(
        self,
        vx: Any,
        vy: Any,
        r: Any,
        T: Any,
        delta: Any,
        *,
        yaw: Any = 0.0,
        t: Any = 0.0,
        s: Any = 0.0,
        knowledge: Any = 1.0,
        ops: Operations = NUMPY,
        states: Mapping[str, Any] | None = None,
        recording: Any = None,
    ) -> Flow:
        """Return the flow as far as its first stage: what has become of the commands; parameters as of `flow`."""
        car = self.vehicle
        flow = Flow(
            ops=ops,
            vehicle=car,
            vx=vx,
            vy=vy,
            r=r,
            T=T,
            delta=delta,
            yaw=yaw,
            t=t,
            s=s,
            mass=car.mass,
            yaw_inertia=car.yaw_inertia,
            l_f=car.cg_to_front_axle,
            l_r=car.cg_to_rear_axle,
            front=AxleFlow(car.front_tire.B, car.front_tire.C, car.front_tire.D),
            rear=AxleFlow(car.rear_tire.B, car.rear_tire.C, car.rear_tire.D),
            states=states,
            recording=recording,
            knowledge=knowledge,
        )
        for term in self.terms:
            term.actuate(flow)
        return flow

    @staticmethod
    def _turn(flow: Flow, bare: Flow | None) -> None:
        """Take where the wheels point: sine and cosine of the steer angle, and slip angles."""
        ops = flow.ops
        if bare is not None and flow.delta is bare.delta:
            flow.sine, flow.cosine = bare.sine, bare.cosine
        else:
            flow.sine, flow.cosine = flow.cached(ops.sin, flow.delta), flow.cached(ops.cos, flow.delta)
        alike = ("vx", "vy", "r", "l_f", "l_r")
        if bare is None or any(getattr(flow, name) is not getattr(bare, name) for name in alike):
            flow.front.slip_angle, flow.rear.slip_angle = slip_angles(
                flow.vx, flow.vy, flow.r, flow.delta, flow.l_f, flow.l_r, ops
            )
            return
        # The axles move as they did: steering turns but the front one.
        turned = bare.front.slip_angle
        if flow.delta is bare.delta:
            flow.front.slip_angle = turned
        else:
            flow.front.slip_angle = flow.cached(_turned_further, turned, flow.delta, bare.delta)
        flow.rear.slip_angle = bare.rear.slip_angle

    @staticmethod
    def _longitudinal_forces(car: Vehicle, T: Any, ops: Operations) -> tuple[Any, Any]:
        """Return F_fx and F_rx [N]: SPLIT paper, longitudinal tire forces, with a split of its own for T < 0."""
        kappa = car.drive_split_front
        if car.brake_split_front != kappa:
            kappa = ops.where(T < 0.0, car.brake_split_front, kappa)
        force = T / car.wheel_radius
        return kappa * force - car.rolling_resistance_front, (1.0 - kappa) * force - car.rolling_resistance_rear

    def velocity_derivative(self, vx: Any, vy: Any, r: Any, T: Any, delta: Any, **situation: Any) -> Rates:
        """Return (v_x', v_y', r') [m/s^2], [m/s^2], [rad/s^2].

        Parameters
        ----------
        vx, vy, r, T, delta : array
            Any one shape.
        **situation
            ``yaw``, ``t``, ``s``, ``knowledge``, ``ops``, ``states``, ``recording`` as for `flow`.

        Notes
        -----
        SPLIT paper, the nominal model; terms act between its stages.
        """
        return self.balance(self.flow(vx, vy, r, T, delta, **situation))

    @staticmethod
    def balance(f: Flow) -> Rates:
        """Return (v_x', v_y', r') of an evaluated flow."""
        if isinstance(f.ops, CompiledOperations) and (rates := f.ops.balance(f)) is not None:
            return rates
        front_x = f.front.longitudinal_force * f.cosine - f.front.lateral_force * f.sine
        front_y = f.front.lateral_force * f.cosine + f.front.longitudinal_force * f.sine
        dvx = (f.rear.longitudinal_force + front_x + f.force_x) / f.mass + f.vy * f.r
        dvx = dvx * (f.mass / (f.mass + f.rotating_mass))
        dvy = (f.rear.lateral_force + front_y + f.force_y) / f.mass - f.vx * f.r
        dr = (front_y * f.l_f - f.rear.lateral_force * f.l_r + f.moment) / f.yaw_inertia
        return dvx, dvy, dr

    @classmethod
    def weighted_changes(cls, bare: Flow, weighted: Iterable[tuple[float, Flow]]) -> Rates:
        """Return the sum over flows of a weight times what each changes of (v_x', v_y', r') against a bare one.

        Parameters
        ----------
        bare : Flow
            Of the same vehicle at the very same arrays, as the flows are.
        weighted : iterable of (float, Flow)

        Notes
        -----
        The balance is linear in the forces: where nothing else changes, they are added up first.
        """
        sums: dict[str, Any] = dict.fromkeys(_FORCES, 0.0)
        base = cls.balance(bare)
        out = [0.0 * rate for rate in base]
        for weight, flow in weighted:
            if any(getattr(flow, name) is not getattr(bare, name) for name in _BALANCED_BY):
                for k, (rate, before) in enumerate(zip(cls.balance(flow), base, strict=True)):
                    out[k] = out[k] + weight * (rate - before)
                continue
            for name, force in _FORCES.items():
                after, before = force(flow), force(bare)
                if after is not before:
                    sums[name] = with_change(sums[name], weight, after, before)
        axles: dict[str, Any] = {
            axle: AxleFlow(0.0, 0.0, 0.0, 0.0, sums[f"{axle}_longitudinal"], sums[f"{axle}_lateral"])
            for axle in ("front", "rear")
        }
        # At rest, where nothing turns the velocities.
        external = {name: sums[name] for name in ("force_x", "force_y", "moment")}
        together = cls.balance(replace(bare, vx=0.0, vy=0.0, r=0.0, **axles, **external))
        return out[0] + together[0], out[1] + together[1], out[2] + together[2]

    def velocity_jacobian(
        self, vx: np.ndarray, vy: np.ndarray, r: np.ndarray, T: np.ndarray, delta: np.ndarray, **situation: Any
    ) -> np.ndarray:
        """Return A, the Jacobian of (v_x', v_y', r') with respect to (v_x, v_y, r), shape (N, 3, 3).

        Closed form for the plain nominal model; with terms, central differences of steps 1e-6 (1 + |v|), whose
        error is about 1e-9 of the entries.
        """
        if self.terms:
            return self._jacobian_by_differences(vx, vy, r, T, delta, **situation)
        car = self.vehicle
        m, i_z, l_f, l_r = car.mass, car.yaw_inertia, car.cg_to_front_axle, car.cg_to_rear_axle
        alpha_f, alpha_r = slip_angles(vx, vy, r, delta, l_f, l_r)
        slope_f = lateral_force_slope(car.front_tire.B, car.front_tire.C, car.front_tire.D, alpha_f)
        slope_r = lateral_force_slope(car.rear_tire.B, car.rear_tire.C, car.rear_tire.D, alpha_r)
        w_f, w_r = vy + l_f * r, vy - l_r * r
        q_f, q_r = vx * vx + w_f * w_f, vx * vx + w_r * w_r
        # Rows: derivative of the lateral force with respect to v_x, v_y, r.
        d_front = slope_f / q_f * np.stack([w_f, -vx, -l_f * vx])
        d_rear = slope_r / q_r * np.stack([w_r, -vx, l_r * vx])
        sine, cosine = np.sin(delta), np.cos(delta)
        jacobian = np.empty((*np.shape(vx), 3, 3))
        for column in range(3):
            jacobian[..., 0, column] = -d_front[column] * sine / m
            jacobian[..., 1, column] = (d_rear[column] + d_front[column] * cosine) / m
            jacobian[..., 2, column] = (d_front[column] * cosine * l_f - d_rear[column] * l_r) / i_z
        jacobian[..., 0, 0] -= 2.0 * car.drag_coefficient * vx / m
        jacobian[..., 0, 1] += r
        jacobian[..., 0, 2] += vy
        jacobian[..., 1, 0] -= r
        jacobian[..., 1, 2] -= vx
        return jacobian

    def _jacobian_by_differences(
        self, vx: np.ndarray, vy: np.ndarray, r: np.ndarray, T: np.ndarray, delta: np.ndarray, **situation: Any
    ) -> np.ndarray:
        velocity = [np.asarray(component, dtype=float) for component in (vx, vy, r)]
        jacobian = np.empty((*np.shape(vx), 3, 3))
        for column in range(3):
            step = 1e-6 * (1.0 + np.abs(velocity[column]))
            ahead, behind = list(velocity), list(velocity)
            ahead[column] = velocity[column] + step
            behind[column] = velocity[column] - step
            width = ahead[column] - behind[column]
            after = self.velocity_derivative(ahead[0], ahead[1], ahead[2], T, delta, **situation)
            before = self.velocity_derivative(behind[0], behind[1], behind[2], T, delta, **situation)
            for row in range(3):
                jacobian[..., row, column] = (after[row] - before[row]) / width
        return jacobian

    def jacobian_with_memory(
        self,
        vx: np.ndarray,
        vy: np.ndarray,
        r: np.ndarray,
        T: np.ndarray,
        delta: np.ndarray,
        *,
        states: Mapping[str, np.ndarray],
        **situation: Any,
    ) -> np.ndarray:
        """Return the Jacobian of velocities and the terms' states together, shape (N, 3 + S, 3 + S).

        Parameters
        ----------
        states : mapping of str to ndarray of shape (N,)
            All of `state_names`, in whose order rows and columns follow those of v_x, v_y, r.
        **situation
            As for `velocity_derivative`.

        Notes
        -----
        `velocity_jacobian` holds the states still: a force that builds up late answers to no velocity there. By
        central differences of steps 1e-6 (1 + |x|).
        """
        names = self.state_names
        begin = [np.asarray(one, dtype=float) for one in (vx, vy, r, *(states[name] for name in names))]

        def derivative(x: Sequence[np.ndarray]) -> np.ndarray:
            there = dict(zip(names, x[3:], strict=True))
            flow = self.flow(x[0], x[1], x[2], T, delta, states=there, **situation)
            rates = [*self.balance(flow), *(flow.rates[name] for name in names)]
            return np.stack([np.broadcast_to(rate, np.shape(vx)) for rate in rates], axis=-1)

        columns = []
        for k, value in enumerate(begin):
            step = 1e-6 * (1.0 + np.abs(value))
            ahead, behind = ([*begin[:k], value + side * step, *begin[k + 1 :]] for side in (1.0, -1.0))
            columns.append((derivative(ahead) - derivative(behind)) / (ahead[k] - behind[k])[..., None])
        return np.stack(columns, axis=-1)
