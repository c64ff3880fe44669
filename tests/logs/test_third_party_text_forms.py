"""Texts that were refused, or read in part: touching columns, FORTRAN, channels as rows, NovAtel, JSON of sensors."""

import json
import time

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from split_cli.errors import LogError
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.dialect import sniff
from split_cli.logs.readers.lines_of_objects import form_of_objects
from split_cli.logs.readers.novatel import is_novatel
from split_cli.logs.readers.opening import is_prose, open_recording
from split_cli.logs.readers.rewritten_tables import open_rewritten

DEG = 180.0 / np.pi
T = np.arange(0.0, 40.0, 0.05)


@pytest.fixture(scope="module")
def rows(car):
    return np.column_stack([T, 3.6 * car.at("vx", T), DEG * car.at("r", T), car.at("ay", T)])


NAMES = ("TIME", "SPEED", "YAWRATE", "LATACC")


def written(path, head, rows, form):
    path.write_text(head + "\n".join("".join(form(value) for value in row) for row in rows) + "\n")
    return open_recording(path)


def agrees(recording, rows, names=NAMES[1:], abs_=1e-4):
    read = recording.read(list(names))
    for place, name in enumerate(names, 1):
        assert read[name].values == pytest.approx(rows[:, place], abs=abs_)


def test_numbers_of_fixed_width_that_touch_are_cut_where_the_columns_end(rows, tmp_path):
    """626 of 2,250 rows were left out, and 28 % of the drive with them."""
    head = "".join(name.rjust(9) for name in NAMES) + "\n"
    path = tmp_path / "fixed.txt"
    recording = written(path, head, rows, lambda v: f"{v:9.5f}")
    assert any("-" in line.strip()[1:] and "  " not in line for line in path.read_text().splitlines()[1:])
    agrees(recording, rows, abs_=1e-5)
    assert any("fixed width" in note.what for note in recording.notes)


def test_dates_with_minus_are_no_touching_numbers(rows, tmp_path):
    lines = [f"2024-03-11 12:00:{t:06.3f} {v:.4f} {r:.4f} {a:.4f}" for t, v, r, a in rows]
    (tmp_path / "dates.txt").write_text("date time speed rate acc\n" + "\n".join(lines) + "\n")
    recording = open_recording(tmp_path / "dates.txt")
    assert recording.read(["speed"])["speed"].values == pytest.approx(rows[:, 1], abs=1e-4)


def test_exponents_of_fortran(rows, tmp_path):
    head = "".join(name.rjust(16) for name in NAMES) + "\n"
    agrees(written(tmp_path / "run.dat", head, rows, lambda v: f"{v:16.7E}".replace("E", "D")), rows, abs_=1e-4)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_a_line_for_each_channel_is_a_table_on_its_side(rows, separator, tmp_path):
    """It was called rows that begin with a word, of ArduPilot perhaps."""
    lines = [separator.join([n, *(f"{v:.6f}" for v in column)]) for n, column in zip(NAMES, rows.T, strict=True)]
    (tmp_path / "side.csv").write_text("\n".join(lines) + "\n")
    agrees(open_recording(tmp_path / "side.csv"), rows, abs_=1e-5)
    # Rows of messages with many numbers are none.
    (tmp_path / "kinds.csv").write_text("\n".join(f"IMU{separator}{separator.join(['1.5'] * 30)}" for _ in range(9)))
    assert open_rewritten(tmp_path / "kinds.csv") is None


def test_date_and_clock_under_one_title_of_a_comment(car, tmp_path):
    """Of RTKLIB the clock was the latitude."""
    lat, lon = 52.1 + car.at("Y", T) / 111195.0, 10.2 + car.at("X", T) / 68305.0
    head = "% program   : RTKPOST\n%\n%  GPST        latitude(deg) longitude(deg)  height(m)   vn(m/s)\n"
    lines = [f"2024/03/11 12:00:{t:06.3f}  {a:.9f}  {b:.9f}  100.0  1.0" for t, a, b in zip(T, lat, lon, strict=True)]
    (tmp_path / "track.pos").write_text(head + "\n".join(lines) + "\n")
    recording = open_recording(tmp_path / "track.pos")
    assert recording.read(["latitude"])["latitude"].values == pytest.approx(lat, abs=1e-8)
    assert draft_map(recording).time.startswith("time: {source: GPST")


