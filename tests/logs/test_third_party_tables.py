"""Tables in forms first met in logs as a tenth set of programs writes them: kinds of rows, factors, clocks, places."""

import io
import pickle
import re

import h5py
import numpy as np
import pytest

from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.raw import unit_of_time
from split_cli.logs.readers.clock_of_day import over_midnight
from split_cli.logs.readers.coordinates import holds_both, in_degrees, parts_of_angles, parts_of_cells
from split_cli.logs.readers.dialect import plain_sign
from split_cli.logs.readers.hdf5_attributes import titles_of_block
from split_cli.logs.readers.on_change import held_on_change
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.readers.rows_of_kinds import titles_of_kinds
from split_cli.signals import find_unit, split_name_and_unit
from split_cli.workflows.ingesting.ingest import open_logs
from split_cli.workflows.ingesting.init import init_project
from tests.logs.planted import LOGGED, write_table

DEG = 180.0 / np.pi


@pytest.fixture(scope="module")
def t():
    return np.arange(0.0, 40.0, 0.02)


def check(recording, car, t, names, abs_=1e-4):
    """Compare columns with the truth, in the units that the recording states."""
    read = recording.read(list(names))
    for name, (channel, factor, _) in zip(names, LOGGED.values(), strict=True):
        unit = find_unit(read[name].unit)
        truth = car.at(channel, t if read[name].time is None else read[name].time + recording.origin)
        assert read[name].values * unit.factor == pytest.approx(truth, abs=abs_), name
        assert factor > 0.0


@pytest.mark.parametrize("mark", ["#", ""])
def test_rows_of_several_kinds_have_titles_and_clocks_of_their_own(mark, car, t, tmp_path):
    """Rows of a gyro and of a receiver had been one table: a latitude stood for an acceleration."""
    lines = ["boot ok", f"{mark}IMU,time_us,YawRate_dps,LatAcc_mps2", f"{mark}GPS,time_us,Speed_kmh,sats"]
    for n, x in enumerate(t):
        lines.append(f"IMU,{1e6 * x:.0f},{DEG * car.at('r', x):.6f},{car.at('ay', x):.6f}")
        if n % 5 == 0:
            lines.append(f"GPS,{1e6 * x:.0f},{3.6 * car.at('vx', x):.6f},12")
    (tmp_path / "log.csv").write_text("\n".join(lines))
    recording = open_recording(tmp_path / "log.csv")
    assert {info.name for info in recording.channels()} >= {"IMU.YawRate_dps", "GPS.Speed_kmh", "GPS.sats"}
    check(recording, car, t, ["GPS.Speed_kmh", "IMU.YawRate_dps", "IMU.LatAcc_mps2"])


def test_a_column_of_words_makes_no_kinds_of_rows():
    rows = "".join(f"{'left' if n % 2 else 'right'},{n},{0.1 * n:.2f}\n" for n in range(40))
    assert titles_of_kinds(f"side,time,angle\n{rows}".encode()) is None


def test_whole_numbers_are_taken_times_the_factor_above_them(car, t, tmp_path):
    """The row of factors was read as the first row of values, and a steer angle of 18,000 deg as stated."""
    steps, offsets = (1e-2, 1e-2, 1e-3), (0.0, -300.0, -40.0)
    head = "Name;time;" + ";".join(LOGGED) + "\nUnit;s;km/h;deg/s;m/s^2\nFactor;0.001;0.01;0.01;0.001\n"
    head += "Offset;0;" + ";".join(f"{o:g}" for o in offsets) + "\n"
    columns = [np.rint(1e3 * t)]
    for (channel, factor, _), step, offset in zip(LOGGED.values(), steps, offsets, strict=True):
        columns.append(np.rint((factor * car.at(channel, t) - offset) / step))
    rows = ["".join(f";{value:.0f}" for value in row) for row in zip(*columns, strict=True)]
    (tmp_path / "log.csv").write_text(head + "\n".join(rows))
    recording = open_recording(tmp_path / "log.csv")
    assert recording.read(["time"])["time"].values == pytest.approx(t)
    check(recording, car, t, LOGGED, abs_=0.0015)
    (tmp_path / "real.csv").write_text(head + "\n".join(f";{1000 * x:.0f};100;200;{x:.3f}" for x in t))
    assert open_recording(tmp_path / "real.csv").read(["Speed"])["Speed"].values[0] == 100.0
    real = [";" + ";".join(f"{v:.4f}" for v in (x, 3.6 * car.at("vx", x), 0.5, 0.5)) for x in t]
    (tmp_path / "real.csv").write_text(head + "\n".join(real))  # quantities already, whatever stands above
    read = open_recording(tmp_path / "real.csv").read(["Speed"])["Speed"]
    assert read.values == pytest.approx(3.6 * car.at("vx", t), abs=1e-3)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("v_kmh_x10", "0.1 km/h"),
        ("yawrate_dps_x100", "0.01 deg/s"),
        ("pos_x10", None),
        ("pitch_deg*10", "0.1 deg"),
        ("speed_kmh", "km/h"),
    ],
)
def test_a_factor_behind_the_unit_of_a_name(name, unit):
    assert split_name_and_unit(name) == (name, unit)


