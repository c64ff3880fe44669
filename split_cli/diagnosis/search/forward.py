"""Forward search: terms are added one at a time while each passes its tests, and `refusal`, which are these tests."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import SelectionRules
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, Tangent, fits_without
from split_cli.diagnosis.search.form_error import saved_beside_form_error, share_of_error
from split_cli.diagnosis.search.pairs import estimated_pairs, with_pair
from split_cli.diagnosis.search.term_tests import (
    contradicts_yaw,
    exceeds_simulation_scatter,
    is_form_error,
    is_spread,
    is_tolerated,
    is_witnessed,
    over_form_error,
    part_sizes,
    sizes_in_velocity,
    sizes_of_terms,
    term_p,
    witnessed_p,
)
from split_cli.vehicle.effects import Term

#: Reasons of a refusal, for the history.
_AGAINST_YAW = "contradicted by the recorded yaw"
_FEW_MOMENTS = "nearly all of it in a few moments"
_FORM_ERROR = "within the model-form error of the other terms"


@dataclass(frozen=True)
class ForwardResult:
    """Result of a forward search."""

    # chosen, with_refused: the explanation of named and nuisance terms, and that with the term refused last.
    chosen: Fit
    with_refused: Fit
    names: int  # number of parts that were added as named terms
    history: tuple[str, ...]  # in words
    first_p: float  # as in `Selection`

    def with_large_refused(self, base: Fit, rules: SelectionRules) -> Fit:
        """Return the explanation with the refused term if that saves more than model-form error.

        Without it the other terms would take up its effect.
        """
        refused, saved = self.chosen.cost - self.with_refused.cost, base.cost - self.chosen.cost
        return self.with_refused if refused > rules.form_error_cost * saved else self.chosen

    @property
    def leaves_remainder(self) -> bool:
        """Whether several terms, or a refused one, show that the first term leaves something."""
        return self.names > 1 or self.with_refused is not self.chosen


def search_forward(
    explore: Explorer, base: Fit, first: Sequence[Fit] = (), begun: Fit | None = None, nuisances: Collection[str] = ()
) -> ForwardResult:
    """Add terms while they pass their tests, beginning with the best of `first`, or with `begun`.

    Parameters
    ----------
    base : Fit
        The fit without any term.
    first : sequence of Fit
        Fits of each term alone, best first; used without `begun`.
    begun : Fit, optional
        An explanation to continue from.
    nuisances : collection of str
        Labels of its parts that are nuisance terms.
    """
    rules = explore.rules
    chosen, history, first_p, refused = base if begun is None else begun, [], 1.0, None
    unnamed = frozenset(nuisances)
    # State before a term was kept tentatively that saves in a few moments only: fit, nuisances, length of history, and
    # that term's fit.
    tentative: tuple[Fit, frozenset[str], int, Fit] | None = None

    def are_nuisances(fit: Fit) -> list[bool]:
        return [part.candidate.label in unnamed for part in fit.parts]

    def price_saved(fit: Fit) -> float:
        return explore.price(chosen) - explore.price(fit)

    def that_save(fits: Sequence[Fit]) -> list[Fit]:
        return [fit for fit in fits if price_saved(fit) > 0.0 and not leaves_car_range(chosen, fit)]

    while True:
        fits = that_save(first if chosen is base else explore(chosen))
        if not fits:
            break
        best = fits[0]
        # Beside nuisance terms alone, a term cannot be the model-form error of a named one.
        if not all(are_nuisances(chosen)):
            best, reason = _first_accepted(explore, chosen, fits[: rules.considered])
            if best is None:
                beyond = that_save(explore.beyond_form_error(chosen))
                best, _ = _first_accepted(explore, chosen, beyond[: rules.considered])
            both = hidden_pair(explore, chosen, best)
            if both is not None:
                labels = " and ".join(part.candidate.label for part in both.parts[-2:])
                history.append(f"added {labels}, which hide each other, saves {price_saved(both):.0f}")
                chosen, dropped = _prune(explore, both)
                history += dropped
                tentative = None
                continue
        if best is None:
            label, saved = fits[0].parts[-1].candidate.label, price_saved(fits[0])
            if reason == _FEW_MOMENTS and sum(are_nuisances(chosen)) < rules.most_nuisances:
                # A missing effect may disturb its saving block by block, so that it is tried as a nuisance term first.
                tentative = tentative or (chosen, unnamed, len(history), fits[0])
                history.append(f"{label} saves {saved:.0f}, {reason}")
                chosen, unnamed = fits[0], unnamed | {label}
                continue
            history.append(f"{label} would save {saved:.0f}, {reason}")
            refused = fits[0]
            break
        label, saved = best.parts[-1].candidate.label, price_saved(best)
        p_value, small, spread = _significance(explore, chosen, best)
        # The p value of a sensor error within tolerance says nothing of other terms.
        first_p = min(first_p, p_value if spread and not (small and p_value < rules.level) else 1.0)
        if small or not spread:
            history.append(f"{label} saves {saved:.0f}, {'too small to name' if small else _FEW_MOMENTS}")
            unnamed |= {label}
            # Sensor errors within tolerance do not count towards the limit of nuisance terms.
            counted = (part for part, one in zip(best.parts, are_nuisances(best), strict=True) if one)
            if sum(not part.is_within_tolerance for part in counted) > rules.most_nuisances:
                unnamed -= {label}
                break
            chosen = best
            continue
        history.append(f"added {label}, saves {saved:.0f}")
        chosen, dropped = _prune(explore, best)
        history += dropped
        tentative = None
    if tentative is not None:
        chosen, unnamed, begun_at, refused = tentative
        label, saved = refused.parts[-1].candidate.label, price_saved(refused)
        history[begun_at:] = [f"{label} would save {saved:.0f}, {_FEW_MOMENTS}"]
    names = are_nuisances(chosen).count(False)
    return ForwardResult(chosen, refused or chosen, names, tuple(history), first_p)


def _significance(explore: Explorer, chosen: Fit, further: Fit) -> tuple[float, bool, bool]:
    """Return the p value of the last term of `further` beside `chosen`, and two verdicts on it.

    Returns
    -------
    p_value : float
        Corrected for the number of candidates (Bonferroni).
    small : bool
        Whether the term is too small to name.
    spread : bool
        Whether it saves in more than a few moments.
    """
    objective, rules, part = explore.objective, explore.rules, further.parts[-1]
    last, saved = len(further.parts) - 1, chosen.cost - further.cost
    witnessed = witnessed_p(objective, further, last, chosen, rules)
    p_value = min(term_p(objective, further, last, saved, explore.variance_inflation), witnessed)
    p_value *= len(explore.candidates)
    level = rules.level / len(explore.candidates)
    small = p_value >= rules.level
    small |= is_tolerated(objective, further, last, chosen, explore.variance_inflation, level)
    small |= witnessed > p_value and not exceeds_simulation_scatter(objective, part.candidate, saved)
    spread = witnessed <= p_value or is_spread(objective, further, last, chosen, rules)
    return p_value, small, spread


def other_beginnings(first: Sequence[Fit], base: Fit, rules: SelectionRules) -> list[Fit]:
    """Return the best fits of the next best terms that save nearly as much as the best one."""
    out: dict[str, Fit] = {}
    saved = base.cost - first[0].cost if first else 0.0
    for fit in first[1:]:
        term = fit.parts[-1].candidate.term
        if term != first[0].parts[-1].candidate.term and base.cost - fit.cost > (1.0 - rules.fair_share) * saved:
            out.setdefault(term, fit)
    return list(out.values())[: rules.beginnings]


def leaves_car_range(chosen: Fit, further: Fit) -> bool:
    """Return whether a further term, or another one because of it, ends at a bound of a real car's range."""
    if not chosen.parts:
        return False

    def at_limit(fit: Fit) -> set[str]:
        return {part.candidate.term for part in fit.parts if part.candidate.at_limit(part.values)}

    return bool(at_limit(further) - at_limit(chosen))


