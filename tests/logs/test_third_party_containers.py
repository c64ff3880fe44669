"""Files in containers that other programs write: workbooks, echoes in YAML, data bases, NetCDF, lines of topics."""

import json
import sqlite3
import zipfile
from datetime import datetime, timedelta

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer
from openpyxl import Workbook
from scipy.io import netcdf_file, savemat

from split_cli.errors import LogError, SplitError
from split_cli.logs.drafting.naming import meanings, stated_unit
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.one_car import several_cars
from split_cli.logs.raw import RawChannelInfo
from split_cli.logs.readers.cells import number_of
from split_cli.logs.readers.code_pages import utf_16_without_mark
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.readers.rows_above import is_scaling, listed_names
from split_cli.logs.readers.yaml_documents import is_yaml_documents
from split_cli.workflows.ingesting.ingest import open_logs
from split_cli.workflows.ingesting.init import init_project
from split_cli.workflows.sources import find_sources
from tests.logs.planted import write_table

DEG = 180.0 / np.pi
TITLES = ["time_s", "speed_mps", "yaw_rate_dps"]


@pytest.fixture(scope="module")
def rows(car):
    t = np.arange(0.0, 40.0, 0.05)
    return np.column_stack([t, car.at("vx", t), DEG * car.at("r", t)])


def check(recording, rows, names=("speed_mps", "yaw_rate_dps"), timed=True, abs_=1e-6):
    read = recording.read(list(names))
    for place, name in enumerate(names, 1):
        assert read[name].values == pytest.approx(rows[:, place], abs=abs_)
        if timed:
            time = read[name].time + recording.origin
            assert time - time[0] == pytest.approx(rows[:, 0] - rows[0, 0], abs=1e-4)


def workbook(path, *sheets):
    """Write a workbook with the rows of some sheets."""
    book = Workbook()
    book.remove(book.active)
    for number, lines in enumerate(sheets):
        sheet = book.create_sheet(f"sheet {number}")
        for line in lines:
            sheet.append(line)
    book.save(path)


@pytest.mark.parametrize("clock", ["days", "dates"])
def test_the_sheet_of_a_workbook_with_the_most_numbers_is_read(rows, clock, tmp_path):
    """A workbook was refused: a first sheet about the car, days or dates, empty cells that Excel stores not at all."""
    lines = [["Timestamp", None, "speed_mps", "yaw_rate_dps"]]
    noon = datetime(2026, 11, 28, 12)
    for t, speed, rate in rows.tolist():
        moment = 46354.5 + t / 86400.0 if clock == "days" else noon + timedelta(seconds=t)
        lines.append([moment, None, speed, rate])
    lines[5][2] = None
    workbook(tmp_path / "log.xlsx", [["mass", 1573]], lines)
    recording = open_recording(tmp_path / "log.xlsx")
    read = recording.read(["Timestamp", "speed_mps", "yaw_rate_dps"])
    assert np.isnan(read["speed_mps"].values[4])
    assert np.delete(read["speed_mps"].values, 4) == pytest.approx(np.delete(rows[:, 1], 4))
    assert read["yaw_rate_dps"].values == pytest.approx(rows[:, 2])
    unit = "d" if clock == "days" else "s"
    assert draft_map(recording).time == f"time: {{source: Timestamp, unit: {unit}}}"
    assert any("other sheets" in note.what for note in recording.notes)


def test_a_workbook_that_would_exhaust_memory_is_refused(rows, tmp_path):
    workbook(tmp_path / "log.xlsx", [["time", "speed"], *rows[:, :2].tolist()])
    bomb = b'<!DOCTYPE w [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    with zipfile.ZipFile(tmp_path / "log.xlsx") as whole, zipfile.ZipFile(tmp_path / "bomb.xlsx", "w") as other:
        for name in whole.namelist():
            other.writestr(name, (bomb if "sheet1" in name else b"") + whole.read(name))
    with pytest.raises(LogError, match="definitions that no program writes"):
        open_recording(tmp_path / "bomb.xlsx")


def test_a_workbook_that_was_cut_off_or_lacks_a_part_is_refused(rows, tmp_path):
    workbook(tmp_path / "log.xlsx", [["time", "speed"], *rows[:, :2].tolist()])
    with zipfile.ZipFile(tmp_path / "log.xlsx") as whole, zipfile.ZipFile(tmp_path / "part.xlsx", "w") as other:
        for name in whole.namelist():
            if not name.endswith("workbook.xml"):
                other.writestr(name, whole.read(name))
    with pytest.raises(LogError, match="part.xlsx"):
        open_recording(tmp_path / "part.xlsx")


