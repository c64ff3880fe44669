"""The shared model discrepancy of a car on other tyres, or on another road: its lateral forces grow with theirs.

What a single track lacks of an axle's lateral force was learned at one grip. On half the grip a tyre carries half
of it. Were it left as it is, the correction that a drive on rubber taught would be as large on ice as the force of
the whole axle, and would take from a grip what that should explain.
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
    """Return whether a term changes the curve of a tyre, and nothing of the body that stands on it."""
    return type(term).tire is not Term.tire and not alters_body(term)


#: Forces of one curve over those of another, (N,) each [1], by the number of the force: 1 in front, 2 behind.
Ratios = Mapping[int, np.ndarray]


def tire_ratios(series: Series, vehicle: Vehicle, terms: Sequence[Term]) -> Ratios:
    """Return by how much terms that alter tyres scale the lateral forces of the axles; none for an equal curve."""
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
    """Return rates whose lateral axle forces are scaled as terms scale those of the axles' tyres.

    Parameters
    ----------
    rates : ndarray, shape (N, 3)
        Of v_x, v_y [m/s^2] and r [rad/s^2], in the middle of the samples of `series`.
    terms : sequence of Term
        Those that alter no tyre are passed over.
    ratios_of : callable
        What returns `tire_ratios`, which serve other rates as well.

    Notes
    -----
    With (F_x, F_f, F_r) the forces that make the rates, F_f and F_r become F_f g'/g and F_r g'/g, where g is the
    curve D sin(C atan(B alpha)) of the axle at its slip angle. What is lacked is a share of the axle's force. That
    is exact where a whole curve is scaled. Where the peak alone is, it is exact for small slip, where nothing
    changes, and at the limit; in between it stands for the similarity of curves (Pacejka 2012, section 4.2).
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
    """Return the force of one curve over that of another at the slip angles of the other, (N,) [1]."""
    slip = np.where(old.slip_angle == 0.0, 1e-9, old.slip_angle)  # without slip it is that of the stiffnesses
    before, after = (lateral_force(one.B, one.C, one.D, slip, COMPILED) for one in (old, new))
    return after / before
