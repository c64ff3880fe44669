"""Logs as loggers really write them: .vbo, AiM, rows quoted whole, CAN frames, several clocks, no clock."""

import os

import numpy as np
import pytest

from split_cli.errors import LogError, MapError
from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.readers.can import read_databases
from split_cli.logs.readers.joint import JointRecording
from split_cli.logs.readers.opening import open_recording
from tests.logs.planted import UNITS, PlantedDrive, planted_map, write_table
from tests.optional import needed

VBO = """File created on 12/09/2018 @ 12:47

[header]
satellites
time
latitude
longitude
velocity kmh
heading
Longacc
SWA
Yaw_Rate

[channel units]

rad
°/s

[comments]
Racelogic

[column names]
sats time lat long velocity heading Longacc SWA Yaw_Rate

[data]
"""


def vbo(tmp_path, ending: str = "\n"):
    rows = []
    for row in range(400):
        # Across a minute, so that HHMMSS.ss must be taken apart.
        seconds = 58.0 + 0.01 * row
        clock = f"1047{int(seconds):02d}.{round(100 * (seconds % 1)) % 100:02d}"
        if seconds >= 60.0:
            clock = f"1048{int(seconds - 60.0):02d}.{round(100 * (seconds % 1)) % 100:02d}"
        rows.append(f"053 {clock} +3608.25426832 -1087.02882814 072.00 195.27 +0.10 +1.5E-01 {row % 7}")
    rows.append("053 104819.340 +3608.25 -1087.02 000.01 178.63 +0.00 +0.0E+00 0")  # the stray sample
    path = tmp_path / "lap.VBO"
    path.write_bytes((VBO + "\n".join(rows) + "\n").replace("\n", ending).encode("latin-1"))
    return path


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_vbo_has_units_for_its_last_columns_degrees_east_and_no_stray_row(tmp_path, ending):
    recording = open_recording(vbo(tmp_path, ending))
    units = {info.name: info.unit for info in recording.channels()}
    assert (units["Longacc"], units["SWA"], units["Yaw_Rate"]) == ("g", "rad", "deg/s")
    assert (units["velocity"], units["lat"], units["time"]) == ("km/h", "deg", "s")
    read = recording.read(["time", "lat", "long"])
    assert len(read["time"].values) == 400
    np.testing.assert_allclose(np.diff(read["time"].values), 0.01, atol=1e-9)
    # 3608.25 arc minutes are 60.1376 degrees north; 1087.03 minutes "west positive" and negative are east.
    assert read["lat"].values[0] == pytest.approx(60.1375711, abs=1e-6)
    assert read["long"].values[0] == pytest.approx(18.1171471, abs=1e-6)
    assert any("last row" in note.what for note in recording.notes)


def test_digits_with_something_between_them_are_no_number(tmp_path):
    path = vbo(tmp_path)
    text = path.read_bytes()
    path.write_bytes(text.replace(b" 072.00 ", b" 07_2.00 ", 1))
    recording = open_recording(path)
    assert len(recording.read(["velocity"])["velocity"].values) == 399
    assert any(note.count == 1 and "cells" in note.what for note in recording.notes)
    (tmp_path / "lap.csv").write_text("t,vx\n" + "".join(f"{i},{'1_5' if i == 7 else i}\n" for i in range(40)))
    read = open_recording(tmp_path / "lap.csv").read(["vx"])["vx"].values
    assert np.flatnonzero(np.isnan(read)).tolist() == [7]


def test_a_real_vbo_reads(datasets):
    recording = open_recording(datasets / "kth_s90" / "S90__038.VBO")
    units = {info.name: info.unit for info in recording.channels()}
    assert len(units) == 76
    assert (units["SWA"], units["PtTqAtW_FL"], units["YawRate1"]) == ("rad", "N m", "rad/s")
    assert (units["Slip_COG"], units["YawRate"], units["Lng._Vel."]) == ("deg", "deg/s", "km/h")
    # Stockholm county, not the Atlantic.
    read = recording.read(["lat", "long", "time"])
    assert 59.0 < np.median(read["lat"].values) < 61.0 and 17.0 < np.median(read["long"].values) < 19.0
    assert np.max(np.diff(read["time"].values)) < 0.05


