"""Understeer, steering response, axle forces and whiteness against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.logs.drive import Drive
from split_cli.scoring.handling.axles import axle_forces, binned
from split_cli.scoring.handling.motion import free_run, measured_motion
from split_cli.scoring.handling.steering_response import steering_response
from split_cli.scoring.handling.understeer import understeer_of
from split_cli.scoring.handling.whiteness import autocorrelation
from split_cli.vehicle.integration import integrate_recorded
from split_cli.vehicle.parameters import EffectSpec, Vehicle
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import one_run, road_car

PERIOD = 0.01
CAR = road_car()


def driven(vehicle: Vehicle, delta: np.ndarray, speed: np.ndarray) -> Drive:
    """Return the lateral motion of a single track at given speed: RK4 at 100 Hz, v_x imposed."""
    model = SingleTrack(vehicle)
    state, rows = np.array([[speed[0], 0.0, 0.0]]), []
    torque = np.zeros((1, 2))
    for k in range(len(delta)):
        rows.append(state[0])
        ahead = min(k + 1, len(delta) - 1)
        state = integrate_recorded(model, state, torque, np.array([[delta[k], delta[ahead]]]), PERIOD)
        state[0, 0] = speed[ahead]
    vx, vy, r = np.array(rows).T
    return one_run({"vx": vx, "vy": vy, "r": r, "delta": delta}, PERIOD, "made.parquet")


def gentle(seconds: float = 60.0, seed: int = 0, size: float = 0.008) -> np.ndarray:
    """Return steering of a random walk through a filter of 0.4 s: a broad spectrum up to some 2 Hz."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=round(seconds / PERIOD))
    width = round(0.4 / PERIOD)
    smooth = np.convolve(white, np.hanning(2 * width + 1) / width, mode="same")
    return size * smooth / smooth.std()


@pytest.fixture(scope="module")
def weaving() -> Drive:
    t = PERIOD * np.arange(6000)
    return driven(CAR, gentle(), 18.0 + 4.0 * np.sin(2 * np.pi * t / 30.0))


class TestUndersteer:
    def test_the_gradient_of_a_linear_car_is_that_of_its_file(self, weaving):
        """At 0.006 rad the tyres' curves bend by (B alpha)^2/3, below 1 % of the stiffness."""
        found = understeer_of(weaving, CAR)
        assert found.gradient == pytest.approx(CAR.understeer_gradient, rel=0.03)
        assert found.interval[0] < found.gradient < found.interval[1]

    def test_a_wrong_ratio_is_told_from_understeer(self, weaving):
        """A file that says 8 % more steering than there is: the ratio is 1.08, the gradient the same."""
        columns = dict(weaving.columns) | {"delta": 1.08 * weaving["delta"]}
        found = understeer_of(replace(weaving, columns=columns), CAR)
        assert found.ratio == pytest.approx(1.08, abs=0.01)
        assert understeer_of(weaving, CAR).ratio == pytest.approx(1.0, abs=0.01)

    def test_a_wrong_lateral_velocity_drops_out(self, weaving):
        columns = dict(weaving.columns) | {"vy": weaving["vy"] + 0.01 * weaving["vx"]}
        biased = understeer_of(replace(weaving, columns=columns), CAR)
        assert biased.gradient == pytest.approx(understeer_of(weaving, CAR).gradient, rel=0.02)

    def test_a_car_that_slides_where_its_file_calls_it_gentle_has_no_gradient(self):
        """On ice, at a third of the grip of the file: beyond the front tyres' peak steering changes nothing."""
        front, rear = (replace(tire, D=0.33 * tire.D) for tire in (CAR.front_tire, CAR.rear_tire))
        ice = replace(CAR, front_tire=front, rear_tire=replace(rear, B=3.0 * rear.B))
        steer = 0.3 * np.minimum(PERIOD * np.arange(3000) / 20.0, 1.0)
        slides = driven(ice, steer, np.full(3000, 15.0))
        assert np.abs(slides["vx"] * slides["r"]).max() < 4.0
        assert understeer_of(slides, CAR) is None
        assert understeer_of(driven(CAR, 0.1 * steer, np.full(3000, 15.0)), CAR) is not None

    def test_a_straight_says_nothing(self):
        assert understeer_of(driven(CAR, np.zeros(1000), np.full(1000, 20.0)), CAR) is None


