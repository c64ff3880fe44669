"""Moves between sets of terms that adding, dropping and replacing one at a time do not reach."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.exploration import Explorer, nearest_start
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.statement.separation import exact_mimics, look_alike
from split_cli.vehicle.effects import CATALOGUE

__all__ = ["joined", "merged", "said_of", "split"]


def merged(explore: Explorer, base: Fit, chosen: Fit, named: Sequence[bool]) -> Fit | None:
    """Return the best explanation with one part less and another in another variant, where that is no dearer.

    A variant with another term may be a second variant alone: the whole curve of a tyre scaled and made stiffer is
    its peak scaled. Tried are parts one of which declares that the other is part of what looks like it.
    """
    best, least = None, explore.price(chosen)
    parts = chosen.parts
    for k, gone in enumerate(parts):
        for j, kept in enumerate(parts):
            if j == k or not _declares(gone.candidate.term, kept.candidate.term):
                continue
            others = [part for i, part in enumerate(parts) if i not in (j, k)]
            for sibling in _siblings(kept.candidate, explore.candidates):
                fit = fit_parts(explore.objective, (*others, Part(sibling, dict(kept.values))))
                if explore.price(fit) < least:
                    best, least = fit, explore.price(fit)
    return best


def joined(explore: Explorer, base: Fit, chosen: Fit, named: Sequence[bool]) -> Fit | None:
    """Return the best explanation with two parts replaced by the one term that is both, where that is no dearer.

    Steering and torque that are late by the same are sensors that are late.
    """
    best, least = None, explore.price(chosen)
    for one in explore.candidates:
        pairs = {frozenset(terms.split("+")) for terms in exact_mimics(one.term, one.variant) if "+" in terms}
        own = [part for part in chosen.parts if any(part.candidate.term in pair for pair in pairs)]
        if not one.starts or frozenset(part.candidate.term for part in own) not in pairs:
            continue
        others = [part for part in chosen.parts if part not in own]
        fit = fit_parts(explore.objective, (*others, Part(one, nearest_start(one, own[0]))))
        if explore.price(fit) < least:
            best, least = fit, explore.price(fit)
    return best


def split(explore: Explorer, base: Fit, chosen: Fit, named: Sequence[bool]) -> Fit | None:
    """Return the best explanation with one named part replaced by two that together look like it, if that saves.

    Late sensors look like late steering and late torque together. One more name has to save what a single track
    may get wrong of the whole as well, and its price where model-form error widens chance.
    """
    rules = explore.rules
    widened = max(explore.variance_inflation, explore.objective.form_error_inflation)
    burden = rules.form_error_cost * (base.cost - chosen.cost) / explore.variance_inflation
    best, least = None, explore.price(chosen) - burden - rules.tie
    for k, part in enumerate(chosen.parts):
        others = chosen.parts[:k] + chosen.parts[k + 1 :]
        taken = {one.candidate.term for one in others}
        for pair in _pairs_like(part, explore.candidates) if named[k] else ():
            if not taken & {one.candidate.term for one in pair}:
                fit = fit_parts(explore.objective, (*others, *pair))
                worth = (chosen.cost - fit.cost) / widened > rules.price * (fit.complexity - chosen.complexity)
                if worth and explore.price(fit) < least:
                    best, least = fit, explore.price(fit)
    return best


def said_of(before: Fit, after: Fit) -> str:
    """Return a move in words, for the history."""
    come, gone = sorted(set(after.names) - set(before.names)), sorted(set(before.names) - set(after.names))
    return f"{' and '.join(come) or 'another variant'} in place of {' and '.join(gone)}"


def _siblings(own: Candidate, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return other variants of a candidate that have its parameters."""
    return [
        one
        for one in candidates
        if one.term == own.term and one.variant != own.variant and set(one.ranges) == set(own.ranges)
    ]


def _declares(term: str, other: str) -> bool:
    """Return whether one of two terms is among what looks like the other, alone or together with more."""
    return any(
        b in mimic.terms.split("+") for a, b in ((term, other), (other, term)) for mimic in CATALOGUE[a].mimics
    )


def _pairs_like(part: Part, candidates: Sequence[Candidate]) -> list[tuple[Part, Part]]:
    """Return pairs of terms that are declared to look like a part, or of which each looks like a member of one."""
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
