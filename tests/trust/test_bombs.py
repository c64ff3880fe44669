"""Files that unfold into more than a computer holds are refused, in bounded memory and time."""

import bz2
import io
import lzma
import os
import sqlite3
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from pathlib import Path

import h5py
import lz4.frame
import pytest
import yaml
import zstandard

from split_cli.errors import LogError, SplitError, VehicleError
from split_cli.logs.budget import most_bytes_out
from split_cli.logs.readers import open_recording
from split_cli.logs.readers.blf import is_cut_blf
from split_cli.logs.readers.definitions import Definitions, leaf_paths
from split_cli.vehicle.parameters import read_vehicle
from tests.trust.test_hostile_containers import mcap, record, text

MEMORY = 1 << 30
"""Of the process that opens a bomb [bytes]: the project's bound; imports alone take some 300 MB of addresses."""


def opened_within_memory(path: Path) -> str:
    """Open a recording and read all of it in a process of bounded memory; returns what it said."""
    code = (
        "import sys\n"
        "from split_cli.errors import SplitError\n"
        "from split_cli.logs.readers import open_recording\n"
        "try:\n"
        "    r = open_recording(sys.argv[1]); r.read([c.name for c in r.channels()]); print('read', r.notes)\n"
        "except SplitError as error:\n"
        "    print('refused', error)\n"
        "print(open('/proc/self/status').read().partition('VmHWM:')[2].split()[0], file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    # Of the new program alone: what the system counts of a child begins with the memory of the test run.
    peak = int(done.stderr.split()[-1])
    assert peak * 1024 < MEMORY, f"{peak / 1e3:.0f} MB"
    return done.stdout


def zeros_packed(engine, megabytes: int) -> bytes:
    """Return zeros as an engine of compression packs them, megabyte by megabyte."""
    return b"".join(engine.compress(bytes(1 << 20)) for _ in range(megabytes)) + engine.flush()


def mcap_with_chunk(path: Path, compression: bytes, packed: bytes, claimed: int) -> Path:
    """Write an MCAP file of one chunk, by the format's own layout."""
    chunk = struct.pack("<QQQI", 0, 1, claimed, 0) + text(compression) + struct.pack("<Q", len(packed)) + packed
    return mcap(path, record(6, chunk))


@pytest.mark.parametrize("claimed", [1000, 2 << 30, 3 << 30])
@pytest.mark.parametrize("compression", [b"zstd", b"lz4"])
def test_a_chunk_of_mcap_unfolds_into_what_it_claims_at_most(tmp_path, compression, claimed):
    zeros = zeros_packed(zstandard.ZstdCompressor().compressobj(), 200)
    packed = zeros if compression == b"zstd" else lz4.frame.compress(bytes(64 << 20))
    path = mcap_with_chunk(tmp_path / "bomb.mcap", compression, packed, claimed)
    assert "refused" in opened_within_memory(path)


def zip_of_zeros(megabytes: int) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for half in ("a.csv", "b.csv"):
            archive.writestr(half, bytes(megabytes << 19))
    return content.getvalue()


@pytest.mark.parametrize("kind", ["gz", "bz2", "xz", "zst", "zip"])
def test_a_packed_file_unfolds_within_its_bound_and_leaves_nothing(tmp_path, monkeypatch, kind):
    """Of an archive all files together; each is below the 64 MB that any file may unfold into."""
    engines = {
        "gz": lambda: zlib.compressobj(wbits=31),
        "bz2": bz2.BZ2Compressor,
        "xz": lambda: lzma.LZMACompressor(preset=0),
        "zst": lambda: zstandard.ZstdCompressor().compressobj(),
    }
    packed = zip_of_zeros(100) if kind == "zip" else zeros_packed(engines[kind](), 100)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    path = tmp_path / (f"bomb.{kind}" if kind == "zip" else f"bomb.csv.{kind}")
    path.write_bytes(packed)
    said = opened_within_memory(path)
    assert "refused" in said and "unpacks into over 60 times its size" in said
    assert not [file for file in temporary.rglob("*") if file.is_file() and "compiled" not in str(file)]


def test_a_chunk_of_a_bag_unfolds_within_its_budget(tmp_path):
    packed = zeros_packed(bz2.BZ2Compressor(), 100)
    assert len(packed) < 5000

    def field(name: bytes, value: bytes) -> bytes:
        return struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value

    head = field(b"op", b"\x05") + field(b"compression", b"bz2") + field(b"size", struct.pack("<I", 100 << 20))
    body = struct.pack("<I", len(head)) + head + struct.pack("<I", len(packed)) + packed
    path = tmp_path / "bomb.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + body)
    assert "refused" in opened_within_memory(path)


def test_a_matlab_variable_is_measured_before_it_is_unpacked(tmp_path):
    packed = zeros_packed(zlib.compressobj(9), 100)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    path = tmp_path / "bomb.mat"
    path.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    said = opened_within_memory(path)
    assert "refused" in said and "more than" in said


def test_a_block_of_can_frames_is_measured_before_it_is_unpacked(tmp_path):
    packed = zeros_packed(zlib.compressobj(9), 100)
    container = struct.pack("<H6xL4x", 2, 1000) + packed
    block = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(container), 10) + container
    (tmp_path / "bomb.blf").write_bytes(b"LOGG" + struct.pack("<L", 144) + bytes(136) + block)
    with pytest.raises(LogError, match="a block claims 6[0-9] MB"):
        is_cut_blf(tmp_path / "bomb.blf")


