"""Raw signals to SI series of a channel's frame: units, curves, signs, quaternions, latitude and longitude."""

from dataclasses import dataclass

import numpy as np

from split_cli.errors import LogError, MapError
from split_cli.logs.assembling import transform
from split_cli.logs.map_entries import EXTRA_UNITS, SignalMap, SignalSource
from split_cli.logs.raw import RawSignal
from split_cli.logs.scratch import set_aside
from split_cli.signals import CHANNELS, convert_to_si, find_unit


@dataclass(frozen=True)
class RawSeries:
    """One source of one channel in SI, frame and sign converted, on its own clock."""

    channel: str
    source: str  # recorded name, for messages
    time: np.ndarray  # (N,): [s], as recorded, in the order of the file; delays not yet applied
    values: np.ndarray  # (N,): SI unit of the channel; NaN where missing
    delay: float = 0.0  # as the map gives it [s]
    command: bool = False  # whether the map says so


@dataclass(frozen=True)
class ConversionNotes:
    """What was done to channels, in words: conversions, units assumed, contradictions of file and map."""

    conversions: list[str]
    assumed: list[str]
    contradictions: list[str]


def expected_unit(channel: str) -> str | None:
    """Return the SI unit of a channel known by name, None for others."""
    return CHANNELS[channel].unit if channel in CHANNELS else EXTRA_UNITS.get(channel)


