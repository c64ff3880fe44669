"""Drivers stay on the road, use the grip they are given, differ and repeat; scripts are carried out."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import SplitError
from split_cli.plant.cars import CARS, F1TENTH_CAR, FORMULA_CAR, ROAD_CAR
from split_cli.plant.drivers import DRIVER_STYLES, find_driver, grip_of, speed_profile
from split_cli.plant.dynamics import advance
from split_cli.plant.maneuvers import build_maneuver, run_maneuver
from split_cli.plant.road import Road
from split_cli.plant.simulation import CONTROL_PERIOD, STEP, Script, drive_laps, drive_script, initial_state
from split_cli.plant.tracks import find_track

HOME = {"road_car": "small", "f1tenth_car": "f1tenth", "formula_car": "small"}


@pytest.mark.parametrize("style", DRIVER_STYLES)
@pytest.mark.parametrize("car", CARS.values(), ids=CARS)
def test_nobody_spins_or_leaves_the_track_at_nine_tenths_of_the_grip(car, style):
    # A run that spins or leaves raises; three people each, unlike in line, pace, pedals and preview.
    track = find_track(HOME[car.name])
    for seed in range(20, 23):
        run = drive_laps(car, track, find_driver(style), aggressiveness=0.9, seed=seed)
        assert run.s[-1] == pytest.approx(track.length, abs=2.0)
        assert np.abs(run.channel("ay")).max() > 0.75 * grip_of(car).lateral  # and they do drive hard


def test_the_grip_in_use_follows_the_aggressiveness():
    track = find_track("handling")
    for share in (0.3, 0.5, 0.7):
        run = drive_laps(ROAD_CAR, track, DRIVER_STYLES["smooth"], aggressiveness=share, seed=1)
        used = np.quantile(np.abs(run.channel("ay")), 0.98) / grip_of(ROAD_CAR).lateral
        # Pace wanders by some per cent, lateral acceleration by twice as much, and lines are cut or widened.
        assert used == pytest.approx(share, rel=0.15)


def test_same_seed_same_drive_and_another_seed_another():
    track = find_track("f1tenth")
    first, again, other = (
        drive_laps(F1TENTH_CAR, track, DRIVER_STYLES["brisk"], aggressiveness=0.6, seed=seed) for seed in (4, 4, 5)
    )
    np.testing.assert_array_equal(first.states, again.states)
    shortest = min(len(first.t), len(other.t))
    assert np.std(first.states[:shortest, 3] - other.states[:shortest, 3]) > 0.05


def test_styles_brake_into_corners_or_before_them():
    track = find_track("handling")
    overlap = {}
    for name in ("novice", "racer"):
        run = drive_laps(ROAD_CAR, track, DRIVER_STYLES[name], aggressiveness=0.7, seed=2)
        braking = run.channel("ax") < -2.0
        overlap[name] = np.mean(np.abs(run.channel("ay"))[braking] > 3.0)
    # Trail braking: the racer spends much of the braking in the corner, the novice little.
    assert overlap["racer"] > 1.5 * overlap["novice"]
    assert overlap["racer"] > 0.3


@pytest.mark.parametrize("car", CARS.values(), ids=CARS)
def test_the_steer_a_driver_adds_is_the_understeer_gradient_by_hand(car):
    # d(alpha_f - alpha_r)/da_y at rest is m/L (l_r/C_f - l_f/C_r), C from each tyre's stated cornering stiffness.
    def stiffness(tire, axle_load):
        share = 0.5 * axle_load / tire.nominal_load
        return 2.0 * tire.p_ky1 * tire.nominal_load * np.sin(2.0 * np.arctan(share / tire.p_ky2))

    front = car.cg_to_rear_axle / stiffness(car.front_tire, car.static_load_front)
    rear = car.cg_to_front_axle / stiffness(car.rear_tire, car.static_load_rear)
    grip = grip_of(car)
    slope = grip.slip_difference[2] / (2 * grip.lateral_spacing)
    # The difference of two nearly equal angles, read from a table of 2.5 mrad steps at 0.04 g: 2 % of the larger.
    assert slope == pytest.approx(
        car.mass / car.wheelbase * (front - rear), abs=0.02 * car.mass / car.wheelbase * front
    )


def test_the_speed_profile_obeys_the_friction_ellipse():
    track, grip = find_track("handling"), grip_of(ROAD_CAR)
    profile = speed_profile(ROAD_CAR, track, DRIVER_STYLES["racer"], 0.8, grip)
    along = profile.acceleration / (0.8 * np.where(profile.acceleration > 0, grip.driving, grip.braking))
    across = profile.speed**2 * np.abs(track.curvature) / (0.8 * grip.lateral)
    # Curvature and speed are smoothed after the limit was applied: some per cent.
    assert np.hypot(along, across).max() < 1.10
    assert np.quantile(np.hypot(along, across), 0.8) > 0.85


def test_a_script_is_what_an_outside_controller_would_get_from_stepping():
    clock = np.arange(50) * CONTROL_PERIOD
    torque, steer = 400.0 * np.sin(3 * clock), 0.03 * np.sin(5 * clock)
    car = replace(ROAD_CAR, toe_front=0.0, toe_rear=0.0)
    run = drive_script(
        car, Script(torque, steer, np.full(50, np.nan)), DRIVER_STYLES["smooth"], speed=20.0, sample_period=STEP
    )
    state = initial_state(car, 20.0)
    for k in range(49):
        state, _ = advance(car, state, torque[k], steer[k], CONTROL_PERIOD, step=STEP)
    at = int(round(49 * CONTROL_PERIOD / STEP))
    np.testing.assert_allclose(run.states[at], state, rtol=1e-10, atol=1e-12)


def test_actuators_delay_scale_and_play():
    clock = np.arange(100) * CONTROL_PERIOD
    steer = 0.02 * np.sin(4 * clock)
    still = np.zeros(100)

    def road_wheels(**changes):
        car = replace(ROAD_CAR, steer_lag=1e-3, steer_rate=50.0, **changes)
        script = Script(still, steer, np.full(100, np.nan))
        run = drive_script(car, script, DRIVER_STYLES["smooth"], speed=20.0, sample_period=STEP)
        return run.t, run.channel("delta_actual")

    t, plain = road_wheels()
    _, late = road_wheels(steer_delay=0.1)
    np.testing.assert_allclose(late[100:], plain[:-100], atol=1e-12)
    _, scaled = road_wheels(steer_gain=0.9, steer_offset=0.005)
    np.testing.assert_allclose(scaled, 0.9 * plain + 0.005, atol=1e-6)
    _, played = road_wheels(steer_backlash=0.006)
    # Half the play is lost at either end of the swing.
    after = t > 0.5
    assert played[after].max() == pytest.approx(plain[after].max() - 0.003, abs=1e-5)
    assert played[after].min() == pytest.approx(plain[after].min() + 0.003, abs=1e-5)


def test_the_road_acts_where_and_when_it_says():
    maneuver = build_maneuver("coast_down", ROAD_CAR)
    level = run_maneuver(ROAD_CAR, maneuver)
    hill = run_maneuver(ROAD_CAR, maneuver, road=Road(spacing=10.0, grade=np.r_[np.zeros(50), np.full(400, 0.02)]))
    start = int(np.searchsorted(hill.s, 490.0))
    np.testing.assert_array_equal(level.states[:start], hill.states[:start])
    later = int(np.searchsorted(hill.s, 600.0))
    # Gravity's 0.02 g against the level road's deceleration at the same speed.
    slope = np.interp(
        hill.channel("vx")[later], level.channel("vx")[::-1], np.gradient(level.channel("vx"), level.t)[::-1]
    )
    decel = np.gradient(hill.channel("vx"), hill.t)[later]
    effective = ROAD_CAR.mass / ROAD_CAR.effective_mass
    assert decel - slope == pytest.approx(-9.80665 * np.sin(0.02) * effective, rel=5e-3)


def test_constant_radius_holds_the_circle_while_speed_rises():
    maneuver = build_maneuver("constant_radius", FORMULA_CAR, 0.5)
    run = run_maneuver(FORMULA_CAR, maneuver)
    radius = 1.0 / maneuver.track.curvature[0]
    off = np.hypot(run.channel("X"), run.channel("Y") - radius) - radius
    settled = run.t > 3.0
    assert np.abs(off[settled]).max() < 0.02 * radius
    ay = run.channel("ay")
    # Lateral acceleration rises evenly by design: a straight line in time.
    fit = np.polyfit(run.t[settled], ay[settled], 1)
    assert np.std(ay[settled] - np.polyval(fit, run.t[settled])) < 0.1 * np.ptp(ay[settled])


@pytest.mark.parametrize(
    ("change", "words"),
    [({"aggressiveness": 0.0}, "aggressiveness"), ({"laps": -1.0}, "laps"), ({"duration": 0.0}, "duration")],
)
def test_settings_without_sense_are_refused(change, words):
    with pytest.raises(SplitError, match=words):
        drive_laps(ROAD_CAR, find_track("small"), DRIVER_STYLES["brisk"], **change)


def test_a_large_car_on_a_tiny_track_is_refused():
    with pytest.raises(SplitError, match="crawl|left the track|spun"):
        drive_laps(ROAD_CAR, find_track("f1tenth"), DRIVER_STYLES["brisk"])
