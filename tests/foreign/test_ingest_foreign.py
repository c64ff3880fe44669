"""The recordings of others, each by one command with a map and a vehicle of the project."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.ingest import command
from split_cli.logs.drive import Drive, read_drive
from split_cli.vehicle.parameters import read_vehicle, write_vehicle
from split_cli.workflows.ingesting.init import init_project
from tests.factories import road_car

pytestmark = pytest.mark.foreign


AV21 = ("--map", "av21_lvms", "--vehicle", "av21", "--derive", "torque-from-throttle-and-brake")


def ingest(tmp_path, log, *arguments: str) -> tuple[Drive, dict]:
    output = tmp_path / "drive.parquet"
    shown = CliRunner().invoke(command, [str(log), *arguments, "-o", str(output), "--json"], catch_exceptions=False)
    assert shown.exit_code == 0
    return read_drive(output), json.loads(shown.stdout)[0]


def findings(report: dict) -> dict[tuple[str, str], float]:
    return {(f["channel"], f["check"]): f["measured"] for f in report["quality"]["consistency"]["findings"]}


def delays(report: dict) -> dict[str, dict]:
    return {entry["channel"]: entry for entry in report["quality"]["delays"]}


def test_genesis_its_biases_on_straights_are_found_and_its_held_steering_is_held(tmp_path, datasets):
    drive, report = ingest(
        tmp_path,
        datasets / "genesis_slow" / "cpg_slow_lap.mat",
        "--map",
        "genesis_slow",
        "--vehicle",
        "genesis",
        "--derive",
        "torque-from-acceleration",
        "--estimate-delays",
    )
    assert drive.rate == pytest.approx(100.0) and len(drive) > 36000
    # Its folder's own description: v_y about -0.12 m/s and a_lat about -0.64 m/s^2 on straights.
    found = findings(report)
    assert found.pop(("vy", "bias on straights")) == pytest.approx(-0.12, abs=0.02)
    assert found.pop(("ay", "bias on straights")) == pytest.approx(-0.64, abs=0.06)
    assert found == {}
    (steer,) = (c for c in report["quality"]["channels"] if c["channel"] == "delta")
    assert steer["resampling"] == "held"
    assert np.mean(np.diff(drive["delta"]) == 0.0) > 0.7
    assert report["kinds"]["T"].startswith("derived")
    # One INS: no channel is later than the 20 ms of its own filters' differences; accelerations a little more.
    assert all(abs(d["delay"]) < 0.04 for d in delays(report).values())


def test_av21_its_shifted_channels_are_found(tmp_path, datasets):
    drive, report = ingest(tmp_path, datasets / "av21_lvms" / "LVMS_23_01_04_B.csv", *AV21, "--estimate-delays")
    assert drive.rate == pytest.approx(25.0)
    found = delays(report)
    # Yaw rate trails yaw and velocity by more than a quarter second, a_x by a whole one.
    assert found["r"]["delay"] == pytest.approx(0.33, abs=0.1) and found["r"]["refusal"] == ""
    assert found["r"]["delay"] - found["yaw"]["delay"] == pytest.approx(0.24, abs=0.05)
    assert found["ax"]["delay"] > 0.9
    # Front wheels are in time. The driven rear ones seem early; slip does that too, so the error covers it.
    assert abs(found["wheel_speed_fl"]["delay"]) < 0.04
    assert found["wheel_speed_rl"]["error"] > 0.02
    # Evidence by another measure: dyaw/dt and r agree better after, as far as r's own filter lets them.
    before, _ = ingest(tmp_path, datasets / "av21_lvms" / "LVMS_23_01_04_B.csv", *AV21)
    assert _yaw_rate_misfit(drive) < 0.8 * _yaw_rate_misfit(before)
    # Its a_x is filtered to half its size; that is said.
    assert findings(report)[("ax", "scale")] == pytest.approx(0.5, abs=0.1)
    # Wheel speeds in km/h and a brake in kPa arrive in SI.
    assert np.nanmax(drive["wheel_speed_rl"]) < 25.0 and np.nanmax(drive["brake_pressure"]) > 2e6
    assert drive["T"].min() < -500.0 and drive["T"].max() > 500.0


def _yaw_rate_misfit(drive: Drive) -> float:
    from scipy.ndimage import gaussian_filter1d

    rate = np.gradient(gaussian_filter1d(drive["yaw"], 5.0), drive.period)
    moving = drive["vx"] > 5.0
    return float(np.sqrt(np.mean((gaussian_filter1d(drive["r"], 5.0) - rate)[moving] ** 2)))


@pytest.mark.parametrize("name", ["data_to_run.csv", "data_to_train_12.csv"])
def test_tum_a_log_without_time_gets_one_and_its_torque_is_the_sum(tmp_path, datasets, name):
    drive, report = ingest(tmp_path, datasets / "tum_sim" / name, "--map", "tum_sim", "--vehicle", "tum_sim")
    assert drive.rate == pytest.approx(100.0)
    assert findings(report) == {}  # a simulation: its channels do fit together
    assert any("0.008 s apart" in text for text in report["quality"]["assumed"])
    raw = np.loadtxt(datasets / "tum_sim" / name, delimiter=",", comments="#")
    total = raw[:, 6] + raw[:, 7] - 70.0 * (raw[:, 8] + raw[:, 9])
    # Each value holds for 0.008 s; a row of 0.01 s has the mean until the next row.
    until = np.append(0.0, np.cumsum(total) * 0.008)
    ends = np.interp([drive["t"], drive["t"] + 0.01], 0.008 * np.arange(len(until)), until)
    np.testing.assert_allclose(drive["T"][:-1], ((ends[1] - ends[0]) / 0.01)[:-1], atol=1e-5)
    assert np.std(drive["vx"] - np.interp(drive["t"], 0.008 * np.arange(len(raw)), raw[:, 0])) < 0.01


@pytest.mark.parametrize("name", ["genesis", "av21", "tum_sim"])
def test_every_value_of_the_vehicles_says_where_it_is_from(name):
    vehicle = read_vehicle(name)
    tires = {f"{axle}_tire.{key}" for axle in ("front", "rear") for key in "BCD"}
    said = set(vehicle.origins)
    assert {"mass", "yaw_inertia", "cg_to_front_axle", "cg_to_rear_axle", "wheel_radius", *tires} <= said
    assert set(vehicle.origins.values()) <= {"published", "assumed", "calibrated"}


def test_the_published_stiffness_of_the_genesis_is_kept():
    vehicle = read_vehicle("genesis")
    assert vehicle.front_tire.cornering_stiffness == pytest.approx(2 * 76419, rel=1e-3)
    assert vehicle.rear_tire.cornering_stiffness == pytest.approx(2 * 134851, rel=1e-3)


@pytest.mark.parametrize("name", ["aim_formula_ford/SummitPointFF.csv", "motec_simulated/blakelyauto.csv"])
def test_logs_of_race_cars_without_a_gyro_become_drives_that_say_what_they_assume(tmp_path, datasets, name):
    made = init_project([datasets / name], tmp_path / "car")
    asked = ("yaw-rate-from-lateral-acceleration", "torque-from-acceleration")
    assert " ".join(f"--derive {one}" for one in asked) in made.next_steps[-1]
    assert "nothing of its sideslip" in made.next_steps[0]
    text = made.map_path.read_text()
    ratio = "  delta: {source: Steered Angle, unit: deg, scale: 0.08}"  # what a comment of the draft asks for
    made.map_path.write_text("\n".join(ratio if "# open: delta" in line else line for line in text.splitlines()))
    car = road_car()
    grippy = replace(car, rear_tire=replace(car.rear_tire, D=2.0 * car.rear_tire.D))
    write_vehicle(grippy, tmp_path / "car.yaml")
    derive = [word for one in asked for word in ("--derive", one)]
    drive, report = ingest(
        tmp_path, datasets / name, "--map", str(made.map_path), "--vehicle", str(tmp_path / "car.yaml"), *derive
    )
    assert report["quality"]["duration"] > 150.0
    assert drive.metadata.faults == (
        "no yaw rate was recorded: r and v_y follow from a_y and the rear tyres of the vehicle file",
    )
    # A car on a circuit turns by less than a rad/s, and its body slips by less than the tyres do.
    assert np.abs(drive["r"]).max() < 1.5 and np.abs(drive["vy"] / drive["vx"]).max() < 0.3
