"""Hostile input: a damaged recording gives a `LogError` or fewer values and a note, never a traceback."""

import gc
import tempfile

import numpy as np
import pytest
from mcap.writer import CompressionType

import tests.logs.readers_support as support
from split_cli.errors import LogError
from split_cli.logs.readers import open_recording
from tests.logs.readers_support import FIELDS
from tests.optional import needed

COUNT = 24
MCAP_KINDS = {
    "zstd": {"compression": CompressionType.ZSTD, "chunk_size": 4096},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 4096},
    "uncompressed": {"compression": CompressionType.NONE, "chunk_size": 4096},
    "without chunks": {"use_chunking": False},
}


def read_vx(path):
    """Open and read as a user would; return values and notes, or None for a `LogError`."""
    try:
        recording = open_recording(path)
        recording.channels()
        return recording.read([FIELDS["vx"]], recording.clocks[-1])[FIELDS["vx"]].values, recording.notes
    except LogError as error:
        assert "\n" not in str(error)
        return None


@pytest.fixture(scope="module")
def planted():
    return support.plant(count=COUNT)


def kept_of_cuts(path, whole, planted, *, all_told=True):
    """Return how many messages are read of the first bytes of a file, for fewer and fewer of them."""
    kept = []
    # 97 is prime, so that cuts fall everywhere within records.
    for size in range(len(whole) - 1, 0, -97):
        path.write_bytes(whole[:size])
        values, notes = read_vx(path) or ([], True)
        np.testing.assert_array_equal(values, planted.vx[: len(values)])
        assert notes or (len(values) == COUNT and not all_told), f"a cut at byte {size} was not told"
        kept.append(len(values))
    assert kept[0] == COUNT
    assert sorted(kept, reverse=True) == kept
    return set(kept)


@pytest.mark.parametrize("kind", MCAP_KINDS)
def test_mcap_cut_off_anywhere_keeps_the_messages_before(tmp_path, planted, kind):
    whole = support.write_ros2_mcap(tmp_path / "whole.mcap", planted, **MCAP_KINDS[kind]).read_bytes()
    # Recovery is by message, not by chunk: with 5 messages a chunk, all counts must occur where a cut can
    # fall between two messages. Compressed chunks of a few messages come in blocks, so fewer counts do.
    least = COUNT if kind in ("uncompressed", "without chunks") else COUNT // 5
    assert len(kept_of_cuts(tmp_path / "cut.mcap", whole, planted)) >= least


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_ros1_bag_cut_off_anywhere_keeps_the_messages_before(tmp_path, planted, compression):
    whole = support.write_bag1(tmp_path / "whole.bag", planted, compression).read_bytes()
    # What a killed recorder leaves has this name, and no index at its end.
    kept = kept_of_cuts(tmp_path / "drive.bag.active", whole, planted, all_told=False)
    # A compressed block, here the whole of 20 kB, is all or nothing; else every message before the cut is kept.
    assert len(kept) >= (2 if compression else COUNT)


@pytest.mark.parametrize("kind", ["zstd", "lz4", "uncompressed"])
def test_mcap_with_corrupt_bytes_never_gives_other_values(tmp_path, planted, kind):
    whole = support.write_ros2_mcap(tmp_path / "whole.mcap", planted, **MCAP_KINDS[kind]).read_bytes()
    rng = np.random.default_rng(11)
    path = tmp_path / "corrupt.mcap"
    known = set(planted.vx.tolist())
    fewer = 0
    for _ in range(250):
        corrupt = bytearray(whole)
        start = int(rng.integers(8, len(whole)))
        for position in range(start, min(start + int(rng.integers(1, 6)), len(whole))):
            corrupt[position] = int(rng.integers(256))
        path.write_bytes(corrupt)
        outcome = read_vx(path)
        if outcome is not None:
            values, notes = outcome
            # Chunks and the summary carry checksums, so what comes back must be planted.
            assert set(values.tolist()) <= known
            assert len(values) == COUNT or notes
            fewer += len(values) < COUNT
    assert fewer > 50


