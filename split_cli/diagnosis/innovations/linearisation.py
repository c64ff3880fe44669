"""How the nominal model's rates answer to small deviations of the velocities along a recording.

Models are evaluated at predicted states, and this linearisation leads from there to the measured ones. It so decides
how sensor noise enters the defects. Where lateral tyre forces build up over a distance, a deviation changes them late.
If their change were taken as immediate, predictions that contain noise would look wrong by a force that answers at
once. That shortens every relaxation length that is found, by half in a model car
(docs/decisions/0042-deviations-build-up.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.recording.series import Series
from split_cli.vehicle.effects import CATALOGUE, Recording, Term, build_terms
from split_cli.vehicle.effects.recording import first_order_response
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

_UNRESOLVED = 4.0
"""Sample period over the time in which forces build up, from which on they do so at once [1]. Judgement: within a
quarter of a sample. A lag that short cannot be told from the error of integration, which would feed on itself: a
nominal car's 6 mm became 21 mm in eight passes."""


@dataclass(frozen=True)
class Linearisation:
    """Velocity Jacobians of the nominal model along a recording of N samples, and how late tyre forces follow.

    Attributes
    ----------
    jacobian : ndarray, shape (N, 3, 3)
        A, derivative of (v_x', v_y', r') with respect to (v_x, v_y, r) where tyre forces have built up [1/s].
    immediate : ndarray, shape (N, 3, 3)
        The part of A that does not pass through lateral tyre forces [1/s].
    rate : ndarray of shape (N,), or None
        Rate at which lateral tyre forces build up, v_x over the relaxation length [1/s]; None if they do at once.
    recording : Recording
        The time base.
    """

    jacobian: np.ndarray
    immediate: np.ndarray
    rate: np.ndarray | None
    recording: Recording

    def of_deviation(self, deviation: np.ndarray) -> np.ndarray:
        """Return the change of the rates, shape (N, 3), by deviations of the velocities, shape (N, 3).

        Notes
        -----
        A d, or A_0 d + F with the immediate part A_0 and F' = (v_x/length) ((A - A_0) d - F) where forces build up.
        """
        if self.rate is None:
            return _times(self.jacobian, deviation)
        forces = _times(self.jacobian - self.immediate, deviation)
        late = [first_order_response(column, self.rate, self.recording) for column in forces.T]
        return _times(self.immediate, deviation) + np.stack(late, axis=1)


def linearise(vehicle: Vehicle, series: Series, terms: Sequence[Term] = ()) -> Linearisation:
    """Return the linearisation of the nominal model at the predicted states of a recording.

    Parameters
    ----------
    terms : sequence of Term
        What the car has beyond its file. Of these only the relaxation length counts, besides that of the file.
    """
    relaxation = CATALOGUE["tire_relaxation"]
    own = build_terms(vehicle)
    length = sum(one.parameters["length"] for one in (*own, *terms) if isinstance(one, relaxation))
    rest = tuple(one for one in own if not isinstance(one, relaxation))
    at = (*series.predicted.T, series.torque, series.steer_angle)
    where = {"yaw": series.yaw, "t": series.t, "s": series.s}
    jacobian = SingleTrack(vehicle, rest).velocity_jacobian(*at, **where)
    late = relaxation({"length": length})
    by_speed = late.fastest_rate(1.0)  # 0 for a length so short that forces build up at once
    rate = by_speed * np.abs(series.predicted[:, 0])
    if by_speed == 0.0 or np.median(rate) * series.period > _UNRESOLVED:
        return Linearisation(jacobian, jacobian, None, series.recording)
    model = SingleTrack(vehicle, (*rest, late))
    held = {name: np.zeros(len(series)) for name in model.state_names}
    immediate = model.velocity_jacobian(*at, **where, states=held)
    return Linearisation(jacobian, immediate, rate, series.recording)


def _times(jacobian: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", jacobian, deviation)
