"""A listing shows each array once, with how many elements it has, and nothing is left out without a word."""

import json

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.typesys import get_types_from_msg
from scipy.io import savemat

import tests.logs.readers_support as support
from split_cli.cli.main import group
from split_cli.logs.listing import listed_channels, with_all_elements
from split_cli.logs.readers.opening import open_recording

TIME = np.arange(0.0, 20.0, 0.05)
WIDE = TIME[:, None] + 100.0 * np.arange(90.0)


def lines_of(path):
    return {line.name: line for line in listed_channels(open_recording(path))}


def test_columns_of_a_wide_matrix_are_counted_and_read_by_name(tmp_path):
    path = tmp_path / "wide.mat"
    savemat(path, {"t": TIME, "M": WIDE})
    recording = open_recording(path)
    assert [c.name for c in recording.channels()] == ["t", *(f"M[{k}]" for k in range(64))]
    np.testing.assert_array_equal(recording.read(["M[89]"])["M[89]"].values, WIDE[:, 89])
    (note,) = recording.notes
    assert note.count == 26 and "M[64] to M[89]" in note.what
    assert lines_of(path)["M[0..89]"].example == "M[89]"
    listed = CliRunner().invoke(group, ["ingest", str(path), "--list"])
    assert "M[0..89]" in listed.output and "26 x columns of a matrix" in listed.stderr and "as M[89]" in listed.stderr


def test_a_far_column_of_a_matrix_becomes_a_channel(tmp_path):
    """The last column of 90 is the speed; the map names it."""
    wide = WIDE.copy()
    wide[:, 89] = 10.0 + np.sin(TIME)
    savemat(tmp_path / "wide.mat", {"t": TIME, "M": wide})
    (tmp_path / "map.yaml").write_text(
        "extras: []\nchannels:\n  vx: {source: 'M[89]', unit: m/s}\n"
        + "".join(f"  {name}: {{source: 'M[{k}]', scale: 1e-5}}\n" for k, name in enumerate(["vy", "r", "T", "delta"]))
    )
    out = tmp_path / "drive.parquet"
    done = CliRunner().invoke(
        group, ["ingest", str(tmp_path / "wide.mat"), "--map", str(tmp_path / "map.yaml"), "-o", str(out)]
    )
    assert done.exit_code == 0, done.output
    from split_cli.logs.drive import read_drive

    drive = read_drive(out)
    np.testing.assert_allclose(drive["vx"], 10.0 + np.sin(drive["t"]), atol=1e-9)


