"""Joint search: all terms are fitted at once, then removed one by one while that costs less than their price.

A forward search finds terms that save alone. Effects that act together may hide each other: a wrong term that resembles
each of them is added first, and none of the true ones saves much beside it. Here all terms take part from the
beginning, with priors as wide as a car's range. Then the least useful are removed (backward elimination).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from split_cli.diagnosis.cache import release_memory
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.parallel import map_distributed_with
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import (
    Fit,
    Part,
    Prior,
    fit_parts,
    fit_with_prior,
    fits_without,
    of_length_one,
    sensitivity_of,
)
from split_cli.vehicle.effects import CATALOGUE

_NEAR_NEUTRAL = 0.1  # share of a start at which a term begins that is not in the explanation yet [1]
_NO_EFFECT = 1e-12  # least curvature of the cost, per squared step, for scaling [chi squared]
_TRIED = 2  # parts whose removal is tried by a refit: those that cost least to first order [1]


def estimated_saving_of_all(explore: Explorer, current: Fit) -> float:
    """Return what a linear fit of all terms beside an explanation would save beyond chance [chi squared].

    Notes
    -----
    e^T P e less the number of columns, with the residuals e and the projection P onto [D S]: the derivatives D of terms
    at their best starts, and the sensitivity S of the explanation. Of noise, each column saves 1.
    """
    tangents = [one.slopes for one in explore.first_tangents(current)]
    columns = of_length_one(np.hstack([*tangents, sensitivity_of(explore.objective, current)]))
    score = columns.T @ current.residuals
    normal = columns.T @ columns + 1e-6 * np.eye(len(score))
    return float(score @ np.linalg.solve(normal, score)) / explore.variance_inflation - len(score)


def all_at_once(explore: Explorer, nothing: Fit, current: Fit) -> Fit:
    """Return the explanation that is left of all terms when removing any one would cost more than its price.

    Parameters
    ----------
    nothing, current : Fit
        The fit without any term, and an explanation. All terms are fitted from near neutral, beside the explanation's
        parts with a place; so a wrong term has no advantage. They are also fitted beside the whole explanation, and the
        better of both is used.

    Notes
    -----
    Let H be the half Hessian of the cost with priors, per steps of the parameters, and d the distance of a term's
    parameters b from neutral. Removing the term costs d^T ((H^-1)_bb)^-1 d to second order, the others refitted (Wald).
    Terms are removed by these estimates while they are worth less than their price. The rest is fitted without priors,
    and further terms are removed by refits.
    """
    placed = tuple(part for part in current.parts if part.candidate.located)
    begun = fit_parts(explore.objective, placed) if placed else nothing
    begins = [_everything_from(explore, one) for one in (begun, current)]
    release_memory()  # derivatives with respect to all terms are the largest arrays of a search
    (fit, curvature), (beside, its_curvature) = map_distributed_with(explore.objective, _fit_from, begins)
    if beside.cost < fit.cost - explore.rules.price * explore.variance_inflation:
        fit, curvature = beside, its_curvature
    kept = _not_needless(explore, fit.parts, curvature)
    release_memory()
    if not kept:
        return current
    return without_needless(explore, fit_parts(explore.objective, kept))


def without_needless(explore: Explorer, fit: Fit) -> Fit:
    """Return an explanation without the parts whose removal costs less than their price, one after the other.

    Only those that cost least to first order are tried.
    """
    while len(fit.parts) > 1:
        tried = cheapest_first(explore, fit)[:_TRIED]
        reduced = fits_without(explore.objective, fit, tried)
        best = min(reduced, key=explore.price)
        if explore.price(best) > explore.price(fit):
            break
        fit = best
    return fit


def out_of_local_minimum(explore: Explorer, nothing: Fit, fit: Fit) -> tuple[Fit, tuple[Fit, ...]]:
    """Return an explanation and the fits without each part, none of which costs less.

    At the global minimum, fewer parameters never cost less. If they do, the fit ended in another local minimum. Then it
    is repeated from the cheaper fit, with the missing part near neutral.
    """
    tie = explore.rules.tie * explore.variance_inflation
    while True:
        without = explore.without(nothing, fit)
        best = min(without, key=lambda one: one.cost, default=fit)
        if best.cost > fit.cost - tie:
            return fit, without
        k = without.index(best)
        again = fit_parts(explore.objective, (*best.parts[:k], near_neutral(fit.parts[k]), *best.parts[k:]))
        if again.cost > fit.cost - tie:
            return fit, without
        fit = again


def cheapest_first(explore: Explorer, fit: Fit) -> list[int]:
    """Return the numbers of a fit's parts in ascending order of `estimated_removal_costs`."""
    return [int(k) for k in np.argsort(estimated_removal_costs(explore, fit))]


def estimated_removal_costs(explore: Explorer, fit: Fit) -> np.ndarray:
    """Return the estimated cost of removing each part less its price, shape (parts,) [chi squared]."""
    steps = np.array([part.candidate.ranges[name].step for part in fit.parts for name in part.values])
    slopes = sensitivity_of(explore.objective, fit) * steps
    worth = _worth(explore, _blocks(fit.parts), slopes.T @ slopes, np.zeros(len(steps)))
    return np.array([one for one, _ in worth])


