"""Choice of a term's variant by open-loop errors, where one-step errors do not decide.

Variants of a term differ in how a tyre carries load or loses grip. If much of the gap is unexplained, it may exceed the
one-step difference of the variants. The one that fits the unexplained part best may be wrong in open loop.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.innovations.rollouts import Stage, roll_out_stages, shared_rates
from split_cli.diagnosis.remainder.structure import Structure
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit
from split_cli.diagnosis.search.selection import Selection, explaining_as_well, with_chosen

_TINY = 1e-30  # least mean squared error, so that its logarithm is finite


def with_variants_by_rollout(
    structure: Structure, candidates: Sequence[Candidate], selection: Selection, variance_inflation: float
) -> Selection:
    """Return a selection with another variant of a term, if its open-loop errors are clearly smaller.

    Variants are exchanged only if more than model-form error is unexplained, and if they explain the data as well.

    Parameters
    ----------
    structure : Structure
        With the objective.
    """
    objective, chosen = structure.objective, selection.chosen
    rules = objective.policy.selection
    left = structure.fit(chosen.residuals, variance_inflation)
    unnamed = structure.unnamed_share(left, selection.base.cost - chosen.cost, variance_inflation)
    if unnamed <= rules.form_error_cost:
        return selection
    others = [
        sibling.fit
        for k, siblings in enumerate(selection.siblings)
        for sibling in explaining_as_well(objective, selection, k, siblings, unnamed)
    ]
    if not others:
        return selection
    own, *theirs = open_loop_errors(objective, [chosen, *others])
    best = int(np.argmin(theirs))
    if not theirs[best] < (1.0 - rules.form_error_share) * own:
        return selection
    found = with_chosen(Explorer(objective, tuple(candidates), variance_inflation), selection, others[best])
    if sum(found.named) < sum(selection.named):
        return selection
    label = others[best].parts[-1].candidate.label
    note = f"{label} replaces a variant: {100.0 * theirs[best] / own:.0f} % of its open-loop error"
    return replace(found, history=(*selection.history, note))


def open_loop_errors(objective: MarginalLikelihood, fits: Sequence[Fit]) -> list[float]:
    """Return the open-loop error of each explanation over the noise floor [1].

    It is the geometric mean over channels and the horizons 0.5, 1 and 2 s of rms errors on the real recordings.
    """
    totals, weight = np.zeros(len(fits)), 0
    for one in objective.evidence:
        stages = {
            str(k): Stage(fit.terms, shared_rates(one.series, objective.discrepancy, objective.posterior, fit.terms))
            for k, fit in enumerate(fits)
        }
        errors = roll_out_stages(one, stages, np.ones(len(one.series), dtype=bool))
        if errors is None or not len(errors.t):
            continue
        floor = np.maximum(errors.floor.mean(axis=0), _TINY)  # of a recording without noise
        means = np.maximum([errors.squared[str(k)].mean(axis=0) for k in range(len(fits))], _TINY)
        logs = 0.5 * np.log(means / floor).mean(axis=(1, 2))
        totals += len(errors.t) * logs
        weight += len(errors.t)
    return list(np.exp(totals / max(weight, 1)))
