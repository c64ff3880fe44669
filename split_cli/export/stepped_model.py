"""The exported model stepped in NumPy: what exports are compared with, from anywhere and along drives.

Single steps take past commands by `numpy.interp`; drives are followed as recordings are, delays and plays solved
along the whole of it, so that a line of past commands that shifts wrongly shows.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from split_cli.errors import OUR_FAULT, ExportError
from split_cli.export.memory import COMMANDS, Memory, exported_model, nothing_kept, present
from split_cli.export.reference import Reference
from split_cli.export.symbolic import NominalGraph
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects.recording import Recording, shifted
from split_cli.vehicle.integration import Situation, integrate_with_memory, phi_matrix
from split_cli.vehicle.single_track import SingleTrack

_DRIVES, _STEPS = 4, 40
_DIFFERENCES = 1e-5
_RK4_SUBSTEPS = 4


@dataclass(frozen=True)
class Drives:
    """Drives of the model by itself, from steady."""

    u: np.ndarray  # (K, R, 2)
    place_time: np.ndarray  # (K, R, 2): t and s at each step's start
    # exact, runge_kutta: (K + 1, R, n): whole states by either discretisation.
    exact: np.ndarray
    runge_kutta: np.ndarray
    step: float  # [s]


def rk4_substeps(memory: Memory | None) -> int:
    """Return the substeps of the Runge-Kutta step that is compared: what states of terms need up to 100 m/s."""
    if memory is None:
        return _RK4_SUBSTEPS
    standing, moving = memory.rates
    return max(_RK4_SUBSTEPS, 1 + int(np.ceil((standing + 100.0 * moving) * memory.step)))


class SteppedModel:
    """The model with its memory in NumPy; the linear Jacobian is the traced one, checked by differences."""

    def __init__(self, graph: NominalGraph, training_set: TrainingSet, reference: Reference) -> None:
        self.graph, self.training_set, self.reference = graph, training_set, reference
        self.model = exported_model(SingleTrack(training_set.vehicle))
        self.memory = graph.memory or nothing_kept(training_set.horizon)
        self.step = self.memory.step
        self.substeps = rk4_substeps(graph.memory)

    def arrivals(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what arrives at a step's start and end, shape (N, 2) each, of whole states (N, n)."""
        h, first, last = self.step, np.empty((len(x), 2)), np.empty((len(x), 2))
        begin = self.memory.continuous
        for c, (length, delay) in enumerate(zip(self.memory.lengths, self.memory.delays, strict=True)):
            past = x[:, begin : begin + length][:, ::-1]
            begin += length
            known = np.column_stack([past, x[:, 6 + c], x[:, 6 + c] + h * u[:, c]])
            times = h * np.arange(-length, 2)
            for k, row in enumerate(known):
                first[k, c], last[k, c] = np.interp([-delay, h - delay], times, row)
        return first, last

    def acting(self, x: np.ndarray, arrived: np.ndarray) -> np.ndarray:
        """Return what acts, shape (N, 8 + S), of whole states (N, n) and what arrives (N, 2)."""
        return np.column_stack([x[:, :6], arrived, x[:, 8 : self.memory.continuous]])

    def dragged(self, acting: np.ndarray, command: np.ndarray) -> np.ndarray:
        """Return where commands (N, 2) drag the plays, shape (N, P), of what acts (N, 8 + S)."""
        names = self.memory.names
        states = dict(zip(names, acting[:, 8:].T, strict=True))
        flow = self.model.flow(*acting[:, 3:6].T, *command.T, yaw=acting[:, 2], states=states or None)
        return np.stack([flow.pulled[names[k]] for k in self.memory.plays], axis=1)

    def features(self, acting: np.ndarray, command: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return features (N, D) and their slopes (N, D, 8 + S + 4) by what acts, command and input."""
        given = acting if self.graph.memory is None else np.column_stack([acting, command])
        z, flat = present(self.graph.features).map(len(u))(given.T, u.T)
        slopes = np.asarray(flat).reshape(-1, len(u), given.shape[1] + 2).transpose(1, 0, 2)
        if self.graph.memory is None:  # without a memory the command is what acts
            slopes = np.insert(slopes, [8, 8], 0.0, axis=2)
        return np.asarray(z).T, slopes

    def situation(self, acting: np.ndarray, command: np.ndarray, u: np.ndarray, place_time: np.ndarray) -> np.ndarray:
        """Return t, s and how much the set knows as a step begins, shape (N, 3); 1 where no term asks."""
        known = np.ones(len(u))
        if self.graph.asks_knowledge:
            known = self.reference.knowledge(self.features(acting, command, u)[0])
        return np.column_stack([place_time, known])

    def _traced(self, acting: np.ndarray, situation: np.ndarray) -> tuple[Any, Any]:
        """Return the traced rates and their Jacobian."""
        asked = situation if self.graph.asks_knowledge else situation[:, :2]
        rates, jacobian = self.graph.rates.map(len(acting))(acting[:, 2:].T, asked.T)
        return rates, jacobian

    def linear(self, acting: np.ndarray, driven: np.ndarray, situation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return f (N, 8 + S) and A of what acts; `driven` (N, 2 + P): rates of commands and plays."""
        count, size = acting.shape
        found = self._traced(acting, situation)
        rows, columns = size - 5, size - 2
        rates = np.asarray(found[0]).T
        jacobian = np.asarray(found[1]).reshape(rows, count, columns).transpose(1, 0, 2)
        x = acting
        sine, cosine = np.sin(x[:, 2]), np.cos(x[:, 2])
        east, north = x[:, 3] * cosine - x[:, 4] * sine, x[:, 3] * sine + x[:, 4] * cosine
        A = np.zeros((count, size, size))
        A[:, 0, 2], A[:, 0, 3], A[:, 0, 4] = -north, cosine, -sine
        A[:, 1, 2], A[:, 1, 3], A[:, 1, 4] = east, sine, cosine
        A[:, 2, 5] = 1.0
        A[:, 3:6, 2:], A[:, 8:, 2:] = jacobian[:, :3], jacobian[:, 3:]
        f = np.column_stack([east, north, x[:, 5], rates[:, :3], driven[:, :2], rates[:, 3:]])
        for k, play in enumerate(self.memory.plays):
            f[:, 8 + play], A[:, 8 + play] = driven[:, 2 + k], 0.0
        return f, A

    def rates(self, acting: np.ndarray, u: np.ndarray, situation: np.ndarray) -> np.ndarray:
        """Return x' of what acts without the residual, by NumPy, shape (N, 8 + S)."""
        names, x = self.memory.names, acting
        states = dict(zip(names, x[:, 8:].T, strict=True)) or None
        t, s, knowledge = situation.T
        flow = self.model.flow(*x[:, 3:8].T, states=states, yaw=x[:, 2], t=t, s=s, knowledge=knowledge)
        sine, cosine = np.sin(x[:, 2]), np.cos(x[:, 2])
        east, north = x[:, 3] * cosine - x[:, 4] * sine, x[:, 3] * sine + x[:, 4] * cosine
        columns = [east, north, x[:, 5], *self.model.balance(flow), *u.T, *(flow.rates[name] for name in names)]
        return np.stack([np.broadcast_to(column, len(x)) for column in columns], axis=1)

    def residual(
        self, acting: np.ndarray, command: np.ndarray, u: np.ndarray, A: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return what the residual adds in a step, shape (N, K), and Phi, shape (N, K, 3).

        K is 3, for v_x, v_y, r; where these move the terms' states all that follows the pose.
        """
        last = A.shape[1] if self.graph.feeds_back else 6
        phi = phi_matrix(A[:, 3:last, 3:last], self.step)[:, :, :3]
        if self.training_set.plain:
            phi = np.broadcast_to(np.eye(last - 3, 3), phi.shape)
        mean = self.reference.predict(self.features(acting, command, u)[0]).mean
        return self.step * (phi @ mean[:, :, None])[..., 0], phi

    def advance(
        self, acting: np.ndarray, driven: np.ndarray, command: np.ndarray, u: np.ndarray, place_time: np.ndarray
    ) -> np.ndarray:
        """Return what acts after a linearised exact step, shape (N, 8 + S)."""
        f, A = self.linear(acting, driven, self.situation(acting, command, u, place_time))
        size = acting.shape[1]
        augmented = np.zeros((len(acting), size + 1, size + 1))
        augmented[:, :size, :size], augmented[:, :size, size] = A, f
        moved: np.ndarray = acting + scipy.linalg.expm(augmented * self.step)[:, :size, size]
        added, _ = self.residual(acting, command, u, A)
        moved[:, 3 : 3 + added.shape[1]] += added
        return moved

    def integrate(
        self, acting: np.ndarray, last: np.ndarray, command: np.ndarray, u: np.ndarray, place_time: np.ndarray
    ) -> np.ndarray:
        """Return what acts after a step of Runge-Kutta, as labels are made; `last` arrives at its end."""
        situation = self.situation(acting, command, u, place_time)
        t, s, knowledge = situation.T
        torque, steer = (np.column_stack([acting[:, 6 + c], last[:, c]]) for c in (0, 1))
        moved, states = integrate_with_memory(
            self.model,
            acting[:, :6],
            torque,
            steer,
            self.step,
            self.substeps,
            Situation(t, s, knowledge=knowledge, states=acting[:, 8:]),
        )
        _, A = self.linear(acting, np.zeros((len(u), 2 + len(self.memory.plays))), situation)
        added, _ = self.residual(acting, command, u, A)
        moved[:, 3:6] += added[:, :3]
        return np.column_stack([moved, last, states + added[:, 5:] if self.graph.feeds_back else states])

    def nominal_end(self, x: np.ndarray, u: np.ndarray, place_time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return velocities after a nominal step of Runge-Kutta (N, 3), and what each whole correction adds.

        The second has shape (N, 3, 3): a row a velocity, a column a correction.
        """
        first, last = self.arrivals(x, u)
        acting = self.acting(x, first)
        situation = self.situation(acting, x[:, 6:8], u, place_time)
        _, A = self.linear(acting, np.zeros((len(u), 2 + len(self.memory.plays))), situation)
        added, phi = self.residual(acting, x[:, 6:8], u, A)
        mean = self.reference.predict(self.features(acting, x[:, 6:8], u)[0]).mean
        ended = self.integrate(acting, last, x[:, 6:8], u, place_time)
        return ended[:, 3:6] - added[:, :3], self.step * phi[:, :3] * mean[:, None, :]

    def one_step(self, x: np.ndarray, u: np.ndarray, place_time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return whole states after a step of either kind, shape (N, n)."""
        first, last = self.arrivals(x, u)
        acting = self.acting(x, first)
        driven = (last - first) / self.step
        if self.memory.plays:
            plays = [8 + k for k in self.memory.plays]
            driven = np.column_stack([driven, (self.dragged(acting, last) - acting[:, plays]) / self.step])
        command = x[:, 6:8]
        exact = self.advance(acting, driven, command, u, place_time)
        recorded = self.integrate(acting, last, command, u, place_time)
        return self._whole(x, u, exact), self._whole(x, u, recorded)

    def _whole(self, x: np.ndarray, u: np.ndarray, acting: np.ndarray) -> np.ndarray:
        """Return the whole state after a step from what acts then."""
        line, begin = [], self.memory.continuous
        for c, length in enumerate(self.memory.lengths):
            if length:
                line += [x[:, [6 + c]], x[:, begin : begin + length - 1]]
            begin += length
        return np.column_stack([acting[:, :6], x[:, 6:8] + self.step * u, acting[:, 8:], *line])

    def derivative(self, x: np.ndarray, u: np.ndarray, place_time: np.ndarray) -> np.ndarray:
        """Return the slopes of the exact step by (x, u), shape (N, n, n + 2); A, Phi and knowledge are held."""
        count, n = x.shape
        size, plays = self.memory.continuous, self.memory.plays
        first, last = self.arrivals(x, u)
        acting = self.acting(x, first)
        situation = self.situation(acting, x[:, 6:8], u, place_time)
        f, A = self.linear(acting, np.zeros((count, 2 + len(plays))), situation)
        augmented = np.zeros((count, 2 * size, 2 * size))
        augmented[:, :size, :size], augmented[:, :size, size:] = A, np.eye(size)
        exponential = scipy.linalg.expm(augmented * self.step)
        slopes = np.empty((count, n, n + 2))
        z, z_slopes = self.features(acting, x[:, 6:8], u)
        _, phi = self.residual(acting, x[:, 6:8], u, A)
        gain = self.step * phi @ self.reference.jacobian_by_differences(z) @ z_slopes
        drag = self._drag_slopes(acting, last) if plays else np.empty((count, 0, 0))
        for column in range(n + 2):
            along = np.zeros((1, n + 2))
            along[0, column] = 1.0
            begins, ends = self.arrivals(along[:, :n], along[:, n:])
            moved = np.concatenate([along[0, :6], begins[0], along[0, 8:size]])
            drive = np.zeros((count, size))
            drive[:, 6:8] = (ends[0] - begins[0]) / self.step
            for k, play in enumerate(plays):
                end = drag[:, k] @ np.concatenate([ends[0], moved[[8 + p for p in plays]]])
                drive[:, 8 + play] = (end - moved[8 + play]) / self.step
            after = exponential[:, :size, :size] @ moved
            after += (exponential[:, :size, size:] @ drive[:, :, None])[..., 0]
            after[:, 3 : 3 + gain.shape[1]] += gain @ np.concatenate([moved, along[0, 6:8], along[0, n:]])
            slopes[:, :, column] = self._whole(np.repeat(along[:, :n], count, axis=0), along[:, n:], after)
        return slopes

    def _drag_slopes(self, acting: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return the slopes of the plays by (T, delta, plays), by differences, shape (N, P, 2 + P)."""
        plays, columns = self.memory.plays, []
        for k in range(2 + len(plays)):
            values = []
            for sign in (1.0, -1.0):
                at, command = acting.copy(), last.copy()
                if k < 2:
                    command[:, k] += sign * 1e-7
                else:
                    at[:, 8 + plays[k - 2]] += sign * 1e-7
                values.append(self.dragged(at, command))
            columns.append((values[0] - values[1]) / 2e-7)
        return np.stack(columns, axis=2)

    def require_slopes(self, x: np.ndarray, place_time: np.ndarray) -> None:
        """Compare the traced Jacobian of velocities and states with differences of NumPy's model.

        Raises
        ------
        ExportError
            If they differ.
        """
        size = self.memory.continuous
        still = np.zeros((len(x), 2))
        first, _ = self.arrivals(x, still)
        acting = self.acting(x, first)
        situation = self.situation(acting, x[:, 6:8], still, place_time)
        found = self._traced(acting, situation)[1]
        found = np.asarray(found).reshape(size - 5, len(x), size - 2).transpose(1, 0, 2)

        def rates(at: np.ndarray) -> np.ndarray:
            return np.delete(self.rates(at, still, situation), [0, 1, 2, 6, 7], axis=1)

        for column in range(2, size):
            move = np.zeros(size)
            move[column] = 1e-6 * (1.0 + np.abs(acting[:, column]).max())
            near = rates(acting + move) - rates(acting - move)
            expected = near / (2.0 * move[column])
            wrong = np.abs(found[:, :, column - 2] - expected) > _DIFFERENCES * (1.0 + np.abs(rates(acting)))
            # A kink within the move: either side's slope is right there.
            if wrong.any(axis=1).mean() > 0.05:
                what = "the traced model's Jacobian is not that of Python; nothing was written"
                raise ExportError(what, advice=OUR_FAULT)


def random_memory(memory_model: SteppedModel, x: np.ndarray, place_time: np.ndarray) -> np.ndarray:
    """Return whole states (N, n) with first eight `x`, their memory on its way from somewhere."""
    rng, memory = np.random.default_rng(17), memory_model.memory
    parts = [x]
    if memory.states:
        settled = np.asarray(present(memory_model.graph.start).map(len(x))(x[:, 2:8].T, place_time.T)).T
        parts.append(settled * rng.uniform(0.7, 1.3, settled.shape))
    for c, length in enumerate(memory.lengths):
        size = 0.1 * np.abs(x[:, [6 + c]]).mean()
        parts.append(x[:, [6 + c]] + np.cumsum(rng.normal(0.0, size, (len(x), length)), axis=1))
    return np.column_stack(parts)


def roll_drives(memory_model: SteppedModel) -> Drives:
    """Drive turns with torque and brake from a steady start, following delays and plays along the recording.

    Raises
    ------
    ExportError
        If features along the drive differ from those that training would compute of it.
    """
    m, h = memory_model, memory_model.step
    u, nodes, x0, place_time = _commands(m)
    clock = Recording.single(h, _STEPS + 1)
    late = np.stack(
        [np.stack([shifted(series, m.memory.delays[c], clock) for series in nodes[:, :, c].T], axis=1) for c in (0, 1)],
        axis=2,
    )
    driven = (late[1:] - late[:-1]) / h
    plays = _plays(m, nodes, clock)
    driven = np.concatenate([driven, (plays[1:] - plays[:-1]) / h], axis=2)
    exact, recorded = [x0], [x0]
    for k in range(_STEPS):
        for path, kind in ((exact, 0), (recorded, 1)):
            x = path[-1]
            acting = m.acting(x, late[k])
            given = (nodes[k], u[k], place_time[k])
            after = m.advance(acting, driven[k], *given) if kind == 0 else m.integrate(acting, late[k + 1], *given)
            line = _line(m, nodes, k + 1)
            path.append(np.column_stack([after[:, :6], nodes[k + 1], after[:, 8:], line]))
    drives = Drives(u, place_time, np.stack(exact), np.stack(recorded), h)
    _require_features(m, drives, late)
    return drives


def _line(m: SteppedModel, nodes: np.ndarray, k: int) -> np.ndarray:
    """Return past commands at sample k, held before the start, shape (R, N_T + N_delta)."""
    past = [nodes[max(k - j, 0), :, c] for c in (0, 1) for j in range(1, m.memory.lengths[c] + 1)]
    return np.stack(past, axis=1) if past else np.empty((nodes.shape[1], 0))


def _plays(m: SteppedModel, nodes: np.ndarray, clock: Recording) -> np.ndarray:
    """Return the plays along each drive, by the exact operator, shape (K + 1, R, P)."""
    out = np.empty((len(nodes), nodes.shape[1], len(m.memory.plays)))
    still = np.full(len(nodes), 20.0), np.zeros(len(nodes)), np.zeros(len(nodes))
    for drive in range(nodes.shape[1]):
        flow = m.model.flow(*still, *nodes[:, drive].T, recording=clock)
        for k, play in enumerate(m.memory.plays):
            out[:, drive, k] = flow.values[m.memory.names[play]]
    return out


def _commands(m: SteppedModel) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return input (K, R, 2), commands (K + 1, R, 2), whole start states (R, n), and t, s (K, R, 2)."""
    rng, car, h = np.random.default_rng(23), m.training_set.vehicle, m.step
    speed = m.training_set.region.minimum_speed * np.linspace(2.0, 5.0, _DRIVES)
    time = h * np.arange(_STEPS + 1)[:, None]
    # Turns of about 3 m/s^2 to either side and torque of either sign, a kink at every step.
    turn = 3.0 * car.wheelbase / speed**2 * np.sin(2.0 * np.pi * time / (12.0 * h) + rng.uniform(0, 6, _DRIVES))
    push = 0.3 * car.max_torque * np.sin(2.0 * np.pi * time / (17.0 * h) + rng.uniform(0, 6, _DRIVES))
    nodes = np.stack([push, turn], axis=2)
    u = np.diff(nodes, axis=0) / h
    # Commands are integrated as the step does it.
    nodes = nodes[:1] + np.concatenate([np.zeros_like(u[:1]), h * np.cumsum(u, axis=0)])
    zero = np.zeros(_DRIVES)
    x = np.column_stack([zero, zero, rng.uniform(-3, 3, _DRIVES), speed, zero, zero, nodes[0]])
    # Stretches are entered and left in the middle of drives.
    edges = [term.parameters[key] for term in m.model.terms for key in ("s_start", "s_end") if key in term.parameters]
    middle = np.resize(edges, _DRIVES) if edges else rng.uniform(0.0, 900.0, _DRIVES)
    half = 0.5 * _STEPS * h
    place_time = np.stack(
        [time[:-1] + rng.uniform(0.0, 60.0, _DRIVES), middle + 0.37 + speed * (time[:-1] - half)], axis=2
    )
    states = []
    if m.memory.states:
        settled = m.model.flow(*x[:, 3:8].T, yaw=x[:, 2], t=place_time[0, :, 0], s=place_time[0, :, 1]).values
        states = [np.broadcast_to(settled[name], _DRIVES) for name in m.memory.names]
    return u, nodes, np.column_stack([x, *states, _line(m, nodes, 0)]), place_time


def _require_features(m: SteppedModel, drives: Drives, late: np.ndarray) -> None:
    """Compare features along the drives with those of `FeatureSet.compute`, which training uses.

    States of terms are left out: between samples the step follows its linear model, training a straight line.
    Where a state follows the motion, as a slip angle behind a lag, both differ by the curvature within a step.
    """
    names = m.training_set.features.names
    followed = [k for k, name in enumerate(names) if name != "steer_rate" and name not in m.memory.names]
    for drive in range(_DRIVES):
        x = drives.exact[:-1, drive]
        channels = ("X", "Y", "yaw", "vx", "vy", "r", *COMMANDS)
        columns = {name: x[:, k] for k, name in enumerate(channels)}
        columns["t"] = drives.place_time[:, drive, 0]
        recorded = Drive("check", columns, np.zeros(len(x), dtype=np.int32), m.step)
        expected = m.training_set.features.compute(m.model, recorded)[:, followed]
        acting = m.acting(x, late[:-1, drive])
        found = m.features(acting, x[:, 6:8], drives.u[:, drive])[0][:, followed]
        if not np.allclose(found, expected, rtol=1e-9, atol=1e-9):
            what = "features along a drive are not those of training; nothing was written"
            raise ExportError(what, advice=OUR_FAULT)
