"""An offset of the steer angle, found on straights by symmetry and without a tyre model.

Against the bare nominal model many effects differ at once. Tyres, mass and bank then share the effect of an offset, and
the search may miss it. No symmetric effect changes the steer angle on straights, see `angle_of_straights`.
"""

from collections.abc import Sequence
from dataclasses import replace

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.recording.straights import Straight, angle_of_straights
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, without_parts
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.search.term_tests import term_p, term_size

_TERM = "steer_offset"


def with_offset_of_straights(
    objective: MarginalLikelihood, selection: Selection, candidates: Sequence[Candidate], variance_inflation: float
) -> Selection:
    """Return a selection with the steer offset that straights show, if the joint fit agrees with it.

    The selection is unchanged if an offset is named already, if straights show none, if the fit disagrees, or if the
    offset saves no more than chance or is too small to be named.
    """
    own = [one for one in candidates if one.term == _TERM]
    if not own or any(term.id == _TERM for term in selection.terms):
        return selection
    straight = straight_off_centre(objective)
    if straight is None:
        return selection
    chosen = selection.chosen
    keep = [k for k, part in enumerate(chosen.parts) if part.candidate.term != _TERM]
    others = tuple(chosen.parts[k] for k in keep)
    fit = fit_parts(objective, (*others, Part(own[0], {"offset": -straight.angle})), slopes_of=chosen)
    if not agrees_with_straights(objective, straight, fit):
        return selection
    without, last, rules = without_parts(objective, selection.base, fit), len(others), objective.policy.selection
    chance = term_p(objective, fit, last, without[last].cost - fit.cost, variance_inflation) * len(candidates)
    if chance >= rules.level or term_size(objective, fit, last) < objective.policy.allowances.unnamed:
        return selection
    return replace(
        selection,
        chosen=fit,
        without=without,
        rivals=(*(selection.rivals[k] for k in keep), ()),
        siblings=(*(selection.siblings[k] for k in keep), ()),
        named=(*(selection.named[k] for k in keep), True),
        history=(*selection.history, f"added {own[0].label}, which straights show"),
    )


def straight_off_centre(objective: MarginalLikelihood) -> Straight | None:
    """Return the steer angle on straights; None if it is no more than chance, or if there is a simulation.

    Straights of the simulation are not evaluated.
    """
    policy, evidence = objective.policy, objective.evidence
    if objective.posterior is not None:
        return None
    known = angle_of_straights([one.series for one in evidence], evidence[0].vehicle, policy.screening)
    return None if known is None or abs(known.angle) <= policy.comparison.deviations * known.error else known


def confirmed_by_straights(objective: MarginalLikelihood, fit: Fit) -> set[str]:
    """Return the id of the steer offset if it is part of a fit and straights confirm it; else no id."""
    if not any(part.candidate.term == _TERM for part in fit.parts):
        return set()
    straight = straight_off_centre(objective)
    return {_TERM} if straight is not None and agrees_with_straights(objective, straight, fit) else set()


def agrees_with_straights(objective: MarginalLikelihood, straight: Straight, fit: Fit) -> bool:
    """Return whether a fit's steer offset agrees with the angle on straights within the factor for witnesses.

    Recorded angle and offset must add up to zero, for any bank of the road that is possible.
    """
    agree = objective.policy.self_test.term_margin
    offsets = [part.values["offset"] for part in fit.parts if part.candidate.term == _TERM]
    shares = [-(straight.angle + sign * straight.by_road) / one for sign in (-1.0, 1.0) for one in offsets if one]
    return bool(shares) and all(1.0 / agree < one < agree for one in shares)
