"""Faults first seen in six more public logs: a phone, a lap timer, a student car, a data logger, a simulation."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import savemat

from split_cli.errors import LogError
from split_cli.logs.assembling.assemble import assemble_drive
from split_cli.logs.assembling.gather import gather
from split_cli.logs.checking.consistency import check_consistency
from split_cli.logs.drafting.naming import meanings, stated_unit
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.drive import Drive
from split_cli.logs.raw import RawChannelInfo
from split_cli.logs.readers import json_channels
from split_cli.logs.readers.clock_of_day import packed_clock
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.signals import STANDARD_GRAVITY, convert_to_si
from split_cli.workflows.ingesting.ingest import open_logs
from tests.logs.planted import PlantedDrive, write_table
from tests.logs.test_third_party_public import drafted_table


def packed(seconds: np.ndarray, scale: float) -> np.ndarray:
    """Return seconds since midnight as HHMMSS in one number, times `scale`."""
    hours, rest = np.divmod(np.mod(seconds, 86400.0), 3600.0)
    return np.round((hours * 10000.0 + rest // 60.0 * 100.0 + rest % 60.0) * scale, 3)


@pytest.mark.parametrize("scale", [1.0, 100.0, 1000.0])
def test_a_clock_in_one_number_is_read_as_seconds_across_minutes_hours_and_midnight(scale):
    seconds = 86400.0 - 125.0 + 0.1 * np.arange(3000)
    read = packed_clock(packed(seconds, scale))
    assert read == pytest.approx(seconds, abs=1e-6)


def test_a_count_of_seconds_a_distance_and_a_short_clock_are_no_clock_of_the_day():
    count = 0.1 * np.arange(9000)
    assert packed_clock(count) is None and packed_clock(1000.0 * count) is None
    # Within one minute nothing tells them apart, and the seconds are the same.
    assert packed_clock(packed(45000.0 + 0.1 * np.arange(300), 1.0)) is None
    # A row every two minutes skips the hundreds by chance.
    assert packed_clock(100.0 * np.arange(50) + 30.0) is None


def test_a_finer_clock_goes_before_one_whose_stamps_several_rows_share(tmp_path):
    """A phone writes the receiver's clock of 0.1 s beside milliseconds since 1970, 50 rows a second."""
    planted = PlantedDrive(seconds=59.0)
    t = np.arange(0.0, 59.0, 0.02)
    table = {"time": packed(45505.0 + np.floor(10.0 * t) / 10.0, 1000.0), "millis": 1395837505119.0 + 1000.0 * t}
    table |= {"speed [m/s]": planted.at("vx", t), "yawrate [rad/s]": planted.at("r", t)}
    assert "time: {source: millis, unit: ms}" in drafted_table(table, tmp_path).time


def test_thousandths_of_g_and_of_degrees_a_second_are_units():
    assert convert_to_si(np.array([1000.0]), "milli-g")[0] == pytest.approx(STANDARD_GRAVITY)
    for spelled in ("mdps", "milli-dps", "mdeg/s"):
        assert convert_to_si(np.array([180e3]), spelled)[0] == pytest.approx(np.pi)


def test_a_yaw_rate_beyond_every_cars_in_degrees_too_is_left_open(tmp_path):
    t = np.arange(0.0, 20.0, 0.05)
    draft = drafted_table({"time": t, "gyro_z": 4e4 * np.sin(t)}, tmp_path)
    assert draft.of("r").status == "open" and "rad/s or deg/s" in draft.of("r").reason


def test_a_row_of_groups_above_the_titles_says_what_short_titles_mean(tmp_path):
    path = tmp_path / "crash.csv"
    rows = [
        "Run,Acceleration,,,Lateral Forces,,Vertical Forces,",
        "Time sec,1 Long g,2 Lat g,3 Vert g,LF klb,RF klb,LF klb,RF klb",
    ]
    rows += [f"{0.1 * k},{k % 3},{k % 5},1,{k},{2 * k},3,4" for k in range(30)]
    path.write_text("\n".join(rows) + "\n")
    recording = open_recording(path)
    infos = {info.name: info for info in recording.channels()}
    assert {"Lateral Forces.LF klb", "Vertical Forces.LF klb"} <= set(infos)
    assert recording.read(["Vertical Forces.LF klb"])["Vertical Forces.LF klb"].values[5] == 3.0
    found = {name: (meanings(info)[0].channel, stated_unit(info)) for name, info in infos.items() if meanings(info)}
    assert found == {"1 Long g": ("ax", "g"), "2 Lat g": ("ay", "g")}
    # A name of the table with one of its driver is no row of groups, nor is a note behind the last column.
    for above in ("Driver,Long Accelerations,,,,,,", ",,,,,,,,note"):
        path.write_text("\n".join([above, *rows[1:]]) + "\n")
        assert {info.group for info in open_recording(path).channels()} == {""}


