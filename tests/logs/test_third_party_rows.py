"""Rows written as JSON, blocks with clocks of their own, and what a name says of wheels, axles and commands."""

import json

import numpy as np
import pytest

from split_cli.errors import LogError
from split_cli.logs.drafting.message_fields import field_candidates
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.raw import RawChannelInfo, RawSignal, TableRecording
from split_cli.logs.readers.opening import open_recording
from tests.logs.test_third_party_exports import CHANNELS, ingested
from tests.logs.test_third_party_styles import DEG


@pytest.fixture(scope="module")
def driven(planted) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    t = np.arange(0.0, 60.0, 0.01)
    return t, {name: planted.at(name, t) for name in (*CHANNELS, "ax", "ay")}


def lines(t, c, every=2):
    return [
        {
            "stamp": {"sec": 1_700_000_000 + int(t[k]), "nanosec": round(t[k] % 1 * 1e9)},
            "mode": "auto",
            "imu": {"gyro": {"z": c["r"][k]}},
            "vel": {"vx": c["vx"][k], "vy": c["vy"][k]},
            "pose": [c["X"][k], c["Y"][k]],
            "steer_rad": c["delta"][k],
            "torque_total_nm": c["T"][k],
        }
        for k in range(0, len(t), every)
    ]


def test_an_object_a_line_is_read_by_the_addresses_of_its_numbers(planted, driven, tmp_path):
    rows = [json.dumps(row) for row in lines(*driven)]
    rows[40] = rows[40][:30]  # a line cut off
    (tmp_path / "log.jsonl").write_text("\n".join(rows) + "\n")
    draft = ingested(tmp_path / "log.jsonl", planted, tmp_path)
    assert draft.of("r").sources == ("imu.gyro.z",)
    recording = open_recording(tmp_path / "log.jsonl")
    east = recording.read(["pose[0]"])["pose[0]"].values
    np.testing.assert_array_equal(east, np.delete(driven[1]["X"][::2], 40))
    assert [note.count for note in recording.notes] == [1]


@pytest.mark.parametrize("form", ["list", "columns", "inside"])
def test_json_in_one_piece_holds_the_same_numbers(driven, tmp_path, form):
    t, c = driven
    moments = [f"2026-05-02T10:00:{x:09.6f}Z" for x in t[:300:3]]
    table = {"time": moments, "vx [km/h]": list(c["vx"][:300:3] * 3.6), "yaw_rate": list(c["r"][:300:3])}
    rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
    written = {"list": rows, "columns": table, "inside": {"car": "A7", "samples": rows}}[form]
    (tmp_path / "log.json").write_text(json.dumps(written, indent=1))
    read = open_recording(tmp_path / "log.json").read(["time", "vx", "yaw_rate"])
    assert read["vx"].unit == "km/h"
    np.testing.assert_array_equal(read["yaw_rate"].values, c["r"][:300:3])
    np.testing.assert_allclose(np.diff(read["time"].values), 0.03, atol=1e-6)


def test_json_lines_may_hold_vectors_inside_objects(tmp_path):
    rows = [json.dumps({"t": 0.1 * k, "imu": {"gyro": [k, 2 * k], "a": [0.0, 1.0]}}) for k in range(5)]
    (tmp_path / "log.jsonl").write_text("\n".join(rows))
    read = open_recording(tmp_path / "log.jsonl").read(["t", "imu.gyro[1]"])
    np.testing.assert_array_equal(read["imu.gyro[1]"].values, 2.0 * np.arange(5))


def test_json_without_rows_of_numbers_is_told_so(tmp_path):
    row = json.dumps({"channels": {"vx": list(range(40)), "r": list(range(30))}})  # a document, no row of 70
    for text in (row, '{"name": "car"}', '[{"name": "car"}]', '{"a": {"b": "c"}}\n{"a": 1', "{" + '"a":[' * 5000):
        (tmp_path / "log.json").write_text(text)
        with pytest.raises(LogError, match="JSON without rows of numbers"):
            open_recording(tmp_path / "log.json")