def test_the_steering_response_is_that_of_the_linear_single_track():
    """H(s) = C (s I - A)^-1 b at 20 m/s, from the model's own Jacobian; 5 % for Hann windows of 8 s."""
    drive = driven(CAR, gentle(80.0, seed=1), np.full(8000, 20.0))
    found = steering_response(drive)
    model = SingleTrack(CAR)
    at = [np.array([v]) for v in (20.0, 0.0, 0.0, 0.0, 0.0)]
    a = model.velocity_jacobian(*at)[0][1:, 1:]
    small = 1e-5
    up, down = (model.velocity_derivative(20.0, 0.0, 0.0, 0.0, sign * small)[1:] for sign in (1.0, -1.0))
    b = (np.array(up) - np.array(down)).ravel() / (2 * small)
    s = 2j * np.pi * found.frequency
    exact = np.array([np.linalg.solve(one * np.eye(2) - a, b)[1] for one in s])
    slow = found.frequency < 1.5
    np.testing.assert_allclose(found.gain[slow], np.abs(exact)[slow], rtol=0.05)
    np.testing.assert_allclose(found.phase[slow], np.degrees(np.angle(exact))[slow], atol=5.0)
    assert steering_response(drive.select(slice(0, 900))) is None


class TestFreeRun:
    def test_the_model_that_made_a_drive_repeats_it(self, weaving):
        run = free_run(SingleTrack(CAR), weaving, 2.0, recorded_speed=True)
        measured = measured_motion(weaving)
        rows = np.searchsorted(measured["t"], run["t"] - 1e-6)
        # The same equations, steps of 0.05 s between settings of v_x instead of 0.01 s.
        np.testing.assert_allclose(run["r"], measured["r"][rows], atol=2e-3)
        assert np.all(np.diff(run["t"])[np.diff(run.segment) == 0] > 0)

    def test_nothing_is_run_across_a_gap(self, weaving):
        cut = weaving.select((weaving["t"] < 10.0) | (weaving["t"] > 10.5))
        run = free_run(SingleTrack(CAR), cut, 2.0)
        for one in run.segments():
            assert run["t"][one][-1] - run["t"][one][0] == pytest.approx(2.0, abs=1e-6)
        assert free_run(SingleTrack(CAR), cut, 100.0) is None


def test_axle_forces_are_those_that_drove_the_car():
    """A car with front tyres 20 % softer: the measured force is 0.8 of the file's at small angles."""
    soft = CAR.with_effects(EffectSpec("tire_stiffness", {"front_scale": 0.8, "rear_scale": 1.0}))
    drive = driven(soft, gentle(30.0, seed=2), np.full(3000, 20.0))
    forces = axle_forces(drive, CAR)
    turning = np.abs(forces.slip[:, 0]) > 0.002
    ratio = forces.measured[turning, 1] / forces.nominal[turning, 1]
    assert np.median(ratio) == pytest.approx(0.8, abs=0.02)
    rear = forces.measured[:, 2] - forces.nominal[:, 2]
    assert np.sqrt(np.mean(rear**2)) < 0.05 * np.sqrt(np.mean(forces.nominal[:, 2] ** 2))


def test_bins_hold_their_means():
    x = np.array([0.1, 0.2, 0.3, 1.1, 1.2, 5.0])
    centre, mean, spread = binned(x, 2.0 * x, 1.0, fewest=2)
    np.testing.assert_allclose(centre, [0.5, 1.5])
    np.testing.assert_allclose(mean, [0.4, 2.3])
    np.testing.assert_allclose(spread, [np.std([0.2, 0.4, 0.6]), 0.1])


class TestWhiteness:
    def test_white_noise_stays_in_its_band_and_a_moving_average_does_not(self):
        rng = np.random.default_rng(3)
        white = rng.normal(size=5000)
        found, band = autocorrelation(white, np.zeros(5000), 20)
        assert found[0] == pytest.approx(1.0) and np.mean(np.abs(found[1:]) < band) >= 0.9
        # x_k = e_k - e_(k-1), as differences of noisy samples are: -1/2 at lag 1, nothing beyond.
        differences = np.diff(white)
        found, band = autocorrelation(differences, np.zeros(4999), 5)
        assert found[1] == pytest.approx(-0.5, abs=0.03) and np.all(np.abs(found[2:]) < 2 * band)

    def test_no_product_spans_a_change_of_run(self):
        """Runs of two samples: only lag 1 has pairs, half of all neighbours."""
        values = np.array([1.0, 1.0, -1.0, -1.0] * 50)
        found, _ = autocorrelation(values, np.repeat(np.arange(100), 2), 2)
        assert found[1] == pytest.approx(1.0) and found[2] == 0.0
