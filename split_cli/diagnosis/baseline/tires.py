"""The shared model discrepancy of a car on other tyres, or on another road: it follows the tyres' curves.

What a single track lacks of an axle's lateral force was learned on one tyre. Were it left as it is, the correction
that a drive on rubber taught would be as large on ice as the force of the whole axle, and would take from a grip
what that should explain. Softer tyres slip further at the same force. Were it taken at the slips that they have, a
correction by powers of the slip would be asked for where no simulation has been.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.baseline.body import alters_body
from split_cli.diagnosis.recording.series import Series, extended_model
from split_cli.vehicle.effects import Term
from split_cli.vehicle.flow import AxleFlow
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import lateral_force

__all__ = ["OtherTires", "alters_tires", "on_other_tires"]


def alters_tires(term: Term) -> bool:
    """Return whether a term changes the curve of a tyre, and nothing of the body that stands on it."""
    return type(term).tire is not Term.tire and not alters_body(term)


@dataclass(frozen=True)
class OtherTires:
    """Where on the curves of the vehicle's axles those of altered tyres are, sample by sample.

    Attributes
    ----------
    slip : ndarray, shape (2, N)
        B'/B of the front and the rear axle [1]: by it the slip angle is multiplied.
    force : ndarray, shape (2, N)
        Lateral force of the altered curve over that of the vehicle's at this slip angle [1]; D'/D with C as it is.

    Notes
    -----
    Similarity of tyre curves (Pacejka 2012, section 4.3.1): with the same C, D' sin(C atan(B' alpha)) is D'/D
    times the vehicle's curve at B' alpha/B. What an axle lacks of its force is taken at the same point of the
    curve, and is the same share of it.
    """

    slip: np.ndarray
    force: np.ndarray


def on_other_tires(series: Series, vehicle: Vehicle, terms: Sequence[Term]) -> OtherTires | None:
    """Return where a vehicle's axles are on their curves with the tyres that terms make of its own.

    Parameters
    ----------
    series : Series
    vehicle : Vehicle
    terms : sequence of Term
        Those that alter no tyre are passed over.

    Returns
    -------
    OtherTires or None
        None where none alters a tyre.
    """
    altering = [term for term in terms if alters_tires(term)]
    if not altering:
        return None
    old, new = (series.flow(extended_model(vehicle, some)) for some in ((), altering))
    axles = [_of_axle(*pair, len(series)) for pair in ((old.front, new.front), (old.rear, new.rear))]
    slip, force = (np.stack(several) for several in zip(*axles, strict=True))
    return OtherTires(slip, force)


def _of_axle(old: AxleFlow, new: AxleFlow, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Return B'/B and the ratio of the forces there, (length,) each."""
    further = new.B / old.B
    slip = np.where(old.slip_angle == 0.0, 1e-9, old.slip_angle)  # without slip it is that of the stiffnesses
    before = lateral_force(old.B, old.C, old.D, further * slip)
    after = lateral_force(new.B, new.C, new.D, slip)
    return np.broadcast_to(further, length), np.broadcast_to(after / before, length)