def test_aim_numbers_its_columns_under_the_units(tmp_path):
    path = tmp_path / "aim.csv"
    titles = "Time,GPS_Speed,Gear,RPM"
    head = ["Format,AIM CSV File,,", "Sample Rate,20,,", ",,,", titles, titles, "sec,mph,#,rpm", ",1,2,3", ",,,"]
    path.write_text("\n".join([*head, *(f"{0.05 * i:.2f},{100 + i},4,5000" for i in range(50))]) + "\n")
    recording = open_recording(path)
    assert [(c.name, c.unit) for c in recording.channels()] == [
        ("Time", "s"),
        ("GPS_Speed", "mph"),
        ("Gear", "#"),
        ("RPM", "rpm"),
    ]
    np.testing.assert_array_equal(recording.read(["GPS_Speed"])["GPS_Speed"].values[:2], [100.0, 101.0])


def test_rows_quoted_whole_are_taken_apart(tmp_path):
    path = tmp_path / "quoted.csv"
    rows = ["time,vx,yaw rate [deg/s]", *(f"{0.01 * i:.2f},{10 + i},{-i}" for i in range(100))]
    path.write_text("".join(f'"{row}"\n' for row in rows))
    recording = open_recording(path)
    assert [c.name for c in recording.channels()] == ["time", "vx", "yaw rate"]
    np.testing.assert_array_equal(recording.read(["yaw rate"])["yaw rate"].values, -np.arange(100.0))


DBC = """VERSION ""
BU_: ECU
BO_ 256 Steering: 8 ECU
 SG_ SteeringWheelAngle : 0|16@1- (0.1,0) [-1000|1000] "deg" ECU
BO_ 257 Motion: 8 ECU
 SG_ YawRate : 0|16@1- (0.01,0) [-300|300] "deg/s" ECU
 SG_ LatAcc : 16|16@1- (0.001,0) [-30|30] "m/s^2" ECU
"""


@pytest.fixture
def can_log(tmp_path, request):
    can = needed("can")
    cantools = needed("cantools")
    (tmp_path / "car.dbc").write_text(DBC)
    database = cantools.database.load_file(str(tmp_path / "car.dbc"))
    path = tmp_path / f"drive.{request.param}"
    writer = can.Logger(str(path))
    for row in range(300):
        for name, late, values in (
            ("Steering", 0.0, {"SteeringWheelAngle": 0.1 * row}),
            ("Motion", 0.004, {"YawRate": 0.02 * row, "LatAcc": 1.0}),
        ):
            message = database.get_message_by_name(name)
            data, stamp = message.encode(values), 1.7e9 + 0.01 * row + late
            writer.on_message_received(
                can.Message(timestamp=stamp, arbitration_id=message.frame_id, is_extended_id=False, data=data)
            )
        writer.on_message_received(
            can.Message(timestamp=1.7e9 + 0.01 * row + 0.005, arbitration_id=999, is_extended_id=False, data=b"12")
        )
    writer.stop()
    return path, tmp_path / "car.dbc"


@pytest.mark.parametrize("can_log", ["blf", "asc", "log", "trc"], indirect=True)
def test_can_frames_are_decoded_with_a_dbc_and_refused_without(can_log):
    path, database = can_log
    recording = open_recording(path, message_paths=[database])
    units = {info.name: info.unit for info in recording.channels()}
    assert units == {"/Steering/SteeringWheelAngle": "deg", "/Motion/YawRate": "deg/s", "/Motion/LatAcc": "m/s^2"}
    read = recording.read(["/Steering/SteeringWheelAngle", "/Motion/YawRate"])
    np.testing.assert_allclose(read["/Steering/SteeringWheelAngle"].values, 0.1 * np.arange(300), atol=1e-9)
    # Each message keeps its own clock: 4 ms apart here.
    late = read["/Motion/YawRate"].time - read["/Steering/SteeringWheelAngle"].time
    np.testing.assert_allclose(late, 0.004, atol=1e-4)
    assert [(n.what, n.count) for n in recording.notes] == [("frames of ids that no database defines", 300)]
    with pytest.raises(LogError, match="--dbc"):
        open_recording(path)


