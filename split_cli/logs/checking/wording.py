"""The best explanation of what does not fit together, put into findings with evidence, remedy and rivals."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.logs.checking.mistakes import COMMON, OTHER_RADIUS, Mistake, known_mistakes
from split_cli.logs.checking.relations import OF_THE_BODY, ConsistencyFinding, Leaf, Plausible, Relation, Story

_ALIKE = 1.01
"""Largest ratio of two wheels' factors that are one [1]: tyres of one car wear by less."""


def tell(
    best: Story, rivals: Sequence[Story], relations: Sequence[Relation], beyond: Sequence[Plausible]
) -> list[ConsistencyFinding]:
    """Put the best story into words, with its rivals."""
    broken = [relation for relation in relations if not relation.holds]
    opposite = next((s for s in rivals if {s.axes, best.axes} == {"world", "car"}), None)
    if opposite is not None:
        # Mirrored as a whole, the pose and the car contradict each other alike: one question, told as one.
        rivals = [s for s in rivals if s is not opposite]
        world, car = (best, opposite) if best.axes == "world" else (opposite, best)
        rest = _without_the_mirrored(best)
        return [*_opposite_hands(world, car, broken), *tell(rest, rivals, relations, beyond)]
    others = [_in_words(story) for story in rivals]
    others = list(dict.fromkeys(others))[:3]
    alternative = f" Or: {'; or '.join(others)}: nothing recorded decides." if others else ""
    reach = [
        f"{' '.join([m.name, f'reaches {m.value:.3g}', m.unit]).strip()}, no car's exceeds {m.high:g}" for m in beyond
    ]
    # What every story says is not in doubt.
    doubt = {m: "" if all(m in rival.mistakes for rival in rivals) else alternative for m in best.mistakes}
    found = [_finding(mistake, broken, doubt[mistake], (), reach) for mistake in best.shared]
    alike = _wheels_alike(best)
    found += [_of_all_wheels(alike, alternative)] if alike else []
    found += _of_leaves([leaf for leaf in best.leaves if leaf not in alike], doubt, alternative)
    left_over = {m.channel: m.high for m in best.mistakes}
    for magnitude, words in zip(beyond, reach, strict=True):
        if magnitude.cost(left_over) > 0.0:
            first = next(iter(magnitude.powers))
            units = _units_that_help(magnitude)
            text = f"{words}: check the unit of {' and '.join(magnitude.powers)}{units}.{alternative}"
            found.append(ConsistencyFinding("range", first, text, magnitude.value))
    return found


def _without_the_mirrored(story: Story) -> Story:
    """Return a story without what it says of axes that are mirrored as a whole."""
    shared = tuple(m for m in story.shared if m.channel not in story.mirrored)
    leaves = tuple(leaf for leaf in story.leaves if leaf.relation.leaf not in story.mirrored)
    return replace(story, shared=shared, leaves=leaves, axes="")


def _of_leaves(leaves: Sequence[Leaf], doubt: Mapping[Mistake, str], alternative: str) -> Iterator[ConsistencyFinding]:
    """Yield what is said of channels that judge no other; of wheels that are off alike, once in full."""
    wheels: set[str] = set()
    for leaf in leaves:
        if leaf.mistake is not None:
            one = _finding(leaf.mistake, [leaf.relation], doubt[leaf.mistake], leaf.rivals)
            if leaf.relation.leaf.startswith("wheel_speed"):
                slope = leaf.relation.slope.slope
                likewise = f"{one.channel} likewise (slope {slope:.4g}): {leaf.mistake.what}"
                one = replace(one, text=likewise) if leaf.mistake.what in wheels else one
                wheels.add(leaf.mistake.what)
            yield one
        elif leaf.unknown:
            yield _unexplained(leaf, alternative)


def _wheels_alike(story: Story) -> list[Leaf]:
    """Return the wheel speeds that are all off by one factor that no unit explains; none where they differ.

    An axle that just keeps within the tolerance is off as the other one is, where both have the same factor.
    """
    wheels = [leaf for leaf in story.leaves if leaf.relation.leaf.startswith("wheel_speed")]
    slopes = [leaf.relation.slope.slope for leaf in wheels]
    off = [leaf for leaf in wheels if leaf.mistake is not None and leaf.mistake.what == OTHER_RADIUS]
    rolling = all(leaf in off or (leaf.mistake is None and not leaf.unknown) for leaf in wheels)
    return wheels if len(off) > 1 and rolling and max(slopes) < _ALIKE * min(slopes) else []


def _of_all_wheels(wheels: Sequence[Leaf], alternative: str) -> ConsistencyFinding:
    """Tell a factor that all wheels share: it may as well be that of v_x."""
    slope = float(np.mean([leaf.relation.slope.slope for leaf in wheels]))
    error = max(leaf.relation.slope.error for leaf in wheels)
    text = (
        f"every wheel speed is {slope:.4g} +- {error:.1g} times vx: the wheels roll on another radius, or vx is "
        f"{1.0 / slope:.4g} times the true speed. Nothing recorded decides. Correct `wheel_radius` in the vehicle "
        f"file where the wheel speeds count turns, else set `scale:` for them, or `scale: {slope:.4g}` for "
        f"vx.{alternative}"
    )
    return ConsistencyFinding("radius", "vx", text, slope, error)


