"""Faults first seen in logs as sixty kinds of programs write them: units, sides, axes, names and next steps."""

import re

import numpy as np
import pytest
import yaml
from scipy.io import savemat

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.naming import meanings, stated_unit
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.drive import read_drive, write_drive
from split_cli.logs.raw import RawChannelInfo, seconds_a_tick, unit_of_time
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.signals import STANDARD_GRAVITY, find_unit, split_name_and_unit
from split_cli.workflows.ingesting.init import init_project
from tests.logs.planted import write_table

DEG = 180.0 / np.pi


@pytest.fixture
def drafted(tmp_path):
    """Write columns as a table, and return the draft of its map with the recording."""

    def draft(columns, **how):
        write_table(tmp_path / "log.csv", columns, **how)
        recording = open_recording(tmp_path / "log.csv")
        return draft_map(recording), recording

    return draft


def test_the_line_for_a_steering_wheel_keeps_the_column_of_its_sign(car, drafted):
    """The line that the draft advises had left the sign out: a steer angle without left and right, and no word."""
    t = np.arange(0.0, 40.0, 0.02)
    angle = 15.0 * DEG * car.at("delta", t)
    columns = {"t [s]": t, "v [km/h]": 3.6 * car.at("vx", t), "yaw rate [deg/s]": DEG * car.at("r", t)}
    columns |= {"vy [m/s]": car.at("vy", t), "T [Nm]": car.at("T", t)}
    columns |= {"Steering_Angle[deg]": np.abs(angle), "Steering_Angle_Sign[-]": (angle < 0.0).astype(float)}
    draft, recording = drafted(columns)
    line = re.search(r"`delta: (.*?)`", draft.of("delta").reason)[1].replace("1/RATIO", f"{1 / 15.0}")
    entries = {"vx": {"source": "v"}, "vy": {"source": "vy"}, "r": {"source": "yaw rate"}, "T": {"source": "T"}}
    named = map_from_mapping({"time": {"source": "t"}, "channels": {**entries, "delta": yaml.safe_load(line)}})
    drive = assemble_drive(recording, named, car.vehicle).drive
    assert drive.columns["delta"] == pytest.approx(car.at("delta", drive.columns["t"]), abs=1e-3)


