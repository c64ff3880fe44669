"""What a signal map says, entry by entry; `signal_map` reads it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from split_cli.logs.raw import SplitStamp

CONVERSIONS = ("yaw_from_quaternion", "local_x", "local_y", "norm", "pair_sum", "pair_mean", "signed")
"""What may be computed from several fields of one message, before scale, offset and unit."""

EXTRA_UNITS: dict[str, str] = {
    "wheel_speed": "m/s",
    "wheel_speed_fl": "m/s",
    "wheel_speed_fr": "m/s",
    "wheel_speed_rl": "m/s",
    "wheel_speed_rr": "m/s",
    "throttle": "1",
    "brake": "1",
    "brake_pressure": "Pa",
    "motor_current": "A",
    "steering_wheel_angle": "rad",
    "sideslip": "rad",
    "delta_command": "rad",
    "T_command": "N m",
    "vx_command": "m/s",
}
"""Channels beside the canonical ones that derivations, delays and checks know by name, with their SI unit."""


@dataclass(frozen=True)
class Position:
    """Where a sensor sits, from the CG, in the vehicle frame."""

    # x, y: forward and left of the CG [m].
    x: float = 0.0
    y: float = 0.0
    axle: str = "cg"  # ``front_axle`` or ``rear_axle`` where the place is named; x and y are then offsets from it


@dataclass(frozen=True)
class SignalSource:
    """One recorded signal and its way to SI: value = convert(curve(scale * raw + offset), unit)."""

    # ``/topic/field.path``, ``package/Type:field.path`` (the only topic of that type), or a column; several where
    # `convert` needs several.
    names: tuple[str, ...]
    convert: str = ""  # one of `CONVERSIONS`, or empty
    scale: float = 1.0
    offset: float = 0.0
    # Points of a piecewise linear curve, with ascending first members: a steering command to an angle, throttle to
    # torque. Empty is the identity. A sample outside its ends is missing, not extrapolated.
    curve: tuple[tuple[float, float], ...] = ()
    unit: str | None = None  # unit after scale, offset and curve; None takes what the file says
    delay: float | None = None  # positive when the channel is late [s]; its times are moved earlier
    # frame, world: ``flu``/``frd`` and ``enu``/``ned``; None takes the map's.
    frame: str | None = None
    world: str | None = None


@dataclass(frozen=True)
class ChannelMap:
    """How one channel of the drive is made: the sum of its sources."""

    channel: str
    sources: tuple[SignalSource, ...]
    position: Position | None = None  # of the sensor, where it is off the CG
    kind: str | None = None  # ``command``, ``measured`` or ``derived``; None when the map does not say
    # ``continuous``, ``held`` or ``angle``; None lets the channel and its samples decide.
    resample: str | None = None
    optional: bool = False  # a missing source drops the channel with a note instead of an error


@dataclass(frozen=True)
class TimeBase:
    """Where time comes from: a column, a fixed period (tables without time), or a clock of the messages."""

    source: str | None = None  # column
    unit: str | None = None  # of that column
    period: float | None = None  # [s]
    clock: str | None = None  # ``header``, ``publish`` or ``log``
    stamp: SplitStamp | None = None  # a second column, added to the first, which then holds whole seconds


@dataclass(frozen=True)
class SignalMap:
    """A whole map, presets merged in."""

    name: str
    channels: tuple[ChannelMap, ...]
    time: TimeBase = TimeBase()
    # frame, world: ``flu`` or ``frd``; ``enu`` or ``ned``.
    frame: str = "flu"
    world: str = "enu"
    # Replaces a topic or a message type named in a source by a topic of the recording.
    topics: Mapping[str, str] = field(default_factory=dict)
    # Unmapped columns to keep; None keeps all of a table and none of a log with topics.
    extras: tuple[str, ...] | None = None
    # Latitude and longitude [deg] of the local plane's origin; None takes the first fix.
    datum: tuple[float, float] | None = None
    rows: Mapping[str, str] = field(default_factory=dict)  # column and value of one of several cars in one table
    # Settings of derivations, used only when one is asked for.
    derivations: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    despike: bool = True  # whether isolated spikes are dropped (they are always counted)
    content: Mapping[str, Any] = field(default_factory=dict)  # what was written, for the record

    def channel(self, name: str) -> ChannelMap | None:
        """Return the entry of a channel, None when the map has none."""
        return self._by_channel.get(name)

    @cached_property
    def _by_channel(self) -> dict[str, ChannelMap]:
        return {entry.channel: entry for entry in reversed(self.channels)}