@pytest.mark.parametrize("can_log", ["blf", "trc"], indirect=True)
def test_frames_that_are_lost_are_counted_and_not_printed(can_log, capfd):
    path, database = can_log
    whole = path.read_bytes()
    assert "cut off" not in str(open_recording(path, message_paths=[database]).notes)
    # The last block of a BLF is cut; one line of a TRC has no data.
    lines = whole.split(b"\n")
    path.write_bytes(
        whole[:-90] if path.suffix == ".blf" else b"\n".join([*lines[:-40], lines[-40][:30], *lines[-39:]])
    )
    recording = open_recording(path, message_paths=[database])
    assert [note.count for note in recording.notes if "cut off or damaged" in note.what] == [1]
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("can_log", ["mf4"], indirect=True)
def test_bus_logging_in_mf4_is_decoded_with_a_dbc(can_log):
    needed("asammdf")
    path, database = can_log
    recording = open_recording(path, message_paths=[database])
    name = next(info.name for info in recording.channels() if info.name.endswith("SteeringWheelAngle"))
    np.testing.assert_allclose(recording.read([name])[name].values, 0.1 * np.arange(300), atol=1e-9)
    with pytest.raises(LogError, match="--dbc"):
        open_recording(path)


def test_a_database_that_is_missing_or_a_pipe_is_blamed_and_not_the_mf4(tmp_path):
    mdf = needed("asammdf")
    with mdf.MDF() as file:
        file.append([mdf.Signal(np.arange(9.0), 0.01 * np.arange(9), name="vx", unit="m/s")])
        log = file.save(tmp_path / "log.mf4")
    os.mkfifo(tmp_path / "pipe.dbc")
    for name, says in (("none.dbc", "none.dbc: is not there"), ("pipe.dbc", "pipe.dbc: is a pipe")):
        with pytest.raises(LogError, match=says):
            open_recording(log, message_paths=[tmp_path / name])


@pytest.mark.parametrize("can_log", ["log"], indirect=True)
def test_a_database_that_takes_all_memory_or_never_ends_is_refused(can_log, tmp_path):
    log, _ = can_log
    bad = tmp_path / "bad.dbc"
    bad.write_text(DBC.replace(": 8 ", ": 999999999 "))
    assert bad.read_text() != DBC
    with pytest.raises(LogError, match="takes more memory than its size allows"):
        open_recording(log, message_paths=[bad])
    bad.unlink()
    os.mkfifo(bad)
    with pytest.raises(LogError, match="is a pipe"):
        open_recording(log, message_paths=[bad])


@pytest.mark.parametrize("can_log", ["log"], indirect=True)
def test_a_comment_of_megabytes_in_a_dbc_costs_no_memory(can_log, tmp_path):
    """cantools takes 250 times its length: more than the first reading may, which would refuse the file."""
    _, plain = can_log
    talks = tmp_path / "talks.dbc"
    comment = 'says \\"no\\" ' * 400_000
    talks.write_text(f'{DBC}CM_ "{comment}";\nCM_ "short";\n')
    assert talks.stat().st_size > 4e6
    found, known = (read_databases([path]).messages for path in (talks, plain))
    assert [(m.name, [s.name for s in m.signals]) for m in found] == [
        (m.name, [s.name for s in m.signals]) for m in known
    ]
    # One that never ends is the grammar's to refuse.
    talks.write_text(f'{DBC}CM_ "{comment}')
    with pytest.raises(LogError, match="cannot be read as a CAN database"):
        read_databases([talks])