def echoed(rows):
    documents = []
    for row in rows:
        s = 1_718_000_000 + row[0]
        stamp = f"header:\n  stamp:\n    sec: {int(s)}\n    nanosec: {round(s % 1.0 * 1e9)}\n  frame_id: odom\n"
        twist = f"twist:\n  linear:\n    x: {row[1]:.9f}\n    y: 0.0\n  angular:\n    z: {row[2] / DEG:.9f}\n"
        documents.append(f"{stamp}{twist}covariance:\n- 0.0\n- 1.0\n")
    return documents


def test_an_echo_of_messages_in_yaml_is_a_row_for_each_document(car, rows, tmp_path):
    """`ros2 topic echo /odom > odom.yaml` had two channels, called child_frame_id: and base_link."""
    documents = echoed(rows)
    (tmp_path / "odom.yaml").write_text(
        "---\n".join(documents[:300] + ["x: [1,\n", "a: &x 1\nb: *x\n"] + documents[300:])
    )
    recording = open_recording(tmp_path / "odom.yaml")
    read = recording.read(["twist.linear.x", "twist.angular.z"])
    assert read["twist.linear.x"].values == pytest.approx(rows[:, 1], abs=1e-8)
    assert DEG * read["twist.angular.z"].values == pytest.approx(rows[:, 2], abs=1e-6)
    draft = draft_map(recording)
    assert draft.time == "time: {source: header.stamp.sec, nanoseconds: header.stamp.nanosec}"
    assert any(note.count == 2 and "YAML" in note.what for note in recording.notes)


def test_prose_and_settings_are_no_documents_of_yaml():
    assert not is_yaml_documents(b"# Notes\nThe car: was new.\n---\nIt ran well, and so on.\n" * 9)
    assert not is_yaml_documents(b"mass: 1573\nname: car\nfriction: 1.0\nwheel_radius: 0.3\n")


def test_tables_of_a_data_base_have_their_clocks(rows, tmp_path):
    """It was called a damaged rosbag2 database, and the advice was to record it again."""
    path = tmp_path / "log.sqlite"
    with sqlite3.connect(path) as database:
        database.execute("create table imu (id integer primary key, time_ms integer, yaw_rate_dps real)")
        database.execute("create table car (time text, speed_mps real, mode text)")
        database.execute("create table about (key text, value text)")
        imu = [(n, round(1e3 * (1_718_000_000 + row[0])), row[2]) for n, row in enumerate(rows)]
        database.executemany("insert into imu values (?, ?, ?)", imu)
        clock = [f"2024-06-10T06:{13 + int((20 + r[0]) // 60):02}:{(20 + r[0]) % 60:06.3f}" for r in rows]
        database.executemany("insert into car values (?, ?, 'race')", zip(clock, rows[:, 1].tolist(), strict=True))
    recording = open_recording(path)
    assert {info.name for info in recording.channels()} >= {"imu.yaw_rate_dps", "car.speed_mps"}
    check(recording, rows, ("car.speed_mps", "imu.yaw_rate_dps"))
    with sqlite3.connect(tmp_path / "empty.sqlite") as database:
        database.execute("create table about (key text, value text)")
    with pytest.raises(LogError, match=r"without a table of 20 rows .*about"):
        open_recording(tmp_path / "empty.sqlite")


def test_a_computed_column_of_a_data_base_is_not_read(tmp_path, rows):
    with sqlite3.connect(tmp_path / "log.db") as database:
        database.execute("create table a (t real, v real generated always as (t * t))")
        database.execute("create table b (time_s real, speed_mps real)")
        database.executemany("insert into b values (?, ?)", rows[:, :2].tolist())
        database.executemany("insert into a (t) values (?)", rows[:, :1].tolist())
    assert [info.name for info in open_recording(tmp_path / "log.db").channels()] == ["time_s", "speed_mps"]


