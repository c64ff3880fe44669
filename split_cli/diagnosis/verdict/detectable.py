"""Detection limits: the smallest size of each effect that would have been named, beside what is named."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from split_cli.diagnosis.innovations.objective import MarginalLikelihood, alters_inputs
from split_cli.diagnosis.parallel import map_distributed
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, sensitivity_of, tangent
from split_cli.diagnosis.search.form_error import costs_of_rows
from split_cli.diagnosis.search.forward import sizes_with_form_error
from split_cli.diagnosis.search.selection import nothing
from split_cli.diagnosis.search.term_tests import over_allowance, over_form_error, p_of_effect, sizes_of_terms
from split_cli.diagnosis.statement.result import Detectable
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from split_cli.diagnosis.verdict.planted import alters_commands, other_side
from split_cli.vehicle.effects import CATALOGUE, Term

Planted = Callable[[MarginalLikelihood, Term, Sequence[Term]], tuple[float, float]]

_ROUNDS = 8  # an effect of twice the size saves nearly four times as much; past a tyre's peak it hardly saves more
_FURTHEST = 1e4
_GROWTH = 1.25  # steps in which a size grows until it is apart from no effect
_LEAST_GROWTH = 1.02  # the least step in which a size grows until recordings that have it show it
# Steps after which what alters inputs, and what does not, is as told.
_NEAR, _PROPORTIONAL = np.log(1.2), np.log(4.0)


@dataclass(frozen=True)
class _Beside:
    """What explains the drives already, on one objective."""

    objective: MarginalLikelihood
    fit: Fit  # the named terms, refitted
    taken: np.ndarray  # (R, C): orthonormal rows that these terms can take up

    def moved(self, term: Term) -> tuple[np.ndarray, float]:
        """Return what a further term moves of the whitened rows and the others cannot take up, (R,).

        Second is its squared length as a share of all that the term moves.
        """
        rows = self.objective.whiten(self.objective.left_by((*self.fit.terms, term))) - self.fit.residuals
        left = rows - self.taken @ (self.taken.T @ rows)
        return left, float(left @ left) / max(float(rows @ rows), 1e-300)


@dataclass(frozen=True)
class _Shown:
    """What a term of one size shows beside the others; lengths and sizes grow in proportion."""

    size: float  # effect-to-noise ratio over what is allowed
    ways: tuple[tuple[float, float], ...]  # of either sign: how far rows are moved, and what is there against it
    share: float  # of the squared length that is moved, what the others cannot take up
    beyond: tuple[float, ...]  # shares of the rest that are no model-form error of the others, as in `p_of_effect`
    over: float  # size over the model-form error of the others
    witnessed: float  # how far it moves what a recording knows twice

    def over_and_witnessed(self, times: float) -> "_Shown":
        """Return what a term some times as large is over the model-form error of the others, and moves of witnesses."""
        return replace(self, over=times * self.over, witnessed=times * self.witnessed)


def detection_limits(
    objectives: Sequence[MarginalLikelihood],
    candidates: Sequence[Candidate],
    variance_inflation: float,
    level: float,
    planted: Planted | None = None,
    named: Sequence[Part] = (),
) -> tuple[Detectable, ...]:
    """Return from which size on each parameter of each term would be named on these recordings.

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
        Returns what a term that alters commands saves of recordings that have it, beside others, and its size
        there: see `planted_saving`. Without, they are taken to be filtered as these are.
    named : sequence of Part
        What is named of these recordings. A term that is among them is reported beside the others.

    Notes
    -----
    Were an effect there, its term would save the squared length of what it moves in the whitened rows, less what
    the difference that is there already may take off: nobody knows the sign of an effect beforehand. A fault of
    one sign moves the rows as its term of the other does, and where much is curved not as far to either side; what
    is reported holds for both. Its size is searched where the test that is asked of every name is passed just so, and
    it grows until its 95 % interval leaves out no effect. A fault of the commands alters the filter of the rows
    too: it grows until the test is passed by recordings that have it. A size whose interval ends where no real
    car lies beyond is not reported: such a fault is taken for one beyond, which has no name. Chance makes it pass a
    little earlier or later; what looks the same may be named in its stead.

    Beside names it saves what these cannot take up with other values, it has to be more than their model-form
    error, as a further name has, and its interval knows that their values are uncertain, too.
    """
    besides: dict[tuple[int, str], _Beside] = {}
    for k, objective in enumerate(objectives):
        for term in ("", *(part.candidate.term for part in named)):
            besides[k, term] = _beside(objective, [part for part in named if part.candidate.term != term])

    def smallest(candidate: Candidate, start: Mapping[str, float]) -> tuple[float, dict[str, float]]:
        last = len(objectives) - 1 if alters_inputs(candidate.build(start)) else 0
        beside = besides.get((last, candidate.term), besides[last, ""])
        return _smallest(beside, candidate, start, variance_inflation, level / len(candidates), planted)

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


def _beside(objective: MarginalLikelihood, named: Sequence[Part]) -> _Beside:
    fit = fit_parts(objective, named) if named else nothing(objective)
    slopes = sensitivity_of(objective, fit)
    return _Beside(objective, fit, np.linalg.qr(slopes / (np.linalg.norm(slopes, axis=0) + 1e-300))[0])


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
    beside: _Beside,
    candidate: Candidate,
    start: Mapping[str, float],
    variance_inflation: float,
    level: float,
    planted: Planted | None,
) -> tuple[float, dict[str, float]]:
    """Return how many times a start an effect has to be, and its values; infinity and none beyond its range."""
    near = _NEAR if alters_inputs(candidate.build(start)) else _PROPORTIONAL
    objective, rules = beside.objective, beside.objective.policy

    def excess(shown: _Shown, times: float, saved: float) -> float:
        """Return by how much an effect, some times as large, passes, above 0, or fails, below."""
        free = candidate.build(start).corrects and times * shown.witnessed > rules.allowances.large
        beyond = [] if free else [share * saved for share in shown.beyond]
        p_value = p_of_effect(objective, candidate, times * shown.size, saved, variance_inflation, beyond)
        margins = [np.log(level) - np.log(max(p_value, 1e-300))]
        apart = rules.selection.deviations**2 * objective.self_test_savings.get(candidate.effect, 0.0)
        if apart > 0.0:
            margins.append(np.log(saved / apart))
        if not free and np.isfinite(shown.over):
            margins.append(np.log(max(times * shown.over, 1e-300)))
        return float(min(margins))

    values, factor = dict(start), 1.0
    for _ in range(_ROUNDS):
        term, before = candidate.build(values), factor
        shown = _shown(beside, candidate, values)

        def passes(log: float, shown=shown) -> float:
            seen = min(np.exp(log) * length - against for length, against in shown.ways)
            return excess(shown, np.exp(log), max(seen, 1e-6) ** 2)

        far = np.log(_FURTHEST)
        if not min(length for length, _ in shown.ways) > 0.0 or passes(far) < 0.0:
            break
        log = -far if passes(-far) > 0.0 else brentq(passes, -far, far, xtol=0.01)
        factor *= float(np.exp(log))
        values, tolerated = candidate.moved(start, factor), False
        if candidate.is_within_tolerance(values):
            # As large as this it is seen, and yet no fault.
            factor *= min(
                candidate.ranges[name].tolerance / away for name, away in candidate.away(values).items() if away
            )
            values, tolerated = candidate.moved(start, factor), True
        if not candidate.allows(values):
            break
        if tolerated or abs(log) < near:
            if planted is not None and alters_commands(term):
                there = shown.over_and_witnessed(factor / before)
                factor = _grown_seen(beside, candidate, start, factor, there, excess, planted)
            return _grown_until_significant(beside, candidate, start, factor)
    return np.inf, {}


def _shown(beside: _Beside, candidate: Candidate, values: Mapping[str, float]) -> _Shown:
    """Return what a term of these values shows."""
    objective, others, term = beside.objective, beside.fit.terms, candidate.build(values)
    moved, share = beside.moved(term)
    rows = [moved, *(beside.moved(one)[0] for one in _other_sign(candidate, values))]
    ways = []
    for one in rows:
        # What is there points the other way for one sign of an effect, and has to be made up for first.
        length = float(np.sqrt(one @ one))
        ways.append((length, abs(float(one @ beside.fit.residuals)) / max(length, 1e-300)))
    beyond, over = (), np.inf
    if others:
        whole = max(float(moved @ moved), 1e-300)
        shared = (objective.posterior is None, True)
        beyond = tuple(costs_of_rows(objective, beside.fit, [moved], shared=one)[0] / whole for one in shared)
        sizes = sizes_of_terms(objective, (*others, term), others)
        over = over_form_error(objective, sizes, sizes_with_form_error(objective, others))
    size = over_allowance(objective, (*others, term), others)
    return _Shown(size, tuple(ways), share, beyond, over, objective.witnessed((*others, term), others))


def _grown_seen(
    beside: _Beside,
    candidate: Candidate,
    start: Mapping[str, float],
    factor: float,
    shown: _Shown,
    excess: Callable[[_Shown, float, float], float],
    planted: Planted,
) -> float:
    """Return a factor, grown until recordings that have the effect pass; infinity beyond its range.

    They have it to either side, where it has two. What it saves there grows with the square of its size at most,
    so that each step ends short of what is sought. `shown` is of the size at which it begins.
    """
    begun = factor

    def growth(saved: float, size: float) -> float:
        """Return by which factor an effect has to grow; 1 where it passes."""

        there = replace(shown.over_and_witnessed(factor / begun), size=size)

        def passes(log: float) -> float:
            return excess(there, np.exp(log), np.exp(2.0 * log) * saved)

        far = np.log(_FURTHEST)
        if saved > 0.0 and passes(0.0) >= 0.0:
            return 1.0
        if not saved > 0.0 or passes(far) < 0.0:
            return _GROWTH
        return max(float(np.exp(brentq(passes, 0.0, far, xtol=0.01))), _LEAST_GROWTH)

    while candidate.allows(values := candidate.moved(start, factor)):
        for term in (candidate.build(values), *_other_sign(candidate, values)):
            saved, size = planted(beside.objective, term, beside.fit.terms)
            grown = growth(shown.share * saved, size)
            if grown > 1.0:
                factor *= grown
                break
        else:
            return factor
    return np.inf


def _grown_until_significant(
    beside: _Beside, candidate: Candidate, start: Mapping[str, float], factor: float
) -> tuple[float, dict[str, float]]:
    """Return a factor and values as of `_smallest`, grown until an interval leaves out no effect."""
    for _ in range(_ROUNDS):
        values = candidate.moved(start, factor)
        if not (np.isfinite(factor) and candidate.allows(values)):
            break
        if _is_significant(beside, Part(candidate, values)):
            return factor, values
        factor *= _GROWTH
    return np.inf, {}


def _is_significant(beside: _Beside, part: Part) -> bool:
    """Return whether a part that leaves what is left now would have an interval without its neutral value.

    Nor may the interval reach where no real car lies beyond.
    """
    objective, fit = beside.objective, beside.fit
    steps = np.array([part.candidate.ranges[name].step for name in part.values])
    slopes = tangent(objective, np.zeros(len(objective.weight)), part, fit.terms).slopes / steps
    slopes = np.hstack([sensitivity_of(objective, fit), slopes])
    both = Fit((*fit.parts, part), fit.cost, fit.residuals, slopes)
    shown = parameter_estimates(objective, both, recorded=False)[-1]

    def is_apart(name: str) -> bool:
        (low, high), limits, neutral = (shown[name].interval_95, part.candidate.ranges[name], part.term.neutral[name])
        return low > neutral and high < limits.upper or high < neutral and low > limits.lower

    return any(is_apart(name) for name in shown if name in part.term.neutral)


def _other_sign(candidate: Candidate, values: Mapping[str, float]) -> tuple[Term, ...]:
    """Return the term as far to the other side, a ratio's inverse; none where a car has but one side of it."""
    neutral = CATALOGUE[candidate.term].neutral
    turned = other_side(neutral, values)
    if any(not candidate.ranges[name].lower < neutral[name] < candidate.ranges[name].upper for name in turned):
        return ()
    return (candidate.build({**values, **turned}),)
