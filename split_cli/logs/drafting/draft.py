"""A drafted signal map: what is said of each channel, and how it is written as YAML."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from split_cli.logs.assembling.conversion import expected_unit
from split_cli.logs.assembling.derivations import DERIVATIONS, WITHOUT_RATE, derivations_for
from split_cli.logs.one_car import SeveralCars
from split_cli.signals import REQUIRED_CHANNELS, find_unit

UNITS_OF = {
    "sideslip": "rad",
    "latitude": "rad",
    "longitude": "rad",
    "wheel_torque": "N m",
    "course": "rad",
    "engine_torque": "N m",
    "axle_torque": "N m",
}
_NO_LEFT = (
    "CHECK left and right: the signs above are as recorded, and nothing recorded tells the sides apart",
    "(no satellite fix, east and north, or compass). In a left turn r and delta must be positive.",
)
_MARKS = {
    "judged": "judged: ",
    "unsided": "CHECK left and right; the size is judged: ",
    "stated": "unit as the file says; not judged",
    "assumed": "CHECK: ",
}


@dataclass(frozen=True)
class Suggestion:
    """What the draft says of one channel."""

    channel: str
    sources: tuple[str, ...]  # recorded names; several with `convert`, or to be summed
    unit: str | None = None
    scale: float = 1.0
    convert: str = ""
    world: str = ""
    # ``judged`` (a relation to other channels holds), ``unsided`` (the same, but nothing tells left from right),
    # ``stated`` (the file gives the unit, nothing judges it), ``assumed`` (nobody gives the unit, nothing judges
    # it) or ``open`` (left out, with the reason).
    status: str = "assumed"
    reason: str = ""
    offset: float = 0.0  # added after `scale`, in `unit`
    command: bool = False  # whether the name says that it was asked for, not measured
    # Whether the unit is that of ROS messages, which the recording itself does not state.
    by_convention: bool = False
    foreign_unit: str = ""  # what the file states where a unit stands, and is none that is known
    # Of a steering signal, |angle| over curvature [m] as recorded: wheelbase times ratio, and more by understeer.
    reach: float | None = None
    along_the_fix: bool = False  # of X and Y: whether a satellite fix beside them shows that they are east and north

    @property
    def never_changes(self) -> bool:
        """Whether it is left out since it holds one value from end to end."""
        return self.reason.startswith("never changes")

    def left_open(self, reason: str) -> "Suggestion":
        """Return the suggestion left out of the map, with the reason."""
        return replace(self, status="open", reason=reason)


@dataclass(frozen=True)
class Draft:
    """A drafted map."""

    suggestions: tuple[Suggestion, ...]
    time: str  # the map's line for the time, a comment where none was found
    unused: tuple[str, ...]
    undefined: tuple[str, ...] = ()  # message types that cannot be read, for want of a definition
    left: str = ""  # what decides which side is left; empty where nothing does
    hints: tuple[str, ...] = ()  # what to do with a file of another form than a column for each signal
    # What the vertical axis of the accelerometer tells of left and right, where nothing else does.
    by_gravity: str = ""
    presets: tuple[str, ...] = ()  # whose sources are all recorded
    gap: float = 0.0  # what --gap must be for a motion so slowly recorded that ingest refuses it [s]; else 0
    rows: str = ""  # the map's line that chooses one of several cars; empty where there is one
    cars: str = ""  # of columns of several cars: which are taken; empty where there is one

    def of(self, channel: str) -> Suggestion | None:
        """Return what is said of a channel, None when nothing is."""
        return next(iter(self.all_of(channel)), None)

    def all_of(self, channel: str) -> list[Suggestion]:
        """Return all that is said of a channel: of each signal that may be it."""
        return [s for s in self.suggestions if s.channel == channel]


WHAT_GIVES_R = (
    "a gyro or a heading will do; export it if the logger has one. Where v_x with a_y or with X, Y is recorded, "
    f"--derive {WITHOUT_RATE} stands in for it."
)
SIDESLIP_OF_TIRES = (
    "No gyro or heading was found: r and v_y follow from a_y, and the rear tyres of the vehicle file are taken as "
    "right. Such a drive shows how much the car understeers, and nothing of its sideslip; it is not diagnosed. "
    "Export a gyro or a heading if the logger has one."
)
NO_SIDE = "no channel has a side"
"""Of `Draft.left`, where nothing of the recording has one."""


def render_draft(draft: Draft, name: str) -> str:
    """Return a drafted map as YAML text."""
    lines = [
        f"# A draft for {name}. `judged`: the channel fits the others. `CHECK`: nothing judged it, look at it.",
        "# The ratio of a relation is its measured slope; it is 1 where both sides agree.",
        "name: draft",
        *(f"# {line}" for line in lines_on_presets(draft.presets)),
        draft.time,
        *([draft.rows] if draft.rows else []),
        *([f"# CHECK: the log {draft.cars}. For another car, write its names."] if draft.cars else []),
        "frame: flu   # or frd: y right, z down",
        "channels:",
    ]
    for s in draft.suggestions:
        if s.status != "open":
            by_ros = s.by_convention and s.status == "stated"
            mark = "as ROS has it; not judged" if by_ros else _MARKS[s.status]
            lines.append(f"  {s.channel}: {_entry(s)}   # {mark}{s.reason}")
    lines += [f"  # open: {text}" for text in _texts_of_open([s for s in draft.suggestions if s.status == "open"])]
    if not draft.left:
        lines += [f"# {line}" for line in (*_NO_LEFT, draft.by_gravity) if line]
    elif draft.left != NO_SIDE:
        lines.append(f"# Left and right are determined by {draft.left}.")
    mapped = {s.channel for s in draft.suggestions if s.status != "open"}
    missing = [channel for channel in REQUIRED_CHANNELS if channel not in mapped]
    if missing:
        lines.append(f"# Required and not found: {', '.join(missing)}.")
    lines += [f"# {text}" for text in _ways(missing, mapped, {s.channel for s in draft.suggestions} - mapped)]
    lines += [f"# {text}" for text in lines_on_runs(draft)]
    if draft.undefined:
        shown = ", ".join(draft.undefined[:12])
        lines.append(f"# Types that the recording does not define: {shown}. Give their .msg files: --msg-path.")
    if draft.unused:
        unused = in_ranges([name.replace("\n", " ") for name in draft.unused])
        lines.append(f"# Not used: {', '.join(unused[:40])}{' ...' if len(unused) > 40 else ''}")
    return "\n".join(lines)


def _texts_of_open(left: Sequence[Suggestion]) -> list[str]:
    """Return what is said of signals left out; those of a channel that never change or are empty share a line."""
    alike: dict[tuple[str, str], list[Suggestion]] = {}
    for s in left:
        kind = "never change" if s.never_changes else "are nearly empty" if s.reason == "nearly empty" else s.reason
        alike.setdefault((s.channel, kind), []).append(s)
    texts = []
    for (channel, kind), group in alike.items():
        names = in_ranges([", ".join(s.sources) for s in group])
        shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
        texts.append(f"{channel} from {shown}: {kind if len(group) > 1 else group[0].reason}")
    return texts


def lines_on_presets(presets: Sequence[str]) -> tuple[str, ...]:
    """Return in a sentence that maps of the project fit a log; nothing where none does."""
    if not presets:
        return ()
    fit = f"preset {presets[0]} fits" if len(presets) == 1 else f"presets {', '.join(presets)} fit"
    return (f"The {fit} this log: --map {presets[0]} can replace this draft. --list-maps says what it is for.",)


def line_on_cars(cars: SeveralCars) -> str:
    """Return the map's line that takes the rows of one of several cars: the one with the most."""
    return f"rows: {{{quoted(cars.column)}: {quoted(next(iter(cars.counts)))}}}   # CHECK: the log {cars.describe()}"


