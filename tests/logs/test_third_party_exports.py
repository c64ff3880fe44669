"""What programs of the field export beside plain tables: structures, indices, titles that hold separators."""

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import assemble_drive
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import read_map
from split_cli.signals import find_unit
from tests.logs.planted import write_table
from tests.logs.test_third_party_styles import DEG, TOLERANCES, Style, compare

CHANNELS = ("X", "Y", "yaw", "vx", "vy", "r", "delta", "T")


@pytest.fixture
def driven(planted) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    t = np.arange(0.0, 60.0, 0.01)
    return t, {name: planted.at(name, t) for name in CHANNELS}


def ingested(path, planted, tmp_path):
    """Ingest a log with its drafted map, compare every mapped channel with the truth, and return the draft."""
    recording = open_recording(path)
    draft = draft_map(recording)
    (tmp_path / "map.yaml").write_text(render_draft(draft, path.name))
    mapped = read_map(tmp_path / "map.yaml")
    made = assemble_drive(recording, mapped, planted.vehicle)
    assert made.quality.consistency.findings == ()

    compare(
        made.drive.columns,
        planted,
        Style(lambda t, c: {}),
        {entry.channel for entry in mapped.channels} & set(TOLERANCES),
    )
    return draft


def test_a_recording_of_controldesk_is_read_by_the_names_inside(planted, driven, tmp_path):
    from scipy.io import savemat

    t, c = driven
    signals = {
        "vx_cog": (c["vx"] * 3.6, "km/h"),
        "vy_cog": (c["vy"], "m/s"),
        "YawRate": (c["r"] * DEG, "deg/s"),
        "delta_f": (c["delta"], "rad"),
        "T_wheel": (c["T"], "Nm"),
        "psi": (c["yaw"], "rad"),
    }
    fields = [(name, "O") for name in ("Name", "Unit", "Data", "XIndex")]
    rows = [(f"Model Root/Plant/{name}/Out1", unit, v[None], 1.0) for name, (v, unit) in signals.items()]
    capture = {"X": np.array([("Time", "s", t[None], 1.0)], dtype=fields), "Y": np.array(rows, dtype=fields)}
    savemat(tmp_path / "rec.mat", {"rec": capture})
    draft = ingested(tmp_path / "rec.mat", planted, tmp_path)
    assert draft.of("vx").sources == ("rec.vx_cog",) and draft.of("r").unit == "deg/s"