def test_a_fill_value_is_no_data(tmp_path):
    path = tmp_path / "bomb.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("speed", shape=(800_000_000, 1), dtype="f8", fillvalue=1.0, chunks=(100_000, 1))
    said = opened_within_memory(path)
    assert "refused" in said and "speed claims 6,400 MB" in said


def test_honest_compression_is_read(tmp_path):
    # A channel that never changes: the case in which honest data come nearest to a bomb.
    path = tmp_path / "still.mat"
    with h5py.File(path, "w") as file:
        import numpy as np

        file.create_dataset("t", data=np.arange(200_000.0), compression="gzip", chunks=True)
        file.create_dataset("speed", data=np.zeros(200_000), compression="gzip", chunks=True)
    assert len(open_recording(path).read(["speed"])["speed"].values) == 200_000


@pytest.mark.parametrize("bytes_in", [0, 1, 1000, 10**6, 10**8, 10**12])
def test_the_budget_is_monotonous_and_bounded(bytes_in):
    assert 64 << 20 <= most_bytes_out(bytes_in) <= 2 << 30
    assert most_bytes_out(bytes_in) <= most_bytes_out(bytes_in + 1)


def definition(levels: int, fields: str) -> bytes:
    parts = [fields.format(1)]
    for level in range(1, levels):
        parts += ["=" * 80, f"MSG: evil/Level{level}", fields.format(level + 1)]
    parts += ["=" * 80, f"MSG: evil/Level{levels}", "float64 x"]
    return "\n".join(parts).encode()


@pytest.mark.parametrize("fields", ["Level{0} a\nLevel{0} b", "Level{0}[64] a", "Level{0}[] a\nLevel{0}[2] b"])
def test_a_definition_that_unfolds_without_end_is_refused(fields):
    with pytest.raises(LogError, match="numbers|nested"):
        Definitions().layout("evil/Top", "ros2msg", definition(22, fields))


def test_numbers_are_counted_as_they_are_listed():
    # 3 levels of two fields: 8 numbers, by both ways of counting.
    layout = Definitions().layout("evil/Top", "ros2msg", definition(3, "Level{0} a\nLevel{0} b"))
    assert len(list(leaf_paths(layout.fields))) == 8


def test_a_view_that_never_ends_is_no_table_of_messages(tmp_path):
    path = tmp_path / "endless.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(id, topic_id, timestamp, data) AS "
            "(SELECT 1, 1, 1, x'' UNION ALL SELECT id + 1, 1, id, x'' FROM n) SELECT * FROM n"
        )
    with pytest.raises(LogError, match="messages is a view"):
        open_recording(path)


def bag_of_one_message(path, column="data BLOB NOT NULL") -> int:
    """Write a rosbag2 database of one message in pages of 512 bytes; return the page of its table."""
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA page_size = 512")
        database.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute(
            f"CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, {column})"
        )
        database.execute("CREATE TABLE spare(x BLOB)")
        database.execute("INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/Float64', 'cdr')")
        data = ("", "") if "AS" in column else (", data", ", zeroblob(12)")
        database.execute(f"INSERT INTO messages(topic_id, timestamp{data[0]}) VALUES (1, 1{data[1]})")
        database.executemany("INSERT INTO spare VALUES (?)", [(b"x" * 400,)] * 40)
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    return root


def test_a_tree_of_pages_that_unfolds_is_cut_by_the_work_that_reading_it_is(tmp_path):
    """Sixteen pages, each with forty times the next one as its child: 10^25 rows in 20 kB."""
    path, page = tmp_path / "endless.db3", 512
    root = bag_of_one_message(path)
    content = bytearray(path.read_bytes())
    last = len(content) // page
    content[(last - 1) * page :] = content[(root - 1) * page : root * page]
    child = last
    for number in [*range(last - 1, last - 16, -1), root]:
        cells = b"".join(struct.pack(">IB", child, 1) for _ in range(40))
        begin = page - len(cells)
        pointers = b"".join(struct.pack(">H", begin + 5 * k) for k in range(40))
        head = struct.pack(">BHHHBI", 5, 0, 40, begin, 0, child) + pointers
        content[(number - 1) * page : number * page] = head.ljust(begin, b"\0") + cells
        child = number
    path.write_bytes(content)
    began = time.process_time()
    with pytest.raises(LogError, match="damaged, or no rosbag2"):
        open_recording(path)
    assert time.process_time() - began < 5.0


