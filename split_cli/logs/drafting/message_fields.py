"""Which fields of messages hold pose, velocity and acceleration, whatever the maker calls topic and type."""

import re
from collections.abc import Sequence

from split_cli.logs.raw import RawChannelInfo

_FIELDS: tuple[tuple[str, str, str], ...] = (
    ("X", r"(.*\.)?(position|translation)\.x", ""),
    ("Y", r"(.*\.)?(position|translation)\.y", ""),
    ("yaw", r"((.*\.)?(orientation|rotation))\.w", "yaw_from_quaternion"),
    # Before the velocities: accel.linear.x is none.
    ("ax", r"(.*\.)?(linear_acceleration|accel(eration)?)(\.linear)?\.x", ""),
    ("ay", r"(.*\.)?(linear_acceleration|accel(eration)?)(\.linear)?\.y", ""),
    ("vx", r"(.*\.)?(twist\.)?linear\.x|(.*\.)?longitudinal_velocity|(.*\.)?(velocity|vel)\.x", ""),
    ("vy", r"(.*\.)?(twist\.)?linear\.y|(.*\.)?lateral_velocity|(.*\.)?(velocity|vel)\.y", ""),
    ("r", r"(.*\.)?angular(_velocity)?\.z|(.*\.)?heading_rate|(.*\.)?gyro\.z", ""),
    ("delta", r"(.*\.)?steering_(tire_)?angle", ""),
    ("latitude", r"(.*\.)?latitude", ""),
    ("longitude", r"(.*\.)?longitude", ""),
    # GeoJSON (RFC 7946) has the longitude first.
    ("longitude", r"(.*\.)?geometry\.coordinates\[0\]", ""),
    ("latitude", r"(.*\.)?geometry\.coordinates\[1\]", ""),
    ("motor_current", r"(.*\.)?current_motor", ""),
)
_COMMANDS = re.compile(r"(^|[/_])(cmd|command|commands|ref|reference|target|desired|goal|setpoint)", re.IGNORECASE)
_OF_A_COMMAND = ("delta",)
_ASKING_TYPE = re.compile(r"ackermann_msgs/(msg/)?AckermannDrive(Stamped)?")
"""Messages that by their definition ask a car for something, whatever the topic is called."""
_NO_MEASUREMENT = re.compile(r"(nav_msgs/(msg/)?Path|visualization_msgs/.+|rosgraph_msgs/.+|rcl_interfaces/.+)")
"""Messages that plan, draw or report on programs: what they hold was measured by nobody."""
_ANSWERS = re.compile(r"state|status|feedback|measured|actual|odom|current", re.IGNORECASE)


def field_candidates(infos: Sequence[RawChannelInfo]) -> list[tuple[str, tuple[str, ...], str]]:
    """Return channel, address and conversion of every field of a message that the table names.

    Topics whose names say that they are commands give commanded quantities only, no measured motion. A field of a
    list other than its first element is left alone.
    """
    found: list[tuple[str, tuple[str, ...], str]] = []
    for info in infos:
        place = _topic_and_field(info)
        if (
            place is None
            or is_no_measurement(info)
            or re.search(r"(?<!coordinates)\[[1-9]\d*\]", info.name)
            or "covariance" in info.name
        ):
            continue
        topic, field = place
        for channel, pattern, convert in _FIELDS:
            if not re.fullmatch(pattern, field):
                continue
            if is_of_a_command(topic) and channel not in _OF_A_COMMAND:
                continue
            address = info.name[:-2] if convert else info.name
            found.append((channel, (address,), convert))
            break
    return [*found, *_quaternions_in_columns(infos, found)]


def is_of_a_command(topic: str) -> bool:
    """Tell whether a topic's name says that its messages are commands: what they hold was asked for."""
    return _COMMANDS.search(topic) is not None


def is_no_measurement(info: RawChannelInfo) -> bool:
    """Tell a field of a plan, a drawing or a program's report by the type of its message."""
    return _NO_MEASUREMENT.fullmatch(info.type_name) is not None


def asks_by_type(info: RawChannelInfo) -> bool:
    """Tell a field of a message that asks by its type, on a topic that does not say that it answers."""
    topic = info.name.rpartition("/")[0]
    return bool(_ASKING_TYPE.fullmatch(info.type_name)) and not _ANSWERS.search(topic)


def _topic_and_field(info: RawChannelInfo) -> tuple[str, str] | None:
    """Return topic and field; of a table's column, messages written out flat, both are the whole path."""
    if info.type_name == "column":
        path = info.name.strip("/").replace("/", ".")
        return (info.name, path) if "." in path else None
    if not info.name.startswith("/"):
        return None
    topic, field = info.name.rsplit("/", 1)
    return topic, field


def _quaternions_in_columns(
    infos: Sequence[RawChannelInfo], found: Sequence[tuple[str, tuple[str, ...], str]]
) -> list[tuple[str, tuple[str, ...], str]]:
    """Return the yaw of four columns that differ by a last x, y, z, w and are named as a quaternion.

    Numbered from 0, the first one is w (``q0`` to ``q3`` of inertial units, ``q[0]`` of PX4).
    """
    names = {info.name for info in infos if info.type_name == "column"}
    known = {source for _, sources, _ in found for source in sources}
    made = []
    for name in sorted(names):
        group = re.fullmatch(r"(.*(?:orientation|rotation|quat(?:ernion)?|(?:^|[._])q)[._ ]?)[wW]", name, re.IGNORECASE)
        if group is None or group[1].rstrip("._/") in known or "covariance" in name:
            continue
        four = tuple(group[1] + axis for axis in ("xyzw" if name.endswith("w") else "XYZW"))
        if set(four) <= names:
            made.append(("yaw", four, "yaw_from_quaternion"))
    for name in sorted(names):
        numbered = re.fullmatch(r"((?:.*[._])?q(?:uat)?_?\[?)0(\]?)", name, re.IGNORECASE)
        four = tuple(f"{numbered[1]}{k}{numbered[2]}" for k in (1, 2, 3, 0)) if numbered else ()
        if numbered and set(four) <= names and not known & set(four):
            made.append(("yaw", four, "yaw_from_quaternion"))
    return made