@pytest.mark.parametrize(
    ("written", "known"),
    [
        ("km·h⁻¹", "km/h"),
        ("°·s⁻¹", "deg/s"),
        ("rad s-1", "rad/s"),
        ("m s^-2", "m/s^2"),
        ("Â°/s", "deg/s"),
        ("U/min", "rpm"),
        ("arcminutes", "arcmin"),
        ("s-1", None),
        ("m.s-3", None),
        ("10-1", None),
    ],
)
def test_units_with_negative_powers_and_read_in_the_wrong_code_page(written, known):
    found = find_unit(written)
    assert (found.symbol if found else None) == known


def test_a_road_wheel_angle_beyond_any_car_is_left_open(car, t, tmp_path):
    """Nothing judged it by name, and it was called stated."""
    columns = {"time": t, "speed_mps": car.at("vx", t), "road_wheel_angle_deg": 1e4 * DEG * np.cos(t)}
    write_table(tmp_path / "log.csv", columns)
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.of("delta").status == "open" and "no car's exceeds 1.3" in draft.of("delta").reason


def test_attributes_of_hdf5_scale_whole_numbers_and_name_columns(car, t, tmp_path):
    """`scale_factor` was left alone, a matrix with `columns` had no titles."""
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"] = t
        packed = np.rint((car.at("vx", t) - 10.0) / 0.01).astype(np.int32)
        packed[7] = -9999
        file["speed"] = packed
        stated = {"units": "m/s", "scale_factor": 0.01, "add_offset": 10.0, "_FillValue": -9999}
        for key, value in stated.items():
            file["speed"].attrs[key] = value
        file["imu"] = np.column_stack([t, DEG * car.at("r", t), car.at("ay", t)])
        file["imu"].attrs["columns"] = ["time_s", "YawRate_dps", "LatAcc_mps2"]
    recording = open_recording(tmp_path / "log.h5")
    speed = recording.read(["speed"])["speed"].values
    assert np.isnan(speed[7]) and np.delete(speed, 7) == pytest.approx(np.delete(car.at("vx", t), 7), abs=0.006)
    rate = recording.read(["imu.YawRate_dps"])["imu.YawRate_dps"]
    assert rate.values == pytest.approx(DEG * car.at("r", t)) and rate.unit == "deg/s"


def test_titles_that_pandas_pickles_are_read_and_no_code_is_run(car, t, tmp_path):
    titles = ["speed_mps", "YawRate_dps"]
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        kinds = [("index", "f8"), ("values_block_0", "f8", (2,))]
        rows = np.zeros(len(t), dtype=kinds)
        rows["index"], rows["values_block_0"] = t, np.column_stack([car.at("vx", t), DEG * car.at("r", t)])
        group = file.create_group("df")
        group["table"] = rows
        group.attrs["info"] = np.bytes_(pickle.dumps({"index": {"index_name": "time_s"}}, protocol=0))
        group["table"].attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(titles, protocol=0))
    read = open_recording(tmp_path / "frame.h5").read(["df.YawRate_dps"])["df.YawRate_dps"]
    assert read.values == pytest.approx(DEG * car.at("r", t)) and read.time == pytest.approx(t)

    class Harm:
        def __reduce__(self):
            return io.open, (str(tmp_path / "harm"), "w")

    harm = np.bytes_(pickle.dumps([Harm(), "b"], protocol=0))
    assert titles_of_block({"values_block_0_kind": harm}, "values_block_0", 2) == []
    assert not (tmp_path / "harm").exists()


