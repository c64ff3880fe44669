"""Controllers on their own model: tracking to nothing, staying inside, and borders moved in by variance."""

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from split_cli.control import receding_horizon
from split_cli.control.limits import Limits, slip_limit
from split_cli.control.model import ControlModel
from split_cli.control.mpc import Mpc, MpcSettings
from split_cli.control.mpcc import Mpcc, MpccSettings
from split_cli.control.path import contour_and_lag, resampled
from split_cli.control.policy import ANEW, PATIENCE
from split_cli.control.receding_horizon import Actuators, ControllerLost
from split_cli.control.residual import NoResidual, ResidualValues
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.racing.driving import Race
from split_cli.workflows.racing.maneuver import scaled_controller
from tests.studies.experiments import PLAN

CAR = read_vehicle(FilePath(__file__).resolve().parents[2] / "sample_logs" / "road_car.yaml")
ACTUATORS = Actuators(1000.0, 5600.0)


def straight(width: float = 4.0):
    x = np.arange(0.0, 400.0, 1.0)
    points = np.stack([x, 0.0 * x], axis=1)
    return resampled("straight", points, np.full(400, width), np.full(400, width), closed=False)


def ring(radius: float = 25.0, width: float = 4.0):
    angle = np.arange(100) * 2 * np.pi / 100
    points = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return resampled("ring", points, np.full(100, width), np.full(100, width), closed=True)


def followed(controller, model, x, steps):
    states = [x]
    for _ in range(steps):
        u, info = controller.step(states[-1])
        assert info.solved
        states.append(model.linearize(states[-1][None], u[None]).following[0])
    return np.array(states)


@pytest.mark.parametrize("alone", [True, False])
def test_a_line_that_the_model_can_follow_is_tracked_to_nothing(alone):
    model = ControlModel(CAR, NoResidual(), 0.04)
    path, settings = straight(), MpcSettings(horizon=25, steering_alone=alone)
    controller = Mpc(model, path, ACTUATORS, settings, 1.77, lambda s: np.full(np.shape(s), 12.0))
    x = np.array([5.0, 0.6, 0.0, 12.0, 0.0, 0.0, 110.0, 0.0])
    controller.begin(x, 5.0)
    states = followed(controller, model, x, 120)
    # The nominal car on a straight has no steady error; 4.8 s are many times what its steering takes.
    assert abs(states[-1, 1]) < 2e-3 and abs(states[-1, 2]) < 2e-3
    if not alone:
        assert states[-1, 3] == pytest.approx(12.0, abs=0.05)


def similar_car(size: float):
    """Return `CAR` and `ACTUATORS` times `size` at equal accelerations (Froude): times go with the root of it."""
    tires = (replace(tire, D=tire.D * size**3) for tire in (CAR.front_tire, CAR.rear_tire))
    powers = {"mass": 3, "yaw_inertia": 5, "max_torque": 4, "max_brake_torque": 4, "drag_coefficient": 2}
    powers |= dict.fromkeys(("rolling_resistance_front", "rolling_resistance_rear"), 3)
    powers |= dict.fromkeys(("cg_to_front_axle", "cg_to_rear_axle", "cg_height", "wheel_radius"), 1)
    numbers = {name: getattr(CAR, name) * size**power for name, power in powers.items()}
    front, rear = tires
    a = ACTUATORS
    actuators = Actuators(
        a.max_torque * size**4,
        a.max_brake_torque * size**4,
        torque_rate=a.torque_rate * size**3.5,
        steer_rate=a.steer_rate / np.sqrt(size),
    )
    return replace(CAR, front_tire=front, rear_tire=rear, **numbers), actuators


def test_a_similar_car_of_another_size_has_the_same_plan_times_its_size():
    """All weights but that of plan steps, which counts metres and seconds; the plan begins beyond the border."""
    plans = []
    for size in (1.0, 0.125):
        car, actuators = similar_car(size)
        root = np.sqrt(size)
        model = ControlModel(car, NoResidual(), 0.04 * root)
        settings = scaled_controller(MpcSettings(horizon=25, step=0.04 * root, steering_alone=False), size)
        settings = replace(settings, weights=replace(settings.weights, proximal=0.0))
        x = np.arange(0.0, 400.0, 1.0)
        points, sides = size * np.stack([x, 0.0 * x], axis=1), np.full(400, 4.0 * size)
        path = resampled("straight", points, sides, sides, closed=False)
        controller = Mpc(
            model, path, actuators, settings, 1.77 * size, lambda s, v=12.0 * root: np.full(np.shape(s), v)
        )
        units = np.array([size, size, 1.0, root, root, 1.0 / root, size**4, 1.0])
        controller.begin(units * [5.0, 3.6, 0.0, 12.0, 0.0, 0.0, 110.0, 0.0], 5.0 * size, 3)
        assert controller.plan.x[1, 1] > (4.0 - 0.5 * 1.77) * size
        plans.append(controller.plan.x / units)
    full, small = plans
    assert np.abs(full[:, 7]).max() > 0.1  # it steers back
    # Next to no cost hangs on a torque of 0.01 N m, and the solver ends before it knows it.
    known = np.array([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-2, 1e-4])
    assert (np.abs(small - full).max(axis=0) < known).all()


