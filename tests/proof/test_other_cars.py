"""The study's cars of other equations obey closed forms, limits and conservation laws of vehicle dynamics."""

import ast
import os
from pathlib import Path

import numpy as np
import pytest

from tests.studies import other_cars
from tests.studies.other_cars.cars import KINDS
from tests.studies.other_cars.integration import advance_car, rates
from tests.studies.other_cars.surroundings import GRAVITY
from tests.studies.other_cars.tyres import brush_force, magic_force, tmeasy_force

FOLDER = Path(other_cars.__file__).parent
SIMULATORS = (
    "tyres surroundings sports_car van model_car integration cars course driver recording effects sizes".split()
)
FREE = {"drag": 0.0, "rolling": 0.0, "lift_front": 0.0, "lift_rear": 0.0, "lock": 0.0}
"""Changes that leave nothing but tyres and inertia."""
PERIOD = 0.01


def advanced(kind, car, state, duration, *, steer=0.0, torque=0.0, step=None, period=PERIOD):
    """Return the state and the specific forces after constant commands."""
    x = np.array(state, dtype=float)
    forces = advance_car(x, 0.0, duration, step or kind.step, car, np.full(1, steer), np.full(1, torque), 0.0, period)
    return x, forces


def rates_of(car, state, steer=0.0, torque=0.0, place=0.0):
    out = np.zeros(len(state))
    felt = rates(0.0, np.array(state, dtype=float), steer, torque, place, car, out)
    return out, felt


@pytest.fixture(params=list(KINDS))
def kind(request):
    return KINDS[request.param]


def middle(kind) -> float:
    return 0.5 * sum(kind.speeds)


