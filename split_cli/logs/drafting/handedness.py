"""Which side is left: what of a recording is beyond doubt, and what to say where nothing is."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.logs.checking.relations import Relation
from split_cli.logs.drafting.draft import NO_SIDE, Suggestion
from split_cli.logs.drafting.vocabulary import concepts_of, tokens_of
from split_cli.logs.raw import RawChannelInfo, RawSignal
from split_cli.signals import find_unit

NOT_UP = "z is not up"
"""Said of channels that were taken from another axis than the names say."""
HANDED = ("r", "vy", "ay", "yaw", "delta", "steering_wheel_angle", "sideslip")
"""Channels whose sign says left or right."""


_HEADING = re.compile("head|hdg|azimuth|bearing|kurs", re.IGNORECASE)


def path_is_certain(chosen: Mapping[str, Suggestion]) -> bool:
    """Tell whether X, Y are east and north: of a satellite fix, along one, or so called."""
    if not {"X", "Y"} <= set(chosen):
        return False
    if chosen["X"].along_the_fix and chosen["Y"].along_the_fix:
        return True
    if chosen["X"].convert == "local_x" and chosen["Y"].convert == "local_y":
        return True
    letters = {"e": "east", "n": "north", "pe": "east", "pn": "north"}
    # posE is no pose.
    words = [tokens_of(re.sub("pos(?=[EN])", "pos_", chosen[c].sources[0])) for c in "XY"]
    named = [concepts_of(w)[0] | {letters[one] for one in w if one in letters} for w in words]
    return "east" in named[0] and "north" in named[1]


def _compass_is_certain(chosen: Mapping[str, Suggestion]) -> bool:
    """Tell whether yaw is counted clockwise from an axis that is north.

    Beside a position whose level axes only the motion shows, it is a compass in a left-handed world (x to the
    right, z ahead), and in a right-handed one (z back) a mirrored log looks the same.
    """
    of_names = "X" not in chosen or NOT_UP not in chosen["X"].reason
    return "yaw" in chosen and chosen["yaw"].world == "ned" and of_names


def is_heading(s: Suggestion, signals: Mapping[str, RawSignal]) -> bool:
    """Tell whether an angle is named a heading and runs from 0 to 360 degrees, as a compass does."""
    if s.convert or not _HEADING.search(s.sources[0]):
        return False
    values = signals[s.sources[0]].values
    finite = values[np.isfinite(values)]
    unit = find_unit(s.unit or "rad")
    whole = 2.0 * np.pi / (unit.factor if unit is not None else 1.0) * (1.0 + 1e-9)
    return bool(finite.min() >= 0.0 and finite.max() <= whole and finite.max() > 0.5 * whole)


def as_bearing_by_name(s: Suggestion, chosen: Mapping[str, Suggestion], values: np.ndarray | None) -> Suggestion:
    """Take a heading beside a satellite fix that nothing judged as a compass has it, to be confirmed.

    Of a car that stands or drives straight neither its range nor its turning tells how it is counted.
    """
    by_custom = s.status in ("stated", "assumed") and not s.world and not s.convert and _HEADING.search(s.sources[0])
    if not by_custom or values is None or not path_is_certain(chosen):
        return s
    why = "a heading is a compass bearing by custom, and it turns too little here to show how it is counted"
    if np.nanmin(values) < 0.0:
        return replace(s, status="assumed", reason=f"{why}: with `world: ned`, if so")
    return replace(s, world="ned", status="assumed", reason=why)


def certain_of(chosen: Mapping[str, Suggestion]) -> frozenset[str]:
    """Return what of a choice no mistake of hand is looked for in, as `check_consistency` takes it."""
    certain = {"hand"} if path_is_certain(chosen) else set()
    if "yaw" in chosen and chosen["yaw"].world == "ned" and "X" not in chosen:
        certain.add("yaw")
    return frozenset(certain)


def what_tells_left(
    chosen: Mapping[str, Suggestion], infos: Sequence[RawChannelInfo], outer_wheels_are_faster: bool = False
) -> str:
    """Return what decides which side is left, empty where nothing does or no channel has a side.

    Messages of ROS are left-positive by its conventions (REP 103), which their types show. An address with slashes
    of a bus or another logger shows none.
    """
    of_ros = {info.name.rpartition("/")[0] for info in infos if "/" in info.type_name}
    if not set(HANDED) & set(chosen):
        return NO_SIDE
    if path_is_certain(chosen):
        return "the satellite fix that X, Y run along" if chosen["X"].along_the_fix else "east and north"
    if _compass_is_certain(chosen):
        return "the compass"
    if any(s.sources[0].rpartition("/")[0] in of_ros and c in HANDED for c, s in chosen.items()):
        return "the conventions of ROS"
    if any("right by its name" in s.reason for s in chosen.values()):
        return "names"
    return "the wheels outside a turn, which are faster" if outer_wheels_are_faster else ""


def without_a_side(s: Suggestion) -> Suggestion:
    """Return a suggestion that was judged as one whose side was not, where nothing recorded tells left from right.

    A recording that is mirrored as a whole agrees with itself: relations between its channels see sizes only. Of
    axes that are not as named, the one across points left or right, and what nothing supports of it is left open.
    """
    if s.channel in HANDED and NOT_UP in s.reason and s.status in ("assumed", "stated"):
        why = next(part for part in s.reason.split("; ") if NOT_UP in part)
        remark = f"{why}; with `scale: -1` if positive is to the right"
        return s.left_open(remark)
    return replace(s, status="unsided") if s.status == "judged" and s.channel in (*HANDED, "X", "Y") else s


def channels_with_a_side(chosen: Mapping[str, Suggestion], relations: Sequence[Relation], by_wheels: bool) -> set[str]:
    """Return the channels whose side is known: related, directly or by steps, to what knows left from right.

    East and north say nothing of a yaw rate that does not follow the turning of X, Y.
    """
    reached = {"hand"} if path_is_certain(chosen) else set()
    reached |= {"yaw"} if _compass_is_certain(chosen) else set()
    reached |= {"r"} if by_wheels else set()
    sided = {"hand", *HANDED}
    links = [
        (sided & set(r.powers)) | ({"hand"} if r.of_the_world or "X, Y" in r.name else set())
        for r in relations
        if r.holds
    ]
    while grown := {channel for link in links if link & reached for channel in link} - reached:
        reached |= grown
    return reached | ({"delta", "steering_wheel_angle"} if "r" in reached else set())


def without_its_side(s: Suggestion) -> Suggestion:
    """Return a suggestion marked as one whose side nothing tells, though the recording has what could."""
    if s.status == "judged":
        return replace(s, status="unsided")
    return replace(s, status="assumed", reason=f"its sign: it goes with X, Y too loosely to tell left{s.reason}")