def test_classic_netcdf_with_its_units_and_scales(rows, tmp_path):
    with netcdf_file(tmp_path / "log.nc", "w") as file:
        file.createDimension("time", len(rows))
        time = file.createVariable("time", "d", ("time",))
        time[:], time.units = rows[:, 0], "seconds since 2026-11-28"
        speed = file.createVariable("speed", "i", ("time",))
        speed[:], speed.units, speed.scale_factor = np.rint(100.0 * rows[:, 1]), "m s-1", 0.01
    recording = open_recording(tmp_path / "log.nc")
    read = recording.read(["speed", "time"])
    assert read["speed"].values == pytest.approx(rows[:, 1], abs=0.006) and read["speed"].unit == "m/s"
    assert read["time"].unit == "s" and draft_map(recording).time == "time: {source: time, unit: s}"


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_utf_16_without_its_mark_is_text(encoding, rows, tmp_path):
    text = ",".join(TITLES) + "\r\n" + "\r\n".join(",".join(f"{v:.6f}" for v in row) for row in rows)
    (tmp_path / "log.csv").write_bytes(text.encode(encoding))
    check(open_recording(tmp_path / "log.csv"), rows, timed=False, abs_=1e-6)
    assert utf_16_without_mark(np.arange(400, dtype="<i2").tobytes()) == ""


def test_a_table_of_markdown_has_its_titles_above_the_rule(rows, tmp_path):
    """The line of dashes was taken for the titles."""
    head = ["| " + " | ".join(TITLES) + " |", "|---:|:---|:---:|"]
    lines = ["| " + " | ".join(f"{v:.6f}" for v in row) + " |" for row in rows]
    (tmp_path / "log.md").write_text("\n".join(head + lines))
    check(open_recording(tmp_path / "log.md"), rows, timed=False)


