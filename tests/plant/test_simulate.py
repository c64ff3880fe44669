"""`split simulate`: what it writes is what was driven, and settings at fault are told in a line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.simulate import command
from split_cli.errors import SplitError
from split_cli.logs.drive import read_drive
from split_cli.plant.cars import F1TENTH_CAR
from split_cli.plant.maneuvers import CALIBRATION_TESTS
from split_cli.plant.sensors import sensors_of
from split_cli.workflows.simulate import SimulateSettings, simulate_log

QUICK = SimulateSettings(car="f1tenth_car", track="f1tenth", laps=0.5, seed=3)


def test_a_log_lies_within_noise_of_the_truth_beside_it(tmp_path):
    result = simulate_log(QUICK, tmp_path / "log.parquet", truth=tmp_path / "truth.parquet")
    log, truth = read_drive(tmp_path / "log.parquet"), read_drive(tmp_path / "truth.parquet")
    assert len(log) == len(truth)
    state = sensors_of("f1tenth_car")[0].channels
    for name, spec in state.items():
        error = log[name] - truth[name]
        assert error.std() == pytest.approx(
            np.hypot(spec.noise, spec.resolution / 12**0.5), rel=4 / np.sqrt(2 * len(log))
        )
    np.testing.assert_allclose(log["T"], truth["T"], atol=0.6e-4)  # commands are the commands, rounded
    # A rim moves with its hub, v_x - y r, but for some per cent of slip.
    hub = truth["vx"] - 0.5 * F1TENTH_CAR.track_rear * truth["r"]
    assert np.abs(truth["wheel_speed_rl"] - hub).max() < 0.05 * truth["vx"].max()
    assert result.distance == pytest.approx(26.0, abs=0.3)
    assert result.top_speed == pytest.approx(truth["vx"].max(), rel=1e-3)


def test_perfect_instruments_give_the_truth(tmp_path):
    simulate_log(replace(QUICK, instruments="perfect"), tmp_path / "log.parquet", truth=tmp_path / "truth.parquet")
    log, truth = read_drive(tmp_path / "log.parquet"), read_drive(tmp_path / "truth.parquet")
    for name in log.columns:
        np.testing.assert_allclose(log[name], truth[name], atol=1e-9)


def test_the_calibration_drive_is_gentle_and_holds_a_segment_a_test(tmp_path):
    settings = SimulateSettings(car="f1tenth_car", calibration_tests=True, seed=1)
    simulate_log(settings, tmp_path / "tests.parquet", truth=tmp_path / "truth.parquet")
    drive, truth = read_drive(tmp_path / "tests.parquet"), read_drive(tmp_path / "truth.parquet")
    assert len(drive.segments()) == len(CALIBRATION_TESTS) == len(truth.segments())
    assert drive.metadata.quality["tests"] == list(CALIBRATION_TESTS)
    assert drive.metadata.kinds["T"] == "command"
    assert np.abs(truth["ay"]).max() < 0.45 * 9.81 * 0.8
    # Each test excites what it is for.
    spans = {name: truth.select(run) for name, run in zip(CALIBRATION_TESTS, truth.segments(), strict=True)}
    assert np.ptp(spans["coast_down"]["T"]) == 0 and np.ptp(spans["coast_down"]["vx"]) > 5
    assert spans["throttle_steps"]["T"].max() > 0.2 and spans["brake_steps"]["T"].min() < -0.2
    assert spans["constant_radius"]["ay"].max() > 2.0 and spans["constant_radius_right"]["ay"].min() < -2.0
    assert np.ptp(spans["sine_sweep"]["r"]) > 0.3 and np.ptp(spans["step_steer"]["r"]) > 0.3
    # The noise that is written beside the columns is what is in them.
    for name in ("vx", "vy", "r", "ay"):
        error = drive[name] - truth[name]
        within = np.concatenate([error[run] - error[run].mean() for run in drive.segments()])
        assert within.std() == pytest.approx(drive.metadata.noise_of(name).sigma, rel=0.05)


def test_a_duration_replaces_laps(tmp_path):
    result = simulate_log(replace(QUICK, duration=4.0), tmp_path / "log.csv")
    assert result.duration == pytest.approx(4.0, abs=0.03)


def test_the_command_prints_json_that_agrees_with_the_file(tmp_path):
    path = tmp_path / "a.csv"
    arguments = ["--car", "f1tenth_car", "--maneuver", "step_steer", "--seed", "2", "--json", "-o"]
    outcome = CliRunner().invoke(command, [*arguments, str(path)])
    assert outcome.exit_code == 0, outcome.output
    told = json.loads(outcome.stdout)
    drive = read_drive(path)
    assert told["duration"] == pytest.approx(drive["t"][-1], abs=0.02)
    assert told["top_speed"] == pytest.approx(drive["vx"].max(), abs=0.06)


@pytest.mark.parametrize(
    ("settings", "output", "words"),
    [
        (SimulateSettings(), "a.mcap", "exactly one course"),
        (replace(QUICK, maneuver="step_steer"), "a.mcap", "exactly one course"),
        (replace(QUICK, car="f1tent_car"), "a.mcap", "f1tenth_car"),
        (replace(QUICK, track="f10th"), "a.mcap", "f1tenth"),
        (replace(QUICK, track=None, maneuver="step_stear"), "a.mcap", "step_steer"),
        (replace(QUICK, driver="racr"), "a.mcap", "racer"),
        (replace(QUICK, instruments="most"), "a.mcap", "lean"),
        (replace(QUICK, seed=-1), "a.mcap", "seed"),
        (QUICK, "a.bag", "--format"),
        (replace(QUICK, workshop_units=True), "a.mcap", "csv"),
        (replace(QUICK, track=None, calibration_tests=True), "a.csv", "Parquet"),
        (QUICK, "missing/a.mcap", "folder"),
    ],
)
def test_faults_are_named_and_nothing_is_written(settings, output, words, tmp_path):
    with pytest.raises(SplitError, match=words):
        simulate_log(settings, tmp_path / output)
    assert list(tmp_path.iterdir()) == []
