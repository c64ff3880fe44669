"""Leads: explanations beyond the range of a real car, and effects that the findings may hide."""

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
    """Return the leads of a search: explanations beyond a real car's range first, then effects that may be hidden.

    Parameters
    ----------
    selection : Selection
        With the fits of every term alone.
    variance_inflation : float
        Factor by which residual autocorrelation widens chi squared [1].
    apart : bool
        Whether reality and simulation were driven too differently for an effect of the car to have a name.

    Notes
    -----
    A term whose fit ended at a bound of a real car's range is fitted again with wider bounds: alone, and beside the
    findings. It is a lead if it then explains a large share, if it does not end at the wider bound, and if its interval
    excludes no effect. Alone it is no lead where a finding explains as much. Beside findings it must also pass the
    tests of a further finding, with a stricter level.
    """
    chosen, names = selection.chosen, {term.id for term in selection.terms}
    explore = Explorer(objective, tuple(fit.parts[-1].candidate for fit in selection.first), variance_inflation)
    found: dict[str, Lead] = {}
    beside = _beside_names(selection)
    for rest, fits in ((selection.base, selection.first), *beside):
        least = min(chosen.cost, rest.cost) if rest is selection.base else rest.cost
        for lead, free in _leads_beside(objective, rest, fits, least, names):
            if rest is selection.base and names.intersection(lead.instead):
                continue  # a finding explains it as well, and real cars have its value
            if rest is selection.base or _passes_strict_tests(explore, rest, free):
                found.setdefault(lead.term, lead)
    beyond = sorted(found.values(), key=lambda one: -one.share)
    hidden = [one for one in _hidden(explore, selection, beside, apart=apart) if one.term not in found]
    return tuple([*beyond, *hidden][: objective.policy.abstention.most_leads])


def _hidden(
    explore: Explorer, selection: Selection, beside: Sequence[tuple[Fit, Sequence[Fit]]], *, apart: bool
) -> list[Lead]:
    """Return effects within a car's range that save beyond chance, but may be model-form error of the findings.

    Nuisance terms of the explanation are included. Of several effects that save as much, the best is reported with the
    others as alternatives.
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
    """Return a fit with part k moved to the end."""
    parts = (*fit.parts[:k], *fit.parts[k + 1 :], fit.parts[k])
    return replace(fit, parts=parts, sensitivity=np.empty((len(fit.residuals), 0)))


def _beside_names(selection: Selection) -> list[tuple[Fit, Sequence[Fit]]]:
    """Return explanations with findings, each with fits of further terms beside it, the further term last.

    These are the chosen explanation, and that without a term that ended at a bound.
    """
    chosen = selection.chosen
    if not selection.terms:
        return []
    found = [(chosen, selection.beside(chosen))]
    for k, (part, without, named) in enumerate(zip(chosen.parts, selection.without, selection.named, strict=True)):
        if not named and part.candidate.at_limit(part.values):
            found.append((without, [_as_last(chosen, k)]))
    return found


def _passes_strict_tests(explore: Explorer, rest: Fit, free: Fit) -> bool:
    """Return whether a further term passes the tests of a finding except for its range, at the strict level.

    An explanation beyond a car's range is more likely to stand for another effect.
    """
    objective, last = explore.objective, len(free.parts) - 1
    p_value = term_p(objective, free, last, rest.cost - free.cost, explore.variance_inflation)
    sure = p_value * len(explore.candidates) < explore.rules.sure_level
    return sure and not refusal(explore, rest, sizes_with_form_error(objective, rest.terms), free)


def _leads_beside(
    objective: MarginalLikelihood, rest: Fit, fits: Sequence[Fit], least: float, names: Set[str]
) -> list[tuple[Lead, Fit]]:
    """Return the leads among terms fitted beside `rest`, which may be without parts, and their fits.

    Parameters
    ----------
    least : float
        Cost of the best explanation; one of `fits` may cost less.
    """
    rules = objective.policy.abstention
    whole = max(rest.cost - min([least, *(one.cost for one in fits)]), 1e-9)
    bounded: dict[str, Fit] = {}
    for fit in fits:
        part = fit.parts[-1]
        if part.candidate.term not in names and part.candidate.at_limit(part.values):
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
    """Return the lead for the fit `free` with wider bounds than `bounded`."""
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
    """Return term, variant and estimates of terms other than `but` that save nearly as much within their ranges."""
    rules, out = objective.policy.abstention, {}
    for fit in fits:
        one = fit.parts[-1].candidate
        enough = rest.cost - fit.cost >= (1.0 - objective.policy.selection.fair_share) * saved
        if enough and one.term not in {but, *out} and not one.at_limit(fit.parts[-1].values):
            out[one.term] = (one.term, one.variant, parameter_estimates(objective, fit)[-1])
    return tuple(out.values())[: rules.most_leads]
