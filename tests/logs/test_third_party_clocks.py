"""Faults first seen in logs of a first contact: several clocks in one table, units of the clock, names of angles."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

from split_cli.errors import ClockError
from split_cli.logs.assembling.assemble import assemble_drive
from split_cli.logs.drafting.candidates import candidates_of
from split_cli.logs.drafting.forms import hints_on_the_form
from split_cli.logs.drafting.naming import meanings
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.raw import RawChannelInfo
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.workflows.ingesting.ingest import open_logs
from tests.logs.planted import PlantedDrive
from tests.logs.readers_support import write_mcap

DEG = 180.0 / np.pi


@pytest.fixture(scope="module")
def car() -> PlantedDrive:
    return PlantedDrive(seconds=42.0)


def write(path: Path, columns: dict[str, np.ndarray | list[str]], separator: str = ",") -> Path:
    """Write columns of any lengths; the cells of a column that has ended stay empty."""
    texts = {
        title: values if isinstance(values, list) else [f"{value:.10g}" for value in values]
        for title, values in columns.items()
    }
    rows = max(map(len, texts.values()))
    lines = [separator.join(texts)]
    lines += [separator.join(v[k] if k < len(v) else "" for v in texts.values()) for k in range(rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("titles", [("Time 1 - 100Hz", "Time 2 - 50Hz", "Time 3 - 20Hz"), ("time", "time", "time")])
def test_each_column_takes_the_clock_before_it(car, tmp_path, titles):
    """A measuring amplifier exports its rates side by side; one clock for all made r five times too fast."""
    t, u, w = np.arange(0.0, 40.0, 0.01), np.arange(0.0, 40.0, 0.02) + 0.003, np.arange(0.0, 40.0, 0.05) + 0.007
    path = write(
        tmp_path / "rates.csv",
        {
            f"{titles[0]} [s]": t,
            "Ax [m/s^2]": car.at("ax", t),
            f"{titles[1]} [s] " if titles[0] != titles[1] else "time [s] ": u,
            "WheelTorque [Nm]": car.at("T", u),
            "SteerAngle [deg]": car.at("delta", u) * DEG,
            f"{titles[2]} [s]  ": w,
            "VelLong [km/h]": car.at("vx", w) * 3.6,
            "YawRate [deg/s]": car.at("r", w) * DEG,
        },
    )
    recording = open_recording(path)
    read = recording.read(["YawRate", "SteerAngle", "Ax"])
    for name, channel, factor in (("YawRate", "r", DEG), ("SteerAngle", "delta", DEG), ("Ax", "ax", 1.0)):
        assert read[name].values == pytest.approx(factor * car.at(channel, read[name].time), abs=1e-6)
    assert any(note.count == 3 and "clock of the columns behind" in note.what for note in recording.notes)
    draft = draft_map(recording)
    assert {draft.of(c).status for c in ("vx", "ax", "T")} == {"judged"}
    assert draft.of("delta").status == "unsided"


def test_a_second_time_of_the_same_rows_is_no_clock_of_its_own(car, tmp_path):
    t = np.arange(0.0, 40.0, 0.01)
    columns = {
        "Time [s]": t,
        "speed [m/s]": car.at("vx", t),
        "lap time [s]": np.mod(t, 17.0),
        "yaw rate [rad/s]": car.at("r", t),
        "GPS time [ms]": 1000.0 * t + 3.6e8,
        "Ay [m/s^2]": car.at("ay", t),
    }
    assert open_recording(write(tmp_path / "one.csv", columns)).read(["Ay"])["Ay"].time is None
    # A time that ends early rules no columns that go on.
    columns["GPS time [ms]"] = columns["GPS time [ms]"][:3000]
    assert open_recording(write(tmp_path / "two.csv", columns)).read(["Ay"])["Ay"].time is None
    # Nor does the hour, minute and second of the same rows, in one number that jumps by 40 at a full minute.
    of_day = 10 * 3600.0 + 35 * 60.0 + 40.0 + t
    minutes, seconds = np.divmod(of_day, 60.0)
    hours, minutes = np.divmod(minutes, 60.0)
    columns["GPS time"] = 1e4 * hours + 100.0 * minutes + seconds
    del columns["GPS time [ms]"], columns["Ay [m/s^2]"]
    columns["Ay [m/s^2]"] = car.at("ay", t)
    assert open_recording(write(tmp_path / "three.csv", columns)).read(["Ay"])["Ay"].time is None


@pytest.mark.parametrize(
    ("name", "unit", "channel"),
    [
        ("Angle de dérive", "deg", "sideslip"),
        ("Angolo di assetto", "deg", "sideslip"),
        ("Angle au volant", "deg", "steering_wheel_angle"),
        ("Angle de braquage roue avant", "deg", "delta"),
        ("Vitesse roue avant gauche", "km/h", "wheel_speed_fl"),
        ("Velocità ruota posteriore destra", "km/h", "wheel_speed_rr"),
        ("Velocidad rueda delantera izquierda", "km/h", "wheel_speed_fl"),
        ("Pression de freinage", "bar", "brake_pressure"),
        ("n_FL_rpm", "rpm", "wheel_speed_fl"),
        ("Drehzahl VL", "rpm", "wheel_speed_fl"),
        ("omega_RR", "rad/s", "wheel_speed_rr"),
        ("Angle de roulis", "deg", ""),
        ("Wankwinkel", "deg", ""),
        ("Angle de chasse", "deg", ""),
        ("Steering rate FL", "rad/s", ""),
        ("engine rpm", "rpm", ""),
    ],
)
def test_names_of_other_languages_and_of_wheels_by_their_unit(name, unit, channel):
    found = meanings(RawChannelInfo(name, "column", None, unit))
    assert (found[0].channel if found else "") == channel


def test_an_angle_of_something_else_is_no_steering(car, tmp_path):
    """A roll angle follows the curvature as a steer angle does, and its size may make a wheelbase."""
    t = np.arange(0.0, 40.0, 0.01)
    columns = {
        "Temps (s)": t,
        "Vitesse véhicule (km/h)": car.at("vx", t) * 3.6,
        "Vitesse de lacet (deg/s)": car.at("r", t) * DEG,
        "Accélération transversale (m/s²)": car.at("ay", t),
        "Angle au volant (°)": car.at("delta", t) * DEG * 15.4,
        "Angle de roulis (°)": car.at("ay", t) * 0.8,
        "Angle de dérive (°)": np.arctan2(car.at("vy", t), car.at("vx", t)) * DEG,
    }
    draft = draft_map(open_recording(write(tmp_path / "log.csv", columns, ";")))
    assert draft.of("delta").status == "open" and draft.of("delta").sources == ("Angle au volant",)
    assert draft.of("sideslip").sources == ("Angle de dérive",)


@pytest.mark.parametrize("clock", [True, False])
def test_a_simulators_clock_and_rates_in_degrees_are_known(car, tmp_path, clock):
    """CARLA's snapshot counts `elapsed_seconds`. Without it, deg/s read as rad/s made 57 times the rate of rows."""
    t = np.arange(0.0, 40.0, 0.05)
    columns = {
        "frame": 1000.0 + np.arange(len(t)),
        "elapsed_seconds": 12.3 + t,
        "location.x": car.at("X", t),
        "location.y": -car.at("Y", t),
        "rotation.yaw": -3.0 * car.at("yaw", t) * DEG,
        "angular_velocity.z": -3.0 * car.at("r", t) * DEG,
    }
    if not clock:
        del columns["elapsed_seconds"]
    line = draft_map(open_recording(write(tmp_path / "carla.csv", columns))).time
    assert line.startswith("time: {source: elapsed_seconds, unit: s}" if clock else "time: {period: 0.05}")