def novatel(car, tail=""):
    lines = []
    yaw = car.at("yaw", T)
    along, across = car.at("vx", T), car.at("vy", T)
    east, north = along * np.cos(yaw) - across * np.sin(yaw), along * np.sin(yaw) + across * np.cos(yaw)
    lat, lon = 52.1 + car.at("Y", T) / 111195.0, 10.2 + car.at("X", T) / 68305.0
    heading = (90.0 - DEG * yaw) % 360.0
    for t, a, b, n, e, h in zip(T, lat, lon, north, east, heading, strict=True):
        header = f"COM1,0,58.5,FINESTEERING,2210,{250000 + t:.3f},02000020,bdba,15823"
        body = f"INS_SOLUTION_GOOD,INS_RTKFIXED,{a:.10f},{b:.10f},105.3,45.1,{n:.4f},{e:.4f},0.01,0.1,-0.3,{h:.6f}"
        lines.append(f"#INSPVAXA,{header};{body},0.01,4,0*9f2c0a1b{tail}")
        lines.append(f"%RAWIMUSXA,2210,{250000 + t:.3f};00,11,2210,{250000 + t:.3f},0*1a2b3c4d")
    return "\n".join(lines) + "\n"


def test_messages_of_novatel_have_their_fields_and_clocks(car, tmp_path):
    """They were rows that begin with a word, of ArduPilot perhaps."""
    (tmp_path / "log.asc").write_text(novatel(car))
    recording = open_recording(tmp_path / "log.asc")
    read = recording.read(["INSPVAX.latitude", "INSPVAX.true_heading"])
    assert np.diff(read["INSPVAX.latitude"].time) == pytest.approx(0.05, abs=1e-4)
    draft = draft_map(recording)
    assert draft.of("yaw").status == "judged"
    assert draft.of("yaw").world == "ned" or draft.of("yaw").scale == -1.0
    assert draft.of("X").sources == ("INSPVAX.latitude", "INSPVAX.longitude")
    assert any("RAWIMUSX" in note.what and note.count == len(T) for note in recording.notes)
    assert not is_novatel(b"#comment,x\n1,2\n3,4\n")


def test_a_log_of_novatel_without_a_known_message_is_refused(tmp_path):
    lines = ["#INSPVAXA,COM1;" + ",".join(["x"] * 12) + "*00000000"] * 9
    (tmp_path / "log.asc").write_text("\n".join(lines) + "\n")
    with pytest.raises(LogError, match="no message of a known kind"):
        open_recording(tmp_path / "log.asc")


def test_lines_of_a_time_a_topic_and_an_object(car, tmp_path):
    """Refused as no table; two topics have a key in common."""
    lines = []
    for t, r, v in zip(T, car.at("r", T), car.at("vx", T), strict=True):
        lines.append(f"{1.7e9 + t:.3f} car/imu " + json.dumps({"yaw_rate": r, "value": 1.0}))
        lines.append(f"{1.7e9 + t + 0.003:.3f} car/can " + json.dumps({"speed_kmh": 3.6 * v, "value": 2.0}))
    (tmp_path / "mqtt.log").write_text("\n".join(lines) + "\n")
    draft = draft_map(open_recording(tmp_path / "mqtt.log"))
    assert draft.of("r").sources == ("car.imu.yaw_rate",) and draft.of("vx").unit == "km/h"


def test_brackets_with_names_and_values(car, tmp_path):
    lines = [
        f"(time {t:.3f})(speedX {3.6 * v:.5f})(wheelSpinVel 1.0 2.0)" for t, v in zip(T, car.at("vx", T), strict=True)
    ]
    (tmp_path / "torcs.log").write_text("\n".join(lines) + "\n")
    read = open_recording(tmp_path / "torcs.log").read(["speedX", "wheelSpinVel[1]"])
    assert read["speedX"].values == pytest.approx(3.6 * car.at("vx", T), abs=1e-4)
    assert set(read["wheelSpinVel[1]"].values) == {2.0}


