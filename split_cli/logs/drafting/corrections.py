"""What the consistency checks change in a draft: units nobody states, signs, hands, the zero of yaw."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.logs.assembling.conversion import expected_unit
from split_cli.logs.checking.consistency import Consistency
from split_cli.logs.checking.relations import SHARED, Relation
from split_cli.logs.checking.wheel_speeds import AXLES
from split_cli.logs.drafting.draft import UNITS_OF, Suggestion
from split_cli.logs.drafting.handedness import HANDED, is_heading, path_is_certain
from split_cli.logs.drafting.trial import Trial
from split_cli.signals import find_unit

_UNIT_BY_FACTOR = {
    **{(channel, 3.6): "km/h" for channel in ("vx", "vy")},
    **{(channel, 2.237): "mph" for channel in ("vx", "vy")},
    **{(channel, 1.944): "kn" for channel in ("vx", "vy")},
    **{(channel, 3.281): "ft/s" for channel in ("vx", "vy")},
    **{(channel, 100.0): "cm/s" for channel in ("vx", "vy")},
    **{(channel, 1000.0): "mm/s" for channel in ("vx", "vy")},
    ("r", 57.3): "deg/s",
    ("yaw", 57.3): "deg",
    ("delta", 57.3): "deg",
    ("ax", 0.102): "g",
    ("ay", 0.102): "g",
}
_SIBLINGS = {
    "vy": ("vx",),
    "vx": ("vy",),
    "ay": ("ax",),
    "ax": ("ay",),
    "yaw": ("r",),
    "r": ("yaw",),
    "sideslip": ("yaw", "r"),
}
_TWICE = 0.5
"""Units of speed of less [m/s] make a rate more than twice as large as it is."""
_SYMBOLS = {"ax": "a_x against", "ay": "a_y against", "r": "r against", "vx": "v_x against"}
"""How checks that judge a channel begin."""
_STATED = "; unit as the file says"
_ANGLE_OF_RATE = {"deg/s": "deg", "rad/s": "rad", "deg": "deg/s", "rad": "rad/s"}


def correct(chosen: dict[str, Suggestion], trial: Trial) -> tuple[dict[str, Suggestion], Consistency]:
    """Set units that nobody states, and signs, as the checks say, until they say nothing more."""
    undisputed = "X" not in chosen or path_is_certain(chosen)
    if "yaw" in chosen and undisputed and is_heading(chosen["yaw"], trial.signals):
        chosen = {**chosen, "yaw": _as_compass(chosen["yaw"])}
    verdict = trial.judge(chosen)
    for _ in range(4):
        changed = False
        # Units first: whether an angle is a compass bearing shows in degrees.
        for channel, factor in sorted(verdict.factors.items(), key=lambda entry: entry[0] == "hand"):
            if channel == "hand":
                chosen = _other_hand(chosen, trial)
                changed = True
            elif channel in chosen and not (channel == "vx" and factor == -1.0 and _may_reverse(verdict)):
                better = _corrected(chosen[channel], factor)
                if channel == "yaw" and factor < 0.0 and is_heading(better, trial.signals):
                    better = _as_compass(better)
                changed |= better != chosen[channel]
                chosen = {**chosen, channel: better}
                if channel == "X" and better.unit:
                    chosen["Y"] = replace(chosen["Y"], unit=better.unit)
        swapped = {f.channel for f in verdict.findings if f.check == "swapped"}
        alone = {} if {"vx", "X", "yaw"} & set(chosen) else trial.speed_of_wheels(chosen)
        inner = bool(alone) and trial.inner_wheels_are_faster({**alone, **trial.columns(chosen)})
        if inner or ({left for left, _ in AXLES} <= swapped and not {"X", "yaw"} & set(chosen)):
            turned = _right_positive(chosen, "right-positive, as the wheels outside a turn show")
            # All of the car's channels, or the yaw rate alone: as they fit each other.
            ways = [{**chosen, **turned}, {**chosen, **{c: s for c, s in turned.items() if c == "r"}}]
            chosen = min(ways, key=lambda way: trial.judge(way).cost)
            changed = True
        if {"ax", "ay"} <= swapped:
            remark = "along this axis by the data, not by its name"
            pair = (("ax", chosen["ay"]), ("ay", chosen["ax"]))
            chosen = {**chosen, **{c: replace(s, channel=c, scale=abs(s.scale), reason=remark) for c, s in pair}}
            changed = True
        for finding in verdict.findings:
            if finding.check == "compass" and "yaw" in chosen:
                chosen = {**chosen, "yaw": _as_compass(chosen["yaw"])}
                changed = True
            elif finding.check == "direction" and "yaw" in chosen and finding.measured is not None:
                chosen = {**chosen, "yaw": _with_zero(chosen["yaw"], finding.measured)}
                changed = True
        if not changed:
            break
        verdict = trial.judge(chosen)
    return chosen, verdict


def _may_reverse(verdict: Consistency) -> bool:
    """Whether only the speed of a path contradicts the sign of v_x: then the car may have driven backwards."""
    others = [r for r in verdict.relations if "vx" in r.powers and "X" not in r.powers]
    return not any(r.slope.slope < 0.0 for r in others)


def _as_compass(yaw: Suggestion) -> Suggestion:
    return replace(yaw, scale=1.0, offset=0.0, world="ned", reason="a compass bearing, or a course if of GPS")


def as_siblings(chosen: dict[str, Suggestion], verdict: Consistency) -> dict[str, Suggestion]:
    """Give a channel whose unit nobody states and nothing judges the unit of the one beside it in the file.

    A file that has v_x in km/h has v_y so too; that stays an assumption, and is marked as one.
    """
    judged = {channel for r in verdict.relations if r.holds for channel in r.powers}
    made = dict(chosen)
    for channel, others in _SIBLINGS.items():
        s = made.get(channel)
        if s is None or s.unit is not None or channel in judged:
            continue
        other = next((made[o] for o in others if o in made and made[o].unit and o in judged), None)
        if other is None or other.unit is None:
            continue
        rate = other.channel == "r" or channel == "r"
        unit = _ANGLE_OF_RATE.get(other.unit) if rate else other.unit
        if channel == "vy" and find_unit(unit or "m/s").factor < _TWICE and _a_y_goes_with_its_rate(verdict):
            # In the other unit its rate would be more than twice as large, and a_y would go better without it.
            made[channel] = replace(s, reason="a_y goes better with dv_y/dt in m/s^2")
        elif unit is not None:
            made[channel] = replace(s, unit=unit, reason=f"taken in {unit} as {other.channel} has it")
    return made


def _a_y_goes_with_its_rate(verdict: Consistency) -> bool:
    return any(r.holds and r.leaf == "ay" and r.name.endswith("dv_y/dt") for r in verdict.relations)


def _with_zero(s: Suggestion, shift: float) -> Suggestion:
    """Return yaw counted from the axis X: an angle [rad] is added to what `world` and unit make of it."""
    unit = find_unit(s.unit).factor if s.unit and find_unit(s.unit) else 1.0
    own = -shift if s.world == "ned" else shift
    remark = f"its zero is {np.degrees(-shift):.4g} deg off X"
    return replace(s, offset=s.offset + own / unit, reason=f"{s.reason}; {remark}" if s.reason else remark)


def _other_hand(chosen: dict[str, Suggestion], trial: Trial) -> dict[str, Suggestion]:
    """Resolve a car that turns the other way than its path: exchange X and Y, or turn the car's channels.

    North and east of a satellite fix, or so called, are what they are. An angle of 0 to 360 degrees that is called
    a heading counts clockwise from north. With either the car's channels are right-positive.
    """
    turned = _right_positive(chosen, "right-positive, as the path shows")
    yaw = chosen.get("yaw")
    if not path_is_certain(chosen) and not (yaw is not None and is_heading(yaw, trial.signals)):
        remark = "exchanged with the other, or the car's channels are right-positive: nothing recorded decides"
        pair = (("X", chosen["Y"]), ("Y", chosen["X"]))
        return {**chosen, **{c: replace(s, channel=c, reason=remark) for c, s in pair}}
    if yaw is not None and yaw.world != "ned":
        turned["yaw"] = _as_compass(yaw)
    return {**chosen, **turned}


def _right_positive(chosen: Mapping[str, Suggestion], why: str) -> dict[str, Suggestion]:
    """Return the car's channels that a right-positive logger turns, turned."""
    return {c: replace(s, scale=-s.scale, reason=why) for c, s in chosen.items() if c in ("r", "vy", "ay")}


