"""What ETAS, SavvyCAN, CarMaker, LabVIEW, spreadsheets and games did to the draft, planted."""

import numpy as np
import pytest
from scipy.io import savemat

from split_cli.errors import SplitError
from split_cli.logs.assembling.gather import gather
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.dialect import sniff
from split_cli.logs.readers.frames_csv import frames_of
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from split_cli.workflows.ingesting.init import init_project
from tests.logs.planted import PlantedDrive, write_table

DEG = 180.0 / np.pi


@pytest.fixture(scope="module")
def planted() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    drive = PlantedDrive(seconds=60.0, yaw=2.0)
    t = np.arange(0.0, 59.0, 0.02)
    return t, {name: drive.at(name, t) for name in ("vx", "vy", "r", "ax", "ay", "delta", "T")}


def test_a_row_of_types_is_no_row_of_titles(tmp_path):
    rows = "\n".join(f"{0.01 * k}\t{k}\t1.5\t2\t3\t4" for k in range(30))
    titles = "time\tv\tr\ta\tb\tc\nf8\tf8\tf8\tf8\tf8\tf8\n" + '"s"\t"km/h"\t"deg/s"\t"-"\t"-"\t"-"\n'
    (tmp_path / "a.ascii").write_text(f"ETASAsciiItemFile\trecord\tCrLf\tTab\nsampleCount\t30\n{titles}{rows}\n")
    found = sniff(tmp_path / "a.ascii")
    assert found.header == ["time", "v", "r", "a", "b", "c"] and found.units[:3] == ["s", "km/h", "deg/s"]


def test_marks_between_thousands_cost_no_value(tmp_path):
    cells = ["999,5", "1.000,25", "-12.345,5", "1.234.567,0"]
    (tmp_path / "a.csv").write_text("Zeit [s];T [Nm]\n" + "".join(f"{k},0;{c}\n" for k, c in enumerate(cells * 20)))
    read = open_recording(tmp_path / "a.csv").read(["T"])["T"].values
    assert np.array_equal(read[:4], [999.5, 1000.25, -12345.5, 1234567.0])


def test_rows_with_the_newest_first_are_turned_round(planted, tmp_path):
    t, c = planted
    columns = {"time": t, "vx [m/s]": c["vx"], "wheel_torque [Nm]": c["T"]}
    write_table(tmp_path / "a.csv", {title: values[::-1] for title, values in columns.items()})
    recording = open_recording(tmp_path / "a.csv")
    assert draft_map(recording).of("T").scale == 1.0
    content = {"name": "m", "channels": {"vx": {"source": "vx", "unit": "m/s"}}}
    series = gather(recording, map_from_mapping(content)).series["vx"][0]
    assert np.all(np.diff(series.time) > 0.0) and np.allclose(series.values, c["vx"])


def test_an_evenly_counting_first_column_is_the_time_and_no_position(planted, tmp_path):
    t, c = planted
    write_table(tmp_path / "a.csv", {"X_Value": t, "vx [m/s]": c["vx"], "ax [m/s^2]": c["ax"]})
    draft = draft_map(open_recording(tmp_path / "a.csv"))
    assert draft.time.startswith("time: {source: X_Value, unit: s}") and draft.of("X") is None
    assert draft.of("ax").status == "judged"


def test_a_pedal_called_acceleration_is_none(planted, tmp_path):
    t, c = planted
    pedal = np.clip(c["ax"], 0.0, None)
    write_table(tmp_path / "a.csv", {"time": t, "SpeedX": c["vx"], "Accel": pedal / pedal.max()})
    said = draft_map(open_recording(tmp_path / "a.csv")).of("ax")
    assert said.status == "open" and "never negative" in said.reason


def test_structures_of_carmaker_have_units_and_four_wheels_make_a_torque(planted, tmp_path):
    t, c = planted
    fields = {"Time": (t, "s"), "Car_vx": (3.6 * c["vx"], "km/h"), "Car_YawRate": (DEG * c["r"], "deg/s")}
    fields |= {f"PT_W{wheel}_Trq": (0.25 * c["T"], "Nm") for wheel in ("FL", "FR", "RL", "RR")}
    savemat(tmp_path / "a.mat", {n: {"data": v[None, :], "unit": u} for n, (v, u) in fields.items()})
    draft = draft_map(open_recording(tmp_path / "a.mat"))
    assert draft.of("vx").unit == "km/h" and draft.of("r").unit == "deg/s"
    assert draft.of("T").convert == "sum" and len(draft.of("T").sources) == 4


def test_a_torque_in_newton_millimetres_is_told_by_its_unit(planted, tmp_path):
    t, c = planted
    rows = np.stack([t, c["vx"], 1000.0 * c["T"]], 1)
    for unit, status in (("newton-mm", "judged"), ("foo", "open")):
        title = f"time,vx (m/s),total_wheel_torque ({unit})"
        np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=title, comments="")
        assert draft_map(open_recording(tmp_path / "a.csv")).of("T").status == status


def test_frames_in_tables_are_read_and_what_is_none_is_none(tmp_path):
    titles = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    (tmp_path / "a.csv").write_text(f"{titles}1500000,00000100,false,Rx,0,2,0A,FF,\n1,zz,false,Rx,0,1,00\n")
    first, second = frames_of(tmp_path / "a.csv")
    assert (first.timestamp, first.arbitration_id, first.data) == (1.5, 0x100, b"\x0a\xff") and second is None
    (tmp_path / "b.csv").write_text("time,addr,bus,data\n1.5,0x100,0,0x0aff\n")
    assert next(frames_of(tmp_path / "b.csv")) == first


def test_a_table_without_titles_is_told_what_to_do(tmp_path):
    (tmp_path / "a.csv").write_text("0.0,1.5\n0.1,1.6\n" * 20)
    with pytest.raises(SplitError, match="no row of titles"):
        init_project([tmp_path / "a.csv"], tmp_path / "car")
    assert not (tmp_path / "car").exists()