def test_printed_messages_of_protocol_buffers(car, tmp_path):
    """Half a minute went by, and no channel was found; parts that are 0 are not printed."""
    blocks = []
    for k, t in enumerate(T):
        yaw = float(car.at("yaw", t))
        blocks.append(
            f"header {{\n  stamp {{\n    sec: {int(t)}\n    nsec: {k % 20 * 50_000_000}\n  }}\n}}\npose {{\n"
            f"  position {{\n    x: {car.at('X', t):.5f}\n    y: {car.at('Y', t):.5f}\n  }}\n"
            f"  orientation {{\n    z: {np.sin(yaw / 2):.7f}\n    w: {np.cos(yaw / 2):.7f}\n  }}\n}}\n"
        )
    (tmp_path / "topic.txt").write_text("".join(blocks))
    draft = draft_map(open_recording(tmp_path / "topic.txt"))
    assert draft.time == "time: {source: header.stamp.sec, nanoseconds: header.stamp.nsec}"
    assert draft.of("yaw").status == "unsided" and draft.of("Y").sources == ("pose.position.y",)


@pytest.mark.parametrize("text", ["a: 1\nb: 2\nc: 3\n", "x,y\n1,2\n3,4\n5,6\n", "(a b)\n(c d)\n(e f)\n(g h)\n"])
def test_other_text_is_of_no_such_form(text):
    assert form_of_objects(text.encode()) == ""


def test_sensors_in_one_list_of_objects_with_numbers_in_quotes(car, tmp_path):
    """The x of a gyroscope and that of an accelerometer were one column, if it was read at all."""
    rows = []
    for t, r, a in zip(T, car.at("r", T), car.at("ay", T), strict=True):
        stamp = {"time": str(int((1.7e9 + t) * 1e9))}
        rows.append({"sensor": "Gyroscope", **stamp, "x": "0.001", "y": "0.002", "z": f"{r:.6f}"})
        rows.append({"sensor": "Accelerometer", **stamp, "x": "0.1", "y": f"{a:.6f}", "z": "9.8"})
    (tmp_path / "phone.json").write_text(json.dumps(rows))
    read = open_recording(tmp_path / "phone.json").read(["Gyroscope.z", "Accelerometer.y"])
    assert read["Gyroscope.z"].values == pytest.approx(car.at("r", T), abs=1e-6)
    assert read["Accelerometer.y"].values == pytest.approx(car.at("ay", T), abs=1e-6)


def test_lists_of_a_document_deep_inside_have_clocks_of_their_own(car, tmp_path):
    """Of two lists the longer one was read, and nothing said so; deeper ones were not found."""
    slow = np.arange(0.0, 40.0, 0.1)
    fast = [{"t": float(t), "yaw_rate": float(r)} for t, r in zip(T, car.at("r", T), strict=True)]
    gps = [{"t": float(t), "speed": float(v)} for t, v in zip(slow, car.at("vx", slow), strict=True)]
    for name, document in (
        ("flat", {"imu": fast, "gps": gps}),
        ("deep", {"1": {"streams": {"imu": {"samples": fast}, "gps": {"samples": gps}}}, "fps": 30}),
    ):
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
        read = open_recording(tmp_path / f"{name}.json").read(["yaw_rate", "speed"])
        assert read["yaw_rate"].values == pytest.approx(car.at("r", T)) and len(read["speed"].time) == len(slow)
        assert read["speed"].values == pytest.approx(car.at("vx", read["speed"].time))


def test_messages_of_a_bridge_share_the_stamp_of_their_header(car, tmp_path):
    """The stamp of one topic was the clock of all, and the other topic could not be read."""
    lines = []
    for k, t in enumerate(T):
        stamp = {"header": {"stamp": {"secs": 1_700_000_000 + int(t), "nsecs": k % 20 * 50_000_000}}}
        odom = {**stamp, "twist": {"twist": {"linear": {"x": float(car.at("vx", t))}}}}
        drive = {**stamp, "drive": {"steering_angle": float(car.at("delta", t))}}
        lines += [
            json.dumps({"op": "publish", "topic": f"/{n}", "msg": m}) for n, m in (("odom", odom), ("drive", drive))
        ]
    (tmp_path / "bridge.jsonl").write_text("\n".join(lines) + "\n")
    draft = draft_map(open_recording(tmp_path / "bridge.jsonl"))
    assert draft.time == "time: {source: stamp.secs, nanoseconds: stamp.nsecs}"
    assert draft.of("delta").sources == ("drive.drive.steering_angle",)
    assert "cannot be read" not in draft.of("delta").reason