def test_the_simulators_know_nothing_of_the_project():
    for name in SIMULATORS:
        tree = ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
        modules = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        modules += [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
        assert not [module for module in modules if module.split(".")[0] == "split_cli"], name


@pytest.mark.parametrize("along, across", [(0.0, 0.03), (0.02, 0.05), (-0.04, 0.02), (0.05, -0.2)])
def test_brush_forces_are_those_of_bristles_under_a_parabolic_pressure(along, across):
    """Each bristle is deformed by its time in contact, up to what its pressure holds; 20,000 of them are added up."""
    stiff_x, stiff_y, limit = 9.0e4, 7.0e4, 4200.0
    u = (np.arange(20000) + 0.5) / 20000.0  # from the leading edge to the trailing one
    x, y = (2.0 * slope * slip / (1.0 + along) * u for slope, slip in ((stiff_x, along), (stiff_y, across)))
    held = limit * 6.0 * u * (1.0 - u)
    share = np.minimum(1.0, held / np.maximum(np.hypot(x, y), 1e-12))
    # Where it has once slid it slides on; the force keeps its direction since stiffness and slip do.
    expected = np.mean(x * share), np.mean(y * share)
    assert brush_force(along, across, stiff_x, stiff_y, limit) == pytest.approx(expected, rel=2e-4, abs=0.3)


def test_the_tmeasy_curve_has_its_five_numbers_and_no_kink():
    numbers = {"slope": 60000.0, "peak": 5000.0, "peak_slip": 0.15, "slide": 4300.0, "slide_slip": 0.5}
    small = 1e-6
    assert tmeasy_force(small, **numbers) / small == pytest.approx(numbers["slope"], rel=1e-4)
    assert tmeasy_force(0.15, **numbers) == pytest.approx(5000.0)
    assert tmeasy_force(0.5, **numbers) == tmeasy_force(0.9, **numbers) == pytest.approx(4300.0)
    assert tmeasy_force(-0.07, **numbers) == -tmeasy_force(0.07, **numbers)
    for slip in (0.15, 0.5):
        # Flat on both sides: a difference of 1e-4 changes the force by its square only.
        for side in (-1e-4, 1e-4):
            assert abs(tmeasy_force(slip + side, **numbers) - tmeasy_force(slip, **numbers)) < 0.01


def test_the_magic_formula_is_one_curve_of_the_length_of_the_slip():
    stiffness, shape, limit = 85.0, 1.45, 8.0
    pure = limit * np.sin(shape * np.arctan(stiffness / (shape * limit) * 0.1))
    assert magic_force(0.0, 0.1, stiffness, shape, limit) == pytest.approx((0.0, pure))
    along, across = 0.06 / (1.0 - 0.06), 0.08 / (1.0 - 0.06)  # of theoretical slips 0.06 and 0.08, of length 0.1
    assert magic_force(along, across, stiffness, shape, limit) == pytest.approx((0.6 * pure, 0.8 * pure))


def test_forces_of_the_car_are_those_of_its_tyres_at_its_slips():
    """The model car rolls freely with given slips: each axle has twice the force of a tyre at its static load."""
    car = KINDS["model car"].base._replace(**FREE, load_greasing=0.0)
    speed, front, rear = 3.0, 0.05, 0.03
    state = KINDS["model car"].start(car, speed, (0.0, 0.0, 0.0))
    state[9:13] = [front, front, rear, rear]
    out, felt = rates_of(car, state)
    base, weight = car.front + car.rear, car.mass * GRAVITY
    axles = []
    for slip, load, slope in (
        (front, car.rear / base, car.stiffness_front),
        (rear, car.front / base, car.stiffness_rear),
    ):
        limit = car.grip * 0.5 * weight * load
        stiffness = slope * 0.5 * weight * load
        axles.append(2.0 * limit * np.sin(car.shape * np.arctan(stiffness / (car.shape * limit) * slip)))
    assert felt[1] == pytest.approx(sum(axles) / car.mass)
    assert out[5] == pytest.approx((axles[0] * car.front - axles[1] * car.rear) / car.yaw_inertia)


def test_gentle_turns_are_those_of_the_linear_single_track(kind):
    """r = v delta/(L + K v^2); a thousandth of the steering leaves only what is linear.

    The model car's shaft makes both axles turn alike, for which one per cent is left.
    """
    car = kind.base._replace(**FREE)
    speed = middle(kind)
    state, forces = advanced(kind, car, kind.start(car, speed, (0.0, 0.0, 0.0)), 4.0, steer=0.001)
    expected = state[3] * 0.001 / (car.front + car.rear + kind.gradient(car) * state[3] ** 2)
    assert state[5] == pytest.approx(expected, rel=0.012)
    assert forces[1] == pytest.approx(state[3] * state[5], rel=1e-3)


def test_torque_that_balances_drag_and_rolling_keeps_the_speed(kind):
    car, speed = kind.base, middle(kind)
    torque = (car.rolling + car.drag * speed**2) * car.radius
    state, forces = advanced(kind, car, kind.start(car, speed, (0.0, 0.0, 0.0)), 20.0, torque=torque)
    # While the torque builds up the car loses a little, which it hardly regains in 20 s.
    lost = torque / car.radius * car.torque_lag / car.mass
    assert speed - 1.5 * lost - 1e-3 < state[3] < speed
    assert abs(forces[0]) < 0.02


def test_coasting_loses_speed_by_drag_over_mass_and_turning_parts(kind):
    car, speed = kind.base, middle(kind)
    state = kind.start(car, speed, (0.0, 0.0, 0.0))
    later, _ = advanced(kind, car, state, 0.4)
    after, _ = advanced(kind, car, later, 0.2)
    mean = 0.5 * (later[3] + after[3])
    turning = 4.0 * car.wheel_inertia / car.radius**2 + getattr(car, "shaft_inertia", 0.0) / car.radius**2
    expected = (car.rolling + car.drag * mean**2) / (car.mass + turning)
    assert (later[3] - after[3]) / 0.2 == pytest.approx(expected, rel=0.01)


def test_a_grade_and_a_bank_pull_by_gravity_and_are_felt(kind):
    """A car without tyres' slip accelerates by -g sin along and across, while its accelerometers feel nothing of it."""
    state = kind.start(kind.base, middle(kind), (0.0, 0.0, 0.0))
    level, felt = rates_of(kind.base, state)
    inclined, on_it = rates_of(kind.base._replace(grade=0.02, bank=-0.03), state)
    turning = 4.0 * kind.base.wheel_inertia / kind.base.radius**2 if kind.name == "van" else 0.0
    pulled = GRAVITY * np.sin(0.02) * kind.base.mass / (kind.base.mass + turning)
    assert inclined[3] - level[3] == pytest.approx(-pulled)
    assert inclined[4] - level[4] == pytest.approx(GRAVITY * np.sin(0.03))
    assert on_it[1] == pytest.approx(felt[1])
    assert on_it[0] - felt[0] == pytest.approx(GRAVITY * np.sin(0.02) - pulled, abs=1e-12)


def test_a_turning_car_that_nothing_drives_never_gains_energy():
    """Tyres only take: kinetic energy of car and wheels falls at every step of a hard turn."""
    kind = KINDS["sports car"]
    car = kind.base._replace(**FREE)
    state = np.array(kind.start(car, 25.0, (0.0, 0.0, 0.0)))
    steer, energies = np.full(1, 0.06), []
    for k in range(300):
        advance_car(state, k * PERIOD, PERIOD, kind.step, car, steer, np.zeros(1), 0.0, PERIOD)
        energies.append(
            0.5 * car.mass * (state[3] ** 2 + state[4] ** 2)
            + 0.5 * car.yaw_inertia * state[5] ** 2
            + 0.5 * car.wheel_inertia * np.sum(state[6:10] ** 2)
        )
    # Late slip stores a little: a hundred-thousandth of the whole may come back.
    assert np.diff(energies).max() < 1e-5 * energies[0]
    assert energies[-1] < 0.95 * energies[0]


def test_yaw_acceleration_falls_as_the_yaw_inertia_grows(kind):
    state = np.array(kind.start(kind.base, middle(kind), (0.0, 0.0, 0.0)))
    state, _ = advanced(kind, kind.base, state, 0.2, steer=0.03)
    light, _ = rates_of(kind.base, state)
    heavy, _ = rates_of(kind.base._replace(yaw_inertia=1.3 * kind.base.yaw_inertia), state)
    assert heavy[5] == pytest.approx(light[5] / 1.3)
    changed = np.flatnonzero(heavy != light)
    assert changed.tolist() == [5]


def test_the_integrator_is_of_fourth_order(kind):
    """Halving the step divides the error by 16; between 11 and 23 where the next order still counts."""
    state = np.array(kind.start(kind.base, middle(kind), (0.0, 0.0, 0.0)))
    state, _ = advanced(kind, kind.base, state, 0.3, steer=0.02)
    fine, half, whole = (
        advanced(kind, kind.base, state, 0.064, steer=0.025, step=step, period=10.0)[0]
        for step in (kind.step / 16.0, kind.step / 2.0, kind.step)
    )
    ratio = np.linalg.norm((whole - fine)[3:6]) / np.linalg.norm((half - fine)[3:6])
    assert 11.0 < ratio < 23.0


@pytest.mark.parametrize("late, channel", [("steer_delay", "steer"), ("torque_delay", "torque")])
def test_a_late_car_does_what_a_prompt_one_does_with_late_commands(kind, late, channel):
    generator = np.random.default_rng(5)
    commands = {"steer": 0.02 * generator.standard_normal(60), "torque": np.full(60, 0.1 * kind.torques[0])}
    commands["torque"] *= generator.uniform(0.0, 1.0, 60)
    shifted = dict(commands)
    shifted[channel] = np.concatenate([np.repeat(commands[channel][0], 3), commands[channel][:-3]])
    states = []
    for car, given in ((kind.base._replace(**{late: 3 * PERIOD}), commands), (kind.base, shifted)):
        state = np.array(kind.start(car, middle(kind), (0.0, 0.0, 0.0)))
        advance_car(state, 0.0, 0.6, kind.step, car, given["steer"], given["torque"], 0.0, PERIOD)
        states.append(state)
    np.testing.assert_allclose(*states, rtol=1e-9, atol=1e-12)


def test_a_patch_of_grip_acts_on_its_stretch_of_every_lap_alone(kind):
    car = kind.base._replace(patch=0.6, patch_start=20.0, patch_end=30.0, lap=100.0)
    state, _ = advanced(kind, kind.base, kind.start(kind.base, middle(kind), (0.0, 0.0, 0.0)), 0.5, steer=0.08)
    plain, _ = rates_of(kind.base, state)
    for place, is_inside in ((10.0, False), (25.0, True), (125.0, True), (130.0, False)):
        there, _ = rates_of(car, state, place=place)
        assert np.array_equal(there, plain) != is_inside


@pytest.mark.parametrize("name, slips, leans", [("sports car", slice(10, 14), 15), ("model car", slice(9, 13), 21)])
def test_moving_load_between_equal_tyres_takes_no_force_where_all_is_in_proportion_to_load(name, slips, leans):
    kind = KINDS[name]
    plain = {field: 0.0 for field in ("load_softening", "load_greasing") if field in kind.base._fields}
    car = kind.base._replace(**plain)
    state = np.array(kind.start(car, middle(kind), (0.0, 0.0, 0.0)))
    state[slips] = 0.04
    level, _ = rates_of(car, state)
    state[leans] = 3.0
    leaning, _ = rates_of(car, state)
    assert leaning[4] == pytest.approx(level[4])
    softer, _ = rates_of(kind.base, state)
    assert softer[4] < leaning[4]  # with tyres that soften under load it does


def test_a_coupling_resists_turning_until_the_tyres_slip_takes_it_all():
    """Weak, its moment is half its damping times r (w/R)^2; locked, that of tyres of slips -+ r w/(2 v_x)."""
    kind = KINDS["van"]
    state = np.array(kind.start(kind.base, 15.0, (0.0, 0.0, 0.0)))
    state[5] = 0.1
    moments = []
    for lock in (0.0, 1.0, 1e9):
        out, _ = rates_of(kind.base._replace(lock=lock), state)
        moments.append(kind.base.yaw_inertia * out[5])
    weak = 0.5 * state[5] * (kind.base.track / kind.base.radius) ** 2
    stiffness = kind.base.stiffness_along * 0.25 * kind.base.mass * GRAVITY
    locked = 0.5 * kind.base.track**2 * stiffness * state[5] / state[3]
    assert moments[0] - moments[1] == pytest.approx(weak, rel=2e-3)
    assert moments[0] - moments[2] == pytest.approx(locked, rel=1e-6)


@pytest.mark.parametrize("more", [{}, {"steer_lag": 0.04}])
def test_steering_follows_a_ramp_late_by_its_lag(kind, more):
    """First order or second, the wheels are late by the lag behind a ramp, and by half a period in which it is held."""
    car = kind.base._replace(**{name: getattr(kind.base, name) + value for name, value in more.items()})
    rate, period = 0.1, 0.001
    ramp = rate * period * np.arange(800)
    state = np.array(kind.start(car, middle(kind), (0.0, 0.0, 0.0)))
    advance_car(state, 0.0, 0.8, kind.step, car, ramp, np.zeros(800), 0.0, period)
    angle = state[{"sports car": 16, "van": 13, "model car": 13}[kind.name]]
    assert (0.8 * rate - angle) / rate == pytest.approx(car.steer_lag + 0.5 * period, rel=0.01)


def model_car_on_rear_slip(**changes):
    """Return the lateral force of a model car whose rear tyres alone slip, at a forward acceleration of 2 m/s^2."""
    kind = KINDS["model car"]
    car = kind.base._replace(**FREE | {"load_greasing": 0.0} | changes)
    state = np.array(kind.start(car, 4.0, (0.0, 0.0, 0.0)))
    state[11:13], state[20] = 0.04, 2.0
    _, felt = rates_of(car, state)
    return car.mass * felt[1]


def test_a_higher_cg_and_downforce_load_the_rear_axle_by_their_closed_forms():
    """Force is in proportion to load here: m a_x h/L more by acceleration, lift v_x^2 more by downforce."""
    base = KINDS["model car"].base
    wheelbase, rear = base.front + base.rear, base.mass * GRAVITY * base.front / (base.front + base.rear)
    flat = model_car_on_rear_slip(height=0.0)
    high = model_car_on_rear_slip(height=0.08)
    assert high / flat == pytest.approx(1.0 + base.mass * 2.0 * 0.08 / wheelbase / rear)
    winged = model_car_on_rear_slip(height=0.0, lift_rear=0.05)
    assert winged / flat == pytest.approx(1.0 + 0.05 * 4.0**2 / rear)


def test_grip_scales_the_slip_at_which_a_tyre_peaks_and_keeps_its_stiffness(kind):
    """With the limit times q, the force at q times the slip is q times as large: the catalogue's `friction_scale`."""
    laws = {
        "sports car": lambda slip, limit: brush_force(0.0, slip, 8e4, 6e4, limit)[1],
        "van": lambda slip, limit: tmeasy_force(slip, 6e4, limit, 1.9 * limit / 6e4, 0.88 * limit, 6.65 * limit / 6e4),
        "model car": lambda slip, limit: magic_force(0.0, slip, 6e4, 1.45, limit)[1],
    }
    law = laws[kind.name]
    for slip in (0.02, 0.08, 0.3):
        assert law(0.8 * slip, 0.8 * 5000.0) == pytest.approx(0.8 * law(slip, 5000.0))


def test_compiled_code_that_is_older_than_a_source_is_forgotten(tmp_path):
    for name, time in (("old.nbi", 100), ("new.nbi", 300)):
        path = tmp_path / "__pycache__" / name
        path.parent.mkdir(exist_ok=True)
        path.touch()
        os.utime(path, (time, time))
    (tmp_path / "tyres.py").touch()
    os.utime(tmp_path / "tyres.py", (200, 200))
    other_cars.forget_outdated_code(tmp_path)
    assert [path.name for path in (tmp_path / "__pycache__").iterdir()] == ["new.nbi"]


def test_compiled_steps_are_those_of_the_plain_equations(kind):
    """One compiled step of a car against Runge and Kutta's formula with the equations as Python runs them."""
    generator = np.random.default_rng(2)
    start = np.array(kind.start(kind.base, middle(kind), (1.0, 2.0, 0.3)))
    start, _ = advanced(kind, kind.base, start, 0.3, steer=0.03)
    steer, torque = 0.02 * generator.standard_normal(), 0.2 * kind.torques[0]
    h = kind.step
    stages = [np.zeros_like(start)]
    for share in (0.0, 0.5, 0.5, 1.0):
        out, _ = rates_of(kind.base, start + share * h * stages[-1], steer, torque)
        stages.append(out)
    _, a, b, c, d = stages
    expected = start + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    compiled, _ = advanced(kind, kind.base, start, h, steer=steer, torque=torque)
    np.testing.assert_allclose(compiled, expected, rtol=1e-12, atol=1e-13)
