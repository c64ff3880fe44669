"""Guesses of a draft as SI columns on one clock, to be judged by the consistency checks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.logs.assembling.clean import clock_resets, isolated_spikes
from split_cli.logs.assembling.synchronize import BRIDGED_SAMPLES, SLOWEST_PERIOD
from split_cli.logs.assembling.transform import fix_in_degrees, local_tangent_plane, signed, yaw_from_quaternion
from split_cli.logs.checking.checks import LEAST_CORRELATION, NOT_RECORDED
from split_cli.logs.checking.consistency import Consistency, check_consistency
from split_cli.logs.checking.kinematics import Kinematics
from split_cli.logs.checking.plausible import NO_CAR_EXCEEDS
from split_cli.logs.checking.wheel_speeds import AXLES, outer_wheels
from split_cli.logs.drafting.draft import Suggestion
from split_cli.logs.drafting.handedness import certain_of
from split_cli.logs.drive import Drive
from split_cli.logs.raw import RawSignal
from split_cli.signals import REQUIRED_CHANNELS, find_unit
from split_cli.vehicle.parameters import Vehicle

_JUDGED = ("vx", "vy", "r", "yaw", "X", "Y", "ax", "ay", "delta")
_MOST_FLAGS = 8
"""Values that a flag of validity takes at most [1]: two or three bits."""
_GAP = 0.5
"""Between two rows of a table, from which on what stands between them is not judged, or five usual steps [s]."""


_OF_A_FIX = ("local_x", "local_y")
_COUNTED_FIX = "1e-07 deg"
"""Of coordinates in whole numbers (u-blox, MAVLink, PX4): 180 degrees are 1.8e9, which four bytes hold."""
_LEAST_COUNTED = 1e6
"""A tenth of a degree in that unit [1], beyond what arc minutes (10,800) and NMEA's ddmm.mmm (18,000) reach."""


@dataclass(frozen=True)
class TrialCandidate:
    """One reading of one or several recorded names."""

    channel: str
    sources: tuple[str, ...]  # recorded names; one without its axes for a quaternion
    weight: int  # how clearly names say so; 3 is clear
    unit: str | None
    convert: str = ""
    # Whether the unit is that of ROS messages, which the recording itself does not state.
    by_convention: bool = False
    foreign_unit: str = ""  # what the file states where a unit stands, and is none that is known
    note: str = ""  # why it is taken in spite of its name
    asked: bool = False  # of a message that by its type asks for something


def names_of(candidate: TrialCandidate | Suggestion) -> tuple[str, ...]:
    """Return the recorded names that a candidate or a suggestion reads."""
    if candidate.convert == "yaw_from_quaternion" and len(candidate.sources) == 1:
        base = candidate.sources[0]
        joint = "." if "." in base.rsplit("/", 1)[-1] or not base.startswith("/") else "/"
        return tuple(f"{base}{joint}{axis}" for axis in "xyzw")
    return candidate.sources


