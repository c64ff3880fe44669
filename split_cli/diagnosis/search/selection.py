"""`select_terms`: one search for the explanation of an objective, and `Selection`, its result with the alternatives."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.delay_minima import in_lowest_minima
from split_cli.diagnosis.search.every_car import explanation_of_every_car, is_shown, physics_of_every_car
from split_cli.diagnosis.search.exchange import (
    all_as_one,
    fewer_by_another_variant,
    inverted_stretch,
    is_better_beside_form_error,
    move_in_words,
    one_as_hidden_pair,
    one_as_pair,
    pair_as_one,
    with_fewer_parts,
)
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, fit_parts
from split_cli.diagnosis.search.form_error import saved_in_place_of
from split_cli.diagnosis.search.forward import (
    ForwardResult,
    is_beyond_form_error,
    is_refused_last,
    leaves_car_range,
    other_beginnings,
    search_forward,
    sizes_with_form_error,
)
from split_cli.diagnosis.search.joint import all_at_once, cheapest_first, estimated_saving_of_all, out_of_local_minimum
from split_cli.diagnosis.search.parts_of_drive import ActingPart, strongest_beside_tolerated
from split_cli.diagnosis.search.rivals import Rival, rivals_of
from split_cli.diagnosis.search.term_tests import (
    contradicts_yaw,
    exceeds_simulation_scatter,
    is_spread,
    is_tolerated,
    part_over_allowance,
    part_sizes,
    term_p,
    term_size,
    witnessed_p,
)
from split_cli.vehicle.effects import Term


@dataclass(frozen=True)
class Selection:
    """The chosen explanation, which of its parts are named, and the explanations it was compared with."""

    # base, chosen: the fit without any term, and the chosen explanation.
    base: Fit
    chosen: Fit
    without: tuple[Fit, ...]  # the chosen explanation refitted without each part
    # For each named part, explanations with another term in its place, best first; empty for nuisance terms.
    rivals: tuple[tuple[Rival, ...], ...]
    siblings: tuple[tuple[Rival, ...], ...]  # the same with other variants of the part's own term
    named: tuple[bool, ...]  # whether each part is named; the others are nuisance terms
    history: tuple[str, ...] = ()  # steps of the search in words
    # Smallest p value of the minimum-effect test, times the number of candidates (Bonferroni); without sensor errors
    # within tolerance, and without savings as between halves of the simulation.
    first_p: float = 1.0
    first: tuple[Fit, ...] = ()  # fits of single terms, best first
    # Returns fits with one further term beside an explanation, best first.
    beside: Callable[[Fit], Sequence[Fit]] = lambda fit: ()
    # Returns the term that acts in a part of the drive with the smallest p value, or None; computed on the first call.
    partly: Callable[[], ActingPart | None] = lambda: None

    @property
    def terms(self) -> tuple[Term, ...]:
        """The named terms."""
        return tuple(term for term, named in zip(self.chosen.terms, self.named, strict=True) if named)

    @property
    def nuisances(self) -> tuple[str, ...]:
        """Labels of the parts that are not named."""
        parts = zip(self.chosen.parts, self.named, strict=True)
        return tuple(part.candidate.label for part, named in parts if not named)


def nothing(objective: MarginalLikelihood) -> Fit:
    """Return the fit without any term."""
    residuals = objective.whiten(objective.residual(()))
    return Fit((), float(residuals @ residuals), residuals, np.empty((len(residuals), 0)))


def select_terms(
    objective: MarginalLikelihood,
    candidates: Sequence[Candidate],
    variance_inflation: float,
    leaves_structure: Callable[[Fit], bool] = lambda fit: True,
    leaves_more_than_noise: Callable[[Fit], bool] = lambda fit: False,
) -> Selection:
    """Return the explanation of an objective, after a search over terms; docs/inside_diagnosis.md lists its steps.

    Parameters
    ----------
    variance_inflation : float
        Factor by which residual autocorrelation widens chi squared [1].
    leaves_structure : callable
        Whether a fit leaves more than noise and the model-form error of its terms. If so, or if many terms were added,
        all terms are fitted jointly.
    leaves_more_than_noise : callable
        Whether a fit leaves more than noise. If not, it is not compared with the effects of every car.
    """
    rules = objective.policy.selection
    explore = Explorer(objective, tuple(candidates), variance_inflation)
    base = nothing(objective)
    first = explore(base)
    found = search_forward(explore, base, first)
    # Several terms may imitate one and fit better because of its model-form error, which is added to their price.
    burden = rules.form_error_cost * (base.cost - found.chosen.cost) / variance_inflation

    def score(found: ForwardResult) -> float:
        return explore.price(found.with_large_refused(base, rules)) + burden * found.names

    partly = partial(strongest_beside_tolerated, objective, explore.tangents, variance_inflation, base)
    physics = cache(lambda: physics_of_every_car(explore, base))

    def as_every_car(found: Fit) -> Selection | None:
        whole = explanation_of_every_car(explore, physics, found, leaves_more_than_noise)
        return None if whole is None else replace(_named_of_every_car(explore, base, whole[0]), history=whole[1])

    if (whole := as_every_car(found.with_large_refused(base, rules))) is not None:
        explore.close()
        acting = cache(partial(partly, whole.chosen))
        return replace(whole, first_p=found.first_p, first=tuple(first), beside=explore, partly=acting)
    jointly = None
    many = found.names > rules.few_names
    if many or (found.leaves_remainder and leaves_structure(found.with_large_refused(base, rules))):
        jointly = _all_at_once(explore, base, found.with_large_refused(base, rules))
    if jointly is not None:
        chosen, history = jointly, [*found.history, f"joint search: {move_in_words(found.chosen, jointly)}"]
    else:
        for other in other_beginnings(first, base, rules) if found.leaves_remainder else ():
            found = min(found, search_forward(explore, base, [other]), key=score)
        chosen, history = found.with_large_refused(base, rules), list(found.history)
        refused = chosen is not found.chosen
        if refused and term_size(objective, chosen, len(chosen.parts) - 1) < objective.policy.allowances.unnamed:
            history.append(f"{chosen.parts[-1].candidate.label} kept as a nuisance")
        else:
            chosen = found.chosen
    selection = _examined(explore, base, _inverted_stretch(explore, chosen, history))
    for _ in range(rules.rounds):
        selection, exchanged = _exchanged(explore, selection, history)
        selection, moved = _exchanged_beside_form_error(explore, selection, history)
        if not (exchanged or moved):
            break
        # Further effects may show after a wrong term was replaced.
        grown = search_forward(explore, base, begun=selection.chosen, nuisances=selection.nuisances)
        more = len(grown.chosen.parts) > len(selection.chosen.parts)
        history += grown.history if more else ()
        turned = _inverted_stretch(explore, grown.chosen if more else selection.chosen, history)
        if turned is selection.chosen:
            break
        selection = _examined(explore, base, turned)
    deeper = in_lowest_minima(objective, selection.chosen, rules.tie * variance_inflation)
    if deeper is not selection.chosen:
        history.append(f"another minimum of a delay saves {selection.chosen.cost - deeper.cost:.0f}")
        selection = _examined(explore, base, deeper)
    selection = _settled_nuisances(explore, selection, history)
    # This comes last: further terms or rivals would only lead back to the explanation that it replaces.
    single = all_as_one(explore, base, selection.chosen, selection.named)
    if single is not None:
        history.append(move_in_words(selection.chosen, single))
        selection = _examined(explore, base, single)
    # The final explanation is compared with the effects of every car once more.
    selection = as_every_car(selection.chosen) or replace(selection, history=tuple(history))
    explore.close()
    acting = cache(partial(partly, selection.chosen))
    return replace(selection, first_p=found.first_p, first=tuple(first), beside=explore, partly=acting)


def _all_at_once(explore: Explorer, base: Fit, chosen: Fit) -> Fit | None:
    """Return the joint fit of all terms, without those that are refused beside the others; None if it is no better."""
    if estimated_saving_of_all(explore, chosen) < explore.rules.price:
        return None
    fit = all_at_once(explore, base, chosen)
    left = len(fit.parts)
    while left > 1:
        for k in cheapest_first(explore, fit):
            rest = fit_parts(explore.objective, fit.parts[:k] + fit.parts[k + 1 :], slopes_of=fit)
            if is_refused_last(explore, rest, fit, k):
                fit, left = rest, left - 1
                break
        else:
            break
    return fit if is_better_beside_form_error(explore, fit, chosen) else None


def _named_of_every_car(explore: Explorer, base: Fit, whole: Fit) -> Selection:
    """Return the selection of effects of every car, named if they are larger than the others' model-form error.

    Rivals do not replace them: by cost alone the most flexible terms would win.
    """
    selection = _compared(explore, base, whole)
    shown = [is_shown(explore, whole, rest) for rest in selection.without]
    named = tuple(one and other for one, other in zip(selection.named, shown, strict=True))
    return _with_rivals(explore, replace(selection, named=named))


def _inverted_stretch(explore: Explorer, chosen: Fit, history: list[str]) -> Fit:
    """Return an explanation with a stretch in place of the rest of the lap if that costs less; extends `history`."""
    other = inverted_stretch(explore, chosen)
    if other is None:
        return chosen
    gone = sorted(set(chosen.names) - set(other.names))
    history.append(f"a stretch in place of the rest of the lap{' and ' * bool(gone)}{' and '.join(gone)}")
    return other


def _exchanged(explore: Explorer, selection: Selection, history: list[str]) -> tuple[Selection, bool]:
    """Return the selection after exchanges of terms that save cost, and whether there were any; extends `history`."""
    rules, base, before = explore.rules, selection.base, selection.chosen
    rivals = [rival.fit for several in (*selection.rivals, *selection.siblings) for rival in several]
    fewer = with_fewer_parts(explore, selection.chosen, rivals)
    if fewer is not None:
        history.append(move_in_words(selection.chosen, fewer))
        selection = _examined(explore, base, fewer)
    all_known = True
    for _ in range(rules.swaps * max(len(selection.chosen.parts), 1)):
        better = _best_rival(selection)
        if len(selection.chosen.parts) < 2 or better is None or better.excess > -rules.tie:
            if all_known:
                break
            selection, all_known = _with_rivals(explore, selection), True
            continue
        history.append(f"{better.fit.parts[-1].candidate.label} replaces a term, saves {-better.excess:.0f}")
        # Only better rivals are fitted until there are none.
        selection = _with_rivals(explore, _compared(explore, base, better.fit), better=True)
        all_known = False
    best_first = sorted((rival for several in selection.rivals for rival in several), key=lambda one: one.excess)
    moves: tuple[Callable[[Explorer, Fit, Fit, Sequence[bool]], Fit | None], ...]
    as_one = partial(pair_as_one, rivals=[rival.fit for rival in best_first])
    moves = (fewer_by_another_variant, as_one, one_as_pair, one_as_hidden_pair)
    for move in moves:
        other = move(explore, selection.base, selection.chosen, selection.named)
        if other is not None:
            history.append(move_in_words(selection.chosen, other))
            selection, all_known = _compared(explore, base, other), False
    if not all_known:
        selection = _with_rivals(explore, selection)
    return selection, selection.chosen is not before


def _best_rival(selection: Selection) -> Rival | None:
    """Return the rival with the least cost whose values are within a car's range; None without any."""
    others = (rival for several in (*selection.rivals, *selection.siblings) for rival in several)
    possible = [one for one in others if not leaves_car_range(selection.chosen, one.fit)]
    return min(possible, key=lambda one: one.excess, default=None)


