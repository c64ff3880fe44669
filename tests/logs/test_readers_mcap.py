"""MCAP: the planted drive comes back bit for bit, whatever the encoding, compression and clock."""

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType

import tests.logs.readers_support as support
from split_cli.logs.readers import open_recording
from tests.logs.readers_support import FIELDS, check_planted

WRITERS = {
    "cdr zstd": support.write_ros2_mcap,
    "cdr lz4": lambda p, d: support.write_ros2_mcap(p, d, compression=CompressionType.LZ4),
    "cdr uncompressed": lambda p, d: support.write_ros2_mcap(p, d, compression=CompressionType.NONE),
    "cdr without chunks": lambda p, d: support.write_ros2_mcap(p, d, use_chunking=False),
    "cdr without index": lambda p, d: support.write_ros2_mcap(p, d, index_types=IndexType.NONE),
    "cdr without statistics": lambda p, d: support.write_ros2_mcap(p, d, use_statistics=False),
    "cdr without repeats": lambda p, d: support.write_ros2_mcap(p, d, repeat_channels=False, repeat_schemas=False),
    "ros1": support.write_ros1_mcap,
    "protobuf": support.write_protobuf_mcap,
    "json sec nsec": lambda p, d: support.write_json_mcap(p, d, lambda t: {"sec": t // 10**9, "nsec": t % 10**9}),
    "json nanoseconds": lambda p, d: support.write_json_mcap(p, d, lambda t: t),
}


@pytest.mark.parametrize("how", WRITERS)
def test_the_planted_drive_comes_back(tmp_path, how):
    planted = support.plant()
    recording = open_recording(WRITERS[how](tmp_path / "drive.mcap", planted))
    assert recording.clocks == ("header", "publish", "log")
    check_planted(recording, planted)
    assert {c.name for c in recording.channels()} >= set(FIELDS.values())
    assert {c.count for c in recording.channels()} == {len(planted.vx)}
    said = ["taken to be in ns"] + ["without a checksum"] * (how == "cdr without chunks")
    assert not [note for note in recording.notes if not any(words in note.what for words in said)]


def test_protobuf_parts_that_a_message_leaves_out_are_missing(tmp_path):
    from mcap_protobuf.schema import build_file_descriptor_set

    kind = support.protobuf_odometry()
    full, without_twist, default = kind(), kind(), kind()
    full.twist.twist.linear.x = 3.0
    full.twist.covariance.extend([1.0, 2.0])
    default.twist.twist.linear.y = 1.0
    messages = [
        ("/odom", support.EPOCH + n, support.EPOCH + n, message.SerializeToString())
        for n, message in enumerate([full, without_twist, default])
    ]
    schema = ("test.Odometry", "protobuf", build_file_descriptor_set(kind).SerializeToString())
    recording = open_recording(support.write_mcap(tmp_path / "a.mcap", schema, "protobuf", messages))
    signals = recording.read([FIELDS["vx"], "/odom/twist.covariance[1]"])
    # In a submessage that is there, a number left out is zero: so proto3 defines it.
    np.testing.assert_array_equal(signals[FIELDS["vx"]].values, [3.0, np.nan, 0.0])
    np.testing.assert_array_equal(signals["/odom/twist.covariance[1]"].values, [2.0, np.nan, np.nan])


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us")])
def test_the_unit_of_a_bare_json_time_is_found_and_said(tmp_path, factor, unit):
    planted = support.plant(count=50)
    path = support.write_json_mcap(tmp_path / "a.mcap", planted, lambda time: time * 1e-9 * factor)
    recording = open_recording(path)
    time = recording.read([FIELDS["vx"]], "header")[FIELDS["vx"]].time
    # Seconds since 1970 in a double resolve 0.24 us.
    np.testing.assert_allclose(time, (planted.header - planted.log.min()) * 1e-9, rtol=0, atol=5e-7)
    assert [note.what for note in recording.notes] == [f"timestamp has no unit, taken to be in {unit}"]
