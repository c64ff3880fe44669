"""Vectors recorded as three columns whose axes are not the car's: a sensor on its side, a game with y up."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from split_cli.logs.checking.plausible import NO_CAR_EXCEEDS
from split_cli.logs.drafting.draft import Suggestion
from split_cli.logs.drafting.handedness import NOT_UP
from split_cli.logs.drafting.trial import TrialCandidate, names_of
from split_cli.logs.raw import RawChannelInfo, RawSignal
from split_cli.signals import STANDARD_GRAVITY, find_unit

_CLEARLY = 3.0
"""How many times more one axis must turn or move than the one that the names say [1]."""
_STEEPEST = 0.25
"""Slope of a road [1]: of passes 0.2, of the steepest streets 0.35 over 100 m. An axis that changes by more, beside one
that hardly changes, is no height."""
_YAWS = 0.1
"""Part of a quaternion along one axis, below which it may be a roll or a pitch [1]: 11 degrees, more than cars do."""
_SECONDS = 5.0
"""Over which a car that rolls and pitches comes back, and one that yaws does not [s]."""
_HEAVE = 0.5
"""Of the velocity of what stands or hovers, by waves and drift [m/s]; judgement: half a walking pace."""
_READINGS = (("m/s^2", 1.0, STANDARD_GRAVITY, "m/s^2"), ("g", 1.0, 1.0, "g"), ("g", 1e-3, 1000.0, "thousandths of g"))
"""Unit and scale of an accelerometer, with what it reads of gravity and how that is called."""
_ABOUT_GRAVITY = 0.2
"""Share of gravity by which the median of a vertical axis may differ from it, from slopes and scale [1]."""
_KINDS = {
    "r": "rate",
    "vx": "velocity",
    "vy": "velocity",
    "ax": "acceleration",
    "ay": "acceleration",
    "X": "position",
    "Y": "position",
}


@dataclass(frozen=True)
class _Axes:
    """Which of x, y, z (0, 1, 2) are up and forward, and what says so; `forward` is None where nothing tells."""

    up: int
    forward: int | None
    why: str

    @property
    def level(self) -> tuple[int, int]:
        """The two axes that are not up."""
        first, second = (k for k in range(3) if k != self.up)
        return first, second


def names_of_triples(infos: Sequence[RawChannelInfo]) -> tuple[tuple[str, str, str], ...]:
    """Return names of three axes: ``AccelX``, ``AccelY``, ``AccelZ``, or ``acc[0]`` to ``acc[2]`` and no more."""
    names = {info.name for info in infos if info.type_name != "text"}
    firsts = [name.removesuffix("[0]") for name in sorted(names) if name.endswith("[0]")]
    found = [(f"{n}[0]", f"{n}[1]", f"{n}[2]") for n in firsts if {f"{n}[1]", f"{n}[2]"} <= names]
    found = [three for three in found if three[0].removesuffix("[0]") + "[3]" not in names]
    for name in sorted(names):
        for place in reversed([k for k, letter in enumerate(name) if letter in "xX"]):
            axes = "xyz" if name[place] == "x" else "XYZ"
            three = tuple(name[:place] + axis + name[place + 1 :] for axis in axes)
            if names.issuperset(three):
                found.append((three[0], three[1], three[2]))
                break
    return tuple(found)


def side_by_gravity(
    chosen: Mapping[str, Suggestion], triples: Sequence[tuple[str, str, str]], signals: Mapping[str, RawSignal]
) -> str:
    """Say which side a_y is positive to, by what the third axis of its accelerometer reads; empty where unclear.

    An accelerometer at rest reads +g along an axis that points up. The axis of a_x points forward where it reads
    positive when v_x rises. In a right-handed sensor the third axis then points left or right. A sensor that is
    left-handed, or reads gravity with the other sign, makes this wrong: it is advice and turns no sign.
    """
    ax, ay = chosen.get("ax"), chosen.get("ay")
    if ax is None or ay is None or ax.scale < 0.0 or ax.status != "judged":
        return ""
    three = next((t for t in triples if ax.sources[0] in t and ay.sources[0] in t), None)
    unit = find_unit(ax.unit or "m/s^2")
    if three is None or unit is None or ax.sources == ay.sources:
        return ""
    i, j = three.index(ax.sources[0]), three.index(ay.sources[0])
    k = 3 - i - j
    values = signals[three[k]].values if three[k] in signals else np.zeros(0)
    reads = float(np.nanmedian(values)) * unit.factor if np.isfinite(values).any() else 0.0
    if abs(abs(reads) / STANDARD_GRAVITY - 1.0) > _ABOUT_GRAVITY:
        return ""
    up = 1.0 if reads > 0.0 else -1.0
    # left = up x forward
    left = up * (1.0 if (k, i, j) in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1.0)
    way = "up" if up > 0.0 else "down"
    remark = f"{three[k]} reads {reads:.3g} m/s^2, so it points {way}. In a right-handed sensor"
    if left * ay.scale > 0.0:
        return f"{remark} a_y as above is then left-positive, and what agrees with it too."
    return (
        f"{remark} a_y as above is then right-positive, and what agrees with it too: set `frame: frd`, "
        "and `world: ned` if there is a pose."
    )


def unit_by_gravity(
    s: Suggestion, triples: Sequence[tuple[str, str, str]], signals: Mapping[str, RawSignal]
) -> Suggestion:
    """Set the unit of an acceleration that nobody states and nothing judges: another axis of it reads gravity.

    Without such an axis, an acceleration that no car reaches in the assumed unit is left open.
    """
    if s.channel not in ("ax", "ay") or s.status != "assumed" or s.unit != "m/s^2" or s.scale not in (1.0, -1.0):
        return s
    three = next((t for t in triples if s.sources[0] in t), ())
    others = {name: signals[name].values for name in three if name in signals and name != s.sources[0]}
    levels = {name: abs(float(np.nanmedian(v))) for name, v in others.items() if np.isfinite(v).any()}
    name = max(levels, key=lambda name: levels[name], default="")
    if name and levels[name] > _CLEARLY * float(np.nanstd(others[name])):
        reads = levels[name]
        for unit, scale, size, called in _READINGS:
            if abs(reads / size - 1.0) < _ABOUT_GRAVITY:
                reason = f"unit not stated; {name} reads {reads:.4g}, which is gravity in {called}"
                return replace(s, unit=unit, scale=scale * s.scale, reason=reason)
    limit, si = NO_CAR_EXCEEDS[s.channel]
    values = signals[s.sources[0]].values if s.sources[0] in signals else np.zeros(0)
    reach = float(np.nanquantile(np.abs(values), 0.99)) if np.isfinite(values).any() else 0.0
    if reach <= limit:
        return s
    known = f"no car's exceeds {limit:g} {si}"
    reason = f"unit not stated; it reaches {reach:.3g}, and {known}. Give its `unit:`, or `scale:`"
    return s.left_open(reason)


def doubt_of_height(
    suggestions: Sequence[Suggestion],
    triples: Sequence[tuple[str, str, str]],
    signals: Mapping[str, RawSignal],
    time: np.ndarray | None,
) -> list[Suggestion]:
    """Mark X and Y whose third axis changes more than Y where only the speed of the path judged them.

    On a straight along X the speed fits with a height in the place of Y too; a turning tells them apart.
    """
    pose = {s.channel: s for s in suggestions if s.channel in ("X", "Y") and s.status == "judged"}
    three = next((t for t in triples if len(pose) == 2 and pose["X"].sources + pose["Y"].sources == t[:2]), None)
    if three is None or three[2] not in signals or "turning" in pose["X"].reason:
        return list(suggestions)
    across, third = (_lasting(signals[name], time, True) for name in three[1:])
    if third <= _CLEARLY * across:
        return list(suggestions)
    remark = f"{three[2]} changes more than {three[1]}: one of them is the height, and which is not known"
    return [
        replace(s, status="assumed", reason=f"{remark}; {s.reason}") if s in pose.values() else s for s in suggestions
    ]


def along_the_car(
    candidates: Sequence[TrialCandidate],
    triples: Sequence[tuple[str, str, str]],
    signals: Mapping[str, RawSignal],
    time: np.ndarray | None,
) -> list[TrialCandidate]:
    """Return the candidates with elements of vectors exchanged where the data show other axes than the names.

    A car turns about its vertical axis and travels along another one. Where the axis called z turns far less than
    another, or is the one of travel, z is not up: yaw rate, velocities, accelerations and positions are then taken
    from the axes that the data show. Names of world axes are left alone, since there z is up.
    """
    candidates = [_about_its_own_axis(c, signals) for c in candidates]
    kinds = {
        _KINDS[c.channel]: three
        for three in triples
        for c in candidates
        if c.sources in {(n,) for n in three}
        if c.channel in _KINDS
    }
    axes = _axes(kinds, signals, time)
    if axes is None:
        return list(candidates)
    place = {name: (three, k) for three in triples for k, name in enumerate(three)}
    made: list[TrialCandidate] = []
    for c in candidates:
        if c.channel not in _KINDS or len(c.sources) != 1 or c.sources[0] not in place:
            made.append(c)
            continue
        three, _ = place[c.sources[0]]
        for k in _wanted(c.channel, axes):
            made.append(replace(c, sources=(three[k],), note=axes.why))
    return made


def _about_its_own_axis(c: TrialCandidate, signals: Mapping[str, RawSignal]) -> TrialCandidate:
    """Return a quaternion with its axes in turn, so that the one about which it turns comes last, as z.

    A car hardly rolls or pitches: of a world with y up, as motion capture has it, the part along y is the yaw's.
    """
    names = names_of(c)
    if c.convert != "yaw_from_quaternion" or any(name not in signals for name in names):
        return c
    sizes = [float(np.sqrt(np.nanmean(signals[name].values ** 2))) for name in names[:3]]
    up = int(np.argmax(sizes))
    if up == 2 or sizes[up] < _YAWS or not sizes[up] > _CLEARLY * max(size for k, size in enumerate(sizes) if k != up):
        return c
    turned = tuple(names[(up + 1 + k) % 3] for k in range(3))
    note = f"{names[up]} is {sizes[up]:.2g} beside {sizes[2]:.2g} of {names[2]}: {NOT_UP}"
    return replace(c, sources=(*turned, names[3]), unit=None, note=note)


def _wanted(channel: str, axes: _Axes) -> tuple[int, ...]:
    """Return the axes that may hold a channel, the likelier first."""
    first, second = axes.level
    if channel == "r":
        return (axes.up,)
    if channel in ("X", "Y"):
        return (first,) if channel == "X" else (second,)
    if axes.forward is None:
        return (first, second) if channel in ("vx", "ax") else (second, first)
    across = second if axes.forward == first else first
    return (axes.forward,) if channel in ("vx", "ax") else (across,)


def _axes(
    kinds: Mapping[str, tuple[str, str, str]], signals: Mapping[str, RawSignal], time: np.ndarray | None
) -> _Axes | None:
    """Return the axes that turning and travel show; None where they are as named."""

    def sizes(kind: str, without_bias: bool = False) -> np.ndarray | None:
        three = kinds.get(kind, ())
        if not three or any(name not in signals for name in three):
            return None
        return np.array([_lasting(signals[name], time, without_bias) for name in three])

    turning, travel, pull = sizes("rate", without_bias=True), sizes("velocity"), sizes("acceleration")
    forward = None
    if travel is not None and travel[2] > max(_CLEARLY * max(travel[:2]), _HEAVE):
        forward = 2
    elif pull is not None and pull[2] > _CLEARLY * max(pull[:2]):
        return None  # gravity lies along z: on a straight a car pitches more than it yaws
    if turning is not None:
        up = int(np.argmax(turning))
        others = np.delete(turning, up)
        # On a straight a car pitches more than it yaws, but what pitches swings back.
        lasts = _CLEARLY * turning[up] > _lasting(signals[kinds["rate"][up]], time, True, seconds=0.0)
        if up != 2 and lasts and turning[up] > _CLEARLY * others.max():
            name, z = kinds["rate"][up], kinds["rate"][2]
            why = f"{name} turns {turning[up] / max(turning[2], 1e-12):.3g} times as much as {z}: {NOT_UP}"
            return _Axes(up, forward if forward != up else None, why)
    if forward == 2 and travel is not None:
        name = kinds["velocity"][2]
        return _Axes(1, 2, f"the car travels along {name}: {NOT_UP}")
    span = sizes("position", without_bias=True)
    # A velocity beside it, of the world too, is as small along the height.
    level = travel is None or _CLEARLY * travel[1] < min(travel[0], travel[2])
    x, y, z = span if span is not None and turning is None and level else np.zeros(3)
    if z > _STEEPEST * x and _CLEARLY * y < min(x, z):
        return _Axes(1, None, f"{kinds['position'][1]} changes far less than the other two: {NOT_UP}")
    return None


def _lasting(signal: RawSignal, time: np.ndarray | None, without_bias: bool, seconds: float = _SECONDS) -> float:
    """Return the rms of a signal's means over some seconds: what lasts, not what swings back.

    A gyroscope at rest may read a degree per second, more than a car on a straight turns: its median is taken off.
    """
    stamps = time if signal.time is None else signal.time
    values = signal.values
    if stamps is None or len(stamps) != len(values):
        return 0.0
    good = np.isfinite(values) & np.isfinite(stamps)
    if np.count_nonzero(good) < 20:
        return 0.0
    step = float(np.median(np.diff(stamps[good])))
    rows = int(np.clip(seconds / max(step, 1e-9), 1, np.count_nonzero(good)))
    means = uniform_filter1d(values[good], rows)
    return float(np.sqrt(np.mean((means - np.median(means) if without_bias else means) ** 2)))