def _corrected(s: Suggestion, factor: float) -> Suggestion:
    size = abs(factor)
    known = [(f, u) for (c, f), u in _UNIT_BY_FACTOR.items() if c == s.channel]
    unit = next((u for f, u in known if abs(size / f - 1.0) < 0.03), None)
    if s.channel == "X" and size != 1.0:
        unit = {0.3048: "ft", 1000.0: "km", 0.01: "cm", 0.001: "mm"}.get(round(1.0 / size, 4))
    if s.channel.startswith("wheel_speed"):
        unit = {3.6: "km/h", 2.237: "mph", 1.944: "kn"}.get(round(size, 3))
    turned = factor < 0.0
    if s.status == "stated" and size != 1.0 and not s.by_convention:
        return s  # the file states a unit: a finding tells of the contradiction
    if size == 1.0:
        return replace(s, scale=-s.scale, reason=_beside(s.reason, "its sign is turned")) if turned else s
    if unit is None:
        return s
    reason = _beside(s.reason, f"found to be in {unit}")
    return replace(s, unit=unit, scale=-s.scale if turned else s.scale, reason=reason)


def _beside(reason: str, remark: str) -> str:
    """Return a further thing to say, behind what was said before."""
    return remark if not reason or remark in reason else f"{reason}; {remark}"


