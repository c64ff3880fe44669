"""Which terms earn their place: forward selection, backward elimination, and what looks the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from split_cli.diagnosis.innovations.judge import Judge
from split_cli.diagnosis.innovations.severity import severities_of
from split_cli.diagnosis.policy import SelectionRules
from split_cli.diagnosis.remainder.structure import common_severities, minimum_effect_p, term_allowances
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.exchange import merged, said_of, split
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, fit_parts
from split_cli.diagnosis.search.misfit import costs_beside_misfit, saved_beside_misfit
from split_cli.vehicle.effects import Term

__all__ = [
    "Rival",
    "Selection",
    "explaining_as_well",
    "nothing",
    "over_allowance",
    "p_of_effect",
    "select_terms",
    "severity_of_terms",
    "term_p",
    "term_size",
    "with_chosen",
    "without_parts",
]


_ONCE = "nearly all in a few moments"
_MISFIT = "no more than the others misfit"


@dataclass(frozen=True)
class Rival:
    """Another explanation of the same rows, with how it compares.

    Attributes
    ----------
    fit : Fit
    excess : float
        Cost above the chosen explanation, prices included, in units of chi squared after inflation by chance or
        misfit, whichever is more.
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
    without : tuple of Fit
        The explanation refitted without each part.
    rivals : tuple of tuple of Rival
        For each part of the chosen fit that is named, that part replaced by every other term, best first.
    siblings : tuple of tuple of Rival
        The same with other variants of the part's own term.
    named : tuple of bool
        Which parts are large enough to be named; the others are kept aside, so that they take nothing from these.
    history : tuple of str
        What was added or removed, in order, in words.
    first_p : float
        Smallest minimum-effect p value of a term that was tried, times the number of terms tried.
    first : tuple of Fit
        What each term, in each variant that promised most, explains alone, best first.
    """

    base: Fit
    chosen: Fit
    without: tuple[Fit, ...]
    rivals: tuple[tuple[Rival, ...], ...]
    siblings: tuple[tuple[Rival, ...], ...]
    named: tuple[bool, ...]
    history: tuple[str, ...] = ()
    first_p: float = 1.0
    first: tuple[Fit, ...] = ()

    @property
    def terms(self) -> tuple[Term, ...]:
        """The named terms."""
        return tuple(term for term, named in zip(self.chosen.terms, self.named, strict=True) if named)


def nothing(judge: Judge) -> Fit:
    """Return the explanation without any term."""
    entries = judge.whiten(judge.residual(()))
    return Fit((), float(entries @ entries), entries, np.empty((len(entries), 0)))


def select_terms(judge: Judge, candidates: Sequence[Candidate], inflation: float) -> Selection:
    """Add the term that saves most while one earns its price, then drop those that no longer do.

    Where the best first term leaves something, the search begins anew from the next best: two terms together may
    be one that is not the best alone.
    """
    rules = judge.policy.selection
    explore = Explorer(judge, tuple(candidates), inflation)
    base = nothing(judge)
    first = explore(base)
    found = _forward(explore, base, first)
    # Several terms may imitate one, and fit better by what the one misfits.
    burden = rules.same_misfit * (base.cost - found.chosen.cost) / inflation

    def score(found: _Found) -> float:
        return explore.price(found.with_what_matters(base, rules)) + burden * found.names

    for other in _other_beginnings(first, base, rules) if found.left_something else ():
        found = min(found, _forward(explore, base, [other]), key=score)
    chosen, history = found.with_what_matters(base, rules), list(found.history)
    if chosen is not found.chosen and term_size(judge, chosen, len(chosen.parts) - 1) < rules.aside_severity:
        history.append(f"{chosen.parts[-1].candidate.label} kept aside")
    else:
        chosen = found.chosen
    selection = _examined(explore, base, chosen)
    for _ in range(rules.rounds):
        selection, exchanged = _exchanged(explore, selection, history)
        selection, moved = _exchanged_beside_misfit(explore, selection, history)
        if not (exchanged or moved):
            break
        # What a wrong term took a share of is seen once that has given way.
        grown = _forward(explore, base, (), selection)
        if len(grown.chosen.parts) == len(selection.chosen.parts):
            break
        history += grown.history
        selection = _examined(explore, base, grown.chosen)
    return replace(selection, history=tuple(history), first_p=found.first_p, first=tuple(first))


def _exchanged(explore: Explorer, selection: Selection, history: list[str]) -> tuple[Selection, bool]:
    """Let other terms take places while that saves, and say so; return whether any did."""
    rules, base, exchanged = explore.rules, selection.base, False
    for _ in range(rules.swaps * max(len(selection.chosen.parts), 1)):
        # A variant was chosen before what was found later; it may be another now.
        rivals = [several[0] for several in (*selection.rivals, *selection.siblings) if several]
        better = min(rivals, key=lambda one: one.excess, default=None)
        if len(selection.chosen.parts) < 2 or better is None or better.excess > -rules.least_swap:
            break
        history.append(f"{better.fit.parts[-1].candidate.label} takes a place, saves {-better.excess:.0f}")
        selection, exchanged = _examined(explore, base, better.fit), True
    for move in (merged, split):
        other = move(explore, selection.base, selection.chosen, selection.named)
        if other is not None:
            history.append(said_of(selection.chosen, other))
            selection, exchanged = _examined(explore, base, other), True
    return selection, exchanged


def _exchanged_beside_misfit(
    explore: Explorer, selection: Selection, history: list[str]
) -> tuple[Selection, bool]:
    """Let alternatives take places that are better where every misfit is free; return whether any did."""
    exchanged = False
    for _ in range(explore.rules.swaps):
        better, saved = _better_beside_misfit(explore, selection)
        trial = _examined(explore, selection.base, better) if better is not None else selection
        if better is None or sum(trial.named) < sum(selection.named):
            break
        history.append(f"{better.parts[-1].candidate.label} takes a place, saves {saved:.1f} beside misfit")
        selection, exchanged = trial, True
    return selection, exchanged


def _examined(explore: Explorer, base: Fit, chosen: Fit) -> Selection:
    """Compare an explanation with what is left without each part, and with what might be there instead."""
    judge, rules = explore.judge, explore.rules
    without = without_parts(judge, base, chosen)
    sure = [
        term_p(judge, chosen, k, one.cost - chosen.cost, explore.inflation) * len(explore.candidates) < rules.level
        and is_spread(judge, chosen, k, one, rules)
        and not chosen.parts[k].candidate.at_limit(chosen.parts[k].values)
        for k, one in enumerate(without)
    ]
    named = _believed_together(judge, chosen, without, sure, rules)
    rivals = tuple(_rivals(explore, chosen, k, rest) if named[k] else ((), ()) for k, rest in enumerate(without))
    others, siblings = zip(*rivals, strict=True) if rivals else ((), ())
    return Selection(base, chosen, without, others, siblings, named)


def with_chosen(explore: Explorer, selection: Selection, chosen: Fit) -> Selection:
    """Return a selection with another explanation in the place of the chosen one, compared afresh."""
    found = _examined(explore, selection.base, chosen)
    return replace(found, history=selection.history, first_p=selection.first_p, first=selection.first)


def _believed_together(
    judge: Judge, chosen: Fit, without: Sequence[Fit], sure: Sequence[bool], rules: SelectionRules
) -> tuple[bool, ...]:
    """Return which parts are named: of those that are sure the largest, and what is no misfit of larger ones."""
    if sum(sure) < 2:
        return tuple(sure)
    sizes = {k: _part_sizes(judge, chosen, k) for k, one in enumerate(sure) if one}
    named: list[int] = []
    for k in sorted(sizes, key=lambda k: -sizes[k].max()):
        larger = _sizes(judge, tuple(chosen.terms[i] for i in named), ())
        witnessed = _is_witnessed(judge, chosen, k, rules)
        if not named or witnessed or not _is_misfit(judge, sizes[k], larger, without[k], chosen, rules):
            named.append(k)
    return tuple(k in named for k in range(len(chosen.parts)))


def _better_beside_misfit(explore: Explorer, selection: Selection) -> tuple[Fit | None, float]:
    """Return the alternative that is best where misfit of every effect is free, and what it saves; else None.

    Alternatives differ from the chosen explanation by less than what a single track gets wrong of either.
    """
    alternatives = {}
    for k, rivals in enumerate(selection.rivals):
        for rival in explaining_as_well(explore.judge, selection, k, rivals):
            alternatives.setdefault((k, rival.fit.parts[-1].candidate.term), rival.fit)
    best, most = None, 0.0
    for fit in alternatives.values():
        here, there = costs_beside_misfit(explore.judge, [selection.chosen, fit])
        price = explore.rules.price * (fit.complexity - selection.chosen.complexity)
        saved = (here - there) / explore.inflation - price
        if saved > most:
            best, most = fit, saved
    return best, most


@dataclass(frozen=True)
class _Found:
    """What a search forward ended with.

    Attributes
    ----------
    chosen, with_refused : Fit
        As far as it is believed or kept aside, and with the term that was refused last.
    names : int
        How many of its parts were added to be named.
    history : tuple of str
    first_p : float
    """

    chosen: Fit
    with_refused: Fit
    names: int
    history: tuple[str, ...]
    first_p: float

    def with_what_matters(self, base: Fit, rules: SelectionRules) -> Fit:
        """Return the explanation with the refused term, if that saves more than a single track misfits.

        Too small to be told, it would yet be taken for more or less of the others.
        """
        refused, told = self.chosen.cost - self.with_refused.cost, base.cost - self.chosen.cost
        return self.with_refused if refused > rules.same_misfit * told else self.chosen

    @property
    def left_something(self) -> bool:
        """Whether several terms or a refused one show that the first leaves something."""
        return self.names > 1 or self.with_refused is not self.chosen


def _forward(explore: Explorer, base: Fit, first: Sequence[Fit], begun: Selection | None = None) -> _Found:
    """Add terms while evidence carries them, beginning with the best of `first`, or with what is `begun`."""
    judge, rules, inflation = explore.judge, explore.rules, explore.inflation
    chosen, history, first_p, aside, refused = base, [], 1.0, 0, None
    if begun is not None:
        chosen, aside = begun.chosen, begun.named.count(False)

    def price_saved(fit: Fit) -> float:
        return explore.price(chosen) - explore.price(fit)

    while True:
        fits = first if chosen is base else explore(chosen)
        fits = [fit for fit in fits if price_saved(fit) > 0.0]
        if not fits:
            break
        best = fits[0]
        if len(chosen.parts) > aside:  # beside what is kept aside there is no name to be a misfit of
            best, reason = _first_believed(explore, chosen, fits[: rules.considered])
        if best is None:
            label, saved = fits[0].parts[-1].candidate.label, price_saved(fits[0])
            history.append(f"{label} would save {saved:.0f}, {reason}")
            refused = fits[0]
            break
        label, saved = best.parts[-1].candidate.label, price_saved(best)
        p_value = term_p(judge, best, len(best.parts) - 1, chosen.cost - best.cost, inflation)
        p_value *= len(explore.candidates)
        small, spread = p_value >= rules.level, is_spread(judge, best, len(best.parts) - 1, chosen, rules)
        first_p = min(first_p, p_value if spread else 1.0)
        if small or not spread:
            history.append(f"{label} saves {saved:.0f}, {'too small to name' if small else _ONCE}")
            aside += 1
            if aside > rules.most_aside:
                break
            chosen = best
            continue
        history.append(f"added {label}, saves {saved:.0f}")
        chosen, dropped = _prune(explore, best)
        history += dropped
    names = len(chosen.parts) - aside
    return _Found(chosen, refused or chosen, names, tuple(history), first_p)


def _other_beginnings(first: Sequence[Fit], base: Fit, rules: SelectionRules) -> list[Fit]:
    """Return the best fits of the next best terms, where they save nearly as much as the best."""
    out: dict[str, Fit] = {}
    saved = base.cost - first[0].cost if first else 0.0
    for fit in first[1:]:
        term = fit.parts[-1].candidate.term
        if term != first[0].parts[-1].candidate.term and base.cost - fit.cost > (1.0 - rules.same_share) * saved:
            out.setdefault(term, fit)
    return list(out.values())[: rules.beginnings]


def without_parts(judge: Judge, base: Fit, fit: Fit) -> tuple[Fit, ...]:
    """Return an explanation refitted without each of its parts; `base` is the one without any."""
    several = len(fit.parts) > 1
    return tuple(
        fit_parts(judge, fit.parts[:k] + fit.parts[k + 1 :]) if several else base for k in range(len(fit.parts))
    )


def block_z(judge: Judge, fit: Fit, other: Fit) -> float:
    """Return what a fit saves against another in standard errors, from differences block by block."""
    difference = judge.block_sums(other.entries**2) - judge.block_sums(fit.entries**2)
    return float(difference.sum()) / _error_of_sum(difference)


def is_spread(judge: Judge, fit: Fit, k: int, without: Fit, rules: SelectionRules) -> bool:
    """Return whether one part saves in enough blocks of time, or its size is known well enough from them all.

    A place is passed once a lap. What acts in few blocks saves in few; if it is there, those agree about its size,
    and if it stands for something else they do not. What is larger than the noise is seen however seldom it acts.
    Where there is much misfit it is worst somewhere, and a place says no more than any few moments.
    """
    seldom = fit.parts[k].candidate.located and judge.misfit <= rules.much_misfit
    if seldom or block_z(judge, fit, without) > rules.spread:
        return True
    return block_t(judge, fit, without) > rules.sure or term_size(judge, fit, k) > rules.plain


def block_t(judge: Judge, fit: Fit, without: Fit) -> float:
    """Return the size of what a fit adds to another in standard errors, from scores block by block.

    Notes
    -----
    With what it adds taken as one direction d, e the entries left: d^T d/sqrt(sum over blocks of (d_b^T e_b)^2),
    a Wald statistic with the sandwich's variance (Liang and Zeger, 1986).
    """
    added = without.entries - fit.entries
    scores = judge.block_sums(added * fit.entries)
    return float(added @ added) / (float(np.sqrt(scores @ scores)) + 1e-9)


def _error_of_sum(difference: np.ndarray) -> float:
    """Return the standard error of a sum over blocks, shape (B,)."""
    return float(np.sqrt(len(difference) * np.var(difference, ddof=1))) + 1e-9


def _first_believed(explore: Explorer, chosen: Fit, fits: Sequence[Fit]) -> tuple[Fit | None, str]:
    """Return the first further term that is believed; where none is, why not the first of them, in words."""
    judge = explore.judge
    sizes = _sizes(judge, chosen.terms, ())
    reasons = []
    for fit in fits:
        reasons.append(_refusal(explore, chosen, sizes, fit))
        if not reasons[-1]:
            return fit, ""
    return None, reasons[0]


def _refusal(explore: Explorer, chosen: Fit, sizes: np.ndarray, further: Fit) -> str:
    """Return why a further term is not believed, in words; nothing where it is.

    It may be no larger than what single-track terms leave of a real car's effect. That is measured by prediction
    errors over 0.05 s: costs also weigh what builds up slowly, and one term's slow channel would drown another's
    fast one. What is left of one term is of its own kind, so channels count apart. It has to be told from what the
    others may get wrong, too: by what it saves where they are free to. Or it may save all in a few moments, unless
    it acts at a place, which is passed once a lap.
    """
    judge, rules = explore.judge, explore.rules
    k = len(further.parts) - 1
    # What witnesses show is the instrument's own, whatever the model gets wrong.
    if not _is_witnessed(judge, further, k, rules):
        if _is_misfit(judge, _sizes(judge, further.terms, chosen.terms), sizes, chosen, further, rules):
            return _MISFIT
        saved = saved_beside_misfit(judge, chosen, further)
        if term_p(judge, further, k, saved, explore.inflation) * len(explore.candidates) >= rules.level:
            return _MISFIT
    return "" if is_spread(judge, further, len(further.parts) - 1, chosen, rules) else _ONCE


def _is_witnessed(judge: Judge, fit: Fit, k: int, rules: SelectionRules) -> bool:
    """Return whether a sensor's fault moves what a recording knows twice, which no model-form error does."""
    if not fit.parts[k].term.corrects:
        return False
    return judge.witnessed(fit.terms, fit.terms[:k] + fit.terms[k + 1 :]) > rules.least_witnessed