@pytest.mark.parametrize("kind", ["bag", "db3", "parquet", "feather", "mat", "csv", "unchunked", "mf4"])
def test_other_formats_cut_off_or_corrupt_give_no_traceback_and_print_nothing(tmp_path, planted, kind, capfd):
    path = write_other(tmp_path, planted, kind)
    whole = path.read_bytes()
    rng = np.random.default_rng(12)
    damaged = path.with_name("damaged" + path.suffix)
    # Each of these two is first read in a process of its own, which takes time; the fuzz tries many.
    for trial in range({"feather": 12, "mf4": 4}.get(kind, 120)):
        corrupt, start = bytearray(whole), int(rng.integers(1, len(whole)))
        if trial % 2:
            del corrupt[start:]
        else:
            corrupt[start : start + 8] = rng.bytes(min(8, len(whole) - start))
        damaged.write_bytes(corrupt)
        try:
            recording = open_recording(damaged)
            numeric = [c.name for c in recording.channels() if c.type_name != "text" and c.count != 0]
            recording.read(numeric[:20])
        except LogError as error:
            assert len(str(error)) < 1200
    gc.collect()
    assert capfd.readouterr() == ("", "")


def write_other(folder, planted, kind):
    import pandas as pd
    from scipy.io import savemat

    frame = pd.DataFrame({"t": planted.header * 1e-9, "vx(m/s)": planted.vx, "vy(m/s)": planted.vy})
    path = folder / f"drive.{kind}"
    if kind == "bag":
        return support.write_bag1(path, planted)
    if kind == "db3":
        messages = [(log, p) for _, log, _, p in support.cdr_messages(support.ros2_store(), planted)]
        return support.write_humble_db3(path, {"/odom": ("nav_msgs/msg/Odometry", messages)})
    if kind == "unchunked":
        return support.write_ros2_mcap(path, planted, use_chunking=False)
    if kind == "mf4":
        asammdf = needed("asammdf")
        with asammdf.MDF(version="4.10") as file:
            file.append([asammdf.Signal(planted.vx, planted.header * 1e-9, name="vx", unit="m/s")])
            return file.save(path, overwrite=True)
    if kind == "parquet":
        frame.to_parquet(path)
    elif kind == "feather":
        frame.to_feather(path)
    elif kind == "csv":
        frame.to_csv(path, index=False)
    else:
        savemat(path, {name.partition("(")[0]: values for name, values in frame.items()})
    return path


def test_a_structure_of_arrow_that_claims_more_rows_than_its_parts_ends_no_process(tmp_path):
    import pyarrow as pa
    import pyarrow.feather

    path = tmp_path / "lap.feather"
    pose = pa.StructArray.from_arrays([pa.array(np.arange(40.0))], ["vy"])
    pyarrow.feather.write_feather(pa.table({"pose": pose}), str(path), compression="uncompressed")
    assert len(open_recording(path).read(["pose.vy"])["pose.vy"].values) == 40
    whole, lengths = path.read_bytes(), (40).to_bytes(8, "little")
    at, refused = whole.find(lengths), 0
    while at >= 0:
        path.write_bytes(whole[:at] + (4_000_000).to_bytes(8, "little") + whole[at + 8 :])
        try:
            recording = open_recording(path)
            recording.read([info.name for info in recording.channels()])
        except LogError as error:
            refused += "cut off or damaged" in str(error)
        at = whole.find(lengths, at + 1)
    assert refused >= 2


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("empty.mcap", b"", "is empty"),
        ("zeros.mcap", bytes(5000), "does not begin like"),
        ("zeros.dat", bytes(5000), "no known format"),
        ("picture.png", b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20, "no known format"),
        ("letter.txt", b"Dear reader,\nthis is a letter; it has no numbers.\n" * 50, "no table of numbers"),
        ("header.csv", b"t,vx,vy\n", "no table of numbers"),
        ("drive.csv.gz", b"\x1f\x8b\x08\x00" + bytes(100), "cannot be unpacked"),
        ("flight.ulg", b"ULog\x01\x12\x35\x01" + bytes(100), "pyulog|damaged|no channel"),
        ("magic.mcap", b"\x89MCAP0\r\n", "no readable message"),
        ("noise.mcap", b"\x89MCAP0\r\n" + np.random.default_rng(0).bytes(4000), "no readable message"),
        ("noise.parquet", b"PAR1" + np.random.default_rng(0).bytes(400), "damaged"),
        ("noise.db3", b"SQLite format 3\0" + np.random.default_rng(0).bytes(4000), "damaged"),
        ("noise.bag", b"#ROSBAG V2.0\n" + np.random.default_rng(0).bytes(400), "no readable message"),
        ("noise.mat", b"MATLAB 5.0 MAT-file" + np.random.default_rng(0).bytes(400), "damaged"),
        ("noise.mf4", b"MDF     4.10    " + np.random.default_rng(0).bytes(400), "damaged"),
    ],
)
def test_what_is_no_recording_is_said_and_leaves_nothing(tmp_path, monkeypatch, name, content, match):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=match) as caught:
        open_recording(tmp_path / name)
    assert name in str(caught.value)
    del caught
    gc.collect()
    assert not list(scratch.iterdir())


