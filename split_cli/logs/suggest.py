"""A draft of a signal map, guessed from names, types and units; every guess says that it is one."""

from __future__ import annotations

import re
from collections.abc import Iterable

from split_cli.logs.gather import expected_unit
from split_cli.logs.raw import RawChannelInfo, Recording, time_column
from split_cli.signals import REQUIRED_CHANNELS, find_unit

__all__ = ["guess_channels", "suggest_map"]

_BY_TYPE = {
    "nav_msgs/Odometry": {
        "X": "pose.pose.position.x", "Y": "pose.pose.position.y", "yaw": "pose.pose.orientation",
        "vx": "twist.twist.linear.x", "vy": "twist.twist.linear.y", "r": "twist.twist.angular.z",
    },
    "geometry_msgs/TwistStamped": {"vx": "twist.linear.x", "vy": "twist.linear.y", "r": "twist.angular.z"},
    "geometry_msgs/PoseStamped": {"X": "pose.position.x", "Y": "pose.position.y", "yaw": "pose.orientation"},
    "sensor_msgs/Imu": {"r": "angular_velocity.z", "ax": "linear_acceleration.x", "ay": "linear_acceleration.y"},
    "ackermann_msgs/AckermannDriveStamped": {"delta": "drive.steering_angle", "vx_command": "drive.speed"},
    "autoware_vehicle_msgs/VelocityReport": {
        "vx": "longitudinal_velocity", "vy": "lateral_velocity", "r": "heading_rate",
    },
    "autoware_vehicle_msgs/SteeringReport": {"delta": "steering_tire_angle"},
    "raptor_dbw_msgs/SteeringReport": {"steering_wheel_angle": "steering_wheel_angle"},
    "vesc_msgs/VescStateStamped": {"motor_current": "state.current_motor"},
}  # fmt: skip

_PATTERNS: tuple[tuple[str, str], ...] = (
    (
        "vx",
        r"v_?x|vel(ocity)?_?x|u|v_?long\w*|long(itudinal)?_?vel\w*|v_?lon|ground_?speed|gps_?speed|speed|vehicle_?speed",
    ),
    ("vy", r"v_?y|vel(ocity)?_?y|v_?lat\w*|lat(eral)?_?vel\w*"),
    ("r", r"r|wz|omega(_?z)?|yaw_?rate|dpsi|psi_?dot|yaw_?vel\w*|gyro_?z|gyro_?yaw\w*|heading_?rate"),
    ("yaw", r"yaw(_?angle)?|psi|phi|heading|theta"),
    ("X", r"x|pos_?x|x_?pos\w*|east\w*"),
    ("Y", r"y|pos_?y|y_?pos\w*|north\w*"),
    ("ax", r"a_?x|acc\w*_?x|a_?long|g_?force_?long|gps_?lonacc|long\w*_?acc\w*"),
    ("ay", r"a_?y|acc\w*_?y|a_?lat|g_?force_?lat|gps_?latacc|lat\w*_?acc\w*"),
    ("delta", r"delta|df|delta_?wheel|steer(ing)?_?(tire_?)?angle|road_?wheel_?angle|steered_?angle|steer(ing)?"),
    ("T", r"t|torque|wheel_?torque|t_?wheel\w*"),
    ("steering_wheel_angle", r"(steering_?wheel|swa|hand_?wheel)(_?angle)?"),
    ("throttle", r"thr(ottle)?(_?p(os|ed)\w*)?|accelerator\w*|gas"),
    ("brake_pressure", r"p_?brake\w*|brake_?pres\w*"),
    ("brake", r"brake(_?p(os|ed)\w*)?"),
    ("motor_current", r"(motor_?)?current(_?motor)?"),
    *((f"wheel_speed_{c}", rf"(wheel_?(speed_?)?|w_?|v_?wheel_?){c}") for c in ("fl", "fr", "rl", "rr")),
)
_UNIT_SUFFIX = re.compile(
    r"_(mps2?|mpss|kmph|kph|kmh|mph|radps|rad|degps|dps|deg|rpm|nm|bar|kpa|psi|pct|mm|m|s)$", re.IGNORECASE
)


def guess_channels(infos: Iterable[RawChannelInfo]) -> dict[str, RawChannelInfo]:
    """Return for each channel the recorded signal whose type or name suggests it; a wrong unit rules one out."""
    infos = list(infos)
    time = time_column(infos)
    by_name = {info.name: info for info in infos}
    found: dict[str, RawChannelInfo] = {}
    for info in infos:
        if not info.name.startswith("/"):
            continue
        topic, path = info.name.rsplit("/", 1)
        fields = _BY_TYPE.get(info.type_name.replace("/msg/", "/"), {})
        for channel, field_path in fields.items():
            if channel not in found and (path == field_path or path == f"{field_path}.x"):
                name = f"{topic}/{field_path}"
                found[channel] = by_name.get(name) or RawChannelInfo(name, info.type_name, info.count)
    for channel, pattern in _PATTERNS:
        expression = re.compile(pattern, re.IGNORECASE)
        for info in infos:
            if info == time:
                continue
            unit = find_unit(info.unit) if info.unit else None
            if unit is not None and expected_unit(channel) not in (None, unit.si):
                continue
            plain = info.name.rsplit("/", 1)[-1].rsplit(".", 1)[-1]
            plain = _UNIT_SUFFIX.sub("", re.sub(r"[\s.]+", "_", plain.strip()))
            if channel not in found and info not in found.values() and expression.fullmatch(plain):
                found[channel] = info
    return found


def suggest_map(recording: Recording, *, row_rate: float | None = None, vehicle=None) -> str:
    """Return a draft map as YAML text, guesses marked, what is missing left as a comment."""
    infos = recording.channels()
    found = guess_channels(infos)
    lines = [
        f"# A draft for {recording.name}: every line below is a guess from names and units. Check each.",
        "name: draft",
    ]
    if not recording.clocks:
        time = time_column(infos)
        unit = f", unit: {time.unit}" if time is not None and time.unit else ""
        lines.append(
            f"time: {{source: {_quoted(time.name)}{unit}}}"
            if time is not None
            else "# time: {source: COLUMN}   or   {period: SECONDS}"
        )
    lines += ["frame: flu   # or frd: y right, z down", "channels:"]
    for channel, info in found.items():
        convert = ", convert: yaw_from_quaternion" if info.name.endswith("orientation") else ""
        expected = expected_unit(channel)
        unit = (
            ""
            if convert
            else f", unit: {_quoted(info.unit)}"
            if info.unit
            else f", unit: {_quoted(expected or '1')}"
        )
        asked = "" if info.unit or convert else f"   # guess: unit not recorded, {expected} assumed"
        lines.append(f"  {channel}: {{source: {_quoted(info.name)}{unit}{convert}}}{asked}")
    missing = [channel for channel in REQUIRED_CHANNELS if channel not in found]
    if missing:
        lines.append(f"# Not found, and required: {', '.join(missing)} (T can be derived, see --derive).")
    rest = [info.name for info in infos if info not in found.values()]
    if rest:
        lines.append(f"# Not used: {', '.join(rest[:40])}{' ...' if len(rest) > 40 else ''}")
    return "\n".join(lines)


def _quoted(text: str) -> str:
    return text if re.fullmatch(r"[A-Za-z_][\w./ ^-]*", text) else '"' + text.replace('"', '\\"') + '"'
