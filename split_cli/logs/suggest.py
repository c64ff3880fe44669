"""A draft of a signal map: names and units suggest, the data and the consistency checks judge."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.errors import SplitError
from split_cli.logs.checks import NO_CAR_EXCEEDS
from split_cli.logs.consistency import Consistency, check_consistency
from split_cli.logs.drive import Drive
from split_cli.logs.fields import field_candidates
from split_cli.logs.gather import expected_unit, row_rate_from_yaw
from split_cli.logs.naming import meanings, stated_unit
from split_cli.logs.raw import RawChannelInfo, RawSignal, Recording, time_column
from split_cli.logs.steering import read_steering
from split_cli.logs.transform import local_tangent_plane
from split_cli.signals import REQUIRED_CHANNELS, find_unit
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Draft", "Suggestion", "draft_map", "render_draft", "suggest_map"]

_JUDGED = ("vx", "vy", "r", "yaw", "X", "Y", "ax", "ay", "delta")
_MOST_RIVALS = 4
_GRID_RATE = 50.0
_MARKS = {"judged": "judged: ", "stated": "unit as the file says; not judged", "assumed": "CHECK: "}
_HELPERS = ("latitude", "longitude", "wheel_torque", "course")
"""Meanings that make channels of the drive and are none."""
_HANDED = ("r", "vy", "ay", "yaw", "delta", "steering_wheel_angle", "sideslip")
"""Channels whose sign says left or right."""
_UNITS_OF = {"sideslip": "rad", "latitude": "rad", "longitude": "rad", "wheel_torque": "N m", "course": "rad"}
_UNIT_BY_FACTOR = {
    ("vx", 3.6): "km/h", ("vy", 3.6): "km/h", ("vx", 2.237): "mph", ("vy", 2.237): "mph", ("vx", 1.944): "kn",
    ("r", 57.3): "deg/s", ("yaw", 57.3): "deg", ("delta", 57.3): "deg", ("ax", 0.102): "g", ("ay", 0.102): "g",
}  # fmt: skip


@dataclass(frozen=True)
class Suggestion:
    """What the draft says of one channel.

    Attributes
    ----------
    channel : str
    sources : tuple of str
        Recorded names; several with `convert`, or to be summed.
    unit : str or None
    scale : float
    convert, world : str
    status : str
        ``judged`` (a relation to other channels holds), ``stated`` (the file gives the unit, nothing judges it),
        ``assumed`` (nobody gives the unit, nothing judges it) or ``open`` (left out, with the reason).
    reason : str
    """

    channel: str
    sources: tuple[str, ...]
    unit: str | None = None
    scale: float = 1.0
    convert: str = ""
    world: str = ""
    status: str = "assumed"
    reason: str = ""


@dataclass(frozen=True)
class Draft:
    """A drafted map.

    Attributes
    ----------
    suggestions : tuple of Suggestion
    time : str
        The map's line for the time, a comment where none was found.
    unused : tuple of str
    undefined : tuple of str
        Message types that cannot be read, for want of a definition.
    """

    suggestions: tuple[Suggestion, ...]
    time: str
    unused: tuple[str, ...]
    undefined: tuple[str, ...] = ()

    def of(self, channel: str) -> Suggestion | None:
        """Return what is said of a channel, None when nothing is."""
        return next((s for s in self.suggestions if s.channel == channel), None)


@dataclass(frozen=True)
class _Candidate:
    channel: str
    sources: tuple[str, ...]
    weight: int
    unit: str | None
    convert: str = ""


def draft_map(recording: Recording, *, row_rate: float | None = None, vehicle: Vehicle | None = None) -> Draft:
    """Draft a map for a recording.

    Parameters
    ----------
    recording : Recording
    row_rate : float, optional
        Of a table without a column of time [Hz].
    vehicle : Vehicle, optional
        Lets the steer angle, T and the place of v_y be judged too.

    Notes
    -----
    Names and units give candidates. Of several for one channel the one is taken with which the recording
    contradicts itself least. A unit that nobody states and a sign are corrected where the checks name one mistake
    as clearly the best explanation; what they do not settle is left open or marked.
    """
    infos = recording.channels()
    candidates = _candidates(recording, infos)
    signals = _read(recording, candidates)
    time, line, known = _time(recording, infos, signals, candidates, row_rate)
    trial = _Trial(signals, time, vehicle, known)
    opened: list[Suggestion] = []
    usable: dict[str, list[_Candidate]] = {}
    for candidate in candidates:
        reason = trial.unusable(candidate)
        if reason:
            opened.append(Suggestion(candidate.channel, candidate.sources, status="open", reason=reason))
        else:
            usable.setdefault(candidate.channel, []).append(candidate)
    chosen = _choose(usable, trial)
    corrected, consistency = _correct(chosen, trial)
    suggestions = [_with_status(s, consistency) for s in corrected.values()]
    suggestions = [s for s in suggestions if s.channel not in ("delta", "steering_wheel_angle", *_HELPERS)]
    steering = read_steering(corrected, trial.columns(corrected), vehicle, Suggestion)
    hand = next((s.reason for s in suggestions if s.status == "open" and "positive is undecided" in s.reason), "")
    suggestions += [replace(s, status="open", reason=hand) if hand and s.status != "open" else s for s in steering]
    taken = {name for s in suggestions for name in s.sources}
    known = {s.channel for s in suggestions}
    opened = [s for s in opened if s.channel not in known and not set(s.sources) & taken]
    unused = tuple(info.name for info in infos if info.name not in taken)
    undefined = dict.fromkeys(i.type_name for i in infos if i.name.startswith("/") and _is_bare_topic(i, infos))
    return Draft(tuple([*suggestions, *dict.fromkeys(opened)]), line, unused, tuple(undefined))


def suggest_map(recording: Recording, *, row_rate: float | None = None, vehicle: Vehicle | None = None) -> str:
    """Return a draft map as YAML text: each channel with its evidence, or commented out with its reason."""
    return render_draft(draft_map(recording, row_rate=row_rate, vehicle=vehicle), recording.name)


def render_draft(draft: Draft, name: str) -> str:
    """Return a drafted map as YAML text."""
    lines = [
        f"# A draft for {name}. `judged` fits the other channels; `CHECK` was not judged: look at it.",
        "name: draft",
        draft.time,
        "frame: flu   # or frd: y right, z down",
        "channels:",
    ]
    for s in draft.suggestions:
        if s.status != "open":
            lines.append(f"  {s.channel}: {_entry(s)}   # {_MARKS[s.status]}{s.reason}")
    for s in draft.suggestions:
        if s.status == "open":
            lines.append(f"  # open: {s.channel} from {', '.join(s.sources)}: {s.reason}")
    mapped = {s.channel for s in draft.suggestions if s.status != "open"}
    missing = [channel for channel in REQUIRED_CHANNELS if channel not in mapped]
    if missing:
        lines.append(f"# Required and not found: {', '.join(missing)}.")
    lines += [f"# {text}" for text in _ways(missing, mapped)]
    if draft.undefined:
        shown = ", ".join(draft.undefined[:12])
        lines.append(f"# Types that the recording does not define: {shown}. Give their .msg files: --msg-path.")
    if draft.unused:
        shown = [name.replace("\n", " ") for name in draft.unused[:40]]
        lines.append(f"# Not used: {', '.join(shown)}{' ...' if len(draft.unused) > 40 else ''}")
    return "\n".join(lines)


def _is_bare_topic(info: RawChannelInfo, infos: Sequence[RawChannelInfo]) -> bool:
    """Whether a topic is listed without fields: its type is not defined."""
    return "/" in info.type_name and not any(other.name.startswith(info.name + "/") for other in infos) and (
        info.name.count("/") == 1
    )


def _ways(missing: Sequence[str], mapped: set[str]) -> list[str]:
    """Return how missing channels can be derived from what is mapped."""
    ways = []
    if "T" in missing:
        ways.append("T: --derive torque-from-acceleration (it says nothing of the drive train), or from pedals.")
    if "vy" in missing and "sideslip" in mapped:
        ways.append("vy: --derive lateral-velocity-from-sideslip.")
    elif {"vx", "vy", "r"} & set(missing) and {"X", "Y", "yaw"} <= mapped:
        ways.append("vx, vy, r: --derive velocity-from-pose.")
    elif "vy" in missing:
        ways.append("vy: neither lateral velocity, sideslip nor pose was found; it takes one of them.")
    return ways


def _candidates(recording: Recording, infos: Sequence[RawChannelInfo]) -> list[_Candidate]:
    """Return what names and units suggest; a unit of another quantity rules a channel out."""
    time = None if recording.clocks else time_column(infos)
    found: list[_Candidate] = []
    for channel, sources, convert in field_candidates(infos):
        # Messages of ROS are in SI by its conventions (REP 103), positions of a fix in degrees.
        unit = "deg" if channel in ("latitude", "longitude") else expected_unit(channel)
        found.append(_Candidate(channel, sources, 3, unit, convert))
    by_field = {name for candidate in found for name in candidate.sources}
    for info in infos:
        if info == time or info.type_name == "text" or info.name in by_field:
            continue
        unit = stated_unit(info)
        for meaning in meanings(info):
            channel = meaning.channel
            si = getattr(find_unit(unit), "si", None) if unit else None
            if channel == "brake" and si == "Pa":
                channel = "brake_pressure"
            expected = _UNITS_OF.get(channel) or expected_unit(channel)
            turning = channel.startswith("wheel_speed") and si == "rad/s"
            if si is not None and expected is not None and si != expected and not turning:
                continue
            found.append(_Candidate(channel, (info.name,), meaning.weight - info.name.startswith("_"), unit))
    return [*found, *_fixes(found)]


def _fixes(found: Sequence[_Candidate]) -> list[_Candidate]:
    """Return X and Y from latitude and longitude, sums of wheel torques and brake pressures."""
    first = {c.channel: c for c in reversed(found) if c.channel in ("latitude", "longitude")}
    made = []
    if len(first) == 2:
        pair = (first["latitude"].sources[0], first["longitude"].sources[0])
        made += [_Candidate("X", pair, 2, "m", "local_x"), _Candidate("Y", pair, 2, "m", "local_y")]
    wheels = [c for c in found if c.channel == "wheel_torque"]
    if wheels:
        made.append(_Candidate("T", tuple(c.sources[0] for c in wheels), 4, wheels[0].unit, "sum"))
    pressures = [c for c in found if c.channel == "brake_pressure"]
    if len(pressures) == 2:
        both = tuple(c.sources[0] for c in pressures)
        made.append(_Candidate("brake_pressure", both, 4, pressures[0].unit, "sum"))
    return made


def _read(recording: Recording, candidates: Sequence[_Candidate]) -> dict[str, RawSignal]:
    """Read what candidates need and what may be a clock; a signal that cannot be read is left out."""
    names = {name for c in candidates for name in _names(c)}
    listed = recording.channels()
    if not recording.clocks:
        names |= {info.name for info in listed if re.search("time|stamp|^t$", info.name, re.IGNORECASE)}
        names |= {info.name for info in [time_column(listed)] if info is not None}
    text = {info.name for info in listed if info.type_name == "text"}
    known = {info.name for info in listed}
    signals: dict[str, RawSignal] = {}
    for name in sorted(names & known - text):
        try:
            signals |= recording.read([name])
        except SplitError:
            continue
    return signals


def _names(candidate: _Candidate) -> tuple[str, ...]:
    if candidate.convert == "yaw_from_quaternion":
        return tuple(f"{candidate.sources[0]}.{axis}" for axis in "xyzw")
    return candidate.sources


def _time(
    recording: Recording,
    infos: Sequence[RawChannelInfo],
    signals: Mapping[str, RawSignal],
    candidates: Sequence[_Candidate],
    row_rate: float | None,
) -> tuple[np.ndarray | None, str, bool]:
    """Return the clock of a table's rows [s], the map's line for it, and whether it is known."""
    bare = [s for s in signals.values() if s.time is None]
    if recording.clocks:
        return None, "# time: that of the messages", True
    if hasattr(recording, "paths"):
        return None, "# time: that of each file", True
    if signals and not bare:
        return None, "# time: each signal has its own", True
    needed = "# time: {period: SECONDS}   # no column of time: needed, or --row-rate HZ"
    if not bare:
        return None, needed, False
    count = len(bare[0].values)
    found = time_column(infos)
    clocks = [found] if found is not None else [i for i in infos if re.search("time|stamp", i.name, re.IGNORECASE)]
    rising = [i for i in clocks if i.name in signals and _rises(signals[i.name].values)]
    if rising and row_rate is None:
        info = rising[0]
        values = signals[info.name].values
        unit = info.unit if find_unit(info.unit or "") and find_unit(info.unit).si == "s" else stated_unit(info)
        unit = unit if unit in ("s", "ms", "us", "ns", "min") else _unit_of_time(values)
        others = [i.name for i in rising[1:]]
        also = f"   # also rises: {', '.join(others)}" if others else ""
        line = f"time: {{source: {_quoted(info.name)}, unit: {unit}}}{also}"
        return (values - np.nanmin(values)) * find_unit(unit).factor, line, True
    if row_rate is None:
        row_rate = _rate_told_by_yaw(candidates, signals)
        if row_rate is None:
            return np.arange(count) * 0.01, needed, False
        why = "no column of time; yaw turns as yaw rate says so"
        line = f"time: {{period: {1.0 / row_rate:.4g}}}   # CHECK: {why}"
        return np.arange(count) / row_rate, line, True
    return np.arange(count) / row_rate, f"time: {{period: {1.0 / row_rate:.6g}}}   # as given", True


def _rises(values: np.ndarray) -> bool:
    step = np.diff(values[np.isfinite(values)])
    return len(step) > 10 and np.mean(step > 0) > 0.95


def _unit_of_time(values: np.ndarray) -> str:
    """Return the unit in which samples are 0.2 ms to 1 s apart; that is one of a thousand."""
    step = float(np.median(np.diff(values[np.isfinite(values)])))
    return next((u for u, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)) if step * size > 2e-4
                 and step * size < 1.5), "s")  # fmt: skip


def _rate_told_by_yaw(candidates: Sequence[_Candidate], signals: Mapping[str, RawSignal]) -> float | None:
    for yaw in (c for c in candidates if c.channel == "yaw" and c.sources[0] in signals):
        for rate in (c for c in candidates if c.channel == "r" and c.sources[0] in signals):
            units = [find_unit(c.unit).factor if c.unit else 1.0 for c in (yaw, rate)]
            pair = [signals[c.sources[0]].values * u for c, u in zip((yaw, rate), units, strict=True)]
            found = row_rate_from_yaw(*pair)
            if found:
                return found
    return None


class _Trial:
    """Candidates as SI columns on one clock, to be judged by the consistency checks."""

    def __init__(
        self,
        signals: Mapping[str, RawSignal],
        time: np.ndarray | None,
        vehicle: Vehicle | None,
        time_is_known: bool,
    ) -> None:
        self.signals, self.time, self.vehicle, self.time_is_known = signals, time, vehicle, time_is_known
        stamps = [time if s.time is None else s.time for s in signals.values()]
        stamps = [t for t in stamps if t is not None and np.isfinite(t).sum() > 20]
        low = max((float(np.nanquantile(t, 0.0)) for t in stamps if _is_long(t, stamps)), default=0.0)
        high = min((float(np.nanquantile(t, 1.0)) for t in stamps if _is_long(t, stamps)), default=0.0)
        count = int(min(max((high - low) * _GRID_RATE, 0), 60_000))
        self.grid = low + np.arange(count) / _GRID_RATE

    def unusable(self, candidate: _Candidate) -> str:
        """Return why a candidate cannot be used, empty when it can."""
        missing = [name for name in _names(candidate) if name not in self.signals]
        if missing:
            return f"{missing[0]} cannot be read"
        values = self._combined(candidate, [self.signals[name].values for name in _names(candidate)])
        finite = values[np.isfinite(values)]
        if len(finite) < 20:
            return "nearly empty"
        if np.ptp(finite) == 0.0:
            return f"never changes ({finite[0]:g})"
        unit = find_unit(candidate.unit) if candidate.unit else None
        reach = float(np.quantile(np.abs(finite), 0.99)) * (unit.factor if unit is not None else 0.0)
        limit, si = NO_CAR_EXCEEDS.get(candidate.channel, (np.inf, ""))
        if reach > limit and candidate.channel != "delta":
            return f"reaches {reach:.3g} {si} in the unit that the file states, no car's exceeds {limit:g}"
        if candidate.channel == "course":
            return "direction of travel over ground: yaw plus sideslip, not yaw"
        return ""

    def column(self, s: Suggestion) -> np.ndarray | None:
        """Return a suggestion's samples on the grid, SI, shape (N,); None where too few."""
        names = _names(_Candidate(s.channel, s.sources, 0, s.unit, s.convert))
        if any(name not in self.signals for name in names):
            return None
        raw = [self.signals[name] for name in names]
        values = self._combined(s, [signal.values for signal in raw])
        stamps = self.time if raw[0].time is None else raw[0].time
        if stamps is None or len(stamps) != len(values):
            return None
        unit = find_unit(s.unit) if s.unit else None
        values = values * s.scale * (unit.factor if unit is not None else 1.0)
        if s.channel == "yaw" and s.world == "ned":
            values = 0.5 * np.pi - values
        good = np.isfinite(values) & np.isfinite(stamps)
        stamps, values = stamps[good], values[good]
        order = np.argsort(stamps, kind="stable")
        if len(order) < 20 or not len(self.grid):
            return None
        if s.channel in ("yaw", "course"):
            values = np.unwrap(values[order])
            return np.interp(self.grid, stamps[order], values)
        return np.interp(self.grid, stamps[order], values[order])

    def _combined(self, s: Suggestion | _Candidate, values: list[np.ndarray]) -> np.ndarray:
        from split_cli.logs.transform import yaw_from_quaternion

        if s.convert == "yaw_from_quaternion":
            return yaw_from_quaternion(*values)
        if s.convert in ("local_x", "local_y"):
            finite = np.flatnonzero(np.isfinite(values[0]) & np.isfinite(values[1]) & (values[0] != 0.0))
            if not len(finite):
                return np.full(len(values[0]), np.nan)
            plane = local_tangent_plane(*values, (values[0][finite[0]], values[1][finite[0]]))
            return plane[0] if s.convert == "local_x" else plane[1]
        return np.sum(values, axis=0) if s.convert == "sum" else values[0]

    def columns(self, chosen: Mapping[str, Suggestion]) -> dict[str, np.ndarray]:
        """Return all suggestions that can be laid on the grid."""
        made = {channel: self.column(s) for channel, s in chosen.items()}
        return {channel: values for channel, values in made.items() if values is not None}

    def judge(self, chosen: Mapping[str, Suggestion]) -> Consistency:
        """Return what the consistency checks say of a choice; channels without a suggestion are not judged."""
        columns = self.columns(chosen)
        wheels = {c: v for c, v in columns.items() if c.startswith("wheel_speed")}
        unit_of = {c: find_unit(s.unit).si for c, s in chosen.items() if s.unit and find_unit(s.unit)}
        radius = self.vehicle.wheel_radius if self.vehicle is not None else None
        used = {c: columns[c] for c in (*_JUDGED, "T") if c in columns}
        for channel, values in wheels.items():
            if unit_of.get(channel) == "rad/s":
                if radius is None:
                    continue
                values = values * radius
            used[channel] = values
        if "vx" not in used or len(self.grid) < 200 or not self.time_is_known:
            return Consistency()
        kinds = {channel: "derived: nothing" for channel in REQUIRED_CHANNELS if channel not in used}
        nothing = {channel: np.zeros(len(self.grid)) for channel in kinds}
        drive = Drive("draft", {"t": self.grid - self.grid[0], **used, **nothing},
                      np.zeros(len(self.grid), dtype=np.int32), 1.0 / _GRID_RATE)  # fmt: skip
        with np.errstate(all="ignore"):
            return check_consistency(drive, self.vehicle, kinds)