def test_missing_paths_and_empty_folders_are_said(tmp_path):
    (tmp_path / "lap_one.mcap").write_bytes(b"")
    with pytest.raises(LogError, match=r"does not exist.*Did you mean lap_one\.mcap"):
        open_recording(tmp_path / "lap_onne.mcap")
    (tmp_path / "folder").mkdir()
    with pytest.raises(LogError, match="without a recording"):
        open_recording(tmp_path / "folder")
    (tmp_path / "folder" / "metadata.yaml").write_text("rosbag2_bagfile_information: [1, 2]\n")
    with pytest.raises(LogError, match=r"metadata\.yaml"):
        open_recording(tmp_path / "folder")


def test_missing_topics_fields_and_clocks_name_what_exists(tmp_path, planted):
    recording = open_recording(support.write_ros2_mcap(tmp_path / "a.mcap", planted))
    with pytest.raises(LogError, match="Did you mean /odom"):
        recording.read(["/odometry/twist.twist.linear.x"])
    with pytest.raises(LogError, match=r"Did you mean twist\.twist\.linear\.x"):
        recording.read(["/odom/twist.twist.linear.xx"])
    with pytest.raises(LogError, match="no numeric field 'child_frame_id'"):
        recording.read(["/odom/child_frame_id"])
    with pytest.raises(LogError, match=r"covariance\[36\]"):
        recording.read(["/odom/twist.covariance[36]"])
    bag = open_recording(support.write_bag1(tmp_path / "a.bag", planted))
    with pytest.raises(LogError, match="has no publish time.*header, log"):
        bag.read([FIELDS["vx"]], "publish")


def test_undecodable_payloads_are_counted_and_the_others_kept(tmp_path, planted):
    store = support.ros2_store()
    messages = support.cdr_messages(store, planted)
    messages[4] = (*messages[4][:3], messages[4][3][:100])
    messages[9] = (*messages[9][:3], b"")
    schema = support.ros2_schema(store, "nav_msgs/msg/Odometry")
    recording = open_recording(support.write_mcap(tmp_path / "a.mcap", schema, "cdr", messages))
    values = recording.read([FIELDS["vx"]])[FIELDS["vx"]].values
    np.testing.assert_array_equal(values, np.delete(planted.vx, [4, 9]))
    for _ in range(2):
        recording.read([FIELDS["vx"]])
    (note,) = recording.notes
    assert (note.count, note.where) == (2, "/odom")


@pytest.mark.parametrize("encoding", ["flatbuffer", "cbor", "msgpack", "", "x" * 2000])
def test_unsupported_encodings_are_listed_and_refused(tmp_path, encoding):
    messages = [("/odom", support.EPOCH, support.EPOCH, b"abc")]
    path = support.write_mcap(tmp_path / "a.mcap", ("Odometry", encoding, b""), encoding, messages)
    recording = open_recording(path)
    assert [channel.name for channel in recording.channels()] == ["/odom"]
    assert recording.clocks == ("publish", "log")
    with pytest.raises(LogError, match="not supported"):
        recording.read(["/odom/x"])


@pytest.mark.parametrize("payload", [b"", b"[1]", b"{", b'{"vx": "fast"}', b'{"vx": {"deeper": 1}}', b"\xff\xfe"])
def test_json_that_is_none_is_counted_or_missing(tmp_path, payload):
    messages = [("/car", support.EPOCH + row, 0, b'{"vx": %d}' % row) for row in range(4)]
    messages.append(("/car", support.EPOCH + 9, 0, payload))
    recording = open_recording(support.write_mcap(tmp_path / "a.mcap", ("Car", "", b""), "json", messages))
    values = recording.read(["/car/vx"])["/car/vx"].values
    np.testing.assert_array_equal(values[:4], [0, 1, 2, 3])
    assert recording.notes if len(values) == 4 else np.isnan(values[4])
