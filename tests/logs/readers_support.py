"""One planted drive, and writers that put it into every format the readers know."""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

EPOCH = 1_700_000_000_123_456_789
LOG_LATENCY = 7_000_000
PUBLISH_LATENCY = 3_000_000

EXTRA_DEFINITIONS = {
    "ackermann_msgs/msg/AckermannDrive": "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\n"
    "float32 acceleration\nfloat32 jerk\n",
    "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header\nAckermannDrive drive\n",
    "autoware_vehicle_msgs/msg/SteeringReport": "builtin_interfaces/Time stamp\nfloat32 steering_tire_angle\n",
    "autoware_vehicle_msgs/msg/VelocityReport": "std_msgs/Header header\nfloat32 longitudinal_velocity\n"
    "float32 lateral_velocity\nfloat32 heading_rate\n",
    "raptor_dbw_msgs/msg/WheelSpeedReport": "std_msgs/Header header\nfloat32 front_left\nfloat32 front_right\n"
    "float32 rear_left\nfloat32 rear_right\n",
    "raptor_dbw_msgs/msg/SteeringReport": "std_msgs/Header header\nfloat32 steering_wheel_angle\n"
    "float32 steering_wheel_angle_cmd\nfloat32 steering_wheel_torque\nbool enabled\nuint8 rolling_counter\n",
    "vesc_msgs/msg/VescState": "float64 temp_fet\nfloat64 current_motor\nfloat64 speed\nfloat64 duty_cycle\n"
    "int32 fault_code\n",
    "vesc_msgs/msg/VescStateStamped": "std_msgs/Header header\nVescState state\n",
}


FIELDS = {"vx": "/odom/twist.twist.linear.x", "vy": "/odom/twist.twist.linear.y", "r": "/odom/twist.twist.angular.z"}


@dataclass(frozen=True)
class Planted:
    """A signal at irregular header times [ns]; what every format must give back."""

    header: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    r: np.ndarray

    @property
    def log(self) -> np.ndarray:
        return self.header + LOG_LATENCY

    @property
    def publish(self) -> np.ndarray:
        return self.header + PUBLISH_LATENCY


def plant(count: int = 300, seed: int = 5) -> Planted:
    """Return `count` samples at about 100 Hz with jitter; values fill all the bits of a double."""
    rng = np.random.default_rng(seed)
    header = EPOCH + np.arange(count) * 10_000_000 + rng.integers(-2_000_000, 2_000_000, count)
    return Planted(header, *rng.normal(size=(3, count)) * np.array([[20.0], [0.5], [0.3]]))


def check_planted(recording: Any, planted: Planted, clocks: tuple[str, ...] = ("header", "publish", "log")) -> None:
    """Assert that values are equal bit for bit, and times to the rounding of a double near 10 s (2 ns)."""
    for clock in clocks:
        signals = recording.read(list(FIELDS.values()), clock)
        expected = (getattr(planted, clock) - planted.log.min()) * 1e-9
        for name, topic in FIELDS.items():
            np.testing.assert_array_equal(signals[topic].values, getattr(planted, name))
            np.testing.assert_allclose(signals[topic].time, expected, rtol=0, atol=2e-9)
    assert recording.origin == pytest.approx(planted.log.min() * 1e-9, abs=1e-6)