@pytest.mark.parametrize("kind", ["5", "7.3"])
def test_cells_of_more_than_64_elements_are_read_whole(tmp_path, kind):
    """Ninety titles beside a matrix of ninety columns, and ninety vectors in a cell."""
    path = tmp_path / "log.mat"
    titles = [f"signal_{k}" for k in range(90)]
    if kind == "5":
        cells = np.empty((2, 90), dtype=object)
        for k in range(90):
            cells[0, k], cells[1, k] = titles[k], TIME * k
        savemat(path, {"t": TIME, "rec": {"titles": cells[:1], "data": WIDE}, "runs": cells[1:]})
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            file["t"] = TIME[None, :]
            file["rec/data"] = WIDE.T
            for name, values in (
                ("rec/titles", [np.array([[ord(c)] for c in title], dtype="u2") for title in titles]),
                ("runs", [TIME[None, :] * k for k in range(90)]),
            ):
                references = np.empty((90, 1), dtype=h5py.ref_dtype)
                for k, value in enumerate(values):
                    item = file.create_dataset(f"#refs#/{name.replace('/', '_')}_{k}", data=value)
                    item.attrs["MATLAB_class"] = np.bytes_("char" if value.dtype.kind == "u" else "double")
                    references[k, 0] = item.ref
                cell = file.create_dataset(name, data=references, dtype=h5py.ref_dtype)
                cell.attrs["MATLAB_class"] = np.bytes_("cell")
        with open(path, "r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))
    recording = open_recording(path)
    read = recording.read(["rec.signal_89", "runs[89]"])
    np.testing.assert_array_equal(read["rec.signal_89"].values, WIDE[:, 89])
    np.testing.assert_array_equal(read["runs[89]"].values, TIME * 89)
    assert "runs[0..89]" in lines_of(path)
    assert not recording.notes


def test_variables_that_cannot_be_mapped_are_counted(tmp_path):
    deep: object = TIME
    for _ in range(10):
        deep = {"a": deep}
    savemat(tmp_path / "odd.mat", {"t": TIME, "z": TIME + 1j * TIME, "deep": deep})
    said = {note.what: note.count for note in open_recording(tmp_path / "odd.mat").notes}
    assert said == {
        "variables that are neither real numbers nor text, left out": 1,
        "variables within more than 8 others, left out": 1,
    }


def test_sequences_of_ros_state_how_many_elements_they_have(tmp_path):
    store = support.ros2_store()
    text = "std_msgs/Header header\nfloat32[] speeds\nfloat64[100] ranges\n"
    text += "geometry_msgs/Point[] corners\nfloat32[] none\n"
    store.register(get_types_from_msg(text, "test_msgs/msg/Wheels"))
    points = [support.build(store, "geometry_msgs/msg/Point", x=float(k)) for k in range(3)]
    messages = []
    for k in range(5):
        time = support.EPOCH + k * 10_000_000
        built = support.build(
            store,
            "test_msgs/msg/Wheels",
            **support.stamp_of(time),
            speeds=np.arange(4, dtype=np.float32) + k,
            corners=points,
        )
        messages.append(("/wheels", time, time, bytes(store.serialize_cdr(built, "test_msgs/msg/Wheels"))))
    path = support.write_mcap(tmp_path / "a.mcap", support.ros2_schema(store, "test_msgs/msg/Wheels"), "cdr", messages)
    lines = lines_of(path)
    shown = {name: line.example for name, line in lines.items() if line.example}
    assert shown == {
        "/wheels/speeds[0..3]": "/wheels/speeds[3]",
        "/wheels/ranges[0..99]": "/wheels/ranges[99]",
        "/wheels/corners[0..2].x": "/wheels/corners[2].x",
        "/wheels/corners[0..2].y": "/wheels/corners[2].y",
        "/wheels/corners[0..2].z": "/wheels/corners[2].z",
        "/wheels/none[..]": "/wheels/none[0]",
    }
    recording = open_recording(path)
    np.testing.assert_array_equal(recording.read(["/wheels/speeds[3]"])["/wheels/speeds[3]"].values, 3.0 + np.arange(5))


def test_sequences_of_protobuf_and_json_state_how_many_elements_they_have(tmp_path):
    lines = lines_of(support.write_protobuf_mcap(tmp_path / "a.mcap", support.plant(count=20)))
    assert lines["/odom/twist.covariance[0..1]"].example == "/odom/twist.covariance[1]"
    content = json.dumps({"cars": [{"speeds": [1.0, 2.0, 3.0]}, {"speeds": [1.0, 2.0, 3.0]}], "far": [0.5] * 80})
    messages = [("/j", support.EPOCH + k, support.EPOCH + k, content.encode()) for k in range(3)]
    lines = lines_of(support.write_mcap(tmp_path / "b.mcap", ("J", "jsonschema", b""), "json", messages))
    assert {name: line.example for name, line in lines.items()} == {
        "/j/cars[0..1].speeds[0..2]": "/j/cars[1].speeds[2]",
        "/j/far[0..79]": "/j/far[79]",
    }


def test_indices_with_gaps_stand_in_lines_of_their_own(tmp_path):
    path = tmp_path / "log.csv"
    rows = "\n".join(f"{0.01 * k:.2f},1,2,3" for k in range(50))
    path.write_text(f"t,c[0],c[2],c[5]\n{rows}\n")
    assert list(lines_of(path)) == ["t", "c[0]", "c[2]", "c[5]"]


def test_an_array_that_stands_by_its_first_element_is_named_with_its_range():
    class Counted:
        def element_counts(self):
            return {"/sensors/data": 10, "/sensors/dim": 1, "/objects": 3}

    names = ["/sensors/data[0]", "/sensors/dim[0].size", "/objects[0].x", "/fixed[0]", "/fixed[1]"]
    shown = ["/sensors/data[0..9]", "/sensors/dim[0].size", "/objects[0..2].x", "/fixed[0]", "/fixed[1]"]
    assert with_all_elements(Counted(), names) == shown