def _settled_nuisances(explore: Explorer, selection: Selection, history: list[str]) -> Selection:
    """Return a selection without nuisance terms that hide or support a named term; extends `history`.

    Two terms may share an effect so that neither is named beside the other, while either alone would be. That is one
    finding with an alternative, so one of them is removed. Or a nuisance term and a named one cancel each other and are
    significant only together. Then both are removed, if the nuisance term is no more than model-form error.
    """
    while not all(selection.named) and len(selection.named) > 1:
        chosen, own = selection.chosen, {term.id for term in selection.terms}
        unnamed = [k for k, named in enumerate(selection.named) if not named]
        k = min(unnamed, key=lambda k: explore.price(selection.without[k]))
        trial, label = _compared(explore, selection.base, selection.without[k]), chosen.parts[k].candidate.label
        supported = own - {term.id for term in trial.terms}
        if sum(trial.named) > len(own) and _costs_little_without(explore, selection, trial, own):
            history.append(f"{label} gives way: another is named without it")
        elif supported and own - supported and _is_dispensable(explore, selection, k):
            others = [part for part in trial.chosen.parts if part.candidate.term not in supported]
            trial = _compared(explore, selection.base, fit_parts(explore.objective, others, slopes_of=trial.chosen))
            if {term.id for term in trial.terms} != own - supported:
                break
            history.append(f"{label} leaves with {' and '.join(sorted(supported))}, of no name without it")
        else:
            break
        selection = _with_rivals(explore, trial)
    return selection


