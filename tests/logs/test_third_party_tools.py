"""Logs as tools write them: coordinates in words, spans of time, a speed in several units, names of CAN."""

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import assemble_drive
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.drive import read_drive, write_drive
from split_cli.logs.readers.cells import degrees_of, seconds_of
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from tests.logs.planted import UNITS
from tests.logs.test_third_party_exports import ingested
from tests.logs.test_third_party_styles import DEG

MPH = 0.44704


def write(path, columns: dict[str, object], separator: str = ",", decimal: str = ".") -> None:
    cells = [[x if isinstance(x, str) else f"{x:.9g}" for x in values] for values in columns.values()]
    lines = [separator.join(columns), *(separator.join(row) for row in zip(*cells, strict=True))]
    path.write_text("\n".join(lines).replace(".", decimal) if decimal != "." else "\n".join(lines))


@pytest.mark.parametrize(
    ("cell", "degrees"),
    [
        ("52°06.6000' N", 52.11),
        ("52° 6' 36\" S", -52.11),
        ("E 11° 18,0'", 11.3),
        ("11.3° W", -11.3),
        ("52°06.6'", np.nan),  # of which half of the globe?
        ("11° 18' O", np.nan),  # east in German, west in French
        ("12 N", 12.0),
    ],
)
def test_a_coordinate_in_words_has_the_half_of_the_globe_that_it_names(cell, degrees):
    np.testing.assert_allclose(degrees_of(cell), degrees, rtol=1e-12)


def test_a_span_of_time_is_read_in_seconds():
    assert [seconds_of(cell) for cell in ("0 sec", "1.5 sec", "2 min", "0.5 hr")] == [0.0, 1.5, 120.0, 1800.0]


def test_positions_in_degrees_and_minutes_tell_the_sides_of_slip_and_turning(planted, tmp_path):
    t = np.arange(0.0, 60.0, 0.02)
    c = {name: planted.at(name, t) for name in ("X", "Y", "yaw", "vx", "vy", "r")}
    # One minute of latitude is 1855.3 m at 52 degrees north, one of longitude 1145.4 m (WGS 84).
    north, east = 6.0 + c["Y"] / 1854.5, 18.0 + c["X"] / 1144.9
    write(
        tmp_path / "vbox.csv",
        {
            "Time (s)": t,
            "Latitude": [f"52°{v:010.7f}' N" for v in north],
            "Longitude": [f"011°{v:010.7f}' E" for v in east],
            "Speed (km/h)": c["vx"] * 3.6,
            "True Heading (°)": np.mod(90.0 - c["yaw"] * DEG, 360.0),
            "Yaw Rate (°/s)": -c["r"] * DEG,
            "Slip Angle (°)": np.arctan2(c["vy"], c["vx"]) * DEG,
            "Brake Switch": (np.sin(t) > 0.8).astype(int),
        },
    )
    draft = draft_map(open_recording(tmp_path / "vbox.csv"))
    assert draft.of("X").status == draft.of("r").status == draft.of("sideslip").status == "judged"
    assert draft.of("r").scale == -1.0 and draft.of("sideslip").scale == 1.0
    assert draft.of("brake").status == "open" and "a switch" in draft.of("brake").reason


def test_three_columns_called_speed_tell_each_others_units(planted, tmp_path):
    """Nothing else judges v_x: with one of them taken in m/s, that in mph would be read 2.2 times too large."""
    t = np.arange(0.0, 60.0, 0.02)
    vx = planted.at("vx", t)
    columns = {
        "Time": [f"{x:.5g} sec" for x in t],
        "Speed": vx / MPH,
        " Speed": vx,
        "Speed ": vx * 3.6,
        "Lateral Velocity": planted.at("vy", t),
        "Yaw Rate": planted.at("r", t),
        "Road Wheel Angle": planted.at("delta", t),
        "Wheel Torque": planted.at("T", t),
    }
    write(tmp_path / "log.csv", columns)
    draft = ingested(tmp_path / "log.csv", planted, tmp_path)
    assert draft.time == "time: {source: Time, unit: s}" and "multiples" in draft.of("vx").reason