def test_an_index_of_pandas_is_the_time_and_its_name_no_unit(planted, driven, tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    t, c = driven
    stamps = pa.array((1.7e18 + np.round(t * 1e9)).astype("int64"), pa.timestamp("ns", "UTC"))
    columns = {
        "vehicle_speed": c["vx"],
        "lateral_velocity": c["vy"],
        "yaw_rate": c["r"],
        "utm_e": c["X"],
        "utm_n": c["Y"],
        "steer_angle_front": c["delta"],
        "wheel_torque_total": c["T"],
    }
    for title in ("__index_level_0__", "stamp_ns"):
        path = tmp_path / f"{title}.parquet"
        pq.write_table(pa.table({**columns, title: stamps}), path)
        draft = ingested(path, planted, tmp_path)
        assert draft.time == f"time: {{source: {title}, unit: s}}" and draft.left == "east and north"
    stated = pa.schema([pa.field("stamp", pa.timestamp("ns"), metadata={"unit": "ns"})])
    pq.write_table(pa.table([pa.array([5, 10**9 + 5], pa.timestamp("ns"))], schema=stated), tmp_path / "u.parquet")
    read = open_recording(tmp_path / "u.parquet").read(["stamp"])["stamp"]
    assert read.unit == "s" and np.diff(read.values)[0] == 1.0


def test_titles_with_separators_in_brackets_stay_titles(tmp_path):
    values = "\n".join(f"{n},{0.1 * n:.1f},{n % 3},{20.0 + 0.1 * n}" for n in range(50))
    path = tmp_path / "lap.csv"
    path.write_text("INDEX,TIME,GPSFIX[0:NOFIX,1:2D,2:3D],SPEED_KPH\n" + values + "\n")
    assert [info.name for info in open_recording(path).channels()] == ["INDEX", "TIME", "GPSFIX", "SPEED_KPH"]
    path.write_text("INDEX,TIME,FIX,KIND,SATELLITES,SPEED_KPH\n" + values + "\n")
    recording = open_recording(path)
    assert [info.name for info in recording.channels()] == [f"column{n}" for n in (1, 2, 3, 4)]
    assert "6 titles stand before 4 columns" in recording.notes[0].what


def test_a_flat_column_beside_a_structure_of_that_name_keeps_its_values(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    inner = pa.StructArray.from_arrays([pa.array([10.0, 20.0, 30.0])], ["x"])
    pq.write_table(pa.table({"pose.x": [1.0, 2.0, 3.0], "pose": inner}), tmp_path / "two.parquet")
    recording = open_recording(tmp_path / "two.parquet")
    signals = recording.read(["pose.x", "pose.x_2"])
    np.testing.assert_array_equal(signals["pose.x"].values, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(signals["pose.x_2"].values, [10.0, 20.0, 30.0])
    assert recording.notes


def test_pedals_in_per_cent_and_units_that_nobody_knows_are_told(driven, tmp_path):
    t, c = driven
    columns = {
        "t": t,
        "vx [warp]": c["vx"],
        "vy": c["vy"],
        "yaw_rate": c["r"],
        "throttle": 50.0 + 50.0 * np.sin(t),
        "brake": 0.5 + 0.5 * np.sin(t),
        "torque [Nm]": 0.05 * c["T"],
    }
    write_table(tmp_path / "log.csv", columns)
    draft = draft_map(open_recording(tmp_path / "log.csv"))
    assert draft.of("throttle").unit == "%" and draft.of("brake").unit == "1"
    assert draft.of("vx").foreign_unit == "warp"
    # A twentieth of mass times wheel radius is no torque at the wheels of a car at 20 m/s.
    assert draft.of("T").status == "open" and "engine" in draft.of("T").reason


@pytest.mark.parametrize(
    ("written", "size"),
    [
        ("mm/s", 1e-3),
        ("degrees/s", 1 / DEG),
        ("Deg/Sec", 1 / DEG),
        ("deg/min", 1 / DEG / 60),
        ("mm/s^2", 1e-3),
        ("cm/s²", 1e-2),
        ("km/min", 1000 / 60),
        ("ft/s", 0.3048),
        ("mrad/s", 1e-3),
        ("m/min", 1 / 60),
    ],
)
def test_lengths_and_angles_per_time_are_units(written, size):
    assert find_unit(written).factor == pytest.approx(size, rel=1e-12)


@pytest.mark.parametrize("written", ["N/m", "m/s/s/s", "m/", "/s", "g/s", "m/kg"])
def test_other_quotients_are_none(written):
    assert find_unit(written) is None


@pytest.mark.parametrize("bad", [None, 0.5, float("inf"), 1e12])
def test_a_segment_that_is_no_whole_number_is_refused(bad, tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    from split_cli.errors import DriveError
    from split_cli.logs.drive import read_drive

    columns = {name: np.linspace(1.0, 2.0, 50) for name in ("vx", "vy", "r", "T", "delta")}
    table = {"t": 0.01 * np.arange(50), **columns, "segment": pa.array([0.0] * 20 + [bad] + [0.0] * 29)}
    pq.write_table(pa.table(table), tmp_path / "drive.parquet")
    with pytest.raises(DriveError, match="values that are no whole numbers, the first in row 21"):
        read_drive(tmp_path / "drive.parquet")


@pytest.mark.parametrize("shift", [0, 1, 2, 3])
def test_a_chinese_code_page_is_found_wherever_the_sample_ends(shift, tmp_path):
    text = "时间,车速,模式\n" + "".join(f"{0.01 * n:.2f},{10 + n % 7},运动运动运动运动运动\n" for n in range(12_000))
    (tmp_path / "lap.csv").write_bytes(("x" * shift + text).encode("gb18030"))
    assert [info.name for info in open_recording(tmp_path / "lap.csv").channels()][1:] == ["车速", "模式"]


@pytest.mark.parametrize("title", ["Größe", "Länge", "année créée", "Weg (süße °)"])
def test_umlauts_that_stand_together_are_no_chinese(title, tmp_path):
    rows = "\n".join(f"{0.01 * n:.2f};{n % 7}" for n in range(50))
    (tmp_path / "lap.csv").write_bytes(f"Zeit;{title}\n{rows}\n".encode("latin-1"))
    names = [info.name for info in open_recording(tmp_path / "lap.csv").channels()]
    assert names[0] == "Zeit" and title.startswith(names[1])


@pytest.mark.parametrize("units", ["", "s,m/s,m/s,deg/s\n"])
def test_a_row_about_the_session_is_no_header_where_a_name_occurs_twice(units, tmp_path):
    rows = "\n".join(f"{0.01 * n:.2f},{n},{n % 3},{2 * n}" for n in range(50))
    (tmp_path / "lap.csv").write_text(f"Driver,Anna,Car,Formula\ntime,speed,speed,yaw\n{units}{rows}\n")
    names = [info.name for info in open_recording(tmp_path / "lap.csv").channels()]
    assert [name.partition("_")[0] for name in names] == ["time", "speed", "speed", "yaw"]
