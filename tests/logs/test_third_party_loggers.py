"""What exports of AiM, MoTeC, CarSim, Simulink, phones and motion capture did to the draft, planted."""

import numpy as np
import pytest
from scipy.io import savemat

from split_cli.errors import LogError
from split_cli.logs.drafting.draft import Draft, Suggestion
from split_cli.logs.drafting.single_channel import read_sideslip
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.dialect import sniff
from split_cli.logs.readers.joint import JointRecording
from split_cli.logs.readers.opening import open_recording
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.ingesting.ingest import ingest_logs
from split_cli.workflows.ingesting.init import init_project
from tests.factories import road_car
from tests.logs.planted import UNITS, PlantedDrive, write_table
from tests.optional import needed

DEG, G = 180.0 / np.pi, 9.80665


@pytest.fixture(scope="module")
def planted() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    drive = PlantedDrive(seconds=60.0, yaw=2.0)
    t = np.arange(0.0, 59.0, 0.02)
    return t, {name: drive.at(name, t) for name in ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay", "delta", "T")}


def table(path, columns: dict[str, np.ndarray], before: str = "") -> Draft:
    write_table(path, columns)
    path.write_text(before + path.read_text())
    return draft_map(open_recording(path))


def test_a_row_of_units_may_hold_signs_for_channels_that_have_none(tmp_path):
    """RaceStudio writes # under every channel without a unit; two thirds of them made the units the titles."""
    titles = ["Time", "GPS Speed", "Mode", "State", "Relay", "Fault", "Inverter", "Gear"]
    units = ["s", "km/h", "#", "#", "#", "#", "V", " "]
    rows = "\n".join(f"{0.05 * k},{k},1,2,3,4,5,6" for k in range(30))
    (tmp_path / "aim.csv").write_text(f"{','.join(titles)}\n{','.join(units)}\n\n{rows}\n")
    found = sniff(tmp_path / "aim.csv")
    assert found.header == titles and found.units == units


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_structures_of_motec_are_channels_with_their_units(version, planted, tmp_path):
    t, c = planted
    fields = {
        "Corr_Speed": (c["vx"] * 3.6, "km/h"),
        "Yaw_Rate": (c["r"] * DEG, "deg/s"),
        "Accel_Lat": (c["ay"] / G, "G"),
        "Brake_Pressure_Front": (0.0 * t + t, "psi"),
    }
    path = tmp_path / "lap.mat"
    if version == "5":
        savemat(path, {n: {"Time": t + 237.9, "Value": v, "Units": u} for n, (v, u) in fields.items()})
    else:
        h5py = needed("h5py")
        with h5py.File(path, "w") as file:
            for name, (values, unit) in fields.items():
                group = file.create_group(name)
                group["Time"], group["Value"] = t[None] + 237.9, values[None]
                group["Units"] = np.array([[ord(letter)] for letter in unit], dtype=np.uint16)
                group["Units"].attrs["MATLAB_class"] = np.bytes_("char")
    recording = open_recording(path)
    assert {i.name: i.unit for i in recording.channels()} == {
        "Corr_Speed": "km/h",
        "Yaw_Rate": "deg/s",
        "Accel_Lat": "g",
        "Brake_Pressure_Front": "psi",
    }
    assert np.allclose(recording.read(["Yaw_Rate"])["Yaw_Rate"].time, t + 237.9)
    draft = draft_map(recording)
    assert draft.of("ay").status == "unsided" and draft.of("vx").sources == ("Corr_Speed",)
    assert draft.of("brake_pressure").sources == ("Brake_Pressure_Front",)


def test_a_matrix_of_two_rows_whose_first_counts_up_is_a_signal_with_its_time(planted, tmp_path):
    """Simulink's To File; several of them are one drive."""
    t, c = planted
    for name in ("vx", "psi"):
        savemat(tmp_path / f"{name}.mat", {name: np.stack([t, c["vx" if name == "vx" else "yaw"]])})
    joined = JointRecording([open_recording(tmp_path / f"{name}.mat") for name in ("vx", "psi")])
    read = joined.read(["vx", "psi"])
    assert np.array_equal(read["psi"].time, t) and np.array_equal(read["psi"].values, c["yaw"])
    assert any("first taken as time" in note.what for note in joined.notes)


def test_a_car_that_pitches_on_a_straight_keeps_its_axes(tmp_path):
    """CarSim's 700 columns: full throttle straight ahead, and v_x had come from Vz, a_x from AAx."""
    t = np.arange(0.0, 20.0, 0.025)
    rng = np.random.default_rng(2)
    vx = 3.0 * t
    swing = np.sin(9.0 * t)
    draft = table(
        tmp_path / "a.csv",
        {
            "Time": t,
            "AAx": rng.standard_normal(len(t)),
            "AAy": rng.standard_normal(len(t)),
            "AAz": 0.1 * swing,
            "AVx": 0.3 * swing,
            "AVy": swing - 0.04,
            "AVz": 1e-4 * swing,
            "AVy_L1": vx / 0.3 * 9.549,
            "Ax": 0 * t + 3.0 / G,
            "Ay": 1e-3 * swing,
            "Vx": vx * 3.6,
            "Vy": 1e-3 * swing,
            "Vz": 0.1 * swing,
            "Xo": 1.5 * t**2,
            "Yo": 1e-3 * swing,
        },
    )
    sources = {channel: draft.of(channel).sources for channel in ("ax", "vx", "wheel_speed_fl", "r")}
    assert sources == {"ax": ("Ax",), "vx": ("Vx",), "wheel_speed_fl": ("AVy_L1",), "r": ("AVz",)}
    assert draft.of("vx").unit == "km/h"


def test_a_side_slip_of_more_than_half_a_turn_is_in_degrees():
    """Standing, CarSim's reads anything up to 180."""
    s = Suggestion("sideslip", ("Beta",), "rad", status="assumed")
    assert read_sideslip(s, {"sideslip": np.array([-100.9, 0.2, 1.3])}, 40.0).unit == "deg"
    assert read_sideslip(s, {"sideslip": np.array([-0.9, 0.2, 1.3])}, 40.0).unit == "rad"


def test_a_speed_that_is_none_of_this_path_is_left_open(planted, tmp_path):
    """A pose to go by, and velocities that are noise of another size: they had been taken with a mark only."""
    t, c = planted
    rng = np.random.default_rng(3)
    wander = np.cumsum(rng.standard_normal(len(t)))
    columns = {
        "time": t,
        "x": 0.05 * c["X"],
        "y": 0.05 * c["Y"],
        "yaw": c["yaw"],
        "yaw_rate": c["r"],
        "velocity_x": 40.0 + wander,
        "velocity_y": -50.0 + wander[::-1],
    }
    draft = table(tmp_path / "a.csv", columns)
    assert draft.of("vx").status == "open" and "does not follow the path" in draft.of("vx").reason
    assert abs(draft.of("yaw").offset) < 0.1


def test_yaw_and_its_rate_alone_do_not_tell_radians_from_degrees(planted, tmp_path):
    t, c = planted
    draft = table(tmp_path / "a.csv", {"time": t, "yaw": 0.2 * c["yaw"], "yaw_rate": 0.2 * c["r"], "vx": c["vx"]})
    assert draft.of("r").status == draft.of("yaw").status == "assumed" and "degrees too" in draft.of("r").reason


def test_a_heading_that_changes_with_the_fix_alone_is_a_course(planted, tmp_path):
    """A phone records its accelerometer at 20 Hz and repeats fix and heading of its receiver between them."""
    t, c = planted

    def held(values):
        return np.repeat(values[::25], 25)[: len(t)]

    course = c["yaw"] + np.arctan2(c["vy"], c["vx"])
    east = held(c["X"]) / 111194.93 / np.cos(np.radians(48.0))
    columns = {
        "Time": t,
        "Latitude": 48.0 + held(c["Y"]) / 111194.93,
        "Longitude": 11.0 + east,
        "Speed (Km/h)": held(c["vx"]) * 3.6,
        "Heading": held(np.mod(90.0 - course * DEG, 360.0)),
        "Accel X": c["ay"] / G,
    }
    write_table(tmp_path / "a.csv", columns, fmt="%.9f")
    yaw = draft_map(open_recording(tmp_path / "a.csv")).of("yaw")
    assert yaw.status == "open" and "satellite fix" in yaw.reason


def test_wheels_of_another_radius_are_no_speed_in_another_unit(planted, tmp_path):
    """Four wheels in rpm, a radius of 0.9 of the true one, and forty columns that nothing knows."""
    t, c = planted
    columns = {
        "t": t,
        "vx": c["vx"],
        "vy": c["vy"],
        "r": c["r"],
        "X": c["X"],
        "Y": c["Y"],
        "yaw": c["yaw"],
        "ax": c["ax"],
        "T": c["T"],
        "delta": c["delta"],
    }
    corners = ("fl", "fr", "rl", "rr")
    columns |= {f"n_{w}": c["vx"] / 0.9 / road_car().wheel_radius * 9.5493 for w in corners}
    columns |= {f"aux_{k}": np.sin(k * t) for k in range(40)}
    write_table(tmp_path / "a.csv", columns)
    lines = [f"  {n}: {{source: {n}, unit: {UNITS[n]}}}" for n in list(columns)[1:10]]
    lines += [f"  wheel_speed_{w}: {{source: n_{w}, unit: rpm}}" for w in corners]
    (tmp_path / "map.yaml").write_text("name: m\ntime: {source: t, unit: s}\nchannels:\n" + "\n".join(lines) + "\n")
    write_vehicle(road_car(), tmp_path / "car.yaml")
    run = ingest_logs(
        [tmp_path / "a.csv"], tmp_path / "d.parquet", maps=[tmp_path / "map.yaml"], vehicle_path=tmp_path / "car.yaml"
    )
    result = run.results[0]
    # All alike: v_x may be what is wrong, so that they are one question.
    (found,) = [finding for finding in result.quality.consistency.findings if "another radius" in finding.text]
    assert found.channel == "vx" and "or vx is 0.9 times the true speed" in found.text
    text = result.to_text()
    assert "and 28 further columns, kept as recorded: aux_12" in text and "aux_39 " not in text


@pytest.mark.parametrize(
    ("title", "factor", "unit"), [("time_s", 1e3, "ms"), ("time_ms", 1.0, "s"), ("time", 1e6, "us")]
)
def test_a_clock_in_another_unit_than_its_name_says_is_told(title, factor, unit, planted, tmp_path):
    t, c = planted
    draft = table(tmp_path / "a.csv", {title: t * factor, **{n: c[n] for n in ("X", "Y", "yaw", "vx", "r")}})
    assert f"unit: {unit}" in draft.time and ("CHECK" in draft.time) == (title != "time")


def test_ticks_of_ten_microseconds_are_told_as_the_clock_and_not_as_four_scales(planted, tmp_path):
    t, c = planted
    names = ("X", "Y", "yaw", "vx", "r", "ax", "ay")
    draft = table(tmp_path / "a.csv", {"time": t * 1e5, **{n: c[n] for n in names}})
    assert float(draft.time.split("the time counts ")[1].split(" times too slow")[0]) == pytest.approx(10.0, rel=2e-3)
    assert {draft.of(n).status for n in ("vx", "r", "ay")} <= {"judged", "unsided"}
    straight = table(tmp_path / "b.csv", {"time": t, **{n: c[n] for n in names}})
    assert "CHECK" not in straight.time


def test_a_clock_of_xsens_counts_tenths_of_milliseconds(planted, tmp_path):
    t, c = planted
    names = ("X", "Y", "yaw", "vx", "r", "ax", "ay")
    draft = table(tmp_path / "a.csv", {"SampleTimeFine": 51_234_567 + np.round(t * 1e4), **{n: c[n] for n in names}})
    assert draft.time == "time: {source: SampleTimeFine, unit: 0.1ms}"
    assert {draft.of(n).status for n in ("vx", "r", "ay")} <= {"judged", "unsided"}


def test_files_of_other_programs_are_named_with_the_way_out(tmp_path):
    for name, head, told in (
        ("a.zip", b"PK\x03\x04", "cannot be unpacked"),
        ("a.drk", b"<h", "RaceStudio"),
        ("a.ld", b"@", "a MoTeC log"),
        ("a.ibt", b"\x02", "of iRacing"),
    ):
        (tmp_path / name).write_bytes(head + bytes(64))
        with pytest.raises(LogError, match=told):
            open_recording(tmp_path / name)


def test_init_says_that_a_log_without_time_needs_one(tmp_path):
    rows = "\n".join(f"{k},{30 + np.sin(k / 9):.3f}" for k in range(60))
    (tmp_path / "a.csv").write_text(f"tick,speed_kph\n{rows}\n")
    steps = init_project([tmp_path / "a.csv"], tmp_path / "out").next_steps
    assert any("--row-rate" in step for step in steps)