def test_each_block_of_a_pi_toolbox_export_has_its_own_clock(planted, driven, tmp_path):
    t, c = driven
    made = ["PiToolboxVersionedASCIIDataSet", "Version\t2", "", "{OutingInformation}", "CarName\tCar 7", ""]
    for title, values, every in (
        ("Speed[kph]", c["vx"] * 3.6, 2),
        ("YawRate[deg/s]", c["r"] * DEG, 1),
        ("VelLat[m/s]", c["vy"], 2),
        ("X[m]", c["X"], 5),
        ("Y[m]", c["Y"], 5),
        ("RoadWheelAngle[deg]", c["delta"] * DEG, 4),
        ("TotalWheelTorque[Nm]", c["T"], 3),
    ):
        made += ["{ChannelBlock}", f"Time\t{title}"]
        made += [f"{a:.3f}\t{b:.9g}" for a, b in zip(t[::every], values[::every], strict=True)]
        made.append("")
    (tmp_path / "outing.txt").write_text("\n".join(made))
    draft = ingested(tmp_path / "outing.txt", planted, tmp_path)
    assert draft.of("T").sources == ("TotalWheelTorque",)
    recording = open_recording(tmp_path / "outing.txt")
    assert len(recording.read(["X"])["X"].time) == 1200 and len(recording.read(["YawRate"])["YawRate"].time) == 6000


def test_one_block_of_a_pi_toolbox_export_is_a_table(driven, tmp_path):
    t, c = driven
    rows = [f"{a:.3f}\t{b:.6f}".replace(".", ",") for a, b in zip(t, c["vx"], strict=True)]
    (tmp_path / "o.txt").write_text(
        "\n".join(["PiToolboxVersionedASCIIDataSet", "{ChannelBlock}", "Time\tv[m/s]", *rows, "x\t1"])
    )
    recording = open_recording(tmp_path / "o.txt")
    assert recording.read(["v"])["v"].time is None and recording.notes[0].count == 1
    np.testing.assert_allclose(recording.read(["v"])["v"].values, c["vx"], atol=1e-6)


