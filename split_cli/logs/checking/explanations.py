"""What accounts best for measured factors between channels: each relation by itself, weighed, several at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from split_cli.logs.checking.kinematics import Slope
from split_cli.logs.checking.mistakes import COMMON, Mistake, known_mistakes
from split_cli.vehicle.parameters import Vehicle

__all__ = ["ConsistencyFinding", "Explanation", "Plausible", "Relation", "explain"]

_UNKNOWN = 8.0
"""Cost of a factor that no known mistake gives: dearer than one of unit and sign at the edge of the tolerance."""
_EDGE = 2.0
"""Cost of a ratio at the edge of its tolerance, two standard deviations; beyond it nothing is accounted for."""
_RIVAL = 1.5
"""Explanations less than this dearer than the best are told beside it: odds of less than 5 to 1."""
_SAME_UNIT = 1.0
"""Cost of v_y or a wheel speed in the wrong unit that v_x is in too, and of a_y in that of a_x: of one logger."""
_ONE_MORE_WHEEL = 0.25
_BEYOND_PHYSICS = 4.0
"""Cost of a magnitude e times what a car can reach."""
_SAME_AXES = 0.5
"""Added to the cost of one turned sign when all channels of the vehicle, or of the world, have other axes."""
_OF_THE_BODY = ("vy", "ay", "delta")
_OVER_TIME = ("r against dyaw/dt", "r against the turning of X, Y", "v_x against the speed of X, Y",
              "a_x against dv_x/dt - v_y r")  # fmt: skip
"""Relations to a rate of change, which a wrong clock puts off by one factor."""
_REVERSING = _OVER_TIME[:2] + _OVER_TIME[3:]
"""Of these the ones that change their sign where time runs backwards; a speed does not."""
_LEAST_REVERSED = 3
"""Relations with the opposite sign that are told as one mistake [1]: two may be two turned channels."""
_SHARED = ("vx", "r")
"""Channels that enter several relations; every other one enters one."""


@dataclass(frozen=True)
class ConsistencyFinding:
    """Something that does not fit together.

    Attributes
    ----------
    check : str
        ``scale``, ``sign``, ``bias on straights``, ``place``, ``direction``, ``swapped``, ``world``, ``constant``,
        ``range``, ``contradiction``, ``course``.
    channel : str
        The one to look at.
    text : str
        What was measured, what it probably is, and what to do.
    measured : float or None
        Slope, factor or bias.
    error : float or None
        Its standard error from blocks of time.
    """

    check: str
    channel: str
    text: str
    measured: float | None = None
    error: float | None = None


@dataclass(frozen=True)
class Relation:
    """A measured ratio that should be 1.

    Attributes
    ----------
    name : str
    powers : mapping of str to int
        Channel to the power with which its factor enters.
    slope : Slope
    tolerance : float
        Of the logarithm of the ratio: what right recordings show.
    corrected : callable or None
        Takes the factors of v_x and r and returns the ratio that is left after both are corrected, for relations
        that are no plain product; None where `powers` says it all.
    of_the_world : bool
        Whether it turns its sign when yaw and the order of X, Y are both turned.
    certain : bool
        Whether the channel that only this relation has is beyond doubt: a path of satellite fixes, a compass.
    """

    name: str
    powers: Mapping[str, int]
    slope: Slope
    tolerance: float
    corrected: Callable[[float, float], float] | None = None
    of_the_world: bool = False
    certain: bool = False

    @property
    def holds(self) -> bool:
        """Whether the ratio is 1 within its tolerance."""
        return self.slope.slope > 0 and abs(np.log(self.slope.slope)) <= self.tolerance

    @property
    def leaf(self) -> str:
        """The channel that enters this relation only."""
        return next(channel for channel in self.powers if channel not in _SHARED)

    def without(self, factors: Mapping[str, float]) -> float:
        """Return the ratio that is left when v_x and r are divided by `factors`."""
        if self.corrected is not None:
            return self.corrected(factors.get("vx", 1.0), factors.get("r", 1.0))
        ratio = self.slope.slope
        for channel in _SHARED:
            ratio *= factors.get(channel, 1.0) ** -self.powers.get(channel, 0)
        return ratio


@dataclass(frozen=True)
class Plausible:
    """A magnitude that physics bounds: `value` is the product of channels to their `powers`.

    Attributes
    ----------
    name : str
    powers : mapping of str to int
    value, high : float
        What it reaches, and what no car reaches, SI.
    unit : str
    """

    name: str
    powers: Mapping[str, int]
    value: float
    high: float
    unit: str

    def cost(self, factors: Mapping[str, float]) -> float:
        """Return what it costs that the corrected magnitude is larger than any car's."""
        value = self.value
        for channel, power in self.powers.items():
            value *= abs(factors.get(channel, 1.0)) ** -power
        return _BEYOND_PHYSICS * float(max(np.log(max(value, 1e-12) / self.high), 0.0))


