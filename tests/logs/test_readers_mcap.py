"""MCAP: the planted drive comes back bit for bit, whatever the encoding, compression and clock."""

from __future__ import annotations

import numpy as np
import pytest
import readers_support as support
from mcap.writer import CompressionType, IndexType

from split_cli.errors import LogError
from split_cli.logs.readers import open_recording

FIELDS = {
    "vx": "/odom/twist.twist.linear.x",
    "vy": "/odom/twist.twist.linear.y",
    "r": "/odom/twist.twist.angular.z",
}


def check_planted(recording, planted, clocks=("header", "publish", "log")):
    """Assert that values are equal bit for bit, and times to the rounding of a double near 10 s (2 ns)."""
    for clock in clocks:
        signals = recording.read(list(FIELDS.values()), clock)
        expected = (getattr(planted, clock) - planted.log.min()) * 1e-9
        for name, topic in FIELDS.items():
            np.testing.assert_array_equal(signals[topic].values, getattr(planted, name))
            np.testing.assert_allclose(signals[topic].time, expected, rtol=0, atol=2e-9)
    assert recording.origin == pytest.approx(planted.log.min() * 1e-9, abs=1e-6)


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
    assert not [note for note in recording.notes if "assumed" not in note.what]
