"""Faults first seen when eight kinds of logs were taken from `split init` to a diagnosis as a stranger would."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
import yaml
from scipy.io import savemat

from split_cli.errors import LogError, SplitError
from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.draft import lines_on_runs
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.raw import RawSignal, TableRecording
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.workflows.ingesting.ingest import open_logs
from split_cli.workflows.ingesting.init import init_project
from tests.logs.planted import UNITS, PlantedDrive, write_table


@pytest.fixture(scope="module")
def planted() -> PlantedDrive:
    return PlantedDrive(seconds=40.0)


def stamps(t: np.ndarray, late: int, name: str) -> dict[str, np.ndarray]:
    """Return whole seconds and microseconds of times since 1970, `late` us later."""
    count = np.round((1_718_000_000 + t) * 1e6).astype(np.int64) + late
    return {f"{name}.seconds": count // 10**6, f"{name}.microseconds": count % 10**6}


def test_messages_as_tables_with_seconds_and_microseconds_make_one_drive(planted, tmp_path):
    """OpenDLV writes a table for each message, with the instants of sending, receiving and sampling."""
    t = np.arange(0.0, 40.0, 0.02)
    signals = {
        "groundSpeed": "vx",
        "angularVelocityZ": "r",
        "groundSteering": "delta",
        "x": "X",
        "y": "Y",
        "northHeading": "yaw",
        "lateralVelocity": "vy",
        "wheelTorque": "T",
    }
    paths = []
    for number, (name, channel) in enumerate(signals.items()):
        own = t + 0.003 * number
        stamped = {
            **stamps(own, 90_000, "sent"),
            **stamps(own, 210_000, "received"),
            **stamps(own, 0, "sampleTimeStamp"),
        }
        values = planted.at(channel, own)
        paths.append(tmp_path / f"{name}Reading.csv")
        write_table(paths[-1], {**stamped, name: 0.5 * np.pi - values if channel == "yaw" else values})
    recording = open_logs(paths)
    assert [info.name for info in recording.channels()] == list(signals)  # no instant is a quantity
    draft = draft_map(recording)
    assert draft.of("yaw").world == "ned" and {draft.of(c).status for c in ("vx", "r", "X", "Y")} == {"judged"}
    for number, name in enumerate(signals):  # the instant of sampling, not of sending or receiving
        assert recording.read([name])[name].time - 1_718_000_000 == pytest.approx(t + 0.003 * number, abs=2e-6)


def test_a_stamp_of_two_columns_is_read_from_the_map_and_refused_where_it_is_none(planted, tmp_path):
    t = np.arange(0.0, 40.0, 0.02)
    table = {**stamps(t, 0, "header"), "speed": planted.at("vx", t), "yaw_rate": planted.at("r", t)}
    write_table(tmp_path / "log.csv", table)
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.time == "time: {source: header.seconds, microseconds: header.microseconds}"
    entries = {"name": "x", "time": yaml.safe_load(draft.time)["time"], "channels": {"vx": {"source": "speed"}}}
    time = map_from_mapping(entries).time.stamp
    assert time.joined(table["header.seconds"], table["header.microseconds"], 1_718_000_000.0) == pytest.approx(t)
    # Microseconds that go on over a second are a clock of their own, not the rest of one.
    assert time.joined(table["header.seconds"], 1e6 * t, 0.0) is None
    for path, whole in ((tmp_path / "a.csv", True), (tmp_path / "b.csv", False)):
        part = table["header.microseconds"] if whole else 1e6 * t
        write_table(path, {"tv_sec": table["header.seconds"], "tv_usec": part, path.stem: planted.at("r", t)})
    with pytest.raises(LogError, match="reaches a whole second"):
        open_logs([tmp_path / "a.csv", tmp_path / "b.csv"]).read(["b"])


TITLES = {"Vx": ("vx", "m/s"), "Vy": ("vy", "m/s"), "YawRate": ("r", "rad/s"), "SteerAngle": ("delta", "rad")}


@pytest.mark.parametrize("form", ["timetable", "importdata", "7.3", "npz"])
def test_a_matrix_takes_the_titles_and_units_that_stand_beside_it(planted, tmp_path, form):
    """A timetable saved by its parts, a table as `importdata` returns it, names beside a matrix in NumPy."""
    t = np.arange(0.0, 40.0, 0.02)
    matrix = np.column_stack([planted.at(c, t) for c, _ in TITLES.values()])
    names, units = np.array(list(TITLES), dtype=object), np.array([u for _, u in TITLES.values()], dtype=object)
    path, front = tmp_path / "log.mat", "run."
    if form == "timetable":
        properties = {
            "VariableNames": names,
            "VariableUnits": units,
            "DimensionNames": np.array(["Time", "Variables"], object),
        }
        savemat(path, {"run": {"Time": t, "Variables": matrix, "Properties": properties}})
    elif form == "importdata":
        savemat(path, {"run": {"time": t, "data": matrix, "colheaders": names}})
    elif form == "7.3":
        with h5py.File(path, "w", userblock_size=512) as file:
            file["run/time"], file["run/data"] = t[None, :], matrix.T
            for field, texts in (("names", names), ("units", units)):
                cell = file.create_dataset(f"run/{field}", (1, len(texts)), dtype=h5py.ref_dtype)
                cell.attrs["MATLAB_class"] = np.bytes_("cell")
                for k, text in enumerate(texts):
                    one = file.create_dataset(f"#refs#/{field}{k}", data=np.array([[ord(c)] for c in text], "u2"))
                    one.attrs["MATLAB_class"] = np.bytes_("char")
                    cell[0, k] = one.ref
        with open(path, "r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))
    else:
        path, front = tmp_path / "log.npz", ""
        np.savez(path, t=t, data=matrix, columns=np.array(list(TITLES)))
    recording = open_recording(path)
    read = recording.read([f"{front}{title}" for title in TITLES])
    for title, (channel, unit) in TITLES.items():
        assert read[f"{front}{title}"].values == pytest.approx(planted.at(channel, t))
        assert read[f"{front}{title}"].unit == (unit if form in ("timetable", "7.3") else None)
    assert {s.channel for s in draft_map(recording).suggestions if s.status != "open"} >= {"vx", "vy", "r"}


def test_a_list_of_another_length_titles_nothing(planted, tmp_path):
    t = np.arange(0.0, 40.0, 0.02)
    matrix = np.column_stack([planted.at("vx", t), planted.at("r", t)])
    savemat(tmp_path / "log.mat", {"t": t, "data": matrix, "who": np.array(["a", "b", "c"], dtype=object)})
    listed = {info.name for info in open_recording(tmp_path / "log.mat").channels()}
    assert listed == {"t", "data[0]", "data[1]"}


def test_clocks_meet_by_what_tells_time_best_and_not_by_wheels_that_slip(planted, tmp_path):
    """The slip of wheels goes with dv_x/dt, as a speed does that is early: 0.1 s had been lost."""
    t = np.arange(0.0, 38.0, 0.02)
    rng = np.random.default_rng(4)
    own = {c: planted.at(c, t) for c in ("vx", "r", "ax")}
    other = {c: planted.at(c, t + 1.3) for c in own}
    logger = {"time [s]": t, "Wheel speed [m/s]": own["vx"] + 0.1 * own["ax"]}
    unit = {"time [s]": 34_872.0 + t, "vel_fwd [m/s]": other["vx"], "yaw_rate [rad/s]": other["r"]}
    write_table(tmp_path / "ins.csv", unit)
    moved = {}
    for name, more in {"wheels": {}, "gyro": {"gyro_z [rad/s]": own["r"] + 0.002 * rng.normal(size=len(t))}}.items():
        write_table(tmp_path / f"{name}.csv", {**logger, **more})
        recording = open_logs([tmp_path / f"{name}.csv", tmp_path / "ins.csv"])
        moved[name] = recording.read(["vel_fwd"])["vel_fwd"].time[0]
    assert moved["gyro"] == pytest.approx(1.3, abs=0.01) and abs(moved["wheels"] - 1.3) > 0.05


def test_rows_that_begin_with_the_name_of_a_message_are_told_how_they_become_tables(tmp_path):
    rows = [f"{name}, {20000 * k}, 0.{k}, {-k}, 1.5" for k in range(200) for name in ("IMU", "ATT")]
    (tmp_path / "rover.log").write_text("\n".join(rows))
    with pytest.raises(SplitError, match="mavlogdump.*--together"):
        init_project([tmp_path / "rover.log"], tmp_path / "car")


def test_a_car_that_drives_backwards_is_told_and_no_position_is_blamed(planted, tmp_path):
    """Its axes turned by half a turn, the same motion is a car that reverses: the sign of X had been blamed."""
    t = np.arange(0.0, 40.0, 0.02)
    ahead = {c: planted.at(c, t) for c in ("X", "Y", "yaw", "vx", "r", "ax", "ay")}
    back = ahead | {c: -ahead[c] for c in ("vx", "ax", "ay")} | {"yaw": ahead["yaw"] + np.pi}

    def drafted(columns):
        table = {"time [s]": t, **{f"{c} [{UNITS[c]}]": values for c, values in columns.items()}}
        write_table(tmp_path / "log.csv", table)
        return draft_map(open_recording(tmp_path / "log.csv"))

    seen = drafted(back)
    assert "drives backwards" in seen.of("X").reason and seen.of("vx").status == "judged"
    few = drafted({c: back[c] for c in ("X", "Y", "yaw", "vx", "r")})
    assert few.of("vx").status == "open" and "or the car drives backwards" in few.of("vx").reason
    assert few.of("X").status == "unsided" and few.of("X").scale == few.of("vx").scale == 1.0
    # The accelerations of a car that drives ahead tell a speed of the wrong sign from one of driving backwards.
    assert drafted(ahead | {"vx": -ahead["vx"]}).of("vx").scale == -1.0


def test_the_next_step_of_a_slow_log_names_the_gap_that_ingest_asks_for(planted, tmp_path):
    """The printed command had been refused, for want of --gap."""
    for rate, gap in ((5.0, "--gap 0.5"), (10.0, None)):
        t = np.arange(0.0, 40.0, 1.0 / rate)
        table = {"time [s]": t, **{f"{c} [{UNITS[c]}]": planted.at(c, t) for c in ("vx", "vy", "r", "delta", "T")}}
        write_table(tmp_path / f"at_{rate:.0f}.csv", table)
        step = init_project([tmp_path / f"at_{rate:.0f}.csv"], tmp_path / f"car{rate:.0f}").next_steps[-1]
        assert step.count("--gap") == (gap is not None) and (gap or "") in step
    signal_map = map_from_mapping(yaml.safe_load((tmp_path / "car5" / "map.yaml").read_text()))
    slow = open_recording(tmp_path / "at_5.csv")
    with pytest.raises(LogError, match="--gap 0.5"):
        assemble_drive(slow, signal_map, planted.vehicle)
    assert len(assemble_drive(slow, signal_map, planted.vehicle, IngestSettings(gap=0.5)).drive) > 150


def test_a_clock_in_words_is_the_time_whatever_its_title(planted, tmp_path):
    """A German spreadsheet: a line for Excel, groups over the titles, the date apart, decimal commas."""
    t = np.arange(0.0, 40.0, 0.02)
    columns = [3.6 * planted.at("vx", t), planted.at("ay", t) / 9.80665, np.degrees(planted.at("r", t))]
    rows = [
        "sep=;",
        "Messung;Handlingkurs",
        "",
        "Zeit;;Bewegung;;",
        "Datum;Uhrzeit;Geschwindigkeit;Querbeschl;Gierrate",
    ]
    rows += [";;km/h;g;°/s"]
    for moment, values in zip(t, np.transpose(columns), strict=True):
        clock = f"14:{5 + int(moment // 60):02d}:{moment % 60:06.3f}".replace(".", ",")
        rows.append(";".join(["03.06.2025", clock, *(f"{v:.4f}".replace(".", ",") for v in values)]))
    (tmp_path / "log.csv").write_text("\n".join(rows), encoding="cp1252")
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.time == "time: {source: Uhrzeit, unit: s}"
    assert draft.of("vx").status == "judged"


def test_names_of_times_are_known_however_their_words_are_parted(planted, tmp_path):
    t = np.arange(0.0, 40.0, 0.02)
    for title in ("GpsTow", "gps tow", "GPS_TOW"):
        table = {"GpsWeek": np.full(len(t), 2369.0), title: 223_507.12 + t, "VelBodyX": planted.at("vx", t)}
        write_table(tmp_path / "log.csv", table)
        assert draft_map(open_recording(tmp_path / "log.csv")).time.startswith(f"time: {{source: {title}, unit: s}}")


def test_without_a_clock_a_yaw_in_degrees_tells_the_rate_and_no_torque_is_judged(planted, tmp_path):
    """It was taken in radians, which made a period of 0.57 s; T was judged by a period that nobody had stated."""
    t = np.arange(0.0, 40.0, 0.01)
    yaw = (np.degrees(planted.at("yaw", t)) + 170.0 + 180.0) % 360.0 - 180.0
    assert np.abs(np.diff(yaw)).max() > 300.0
    table = {"Yaw": yaw, "GyroZ": planted.at("r", t), "VelBodyX": planted.at("vx", t)}
    write_table(tmp_path / "log.csv", table)
    time = draft_map(open_recording(tmp_path / "log.csv")).time
    assert yaml.safe_load(time)["time"]["period"] == pytest.approx(0.01, rel=0.01)
    write_table(tmp_path / "log.csv", {"vx": planted.at("vx", t), "T": planted.at("T", t), "r": planted.at("r", t)})
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert "needed" in draft.time and draft.of("T").status == "assumed"
    draft = draft_map(open_recording(tmp_path / "log.csv"), row_rate=100.0)
    assert "mass times wheel radius" in draft.of("T").reason


def test_a_torque_too_small_for_any_gear_is_in_kilonewton_metres(planted, tmp_path):
    t = np.arange(0.0, 40.0, 0.01)
    small = {"t": t, "vx": planted.at("vx", t), "r": planted.at("r", t), "torque": 1e-3 * planted.at("T", t)}
    write_table(tmp_path / "log.csv", small)
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.of("T").unit == "kN m" and draft.of("T").status == "assumed"
    write_table(tmp_path / "log.csv", {**small, "torque": 0.1 * planted.at("T", t)})  # an engine's, in second gear
    assert draft_map(open_recording(tmp_path / "log.csv")).of("T").status == "open"


def test_units_beside_a_dataset_or_a_value_are_read(planted, tmp_path):
    t = np.arange(0.0, 40.0, 0.01)
    channels = {
        "VehicleSpeed": (3.6 * planted.at("vx", t), "km/h"),
        "YawRate": (np.degrees(planted.at("r", t)), "deg/s"),
    }
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name, (values, unit) in {**channels, "time": (1e3 * t, "ms")}.items():
            file.create_dataset(f"log/{name}", data=values).attrs["units"] = unit.encode() if unit == "ms" else unit
    recording = open_recording(tmp_path / "log.h5")
    assert {i.name: i.unit for i in recording.channels()} == {
        "log.VehicleSpeed": "km/h",
        "log.YawRate": "deg/s",
        "log.time": "ms",
    }
    assert recording.read(["log.YawRate"])["log.YawRate"].time == pytest.approx(t)
    rows = [
        {"t": float(t[k])} | {n: {"value": float(v[k]), "unit": u} for n, (v, u) in channels.items()}
        for k in range(4000)
    ]
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, rows)))
    draft = draft_map(open_recording(tmp_path / "log.jsonl"))
    assert (draft.of("vx").unit, draft.of("r").unit) == ("km/h", "deg/s")


@pytest.mark.parametrize("turned", [True, False], ids=["binTrans", "binNormal"])
def test_a_result_of_modelica_is_read_by_its_names(planted, tmp_path, turned):
    """Dymola and OpenModelica: an alias may turn the sign, a parameter has two values only."""
    t = np.arange(0.0, 40.0, 0.01)
    table = np.column_stack([t, planted.at("vx", t), planted.at("r", t)])
    names = ["time", "car.body.v_x", "car.body.w_z", "sensor.w_down", "car.m"]
    said = ["Time [s]", "Velocity [m/s]", "Yaw rate [rad/s]", "Yaw rate, z down [rad/s]", "Mass [kg]"]
    info = np.array([[0, 1, 0, -1], [2, 2, 0, -1], [2, 3, 0, -1], [2, -3, 0, -1], [1, 2, 0, 0]], dtype=np.int32)

    def characters(texts):
        wide = np.array([list(text.ljust(max(map(len, texts)))) for text in texts])
        return np.array(["".join(row) for row in (wide.T if turned else wide)])

    matrices = {"dataInfo": info, "data_1": np.array([[0.0, 1500.0], [40.0, 1500.0]]), "data_2": table}
    kind = np.array(["Atrajectory", "1.1        ", "           ", "binTrans   " if turned else "binNormal  "])
    texts = {"Aclass": kind, "name": characters(names), "description": characters(said)}
    made = texts | {name: matrix.T if turned else matrix for name, matrix in matrices.items()}
    savemat(tmp_path / "res.mat", made, format="4")
    recording = open_recording(tmp_path / "res.mat")
    assert [(i.name, i.unit) for i in recording.channels()] == [
        ("time", "s"),
        ("car.body.v_x", "m/s"),
        ("car.body.w_z", "rad/s"),
        ("sensor.w_down", "rad/s"),
    ]
    read = recording.read(["car.body.w_z", "sensor.w_down"])
    assert read["car.body.w_z"].values == pytest.approx(table[:, 2])
    assert read["sensor.w_down"].values == pytest.approx(-table[:, 2])


def test_an_arrow_file_that_was_written_as_it_came_is_read(planted, tmp_path):
    t = np.arange(0.0, 40.0, 0.01)
    table = pa.table({"t": t, "vx": planted.at("vx", t)})
    with pa.OSFile(str(tmp_path / "log.arrows"), "wb") as file, pa.ipc.new_stream(file, table.schema) as stream:
        stream.write_table(table)
    assert open_recording(tmp_path / "log.arrows").read(["vx"])["vx"].values == pytest.approx(planted.at("vx", t))
    whole = (tmp_path / "log.arrows").read_bytes()
    (tmp_path / "cut.arrows").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(LogError, match="damaged"):
        open_recording(tmp_path / "cut.arrows")


@pytest.mark.parametrize("kind", ["5", "7.3"])
def test_runs_in_an_array_of_structures_are_known_by_their_fields(planted, kind, tmp_path):
    """HDF5 keeps a field of all elements as references, which nothing followed; the other runs went unmentioned."""
    t, fields = np.arange(0.0, 40.0, 0.01), {"vx": "vx", "yawrate": "r", "delta_f": "delta", "M_wheels": "T"}
    runs = [{"t": h - h[0], **{f: planted.at(c, h) for f, c in fields.items()}} for h in (t[:2000], t[2000:])]
    if kind == "5":
        array = np.zeros(2, dtype=[(name, object) for name in runs[0]])
        for k, run in enumerate(runs):
            array[k] = tuple(run.values())
        savemat(tmp_path / "runs.mat", {"runs": array})
    else:
        with h5py.File(tmp_path / "runs.mat", "w", userblock_size=512) as file:
            for name in runs[0]:
                field = file.create_dataset(f"runs/{name}", (2, 1), dtype=h5py.ref_dtype)
                for k, run in enumerate(runs):
                    field[k, 0] = file.create_dataset(f"#refs#/{name}{k}", data=run[name][None, :]).ref
        with open(tmp_path / "runs.mat", "r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))
    recording = open_recording(tmp_path / "runs.mat")
    read = recording.read(["runs[1].vx"])["runs[1].vx"]
    np.testing.assert_allclose(read.values, runs[1]["vx"])
    np.testing.assert_allclose(read.time, runs[1]["t"], atol=1e-9)
    draft = draft_map(recording)
    assert [draft.of(c).sources for c in ("delta", "T")] == [("runs[0].delta_f",), ("runs[0].M_wheels",)]
    assert lines_on_runs(draft)[0].startswith("The map takes runs[0]; runs[1] has the same fields.")


NOISE = {"vx": 0.02, "vy": 0.01, "r": 0.002, "ay": 0.05, "T": 5.0, "delta": 2e-4, "yaw": 1e-3}


def standing(planted: PlantedDrive, **altered) -> list[str]:
    """Return what ingest says of standstills; noise, then a function of values and time for some channels."""
    t, rng = np.arange(0.0, 40.0, 0.01), np.random.default_rng(3)
    columns = {c: planted.at(c, t) + sigma * rng.standard_normal(len(t)) for c, sigma in NOISE.items()}
    columns |= {c: change(planted.at(c, t), columns[c], t) for c, change in altered.items()}
    signals = {c: RawSignal(c, None, v, UNITS.get(c, "s")) for c, v in {"t": t, **columns}.items()}
    named = {"time": {"source": "t"}, "channels": {c: {"source": c} for c in columns}}
    made = assemble_drive(TableRecording("a.csv", Path("a.csv"), signals), map_from_mapping(named), planted.vehicle)
    return [f.text for f in made.quality.consistency.findings if f.check == "stopped"]


@pytest.mark.parametrize("channel", list(NOISE))
def test_a_channel_that_stands_still_while_the_car_moves_is_told(planted, channel):
    """A bus repeats its last message, or a source failed for good: the channels were said to fit together."""

    def from_to(start: float, end: float):
        return lambda _, noisy, t: np.where((t >= start) & (t < end), noisy[int(100 * start)], noisy)

    assert not standing(planted)
    for start, end in ((10.0, 12.0), (25.0, 50.0)):
        told = standing(planted, **{channel: from_to(start, end)})
        assert len(told) == 1 and f"{channel} stands still 1 time" in told[0]
        assert f"from t = {start:.1f} to {min(end, 40.0):.1f} s" in told[0]


def test_a_channel_that_may_be_constant_does_not_stand_still(planted):
    """Straight ahead without noise or within the resolution, at the limit of an actuator, in a steady turn."""

    def steady(true, noisy, t):
        return np.where((t > 10.0) & (t < 12.0), true[1000], true)

    assert not standing(planted, r=lambda true, noisy, t: np.where((t > 10.0) & (t < 12.0), 0.0, true))
    assert not standing(planted, **{c: lambda true, *_: np.round(true, 4) for c in ("r", "vy", "ay")})
    assert not standing(planted, T=lambda true, noisy, t: np.minimum(noisy, 300.0))
    assert not standing(planted, delta=steady, vx=steady)
    assert len(standing(planted, r=steady)) == 1


class OnTwoClocks(TableRecording):
    """Topics whose header times begin when each sensor was switched on; the times of the log are one clock's."""

    def __init__(self, planted: PlantedDrive, late: float) -> None:
        super().__init__("bag", Path("bag"), {c: RawSignal(c, None, planted.at(c, T100), UNITS[c]) for c in OF_CAR})
        self.clocks, self.late = ("header", "log"), late

    def read(self, names, clock=None):
        found = super().read(names)
        late = {name: self.late * (clock != "log" and name in ("ax", "ay")) for name in names}
        return {name: replace(signal, time=T100 + late[name]) for name, signal in found.items()}