def as_others_turn(chosen: dict[str, Suggestion], verdict: Consistency) -> dict[str, Suggestion]:
    """Turn a channel whose side nothing judges where the log's yaw rate was found to be right-positive.

    One logger has one hand; that stays an assumption, and is marked as one.
    """
    if "r" not in chosen or chosen["r"].scale > 0.0 or chosen["r"].convert:
        return chosen
    judged = {channel for r in verdict.relations if r.holds for channel in r.powers}
    why = "taken as right-positive, since r is"
    return {
        c: replace(s, scale=-s.scale, status="assumed", reason=f"{why}{_STATED if s.status == 'stated' else ''}")
        if c in ("vy", "ay", "sideslip") and c not in judged and s.scale > 0.0
        else s
        for c, s in chosen.items()
    }


_TURNING = {"r", "yaw"}


def _agree_in_any_unit(s: Suggestion, chosen: Mapping[str, Suggestion], verdict: Consistency) -> bool:
    """Whether yaw or its rate, in no stated unit, agrees with the other alone: in degrees both would too."""
    if s.channel not in _TURNING or any(chosen[c].status == "stated" for c in _TURNING & set(chosen)):
        return False
    holding = [set(r.powers) for r in verdict.relations if r.holds and _TURNING & set(r.powers)]
    return bool(holding) and all(powers == _TURNING for powers in holding)


def with_status(s: Suggestion, chosen: Mapping[str, Suggestion], verdict: Consistency) -> Suggestion:
    """Say what supports or contradicts a suggestion."""
    faults = ("scale", "sign", "range", "constant", "swapped", "contradiction", "course")
    wrong = [f for f in verdict.findings if f.channel == s.channel and f.check in faults]
    speed = _speed_at_fault(chosen, verdict)
    if speed is not None and s.channel == "vx":
        return s.left_open(speed)
    if speed is not None and s.channel in ("X", "Y"):
        wrong = [f for f in wrong if f.check != "scale"]
    if wrong:
        return s.left_open(wrong[0].text)
    undecided = [f for f in verdict.findings if f.check in ("sign", "hand") and f.channel in ("r", "yaw", "X")]
    if undecided and s.channel in HANDED:
        return s.left_open(f"left or right positive is undecided: {undecided[0].text}")
    key = {"Y": "X"}.get(s.channel, s.channel)
    keys = {key, "hand"} if key == "X" else {key}
    # What agrees with a channel that no car's can be has it for a companion, not for a judge.
    beyond = {f.channel for f in verdict.findings if f.check == "range"}
    holding = [r for r in verdict.relations if r.holds and keys & set(r.powers) and not beyond & set(r.powers)]
    remark = f"{s.reason}; " if s.reason else ""
    unit = s.unit or UNITS_OF.get(s.channel) or expected_unit(s.channel) or "1"
    if _agree_in_any_unit(s, chosen, verdict):
        return replace(s, unit=unit, reason=f"{remark}unit not stated, {unit} assumed: r and yaw agree in degrees too")
    if holding and _turns_alone(s, key, holding):
        shown = f"{holding[0].name}: ratio {holding[0].slope.slope:.3g}, of any unit of length"
        return replace(s, unit=unit, reason=f"{_assumed(s, unit)}, and nothing judges its size: {shown}")
    if holding:
        notes = [f"; note: {f.text}" for f in verdict.findings if f.channel == s.channel]
        shown = "; ".join(f"{r.name}: ratio {r.slope.slope:.3g}" for r in holding[:3])
        if against := _better_blamed(s.channel, holding, verdict):
            doubt = f"its scale: {against.name} {against.slope.slope:.3g}, and with that factor in {s.channel}"
            return replace(s, unit=unit, status="assumed", reason=f"{remark}{doubt} the others fit better: {shown}")
        return replace(s, status="judged", reason=f"{remark}{shown}{''.join(notes[:1])}")
    if s.status == "stated":
        return replace(s, reason=f"{'; ' + s.reason if s.reason else ''}")
    return replace(s, unit=unit, reason=f"{_assumed(s, unit)}, and {_who_could_judge(s, verdict)}")


