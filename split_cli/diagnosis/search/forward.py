"""Terms added one at a time while the evidence carries them, and why a further one is refused."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import SelectionRules
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, fits_without
from split_cli.diagnosis.search.form_error import saved_beside_form_error
from split_cli.diagnosis.search.pairs import promised_pairs, with_pair
from split_cli.diagnosis.search.term_tests import (
    exceeds_simulation_scatter,
    is_denied,
    is_form_error,
    is_spread,
    is_witnessed,
    over_form_error,
    part_sizes,
    sizes_in_velocity,
    sizes_of_terms,
    term_p,
    witnessed_p,
)
from split_cli.vehicle.effects import Term

_DENIED = "contradicted by the recorded yaw"
_ONCE = "nearly all of it in a few moments"
_FORM_ERROR = "within the model-form error of the other terms"


@dataclass(frozen=True)
class Found:
    """What a search forward ended with."""

    # chosen, with_refused: as far as it is believed or kept as a nuisance, and with the term that was refused
    # last.
    chosen: Fit
    with_refused: Fit
    names: int  # how many of its parts were added to be named
    history: tuple[str, ...]
    first_p: float

    def with_what_matters(self, base: Fit, rules: SelectionRules) -> Fit:
        """Return the explanation with the refused term, if that saves more than model-form error.

        Too small to be reported, it would yet be taken for more or less of the others.
        """
        refused, saved = self.chosen.cost - self.with_refused.cost, base.cost - self.chosen.cost
        return self.with_refused if refused > rules.form_error_cost * saved else self.chosen

    @property
    def left_something(self) -> bool:
        """Whether several terms or a refused one show that the first leaves something."""
        return self.names > 1 or self.with_refused is not self.chosen


def search_forward(
    explore: Explorer, base: Fit, first: Sequence[Fit] = (), begun: Fit | None = None, nuisances: int = 0
) -> Found:
    """Add terms while evidence carries them, beginning with the best of `first`, or with what is `begun`.

    Parameters
    ----------
    base : Fit
        Without any term.
    first : sequence of Fit
        What each term explains alone, best first; of use where nothing is begun.
    begun : Fit, optional
        An explanation to go on from.
    nuisances : int
        How many of its parts are too small to be named.
    """
    objective, rules, variance_inflation = explore.objective, explore.rules, explore.variance_inflation
    chosen, history, first_p, refused = base if begun is None else begun, [], 1.0, None
    alone: tuple[Fit, int, int, Fit] | None = None  # what was believed before a term that saves in a few moments

    def price_saved(fit: Fit) -> float:
        return explore.price(chosen) - explore.price(fit)

    def worth_it(fits: Sequence[Fit]) -> list[Fit]:
        return [fit for fit in fits if price_saved(fit) > 0.0 and not goes_too_far(chosen, fit)]

    while True:
        fits = worth_it(first if chosen is base else explore(chosen))
        if not fits:
            break
        best = fits[0]
        # Beside nuisances alone there is no name that a term could be a model-form error of.
        if len(chosen.parts) > nuisances:
            best, reason = _first_believed(explore, chosen, fits[: rules.considered])
            if best is None:
                beyond = worth_it(explore.beyond_form_error(chosen))
                best, _ = _first_believed(explore, chosen, beyond[: rules.considered])
            both = hidden_pair(explore, chosen, best)
            if both is not None:
                labels = " and ".join(part.candidate.label for part in both.parts[-2:])
                history.append(f"added {labels}, which hide each other, saves {price_saved(both):.0f}")
                chosen, dropped = _prune(explore, both)
                history += dropped
                alone = None
                continue
        if best is None:
            label, saved = fits[0].parts[-1].candidate.label, price_saved(fits[0])
            if reason == _ONCE and nuisances < rules.most_nuisances:
                # What else is missing bends what it saves block by block: it may be identified beside a further one.
                alone = alone or (chosen, nuisances, len(history), fits[0])
                history.append(f"{label} saves {saved:.0f}, {reason}")
                chosen, nuisances = fits[0], nuisances + 1
                continue
            history.append(f"{label} would save {saved:.0f}, {reason}")
            refused = fits[0]
            break
        label, saved = best.parts[-1].candidate.label, price_saved(best)
        p_value = term_p(objective, best, len(best.parts) - 1, chosen.cost - best.cost, variance_inflation)
        witnessed = witnessed_p(objective, best, len(best.parts) - 1, chosen, rules)
        p_value = min(p_value, witnessed) * len(explore.candidates)
        last = best.parts[-1]
        small = p_value >= rules.level or last.is_within_tolerance
        small |= witnessed > p_value and not exceeds_simulation_scatter(
            objective, last.candidate, chosen.cost - best.cost
        )
        spread = witnessed <= p_value or is_spread(objective, best, len(best.parts) - 1, chosen, rules)
        # What any sound recording has is sure, and lends no sureness to a name beside it.
        first_p = min(first_p, p_value if spread and not (small and p_value < rules.level) else 1.0)
        if small or not spread:
            history.append(f"{label} saves {saved:.0f}, {'too small to name' if small else _ONCE}")
            nuisances += 1
            # What any sound recording has is no guess, and takes no guess's place.
            guesses = nuisances - sum(part.is_within_tolerance for part in best.parts)
            if guesses > rules.most_nuisances:
                break
            chosen = best
            continue
        history.append(f"added {label}, saves {saved:.0f}")
        chosen, dropped = _prune(explore, best)
        history += dropped
        alone = None
    if alone is not None:
        chosen, nuisances, begun_at, refused = alone
        label, saved = refused.parts[-1].candidate.label, price_saved(refused)
        history[begun_at:] = [f"{label} would save {saved:.0f}, {_ONCE}"]
    names = len(chosen.parts) - nuisances
    return Found(chosen, refused or chosen, names, tuple(history), first_p)


def other_beginnings(first: Sequence[Fit], base: Fit, rules: SelectionRules) -> list[Fit]:
    """Return the best fits of the next best terms, where they save nearly as much as the best."""
    out: dict[str, Fit] = {}
    saved = base.cost - first[0].cost if first else 0.0
    for fit in first[1:]:
        term = fit.parts[-1].candidate.term
        if term != first[0].parts[-1].candidate.term and base.cost - fit.cost > (1.0 - rules.fair_share) * saved:
            out.setdefault(term, fit)
    return list(out.values())[: rules.beginnings]


def goes_too_far(chosen: Fit, further: Fit) -> bool:
    """Return whether a further term ends where no real car goes further, or takes one that did not there."""
    if not chosen.parts:
        return False

    def at_limit(fit: Fit) -> set[str]:
        return {part.candidate.term for part in fit.parts if part.candidate.at_limit(part.values)}

    return bool(at_limit(further) - at_limit(chosen))


def _prune(explore: Explorer, fit: Fit) -> tuple[Fit, list[str]]:
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


def _first_believed(explore: Explorer, chosen: Fit, fits: Sequence[Fit]) -> tuple[Fit | None, str]:
    """Return the first further term that is believed; where none is, why not the first of them, in words."""
    objective = explore.objective
    sizes = sizes_with_form_error(objective, chosen.terms)
    reasons = []
    for fit in fits:
        reasons.append(refusal(explore, chosen, sizes, fit))
        if not reasons[-1]:
            return fit, ""
    return None, next(iter(reasons), "")


def hidden_pair(explore: Explorer, chosen: Fit, best: Fit | None) -> Fit | None:
    """Return an explanation with two terms that save more together than the best one with any other; else None.

    Each of the two has to be sure, and believed as the last to come to the other. What they do together has to be
    more than either may get wrong: steering that arrives late and is logged late by as much does next to nothing.

    Parameters
    ----------
    best : Fit, optional
        With the one further term that would be added; where there is none, any two that are worth it will do.
    """
    rules, enough = explore.rules, explore.price(chosen if best is None else best)
    promised = promised_pairs(explore, chosen)
    if best is not None:
        own = best.parts[-1].candidate.term
        with_best = (one for one, *pair in promised if own in {line.part.candidate.term for line in pair})
        enough = min(enough, next(with_best, np.inf))
    for promise, first, second in promised[: rules.considered]:
        if promise > enough - rules.price:
            break
        fit = with_pair(explore, chosen, (first, second))
        if fit is None or explore.price(fit) > enough - rules.price or goes_too_far(chosen, fit):
            continue
        if not cancel(explore.objective, fit) and all(
            _is_sure(explore, fit, k) for k in range(len(chosen.parts), len(fit.parts))
        ):
            return fit
    return None


def cancel(objective: MarginalLikelihood, fit: Fit) -> bool:
    """Return whether the last two parts of a fit together do no more than the model-form error of either."""
    first, second = (part_sizes(objective, fit, k) for k in (len(fit.parts) - 2, len(fit.parts) - 1))
    together = sizes_of_terms(objective, fit.terms, fit.terms[:-2])
    return over_form_error(objective, together, np.maximum(first, second)) < 1.0


def _is_sure(explore: Explorer, fit: Fit, k: int) -> bool:
    """Return whether a part is sure enough to be named, and would be believed as the last to come to the others."""
    objective, own = explore.objective, fit.parts[k]
    rest = fits_without(objective, fit, [k])[0]
    saved = rest.cost - fit.cost
    if own.is_within_tolerance or not exceeds_simulation_scatter(objective, own.candidate, saved):
        return False
    if term_p(objective, fit, k, saved, explore.variance_inflation) * len(explore.candidates) >= explore.rules.level:
        return False
    return not is_refused_last(explore, rest, fit, k)


def is_refused_last(explore: Explorer, rest: Fit, fit: Fit, k: int) -> bool:
    """Return whether one part of a fit would be refused as the last to come to the others, which leave `rest`."""
    last = replace(fit, parts=(*fit.parts[:k], *fit.parts[k + 1 :], fit.parts[k]))
    return bool(refusal(explore, rest, sizes_with_form_error(explore.objective, rest.terms), last))


def refusal(explore: Explorer, chosen: Fit, sizes: np.ndarray, further: Fit) -> str:
    """Return why a further term is not believed, in words; nothing where it is.

    Yaw may deny it, see `is_denied`. It may be no more than the others' model-form error, see
    `is_beyond_form_error`. Or it may save all in a few moments, unless it acts at a place, which is passed once a
    lap.
    """
    last = len(further.parts) - 1
    if is_denied(explore.objective, further, last):
        return _DENIED
    if not is_beyond_form_error(explore, chosen, sizes, further, last):
        return _FORM_ERROR
    return "" if is_spread(explore.objective, further, last, chosen, explore.rules) else _ONCE


def is_beyond_form_error(explore: Explorer, without: Fit, sizes: np.ndarray, fit: Fit, k: int) -> bool:
    """Return whether part k of a fit is more than the others' model-form error; they leave `without`.

    It may be no larger than what single-track terms leave of a real car's effect, `sizes` of the others. That is
    measured by prediction errors over 0.05 s: costs also weigh what builds up slowly, and one term's slow channel
    would drown another's fast one. What is left of one term is of its own kind, so channels count apart. What it
    saves has to be more than what the others and the shared discrepancy may get wrong would save, too.
    """
    objective, rules = explore.objective, explore.rules
    # What witnesses show is the instrument's own, whatever the model gets wrong.
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
    """Return the sizes of terms of the car, shape (3,): what an instrument does has no model-form error."""
    return sizes_in_velocity(objective, tuple(term for term in terms if term.exported), ())