def estimated_removal_of_several(explore: Explorer, fit: Fit) -> tuple[float, tuple[int, ...]]:
    """Return the estimated cost of removing several parts less their price, and their numbers, for the best set.

    Sets are formed by removing the cheapest part again and again. Two terms that share an effect may each be worth the
    price, but not both after a third one is added.
    """
    steps = np.array([part.candidate.ranges[name].step for part in fit.parts for name in part.values])
    slopes = sensitivity_of(explore.objective, fit) * steps
    gone = _leaving(explore, _blocks(fit.parts), slopes.T @ slopes)
    if not gone:
        return 0.0, ()
    costs = np.cumsum([cost for cost, _ in gone])
    count = int(np.argmin(costs)) + 1
    return float(costs[count - 1]), tuple(k for _, k in gone[:count])


def _fit_from(
    objective: MarginalLikelihood, begin: tuple[Sequence[Part], Sequence[Mapping[str, Prior]]]
) -> tuple[Fit, np.ndarray]:
    return fit_with_prior(objective, *begin)


def _everything_from(explore: Explorer, current: Fit) -> tuple[list[Part], list[dict[str, Prior]]]:
    """Return an explanation's parts with all other terms in their best variants near neutral, and their priors."""
    parts = [*current.parts, *(near_neutral(one.part) for one in explore.first_tangents(current))]
    return parts, [prior_of(part.candidate, explore.rules.deviations) for part in parts]


def near_neutral(part: Part) -> Part:
    """Return a part with values near neutral, at which a term begins that is not in the explanation yet."""
    ranges = part.candidate.ranges
    near = part.candidate.moved(part.values, _NEAR_NEUTRAL)
    inside = {name: float(np.clip(value, ranges[name].lower, ranges[name].upper)) for name, value in near.items()}
    return Part(part.candidate, inside)


def prior_of(candidate: Candidate, deviations: float) -> dict[str, Prior]:
    """Return priors of parameters with a neutral value: that value, and a range that is `deviations` standard ones."""
    neutral = CATALOGUE[candidate.term].neutral
    out = {}
    for name, limit in candidate.ranges.items():
        none = neutral.get(name)
        if none is not None:
            out[name] = Prior(none, max(limit.upper - none, none - limit.lower) / deviations)
    return out


@dataclass(frozen=True)
class _PartColumns:
    """Numbers of a part's parameters among those of a fit, and of those that have a neutral value."""

    part: Part
    columns: np.ndarray  # int: all parameters of the part
    vanishing: np.ndarray  # int: those with a neutral value, which are neutral without the part
    distance: np.ndarray  # of the latter: values less neutral values, in steps


def _blocks(parts: Sequence[Part]) -> list[_PartColumns]:
    """Return the parameter numbers of all parts, in their order."""
    blocks, first = [], 0
    for part in parts:
        neutral = CATALOGUE[part.candidate.term].neutral
        names = list(part.values)
        has_neutral = np.array([neutral.get(name) is not None for name in names])
        distance = [
            (part.values[name] - neutral[name]) / part.candidate.ranges[name].step
            for name in names
            if neutral.get(name) is not None
        ]
        columns = first + np.arange(len(names))
        blocks.append(_PartColumns(part, columns, columns[has_neutral], np.array(distance)))
        first += len(names)
    return blocks


def _not_needless(explore: Explorer, parts: Sequence[Part], curvature: np.ndarray) -> tuple[Part, ...]:
    """Return the parts that are worth their price by estimated costs, after removing the others one by one."""
    gone = _leaving(explore, _blocks(parts), curvature)
    needless = {k for _, k in takewhile(lambda one: one[0] <= 0.0, gone)}
    return tuple(part for k, part in enumerate(parts) if k not in needless)


def _leaving(explore: Explorer, blocks: Sequence[_PartColumns], curvature: np.ndarray) -> list[tuple[float, int]]:
    """Return the order in which parts are removed, with the cost of each removal less its price; one part stays."""
    left, out = list(range(len(blocks))), []
    moved = np.zeros(len(curvature))  # change of the parameters that stay
    while len(left) > 1:
        here = [blocks[k] for k in left]
        worth = _worth(explore, here, curvature, moved)
        least = int(np.argmin([one for one, _ in worth]))
        moved[np.concatenate([one.columns for one in here])] += worth[least][1]
        out.append((worth[least][0], left.pop(least)))
    return out


def _worth(
    explore: Explorer, blocks: Sequence[_PartColumns], curvature: np.ndarray, moved: np.ndarray
) -> list[tuple[float, np.ndarray]]:
    """Return for each part the estimated cost of its removal less its price, and the change of all parameters."""
    here = np.concatenate([one.columns for one in blocks])
    place = {column: i for i, column in enumerate(here)}
    scale = 1.0 / np.sqrt(np.maximum(np.diag(curvature)[here], _NO_EFFECT))
    inverse = np.linalg.inv(curvature[np.ix_(here, here)] * np.outer(scale, scale) + 1e-9 * np.eye(len(here)))
    inverse *= np.outer(scale, scale)
    out = []
    for one in blocks:
        at = [place[column] for column in one.vanishing]
        distance = one.distance + moved[one.vanishing]
        weights = np.linalg.solve(inverse[np.ix_(at, at)], distance)
        price = explore.rules.price * one.part.candidate.complexity
        out.append((float(distance @ weights) / explore.variance_inflation - price, -inverse[:, at] @ weights))
    return out