def _turns_alone(s: Suggestion, key: str, holding: Sequence[Relation]) -> bool:
    """Whether what agrees with a position of no stated unit is its turning, which is the same in feet and in counts."""
    known = s.status == "stated" or s.unit is not None or bool(s.convert)
    return key == "X" and not known and not any("X" in r.powers for r in holding)


def _better_blamed(channel: str, holding: Sequence[Relation], verdict: Consistency) -> Relation | None:
    """Return a relation that fails, and whose factor in this channel would make all that hold fit better."""
    unexplained = {f.channel for f in verdict.findings if f.check == "scale"} - verdict.factors.keys()
    for failed in verdict.relations:
        if failed.holds or failed.leaf not in unexplained or failed.slope.slope < 0.0 or channel not in SHARED:
            continue
        power = failed.powers.get(channel, 0)
        if not power or failed.corrected is not None or failed.leaf == channel:
            continue
        factors = {channel: failed.slope.slope ** (1.0 / power)}
        left = [(r.slope.slope, r.without(factors)) for r in holding]
        if all(after > 0.0 and abs(np.log(after)) < abs(np.log(before)) for before, after in left):
            return failed
    return None


def _speed_at_fault(chosen: Mapping[str, Suggestion], verdict: Consistency) -> str | None:
    """Return why v_x is left out for the pose, where what else was recorded sides with the pose; None where not."""
    if not {"vx", "X", "Y", "yaw"} <= chosen.keys():
        return None
    failed = _better_blamed("vx", [r for r in verdict.relations if r.holds and "vx" in r.powers], verdict)
    if failed is None or failed.leaf not in ("X", "hand") or set(failed.powers) - {"vx", "X", "hand"}:
        return None
    beside = next(r for r in verdict.relations if r.holds and "vx" in r.powers)
    return (
        f"{failed.name} {failed.slope.slope:.3g}, and {beside.name} {beside.slope.slope:.3g} fits better with that "
        "factor in vx: its scale is wrong, or the wheels slip. `--derive velocity-from-pose` takes v_x from X, Y, yaw"
    )


def _assumed(s: Suggestion, unit: str) -> str:
    """Say what is taken for granted of a unit that nothing judges, behind what was said of the channel."""
    if s.reason.endswith(_STATED):
        return s.reason
    assumed = "unit not stated" if s.unit else f"unit not stated, {unit} assumed"
    if s.foreign_unit and not s.unit:
        assumed = f"the file says {s.foreign_unit!r}, which is no known unit; {unit} assumed"
    return f"{s.reason}; {assumed}" if s.reason else assumed


def _who_could_judge(s: Suggestion, verdict: Consistency) -> str:
    """Say which check would have judged a channel, and why it could not."""
    tried = next((u for u in verdict.unjudged if u.check.startswith(_SYMBOLS.get(s.channel, "-"))), None)
    return f"not judged ({tried.check}: {tried.reason})" if tried is not None else "nothing judges it"