@pytest.mark.parametrize("can_log", ["log"], indirect=True)
def test_the_dbc_of_another_car_is_said(can_log, tmp_path):
    path, _ = can_log
    other = tmp_path / "other.dbc"
    other.write_text(DBC.replace("256", "512").replace("257", "513"))
    with pytest.raises(LogError, match="0x100"):
        open_recording(path, message_paths=[other])


def test_files_with_clocks_of_their_own_make_one_drive(tmp_path):
    planted = PlantedDrive(seconds=40.0)
    shares = {"a": (("vx", "vy", "T"), 50.0, "t_s"), "b": (("r", "delta"), 100.0, "time_ms")}
    for name, (channels, rate, clock) in shares.items():
        time = np.arange(0.0, 40.0, 1.0 / rate) + 0.003
        stamps = time * (1e3 if clock == "time_ms" else 1.0)
        write_table(tmp_path / f"{name}.csv", {clock: stamps, **{c: planted.at(c, time) for c in channels}})
    recording = JointRecording([open_recording(tmp_path / f"{name}.csv") for name in shares])
    assert {info.name for info in recording.channels()} == {"vx", "vy", "T", "r", "delta"}
    made = assemble_drive(recording, planted_map(("vx", "vy", "T", "r", "delta")), planted.vehicle)
    assert made.drive.rate == pytest.approx(50.0) and len(made.drive.metadata.sources) == 2
    t = made.drive["t"] + 0.003
    np.testing.assert_allclose(made.drive["r"][50:-50], planted.at("r", t)[50:-50], atol=2e-3)
    np.testing.assert_allclose(made.drive["vx"][50:-50], planted.at("vx", t)[50:-50], atol=2e-2)


def test_a_stretch_left_out_leaves_a_gap_and_the_ends_go():
    planted = PlantedDrive(seconds=40.0)
    settings = IngestSettings(start=5.0, end=35.0, cuts=((10.0, 12.0),))
    made = assemble_drive(planted.recording(), planted_map(), planted.vehicle, settings)
    assert len(made.drive.segments()) == 2
    assert len(made.drive) * made.drive.period == pytest.approx(28.0, abs=0.1)
    np.testing.assert_allclose(made.drive["vx"], planted.at("vx", made.drive["t"] + 5.0), atol=0.02)
    with pytest.raises(MapError, match="not longer than the gap"):
        assemble_drive(planted.recording(), planted_map(), planted.vehicle, IngestSettings(cuts=((3.0, 3.05),)))


def test_without_a_clock_the_yaw_tells_the_rate(tmp_path):
    planted = PlantedDrive(seconds=40.0)
    time = np.arange(0.0, 40.0, 0.008)
    write_table(tmp_path / "log.csv", {c: planted.at(c, time) for c in UNITS}, fmt="%.9g")
    recording = open_recording(tmp_path / "log.csv")
    with pytest.raises(MapError, match="says at 125 Hz"):
        assemble_drive(recording, planted_map(), planted.vehicle)
    made = assemble_drive(recording, planted_map(), planted.vehicle, IngestSettings(row_rate=125.0, rate=50.0))
    assert made.drive["t"][-1] == pytest.approx(40.0, abs=0.1)


def test_time_that_starts_again_at_each_lap_goes_on_behind(tmp_path):
    planted = PlantedDrive(seconds=40.0)
    time = np.arange(0.0, 40.0, 0.02)
    columns = {"time": np.where(time < 20.0, time, time - 20.0), **{c: planted.at(c, time) for c in UNITS}}
    write_table(tmp_path / "laps.csv", columns, fmt="%.9g")
    made = assemble_drive(open_recording(tmp_path / "laps.csv"), planted_map(), planted.vehicle)
    assert len(made.drive.segments()) == 2
    assert any("clock jumps back" in text for text in made.drive.metadata.conversions)
