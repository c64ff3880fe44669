"""Messages a second of the readers of MCAP and bags against mcap-ros2-support and rosbags, decoding in full.

Run it with ``python -m tests.benchmarks.bench_readers [messages]``. All read the same file of ROS 2 odometry
and, but for the raw iteration, hand over the same numbers: time and three fields of every message. With ``csv``
in place of a number it reads a plain table of a million rows beside pyarrow and pandas instead.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pyarrow import csv as arrow_csv
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
    with AnyReader([path if path.suffix == ".bag" else path.parent]) as reader:
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


def compare(count: int, path: Path, readers: Sequence[Callable[[Path], np.ndarray]]) -> None:
    """Print the table of one file; the last reader, which decodes in full, is the reference of the ratios."""
    measured = {read.__name__: best_time(read, path) for read in readers}
    reference_time, reference = measured[readers[-1].__name__]
    np.testing.assert_array_equal(measured["ours"][1][1:], reference[1:])
    print(f"\n{path.name}: {count} odometry messages, {path.stat().st_size / 1e6:.1f} MB")
    print(f"{'reader':<20}{'messages/s':>14}{'ratio':>8}")
    for name, (seconds, _) in measured.items():
        print(f"{name:<20}{count / seconds:>14,.0f}{reference_time / seconds:>8.1f}")


def compare_csv(rows: int = 1_000_000, columns: int = 10) -> None:
    """Print median times of reading a plain table, turn by turn: a machine that others use slows all alike."""
    steps = np.random.default_rng(0).normal(0.0, 0.01, (rows, columns)).cumsum(axis=0)
    names = [f"c{column}" for column in range(columns)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plain.csv"
        arrow_csv.write_csv(pa.table(dict(zip(names, steps.T, strict=True))), path)
        readers: dict[str, Callable[[], object]] = {
            "open_recording": lambda: open_recording(path).read(names),
            "pyarrow.csv.read_csv": lambda: arrow_csv.read_csv(path),
            "pandas.read_csv": lambda: pd.read_csv(path),
        }
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in readers}
        for _ in range(2 * REPEATS):
            for name, read in readers.items():
                start = time.process_time(), time.perf_counter()
                read()
                times[name].append((time.process_time() - start[0], time.perf_counter() - start[1]))
        print(f"{path.name}: {rows} rows of {columns} columns, {path.stat().st_size / 1e6:.0f} MB")
    for name, spent in times.items():
        processor, wall = np.median(spent, axis=0)
        least = np.min(spent, axis=0)[0]
        print(f"{name:<22}{processor:>8.3f} s of processor time, at best {least:.3f} s; {wall:.3f} s of wall time")


def main(count: int = 50_000) -> None:
    """Write the planted drive in three containers and read it by each of the readers that can."""
    planted = support.plant(count)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        support.write_rosbag2(folder / "mcap", planted, "MCAP")
        zstd = support.write_ros2_mcap(folder / "mcap" / "mcap.mcap", planted, chunk_size=1 << 20)
        compare(count, zstd, (ours, mcap_iteration, rosbags, mcap_ros2_support))
        support.write_rosbag2(folder / "db3", planted, "SQLITE3")
        compare(count, folder / "db3" / "db3.db3", (ours, rosbags))
        compare(count, support.write_bag1(folder / "drive.bag", planted), (ours, rosbags))


if __name__ == "__main__":
    if sys.argv[1:] == ["csv"]:
        compare_csv()
        sys.exit()
    main(*(int(argument) for argument in sys.argv[1:]))