@pytest.mark.parametrize(("down", "forward"), [(True, 0), (False, 0), (False, 1)])
def test_gravity_along_z_tells_of_a_right_handed_sensor_where_y_points(down, forward, planted, tmp_path):
    """An autopilot's x, y, z are forward, right, down; a phone's may be right, forward, up."""
    t = np.arange(0.0, 60.0, 0.02)
    ax, ay, to_left = planted.at("ax", t), planted.at("ay", t), -1.0 if down or forward == 1 else 1.0
    along, across = f"accelerometer_m_s2[{forward}]", f"accelerometer_m_s2[{1 - forward}]"
    columns = {
        "Time": t,
        "Speed [m/s]": planted.at("vx", t),
        along: ax,
        across: to_left * ay,
        "accelerometer_m_s2[2]": 0.0 * t + (-9.7 if down else 9.7) + 0.1 * np.sin(t),
        "yaw_rate [rad/s]": to_left * planted.at("r", t),
    }
    write(tmp_path / "log.csv", columns)
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.of("ay").sources == (across,) and draft.of("ay").scale == 1.0
    assert ("right-positive" if to_left < 0.0 else "left-positive") in draft.by_gravity
    assert ("frame: frd" in draft.by_gravity) == (to_left < 0.0)


def test_elements_of_arrays_beside_the_channels_are_kept_and_read_again(planted, tmp_path):
    t = np.arange(0.0, 20.0, 0.02)
    names = {c: f"{c} [{UNITS[c]}]" for c in ("vx", "vy", "r", "delta", "T")}
    beside = {"q[0]": np.cos(t), "q[1]": np.sin(t)}
    write(tmp_path / "log.csv", {"t": t, **{names[c]: planted.at(c, t) for c in names}, **beside})
    found = map_from_mapping({"time": {"source": "t"}, "channels": {c: {"source": c} for c in names}})
    made = assemble_drive(open_recording(tmp_path / "log.csv"), found, planted.vehicle)
    write_drive(made.drive, tmp_path / "drive.parquet")
    again = read_drive(tmp_path / "drive.parquet")
    np.testing.assert_array_equal(again.columns["q[1]"], made.drive.columns["q[1]"])
    assert {"q[0]", "q[1]"} <= set(again.columns)


def test_a_bearing_of_a_satellite_receiver_is_no_yaw_where_nothing_measured_turning(planted, tmp_path):
    """It passed for yaw in a lap timer's log: a v_y derived from the direction of travel is zero."""
    t = np.arange(0.0, 60.0, 0.05)
    c = {name: planted.at(name, t) for name in ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay")}
    course = 90.0 - (c["yaw"] + np.arctan2(c["vy"], c["vx"])) * DEG
    columns = {
        "TIME": t,
        "LATITUDE": 48.0 + c["Y"] / 111200.0,
        "LONGITUDE": 11.0 + c["X"] / 74560.0,
        "SPEED_KMH": c["vx"] * 3.6,
        "HEADING_DEG": np.mod(course, 360.0),
        "LATERAL_G": c["ay"] / 9.80665,
    }
    write(tmp_path / "lap.csv", columns)
    draft = draft_map(open_recording(tmp_path / "lap.csv"))
    assert draft.of("yaw").status == "open" and "derived from a course is zero" in draft.of("yaw").reason
    # A gyro beside it judges: the same column is a yaw, or shows no slip of tyres and is none.
    columns |= {"YAW_RATE_DPS": c["r"] * DEG, "HEADING_DEG": np.mod(90.0 - c["yaw"] * DEG, 360.0)}
    write(tmp_path / "lap.csv", columns)
    assert draft_map(open_recording(tmp_path / "lap.csv")).of("yaw").status == "judged"


@pytest.mark.parametrize(("name", "status"), [("Torque (Nm)", "assumed"), ("Wheel Torque (Nm)", "judged")])
def test_a_torque_beside_an_engine_speed_may_be_the_engines(planted, tmp_path, name, status):
    """At one gear a third of the wheels' torque goes with the acceleration as well as all of it."""
    t = np.arange(0.0, 60.0, 0.05)
    c = {channel: planted.at(channel, t) for channel in ("vx", "vy", "r", "T")}
    columns = {"t": t, "Speed (m/s)": c["vx"], "vy": c["vy"], "r": c["r"], name: c["T"] / 3.0}
    write(tmp_path / "game.csv", columns | {"Engine rpm": c["vx"] * 95.0})
    torque = draft_map(open_recording(tmp_path / "game.csv")).of("T")
    assert torque.status == status and ("gear ratio" in torque.reason) == (status == "assumed")
    write(tmp_path / "game.csv", columns)  # without an engine there is no gearbox to ask of
    assert draft_map(open_recording(tmp_path / "game.csv")).of("T").status == "judged"