@pytest.mark.parametrize("day", [46354.5, 740313.5], ids=["spreadsheet", "datenum"])
def test_dates_in_days_are_a_clock(car, tmp_path, day):
    """A spreadsheet saves a moment as days since 1899, MATLAB since the year 0; as seconds rows are 0.1 us apart."""
    t = np.arange(0.0, 40.0, 0.02)
    columns = {
        "DateTime": [f"{day + one / 86400.0:.10f}" for one in t],
        "vx (m/s)": car.at("vx", t),
        "vy (m/s)": car.at("vy", t),
        "yaw rate (rad/s)": car.at("r", t),
        "ay (m/s^2)": car.at("ay", t),
        "road wheel angle (rad)": car.at("delta", t),
        "wheel torque (lb-ft)": car.at("T", t) / 1.3558179483,
    }
    recording = open_recording(write(tmp_path / "log.csv", columns))
    draft = draft_map(recording)
    assert draft.time.startswith("time: {source: DateTime, unit: d}")
    assert draft.of("T").unit == "lbf ft" and draft.of("T").status == "judged"
    drafted = yaml.safe_load(render_draft(draft, "log.csv"))
    made = assemble_drive(recording, map_from_mapping(drafted), car.vehicle)
    assert np.abs(made.drive["r"] - car.at("r", made.drive["t"])).max() < 1e-3
    del drafted["time"]
    with pytest.raises(ClockError, match="probably in d"):
        assemble_drive(recording, map_from_mapping(drafted), car.vehicle)


