"""What was planted in the sensors is found again in their readings."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import SplitError
from split_cli.plant.cars import ROAD_CAR
from split_cli.plant.drivers import DRIVER_STYLES
from split_cli.plant.maneuvers import build_maneuver, run_maneuver
from split_cli.plant.sensors import ChannelSpec, SensorSpec, measure, perfect, sensors_of
from split_cli.plant.simulation import drive_laps
from split_cli.plant.tracks import find_track


@pytest.fixture(scope="module")
def lap():
    return drive_laps(ROAD_CAR, find_track("small"), DRIVER_STYLES["brisk"], seed=8)


def truth_at(run, channel, t):
    return np.interp(t, run.t, run.channel(channel))


def one(run, seed=0, **changes):
    spec = SensorSpec("device", 100.0, {"vx": ChannelSpec(), "vy": ChannelSpec(), "r": ChannelSpec()})
    return measure(run, (replace(spec, **changes),), seed)[0]


def test_noise_has_the_stated_size_and_no_memory(lap):
    channels = {"vx": ChannelSpec(noise=0.05), "r": ChannelSpec(noise=0.01)}
    reading = one(lap, channels=channels)
    for name, spec in channels.items():
        noise = reading.values[name] - truth_at(lap, name, reading.stamp)
        count = len(noise)
        # From N samples a deviation is off by sigma/sqrt(2 N), an autocorrelation by 1/sqrt(N): four of each.
        assert noise.std() == pytest.approx(spec.noise, rel=4 / np.sqrt(2 * count))
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4 / np.sqrt(count)
        assert abs(noise.mean()) < 4 * spec.noise / np.sqrt(count)
    noises = [reading.values[name] - truth_at(lap, name, reading.stamp) for name in channels]
    assert abs(np.corrcoef(*noises)[0, 1]) < 4 / np.sqrt(count)


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.12])
def test_a_delay_is_recovered_from_the_reading(lap, delay):
    reading = one(lap, channels={"r": ChannelSpec(noise=0.002, delay=delay)})
    inside = (reading.stamp > 0.5) & (reading.stamp < lap.t[-1] - 0.5)
    trials = np.arange(-0.05, 0.2, 0.001)
    costs = [np.mean((reading.values["r"] - truth_at(lap, "r", reading.stamp - d))[inside] ** 2) for d in trials]
    # Least squares over some thousand samples of a yaw rate with slopes near 1 rad/s^2: sigma 0.002/sqrt(3000) s.
    assert trials[int(np.argmin(costs))] == pytest.approx(delay, abs=0.0015)


def test_a_bias_is_constant_in_a_recording_and_has_the_stated_spread(lap):
    found = []
    for seed in range(60):
        reading = one(lap, seed=seed, channels={"r": ChannelSpec(bias=0.02)})
        error = reading.values["r"] - truth_at(lap, "r", reading.stamp)
        assert np.ptp(error) < 1e-12
        found.append(error[0])
    assert np.std(found) == pytest.approx(0.02, rel=4 / np.sqrt(2 * 60))


def test_values_come_in_steps_of_the_resolution(lap):
    reading = one(lap, channels={"vx": ChannelSpec(noise=0.1, resolution=0.25)})
    np.testing.assert_allclose(reading.values["vx"] / 0.25, np.round(reading.values["vx"] / 0.25), atol=1e-12)
    error = reading.values["vx"] - truth_at(lap, "vx", reading.stamp)
    # Rounding adds the variance of a uniform error, step^2/12.
    assert error.std() == pytest.approx(np.hypot(0.1, 0.25 / np.sqrt(12)), rel=0.05)


def test_a_device_off_the_centre_and_turned_reports_rigid_body_motion(lap):
    reading = one(lap, position_x=-1.2, position_y=0.3, turned=0.02)
    vx, vy, r = (truth_at(lap, name, reading.stamp) for name in ("vx", "vy", "r"))
    there_x, there_y = vx - 0.3 * r, vy - 1.2 * r
    np.testing.assert_allclose(reading.values["vx"], np.cos(0.02) * there_x + np.sin(0.02) * there_y, atol=1e-12)
    np.testing.assert_allclose(reading.values["vy"], np.cos(0.02) * there_y - np.sin(0.02) * there_x, atol=1e-12)


def test_clocks_keep_their_rate_and_transport_only_delays(lap):
    for reading in measure(lap, sensors_of("road_car"), 3):
        step = np.diff(reading.stamp)
        assert np.mean(step) == pytest.approx(1 / reading.sensor.rate, rel=1e-3)
        assert np.std(step) == pytest.approx(np.sqrt(2) * reading.sensor.clock_jitter, rel=0.1, abs=1e-9)
        excess = reading.arrival - reading.stamp - reading.sensor.latency
        assert excess.min() >= -1e-12
        # An exponential's mean from N samples is off by mean/sqrt(N).
        assert np.mean(excess) == pytest.approx(reading.sensor.latency_jitter, rel=5 / np.sqrt(len(excess)))


def test_commands_are_stamped_when_they_take_effect(lap):
    command = next(r for r in measure(lap, sensors_of("road_car"), 3) if r.sensor.name == "command")
    np.testing.assert_array_equal(command.stamp, lap.command_t[: len(command.stamp)])
    np.testing.assert_allclose(command.values["T"], lap.torque_command[: len(command.stamp)], atol=0.005 + 1e-9)


def test_perfect_instruments_report_the_truth(lap):
    for reading in measure(lap, perfect(sensors_of("road_car")), 3):
        for name, values in reading.values.items():
            if name not in ("T", "delta"):
                np.testing.assert_allclose(values, truth_at(lap, name, reading.stamp), atol=1e-12)


def test_another_device_does_not_change_the_noise_of_the_first(lap):
    sensors = sensors_of("road_car")
    alone = measure(lap, sensors[:1], 9)[0]
    together = measure(lap, sensors, 9)[0]
    np.testing.assert_array_equal(alone.values["vx"], together.values["vx"])


def test_a_run_too_short_for_a_device_is_refused():
    maneuver = build_maneuver("coast_down", ROAD_CAR)
    brief = replace(maneuver.script, **{n: getattr(maneuver.script, n)[:3] for n in ("torque", "steer", "speed")})
    run = run_maneuver(ROAD_CAR, replace(maneuver, script=brief))
    with pytest.raises(SplitError, match="too short"):
        measure(run, (SensorSpec("slow", 2.0, {"vx": ChannelSpec()}),))
