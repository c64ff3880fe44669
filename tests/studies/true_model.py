"""What a perfect model would leave: laps of the race's own controller with the plant's equations as its model.

Example: ``python -m tests.studies.true_model small true base margin=0,kept=0``. The controller plans with the
simulated car's own equations and knows their hidden states. In place of ``true``, the file of a trained set drives
the same lap with what was learned. With ``own`` the car is the controller's single track with learned peaks, so
that what the lap lacks to the whole-lap optimum of `fastest_lap` is the controller's own. All else is as in the
last laps of SPLIT: margin, share of the peak, learned peaks, weights, sensor noise and delay. Each further word is
one lap; it names what is changed there, joined by commas: a setting of the controller and its value, ``exact``
(sensors without noise), or ``nodelay``.
"""

import sys
import time
from dataclasses import replace

import numpy as np
from numba import njit

from split_cli.control.model import ControlModel, Linearization
from split_cli.control.mpcc import Mpcc
from split_cli.control.residual import NoResidual
from split_cli.plant import _compiled
from split_cli.plant._numbers import as_numbers
from split_cli.plant.cars import CarParameters
from split_cli.plant.dynamics import Surroundings
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.racing.closed_loop import SAMPLE_PERIOD, World
from split_cli.workflows.racing.driving import Race
from split_cli.workflows.racing.settings import LEARNING, RaceSettings

VEHICLE = "sample_logs/road_car.yaml"
TRACKS = {"small": (22.0, (0.905, 0.93)), "handling": (30.0, (0.91, 0.935))}
"""Largest speed [m/s], and the peaks over the file's [1] that SPLIT had learned after lap 10 with seed 0."""

KEPT = 0.04
"""What plans kept beside the least margin in the last laps of SPLIT [m]."""

HIDDEN = 8
"""States beside [X, Y, yaw, v_x, v_y, r, T, delta]: tangents of the relaxed slip angles of front and rear,
delivered torque and steer angle, and the two specific forces at the suspension with their rates. Spins and slip
ratios of the wheels settle within milliseconds, so that a plan carries them on without a slope."""

SIZE = 8 + HIDDEN
SCALE = np.array([0.1, 0.1, 1000.0, 0.1, 5.0, 30.0, 5.0, 30.0])
"""Of the hidden states, in their units."""

SMALL_STEPS = np.array([1e-3, 1e-3, 1e-4, 1.0, 1e-5, 1e-5, 1e-5, 1.0, 1e-5, 1e-3, 1e-3, 1e-3, 1e-3, 10.0, 1e-4])
"""Differences from which slopes are taken: of v_x to the last hidden state, then of both inputs."""

SAMPLES, PARTS, SLOPE_PARTS = 5, 2, 1
"""Ramps of an interval of 50 ms, and Runge-Kutta steps of each: for what follows, and for its slopes."""

MOTION = (_compiled.X, _compiled.Y, _compiled.YAW, _compiled.VX, _compiled.VY, _compiled.R)
"""Places of what a controller's state begins with in the plant's."""


@njit
def put(full, x, radius):
    """Write a reduced state, shape (16,), into a state of the plant, shape (24,)."""
    change = (x[3] - full[3]) / radius
    for i in range(4):
        full[6 + i] += change
    full[:6] = x[:6]
    for axle in range(2):
        shift = x[8 + axle] - 0.5 * (full[14 + 2 * axle] + full[15 + 2 * axle])
        full[14 + 2 * axle] += shift
        full[15 + 2 * axle] += shift
    full[18:24] = x[10:16]


@njit
def take(full, torque, steer):
    """Return the reduced state of a state of the plant under commands that have come to `torque`, `steer`."""
    x = np.empty(SIZE)
    x[:6] = full[:6]
    x[6], x[7] = torque, steer
    x[8], x[9] = 0.5 * (full[14] + full[15]), 0.5 * (full[16] + full[17])
    x[10:] = full[18:24]
    return x


@njit
def interval(full, torque, steer, rates, env, car, step, parts):
    """Return the plant's state after an interval in which both commands move at `rates`, shape (2,)."""
    part = step / SAMPLES
    for i in range(SAMPLES):
        full = _compiled.advance(
            full,
            torque + rates[0] * (i + 0.5) * part,
            steer + rates[1] * (i + 0.5) * part,
            env,
            car,
            part / parts,
            parts,
        )[0]
    return full