@pytest.mark.parametrize(("bends", "least", "most"), [(True, 0.0, 200.0), (False, 1000.0, 5000.0)])
def test_programmes_about_one_state_come_to_one_torque_since_the_slip_limits_bend(bends, least, most):
    """Straight tangents let the torque swing between drive and brakes; what is left jumps with the brakes' split."""
    controller = Mpcc(
        ControlModel(CAR, NoResidual(), 0.05),
        ring(),
        ACTUATORS,
        MpccSettings(horizon=40, limits=Limits(p_long=1.2, p_ellipse=0.8, guarded=True)),
        1.77,
    )
    controller.begin(np.array([25.0, 0.0, np.pi / 2, 16.0, 0.0, 0.64, 0.0, 0.1]), 0.0, 1)
    swings = []
    for _ in range(16):
        before = controller.plan.x[:, 6].copy()
        controller.slack *= bends
        assert controller._iterate()[0]
        swings.append(np.abs(controller.plan.x[:, 6] - before).max())
    assert least <= max(swings[-4:]) < most


def test_contouring_control_keeps_to_its_limits_on_a_ring():
    model = ControlModel(CAR, NoResidual(), 0.05)
    settings = MpccSettings(horizon=40, max_speed=30.0, limits=Limits(p_long=1.2, p_ellipse=0.8))
    path = ring()
    controller = Mpcc(model, path, ACTUATORS, settings, 1.77)
    x = np.array([25.0, 0.0, np.pi / 2, 9.0, 0.0, 0.36, 0.0, 0.1])
    controller.begin(x, 0.0)
    states = followed(controller, model, x, 60)[20:]
    found = model.linearize(states, np.zeros((len(states), 2)))
    bound = slip_limit(settings.limits, found)[0]
    # Rows are soft: the price of a slack of 0.01 rad is small against the progress it buys.
    assert (np.abs(found.slip) - bound).max() < 0.01
    s = [path.nearest(*state[:2]) for state in states]
    contour = contour_and_lag(path.at(np.array(s)), states[:, 0], states[:, 1])[0]
    assert np.abs(contour).max() < 4.0 - 0.885
    # It is the limits that hold it: the front or rear axle is at its bound somewhere.
    assert (bound - np.abs(found.slip)).min() < 0.01
    assert states[:, 6].max() <= 1000.0 + 1e-6 and states[:, 6].min() >= -5600.0 - 1e-6


def test_guarded_limits_bound_the_torque_and_leave_a_way_back():
    model, path = ControlModel(CAR, NoResidual(), 0.05), straight()
    x = np.array([5.0, 0.0, 0.0, 20.0, 0.0, 0.0, -5000.0, 0.0])
    bounds = {}
    for guarded in (False, True):
        settings = MpccSettings(horizon=20, limits=Limits(p_long=1.2, guarded=guarded))
        controller = Mpcc(model, path, ACTUATORS, settings, 1.77)
        controller.begin(x, 5.0, iterations=5)
        found = model.linearize(controller.plan.x[:20, :8], controller.plan.u[:, :2])
        bounds[guarded] = controller.bounds(found)[0][:, 6]
        # Whatever it begins with, the plan ends within its bounds.
        assert (controller.plan.x[1:, 6] >= bounds[guarded] - 1.0).all()
    assert (bounds[False] == -5600.0).all()
    # Half of 20,000 N m/s: 500 N m come back in a step of 50 ms, until the ellipse holds the torque.
    assert bounds[True][0] == pytest.approx(-4500.0) and bounds[True][-1] > -4500.0


class Uncertain(NoResidual):
    """No residual, but with a variance."""

    def of_data(self, z):
        values = super().of_data(z)
        return ResidualValues(values.mean, values.slope, np.full_like(values.mean, 0.5), values.knowledge)


