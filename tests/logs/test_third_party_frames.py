"""Lines of CAN frames as programs write them that no reader is known by name for, and rows of several cars."""

import struct

import numpy as np
import pytest
import yaml

from split_cli.errors import MapError
from split_cli.logs.assembling.assemble import assemble_drive
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.one_car import several_cars
from split_cli.logs.readers.frames_text import frames_in_lines, is_text_of_frames
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.workflows.ingesting.init import init_project
from tests.logs.planted import write_table
from tests.optional import needed

DEG = 180.0 / np.pi
DBC = 'VERSION ""\nBU_: E\nBO_ 256 ESP: 8 E\n SG_ Speed : 0|16@1+ (0.01,0) [0|655] "km/h" E\n'
DBC += ' SG_ YawRate : 16|16@1- (0.01,0) [-300|300] "deg/s" E\n'


def stamp(seconds):
    whole, part = divmod(seconds, 1.0)
    return f"{int(whole) // 3600 % 24}:{int(whole) // 60 % 60}:{int(whole) % 60}:{int(1e4 * part):04d}"


FORMS = {
    "candump": ("", lambda t, data: f" ({1_718_000_000 + t:.6f})  can0  100   [8]  {data}"),
    "BusMaster": ("***HEX***\n", lambda t, data: f"{stamp(86_380.0 + t)} Rx 1 0x100 s 8 {data}"),
    "bytes": ("Time_ms;ID;DLC;D0\n", lambda t, data: f"{1e3 * t:.3f};0x100;8;{data.replace(' ', ';')}"),
    "counts": ("time,id,len,bytes\n", lambda t, data: f"{5_000 + 1e3 * t:.0f},100,8,{data}"),
    "Kvaser": ("Chn Identifier Flg DLC D0..D7 Time Dir\n", lambda t, data: f" 0 00000100   8  {data}  {t:.6f} R"),
}


def written(form, car):
    """Return the text of a log, its times [s], and the two quantities in its frames."""
    t = np.arange(0.0, 40.0, 0.1)
    speed, rate = 3.6 * car.at("vx", t), DEG * car.at("r", t)
    head, line = FORMS[form]
    frames = [struct.pack("<Hhxxxx", round(100 * v), round(100 * w)).hex(" ") for v, w in zip(speed, rate, strict=True)]
    return head + "\n".join(map(line, t, frames)) + "\n", t, speed, rate


@pytest.mark.parametrize("form", FORMS)
def test_lines_of_frames_are_known_by_their_count_of_bytes(form, car, tmp_path):
    """Time, identifier, a count and so many bytes: each of these was no table, or one of numbers."""
    text, t, speed, rate = written(form, car)
    assert is_text_of_frames(text[:4096].encode())
    (tmp_path / "bus.log").write_text(text)
    frames = [frame for frame in frames_in_lines(tmp_path / "bus.log") if frame is not None]
    assert {frame.arbitration_id for frame in frames} == {0x100}
    values = np.array([struct.unpack("<Hhxxxx", frame.data) for frame in frames]) / 100.0
    assert values == pytest.approx(np.column_stack([speed, rate]), abs=0.0051)
    # BusMaster counts tenths of milliseconds.
    assert np.array([f.timestamp - frames[0].timestamp for f in frames]) == pytest.approx(t, abs=2e-4)


def test_lines_of_frames_are_decoded_by_their_data_base(car, tmp_path):
    needed("can")
    text, t, speed, _ = written("BusMaster", car)
    (tmp_path / "bus.log").write_text(text)
    (tmp_path / "bus.dbc").write_text(DBC)
    recording = open_recording(tmp_path / "bus.log", message_paths=[tmp_path / "bus.dbc"])
    read = recording.read(["/ESP/Speed"])["/ESP/Speed"]
    assert read.values == pytest.approx(speed, abs=0.0051) and read.time == pytest.approx(t, abs=2e-4)


def test_numbers_in_a_table_are_no_bytes():
    rows = "".join(f"{0.01 * n:.2f},100,3,{10 + n % 80},{20 + n % 70},{30 + n % 60}\n" for n in range(50))
    assert not is_text_of_frames(b"time,rpm,gear,a,b,c\n" + rows.encode())


def test_a_line_that_holds_no_frame_is_counted(tmp_path):
    (tmp_path / "bus.log").write_text(" (0.1) can0 100 [2] 0A FF\n (0.2) can0 100 [2] 0A\n (0.3) can0 100 [0]\n")
    first, *others = frames_in_lines(tmp_path / "bus.log")
    assert (first.timestamp, first.arbitration_id, first.data) == (0.1, 256, b"\x0a\xff") and others == [None, None]


def test_an_asc_log_may_count_from_the_frame_before(car, tmp_path):
    """Of `timestamps relative` one sample was left: all frames but the first had the time of another."""
    needed("can")
    (tmp_path / "bus.dbc").write_text(DBC)
    t = np.arange(0.0, 40.0, 0.05)
    head = ["date Sat Nov 28 02:03:40.120 pm 2026", "base hex  timestamps relative", "internal events logged"]
    steps = np.diff(t, prepend=0.0)
    lines = [
        f"   {step:.6f} 1  100             Rx   d 8 {struct.pack('<Hhxxxx', round(360 * v), 0).hex(' ')}"
        for step, v in zip(steps, car.at("vx", t), strict=True)
    ]
    (tmp_path / "bus.asc").write_text("\r\n".join([*head, *lines, "End TriggerBlock"]) + "\r\n")
    speed = open_recording(tmp_path / "bus.asc", message_paths=[tmp_path / "bus.dbc"]).read(["/ESP/Speed"])
    assert speed["/ESP/Speed"].time == pytest.approx(t, abs=1e-6)
    assert speed["/ESP/Speed"].values == pytest.approx(3.6 * car.at("vx", t), abs=0.0051)


