"""The shared model discrepancy of a car with other tyres, or on another road: its lateral forces scale with theirs.

The error of an axle's lateral force is learned at one grip, and is taken to be proportional to the force. With half the
grip it is half as large. If it were kept instead, a correction learned on rubber could be as large on ice as the force
of a whole axle, and it would hide a change of grip.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from split_cli.diagnosis.baseline.body import alters_body
from split_cli.diagnosis.recording.series import Series, extended_model
from split_cli.vehicle.compiled_operations import COMPILED
from split_cli.vehicle.effects import Term
from split_cli.vehicle.flow import AxleFlow
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import same_curve
from split_cli.vehicle.tire import lateral_force


def alters_tires(term: Term) -> bool:
    """Return whether a term changes the force curve of a tyre, but neither mass, inertia nor CG."""
    return type(term).tire is not Term.tire and not alters_body(term)


#: Forces of one curve over those of another, (N,) each [1], by the number of the force: 1 in front, 2 behind.
Ratios = Mapping[int, np.ndarray]


def tire_ratios(series: Series, vehicle: Vehicle, terms: Sequence[Term]) -> Ratios:
    """Return the ratios of lateral axle forces with and without terms; an axle with an unchanged curve is left out."""
    old, new = (series.flow(extended_model(vehicle, some)) for some in ((), terms))
    axles = {1: (old.front, new.front), 2: (old.rear, new.rear)}
    return {k: _ratio(*pair) for k, pair in axles.items() if not same_curve(*pair)}


def at_other_tires(
    rates: np.ndarray,
    series: Series,
    vehicle: Vehicle,
    terms: Sequence[Term],
    ratios_of: Callable[[Series, Vehicle, Sequence[Term]], Ratios] = tire_ratios,
) -> np.ndarray:
    """Return rates, shape (N, 3), whose lateral axle forces are scaled by the change of the tyres' curves.

    Parameters
    ----------
    rates : ndarray, shape (N, 3)
        Of v_x, v_y [m/s^2] and r [rad/s^2], in the middle of the samples of `series`.
    terms : sequence of Term
        Terms that change no tyre are ignored.
    ratios_of : callable
        Returns `tire_ratios`, perhaps from a cache: the ratios do not depend on the rates.

    Notes
    -----
    With (F_x, F_f, F_r) the forces that cause the rates, F_f and F_r become F_f g'/g and F_r g'/g. Here g is the curve
    D sin(C atan(B alpha)) of the axle at its slip angle, and g' the changed curve. This is exact if the whole curve is
    scaled. If only the peak is scaled, it is exact at small slip, where nothing changes, and at the limit. In between
    it approximates the similarity of curves (Pacejka 2012, section 4.2).
    """
    altering = [term for term in terms if alters_tires(term)]
    if not altering:
        return rates
    matrix = vehicle.force_matrix()
    forces = rates @ np.linalg.inv(matrix).T
    for k, ratio in ratios_of(series, vehicle, altering).items():
        forces[:, k] *= ratio
    return forces @ matrix.T


def _ratio(old: AxleFlow, new: AxleFlow) -> np.ndarray:
    """Return the ratio of the new to the old curve's force at the old slip angles, shape (N,) [1]."""
    slip = np.where(old.slip_angle == 0.0, 1e-9, old.slip_angle)  # at zero slip: the ratio of stiffnesses
    before, after = (lateral_force(one.B, one.C, one.D, slip, COMPILED) for one in (old, new))
    return after / before
