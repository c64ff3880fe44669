"""Discrete time: RK4 over recorded inputs, the exact linear step, and Phi, each against a slower way."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad_vec, solve_ivp
from scipy.linalg import expm

from split_cli.vehicle.effects import CATALOGUE, Recording, Term
from split_cli.vehicle.integration import Situation, integrate_recorded, phi_matrix
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.windows import recorded_inputs, substep_count
from tests.exact_step import exact_step


class LinearModel:
    """A stand-in for the single track that is linear in all it gets: v' = A v + b_T T + b_delta delta."""

    A = np.array([[-0.05, 0.3, 0.1], [-0.2, -4.0, -12.0], [0.02, 1.5, -5.0]])
    B = np.array([[2e-3, 0.4], [1e-4, 30.0], [-2e-4, 40.0]])

    def velocity_derivative(self, vx, vy, r, T, delta, **situation):
        state = np.stack(np.broadcast_arrays(vx, vy, r, T, delta))
        return tuple(np.hstack([self.A, self.B]) @ state)


def manoeuvre(car, seconds, period, *, phase=0.0):
    """A smooth slalom with changing torque: inputs on the samples, linear between them."""
    t = np.arange(round(seconds / period) + 1) * period
    steer = 0.05 * np.sin(3.0 * t + phase)[None]
    torque = 0.2 * car.max_torque * np.cos(2.0 * t + phase)[None]
    return torque, steer