def lines_on_runs(draft: Draft) -> tuple[str, ...]:
    """Return in a sentence that an array of structures holds further runs; nothing where it does not."""
    mapped = [name for s in draft.suggestions if s.status != "open" for name in s.sources]
    taken, unused = (
        [match for name in names if (match := re.fullmatch(r"(.+)\[(\d+)\]\.(.+)", name))]
        for names in (mapped, draft.unused)
    )
    fields = {(one[1], one[3]) for one in taken}
    others = in_ranges([*dict.fromkeys(f"{one[1]}[{one[2]}]" for one in unused if (one[1], one[3]) in fields)])
    if not others:
        return ()
    chosen = ", ".join(sorted({f"{one[1]}[{one[2]}]" for one in taken}))
    return (
        f"The map takes {chosen}; {', '.join(others)} {'has' if len(others) == 1 else 'have'} the same fields. "
        "Each that is another run needs a copy of the map with its number.",
    )


_NOTES = {
    "torque-from-acceleration": " (it says nothing of the drive train), or from pedals",
    "velocity-from-pose": " (at the point of X, Y: add `position: rear_axle` to both if that is there)",
    "lateral-velocity-from-accelerations": " (a_y - v_x r, held where driving is gentle)",
}


def _ways(missing: Sequence[str], mapped: set[str], opened: set[str]) -> list[str]:
    """Return how missing channels can be derived from what is mapped."""
    chosen = derivations_for(missing, mapped)
    made = {channel for name in chosen for channel in DERIVATIONS[name].makes}
    makes = {name: DERIVATIONS[name].makes for name in chosen}
    shown = {name: [c for c in made if c in missing] or made for name, made in makes.items()}
    ways = [f"{', '.join(shown[name])}: --derive {name}{_NOTES.get(name, '')}." for name in chosen]
    if "vy" in missing and WITHOUT_RATE in chosen:
        ways.append(SIDESLIP_OF_TIRES)
    if "vy" in missing and "vy" not in made:
        ways.append("vy: neither lateral velocity, sideslip, pose nor yaw rate with a_y was found; it takes one.")
    if "r" in missing and "r" not in made:
        ways.append(f"r: {WHAT_GIVES_R}")
    if "delta" in missing and not opened & {"delta", "steering_wheel_angle"}:
        ways.append("delta: no steering angle was found. Training and diagnosis need one, measured or commanded.")
    return ways


