"""Effects of every real car, fitted together, for a comparison with the bare nominal model.

Without a simulation all effects that a plain single track lacks differ at once. A search that adds terms one at a time
begins with a wrong term that resembles several of them: late sensors look like lags of both actuators. Further terms
then correct the error of the first. By cost alone the most flexible list of terms would win. Beside the model-form
error of all terms such lists cost about the same. So effects that every car has are preferred: they have no price.
"""

from collections.abc import Callable

import numpy as np

from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, fit_with_prior
from split_cli.diagnosis.search.form_error import costs_beside_form_error
from split_cli.diagnosis.search.forward import leaves_car_range, refusal, sizes_with_form_error
from split_cli.diagnosis.search.joint import near_neutral, out_of_local_minimum, prior_of, without_needless
from split_cli.diagnosis.search.term_tests import is_form_error, is_witnessed, sizes_in_velocity
from split_cli.vehicle.effects import CATALOGUE


def explanation_of_every_car(
    explore: Explorer, physics: Callable[[], Fit], found: Fit, leaves_more_than_noise: Callable[[Fit], bool]
) -> tuple[Fit, tuple[str, ...]] | None:
    """Return the fit of effects of every car with further terms, and its history; None if `found` is kept.

    Parameters
    ----------
    physics : callable
        Returns `physics_of_every_car`.
    found : Fit
        Result of the forward search, or of the whole search.
    leaves_more_than_noise : callable
        Whether an explanation leaves more than noise.

    Notes
    -----
    `found` is kept with a simulation, which has these effects too. It is also kept if it leaves only noise, so that
    there is no model-form error, and if it costs less.
    """
    if explore.objective.posterior is not None or not found.parts or not leaves_more_than_noise(found):
        return None
    whole = physics()
    if not _costs_less(explore, whole, found):
        return None
    grown, history = _with_further_terms(explore, whole)
    return grown, (f"what every car has: {', '.join(whole.names)}", *history)


def physics_of_every_car(explore: Explorer, nothing: Fit) -> Fit:
    """Return a joint fit of all effects of every car in their best variants, without those not worth their price.

    Notes
    -----
    Each parameter starts near neutral with a prior as wide as a car's range. The last fit is without the prior.
    """
    tangents = [one for one in explore.first_tangents(nothing) if CATALOGUE[one.part.candidate.term].in_every_car]
    parts = [near_neutral(one.part) for one in tangents]
    priors = [prior_of(part.candidate, explore.rules.deviations) for part in parts]
    fit, _ = fit_with_prior(explore.objective, parts, priors)
    whole = without_needless(explore, _in_best_variants(explore, fit_parts(explore.objective, fit.parts)))
    return out_of_local_minimum(explore, nothing, whole)[0]


def _in_best_variants(explore: Explorer, fit: Fit) -> Fit:
    """Return a fit in which variants of parts are exchanged as long as that saves more than a tie."""
    while True:
        others = [
            fit_parts(explore.objective, (*fit.parts[:k], _as_variant(part, one), *fit.parts[k + 1 :]), slopes_of=fit)
            for k, part in enumerate(fit.parts)
            for one in explore.candidates
            if one.term == part.candidate.term and one.variant != part.candidate.variant
        ]
        best = min(others, key=explore.price, default=fit)
        if explore.price(best) > explore.price(fit) - explore.rules.tie:
            return fit
        fit = best


def _as_variant(part: Part, other: Candidate) -> Part:
    """Return a part in another variant; parameters that the part does not have get their starting values."""
    return Part(other, {name: part.values.get(name, begin) for name, begin in other.starts[0].items()})


def _costs_less(explore: Explorer, fit: Fit, than: Fit) -> bool:
    """Return whether a fit of effects of every car costs less than another, beside model-form error of both.

    Effects of every car have no price here; other terms have theirs.
    """
    there, here = costs_beside_form_error(explore.objective, [than, fit])
    price = explore.rules.price * (_further_parameters(fit) - _further_parameters(than))
    return (here - there) / explore.variance_inflation + price < 0.0


def _with_further_terms(explore: Explorer, whole: Fit) -> tuple[Fit, list[str]]:
    """Return an explanation with further terms that pass the tests beside it, and the history in words.

    A term that resembles present ones may get a large value at their expense, as a yaw inertia beside a steering lag
    and a relaxation. So its size is what it changes after the others are refitted, and that has to exceed model-form
    error.
    """
    history: list[str] = []
    while True:
        sizes = sizes_with_form_error(explore.objective, whole.terms)
        for fit in explore.beyond_form_error(whole)[: explore.rules.considered]:
            saved = explore.price(whole) - explore.price(fit)
            if saved > 0.0 and _changes_enough(explore, whole, fit, sizes) and not leaves_car_range(whole, fit):
                history.append(f"added {fit.parts[-1].candidate.label}, saves {saved:.0f}")
                whole = fit
                break
        else:
            return whole, history


def _changes_enough(explore: Explorer, whole: Fit, fit: Fit, sizes: np.ndarray) -> bool:
    """Return whether the last part of a fit changes more than model-form error, compared with the refitted others."""
    objective = explore.objective
    changed = sizes_in_velocity(objective, fit.terms, whole.terms)
    shown = is_witnessed(objective, fit, len(fit.parts) - 1)
    if not shown and is_form_error(objective, changed, sizes, whole, fit, explore.rules):
        return False
    return not refusal(explore, whole, sizes, fit)


def is_shown(explore: Explorer, fit: Fit, without: Fit) -> bool:
    """Return whether a part changes some channel by more than the others' model-form error.

    Parameters
    ----------
    without : Fit
        The others, refitted without the part.
    """
    policy, objective = explore.objective.policy, explore.objective
    changed = sizes_in_velocity(objective, fit.terms, without.terms)
    others = sizes_with_form_error(objective, without.terms)
    least = np.maximum(policy.allowances.unnamed, policy.selection.form_error_share * others)
    return bool(np.any(changed > least))


def _further_parameters(fit: Fit) -> float:
    """Return the complexity of a fit without that of effects of every car."""
    own = (part.candidate for part in fit.parts)
    return sum(one.complexity for one in own if not CATALOGUE[one.term].in_every_car)
