"""The shared model discrepancy of a car on other tyres, or on another road: its lateral forces grow with the peak.

What a single track lacks of an axle's lateral force was learned at one grip. On half the grip a tyre carries half
of it. Were it left as it is, the correction that a drive on rubber taught would be as large on ice as the force of
the whole axle, and would take from a grip what that should explain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.baseline.body import alters_body
from split_cli.diagnosis.recording.series import Series, extended_model
from split_cli.vehicle.effects import Term
from split_cli.vehicle.parameters import Vehicle

__all__ = ["alters_tires", "at_other_tires"]


def alters_tires(term: Term) -> bool:
    """Return whether a term changes the curve of a tyre, and nothing of the body that stands on it."""
    return type(term).tire is not Term.tire and not alters_body(term)


def at_other_tires(rates: np.ndarray, series: Series, vehicle: Vehicle, terms: Sequence[Term]) -> np.ndarray:
    """Return rates whose lateral axle forces are scaled as terms scale the peaks of the axles' tyres.

    Parameters
    ----------
    rates : ndarray, shape (N, 3)
        Of v_x, v_y [m/s^2] and r [rad/s^2], in the middle of the samples of `series`.
    series : Series
    vehicle : Vehicle
    terms : sequence of Term
        Those that alter no tyre are passed over.

    Notes
    -----
    With (F_x, F_f, F_r) the forces that make the rates, F_f and F_r become F_f D_f'/D_f and F_r D_r'/D_r. That is
    the similarity of tyre curves (Pacejka 2012, section 4.2) at equal slip: exact where a whole curve is scaled.
    Where the peak alone is, slip would scale as well; the learned forces level off beyond the slips they were
    learned at, and are taken where the car is.
    """
    altering = [term for term in terms if alters_tires(term)]
    if not altering:
        return rates
    old, new = (series.flow(extended_model(vehicle, some)) for some in ((), altering))
    grown = [(getattr(new, axle).D / getattr(old, axle).D, k) for k, axle in ((1, "front"), (2, "rear"))]
    matrix = vehicle.force_matrix()
    forces = rates @ np.linalg.inv(matrix).T
    for ratio, k in grown:
        forces[:, k] *= ratio
    return forces @ matrix.T