def two_cars(car, t, names):
    """Return the columns of one car and of another that is 7 s behind, row by row in turn."""
    columns = {"time_s": np.repeat(t, 2), "car_id": np.tile(names, len(t)).astype(float)}
    for title, channel, factor in (("vx_mps", "vx", 1.0), ("yaw_rate_dps", "r", DEG), ("ay_mps2", "ay", 1.0)):
        columns[title] = factor * np.stack([car.at(channel, t), 0.8 * car.at(channel, t[::-1])], axis=1).ravel()
    return columns


@pytest.mark.parametrize("sorted_by_car", [False, True])
def test_rows_of_two_cars_are_said_and_never_mixed(sorted_by_car, car, tmp_path):
    """They were taken as one car, and nothing said so."""
    t = np.arange(0.0, 40.0, 0.02)
    columns = two_cars(car, t, [44, 63])
    order = np.argsort(columns["car_id"], kind="stable") if sorted_by_car else slice(None)
    write_table(tmp_path / "race.csv", {name: values[order] for name, values in columns.items()})
    recording = open_recording(tmp_path / "race.csv")
    draft = draft_map(recording)
    assert {draft.of(c).status for c in ("vx", "r", "ay")} <= {"judged", "unsided"}
    drafted = yaml.safe_load(render_draft(draft, "race.csv"))
    assert drafted["rows"] == {"car_id": "44"}
    steps = init_project([tmp_path / "race.csv"], tmp_path / "car").next_steps
    assert any("the rows of 2 cars by its column 'car_id' (44, 63)" in step for step in steps)
    entries = {c: {"source": s} for c, s in (("vx", "vx_mps"), ("r", "yaw_rate_dps"), ("ay", "ay_mps2"))}
    entries |= {c: {"source": "vx_mps", "scale": 1e-3, "unit": u} for c, u in (("vy", "m/s"), ("T", "N m"))}
    entries["delta"] = {"source": "yaw_rate_dps", "unit": "deg"}
    content = {"time": {"source": "time_s"}, "channels": entries}
    with pytest.raises(MapError, match="2 cars") as refused:
        assemble_drive(recording, map_from_mapping(content), car.vehicle)
    assert "rows: {car_id: 44}" in refused.value.advice
    drive = assemble_drive(recording, map_from_mapping({**content, "rows": {"car_id": 44}}), car.vehicle).drive
    assert drive.columns["vx"] == pytest.approx(car.at("vx", drive.columns["t"]), abs=2e-3)
    with pytest.raises(MapError, match="no row has '7'"):
        assemble_drive(recording, map_from_mapping({**content, "rows": {"car_id": 7}}), car.vehicle)


def test_drivers_with_names_are_told_apart_in_a_table_and_in_json(car, tmp_path):
    t = np.arange(0.0, 40.0, 0.02)
    rows = [(x, name, f * car.at("vx", x)) for x in t for name, f in (("HAM", 1.0), ("RUS", 0.5))]
    (tmp_path / "race.csv").write_text("t,driver,v\n" + "\n".join(f"{x:.2f},{name},{v:.5f}" for x, name, v in rows))
    lines = [f'{{"t": {x:.2f}, "driver": "{name}", "v": {v:.5f}}}' for x, name, v in rows]
    (tmp_path / "race.jsonl").write_text("\n".join(lines))
    for name in ("race.csv", "race.jsonl"):
        found = several_cars(open_recording(tmp_path / name))
        assert found.column == "driver" and found.counts == {"HAM": len(t), "RUS": len(t)}


def test_drivers_who_take_turns_in_one_car_are_one_car(car, tmp_path):
    t = np.arange(0.0, 40.0, 0.02)
    rows = [f"{x:.2f},{'A' if x < 20.0 else 'B'},{car.at('vx', x):.5f}" for x in t]
    (tmp_path / "stint.csv").write_text("t,driver,v\n" + "\n".join(rows))
    assert several_cars(open_recording(tmp_path / "stint.csv")) is None
    seen = [f"{x:.2f},{int(x / 5.0) % 3},{car.at('vx', x):.5f}" for x in t]  # objects that a radar sees again
    (tmp_path / "radar.csv").write_text("t,object_id,v\n" + "\n".join(seen))
    assert several_cars(open_recording(tmp_path / "radar.csv")) is None


def test_a_clock_of_the_lap_starts_again_for_one_car(car, tmp_path):
    t = np.arange(0.0, 40.0, 0.02)
    rows = [f"{x % 20.0:.2f},{'A' if x < 20.0 else 'B'},{car.at('vx', x):.5f}" for x in t]
    (tmp_path / "laps.csv").write_text("lap_time_s,driver,v\n" + "\n".join(rows))
    assert several_cars(open_recording(tmp_path / "laps.csv")) is None