def _is_misfit(
    judge: Judge, size: np.ndarray, of: np.ndarray, before: Fit, after: Fit, rules: SelectionRules
) -> bool:
    """Return whether severities, shape (3,), are no more than terms with severities `of`, shape (3,), misfit.

    What large terms misfit in a channel they hardly act in has no simple shape: a term that takes nearly all that
    was left there, and much was, is none of it.
    """
    channel = int(np.argmax(size))
    across = 0.0 if _settles(judge, channel, before, after, rules) else rules.misfit_across * of.max()
    common = rules.common_misfit * common_severities(judge)[channel]
    return bool(size[channel] < max(rules.least_severity, rules.misfit * of[channel], across, common))


def _settles(judge: Judge, channel: int, before: Fit, after: Fit, rules: SelectionRules) -> bool:
    """Return whether a fit leaves next to noise in a channel where another leaves much more.

    Notes
    -----
    Noise is half the mean square of successive differences (von Neumann, 1941), which what varies slowly hardly
    adds to.
    """
    rows = sum(int(mask.sum()) for mask in judge.keep)
    left, still = (fit.entries[: 3 * rows].reshape(rows, 3)[:, channel] for fit in (before, after))
    noise = 0.5 * np.mean(np.diff(still) ** 2)
    much, little = np.mean(left**2) - noise, np.mean(still**2) - noise
    return bool(much > rules.settled_noise * noise and little < (1.0 - rules.settled) * much)


