"""Recordings of any length in the formats that `split ingest` reads: one lap, repeated with other sensor noise.

Used by `tests.studies.memory`.
"""

import json
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

_NOISE = {"vx": 0.02, "vy": 0.01, "r": 0.002}
_TOPIC = "/car"
_TYPE = "car_msgs/msg/Car"
_DBC = """VERSION ""
BU_: ECU
BO_ 256 Motion: 8 ECU
 SG_ vx : 0|16@1- (0.002,0) [-65|65] "m/s" ECU
 SG_ vy : 16|16@1- (0.0005,0) [-16|16] "m/s" ECU
 SG_ r : 32|16@1- (0.0001,0) [-3|3] "rad/s" ECU
BO_ 257 Inputs: 8 ECU
 SG_ T : 0|16@1- (0.5,0) [-16000|16000] "N m" ECU
 SG_ delta : 16|16@1- (0.0001,0) [-3|3] "rad" ECU
"""
_ON_BUS = {"Motion": ("vx", "vy", "r"), "Inputs": ("T", "delta")}

Part = dict[str, np.ndarray]


class LoggedLap:
    """A drive that is repeated.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (N,)
        With the time as ``t`` [s].
    """

    def __init__(self, columns: Mapping[str, np.ndarray]) -> None:
        self.columns = dict(columns)
        self.names = [name for name in columns if name != "t"]
        self.length = len(columns["t"])
        self.duration = float(columns["t"][-1]) + 1.0

    def parts(self, rows: int) -> Iterator[Part]:
        """Yield `rows` rows, a lap at a time, each with noise of its own and a second after the one before."""
        rng = np.random.default_rng(rows)
        for number in range(-(-rows // self.length)):
            count = min(self.length, rows - number * self.length)
            part = {name: values[:count].copy() for name, values in self.columns.items()}
            part["t"] += number * self.duration
            for name, sigma in _NOISE.items():
                part[name] += rng.normal(0.0, sigma, count)
            yield part

    def whole(self, rows: int) -> Part:
        """Return `rows` rows at once."""
        parts = list(self.parts(rows))
        return {name: np.concatenate([part[name] for part in parts]) for name in self.columns}

    def packed(self, rows: int) -> Iterator[tuple[int, bytes]]:
        """Yield time [ns] and the numbers of each row, as doubles one after the other."""
        for part in self.parts(rows):
            numbers = np.column_stack([part[name] for name in self.names])
            yield from zip(_nanoseconds(part["t"]), map(bytes, numbers), strict=True)


def write_log(kind: str, path: Path, lap: LoggedLap, rows: int) -> None:
    """Write `rows` rows as a log of one of `KINDS`."""
    KINDS[kind](path, lap, rows)


def arguments_of(kind: str, folder: Path) -> list[str]:
    """Return what `split ingest` needs beside the log; writes map and database."""
    if kind in _ON_A_BUS:
        (folder / "car.dbc").write_text(_DBC)
        places = {name: f"/{message}/{name}" for message, names in _ON_BUS.items() for name in names}
    elif kind in _MESSAGES:
        places = {name: f"{_TOPIC}/{name}" for names in _ON_BUS.values() for name in names}
    else:
        return []
    sources = "".join(f"  {name}: {{source: {place}}}\n" for name, place in places.items())
    (folder / f"{kind}.yaml").write_text("channels:\n" + sources)
    database = ["--dbc", str(folder / "car.dbc")] if kind in _ON_A_BUS else []
    return ["--map", str(folder / f"{kind}.yaml"), *database]


def _nanoseconds(time: np.ndarray) -> list[int]:
    return [1_700_000_000_000_000_000 + stamp for stamp in np.rint(1e9 * time).astype(np.int64).tolist()]


def _csv(path: Path, lap: LoggedLap, rows: int) -> None:
    import pyarrow as pa
    import pyarrow.csv

    schema = pa.schema([(name, pa.float64()) for name in lap.columns])
    with pa.csv.CSVWriter(path, schema) as writer:
        for part in lap.parts(rows):
            writer.write_table(pa.table(part, schema=schema))


def _parquet(path: Path, lap: LoggedLap, rows: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    schema = pa.schema([(name, pa.float64()) for name in lap.columns])
    with pa.parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for part in lap.parts(rows):
            writer.write_table(pa.table(part, schema=schema))


def _mcap(path: Path, messages: Iterator[tuple[int, bytes]], schema: tuple[str, str, bytes], encoding: str) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(_TOPIC, encoding, writer.register_schema(*schema))
        for stamp, payload in messages:
            writer.add_message(channel, stamp, payload, stamp)
        writer.finish()


def _json_mcap(path: Path, lap: LoggedLap, rows: int) -> None:
    """JSON messages: the slowest encoding, and the largest."""
    fields = {name: {"type": "number"} for name in lap.names}
    schema = json.dumps({"type": "object", "properties": fields}).encode()

    def messages() -> Iterator[tuple[int, bytes]]:
        for part in lap.parts(rows):
            numbers = np.column_stack([part[name] for name in lap.names]).round(6).tolist()
            for stamp, row in zip(_nanoseconds(part["t"]), numbers, strict=True):
                yield stamp, json.dumps(dict(zip(lap.names, row, strict=True))).encode()

    _mcap(path, messages(), ("Car", "jsonschema", schema), "json")


def _definition(lap: LoggedLap) -> str:
    return "".join(f"float64 {name}\n" for name in lap.names)


def _ros2(lap: LoggedLap, rows: int) -> Iterator[tuple[int, bytes]]:
    return ((stamp, b"\0\1\0\0" + numbers) for stamp, numbers in lap.packed(rows))


def _ros2_mcap(path: Path, lap: LoggedLap, rows: int) -> None:
    _mcap(path, _ros2(lap, rows), (_TYPE, "ros2msg", _definition(lap).encode()), "cdr")


def _bag(path: Path, lap: LoggedLap, rows: int) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(_definition(lap), _TYPE))
    with Writer(path) as bag:
        connection = bag.add_connection(_TOPIC, _TYPE, typestore=store)
        for stamp, numbers in lap.packed(rows):
            bag.write(connection, stamp, numbers)


def _db3(path: Path, lap: LoggedLap, rows: int) -> None:
    import sqlite3

    with sqlite3.connect(path) as database:
        database.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT,"
            " encoded_message_definition TEXT);"
            f"INSERT INTO topics VALUES (1, '{_TOPIC}', '{_TYPE}', 'cdr');"
        )
        database.execute("INSERT INTO message_definitions VALUES (1, ?, 'ros2msg', ?)", (_TYPE, _definition(lap)))
        database.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", _ros2(lap, rows))
    database.close()


def _mf4(path: Path, lap: LoggedLap, rows: int) -> None:
    from asammdf import MDF, Signal

    whole = lap.whole(rows)
    with MDF(version="4.10") as mdf:
        mdf.append([Signal(whole[name], whole["t"], name=name) for name in lap.names])
        mdf.save(path, overwrite=True, compression=1)


def _mat(path: Path, lap: LoggedLap, rows: int) -> None:
    from scipy.io import savemat

    savemat(path, lap.whole(rows), appendmat=False, do_compression=True)


def _mat_hdf5(path: Path, lap: LoggedLap, rows: int) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in lap.whole(rows).items():
            file.create_dataset(name, data=values[:, None].T, compression="gzip", chunks=(1, min(rows, 2**16)))
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + struct.pack("<HH", 0x0200, 0x4D49))