@pytest.mark.parametrize("large", [False, True])
def test_channels_of_one_name_in_a_list_are_numbered_and_none_replaces_another(large, tmp_path, monkeypatch):
    if large:
        monkeypatch.setattr(json_channels, "LARGEST_DOCUMENT", 10)
    names = ("speed", "yaw rate", "speed")
    content = [{"name": n, "unit": "m/s", "data": [float(k + 100 * p) for k in range(30)]} for p, n in enumerate(names)]
    path = tmp_path / "channels.json"
    path.write_text(json.dumps({"channels": content}))
    recording = open_recording(path)
    assert [info.name for info in recording.channels()] == ["speed", "yaw rate", "speed_2"]
    signals = recording.read(["speed", "speed_2"])
    assert (signals["speed"].values[0], signals["speed_2"].values[0]) == (0.0, 200.0)
    assert any("twice" in note.what for note in recording.notes)


def test_a_speed_in_miles_that_the_file_calls_kilometres_is_named(tmp_path):
    planted = PlantedDrive(seconds=59.0)
    t = np.arange(0.0, 59.0, 0.02)
    table = {"time": t, "X [m]": planted.at("X", t), "Y [m]": planted.at("Y", t)}
    draft = drafted_table(table | {"speed [km/h]": planted.at("vx", t) / 0.44704}, tmp_path)
    assert draft.of("vx").status == "open" and "from km/h although it is in mph" in draft.of("vx").reason
    draft = drafted_table(table | {"speed [mph]": planted.at("vx", t) * 3.6}, tmp_path)
    assert draft.of("vx").status == "open" and "from mph although it is in km/h" in draft.of("vx").reason


def test_an_accuracy_is_no_acceleration_and_a_name_that_begins_with_g_is_in_g():
    assert not meanings(RawChannelInfo("GPSi_hAcc", "column", None))
    assert [stated_unit(RawChannelInfo(name, "column", None)) for name in ("g_lat", "g_force_lon")] == ["g", "g"]
    assert stated_unit(RawChannelInfo("g_level", "column", None)) is None


def test_a_folder_of_tables_names_them(tmp_path):
    for name in ("vx", "psi"):
        savemat(tmp_path / f"{name}.mat", {name: np.arange(9.0)})
    with pytest.raises(LogError, match=r"psi\.mat, vx\.mat: name one of them, or .* --together"):
        open_recording(tmp_path)


def test_a_speed_that_jumps_beyond_all_grip_is_counted_with_its_times():
    """A small car's simulator put it elsewhere: v_x read 91 m/s for a second, and nothing was said of it."""
    planted = PlantedDrive(seconds=59.0)
    t = np.arange(0.0, 59.0, 0.01)
    columns = {"t": t, **{name: planted.at(name, t) for name in ("vx", "vy", "r", "T", "delta")}}
    away = (t >= 20.0) & (t < 21.0)
    columns["vx"] = np.where(away, 91.0, columns["vx"])
    drive = Drive("jumping", columns, np.zeros(len(t), np.int32), 0.01)
    for vehicle, limit in ((planted.vehicle, "twice what the tyres"), (None, "70 m/s")):
        found = [f for f in check_consistency(drive, vehicle, {}).findings if f.check == "jump"]
        assert len(found) == 1 and found[0].measured == 2.0
        assert "to 91 m/s at t = 19." in found[0].text and limit in found[0].text
    # Braking at the limit of grip is no jump, nor is a segment that begins at another speed.
    columns["vx"] = np.where(t < 30.0, 20.0, np.maximum(20.0 - 9.81 * (t - 30.0), 1.0) + 30.0 * (t > 45.0))
    drive = Drive("braking", columns, (t > 45.0).astype(np.int32), 0.01)
    assert not [f for f in check_consistency(drive, planted.vehicle, {}).findings if f.check == "jump"]


