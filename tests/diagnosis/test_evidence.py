"""Which rows of a recording are compared at all."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.evidence import gather_evidence, rolling
from split_cli.diagnosis.recording.series import extended_model
from split_cli.diagnosis.remainder.spectrum import strongest_line
from split_cli.diagnosis.search.identifiable import what_was_not_excited
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import bare_objective, light_evidence, noisy, prepared
from tests.factories import road_car
from tests.term_examples import EXAMPLES

FIRST, LAST = 1200, 1300


def asked_for(drive, share, window: slice = slice(FIRST, LAST)):
    """Return a drive whose torque asks the rear axle for shares of its peak for a second, at 100 Hz."""
    car = road_car()
    force = share * car.rear_tire.D + car.rolling_resistance_rear
    torque = drive["T"].copy()
    torque[window] = force * car.wheel_radius / (1.0 - car.drive_split_front)
    return replace(drive, columns={**drive.columns, "T": torque})


@pytest.fixture(scope="module")
def spinning(noisy_nominal):
    return prepared(asked_for(noisy_nominal, 0.95))


@pytest.fixture(scope="module")
def noisy_nominal(nominal_drive):
    return noisy(nominal_drive, 1)


def test_wheels_roll_below_nine_tenths_of_an_axles_peak(noisy_nominal):
    car = road_car()
    assert rolling(prepared(asked_for(noisy_nominal, 0.88)), car).all()
    slipping = ~rolling(prepared(asked_for(noisy_nominal, 0.95)), car)
    # And a fifth of a second before and after; over its last sample the torque falls back in a line.
    np.testing.assert_array_equal(np.flatnonzero(slipping), np.arange(FIRST - 20, LAST + 19))


def test_braking_counts_as_driving_does(noisy_nominal):
    assert not rolling(prepared(asked_for(noisy_nominal, -1.5)), road_car())[FIRST:LAST].any()


def test_a_car_that_gets_more_than_it_asks_for_rolls(noisy_nominal):
    """Downforce or load gives an axle more than its file says; a spinning wheel never does."""
    asked = asked_for(asked_for(noisy_nominal, 0.85, slice(FIRST - 40, LAST + 40)), 0.95)
    force = 0.95 * road_car().rear_tire.D / (1.0 - road_car().drive_split_front)
    faster, begin, end = asked["vx"].copy(), FIRST - 40, LAST + 40
    faster[begin:end] = asked["vx"][begin] + 1.4 * force / road_car().mass * 0.01 * np.arange(end - begin)
    faster[end:] += faster[end - 1] - asked["vx"][end - 1]
    assert not rolling(prepared(asked), road_car()).all()
    assert rolling(prepared(replace(asked, columns={**asked.columns, "vx": faster})), road_car()).all()


def swinging(drive, least: float, most: float, hertz: float):
    """Return a drive whose torque swings between shares of the rear axle's peak, and a car that gets it all."""
    car, t = road_car(), 0.01 * np.arange(LAST - FIRST)
    shares = 0.5 * (most + least) + 0.5 * (most - least) * np.sin(2.0 * np.pi * hertz * t)
    asked = asked_for(drive, shares)
    faster = asked["vx"].copy()
    force = shares * car.rear_tire.D / (1.0 - car.drive_split_front)
    faster[FIRST:LAST] = asked["vx"][FIRST] + np.cumsum(force / car.mass * 0.01)
    faster[LAST:] += faster[LAST - 1] - asked["vx"][LAST - 1]
    return replace(asked, columns={**asked.columns, "vx": faster})


def test_wheels_do_not_roll_under_a_slip_control(noisy_nominal):
    """Eight times a second up to the limit and back; not far below it, nor so slowly that a driver may do it."""
    middle = slice(FIRST + 10, LAST - 10)
    assert not rolling(prepared(swinging(noisy_nominal, 0.2, 1.0, 8.0)), road_car())[middle].any()
    assert rolling(prepared(swinging(noisy_nominal, 0.0, 0.8, 8.0)), road_car()).all()
    assert rolling(prepared(swinging(noisy_nominal, 0.2, 1.0, 1.0)), road_car()).all()


def test_a_car_that_asks_for_more_nearly_always_has_other_tyres(noisy_nominal):
    always = slice(0, int(0.8 * len(noisy_nominal)))
    assert rolling(prepared(asked_for(noisy_nominal, 0.95, always)), road_car()).all()


def test_rows_with_spinning_wheels_are_not_compared(spinning, gathered, discrepancy):
    one = gather_evidence(road_car(), spinning, discrepancy)
    outside = (one.at < FIRST - 25) | (one.at >= LAST + 25)
    inside = (one.at >= FIRST - 20) & (one.at < LAST + 20)
    assert (one.weight[outside] > 0.0).all() and not one.weight[inside].any()
    # Nor do they say how much shakes the car: what was asked for and never arrived is many times its noise.
    np.testing.assert_allclose(one.disturbance, gathered.disturbance, rtol=3.0)
    assert np.abs(one.nominal_rows[inside, 0]).mean() > 10.0
    # What follows has forgotten it.
    compared = one.nominal_rows[one.weight > 0.0]
    assert np.abs(compared).max() < 6.0


def test_lines_are_not_sought_where_wheels_spin(noisy_nominal):
    """A driver plays with both pedals for half a minute, ten times a second, and the wheels do not follow."""
    window = slice(2500, 5500)
    torque = noisy_nominal["T"].copy()
    size = asked_for(noisy_nominal, 1.1)["T"][FIRST]
    torque[window] = size * np.sin(2.0 * np.pi * 10.0 * 0.01 * np.arange(3000))
    playing = light_evidence(prepared(replace(noisy_nominal, columns={**noisy_nominal.columns, "T": torque})))
    assert strongest_line(bare_objective(playing), ()) is None
    everything = replace(playing, rolls=np.ones_like(playing.rolls))
    assert strongest_line(bare_objective(everything), ()).channel == "v_x"


def test_how_much_is_not_compared_is_said(spinning, discrepancy):
    one = light_evidence(spinning)
    assert 0.0 < 1.0 - one.rolls.mean() < 0.02
    assert not [text for text in what_was_not_excited([one], road_car()) if "spin or lock" in text]
    longer = asked_for(spinning.drive, 0.95, slice(FIRST, FIRST + 500))
    (text,) = (
        text for text in what_was_not_excited([light_evidence(prepared(longer))], road_car()) if "spin or lock" in text
    )
    assert text.startswith(f"{100 * 540 / len(spinning):.0f} % of the real drive")


def test_what_commands_become_is_kept_for_other_terms(noisy_nominal):
    """Beside a lag and a gain, every term gives the rates of one evaluation of all stages."""
    series = prepared(noisy_nominal)
    acting = ("steer_lag", {"tau": 0.1}), ("drive_gain", EXAMPLES["drive_gain", ""])
    before = [CATALOGUE[name](values) for name, values in acting]
    for (name, variant), values in EXAMPLES.items():
        model = extended_model(road_car(), [*before, CATALOGUE[name](values, variant)])
        bare = series.flow(extended_model(road_car()))
        whole = model.flow(
            bare.vx,
            bare.vy,
            bare.r,
            series.torque,
            series.steer_angle,
            yaw=series.yaw,
            t=series.t,
            s=series.s,
            recording=series.recording,
            bare=bare,
        )
        for _ in range(2):
            for row, expected in zip(series.rate_rows(model), model.balance(whole), strict=True):
                np.testing.assert_allclose(row, expected, rtol=0.0, atol=1e-11, err_msg=name)
