"""A late channel, found by its witnesses alone: two instruments are compared, without a model of the car.

If model-form error is large, the cost of the equations of motion has many minima over a delay, none at the true value.
Witnesses show delays directly: the change of yaw that of the yaw rate, positions that of the velocities, accelerations
that of both. Their cost has one minimum, and physics that a model lacks does not change it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part, Tangent, sensitivity_of, tangent
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.search.term_tests import witnessed_p
from split_cli.vehicle.calibration.least_squares import solve
from split_cli.vehicle.effects import CATALOGUE


def with_late_channel(
    objective: MarginalLikelihood, selection: Selection, candidates: Sequence[Candidate], variance_inflation: float
) -> Selection | None:
    """Return a selection with the late channel that witnesses show, beside the named terms; None if they show none.

    The delay must save more of the witnesses' cost than between halves of the simulation. It must also save more than
    the cost of the equations of motion rises, weighted by model-form error. Its value is that of the witnesses.
    """
    rules, before = objective.policy.selection, selection
    if not any(selection.named):
        before = replace(selection, chosen=selection.base, without=(), rivals=(), siblings=(), named=())
    base = before.chosen
    part = late_by_witnesses(objective, candidates, base.parts)
    if part is None:
        return None
    linear = tangent(objective, objective.raw_residual(base.terms), part, base.terms)
    fit = _as_it_is(objective, linear, base)
    p_value = witnessed_p(objective, fit, len(base.parts), base, rules) * len(candidates)
    seen = objective.witnesses_cost(base.residuals) - objective.witnesses_cost(fit.residuals)
    lost = fit.cost - base.cost + seen
    evidence = seen / variance_inflation - lost / max(objective.form_error_inflation, variance_inflation)
    own = objective.witness_floors.get(part.candidate.effect, 0.0) / objective.policy.self_test.term_margin
    if p_value >= rules.level or evidence < rules.price or seen < rules.deviations**2 * own:
        return None
    return replace(
        before,
        chosen=fit,
        without=(*(_as_it_is(objective, linear, one) for one in before.without), base),
        rivals=(*before.rivals, ()),
        siblings=(*before.siblings, ()),
        named=(*before.named, True),
        history=(*before.history, f"added {part.candidate.label}, witnesses save {seen:.0f}"),
        first_p=before.first_p if before.named else p_value,
    )


def late_by_witnesses(
    objective: MarginalLikelihood, candidates: Sequence[Candidate], beside: Sequence[Part] = ()
) -> Part | None:
    """Return the late channel that saves most of the witnesses' cost; None if another fault saves nearly as much.

    Savings of the other faults are estimated to first order. None is also returned if a part beside it shifts samples
    in time, since both would describe the same delay.
    """
    rules, named = objective.policy.selection, {part.candidate.term for part in beside}
    before = _left(objective, beside)
    if not len(before) or any(CATALOGUE[one].moves_samples and not CATALOGUE[one].exported for one in named):
        return None
    best, most, others = None, 0.0, [0.0]
    total = float(before @ before)
    for one in candidates:
        kind = CATALOGUE[one.term]
        if kind.exported or not one.starts or one.term in named:
            continue
        if kind.moves_samples:
            part = _fitted(objective, one, beside)
            after = _left(objective, (*beside, part))
            saved = total - float(after @ after)
            if saved > most and len(one.ranges) == 1:
                best, most = part, saved
        else:
            others.append(_saved_along(objective, one, beside, before))
    if best is None or best.candidate.at_limit(best.values) or most < rules.fair_share * total:
        return None
    return best if max(others) < (1.0 - rules.fair_share) * most else None


def _left(objective: MarginalLikelihood, parts: Sequence[Part]) -> np.ndarray:
    """Return the rows of all witnesses with parts corrected, less the mean of each witness, shape (W,)."""
    return objective.of_witnesses(objective.witness_rows([part.term for part in parts]))


def _fitted(objective: MarginalLikelihood, candidate: Candidate, beside: Sequence[Part]) -> Part:
    """Return a delay with the value that minimises the witnesses' cost."""
    names = list(candidate.ranges)
    lower, upper = (np.array([getattr(candidate.ranges[n], end) for n in names]) for end in ("lower", "upper"))

    def left(x: np.ndarray) -> np.ndarray:
        return _left(objective, (*beside, Part(candidate, dict(zip(names, x.tolist(), strict=True)))))

    starts = [np.array([start[name] for name in names]) for start in candidate.starts]
    begin = min(starts, key=lambda x: float(np.sum(left(x) ** 2)))
    steps = np.diag([candidate.ranges[name].step for name in names])

    def with_slopes(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        here = left(x)
        return here, np.stack([(left(x + step) - here) / step.sum() for step in steps], axis=1)

    found = solve(with_slopes, begin, lower, upper, scale=np.inf)  # squares, however large
    return Part(candidate, dict(zip(names, found.parameters.tolist(), strict=True)))


def _saved_along(
    objective: MarginalLikelihood, candidate: Candidate, beside: Sequence[Part], before: np.ndarray
) -> float:
    """Return the saving of the witnesses' cost by a sensor fault, to first order from neutral [chi squared]."""
    neutral, most = CATALOGUE[candidate.term].neutral, 0.0
    for start in candidate.starts:
        sized = [name for name in start if neutral.get(name) is not None]
        none = {**start, **{name: neutral[name] for name in sized}}
        columns = np.stack(
            [_left(objective, (*beside, Part(candidate, {**none, name: start[name]}))) - before for name in sized],
            axis=1,
        )
        weights = np.linalg.lstsq(columns, -before, rcond=1e-9)[0]
        after = before + columns @ weights
        most = max(most, float(before @ before - after @ after))
    return most


def _as_it_is(objective: MarginalLikelihood, linear: Tangent, base: Fit) -> Fit:
    """Return an explanation with one further part at its values, without a refit."""
    residuals = base.residuals + linear.moved
    steps = np.array([linear.part.candidate.ranges[name].step for name in linear.part.values])
    sensitivity = np.hstack([sensitivity_of(objective, base), linear.slopes / steps])
    return Fit((*base.parts, linear.part), float(residuals @ residuals), residuals, sensitivity)