def test_a_position_that_runs_away_is_told_with_its_time():
    """The tail of a tracker's log: kilometres within a fraction of a second, and the channels were said to fit."""
    planted = PlantedDrive(seconds=59.0)
    t = np.arange(0.0, 59.0, 0.01)
    columns = {"t": t, **{name: planted.at(name, t) for name in ("vx", "vy", "r", "T", "delta", "X", "Y", "yaw")}}
    sound = Drive("sound", columns, np.zeros(len(t), np.int32), 0.01)
    assert not [f for f in check_consistency(sound, planted.vehicle, {}).findings if f.check == "jump"]
    away = columns | {"X": columns["X"] + 2e5 * np.maximum(t - 58.8, 0.0)}
    told = check_consistency(replace(sound, columns=away), planted.vehicle, {}).findings
    assert [(f.channel, f.measured) for f in told if f.check == "jump"] == [("X", 1.0)]
    assert "at t = 58.8 s" in next(f.text for f in told if f.check == "jump")


def test_a_clock_of_the_day_goes_on_over_midnight(tmp_path):
    """Night of a race: HH:MM:SS falls by a day, and nothing of the drive is lost or moved."""
    t = 0.02 * np.arange(1000)
    clock = [f"{int(s // 3600) % 24:02}:{int(s // 60) % 60:02}:{s % 60:06.3f}" for s in 86390.0 + t]
    path = tmp_path / "night.csv"
    path.write_text("Time,v [m/s]\n" + "".join(f"{c},{20.0 + s}\n" for c, s in zip(clock, t, strict=True)))
    entries = {"name": "night", "time": {"source": "Time", "unit": "s"}, "channels": {"vx": {"source": "v"}}}
    gathered = gather(open_recording(path), map_from_mapping(entries))
    assert gathered.series["vx"][0].time == pytest.approx(t, abs=1e-6)


def wheeled_table(sides: float) -> dict[str, np.ndarray]:
    """Return a log with r and a_y times `sides`, wheel speeds of a car 1.5 m wide, and no position."""
    planted = PlantedDrive(seconds=60.0)
    t = np.arange(0.0, 60.0, 0.02)
    r, vx = planted.at("r", t), planted.at("vx", t)
    table = {"utc_ms": 1.7e12 + 1000.0 * t, "VehSpd_fps": vx / 0.3048, "YawRate [rad/s]": sides * r}
    table |= {"LatAcc [m/s^2]": sides * planted.at("ay", t), "LongAcc [m/s^2]": planted.at("ax", t)}
    corners = {"FL": -0.75, "FR": 0.75, "RL": -0.75, "RR": 0.75}
    return table | {f"WheelSpeed_{c} [m/s]": vx + at * r for c, at in corners.items()}


@pytest.mark.parametrize("sides", [1.0, -1.0])
def test_wheels_outside_a_turn_tell_left_from_right(sides, tmp_path):
    draft = drafted_table(wheeled_table(sides), tmp_path)
    assert draft.left == "the wheels outside a turn, which are faster"
    assert draft.of("r").scale == draft.of("ay").scale == sides
    assert draft.time == "time: {source: utc_ms, unit: ms}" and draft.of("vx").unit == "ft/s"
    assert {s.channel for s in draft.suggestions if s.status == "open"} == set()


def test_wheels_exchanged_on_one_axle_are_told_and_turn_nothing(tmp_path):
    table = wheeled_table(1.0)
    left, right = "WheelSpeed_FL [m/s]", "WheelSpeed_FR [m/s]"
    table[left], table[right] = table[right], table[left]
    draft = drafted_table(table, tmp_path)
    assert draft.of("r").scale == 1.0 and "exchanged" in draft.of("wheel_speed_fl").reason


def test_what_turns_at_a_corner_in_rpm_is_a_wheel_and_an_engine_is_none():
    info = RawChannelInfo("RPM_RL", "column", None)
    assert meanings(info)[0].channel == "wheel_speed_rl" and stated_unit(info) == "rpm"
    assert not meanings(RawChannelInfo("RPM", "column", None))


