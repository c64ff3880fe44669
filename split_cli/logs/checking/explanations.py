"""What accounts best for measured factors between channels: each relation by itself, weighed, several at once."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from split_cli.logs.checking.mistakes import COMMON, Mistake, known_mistakes
from split_cli.logs.checking.relations import (
    OF_THE_BODY,
    OVER_TIME,
    SHARED,
    UNKNOWN,
    ConsistencyFinding,
    Leaf,
    Plausible,
    Relation,
    Story,
)
from split_cli.logs.checking.wording import tell
from split_cli.vehicle.parameters import Vehicle

_EDGE = 2.0
"""Cost of a ratio at the edge of its tolerance, two standard deviations; beyond it nothing is accounted for."""
_RIVAL = 1.5
"""Explanations less than this dearer than the best are reported beside it: odds of less than 5 to 1."""
_SAME_UNIT = 1.0
"""Cost of v_y or a wheel speed in the wrong unit that v_x is in too, and of a_y in that of a_x: of one logger."""
_ONE_MORE_WHEEL = 0.25
_SAME_AXES = 0.5
"""Added to the cost of one turned sign when all channels of the vehicle, or of the world, have other axes."""
_REVERSING = OVER_TIME[:2] + OVER_TIME[3:]
"""Of these the ones that change their sign where time runs backwards; a speed does not."""
_LEAST_REVERSED = 3
"""Relations with the opposite sign that are reported as one mistake [1]: two may be two turned channels."""


@dataclass(frozen=True)
class Explanation:
    """Findings, and the exact signed factors that correct the channels they blame."""

    findings: tuple[ConsistencyFinding, ...] = ()
    # Channel to the factor that is in it; only where one mistake is clearly the best.
    factors: Mapping[str, float] = field(default_factory=dict)
    cost: float = 0.0  # of the best story, 0 where all relations hold [1]
    unexplained: frozenset[str] = frozenset()  # channels whose relations no known mistake accounts for


def explain(relations: Sequence[Relation], vehicle: Vehicle | None, plausible: Sequence[Plausible] = ()) -> Explanation:
    """Name the cheapest set of known mistakes that accounts for the relations.

    Parameters
    ----------
    vehicle : Vehicle, optional
        Its wheel radius tells wheel speeds in rad/s.
    plausible : sequence of Plausible
        Magnitudes that decide between explanations that the relations leave open.

    Returns
    -------
    Explanation
        Without findings when all relations hold. Where several explanations are about equally good, the findings
        tell the others too.

    Notes
    -----
    v_x and r enter several relations, every other channel enters one. For each pair of mistakes in v_x and r the
    best account of every other relation is therefore found by itself, so that any number of mistakes is found
    together, and a relation that nothing accounts for silences no other. The cost of a story is the sum of its
    mistakes' costs (negative logarithms of how frequent they are) and of half the squared misfits, each at most
    the cost of a factor that is not known.
    """
    backwards = _backwards(relations)
    if backwards is not None:
        turned = [_by_this_clock(r, -1.0) if r.name in _REVERSING or r.leaf == "T" else r for r in relations]
        rest = explain(turned, vehicle, plausible)
        return replace(rest, findings=(backwards, *rest.findings), cost=rest.cost + UNKNOWN)
    clock = _clock(relations)
    if clock is not None:
        # What the path's rate of change reaches was measured by this clock.
        plausible = [magnitude for magnitude in plausible if "X" not in magnitude.powers]
        rest = explain([_by_this_clock(r, clock.measured or 1.0) for r in relations], vehicle, plausible)
        return replace(rest, findings=(clock, *rest.findings), cost=rest.cost + UNKNOWN)
    beyond = [magnitude for magnitude in plausible if magnitude.cost({}) > 0.0]
    if all(relation.holds for relation in relations) and not beyond:
        return Explanation()
    stories = sorted(
        (_story(shared, relations, vehicle, plausible) for shared in _shared_choices(relations, vehicle, beyond)),
        key=lambda story: (story.cost, len(story.mistakes)),
    )
    best = stories[0]
    # More than the best says is no rival to it.
    rivals = [s for s in stories[1:] if s.cost < best.cost + _RIVAL and not s.blamed >= best.blamed]
    findings = tell(best, rivals, relations, beyond)
    sure = {m.channel for m in best.mistakes if all(m in rival.mistakes for rival in rivals)}
    doubtful = {leaf.relation.leaf for leaf in best.leaves if leaf.rivals}
    factors = {
        m.channel: m.factor
        for m in best.mistakes
        if m.channel in sure and m.channel not in doubtful and m.factor is not None
    }
    unexplained = frozenset(leaf.relation.leaf for leaf in best.leaves if leaf.unknown)
    return Explanation(tuple(findings), factors, best.cost, unexplained)


def _backwards(relations: Sequence[Relation]) -> ConsistencyFinding | None:
    """Tell rows that run backwards: every rate of change has the opposite sign, along the car and in turning."""
    rates = [r for r in relations if r.name in _REVERSING or r.leaf == "T"]
    along = any(r.leaf in ("ax", "T") for r in rates)
    turning = any("r" in r.powers for r in rates)
    one = all(r.slope.slope < 0.0 and abs(np.log(-r.slope.slope)) <= r.tolerance for r in rates)
    if len(rates) < _LEAST_REVERSED or not (along and turning and one):
        return None
    text = (
        f"the rows run backwards in time: {'; '.join(r.name for r in rates)} all have the opposite sign. "
        "Write them in the other order, the oldest first, and ingest again; turn no sign."
    )
    return ConsistencyFinding("sign", "time", text, -1.0, None)


def _clock(relations: Sequence[Relation]) -> ConsistencyFinding | None:
    """Tell a clock that counts too fast or too slow: rates of change are off by one factor, of v_x and of r."""
    rates = [relation for relation in relations if relation.name in OVER_TIME and relation.slope.slope > 0.0]
    if not all(any(channel in relation.powers for relation in rates) for channel in SHARED) or len(rates) < 3:
        return None
    sizes = np.log([relation.slope.slope for relation in rates])
    common = float(np.median(sizes))
    if any(abs(s - common) > r.tolerance or abs(s) <= r.tolerance for s, r in zip(sizes, rates, strict=True)):
        return None
    factor = float(np.exp(common))
    text = (
        f"the time counts {max(factor, 1.0 / factor):.4g} times too {'fast' if factor > 1.0 else 'slow'}: "
        f"{'; '.join(relation.name for relation in rates)} are all {factor:.4g} instead of 1. "
        "Set the unit of `time:` in the map, or `time: {period: SECONDS}`."
    )
    return ConsistencyFinding("scale", "time", text, factor, None)


def _by_this_clock(relation: Relation, factor: float) -> Relation:
    """Return a relation as it is with the time put right."""
    if relation.name not in OVER_TIME and relation.leaf != "T":
        return relation
    slope = replace(relation.slope, slope=relation.slope.slope / factor)
    return replace(relation, slope=slope, corrected=None)


def _shared_choices(
    relations: Sequence[Relation], vehicle: Vehicle | None, beyond: Sequence[Plausible]
) -> Iterable[tuple[Mistake, ...]]:
    """Yield every pair of mistakes in v_x and r, none included, and factors of v_x or r that are not known."""
    options: dict[str, list[Mistake | None]] = {}
    for channel in SHARED:
        own = [relation for relation in relations if channel in relation.powers]
        options[channel] = [None]
        if own or any(channel in magnitude.powers for magnitude in beyond):
            options[channel] += known_mistakes(channel, vehicle)
        unknown: list[float] = []
        for relation in own if len(own) > 1 else ():
            factor = abs(relation.slope.slope) ** (1.0 / relation.powers[channel])
            known = [1.0, *(m.low for m in options[channel] if m is not None and m.cost < UNKNOWN)]
            far = all(abs(np.log(factor / low)) > 3.0 * relation.tolerance for low in known)
            again = any(abs(np.log(factor / other)) < relation.tolerance for other in unknown)
            if relation.corrected is None and far and not again:
                unknown.append(factor)
                turned = (False, True) if relation.slope.slope < 0.0 else (False,)
                options[channel] += [_unknown_factor(channel, float(factor), sign) for sign in turned]
    for first in options["vx"]:
        for second in options["r"]:
            yield tuple(mistake for mistake in (first, second) if mistake is not None)


def _unknown_factor(channel: str, factor: float, turned: bool) -> Mistake:
    sign, cost = ("-", UNKNOWN + 1.0 + COMMON) if turned else ("", UNKNOWN + 1.0)
    what = f"is {sign}{factor:.3g} times what the other channels say; no usual mistake of unit or sign explains that"
    return Mistake(channel, factor, factor, turned, what, f"check the scale of {channel}", cost)


def _story(
    shared: tuple[Mistake, ...], relations: Sequence[Relation], vehicle: Vehicle | None, plausible: Sequence[Plausible]
) -> Story:
    factors = {mistake.channel: mistake.factor for mistake in shared}
    leaves = [_leaf(relation, factors, shared, vehicle, plausible) for relation in relations]
    world = {"yaw", "hand"} <= _turned(leaves)
    if world:
        # North-east-down axes mirror the path: what relates to it turns its sign with them.
        mirrored = [
            replace(r, slope=replace(r.slope, slope=-r.slope.slope)) if r.of_the_world else r for r in relations
        ]
        leaves = [_leaf(relation, factors, shared, vehicle, plausible) for relation in mirrored]
    cost = sum(mistake.cost for mistake in shared) + sum(leaf.cost for leaf in leaves)
    cost += sum(p.cost(factors) for p in plausible if set(p.powers) <= set(SHARED))
    cost -= _shared_wheel_costs(leaves) + _shared_acceleration_cost(leaves)
    body = [leaf for leaf in leaves if leaf.relation.leaf in OF_THE_BODY]
    axes = "world" if world else ""
    if world:
        cost -= COMMON - _SAME_AXES  # one mistake, not two
    elif any(m.channel == "r" and m.turned for m in shared) and body and _all_turned(body):
        cost -= sum(_cost_of_sign(leaf) for leaf in body) - _SAME_AXES
        axes = "car"
    return Story(shared, tuple(leaves), cost, axes)


def _cost_of_sign(leaf: Leaf) -> float:
    """Return what the turned sign of a leaf was charged, without the unit that may be wrong beside it."""
    mistake = leaf.mistake
    plain = mistake is not None and mistake.low == mistake.high == 1.0
    return leaf.charged if plain else max(leaf.charged - COMMON, 0.0)


def _turned(leaves: Sequence[Leaf]) -> set[str]:
    return {leaf.mistake.channel for leaf in leaves if leaf.mistake is not None and leaf.mistake.turned}


def _all_turned(leaves: Sequence[Leaf]) -> bool:
    """Whether every one of the channels has its sign turned: right-handed-down axes do that to all of them."""
    return all(leaf.relation.leaf in _turned([leaf]) for leaf in leaves)


def _shared_wheel_costs(leaves: Sequence[Leaf]) -> float:
    """Return what the same mistake in several wheel speeds costs too much: one logger makes it for all."""
    costs: dict[str, list[float]] = {}
    for leaf in leaves:
        if leaf.mistake is not None and leaf.relation.leaf.startswith("wheel_speed"):
            costs.setdefault(leaf.mistake.what, []).append(leaf.charged - _ONE_MORE_WHEEL)
    return sum(sum(same[1:]) for same in costs.values())


def _shared_acceleration_cost(leaves: Sequence[Leaf]) -> float:
    """Return what a unit that both accelerations are in costs too much."""
    units = {leaf.mistake.channel: leaf for leaf in leaves if leaf.mistake is not None and leaf.mistake.unit}
    both = [units[channel] for channel in ("ax", "ay") if channel in units]
    same = len(both) == 2 and both[0].mistake.unit == both[1].mistake.unit
    return max(both[1].charged - _SAME_UNIT, 0.0) if same else 0.0


def _leaf(
    relation: Relation,
    factors: Mapping[str, float],
    shared: Sequence[Mistake],
    vehicle: Vehicle | None,
    plausible: Sequence[Plausible],
) -> Leaf:
    """Account for what v_x and r leave of a relation: by nothing, by a mistake, or by a factor unknown."""
    left, channel = relation.without(factors), relation.leaf
    power = relation.powers[channel]
    own = [p for p in plausible if channel in p.powers]
    units = {mistake.unit for mistake in shared if mistake.unit}
    choices: list[tuple[float, Mistake | None, float]] = [
        (_misfit(relation, left, 1.0, 1.0, False) + sum(p.cost(factors) for p in own), None, 0.0)
    ]
    for mistake in () if relation.certain else known_mistakes(channel, vehicle):
        low, high = sorted((mistake.low**power, mistake.high**power))
        same_logger = mistake.unit in units and (channel == "vy" or channel.startswith("wheel_speed"))
        charged = _SAME_UNIT if same_logger else mistake.cost
        beyond = sum(p.cost({**factors, channel: mistake.high}) for p in own)
        choices.append((charged + beyond + _misfit(relation, left, low, high, mistake.turned), mistake, charged))
    cost, mistake, charged = min(choices, key=lambda choice: choice[0])
    unknown = 2.0 * UNKNOWN if relation.certain else UNKNOWN
    if cost >= unknown:
        return Leaf(relation, None, unknown, left)
    rivals = tuple(m for c, m, _ in choices if m is not None and m is not mistake and c < cost + _RIVAL)
    return Leaf(relation, mistake, cost, left, rivals if mistake is not None else (), charged)


def _misfit(relation: Relation, ratio: float, low: float, high: float, turned: bool) -> float:
    """Return half the squared distance of a ratio from `low` to `high` in standard deviations, see `_EDGE`."""
    if ratio == 0.0 or (ratio < 0.0) != turned:
        return np.inf
    size = float(np.log(abs(ratio)))
    distance = max(np.log(low) - size, size - np.log(high), 0.0)
    return _EDGE * float(distance / relation.tolerance) ** 2 if distance <= relation.tolerance else np.inf