def test_borders_move_in_by_the_spread_that_the_variance_makes():
    model = ControlModel(CAR, Uncertain(), 0.05)
    settings = MpccSettings(horizon=20)
    path = straight(50.0)
    x = np.array([5.0, 0.0, 0.0, 15.0, 0.0, 0.0, 100.0, 0.0])
    plain = Mpcc(model, path, ACTUATORS, settings, 1.77)
    plain.begin(x, 5.0, iterations=3)
    found = model.linearize(plain.plan.x[:20, :8], plain.plan.u[:, :2])
    point = path.at(plain.plan.x[1:, -2])
    assert plain._tightened(found, point) == pytest.approx(np.full(20, 0.5 * 1.77 + 0.3))
    # What plan and drive part by comes on top, and leaves half of the room.
    plain.deviation = 0.4
    assert plain._tightened(found, point) == pytest.approx(np.full(20, 0.5 * 1.77 + 0.7))
    close = replace(point, left=np.full(20, 1.685))
    assert plain._tightened(found, close) == pytest.approx(np.full(20, 1.185 + 0.25))
    plain.deviation = 0.0
    tight = Mpcc(model, path, ACTUATORS, settings, 1.77, tightening=2.0)
    tight.plan = plain.plan
    moved = tight._tightened(found, point) - (0.5 * 1.77 + 0.3)
    rng = np.random.default_rng(0)
    state, spread = np.zeros((20_000, 8)), []
    for k in range(20):
        state = state @ found.A[k].T
        state[:, 3:6] += 0.05 * np.sqrt(0.5) * rng.standard_normal((20_000, 3))
        spread.append(state[:, 1].std())
    # 20,000 samples know a deviation to 0.5 %.
    assert moved[1:] == pytest.approx(2.0 * np.array(spread)[1:], rel=0.03)
    narrow = replace(point, left=np.full(20, 2.0), right=np.full(20, 2.0))
    assert tight._tightened(found, narrow).max() <= 1.185 + 0.5 * (2.0 - 1.185) + 1e-9


def test_a_first_plan_is_found_by_shorter_steps_where_whole_ones_lead_to_a_spin(monkeypatch):
    """A road of half the grip: whole steps from the guess reach a plan about which nothing is solved."""
    (wet,) = (e for e in PLAN if e.name == "wet-nominal-0")
    with monkeypatch.context() as patch:
        patch.setattr(receding_horizon, "FIRST_STEPS", (1.0,))
        with pytest.raises(ControllerLost, match="no plan was found"):
            Race(wet.settings, CAR, None, print).begin()
    race = Race(wet.settings, CAR, None, print)
    race.begin()
    plan, states = race.controller.plan, race.controller.n_model
    # The plan is the model's own motion, and its speeds are those of a wet road.
    following = race.model.linearize(plan.x[:-1, :states], plan.u[:, :2]).following
    assert np.abs(following - plan.x[1:, :states])[:, :6].max() < 0.05
    assert plan.x[:, 3].max() < 15.0


def test_a_controller_that_fails_goes_on_with_its_plan_and_then_gives_up(monkeypatch):
    model = ControlModel(CAR, NoResidual(), 0.05)
    controller = Mpcc(model, straight(), ACTUATORS, MpccSettings(horizon=20), 1.77)
    x = np.array([5.0, 0.3, 0.0, 10.0, 0.0, 0.0, 100.0, 0.0])
    controller.begin(x, 5.0)
    planned = controller.plan.u[1:4, :2].copy()
    solve = controller.programme.solve
    monkeypatch.setattr(controller.programme, "solve", lambda data: replace(solve(data), solved=False))
    for k in range(3):
        x = model.linearize(x[None], controller.plan.u[:1, :2]).following[0]
        u, info = controller.step(x)
        assert not info.solved
        assert u == pytest.approx(planned[k])
    with pytest.raises(ControllerLost, match="in a row"):
        for _ in range(PATIENCE):
            controller.step(x)


def test_a_plan_that_spins_is_begun_anew(monkeypatch):
    model = ControlModel(CAR, NoResidual(), 0.05)
    controller = Mpcc(model, straight(), ACTUATORS, MpccSettings(horizon=20), 1.77)
    x = np.array([5.0, 0.3, 0.0, 10.0, 0.0, 0.0, 100.0, 0.0])
    controller.begin(x, 5.0)
    x = model.linearize(x[None], controller.plan.u[:1, :2]).following[0]
    controller.plan.x[8:, 4] = 40.0
    solve, calls = controller.programme.solve, []

    def fails_once(data):
        calls.append(data)
        return replace(solve(data), solved=len(calls) > 1)

    monkeypatch.setattr(controller.programme, "solve", fails_once)
    _, info = controller.step(x)
    assert not info.solved and len(calls) == 1 + ANEW
    plan = controller.plan.x
    assert np.abs(plan[:, 4]).max() < 2.0 and plan[:, 3].min() > 8.0
    assert plan[0, :8] == pytest.approx(x) and controller.step(x)[1].solved