def ros2_store() -> Any:
    """Return the standard types of ROS 2 and those of `EXTRA_DEFINITIONS`."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in EXTRA_DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def build(store: Any, type_name: str, **fields: Any) -> Any:
    """Return a message of `type_name`: given fields set, the others zero, empty or False.

    A field of a nested message is given as ``a__b=value``.
    """
    from rosbags.interfaces import Nodetype

    arguments = {}
    for name, (node, content) in store.fielddefs[type_name][1]:
        inner = {key.partition("__")[2]: v for key, v in fields.items() if key.startswith(name + "__")}
        if name in fields:
            arguments[name] = fields[name]
        elif node == Nodetype.NAME:
            arguments[name] = build(store, content, **inner)
        elif node == Nodetype.BASE:
            arguments[name] = "" if content[0] == "string" else False if content[0] == "bool" else 0
        else:
            (element, described), length = content
            count = length if node == Nodetype.ARRAY else 0
            if element == Nodetype.NAME:
                arguments[name] = [build(store, described) for _ in range(count)]
            elif described[0] == "string":
                arguments[name] = [""] * count
            else:
                kind = {"byte": "uint8", "char": "uint8"}.get(described[0], described[0])
                arguments[name] = np.zeros(count, dtype=kind)
    return store.types[type_name](**arguments)


def stamp_of(time: int) -> dict[str, int]:
    """Return the header's stamp fields as `build` takes them."""
    return {"header__stamp__sec": int(time // 10**9), "header__stamp__nanosec": int(time % 10**9)}


def odometry(store: Any, planted: Planted, row: int, ros1: bool = False) -> Any:
    """Return the planted sample `row` as a nav_msgs/Odometry."""
    more = {"header__seq": row} if ros1 else {}
    return build(
        store,
        "nav_msgs/msg/Odometry",
        **stamp_of(planted.header[row]),
        **more,
        header__frame_id="odom",
        child_frame_id="base_link",
        pose__covariance=np.arange(36.0) + row,
        twist__twist__linear__x=planted.vx[row],
        twist__twist__linear__y=planted.vy[row],
        twist__twist__angular__z=planted.r[row],
        twist__covariance=np.arange(36.0) - row,
    )


def write_mcap(
    path: Path,
    schema: tuple[str, str, bytes],
    encoding: str,
    messages: Iterable[tuple[str, int, int, bytes]],
    compression: CompressionType = CompressionType.ZSTD,
    chunk_size: int = 16_384,
    **options: Any,
) -> Path:
    """Write messages (topic, log time, publish time, payload) of one type."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_size, compression=compression, **options)
        writer.start(profile={"cdr": "ros2", "ros1": "ros1"}.get(encoding, ""), library="test")
        schema_id = writer.register_schema(*schema)
        channels: dict[str, int] = {}
        for topic, log_time, publish_time, payload in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, schema_id)
            writer.add_message(channels[topic], int(log_time), payload, int(publish_time))
        writer.finish()
    return path


def ros2_schema(store: Any, type_name: str) -> tuple[str, str, bytes]:
    """Return a type's schema as rosbag2's MCAP storage writes it."""
    return type_name, "ros2msg", store.generate_msgdef(type_name, ros_version=2)[0].encode()


def cdr_messages(store: Any, planted: Planted) -> list[tuple[str, int, int, bytes]]:
    """Return the planted drive as serialized ROS 2 odometry on ``/odom``."""
    return [
        (
            "/odom",
            planted.log[row],
            planted.publish[row],
            bytes(store.serialize_cdr(odometry(store, planted, row), "nav_msgs/msg/Odometry")),
        )
        for row in range(len(planted.vx))
    ]


def write_ros2_mcap(path: Path, planted: Planted, **options: Any) -> Path:
    """Write the planted drive as ROS 2 odometry in MCAP."""
    store = ros2_store()
    schema = ros2_schema(store, "nav_msgs/msg/Odometry")
    return write_mcap(path, schema, "cdr", cdr_messages(store, planted), **options)


def write_ros1_mcap(path: Path, planted: Planted) -> Path:
    """Write the planted drive as ROS 1 odometry in MCAP."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "nav_msgs/msg/Odometry"
    text = store.generate_msgdef(kind, ros_version=1)[0]
    messages = [
        (
            "/odom",
            planted.log[row],
            planted.publish[row],
            bytes(store.serialize_ros1(odometry(store, planted, row, ros1=True), kind)),
        )
        for row in range(len(planted.vx))
    ]
    return write_mcap(path, ("nav_msgs/Odometry", "ros1msg", text.encode()), "ros1", messages)


def write_json_mcap(path: Path, planted: Planted, stamp: Callable[[int], Any]) -> Path:
    """Write the planted drive as JSON; `stamp` turns nanoseconds into the ``timestamp`` member."""
    messages = []
    for row in range(len(planted.vx)):
        linear = {"x": planted.vx[row], "y": planted.vy[row]}
        content = {
            "timestamp": stamp(int(planted.header[row])),
            "twist": {"twist": {"linear": linear, "angular": {"z": planted.r[row]}}},
        }
        messages.append(("/odom", planted.log[row], planted.publish[row], json.dumps(content).encode()))
    return write_mcap(path, ("Odometry", "jsonschema", b""), "json", messages)


def protobuf_odometry() -> Any:
    """Return a protobuf message class shaped like an odometry with a google Timestamp."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    file = descriptor_pb2.FileDescriptorProto(name="odometry.proto", package="test", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    double, nested = (descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE, descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE)
    shapes = {
        "Linear": [("x", double, ""), ("y", double, "")],
        "Angular": [("z", double, "")],
        "Twist": [("linear", nested, ".test.Linear"), ("angular", nested, ".test.Angular")],
        "Twists": [("twist", nested, ".test.Twist"), ("covariance", double, "repeated")],
        "Odometry": [("timestamp", nested, ".google.protobuf.Timestamp"), ("twist", nested, ".test.Twists")],
    }
    for name, fields in shapes.items():
        message = file.message_type.add(name=name)
        for number, (field, kind, more) in enumerate(fields, 1):
            label = 3 if more == "repeated" else 1
            message.field.add(
                name=field, number=number, type=kind, label=label, type_name=more if more.startswith(".") else None
            )
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("test.Odometry"))


def write_protobuf_mcap(path: Path, planted: Planted) -> Path:
    """Write the planted drive as protobuf in MCAP."""
    from mcap_protobuf.schema import build_file_descriptor_set

    kind = protobuf_odometry()
    messages = []
    for row in range(len(planted.vx)):
        message = kind()
        message.timestamp.seconds = int(planted.header[row] // 10**9)
        message.timestamp.nanos = int(planted.header[row] % 10**9)
        message.twist.twist.linear.x = planted.vx[row]
        message.twist.twist.linear.y = planted.vy[row]
        message.twist.twist.angular.z = planted.r[row]
        message.twist.covariance.extend([1.0, 2.0])
        messages.append(("/odom", planted.log[row], planted.publish[row], message.SerializeToString()))
    schema = build_file_descriptor_set(kind).SerializeToString()
    return write_mcap(path, ("test.Odometry", "protobuf", schema), "protobuf", messages)


def write_rosbag2(folder: Path, planted: Planted, storage: str, **extra: Any) -> Path:
    """Write the planted drive as a rosbag2 folder; `extra` are more (topic, type, messages)."""
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as BagWriter

    store = ros2_store()
    with BagWriter(folder, version=9, storage_plugin=StoragePlugin[storage]) as bag:
        connection = bag.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        for _, log_time, _, payload in cdr_messages(store, planted):
            bag.write(connection, int(log_time), payload)
        for topic, (type_name, messages) in extra.items():
            connection = bag.add_connection(f"/{topic}", type_name, typestore=store)
            for time, message in messages:
                bag.write(connection, int(time), store.serialize_cdr(message, type_name))
    return folder


def write_bag1(path: Path, planted: Planted, compression: str | None = None) -> Path:
    """Write the planted drive as a ROS 1 bag."""
    from rosbags.rosbag1 import Writer as BagWriter

    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "nav_msgs/msg/Odometry"
    bag = BagWriter(path)
    if compression:
        bag.set_compression(BagWriter.CompressionFormat[compression])
    with bag:
        connection = bag.add_connection("/odom", kind, typestore=store)
        for row in range(len(planted.vx)):
            message = odometry(store, planted, row, ros1=True)
            bag.write(connection, int(planted.log[row]), store.serialize_ros1(message, kind))
    return path


def write_humble_db3(path: Path, topics: dict[str, tuple[str, list[tuple[int, bytes]]]]) -> Path:
    """Write a database as ROS 2 Humble does: without any message definition."""
    import sqlite3

    with sqlite3.connect(path) as database:
        database.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
            "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
        )
        for number, (topic, (type_name, messages)) in enumerate(topics.items(), 1):
            database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (number, topic, type_name))
            database.executemany(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
                [(number, int(time), payload) for time, payload in messages],
            )
    database.close()
    return path