def test_a_clock_goes_on_over_the_end_of_its_counter():
    """micros() is full after 71.6 minutes: 1 s was lost, and a segment began."""
    time = 2.0**32 - 5e5 + 1e4 * np.arange(200.0)
    full = np.mod(time, 2.0**32)
    assert over_midnight(full) == pytest.approx(time)
    assert over_midnight(np.mod(time, 2.0**32) / 1e6) == pytest.approx(full / 1e6)  # no whole numbers: as it is
    again = np.concatenate([np.arange(0.0, 3e4, 10.0), np.arange(0.0, 1e3, 10.0)])
    assert over_midnight(again) == pytest.approx(again)


def test_rows_in_bursts_are_in_the_unit_of_the_steps_between_them():
    """Three messages of one instant, microseconds apart, made nanoseconds look like microseconds."""
    instants = 1e12 + 1e7 * np.arange(400.0)
    bursts = (instants[:, None] + np.array([0.0, 2e3, 5e3])).ravel()
    assert unit_of_time(bursts) == "ns" and unit_of_time(instants) == "ns"


@pytest.mark.parametrize(("ticks", "period"), [(2000.0, 0.02), (1000.0, None)])
def test_ticks_of_no_stated_length_are_judged_by_the_motion(ticks, period, car, t, tmp_path):
    """Ticks of 2 kHz were milliseconds: a drive of twice its length, in which all but a_x fitted."""
    columns = {"tick": 1e6 + ticks * t, "speed_mps": car.at("vx", t), "acc_long_mps2": car.at("ax", t)}
    write_table(tmp_path / "log.csv", {**columns, "YawRate_dps": DEG * car.at("r", t)})
    line = draft_map(open_recording(tmp_path / "log.csv")).time
    found = re.search(r"period: ([\d.]+)", line)
    assert "CHECK" in line and (float(found[1]) == pytest.approx(period, rel=0.02) if period else found is None)


def test_two_files_in_two_time_zones_are_brought_together(car, t, tmp_path):
    """They share no sensor; a steer angle could not be read, and nothing said why."""
    write_table(tmp_path / "imu.csv", {"epoch_s": 1.7e9 + 7200.0 + t, "YawRate_dps": DEG * car.at("r", t)}, fmt="%.9f")
    write_table(tmp_path / "car.csv", {"epoch_ms": 1e3 * (1.7e9 + t), "delta_rad": car.at("delta", t)}, fmt="%.9f")
    joined = open_logs([tmp_path / "imu.csv", tmp_path / "car.csv"])
    read = joined.read(["YawRate_dps", "delta_rad"])
    assert read["delta_rad"].time == pytest.approx(read["YawRate_dps"].time)
    assert any("moved by 2 h" in note.what and "CHECK" in note.what for note in joined.notes)


def test_two_drives_one_behind_the_other_are_not_laid_upon_each_other(car, t, tmp_path):
    for name, start in (("first", 1.7e9), ("second", 1.7e9 + 1800.0)):
        write_table(tmp_path / f"{name}.csv", {"epoch_s": start + t, "speed_mps": np.sin(t + start)}, fmt="%.9f")
    joined = open_logs([tmp_path / "first.csv", tmp_path / "second.csv"])
    assert not any("moved" in note.what for note in joined.notes)
    assert joined.read(["second.speed_mps"])["second.speed_mps"].time[0] == pytest.approx(1.7e9 + 1800.0)


