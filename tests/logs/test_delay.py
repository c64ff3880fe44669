"""Delays: planted ones are recovered to a fraction of a sample, with honest errors; others are refused."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.checking.best_lag import fit_lag
from split_cli.logs.checking.channel_delays import _least_squares, estimate_delays
from tests.logs.planted import UNITS, PlantedDrive, planted_map

NOISE = {"vx": 0.01, "vy": 0.01, "r": 0.002, "yaw": 0.001, "ax": 0.05, "ay": 0.05, "delta": 5e-4, "X": 0.01, "Y": 0.01}
SETTINGS = IngestSettings(estimate_delays=True)


@pytest.fixture(scope="module")
def drive() -> PlantedDrive:
    return PlantedDrive()


def test_delays_of_all_channels_at_once_are_recovered(drive):
    planted = {
        "yaw": 0.12,
        "ax": -0.23,
        "ay": 0.31,
        "delta": 0.083,
        "wheel_speed_fl": 0.057,
        "X": 0.15,
        "Y": 0.15,
        "r": 0.4,
    }
    made = assemble_drive(drive.recording(delays=planted, noise=NOISE), planted_map(), drive.vehicle, SETTINGS)
    found = {e.channel: e for e in made.quality.delays}
    for channel, delay in planted.items():
        estimate = found[channel]
        assert estimate.applied == pytest.approx(delay, abs=max(3.0 * estimate.error, 0.002)), channel
        assert estimate.error < 0.01
    # The drive then holds what was true at its times: v_x, the reference, was on time. Noise is 2 mrad/s.
    for channel, tolerance in (("r", 0.002), ("yaw", 0.002), ("delta", 1e-3), ("ay", 0.03)):
        error = made.drive[channel] - drive.at(channel, made.drive["t"] + made.quality.origin)
        assert np.sqrt(np.mean(error**2)) < 2.0 * max(tolerance, NOISE[channel])


def test_steering_beyond_linear_tyres_is_no_delay(drive):
    """A step at the limit called the steer angle 0.7 s early: there it no more follows the linear single track."""
    t = np.arange(0.0, drive.seconds, 0.01)
    lateral = np.abs(drive.at("vx", t) * drive.at("r", t))
    tires = {axle: getattr(drive.vehicle, axle) for axle in ("front_tire", "rear_tire")}
    slippery = replace(drive.vehicle, **{axle: replace(one, B=3 * one.B, D=one.D / 3) for axle, one in tires.items()})
    limit = 0.4 * slippery.lateral_grip
    assert 0.05 < np.mean(lateral > limit) < 0.5
    early = {"delta": lambda v: np.where(lateral > limit, drive.at("delta", t + 0.3), v)}
    made = assemble_drive(drive.recording(altered=early, noise=NOISE), planted_map(), slippery, SETTINGS)
    (found,) = [e for e in made.quality.delays if e.channel == "delta"]
    assert abs(found.delay) < 0.02  # 0.1 s with the rows beyond it


@pytest.mark.parametrize("delay", [-0.37, 0.004, 0.0333, 0.4])
def test_a_lag_is_found_to_a_fraction_of_a_sample(delay):
    t = np.arange(0.0, 100.0, 0.04)  # 25 Hz, as slow as the slowest of real recordings
    rng = np.random.default_rng(8)

    def signal(at):
        return np.sin(0.9 * at) + 0.4 * np.sin(2.3 * at + 1.0)

    late = signal(t - delay) + 0.02 * rng.standard_normal(len(t))
    fit = fit_lag(late, [signal(t)], np.ones(len(t), bool), 0.04, [slice(0, len(t))])
    assert fit.refusal == ""
    assert fit.lag == pytest.approx(delay, abs=max(4.0 * fit.error, 0.001)) and fit.error < 0.002


def test_scale_offset_and_sign_do_not_matter_to_the_lag():
    t = np.arange(0.0, 100.0, 0.02)
    signal = np.sin(0.9 * t) + 0.4 * np.sin(2.3 * t)
    late = -57.0 * (np.sin(0.9 * (t - 0.2)) + 0.4 * np.sin(2.3 * (t - 0.2))) + 3.0
    assert fit_lag(late, [signal], np.ones(len(t), bool), 0.02, [slice(0, len(t))]).lag == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda t, rng: (rng.standard_normal(len(t)), np.sin(t)), "explains only"),
        (lambda t, rng: (np.sin(2 * np.pi * t), np.sin(2 * np.pi * t)), "fit equally well|end of the search"),
        (
            lambda t, rng: (np.sin(0.5 * (t - 3.0)) + np.sin(0.31 * (t - 3)), np.sin(0.5 * t) + np.sin(0.31 * t)),
            r"beyond the 1.5 s that are searched, at \+3.00",
        ),
    ],
    ids=["unrelated", "periodic", "out of reach"],
)
def test_what_cannot_be_told_is_refused(make, reason):
    t = np.arange(0.0, 200.0, 0.02)
    late, early = make(t, np.random.default_rng(0))
    fit = fit_lag(late, [early], np.ones(len(t), bool), 0.02, [slice(0, len(t))])
    assert re.search(reason, fit.refusal)


def test_a_short_or_still_drive_is_refused(drive):
    t = np.arange(0.0, 4.0, 0.02)
    assert "too little" in fit_lag(t, [t], np.ones(len(t), bool), 0.02, [slice(0, len(t))]).refusal


def test_no_delay_is_found_where_there_is_none_and_nothing_is_moved(drive):
    plain = assemble_drive(drive.recording(noise=NOISE), planted_map(), drive.vehicle)
    made = assemble_drive(drive.recording(noise=NOISE), planted_map(), drive.vehicle, SETTINGS)
    assert all(abs(e.delay) <= max(3.5 * e.error, 0.002) for e in made.quality.delays)
    moved = [e.channel for e in made.quality.delays if e.applied]
    # Two errors are exceeded by chance once in twenty; ten channels may have one such.
    assert len(moved) <= 2
    for channel in set(UNITS) - set(moved):
        np.testing.assert_array_equal(plain.drive[channel][:1000], made.drive[channel][:1000])


def test_a_command_is_never_moved_and_the_reason_is_told(drive):
    made = assemble_drive(
        drive.recording(delays={"delta": -0.2}, noise=NOISE),
        planted_map(delta={"kind": "command", "resample": "continuous"}),
        drive.vehicle,
        SETTINGS,
    )
    (estimate,) = (e for e in made.quality.delays if e.channel == "delta")
    assert estimate.applied == 0.0 and "stays in the drive" in estimate.statement
    assert "follows it by 0.200" in estimate.statement


def test_a_delay_the_user_gives_is_taken_and_not_estimated_again(drive):
    settings = IngestSettings(estimate_delays=True, delays={"r": 0.25})
    made = assemble_drive(drive.recording(delays={"r": 0.25}, noise=NOISE), planted_map(), drive.vehicle, settings)
    assert "r" not in {e.channel for e in made.quality.delays}
    error = made.drive["r"] - drive.at("r", made.drive["t"] + made.quality.origin)
    assert np.std(error) < 2.0 * NOISE["r"]


def test_yaw_is_timed_by_the_path_where_no_yaw_rate_tells_it(drive):
    t = np.arange(0.0, 100.0, 0.04)
    rng = np.random.default_rng(5)
    late = {"vx": 0.0, "vy": 0.0, "yaw": 0.13, "X": 0.1, "Y": 0.1}
    columns = {name: drive.at(name, t - late[name]) + NOISE[name] * rng.standard_normal(len(t)) for name in late}
    columns["r"] = 0.1 * rng.standard_normal(len(t))
    found = {
        e.channel: e for e in estimate_delays(columns, 0.04, [slice(0, len(t))], None, {name: name for name in columns})
    }
    for name in ("yaw", "X"):
        assert found[name].delay == pytest.approx(late[name], abs=max(3.0 * found[name].error, 0.002))
    assert found["yaw"].error < 0.01 and "r" not in found


def test_what_contradicts_itself_leaves_an_identity_that_nothing_else_speaks_of_its_error():
    """Birge's ratio: a loop of three that is open by 0.1 s at errors of 0.01 s widens its own three alone."""
    lags = {("yaw", "r"): 0.1, ("X", "r"): 0.0, ("X", "yaw"): 0.0, ("X", "vx"): 0.2}
    edges = [
        (SimpleNamespace(late=late, early=early), SimpleNamespace(lag=lag, error=0.01))
        for (late, early), lag in lags.items()
    ]
    groups = {name: name for name in ("yaw", "r", "X", "vx")}
    delays, errors = _least_squares(edges, groups, ["r", "yaw", "X"])
    assert delays["X"] == pytest.approx(0.2) and errors["X"] == pytest.approx(0.01)
    # Two ways lead from X to yaw, of one identity and of two: 1/(1 + 1/2) of a variance, times chi squared.
    widened = (0.1 / np.sqrt(3.0)) ** 2 / (1.0 + 1.0 / 2.0)
    assert errors["yaw"] == pytest.approx(np.hypot(0.01, np.sqrt(widened)))


def test_without_a_vehicle_the_steer_angle_is_not_guessed(drive):
    made = assemble_drive(drive.recording(noise=NOISE), planted_map(), None, SETTINGS)
    (estimate,) = (e for e in made.quality.delays if e.channel == "delta")
    assert estimate.refusal == "that takes the vehicle"


def test_sensors_off_the_cg_do_not_pass_for_delays(drive):
    """A position 2 m behind the CG turns 2 m/v_x later than it: 0.14 s that are geometry."""
    recording = drive.recording(noise=NOISE)
    x, y = recording.signals["X"], recording.signals["Y"]
    yaw = drive.at("yaw", x.time)
    recording.signals["X"] = replace(x, values=x.values - 2.0 * np.cos(yaw))
    recording.signals["Y"] = replace(y, values=y.values - 2.0 * np.sin(yaw))
    place = {"position": {"x": -2.0, "y": 0.0}}
    made = assemble_drive(recording, planted_map(X=place, Y=place), drive.vehicle, SETTINGS)
    assert all(abs(e.applied) < 0.005 for e in made.quality.delays)
    np.testing.assert_allclose(made.drive["X"], drive.at("X", made.drive["t"] + made.quality.origin), atol=0.1)