def test_a_clock_in_one_number_that_passes_midnight_and_no_other_minute(car, tmp_path):
    """235959.95 and then 000000.00 were seconds: a drive that went back by 235,959 s, and fitted together."""
    lines = []
    for t, v, r in zip(T, car.at("vx", T), car.at("r", T), strict=True):
        s = (86390.0 + t) % 86400.0
        lines.append(f"{int(s // 3600):02d}{int(s % 3600 // 60):02d}{s % 60:05.2f},{v:.5f},{r:.6f}")
    (tmp_path / "night.csv").write_text("UTC,Speed [m/s],Gyro_Z [rad/s]\n" + "\n".join(lines) + "\n")
    time = open_recording(tmp_path / "night.csv").read(["UTC"])["UTC"].values
    assert time - time[0] == pytest.approx(T, abs=1e-6)


def test_words_that_alone_tell_rows_of_one_time_apart_are_cars(car, tmp_path):
    """Rows of two, told apart by `role_name`, were mixed and said to fit together."""
    lines = [
        f"{t:.2f},{name},{sign * v:.5f},{sign * r:.6f}"
        for t, v, r in zip(T, car.at("vx", T), car.at("r", T), strict=True)
        for name, sign in (("hero", 1.0), ("other", 0.5))
    ]
    (tmp_path / "roles.csv").write_text("time,role_name,v,omega\n" + "\n".join(lines) + "\n")
    draft = draft_map(open_recording(tmp_path / "roles.csv"))
    assert draft.rows.startswith("rows: {role_name: hero}")
    # A word that changes with the car's state tells no cars apart.
    states = [f"{t:.2f},{'left' if r > 0 else 'right'},{v:.5f}" for t, v, r in zip(T, T, car.at("r", T), strict=True)]
    (tmp_path / "state.csv").write_text("time,turn,v\n" + "\n".join(states) + "\n")
    assert not draft_map(open_recording(tmp_path / "state.csv")).rows
    # Nor does that of a message, whose rows have numbers of their own.
    kinds = [row for t in T for row in (f"{t:.2f},SPEED,{t + 9.0},", f"{t:.2f},GYRO,,{0.1 * t}")]
    (tmp_path / "kinds.csv").write_text("time,message,v,omega\n" + "\n".join(kinds) + "\n")
    assert not draft_map(open_recording(tmp_path / "kinds.csv")).rows


def test_lists_inside_objects_are_columns(car, tmp_path):
    document = {"time_s": T.tolist(), "velocity": {"longitudinal_kph": (3.6 * car.at("vx", T)).tolist()}}
    document["yaw"] = {"rate_dps": (DEG * car.at("r", T)).tolist()}
    (tmp_path / "columns.json").write_text(json.dumps(document))
    draft = draft_map(open_recording(tmp_path / "columns.json"))
    assert draft.of("vx").sources == ("velocity.longitudinal_kph",) and draft.of("vx").unit == "km/h"
    assert draft.of("r").sources == ("yaw.rate_dps",)


