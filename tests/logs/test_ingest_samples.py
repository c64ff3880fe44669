"""Logs of the project's own plant, ingested and held to the truth they were measured from."""

from pathlib import Path

import numpy as np
import pytest

from split_cli.logs.drive import Drive, read_drive
from split_cli.workflows.ingesting.ingest import IngestResult, IngestSettings, ingest_logs
from split_cli.workflows.simulate import SimulateSettings, simulate_log

# Of the model car's instruments (split_cli/plant/sensors.py): white noise and resolution/sqrt(12).
NOISE = {"X": 0.004, "Y": 0.004, "yaw": 0.003, "vx": 0.012, "vy": 0.008, "r": 0.006, "ax": 0.08, "ay": 0.08}


@pytest.fixture(scope="module")
def lap(tmp_path_factory, sample_logs) -> tuple[IngestResult, Drive, Drive]:
    """A lap of the model car: what ingest says, the drive, and the truth."""
    folder = tmp_path_factory.mktemp("lap")
    settings = SimulateSettings(car="f1tenth_car", track="f1tenth", laps=1.0, aggressiveness=0.8, seed=4)
    simulate_log(settings, folder / "lap.mcap", truth=folder / "truth.parquet")
    results, _, _ = ingest_logs(
        [folder / "lap.mcap"],
        folder / "lap.parquet",
        vehicle_path=sample_logs / "f1tenth_car.yaml",  # and no map: what the project writes needs none
        settings=IngestSettings(estimate_delays=True),
    )
    return results[0], read_drive(folder / "lap.parquet"), read_drive(folder / "truth.parquet")


def times(result: IngestResult, drive: Drive) -> np.ndarray:
    """Return the drive's times on the run's own clock [s]; stamps start at a whole number of seconds of 1970."""
    return drive["t"] + result.quality.origin % 1_000.0


@pytest.mark.parametrize("channel", sorted(NOISE))
def test_each_channel_differs_from_the_truth_by_its_sensor_noise(lap, channel):
    result, drive, truth = lap
    expected = np.interp(times(result, drive), truth["t"], truth[channel])
    error = drive[channel] - expected
    error = error - np.mean(error)  # inertial channels have a constant bias of their own
    # Interpolation between jittered samples averages a little noise away; linear truth adds 1e-4 of it.
    assert 0.7 * NOISE[channel] < np.std(error) < 1.15 * NOISE[channel]


@pytest.mark.parametrize("channel", ["vx", "vy", "r", "yaw"])
def test_the_noise_estimate_is_the_noise(lap, channel):
    result, drive, truth = lap
    estimate = drive.metadata.noise_of(channel)
    # 1,280 samples: the median of third differences is good to 8 %.
    assert estimate.sigma_raw == pytest.approx(NOISE[channel], rel=0.15)
    expected = np.interp(times(result, drive), truth["t"], truth[channel])
    assert estimate.sigma == pytest.approx(np.std(drive[channel] - expected), rel=0.2)


def test_commands_are_held_as_they_were_sent(lap):
    result, drive, truth = lap
    assert drive.metadata.kinds["T"] == drive.metadata.kinds["delta"] == "command"
    assert all(c.resampling == "held" for c in result.quality.channels if c.channel in ("T", "delta"))
    # A row is the mean of what is commanded until the next, which linear interpolation of held truth is as well.
    sent = np.interp(times(result, drive), truth["t"], truth["delta"])
    np.testing.assert_allclose(drive["delta"], sent, atol=1e-4)


def test_a_sound_log_has_no_findings_and_no_delays(lap):
    result, _, _ = lap
    assert [f.text for f in result.quality.consistency.findings] == []
    assert [e.statement for e in result.quality.delays if e.applied] == []
    (steer,) = (e for e in result.quality.delays if e.channel == "delta")
    # The actuator of that car: a lag of 30 ms behind its command; it stays in the drive.
    assert "command" in steer.refusal and "follows it" in steer.refusal


@pytest.mark.parametrize(
    ("log", "vehicle", "preset"),
    [
        ("road_handling_moderate.mcap", "road_car.yaml", "split_sim"),
        ("road_handling_aggressive.mcap", "road_car.yaml", "split_sim"),
        ("f1tenth_laps.mcap", "f1tenth_car.yaml", "split_sim"),
        ("road_small_workshop.csv", "road_car.yaml", "split_sim_table"),
        ("road_car_tests.parquet", "road_car.yaml", "split_sim_table"),
    ],
)
def test_every_bundled_log_becomes_a_drive_without_findings(tmp_path, sample_logs, log, vehicle, preset):
    results, _, _ = ingest_logs(
        [sample_logs / log], tmp_path / "drive.parquet", maps=[preset], vehicle_path=sample_logs / vehicle
    )
    made = read_drive(Path(results[0].drive_path))
    assert made.rate == pytest.approx(100.0)
    assert [f.text for f in results[0].quality.consistency.findings] == []
    recorded = {"road_car_tests.parquet": 7}.get(log, 1)
    assert results[0].quality.segments == recorded


def test_log_time_instead_of_header_time_makes_channels_late_and_the_estimate_sees_it(tmp_path, sample_logs):
    """Latency is 1 to 4 ms by design of the sensors, with jitter; position comes 30 ms late."""
    results, _, _ = ingest_logs(
        [sample_logs / "f1tenth_laps.mcap"],
        tmp_path / "drive.parquet",
        maps=["split_sim"],
        vehicle_path=sample_logs / "f1tenth_car.yaml",
        settings=IngestSettings(clock="log", estimate_delays=True),
    )
    assert results[0].quality.clock == "log time of the messages"
    found = {e.channel: e for e in results[0].quality.delays}
    # The odometry arrives 5 ms after its stamp on average, the IMU 1.5 ms: the IMU looks 3.5 ms early.
    assert found["ax"].delay == pytest.approx(-0.0035, abs=max(0.001, 3.0 * found["ax"].error))


@pytest.mark.parametrize("seed", [3, 5])
def test_a_small_car_whose_tyre_curve_bends_has_its_v_y_at_the_cg(tmp_path, sample_logs, seed):
    """Forces by slip speed left 0.45 of what a straight tyre curve did, and ingest said `position: front_axle`."""
    settings = SimulateSettings(
        car="f1tenth_car", track="f1tenth", driver="racer", aggressiveness=0.6, laps=1.0, seed=seed
    )
    simulate_log(settings, tmp_path / "lap.mcap")
    car = sample_logs / "f1tenth_car.yaml"
    results, _, _ = ingest_logs([tmp_path / "lap.mcap"], tmp_path / "lap.parquet", vehicle_path=car)
    assert not results[0].quality.consistency.findings