def test_messages_in_flatbuffers_are_said_to_be_unread(tmp_path):
    """It was said that no channel was recognised, and not why."""
    with (tmp_path / "log.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        kind = writer.register_schema("car.State", "flatbuffer", b"BFBS")
        channel = writer.register_channel("/state", "flatbuffer", kind)
        for n in range(20):
            writer.add_message(channel, 10**18 + n * 10**7, bytes(40), 10**18 + n * 10**7)
        writer.finish()
    with pytest.raises(SplitError, match="no channel was recognised") as refused:
        init_project([tmp_path / "log.mcap"], tmp_path / "car")
    assert "encoded as 'flatbuffer'" in refused.value.advice


def test_lines_of_influxdb_have_the_clock_of_their_measurement(rows, tmp_path):
    lines = ["# DML"]
    for row in rows:
        stamp = 1_718_000_000 * 10**9 + round(1e9 * row[0])
        lines.append(f'imu,car=7 yaw_rate_dps={row[2]:.7f},state="ok a=1, b" {stamp}')
        lines.append(f"car speed_mps={row[1]:.7f},gear=3i {stamp + 5}")
    (tmp_path / "log.lp").write_text("\n".join(lines) + "\n")
    recording = open_recording(tmp_path / "log.lp")
    assert {info.name for info in recording.channels()} == {"imu.yaw_rate_dps", "car.speed_mps", "car.gear"}
    check(recording, rows, ("car.speed_mps", "imu.yaw_rate_dps"))


def test_cars_in_lines_of_influxdb_are_told_apart_by_their_tags(rows, tmp_path):
    lines = [f"car,id={car} v={car * row[1]:.7f} {10**18 + round(1e9 * row[0])}" for row in rows for car in (1, 2)]
    (tmp_path / "log.lp").write_text("\n".join(lines) + "\n")
    read = open_recording(tmp_path / "log.lp").read(["1.car.v", "2.car.v"])
    assert read["2.car.v"].values == pytest.approx(2.0 * read["1.car.v"].values)


def test_lines_of_a_time_a_topic_and_a_number_without_titles(rows, tmp_path):
    lines = []
    for row in rows:
        stamp = f"2024-06-10T06:13:{row[0]:06.3f}Z"
        lines += [f"{stamp} car/speed {row[1]:.7f}", f"{stamp} car/yaw_rate {row[2]:.7f}"]
    (tmp_path / "log.txt").write_text("\n".join(lines) + "\n")
    check(open_recording(tmp_path / "log.txt"), rows, ("car/speed", "car/yaw_rate"))


def test_what_a_program_logs_to_its_console_has_its_time_in_brackets(rows, tmp_path):
    lines = [f"[{1_718_000_000 + r[0]:.6f}] [INFO] [node]: vx: {r[1]:.7f} r: {r[2]:.7f}" for r in rows]
    (tmp_path / "log.log").write_text("\n".join(lines) + "\n")
    recording = open_recording(tmp_path / "log.log")
    check(recording, rows, ("vx", "r"), timed=False)
    time = recording.read(["time"])["time"].values
    assert time - time[0] == pytest.approx(rows[:, 0], abs=1e-5)


@pytest.mark.parametrize(
    ("cell", "seconds"),
    [
        ("2024-06-10T06:13:20.5+02:00[Europe/Berlin]", 1_717_992_800.5),
        ("0 days 00:00:00.010000", 0.01),
        ("1 days 00:00:01", 86401.0),
        ("1 day, 0:01:00", 86460.0),
    ],
)
def test_a_duration_as_pandas_and_python_write_it(cell, seconds):
    assert number_of(cell, ".") == pytest.approx(seconds)


def test_vectors_take_the_time_that_is_called_after_them(car, tmp_path):
    """Of several clocks in one file none was found, and v_x was left out."""
    t, slow = np.arange(0.0, 40.0, 0.02), np.arange(0.0, 40.0, 0.1)
    arrays = {"vx": car.at("vx", slow), "t_vx": slow, "yaw_rate": car.at("r", t), "yaw_rate_time": t}
    savemat(tmp_path / "log.mat", arrays)
    recording = open_recording(tmp_path / "log.mat")
    read = recording.read(["vx", "yaw_rate"])
    assert read["vx"].time == pytest.approx(slow) and read["yaw_rate"].time == pytest.approx(t)
    assert draft_map(recording).of("vx").status != "open"


def test_structures_with_their_name_inside_are_channels_of_that_name(car, tmp_path):
    t = np.arange(0.0, 40.0, 0.02)
    known = (("Speed", "km/h", 3.6 * car.at("vx", t)), ("YawRate", "deg/s", DEG * car.at("r", t)))
    cells = np.empty(2, dtype=object)
    cells[:] = [{"name": name, "unit": unit, "time": t, "data": values} for name, unit, values in known]
    savemat(tmp_path / "log.mat", {"channels": cells})
    read = open_recording(tmp_path / "log.mat").read(["channels.Speed.data"])["channels.Speed.data"]
    assert read.values == pytest.approx(known[0][2]) and read.unit == "km/h" and read.time == pytest.approx(t)


def test_a_folder_holds_lists_of_objects_and_a_sensor_that_recorded_nothing(car, rows, tmp_path):
    """nuScenes' bus was no log; a phone's empty table of remarks stopped `split init` for all others."""
    folder = tmp_path / "drive"
    folder.mkdir()
    stamps = [round(1e6 * (1_718_000_000 + x)) for x in rows[:, 0]]
    steer = ", ".join(f'{{"utime": {s}, "value": {0.1 * r[2]:.6f}}}' for s, r in zip(stamps, rows, strict=True))
    (folder / "scene_steeranglefeedback.json").write_text(f"[{steer}]")
    (folder / "meta.json").write_text('{"route": "x"}')
    write_table(folder / "Location.csv", {"time": np.array(stamps) * 1e3, "speed": rows[:, 1]}, fmt="%.18g")
    (folder / "Annotation.csv").write_text("time,seconds_elapsed,text\n")
    paths = [source.address for source in find_sources([folder])]
    assert "meta.json" not in " ".join(paths)
    joined = open_logs(paths)
    read = joined.read(["scene_steeranglefeedback.value", "speed"])
    assert read["scene_steeranglefeedback.value"].values == pytest.approx(0.1 * rows[:, 2], abs=1e-6)
    assert read["speed"].time == pytest.approx(read["scene_steeranglefeedback.value"].time, abs=1e-5)
    assert joined.read(["value"])["value"].values == pytest.approx(0.1 * rows[:, 2], abs=1e-6)
    assert any("titles alone" in note.what for note in joined.notes)
    steps = init_project([folder], tmp_path / "car").next_steps
    assert any("Annotation.csv holds titles alone" in step for step in steps)


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("scene-0001_steeranglefeedback.value", "delta"),
        ("Driving Wheel Speed", "vx"),
        ("G Sensor Lat", "ay"),
        ("G Sensor Long", "ax"),
    ],
)
def test_names_of_ecus_and_of_feedback(name, channel):
    assert meanings(RawChannelInfo(name, "column", None))[0].channel == channel


def test_rpm_inside_a_name_is_its_unit():
    assert stated_unit(RawChannelInfo("WheelRPM_FL", "column", None)) == "rpm"


def test_channels_listed_above_rows_without_titles(rows, tmp_path):
    """Haltech lists each channel with its properties; the columns had no names."""
    head = ["%DataLog%", "Channel : Vehicle Speed", "ID : 384", "", "Channel : Yaw Rate", "ID : 385", ""]
    lines = [",".join(f"{v:.6f}" for v in row) for row in rows]
    (tmp_path / "log.csv").write_text("\n".join(head + lines))
    check(open_recording(tmp_path / "log.csv"), rows, ("Vehicle Speed", "Yaw Rate"), timed=False)
    assert listed_names([["Name: A"], ["Name: B"]], 5) == []


