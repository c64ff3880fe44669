"""Detection limits: the smallest size of each effect that would have been named if it were the only one."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.optimize import brentq

from split_cli.diagnosis.innovations.objective import MarginalLikelihood, alters_inputs
from split_cli.diagnosis.parallel import map_distributed
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part, tangent
from split_cli.diagnosis.search.selection import nothing
from split_cli.diagnosis.search.term_tests import over_allowance, p_of_effect
from split_cli.diagnosis.statement.result import Detectable
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from split_cli.diagnosis.verdict.planted import alters_commands, other_side
from split_cli.vehicle.effects import CATALOGUE, Term

Planted = Callable[[MarginalLikelihood, Term], tuple[float, float]]

_ROUNDS = 8  # an effect of twice the size saves nearly four times as much; past a tyre's peak it hardly saves more
_FURTHEST = 1e4
_GROWTH = 1.25  # steps in which a size grows until it is apart from no effect
_LEAST_GROWTH = 1.02  # the least step in which a size grows until recordings that have it show it
# Steps after which what alters inputs, and what does not, is as told.
_NEAR, _PROPORTIONAL = np.log(1.2), np.log(4.0)


def detection_limits(
    objectives: Sequence[MarginalLikelihood],
    candidates: Sequence[Candidate],
    variance_inflation: float,
    level: float,
    planted: Planted | None = None,
) -> tuple[Detectable, ...]:
    """Return from which size on each parameter of each term would be named alone on these recordings.

    Parameters
    ----------
    objectives : sequence of MarginalLikelihood
        The last of them, where its baseline is fixed, names what alters inputs or
        sensors.
    candidates : sequence of Candidate
        Those that act at a place are left out: it depends on the place.
    level : float
        Of the minimum-effect test.
    planted : callable, optional
        Returns what a term that alters commands saves of recordings that have it, and its size there: see
        `planted_saving`. Without, they are taken to be filtered as these are.

    Notes
    -----
    Were an effect there, its term would save the squared length of what it moves in the whitened rows, less what
    the difference that is there already may take off: nobody knows the sign of an effect beforehand. A fault of
    one sign moves the rows as its term of the other does, and where much is curved not as far to either side; what
    is told holds for both. Its size is searched where the test that is asked of every name is passed just so, and
    it grows until its 95 % interval leaves out no effect. A fault of the commands alters the filter of the rows
    too: it grows until the test is passed by recordings that have it. A size whose interval ends where no real
    car lies beyond is not told: such a fault is taken for one beyond, which has no name. Chance makes it pass a
    little earlier or later; what looks the same may be named in its stead.
    """
    bare = [nothing(objective) for objective in objectives]

    def smallest(candidate: Candidate, start: Mapping[str, float]) -> tuple[float, dict[str, float]]:
        last = -1 if alters_inputs(candidate.build(start)) else 0
        return _smallest(
            objectives[last], bare[last], candidate, start, variance_inflation, level / len(candidates), planted
        )

    every = _alone(candidates)
    tried = [(one, start) for several in every.values() for one, start in several]
    found = iter(map_distributed(lambda one: smallest(*one), tried))
    parameters: dict[str, dict[str, tuple[float, str]]] = {}
    for (term, name), several in every.items():
        # Which variant of them is there nobody knows: what is reported holds for all.
        _, values, unit = max(
            ((*next(found), CATALOGUE[term].parameter_units(one.variant)[name]) for one, _ in several),
            key=lambda one: one[0],
        )
        sizes = parameters.setdefault(term, {})
        if values:
            sizes[name] = values[name], unit
    return tuple(Detectable(term, sizes) for term, sizes in parameters.items())


def _alone(candidates: Sequence[Candidate]) -> dict[tuple[str, str], list[tuple[Candidate, dict[str, float]]]]:
    """Return by term and parameter where each of its variants begins with that parameter alone.

    Two parameters of a term need not be there together: brakes may be weak and the drive sound. A parameter that
    no effect leaves open, a place in time, keeps its start. Where variants have several parameters and others one
    of them, each late channel alone, those tell.
    """
    found: dict[tuple[str, str], list[tuple[Candidate, dict[str, float]]]] = {}
    for one in candidates:
        neutral = CATALOGUE[one.term].neutral
        for name in one.ranges if one.starts else ():
            acting = [start for start in one.starts if neutral.get(name) not in (None, start[name])]
            if acting:
                start = acting[len(acting) // 2]
                alone = {each: start[each] if each == name else neutral.get(each, start[each]) for each in start}
                found.setdefault((one.term, name), []).append((one, alone))
    for key, several in found.items():
        fewest = min(len(one.ranges) for one, _ in several)
        found[key] = [(one, start) for one, start in several if len(one.ranges) == fewest]
    return found


def _smallest(
    objective: MarginalLikelihood,
    bare: Fit,
    candidate: Candidate,
    start: Mapping[str, float],
    variance_inflation: float,
    level: float,
    planted: Planted | None,
) -> tuple[float, dict[str, float]]:
    """Return how many times a start an effect has to be, and its values; infinity and none beyond its range."""
    near = _NEAR if alters_inputs(candidate.build(start)) else _PROPORTIONAL

    def excess(size: float, saved: float) -> float:
        """Return by how much an effect, its size over what is allowed, passes, above 0, or fails, below."""
        p_value = p_of_effect(objective, candidate, size, saved, variance_inflation)
        margin = np.log(level) - np.log(max(p_value, 1e-300))
        apart = objective.policy.selection.deviations**2 * objective.own_savings.get(candidate.effect, 0.0)
        if apart > 0.0:
            margin = min(margin, np.log(saved / apart))
        return float(margin)

    values, factor = dict(start), 1.0
    for _ in range(_ROUNDS):
        term = candidate.build(values)
        size = over_allowance(objective, (term,), ())
        ways = [_moved(objective, bare, one) for one in (term, *_other_sign(candidate, values))]

        def passes(log: float, size=size, ways=ways) -> float:
            seen = min(np.exp(log) * length - against for length, against in ways)
            return excess(np.exp(log) * size, max(seen, 1e-6) ** 2)

        far = np.log(_FURTHEST)
        if not min(length for length, _ in ways) > 0.0 or passes(far) < 0.0:
            break
        log = -far if passes(-far) > 0.0 else brentq(passes, -far, far, xtol=0.01)
        factor *= float(np.exp(log))
        values, everyday = candidate.moved(start, factor), False
        if candidate.is_everyday(values):
            # As large as this it is seen, and yet no fault.
            factor *= min(
                candidate.ranges[name].everyday / away for name, away in candidate.away(values).items() if away
            )
            values, everyday = candidate.moved(start, factor), True
        if not candidate.allows(values):
            break
        if everyday or abs(log) < near:
            if planted is not None and alters_commands(term):
                factor = _grown_seen(objective, candidate, start, factor, excess, planted)
            return _grown_until_significant(objective, bare, candidate, start, factor)
    return np.inf, {}


def _grown_seen(
    objective: MarginalLikelihood,
    candidate: Candidate,
    start: Mapping[str, float],
    factor: float,
    excess: Callable[[float, float], float],
    planted: Planted,
) -> float:
    """Return a factor, grown until recordings that have the effect pass; infinity beyond its range.

    They have it to either side, where it has two. What it saves there grows with the square of its size at most,
    so that each step ends short of what is sought.
    """

    def growth(saved: float, size: float) -> float:
        """Return by which factor an effect has to grow; 1 where it passes."""

        def passes(log: float) -> float:
            return excess(np.exp(log) * size, np.exp(2.0 * log) * saved)

        far = np.log(_FURTHEST)
        if saved > 0.0 and passes(0.0) >= 0.0:
            return 1.0
        if not saved > 0.0 or passes(far) < 0.0:
            return _GROWTH
        return max(float(np.exp(brentq(passes, 0.0, far, xtol=0.01))), _LEAST_GROWTH)

    while candidate.allows(values := candidate.moved(start, factor)):
        for term in (candidate.build(values), *_other_sign(candidate, values)):
            grown = growth(*planted(objective, term))
            if grown > 1.0:
                factor *= grown
                break
        else:
            return factor
    return np.inf


def _grown_until_significant(
    objective: MarginalLikelihood, bare: Fit, candidate: Candidate, start: Mapping[str, float], factor: float
) -> tuple[float, dict[str, float]]:
    """Return a factor and values as of `_smallest`, grown until an interval leaves out no effect."""
    for _ in range(_ROUNDS):
        values = candidate.moved(start, factor)
        if not (np.isfinite(factor) and candidate.allows(values)):
            break
        if _is_significant(objective, bare, Part(candidate, values)):
            return factor, values
        factor *= _GROWTH
    return np.inf, {}


def _is_significant(objective: MarginalLikelihood, bare: Fit, part: Part) -> bool:
    """Return whether a part that leaves what is left now would have an interval without its neutral value.

    Nor may the interval reach where no real car lies beyond.
    """
    steps = np.array([part.candidate.ranges[name].step for name in part.values])
    slopes = tangent(objective, np.zeros(len(objective.weight)), part).slopes / steps
    (shown,) = parameter_estimates(objective, Fit((part,), bare.cost, bare.residuals, slopes), recorded=False)

    def is_apart(name: str) -> bool:
        (low, high), limits, neutral = (
            shown[name].interval_95,
            part.candidate.ranges[name],
            part.term.neutral[name],
        )
        return low > neutral and high < limits.upper or high < neutral and low > limits.lower

    return any(is_apart(name) for name in shown if name in part.term.neutral)


def _moved(objective: MarginalLikelihood, bare: Fit, term: Term) -> tuple[float, float]:
    """Return how far a term moves the whitened rows, and how much of that what is there already takes off.

    What is there points the other way for one sign of an effect, and has to be made up for first.
    """
    moved = objective.whiten(objective.residual((term,)) - objective.shift((term,))) - bare.residuals
    length = float(np.sqrt(moved @ moved))
    against = abs(float(moved @ bare.residuals)) / max(length, 1e-300)
    return length, against


def _other_sign(candidate: Candidate, values: Mapping[str, float]) -> tuple[Term, ...]:
    """Return the term as far to the other side, a ratio's inverse; none where a car has but one side of it."""
    neutral = CATALOGUE[candidate.term].neutral
    turned = other_side(neutral, values)
    if any(not candidate.ranges[name].lower < neutral[name] < candidate.ranges[name].upper for name in turned):
        return ()
    return (candidate.build({**values, **turned}),)