def test_vectors_have_the_clock_that_begins_as_they_do_or_that_their_rate_makes(car, tmp_path):
    """Vectors of another length than the first clock were left out, and v_x or r was not found."""
    fast = np.arange(0.0, 40.0, 0.02)
    np.savez(
        tmp_path / "log.npz",
        odom_t=((1.7e9 + T) * 1e9).astype(np.int64),
        odom_v=np.column_stack([car.at("vx", T), car.at("vy", T)]),
        imu_t=((1.7e9 + fast) * 1e9).astype(np.int64),
        imu_gyro_z=car.at("r", fast),
    )
    draft = draft_map(open_recording(tmp_path / "log.npz"))
    assert draft.of("vx").sources == ("odom_v[0]",) and draft.of("r").sources == ("imu_gyro_z",)
    with h5py.File(tmp_path / "daq.h5", "w") as file:
        for name, rate, values in (("vx", 20.0, car.at("vx", T)), ("yawrate", 50.0, car.at("r", fast))):
            file[f"channels/{name}"] = values
            file[f"channels/{name}"].attrs["sample_rate"] = rate
    read = open_recording(tmp_path / "daq.h5").read(["channels.vx", "channels.yawrate"])
    assert read["channels.yawrate"].time == pytest.approx(fast) and read["channels.vx"].time == pytest.approx(T)


@pytest.mark.parametrize("begins", ["<kml xmlns='x'>", "<gpx version='1.1'>", "<?xml version='1.0'?>"])
def test_xml_is_called_so_with_and_without_its_declaration(begins, tmp_path):
    (tmp_path / "track.kml").write_text(f"{begins}\n<Document>\n" + "<coord>10.2 52.1 100</coord>\n" * 9)
    with pytest.raises(LogError, match="is XML, which is not read"):
        open_recording(tmp_path / "track.kml")


@pytest.mark.parametrize("orient", ["columns", "index", "split"])
def test_frames_of_pandas_in_json(rows, orient, tmp_path):
    """They were refused as JSON without rows of numbers, in the form that pandas writes by default too."""
    table = dict(zip(NAMES, rows.T.tolist(), strict=True))
    count = range(len(rows))
    forms = {
        "columns": {name: {str(n): column[n] for n in count} for name, column in table.items()},
        "index": {str(n): {name: column[n] for name, column in table.items()} for n in count},
        "split": {"columns": list(table), "index": list(count), "data": rows.tolist()},
    }
    (tmp_path / "frame.json").write_text(json.dumps(forms[orient]))
    agrees(open_recording(tmp_path / "frame.json"), rows, abs_=1e-9)


def test_tracks_with_their_rows_and_cells_with_lists_are_told_what_to_do(rows, tmp_path):
    """Sixty-four states of a track were columns that are nearly empty; lists in cells could not be read."""
    states = [{"t": t, "v": v} for t, v in rows[:, :2].tolist()]
    (tmp_path / "tracks.json").write_text(json.dumps({"tracks": [{"id": n, "states": states} for n in range(3)]}))
    with pytest.raises(LogError, match=r"a list of 3 objects with a list of rows each \(states: 800 in the first\)"):
        open_recording(tmp_path / "tracks.json")
    parts = np.split(rows, 40)
    lists = {name: [part[:, place].tolist() for part in parts] for place, name in enumerate(("t", "vx", "yaw_rate"))}
    pq.write_table(pa.table(lists), tmp_path / "lists.parquet")
    assert "table.explode(['t', 'vx', 'yaw_rate'])" in draft_map(open_recording(tmp_path / "lists.parquet")).hints[0]


def test_a_folder_takes_tables_of_such_forms_for_logs_and_no_prose(rows, tmp_path):
    lines = [",".join([n, *(f"{v:.6f}" for v in column)]) for n, column in zip(NAMES, rows.T, strict=True)]
    (tmp_path / "side.txt").write_text("\n".join(lines) + "\n")
    assert not is_prose(tmp_path / "side.txt")
    (tmp_path / "read.txt").write_text("These logs are of the first of May.\nThe car had new tyres.\nAsk us.\nBye.\n")
    assert is_prose(tmp_path / "read.txt")


def test_text_in_which_any_line_might_be_the_first_of_values_is_judged_in_a_moment(tmp_path):
    """For each line all lines behind it were gathered: half a minute for 0.6 MB."""
    block = "pose {{\n  x: {n}\n  y: 2.5\n  label w\n}}\n"
    (tmp_path / "long.txt").write_text("".join(block.format(n=n) for n in range(16_000)))
    began = time.process_time()
    sniff(tmp_path / "long.txt")
    assert time.process_time() - began < 6.0  # of 1.5 s, and 12 s before
