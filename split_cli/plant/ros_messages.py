"""The ROS 2 messages that simulated logs are made of: definitions as they go into the file, and their content.

The standard interfaces are those of `nav_msgs`, `sensor_msgs`, `ackermann_msgs`; the torque messages are our own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from split_cli.signals import STANDARD_GRAVITY

_HEADER = """std_msgs/Header header
"""
_PARTS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    "ackermann_msgs/AckermannDrive": (
        "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 jerk\n"
    ),
    "sensor_msgs/NavSatStatus": (
        "int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\nint8 status\n"
        "uint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\nuint16 SERVICE_GALILEO=8\n"
        "uint16 service\n"
    ),
}
_TYPES = {
    "nav_msgs/msg/Odometry": _HEADER
    + "string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist\n",
    "sensor_msgs/msg/Imu": _HEADER
    + "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    + "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    + "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
    "ackermann_msgs/msg/AckermannDriveStamped": _HEADER + "ackermann_msgs/AckermannDrive drive\n",
    "sensor_msgs/msg/JointState": _HEADER + "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    "sensor_msgs/msg/NavSatFix": _HEADER
    + "sensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n"
    + "float64[9] position_covariance\nuint8 COVARIANCE_TYPE_UNKNOWN=0\nuint8 COVARIANCE_TYPE_APPROXIMATED=1\n"
    + "uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\nuint8 COVARIANCE_TYPE_KNOWN=3\nuint8 position_covariance_type\n",
    "split_msgs/msg/WheelTorqueStamped": _HEADER
    + "# total torque at the wheels [N m], driving positive\nfloat64 torque\n",
    "split_msgs/msg/ActuatorReport": _HEADER
    + "# road-wheel angle [rad], left positive\nfloat64 steering_angle\n"
    + "# total torque at the wheels [N m], driving positive\nfloat64 wheel_torque\n",
}


def definition(type_name: str) -> str:
    """Return the full text of a message type: itself, then every type it uses, as a ROS 2 bag stores it."""
    text = _TYPES[type_name]
    needed: list[str] = []

    def collect(body: str) -> None:
        for line in body.splitlines():
            part = line.split(" ")[0].split("[")[0]
            if part in _PARTS and part not in needed:
                needed.append(part)
                collect(_PARTS[part])

    collect(text)
    return text + "".join(f"{'=' * 80}\nMSG: {part}\n{_PARTS[part]}" for part in needed)


@dataclass(frozen=True)
class Topic:
    """A topic that carries one device's reports."""

    name: str
    type_name: str
    sensor: str  # name of the `SensorSpec`
    # From one report (channel to value) to the message's fields, header apart.
    fill: Callable[[Mapping[str, float]], dict]
    frame: str = "base_link"  # frame_id of the header


_NO_COVARIANCE_6 = [0.0] * 36
_NO_COVARIANCE_3 = [0.0] * 9
_ORIGIN_LATITUDE, _ORIGIN_LONGITUDE, _ORIGIN_ALTITUDE = 52.0, 10.0, 80.0
_EARTH_RADIUS, _EARTH_FLATTENING = 6378137.0, 1.0 / 298.257223563


def _vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> dict:
    return {"x": x, "y": y, "z": z}


def _odometry(v: Mapping[str, float]) -> dict:
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(v["yaw"] / 2)), "w": float(np.cos(v["yaw"] / 2))}
    pose = {"position": _vector(v["X"], v["Y"]), "orientation": turn}
    twist = {"linear": _vector(v["vx"], v["vy"]), "angular": _vector(z=v["r"])}
    return {
        "child_frame_id": "base_link",
        "pose": {"pose": pose, "covariance": _NO_COVARIANCE_6},
        "twist": {"twist": twist, "covariance": _NO_COVARIANCE_6},
    }


def _imu(v: Mapping[str, float]) -> dict:
    return {
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        # By the interface's convention a first entry of -1 says that there is no orientation.
        "orientation_covariance": [-1.0, *_NO_COVARIANCE_3[1:]],
        "angular_velocity": _vector(z=v["r"]),
        "angular_velocity_covariance": _NO_COVARIANCE_3,
        "linear_acceleration": _vector(v["ax"], v["ay"], STANDARD_GRAVITY),
        "linear_acceleration_covariance": _NO_COVARIANCE_3,
    }


def _drive_command(v: Mapping[str, float]) -> dict:
    angle = float(np.float32(v["delta"]))
    rest = dict.fromkeys(("steering_angle_velocity", "speed", "acceleration", "jerk"), 0.0)
    return {"drive": {"steering_angle": angle, **rest}}


def _wheels(v: Mapping[str, float]) -> dict:
    return {
        "name": ["front_left", "front_right", "rear_left", "rear_right"],
        "position": [],
        "velocity": [v[f"wheel_speed_{corner}"] for corner in ("fl", "fr", "rl", "rr")],
        "effort": [],
    }


def _fix(v: Mapping[str, float]) -> dict:
    latitude = np.radians(_ORIGIN_LATITUDE)
    eccentricity = _EARTH_FLATTENING * (2.0 - _EARTH_FLATTENING)
    bulge = 1.0 - eccentricity * np.sin(latitude) ** 2
    meridian = _EARTH_RADIUS * (1.0 - eccentricity) / bulge**1.5 + _ORIGIN_ALTITUDE
    normal = _EARTH_RADIUS / np.sqrt(bulge) + _ORIGIN_ALTITUDE
    return {
        "status": {"status": 2, "service": 1},
        "latitude": float(np.round(_ORIGIN_LATITUDE + np.degrees(v["Y"] / meridian), 9)),
        "longitude": float(np.round(_ORIGIN_LONGITUDE + np.degrees(v["X"] / (normal * np.cos(latitude))), 9)),
        "altitude": _ORIGIN_ALTITUDE,
        "position_covariance": [4e-4, 0.0, 0.0, 0.0, 4e-4, 0.0, 0.0, 0.0, 1e-3],
        "position_covariance_type": 2,
    }


TOPICS = (
    Topic("/odometry", "nav_msgs/msg/Odometry", "state", _odometry, "map"),
    Topic("/imu", "sensor_msgs/msg/Imu", "inertial", _imu),
    Topic("/command/drive", "ackermann_msgs/msg/AckermannDriveStamped", "command", _drive_command),
    Topic("/command/wheel_torque", "split_msgs/msg/WheelTorqueStamped", "command", lambda v: {"torque": v["T"]}),
    Topic(
        "/actuators",
        "split_msgs/msg/ActuatorReport",
        "report",
        lambda v: {"steering_angle": v["delta_actual"], "wheel_torque": v["T_actual"]},
    ),
    Topic("/wheels", "sensor_msgs/msg/JointState", "wheels", _wheels),
    Topic("/gnss/fix", "sensor_msgs/msg/NavSatFix", "position", _fix, "gnss"),
)