def test_two_files_of_messages_are_one_drive_by_their_clocks(car, tmp_path):
    """One recorder began 3 s after the other. A stamp in one topic stood for all, and each file counted from 0."""
    start = 1_700_000_000

    def recorded(name: str, topics: dict[str, tuple[float, dict[str, str]]], first: float) -> Path:
        messages = []
        for topic, (rate, fields) in topics.items():
            for t in np.arange(first, 40.0, 1.0 / rate):
                time = start * 10**9 + round(t * 1e9)
                content = {field: float(car.at(channel, t)) for field, channel in fields.items()}
                content |= {"header": {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}}}
                content["speeds"] = [float(car.at("vx", t)) * k for k in range(4)]
                messages.append((topic, time, time, json.dumps(content).encode()))
        messages.sort(key=lambda message: message[1])
        return write_mcap(tmp_path / name, ("J", "jsonschema", b""), "json", messages)

    motion = {"/odom": (100.0, {"vx": "vx", "vy": "vy"}), "/gnss": (20.0, {"x": "X"})}
    inputs = {"/imu": (50.0, {"yaw_rate": "r", "acc_y": "ay"}), "/drive": (25.0, {"angle": "delta"})}
    joined = open_logs([recorded("a.mcap", motion, 0.0), recorded("b.mcap", inputs, 3.0)])
    read = joined.read(["/odom/vx", "/gnss/x", "/imu/yaw_rate", "/drive/angle", "/imu/speeds[3]"])
    for name, channel, factor in (
        ("/odom/vx", "vx", 1.0),
        ("/gnss/x", "X", 1.0),
        ("/imu/yaw_rate", "r", 1.0),
        ("/drive/angle", "delta", 1.0),
        ("/imu/speeds[3]", "vx", 3.0),
    ):
        signal = read[name]
        assert signal.values == pytest.approx(factor * car.at(channel, signal.time - start), abs=1e-4)


@pytest.mark.parametrize("jump", [3600.0, 1.7e9], ids=["a pause", "a clock set by a satellite receiver"])
def test_what_follows_a_long_pause_is_judged_too(car, tmp_path, jump):
    """The draft's clock covers 20 minutes; a log whose clock is set after a second lost all that it could judge."""
    t = np.arange(0.0, 40.0, 0.02)
    columns = {
        "time [s]": [f"{one:.3f}" for one in np.where(t < 0.9, t, t + jump)],
        "vx [km/h]": car.at("vx", t) * 3.6,
        "yaw rate [deg/s]": car.at("r", t) * DEG,
        "ay [g]": car.at("ay", t) / 9.80665,
        "delta": car.at("delta", t),
        "wheel torque [Nm]": car.at("T", t),
    }
    draft = draft_map(open_recording(write(tmp_path / "log.csv", columns)))
    assert {c: draft.of(c).status for c in ("vx", "T", "r", "ay", "delta")} == {
        "vx": "judged", "T": "judged", "r": "unsided", "ay": "unsided", "delta": "unsided"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "channel", "unit"),
    [
        ("yaw_rate_rad_per_s", "r", "rad/s"),
        ("Yaw_deg_per_s", "r", "deg/s"),
        ("yawRateDegPerSec", "r", "deg/s"),
        ("vx_m_per_s", "vx", "m/s"),
        ("speed_kilometers_per_hour", "vx", "km/h"),
        ("accel_x_m_per_s2", "ax", "m/s^2"),
        ("accel_y_m_per_s_squared", "ay", "m/s^2"),
        ("/imu/yaw_rate_rad_per_s", "r", "rad/s"),
        ("/odom/pose/pose/orientation/yaw", "yaw", None),
    ],
)
def test_units_in_words_at_the_end_of_a_name(tmp_path, name, channel, unit):
    """What ends with `_per_s` was in seconds, and so no channel at all."""
    t = np.arange(0.0, 20.0, 0.05)
    path = write(tmp_path / "log.csv", {"time [s]": t, name: np.sin(t)})
    recording = open_recording(path)
    [found] = candidates_of(recording, recording.channels())
    assert (found.channel, found.unit) == (channel, unit)


