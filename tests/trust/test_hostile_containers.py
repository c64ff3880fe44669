"""Containers that unfold without end, go in circles or lead out of the file; pipes and links in folders."""

import os
import struct
import zlib

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq
import pytest
import zstandard

from split_cli.errors import LogError, SplitError
from split_cli.logs.budget import Unfolded
from split_cli.logs.readers import messages
from split_cli.logs.readers.cdr_and_ros1 import SerializedDecoder
from split_cli.logs.readers.definitions import Definitions
from split_cli.logs.readers.opening import open_recording
from split_cli.workflows.info import describe_file
from split_cli.workflows.sources import find_sources
from split_cli.workflows.verifying.verify import verify


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def topic(number: int, definition: bytes) -> bytes:
    """Schema, channel and one message of MCAP."""
    schema = struct.pack("<H", number) + text(b"a/msg/T%d" % number) + text(b"ros2msg") + text(definition)
    channel = struct.pack("<HH", number, number) + text(b"/t%d" % number) + text(b"cdr") + text(b"")
    message = struct.pack("<HIQQd", number, 0, 1, 1, 0.0)
    return record(3, schema) + record(4, channel) + record(5, message)


def mcap(path, *records: bytes):
    head = b"\x89MCAP0\r\n" + record(1, text(b"") + text(b""))
    path.write_bytes(head + b"".join(records) + record(15, bytes(4)))
    return path


def packed(plain: bytes) -> bytes:
    body = zstandard.ZstdCompressor().compress(plain)
    return record(6, struct.pack("<QQQI", 0, 1, len(plain), 0) + text(b"zstd") + struct.pack("<Q", len(body)) + body)


def test_the_chunks_of_a_file_share_one_budget(tmp_path, monkeypatch):
    """Thirty chunks of 6 kB were thirty times two million empty messages."""
    monkeypatch.setattr("split_cli.logs.budget.ALWAYS", 1 << 20)
    messages_of_a_chunk = record(5, struct.pack("<HIQQd", 1, 0, 1, 1, 0.0)) * 20_000
    path = mcap(tmp_path / "a.mcap", topic(1, b"float64 x"), *[packed(messages_of_a_chunk)] * 6)
    recording = open_recording(path)
    left_out = [note for note in recording.notes if "a file, of so few bytes" in note.what]
    (channel,) = recording.channels()
    assert channel.count == 20_001 and len(left_out) == 5
    budget = Unfolded(10)
    assert budget.most(0, 10) == 1 << 20
    budget.add(0, (1 << 20) - 5)
    assert budget.most(0, 10) == 1 << 20 and budget.most(1, 10) == 5


def test_definitions_are_parsed_up_to_a_bound_for_all_of_them(monkeypatch):
    monkeypatch.setattr("split_cli.logs.readers.definitions.MOST_TEXT", 1000)
    definitions = Definitions()
    for number in range(9):
        definitions.layout(f"a/T{number}", "ros2msg", b"float64 x\n" + b"#" * 100)
    with pytest.raises(LogError, match="together"):
        definitions.layout("a/T10", "ros2msg", b"float64 x\n" + b"#" * 100)
    assert definitions.layout("a/T0", "ros2msg", b"float64 x\n" + b"#" * 100).embedded


def test_topics_are_listed_up_to_a_bound_for_all_of_them(tmp_path, monkeypatch):
    """A megabyte of types, each of 20,000 numbers, would be 14 GB of names."""
    monkeypatch.setattr(messages, "MOST_CHANNELS", 100)
    path = mcap(tmp_path / "a.mcap", *(topic(number, b"float64[30] x") for number in range(1, 6)))
    recording = open_recording(path)
    assert sum("x[" in channel.name for channel in recording.channels()) == 90
    assert sum("more than 100 fields" in note.what for note in recording.notes) == 2


def test_structures_of_nothing_within_each_other_are_not_walked_one_by_one():
    """Of ROS 1: a million times a million of them in a message of a megabyte."""
    rule = b"=" * 80
    types = [b"B[900000] b\nfloat64 x", b"MSG: a/B\nC[900000] c", b"MSG: a/C\nD[900000] d", b"MSG: a/D\n"]
    layout = Definitions().layout("a/A", "ros1msg", (b"\n" + rule + b"\n").join(types))
    payload = struct.pack("<d", 1.5) + bytes(10**6)
    assert SerializedDecoder(layout, cdr=False).decode([payload], ["x"]).values.tolist() == [[1.5]]


def hdf5(path, fill):
    with h5py.File(path, "w") as file:
        file["t"] = np.arange(100.0)
        fill(file)
    return path


