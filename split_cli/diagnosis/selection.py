"""Which terms earn their place: forward selection, backward elimination, and what looks the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.candidates import Candidate
from split_cli.diagnosis.fitting import Fit, Part, fit_parts, linear_cost, scan_places
from split_cli.diagnosis.judge import Judge, alters_inputs
from split_cli.diagnosis.structure import TERM_FLOOR, minimum_effect_p, severity_of, term_allowance
from split_cli.vehicle.effects import Term

__all__ = ["Rival", "Rules", "Selection", "nothing", "select_terms", "term_p", "term_size"]


@dataclass(frozen=True)
class Rules:
    """Settings of the selection, one for all cases."""

    price: float = 8.0  # cost a searched parameter has to save, before inflation
    most_terms: int = 3
    most_aside: int = 2  # terms that save more than chance but are too small to name
    most_of_lap: float = 0.75  # a stretch that is longer is no stretch
    full_fits: int = 9
    followed: int = 5  # of the best, in which the common physics follows the inputs they change
    same_within: float = 2.5  # standard errors of the paired block difference
    same_excess: float = 9.0  # cost above the chosen one, after inflation
    same_share: float = 0.15  # of what the chosen term saves: beyond it, a rival is worse whatever its error
    least_share: float = 0.005  # of the explained cost, for a further term
    misfit: float = 0.10  # of what the chosen terms explain in the same channels
    spread: float = 1.5  # standard errors, from differences block by block, that a further term has to save
    swaps: int = 2
    level: float = 0.01  # of the minimum-effect test, after counting the terms that were tried


@dataclass(frozen=True)
class Rival:
    """Another explanation of the same rows, with how it compares.

    Attributes
    ----------
    fit : Fit
    excess : float
        Cost above the chosen explanation, prices included, in units of chi squared after inflation.
    z : float
        The same over its standard error from differences block by block.
    """

    fit: Fit
    excess: float
    z: float


@dataclass(frozen=True)
class Selection:
    """The chosen explanation and everything it was compared with.

    Attributes
    ----------
    base, chosen : Fit
        Nothing added, and the explanation.
    rivals : tuple of tuple of Rival
        For each part of the chosen fit that is named, that part replaced by every other candidate, best first.
    named : tuple of bool
        Which parts are large enough to be named; the others are kept aside, so that they take nothing from these.
    history : tuple of str
        What was added or removed, in order, in words.
    first_p : float
        Smallest minimum-effect p value of a term that was tried, times the number of terms tried.
    """

    base: Fit
    chosen: Fit
    rivals: tuple[tuple[Rival, ...], ...]
    named: tuple[bool, ...]
    history: tuple[str, ...]
    first_p: float

    @property
    def terms(self) -> tuple[Term, ...]:
        """The named terms."""
        return tuple(term for term, named in zip(self.chosen.terms, self.named, strict=True) if named)


def nothing(judge: Judge) -> Fit:
    """Return the explanation without any term."""
    entries = judge.whiten(judge.residual(()))
    return Fit((), float(entries @ entries), entries, np.empty((len(entries), 0)))


def price(fit: Fit, inflation: float, rules: Rules) -> float:
    """Return a fit's cost with the price of its parameters."""
    return fit.cost / inflation + rules.price * fit.complexity


def explore(
    judge: Judge, current: Fit, candidates: Sequence[Candidate], rules: Rules, inflation: float
) -> list[Fit]:
    """Add each candidate to the current explanation; return the promising ones fitted, best first."""
    taken = {part.candidate.term for part in current.parts}
    base = judge.residual(current.terms)
    promises = []
    for candidate in candidates:
        if candidate.term in taken:
            continue
        starts = candidate.starts or scan_places(judge, current.terms, base, candidate)
        for start in starts:
            part = Part(candidate, dict(start))
            promises.append((linear_cost(judge, current.parts, part), part))
    promises.sort(key=lambda promise: promise[0] / inflation + rules.price * promise[1].candidate.complexity)
    fits, seen = [], {}
    for _, part in promises:
        key = (part.candidate.term, part.candidate.variant)
        if seen.get(key, 0) >= 2 or (key not in seen and len(seen) >= rules.full_fits):
            continue
        seen[key] = seen.get(key, 0) + 1
        settled = any(alters_inputs(one.term) for one in current.parts)
        fits.append(fit_parts(judge, (*current.parts, part), refreshes=int(settled)))
    fits = [fit for fit in fits if not _is_everywhere(fit.parts[-1], rules)]
    fits.sort(key=lambda fit: price(fit, inflation, rules))
    best, done = [], set()
    for fit in fits:
        key = (fit.parts[-1].candidate.term, fit.parts[-1].candidate.variant)
        if key in done:
            continue
        done.add(key)
        # Only what may win is worth following with the common physics.
        again = len(done) <= rules.followed and any(alters_inputs(term) for term in fit.terms)
        best.append(fit_parts(judge, fit.parts) if again else fit)
    best.sort(key=lambda fit: price(fit, inflation, rules))
    return best


def _is_everywhere(part: Part, rules: Rules) -> bool:
    """Return whether a stretch covers so much of the track that it is none."""
    if "s_start" not in part.values:
        return False
    reach = part.candidate.ranges["s_end"].upper
    return (part.values["s_end"] - part.values["s_start"]) % reach > rules.most_of_lap * reach


