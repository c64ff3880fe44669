"""The nominal model in discrete time: RK4 over recorded inputs, and phi_1 of the linearised exact step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from split_cli.errors import VehicleError
from split_cli.vehicle.flow import FlowTerm
from split_cli.vehicle.single_track import SingleTrack

_TAYLOR_TERMS = 13
_MOST_SUBSTEPS = 1_000
_TOP_SPEED = 150.0
"""No car is faster [m/s]; a simulation that is has diverged, and it, not a term that reacts in proportion to the
speed, is to blame for steps that are too long."""


@dataclass(frozen=True)
class Situation:
    """What a model needs beside velocities and inputs: when and where, its yaw, and what its terms remember."""

    # t, s, yaw: (N,): time [s], track position [m], yaw angle [rad]; 0 where nothing is known.
    t: Any = 0.0
    s: Any = 0.0
    yaw: Any = 0.0
    # (N,): share of the prior's variance that a trained set explains there; 1 where there is no set.
    knowledge: Any = 1.0
    # (N, S): the terms' states, in the order of ``model.state_names``; None means steady.
    states: np.ndarray | None = None

    def at(self, rows: np.ndarray) -> Situation:
        """Return the situation of some rows only."""
        here = (self.t, self.s, self.yaw, self.knowledge)
        t, s, yaw, knowledge = (value[rows] if np.ndim(value) else value for value in here)
        return Situation(t, s, yaw, knowledge, None if self.states is None else self.states[rows])

    @classmethod
    def joined(cls, parts: Sequence[Situation]) -> Situation:
        """Return the situations of several windows one after the other."""
        t, s, yaw, knowledge = (
            np.concatenate([getattr(part, name) for part in parts])
            if np.ndim(getattr(parts[0], name))
            else getattr(parts[0], name)
            for name in ("t", "s", "yaw", "knowledge")
        )
        states = [part.states for part in parts if part.states is not None]
        return cls(t, s, yaw, knowledge, np.concatenate(states) if states else None)

    def arguments(self, model: SingleTrack) -> dict[str, Any]:
        """Return it as `SingleTrack.flow` takes it, states by name."""
        names = model.state_names
        states = None if self.states is None else dict(zip(names, self.states.T, strict=True)) or None
        return {"t": self.t, "s": self.s, "yaw": self.yaw, "knowledge": self.knowledge, "states": states}


#: Nowhere in particular, from steady.
NOWHERE = Situation()


def integrate_recorded(
    model: SingleTrack,
    state: np.ndarray,
    torque: np.ndarray,
    steer_angle: np.ndarray,
    period: float,
    substeps: int = 1,
    situation: Situation = NOWHERE,
    *,
    held: Sequence[str] = (),
) -> np.ndarray:
    """Integrate the model over recorded inputs with classical RK4, many windows at once.

    Parameters
    ----------
    state : ndarray, shape (N, 3) or (N, 6)
        (v_x, v_y, r), or (X, Y, yaw, v_x, v_y, r), at the start of each window, SI.
    torque, steer_angle : ndarray, shape (N, K + 1)
        Recorded T [N m] and delta [rad] on the window's samples, linear in between (u = [dT, ddelta] constant
        over a sample, as the model's input says) unless held.
    period : float
        Sample period [s].
    substeps : int
        RK4 steps a sample.
    situation : Situation
        At the window's start. Place advances with v_x, yaw with r; the yaw of a `state` with pose goes before.
    held : sequence of str
        Which of ``T`` and ``delta`` keep their value until the next sample.

    Returns
    -------
    ndarray
        State after K samples, same shape as `state`.

    Raises
    ------
    VehicleError
        If a term is so fast that following it would take more than 1,000 substeps a sample. A state that has
        diverged goes on to numbers that are not finite.
    """
    return integrate_with_memory(model, state, torque, steer_angle, period, substeps, situation, held=held)[0]


def acts_at_once(term: FlowTerm, period: float) -> bool:
    """Return whether a term's states are steady at once, seen at a sampling period [s].

    A fit may shrink a lag to nothing: following it would take more than a thousand substeps a sample.
    """
    return bool(term.fastest_rate(_TOP_SPEED) * period > _MOST_SUBSTEPS)


def integrate_with_memory(
    model: SingleTrack,
    state: np.ndarray,
    torque: np.ndarray,
    steer_angle: np.ndarray,
    period: float,
    substeps: int = 1,
    situation: Situation = NOWHERE,
    *,
    held: Sequence[str] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate as `integrate_recorded` does, and return the terms' states at the end as well, shape (N, S)."""
    with_pose = state.shape[1] == 6
    rows = [np.ascontiguousarray(column) for column in state.T]
    if not with_pose:
        rows = [situation.s + 0.0 * rows[0], situation.yaw + 0.0 * rows[0], *rows]
    else:
        rows = [situation.s + 0.0 * rows[3], rows[2], *rows[3:], rows[0], rows[1]]
    count = len(rows)
    if getattr(model, "state_names", ()):
        memory = situation.states
        if memory is None:
            place, psi, vx, vy, r = rows[:5]
            steady = model.flow(vx, vy, r, torque[:, 0], steer_angle[:, 0], yaw=psi, t=situation.t, s=place).values
            memory = np.stack([steady[name] + 0.0 * vx for name in model.state_names], axis=1)
        rows += [np.ascontiguousarray(column) for column in memory.T]
        speed = min(float(np.fmax.reduce(rows[2], initial=0.0)), _TOP_SPEED)
        fastest = max(term.fastest_rate(speed) for term in model.terms)
        if not fastest * period <= _MOST_SUBSTEPS:
            raise VehicleError(
                f"its effects react within {1.0 / fastest:.2g} s, too fast to follow at a period of {period:g} s",
                where=f"vehicle {model.vehicle.name}, effects",
                advice="Leave out a lag or a relaxation that is this short.",
            )
        substeps = max(substeps, int(np.ceil(fastest * period)))
    step = period / substeps
    total = torque.shape[1] - 1
    for sample in range(total):
        d_torque = 0.0 if "T" in held else torque[:, sample + 1] - torque[:, sample]
        d_steer = 0.0 if "delta" in held else steer_angle[:, sample + 1] - steer_angle[:, sample]
        for sub in range(substeps):
            begin = sub / substeps
            rows = _rk4(
                model,
                rows,
                lambda share, k=sample, b=begin, dT=d_torque, dd=d_steer: (
                    torque[:, k] + (b + share / substeps) * dT,
                    steer_angle[:, k] + (b + share / substeps) * dd,
                ),
                step,
                situation.t + (sample + begin) * period,
                situation.knowledge,
            )
    _, psi, vx, vy, r, *position = rows[:count]
    course = [*position, psi, vx, vy, r] if with_pose else [vx, vy, r]
    kept = np.stack(rows[count:], axis=1) if rows[count:] else np.empty((len(state), 0))
    return np.stack(course, axis=1), kept