class Trial:
    """Candidates as SI columns on one clock, to be judged by the consistency checks."""

    rate = 50.0
    """Of the clock [Hz]."""

    def __init__(
        self, signals: Mapping[str, RawSignal], time: np.ndarray | None, vehicle: Vehicle | None, time_is_known: bool
    ) -> None:
        self.signals, self.vehicle, self.time_is_known = signals, vehicle, time_is_known
        self.time = None if time is None else _without_restarts(time)
        if self.time is not None and all(s.time is None for s in signals.values()):
            self.time = _with_short_pauses(self.time)
        self.torques: list[list[TrialCandidate]] = []
        self._sound: dict[str, np.ndarray] = {}
        stamps = [self.time if s.time is None else s.time for s in signals.values()]
        stamps = [t for t in stamps if t is not None and np.isfinite(t).sum() > 20]
        low = max((float(np.nanquantile(t, 0.0)) for t in stamps if _is_long(t, stamps)), default=0.0)
        high = min((float(np.nanquantile(t, 1.0)) for t in stamps if _is_long(t, stamps)), default=0.0)
        count = int(min(max((high - low) * self.rate, 0), 60_000))
        self.grid = low + np.arange(count) / self.rate
        self.segment = np.zeros(count, dtype=np.int32)
        if self.time is not None:
            self.grid, self.segment = _without_gaps(self.grid, self.time)
        borders = np.flatnonzero(np.diff(self.segment)) + 1
        self.slices = [slice(a, b) for a, b in zip([0, *borders], [*borders, len(self.grid)], strict=True)]

    def unusable(self, candidate: TrialCandidate) -> str:
        """Return why a candidate cannot be used, empty when it can."""
        missing = [name for name in names_of(candidate) if name not in self.signals]
        if missing:
            return f"{missing[0]} cannot be read"
        values = self._combined(candidate, [self.signals[name].values for name in names_of(candidate)])
        finite = values[np.isfinite(values)]
        if len(finite) < 20:
            return "nearly empty"
        alike = next((len(group) for group in self.torques if candidate in group), 0)
        if candidate.channel == "wheel_torque" and alike not in (2, 4):
            return f"torque of {alike} wheel(s): those of two or four wheels make T"
        if np.ptp(finite) == 0.0:
            return f"never changes ({finite[0]:g})"
        if candidate.sources[0].lower().endswith("status") and len(np.unique(finite)) <= _MOST_FLAGS:
            return "takes few values: a flag, not a quantity"
        beyond = self._beyond_the_globe(candidate)
        if beyond:
            return beyond
        if candidate.channel == "ax" and float(np.min(finite)) == 0.0:
            return "rests at 0 and is never negative, while every car brakes: a pedal"
        if candidate.channel in ("throttle", "brake") and set(np.unique(finite)) == {0.0, 1.0}:
            return "is 0 or 1 and nothing between: a switch, not how far the pedal goes"
        unit = find_unit(candidate.unit) if candidate.unit else None
        if candidate.by_convention:
            unit = None  # a driver may keep another
        reach = float(np.quantile(np.abs(finite), 0.99)) * (unit.factor if unit is not None else 0.0)
        limit, si = NO_CAR_EXCEEDS.get(candidate.channel, (np.inf, ""))
        if reach > limit and candidate.channel != "delta":
            return f"reaches {reach:.3g} {si} in the unit that the file states, no car's exceeds {limit:g}"
        if candidate.channel == "course":
            return "direction of travel over ground: yaw plus sideslip, not yaw"
        if candidate.channel == "engine_torque":
            return "before the gearbox: `scale:` with ratio times efficiency makes it T, where one gear is driven"
        return ""

    def _beyond_the_globe(self, candidate: TrialCandidate) -> str:
        """Return which coordinate of a fix is none in degrees, empty where both may be."""
        names = {"latitude": candidate.sources[:1], "longitude": (None, *candidate.sources[:1])}.get(
            candidate.channel, candidate.sources if candidate.convert in _OF_A_FIX else ()
        )
        for name, limit in zip(names, (90.0, 180.0), strict=False):
            if name is None:
                continue
            values = fix_in_degrees(self.signals[name].values, candidate.unit, self.signals[name].unit)
            largest = float(np.quantile(np.abs(values[np.isfinite(values)]), 0.99))
            if largest > limit:
                return (
                    f"{name} reaches {largest:.4g}, no angle on the globe exceeds {limit:g} deg: arc minutes, or "
                    "degrees and minutes as in NMEA (ddmm.mmm)? Write the columns in degrees"
                )
        return ""

    def column(self, s: Suggestion) -> np.ndarray | None:
        """Return a suggestion's samples on the grid, SI, shape (N,); None where too few."""
        names = names_of(s)
        if any(name not in self.signals for name in names):
            return None
        raw = [self.signals[name] for name in names]
        values = self._combined(s, [self._without_spikes(signal) for signal in raw])
        stamps = self.time if raw[0].time is None else raw[0].time
        if stamps is None or len(stamps) != len(values):
            return None
        unit = find_unit(s.unit) if s.unit and s.convert not in _OF_A_FIX else None
        values = (values * s.scale + s.offset) * (unit.factor if unit is not None else 1.0)
        if s.channel == "yaw" and s.world == "ned":
            values = 0.5 * np.pi - values
        good = np.isfinite(values) & np.isfinite(stamps)
        stamps, values = stamps[good], values[good]
        order = np.argsort(stamps, kind="stable")
        if len(order) < 20 or not len(self.grid):
            return None
        stamps, values = stamps[order], values[order]
        if s.channel in ("yaw", "course"):
            values = np.unwrap(values)
        if s.channel in ("X", "Y", "yaw"):
            return _along_a_curve(self.grid, stamps, values)
        return np.interp(self.grid, stamps, values)

    def with_unit_of_the_fix(self, candidate: TrialCandidate) -> TrialCandidate:
        """Return a coordinate with the unit in which receivers count it in whole numbers; another one as it is."""
        if candidate.convert not in _OF_A_FIX and candidate.channel not in ("latitude", "longitude"):
            return candidate
        read = [self.signals[name] for name in candidate.sources if name in self.signals]
        values = np.concatenate([s.values[np.isfinite(s.values)] for s in read if s.unit is None] or [np.zeros(0)])
        largest = float(np.max(np.abs(values), initial=0.0))
        counted = _LEAST_COUNTED < largest <= 1.8e9 and bool(np.all(values == np.rint(values)))
        return replace(candidate, unit=_COUNTED_FIX) if counted else candidate

    def _without_spikes(self, signal: RawSignal) -> np.ndarray:
        """Return what ingest would keep of a signal; NaN where a sample stands alone, far from its neighbours."""
        if signal.name not in self._sound:
            values = np.asarray(signal.values, dtype=np.float64)
            finite = np.flatnonzero(np.isfinite(values))
            spikes = finite[isolated_spikes(values[finite])]
            if len(spikes):
                values = values.copy()
                values[spikes] = np.nan
            self._sound[signal.name] = values
        return self._sound[signal.name]

    def _combined(self, s: Suggestion | TrialCandidate, values: list[np.ndarray]) -> np.ndarray:
        if s.convert == "yaw_from_quaternion":
            return yaw_from_quaternion(*values)
        if s.convert in _OF_A_FIX:
            values = [fix_in_degrees(v, s.unit, self.signals[n].unit) for v, n in zip(values, s.sources, strict=True)]
            finite = np.flatnonzero(np.isfinite(values[0]) & np.isfinite(values[1]) & (values[0] != 0.0))
            if not len(finite):
                return np.full(len(values[0]), np.nan)
            plane = local_tangent_plane(*values, (values[0][finite[0]], values[1][finite[0]]))
            return plane[0] if s.convert == "local_x" else plane[1]
        if s.convert == "signed":
            return signed(*values)
        if s.convert == "pair_mean":
            return np.mean(values, axis=0)
        return np.sum(values, axis=0) if s.convert == "sum" else values[0]

    def columns(self, chosen: Mapping[str, Suggestion]) -> dict[str, np.ndarray]:
        """Return all suggestions that can be laid on the grid."""
        made = {channel: self.column(s) for channel, s in chosen.items()}
        return {channel: values for channel, values in made.items() if values is not None}

    def motion_of_pose(self, columns: Mapping[str, np.ndarray], channels: Sequence[str]) -> dict[str, np.ndarray]:
        """Return what a pose tells of `channels`: v_x as the speed of X, Y, r as the turning of yaw or of X, Y.

        Only what `columns` lacks, on the grid, SI, shape (N,).
        """
        made: dict[str, np.ndarray] = {}
        wanted = [channel for channel in channels if channel not in columns]
        if not columns or len(self.grid) < 200 or not self.time_is_known:
            return made
        k = Kinematics(columns, 1.0 / self.rate, self.slices)
        if "vx" in wanted and {"X", "Y"} <= set(columns):
            made["vx"] = np.hypot(*(self._change(columns[c]) for c in "XY"))
        if "r" in wanted and "yaw" in columns:
            made["r"] = k.rate("yaw")
        elif "r" in wanted and {"X", "Y"} <= set(columns):
            made["r"] = k.course_rate()
        return made

    def speed_of_wheels(self, chosen: Mapping[str, Suggestion]) -> dict[str, np.ndarray]:
        """Return v_x as the mean of both wheels of an axle, the rear one if recorded, with both [m/s], shape (N,).

        Empty where no pair states a unit of speed; one that turns says nothing without its radius.
        """
        for pair in AXLES[::-1]:
            wheels = {c: chosen[c] for c in pair if c in chosen}
            units = [find_unit(s.unit) for s in wheels.values() if s.unit]
            if len(units) == 2 and all(unit is not None and unit.si == "m/s" for unit in units):
                speeds = self.columns(wheels)
                return {**speeds, "vx": sum(speeds.values()) / 2.0} if len(speeds) == 2 else {}
        return {}

    def outer_wheels_are_faster(self, columns: Mapping[str, np.ndarray]) -> bool:
        """Tell whether the wheels of every axle that is recorded say that r is left-positive."""
        found = self._outer_wheels(columns)
        return bool(found) and all(correlation > LEAST_CORRELATION for correlation in found)

    def inner_wheels_are_faster(self, columns: Mapping[str, np.ndarray]) -> bool:
        """Tell whether both axles say that r is right-positive: the wires of one may be exchanged."""
        found = self._outer_wheels(columns)
        return len(found) == len(AXLES) and all(correlation < -LEAST_CORRELATION for correlation in found)

    def _outer_wheels(self, columns: Mapping[str, np.ndarray]) -> list[float]:
        """Return for each axle how right less left wheel speed goes with r, as a correlation [1]."""
        if "vx" not in columns or not self.time_is_known:
            return []
        k = Kinematics(columns, 1.0 / self.rate, self.slices)
        found = outer_wheels(k, lambda *channels: set(channels) <= set(columns)).values()
        return [slope.correlation for slope in found]

    def _change(self, values: np.ndarray) -> np.ndarray:
        """Return the derivative of a column, shape (N,); across a border of two segments there is none."""
        parts = [values[run] for run in self.slices]
        return np.concatenate(
            [np.gradient(part, 1.0 / self.rate) if len(part) > 1 else np.full(len(part), np.nan) for part in parts]
        )

    def judge(self, chosen: Mapping[str, Suggestion]) -> Consistency:
        """Return what the consistency checks say of a choice; channels without a suggestion are not judged."""
        columns = self.columns(chosen)
        wheels = {c: v for c, v in columns.items() if c.startswith("wheel_speed")}
        unit_of = {c: find_unit(s.unit).si for c, s in chosen.items() if s.unit and find_unit(s.unit)}
        radius = self.vehicle.wheel_radius if self.vehicle is not None else None
        used = {c: columns[c] for c in (*_JUDGED, "T") if c in columns}
        # What turns or rolls in a unit that nobody states is no judge of v_x where something else is.
        judged_otherwise = {"X", "Y"} <= set(used) or "ax" in used
        for channel, values in wheels.items():
            if channel not in unit_of and judged_otherwise:
                continue
            if unit_of.get(channel) == "rad/s":
                if radius is None:
                    continue
                values = values * radius
            used[channel] = values
        certain = certain_of(chosen)
        # Motion of a path whose left and right are beyond doubt judges what is recorded beside it.
        sure = {"X": "hand", "Y": "hand", "yaw": "yaw"}
        pose = {channel: used[channel] for channel, by in sure.items() if channel in used and by in certain}
        motion = self.motion_of_pose(used, ("vx",))
        motion |= self.motion_of_pose(pose, ("r",)) if "r" not in used else {}
        if not {"vx"} & {*used, *motion} and (rolled := self.speed_of_wheels(chosen)):
            # They judge the other axle, and no longer themselves.
            motion |= {"vx": rolled["vx"]}
            used = {c: v for c, v in used.items() if c not in rolled}
        kinds = {channel: NOT_RECORDED for channel in REQUIRED_CHANNELS if channel not in {*used, *motion}}
        kinds |= dict.fromkeys(motion, "derived: from the path or the wheels")
        used |= motion
        if "vx" not in used or len(self.grid) < 200 or not self.time_is_known:
            return Consistency()
        nothing = {channel: np.zeros(len(self.grid)) for channel in kinds if channel not in used}
        drive = Drive("draft", {"t": self.grid - self.grid[0], **used, **nothing}, self.segment, 1.0 / self.rate)
        with np.errstate(all="ignore"):
            steps = [self._step(chosen[channel]) for channel in ("X", "yaw") if channel in used and channel in chosen]
            return check_consistency(drive, self.vehicle, kinds, certain, max(steps, default=0.0))

    def gap(self, chosen: Mapping[str, Suggestion]) -> float:
        """Return the ``--gap`` [s] that the motion of a choice needs, or the pose that gives it; 0 if none."""
        motion = [s for c, s in chosen.items() if c in ("vx", "vy", "r")]
        motion = motion if "vx" in chosen else [*motion, *(s for c, s in chosen.items() if c in ("X", "Y", "yaw"))]
        slowest = max((self._step(s) for s in motion), default=0.0)
        return BRIDGED_SAMPLES * slowest if slowest > SLOWEST_PERIOD else 0.0

    def _step(self, s: Suggestion) -> float:
        """Return the usual step between two samples of a suggestion [s]."""
        signal = self.signals[names_of(s)[0]]
        stamps = self.time if signal.time is None else signal.time
        if stamps is None:
            return 0.0
        # Of rows with one stamp ingest keeps one.
        steps = np.diff(np.unique(stamps[np.isfinite(signal.values) & np.isfinite(stamps)]))
        return float(np.median(steps)) if len(steps) else 0.0