def select_terms(
    judge: Judge, candidates: Sequence[Candidate], inflation: float, rules: Rules | None = None
) -> Selection:
    """Add the term that saves most while one earns its price, then drop those that no longer do."""
    rules = rules or Rules()
    base = chosen = nothing(judge)
    history: list[str] = []
    first_p = 1.0
    aside = 0
    while len(chosen.parts) - aside < rules.most_terms:
        fits = explore(judge, chosen, candidates, rules, inflation)
        if not fits:
            break
        best = fits[0]
        label = best.parts[-1].candidate.label
        saved = price(chosen, inflation, rules) - price(best, inflation, rules)
        share = (chosen.cost - best.cost) / max(base.cost - best.cost, 1e-12)
        if saved <= 0.0 or (chosen.parts and share < rules.least_share):
            break
        if chosen.parts and _is_misfit(judge, base, chosen, best, rules):
            history.append(f"{label} would save {saved:.0f}, no more than the others misfit")
            break
        if chosen.parts and block_z(judge, best, chosen) < rules.spread:
            history.append(f"{label} would save {saved:.0f}, all in one moment")
            break
        p_value = term_p(judge, best, len(best.parts) - 1, chosen.cost - best.cost, inflation) * len(candidates)
        first_p = min(first_p, p_value)
        if p_value >= rules.level:
            history.append(f"{label} saves {saved:.0f}, too small to name")
            aside += 1
            if aside > rules.most_aside:
                break
            chosen = best
            continue
        history.append(f"added {label}, saves {saved:.0f}")
        chosen, dropped = _prune(judge, best, inflation, rules)
        history += dropped
    for swap in range(1 + rules.swaps):
        named = _large_enough(judge, base, chosen, len(candidates), inflation, rules)
        rivals = tuple(
            _rivals(judge, chosen, k, candidates, inflation, rules) if named[k] else ()
            for k in range(len(chosen.parts))
        )
        better = min((several[0] for several in rivals if several), key=lambda one: one.excess, default=None)
        if swap == rules.swaps or len(chosen.parts) < 2 or better is None or better.excess >= 0.0:
            break
        history.append(f"{better.fit.parts[-1].candidate.label} takes a place, saves {-better.excess:.0f}")
        chosen = better.fit
    return Selection(base, chosen, rivals, named, tuple(history), first_p)


def _large_enough(
    judge: Judge, base: Fit, fit: Fit, tried: int, inflation: float, rules: Rules
) -> tuple[bool, ...]:
    """Return which parts of an explanation are large enough to be named, each removed last."""
    out = []
    for k in range(len(fit.parts)):
        others = fit.parts[:k] + fit.parts[k + 1 :]
        without = fit_parts(judge, others) if others else base
        out.append(term_p(judge, fit, k, without.cost - fit.cost, inflation) * tried < rules.level)
    return tuple(out)


def block_z(judge: Judge, fit: Fit, other: Fit) -> float:
    """Return what a fit saves against another in standard errors, from differences block by block."""
    difference = judge.block_sums(other.entries**2) - judge.block_sums(fit.entries**2)
    return float(difference.sum()) / (float(np.sqrt(len(difference) * np.var(difference, ddof=1))) + 1e-9)


def _is_misfit(judge: Judge, base: Fit, chosen: Fit, further: Fit, rules: Rules) -> bool:
    """Return whether a further term saves no more than single-track terms leave of a real car's effect.

    Counted in the channels in which the further term saves: what one term leaves is of its own kind.
    """
    before, now, then = (judge.channel_sums(fit.entries**2) for fit in (base, chosen, further))
    gained, explained = np.maximum(now - then, 0.0), np.maximum(before - now, 0.0)
    weight = gained / max(float(gained.sum()), 1e-12)
    return float(gained.sum()) < rules.misfit * float(weight @ explained)


def term_size(judge: Judge, fit: Fit, k: int) -> float:
    """Return the severity of one part of an explanation, the others in place."""
    others = fit.terms[:k] + fit.terms[k + 1 :]
    pairs = zip(judge.evidence, judge.keep, strict=True)
    return max(severity_of(one, one.at[mask], fit.terms, others) for one, mask in pairs)


def term_p(judge: Judge, fit: Fit, k: int, saved: float, inflation: float) -> float:
    """Return the minimum-effect p value of one part of an explanation that saves `saved`."""
    candidate = fit.parts[k].candidate
    floor = max(TERM_FLOOR * judge.shared_cost, judge.term_floors.get(candidate.term, 0.0))
    size = term_size(judge, fit, k)
    return minimum_effect_p(saved, candidate.complexity, size, inflation, floor, term_allowance(judge))


def _prune(judge: Judge, fit: Fit, inflation: float, rules: Rules) -> tuple[Fit, list[str]]:
    history = []
    while len(fit.parts) > 1:
        reduced = [fit_parts(judge, fit.parts[:k] + fit.parts[k + 1 :]) for k in range(len(fit.parts) - 1)]
        best = min(reduced, key=lambda one: price(one, inflation, rules))
        if price(best, inflation, rules) > price(fit, inflation, rules):
            break
        gone = set(fit.names) - set(best.names)
        history.append(f"dropped {', '.join(gone)}")
        fit = best
    return fit, history


def _rivals(judge: Judge, chosen: Fit, k: int, candidates, inflation: float, rules: Rules) -> tuple[Rival, ...]:
    others = chosen.parts[:k] + chosen.parts[k + 1 :]
    own = chosen.parts[k].candidate.term
    rest = fit_parts(judge, others) if others else nothing(judge)
    fits = explore(judge, rest, [one for one in candidates if one.term != own], rules, inflation)
    reference = judge.block_sums(chosen.entries**2)
    rivals = []
    for fit in fits:
        difference = (judge.block_sums(fit.entries**2) - reference) / inflation
        total = float(difference.sum()) + rules.price * (fit.complexity - chosen.complexity)
        spread = float(np.sqrt(len(difference) * np.var(difference, ddof=1))) + 1e-9
        rivals.append(Rival(fit, total, total / spread))
    return tuple(sorted(rivals, key=lambda rival: rival.excess))