def test_a_row_of_units_may_hold_the_pattern_of_a_clock_and_units_with_hyphens(planted, driven, tmp_path):
    t, c = driven
    clock = [f"14:{int(x // 60):02d}:{x % 60:06.3f}".replace(".", ",") for x in t]
    table = {
        "Uhrzeit": clock,
        "Datum": ["02.05.2026"] * len(t),
        "Vx": c["vx"] * 3.6,
        "Vy": c["vy"] * 3.6,
        "AVz": c["r"] * DEG,
        "Ay": c["ay"] / 9.80665,
        "StrK_L1": c["delta"] * DEG,
        "StrK_R1": c["delta"] * DEG,
        "M_Wheels_Total": c["T"],
    }
    units = ["hh:mm:ss,000", "TT.MM.JJJJ", "km/h", "km/h", "deg/s", "g's", "deg", "deg", "N-m"]
    cells = zip(
        *([x if isinstance(x, str) else f"{x:.9g}".replace(".", ",") for x in v] for v in table.values()), strict=True
    )
    text = "\n".join([";".join(table), ";".join(units), *(";".join(row) for row in cells)])
    (tmp_path / "log.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    draft = ingested(tmp_path / "log.csv", planted, tmp_path)
    assert draft.of("ay").unit == "g" and draft.of("T").unit == "N m" and draft.of("delta").convert == "pair_mean"


def test_a_column_of_names_beside_the_numbers_of_a_parquet_file_is_left_alone(planted, driven, tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    t, c = driven
    stamps = pa.array((1.7e15 + np.round(t * 1e6)).astype("int64"), pa.timestamp("us", "Europe/Berlin"))
    table = {
        "recorded_at": stamps,
        "vehicle_id": pa.array(["A7"] * len(t)).dictionary_encode(),
        "driver": ["X"] * len(t),
    }
    table |= {
        "speed_mps": c["vx"].astype(np.float32),
        "v_lat_mps": c["vy"],
        "yaw_rate_dps": c["r"] * DEG,
        "road_wheel_angle_deg": c["delta"] * DEG,
        "wheel_torque_nm": c["T"],
    }
    pq.write_table(pa.table(table), tmp_path / "log.parquet")
    draft = ingested(tmp_path / "log.parquet", planted, tmp_path)
    assert draft.time.startswith("time: {source: recorded_at")


def torques(driven, **shares) -> TableRecording:
    t, c = driven
    columns = {"t": t, "vx": c["vx"], "vy": c["vy"], "yaw_rate": c["r"]}
    columns |= {name: share * c["T"] for name, share in shares.items()}
    signals = {name: RawSignal(name, None, v, "N m" if name in shares else None) for name, v in columns.items()}
    return TableRecording("log.csv", None, signals)


def test_torques_of_two_axles_are_summed_and_that_of_one_is_not_taken_for_the_whole(driven):
    both = draft_map(torques(driven, Antriebsmoment_Hinterachse=0.55, Antriebsmoment_Vorderachse=0.45)).of("T")
    assert len(both.sources) == 2 and both.convert == "sum" and both.status == "judged"
    one = draft_map(torques(driven, DriveTorqueRear=0.55)).of("T")
    assert one.status == "assumed" and "rear axle alone" in one.reason


def test_a_brakes_torque_beside_four_of_the_drive_does_not_hide_their_sum(driven):
    four = {f"PT.W{w}.Trq_Drive": 0.25 for w in ("FL", "FR", "RL", "RR")}
    drawn = draft_map(torques(driven, **four, **{"Brake.Trq_FL": 0.1}))
    assert drawn.of("T").sources == tuple(four) and drawn.of("T").status == "judged"


def test_what_is_asked_for_is_no_measured_acceleration_and_an_accel_message_is_no_velocity():
    infos = [
        RawChannelInfo(name, "any/msg/Any", None)
        for name in (
            "/control/command/control_cmd/longitudinal.acceleration",
            "/vesc/ackermann_cmd_mux/output/drive.speed",
            "/localization/acceleration/accel.accel.linear.x",
        )
    ]
    found = [(channel, sources[0]) for channel, sources, _ in field_candidates(infos)]
    assert found == [("ax", "/localization/acceleration/accel.accel.linear.x")]

    t = np.arange(0.0, 30.0, 0.02)
    values = 15.0 + np.sin(t)
    signals = {i.name: RawSignal(i.name, t, values, None) for i in infos}
    recording = TableRecording("a.mcap", None, signals, type_name="any/msg/Any", clocks=("log",))
    drawn = draft_map(recording)
    assert drawn.of("vx") is None and drawn.of("ax").sources == (infos[2].name,)


def test_an_accelerometer_is_along_the_car_though_the_velocity_beside_it_is_not(driven):
    t, c = driven
    cos, sin = np.cos(c["yaw"]), np.sin(c["yaw"])
    columns = {
        "t": t,
        "x": c["X"],
        "y": c["Y"],
        "yaw": c["yaw"],
        "yaw_rate": c["r"],
        "vx": c["vx"] * cos - c["vy"] * sin,
        "vy": c["vx"] * sin + c["vy"] * cos,
        "ax": c["ax"],
        "ay": c["ay"],
    }
    drawn = draft_map(TableRecording("log.csv", None, {n: RawSignal(n, None, v, None) for n, v in columns.items()}))
    assert drawn.of("vx").status == drawn.of("vy").status == "open"
    assert drawn.of("ay").status in ("judged", "unsided") and drawn.of("ax").status == "judged"


def test_fields_that_begin_late_are_listed_and_those_of_few_rows_told(tmp_path):
    """A sensor that starts after a third of the log is a column; what one row alone has is counted."""
    rows = [{"time": 0.01 * n, "vx": 10.0} | ({"imu": {"r": 0.1}} if n > 1000 else {}) for n in range(3000)]
    rows[700]["rare"] = 1.0
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, rows)) + "\n")
    recording = open_recording(tmp_path / "log.jsonl")
    assert [info.name for info in recording.channels()] == ["time", "vx", "imu.r"]
    read = recording.read(["imu.r"])["imu.r"].values
    assert np.isnan(read[:1001]).all() and np.all(read[1001:] == 0.1)
    assert [(note.what, note.count) for note in recording.notes] == [("fields of few rows, not listed: rare", 1)]
