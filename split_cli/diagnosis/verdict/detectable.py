"""Detection limits: the smallest size of each effect that would have been named if it were the only one."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import brentq

from split_cli.diagnosis.innovations.objective import MarginalLikelihood, alters_inputs
from split_cli.diagnosis.parallel import apart
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part, tangent
from split_cli.diagnosis.search.selection import nothing
from split_cli.diagnosis.search.term_tests import over_allowance, p_of_effect
from split_cli.diagnosis.statement.result import Detectable
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from split_cli.vehicle.effects import CATALOGUE, Term

_ROUNDS = 8  # an effect of twice the size saves nearly four times as much; past a tyre's peak it hardly saves more
_FURTHEST = 1e4
_GROWTH = 1.25  # steps in which a size grows until it is apart from no effect
# Steps after which what alters inputs, and what does not, is as told.
_NEAR, _PROPORTIONAL = np.log(1.2), np.log(4.0)


def smallest_named(
    objectives: Sequence[MarginalLikelihood],
    candidates: Sequence[Candidate],
    variance_inflation: float,
    level: float,
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

    Notes
    -----
    Were an effect there, its term would save the squared length of what it moves in the whitened rows, less what
    the difference that is there already may take off: nobody knows the sign of an effect beforehand. A fault of
    one sign moves the rows as its term of the other does, and where much is curved not as far to either side; what
    is told holds for both. Its size is searched where the test that is asked of every name is passed just so, and
    it grows until its 95 % interval leaves out no effect. Chance makes it pass a little earlier or later; what
    looks the same may be named in its stead.
    """
    bare = [nothing(objective) for objective in objectives]

    def smallest(candidate: Candidate, start: Mapping[str, float]) -> tuple[float, dict[str, float]]:
        last = -1 if alters_inputs(candidate.build(start)) else 0
        return _smallest(
            objectives[last], bare[last], candidate, start, variance_inflation, level / len(candidates)
        )

    every = _alone(candidates)
    tried = [(one, start) for several in every.values() for one, start in several]
    found = iter(apart(lambda one: smallest(*one), tried))
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
            return _grown_apart(objective, bare, candidate, start, factor)
    return np.inf, {}


def _grown_apart(
    objective: MarginalLikelihood, bare: Fit, candidate: Candidate, start: Mapping[str, float], factor: float
) -> tuple[float, dict[str, float]]:
    """Return a factor and values as of `_smallest`, grown until an interval leaves out no effect."""
    for _ in range(_ROUNDS):
        values = candidate.moved(start, factor)
        if not candidate.allows(values):
            break
        if _is_apart(objective, bare, Part(candidate, values)):
            return factor, values
        factor *= _GROWTH
    return np.inf, {}


def _is_apart(objective: MarginalLikelihood, bare: Fit, part: Part) -> bool:
    """Return whether a part that leaves what is left now would have an interval without its neutral value."""
    steps = np.array([part.candidate.ranges[name].step for name in part.values])
    slopes = tangent(objective, np.zeros(len(objective.weight)), part).slopes / steps
    (shown,) = parameter_estimates(objective, Fit((part,), bare.cost, bare.residuals, slopes), recorded=False)
    ends = [(part.term.neutral[name], one.interval_95) for name, one in shown.items() if name in part.term.neutral]
    return any(not low <= neutral <= high for neutral, (low, high) in ends)


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
    sized = [name for name in values if neutral.get(name) is not None]
    if any(not candidate.ranges[name].lower < neutral[name] < candidate.ranges[name].upper for name in sized):
        return ()
    turned = {
        name: 1.0 / values[name] if neutral[name] == 1.0 else 2.0 * neutral[name] - values[name] for name in sized
    }
    return (candidate.build({**values, **turned}),)