def _is_long(stamps: np.ndarray, others: Sequence[np.ndarray]) -> bool:
    """Whether a clock covers half of what the longest does; others must not shrink the common time."""
    return float(np.ptp(stamps[np.isfinite(stamps)])) > 0.5 * max(float(np.ptp(t[np.isfinite(t)])) for t in others)


def _first_guess(candidate: _Candidate, trial: _Trial) -> Suggestion:
    unit = candidate.unit
    if unit is None and candidate.channel in ("yaw", "sideslip") and candidate.convert == "":
        values = trial.signals[candidate.sources[0]].values
        steps = np.abs(np.diff(values[np.isfinite(values)]))
        if candidate.channel == "yaw" and np.any((steps > 300.0) & (steps < 420.0)):
            unit = "deg"
    return Suggestion(candidate.channel, candidate.sources, unit, convert=candidate.convert,
                      status="stated" if candidate.unit else "assumed")  # fmt: skip


def _choose(usable: Mapping[str, list[_Candidate]], trial: _Trial) -> dict[str, Suggestion]:
    """Take the clearest candidate of each channel; among rivals the one that contradicts the others least."""
    ranked = {
        channel: sorted(options, key=lambda c: (-c.weight, c.unit is None, len(c.sources)))[:_MOST_RIVALS]
        for channel, options in usable.items()
    }
    taken: dict[tuple[str, ...], str] = {}
    for channel, options in sorted(ranked.items(), key=lambda entry: -entry[1][0].weight):
        for candidate in list(options):
            owner = taken.get(candidate.sources)
            if owner is not None and not candidate.convert and len(options) > 1:
                options.remove(candidate)
        taken.setdefault(options[0].sources, channel)
    chosen = {channel: _first_guess(options[0], trial) for channel, options in ranked.items()}
    for channel in ("vx", "r", "yaw", "X", "ax", "ay", "vy"):
        options = ranked.get(channel, [])
        if len(options) < 2:
            continue
        scored = []
        for place, candidate in enumerate(options):
            attempt = {**chosen, channel: _first_guess(candidate, trial)}
            if channel == "X" and candidate.convert == "local_x":
                attempt["Y"] = _first_guess(replace(candidate, channel="Y", convert="local_y"), trial)
            verdict = trial.judge(attempt)
            mine = [r for r in verdict.relations if channel in r.powers]
            # A relation that could be measured counts for a candidate, a contradiction against it.
            score = verdict.cost - len(mine) - sum(abs(r.slope.correlation) for r in mine)
            scored.append((score + 2.0 * (options[0].weight - candidate.weight), place, attempt))
        chosen = min(scored, key=lambda entry: entry[:2])[2]
    return chosen