def _prune(explore: Explorer, fit: Fit) -> tuple[Fit, list[str]]:
    """Return a fit without earlier parts that are no longer worth their price, and the history in words."""
    history = []
    while len(fit.parts) > 1:
        reduced = fits_without(explore.objective, fit, range(len(fit.parts) - 1))
        best = min(reduced, key=explore.price)
        if explore.price(best) > explore.price(fit):
            break
        gone = set(fit.names) - set(best.names)
        history.append(f"dropped {', '.join(gone)}")
        fit = best
    return fit, history


def _first_accepted(explore: Explorer, chosen: Fit, fits: Sequence[Fit]) -> tuple[Fit | None, str]:
    """Return the first fit whose further term passes the tests, or None with the reason for the first one."""
    objective = explore.objective
    sizes = sizes_with_form_error(objective, chosen.terms)
    reasons = []
    for fit in fits:
        reasons.append(refusal(explore, chosen, sizes, fit))
        if not reasons[-1]:
            return fit, ""
    return None, next(iter(reasons), "")


def hidden_pair(explore: Explorer, chosen: Fit, best: Fit | None) -> Fit | None:
    """Return an explanation with two further terms that save more together than the best single one; else None.

    Each must be significant and pass the tests beside the other. Their joint effect must exceed the model-form error of
    either, since two effects that cancel explain nothing.

    Parameters
    ----------
    best : Fit, optional
        The explanation with the best single term, if there is one.
    """
    rules, enough = explore.rules, explore.price(chosen if best is None else best)
    estimated = estimated_pairs(explore, chosen)
    if best is not None:
        own = best.parts[-1].candidate.term
        with_best = (one for one, *pair in estimated if own in {linear.part.candidate.term for linear in pair})
        enough = min(enough, next(with_best, np.inf))
    return next(sure_pairs(explore, chosen, estimated, enough - rules.price), None)


