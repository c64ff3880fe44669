"""Logs whose axes, clocks or names mislead: velocities of the world, two odometries, right for left."""

import numpy as np
import pytest
import yaml

from split_cli.logs.assembling.assemble import assemble_drive
from split_cli.logs.checking.consistency import check_consistency
from split_cli.logs.drafting.draft import quoted
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.raw import RawSignal, TableRecording, time_column, unit_of_time
from split_cli.logs.readers.joint import JointRecording
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from tests.factories import one_run
from tests.logs.planted import PlantedDrive, planted_map
from tests.logs.test_third_party_styles import DEG, G, Style, bearing, compare, degrees_of, written
from tests.optional import needed

CHANNELS = ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay", "delta", "T")


def drafted(style: Style, planted: PlantedDrive, tmp_path):
    written(style, planted, tmp_path / "log.csv")
    return draft_map(open_recording(tmp_path / "log.csv"))


def of_the_world(c) -> tuple[np.ndarray, np.ndarray]:
    """Velocity along east and north."""
    cos, sin = np.cos(c["yaw"]), np.sin(c["yaw"])
    return c["vx"] * cos - c["vy"] * sin, c["vx"] * sin + c["vy"] * cos


RIGHT = {
    "an inertial unit's export, all to the right": Style(
        lambda t, c: {
            "Time (GPS s)": 345600 + t,
            "PosLat (deg)": degrees_of(c)[0],
            "PosLon (deg)": degrees_of(c)[1],
            "VelForward (m/s)": c["vx"],
            "VelLateral (m/s)": -c["vy"],
            "AngleHeading (deg)": bearing(c),
            "AngularRateZ (deg/s)": -c["r"] * DEG,
            "AccelX (m/s²)": c["ax"],
            "AccelY (m/s²)": -c["ay"],
            "AngleSlip (deg)": np.arctan2(-c["vy"], c["vx"]) * DEG,
        }
    ),
    "no compass, but satellites": Style(
        lambda t, c: {
            "Time": t,
            "Ground Speed [km/h]": c["vx"] * 3.6,
            "G Force Lat [g]": -c["ay"] / G,
            "Gyro Yaw Velocity [deg/s]": -c["r"] * DEG,
            "Body Slip Angle [deg]": -np.arctan2(c["vy"], c["vx"]) * DEG,
            "GPS Latitude [deg]": degrees_of(c)[0],
            "GPS Longitude [deg]": degrees_of(c)[1],
        }
    ),
    "a compass, but no satellites": Style(
        lambda t, c: {
            "Time": t,
            "VelForward (m/s)": c["vx"],
            "Heading (deg)": bearing(c),
            "AngularRateZ (deg/s)": -c["r"] * DEG,
            "AccelY (m/s²)": -c["ay"],
        }
    ),
    "names of a driving-assistance dataset": Style(
        lambda t, c: {
            "timestamp": t,
            "lat": degrees_of(c)[0],
            "lon": degrees_of(c)[1],
            "yaw": c["yaw"],
            "vn": of_the_world(c)[1],
            "ve": of_the_world(c)[0],
            "vf": c["vx"],
            "vl": c["vy"],
            "ax": c["ax"],
            "ay": c["ay"],
            "wz": c["r"],
        }
    ),
}


@pytest.mark.parametrize("name", RIGHT)
def test_satellites_or_a_compass_tell_left_from_right(name, planted, tmp_path):
    draft = drafted(RIGHT[name], planted, tmp_path)
    assert [s for s in draft.suggestions if s.status == "open"] == []
    assert draft.left
    content = yaml.safe_load(render_draft(draft, "log.csv"))
    have = set(content["channels"])
    content["channels"].setdefault("vy", {"source": draft.of("vx").sources[0], "scale": 1e-9, "unit": "m/s"})
    content["channels"]["delta"] = {"source": draft.of("vx").sources[0], "scale": 1e-9, "unit": "rad"}
    content["channels"]["T"] = {"source": draft.of("vx").sources[0], "unit": "N m"}
    made = assemble_drive(open_recording(tmp_path / "log.csv"), map_from_mapping(content), planted.vehicle)
    style = Style(RIGHT[name].write, tolerances={"X": 2.0, "Y": 2.0, "sideslip": 3e-3})
    compare(made.drive.columns, planted, style, have)