def fine_solution(model, state, torque, steer, period):
    """The continuous model by an adaptive method of order 8 over the linearly interpolated inputs."""
    grid = np.arange(torque.shape[1]) * period
    for k in range(torque.shape[1] - 1):

        def rates(t, x, k=k):
            T = np.interp(t, grid, torque[0])
            delta = np.interp(t, grid, steer[0])
            return np.array([float(v) for v in model.velocity_derivative(*x, T, delta)])

        state = solve_ivp(rates, (grid[k], grid[k + 1]), state, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    return state


def test_rk4_converges_with_the_fourth_power_of_the_step(car):
    model = SingleTrack(car)
    period = 0.1
    torque, steer = manoeuvre(car, 0.4, period)
    start = np.array([3.0 * car.minimum_speed, 0.0, 0.0])
    exact = fine_solution(model, start, torque, steer, period)
    counts = np.array([8, 16, 32])
    errors = [
        np.linalg.norm(integrate_recorded(model, start[None], torque, steer, period, n)[0] - exact) for n in counts
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # 3.7: the limit is approached from outside where |lambda| h is still a few tenths.
    assert np.all(orders > 3.7), orders
    assert errors[-1] < 1e-5 * start[0]


def test_the_substep_rule_keeps_the_step_accurate_in_a_stiff_car():
    # At 6 m/s the lateral modes of a light car are near 60 1/s: one step of 50 ms is outside RK4's stability.
    jacobian = np.diag([-0.1, -60.0, -20.0])[None]
    (n,) = substep_count(jacobian, 0.05, 2.7)
    assert n == 4  # |A^4|^(1/4) is 0.6 % above the largest eigenvalue, which alone would ask for 3.0
    assert np.abs(np.linalg.eigvals(jacobian[0])).max() * 0.05 / n <= 1.0
    assert substep_count(jacobian, 0.0165, 2.7) == [1]
    assert not len(substep_count(np.empty((0, 3, 3)), 0.05, 2.7))


def test_every_window_has_its_own_count_and_what_is_not_finite_one_or_the_most():
    gentle, stiff = np.diag([-0.1, -6.0, -2.0]), np.diag([-0.1, -60.0, -20.0])
    broken = np.full((3, 3), np.nan)
    counts = substep_count(np.stack([gentle, stiff, broken, 1e6 * stiff]), 0.05, 2.7)
    np.testing.assert_array_equal(counts, [1, 4, 1, 1000])


def test_the_substep_rule_bounds_the_error_of_a_sample(car):
    # RK4 replaces e^-1 = 0.3679 by 0.3750 where |lambda| step is 1, so a sample's change is right to about 1 %
    # at the rule's very edge (the slowest speed), and to the fourth power better above.
    model = SingleTrack(car)
    period = 0.05
    torque, steer = manoeuvre(car, 0.05, period, phase=1.2)
    start = np.array([car.minimum_speed, 0.0, 0.0])
    jacobian = model.velocity_jacobian(*(start[:, None]), torque[:, 0], steer[:, 0])
    (n,) = substep_count(jacobian, period, car.wheelbase)
    step = integrate_recorded(model, start[None], torque, steer, period, n)[0] - start
    exact = fine_solution(model, start, torque, steer, period) - start
    assert np.linalg.norm(step - exact) < 1e-2 * np.linalg.norm(exact)


def test_windows_do_not_influence_each_other(car):
    model = SingleTrack(car)
    rng = np.random.default_rng(5)
    state = np.stack([car.minimum_speed * rng.uniform(1, 4, 20), rng.normal(0, 0.1, 20), rng.normal(0, 0.1, 20)], 1)
    torque, steer = rng.normal(0, 0.1 * car.max_torque, (20, 6)), rng.normal(0, 0.05, (20, 6))
    together = integrate_recorded(model, state, torque, steer, 0.01, 2)
    alone = [
        integrate_recorded(model, state[i : i + 1], torque[i : i + 1], steer[i : i + 1], 0.01, 2) for i in range(20)
    ]
    np.testing.assert_array_equal(together, np.concatenate(alone))


def test_pose_follows_the_circle(car):
    # Free of forces but for a constant yaw rate there is no closed form; with the velocities frozen there is.
    class Frozen:
        def velocity_derivative(self, vx, vy, r, T, delta, **situation):
            return 0.0 * vx, 0.0 * vy, 0.0 * r

    v, r = 12.0, 0.6
    inputs = np.zeros((1, 51))
    end = integrate_recorded(Frozen(), np.array([[1.0, 2.0, 0.3, v, 0.0, r]]), inputs, inputs, 0.02, 1)[0]
    yaw = 0.3 + r * 1.0
    expected = [1.0 + v / r * (np.sin(yaw) - np.sin(0.3)), 2.0 - v / r * (np.cos(yaw) - np.cos(0.3)), yaw]
    # RK4 on sin and cos: (r h)^4/2880 of the path, below 1e-11 here; the last digits are rounding.
    np.testing.assert_allclose(end[:3], expected, rtol=1e-9)
    np.testing.assert_array_equal(end[3:], [v, 0.0, r])


def random_jacobians(car, count, seed):
    rng = np.random.default_rng(seed)
    vx = car.minimum_speed * rng.uniform(0.5, 6.0, count)
    return SingleTrack(car).velocity_jacobian(
        vx, rng.normal(0, 0.3, count), rng.normal(0, 0.3, count), np.zeros(count), rng.normal(0, 0.05, count)
    )


@pytest.mark.parametrize("horizon", [1e-3, 0.05, 0.5])
def test_phi_is_the_integral_of_the_exponential(car, horizon):
    for A in random_jacobians(car, 5, 6):
        integral, _ = quad_vec(lambda s, A=A: expm(A * s), 0.0, horizon, epsabs=1e-13, epsrel=1e-12)
        # Both are good to about 1e-12 of the largest entry; expm's own scaling costs the rest.
        scale = np.abs(integral).max() / horizon
        np.testing.assert_allclose(phi_matrix(A[None], horizon)[0], integral / horizon, atol=1e-10 * scale)


def test_phi_of_zero_and_of_one_dimension():
    np.testing.assert_array_equal(phi_matrix(np.zeros((2, 3, 3)), 0.05), np.broadcast_to(np.eye(3), (2, 3, 3)))
    lam = np.array([-30.0, -3.0, 0.5])
    phi = phi_matrix(np.diag(lam)[None], 0.1)[0]
    np.testing.assert_allclose(np.diag(phi), np.expm1(lam * 0.1) / (lam * 0.1), rtol=1e-14)


def test_phi_of_a_matrix_does_not_depend_on_its_neighbours(car):
    # A trained set must be the same bit for bit whatever the batch; a shared scaling would leak.
    A = random_jacobians(car, 40, 8)
    together = phi_matrix(A, 0.05)
    alone = np.concatenate([phi_matrix(one[None], 0.05) for one in A])
    np.testing.assert_array_equal(together, alone)


class Pushed(Term):
    """A constant force and moment from outside, which no tyre lets build up."""

    id = "pushed"
    units = {"lateral": "N", "moment": "N m"}

    def external(self, flow):
        flow.force_y = flow.force_y + self.parameters["lateral"]
        flow.moment = flow.moment + self.parameters["moment"]


def straight_windows(model, speeds, samples, period):
    """Windows of straight drives without torque at each of some speeds, (N,), and the states at their begin."""
    velocity = np.repeat(np.stack([speeds, 0 * speeds, 0 * speeds], axis=1), samples + 1, axis=0)
    zeros, begins = np.zeros(len(velocity)), np.arange(len(speeds)) * (samples + 1)
    recording = Recording(period, tuple((begin, begin + samples + 1) for begin in begins.tolist()))
    inputs = recorded_inputs(model, velocity, zeros, zeros, recording, Situation(zeros, zeros, zeros))
    return inputs.windows(begins, samples), velocity[begins]


@pytest.mark.parametrize("share", [0.02, 0.1, 0.5])
def test_a_held_rate_and_a_velocity_meet_forces_that_build_up_meanwhile(car, share):
    """Phi and exp(A h) beside tyre relaxation, against the model with a push and with another begin."""
    length, horizon, period = share * car.wheelbase, 0.05, 0.005
    relaxation = CATALOGUE["tire_relaxation"]({"length": length})
    model, push = SingleTrack(car, (relaxation,)), np.array([1e-3, 1e-2])  # [m/s^2], [rad/s^2]
    windows, begin = straight_windows(model, car.minimum_speed * np.array([2.0, 4.0]), 10, period)
    jacobian = windows.jacobian(model, begin)
    phi, kept = windows.responses(model, begin, jacobian, horizon)
    plain = windows.predict(model, begin, jacobian)
    for column, size in zip((1, 2), push, strict=True):
        forces = {"lateral": car.mass * size, "moment": 0.0}
        if column == 2:
            forces = {"lateral": 0.0, "moment": car.yaw_inertia * size}
        pushed = windows.predict(SingleTrack(car, (relaxation, Pushed(forces))), begin, jacobian)
        # The car slows by less than 1 % within the window, and so much A is another one; RK4 adds 0.1 %.
        np.testing.assert_allclose((pushed - plain) / (horizon * size), phi[:, :, column], atol=3e-3)
        moved = begin + 1e-3 * np.eye(3)[column]
        after = (windows.predict(model, moved, jacobian) - plain) / 1e-3
        np.testing.assert_allclose(after, kept[:, :, column], atol=3e-3)
    # With the forces held still a rate would arrive as a whole.
    assert np.all(phi[:, 2, 2] < 0.97) and np.all(phi_matrix(jacobian, horizon)[:, 2, 2] > 0.99)


def test_a_force_that_builds_up_ever_faster_resists_as_one_that_is_there_at_once(car):
    speeds, horizon = car.minimum_speed * np.array([2.0, 4.0]), 0.05
    at_once = SingleTrack(car, ())
    windows, begin = straight_windows(at_once, speeds, 10, 0.005)
    phi, kept = windows.responses(at_once, begin, windows.jacobian(at_once, begin), horizon)
    apart = []
    for share in (0.02, 0.01, 0.005):
        model = SingleTrack(car, (CATALOGUE["tire_relaxation"]({"length": share * car.wheelbase}),))
        windows, begin = straight_windows(model, speeds, 10, 0.005)
        ours = windows.responses(model, begin, windows.jacobian(model, begin), horizon)
        apart.append(max(np.abs(one - other).max() for one, other in zip(ours, (phi, kept), strict=True)))
    # What is left goes with the time that the force takes.
    assert apart[0] < 0.2
    np.testing.assert_allclose(np.divide(apart[1:], apart[:-1]), 0.5, atol=0.1)


def full_rk4(model, state, torque_rate, steer_rate, horizon, substeps):
    torque = np.stack([state[:, 6], state[:, 6] + horizon * torque_rate], axis=1)
    steer = np.stack([state[:, 7], state[:, 7] + horizon * steer_rate], axis=1)
    moved = integrate_recorded(model, state[:, :6], torque, steer, horizon, substeps)
    return np.column_stack([moved, torque[:, 1], steer[:, 1]])


def controller_states(car, count, seed):
    rng = np.random.default_rng(seed)
    vx = car.minimum_speed * rng.uniform(1.2, 4.0, count)
    delta = rng.uniform(-0.06, 0.06, count)
    return np.column_stack(
        [
            rng.normal(0, 10, count),
            rng.normal(0, 10, count),
            rng.uniform(-3, 3, count),
            vx,
            rng.normal(0, 0.01, count) * vx,
            0.5 * vx * delta / car.wheelbase,
            rng.uniform(-0.3, 0.5, count) * car.max_torque,
            delta,
        ]
    )


def test_exact_step_is_exact_for_a_linear_system():
    model = LinearModel()
    rng = np.random.default_rng(9)
    state = rng.normal(0, 1, (10, 8))
    state[:, 2] = 0.0  # at yaw 0 with the pose ignored: position is not linear in yaw
    rates = rng.normal(0, 1, (2, 10))
    stepped = exact_step(model, state, *rates, 0.3)
    # v' = A v + B u(t), u linear: the 7 x 7 system [v, u, u'] is linear, and its exponential is the truth.
    system = np.zeros((7, 7))
    system[:3, :3], system[:3, 3:5] = model.A, model.B
    system[3:5, 5:] = np.eye(2)
    grown = np.column_stack([state[:, 3:6], state[:, 6:], rates.T]) @ expm(0.3 * system).T
    # The Jacobian is by differences: 1e-9 of it, with entries up to 40.
    np.testing.assert_allclose(stepped[:, 3:6], grown[:, :3], atol=1e-6)
    np.testing.assert_allclose(stepped[:, 6:], grown[:, 3:5], atol=1e-9)


def test_exact_step_is_of_second_order_otherwise(car):
    model = SingleTrack(car)
    state = controller_states(car, 30, 10)
    torque_rate, steer_rate = np.full(30, car.max_torque), np.full(30, 0.3)
    errors = []
    horizons = np.array([8e-3, 4e-3, 2e-3])
    for h in horizons:
        reference = full_rk4(model, state, torque_rate, steer_rate, h, 40)
        errors.append(np.abs(exact_step(model, state, torque_rate, steer_rate, h) - reference)[:, :6].max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # Local error of order h^3, a method of second order.
    assert np.all((orders > 2.7) & (orders < 3.4)), orders


def test_difference_of_the_two_discretisations_over_fifty_milliseconds(road_car):
    # The figure docs/nomenclature.md states: a road car over 50 ms at 6 to 20 m/s, steer rates to 0.3 rad/s.
    model = SingleTrack(road_car)
    state = controller_states(road_car, 2000, 11)
    rng = np.random.default_rng(12)
    torque_rate = rng.uniform(-1, 1, 2000) * road_car.max_torque
    steer_rate = rng.uniform(-0.3, 0.3, 2000)
    reference = full_rk4(model, state, torque_rate, steer_rate, 0.05, 20)
    difference = exact_step(model, state, torque_rate, steer_rate, 0.05) - reference
    worst = np.abs(difference[:, 3:6]).max(axis=0)
    typical = np.sqrt(np.mean(difference[:, 3:6] ** 2, axis=0))
    # Measured: worst 0.0008 m/s, 0.016 m/s, 0.0074 rad/s; rms 0.00016, 0.0022, 0.0012. A fifth of room.
    assert np.all(worst < [1.0e-3, 2.0e-2, 9.0e-3])
    assert np.all(typical < [2.0e-4, 2.7e-3, 1.5e-3])


def test_terms_of_time_see_the_time_inside_the_step(road_car):
    # A term that uses t must be integrated, not frozen: v_x' = cos(t) has the answer sin.
    class Clock:
        def velocity_derivative(self, vx, vy, r, T, delta, *, t=0.0, **situation):
            return np.cos(t) + 0.0 * vx, 0.0 * vy, 0.0 * r

    # RK4 is Simpson's rule here, off by h^4/2880 of the change: 3.5e-8.
    inputs = np.zeros((1, 11))
    end = integrate_recorded(Clock(), np.zeros((1, 3)), inputs, inputs, 0.1, 1, Situation(t=np.array([0.5])))
    assert end[0, 0] == pytest.approx(np.sin(1.5) - np.sin(0.5), abs=1e-7)


def test_place_advances_with_the_path(road_car):
    class PlaceTerm:
        def velocity_derivative(self, vx, vy, r, T, delta, *, s=0.0, **situation):
            return 0.0 * vx, s + 0.0 * vy, 0.0 * r

    inputs = np.zeros((1, 11))
    start = np.array([[4.0, 0.0, 0.0]])
    end = integrate_recorded(PlaceTerm(), start, inputs, inputs, 0.1, 1, Situation(s=np.array([3.0])))
    # v_y' = s = 3 + 4 t over 1 s: 3 + 2.
    assert end[0, 1] == pytest.approx(5.0, rel=1e-12)


def test_effects_act_inside_the_step(road_car):
    # Only drag: v' = -c v^2/m has v(t) = v0/(1 + c v0 t/m).
    car = replace(road_car, drag_coefficient=0.0, rolling_resistance_front=0.0, rolling_resistance_rear=0.0)
    model = SingleTrack(car.with_effects(EffectSpec("aero_drag", {"drag": 1.0})))
    inputs = np.zeros((1, 101))
    end = integrate_recorded(model, np.array([[40.0, 0.0, 0.0]]), inputs, inputs, 0.05, 1)[0, 0]
    assert end == pytest.approx(40.0 / (1.0 + 1.0 * 40.0 * 5.0 / 1500.0), rel=1e-10)


@pytest.mark.parametrize("share", [0.02, 0.2])
def test_a_rate_that_is_left_out_reads_the_same_at_any_interval_beside_relaxation(car, share):
    """With the tyres' forces held still 0.6 rad/s^2 read 0.54, 0.42 and 0.29 at 20, 50 and 100 ms."""
    relaxation, size = CATALOGUE["tire_relaxation"]({"length": share * car.wheelbase}), 0.6
    model = SingleTrack(car, (relaxation,))
    pushed = SingleTrack(car, (relaxation, Pushed({"lateral": 0.0, "moment": size * car.yaw_inertia})))
    assert model.memory_feeds_back
    off = []
    for samples in (8, 20, 40, 80):
        windows, begin = straight_windows(model, car.minimum_speed * np.array([2.0, 4.0]), samples, 0.0025)
        jacobian, horizon = windows.jacobian(model, begin), 0.0025 * samples
        rate = (windows.predict(pushed, begin, jacobian) - windows.predict(model, begin, jacobian)) / horizon
        found = np.linalg.solve(windows.phi(model, begin, jacobian, horizon), rate[:, :, None])[:, :, 0]
        off.append(np.abs(found - [0.0, 0.0, size]).max())
    # What is left is the change of A while the car begins to turn, which goes with h squared at first.
    assert (np.array(off) < size * np.array([0.0005, 0.003, 0.01, 0.02])).all(), off


def test_only_what_velocities_move_joins_phi(car):
    lags = (CATALOGUE["drive_lag"]({"tau": 0.1}), CATALOGUE["steer_backlash"]({"width": 0.01}))
    assert not SingleTrack(car, lags).memory_feeds_back and not SingleTrack(car, ()).memory_feeds_back
    assert SingleTrack(car, (*lags, CATALOGUE["tire_relaxation"]({"length": 0.5}))).memory_feeds_back
    model = SingleTrack(car, lags)
    windows, begin = straight_windows(model, np.array([10.0, 20.0]), 10, 0.005)
    jacobian = windows.jacobian(model, begin)
    np.testing.assert_array_equal(windows.phi(model, begin, jacobian, 0.05), phi_matrix(jacobian, 0.05))