def _units_that_help(magnitude: Plausible) -> str:
    """Say what the usual units would make of a magnitude of one channel that no car reaches."""
    if len(magnitude.powers) != 1:
        return ""
    (channel,) = magnitude.powers
    sizes = {
        m.unit: magnitude.value / m.low
        for m in known_mistakes(channel, None)
        if m.unit and not m.turned and m.cost <= COMMON and magnitude.value <= m.low * magnitude.high
    }
    readings = [f"{unit} would make it {size:.3g}" for unit, size in sizes.items()]
    return f" ({', '.join(readings)} {magnitude.unit})" if readings else ""


def _opposite_hands(world: Story, car: Story, broken: Sequence[Relation]) -> list[ConsistencyFinding]:
    """Tell a pose and a car of opposite hands: north-east-down axes, or forward-right-down ones."""
    shown = [r for r in broken if set(r.powers) & (world.mirrored | car.mirrored)]
    slopes = "; ".join(f"{r.name}: slope {r.slope.slope:.4g}" for r in shown)
    mine = [c for c in ("r", *OF_THE_BODY) if c in car.mirrored]
    text = (
        f"X, Y and yaw have the opposite hand of {', '.join(mine)} ({slopes}). Either the pose is "
        "north-east-down: set `world: ned` in the map. Or the car's signals are right-positive: set `frame: frd`. "
        "Nothing recorded decides: look at one left turn, in which r must be positive."
    )
    return [ConsistencyFinding("hand", "yaw", text, -1.0), ConsistencyFinding("hand", "X", "X, Y: see yaw.", -1.0)]


_AXES_IN_WORDS = {
    "world": "the pose (X, Y, yaw) is north-east-down: `world: ned`",
    "car": "the car's signals are right-positive: `frame: frd`",
}


def _in_words(story: Story) -> str:
    plain = [m for m in story.mistakes if not m.channel.startswith("wheel_speed")]
    plain = [m for m in plain if not (m.channel in story.mirrored and m.low == m.high == 1.0)]
    parts = [_AXES_IN_WORDS[story.axes]] if story.axes else []
    parts += [f"{_name(m.channel)} {m.what}" for m in plain]
    wheels = dict.fromkeys(m.what for m in story.mistakes if m not in plain)
    parts += [f"the wheel speeds: each {what}" for what in wheels]
    parts += [f"{leaf.relation.name} is off by a factor not known" for leaf in story.leaves if leaf.unknown]
    return " and ".join(parts) or "nothing is wrong"


def _finding(
    mistake: Mistake, shown: Sequence[Relation], alternative: str, rivals: Sequence[Mistake], reach: Sequence[str] = ()
) -> ConsistencyFinding:
    shown = [relation for relation in shown if mistake.channel in relation.powers] or list(shown)
    slopes = [
        f"{r.name}: slope {r.slope.slope:.4g} +- {r.slope.error:.1g}, correlation {r.slope.correlation:.3f}"
        for r in shown
    ]
    evidence = "; ".join([*slopes, *reach])
    channel = "X" if mistake.channel == "hand" else mistake.channel
    check = "sign" if mistake.turned and mistake.low == mistake.high == 1.0 else "scale"
    remedy = mistake.remedy[:1].upper() + mistake.remedy[1:]
    text = f"{_name(mistake.channel)} {mistake.what} ({evidence}). {remedy} in the map."
    if rivals:
        text += f" Or it {'; or it '.join(rival.what for rival in rivals)}: nothing recorded decides."
    measured = shown[0].slope if shown else None
    if measured is None:
        return ConsistencyFinding(check, channel, text + alternative)
    return ConsistencyFinding(check, channel, text + alternative, measured.slope, measured.error)


def _unexplained(leaf: Leaf, alternative: str) -> ConsistencyFinding:
    relation, slope = leaf.relation, leaf.relation.slope
    moved = abs(leaf.left / slope.slope - 1.0) > 0.02
    corrected = f", {leaf.left:.4g} with what else was found corrected" if moved else ""
    measured, _, expected = relation.name.partition(" against ")
    cause = "No usual mistake of unit or sign explains that."
    remedy = f"Check the scale of {' and '.join(_name(c) for c in relation.powers)}."
    if {"vx", "X"} <= set(relation.powers):
        if leaf.left < 0.0:
            cause = "The car drives backwards, if v_x is right: that is not modelled, leave it out with --cut."
        else:
            remedy += " Where X, Y are the sure ones, leave vx out, and pass `--derive velocity-from-pose`."
    return ConsistencyFinding(
        "scale" if leaf.left > 0 else "sign",
        "X" if relation.leaf == "hand" else relation.leaf,
        f"{measured} is {slope.slope:.4g} +- {slope.error:.1g} times {expected} "
        f"(correlation {slope.correlation:.3f}{corrected}). {cause} {remedy}{alternative}",
        slope.slope,
        slope.error,
    )


def _name(channel: str) -> str:
    return "X, Y" if channel == "hand" else channel