class Converter:
    """Makes SI series of the channel's frame out of raw signals, and says in words what it did."""

    def __init__(self, where: str, signal_map: SignalMap, wheel_radius: float | None, notes: ConversionNotes) -> None:
        self.where = where
        self.map = signal_map
        self.wheel_radius = wheel_radius
        self.notes = notes

    def _bend(self, channel: str, source: SignalSource, name: str, values: np.ndarray) -> np.ndarray:
        """Return values on the map's curve; missing where they lie beyond its ends by over a thousandth of it."""
        if not source.curve:
            return values
        at, value = (np.array(side) for side in zip(*source.curve, strict=True))
        slack = 1e-3 * (at[-1] - at[0])
        with np.errstate(invalid="ignore"):
            beyond = (values < at[0] - slack) | (values > at[-1] + slack)
        note = f"{channel}: {name} by a curve of {len(at)} points from {at[0]:g} to {at[-1]:g}"
        if beyond.any():
            note += f"; {int(beyond.sum())} samples beyond its ends are left out"
        self.notes.conversions.append(note)
        return np.where(beyond | ~np.isfinite(values), np.nan, np.interp(values, at, value))

    def convert(
        self, channel: str, source: SignalSource, signals: list[RawSignal], common: np.ndarray | None
    ) -> RawSeries:
        """Return one source of a channel as a series; `common` is the time of signals without one [s]."""
        name = source.names[0] if len(source.names) == 1 else "+".join(source.names)
        values, unit = self._combine(channel, source, signals)
        bent = self._bend(channel, source, name, values * source.scale + source.offset)
        values = self._to_si(channel, source, bent, unit, signals[0].unit)
        if source.scale != 1.0 or source.offset != 0.0:
            shift = f" {'+' if source.offset > 0 else '-'} {abs(source.offset):g}" if source.offset else ""
            self.notes.conversions.append(f"{channel}: {source.scale:g} x {name}{shift}")
        values = self._to_frame(channel, source, values)
        time = common if signals[0].time is None else signals[0].time
        if len(time) != len(values):
            what = f"{name} has {len(values)} samples and {len(time)} time stamps"
            advice = "Leave it out of the map, or save the log again with its own clock."
            raise LogError(what, where=self.where, advice=advice)
        # Of a fix the east is mostly the longitude.
        recorded = signals[-1 if source.convert == "local_x" else 0].name
        if source.convert == "yaw_from_quaternion":
            recorded = recorded.rsplit(".", 1)[0]
        entry = self.map.channel(channel)
        asked = entry is not None and entry.kind == "command"
        return RawSeries(channel, recorded, time, set_aside(values), source.delay or 0.0, asked)

    def _combine(self, channel: str, source: SignalSource, signals: list[RawSignal]) -> tuple[np.ndarray, str | None]:
        columns = [signal.values for signal in signals]
        if source.convert == "yaw_from_quaternion":
            self.notes.conversions.append(f"{channel}: yaw from the quaternion {source.names[0]}")
            return transform.yaw_from_quaternion(*columns), "rad"
        if source.convert in ("local_x", "local_y"):
            columns = [transform.fix_in_degrees(signal.values, source.unit, signal.unit) for signal in signals]
            if source.unit and not all(a is signal.values for a, signal in zip(columns, signals, strict=True)):
                self.notes.conversions.append(f"{channel}: latitude and longitude in {source.unit}")
            datum = self.map.datum or _first_fix(*columns, where=self.where)
            east, north = transform.local_tangent_plane(*columns, datum)
            self.notes.conversions.append(
                f"{channel}: from latitude and longitude, local plane at {datum[0]:.7f}, {datum[1]:.7f} deg"
            )
            return (east if channel == "X" else north), "m"
        if source.convert == "norm":
            return np.sqrt(sum(column**2 for column in columns)), signals[0].unit
        if source.convert in ("pair_sum", "pair_mean"):
            total = sum(columns)
            return (total if source.convert == "pair_sum" else total / len(columns)), signals[0].unit
        if source.convert == "signed":
            if len(columns) != 2:
                what = f"{channel}: `convert: signed` takes a size and a column that is 1 where it is negative"
                raise MapError(what, where=self.where, advice="Write `source: [SIZE, SIGN]`.")
            self.notes.conversions.append(f"{channel}: negative where {source.names[1]} is 1")
            return transform.signed(*columns), signals[0].unit
        return columns[0], signals[0].unit

    def _to_si(
        self, channel: str, source: SignalSource, values: np.ndarray, unit: str | None, written: str | None
    ) -> np.ndarray:
        expected = expected_unit(channel)
        scaled = source.scale != 1.0 or bool(source.curve)
        if source.unit and written and not scaled and find_unit(written) not in (None, find_unit(source.unit)):
            self.notes.contradictions.append(
                f"{channel}: the file says {written}, the map says {source.unit}; the map was followed"
            )
        unit = unit if source.convert in ("local_x", "local_y") else source.unit or unit
        if unit is None:
            if expected is not None:
                self.notes.assumed.append(f"{channel} in {expected} (neither file nor map says)")
            return values
        found = find_unit(unit)
        if found is None:
            if expected is None:
                return values
            what = f"{channel}: the file says unit {unit!r}, which is not known"
            raise MapError(what, where=self.where, advice="Give `unit:` in the map.")
        if found.si == "rad/s" and expected == "m/s" and channel.startswith("wheel_speed"):
            if not self.wheel_radius:
                what = f"{channel} is in {unit}, its speed takes the wheel radius"
                raise MapError(what, where=self.where, advice="Give --vehicle.")
            self.notes.conversions.append(f"{channel}: {unit} times the wheel radius {self.wheel_radius:g} m")
            return convert_to_si(values, unit) * self.wheel_radius
        if expected is not None and found.si != expected:
            what = f"{channel} is in {expected}, {source.names[0]} is in {unit}"
            raise MapError(what, where=self.where, advice="Give scale, and the unit after scaling, in the map.")
        if found.symbol != found.si:
            self.notes.conversions.append(f"{channel}: {found.symbol} to {found.si}")
        return convert_to_si(values, unit, where=self.where)

    def _to_frame(self, channel: str, source: SignalSource, values: np.ndarray) -> np.ndarray:
        frame = source.frame or self.map.frame
        world = source.world or self.map.world
        if channel == "yaw" and world == "ned":
            self.notes.conversions.append("yaw: from clockwise of north to counter-clockwise of east")
            return transform.yaw_from_ned(values)
        if channel in ("X", "Y") and world == "ned" and not source.convert:
            self.notes.conversions.append("X, Y: north and east exchanged")
        if transform.frame_sign(channel, frame) < 0:
            self.notes.conversions.append(f"{channel}: sign turned, y right to y left")
            return -values
        return values


def _first_fix(latitude: np.ndarray, longitude: np.ndarray, *, where: str) -> tuple[float, float]:
    valid = np.isfinite(latitude) & np.isfinite(longitude) & ((latitude != 0.0) | (longitude != 0.0))
    if not valid.any():
        advice = "Leave X and Y out of the map, or cut the time without reception."
        raise LogError("no satellite fix holds a position", where=where, advice=advice)
    index = int(np.flatnonzero(valid)[0])
    return float(latitude[index]), float(longitude[index])
