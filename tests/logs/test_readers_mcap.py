"""MCAP: the planted drive comes back bit for bit, whatever the encoding, compression and clock."""

from __future__ import annotations

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
    "cdr without repeats": lambda p, d: support.write_ros2_mcap(
        p, d, repeat_channels=False, repeat_schemas=False
    ),
    "ros1": support.write_ros1_mcap,
    "protobuf": support.write_protobuf_mcap,
    "json sec nsec": lambda p, d: support.write_json_mcap(
        p, d, lambda t: {"sec": t // 10**9, "nsec": t % 10**9}
    ),
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
    assert not [note for note in recording.notes if "taken to be in ns" not in note.what]