def test_groups_that_hold_each_other_are_read_once(tmp_path):
    def circles(file):
        for number in range(10):
            file[f"s{number}"] = h5py.SoftLink("/")
        group = file.create_group("g")
        for number in range(10):
            group[f"h{number}"] = file["/"]
            file[f"again{number}"] = file["t"]

    recording = open_recording(hdf5(tmp_path / "a.h5", circles))
    names = {info.name for info in recording.channels()}
    assert names == {"t", *(f"again{n}" for n in range(10))} and [note.count for note in recording.notes] == [20]


def test_what_lies_in_another_file_is_none_of_this_one(tmp_path):
    """A recording from elsewhere that names a file of yours must not bring its content into a drive."""
    secret = hdf5(tmp_path / "secret.h5", lambda file: None)
    (tmp_path / "raw").write_bytes(bytes(800))

    def outside(file):
        file["linked"] = h5py.ExternalLink(str(secret), "/t")
        file["gone"] = h5py.SoftLink("/nothing")
        file.create_dataset("raw", shape=(100,), dtype="f8", external=[(str(tmp_path / "raw"), 0, 800)])
        layout = h5py.VirtualLayout(shape=(100,), dtype="f8")
        layout[:] = h5py.VirtualSource(str(secret), "t", shape=(100,))
        file.create_virtual_dataset("virtual", layout)

    recording = open_recording(hdf5(tmp_path / "a.h5", outside))
    assert [info.name for info in recording.channels()] == ["t"]
    assert [note.count for note in recording.notes] == [4]


def test_fill_values_share_one_budget(tmp_path):
    def fills(file):
        for number in range(3):
            file.create_dataset(f"f{number}", shape=(8_000_000,), dtype="f8", fillvalue=1.0, chunks=(100_000,))

    with pytest.raises(LogError, match="variable f1 claims 64 MB"):
        open_recording(hdf5(tmp_path / "a.h5", fills))


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matlab(path, number: int, count: int, rest: bytes):
    parts = element(6, struct.pack("<II", number, 0)) + element(5, struct.pack("<ii", 1, count)) + element(1, b"c")
    matrix = struct.pack("<II", 14, len(parts + rest)) + parts + rest
    stored = zlib.compress(matrix)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    path.write_bytes(head + struct.pack("<II", 15, len(stored)) + stored)
    return path


def test_a_cell_array_of_a_million_nothings_is_refused(tmp_path):
    with pytest.raises(LogError, match="more than 200,000 parts"):
        open_recording(matlab(tmp_path / "a.mat", 1, 10**6, struct.pack("<II", 14, 0) * 10**6))


def test_a_column_of_rows_that_are_stored_nowhere_is_refused(tmp_path):
    path = tmp_path / "a.parquet"
    with pq.ParquetWriter(path, pa.schema([("t", pa.float64())]), compression="zstd") as writer:
        for _ in range(10):
            writer.write_table(pa.table({"t": np.zeros(1 << 20)}))
    with pytest.raises(LogError, match="a column claims 84 MB"):
        open_recording(path)


def test_text_in_parquet_is_not_unpacked(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t": [1.0, 2.0], "s": ["x", "y"]}), path)
    with pytest.raises(LogError, match="'s' holds string"):
        open_recording(path).read(["s"])


def test_a_compressed_feather_file_unfolds_within_the_bounds_of_a_process_of_its_own(tmp_path):
    """Of 330 kB it took 2.3 GB."""
    path = tmp_path / "a.feather"
    columns = {f"c{number}": np.zeros(8 << 20) for number in range(13)}
    pyarrow.feather.write_feather(pa.table(columns), str(path), compression="zstd")
    del columns
    with pytest.raises(LogError, match="more memory than its size allows"):
        open_recording(path)


def test_links_of_a_folder_to_itself_are_no_further_paths(tmp_path):
    """Two of them were 2 to the 40th paths of a pattern with **."""
    (tmp_path / "lap.csv").write_text("t,vx\n")
    for name in ("one", "two"):
        (tmp_path / name).symlink_to(tmp_path)
    assert [source.place for source in find_sources([f"{tmp_path}/**/*.csv"])] == ["lap.csv"]
    assert [source.place for source in find_sources([f"{tmp_path}/**"])] == ["lap.csv"]


@pytest.mark.parametrize("name", ["a.yaml", "a.parquet", "a.split", "a.html", "manifest.json", "a.csv"])
def test_a_pipe_is_refused_by_whoever_looks_at_files(tmp_path, name):
    os.mkfifo(tmp_path / name)
    for look in (verify, describe_file):
        with pytest.raises(SplitError, match="is a pipe"):
            look(tmp_path / name)


def test_a_pipe_among_the_files_of_a_bag_is_refused_and_each_file_is_opened_once(tmp_path):
    os.mkfifo(tmp_path / "a.db3")
    listed = "rosbag2_bagfile_information:\n  relative_file_paths: [a.db3, ./a.db3, a.db3]\n"
    (tmp_path / "metadata.yaml").write_text(listed)
    with pytest.raises(LogError, match="is a pipe"):
        open_recording(tmp_path)