def test_velocities_and_accelerations_of_the_world_are_left_open(planted, tmp_path):
    draft = drafted(
        Style(
            lambda t, c: {
                "timestamp": t,
                "location.x": c["X"],
                "location.y": c["Y"],
                "rotation.yaw": c["yaw"] * DEG,
                "velocity.x": of_the_world(c)[0],
                "velocity.y": of_the_world(c)[1],
                "acceleration.x": np.gradient(of_the_world(c)[0], 0.01),
                "acceleration.y": np.gradient(of_the_world(c)[1], 0.01),
                "angular_velocity.z": c["r"] * DEG,
            }
        ),
        planted,
        tmp_path,
    )
    opened = {s.channel: s.reason for s in draft.suggestions if s.status == "open"}
    assert set(opened) == {"vx", "vy", "ax", "ay"}
    assert all("axes of the world" in reason for reason in opened.values())
    assert draft.of("r").unit == "deg/s" and draft.of("r").status == "unsided"
    assert "# vx, vy: --derive velocity-from-pose" in render_draft(draft, "log.csv")


@pytest.mark.parametrize("hand", [1.0, -1.0])
@pytest.mark.parametrize("known", [("X", "Y"), ("yaw",), ("r",)])
def test_ingest_says_that_a_velocity_is_along_the_world(planted, hand, known):
    t = np.arange(0.0, 60.0, 0.01)
    c = {name: planted.at(name, t) for name in CHANNELS}
    noise = np.random.default_rng(3).normal(0.0, 0.05, (2, len(t)))
    east, north = np.stack(of_the_world(c)) + noise
    columns = {"t": t, "vx": east, "vy": hand * north, "delta": c["delta"], "T": c["T"]}
    columns |= {name: c[name] for name in ("r", *known)}
    kinds = {} if "r" in known else {"r": "derived: nothing"}
    drive = one_run(columns, 0.01, "log")
    findings = check_consistency(drive, planted.vehicle, kinds).findings
    assert [(f.check, f.channel) for f in findings] == [("world", "vx"), ("world", "vy")]


def test_a_car_that_drifts_with_half_a_radian_of_sideslip_is_along_its_own_axes(planted):
    t = np.arange(0.0, 60.0, 0.01)
    r = planted.at("r", t)
    speed, slip = planted.at("vx", t), -0.5 * r / np.max(np.abs(r))
    columns = {"vx": speed * np.cos(slip), "vy": speed * np.sin(slip), "r": r}
    drive = one_run(columns, 0.01, "log")
    kinds = {"delta": "derived: nothing", "T": "derived: nothing"}
    assert not [f for f in check_consistency(drive, None, kinds).findings if f.check == "world"]


def test_where_nothing_tells_left_from_right_the_draft_says_so(planted, tmp_path):
    def mirrored(t, c):
        """A game: y to the south, all turning the other way round, nothing else wrong."""
        return {
            "time": t,
            "loc_x": c["X"],
            "loc_y": -c["Y"],
            "yaw_deg": -c["yaw"] * DEG,
            "vx": c["vx"],
            "vy": -c["vy"],
            "gyro_z": -c["r"],
            "ay": -c["ay"],
        }

    draft = drafted(Style(mirrored), planted, tmp_path)
    assert draft.left == ""
    assert "CHECK left and right" in render_draft(draft, "log.csv")
    # Sizes agree, so that r would pass as judged; its side is not.
    assert {draft.of(c).status for c in ("X", "Y", "yaw", "r", "ay", "vy")} == {"unsided"}
    assert draft.of("vx").status == "judged"


def test_columns_called_e_and_n_tell_left_from_right_whatever_their_unit(planted, tmp_path):
    def write(t, c):
        return {
            "t": t,
            "speed_mps": c["vx"],
            "yaw_rate": c["r"],
            "pos_e_ft": c["X"] / 0.3048,
            "pos_n_ft": c["Y"] / 0.3048,
        }

    draft = drafted(Style(write), planted, tmp_path)
    assert draft.left == "east and north" and draft.of("X").unit == "ft"


