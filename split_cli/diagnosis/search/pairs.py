"""Two further terms at once, for effects that hide each other: they save little alone and much together.

A steering gain and a stiffer differential nearly cancel in a turn, for example. A wrong term that resembles the rest
would save more than either of them, and be found in their place.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise

import numpy as np

from split_cli.diagnosis.parallel import map_in_threads
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import RIDGE, Fit, Tangent, fit_parts, of_length_one, sensitivity_of
from split_cli.vehicle.effects import CATALOGUE


def estimated_pairs(explore: Explorer, current: Fit) -> list[tuple[float, Tangent, Tangent]]:
    """Return the estimated cost, with price, of an explanation with each pair of further terms, best first.

    Each variant without a place takes part, with the start that saves most alone. Two terms that shift commands in time
    are no pair: a lag and a delay of the steering are one delay, and their difference is model-form error of
    transients.
    """
    sensitivity_of(explore.objective, current)
    tangents = explore.tangents_beside(current)
    estimates = map_in_threads(lambda one: one.cost(current), tangents)
    best: dict[str, Tangent] = {}
    for _, linear in sorted(zip(estimates, tangents, strict=True), key=lambda one: one[0]):
        best.setdefault(linear.part.candidate.label, linear)
    firsts = list(best.values())

    def price(cost: float, *pair: Tangent) -> float:
        complexity = sum(one.part.candidate.complexity for one in pair)
        return cost / explore.variance_inflation + explore.rules.price * complexity

    pairs = [(firsts[i], firsts[j], cost) for i, j, cost in costs_of_pairs(current, firsts)]
    return sorted(((price(cost, *pair), *pair) for *pair, cost in pairs), key=lambda one: one[0])


def costs_of_pairs(current: Fit, tangents: Sequence[Tangent]) -> Iterator[tuple[int, int, float]]:
    """Yield the numbers i < j of every two tangents that may be a pair, and the estimated cost with both.

    Notes
    -----
    As `Tangent.cost` with the columns of both. All columns are first made orthogonal to those of the explanation, so
    that each pair needs only a small system.
    """
    slopes = [of_length_one(one.slopes) for one in tangents]
    rows = np.column_stack([*slopes, *(one.moved for one in tangents), current.residuals])
    if current.sensitivity.shape[1]:
        basis = np.linalg.qr(of_length_one(current.sensitivity))[0]
        rows -= basis @ (basis.T @ rows)
    products = rows.T @ rows
    ends = np.cumsum([0, *(one.shape[1] for one in slopes)])
    own = [np.arange(begin, end) for begin, end in pairwise(ends)]
    for i, j in combinations(range(len(tangents)), 2):
        if not _are_one(tangents[i], tangents[j]):
            columns, moved = np.concatenate([own[i], own[j]]), [ends[-1] + i, ends[-1] + j, len(products) - 1]
            score = products[np.ix_(columns, moved)].sum(axis=1)
            normal = products[np.ix_(columns, columns)] + RIDGE * np.eye(len(columns))
            yield i, j, float(products[np.ix_(moved, moved)].sum() - score @ np.linalg.solve(normal, score))


def _are_one(first: Tangent, second: Tangent) -> bool:
    """Return whether two tangents are of the same term, or both shift commands in time."""
    kinds = [CATALOGUE[linear.part.candidate.term] for linear in (first, second)]
    return kinds[0] is kinds[1] or all(kind.acts_late() and kind.acts_on_commands() for kind in kinds)


def with_pair(explore: Explorer, current: Fit, pair: tuple[Tangent, Tangent]) -> Fit | None:
    """Return an explanation with two further terms, fitted; None if one is denied, or equals another term."""
    fit = fit_parts(explore.objective, (*current.parts, *(one.part for one in pair)), slopes_of=current, tangents=pair)
    return fit if all(explore.is_possible(fit, k) for k in range(len(current.parts), len(fit.parts))) else None
