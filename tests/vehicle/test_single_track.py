"""The nominal single track against the textbook, a mirror, energy and differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve

from split_cli.errors import VehicleError
from split_cli.vehicle.effects import CATALOGUE, build_terms
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack, slip_angles
from split_cli.vehicle.tire import MagicFormula, lateral_force, lateral_force_slope


def random_states(car, count, seed):
    """Speeds from slow to fast, slip angles to 0.18 rad, torque over its whole range."""
    rng = np.random.default_rng(seed)
    vx = car.minimum_speed * rng.uniform(1.0, 6.0, count)
    beta = rng.uniform(-0.1, 0.1, count)
    r = rng.uniform(-0.4, 0.4, count) * vx / car.wheelbase * 0.1
    T = rng.uniform(-car.max_brake_torque, car.max_torque, count)
    delta = rng.uniform(-0.2, 0.2, count)
    return vx, vx * np.tan(beta), r, T, delta


def plain(car):
    """The car without resistances, where the linear theory of steady cornering is exact in the limit."""
    return replace(car, rolling_resistance_front=0.0, rolling_resistance_rear=0.0, drag_coefficient=0.0)


@pytest.mark.parametrize("factor", [2.0, 4.0])
def test_steady_cornering_has_the_understeer_gradient_of_linear_theory(car, factor):
    # delta = L/R + K_us a_y with K_us = m (l_r/C_f - l_f/C_r)/L (Gillespie 1992, ch. 6; Milliken, ch. 5).
    model = SingleTrack(plain(car))
    c_f, c_r = car.front_tire.cornering_stiffness, car.rear_tire.cornering_stiffness
    L = car.wheelbase
    gradient = car.mass / L * (car.cg_to_rear_axle / c_f - car.cg_to_front_axle / c_r)
    speed = factor * car.minimum_speed

    def steady(delta):
        def residual(unknown):
            vy, r = unknown
            # The torque that holds v_x is small and acts along x; free rolling isolates cornering.
            _, dvy, dr = model.velocity_derivative(speed, vy, r, 0.0, delta)
            return dvy, dr

        return fsolve(residual, (0.0, speed * delta / L), xtol=1e-12)

    errors = []
    for delta in (2e-3, 1e-3):
        _, r = steady(delta)
        lateral_acceleration = speed * r
        errors.append(abs(delta - (L * r / speed + gradient * lateral_acceleration)) / delta)
    # Tyres, atan and cos leave the linear law with the square of the angle: a quarter at half the angle.
    assert errors[1] < 1e-3
    assert errors[1] / errors[0] == pytest.approx(0.25, abs=0.02)


def test_yaw_velocity_gain_peaks_at_the_characteristic_speed(road_car):
    # r/delta = v/(L + K_us v^2), the largest at v_ch = sqrt(L/K_us).
    car = plain(road_car)
    model = SingleTrack(car)
    c_f, c_r = car.front_tire.cornering_stiffness, car.rear_tire.cornering_stiffness
    gradient = car.mass / car.wheelbase * (car.cg_to_rear_axle / c_f - car.cg_to_front_axle / c_r)
    assert gradient > 0, "the test car understeers"
    characteristic = np.sqrt(car.wheelbase / gradient)
    speeds = characteristic * np.array([0.9, 1.0, 1.1])
    A = model.velocity_jacobian(speeds, 0 * speeds, 0 * speeds, 0 * speeds, 0 * speeds)[:, 1:, 1:]
    step = 1e-6
    ahead = model.velocity_derivative(speeds, 0 * speeds, 0 * speeds, 0 * speeds, 0 * speeds + step)
    gain = -np.linalg.solve(A, np.stack(ahead[1:], axis=1)[:, :, None])[:, 1, 0] / step
    # The force's own tilt, -F sin(delta), is of second order, so 1e-4 covers the difference quotient.
    np.testing.assert_allclose(gain, speeds / (car.wheelbase + gradient * speeds**2), rtol=1e-4)
    assert gain[1] > max(gain[0], gain[2])


def test_straight_running_is_newtons_law_by_hand(car):
    model = SingleTrack(car)
    v, T = 2.0 * car.minimum_speed, 0.3 * car.max_torque
    dvx, dvy, dr = model.velocity_derivative(v, 0.0, 0.0, T, 0.0)
    rolling = car.rolling_resistance_front + car.rolling_resistance_rear
    by_hand = (T / car.wheel_radius - rolling - car.drag_coefficient * v**2) / car.mass
    assert dvx == pytest.approx(by_hand, rel=1e-14)
    assert (dvy, dr) == (0.0, 0.0)


def test_mirrored_motion_has_the_mirrored_derivative_exactly(car):
    vx, vy, r, T, delta = random_states(car, 500, 1)
    model = SingleTrack(car)
    left = model.velocity_derivative(vx, vy, r, T, delta)
    right = model.velocity_derivative(vx, -vy, -r, T, -delta)
    # Odd functions are odd in floating point too, so not a bit may differ.
    np.testing.assert_array_equal(left[0], right[0])
    np.testing.assert_array_equal(left[1], -right[1])
    np.testing.assert_array_equal(left[2], -right[2])


def test_power_balance_without_slip_losses(road_car):
    # d/dt (m v^2 + I r^2)/2 = sum of force times the velocity of its point; forces taken from `flow`.
    vx, vy, r, T, delta = random_states(road_car, 300, 2)
    model = SingleTrack(road_car)
    dvx, dvy, dr = model.velocity_derivative(vx, vy, r, T, delta)
    # In the turning frame the change of kinetic energy is v . (v' + r x v), and r x v does no work.
    m, i_z = road_car.mass, road_car.yaw_inertia
    kinetic = m * (vx * (dvx - vy * r) + vy * (dvy + vx * r)) + i_z * r * dr
    f = model.flow(vx, vy, r, T, delta)
    s, c = np.sin(delta), np.cos(delta)
    front_vy, rear_vy = vy + road_car.cg_to_front_axle * r, vy - road_car.cg_to_rear_axle * r
    front = (f.front.longitudinal_force * c - f.front.lateral_force * s) * vx
    front += (f.front.longitudinal_force * s + f.front.lateral_force * c) * front_vy
    rear = f.rear.longitudinal_force * vx + f.rear.lateral_force * rear_vy
    np.testing.assert_allclose(kinetic, front + rear + f.force_x * vx, rtol=1e-12, atol=1e-9)


def test_a_lateral_force_never_drives_the_contact_patch(car):
    # F_y times the lateral velocity of the tyre's contact patch dissipates: the sign convention of slip angles.
    vx, vy, r, _, delta = random_states(car, 500, 3)
    alpha_f, alpha_r = slip_angles(vx, vy, r, delta, car.cg_to_front_axle, car.cg_to_rear_axle)
    f = SingleTrack(car).flow(vx, vy, r, np.zeros_like(vx), delta)
    sideways_f = -np.sin(delta) * vx + np.cos(delta) * (vy + car.cg_to_front_axle * r)
    sideways_r = vy - car.cg_to_rear_axle * r
    assert np.all(f.front.lateral_force * sideways_f <= 0.0)
    assert np.all(f.rear.lateral_force * sideways_r <= 0.0)
    np.testing.assert_array_equal(f.front.slip_angle, alpha_f)


def test_brake_split_acts_only_below_zero_torque(road_car):
    f = SingleTrack(road_car).flow(*(np.full(3, x) for x in (20.0, 0.0, 0.0)), np.array([-100.0, 0.0, 100.0]), 0.0)
    share = (f.front.longitudinal_force + 90.0) * road_car.wheel_radius
    np.testing.assert_allclose(share, [-66.0, 0.0, 40.0], atol=1e-12)


@pytest.mark.parametrize("effects", [(), (EffectSpec("aero_drag", {"drag": 0.1}),)])
def test_jacobian_agrees_with_differences(car, effects):
    model = SingleTrack(car.with_effects(*effects))
    states = random_states(car, 200, 4)
    jacobian = model.velocity_jacobian(*states)
    for column in range(3):
        # A step of 1e-5 of the speed balances truncation (h^2) and rounding (eps/h): about 1e-10 of an entry.
        h = 1e-5 * (1.0 + np.abs(states[column]))
        ahead, behind = list(states), list(states)
        ahead[column], behind[column] = states[column] + h, states[column] - h
        slopes = [
            (a - b) / (2.0 * h)
            for a, b in zip(model.velocity_derivative(*ahead), model.velocity_derivative(*behind), strict=True)
        ]
        scale = np.abs(jacobian).max()
        np.testing.assert_allclose(jacobian[:, :, column], np.stack(slopes, axis=1), atol=1e-7 * scale)


def test_force_matrix_is_the_model_at_zero_steer(car):
    # A newton at an axle, put in through D at the tyre's peak, changes the rates by the matrix's column.
    B = car.force_matrix()
    vx = np.array([3.0 * car.minimum_speed])
    alpha = -0.05
    states = (vx, np.tan(-alpha) * vx, 0.0 * vx, 0.0 * vx, 0.0 * vx)
    base = np.array(SingleTrack(car).velocity_derivative(*states))[:, 0]
    for column, axle in ((1, "front_tire"), (2, "rear_tire")):
        tire = getattr(car, axle)
        unit = float(np.sin(tire.C * np.arctan(tire.B * alpha)))
        stronger = replace(car, **{axle: MagicFormula(tire.B, tire.C, tire.D + 1.0 / unit * -0.01 * tire.D)})
        newton = -0.01 * tire.D
        changed = np.array(SingleTrack(stronger).velocity_derivative(*states))[:, 0]
        np.testing.assert_allclose((changed - base) / newton, B[:, column], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("tire", [MagicFormula(11.0, 1.45, 7900.0), MagicFormula(4.0, 0.9, 12.0)])
def test_tire_slope_peak_and_stiffness(tire):
    alpha = np.linspace(-0.5, 0.5, 401)
    h = 1e-6
    slope = (lateral_force(tire.B, tire.C, tire.D, alpha + h) - lateral_force(tire.B, tire.C, tire.D, alpha - h)) / (
        2 * h
    )
    np.testing.assert_allclose(
        lateral_force_slope(tire.B, tire.C, tire.D, alpha), slope, atol=1e-8 * tire.cornering_stiffness
    )
    assert lateral_force_slope(tire.B, tire.C, tire.D, 0.0) == pytest.approx(tire.cornering_stiffness, rel=1e-15)
    if tire.C > 1.0:
        peak = np.tan(np.pi / (2.0 * tire.C)) / tire.B
        assert lateral_force(tire.B, tire.C, tire.D, peak) == pytest.approx(tire.D, rel=1e-15)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (EffectSpec("aero_drga", {"drag": 1.0}), "aero_drag"),
        (EffectSpec("aero_drag", {"drug": 1.0}), "drag"),
        (EffectSpec("aero_drag", {}), "lacks drag"),
        (EffectSpec("aero_drag", {"drag": 1.0}, "quadratic"), "variant"),
    ],
)
def test_unknown_terms_and_parameters_are_told_with_the_nearest(road_car, effect, message):
    with pytest.raises(VehicleError, match=message):
        SingleTrack(road_car.with_effects(effect))


def test_weighted_changes_are_those_of_balances_one_by_one(car):
    """Of forces, of peaks and whole curves, of the body and of a steer angle, with others in the file."""
    car = car.with_effects(EffectSpec("aero_drag", {"drag": 0.3}))
    state, own = random_states(car, 50, 12), build_terms(car)
    bare = SingleTrack(car, ()).flow(*state)
    values = {
        "aero_downforce": {"front": 0.4, "rear": 0.0},
        "tire_stiffness": {"front_scale": 1.2, "rear_scale": 1.0},
        "load_transfer": {"cg_height": 0.1},
        "mass": {"scale": 1.1},
        "steer_gain": {"gain": 0.9},
        "rolling_resistance": {"force": 30.0},
    }
    flows = [SingleTrack(car, (*own, CATALOGUE[k](v))).flow(*state, bare=bare) for k, v in values.items()]
    nominal = SingleTrack(car).flow(*state, bare=bare)
    weights = np.linspace(-2.0, 3.0, len(flows))
    found = SingleTrack.weighted_changes(nominal, zip(weights.tolist(), flows, strict=True))
    # Each by all its stages, with nothing taken from the bare flow.
    before = SingleTrack(car).velocity_derivative(*state)
    whole = [SingleTrack(car, (*own, CATALOGUE[k](v))).velocity_derivative(*state) for k, v in values.items()]
    for k in range(3):
        expected = sum(w * (one[k] - before[k]) for w, one in zip(weights, whole, strict=True))
        np.testing.assert_allclose(found[k], expected, rtol=0.0, atol=1e-10)