T100 = np.arange(0.0, 40.0, 0.01)
OF_CAR = ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay", "delta", "T")


def test_a_sensor_whose_stamps_are_of_another_clock_is_told_and_the_log_has_one_for_all(planted):
    """Accelerations without a value in any row stood in the drive, and its channels were said to fit together."""
    recording = OnTwoClocks(planted, late=1.7e9)
    draft = draft_map(recording)
    assert draft.time.startswith("time: {clock: log}") and "CHECK" in draft.time
    assert [draft.of(c).status for c in ("ax", "ay", "r")] == ["judged", "unsided", "unsided"]
    entries = {"channels": {c: {"source": c} for c in OF_CAR}}
    made = assemble_drive(recording, map_from_mapping(entries, where="map"), planted.vehicle)
    assert not {"ax", "ay"} & set(made.drive.columns)
    said = "left out: it begins 1.7e+09 s after its end; with `--clock log` they may share one"
    assert sum(said in warning for warning in made.quality.warnings) == 2
    mapped = map_from_mapping({**entries, "time": {"clock": "log"}}, where="map")
    assert {"ax", "ay"} <= set(assemble_drive(recording, mapped, planted.vehicle).drive.columns)
    assert draft_map(OnTwoClocks(planted, late=0.02)).time == "# time: that of the messages"


