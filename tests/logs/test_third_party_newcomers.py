"""Faults first seen in public logs of kinds that had not been tried: games, simulators, loggers, small cars."""

import json

import numpy as np
import pytest

from split_cli.errors import LogError
from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.naming import meanings
from split_cli.logs.raw import RawChannelInfo
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.workflows.ingesting.init import init_project
from tests.logs.planted import PlantedDrive, write_table
from tests.logs.test_third_party_public import drafted_table

DEG = 180.0 / np.pi
DEGREE_OF_LATITUDE = 111_320.0


@pytest.fixture(scope="module")
def planted() -> PlantedDrive:
    return PlantedDrive(seconds=59.0, yaw=2.0)


@pytest.fixture
def columns(planted):
    t = np.arange(0.0, 59.0, 0.02)
    return t, {name: planted.at(name, t) for name in ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay", "delta")}


def test_a_game_whose_z_is_forward_is_no_car_that_reads_gravity_there(tmp_path):
    """Forza on a drag strip: the acceleration along z is larger than the others for long, and is no gravity."""
    t = np.arange(0.0, 60.0, 0.02)
    vx, r = 30.0 + 25.0 * np.sin(t / 8.0), 0.02 * np.sin(0.7 * t)
    yaw = np.cumsum(r) * 0.02
    names = ("Acceleration", "Velocity", "AngularVelocity", "Position")
    sides = (vx * r, 0.05 * np.sin(t), 0.0 * t), (0.1 * r, 0.05 * np.cos(9.0 * t), 0.0 * t)
    triples = {
        "Acceleration": (sides[0][0], 0.2 * np.sin(11.0 * t), 25.0 / 8.0 * np.cos(t / 8.0)),
        "Velocity": (sides[1][0], sides[1][1], vx),
        "AngularVelocity": (0.02 * np.sin(12.0 * t), r, 0.01 * np.sin(13.0 * t)),
        "Position": (np.cumsum(vx * np.sin(yaw)) * 0.02, 170.0 + 1e-3 * t, np.cumsum(vx * np.cos(yaw)) * 0.02),
    }
    table = {"TimestampMS": 1000.0 * t, "Yaw": yaw}
    table |= {f"{name}{axis}": values for name in names for axis, values in zip("XYZ", triples[name], strict=True)}
    draft = drafted_table(table, tmp_path)
    found = {channel: draft.of(channel).sources for channel in ("vx", "vy", "ax", "ay", "r", "X", "Y")}
    assert found == {
        "vx": ("VelocityZ",),
        "vy": ("VelocityX",),
        "ax": ("AccelerationZ",),
        "ay": ("AccelerationX",),
        "r": ("AngularVelocityY",),
        "X": ("PositionZ",),
        "Y": ("PositionX",),
    }
    assert {"vx", "ax"} <= {s.channel for s in draft.suggestions if s.status == "judged"}


def test_an_axis_that_reads_gravity_tells_the_unit_of_the_others(tmp_path):
    """A small car's logger in thousandths of g had been taken in m/s^2; without such an axis it is left open."""
    rng = np.random.default_rng(1)
    small = 60.0 * np.sin(np.arange(600) / 40.0)
    sensor = {"acc_x": small, "acc_y": -0.5 * small, "acc_z": 1020.0 + rng.standard_normal(600)}
    draft = drafted_table(sensor, tmp_path)
    assert (draft.of("ax").unit, draft.of("ax").scale) == ("g", 1e-3)
    assert "acc_z reads 102" in draft.of("ay").reason and draft.of("ay").status == "assumed"
    # Standing, the largest reading is gravity, not a smaller one that happens to be 1.
    sensor |= {"acc_x": 1.1 + 1e-3 * small, "acc_y": 1e-3 * small, "acc_z": 9.6 + 0.01 * small / 60.0}
    assert drafted_table(sensor, tmp_path).of("ay").unit == "m/s^2"
    sensor = {"acc_x": small, "acc_y": -0.5 * small}
    sensor = {name: 4.0 * values for name, values in sensor.items()}
    assert drafted_table(sensor, tmp_path).of("ax").status == "open"


def test_the_speed_of_a_steering_wheel_is_no_speed_of_the_car(columns, tmp_path):
    """A simulator's `ang`, `vel`, `acc` of the steering wheel agreed with each other, as v_x and a_x.

    The path says how fast the car is, at a steady speed too, where nothing correlates with it.
    """
    t, c = columns
    turned = 17.0 * c["delta"]
    rate = np.gradient(turned, 0.02)
    table = {"time": t, "x": c["X"], "y": c["Y"], "yaw": c["yaw"], "vel": rate, "acc": np.gradient(rate, 0.02)}
    alone = drafted_table(table, tmp_path)
    assert alone.of("vx").status == "open" and "speed of X, Y over v_x" in alone.of("vx").reason
    assert alone.of("ax").status == "assumed"
    draft = drafted_table(table | {"carv": c["vx"], "fl": 1e-3 * turned, "fr": 1e-3 * turned}, tmp_path)
    assert draft.of("vx").sources == ("carv",) and draft.of("vx").status == "judged"
    # Nor is every column called by a corner the speed of a wheel.
    assert draft.of("wheel_speed_fl").status == "open"


def test_columns_of_several_quantities_with_the_same_numbers_are_measured_by_nobody(columns, tmp_path):
    t, c = columns
    noise = np.random.default_rng(2).standard_normal(len(t))
    table = {
        "t_s": t,
        "x_m": c["X"],
        "y_m": c["Y"],
        "yaw_deg": c["yaw"] * DEG,
        "v_mps": c["vx"],
        "imu_gz_rps": noise,
        "imu_ax_mps2": noise,
        "imu_ay_mps2": noise,
    }
    draft = drafted_table(table, tmp_path)
    assert {s.channel for s in draft.suggestions if "another quantity" in s.reason} == {"r", "ax", "ay"}
    found = meanings(RawChannelInfo("imu_gz_rps", "column", None))
    assert [meaning.channel for meaning in found] == ["r"]


def test_a_yaw_rate_of_unknown_size_and_other_hand_leaves_the_satellite_fix_alone(columns, tmp_path):
    """A gyroscope decoded with another factor: the fix, the speed and a_y contradict it alike, not each other."""
    t, c = columns
    table = {
        "time": t,
        "SPEED": c["vx"] * 3.6,
        "Z_ANGLE_RATE": -0.22 * c["r"] * DEG,
        "LATITUDE": 41.0 + c["Y"] / DEGREE_OF_LATITUDE,
        "LONGITUDE": -81.0 + c["X"] / DEGREE_OF_LATITUDE / np.cos(np.radians(41.0)),
        "Y_ACCELERATION": c["ay"],
    }
    draft = drafted_table(table, tmp_path, fmt="%.10f")
    assert draft.of("r").status == "open" and "r is -12.6 times" in draft.of("r").reason
    assert "Or:" not in draft.of("r").reason
    assert draft.of("X").status == draft.of("vx").status == "judged"


def test_a_position_whose_second_axis_hardly_changes_is_a_height(columns, tmp_path):
    """Gran Turismo: y is up, a part of a quaternion is called yaw, and the yaw rate has lost its sign."""
    t, c = columns
    table = {
        "data_time": t,
        "data_position_x": c["X"],
        "data_position_y": 2.0 * np.sin(t / 20.0),
        "data_position_z": c["Y"],
        "data_speed": c["vx"] * 3.6,
        "data_rotation_yaw": np.sin(6.0 * c["yaw"]),
        "data_absolute_yaw_rate_per_second": np.abs(c["r"]),
    }
    draft = drafted_table(table, tmp_path)
    assert draft.of("Y").sources == ("data_position_z",)
    assert (draft.of("vx").unit, draft.of("vx").status) == ("km/h", "judged")
    assert draft.of("yaw").status == "open" and draft.of("r") is None


def test_a_list_of_laps_with_a_list_for_each_channel_is_refused_with_the_way_out(tmp_path):
    laps = [{"title": "a", "data_speed": list(range(300)), "data_time": list(range(300))}] * 3
    (tmp_path / "a.json").write_text(json.dumps(laps))
    with pytest.raises(LogError, match="list of 3 objects with a list for each channel") as refused:
        open_recording(tmp_path / "a.json")
    assert "json.load(open('a.json'))[0]" in str(refused.value)
    (tmp_path / "b.json").write_text(json.dumps({"laps": laps}))
    with pytest.raises(LogError, match=r"\['laps'\]\[0\]"):
        open_recording(tmp_path / "b.json")


def test_what_no_step_mends_stands_first(columns, tmp_path):
    t, c = columns
    drafted_table({"time": t, "speed_mps": c["vx"]}, tmp_path)
    steps = init_project([tmp_path / "log.csv"], tmp_path / "car").next_steps
    assert steps[0].startswith("Nothing in this log gives vy, r, delta")
    assert steps[-1].startswith("With vy, r, delta, run: split ingest")


def test_an_acceleration_that_the_change_of_speed_denies_is_left_open_with_the_other_of_its_sensor(columns, tmp_path):
    """A phone's x is to the right and in g: a tenth of what dv_x/dt says, and nothing to do with it."""
    t, c = columns
    fast = 20.0 + 12.0 * np.sin(0.4 * t)
    table = {"Time": t, "Speed (m/s)": fast, "Accel X": 0.02 * np.sin(3.3 * t), "Accel Y": 0.05 * np.cos(2.1 * t)}
    draft = drafted_table(table, tmp_path)
    assert "does not go with it" in draft.of("ax").reason and draft.of("ay").status == "open"


def test_a_word_that_ends_many_names_says_who_measured(columns, tmp_path):
    """Motion capture, motor controller and IMU in one table; the IMU is turned round and its yaw begins at 0."""
    t, c = columns
    draft = drafted_table(
        {
            "timestamp": t,
            "x_opti": c["X"],
            "y_opti": c["Y"],
            "yaw_opti": c["yaw"],
            "vx_opti": c["vx"],
            "vy_opti": c["vy"],
            "r_opti": c["r"],
            "ax_imu": -c["ax"],
            "ay_imu": -c["ay"],
            "x_plan": c["X"] + 1.0,
            "yaw_imu": c["yaw"] + 0.7,
            "delta_vesc": -c["delta"],
            "vx_vesc": 1.04 * c["vx"],
            "rpm_vesc": 1e3 * c["vx"],
            "y_plan": c["Y"],
        },
        tmp_path,
    )
    for channel in ("X", "Y", "yaw", "vx", "vy", "r"):
        assert draft.of(channel).sources == (f"{channel.lower()}_opti",), channel
    assert draft.of("delta").sources == ("delta_vesc",)
    assert [draft.of(c).scale for c in ("ax", "ay", "delta")] == [-1.0, -1.0, -1.0]


def test_an_index_without_a_title_that_counts_in_seconds_is_the_time(columns, tmp_path):
    """A data frame of three runs, written with its index; between the runs two minutes are missing."""
    t, c = columns
    clock = t + 120.0 * ((t > 20.0).astype(float) + (t > 41.0))
    table = {"": clock, "v_x": c["vx"], "v_y": c["vy"], "r": c["r"], "ax_imu": c["ax"], "delta": c["delta"]}
    draft = drafted_table(table, tmp_path)
    recording = open_recording(tmp_path / "log.csv")
    assert draft.time == "time: {source: column1, unit: s}" and draft.of("ax").status == "judged"
    assert "column1" not in draft.unused and [n.what for n in recording.notes] == [
        "a first column without a title, called column1"
    ]
    # Row numbers are none.
    rows = np.arange(200.0)
    assert drafted_table({"": rows, "v_x": 0.1 * rows}, tmp_path).time.startswith("# time: {period")


@pytest.mark.parametrize("gap", [None, 3.0])
def test_runs_that_one_clock_joins_are_segments(gap, columns, tmp_path):
    """Three runs in a table whose index was counted anew: at the joints the motion jumps, and no car does that.

    Nothing is interpolated from one run to the next, whatever gap is bridged and however slow a source is.
    """
    t, c = columns
    kept = ((t > 5.0) & (t < 18.0)) | ((t > 24.0) & (t < 37.0)) | (t > 43.0)
    run = np.digitize(t, [20.0, 40.0])[kept].astype(float)
    table = {"t": 0.02 * np.arange(len(run)), **{k: c[k][kept] for k in ("vx", "vy", "r", "ax", "delta")}}
    table |= {"T": 0.0 * run, "run_id": run}
    write_table(tmp_path / "log.csv", table)
    signal_map = map_from_mapping(
        {"time": {"source": "t"}, "channels": {k: {"source": k} for k in ("vx", "vy", "r", "ax", "delta", "T")}}
    )
    made = assemble_drive(open_recording(tmp_path / "log.csv"), signal_map, settings=IngestSettings(gap=gap))
    parts = made.drive.segments()
    assert [len(made.drive["vx"][part]) for part in parts] == [np.count_nonzero(run == k) for k in range(3)]
    np.testing.assert_allclose(made.drive["vx"][parts[1]], table["vx"][run == 1], atol=1e-9)
    assert any("run_id changes 2 times while the time goes on" in line for line in made.drive.metadata.conversions)
