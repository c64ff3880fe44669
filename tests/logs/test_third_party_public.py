"""Faults first seen in logs of public projects, planted: clocks that start again, other axes, cells of dashes."""

import numpy as np
import pytest

from split_cli.errors import MapError
from split_cli.logs.drafting.draft import Draft
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.delimited import open_delimited
from split_cli.logs.readers.opening import open_recording
from split_cli.workflows.ingesting.ingest import ingest_logs
from tests.logs.planted import write_table
from tests.logs.test_third_party_styles import DEG, G, Style, written
from tests.optional import needed

CHANNELS = ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay", "delta", "T")


def drafted(write, planted, tmp_path) -> Draft:
    written(Style(write), planted, tmp_path / "log.csv")
    return draft_map(open_recording(tmp_path / "log.csv"))


def drafted_table(columns: dict[str, np.ndarray], tmp_path, **how: str) -> Draft:
    write_table(tmp_path / "log.csv", columns, **how)
    return draft_map(open_recording(tmp_path / "log.csv"))


def test_runs_one_behind_the_other_are_judged_run_by_run(planted, tmp_path):
    """The clock starts again three times; a rate differenced from a wrapped angle must not win."""
    rng = np.random.default_rng(3)

    def write(t, c):
        start_again = np.minimum.reduce([np.where(t >= s, t - s, np.inf) for s in (0.0, 13.0, 31.0, 44.0)])
        differenced = np.gradient(np.angle(np.exp(1j * c["yaw"])), 0.01)
        differenced[np.flatnonzero(np.diff(start_again) < 0)] = 900.0
        vx = c["vx"].copy()
        vx[3000] = 6000.0
        return {
            "t": start_again,
            "pose_x": c["X"],
            "pose_y": c["Y"],
            "yaw": np.angle(np.exp(1j * c["yaw"])),
            "velocity_vehicle_x": vx,
            "velocity_vehicle_y": c["vy"],
            "angular_velocity_from_yaw": differenced + 0.3 * rng.standard_normal(len(t)),
            "yaw_rate": c["r"] * DEG,
            "accx": c["ax"] / G,
            "accy": c["ay"] / G,
        }

    draft = drafted(write, planted, tmp_path)
    assert draft.of("r").sources == ("yaw_rate",) and draft.of("r").unit == "deg/s"
    assert draft.of("ax").unit == "g" and draft.of("ay").unit == "g"
    supported = {s.channel for s in draft.suggestions if s.status in ("judged", "unsided")}
    assert supported >= {"vx", "vy", "r", "yaw", "X", "Y", "ax", "ay"}


def test_a_rival_of_the_wrong_size_is_left_open_instead_of_one_that_does_not_turn_with_the_car(planted, tmp_path):
    """The change of v_y alone is no lateral acceleration; that of the sensor reads 30 % too much."""
    draft = drafted(
        lambda t, c: {
            "t": t,
            "vx": c["vx"],
            "vy": c["vy"],
            "yaw": c["yaw"],
            "yaw_rate": c["r"] * DEG,
            "accx": c["ax"],
            "accy": 1.3 * c["ay"],
            "acc_vehicle_y": np.gradient(c["vy"], 0.01),
        },
        planted,
        tmp_path,
    )
    found = draft.of("ay")
    assert found.sources == ("accy",) and found.status == "open"
    assert float(found.reason.split(" is ")[1].split()[0]) == pytest.approx(1.3, rel=0.01)