def test_fixes_once_a_second_judge_a_yaw_rate_by_what_both_can_show(tmp_path):
    """Straight pieces between fixes turn in their corners alone: r was 0.72 times the turning of such a path."""
    planted = PlantedDrive(seconds=90.0)
    t = np.arange(0.0, 90.0, 0.02)
    table = {"time": t, "speed [m/s]": planted.at("vx", t), "yaw_rate [rad/s]": planted.at("r", t)}
    fixes = np.arange(len(t)) % 50 == 0
    noise = np.random.default_rng(4).normal(0.0, 0.05, (2, len(t)))  # of a receiver's digits [m]
    table |= {
        n: np.where(fixes, planted.at(n[0], t) + e, np.nan) for n, e in zip(("X [m]", "Y [m]"), noise, strict=True)
    }
    draft = drafted_table(table, tmp_path)
    assert "r against the turning of X, Y" in draft.of("r").reason
    slope = float(draft.of("r").reason.split("turning of X, Y: ratio ")[1].split(";")[0])
    assert slope == pytest.approx(1.0, abs=0.1)


def test_the_status_of_a_quantity_is_its_value_unless_it_takes_few(tmp_path):
    t = np.arange(0.0, 20.0, 0.02)
    values = {"vehicle_speed_status": 10.0 + np.sin(t), "yaw_rate_status": np.round(np.sin(t)) + 2.0}
    draft = drafted_table({"time": t, **values}, tmp_path)
    assert draft.of("vx").status == "assumed" and draft.of("r").status == "open"


@pytest.mark.parametrize("laps", [1, 4])
def test_clocks_that_do_not_meet_are_brought_together_by_the_speed_of_both(laps, tmp_path):
    """A bus counts from its start, a receiver since 1970; of laps that repeat, nothing says which one is which."""
    planted = PlantedDrive(seconds=120.0 / laps)
    t = np.arange(0.0, 120.0, 0.1)
    speed = planted.at("vx", t % (120.0 / laps))
    write_table(tmp_path / "bus.csv", {"time": 311.37 + t, "VehicleSpeed [km/h]": 3.6 * speed})
    late = t[20:] + 1.7e9 + 0.13
    write_table(tmp_path / "fix.csv", {"utc_ms": 1000.0 * late, "GPS Speed [kn]": speed[20:] / 0.5144})
    joined = open_logs([tmp_path / "bus.csv", tmp_path / "fix.csv"])
    moved = float(joined.read(["GPS Speed"])["GPS Speed"].time[0] - late[0])
    if laps == 1:
        assert moved == pytest.approx(311.37 - 1.7e9 - 0.13, abs=0.02)
        assert "correlation 1.0" in draft_map(joined).time
    else:
        assert moved == 0.0


def test_laps_whose_clock_starts_again_lose_nothing_to_the_pause_between_them(tmp_path):
    planted = PlantedDrive(seconds=60.0)
    t = np.arange(0.0, 60.0, 0.02)
    columns = {c: planted.at(c, t) for c in ("vx", "vy", "r", "T", "delta")}
    write_table(tmp_path / "laps.csv", {"lap_time": np.round(t % 20.0, 2), **columns})
    channels = {c: {"source": c} for c in columns}
    entries = {"name": "laps", "time": {"source": "lap_time", "unit": "s"}, "channels": channels}
    made = assemble_drive(open_recording(tmp_path / "laps.csv"), map_from_mapping(entries), planted.vehicle)
    assert made.quality.segments == 3 and len(made.drive) == len(t)
    assert made.quality.recorded == pytest.approx(made.quality.duration, abs=0.1)


def test_topics_as_tables_with_seconds_and_nanoseconds_make_one_drive(tmp_path):
    """A model car's topics, a table each with `s`, `ns`: the yaw is that of the file which X and Y are of."""
    planted = PlantedDrive(seconds=30.0)
    t = np.arange(0.0, 30.0, 0.04)
    stamp = {"s": 1651541251 + np.floor(t), "ns": np.round(t % 1.0 * 1e9)}
    half = 0.5 * planted.at("yaw", t)
    turned = {"q.x": 0.0 * t, "q.y": 0.0 * t, "q.z": np.sin(half), "q.w": np.cos(half)}
    other = {"q.x": 0.0 * t, "q.y": 0.0 * t, "q.z": np.sin(0.3 * half), "q.w": np.cos(0.3 * half)}
    write_table(tmp_path / "imu.csv", {**stamp, "wz": planted.at("r", t), **other})
    write_table(tmp_path / "odom.csv", {**stamp, "vx": planted.at("vx", t)})
    write_table(tmp_path / "pose.csv", {**stamp, "x": planted.at("X", t), "y": planted.at("Y", t), **turned})
    draft = draft_map(open_logs([tmp_path / f"{name}.csv" for name in ("imu", "odom", "pose")]))
    assert draft.of("yaw").sources == tuple(f"pose.q.{axis}" for axis in "xyzw")
    assert "r against dyaw/dt: ratio 1" in draft.of("yaw").reason and draft.of("vx").status == "judged"