def _sizes(judge: Judge, terms: tuple[Term, ...], without: tuple[Term, ...]) -> np.ndarray:
    """Return severities of terms against those of `without` in v_x, v_y and r, shape (3,)."""
    sizes = [
        severities_of(one, one.at[mask], terms, without, partial(judge.carried, one))
        for one, mask in zip(judge.evidence, judge.keep, strict=True)
    ]
    size = np.max(sizes, axis=0)
    # An accelerometer's fault moves no prediction of the velocities: it is as large as its witness says.
    return size if size.any() else np.full(3, judge.witnessed(terms, without))


def _part_sizes(judge: Judge, fit: Fit, k: int) -> np.ndarray:
    return _sizes(judge, fit.terms, fit.terms[:k] + fit.terms[k + 1 :])


def term_size(judge: Judge, fit: Fit, k: int) -> float:
    """Return the severity of one part of an explanation, the others in place."""
    return float(_part_sizes(judge, fit, k).max())


def severity_of_terms(judge: Judge, terms: tuple[Term, ...]) -> float:
    """Return the effect-to-noise ratio of terms, in the channel where it is most."""
    return float(_sizes(judge, terms, ()).max())


def over_allowance(judge: Judge, terms: tuple[Term, ...], without: tuple[Term, ...]) -> float:
    """Return the size of terms against `without` over what is allowed, in the channel where that is most."""
    return float(np.max(_sizes(judge, terms, without) / term_allowances(judge)))


