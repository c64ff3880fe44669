"""All plausible terms fitted at once, and taken away again while evidence allows.

Adding terms one at a time finds those that help alone. Effects that act together may hide each other: a first term
that stands for a little of each is added, and none of the true ones saves much beside it. Here every term takes
part from the beginning, held by the prior of what a car of this size can have; then those leave that cost least.
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

_NEAR_NONE = 0.1  # of a start, where a term that is not in the explanation yet begins
_NO_EFFECT = 1e-12  # curvature, in chi squared by a step, of what changes nothing
_TRIED = 2  # parts whose leaving is tried by a refit, those that cost least to first order


def promised_by_all(explore: Explorer, current: Fit) -> float:
    """Return what a linear fit of every term beside an explanation would save beyond the price, in chi squared.

    Notes
    -----
    The terms' derivatives D at their first starts and the explanation's own sensitivity: e^T P e with P the
    projection onto [D S], e the residuals left. Of pure noise it saves one for every column.
    """
    lines = [one.slopes for one in explore.first_tangents(current)]
    columns = of_length_one(np.hstack([*lines, sensitivity_of(explore.objective, current)]))
    score = columns.T @ current.residuals
    normal = columns.T @ columns + 1e-6 * np.eye(len(score))
    return float(score @ np.linalg.solve(normal, score)) / explore.variance_inflation - len(score)


def all_at_once(explore: Explorer, nothing: Fit, current: Fit) -> Fit:
    """Return the explanation that is left of all terms when none can leave without costing more than its price.

    Parameters
    ----------
    nothing, current : Fit
        Nothing added, and an explanation. Of its parts only those with a place are taken along: all others begin
        near no effect, lest a wrong one keep the place that it has. Where that ends in a worse valley than all
        terms beside the explanation do, this begins there.

    Notes
    -----
    With x the parameters of the joint fit in steps, H its curvature with the prior's, and d the distance of a
    term's parameters b from no effect, leaving the term out costs d^T ((H^-1)_bb)^-1 d to second order, the others
    refitted (Wald). The linear costs are followed down to where the next would cost more than it is worth; what is
    left is then fitted without the prior, and taken away by refits.
    """
    placed = tuple(part for part in current.parts if part.candidate.located)
    begun = fit_parts(explore.objective, placed) if placed else nothing
    begins = [_everything_from(explore, one) for one in (begun, current)]
    release_memory()  # derivatives by all terms at once are the largest arrays of a search
    (fit, curvature), (beside, its_curvature) = map_distributed_with(explore.objective, _fit_from, begins)
    if beside.cost < fit.cost - explore.rules.price * explore.variance_inflation:
        fit, curvature = beside, its_curvature
    kept = _not_needless(explore, fit.parts, curvature)
    release_memory()
    if not kept:
        return current
    return without_needless(explore, fit_parts(explore.objective, kept))


def without_needless(explore: Explorer, fit: Fit) -> Fit:
    """Return an explanation without the parts whose leaving costs less than their price, one after the other.

    Only those whose leaving costs least to first order are tried.
    """
    while len(fit.parts) > 1:
        tried = cheapest_first(explore, fit)[:_TRIED]
        reduced = fits_without(explore.objective, fit, tried)
        best = min(reduced, key=explore.price)
        if explore.price(best) > explore.price(fit):
            break
        fit = best
    return fit


def at_its_least(explore: Explorer, nothing: Fit, fit: Fit) -> tuple[Fit, tuple[Fit, ...]]:
    """Return an explanation and what is left without each of its parts, none of which costs less.

    More parameters never cost more where a cost is least. Where they do, the fit ended in another valley. Then it
    begins again from what is left without the part that hinders most, with that part near no effect.
    """
    tie = explore.rules.tie * explore.variance_inflation
    while True:
        without = explore.without(nothing, fit)
        best = min(without, key=lambda one: one.cost, default=fit)
        if best.cost > fit.cost - tie:
            return fit, without
        k = without.index(best)
        again = fit_parts(explore.objective, (*best.parts[:k], near_none(fit.parts[k]), *best.parts[k:]))
        if again.cost > fit.cost - tie:
            return fit, without
        fit = again


def cheapest_first(explore: Explorer, fit: Fit) -> list[int]:
    """Return the numbers of a fit's parts, by what leaving them costs beyond their price to first order."""
    return [int(k) for k in np.argsort(promised_without(explore, fit))]


def promised_without(explore: Explorer, fit: Fit) -> np.ndarray:
    """Return what leaving each part of a fit costs beyond its price to first order, (parts,) [chi squared]."""
    steps = np.array([part.candidate.ranges[name].step for part in fit.parts for name in part.values])
    slopes = sensitivity_of(explore.objective, fit) * steps
    worth = _worth(explore, _blocks(fit.parts), slopes.T @ slopes, np.zeros(len(steps)))
    return np.array([one for one, _ in worth])


def promised_without_several(explore: Explorer, fit: Fit) -> tuple[float, tuple[int, ...]]:
    """Return what leaving some parts of a fit costs beyond their price, and which, where that is least.

    The cheapest leaves first, then the cheapest of the rest, down to one: of all sets on this way the best. Two
    terms that share an effect may each be worth its price alone, and not both be once a third is found.
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
    """Return an explanation's parts and all other terms, each in its most promising variant, near none; priors."""
    parts = [*current.parts, *(near_none(one.part) for one in explore.first_tangents(current))]
    return parts, [prior_of(part.candidate, explore.rules.deviations) for part in parts]


def near_none(part: Part) -> Part:
    """Return a part near no effect, where one begins that is not in the explanation yet."""
    ranges = part.candidate.ranges
    near = part.candidate.moved(part.values, _NEAR_NONE)
    inside = {name: float(np.clip(value, ranges[name].lower, ranges[name].upper)) for name, value in near.items()}
    return Part(part.candidate, inside)


def prior_of(candidate: Candidate, deviations: float) -> dict[str, Prior]:
    """Return no effect and a deviation, so many to a range's bound, for parameters with a neutral value."""
    neutral = CATALOGUE[candidate.term].neutral
    out = {}
    for name, limit in candidate.ranges.items():
        none = neutral.get(name)
        if none is not None:
            out[name] = Prior(none, max(limit.upper - none, none - limit.lower) / deviations)
    return out


@dataclass(frozen=True)
class _PartColumns:
    """Which of all parameters belong to a part, and which of them vanish with it."""

    part: Part
    columns: np.ndarray
    vanishing: np.ndarray
    distance: np.ndarray


def _blocks(parts: Sequence[Part]) -> list[_PartColumns]:
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
    """Return the parts that cost more than their price, by linear costs, the cheapest taken away one by one."""
    gone = _leaving(explore, _blocks(parts), curvature)
    needless = {k for _, k in takewhile(lambda one: one[0] <= 0.0, gone)}
    return tuple(part for k, part in enumerate(parts) if k not in needless)


def _leaving(explore: Explorer, blocks: Sequence[_PartColumns], curvature: np.ndarray) -> list[tuple[float, int]]:
    """Return what each part costs beyond its price as it leaves, the cheapest first, and its number; one stays."""
    left, out = list(range(len(blocks))), []
    moved = np.zeros(len(curvature))  # of the parameters that stay, as others leave
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
    """Return for each block what its leaving costs beyond its price, and how all parameters then move."""
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
