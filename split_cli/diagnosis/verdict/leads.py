"""Leads: explanations that no real car can have, and effects that the named ones may hide."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.search.forward import refusal, sizes_with_form_error
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.search.term_tests import term_p, term_size
from split_cli.diagnosis.statement.result import Lead, ParameterEstimate
from split_cli.diagnosis.statement.sentences import hidden_sentence, lead_sentence
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from split_cli.diagnosis.verdict.findings import one_excludes_no_effect


def find_leads(
    objective: MarginalLikelihood, selection: Selection, variance_inflation: float, *, apart: bool = False
) -> tuple[Lead, ...]:
    """Return what would explain much, had a car what it would need; and what the named effects may hide.

    Parameters
    ----------
    selection : Selection
        With what every term explains alone.
    variance_inflation : float
        By which residual autocorrelation widens chi squared.
    apart : bool
        Whether reality and simulation were driven too differently for an effect of the car to have a name.

    Notes
    -----
    A term whose fit ended at a bound of what a car can have is followed beyond it: alone, and beside what is
    named. It is reported if it then explains a fair share of what is there, and if its interval leaves out no
    effect: what may as well be of the other sign leads nowhere. Nor does what ends at the wider bound, too: that
    is no value. Beside names it has to be what a further name has
    to be, more than their model-form error, beyond doubt.
    """
    chosen, known = selection.chosen, {term.id for term in selection.terms}
    explore = Explorer(objective, tuple(fit.parts[-1].candidate for fit in selection.first), variance_inflation)
    found: dict[str, Lead] = {}
    beside = _beside_names(selection)
    for rest, fits in ((selection.base, selection.first), *beside):
        least = min(chosen.cost, rest.cost) if rest is selection.base else rest.cost
        for lead, free in _leads_beside(objective, rest, fits, least, known):
            if rest is selection.base or _is_believed(explore, rest, free):
                found.setdefault(lead.term, lead)
    beyond = sorted(found.values(), key=lambda one: -one.share)
    hidden = [one for one in _hidden(explore, selection, beside, apart=apart) if one.term not in found]
    return tuple([*beyond, *hidden][: objective.policy.abstention.most_leads])


def _hidden(
    explore: Explorer, selection: Selection, beside: Sequence[tuple[Fit, Sequence[Fit]]], *, apart: bool
) -> list[Lead]:
    """Return effects that a car can have and that save beyond chance beside the names, which may yet be their error.

    Either this effect acts, or a single track gets that much wrong of the named ones. A term without a name that is
    part of the explanation is one of these, too. Of several that save as much the best stands for all.
    """
    objective, level = explore.objective, explore.rules.level / max(len(explore.candidates), 1)
    chosen = selection.chosen
    whole, out = max(selection.base.cost - chosen.cost, 1e-9), []
    taken = {part.candidate.term for part in chosen.parts}
    nameless = [
        (without, [_as_last(chosen, k)])
        for k, (without, named) in enumerate(zip(selection.without, selection.named, strict=True))
        if beside and not named
    ]
    for rest, fits in (*nameless, *beside[:1]):
        for fit in fits:
            part, last, saved = fit.parts[-1], len(fit.parts) - 1, rest.cost - fit.cost
            own = part.candidate
            if own.at_limit(part.values) or part.is_within_tolerance or (own.term in taken and rest is chosen):
                continue
            if len(out) >= objective.policy.abstention.most_leads:
                return out
            sure = term_p(objective, fit, last, saved, explore.variance_inflation) < level
            size = term_size(objective, fit, last) if sure else 0.0
            if size <= objective.policy.allowances.large:
                continue
            estimates = parameter_estimates(objective, fit)[-1]
            if one_excludes_no_effect(own.term, estimates):
                others = _as_good(objective, rest, fits, saved, own.term)
                instead = tuple(term for term, _, _ in others)
                taken |= {own.term, *instead}
                vehicle = objective.evidence[0].vehicle
                sentence = hidden_sentence(own.term, own.variant, estimates, size, instead, vehicle, apart=apart)
                out.append(Lead(own.term, own.variant, estimates, {}, saved / whole, instead, sentence))
    return out


def _as_last(fit: Fit, k: int) -> Fit:
    """Return a fit with one of its parts behind the others."""
    parts = (*fit.parts[:k], *fit.parts[k + 1 :], fit.parts[k])
    return replace(fit, parts=parts, sensitivity=np.empty((len(fit.residuals), 0)))


def _beside_names(selection: Selection) -> list[tuple[Fit, Sequence[Fit]]]:
    """Return what stands beside names, and fits of further terms beside it, each the last of its parts.

    Those are the chosen explanation, and what is left of it without a term that ended at a bound.
    """
    chosen = selection.chosen
    if not selection.terms:
        return []
    found = [(chosen, selection.beside(chosen))]
    for k, (part, without, named) in enumerate(zip(chosen.parts, selection.without, selection.named, strict=True)):
        if not named and part.candidate.at_limit(part.values):
            found.append((without, [_as_last(chosen, k)]))
    return found


def _is_believed(explore: Explorer, rest: Fit, free: Fit) -> bool:
    """Return whether a further term would be named, but for what it needs, and is beyond doubt.

    What no car has is likelier to stand for something else than what cars have.
    """
    objective, last = explore.objective, len(free.parts) - 1
    p_value = term_p(objective, free, last, rest.cost - free.cost, explore.variance_inflation)
    sure = p_value * len(explore.candidates) < explore.rules.sure_level
    return sure and not refusal(explore, rest, sizes_with_form_error(objective, rest.terms), free)


def _leads_beside(
    objective: MarginalLikelihood, rest: Fit, fits: Sequence[Fit], least: float, known: Set[str]
) -> list[tuple[Lead, Fit]]:
    """Return the leads among terms fitted beside the rest of an explanation, which may be nothing, and their fits.

    Parameters
    ----------
    least : float
        What the best explanation costs; that of `fits` may be less.
    """
    rules = objective.policy.abstention
    whole = max(rest.cost - min([least, *(one.cost for one in fits)]), 1e-9)
    bounded: dict[str, Fit] = {}
    for fit in fits:
        part = fit.parts[-1]
        if part.candidate.term not in known and part.candidate.at_limit(part.values):
            bounded.setdefault(part.candidate.term, fit)
    leads = []
    for fit in bounded.values():
        if rest.cost - fit.cost < rules.worth_following * whole:
            continue
        part = fit.parts[-1]
        free = fit_parts(objective, (*fit.parts[:-1], Part(part.candidate.unlimited(), dict(part.values))))
        saved, ends = rest.cost - free.cost, free.parts[-1].candidate.at_limit(free.parts[-1].values)
        enough = saved >= rules.greater_part * whole and not ends
        estimates = parameter_estimates(objective, free)[-1] if enough else {}
        if estimates and one_excludes_no_effect(part.candidate.term, estimates):
            share = saved / max(saved, whole)
            leads.append((_lead(objective, rest, fits, fit, free, estimates, share), free))
    return leads


def _lead(
    objective: MarginalLikelihood,
    rest: Fit,
    fits: Sequence[Fit],
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
    others = _as_good(objective, rest, fits, rest.cost - free.cost, candidate.term)
    sentence = lead_sentence(
        candidate.term,
        candidate.variant,
        estimates,
        sources,
        [(term, variant, p) for term, variant, p in others],
        objective.evidence[0].vehicle,
        further=bool(rest.parts),
    )
    return Lead(candidate.term, candidate.variant, estimates, limits, share, tuple(one[0] for one in others), sentence)


def _as_good(
    objective: MarginalLikelihood, rest: Fit, fits: Sequence[Fit], saved: float, but: str
) -> Sequence[tuple[str, str, Mapping[str, ParameterEstimate]]]:
    """Return terms that save nearly as much within their ranges, with their parameters, best first."""
    rules, out = objective.policy.abstention, {}
    for fit in fits:
        one = fit.parts[-1].candidate
        enough = rest.cost - fit.cost >= (1.0 - objective.policy.selection.fair_share) * saved
        if enough and one.term not in {but, *out} and not one.at_limit(fit.parts[-1].values):
            out[one.term] = (one.term, one.variant, parameter_estimates(objective, fit)[-1])
    return tuple(out.values())[: rules.most_leads]
