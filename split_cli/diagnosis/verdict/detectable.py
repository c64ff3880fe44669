"""Detection limits: the smallest size of each other effect that would have been named beside the findings."""

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
from split_cli.diagnosis.verdict.faulty_commands import other_side
from split_cli.vehicle.effects import CATALOGUE, Term

#: As `saving_on_faulty_recordings` without its keyword arguments.
FaultySaving = Callable[[MarginalLikelihood, Term, Sequence[Term]], tuple[float, float]]

_ROUNDS = 8  # iterations of the search for a size
_FURTHEST = 1e4  # largest factor on a size that is tried [1]
_GROWTH = 1.25  # factor by which a size grows until its interval excludes no effect [1]
_LEAST_GROWTH = 1.02  # least factor by which a size grows until recordings that have the fault show it [1]
# Logarithms of the last change of a size with which the search ends: for terms that alter inputs, and for others, whose
# saving is proportional to the squared size.
_NEAR, _PROPORTIONAL = np.log(1.2), np.log(4.0)


@dataclass(frozen=True)
class _Beside:
    """The named terms, refitted on one objective, beside which another effect would be found."""

    objective: MarginalLikelihood
    fit: Fit  # of the named terms
    taken: np.ndarray  # (R, P): orthonormal basis of the row changes that their parameters can cause

    def moved(self, term: Term) -> tuple[np.ndarray, float]:
        """Return the change of whitened rows by a further term that the named ones cannot take up, shape (R,).

        Second is its squared length as a share of the whole change's [1].
        """
        rows = self.objective.whiten(self.objective.raw_residual((*self.fit.terms, term))) - self.fit.residuals
        left = rows - self.taken @ (self.taken.T @ rows)
        return left, float(left @ left) / max(float(rows @ rows), 1e-300)


@dataclass(frozen=True)
class _Shown:
    """Evidence that a term of one size would give beside the named ones; it grows in proportion to the size."""

    size: float  # effect-to-noise ratio over the allowance [1]
    # For either sign: length of the row change, and the projection of the present residuals on it, which may oppose it.
    ways: tuple[tuple[float, float], ...]
    share: float  # of the squared length of the change, what the named terms cannot take up [1]
    beyond: tuple[float, ...]  # shares of the saving beyond model-form error, for `beside` of `p_of_effect` [1]
    over: float  # size over the model-form error of the named terms [1]
    witnessed: float  # rms change of the witness that it changes most [1]

    def over_and_witnessed(self, times: float) -> "_Shown":
        """Return the same with `over` and `witnessed` of a term that is so many times as large."""
        return replace(self, over=times * self.over, witnessed=times * self.witnessed)