@njit
def along_plan(x, u, full, env, car, step, radius, small):
    """Return A (N, 16, 16), B (N, 16, 2), following (N, 16) about states and inputs, and the last whole state."""
    count = len(x)
    A, B, following = np.zeros((count, SIZE, SIZE)), np.zeros((count, SIZE, 2)), np.empty((count, SIZE))
    full = full.copy()
    for k in range(count):
        put(full, x[k], radius)
        ended = x[k, 6] + step * u[k, 0], x[k, 7] + step * u[k, 1]
        after = interval(full, x[k, 6], x[k, 7], u[k], env, car, step, PARTS)
        following[k] = take(after, ended[0], ended[1])
        here = take(interval(full, x[k, 6], x[k, 7], u[k], env, car, step, SLOPE_PARTS), ended[0], ended[1])
        A[k, 0, 0] = A[k, 1, 1] = A[k, 2, 2] = 1.0
        A[k, 0, 2], A[k, 1, 2] = -(here[1] - x[k, 1]), here[0] - x[k, 0]
        for j in range(15):
            moved, rates, near = x[k].copy(), u[k].copy(), full.copy()
            if j < 13:
                moved[3 + j] += small[j]
            else:
                rates[j - 13] += small[j]
            put(near, moved, radius)
            there = take(
                interval(near, moved[6], moved[7], rates, env, car, step, SLOPE_PARTS),
                moved[6] + step * rates[0],
                moved[7] + step * rates[1],
            )
            if j < 13:
                A[k, :, 3 + j] = (there - here) / small[j]
            else:
                B[k, :, j - 13] = (there - here) / small[j]
        full = after
    return A, B, following, full


class TrueModel:
    """The plant in the place of a `ControlModel`; the slip limits are those of the vehicle file.

    Set `observed` to the plant's whole state before the state one interval ahead is asked for.
    """

    def __init__(self, vehicle: Vehicle, car: CarParameters, horizon: int, step: float, friction: float) -> None:
        self.vehicle, self.step, self.horizon = vehicle, step, horizon
        self.states, self.memory = SIZE, HIDDEN
        self.file = ControlModel(vehicle, NoResidual(), step)
        self.car, self.radius = as_numbers(car), car.wheel_radius
        self.env = Surroundings(friction=friction).vector()
        self.observed: np.ndarray | None = None
        self.begin = self.end = np.zeros(_compiled.STATE_SIZE)
        self.residual = self.file.residual
        self.scale = np.concatenate([self.file.scale, SCALE])

    def steady_states(self, x: np.ndarray) -> np.ndarray:
        """Return the reduced state about [X, Y, yaw, v_x, v_y, r, T, delta] with tyres and suspension settled."""
        v = max(x[3], 1.0)
        tangents = [x[7] - (x[4] + self.car.cg_to_front_axle * x[5]) / v, -(x[4] - self.car.cg_to_rear_axle * x[5]) / v]
        return np.concatenate([x[:8], tangents, x[6:8], [0.0, 0.0, v * x[5], 0.0]])

    def linearize(self, x: np.ndarray, u: np.ndarray) -> Linearization:
        """Return the plant's step about states `x`, shape (N, 16), and inputs `u`, shape (N, 2)."""
        ahead = len(x) == 1 and self.observed is not None
        full = self.observed if ahead else self.end if len(x) == 1 else self.begin
        A, B, following, last = along_plan(
            np.ascontiguousarray(x),
            np.ascontiguousarray(u),
            full,
            self.env,
            self.car,
            self.step,
            self.radius,
            SMALL_STEPS,
        )
        if ahead:
            self.begin, self.observed = last, None
        elif len(x) > 1:
            self.end = last
        found = self.file.linearize(x[:, :8], u)
        beside = ((0, 0), (0, 0), (0, HIDDEN))
        return replace(
            found,
            A=A,
            B=B,
            following=following,
            slip_slope=np.pad(found.slip_slope, beside),
            force_slope=np.pad(found.force_slope, beside),
        )