@dataclass(frozen=True)
class Explanation:
    """Findings, and the exact signed factors that correct the channels they blame.

    Attributes
    ----------
    findings : tuple of ConsistencyFinding
    factors : mapping of str to float
        Channel to the factor that is in it; only where one mistake is clearly the best.
    cost : float
        Of the best story, 0 where all relations hold [1].
    """

    findings: tuple[ConsistencyFinding, ...] = ()
    factors: Mapping[str, float] = field(default_factory=dict)
    cost: float = 0.0


@dataclass(frozen=True)
class _Leaf:
    """How one relation is accounted for, given the shared channels: a mistake, nothing, or an unknown factor."""

    relation: Relation
    mistake: Mistake | None
    cost: float
    left: float
    rivals: tuple[Mistake, ...] = ()
    charged: float = 0.0

    @property
    def unknown(self) -> bool:
        return self.mistake is None and self.cost >= _UNKNOWN


@dataclass(frozen=True)
class _Story:
    """One assignment of mistakes to all channels, with its cost."""

    shared: tuple[Mistake, ...]
    leaves: tuple[_Leaf, ...]
    cost: float

    @property
    def mistakes(self) -> tuple[Mistake, ...]:
        return (*self.shared, *(leaf.mistake for leaf in self.leaves if leaf.mistake is not None))

    @property
    def blamed(self) -> frozenset[tuple[str, str]]:
        unknown = ((leaf.relation.leaf, "unknown") for leaf in self.leaves if leaf.unknown)
        return frozenset([*((m.channel, m.what) for m in self.mistakes), *unknown])