def _over_allowance(judge: Judge, fit: Fit, k: int) -> float:
    return over_allowance(judge, fit.terms, fit.terms[:k] + fit.terms[k + 1 :])


def explaining_as_well(
    judge: Judge, selection: Selection, k: int, rivals: Sequence[Rival], misfit: float = 0.0
) -> list[Rival]:
    """Return the rivals of a part that may be what acts instead of it.

    They may where the two differ by chance, and where a misfit that is allowed, or no larger than single tracks
    have, or than a share `misfit` of the part's savings, could have made the difference.
    """
    rules, margin = judge.policy.selection, judge.policy.self_test.term_margin
    # An excess is told in what misfit makes of chance; so is what it is compared with.
    saved = (selection.without[k].cost - selection.chosen.cost) / max(judge.misfit / margin, 1.0)
    share = min(1.0 / max(_over_allowance(judge, selection.chosen, k), 1e-9), 1.0) ** 2
    allowed = max(rules.same_excess, max(share, rules.same_misfit, misfit / margin) * saved)
    by_chance = rules.same_share * saved
    return [
        rival
        for rival in rivals
        if rival.excess < allowed or (rival.z < rules.same_within and rival.excess < by_chance)
    ]


def term_p(judge: Judge, fit: Fit, k: int, saved: float, inflation: float) -> float:
    """Return the minimum-effect p value of one part of an explanation that saves `saved`."""
    return p_of_effect(judge, fit.parts[k].candidate, _over_allowance(judge, fit, k), saved, inflation)