def _rk4(
    model: SingleTrack, rows: list[np.ndarray], inputs: Any, step: float, time: Any, knowledge: Any
) -> list[np.ndarray]:
    """Advance [s, yaw, v_x, v_y, r(, X, Y)(, term states)] by one classical RK4 step."""
    names = getattr(model, "state_names", ())
    plain = len(rows) - len(names)

    def derivative(now: list[np.ndarray], share: float) -> list[np.ndarray]:
        s, psi, vx, vy, r = now[:5]
        T, delta = inputs(share)
        situation = {"yaw": psi, "t": time + share * step, "s": s, "knowledge": knowledge}
        if names:
            states = dict(zip(names, now[plain:], strict=True))
            flow = model.flow(vx, vy, r, T, delta, states=states, **situation)
            out, memory = [vx, r, *model.balance(flow)], [flow.rates[name] for name in names]
        else:
            out, memory = [vx, r, *model.velocity_derivative(vx, vy, r, T, delta, **situation)], []
        if plain == 7:
            out += [vx * np.cos(psi) - vy * np.sin(psi), vx * np.sin(psi) + vy * np.cos(psi)]
        return out + memory

    k1 = derivative(rows, 0.0)
    k2 = derivative([x + 0.5 * step * k for x, k in zip(rows, k1, strict=True)], 0.5)
    k3 = derivative([x + 0.5 * step * k for x, k in zip(rows, k2, strict=True)], 0.5)
    k4 = derivative([x + step * k for x, k in zip(rows, k3, strict=True)], 1.0)
    return [x + step / 6.0 * (a + 2.0 * b + 2.0 * c + d) for x, a, b, c, d in zip(rows, k1, k2, k3, k4, strict=True)]


def phi_matrix(jacobian: np.ndarray, horizon: float) -> np.ndarray:
    """Return (1/h) times the integral of exp(A s) over 0..h, shape as of A.

    It is how a constant rate g that acts during h arrives in the state after h: h Phi g. Truncated Taylor series
    after halving the argument until its norm is at most 1/2, then doubling by
    phi(2M) = phi(M) (I + exp(M))/2; the truncation is below 1e-16.

    Parameters
    ----------
    jacobian : ndarray, shape (N, K, K)
        A: of the velocities (K = 3), or of all that moves with them.
    horizon : float
        h [s].
    """
    argument = np.asarray(jacobian, dtype=float) * horizon
    norm = np.abs(argument).sum(axis=-1).max(axis=-1)
    # Halved matrix by matrix: a scaling shared by the batch would let neighbours change the last bits.
    halvings = np.ceil(np.log2(np.maximum(norm, 0.5) / 0.5)).astype(int)
    argument = argument / np.exp2(halvings)[..., None, None]
    identity = np.eye(argument.shape[-1])
    phi = np.broadcast_to(identity, argument.shape).copy()
    for k in range(_TAYLOR_TERMS, 0, -1):
        # Horner: phi = I + M/(2) (I + M/3 (I + ...)), since phi_1(M) = sum of M^k/(k+1)!
        phi = identity + argument @ phi / (k + 1)
    for doubling in range(halvings.max(initial=0)):
        open_ = halvings > doubling
        exponential = identity + argument[open_] @ phi[open_]
        phi[open_] = 0.5 * phi[open_] @ (identity + exponential)
        argument[open_] = 2.0 * argument[open_]
    return phi