def test_tables_of_pandas_in_hdf5_have_their_titles(car, tmp_path):
    """Of a frame of several types each block has its list of titles; a table has a field for each column."""
    t = np.arange(0.0, 20.0, 0.05)
    floats = {"time": t, "vx": car.at("vx", t)}
    whole = {"gear": np.full(len(t), 3), "yaw_rate": np.round(1000.0 * car.at("r", t)).astype(np.int64)}
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        group = file.create_group("df")
        for number, block in enumerate((floats, whole)):
            group[f"block{number}_items"] = np.array([name.encode() for name in block])
            group[f"block{number}_values"] = np.column_stack(list(block.values()))
    read = open_recording(tmp_path / "frame.h5").read(["df.vx", "df.yaw_rate", "df.gear"])
    assert read["df.vx"].values == pytest.approx(car.at("vx", t)) and np.all(read["df.gear"].values == 3)
    assert read["df.yaw_rate"].values == pytest.approx(whole["yaw_rate"])

    kinds = [("index", "<i8"), ("vx", "<f8"), ("note", "S4"), ("values_block_0", "<f8", (2,))]
    rows = np.zeros(len(t), dtype=kinds)
    rows["vx"], rows["values_block_0"] = car.at("vx", t), np.column_stack([car.at("r", t), t])
    with h5py.File(tmp_path / "table.h5", "w") as file:
        file["df/table"] = rows
    table = open_recording(tmp_path / "table.h5")
    assert table.read(["df.table.vx"])["df.table.vx"].values == pytest.approx(car.at("vx", t))
    assert table.read(["df.table.values_block_0[0]"])["df.table.values_block_0[0]"].values == pytest.approx(
        car.at("r", t)
    )
    assert any(note.count == 2 and "data_columns=True" in note.what for note in table.notes)


def test_rows_without_their_last_separators_are_filled_up(car, tmp_path):
    """An exporter that cuts empty cells off leaves titles that fit half of the rows: the others had been lost."""
    t = np.arange(0.0, 10.0, 0.02)
    columns = {"time [s]": t, "r [rad/s]": car.at("r", t), "time [s] ": t[:200], "vx [m/s]": car.at("vx", t[:200])}
    path = write(tmp_path / "log.csv", columns)
    path.write_text("\n".join(line.rstrip(",") for line in path.read_text().splitlines()) + "\n")
    recording = open_recording(path)
    read = recording.read(["r", "vx"])
    assert read["r"].values == pytest.approx(car.at("r", t)) and read["r"].time == pytest.approx(t)
    assert read["vx"].values == pytest.approx(car.at("vx", t[:200]))
    assert any("cut off" in note.what for note in recording.notes)


def test_rows_that_all_lack_cells_are_told_with_both_numbers(tmp_path):
    rows = [f"{0.02 * n},{n}" for n in range(500)]
    (tmp_path / "log.csv").write_text("\n".join(["time [s],r [rad/s],time [s],vx [m/s]", *rows]))
    recording = open_recording(tmp_path / "log.csv")
    [advice] = hints_on_the_form(recording, recording.channels())
    assert "4 titles stand before 2 columns of values" in advice and "separators" in advice


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "m/s"), (3.6, "km/h")])
def test_a_lateral_velocity_beside_a_speed_in_km_h_is_in_the_unit_that_a_y_tells(car, tmp_path, factor, unit):
    """A service writes `speed_kmh` beside `v_lat` of its estimator: v_y in km/h was 3.6 times too small."""
    t = np.arange(0.0, 40.0, 0.02)
    columns = {
        "time [s]": t,
        "speed_kmh": car.at("vx", t) * 3.6,
        "v_lat": car.at("vy", t) * factor,
        "yaw_rate_dps": car.at("r", t) * DEG,
        "acc_y_ms2": car.at("ay", t),
    }
    found = draft_map(open_recording(write(tmp_path / "log.csv", columns))).of("vy")
    assert found.status == "assumed" and (found.unit or "m/s") == unit


@pytest.mark.parametrize("fine", [False, True], ids=["whole seconds", "a time that is fine itself"])
def test_milliseconds_beside_a_clock_of_the_day_are_its_parts(car, tmp_path, fine):
    """A logger writes 23:59:58 and 120 in two columns; by the first alone rows came once a second."""
    t = np.arange(0.0, 20.0, 0.04)
    day = (86398.0 + t) % 86400.0
    clock = [f"{int(s // 3600):02}:{int(s // 60) % 60:02}:{s % 60:0{6 if fine else 2}.{3 if fine else 0}f}" for s in
             (day if fine else np.floor(day + 1e-6))]  # fmt: skip
    columns = {
        "Time": clock,
        "Millisecond": [f"{round(s * 1000) % 1000}" for s in day],
        "vx [m/s]": car.at("vx", t),
        "vy [m/s]": car.at("vy", t),
        "yaw rate [rad/s]": car.at("r", t),
        "road wheel angle [rad]": car.at("delta", t),
        "wheel torque [Nm]": car.at("T", t),
    }
    recording = open_recording(write(tmp_path / "log.csv", columns))
    draft = draft_map(recording)
    assert ("milliseconds: Millisecond" in draft.time) is not fine
    made = assemble_drive(recording, map_from_mapping(yaml.safe_load(render_draft(draft, "log.csv"))), car.vehicle)
    assert made.drive["t"][-1] == pytest.approx(t[-1], abs=0.05)
    assert np.abs(made.drive["r"] - car.at("r", made.drive["t"])).max() < 1e-3