def test_a_title_that_is_called_offset_is_no_row_of_offsets():
    assert is_scaling(["Offset", "0", "-40"], ".") and not is_scaling(["Offset", "rpm", "mph"], ".")
    assert is_scaling(["Factor:", "0,01", ""], ",") and not is_scaling(["Factor"], ".")


def test_messages_of_several_topics_in_json_lines_keep_their_topics(car, tmp_path):
    """`mcap cat --json` was said to hold no numbers; two gyros that send alike messages must not become one."""
    lines = []
    for x in np.arange(0.0, 40.0, 0.05):
        for topic, factor in (("/imu/front", 1.0), ("/imu/column", 9.0)):
            gyro = f'{{"angular_velocity": {{"z": {factor * car.at("r", x):.7f}}}}}'
            lines.append(f'{{"topic": "{topic}", "log_time": {1.7e9 + x:.3f}, "data": {gyro}}}')
        lines.append(f'{{"topic": "/car", "log_time": {1.7e9 + x:.3f}, "data": {{"speed": {car.at("vx", x):.5f}}}}}')
    (tmp_path / "log.jsonl").write_text("\n".join(lines))
    recording = open_recording(tmp_path / "log.jsonl")
    names = ["imu.front.angular_velocity.z", "imu.column.angular_velocity.z", "car.speed"]
    read = recording.read(names)
    front, column = (read[name].values[np.isfinite(read[name].values)] for name in names[:2])
    assert column == pytest.approx(9.0 * front, abs=1e-5)
    draft = draft_map(recording)
    assert draft.time.startswith("time: {source: log_time")


@pytest.mark.parametrize("as_dictionary", [False, True])
def test_drivers_in_a_parquet_file_are_told_apart(as_dictionary, car, tmp_path):
    t = np.repeat(np.arange(0.0, 40.0, 0.05), 2)
    driver = pa.array(["HAM", "RUS"] * (len(t) // 2))
    driver = driver.dictionary_encode() if as_dictionary else driver
    pq.write_table(pa.table({"time_s": t, "driver": driver, "speed_mps": car.at("vx", t)}), tmp_path / "race.parquet")
    assert several_cars(open_recording(tmp_path / "race.parquet")).counts == {"HAM": len(t) // 2, "RUS": len(t) // 2}


@pytest.mark.parametrize("flow", [True, False])
def test_a_list_in_yaml_is_a_row_for_each_item(flow, rows, tmp_path):
    """It was called JSON without rows."""
    form = "- {{t: {:.2f}, speed_mps: {:.7f}, yaw_rate_dps: {:.7f}}}\n"
    form = form if flow else "- t: {:.2f}\n  speed_mps: {:.7f}\n  yaw_rate_dps: {:.7f}\n"
    (tmp_path / "log.yaml").write_text("".join(form.format(*row) for row in rows))
    check(open_recording(tmp_path / "log.yaml"), rows, timed=False)


def test_lists_in_json_lines_below_a_list_of_titles(rows, tmp_path):
    """The brackets were parts of the first and the last title: the time and the steering were lost."""
    lines = [json.dumps(TITLES), *(json.dumps(row) for row in rows.tolist()), "[1]"]
    (tmp_path / "log.jsonl").write_text("\n".join(lines) + "\n")
    recording = open_recording(tmp_path / "log.jsonl")
    check(recording, rows, timed=False)
    assert draft_map(recording).time == "time: {source: time_s, unit: s}"


def test_what_is_measured_is_taken_and_not_what_a_filter_made_of_it(car, tmp_path):
    """Two channels that are filtered alike fit each other, and the steer angle had the wrong size."""
    t = np.arange(0.0, 40.0, 0.02)
    columns = {"time_s": t, "speed_mps": car.at("vx", t), "YawRate_filt_dps": 0.9 * DEG * car.at("r", t - 0.25)}
    columns |= {"YawRate_dps": DEG * car.at("r", t), "LatAcc_filt_mps2": 0.9 * car.at("ay", t - 0.25)}
    write_table(tmp_path / "log.csv", {**columns, "LatAcc_mps2": car.at("ay", t)})
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.of("r").sources == ("YawRate_dps",) and draft.of("ay").sources == ("LatAcc_mps2",)
    del columns["YawRate_dps"]
    write_table(tmp_path / "filtered.csv", columns)
    assert draft_map(open_recording(tmp_path / "filtered.csv")).of("r").sources == ("YawRate_filt_dps",)
