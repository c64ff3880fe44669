"""Logs with one value a row and its signal's name beside it, and logs with other odd beginnings, planted."""

import json

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.raw import RawSignal
from split_cli.logs.readers.cells import seconds_of
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from tests.logs.planted import PlantedDrive
from tests.optional import needed

DEG = 180.0 / np.pi
INFLUX = (
    "#group,false,false,true,true,false,false,true,true\n"
    "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,string\n"
    ",result,table,_start,_stop,_time,_value,_field,_measurement\n"
)


@pytest.fixture(scope="module")
def rows() -> list[tuple[float, str, float, str]]:
    """Time, name, value and unit of five signals of other rates, in the order of time."""
    drive = PlantedDrive(seconds=60.0)
    made = []
    signals = (
        ("vehicle_speed", "vx", 3.6, 0.05, "km/h"),
        ("yaw_rate", "r", DEG, 0.02, "deg/s"),
        ("lateral_acceleration", "ay", 1.0, 0.03, "m/s^2"),
        ("front_wheel_angle", "delta", DEG, 0.1, "deg"),
        ("torque_at_transmission", "T", 0.1, 0.1, "Nm"),
    )
    for phase, (name, channel, factor, step, unit) in enumerate(signals):
        t = 0.001 * phase + np.arange(0.0, 59.0, step)
        made += [(s, name, v, unit) for s, v in zip(t, factor * drive.at(channel, t), strict=True)]
    return sorted(made)


def written(form: str, rows, path) -> None:
    if form == "openxc":
        lines = [json.dumps({"timestamp": 1.7e9 + t, "name": name, "value": v}) for t, name, v, _ in rows]
        lines[5:5] = [json.dumps({"timestamp": 1.7e9, "name": "gear", "value": "fourth"})] * 3 + ["torn {"]
        path.write_text("\n".join(lines) + "\n")
    elif form == "can":
        lines = [f"{t:.4f};CAN1;0x1F0;{name};{f'{v:.6f}'.replace('.', ',')};{unit}" for t, name, v, unit in rows]
        path.write_text("Time [s];Bus;Message;Signal;Value;Unit\n" + "\n".join(lines).replace(".", ",") + "\n")
    else:  # a table for each name, one behind the other
        lines = [
            f",,0,,,2026-03-14T14:{int(t // 60):02}:{t % 60:09.6f}Z,{v:.7g},{name},car"
            for t, name, v, _ in sorted(rows, key=lambda row: row[1])
        ]
        path.write_text(INFLUX + "\n".join(lines) + "\n")


@pytest.mark.parametrize("form", ["openxc", "can", "influx"])
def test_one_value_a_row_is_a_signal_for_each_name_with_its_own_clock(form, rows, tmp_path):
    path = tmp_path / ("a.json" if form == "openxc" else "a.csv")
    written(form, rows, path)
    recording = open_recording(path)
    truth = [(t, v) for t, name, v, _ in rows if name == "yaw_rate"]
    read = recording.read(["yaw_rate"])["yaw_rate"]
    assert np.allclose(read.time - read.time[0], [t - truth[0][0] for t, _ in truth], atol=1e-4)
    assert np.allclose(read.values, [v for _, v in truth], atol=1e-5)
    units = {info.name: info.unit for info in recording.channels()}
    assert len(units) == 5 and units["vehicle_speed"] == ("km/h" if form == "can" else None)
    draft = draft_map(recording)
    assert draft.of("vx").unit == "km/h" and draft.of("r").unit == "deg/s" and draft.of("ay").status == "unsided"
    # What leaves the gearbox is turned once more before the wheels.
    assert all(s.status == "open" for s in draft.suggestions if s.channel in ("T", "engine_torque"))
    if form == "openxc":
        assert sorted(note.what for note in recording.notes) == [
            "lines that hold no object, left out",
            "names whose values are no numbers, left out: gear",
        ]


def test_a_race_of_two_cars_in_one_table_keeps_them_apart(rows, tmp_path):
    """Titles of one beginning name a signal and its value; the clock is the only column that holds a time."""
    lines = ["meta_time,lap,meta_source,telemetry_name,telemetry_value,vehicle_id"]
    for t, name, value, _ in rows:
        stamp = f"2026-05-18T10:{int(t // 60):02}:{t % 60:09.6f}Z"
        lines += [f"{stamp},1,live,{name},{factor * value:.7g},{car}" for car, factor in (("GT-7", 1.0), ("GT-9", 0.9))]
    (tmp_path / "race.csv").write_text("\n".join(lines) + "\n")
    recording = open_recording(tmp_path / "race.csv")
    assert len(recording.channels()) == 10
    truth = np.array([v for _, name, v, _ in rows if name == "yaw_rate"])
    for car, factor in (("GT-7", 1.0), ("GT-9", 0.9)):
        read = recording.read([f"{car}.yaw_rate"])[f"{car}.yaw_rate"]
        assert np.allclose(read.values, factor * truth, atol=1e-5) and np.allclose(np.diff(read.time), 0.02, atol=1e-5)
    one = [line for line in lines if not line.endswith("GT-9")]
    (tmp_path / "race.csv").write_text("\n".join(one) + "\n")
    draft = draft_map(open_recording(tmp_path / "race.csv"))
    assert draft.of("vx").unit == "km/h" and draft.of("r").unit == "deg/s"