def test_a_yaw_beside_axes_that_motion_shows_is_no_compass(car, drafted):
    """A right-handed game with y up: taken for a left-handed one its log is a mirror image, called certain."""
    t = np.arange(0.0, 40.0, 0.02)
    at = {c: car.at(c, t) for c in ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay", "delta")}
    east, north = np.gradient(at["X"], t), np.gradient(at["Y"], t)
    still = 1e-3 * np.sin(t)
    columns = {"m_sessionTime": t, "m_worldPositionX": at["X"], "m_worldPositionY": still}
    columns |= {"m_worldPositionZ": -at["Y"], "m_worldVelocityX": east, "m_worldVelocityY": still}
    columns |= {"m_worldVelocityZ": -north, "m_yaw": np.angle(1j * np.exp(1j * at["yaw"]))}
    columns |= {"m_localVelocityX": -at["vy"], "m_localVelocityY": still, "m_localVelocityZ": at["vx"]}
    columns |= {"m_angularVelocityX": still, "m_angularVelocityY": -at["r"], "m_angularVelocityZ": still}
    columns |= {f"m_wheelSpeed{c}": at["vx"] + s * at["r"] for c, s in (("RL", -0.8), ("RR", 0.8))}
    draft, _ = drafted(columns)
    assert draft.left == ""
    assert {draft.of(c).status for c in ("r", "vy", "yaw", "X", "Y")} == {"unsided"}
    assert draft.of("wheel_speed_rl").sources == ("m_wheelSpeedRL",) and draft.of("T") is None


def test_velocities_of_the_world_with_y_up_are_no_velocity_of_the_car(car, drafted):
    """Of a flat track the height never changes: Y was missing, and the world's x was taken for v_x."""
    t = np.arange(0.0, 40.0, 0.02)
    x, z = car.at("X", t), car.at("Y", t)
    columns = {"time": t, "pos_x": x, "pos_y": np.full(len(t), 20.0), "pos_z": z}
    columns |= {"speed": np.hypot(np.gradient(x, t), np.gradient(z, t))}
    columns |= {"vel_x": np.gradient(x, t), "vel_y": np.zeros(len(t)), "vel_z": np.gradient(z, t)}
    draft, _ = drafted(columns)
    assert (draft.of("X").sources, draft.of("Y").sources) == (("pos_x",), ("pos_z",))
    assert (draft.of("vx").sources, draft.of("vx").status) == (("speed",), "judged")


@pytest.mark.parametrize(("speed", "factor", "unit"), [("gSpeed", 1000.0, "mm/s"), ("Spd", 100.0, "cm/s")])
def test_a_fix_in_whole_numbers_is_in_ten_millionths_of_a_degree(speed, factor, unit, car, drafted):
    """u-blox, MAVLink and PX4 count so; the draft had left position and speed open."""
    t = np.arange(0.0, 40.0, 0.1)
    radius = 6_378_137.0
    lat, lon = -33.9 + DEG * car.at("Y", t) / radius, 151.2 + DEG * car.at("X", t) / radius / np.cos(-33.9 / DEG)
    columns = {"iTOW": 1000.0 * t, "lon": np.rint(1e7 * lon), "lat": np.rint(1e7 * lat)}
    columns |= {speed: np.rint(factor * np.hypot(car.at("vx", t), car.at("vy", t)))}
    columns |= {c: car.at(c, t) for c in ("r", "T", "delta")}
    draft, recording = drafted(columns, fmt="%.12g")
    assert draft.of("X").unit == draft.of("Y").unit == "1e-07 deg" and draft.of("vx").unit == unit
    assert {draft.of(c).status for c in ("X", "Y", "vx")} == {"judged"}
    fix = {"source": ["lat", "lon"], "unit": "1e-07 deg"}
    entries = {"X": {**fix, "convert": "local_x"}, "Y": {**fix, "convert": "local_y"}}
    entries |= {c: {"source": speed, "unit": unit} for c in ("vx", "vy")}
    entries |= {c: {"source": c} for c in ("r", "T", "delta")}
    named = map_from_mapping({"time": {"source": "iTOW", "unit": "ms"}, "channels": entries})
    drive = assemble_drive(recording, named, car.vehicle).drive
    for channel in "XY":
        moved = drive.columns[channel] - drive.columns[channel][0]
        truth = car.at(channel, drive.columns["t"])
        # The ellipsoid is 0.6 % off the sphere that made the degrees, at most.
        assert moved == pytest.approx(truth - truth[0], abs=0.007 * np.ptp(truth))


@pytest.mark.parametrize(
    ("written", "si", "factor"),
    [
        ("gon", "rad", np.pi / 200.0),
        ("rev", "rad", 2.0 * np.pi),
        ("cdeg", "rad", np.pi / 18_000.0),
        ("kgf·m", "N m", STANDARD_GRAVITY),
        ("1e-7 deg", "rad", 1e-7 * np.pi / 180.0),
        ("0.01 m/s", "m/s", 0.01),
    ],
)
def test_units_of_angles_torques_and_counted_steps(written, si, factor):
    found = find_unit(written)
    assert found.si == si and found.factor == pytest.approx(factor, rel=1e-12)
    assert find_unit(found.symbol) == found


@pytest.mark.parametrize("raster", ["10ms", "100 ms", "2D", "3d fix", "1e-7", "0.01"])
def test_a_raster_and_a_number_alone_are_no_unit_of_steps(raster):
    assert find_unit(raster) is None


@pytest.mark.parametrize(
    ("name", "channel", "unit"),
    [
        ("VSS1", "vx", None),
        ("Knots", "vx", "kn"),
        ("km/h", "vx", "km/h"),
        ("velocity.w_z", "r", None),
        ("GyZ", "r", None),
        ("AcX", "ax", None),
        ("m_wheelSpeedRL", "wheel_speed_rl", None),
        ("Yaw_cdeg", "yaw", "cdeg"),
        ("Spd_cms", "vx", "cm/s"),
        ("rwa_rad", "delta", "rad"),
        ("RoadWheelAngle_mrad", "delta", "mrad"),
        ("AccelerationSway", "ay", None),
        ("AccelerationSurge", "ax", None),
        ("OrientationYawVelocity", "r", None),
    ],
)
def test_names_of_sensors_of_units_and_of_turning(name, channel, unit):
    info = RawChannelInfo(name, "column", None)
    assert next(iter(meanings(info))).channel == channel and stated_unit(info) == unit


def test_what_goes_down_is_no_velocity_of_the_car():
    assert not meanings(RawChannelInfo("velocity_down", "column", None))
    assert not meanings(RawChannelInfo("(m/s)", "column", None))  # a row of units in place of the titles
    assert not meanings(RawChannelInfo("fps", "column", None))  # frames a second


def test_g_is_the_gyroscope_beside_accelerations_and_gravity_alone(car, drafted):
    t = np.arange(0.0, 40.0, 0.02)
    columns = {"t": 1e3 * t, "v": car.at("vx", t), "ax": car.at("ax", t), "ay": car.at("ay", t)}
    draft, _ = drafted({**columns, "gz": DEG * car.at("r", t)})
    assert (draft.of("r").sources, draft.of("r").unit, draft.of("r").status) == (("gz",), "deg/s", "unsided")
    forces = {"t": 1e3 * t, "v": car.at("vx", t), "gx": car.at("ax", t), "gz": car.at("ay", t)}
    assert drafted(forces)[0].of("r") is None


def test_what_is_derived_of_a_derived_channel_is_not_called_missing(car, tmp_path):
    """A heading gives r, and r with a_y gives v_y; in gon a heading runs to 400."""
    t = np.arange(0.0, 40.0, 0.02)
    bearing = (300.0 - 200.0 / np.pi * car.at("yaw", t)) % 400.0
    columns = {"time[s]": t, "speed[ft/s]": car.at("vx", t) / 0.3048, "heading[gon]": bearing}
    columns |= {"ax[m/s2]": car.at("ax", t), "ay[m/s2]": car.at("ay", t), "delta[deg]": DEG * car.at("delta", t)}
    write_table(tmp_path / "log.csv", columns)
    made = init_project([tmp_path / "log.csv"], tmp_path / "car")
    assert made.draft.of("yaw").world == "ned" and made.draft.left == "the compass"
    assert made.next_steps[-1].startswith("Run: ")
    assert "--derive yaw-rate-from-yaw --derive lateral-velocity-from-accelerations" in made.next_steps[-1]


def test_a_derived_channel_beyond_any_measurement_leaves_rows_out(car, drafted, tmp_path):
    """A car that slides backwards, steered beyond any car's angle: 2e9 N m stood in a drive that nothing could read."""
    t = np.arange(0.0, 40.0, 0.01)
    delta, front = car.at("delta", t), car.vehicle.brake_split_front
    delta[t < 20.0] = np.arccos(1.0 - 1.0 / front)  # where braked wheels push as much aside as along
    columns = {"t": t, "vx": -car.at("vx", t), "vy": 0.7 * car.at("vx", t), "r": car.at("r", t), "delta": delta}
    _, recording = drafted(columns)
    named = map_from_mapping({"time": {"source": "t"}, "channels": {c: {"source": c} for c in [*columns][1:]}})
    made = assemble_drive(recording, named, car.vehicle, IngestSettings(derive=("torque-from-acceleration",)))
    write_drive(made.drive, tmp_path / "drive.parquet")
    assert len(read_drive(tmp_path / "drive.parquet")) == len(made.drive) < len(t)
    assert [text for text in made.drive.metadata.conversions if "rows left out, derived as more than" in text]


@pytest.mark.parametrize(("gyro", "accelerometer"), [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
def test_wheels_judge_units_and_sides_where_no_speed_is_recorded(gyro, accelerometer, car, drafted):
    """OBD has four wheels and no v_x: yaw rate, accelerations and steering had been judged by nothing."""
    t = np.arange(0.0, 40.0, 0.02)
    vx, r, half = car.at("vx", t), car.at("r", t), 0.8
    sides = {"fl": -1.0, "fr": 1.0, "rl": -1.0, "rr": 1.0}
    columns = {"time": t, **{f"wheel_{c}_kmh": 3.6 * (vx + s * half * r) for c, s in sides.items()}}
    columns |= {"steering_angle": 15.0 * DEG * car.at("delta", t), "yawrate": gyro * DEG * r}
    columns |= {"acc_lat": accelerometer * car.at("ay", t), "acc_long": car.at("ax", t)}
    draft, _ = drafted(columns)
    found = {c: draft.of(c) for c in ("r", "ay", "ax", "wheel_speed_fl")}
    assert {s.status for s in found.values()} == {"judged"} and found["r"].unit == "deg/s"
    assert (found["r"].scale, found["ay"].scale) == (gyro, accelerometer)
    assert draft.left == "the wheels outside a turn, which are faster"
    assert "m over the wheelbase" in draft.of("delta").reason and "minus" not in draft.of("delta").reason


@pytest.mark.parametrize(
    ("title", "name", "unit"),
    [
        ("Yaw rate, °/s", "Yaw rate", "deg/s"),
        ("Gierrate in °/s", "Gierrate", "deg/s"),
        ("v / m/s", "v", "m/s"),
        ("Lateral acceleration, m/s²", "Lateral acceleration", "m/s^2"),
        ("Speed, front left", "Speed, front left", None),
        ("car in front", "car in front", None),
        ("Velocity, N", "Velocity, N", None),
    ],
)
def test_a_unit_stands_behind_a_comma_an_in_or_a_stroke(title, name, unit):
    assert split_name_and_unit(title) == (name, unit)


def test_a_torque_of_the_drive_beside_those_of_the_brakes_is_marked(car, drafted):
    """It was called judged, by the moments in which the car is driven, and the brakes were not used."""
    t = np.arange(0.0, 40.0, 0.02)
    torque, corners = car.at("T", t), ("FL", "FR", "RL", "RR")
    columns = {"t_s": t, "vx_mps": car.at("vx", t), "vy_mps": car.at("vy", t), "yawrate_radps": car.at("r", t)}
    driven = {f"DriveTrq_{c}_Nm": 0.25 * np.maximum(torque, 0.0) for c in corners}
    braked = {f"BrakeTrq_{c}_Nm": 0.25 * np.maximum(-torque, 0.0) for c in corners}
    draft, _ = drafted({**columns, **driven, **braked})
    assert draft.of("T").status == "assumed" and "add the brakes to `sum:`" in draft.of("T").reason
    draft, _ = drafted({**columns, **{f"WheelTrq_{c}_Nm": 0.25 * torque for c in corners}})
    assert draft.of("T").status == "judged"


@pytest.mark.parametrize("name", ["q{}", "attitude.q[{}]"])
def test_a_numbered_quaternion_begins_with_its_real_part(name, car, drafted):
    names = tuple(name.format(k) for k in range(4))
    t = np.arange(0.0, 40.0, 0.02)
    half, still = 0.5 * car.at("yaw", t), np.zeros(len(t))
    four = dict(zip(names, (np.cos(half), still, still, np.sin(half)), strict=True))
    columns = {"time": t, **four, "pos_x": car.at("X", t), "pos_y": car.at("Y", t), "gyro_z": car.at("r", t)}
    draft, _ = drafted(columns)
    assert draft.of("yaw").sources == (*names[1:], names[0]) and draft.of("yaw").status == "unsided"


@pytest.mark.parametrize(
    ("stated", "tick", "first", "seconds"),
    [
        ("ms", 100.0, 0.0, 1e-3),  # as stated, though steps of 100 ms are few a second
        (None, 10.0, 1.7e12, 1e-3),
        ("1/min", 10.0, 1.7e12, 1e-3),  # a unit that is none of time says nothing
        ("", 2e5, 133_600_000_000_000_000, 1e-7),
        ("sec", 0.01, 0.0, 1.0),
        (None, 0.01, 5.0, 1.0),
    ],
)
def test_a_tick_is_as_long_as_stated_or_as_steps_tell(stated, tick, first, seconds):
    assert seconds_a_tick(first + tick * np.arange(500.0), stated) == pytest.approx(seconds)


def test_a_struct_whose_time_counts_ticks_of_windows_is_as_long_as_it_was(tmp_path):
    """Its clock was taken for seconds: a drive of 40 s lasted for twelve years."""
    t = np.arange(0.0, 40.0, 0.02)
    ticks = 621_355_968_000_000_000.0 + 1e7 * (1_718_000_000.0 + t)
    savemat(tmp_path / "log.mat", {"car": {"time": ticks, "v_x": 10.0 + t}, "imu": {"time": ticks[::2], "r": t[::2]}})
    recording = open_recording(tmp_path / "log.mat")
    time = recording.read(["car.v_x"])["car.v_x"].time
    assert np.ptp(time) == pytest.approx(np.ptp(t), abs=1e-4)


@pytest.mark.parametrize("epoch", [116_444_736_000_000_000, 621_355_968_000_000_000], ids=["1601", "year 1"])
def test_ticks_of_windows_are_tenths_of_microseconds(epoch, car, drafted):
    """They were taken for microseconds: a drive of ten times its length, and nothing said so."""
    t = np.arange(0.0, 40.0, 0.02)
    ticks = epoch + 10_000_000 * 1_718_000_000 + np.rint(1e7 * t).astype(np.int64)
    assert unit_of_time(ticks.astype(float)) == "0.1us"
    columns = {"timestamp": ticks.astype(float), "v": car.at("vx", t), "r": car.at("r", t)}
    draft, _ = drafted(columns, fmt="%.18g")
    assert draft.time == "time: {source: timestamp, unit: 0.1us}"