def sure_pairs(
    explore: Explorer, chosen: Fit, estimated: Sequence[tuple[float, Tangent, Tangent]], enough: float
) -> Iterator[Fit]:
    """Yield explanations with two further terms, each sure beside the other, for the best estimates.

    Parameters
    ----------
    estimated : sequence
        As of `estimated_pairs`.
    enough : float
        Cost with price that they may have at most, over the variance inflation [chi squared].
    """
    for estimate, first, second in estimated[: explore.rules.considered]:
        if estimate > enough:
            break
        fit = with_pair(explore, chosen, (first, second))
        if fit is None or explore.price(fit) > enough or leaves_car_range(chosen, fit):
            continue
        if not cancel(explore.objective, fit) and all(
            _is_sure(explore, fit, k) for k in range(len(chosen.parts), len(fit.parts))
        ):
            yield fit


def cancel(objective: MarginalLikelihood, fit: Fit) -> bool:
    """Return whether the joint effect of a fit's last two parts is no more than the model-form error of either."""
    first, second = (part_sizes(objective, fit, k) for k in (len(fit.parts) - 2, len(fit.parts) - 1))
    together = sizes_of_terms(objective, fit.terms, fit.terms[:-2])
    return over_form_error(objective, together, np.maximum(first, second)) < 1.0


def _is_sure(explore: Explorer, fit: Fit, k: int) -> bool:
    """Return whether a part is significant, and would pass the tests as the last term beside the others."""
    objective, own = explore.objective, fit.parts[k]
    rest = fits_without(objective, fit, [k])[0]
    saved = rest.cost - fit.cost
    if own.is_within_tolerance or not exceeds_simulation_scatter(objective, own.candidate, saved):
        return False
    if term_p(objective, fit, k, saved, explore.variance_inflation) * len(explore.candidates) >= explore.rules.level:
        return False
    return not is_refused_last(explore, rest, fit, k)


def is_refused_last(explore: Explorer, rest: Fit, fit: Fit, k: int) -> bool:
    """Return whether part k would be refused as a further term beside the others, whose fit is `rest`."""
    last = replace(fit, parts=(*fit.parts[:k], *fit.parts[k + 1 :], fit.parts[k]))
    return bool(refusal(explore, rest, sizes_with_form_error(explore.objective, rest.terms), last))


def refusal(explore: Explorer, chosen: Fit, sizes: np.ndarray, further: Fit) -> str:
    """Return why the last term of `further` is refused beside `chosen`, in words; empty if it is not.

    The recorded yaw may contradict it (`contradicts_yaw`). It may be no more than the others' model-form error
    (`is_beyond_form_error`). Or it may save cost in a few moments only (`is_spread`).

    Parameters
    ----------
    sizes : ndarray, shape (3,)
        `sizes_with_form_error` of the terms of `chosen`.
    """
    last = len(further.parts) - 1
    if contradicts_yaw(explore.objective, further, last):
        return _AGAINST_YAW
    if not is_beyond_form_error(explore, chosen, sizes, further, last):
        return _FORM_ERROR
    return "" if is_spread(explore.objective, further, last, chosen, explore.rules) else _FEW_MOMENTS


def is_beyond_form_error(explore: Explorer, without: Fit, sizes: np.ndarray, fit: Fit, k: int) -> bool:
    """Return whether part k of a fit exceeds the model-form error of the others, whose fit is `without`.

    Its size must exceed a share of `sizes`, those of the others, in some channel (`is_form_error`). Sizes are
    prediction errors over 0.05 s, since costs are dominated by slow effects. Its saving must also be significant beside
    the model-form error of the others and of the shared discrepancy (`saved_beside_form_error`).
    """
    objective, rules = explore.objective, explore.rules
    # Witnesses compare two instruments, so model-form error does not matter.
    if is_witnessed(objective, fit, k):
        return True
    if is_form_error(objective, part_sizes(objective, fit, k), sizes, without, fit, rules):
        return False
    saved, widened = without.cost - fit.cost, explore.variance_inflation
    both = saved_beside_form_error(objective, without, fit)
    alone = objective.posterior is None
    beside = both if alone else saved_beside_form_error(objective, without, fit, shared=False), both
    return term_p(objective, fit, k, saved, widened, beside) * len(explore.candidates) < rules.level


def sizes_with_form_error(objective: MarginalLikelihood, terms: tuple[Term, ...]) -> np.ndarray:
    """Return the effect-to-noise ratios, (3,), of terms of the car; sensor faults have no model-form error.

    A term of which more is wrong than of others, see `share_of_error`, counts as one that is so much larger.
    """
    own = tuple(term for term in terms if term.exported)
    sizes = sizes_in_velocity(objective, own, ())
    for k, term in enumerate(own):
        more = share_of_error(objective, term) / objective.policy.selection.form_error_share
        if more > 1.0:
            sizes = np.maximum(sizes, more * sizes_in_velocity(objective, own, own[:k] + own[k + 1 :]))
    return sizes