def test_a_game_with_y_up_is_read_along_its_own_axes(planted, tmp_path):
    """x to the right, y up, z forward: the velocity along x is small, and the car turns about y."""
    rng = np.random.default_rng(4)

    def write(t, c):
        shake = 0.02 * np.sin(9.0 * t) + 0.005 * rng.standard_normal(len(t))
        return {
            "TimestampMS": 1e3 * t,
            "AccelerationX": -c["ay"],
            "AccelerationY": 5.0 * shake,
            "AccelerationZ": c["ax"],
            "VelocityX": -c["vy"],
            "VelocityY": shake,
            "VelocityZ": c["vx"],
            "AngularVelocityX": shake,
            "AngularVelocityY": -c["r"],
            "AngularVelocityZ": 0.5 * shake,
            "PositionX": -c["Y"],
            "PositionY": 170.0 + shake,
            "PositionZ": c["X"],
            "Speed": c["vx"],
            "Yaw": -c["yaw"],
            "TireSlipAngleFrontLeft": 0.5 * c["delta"],
            "TireSlipAngleFrontRight": 0.5 * c["delta"],
            "Torque": c["T"] / 12.0,
            "WheelRotationSpeedFrontLeft": c["vx"] / 0.35,
        }

    draft = drafted(write, planted, tmp_path)
    taken = {c: draft.of(c).sources[0] for c in ("vx", "vy", "r", "ax", "ay")}
    assert taken == {
        "vx": "VelocityZ",
        "vy": "VelocityX",
        "r": "AngularVelocityY",
        "ax": "AccelerationZ",
        "ay": "AccelerationX",
    }
    assert {draft.of(c).sources[0] for c in "XY"} == {"PositionX", "PositionZ"}
    assert all(draft.of(c).status in ("judged", "unsided") for c in taken)
    wheel = draft.of("wheel_speed_fl")
    assert wheel.unit == "rad/s" and "0.35 m radius" in wheel.reason
    # The slip angle of a tyre is no steer angle.
    assert draft.of("delta") is None or "Slip" not in draft.of("delta").sources[0]


def test_a_sensor_on_its_side_is_read_along_the_car(planted, tmp_path):
    """x down and y backward: the axis that turns is up, the one that goes with the speed is forward."""
    rng = np.random.default_rng(5)

    def write(t, c):
        shake = 0.01 * rng.standard_normal(len(t))
        return {
            "Time": t,
            "Speed [m/s]": c["vx"],
            "Heading [deg]": np.mod(90.0 - c["yaw"] * DEG, 360.0),
            "AccelerationX [m/s^2]": -G + shake,
            "AccelerationY [m/s^2]": -c["ax"] + shake,
            "AccelerationZ [m/s^2]": -c["ay"] + shake,
            "AngularRateX [deg/s]": -c["r"] * DEG + shake,
            "AngularRateY [deg/s]": 1.5 + shake,
            "AngularRateZ [deg/s]": shake,
        }

    draft = drafted(write, planted, tmp_path)
    assert draft.of("r").sources == ("AngularRateX",) and draft.of("r").scale == -1.0
    assert "z is not up" in draft.of("r").reason
    assert draft.of("ax").sources == ("AccelerationY",) and draft.of("ax").scale == -1.0
    assert draft.of("ay").sources == ("AccelerationZ",) and draft.of("ay").scale == -1.0


def test_axes_stay_as_named_where_the_car_hardly_turns(tmp_path):
    """On a straight the bias of a gyroscope's other axes is more than the yaw rate."""
    rng = np.random.default_rng(6)
    t = np.arange(0.0, 60.0, 0.02)
    vx = 20.0 + 3.0 * np.sin(0.2 * t)
    columns = {
        "t": t,
        "vx": vx,
        "gyro_x": 0.03 + 0.004 * rng.standard_normal(len(t)),
        "gyro_y": -0.02 + 0.004 * rng.standard_normal(len(t)),
        "gyro_z": 0.004 * rng.standard_normal(len(t)),
    }
    assert drafted_table(columns, tmp_path).of("r").sources == ("gyro_z",)


def test_gravity_along_z_says_that_z_is_up_where_the_car_pitches_more_than_it_yaws(tmp_path):
    """A freeway: hardly a bend, and long waves of the road."""
    t = np.arange(0.0, 120.0, 0.02)
    columns = {
        "t": t,
        "gyro_x_radps": 0.001 * np.sin(0.9 * t),
        "gyro_y_radps": 0.02 * np.sin(0.5 * t),
        "gyro_z_radps": 0.002 * np.sin(0.1 * t),
        "acc_x": 0.5 * np.sin(0.2 * t),
        "acc_y": 0.05 * np.sin(0.1 * t),
        "acc_z": -G + 0.3 * np.sin(7.0 * t),
    }
    draft = drafted_table(columns, tmp_path)
    assert {c: draft.of(c).sources[0] for c in ("r", "ax", "ay")} == {"r": "gyro_z_radps", "ax": "acc_x", "ay": "acc_y"}
    # Without them nothing speaks against the turning; the side is then asked for, with the reason.
    draft = drafted_table({name: v for name, v in columns.items() if "acc" not in name}, tmp_path)
    assert draft.of("r").status == "open" and draft.of("r").reason.startswith("gyro_y_radps turns 7.52 times")


