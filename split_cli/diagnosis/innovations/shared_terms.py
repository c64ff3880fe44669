"""Lags and combined slip of the simulation: found as terms, before what else it has beyond the nominal model.

A lag is no function of the state, and its derivative stands for it only where it is short. A servo of 35 ms doubles
the yaw moment that a model car seems to need. What a discrepancy of functions misses of that, it makes up for by
weaker forces, since the rate of steering goes with the yaw acceleration in most driving. Another yaw inertia then
comes out too small. And what tyres that drive or brake lose across depends on the grip that is there, so that less
grip seems to bring combined slip of its own. As terms of the model both answer to what else differs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from split_cli.diagnosis.baseline.discrepancy import SHARED_TERMS, SharedDiscrepancy
from split_cli.diagnosis.innovations.evidence import Evidence, weighted_rows
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.effects.late import BuildsUp
from split_cli.vehicle.effects.search import Course

_BEGIN = 0.03
"""Where the search begins, in units of `Term.sizes` [1]. Judgement: a servo's 30 ms in a full-size car; from there
least squares go to the nearest minimum."""


def shared_terms_of(simulated: Sequence[Evidence], discrepancy: SharedDiscrepancy) -> tuple[Term, ...]:
    """Return the `SHARED_TERMS` with which simulations are explained best, by least squares.

    Parameters
    ----------
    simulated : sequence of Evidence
        At least one, whitened with `discrepancy`.
    discrepancy : SharedDiscrepancy
        Those of its columns that none of the terms is like are fitted with them.
    """
    vehicle, first = discrepancy.vehicle, simulated[0].series
    course = Course(max(float(first.t[-1]), 1.0), float(first.s.max()))
    kinds = {kind: name for kind in map(CATALOGUE.__getitem__, SHARED_TERMS) for name in kind.units}
    unit = np.array([kind.sizes(vehicle).get(name, 1.0) for kind, name in kinds.items()])
    most = np.array([kind.search(vehicle, course).ranges[name].upper for kind, name in kinds.items()])  # in units
    beside = discrepancy.unlike_shared_terms()
    columns = weighted_rows(simulated, [one.discrepancy[:, :, beside] for one in simulated])
    bare = [replace(one, shared_terms=()) for one in simulated]
    inverse = np.linalg.solve(columns.T @ columns + np.eye(columns.shape[1]), columns.T)

    def terms_at(sizes: np.ndarray) -> tuple[Term, ...]:
        values = zip(kinds.items(), (sizes * unit).tolist(), strict=True)
        return tuple(kind({name: value}) for (kind, name), value in values)

    def left(sizes: np.ndarray) -> np.ndarray:
        terms = terms_at(sizes)
        rows = weighted_rows(simulated, [one.rows(terms) for one in bare])
        weights = inverse @ rows
        return np.concatenate([rows - columns @ weights, weights])

    # Beside wrong lags a friction ellipse may go to another minimum, where it leaves tyres no force at all. So it is
    # begun anew from lags that were found without it.
    late = np.array([issubclass(kind, BuildsUp) for kind in kinds])

    def left_by_lags(sizes: np.ndarray) -> np.ndarray:
        out = np.zeros(len(late))
        out[late] = sizes
        return left(out)

    begin = np.full(len(unit), _BEGIN)
    found = _fitted(left, begin, most)
    begin[late] = _fitted(left_by_lags, begin[late], most[late]).x
    again = _fitted(left, begin, most)
    deeper = again.cost < found.cost and not np.isclose(again.cost, found.cost)
    return terms_at(again.x if deeper else found.x)


def _fitted(left: Callable[[np.ndarray], np.ndarray], begin: np.ndarray, most: np.ndarray) -> OptimizeResult:
    """Return the nearest minimum of the sum of squares of what is left, over sizes from 0 to the most, (P,)."""
    return least_squares(left, begin, bounds=(0.0, most), diff_step=0.01)