def _costs_little_without(explore: Explorer, selection: Selection, trial: Selection, names: set[str]) -> bool:
    """Return whether the cost rises without a nuisance term by less than a fair share of the new name's saving."""
    lacking = trial.chosen.cost - selection.chosen.cost
    saved = [
        without.cost - trial.chosen.cost
        for part, without, named in zip(trial.chosen.parts, trial.without, trial.named, strict=True)
        if named and part.candidate.term not in names
    ]
    return lacking < explore.rules.fair_share * min(saved, default=0.0)


def _is_dispensable(explore: Explorer, selection: Selection, k: int) -> bool:
    """Return whether nuisance term k would be refused, saves little, and is no sensor error within tolerance."""
    chosen, without, own = selection.chosen, selection.without[k], selection.chosen.parts[k]
    much = explore.rules.form_error_cost * (selection.base.cost - chosen.cost)
    if own.is_within_tolerance or without.cost - chosen.cost > much:
        return False
    return is_refused_last(explore, without, chosen, k)


def _exchanged_beside_form_error(explore: Explorer, selection: Selection, history: list[str]) -> tuple[Selection, bool]:
    """Return the selection after exchanges with alternatives that are better beside model-form error; see above."""
    exchanged = False
    for _ in range(explore.rules.swaps):
        better, saved = _better_beside_form_error(explore, selection)
        trial = _compared(explore, selection.base, better) if better is not None else selection
        if better is None or sum(trial.named) < sum(selection.named):
            break
        history.append(f"{better.parts[-1].candidate.label} replaces a term, saves {saved:.1f} beside model-form error")
        selection, exchanged = _with_rivals(explore, trial), True
    return selection, exchanged


