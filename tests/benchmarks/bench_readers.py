"""Messages a second of the MCAP reader against full decoding by mcap-ros2-support and by rosbags.

Run it with ``python -m tests.benchmarks.bench_readers [messages]``. All read the same file of ROS 2 odometry
and, but for the raw iteration, hand over the same numbers: time and three fields of every message.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

import tests.logs.readers_support as support
from split_cli.logs.readers import open_recording

REPEATS = 3
NAMES = list(support.FIELDS.values())


def ours(path: Path) -> np.ndarray:
    """Read through `open_recording`, opening included."""
    signals = open_recording(path).read(NAMES)
    return np.stack([signals[NAMES[0]].time, *[signals[name].values for name in NAMES]])


def mcap_iteration(path: Path) -> np.ndarray:
    """Iterate over raw messages with the `mcap` package, decoding nothing."""
    with path.open("rb") as stream:
        times = [message.log_time for _, _, message in make_reader(stream).iter_messages(topics=["/odom"])]
    return np.array([times])


def mcap_ros2_support(path: Path) -> np.ndarray:
    """Decode every message of the topic with mcap-ros2-support."""
    rows = []
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages(topics=["/odom"]):
            rows.append(_row(message))
    return np.array(rows).T


def rosbags(path: Path) -> np.ndarray:
    """Decode every message of the topic with rosbags."""
    rows = []
    with AnyReader([path.parent]) as reader:
        for connection, _, payload in reader.messages([c for c in reader.connections if c.topic == "/odom"]):
            rows.append(_row(reader.deserialize(payload, connection.msgtype)))
    return np.array(rows).T


def _row(message: object) -> tuple[float, float, float, float]:
    stamp, twist = message.header.stamp, message.twist.twist
    return stamp.sec + 1e-9 * stamp.nanosec, twist.linear.x, twist.linear.y, twist.angular.z


def best_time(read: Callable[[Path], np.ndarray], path: Path) -> tuple[float, np.ndarray]:
    """Return the shortest of a few runs [s], and what was read."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        result = read(path)
        times.append(time.perf_counter() - start)
    return min(times), result


def main(count: int = 50_000) -> None:
    """Write the file, read it by each, check that they agree, print the table."""
    planted = support.plant(count)
    with tempfile.TemporaryDirectory() as folder:
        bag = support.write_rosbag2(Path(folder) / "bag", planted, "MCAP")
        rewritten = Path(folder) / "bag" / next(bag.glob("*.mcap")).name
        support.write_ros2_mcap(rewritten, planted, compression=CompressionType.ZSTD, chunk_size=1 << 20)
        print(f"{count} odometry messages, {rewritten.stat().st_size / 1e6:.1f} MB in zstd chunks of 1 MB")
        measured = {
            read.__name__: best_time(read, rewritten)
            for read in (ours, mcap_iteration, mcap_ros2_support, rosbags)
        }
    reference = measured["mcap_ros2_support"]
    for name in ("ours", "rosbags"):
        np.testing.assert_array_equal(measured[name][1][1:], reference[1][1:])
    print(f"{'reader':<20}{'messages/s':>14}{'ratio':>8}")
    for name, (seconds, _) in measured.items():
        print(f"{name:<20}{count / seconds:>14,.0f}{reference[0] / seconds:>8.1f}")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:]))
