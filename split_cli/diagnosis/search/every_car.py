"""What no real car is without, all at once: where the bare nominal model is the simulation, it all lacks.

A search that adds terms one at a time begins with the one that stands for most of them: sensors that are late are
both actuators that lag. Each further term then takes up what the first got wrong, and by raw costs the list that
bends most wins. Beside the model-form error of all, such lists cost the same. Then what every car has is no
surprise, and what is wrong of a recording or of a file is.
"""

from collections.abc import Callable

import numpy as np

from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, fit_with_prior
from split_cli.diagnosis.search.form_error import costs_beside_form_error
from split_cli.diagnosis.search.forward import goes_too_far, refusal, sizes_with_form_error
from split_cli.diagnosis.search.joint import at_its_least, near_none, prior_of, without_needless
from split_cli.diagnosis.search.term_tests import is_form_error, is_witnessed, sizes_in_velocity
from split_cli.vehicle.effects import CATALOGUE


def explanation_of_every_car(
    explore: Explorer, physics: Callable[[], Fit], found: Fit, leaves_more_than_noise: Callable[[Fit], bool]
) -> tuple[Fit, tuple[str, ...]] | None:
    """Return what every car has and what is believed beside it, and that in words; None where `found` stays.

    Parameters
    ----------
    physics : callable
        Returns what every car has, see `physics_of_every_car`.
    found : Fit
        What the search forward ended with, or all of the search.
    leaves_more_than_noise : callable
        Whether an explanation does.

    Notes
    -----
    What was found stays where a simulation is given, which has that physics of every car too. It also stays where
    it leaves noise alone, so that there is no model-form error to compare beside, and where it costs less.
    """
    if explore.objective.posterior is not None or not found.parts or not leaves_more_than_noise(found):
        return None
    whole = physics()
    if not _costs_less(explore, whole, found):
        return None
    grown, history = _with_further_terms(explore, whole)
    return grown, (f"what every car has: {', '.join(whole.names)}", *history)


def physics_of_every_car(explore: Explorer, nothing: Fit) -> Fit:
    """Return a joint fit of all that no car is without, in its best variants, less what is not worth its price.

    Notes
    -----
    Each begins near none, held by the prior of what a car of this size can have; then the prior is let go.
    """
    lines = [one for one in explore.first_tangents(nothing) if CATALOGUE[one.part.candidate.term].in_every_car]
    parts = [near_none(one.part) for one in lines]
    priors = [prior_of(part.candidate, explore.rules.deviations) for part in parts]
    fit, _ = fit_with_prior(explore.objective, parts, priors)
    whole = without_needless(explore, _in_best_variants(explore, fit_parts(explore.objective, fit.parts)))
    return at_its_least(explore, nothing, whole)[0]


def _in_best_variants(explore: Explorer, fit: Fit) -> Fit:
    """Return a fit with another variant of a part in its place while one saves more than a tie."""
    while True:
        others = [
            fit_parts(explore.objective, (*fit.parts[:k], _as_variant(part, one), *fit.parts[k + 1 :]), known=fit)
            for k, part in enumerate(fit.parts)
            for one in explore.candidates
            if one.term == part.candidate.term and one.variant != part.candidate.variant
        ]
        best = min(others, key=explore.price, default=fit)
        if explore.price(best) > explore.price(fit) - explore.rules.tie:
            return fit
        fit = best


def _as_variant(part: Part, other: Candidate) -> Part:
    """Return a part in another variant; parameters that it has not itself begin where their search does."""
    return Part(other, {name: part.values.get(name, begin) for name, begin in other.starts[0].items()})


def _costs_less(explore: Explorer, fit: Fit, than: Fit) -> bool:
    """Return whether a fit of what every car has costs less than another, beside model-form error of both.

    What every car has is no surprise and has no price; all other terms have theirs.
    """
    there, here = costs_beside_form_error(explore.objective, [than, fit])
    price = explore.rules.price * (_further_parameters(fit) - _further_parameters(than))
    return (here - there) / explore.variance_inflation + price < 0.0


def _with_further_terms(explore: Explorer, whole: Fit) -> tuple[Fit, list[str]]:
    """Return an explanation with what else is believed beside it, and that in words.

    A term that resembles what is there may be large while the others make way for it: a yaw inertia beside a
    steering lag and a relaxation. What it changes once the others are fitted again is what the data say of it, and
    has to be more than model-form error.
    """
    history: list[str] = []
    while True:
        sizes = sizes_with_form_error(explore.objective, whole.terms)
        for fit in explore.beyond_form_error(whole)[: explore.rules.considered]:
            saved = explore.price(whole) - explore.price(fit)
            if saved > 0.0 and _changes_enough(explore, whole, fit, sizes) and not goes_too_far(whole, fit):
                history.append(f"added {fit.parts[-1].candidate.label}, saves {saved:.0f}")
                whole = fit
                break
        else:
            return whole, history


def _changes_enough(explore: Explorer, whole: Fit, fit: Fit, sizes: np.ndarray) -> bool:
    """Return whether the last part of a fit changes more than model-form error, the others fitted again."""
    objective = explore.objective
    changed = sizes_in_velocity(objective, fit.terms, whole.terms)
    shown = is_witnessed(objective, fit, len(fit.parts) - 1)
    if not shown and is_form_error(objective, changed, sizes, whole, fit, explore.rules):
        return False
    return not refusal(explore, whole, sizes, fit)


def is_shown(explore: Explorer, fit: Fit, without: Fit) -> bool:
    """Return whether a part changes more than the others' model-form error in some channel, these refitted.

    Parameters
    ----------
    without : Fit
        The same refitted without the part.
    """
    policy, objective = explore.objective.policy, explore.objective
    changed = sizes_in_velocity(objective, fit.terms, without.terms)
    others = sizes_with_form_error(objective, without.terms)
    least = np.maximum(policy.allowances.unnamed, policy.selection.form_error_share * others)
    return bool(np.any(changed > least))


def _further_parameters(fit: Fit) -> float:
    """Return how many parameters were effectively searched for beside those of what every car has."""
    own = (part.candidate for part in fit.parts)
    return sum(one.complexity for one in own if not CATALOGUE[one.term].in_every_car)