def test_a_course_by_name_is_yaw_only_where_the_sideslip_is_seen(planted, tmp_path):
    def write(with_vy, t, c):
        course = np.mod(bearing(c) - np.arctan2(c["vy"], c["vx"]) * DEG, 360.0)
        lateral = {"vy": c["vy"]} if with_vy else {}
        return {
            "t": t,
            "GPS Speed [m/s]": c["vx"],
            "GPS Heading [deg]": course,
            "lat": degrees_of(c)[0],
            "lon": degrees_of(c)[1],
            "yaw_rate": c["r"],
            **lateral,
        }

    for with_vy in (True, False):
        draft = drafted(Style(lambda t, c, v=with_vy: write(v, t, c)), planted, tmp_path)
        yaw = draft.of("yaw") or draft.of("course")
        assert yaw.status == "open" and "course over ground" in yaw.reason


def test_an_angle_called_the_steering_wheels_is_the_road_wheels_by_its_size(planted, tmp_path):
    def write(ratio, t, c):
        return {"t": t, "vx": c["vx"], "yaw_rate": c["r"], "SteerAngleWheel": ratio * c["delta"], "ay": c["ay"]}

    road = drafted(Style(lambda t, c: write(1.0, t, c)), planted, tmp_path)
    assert road.of("delta").status == "unsided" and road.of("steering_wheel_angle") is None
    hand = drafted(Style(lambda t, c: write(-15.0, t, c)), planted, tmp_path)
    assert hand.of("delta").status == "open"
    assert hand.of("steering_wheel_angle").scale == -1.0


def test_torque_is_judged_by_the_acceleration(planted, tmp_path):
    def write(torque, t, c):
        return {"t": t, "vx": c["vx"], "vy": c["vy"], "yaw_rate": c["r"], "torque [Nm]": torque(c)}

    made = drafted(Style(lambda t, c: write(lambda c: c["T"], t, c)), planted, tmp_path).of("T")
    assert made.status == "judged"
    size = planted.vehicle.mass * planted.vehicle.wheel_radius
    assert float(made.reason.split()[0]) == pytest.approx(size, rel=0.1)
    of_the_hand = drafted(Style(lambda t, c: write(lambda c: 50.0 * c["delta"], t, c)), planted, tmp_path).of("T")
    assert of_the_hand.status == "assumed" and "is it the torque at the wheels?" in of_the_hand.reason


def test_x_and_y_come_from_one_odometry_and_r_from_what_measures_it(planted):
    t = np.arange(0.0, 60.0, 0.01)
    c = {name: planted.at(name, t) for name in CHANNELS}
    signals, zero = {}, 0.0 * t

    def topic(name, **fields):
        for field, values in fields.items():
            path = f"/{name}/{field.replace('__', '.')}"
            signals[path] = RawSignal(path, t, values)

    # The odometry of the motor runs on a wrong radius, has no v_y, and computes its yaw rate from the servo.
    topic(
        "motor/odom",
        pose__position__x=1.3 * c["X"],
        pose__position__y=1.3 * c["Y"],
        twist__linear__x=c["vx"],
        twist__linear__y=zero,
        twist__angular__z=c["vx"] * np.tan(c["delta"]) / planted.vehicle.wheelbase,
    )
    topic("filter/odom", pose__position__x=c["X"], pose__position__y=c["Y"])
    topic("imu", angular_velocity__z=c["r"] * DEG, linear_acceleration__y=c["ay"] / G)
    draft = draft_map(TableRecording("bag", None, signals, clocks=("header",)))
    assert draft.of("X").sources[0].startswith("/filter") and draft.of("Y").sources[0].startswith("/filter")
    assert draft.of("r").sources == ("/imu/angular_velocity.z",)
    assert draft.of("r").unit == "deg/s" and draft.of("ay").unit == "g"


