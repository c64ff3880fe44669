"""Moves between sets of terms that adding, dropping or replacing single terms does not reach.

Each move returns the changed explanation, refitted, or None if it is no better.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from split_cli.diagnosis.parallel import map_in_threads
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.exploration import Explorer, nearest_start, repeats_a_delay
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, sensitivity_of, tangent
from split_cli.diagnosis.search.form_error import free_to_form_error, marginal_cost, saved_in_place_of
from split_cli.diagnosis.search.forward import refusal, sizes_with_form_error, sure_pairs
from split_cli.diagnosis.search.joint import estimated_removal_costs, estimated_removal_of_several, without_needless
from split_cli.diagnosis.search.pairs import estimated_pairs
from split_cli.diagnosis.statement.separation import exact_mimics, look_alike
from split_cli.vehicle.effects import CATALOGUE


def fewer_by_another_variant(explore: Explorer, base: Fit, chosen: Fit, named: Sequence[bool]) -> Fit | None:
    """Return the best explanation without one named part and with another variant of a second one; else None.

    A variant with a further term may equal another variant alone: a scaled and stiffened tyre curve is a scaled peak.
    Or a term corrects the error of a wrong variant. Then removing it costs more, but no more than the model-form error
    of both explanations, and the term would be refused beside the right variant. Linear estimates choose what is
    fitted.
    """
    best, least = None, np.inf
    for parts, gone in _mergers_by_estimated_cost(explore, chosen, named)[: explore.rules.considered]:
        fit = fit_parts(explore.objective, parts, slopes_of=chosen)
        price = explore.price(fit)
        if price < least and (price < explore.price(chosen) or _repairs(explore, chosen, fit, gone)):
            best, least = fit, price
    return best


def _repairs(explore: Explorer, chosen: Fit, without: Fit, gone: Part) -> bool:
    """Return whether a part only corrected a wrong variant: it would be refused beside the right one."""
    if is_better_beside_form_error(explore, chosen, without):
        return False
    sizes = sizes_with_form_error(explore.objective, without.terms)
    back = fit_parts(explore.objective, (*without.parts, gone), slopes_of=without)
    return bool(refusal(explore, without, sizes, back))


def _mergers_by_estimated_cost(
    explore: Explorer, chosen: Fit, named: Sequence[bool]
) -> list[tuple[tuple[Part, ...], Part]]:
    """Return sets of parts with another variant and without one part, and that part, by estimated cost.

    Notes
    -----
    Without part k the residuals change by its effect beside the others, with another variant by the difference of the
    two at the same values. The other parameters adjust to first order, see `Tangent.cost`.
    """
    objective, parts = explore.objective, chosen.parts
    siblings = [(j, one) for j, part in enumerate(parts) for one in _siblings(part.candidate, explore.candidates)]
    if len(parts) < 2 or not siblings:
        return []
    here = objective.raw_residual(chosen.terms)
    sensitivity = sensitivity_of(objective, chosen)
    owner = np.repeat(np.arange(len(parts)), [len(part.values) for part in parts])
    free = free_to_form_error(objective, chosen, together=False)
    seen = free.T @ chosen.residuals
    own = chosen.cost - float(seen @ seen)
    gone = {
        k: objective.whiten(objective.raw_residual(chosen.terms[:k] + chosen.terms[k + 1 :]) - here)
        for k, is_named in enumerate(named)
        if is_named
    }

    def estimates(j: int, sibling: Candidate) -> list[tuple[float, tuple[Part, ...], Part]]:
        others = chosen.terms[:j] + chosen.terms[j + 1 :]
        linear = tangent(objective, here, Part(sibling, dict(parts[j].values)), others)
        out = []
        for k, moved in gone.items():
            if k != j:
                kept = tuple(part for i, part in enumerate(parts) if i not in (j, k))
                rest = Fit(kept, 0.0, chosen.residuals + moved, sensitivity[:, (owner != j) & (owner != k)])
                fewer = chosen.complexity - rest.complexity - sibling.complexity
                worse = linear.cost(rest, free) - own - explore.variance_inflation * explore.rules.price * fewer
                out.append((worse, (*kept, linear.part), parts[k]))
        return out

    found = map_in_threads(lambda one: estimates(*one), siblings)
    most = explore.variance_inflation * explore.rules.price
    cheapest = [one for several in found for one in several if one[0] < most]
    return [(kept, out) for _, kept, out in sorted(cheapest, key=lambda one: one[0])]


def is_better_beside_form_error(explore: Explorer, fit: Fit, than: Fit) -> bool:
    """Return whether a fit costs less than another with price, also beside the model-form error of both.

    Several terms may imitate one, and fit better because of its model-form error.
    """
    # Of equally good explanations the one with fewer terms stays.
    least = explore.rules.price if len(fit.parts) > len(than.parts) else explore.rules.tie
    if explore.price(fit) > explore.price(than) - least:
        return False
    price = explore.rules.price * (fit.complexity - than.complexity)
    return saved_in_place_of(explore.objective, than, fit, explore.variance_inflation) > price + least


def with_fewer_parts(explore: Explorer, chosen: Fit, rivals: Sequence[Fit]) -> Fit | None:
    """Return the best explanation with fewer parts: the chosen one or a rival without one, or it without several.

    None is returned if the chosen explanation or a rival is better. Two terms may imitate a third one, which saves
    little beside either of them. As a rival of one it makes the other needless. Added beside both, it leaves them a
    small shared saving, so that both are removed together. Linear estimates choose what is fitted.

    Parameters
    ----------
    rivals : sequence of Fit
        Explanations with another term, the last part, in place of one.
    """
    rules, cheapest = explore.rules, []
    limit = min(explore.price(chosen) - rules.tie, *(explore.price(fit) + rules.tie for fit in rivals or [chosen]))
    for fit in (chosen, *rivals) if len(chosen.parts) > 1 else ():
        others = len(fit.parts) - (fit is not chosen)
        if not others:  # one term in the places of two
            continue
        # Removing a part saves at most its price.
        most = rules.price * max(part.candidate.complexity for part in fit.parts[:others])
        if fit is not chosen and explore.price(fit) - most >= limit:
            continue
        # The copy discards the sensitivity that is computed for it.
        asked = fit if fit is chosen else replace(fit)
        leaving = [(dearer, (k,)) for k, dearer in enumerate(estimated_removal_costs(explore, asked)[:others])]
        if fit is chosen:
            leaving.append(estimated_removal_of_several(explore, fit))
        for dearer, gone in leaving:
            if explore.price(fit) + dearer < limit:
                cheapest.append((explore.price(fit) + dearer, fit, gone))
    best, least = None, limit
    for _, fit, gone in sorted(cheapest, key=lambda one: one[0])[: rules.considered]:
        kept = [part for k, part in enumerate(fit.parts) if k not in gone]
        rest = fit_parts(explore.objective, kept, slopes_of=fit)
        if explore.price(rest) < least:
            best, least = rest, explore.price(rest)
    return best


def pair_as_one(
    explore: Explorer, base: Fit, chosen: Fit, named: Sequence[bool], rivals: Sequence[Fit] = ()
) -> Fit | None:
    """Return the best explanation with two parts replaced by the one term that equals both; None if it costs more.

    Steering and torque with the same delay are late sensors, for example. With different delays a third, wrong term
    makes up for the difference, so that only the exchange together with another term in its place costs less.

    Parameters
    ----------
    rivals : sequence of Fit
        Explanations with another term in place of one, best first.
    """
    best, least = None, explore.price(chosen)
    for one in explore.candidates:
        pairs = {frozenset(terms.split("+")) for terms in exact_mimics(one.term, one.variant) if "+" in terms}
        several = [
            (fit, [p for p in fit.parts if any(p.candidate.term in pair for pair in pairs)])
            for fit in (chosen, *rivals)
        ]
        both = [
            (fit, own)
            for fit, own in several
            if frozenset(part.candidate.term for part in own) in pairs and one.term not in fit.names
        ]
        for fit, own in both[: explore.rules.full_fits] if one.starts else ():
            others = [part for part in fit.parts if part not in own]
            parts = (*others, Part(one, nearest_start(one, own[0])))
            trial = fit_parts(explore.objective, parts, slopes_of=fit)
            if explore.price(trial) < least:
                best, least = trial, explore.price(trial)
    return best


def all_as_one(explore: Explorer, base: Fit, chosen: Fit, named: Sequence[bool]) -> Fit | None:
    """Return one term in place of all named ones, if it costs no more beside model-form error; else None.

    Two terms may imitate one and fit better because of its model-form error: a softer tyre and late steering look like
    a steering gain. The single term must have fewer parameters and save nearly as much.
    """
    if sum(named) < 2:
        return None
    enough = (1.0 - explore.rules.fair_share) * (base.cost - chosen.cost)
    taken = {part.candidate.term for part in chosen.parts}
    best, most = None, -np.inf
    for fit in explore(base)[: explore.rules.full_fits]:
        own = fit.parts[-1]
        if base.cost - fit.cost < enough or own.candidate.term in taken or fit.complexity >= chosen.complexity:
            continue
        if own.candidate.at_limit(own.values) or own.is_within_tolerance:
            continue
        saved = saved_in_place_of(explore.objective, chosen, fit, explore.variance_inflation)
        if saved >= 0.0 and saved > most:
            best, most = fit, saved
    return best


def in_places_of_two(explore: Explorer, chosen: Fit, k: int, nuisances: Sequence[int]) -> list[Fit]:
    """Return explanations with one term, the last part, for part k and a nuisance term that resembles it.

    A small bias of a velocity may be a nuisance beside a turned sensor, for example, although the bias alone might
    explain both.
    """
    own, fits = chosen.parts[k], []
    for j in nuisances:
        term = chosen.parts[j].candidate.term
        if j != k and term != own.candidate.term and look_alike(own.candidate.term, term):
            others = [part for i, part in enumerate(chosen.parts) if i not in (j, k)]
            alike = [one for one in explore.candidates if one.term == term and one.starts]
            fits += [
                fit_parts(explore.objective, (*others, Part(one, nearest_start(one, own))), slopes_of=chosen)
                for one in alike
            ]
    return fits


def inverted_stretch(explore: Explorer, chosen: Fit) -> Fit | None:
    """Return the best explanation with a stretch of road in place of the rest of the lap, if it costs less; else None.

    A slope on a stretch equals the opposite slope on the rest of the lap, with a longitudinal force and a bias of the
    accelerometer. The rest of the lap may be found first if it also stands for a missing drag. Then no exchange of a
    single term costs less. So the stretch is also fitted with the term that saves most beside it.
    """
    best, least = None, explore.price(chosen) - explore.rules.tie
    closed = explore.objective.evidence[0].series.lap_length is not None
    for k, part in enumerate(chosen.parts if closed and len(chosen.parts) > 1 else ()):
        if "s_start" in part.values:
            values = part.candidate.moved(part.values, -1.0)
            rest = Part(part.candidate, {**values, "s_start": values["s_end"], "s_end": values["s_start"]})
            others = chosen.parts[:k] + chosen.parts[k + 1 :]
            there = fit_parts(explore.objective, (*others, rest), slopes_of=chosen)
            for begun in (there, *explore(there)[:1]):
                fit = without_needless(explore, begun)
                few = len(fit.parts) <= len(chosen.parts) and not any(map(explore.is_everywhere, fit.parts))
                if few and explore.price(fit) < least:
                    best, least = fit, explore.price(fit)
    return best


def one_as_pair(explore: Explorer, base: Fit, chosen: Fit, named: Sequence[bool]) -> Fit | None:
    """Return the best explanation with a named part replaced by two that together resemble it; else None.

    Late sensors resemble late steering with late torque. Two terms may fit better because of model-form error, so they
    must also be better beside the model-form error of both explanations. Late sensors beside a steering that is logged
    late by less are two late commands: these are stated where they fit as well, since neither undoes a part of another.
    """
    rules = explore.rules
    best, least = None, explore.price(chosen) - rules.tie
    for k, part in enumerate(chosen.parts):
        others = chosen.parts[:k] + chosen.parts[k + 1 :]
        taken = {one.candidate.term for one in others}
        for pair in _pairs_like(part, explore.candidates) if named[k] else ():
            names = [one.candidate.term for one in pair]
            if taken & {*names}:
                continue
            kept = [one for one in others if not repeats_a_delay([*names, one.candidate.term])]
            fit = fit_parts(explore.objective, (*kept, *pair), slopes_of=chosen)
            price = explore.price(fit)
            as_good = best is None and len(kept) < len(others) and price < explore.price(chosen) + rules.tie
            if as_good or (price < least and is_better_beside_form_error(explore, fit, chosen)):
                best, least = fit, min(least, price)
    return best


def one_as_hidden_pair(explore: Explorer, base: Fit, chosen: Fit, named: Sequence[bool]) -> Fit | None:
    """Return the best explanation with two terms that hide each other in place of a named part; None without any.

    A late steering of a car with less yaw inertia looks like a tyre that relaxes, for example. Each of the two saves
    little without the other, so that no exchange of single terms leads to them. Linear estimates choose what is fitted.
    On rows about the nominal model none is tried: their bias (docs/decisions/0043) is what such a pair could explain.
    """
    if not explore.objective.about_explanation:
        return None
    rules = explore.rules

    def marginal_price(fit: Fit) -> float:
        return marginal_cost(explore.objective, fit, explore.variance_inflation) + rules.price * fit.complexity

    best, least, bound = None, explore.price(chosen) - rules.tie, None
    for k, rest in enumerate(explore.without(base, chosen)):
        own = chosen.parts[k].candidate.term
        pairs = estimated_pairs(explore, rest) if named[k] else []
        others = [one for one in pairs if own not in (linear.part.candidate.term for linear in one[1:])]
        for fit in sure_pairs(explore, rest, others, least):
            bound = marginal_price(chosen) - rules.tie if bound is None else bound
            if explore.price(fit) < least and marginal_price(fit) < bound:
                best, least = fit, explore.price(fit)
    return best


def move_in_words(before: Fit, after: Fit) -> str:
    """Return a move in words, for the history."""
    come, gone = sorted(set(after.names) - set(before.names)), sorted(set(before.names) - set(after.names))
    kept = {part.candidate.label for part in after.parts} <= {part.candidate.label for part in before.parts}
    if kept and gone:
        return f"without {' and '.join(gone)}"
    return f"{' and '.join(come) or 'another variant'} in place of {' and '.join(gone) or 'nothing'}"


def _siblings(own: Candidate, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return other variants of a candidate that have its parameters."""
    return [
        one
        for one in candidates
        if one.term == own.term and one.variant != own.variant and set(one.ranges) == set(own.ranges)
    ]


def _pairs_like(part: Part, candidates: Sequence[Candidate]) -> list[tuple[Part, Part]]:
    """Return pairs of terms that are declared to resemble a part, or whose members resemble members of such a pair."""
    plain: dict[str, Candidate] = {}
    for one in candidates:
        if one.starts:
            plain.setdefault(one.term, one)

    def like(name: str) -> list[Part]:
        alike = [name, *(other for other in plain if other != part.candidate.term and look_alike(name, other))]
        return [Part(plain[one], nearest_start(plain[one], part)) for one in alike if one in plain]

    pairs = [mimic.terms.split("+") for mimic in CATALOGUE[part.candidate.term].mimics]
    members = [product(like(pair[0]), like(pair[1])) for pair in pairs if len(pair) == 2]
    return [pair for several in members for pair in several if pair[0].candidate.term != pair[1].candidate.term]