def test_understeer_at_speed_does_not_make_a_steering_wheel_of_a_road_wheel(tmp_path):
    """At 60 m/s this car needs five times the angle: 33 m of steering wheel over curvature, in radians."""
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 300.0, 0.05)
    vx = 35.0 + 27.0 * np.sin(2.0 * np.pi * t / 60.0)
    ay = 6.0 * np.sin(2.0 * np.pi * t / 11.0) + 2.0 * np.sin(2.0 * np.pi * t / 3.7)
    curvature = ay / vx**2
    hand = 12.4 * (2.65 + 0.0045 * vx**2) * curvature + 0.002 * rng.standard_normal(len(t))
    draft = drafted_table({"time": t, "delta_D": hand, "u": vx, "ay": ay}, tmp_path)
    wheel, road = draft.of("steering_wheel_angle"), draft.of("delta")
    assert wheel.unit == "rad" and road.status == "open"
    assert float(road.reason.split("its ratio: ")[1].split(" m")[0]) == pytest.approx(12.4 * 2.65, rel=0.05)


def test_a_phone_that_writes_dashes_and_two_kinds_of_date_is_read(tmp_path):
    """Most cells are dashes until a sensor answers; the satellite's time is written as programs print it."""
    rows = ["GPS Time, Device Time, GPS Speed (Meters/second),Boost(psi),G(x),Torque(Nm),Engine Torque(Nm)"]
    for n in range(400):
        minute, second = divmod(n, 60)
        phone = f"03-Mar-2025 07:{10 + minute:02}:{second:02}.250"
        spoken = f"Mon Mar 03 07:{10 + minute:02}:{second:02} GMT+01:00 2025" if n >= 3 else "-"
        speed = f"{10.0 + 5.0 * np.sin(0.05 * n):.4f}" if n >= 3 else "-"
        torque = f"{3.0 * np.cos(0.05 * n):.3f}"
        rows.append(f"{spoken},{phone},{speed},-,-,{torque},{torque}")
        rows += [""] if n == 5 else []
    (tmp_path / "track.csv").write_text("\n".join(rows) + "\n")
    recording = open_delimited(tmp_path / "track.csv")
    time = recording.read(["GPS Time"])["GPS Time"].values
    # 07:10:03 at one hour east of Greenwich.
    assert time[3] == 1740982203.0 and np.isnan(time[0]) and np.all(np.diff(time[3:]) == 1.0)
    draft = draft_map(recording)
    assert draft.of("vx").sources == ("GPS Speed",) and draft.of("engine_torque").status == "open"
    assert draft.time.startswith("time: {source: GPS Time")


@pytest.mark.parametrize(
    ("cell", "seconds"),
    [
        ("Wed Feb  3 06:51:06 2021", 1612335066.0),
        ("Thu Sep 09 06:51:06.5 CEST 2021", 1631170266.5),
        ("Wed Feb 23 06:51:06 GMT+08:00 2022", 1645570266.0),
    ],
)
def test_dates_as_programs_print_them(cell, seconds, tmp_path):
    text = "when,v\n" + "\n".join(f"{cell},{n}" for n in range(5)) + "\n"
    (tmp_path / "log.csv").write_text(text)
    assert open_delimited(tmp_path / "log.csv").read(["when"])["when"].values[0] == seconds