def test_files_with_epochs_in_nanoseconds_are_one_drive(planted, tmp_path):
    t = np.arange(0.0, 20.0, 0.01)
    stamps = np.char.mod("%d", (1.7e18 + 1e9 * t).astype(np.int64))
    for name, channels in (("imu", ("r", "ay")), ("can", ("vx", "delta", "T", "vy"))):
        rows = np.stack([stamps, *(np.char.mod("%.9g", planted.at(c, t)) for c in channels)], axis=1)
        text = "\n".join([",".join(("timestamp", *channels)), *map(",".join, rows)])
        (tmp_path / f"{name}.csv").write_text(text + "\n")
    joined = JointRecording([open_recording(tmp_path / f"{name}.csv") for name in ("imu", "can")])
    made = assemble_drive(joined, planted_map(("r", "vx", "vy", "delta", "T")), planted.vehicle)
    assert made.drive.period == pytest.approx(0.01, rel=1e-4)
    assert any("taken as time in ns" in note.what for note in joined.notes)


def test_columns_inside_structures_of_parquet_are_read(tmp_path):
    pa = needed("pyarrow")
    import pyarrow.parquet as pq

    rng = np.random.default_rng(5)
    x, z = rng.normal(size=(2, 50))
    gyro = pa.StructArray.from_arrays([pa.array(z)], ["z"])
    imu = pa.StructArray.from_arrays([pa.array(x), gyro], ["acc_x", "gyro"])
    pq.write_table(pa.table({"t": np.arange(50.0), "imu": imu}), tmp_path / "log.parquet")
    recording = open_recording(tmp_path / "log.parquet")
    assert [info.name for info in recording.channels()] == ["t", "imu.acc_x", "imu.gyro.z"]
    read = recording.read(["imu.gyro.z", "imu.acc_x"])
    np.testing.assert_array_equal(read["imu.gyro.z"].values, z)
    np.testing.assert_array_equal(read["imu.acc_x"].values, x)


@pytest.mark.parametrize("name", ["vVeh\\ETKC:1", 'a "quoted" name', "tab\there", "Größe [m/s]", "plain_name", "1st"])
def test_any_name_survives_the_map(name):
    assert yaml.safe_load(f"{{source: {quoted(name)}}}") == {"source": name}


def test_a_counter_of_rows_is_no_clock_and_a_clock_tells_its_unit():
    infos = [RawSignal(name, None, np.zeros(3)) for name in ("time_step", "time step", "frame", "vx")]
    channels = TableRecording("log", None, {s.name: s for s in infos}).channels()
    assert time_column(channels) is None
    for name in ("frame_time", "step_timestamp_ns"):
        one = TableRecording("log", None, {name: RawSignal(name, None, np.zeros(3))}).channels()
        assert time_column(one).name == name
    for unit, size in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        assert unit_of_time(1.7e9 * size + np.arange(500) * 0.01 * size) == unit


@pytest.mark.parametrize(
    ("offset", "turned", "mirrored", "sure"),
    [(3000.0, 0.0, False, True), (0.0, 0.5, False, False), (0.0, 0.0, True, False)],
    ids=["east and north from elsewhere", "a frame of its own", "a game's, all to the right"],
)
def test_x_and_y_that_run_along_a_satellite_fix_tell_left_from_right(planted, tmp_path, offset, turned, mirrored, sure):
    """A log with X, Y and latitude, longitude was said to hold no satellite fix: the pair that is not mapped counts."""

    def write(t, c):
        side = -1.0 if mirrored else 1.0
        rotation = np.exp(1j * turned)
        place = offset + rotation * (c["X"] + 1j * c["Y"])
        return {
            "t": t,
            "x": place.real,
            "y": side * place.imag,
            "psi": side * (c["yaw"] + turned),
            "lat": degrees_of(c)[0],
            "lon": degrees_of(c)[1],
            "vx": c["vx"],
            "vy": side * c["vy"],
            "wz": side * c["r"],
        }

    draft = drafted(Style(write), planted, tmp_path)
    assert draft.of("X").sources == ("x",)
    assert draft.left == ("the satellite fix that X, Y run along" if sure else "")
    assert draft.of("r").status == ("judged" if sure else "unsided")
