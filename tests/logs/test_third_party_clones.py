"""Faults first seen in logs that were cloned with public projects and taken the whole way, planted."""

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.opening import open_recording
from split_cli.workflows.ingesting.init import init_project
from tests.logs.planted import PlantedDrive, planted_map, write_table

DEG = 180.0 / np.pi


@pytest.fixture(scope="module")
def planted() -> PlantedDrive:
    return PlantedDrive(seconds=40.0, yaw=2.0)


def test_titles_and_units_behind_marks_of_comments_are_read(planted, tmp_path):
    """CarMaker's ASCII: three commented rows, titles, one word for all columns, units, all in quotes."""
    t = np.arange(0.0, 40.0, 0.02)
    columns = {
        "Time": ("s", t),
        "Car.YawRate": ("deg/s", planted.at("r", t) * DEG),
        "Car.ay": ("m/s^2", planted.at("ay", t)),
        "Car.v": ("m/s", np.hypot(planted.at("vx", t), planted.at("vy", t))),
        "Car.vx": ("m/s", planted.at("vx", t)),
        "Car.vy": ("m/s", planted.at("vy", t)),
    }
    above = [list(columns), ["C1"] * len(columns), [unit for unit, _ in columns.values()]]
    head = "\n".join("# " + ",".join(f'"{cell}"' for cell in row) for row in above)
    np.savetxt(
        tmp_path / "log.csv", np.stack([v for _, v in columns.values()], 1), delimiter=",", header=head, comments=""
    )
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.of("vx").sources == ("Car.vx",) and draft.of("vx").status == "judged"
    assert draft.of("vy").sources == ("Car.vy",)
    assert (draft.of("r").unit, draft.of("r").status) == ("deg/s", "unsided")


def test_a_column_called_by_the_mark_of_a_comment_keeps_its_place(tmp_path):
    rows = "\n".join(f"{n},{0.01 * n},{20.0 + n % 3}" for n in range(60))
    (tmp_path / "log.csv").write_text(f"#,time,speed [m/s]\n{rows}\n")
    read = open_recording(tmp_path / "log.csv").read(["time", "speed"])
    assert read["time"].values[-1] == 0.59 and read["speed"].values[:3].tolist() == [20.0, 21.0, 22.0]


def test_a_clock_of_fewer_digits_than_the_rows_come_in_is_the_clock(planted, tmp_path):
    """Rows every 4 ms and stamps of 10 ms: most rows share one, and none goes back."""
    t = np.arange(0.0, 40.0, 0.004)
    columns = {
        "time": np.floor(t * 100.0) / 100.0,
        "x": planted.at("X", t),
        "y": planted.at("Y", t),
        "yaw": planted.at("yaw", t),
        "speed": planted.at("vx", t),
    }
    write_table(tmp_path / "log.csv", columns)
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.time == "time: {source: time, unit: s}"
    assert draft.of("vx").status == "judged"


def test_seconds_and_nanoseconds_of_one_letter_each_are_one_stamp(planted, tmp_path):
    t = np.arange(0.0, 40.0, 0.02)
    columns = {
        "": np.arange(len(t)),
        "S": np.floor(t) + 1.6e9,
        "ns": np.round((t % 1.0) * 1e9),
        "vx": planted.at("vx", t),
        "wz": planted.at("r", t),
        "ay": planted.at("ay", t),
    }
    write_table(tmp_path / "log.csv", columns)
    assert draft_map(open_recording(tmp_path / "log.csv")).time == "time: {source: S, nanoseconds: ns}"


def test_a_steering_angle_is_taken_before_a_share_of_the_lock(planted, tmp_path):
    """A share of the lock, 5 % a degree here, is no angle; the column beside it is the road wheels' angle."""
    t = np.arange(0.0, 40.0, 0.02)
    delta = planted.at("delta", t)
    columns = {
        "time": t,
        "speed_mps": planted.at("vx", t),
        "yaw_rate": planted.at("r", t),
        "lat_accel": planted.at("ay", t),
        "steering": delta,
        "steering_pct": 5.0 * delta * DEG,
    }
    write_table(tmp_path / "log.csv", columns)
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.of("delta").sources == ("steering",) and draft.of("delta").status != "open"


def test_what_nothing_in_a_log_gives_is_no_matter_of_the_map(planted, tmp_path):
    t = np.arange(0.0, 40.0, 0.1)
    columns = {"time": t, "speed_mps": planted.at("vx", t), "lateral_acc": planted.at("ay", t)}
    write_table(tmp_path / "log.csv", columns)
    steps = "\n".join(init_project([tmp_path / "log.csv"], tmp_path / "car").next_steps)
    # Without a gyro a_y and v_x give r and v_y, and what that costs is said.
    assert steps.startswith("Nothing in this log gives delta, and") and "Map vy" not in steps
    assert "nothing of its sideslip" in steps and "--derive yaw-rate-from-lateral-acceleration" in steps


def test_no_torque_is_made_of_an_acceleration_that_does_not_follow_the_velocity():
    """Noise in the place of a_x: T comes from dv_x/dt - v_y r then, and the report says why."""
    drive = PlantedDrive(seconds=40.0)
    channels = ("vx", "vy", "r", "delta", "ax")
    settings = IngestSettings(derive=("torque-from-acceleration",))
    noise = np.random.default_rng(1)
    recording = drive.recording(channels, altered={"ax": lambda values: noise.standard_normal(len(values))})
    made = assemble_drive(recording, planted_map(channels), drive.vehicle, settings)
    assert "from dv_x/dt - v_y r" in made.drive.metadata.kinds["T"]
    assert any("a_x was not used for T" in text for text in made.quality.warnings)
    inside = slice(50, -50)
    np.testing.assert_allclose(made.drive["T"][inside], drive.at("T", made.drive["t"])[inside], atol=0.02 * 1700)


def test_a_speed_that_no_car_reaches_is_told_with_what_other_units_would_make_of_it(tmp_path):
    """150 km/h without a unit, and nothing recorded that judges it."""
    t = np.arange(0.0, 60.0, 0.1)
    write_table(tmp_path / "log.csv", {"time": t, "SPEED": 150.0 + 8.0 * np.sin(0.2 * t)})
    reason = draft_map(open_recording(tmp_path / "log.csv")).of("vx").reason
    assert "km/h would make it 43.9, mph would make it 70.6, kn would make it 81.3 m/s" in reason