def test_east_and_north_tell_no_side_of_a_yaw_rate_that_does_not_follow_them(tmp_path):
    """On a motorway a right-positive gyro shows little but noise: its sign is to be checked."""
    planted = PlantedDrive(seconds=60.0)
    t = np.arange(0.0, 60.0, 0.02)
    table = {"time": t, "east [m]": planted.at("X", t), "north [m]": planted.at("Y", t)}
    table |= {"speed [m/s]": planted.at("vx", t)}
    slow = np.sin(0.9 * t) + np.sin(1.7 * t)
    marked = drafted_table({**table, "gyro_z [rad/s]": 0.3 * slow - planted.at("r", t)}, tmp_path)
    assert marked.left == "east and north" and marked.of("r").status in ("assumed", "open")
    followed = drafted_table({**table, "gyro_z [rad/s]": -planted.at("r", t)}, tmp_path)
    assert followed.of("r").status == "judged" and followed.of("r").scale == -1.0


def test_a_quick_slalom_judges_accelerations_by_what_v_y_adds(tmp_path):
    """In a multi-body program's sines of 1 Hz a_y beside the CG was taken for a_y, and m/s for mph."""
    t = np.arange(0.0, 60.0, 0.01)
    vx, r = 7.0 + 0.05 * np.sin(0.2 * t), 0.3 * np.sin(2.0 * np.pi * t) * (0.3 + 0.2 * np.sin(0.11 * t))
    dr = np.gradient(r, t)
    vy = 0.9 * r + 0.12 * dr
    lateral = np.gradient(vy, t) + vx * r
    table = {"time [s]": t, "Car.vx [m/s]": vx, "Car.vy [m/s]": vy, "Car.YawRate [rad/s]": r}
    table |= {"Body.PoI.ay [m/s^2]": 0.9 * lateral - 0.3 * dr, "Car.ay [m/s^2]": lateral}
    draft = drafted_table(table, tmp_path)
    assert draft.of("ay").sources == ("Car.ay",) and draft.of("vx").status != "open"
    assert "v_x r + dv_y/dt: ratio 1" in draft.of("ay").reason
    # A v_y of the other hand goes worse with a_y than none.
    draft = drafted_table(table | {"Car.vy [m/s]": -vy}, tmp_path)
    assert "dv_y/dt" not in draft.of("r").reason


def test_a_noisy_position_does_not_make_a_yaw_rate_too_small():
    """A particle filter's position: what its noise turns counted, and r was said to be 0.82 times the turning."""
    planted = PlantedDrive(seconds=90.0)
    made = assemble_drive(
        planted.recording(("X", "Y", "vx", "vy", "r", "T", "delta"), rate=50.0, noise={"X": 0.25, "Y": 0.25}),
        map_from_mapping({"channels": {c: c for c in ("X", "Y", "vx", "vy", "r", "T", "delta")}}),
        planted.vehicle,
    )
    turning = next(r for r in made.quality.consistency.relations if "turning" in r.name)
    assert turning.holds and turning.slope.slope == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("factor", "ahead", "check"), [(1.47, 0.0, "size"), (3.6, 0.0, "size"), (1.0, -1.45, "place")])
def test_a_lateral_velocity_of_wrong_size_is_told_from_one_of_another_place_without_a_position(factor, ahead, check):
    """American units made v_y 1.47 times too large; its place, or the delay of delta, was blamed."""
    planted, channels = PlantedDrive(seconds=90.0), ("vx", "vy", "r", "T", "delta", "ay")
    recording = planted.recording(channels)
    vy = recording.signals["vy"]
    moved = factor * planted.at("vy", vy.time) + ahead * planted.at("r", vy.time)
    recording.signals["vy"] = replace(vy, values=moved)
    made = assemble_drive(recording, map_from_mapping({"channels": {c: c for c in channels}}), planted.vehicle)
    told = [f for f in made.quality.consistency.findings if f.channel in ("vy", "delta")]
    assert [f.check for f in told] == [check]
    if check == "size":
        assert told[0].measured == pytest.approx(factor, rel=0.01)