def test_cells_written_on_change_alone_hold_their_value(car):
    t = np.arange(0.0, 40.0, 0.01)
    angle = np.rint(15.0 * DEG * car.at("delta", t))
    written = np.where(np.diff(angle, prepend=np.nan) != 0.0, angle, np.nan)
    assert held_on_change(written) == pytest.approx(angle)
    slow = np.where(np.arange(len(t)) % 10 == 0, car.at("vx", t), np.nan)
    assert held_on_change(slow) is None  # a slow sensor moves on between
    lost = np.where((t % 4.0) < 3.0, np.rint(100.0 * car.at("ay", t)), np.nan)
    assert held_on_change(lost) is None  # and one that fails comes back elsewhere


def test_degrees_minutes_and_seconds_in_columns_of_their_own(car, tmp_path):
    """The whole degrees were the latitude, in the unit that the file states."""
    t = np.arange(0.0, 40.0, 0.1)
    lat = -33.9 + DEG * car.at("Y", t) / 6_378_137.0
    lon = 9.9995 + DEG * car.at("X", t) / 6_378_137.0 / np.cos(33.9 / DEG)

    def parts(angle):
        size = np.abs(angle)
        minutes = 60.0 * (size % 1.0)
        return np.copysign(np.floor(size), angle), np.floor(minutes), 60.0 * (minutes % 1.0)

    columns = dict(
        zip(("Lat_deg", "Lat_min", "Lat_sec", "Lon_deg", "Lon_min", "Lon_sec"), (*parts(lat), *parts(lon)), strict=True)
    )
    motion = {"speed_mps": car.at("vx", t), "YawRate_dps": DEG * car.at("r", t)}
    write_table(tmp_path / "log.csv", {"time": t, **columns, **motion}, fmt="%.8f")
    recording = open_recording(tmp_path / "log.csv")
    read = recording.read(["Lat_deg", "Lon_deg"])
    assert read["Lat_deg"].values == pytest.approx(lat, abs=1e-10)
    assert read["Lon_deg"].values == pytest.approx(lon, abs=1e-10)
    assert {draft_map(recording).of(c).status for c in ("X", "Y", "r")} == {"judged"}
    titles = " UTC Latitude Longitude Speed\n (s) (D) (M) (S) (D) (M) (S) (m/s)\n"
    rows = zip(t, *columns.values(), car.at("vx", t), strict=True)
    (tmp_path / "log.txt").write_text(titles + "\n".join(" ".join(f"{v:.8f}" for v in row) for row in rows))
    read = open_recording(tmp_path / "log.txt").read(["Latitude deg", "Speed"])
    assert read["Latitude deg"].values == pytest.approx(lat, abs=1e-10)
    assert read["Speed"].values == pytest.approx(car.at("vx", t), abs=1e-7)


def test_groups_that_are_written_again_in_each_column(tmp_path):
    """A motion capture had X twice, and the last part of a quaternion was taken for the yaw rate."""
    head = ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position\nFrame,Time,X,Y,Z,W,X,Y,Z\n"
    rows = "\n".join(f"{n},{0.01 * n:.2f},0,{0.1 * n},0,1,{n},0.5,{2 * n}" for n in range(50))
    (tmp_path / "log.csv").write_text(head + rows)
    names = [info.name for info in open_recording(tmp_path / "log.csv").channels()]
    assert [name for name in names[2:] if not name.endswith("W")] == [
        f"{g}.{c}" for g in ("Rotation", "Position") for c in "XYZ"
    ]


def test_rows_that_are_equally_far_apart_along_the_track_are_said(car, t, tmp_path):
    columns = {"Distance [m]": 0.5 * np.arange(len(t)), "Speed [m/s]": car.at("vx", t)}
    write_table(tmp_path / "log.csv", columns)
    steps = init_project([tmp_path / "log.csv"], tmp_path / "car").next_steps
    assert any("rows are 0.5 m apart by Distance, not in time" in step for step in steps)


def test_an_angle_just_south_of_the_equator_keeps_its_sign():
    assert in_degrees(np.array([-0.0, 0.0]), np.array([30.0, 30.0])) == pytest.approx([-0.5, 0.5])
    assert parts_of_angles(["t_sec", "Steer_deg", "Steer_min"]) == {}


