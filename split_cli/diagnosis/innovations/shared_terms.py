"""Lags, tyre relaxation and combined slip of the simulation, fitted as terms before the rest of the discrepancy.

A lag is no function of the state, and its derivative approximates it only while it is short. A servo lag of 35 ms
doubles the yaw moment that a model car seems to need. Basis functions represent a part of that by weaker forces, since
steer rate and yaw acceleration are correlated in most driving. A change of the yaw inertia then comes out too small.
The lateral force that is lost to combined slip depends on the grip, so that a lower grip would seem to change combined
slip too. As terms of the model, both respond to a changed inertia or grip as they should.
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
from split_cli.vehicle.parameters import Vehicle

_BEGIN = 0.03
"""Starting value of every parameter, in units of `Term.sizes` [1]. Judgement: a servo's 30 ms in a full-size car."""
_LEAST = 1e-3
"""Smallest value that a fit begins from, in units of `Term.sizes` [1]: on a bound it would have no slope to one side.
Judgement: a thirtieth of the value that a first fit begins from."""


def shared_terms_of(simulated: Sequence[Evidence], discrepancy: SharedDiscrepancy) -> tuple[Term, ...]:
    """Return the `SHARED_TERMS` with the values that explain the simulations best, by least squares.

    Parameters
    ----------
    simulated : sequence of Evidence
        At least one, whitened with `discrepancy`.
    discrepancy : SharedDiscrepancy
        Its columns `unlike_shared_terms` are fitted at the same time. The fit begins from its shared terms, if any.
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

    # With wrong lags the friction ellipse may end in a minimum in which the tyres have no force left. So the fit is
    # repeated from lags that were fitted without it.
    late = np.array([issubclass(kind, BuildsUp) for kind in kinds])

    def left_by_lags(sizes: np.ndarray) -> np.ndarray:
        out = np.zeros(len(late))
        out[late] = sizes
        return left(out)

    known = {name: value for term in discrepancy.shared_terms for name, value in _sizes(term, vehicle).items()}
    begin = np.array([known.get((kind.id, name), _BEGIN) for kind, name in kinds.items()])
    found = _fitted(left, np.clip(begin, _LEAST, most), most)
    begin = np.full(len(unit), _BEGIN)
    begin[late] = _fitted(left_by_lags, begin[late], most[late]).x
    again = _fitted(left, begin, most)
    deeper = again.cost < found.cost and not np.isclose(again.cost, found.cost)
    return terms_at(again.x if deeper else found.x)


def have_settled(before: Sequence[Term], after: Sequence[Term], vehicle: Vehicle, share: float) -> bool:
    """Return whether all shared terms changed by at most this share of their values, or of `_BEGIN` if that is more."""
    return len(before) == len(after) and all(
        abs(new - old) <= share * max(old, new, _BEGIN)
        for one, other in zip(before, after, strict=True)
        for old, new in zip(_sizes(one, vehicle).values(), _sizes(other, vehicle).values(), strict=True)
    )


def _sizes(term: Term, vehicle: Vehicle) -> dict[tuple[str, str], float]:
    """Return the parameters in units of `Term.sizes`, by the ids of term and parameter."""
    unit = term.sizes(vehicle)
    return {(term.id, name): value / unit.get(name, 1.0) for name, value in term.parameters.items()}


def _fitted(left: Callable[[np.ndarray], np.ndarray], begin: np.ndarray, most: np.ndarray) -> OptimizeResult:
    """Return the local minimum of the sum of squares of `left`, with sizes from 0 to `most`, shape (P,)."""
    return least_squares(left, begin, bounds=(0.0, most), diff_step=0.01)