def _examined(explore: Explorer, base: Fit, chosen: Fit) -> Selection:
    """Return the selection of an explanation, with fits without each part and with rivals."""
    return _with_rivals(explore, _compared(explore, base, chosen))


def _compared(explore: Explorer, base: Fit, chosen: Fit) -> Selection:
    """Return the selection of an explanation, with named parts and fits without each part, without rivals."""
    objective, rules = explore.objective, explore.rules
    chosen, without = out_of_local_minimum(explore, base, chosen)
    level = rules.level / len(explore.candidates)
    sure = [
        (
            (
                term_p(objective, chosen, k, one.cost - chosen.cost, explore.variance_inflation) < level
                and is_spread(objective, chosen, k, one, rules)
                and exceeds_simulation_scatter(objective, chosen.parts[k].candidate, one.cost - chosen.cost)
            )
            or witnessed_p(objective, chosen, k, one, rules) < level
        )
        and not chosen.parts[k].candidate.at_limit(chosen.parts[k].values)
        and not is_tolerated(objective, chosen, k, one, explore.variance_inflation, level)
        and not contradicts_yaw(objective, chosen, k)
        for k, one in enumerate(without)
    ]
    named = _named_together(explore, chosen, without, sure)
    return Selection(base, chosen, without, ((),) * len(without), ((),) * len(without), named)