def test_the_channel_that_cuts_the_drive_short_is_named_and_so_is_the_origin_of_cuts(planted):
    """Speed came 8 s late and the steer angle ended at 30 s: 55 % became rows, and nothing said why."""
    rng, spans = np.random.default_rng(5), {"vx": (8.0, 40.0), "delta": (0.0, 30.0)}
    signals = {}
    for channel, sigma in NOISE.items():
        t = np.arange(*spans.get(channel, (0.0, 40.0)), 0.01)
        values = planted.at(channel, t) + sigma * rng.standard_normal(len(t))
        if channel == "r":
            values[2000:2500] = values[2000]
        signals[channel] = RawSignal(channel, t, values, UNITS[channel])
    recording = TableRecording("a.mf4", Path("a.mf4"), signals)
    named = map_from_mapping({"channels": {c: {"source": c} for c in NOISE}})
    quality = assemble_drive(recording, named, planted.vehicle).quality
    assert "vx begins 8.0 s after the other channels that a drive needs" in quality.warnings
    assert "delta ends 10.0 s before the other channels that a drive needs" in quality.warnings
    told = next(f.text for f in quality.consistency.findings if f.check == "stopped")
    assert "from t = 12.0 to 17.0 s" in told
    assert any("t = 0 is 8.00 s after the recording's first sample" in text for text in quality.warnings)
    cut = assemble_drive(recording, named, planted.vehicle, IngestSettings(cuts=((19.9, 25.1),)))
    assert not [f for f in cut.quality.consistency.findings if f.check == "stopped"]
