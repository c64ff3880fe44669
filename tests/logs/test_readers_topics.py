"""The topics that cars log, in the containers that cars log them in."""

import numpy as np
import pytest

import tests.logs.readers_support as support
from split_cli.logs.readers import open_recording

COUNT = 60
# Message type, fields that carry the planted vx, vy, r, and whether the type has a stamp.
TOPICS = {
    "odom": ("nav_msgs/msg/Odometry", ("twist.twist.linear.x", "twist.twist.linear.y", "twist.twist.angular.z")),
    "imu": ("sensor_msgs/msg/Imu", ("linear_acceleration.x", "linear_acceleration.y", "angular_velocity.z")),
    "twist": ("geometry_msgs/msg/TwistStamped", ("twist.linear.x", "twist.linear.y", "twist.angular.z")),
    "accel": (
        "geometry_msgs/msg/AccelWithCovarianceStamped",
        ("accel.accel.linear.x", "accel.accel.linear.y", "accel.accel.angular.z"),
    ),
    "drive": (
        "ackermann_msgs/msg/AckermannDriveStamped",
        ("drive.speed", "drive.acceleration", "drive.steering_angle"),
    ),
    "autoware_velocity": (
        "autoware_vehicle_msgs/msg/VelocityReport",
        ("longitudinal_velocity", "lateral_velocity", "heading_rate"),
    ),
    "wheels": ("raptor_dbw_msgs/msg/WheelSpeedReport", ("front_left", "rear_left", "rear_right")),
    "vesc": ("vesc_msgs/msg/VescStateStamped", ("state.speed", "state.current_motor", "state.duty_cycle")),
}


def message_of(store, type_name, fields, planted, row):
    """Return a message with the planted sample in its three fields."""
    numbers = (planted.vx[row], planted.vy[row], planted.r[row])
    content = {field.replace(".", "__"): value for field, value in zip(fields, numbers, strict=True)}
    return support.build(store, type_name, **support.stamp_of(planted.header[row]), **content)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_topics_of_cars(tmp_path, storage):
    planted = support.plant(count=COUNT)
    store = support.ros2_store()
    extra = {
        topic: (kind, [(planted.log[n] + 1000, message_of(store, kind, fields, planted, n)) for n in range(COUNT)])
        for topic, (kind, fields) in TOPICS.items()
        if topic != "odom"
    }
    steering = "autoware_vehicle_msgs/msg/SteeringReport"
    reports = []
    for n in range(COUNT):
        time = int(planted.header[n])
        stamp = {"stamp__sec": time // 10**9, "stamp__nanosec": time % 10**9}
        reports.append((planted.log[n], support.build(store, steering, **stamp, steering_tire_angle=planted.r[n])))
    extra["steering"] = (steering, reports)
    recording = open_recording(support.write_rosbag2(tmp_path / "bag", planted, storage, **extra))
    names = {f"/{topic}/{field}": n for topic, (_, fields) in TOPICS.items() for n, field in enumerate(fields)}
    names["/steering/steering_tire_angle"] = 2
    assert set(names) <= {channel.name for channel in recording.channels()}
    for clock in ("header", "log"):
        signals = recording.read(list(names), clock)
        for name, number in names.items():
            expected = (planted.vx, planted.vy, planted.r)[number]
            single = name.split("/")[1] in ("drive", "autoware_velocity", "wheels", "steering")
            np.testing.assert_array_equal(signals[name].values, expected.astype(np.float32) if single else expected)
            times = (planted.header if clock == "header" else planted.log) - planted.log.min()
            late = 0 if clock == "header" or name.startswith(("/odom", "/steering")) else 1e-6
            np.testing.assert_allclose(signals[name].time, times * 1e-9 + late, rtol=0, atol=2e-9)


def test_only_the_topics_asked_for_are_decoded(tmp_path, monkeypatch):
    from split_cli.logs.readers.cdr_and_ros1 import SerializedDecoder

    planted = support.plant(count=COUNT)
    store = support.ros2_store()
    kind, fields = TOPICS["imu"]
    extra = {"imu": (kind, [(planted.log[n], message_of(store, kind, fields, planted, n)) for n in range(COUNT)])}
    recording = open_recording(support.write_rosbag2(tmp_path / "bag", planted, "MCAP", **extra))
    decoded = []
    plain = SerializedDecoder.decode

    def counting(self, payloads, paths):
        decoded.append((self._layout.type_name, len(payloads)))
        return plain(self, payloads, paths)

    monkeypatch.setattr(SerializedDecoder, "decode", counting)
    recording.channels()
    assert decoded == []
    recording.read(["/imu/angular_velocity.z"])
    assert decoded == [(kind, COUNT)]


def test_messages_come_in_the_order_of_the_file(tmp_path):
    """Sorted by a clock that went back for good, messages from before and behind would lie between each other."""
    planted = support.plant(count=COUNT)
    messages = support.cdr_messages(support.ros2_store(), planted)
    order = [*range(10), *range(14, COUNT), *range(10, 14)]
    schema = support.ros2_schema(support.ros2_store(), "nav_msgs/msg/Odometry")
    moved = [messages[n] for n in order]
    recording = open_recording(support.write_mcap(tmp_path / "a.mcap", schema, "cdr", moved, chunk_size=2000))
    name = support.FIELDS["vx"]
    signal = recording.read([name], "log")[name]
    np.testing.assert_array_equal(signal.values, planted.vx[order])
    np.testing.assert_array_equal(np.argsort(signal.time), np.argsort(order))


def test_a_topic_whose_type_changes_is_read_with_both_definitions(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for number, text in enumerate(["float64 speed\n", "float32 gear\nfloat64 speed\n"]):
            channel = writer.register_channel(
                "/car", "cdr", writer.register_schema("car/Speed", "ros2msg", text.encode())
            )
            payload = b"\0\1\0\0" + (b"" if number == 0 else np.array([3, 0], "<f4").tobytes())
            for n in range(5):
                writer.add_message(channel, 10 * number + n, payload + np.array([10.0 * number + n]).tobytes(), 0)
        writer.finish()
    recording = open_recording(path)
    signals = recording.read(["/car/speed", "/car/gear"])
    np.testing.assert_array_equal(signals["/car/speed"].values, [0, 1, 2, 3, 4, 10, 11, 12, 13, 14])
    np.testing.assert_array_equal(signals["/car/gear"].values, [np.nan] * 5 + [3] * 5)