def _correct(
    chosen: dict[str, Suggestion], trial: _Trial
) -> tuple[dict[str, Suggestion], Consistency]:
    """Set units that nobody states, and signs, as the checks say, until they say nothing more."""
    verdict = trial.judge(chosen)
    for _ in range(4):
        changed = False
        for channel, factor in verdict.factors.items():
            if channel == "hand":
                chosen = {**chosen, "X": replace(chosen["Y"], channel="X"), "Y": replace(chosen["X"], channel="Y")}
                changed = True
            elif channel in chosen:
                better = _corrected(chosen[channel], factor)
                changed |= better != chosen[channel]
                chosen = {**chosen, channel: better}
                if channel == "X" and better.unit:
                    chosen["Y"] = replace(chosen["Y"], unit=better.unit)
        for finding in verdict.findings:
            if finding.check == "compass" and "yaw" in chosen:
                yaw = replace(chosen["yaw"], scale=1.0, world="ned", reason="a compass bearing")
                chosen = {**chosen, "yaw": yaw}
                changed = True
        if not changed:
            break
        verdict = trial.judge(chosen)
    return chosen, verdict


def _corrected(s: Suggestion, factor: float) -> Suggestion:
    size = abs(factor)
    known = [(f, u) for (c, f), u in _UNIT_BY_FACTOR.items() if c == s.channel]
    unit = next((u for f, u in known if abs(size / f - 1.0) < 0.03), None)
    if s.channel == "X" and size != 1.0:
        unit = {0.3048: "ft", 1000.0: "km", 0.01: "cm", 0.001: "mm"}.get(round(1.0 / size, 4))
    if s.channel.startswith("wheel_speed"):
        unit = {3.6: "km/h", 2.237: "mph", 1.944: "kn"}.get(round(size, 3))
    turned = factor < 0.0
    if s.status == "stated" and size != 1.0:
        return s  # the file states a unit: a finding tells of the contradiction
    if size == 1.0:
        return replace(s, scale=-s.scale, reason="its sign is turned") if turned else s
    if unit is None:
        return s
    return replace(s, unit=unit, scale=-s.scale if turned else s.scale, reason=f"found to be in {unit}")