def detection_limits(
    objectives: Sequence[MarginalLikelihood],
    candidates: Sequence[Candidate],
    variance_inflation: float,
    level: float,
    faulty_saving: FaultySaving | None = None,
    named: Sequence[Part] = (),
) -> tuple[Detectable, ...]:
    """Return the smallest size of each parameter of each further term that would be named on these recordings.

    Parameters
    ----------
    objectives : sequence of MarginalLikelihood
        The last one serves terms that alter inputs or sensors; it may have a fixed baseline.
    candidates : sequence of Candidate
        Terms that act at a place are left out, since their limit depends on the place.
    level : float
        p value that the minimum-effect test has to fall below.
    faulty_saving : callable, optional
        `saving_on_faulty_recordings` for terms that alter commands. Without it their saving is computed from the
        present rows.
    named : sequence of Part
        Findings. They have no limit: their intervals say how well they are known.

    Notes
    -----
    If the effect were there, its term would save the squared length of the row change that it causes, less what the
    present residuals may oppose. The limit holds for either sign of the effect, whose row changes may differ in length.
    The smallest size is found that passes the test of a named term. It grows until its 95 % interval excludes no
    effect. A fault of the commands also changes the whitening filter: its size grows until recordings that have it pass
    the test. If the interval reaches the end of a real car's range, no size is reported, since such a fault would not
    be named. By chance an effect may be named at a slightly smaller or larger size, or an alternative may be named in
    its place.

    Beside findings the saving is what these cannot take up with other values. The effect must exceed their model-form
    error, as a further finding has to, and its interval includes the uncertainty of their values.
    """
    besides = [_beside(objective, named) for objective in objectives]

    def smallest(candidate: Candidate, start: Mapping[str, float]) -> tuple[float, dict[str, float]]:
        beside = besides[-1 if alters_inputs(candidate.build(start)) else 0]
        return _smallest(beside, candidate, start, variance_inflation, level / len(candidates), faulty_saving)

    known = {part.candidate.term for part in named}
    every = _alone([one for one in candidates if one.term not in known])
    tried = [(one, start) for several in every.values() for one, start in several]
    found = iter(map_distributed(lambda one: smallest(*one), tried))
    parameters: dict[str, dict[str, tuple[float, str]]] = {}
    for (term, name), several in every.items():
        # The variant of an effect is not known: the largest limit of all variants is reported.
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
    """Return, by term and parameter, each variant with starting values at which that parameter alone has an effect.

    Parameters of a term need not differ from neutral together: brakes may be weak and the drive sound. A parameter
    without a neutral value, such as a time, keeps its start. Of variants with different numbers of parameters only
    those with the fewest are taken.
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
    faulty_saving: FaultySaving | None,
) -> tuple[float, dict[str, float]]:
    """Return the factor on the start's effect at the limit, and the values; infinity and none beyond its range."""
    near = _NEAR if alters_inputs(candidate.build(start)) else _PROPORTIONAL
    objective, rules = beside.objective, beside.objective.policy

    def excess(shown: _Shown, times: float, saved: float) -> float:
        """Return the margin by which an effect of so many times the size passes the tests: negative if it fails."""
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
            # It would be seen at this size, but is within tolerance: the limit is the tolerance.
            factor *= min(candidate.tolerances[name] / away for name, away in candidate.away(values).items() if away)
            values, tolerated = candidate.moved(start, factor), True
        if not candidate.allows(values):
            break
        if tolerated or abs(log) < near:
            if faulty_saving is not None and term.acts_on_commands():
                there = shown.over_and_witnessed(factor / before)
                factor = _grown_seen(beside, candidate, start, factor, there, excess, faulty_saving)
            return _grown_until_significant(beside, candidate, start, factor)
    return np.inf, {}


def _shown(beside: _Beside, candidate: Candidate, values: Mapping[str, float]) -> _Shown:
    """Return the evidence that a term of these values would give."""
    objective, others, term = beside.objective, beside.fit.terms, candidate.build(values)
    moved, share = beside.moved(term)
    rows = [moved, *(beside.moved(one)[0] for one in _other_sign(candidate, values))]
    ways = []
    for one in rows:
        # For one sign of the effect the present residuals oppose the change.
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
    faulty_saving: FaultySaving,
) -> float:
    """Return the factor, increased until recordings that have the effect pass the tests; infinity beyond the range.

    Effects of both signs have to pass. The saving grows at most with the square of the size, so that each step falls
    short of the limit. `shown` belongs to the initial factor.
    """
    begun = factor

    def growth(saved: float, size: float) -> float:
        """Return the factor by which an effect has to grow; 1 if it passes."""

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
            saved, size = faulty_saving(beside.objective, term, beside.fit.terms)
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
    """Return factor and values as `_smallest` does, increased until the 95 % interval excludes no effect."""
    for _ in range(_ROUNDS):
        values = candidate.moved(start, factor)
        if not (np.isfinite(factor) and candidate.allows(values)):
            break
        if _is_significant(beside, Part(candidate, values)):
            return factor, values
        factor *= _GROWTH
    return np.inf, {}


def _is_significant(beside: _Beside, part: Part) -> bool:
    """Return whether a part would have an interval that contains neither neutral nor an end of a real car's range."""
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
    """Return the term with the opposite effect (a ratio's inverse); empty if a car can have one sign only."""
    neutral = CATALOGUE[candidate.term].neutral
    turned = other_side(neutral, values)
    if any(not candidate.ranges[name].lower < neutral[name] < candidate.ranges[name].upper for name in turned):
        return ()
    return (candidate.build({**values, **turned}),)
