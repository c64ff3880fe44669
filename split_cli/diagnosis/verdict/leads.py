"""Explanations that no real car can have: no findings, but leads, with what they would need."""

from collections.abc import Mapping, Sequence

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.statement.result import Lead, ParameterEstimate
from split_cli.diagnosis.statement.sentences import lead_sentence
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from split_cli.diagnosis.verdict.findings import one_excludes_no_effect


def find_leads(objective: MarginalLikelihood, selection: Selection) -> tuple[Lead, ...]:
    """Return what would explain much, had a car what it would need.

    Parameters
    ----------
    selection : Selection
        With what every term explains alone.

    Notes
    -----
    A term whose fit ended at a bound of what a car can have is followed beyond it. It is reported if it then
    explains a fair share of what is there, alone, and if its interval leaves out no effect: what may as well be of
    the other sign leads nowhere.
    """
    rules = objective.policy.abstention
    known = {term.id for term in selection.terms}
    whole = max(selection.base.cost - min(one.cost for one in (selection.chosen, *selection.first)), 1e-9)
    bounded: dict[str, Fit] = {}
    for fit in selection.first:
        part = fit.parts[-1]
        if part.candidate.term not in known and part.candidate.at_limit(part.values):
            bounded.setdefault(part.candidate.term, fit)
    leads = []
    for fit in bounded.values():
        if selection.base.cost - fit.cost < rules.worth_following * whole:
            continue
        part = fit.parts[-1]
        free = fit_parts(objective, (Part(part.candidate.unlimited(), dict(part.values)),))
        saved = selection.base.cost - free.cost
        estimates = parameter_estimates(objective, free)[-1] if saved >= rules.greater_part * whole else {}
        if estimates and one_excludes_no_effect(part.candidate.term, estimates):
            leads.append(_lead(objective, selection, fit, free, estimates, saved / max(saved, whole)))
    return tuple(sorted(leads, key=lambda one: -one.share)[: rules.most_leads])


def _lead(
    objective: MarginalLikelihood,
    selection: Selection,
    bounded: Fit,
    free: Fit,
    estimates: Mapping[str, ParameterEstimate],
    share: float,
) -> Lead:
    """Return the lead that an explanation beyond the bounds of another is."""
    part, candidate = free.parts[-1], bounded.parts[-1].candidate
    limits = {
        name: (limit.lower, limit.upper)
        for name, limit in candidate.ranges.items()
        if not limit.lower <= part.values[name] <= limit.upper
    }
    sources = tuple(dict.fromkeys(candidate.ranges[name].source for name in limits or candidate.ranges))
    saved = selection.base.cost - free.cost
    others = _as_good(objective, selection, saved, candidate.term)
    sentence = lead_sentence(
        candidate.term, candidate.variant, estimates, sources, [(term, variant, p) for term, variant, p in others],
        objective.evidence[0].vehicle,
    )  # fmt: skip
    return Lead(
        candidate.term, candidate.variant, estimates, limits, share, tuple(one[0] for one in others), sentence
    )


def _as_good(
    objective: MarginalLikelihood, selection: Selection, saved: float, but: str
) -> Sequence[tuple[str, str, Mapping[str, ParameterEstimate]]]:
    """Return terms that alone save nearly as much within their ranges, with their parameters, best first."""
    rules, out = objective.policy.abstention, {}
    for fit in selection.first:
        one = fit.parts[-1].candidate
        enough = selection.base.cost - fit.cost >= (1.0 - objective.policy.selection.fair_share) * saved
        if enough and one.term not in {but, *out} and not one.at_limit(fit.parts[-1].values):
            out[one.term] = (one.term, one.variant, parameter_estimates(objective, fit)[-1])
    return tuple(out.values())[: rules.most_leads]