def test_a_message_of_the_year_1677_costs_itself_only(tmp_path):
    """Its time, negative, was taken as the recording's first, and no message was read."""
    bag_of_one_message(tmp_path / "old.db3")
    with sqlite3.connect(tmp_path / "old.db3") as database:
        row = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)"
        database.executemany(row, ((time, struct.pack("<Id", 256, 1.5)) for time in (-(2**63), "soon", 2.5, 7)))
    recording = open_recording(tmp_path / "old.db3")
    (signal,) = recording.channels()
    assert len(recording.read([signal.name])[signal.name].values) == 2
    assert [note.count for note in recording.notes] == [3]


def test_messages_that_are_computed_are_none(tmp_path):
    bag_of_one_message(tmp_path / "made.db3", "data BLOB AS (zeroblob(900000000))")
    with pytest.raises(LogError, match="messages is computed"):
        open_recording(tmp_path / "made.db3")


def test_the_bound_of_work_leaves_room_for_the_smallest_messages(tmp_path, monkeypatch):
    from split_cli.logs.readers import rosbag2

    monkeypatch.setattr(rosbag2, "FREE_STEPS", 0)
    bag_of_one_message(tmp_path / "many.db3")
    with sqlite3.connect(tmp_path / "many.db3") as database:
        row = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)"
        database.executemany(row, ((k, struct.pack("<Id", 256, k)) for k in range(2, 20_001)))
    read = open_recording(tmp_path / "many.db3")
    (signal,) = read.channels()
    assert len(read.read([signal.name])[signal.name].values) == 20_000


_NEXT = list(zip("abcdefgh", "bcdefghi", strict=True))
YAML_BOMBS = {
    "aliases": "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(f"{n}: &{n} [{','.join([f'*{p}'] * 9)}]\n" for p, n in _NEXT),
    "merges": "a: &a {k0: 1}\n"
    + "".join(f"{n}: &{n} {{<<: [{','.join([f'*{p}'] * 9)}], k{n}: 1}}\n" for p, n in _NEXT),
    "itself": "a: &a [*a]\n",
    "digits": "mass: " + "9" * 5000 + "\n",
    "large": "mass: 1" + "0" * 399 + "\n",
    "date": "name: 2023-02-31\n",
    "deep": "a: " + "[" * 5000 + "]" * 5000 + "\n",
    "size": "name: |\n" + "  x\n" * 2_000_000,
}


@pytest.mark.parametrize("kind", YAML_BOMBS)
def test_yaml_that_unfolds_without_end_is_refused_with_its_reason(tmp_path, kind):
    path = tmp_path / "car.yaml"
    path.write_text(YAML_BOMBS[kind])
    with pytest.raises(VehicleError) as refused:
        read_vehicle(path)
    assert str(path) in str(refused.value)


def test_an_alias_that_is_used_twice_is_fine(tmp_path):
    from split_cli.yaml_file import read_yaml_mapping

    path = tmp_path / "map.yaml"
    path.write_text("a: &a {x: 1}\nb: *a\nc: {<<: *a, y: 2}\n")
    assert read_yaml_mapping(path, SplitError) == {"a": {"x": 1}, "b": {"x": 1}, "c": {"x": 1, "y": 2}}


@pytest.mark.parametrize(
    ("at", "value", "says"),
    [
        (128, 99, "type 99 where a variable was expected"),
        (144, 77, "class 77"),
        (152, 999, "type 999"),
        (132, 10**6, "ends after the file"),
        (136, 5, "without flags"),
    ],
)
def test_a_tag_that_scipy_would_follow_into_nothing_is_refused(tmp_path, at, value, says):
    import numpy as np
    from scipy.io import savemat

    path = tmp_path / "lap.mat"
    savemat(path, {"speed": np.arange(10.0)}, do_compression=False)
    content = bytearray(path.read_bytes())
    content[at : at + 4] = value.to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(LogError, match=says):
        open_recording(path)


def test_yaml_of_many_values_is_refused_where_the_bound_is_passed(tmp_path):
    """All were composed before they were counted, which took a minute; keys were compared with all others."""
    from split_cli.yaml_file import parse_yaml

    with pytest.raises(yaml.YAMLError, match="more than 100000 values") as refused:
        parse_yaml("a: [" + "[]," * 400_000 + "]\n")
    assert 290_000 < refused.value.problem_mark.index < 310_000
    keys = "".join(f"k{number}: 1\n" for number in range(10_000))
    with pytest.raises(yaml.YAMLError, match="the key 'k7' stands twice"):
        parse_yaml(f"{keys}k7: 2\n")