def _entry(s: Suggestion) -> str:
    if s.convert == "sum":
        unit = f", unit: {quoted(s.unit)}" if s.unit else ""
        return "{sum: [" + ", ".join(f"{{source: {quoted(n)}{unit}}}" for n in s.sources) + "]}"
    source = quoted(s.sources[0]) if len(s.sources) == 1 else "[" + ", ".join(map(quoted, s.sources)) + "]"
    parts = [f"source: {source}"]
    if s.convert:
        parts.append(f"convert: {s.convert}")
    if s.convert in ("", "pair_mean", "signed"):
        unit = s.unit or UNITS_OF.get(s.channel) or expected_unit(s.channel)
        parts += [f"unit: {quoted(unit)}"] if unit else []
    elif s.unit and getattr(find_unit(s.unit), "si", "m") == "rad" and s.convert in ("local_x", "local_y"):
        parts.append(f"unit: {quoted(s.unit)}")
    if s.scale != 1.0:
        parts.append(f"scale: {s.scale:g}")
    if s.offset != 0.0:
        parts.append(f"offset: {s.offset:.6g}")
    if s.world:
        parts.append(f"world: {s.world}")
    if s.command and s.channel in ("T", "delta"):
        parts.append("kind: command")
    return "{" + ", ".join(parts) + "}"


def in_ranges(names: Sequence[str]) -> list[str]:
    """Return names in their order; three or more that differ in one last number stand as one, with its range."""
    numbered = [re.fullmatch(r"(.*?)(\d+)(\D?)", name) for name in names]
    ranges: dict[tuple[str, str], list[int]] = {}
    for match in numbered:
        if match is not None:
            ranges.setdefault((match[1], match[3]), []).append(int(match[2]))
    shown: dict[str, None] = {}
    for name, match in zip(names, numbered, strict=True):
        among = ranges[match[1], match[3]] if match is not None else []
        shown[f"{match[1]}{min(among)}..{max(among)}{match[3]}" if len(among) > 2 else name] = None
    return list(shown)


def quoted(text: str) -> str:
    """Return a name as YAML writes it, in quotes where it needs them."""
    return text if re.fullmatch(r"[A-Za-z_][\w./ ^-]*", text) else json.dumps(text, ensure_ascii=False)
