"""The double track against hand calculation, symmetry, energy and its own order of integration."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.plant import _compiled
from split_cli.plant._numbers import as_numbers
from split_cli.plant.cars import CARS, F1TENTH_CAR, FORMULA_CAR, ROAD_CAR
from split_cli.plant.dynamics import STATE_NAMES, Surroundings, advance, outputs_from
from split_cli.plant.maneuvers import MANEUVER_NAMES, build_maneuver, run_maneuver
from split_cli.plant.simulation import initial_state
from split_cli.signals import STANDARD_GRAVITY

INDEX = {name: number for number, name in enumerate(STATE_NAMES)}
WHEELS = slice(6, 10)


def state_rate(car, state, torque, steer, around=None):
    """Return the rate of a state, and what follows from it there."""
    rate, out = np.empty(_compiled.STATE_SIZE), np.empty(_compiled.OUT_SIZE)
    _compiled.state_rate(state, torque, steer, (around or Surroundings()).vector(), as_numbers(car), rate, out)
    return rate, outputs_from(out)


def plain(car, **changes):
    """Return a car without toe, Ackermann and locked axles, which the hand formulas leave out."""
    return replace(
        car,
        toe_front=0.0,
        toe_rear=0.0,
        ackermann_fraction=0.0,
        differential_locking_front=0.0,
        differential_locking_rear=0.0,
        **changes,
    )


def random_state(car, rng):
    """Return a state within the range of driving, loads well above zero."""
    pace = np.sqrt(car.wheelbase / 2.7)
    state = initial_state(car, rng.uniform(8, 30) * pace)
    state[2] = rng.uniform(-3, 3)
    state[4:6] = rng.normal(0, 0.3 * pace), rng.normal(0, 0.2 / pace)
    state[WHEELS] *= 1 + rng.normal(0, 0.02, 4)
    state[10:18] = rng.normal(0, 0.03, 8)
    state[18] = rng.uniform(-0.3, 0.3) * car.max_torque
    state[19] = rng.normal(0, 0.03)
    state[20:24] = rng.normal(0, 1.5, 4)
    return state


@pytest.mark.parametrize("car", CARS.values(), ids=CARS)
def test_rolling_out_slows_by_drag_and_rolling_resistance_over_the_effective_mass(car):
    car = plain(car)
    speed = 20.0 * np.sqrt(car.wheelbase / 2.7)
    state = initial_state(car, speed)
    for _ in range(20):  # two seconds: tyres, wheels and pitch have settled
        state, _ = advance(car, state, 0.0, 0.0, 0.1)
    rate, out = state_rate(car, state, 0.0, 0.0)
    vx = state[INDEX["vx"]]
    drag = 0.5 * car.air_density * car.drag_area * vx**2
    rolling = sum(
        tire.rolling_resistance * loads.sum()
        for tire, loads in ((car.front_tire, out.load[:2]), (car.rear_tire, out.load[2:]))
    )
    # The wheels turn v (1 + kappa)/R with a kappa of about 1e-3 that changes slowly, felt through their inertia,
    # some per cent of the mass: a few 1e-5.
    assert rate[INDEX["vx"]] == pytest.approx(-(drag + rolling) / car.effective_mass, rel=2e-4)


def axle_stiffness(tire, axle_load):
    return (
        2.0
        * tire.p_ky1
        * tire.nominal_load
        * np.sin(2.0 * np.arctan(0.5 * axle_load / (tire.p_ky2 * tire.nominal_load)))
    )


@pytest.mark.parametrize("car", CARS.values(), ids=CARS)
def test_steady_cornering_at_small_lateral_acceleration_is_the_bicycle_model(car):
    # r/delta = v/(L + K v^2), K = m/L (l_r/C_f - l_f/C_r); beta from the rear axle's slip angle.
    car = plain(car, drag_area=0.0, side_area=0.0, downforce_area_front=0.0, downforce_area_rear=0.0)
    car = replace(
        car,
        front_tire=replace(car.front_tire, rolling_resistance=0.0),
        rear_tire=replace(car.rear_tire, rolling_resistance=0.0),
    )
    stiff_front = axle_stiffness(car.front_tire, car.static_load_front)
    stiff_rear = axle_stiffness(car.rear_tire, car.static_load_rear)
    speed = 18.0 * np.sqrt(car.wheelbase / 2.7)
    gradient = car.mass / car.wheelbase * (car.cg_to_rear_axle / stiff_front - car.cg_to_front_axle / stiff_rear)
    steer = 0.2 * (car.wheelbase + gradient * speed**2) / speed**2  # for 0.2 m/s^2
    state, out = advance(car, initial_state(car, speed), 0.0, steer, 4.0)
    vx, vy, r = state[3:6]
    # The quadratic of F(alpha), the loads' shift and the speed lost to the front's cos(delta) are each below 1e-3.
    assert r / steer == pytest.approx(vx / (car.wheelbase + gradient * vx**2), rel=2e-3)
    rear_angle = car.mass * car.cg_to_front_axle / car.wheelbase * vx * r / stiff_rear
    assert vy == pytest.approx(car.cg_to_rear_axle * r - vx * rear_angle, rel=1e-2, abs=2e-4)
    # The car still slows by cornering, and v_y follows: 1e-5 of the whole.
    assert out.specific_force[1] == pytest.approx(vx * r, rel=1e-4)


@pytest.mark.parametrize("car", CARS.values(), ids=CARS)
def test_a_mirrored_state_has_mirrored_rates_to_the_last_bit(car):
    rng = np.random.default_rng(11)
    odd = [INDEX[name] for name in ("Y", "yaw", "vy", "r", "steer", "ay_load", "ay_load_rate")]
    swap = np.arange(24)
    for start in (6, 10, 14):
        swap[start : start + 4] = start + np.array([1, 0, 3, 2])
    sign = np.ones(24)
    sign[odd] = -1.0
    sign[14:18] = -1.0
    for _ in range(50):
        state = random_state(car, rng)
        torque, steer = rng.uniform(-1, 1) * car.max_torque, rng.normal(0, 0.05)
        around = Surroundings(0.9, 0.02, 0.03, 2.0, -3.0)
        mirrored = Surroundings(0.9, 0.02, -0.03, 2.0, 3.0)
        rate, out = state_rate(car, state, torque, steer, around)
        other, other_out = state_rate(car, sign * state[swap], torque, -steer, mirrored)
        np.testing.assert_array_equal(other, sign * rate[swap])
        np.testing.assert_array_equal(other_out.load, out.load[[1, 0, 3, 2]])


@pytest.mark.parametrize("car", CARS.values(), ids=CARS)
def test_kinetic_energy_changes_by_the_powers_at_any_state(car):
    # An identity of the equations: it holds for every state, moving or not along a solution.
    rng = np.random.default_rng(5)
    inertia = np.array([car.wheel_inertia_front] * 2 + [car.wheel_inertia_rear] * 2)
    for _ in range(50):
        state = random_state(car, rng)
        around = Surroundings(0.8, rng.normal(0, 0.05), rng.normal(0, 0.05), *rng.normal(0, 5, 2))
        rate, out = state_rate(car, state, 0.0, 0.0, around)
        gain = car.mass * state[3:5] @ rate[3:5] + car.yaw_inertia * state[5] * rate[5]
        gain += np.sum(inertia * state[WHEELS] * rate[WHEELS])
        sources = out.power_in - out.power_tire - out.power_rolling - out.power_air + out.power_gravity
        size = sum(abs(p) for p in (out.power_in, out.power_tire, out.power_air)) + abs(gain) + 1.0
        assert gain == pytest.approx(sources, abs=1e-11 * size)


def test_energy_over_a_whole_braking_in_a_turn():
    run = run_maneuver(ROAD_CAR, build_maneuver("brake_in_turn", ROAD_CAR, 0.8), sample_period=1e-3)
    inertia = np.array([ROAD_CAR.wheel_inertia_front] * 2 + [ROAD_CAR.wheel_inertia_rear] * 2)
    kinetic = 0.5 * ROAD_CAR.mass * (run.states[:, 3] ** 2 + run.states[:, 4] ** 2)
    kinetic += 0.5 * ROAD_CAR.yaw_inertia * run.states[:, 5] ** 2 + 0.5 * run.states[:, WHEELS] ** 2 @ inertia
    power_in, tire, rolling, air, gravity = run.outputs[:, 14:19].T
    power = power_in - tire - rolling - air + gravity
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(run.t))])
    lost = kinetic[0] - kinetic.min()
    # Trapezoids at 1 ms against wheel dynamics of 10 ms: (1/10)^2/12 of the transients, a small part of the whole.
    assert np.abs(kinetic - kinetic[0] - work).max() < 1e-4 * lost
    assert np.all(tire[run.t > 1.0] > 0)  # sliding tyres only ever lose energy


@pytest.mark.parametrize("car", CARS.values(), ids=CARS)
def test_wheel_loads_sum_to_weight_and_air(car):
    rng = np.random.default_rng(3)
    for _ in range(30):
        state = random_state(car, rng)
        state[20:23:2] = rng.normal(0, 8.0, 2)  # hard enough that wheels lift
        grade, bank = rng.normal(0, 0.05, 2)
        _, out = state_rate(car, state, 0.0, 0.0, Surroundings(grade=grade, bank=bank))
        air = 0.5 * car.air_density * (car.downforce_area_front + car.downforce_area_rear) * state[3] ** 2
        weight = car.mass * STANDARD_GRAVITY * np.cos(grade) * np.cos(bank)
        pitch = car.mass * state[20] * car.cg_height / car.wheelbase
        if abs(pitch) < 0.9 * min(car.static_load_front, car.static_load_rear):  # no axle in the air
            assert out.load.sum() == pytest.approx(weight + air, rel=1e-12)
        assert np.all(out.load >= 0)


def test_load_transfer_balances_the_moments_about_the_ground():
    car = plain(ROAD_CAR)
    state = initial_state(car, 20.0)
    state[20], state[22] = 2.0, 4.0
    _, out = state_rate(car, state, 0.0, 0.0)
    left_to_right = (out.load[1] - out.load[0]) * car.track_front / 2 + (out.load[3] - out.load[2]) * car.track_rear / 2
    # Moments of specific forces at the CG's height; the air's lift acts at the axles and has no part in roll.
    assert left_to_right == pytest.approx(car.mass * 4.0 * car.cg_height, rel=1e-12)
    lift_front = 0.5 * car.air_density * car.downforce_area_front * 400.0
    assert out.load[:2].sum() - car.static_load_front - lift_front == pytest.approx(
        -car.mass * 2.0 * car.cg_height / car.wheelbase, rel=1e-12
    )


@pytest.mark.parametrize("car", CARS.values(), ids=CARS)
def test_runge_kutta_converges_with_order_four(car):
    speed = 15.0 * np.sqrt(car.wheelbase / 2.7)
    start, _ = advance(car, initial_state(car, speed), 0.2 * car.max_torque, 0.0, 0.5, step=2.5e-4)

    def after(step):
        return advance(car, start, 0.3 * car.max_torque, 0.03, 0.24, step=step)[0]

    exact = after(1.25e-4 / 2)
    scale = np.maximum(np.abs(exact), 1e-2)
    errors = [np.abs((after(step) - exact) / scale).max() for step in (2e-3, 1e-3, 5e-4)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # Two halvings of the step; at 2 ms, where the stiffest mode has h*lambda 0.4, the next power adds some tenths.
    assert np.all(orders > 3.6) and np.all(orders < 4.7), (errors, orders)
    assert errors[1] < 1e-6  # at the 1 ms that simulations use


@pytest.mark.parametrize("speed", [6.0, 25.0])
def test_lateral_slip_builds_up_over_a_distance_whatever_the_speed(speed):
    # On ice the car goes straight on with its wheels turned, so the tyres' slip is the pure response to a step:
    # tan(alpha) = tan(delta) (1 - exp(-d cos(delta)/sigma)).
    car = plain(ROAD_CAR, drag_area=0.0, side_area=0.0)
    state = initial_state(car, speed)
    state[INDEX["steer"]] = 0.02
    sigma = car.front_tire.relaxation_lateral
    for distance in (0.3 * sigma, sigma, 3 * sigma):
        step = distance / speed / 200
        after, _ = advance(car, state, 0.0, 0.02, distance / speed, step=step, surroundings=Surroundings(friction=1e-9))
        expected = np.tan(0.02) * (1.0 - np.exp(-distance * np.cos(0.02) / sigma))
        assert after[INDEX["tan_slip_angle_fl"]] == pytest.approx(expected, rel=1e-6)


def test_a_slope_and_a_bank_pull_with_the_share_of_gravity_that_they_should():
    car = plain(ROAD_CAR)
    state = initial_state(car, 20.0)
    level, _ = state_rate(car, state, 0.0, 0.0)
    sloped, out = state_rate(car, state, 0.0, 0.0, Surroundings(grade=0.05, bank=-0.04))
    # Rolling resistance reaches the body through the tyres, whose relaxed slips are still zero: only gravity acts.
    assert sloped[3] - level[3] == pytest.approx(-STANDARD_GRAVITY * np.sin(0.05), rel=1e-9)
    assert sloped[4] - level[4] == pytest.approx(-STANDARD_GRAVITY * np.sin(-0.04), rel=1e-9)
    assert out.specific_force[1] == pytest.approx(0.0, abs=1e-12)


def test_only_the_velocity_through_the_air_makes_drag():
    car = plain(ROAD_CAR)
    state = initial_state(car, 20.0)
    head, _ = state_rate(car, state, 0.0, 0.0, Surroundings(wind_x=-10.0))
    still, _ = state_rate(car, initial_state(car, 30.0), 0.0, 0.0)
    assert head[3] == pytest.approx(still[3], rel=1e-12)


def test_a_locked_axle_resists_turning_by_the_torque_it_passes():
    speed, steer = 8.0, 0.08
    turned = {}
    for locking in (0.0, 50.0):
        car = replace(FORMULA_CAR, differential_locking_rear=locking)
        turned[locking] = advance(car, initial_state(car, speed), 0.0, steer, 2.0)
    (opened, _), (locked, out) = turned[0.0], turned[50.0]
    assert locked[5] / locked[3] < 0.99 * opened[5] / opened[3]
    # The clutch's torque is what the two wheels push against each other; rolling resistance differs with load by
    # some N m and the wheels' own deceleration by less.
    passed = 50.0 * (locked[9] - locked[8])
    pushed = 0.5 * (out.force_x[2] - out.force_x[3]) * FORMULA_CAR.wheel_radius
    assert passed == pytest.approx(pushed, rel=0.05)
    assert passed > 30.0


@pytest.mark.parametrize("name", MANEUVER_NAMES)
def test_true_signals_satisfy_the_kinematic_identities(name):
    car = F1TENTH_CAR if name == "sine_sweep" else ROAD_CAR
    run = run_maneuver(car, build_maneuver(name, car, 0.6), sample_period=1e-3)
    x, y, yaw, vx, vy, r = (run.channel(c) for c in ("X", "Y", "yaw", "vx", "vy", "r"))
    ax, ay = run.channel("ax"), run.channel("ay")

    def slope(values):
        return (values[2:] - values[:-2]) / 2e-3

    inner = slice(1, -1)
    # Central differences of 1 ms: h^2/6 of a third derivative. Motions with wheel and tyre transients of 10 ms or
    # more leave 1e-3 of what changes; commands step every 20 ms, hence a bound on the rms and not on the worst.
    for left, right, size in (
        (slope(x), (vx * np.cos(yaw) - vy * np.sin(yaw))[inner], np.ptp(vx) + 1),
        (slope(y), (vx * np.sin(yaw) + vy * np.cos(yaw))[inner], np.ptp(vx) + 1),
        (slope(yaw), r[inner], np.ptp(r) + 0.01),
        (slope(vx) - (vy * r)[inner], ax[inner], np.ptp(ax) + 0.1),
        (slope(vy) + (vx * r)[inner], ay[inner], np.ptp(ay) + 0.1),
    ):
        assert np.sqrt(np.mean((left - right) ** 2)) < 1e-3 * size


@pytest.mark.parametrize("locking", [0.5, 20.0, 500.0])
@pytest.mark.parametrize("speed", [7.0, 25.0])
def test_a_differential_damps_yaw_in_series_with_the_slip_of_its_wheels(locking, speed):
    """M = -r/(R^2/(k w^2) + 2 v/(w^2 C)) with k the locking and C the slip stiffness of a wheel: less at speed."""
    car = replace(plain(FORMULA_CAR), differential_locking_rear=locking)
    width, turning, inner = car.track_rear, 0.05, slice(6, 18)
    state = initial_state(car, speed)
    state[INDEX["r"]] = turning
    state[INDEX["vy"]] = car.cg_to_rear_axle * turning  # no slip angle at the rear
    # Slopes of both rear wheels at this load, from a slip ratio that is put in by hand.
    slipping = state.copy()
    slipping[12:14] = 1e-3, -1e-3
    pulls = state_rate(car, slipping, 0.0, 0.0)[1].force_x[2:4]
    stiffness = 0.5 * (pulls[0] - pulls[1]) / 1e-3
    for _ in range(6000):  # wheels and slips settle while the body is held
        rate, found = state_rate(car, state, 0.0, 0.0)
        state[inner] += 1e-4 * rate[inner]
    moment = 0.5 * width * (found.force_x[3] - found.force_x[2])
    series = car.wheel_radius**2 / (locking * width**2) + 2.0 * speed / (width**2 * stiffness)
    # Tyres roll at 1 % of slip at most, where they are linear to a few per cent.
    np.testing.assert_allclose(moment, -turning / series, rtol=0.03)