def _with_status(s: Suggestion, verdict: Consistency) -> Suggestion:
    """Say what supports or contradicts a suggestion."""
    faults = ("scale", "sign", "range", "constant", "swapped")
    wrong = [f for f in verdict.findings if f.channel == s.channel and f.check in faults]
    if wrong:
        return replace(s, status="open", reason=wrong[0].text)
    undecided = [f for f in verdict.findings if f.check == "sign" and f.channel in ("r", "yaw", "X")]
    if undecided and s.channel in _HANDED:
        return replace(s, status="open", reason=f"left or right positive is undecided: {undecided[0].text}")
    key = {"Y": "X"}.get(s.channel, s.channel)
    keys = {key, "hand"} if key == "X" else {key}
    holding = [relation for relation in verdict.relations if relation.holds and keys & set(relation.powers)]
    notes = [f.text for f in verdict.findings if f.channel == s.channel]
    told = f"{s.reason}; " if s.reason else ""
    if holding:
        shown = "; ".join(f"{r.name} {r.slope.slope:.3g}" for r in holding[:3])
        return replace(s, status="judged", reason=f"{told}{shown}{'; note: ' + notes[0] if notes else ''}")
    if s.status == "stated":
        return replace(s, reason=f"{'; ' + s.reason if s.reason else ''}")
    unit = s.unit or _UNITS_OF.get(s.channel) or expected_unit(s.channel) or "1"
    return replace(s, unit=unit, reason=f"{told}unit not stated, {unit} assumed, and nothing judges it")


def _entry(s: Suggestion) -> str:
    if s.convert == "sum":
        unit = f", unit: {_quoted(s.unit)}" if s.unit else ""
        return "{sum: [" + ", ".join(f"{{source: {_quoted(n)}{unit}}}" for n in s.sources) + "]}"
    source = _quoted(s.sources[0]) if len(s.sources) == 1 else "[" + ", ".join(map(_quoted, s.sources)) + "]"
    parts = [f"source: {source}"]
    if s.convert:
        parts.append(f"convert: {s.convert}")
    else:
        unit = s.unit or _UNITS_OF.get(s.channel) or expected_unit(s.channel)
        parts += [f"unit: {_quoted(unit)}"] if unit else []
    if s.scale != 1.0:
        parts.append(f"scale: {s.scale:g}")
    if s.world:
        parts.append(f"world: {s.world}")
    return "{" + ", ".join(parts) + "}"


def _quoted(text: str) -> str:
    return text if re.fullmatch(r"[A-Za-z_][\w./ ^-]*", text) else '"' + text.replace('"', '\\"') + '"'