def p_of_effect(judge: Judge, candidate: Candidate, size: float, saved: float, inflation: float) -> float:
    """Return the minimum-effect p value of a term of `size`, over what is allowed, that saves `saved`.

    What misfit may save is told twice, as what it is known to save and as what it adds to chance. A term has to
    stand against each, so the larger of two is returned; both at once would count it double.
    """
    floor = max(judge.policy.allowances.term_floor * judge.shared_cost, judge.term_floors.get(candidate.term, 0.0))

    def p_value(freedom: float, widened: float, spared: float) -> float:
        return minimum_effect_p(saved, freedom, size, widened, spared, allowance=1.0)

    known = p_value(candidate.complexity, inflation, floor)
    if judge.misfit <= inflation:
        return known
    searched = candidate.complexity + (judge.policy.selection.searched_places if candidate.located else 0.0)
    return max(known, p_value(searched, judge.misfit, 0.0))


def _prune(explore: Explorer, fit: Fit) -> tuple[Fit, list[str]]:
    history = []
    while len(fit.parts) > 1:
        reduced = [fit_parts(explore.judge, fit.parts[:k] + fit.parts[k + 1 :]) for k in range(len(fit.parts) - 1)]
        best = min(reduced, key=explore.price)
        if explore.price(best) > explore.price(fit):
            break
        gone = set(fit.names) - set(best.names)
        history.append(f"dropped {', '.join(gone)}")
        fit = best
    return fit, history


def _rivals(explore: Explorer, chosen: Fit, k: int, rest: Fit) -> tuple[tuple[Rival, ...], tuple[Rival, ...]]:
    """Return a part replaced by other terms, and by other variants of its own, best first."""
    judge = explore.judge
    inflation = max(explore.inflation, judge.misfit)
    own = chosen.parts[k].candidate
    reference = judge.block_sums(chosen.entries**2)
    rivals = []
    for fit in explore(rest):
        if fit.parts[-1].candidate.label == own.label:
            continue
        difference = (judge.block_sums(fit.entries**2) - reference) / inflation
        total = float(difference.sum()) + explore.rules.price * (fit.complexity - chosen.complexity)
        rivals.append(Rival(fit, total, total / _error_of_sum(difference)))
    rivals.sort(key=lambda rival: rival.excess)
    of_own = [rival.fit.parts[-1].candidate.term == own.term for rival in rivals]
    return (
        tuple(rival for rival, mine in zip(rivals, of_own, strict=True) if not mine),
        tuple(rival for rival, mine in zip(rivals, of_own, strict=True) if mine),
    )