def test_a_tilted_sensor_is_left_open_by_what_it_reads_at_rest(tmp_path):
    """A phone on its edge, at a rate too slow for any other check."""
    t = np.arange(0.0, 400.0, 1.0)
    v = np.clip(10.0 * np.sin(0.05 * t), 0.0, None)
    rng = np.random.default_rng(9)
    columns = {
        "time [s]": t,
        "speed [m/s]": v,
        "acc_x [g]": 0.02 * rng.standard_normal(len(t)),
        "acc_y [g]": 0.85 + 0.02 * rng.standard_normal(len(t)),
    }
    draft = drafted_table(columns, tmp_path)
    assert draft.of("ay").status == "open" and "gravity" in draft.of("ay").reason
    assert draft.of("ax").status == "open" and "acc_y" in draft.of("ax").reason
    level = drafted_table(columns | {"acc_y [g]": columns["acc_y [g]"] - 0.85}, tmp_path)
    assert level.of("ay").status == "stated" and level.of("ax").status == "stated"


def test_a_force_in_g_is_an_acceleration_and_no_position(tmp_path):
    t = np.arange(0.0, 30.0, 0.05)
    v = 12.0 + 4.0 * np.sin(0.5 * t)
    columns = {
        "Time": t,
        "Speed": v,
        "G-Force(X)": 2.0 * np.cos(0.5 * t) / G,
        "G-Force(Y)": 0.1 * np.sin(t),
        "Torque of motor": np.cos(t),
        "Slip (X)": np.sin(t),
    }
    draft = drafted_table(columns, tmp_path)
    assert draft.of("ax").sources == ("G-Force(X)",) and draft.of("ax").unit == "g"
    assert draft.of("ay").sources == ("G-Force(Y)",) and draft.of("X") is None


def test_an_acceleration_without_a_direction_is_tried_as_the_one_along(tmp_path):
    t = np.arange(0.0, 30.0, 0.05)
    columns = {
        "time": t,
        "speed": 3.6 * (12.0 + 4.0 * np.sin(0.5 * t)),
        "acc": 2.0 * np.cos(0.5 * t),
        "motor_torque": np.cos(t),
    }
    draft = drafted_table(columns, tmp_path)
    assert draft.of("ax").status == "judged" and draft.of("vx").unit == "km/h"
    assert draft.of("engine_torque").status == "open" and draft.of("T") is None


def test_a_bus_recording_of_can_beside_lin_asks_for_its_database(tmp_path):
    asammdf = needed("asammdf")
    path = tmp_path / "bus.mf4"
    file = asammdf.MDF(version="4.10")
    stamps = np.arange(0.0, 2.0, 0.01)
    names = (
        "CAN_DataFrame",
        "CAN_DataFrame.ID",
        "CAN_RemoteFrame.ID",
        "LIN_Frame.ID",
        "LIN_ChecksumError.ID",
        "LIN_ReceiveError.ID",
        "LIN_SyncError.BusChannel",
        "LIN_TransmissionError.ID",
    )
    file.append([asammdf.Signal(np.arange(200.0), stamps, name=name) for name in names])
    file.save(path, overwrite=True)
    from split_cli.errors import LogError

    with pytest.raises(LogError, match="--dbc"):
        open_recording(path)


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(1.0, "m/s"), (3.6, "km/h"), (1.0 / 0.31, "rad/s"), (30.0 / np.pi / 0.31, "rpm"), (0.5 / np.pi / 0.31, None)],
)
def test_four_wheels_without_a_unit_do_not_outvote_a_stated_speed(factor, unit, planted, tmp_path):
    """In turns per second four wheels agree with each other against speed and path."""
    t = np.arange(0.0, 60.0, 0.02)
    columns = {"t_s": t, "v_mps": planted.at("vx", t), "x_m": planted.at("X", t), "y_m": planted.at("Y", t)}
    columns |= {f"wheel_{corner}": factor * planted.at("vx", t) for corner in ("fl", "fr", "rl", "rr")}
    draft = drafted_table(columns, tmp_path)
    assert draft.of("vx").status == "judged" and draft.of("X").status == "judged"
    for corner in ("fl", "fr", "rl", "rr"):
        found = draft.of(f"wheel_speed_{corner}")
        if unit is None:
            assert found.status == "open" and "0.31 m radius" in found.reason
        else:
            assert found.unit == unit and found.status == ("judged" if unit in ("m/s", "km/h") else "assumed")


