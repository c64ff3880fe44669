"""How late actuators and tyres answer in the simulation: found before what else it has beyond the nominal model.

A lag is no function of the state, and its derivative stands for it only where it is short. A servo of 35 ms doubles
the yaw moment that a model car seems to need. What a discrepancy of functions misses of that, it makes up for by
weaker forces, since the rate of steering goes with the yaw acceleration in most driving. Another yaw inertia then
comes out too small. So lags are found first, by least squares beside the functions.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.effects.late import BuildsUp
from split_cli.vehicle.effects.search import Course

_LATE = tuple(kind for kind in CATALOGUE.values() if issubclass(kind, BuildsUp) and kind.discrepancy)
_BEGIN = 0.03
"""Where the search begins, in units of `Term.sizes` [1]: a servo's 30 ms in a full-size car; decides time alone."""


def lags_of_simulation(simulated: Sequence[Evidence], discrepancy: SharedDiscrepancy) -> tuple[Term, ...]:
    """Return the lags with which simulations are explained best, beside a discrepancy without any.

    Parameters
    ----------
    simulated : sequence of Evidence
        At least one, whitened with `discrepancy`.
    """
    vehicle = discrepancy.vehicle
    course = Course(max(float(simulated[0].series.t[-1]), 1.0), float(simulated[0].series.s.max()))
    most = [kind.search(vehicle, course).times(kind.sizes(vehicle)).ranges[kind.slow].upper for kind in _LATE]
    unit = np.array([kind.sizes(vehicle)[kind.slow] for kind in _LATE])
    # Those that are late themselves would take what is searched for.
    beside = discrepancy.of_the_moment()
    columns = _stacked(simulated, [one.discrepancy[:, :, beside] for one in simulated])
    inverse = np.linalg.solve(columns.T @ columns + np.eye(columns.shape[1]), columns.T)

    def left(values: np.ndarray) -> np.ndarray:
        terms = _terms(values * unit)
        rows = _stacked(simulated, [replace(one, lags=terms).rows(()) for one in simulated])
        weights = inverse @ rows
        return np.concatenate([rows - columns @ weights, weights])

    found = least_squares(left, np.full(len(_LATE), _BEGIN), bounds=(0.0, np.array(most) / unit), diff_step=0.01)
    return _terms(found.x * unit)


def _terms(values: np.ndarray) -> tuple[Term, ...]:
    return tuple(kind({kind.slow: float(value)}) for kind, value in zip(_LATE, values, strict=True))


def _stacked(simulated: Sequence[Evidence], rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return rows (G, 3, ...) of all simulations, weighted as robustly as they are believed, shape (R, ...)."""
    weighted = [
        np.reshape(one.weight, (-1, *(1,) * (part.ndim - 1))) * part for one, part in zip(simulated, rows, strict=True)
    ]
    return np.concatenate([part.reshape(-1, *part.shape[2:]) for part in weighted])