def _frames(path: Path, lap: LoggedLap, rows: int) -> None:
    """Frames of 16-bit signals, two a row."""
    import can
    import cantools

    messages = [
        (message, _ON_BUS[message.name], {s.name: (s.scale, s.minimum, s.maximum) for s in message.signals})
        for message in cantools.database.load_string(_DBC, "dbc").messages
    ]
    with can.Logger(str(path)) as writer:
        for part in lap.parts(rows):
            payloads = []
            for message, names, signals in messages:
                raw = [np.rint(np.clip(part[n], *signals[n][1:]) / signals[n][0]).astype("<i2") for n in names]
                octets = np.zeros((len(part["t"]), 4), dtype="<i2")
                octets[:, : len(names)] = np.column_stack(raw)
                payloads.append((message.frame_id, [bytes(row) for row in octets]))
            for row, time in enumerate((1.7e9 + part["t"]).tolist()):
                for number, rows_of_it in payloads:
                    writer.on_message_received(
                        can.Message(time, number, is_extended_id=False, data=rows_of_it[row], channel=0)
                    )


_MESSAGES: dict[str, Callable[[Path, LoggedLap, int], None]] = {
    "mcap": _json_mcap,
    "ros2.mcap": _ros2_mcap,
    "bag": _bag,
    "db3": _db3,
}
_ON_A_BUS: dict[str, Callable[[Path, LoggedLap, int], None]] = {"blf": _frames, "asc": _frames, "log": _frames}
KINDS: dict[str, Callable[[Path, LoggedLap, int], None]] = {
    "parquet": _parquet,
    "csv": _csv,
    **_MESSAGES,
    "mf4": _mf4,
    "mat": _mat,
    "7.3.mat": _mat_hdf5,
    **_ON_A_BUS,
}
"""What is written for ``ingest-KIND``: the end of the file's name, and how it is made."""
