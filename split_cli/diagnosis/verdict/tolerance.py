"""Sensor errors within tolerance: they are part of an explanation, but no finding.

An example is a small bias of the yaw rate in a recording without position, which no witness tells from the car.
"""

from collections.abc import Mapping

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.search.term_tests import term_p, term_size
from split_cli.diagnosis.statement.result import Lead, ParameterEstimate
from split_cli.diagnosis.statement.sentences import tolerance_sentence
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from split_cli.vehicle.effects import CATALOGUE

#: Share of what is usual, from which on a sensor's error is a lead [1]. Judgement: a bias of 0.015 m/s^2 where
#: 0.245 m/s^2 is usual is below what an accelerometer resolves.
_WORTH_A_LEAD = 0.1


def named_or_tolerated(selection: Selection) -> tuple[bool, ...]:
    """Return which parts of an explanation are known to act: the named ones, and sensor errors within tolerance."""
    return tuple(
        named or part.is_within_tolerance for part, named in zip(selection.chosen.parts, selection.named, strict=True)
    )


def tolerance_leads(
    objective: MarginalLikelihood, selection: Selection, variance_inflation: float, *, taken_off: bool
) -> tuple[Lead, ...]:
    """Return sensor errors within tolerance that save beyond chance and are large enough to be seen, as leads.

    Left out are errors below a tenth of what is usual, unless figures of held-out time are without them. Those figures
    are of velocities, which the error of an accelerometer does not change.

    Parameters
    ----------
    variance_inflation : float
        Factor by which residual autocorrelation widens chi squared [1].
    taken_off : bool
        Whether held-out errors with the findings are those after correction of these errors.
    """
    fit, policy = selection.chosen, objective.policy
    whole, out = max(selection.base.cost - fit.cost, 1e-9), []
    for k, (part, without) in enumerate(zip(fit.parts, selection.without, strict=True)):
        saved = without.cost - fit.cost
        if (
            selection.named[k]
            or not part.is_within_tolerance
            or term_p(objective, fit, k, saved, variance_inflation) >= policy.selection.level
        ):
            continue
        if term_size(objective, fit, k) > policy.allowances.large:
            own, estimates = part.candidate, parameter_estimates(objective, fit)[k]
            limits = {name: own.tolerances[name] for name in own.away(part.values)}
            if not is_worth_a_word(estimates, limits, own.term, taken_off=taken_off):
                continue
            sentence = tolerance_sentence(own.term, own.variant, estimates, limits, taken_off=taken_off)
            out.append(Lead(own.term, own.variant, estimates, {}, saved / whole, (), sentence))
    return tuple(out)


def is_worth_a_word(
    estimates: Mapping[str, ParameterEstimate], limits: Mapping[str, float], term: str, *, taken_off: bool
) -> bool:
    """Return whether an error reaches a fair share of what is usual, or changes the velocities that are judged."""
    if taken_off and any(one.unit != "m/s^2" for one in estimates.values()):
        return True
    neutral = CATALOGUE[term].neutral
    return any(abs(estimates[k].value - neutral[k]) >= _WORTH_A_LEAD * limit for k, limit in limits.items())