class TrueRace(Race):
    """A race whose controller knows the plant."""

    def begin(self) -> None:
        """Put the car on the run-up, and give the controller the plant."""
        super().begin()
        s, before = self.settings, self.controller
        self.model = TrueModel(self.vehicle, self.car, self.mpcc.horizon, self.mpcc.step, s.grip)
        self.controller = Mpcc(self.model, self.path, self.actuators, self.mpcc, self.width)
        self.controller.deviation = before.deviation
        self._take_grip(np.array(TRACKS[s.track][1]))
        self.model.begin = self.world.state.copy()
        self.controller.begin(self.model.steady_states(self.world.measured), self.start)
        self.rates = self.controller.plan.u[0, :2].copy()

    def _interval(self, record):
        world = self.world
        self.model.observed = world.state.copy()
        self.memory = take(world.state, world.torque, world.steer)[8:]
        if not self.settings.delay:
            self.model.begin, self.model.observed = self.model.observed, None
        return super()._interval(record)


class OwnWorld(World):
    """A world in which the car is a controller's model, without sensor noise."""

    model: ControlModel

    def drive(self, rates: np.ndarray, duration: float) -> None:
        """Let the commands run with `rates` [N m/s], [rad/s] for `duration` [s]."""
        for _ in range(int(round(duration / SAMPLE_PERIOD))):
            before = self.exact
            x = self.model.linearize(before[None], rates[None]).following[0]
            self.state[list(MOTION)], (self.torque, self.steer) = x[:6], x[6:]
            self.t += SAMPLE_PERIOD
            rate = (x[3:5] - before[3:5]) / SAMPLE_PERIOD
            self._record(rate + before[5] * np.array([-before[4], before[3]]))


class OwnRace(Race):
    """A race of a controller with its own model."""

    def begin(self) -> None:
        """Put the model on the run-up, and plan with it."""
        super().begin()
        grip, before = TRACKS[self.settings.track][1], self.controller
        front, rear = (
            replace(tire, B=tire.B / s, D=s * tire.D)
            for tire, s in zip((self.vehicle.front_tire, self.vehicle.rear_tire), grip, strict=True)
        )
        self.vehicle = replace(self.vehicle, front_tire=front, rear_tire=rear)
        self.model = ControlModel(self.vehicle, NoResidual(), self.mpcc.step)
        self.world = OwnWorld(self.car, self.path, self.world.speed, self.start, seed=None)
        self.world.model = ControlModel(self.vehicle, NoResidual(), SAMPLE_PERIOD)
        self.controller = Mpcc(self.model, self.path, self.actuators, self.mpcc, self.width)
        self.controller.deviation = before.deviation
        self.controller.begin(self.world.measured, self.start)
        self.rates = self.controller.plan.u[0, :2].copy()


def changed(words: list[str], track: str) -> RaceSettings:
    """Return settings of a race with the changes that `words` name."""
    values = dict(word.partition("=")[::2] for word in words)
    numbers = {key: float(value) for key, value in values.items() if value}
    weights, limits = LEARNING.weights, LEARNING.limits
    parts = {}
    for name, part in (("weights", weights), ("limits", limits)):
        parts[name] = replace(part, **{key: numbers.pop(key) for key in [*numbers] if hasattr(part, key)})
    kept = numbers.pop("kept", KEPT)
    own = {key: numbers.pop(key) for key in [*numbers] if hasattr(LEARNING, key) and key != "margin"}
    if "horizon" in own:
        own["horizon"] = int(own["horizon"])
    seed = int(numbers.pop("seed", 0))
    settings = RaceSettings(
        track=track,
        max_speed=TRACKS[track][0],
        max_torque=1000.0,
        learner="none",
        learn_grip=False,
        settings=replace(LEARNING, **parts, **own),
        first_share=parts["limits"].p_ellipse,
        deviation=kept,
        exact_sensors="exact" in values,
        delay="nodelay" not in values,
        seed=seed,
        **numbers,
    )
    return settings


def main(track: str, model: str, *changes: str) -> None:
    """Run from the command line."""
    for change in changes or ("base",):
        settings = changed([word for word in change.split(",") if word != "base"], track)
        kind = {"true": TrueRace, "own": OwnRace}.get(model, Race)
        if kind is Race:
            settings = replace(settings, start_set=model, learn_grip=True)
        began = time.process_time()
        race = kind(settings, read_vehicle(VEHICLE), None, lambda text: None)
        race.begin()
        race._drive(record=None)
        if not race.ended:
            race.drive_lap(1)
        told = race.ended
        if not told:
            lap = race.laps[0]
            told = (
                f"{lap.time:.2f} s, {lap.outside:.2f} m outside, at most {lap.max_lateral:.3f} g, "
                f"{lap.failures} failures, {lap.step_ms[0]:.1f} ms a step"
            )
        print(f"{track}, {model}, {change}: {told}; {time.process_time() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
