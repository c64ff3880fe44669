"""Which fields of messages hold pose, velocity and acceleration, whatever the maker calls topic and type."""

from __future__ import annotations

import re
from collections.abc import Sequence

from split_cli.logs.raw import RawChannelInfo

__all__ = ["field_candidates"]

_FIELDS: tuple[tuple[str, str, str], ...] = (
    ("X", r"(.*\.)?(position|translation)\.x", ""),
    ("Y", r"(.*\.)?(position|translation)\.y", ""),
    ("yaw", r"((.*\.)?(orientation|rotation))\.w", "yaw_from_quaternion"),
    ("vx", r"(.*\.)?(twist\.)?linear\.x|(.*\.)?longitudinal_velocity|(.*\.)?(velocity|vel)\.x", ""),
    ("vy", r"(.*\.)?(twist\.)?linear\.y|(.*\.)?lateral_velocity|(.*\.)?(velocity|vel)\.y", ""),
    ("r", r"(.*\.)?angular(_velocity)?\.z|(.*\.)?heading_rate|(.*\.)?gyro\.z", ""),
    ("ax", r"(.*\.)?(linear_acceleration|accel(eration)?)(\.linear)?\.x", ""),
    ("ay", r"(.*\.)?(linear_acceleration|accel(eration)?)(\.linear)?\.y", ""),
    ("delta", r"(.*\.)?steering_(tire_)?angle", ""),
    ("latitude", r"(.*\.)?latitude", ""),
    ("longitude", r"(.*\.)?longitude", ""),
    ("motor_current", r"(.*\.)?current_motor", ""),
)
_COMMANDS = re.compile(r"(^|[/_])(cmd|command|commands|ref|reference|target|desired|goal|setpoint)", re.IGNORECASE)
_OF_A_COMMAND = ("delta",)


def field_candidates(infos: Sequence[RawChannelInfo]) -> list[tuple[str, tuple[str, ...], str]]:
    """Return channel, address and conversion of every field of a message that the table names.

    Topics whose names say that they are commands give commanded quantities only, no measured motion. A field of a
    list other than its first element is left alone.
    """
    found: list[tuple[str, tuple[str, ...], str]] = []
    for info in infos:
        if not info.name.startswith("/") or re.search(r"\[[1-9]\d*\]", info.name) or "covariance" in info.name:
            continue
        topic, field = info.name.rsplit("/", 1)
        for channel, pattern, convert in _FIELDS:
            if not re.fullmatch(pattern, field):
                continue
            if _COMMANDS.search(topic) and channel not in _OF_A_COMMAND:
                continue
            address = info.name.removesuffix(".w") if convert else info.name
            found.append((channel, (address,), convert))
            break
    return found