def _with_rivals(explore: Explorer, selection: Selection, *, better: bool = False) -> Selection:
    """Return a selection with the rivals of each named part; with `better` mainly those that may cost less."""
    nuisances = [k for k, named in enumerate(selection.named) if not named]
    find = partial(rivals_of, explore, selection.chosen, better=better, nuisances=nuisances)
    rivals = [find(k, rest) if selection.named[k] else ((), ()) for k, rest in enumerate(selection.without)]
    others, siblings = zip(*rivals, strict=True) if rivals else ((), ())
    return replace(selection, rivals=others, siblings=siblings)


def with_chosen(explore: Explorer, selection: Selection, chosen: Fit) -> Selection:
    """Return a selection with another chosen explanation, compared anew."""
    new = _examined(explore, selection.base, chosen)
    compared = {"without": new.without, "rivals": new.rivals, "siblings": new.siblings}
    return replace(selection, chosen=new.chosen, named=new.named, **compared)


def _named_together(explore: Explorer, chosen: Fit, without: Sequence[Fit], sure: Sequence[bool]) -> tuple[bool, ...]:
    """Return which significant parts are named: the largest, and those beyond the model-form error of larger ones."""
    objective = explore.objective
    if sum(sure) < 2:
        return tuple(sure)
    sizes = {k: part_sizes(objective, chosen, k) for k, one in enumerate(sure) if one}
    named: list[int] = []
    for k in sorted(sizes, key=lambda k: -sizes[k].max()):
        larger = sizes_with_form_error(objective, tuple(chosen.terms[i] for i in named))
        if not named or is_beyond_form_error(explore, without[k], larger, chosen, k):
            named.append(k)
    return tuple(k in named for k in range(len(chosen.parts)))


def _better_beside_form_error(explore: Explorer, selection: Selection) -> tuple[Fit | None, float]:
    """Return the best alternative beside the model-form error of both explanations, and its saving; else None.

    Alternatives are rivals that cost more by less than a fair share of the part's saving. One that saves no more than a
    tie is not returned.
    """
    alternatives, rules = {}, explore.rules
    for k, rivals in enumerate(selection.rivals):
        saved = selection.without[k].cost - selection.chosen.cost
        lacking = rules.fair_share * saved / explore.variance_inflation
        for rival in rivals:
            if rival.excess < lacking:
                alternatives.setdefault((k, rival.fit.parts[-1].candidate.term), rival.fit)
    best, most = None, rules.tie
    for fit in alternatives.values():
        price = rules.price * (fit.complexity - selection.chosen.complexity)
        saved = saved_in_place_of(explore.objective, selection.chosen, fit, explore.variance_inflation) - price
        if saved > most:
            best, most = fit, saved
    return best, most


def explaining_as_well(
    objective: MarginalLikelihood, selection: Selection, k: int, rivals: Sequence[Rival], form_error: float = 0.0
) -> list[Rival]:
    """Return the rivals of part k that explain the data as well: its alternatives.

    The difference of cost must be within chance, or within the price, an allowed effect or a model-form error.

    Parameters
    ----------
    form_error : float
        Further share of the part's saving that counts as model-form error [1].
    """
    rules, margin = objective.policy.selection, objective.policy.self_test.term_margin
    # The excess is over the variance inflation of model-form error; so is the saving it is compared with.
    saved = (selection.without[k].cost - selection.chosen.cost) / max(objective.form_error_inflation / margin, 1.0)
    share = min(1.0 / max(part_over_allowance(objective, selection.chosen, k), 1e-9), 1.0) ** 2
    allowed = max(rules.price, max(share, rules.form_error_cost, form_error / margin) * saved)
    by_chance = rules.fair_share * saved
    return [
        rival
        for rival in rivals
        if rival.excess < allowed or (rival.z < rules.same_within and rival.excess < by_chance)
    ]