def test_labview_writes_its_units_above_the_titles(tmp_path):
    rows = "\n".join(f"{0.01 * n:.2f}\t{30 + np.sin(n / 9):.3f}\t{np.cos(n / 9):.3f}" for n in range(300))
    (tmp_path / "a.lvm").write_text(
        "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\t\nChannels\t2\nSamples\t1\t1\n"
        "Y_Unit_Label\tkm/h\tdeg/s\nX0\t0.0E+0\t0.0E+0\n***End_of_Header***\t\n"
        f"X_Value\tVelocity\tYaw rate\tComment\n{rows}\n"
    )
    units = {info.name: info.unit for info in open_recording(tmp_path / "a.lvm").channels()}
    assert units == {"X_Value": "s", "Velocity": "km/h", "Yaw rate": "deg/s"}


def test_a_side_slip_angle_of_the_rear_axle_is_judged_and_moved(tmp_path):
    """A v_y derived from it had counted as derived, so that nothing judged its place."""
    planted = PlantedDrive(seconds=60.0)
    axle = planted.vehicle.cg_to_rear_axle
    log = planted.recording()
    there = planted.at("vy", log.signals["vy"].time) - axle * log.signals["r"].values
    log.signals["beta"] = RawSignal("beta", log.signals["vy"].time, np.arctan2(there, log.signals["vx"].values), "rad")
    names = ("vx", "r", "ay", "delta", "T")
    settings = IngestSettings(derive=("lateral-velocity-from-sideslip",))
    for position in ({}, {"position": "rear_axle"}):
        base = {name: {"source": name} for name in names}
        mapping = {"channels": {**base, "sideslip": {"source": "beta", **position}}, "kinds": {}}
        made = assemble_drive(log, map_from_mapping(mapping, where="m"), planted.vehicle, settings)
        told = [f.text for f in made.quality.consistency.findings if f.check == "place"]
        assert len(told) == (0 if position else 1)
        assert position or "set `position: rear_axle` for `sideslip`" in told[0]
    assert np.allclose(made.drive["vy"], planted.at("vy", made.drive["t"]), atol=5e-3)


@pytest.mark.parametrize("form", ["list", "inside", "dict"])
def test_json_with_an_object_for_each_channel_is_read_with_its_clocks(form, rows, tmp_path):
    """As racing teams keep laps: each channel with its unit and rate, or its own times."""
    signals = {}
    for t, name, v, unit in rows:
        own = signals.setdefault(name, {"unit": unit, "time": [], "values": []})
        own["time"].append(1e3 * t)
        own["values"].append(v)
    if form != "dict":
        rates = {name: 1e3 / (one["time"][1] - one["time"][0]) for name, one in signals.items()}
        channels = [
            {"name": name, "unit": one["unit"], "frequency": rates[name], "data": one["values"]}
            for name, one in signals.items()
        ]
        document = {"session": "FP1", "channels": channels}
        document = {"session": {"channels": channels}} if form == "inside" else document
    else:
        document = signals
    (tmp_path / "lap.json").write_text(json.dumps(document))
    recording = open_recording(tmp_path / "lap.json")
    read = recording.read(["yaw_rate"])["yaw_rate"]
    truth = np.array([(t, v) for t, name, v, _ in rows if name == "yaw_rate"])
    assert read.unit == "deg/s" and np.array_equal(read.values, truth[:, 1])
    assert np.allclose(np.diff(read.time), np.diff(truth[:, 0]))
    assert draft_map(recording).of("ay").status == "unsided"


def test_clocks_in_groups_tell_their_unit_and_colons_before_milliseconds_are_read(tmp_path):
    h5py = needed("h5py")
    t = np.arange(0.0, 5.0, 0.01)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, step in (("ins", 1), ("eps", 2)):
            group = file.create_group(name)
            group["timestamp"] = (1.77e15 + np.round(t[::step] * 1e6)).astype("int64")
            group["value"], group["other"] = np.sin(t[::step]), np.cos(t[::step])
    read = open_recording(tmp_path / "a.h5").read(["eps.other"])["eps.other"]
    assert np.allclose(np.diff(read.time), 0.02, atol=1e-6)  # of a double in 2026
    assert seconds_of("14:20:07:250") == 14 * 3600 + 20 * 60 + 7.25


def test_a_time_of_too_few_digits_is_told(tmp_path):
    """A spreadsheet keeps seven digits of 7.7e14 microseconds."""
    lines = [f"7.700000E+14,{20 + np.sin(n / 30):.4f},{np.cos(n / 30):.4f}" for n in range(400)]
    (tmp_path / "a.csv").write_text("Timestamp (us),speed [m/s],gyro_z [rad/s]\n" + "\n".join(lines) + "\n")
    assert "Timestamp has 1 different values in 400 rows" in draft_map(open_recording(tmp_path / "a.csv")).time


def test_a_time_of_few_rows_is_not_said_to_stand_still(tmp_path):
    (tmp_path / "a.csv").write_text("t,vx,r\n0,10,0.1\n0.01,10,0.1\n")
    time = draft_map(open_recording(tmp_path / "a.csv")).time
    assert "2 rows are too few to see whether t counts time" in time and "does not rise" not in time