def explain(
    relations: Sequence[Relation], vehicle: Vehicle | None, plausible: Sequence[Plausible] = ()
) -> Explanation:
    """Name the cheapest set of known mistakes that accounts for the relations.

    Parameters
    ----------
    relations : sequence of Relation
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
        return replace(rest, findings=(backwards, *rest.findings), cost=rest.cost + _UNKNOWN)
    clock = _clock(relations)
    if clock is not None:
        rest = explain([_by_this_clock(r, clock.measured or 1.0) for r in relations], vehicle, plausible)
        return replace(rest, findings=(clock, *rest.findings), cost=rest.cost + _UNKNOWN)
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
    told = _told(best, rivals, relations, beyond)
    sure = {m.channel for m in best.mistakes if all(m in rival.mistakes for rival in rivals)}
    doubtful = {leaf.relation.leaf for leaf in best.leaves if leaf.rivals}
    factors = {
        m.channel: m.factor
        for m in best.mistakes
        if m.channel in sure and m.channel not in doubtful and m.factor is not None
    }
    return Explanation(tuple(told), factors, best.cost)


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
    rates = [relation for relation in relations if relation.name in _OVER_TIME and relation.slope.slope > 0.0]
    if not all(any(channel in relation.powers for relation in rates) for channel in _SHARED) or len(rates) < 3:
        return None
    sizes = np.log([relation.slope.slope for relation in rates])
    common = float(np.median(sizes))
    widest = max(relation.tolerance for relation in rates)
    if abs(common) < 3.0 * widest or any(abs(s - common) > r.tolerance for s, r in zip(sizes, rates, strict=True)):
        return None
    factor = float(np.exp(common))
    text = (
        f"the time counts {max(factor, 1.0 / factor):.4g} times too {'slow' if factor > 1.0 else 'fast'}: "
        f"{'; '.join(relation.name for relation in rates)} are all {factor:.4g} instead of 1. "
        "Set the unit of `time:` in the map, or `time: {period: SECONDS}`."
    )
    return ConsistencyFinding("scale", "time", text, factor, None)


def _by_this_clock(relation: Relation, factor: float) -> Relation:
    """Return a relation as it is with the time put right."""
    if relation.name not in _OVER_TIME and relation.leaf != "T":
        return relation
    slope = replace(relation.slope, slope=relation.slope.slope / factor)
    return replace(relation, slope=slope, corrected=None)


def _shared_choices(
    relations: Sequence[Relation], vehicle: Vehicle | None, beyond: Sequence[Plausible]
) -> Iterable[tuple[Mistake, ...]]:
    """Yield every pair of mistakes in v_x and r, none included, and factors of v_x or r that are not known."""
    options: dict[str, list[Mistake | None]] = {}
    for channel in _SHARED:
        own = [relation for relation in relations if channel in relation.powers]
        options[channel] = [None]
        if own or any(channel in magnitude.powers for magnitude in beyond):
            options[channel] += known_mistakes(channel, vehicle)
        for relation in own if len(own) > 1 else ():
            factor = abs(relation.slope.slope) ** (1.0 / relation.powers[channel])
            known = [1.0, *(m.low for m in options[channel] if m is not None and m.cost < _UNKNOWN)]
            far = all(abs(np.log(factor / low)) > 3.0 * relation.tolerance for low in known)
            if relation.corrected is None and far:
                options[channel].append(_unknown_factor(channel, float(factor)))
    for first in options["vx"]:
        for second in options["r"]:
            yield tuple(mistake for mistake in (first, second) if mistake is not None)


def _unknown_factor(channel: str, factor: float) -> Mistake:
    what = f"is {factor:.3g} times what the other channels say; no usual mistake of unit or sign gives that"
    return Mistake(channel, factor, factor, False, what, f"check the scale of {channel}", _UNKNOWN + 1.0)


def _story(
    shared: tuple[Mistake, ...],
    relations: Sequence[Relation],
    vehicle: Vehicle | None,
    plausible: Sequence[Plausible],
) -> _Story:
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
    cost += sum(p.cost(factors) for p in plausible if set(p.powers) <= set(_SHARED))
    cost -= _shared_wheel_costs(leaves) + _shared_acceleration_cost(leaves)
    body = [leaf for leaf in leaves if leaf.relation.leaf in _OF_THE_BODY]
    if world:
        cost -= COMMON - _SAME_AXES  # one mistake, not two
    elif any(m.channel == "r" and m.turned for m in shared) and body and _all_turned(body):
        cost -= sum(_cost_of_sign(leaf) for leaf in body) - _SAME_AXES
    return _Story(shared, tuple(leaves), cost)


def _cost_of_sign(leaf: _Leaf) -> float:
    """Return what the turned sign of a leaf was charged, without the unit that may be wrong beside it."""
    mistake = leaf.mistake
    plain = mistake is not None and mistake.low == mistake.high == 1.0
    return leaf.charged if plain else max(leaf.charged - COMMON, 0.0)


def _turned(leaves: Sequence[_Leaf]) -> set[str]:
    return {leaf.mistake.channel for leaf in leaves if leaf.mistake is not None and leaf.mistake.turned}


def _all_turned(leaves: Sequence[_Leaf]) -> bool:
    """Whether every one of the channels has its sign turned: right-handed-down axes do that to all of them."""
    return all(leaf.relation.leaf in _turned([leaf]) for leaf in leaves)


def _shared_wheel_costs(leaves: Sequence[_Leaf]) -> float:
    """Return what the same mistake in several wheel speeds costs too much: one logger makes it for all."""
    costs: dict[str, list[float]] = {}
    for leaf in leaves:
        if leaf.mistake is not None and leaf.relation.leaf.startswith("wheel_speed"):
            costs.setdefault(leaf.mistake.what, []).append(leaf.charged - _ONE_MORE_WHEEL)
    return sum(sum(same[1:]) for same in costs.values())


def _shared_acceleration_cost(leaves: Sequence[_Leaf]) -> float:
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
) -> _Leaf:
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
    unknown = 2.0 * _UNKNOWN if relation.certain else _UNKNOWN
    if cost >= unknown:
        return _Leaf(relation, None, unknown, left)
    rivals = tuple(m for c, m, _ in choices if m is not None and m is not mistake and c < cost + _RIVAL)
    return _Leaf(relation, mistake, cost, left, rivals if mistake is not None else (), charged)


def _misfit(relation: Relation, ratio: float, low: float, high: float, turned: bool) -> float:
    """Return half the squared distance of a ratio from `low` to `high` in standard deviations, see `_EDGE`."""
    if ratio == 0.0 or (ratio < 0.0) != turned:
        return np.inf
    size = float(np.log(abs(ratio)))
    distance = max(np.log(low) - size, size - np.log(high), 0.0)
    return _EDGE * float(distance / relation.tolerance) ** 2 if distance <= relation.tolerance else np.inf


def _told(
    best: _Story, rivals: Sequence[_Story], relations: Sequence[Relation], beyond: Sequence[Plausible]
) -> list[ConsistencyFinding]:
    """Put the best story into words, with its rivals."""
    broken = [relation for relation in relations if not relation.holds]
    others = [_in_words(story) for story in rivals]
    others = list(dict.fromkeys(others))[:3]
    alternative = f" Or: {'; or '.join(others)}: nothing recorded decides." if others else ""
    reach = [f"{m.name} reaches {m.value:.3g} {m.unit}, no car's exceeds {m.high:g}" for m in beyond]
    # What every story says is not in doubt.
    doubt = {m: "" if all(m in rival.mistakes for rival in rivals) else alternative for m in best.mistakes}
    found = [_finding(mistake, broken, doubt[mistake], (), reach) for mistake in best.shared]
    wheels: set[str] = set()
    for leaf in best.leaves:
        if leaf.mistake is not None:
            one = _finding(leaf.mistake, [leaf.relation], doubt[leaf.mistake], leaf.rivals)
            if leaf.relation.leaf.startswith("wheel_speed"):
                slope = leaf.relation.slope.slope
                likewise = f"{one.channel} likewise (slope {slope:.4g}): {leaf.mistake.what}"
                one = replace(one, text=likewise) if leaf.mistake.what in wheels else one
                wheels.add(leaf.mistake.what)
            found.append(one)
        elif leaf.unknown:
            found.append(_unexplained(leaf, alternative))
    left_over = {m.channel: m.high for m in best.mistakes}
    for magnitude, words in zip(beyond, reach, strict=True):
        if magnitude.cost(left_over) > 0.0:
            first = next(iter(magnitude.powers))
            text = f"{words}: check the unit of {' and '.join(magnitude.powers)}.{alternative}"
            found.append(ConsistencyFinding("range", first, text, magnitude.value))
    return found


def _in_words(story: _Story) -> str:
    plain = [m for m in story.mistakes if not m.channel.startswith("wheel_speed")]
    parts = [f"{_name(m.channel)} {m.what}" for m in plain]
    wheels = dict.fromkeys(m.what for m in story.mistakes if m not in plain)
    parts += [f"the wheel speeds: each {what}" for what in wheels]
    parts += [f"{leaf.relation.name} is off by a factor not known" for leaf in story.leaves if leaf.unknown]
    return " and ".join(parts) or "nothing is wrong"


def _finding(
    mistake: Mistake,
    shown: Sequence[Relation],
    alternative: str,
    rivals: Sequence[Mistake],
    reach: Sequence[str] = (),
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


def _unexplained(leaf: _Leaf, alternative: str) -> ConsistencyFinding:
    relation, slope = leaf.relation, leaf.relation.slope
    moved = abs(leaf.left / slope.slope - 1.0) > 0.02
    corrected = f" ({leaf.left:.4g} with what else was found corrected)" if moved else ""
    return ConsistencyFinding(
        "scale" if leaf.left > 0 else "sign",
        "X" if relation.leaf == "hand" else relation.leaf,
        f"{relation.name}: slope {slope.slope:.4g} +- {slope.error:.1g} where 1 was expected "
        f"(correlation {slope.correlation:.3f}){corrected}; no usual mistake of unit or sign gives that. "
        f"Check the scale of {' and '.join(_name(c) for c in relation.powers)}.{alternative}",
        slope.slope,
        slope.error,
    )


def _name(channel: str) -> str:
    return "X, Y" if channel == "hand" else channel
