"""Logs of simulated drives as a real logger would have written them: MCAP with ROS 2 messages, CSV, Parquet."""

import heapq
import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer

from split_cli.errors import SplitError
from split_cli.files import atomic_path, atomic_write_text
from split_cli.plant.ros_messages import TOPICS, Topic, definition
from split_cli.plant.sensors import Reading
from split_cli.signals import CHANNELS, find_unit

#: Seconds since 1970 of a run's time 0 [s].
EPOCH = 1_700_000_000
"""When every simulated drive begins, seconds since 1970: fixed, so that equal seeds give equal files [s]."""

TABLE_CHANNELS = {name: channel.unit for name, channel in CHANNELS.items()}
"""Columns of a table in their order, with their units in the order of the drive's channels."""

WORKSHOP_UNITS = {
    "yaw": "deg",
    "vx": "km/h",
    "vy": "km/h",
    "r": "deg/s",
    "T": "N m",
    "delta": "deg",
    "ax": "g",
    "ay": "g",
}
"""What a data logger of a workshop would use."""


def write_mcap(readings: tuple[Reading, ...], path: str | Path) -> None:
    """Write an MCAP with ROS 2 messages in cdr, their definitions inside, zstd chunks.

    A message's header time is the device's stamp, its publish time a little later, its log time the arrival; the
    file is in order of arrival, so header times of different topics interleave out of order.

    Parameters
    ----------
    readings : tuple of Reading
        Of `sensors.measure`.
    """
    by_name = {reading.sensor.name: reading for reading in readings}
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        topics = [topic for topic in TOPICS if topic.sensor in by_name]
        types = dict.fromkeys(topic.type_name for topic in topics)
        schemas = {name: writer.register_msgdef(name, definition(name)) for name in types}
        merged = heapq.merge(
            *(_messages(topic, index, by_name[topic.sensor], EPOCH) for index, topic in enumerate(topics)),
            key=lambda message: message[:2],
        )
        for log_time, index, sequence, publish_time, message in merged:
            topic = topics[index]
            writer.write_message(topic.name, schemas[topic.type_name], message, log_time, publish_time, sequence)
        writer.finish()


def _messages(topic: Topic, index: int, reading: Reading, start: float):
    """Yield (log time, topic, sequence, publish time, message) of a topic in order of arrival [ns]."""
    begin = int(round(start)) * 1_000_000_000
    # Microseconds, which is what such clocks resolve.
    stamp = begin + np.round(reading.stamp * 1e6).astype(np.int64) * 1000
    # A transport never overtakes itself on one topic.
    arrival = np.maximum.accumulate(begin + np.round(reading.arrival * 1e6).astype(np.int64) * 1000)
    publish = stamp + (arrival - stamp) // 2000 * 1000
    rows = np.stack([reading.values[name] for name in reading.values], axis=1).tolist()
    names = list(reading.values)
    for sequence, row in enumerate(rows):
        seconds, nanoseconds = divmod(int(stamp[sequence]), 1_000_000_000)
        header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": topic.frame}
        message = {"header": header, **topic.fill(dict(zip(names, row, strict=True)))}
        yield int(arrival[sequence]), index, sequence, int(publish[sequence]), message


def _table(readings: tuple[Reading, ...]) -> dict[str, np.ndarray]:
    """Return the columns of readings that share one clock, by channel."""
    columns: dict[str, np.ndarray] = {}
    clock = readings[0].stamp
    for reading in readings:
        if len(reading.stamp) != len(clock) or np.abs(reading.stamp - clock).max() > 1e-9:
            raise SplitError(f"a table needs one clock, {reading.sensor.name} has its own", where="measure")
        for name, values in reading.values.items():
            columns.setdefault(name, values)
    return {"t": np.round(clock, 6), **{name: columns[name] for name in TABLE_CHANNELS if name in columns}}


def write_csv(readings: tuple[Reading, ...], path: str | Path, *, workshop_units: bool = False) -> None:
    """Write a CSV with ``name(unit)`` headers; the readings share one clock.

    Parameters
    ----------
    workshop_units : bool
        km/h, deg, deg/s and g instead of SI.
    """
    columns = _table(readings)
    units = {**TABLE_CHANNELS, **(WORKSHOP_UNITS if workshop_units else {})}
    text = io.StringIO()
    text.write(",".join(f"{name}({units[name]})" for name in columns) + "\n")
    shown = []
    for name, values in columns.items():
        unit = find_unit(units[name])
        digits = 4 if name == "t" else _digits(unit.factor, values)
        shown.append([f"{value:.{digits}f}" for value in (values - unit.offset) / unit.factor])
    for row in zip(*shown, strict=True):
        text.write(",".join(row) + "\n")
    atomic_write_text(path, text.getvalue())


def _digits(factor: float, values: np.ndarray) -> int:
    """Return decimals that resolve a channel to a millionth of its span, which no sensor here does."""
    span = max(float(np.ptp(values)), 1e-3) / factor
    return int(np.clip(np.ceil(-np.log10(span * 1e-5)), 0, 7))


def write_parquet(readings: tuple[Reading, ...], path: str | Path) -> None:
    """Write a Parquet with the canonical column names in SI units; the readings share one clock."""
    columns = _table(readings)
    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    with atomic_path(path) as temporary:
        # Noise has few equal values, so a dictionary only costs; an even clock has bytes that hardly change.
        pyarrow.parquet.write_table(
            table,
            temporary,
            compression="zstd",
            compression_level=15,
            use_dictionary=False,
            column_encoding={"t": "BYTE_STREAM_SPLIT"},
            write_page_checksum=True,
        )