@pytest.mark.parametrize(("title", "turned"), [("position", False), ("lonlat", True)])
def test_both_coordinates_in_one_cell(title, turned, car, tmp_path):
    t = np.arange(0.0, 40.0, 0.1)
    lat = 52.0 + DEG * car.at("Y", t) / 6_378_137.0
    lon = 10.0 + DEG * car.at("X", t) / 6_378_137.0 / np.cos(52.0 / DEG)
    pairs = zip(t, lon if turned else lat, lat if turned else lon, car.at("vx", t), strict=True)
    rows = [f'{x:.1f},"{a:.9f}, {b:.9f}",{v:.5f}' for x, a, b, v in pairs]
    (tmp_path / "log.csv").write_text(f"time,{title},speed_mps\n" + "\n".join(rows))
    recording = open_recording(tmp_path / "log.csv")
    read = recording.read([f"{title}.latitude", f"{title}.longitude"])
    assert read[f"{title}.latitude"].values == pytest.approx(lat, abs=1e-8)
    assert read[f"{title}.longitude"].values == pytest.approx(lon, abs=1e-8)
    assert {draft_map(recording).of(c).status for c in ("X", "Y")} <= {"judged", "unsided"}


def test_a_pair_of_gains_is_no_place():
    assert holds_both("gains", ["1.5, 2.5"] * 5) is None and holds_both("position", ["1.5", "2.5"]) is None


@pytest.mark.parametrize("form", ["\u2212{}", "\u2013{}", "{}-", "({})"])
def test_a_minus_may_be_a_dash_stand_behind_or_be_brackets(form, car, t, tmp_path):
    """All negative values were missing: half of a drive was lost, and what was left was called judged."""

    def written(value):
        text = f"{abs(value):.6f}"
        return form.format(text) if value < 0.0 else text

    rows = [f"{x:.2f};{written(car.at('ay', x))};{written(DEG * car.at('r', x))}" for x in t]
    (tmp_path / "log.csv").write_text("time;ay_mps2;yaw_rate_dps\n" + "\n".join(rows))
    read = open_recording(tmp_path / "log.csv").read(["ay_mps2", "yaw_rate_dps"])
    assert read["ay_mps2"].values == pytest.approx(car.at("ay", t), abs=1e-6)
    assert read["yaw_rate_dps"].values == pytest.approx(DEG * car.at("r", t), abs=1e-6)


@pytest.mark.parametrize("cell", ["1-2", "2026-11-28", "(a)", "a-", "-", "--"])
def test_other_dashes_and_brackets_are_no_minus(cell):
    assert plain_sign(cell) == cell


@pytest.mark.parametrize(
    ("form", "name"),
    [
        ('"[0.1, -0.2, {:.6f}]"', "gyro[2]"),
        ("[0.1 -0.2 {:.6f}]", "gyro[2]"),
        ("\"{{'x': 0.1, 'y': -0.2, 'z': {:.6f}}}\"", "gyro.z"),
    ],
)
def test_a_list_in_each_cell_is_a_channel_for_each_number(form, name, car, t, tmp_path):
    """A frame of pandas with the vectors of messages in its cells was a column of text."""
    rows = [f"{x:.2f},{form.format(car.at('r', x))},{car.at('vx', x):.5f}" for x in t]
    (tmp_path / "log.csv").write_text("time,gyro,speed_mps\n" + "\n".join(rows))
    recording = open_recording(tmp_path / "log.csv")
    assert recording.read([name])[name].values == pytest.approx(car.at("r", t), abs=1e-6)
    assert parts_of_cells(["[1, 2]"] * 4 + ["[1]"]) == [] and parts_of_cells(["12:30:01"] * 9) == []


def test_cells_of_named_numbers_are_judged_in_a_moment_however_they_end():
    assert parts_of_cells(["a:" + "11:" * 300 + "x"] * 9) == []


def test_well_known_text_has_the_longitude_first():
    assert holds_both("position", ["POINT (10.2 52.1)"] * 5) == ("longitude", "latitude")


def test_a_part_of_a_day_between_0_and_1_is_the_time_of_a_spreadsheet():
    assert unit_of_time(0.58 + np.arange(500) * 0.02 / 86400.0) == "d"
    assert unit_of_time(np.arange(500) * 0.001) == "s"
