"""`rivals_of`: explanations with another term in the place of one part, compared with the chosen explanation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.exchange import in_places_of_two
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit
from split_cli.diagnosis.search.term_tests import error_of_sum, is_witnessed, part_over_allowance


@dataclass(frozen=True)
class Rival:
    """Another explanation, compared with the chosen one."""

    fit: Fit
    # Cost less that of the chosen explanation, with prices, over the larger variance inflation [chi squared].
    excess: float
    z: float  # the same over its standard error by blocks of time [1]


def rivals_of(
    explore: Explorer, chosen: Fit, k: int, rest: Fit, *, better: bool = False, nuisances: Sequence[int] = ()
) -> tuple[tuple[Rival, ...], tuple[Rival, ...]]:
    """Return explanations with part k replaced by other terms, and by other variants of its term, best first.

    A refit of the same variant from another start counts as a variant if it costs less.

    Parameters
    ----------
    rest : Fit
        The explanation without part k.
    better : bool
        Whether mainly rivals with a lower estimated cost are fitted, else also those that may explain as well.
    nuisances : sequence of int
        Numbers of nuisance terms. One that resembles part k is also tried in place of both.
    """
    objective = explore.objective
    variance_inflation = max(explore.variance_inflation, objective.form_error_inflation)
    own = chosen.parts[k].candidate
    reference = objective.block_sums(chosen.residuals**2)
    rivals: list[Rival] = []
    fits = explore(rest, chosen.cost if better else _most_cost_of_rivals(explore, chosen, k, rest))
    for fit in (*fits, *(() if better else in_places_of_two(explore, chosen, k, nuisances))):
        # The part may have ended in a local minimum, as a stretch with other ends.
        of_itself = fit.parts[-1].candidate.label == own.label
        if of_itself and fit.cost > chosen.cost - explore.rules.tie * variance_inflation:
            continue
        difference = (objective.block_sums(fit.residuals**2) - reference) / variance_inflation
        total = float(difference.sum()) + explore.rules.price * (fit.complexity - chosen.complexity)
        # Model-form error does not affect witnesses, so their difference is divided by the smaller inflation.
        evidence, error = _witness_evidence(objective, fit, chosen)
        apart = 1.0 / explore.variance_inflation - 1.0 / variance_inflation
        total, spread = total + apart * evidence, np.hypot(error_of_sum(difference), apart * error)
        rivals.append(Rival(fit, total, total / spread))
    rivals.sort(key=lambda rival: rival.excess)
    of_own = [rival.fit.parts[-1].candidate.term == own.term for rival in rivals]
    return (
        tuple(rival for rival, mine in zip(rivals, of_own, strict=True) if not mine),
        tuple(rival for rival, mine in zip(rivals, of_own, strict=True) if mine),
    )


def _witness_evidence(objective: MarginalLikelihood, fit: Fit, chosen: Fit) -> tuple[float, float]:
    """Return the witnesses' cost of a fit less that of the chosen one, and its standard error; zeros without evidence.

    A lower cost counts only if the last part is a sensor fault that witnesses see, and if it is more than between
    halves of the simulation.
    """
    more = objective.of_witnesses(fit.residuals) ** 2 - objective.of_witnesses(chosen.residuals) ** 2
    total, last = float(more.sum()), len(fit.parts) - 1
    if total < 0.0:
        floor = objective.witness_floors.get(fit.parts[last].candidate.effect, 0.0)
        least = max(floor, objective.policy.selection.price)
        if -total < least or not is_witnessed(objective, fit, last):
            return 0.0, 0.0
    return (total, error_of_sum(more)) if len(more) > 1 else (0.0, 0.0)


def _most_cost_of_rivals(explore: Explorer, chosen: Fit, k: int, rest: Fit) -> float:
    """Return the estimated cost below which a rival of part k is fitted.

    It must save the greater part of what the part saves, or cost no more than the price. If the part itself may be
    model-form error, all rivals are fitted.
    """
    objective, policy = explore.objective, explore.objective.policy
    share = min(1.0 / max(part_over_allowance(objective, chosen, k), 1e-9), 1.0) ** 2
    if policy.self_test.term_margin * share > policy.abstention.greater_part:
        return np.inf
    widened = max(explore.variance_inflation, objective.form_error_inflation)
    price = widened * explore.rules.price * (1.0 + chosen.parts[k].candidate.complexity)
    return chosen.cost + max(policy.abstention.greater_part * (rest.cost - chosen.cost), price)