def test_a_column_of_steps_gives_the_period(planted, tmp_path):
    rng = np.random.default_rng(8)
    t = np.arange(0.0, 60.0, 0.02)
    columns = {
        "dt": np.full(len(t), 0.02),
        "vx": planted.at("vx", t),
        "ax": planted.at("ax", t),
        "vy": planted.at("vy", t),
    }
    even = drafted_table(columns, tmp_path)
    assert even.time.startswith("time: {period: 0.02}") and "dt holds the steps" in even.time
    # No step leads to the first row. What the column says goes before a rate that yaw would tell.
    columns |= {"yaw": planted.at("yaw", t), "r": planted.at("r", t)}
    columns["dt"] = np.where(t > 0.0, 0.02, 0.0)
    assert drafted_table(columns, tmp_path).time.startswith("time: {period: 0.02}")
    gap = np.where(np.arange(len(t)) == 900, 60.0, 0.02)
    for steps in (0.02 * rng.uniform(0.5, 1.5, len(t)), gap):
        uneven = drafted_table({**columns, "dt": steps}, tmp_path)
        assert uneven.time.startswith("# time") and "steps of unlike size" in uneven.time


@pytest.mark.parametrize("session", ["Run,7,Driver,12", "3,Session,1,Dry", "Lap,3,4,5"])
def test_a_session_row_half_of_numbers_is_no_row_of_values(session, tmp_path):
    values = "\n".join(f"{0.1 * n:.1f},{n % 5},{20 + n % 3},{n}" for n in range(40))
    (tmp_path / "log.csv").write_text(f"{session}\ntime,gear,speed,rpm\n{values}\n")
    recording = open_delimited(tmp_path / "log.csv")
    assert [info.name for info in recording.channels()] == ["time", "gear", "speed", "rpm"]
    np.testing.assert_allclose(recording.read(["time"])["time"].values, 0.1 * np.arange(40))


def test_a_word_in_the_first_row_of_values_costs_its_cell_alone(tmp_path):
    values = "\n".join(f"{0.1 * n:.1f},{20 + n % 3},{n}" for n in range(1, 40))
    (tmp_path / "log.csv").write_text(f"time,speed,rpm\n0.0,NoFix,0\n{values}\n")
    recording = open_delimited(tmp_path / "log.csv")
    speed = recording.read(["speed"])["speed"].values
    assert len(speed) == 40 and np.isnan(speed[0]) and not np.isnan(speed[1:]).any()
    assert [(note.what, note.count) for note in recording.notes] == [("cells that are no numbers, read as missing", 1)]


def test_logs_that_hold_a_part_each_are_pointed_to_together(planted, tmp_path):
    t = np.arange(0.0, 20.0, 0.02)
    halves = {"a": ("vx", "vy"), "b": ("r", "delta", "T")}
    for name, channels in halves.items():
        write_table(tmp_path / f"{name}.csv", {"t": t, **{c: planted.at(c, t) for c in channels}})
    entries = "".join(f"  {c}: {{source: {c}}}\n" for channels in halves.values() for c in channels)
    (tmp_path / "m.yaml").write_text(f"time: {{source: t, unit: s}}\nchannels:\n{entries}")
    logs = [tmp_path / "a.csv", tmp_path / "b.csv"]
    with pytest.raises(MapError, match="--together"):
        ingest_logs(logs, tmp_path / "out", maps=[tmp_path / "m.yaml"])
    assert not (tmp_path / "out").exists()
    ingest_logs(logs, tmp_path / "one.parquet", maps=[tmp_path / "m.yaml"], together=True)
    with pytest.raises(MapError, match="--topic: no source of the map is of 'odom'"):
        ingest_logs(logs, tmp_path / "x", maps=[tmp_path / "m.yaml"], together=True, topics={"odom": "/car/odom"})
    # Where the whole is not there either, nothing is promised.
    (tmp_path / "m.yaml").write_text(f"time: {{source: t, unit: s}}\nchannels:\n{entries}  ay: {{source: ay}}\n")
    with pytest.raises(MapError) as told:
        ingest_logs(logs, tmp_path / "out", maps=[tmp_path / "m.yaml"])
    assert "--together" not in str(told.value)