def _along_a_curve(grid: np.ndarray, stamps: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return a pose between its fixes, shape of `grid`: a path of straight pieces turns in its corners alone."""
    stamps, first = np.unique(stamps, return_index=True)
    if len(stamps) < 2 or float(np.median(np.diff(stamps))) < Kinematics.WIDTH:
        return np.interp(grid, stamps, values[first])
    from scipy.interpolate import CubicSpline

    return CubicSpline(stamps, values[first])(np.clip(grid, stamps[0], stamps[-1]))


def _without_restarts(time: np.ndarray) -> np.ndarray:
    """Return a table's time with what follows a restart moved behind what was before it, shape (N,)."""
    borders = clock_resets(time, _GAP)
    moved = np.array(time, dtype=np.float64)
    for begin, end in zip(borders, [*borders, len(time)][1:], strict=True):
        before = np.nanmax(moved[:begin])
        moved[begin:end] += before - np.nanmin(moved[begin:end]) + 10.0 * _GAP
    return moved


def _with_short_pauses(time: np.ndarray) -> np.ndarray:
    """Return a table's time with every long pause cut short, shape (N,).

    A logger that paused for an hour, or whose clock was set while it ran, is judged before and after that.
    """
    stamps = np.unique(time[np.isfinite(time)])
    steps = np.diff(stamps)
    longest = max(10.0 * _GAP, 50.0 * float(np.median(steps))) if len(steps) else 0.0
    beyond = np.where(steps > longest, steps - longest, 0.0)
    if not beyond.any():
        return time
    return np.interp(time, stamps, stamps - np.concatenate([[0.0], np.cumsum(beyond)]))


def _without_gaps(grid: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the grid without what lies between rows far apart, and the segment of each of its rows."""
    stamps = np.unique(time[np.isfinite(time)])
    steps = np.diff(stamps)
    wide = np.flatnonzero(steps > max(_GAP, 5.0 * float(np.median(steps)))) if len(steps) else np.zeros(0, int)
    begins, ends = stamps[wide], stamps[wide + 1]
    segment = np.searchsorted(ends, grid, side="right")
    inside = segment < np.searchsorted(begins, grid, side="left")
    return grid[~inside], segment[~inside].astype(np.int32)


def _is_long(stamps: np.ndarray, others: Sequence[np.ndarray]) -> bool:
    """Whether a clock covers half of what the longest does; others must not shrink the common time."""
    return float(np.ptp(stamps[np.isfinite(stamps)])) > 0.5 * max(float(np.ptp(t[np.isfinite(t)])) for t in others)
