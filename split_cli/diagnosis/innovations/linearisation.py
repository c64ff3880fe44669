"""How a model's rates answer to small deviations of the velocities along a recording.

Models are evaluated at predicted states, and this linearisation leads from there to the measured ones. It so decides
how sensor noise enters the defects. Where lateral tyre forces build up over a distance, a deviation changes them late.
If their change were taken as immediate, predictions that contain noise would look wrong by a force that answers at
once. That shortens every relaxation length that is found, by half in a model car
(docs/decisions/0042-deviations-build-up.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from split_cli.diagnosis.recording.series import Series
from split_cli.vehicle.effects import CATALOGUE, Recording, Term, build_terms
from split_cli.vehicle.effects.recording import first_order_response
from split_cli.vehicle.integration import phi_matrix
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

_UNRESOLVED = 4.0
"""Sample period over the time in which forces build up, from which on they do so at once [1]. Judgement: within a
quarter of a sample. A lag that short cannot be told from the error of integration, which would feed on itself: a
nominal car's 6 mm became 21 mm in eight passes."""


_STEP = 1e-3
"""Half a step of a central difference, of v_x, v_y [m/s] or r [rad/s]: well below what bends a tyre's curve, and its
error of rounding is 1e-9 of the rates."""


@dataclass(frozen=True)
class Linearisation:
    """Velocity Jacobians of a model along a recording of N samples, and how late tyre forces follow.

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
    to_motion : ndarray of shape (N - 1, 3, 3), or None
        P: from rates in the middle of a sample, at the mean of its two ends, to the mean of rates over the sample [1],
        see `_to_motion`. None where both are taken as the same.
    by_steer : ndarray of shape (N, 3), or None
        b, derivative of the rates with respect to the steer angle [m/s^2 or rad/s^2, per rad]; None as `to_motion`.
    """

    jacobian: np.ndarray
    immediate: np.ndarray
    rate: np.ndarray | None
    recording: Recording
    to_motion: np.ndarray | None = None
    by_steer: np.ndarray | None = None

    def of_first_moment(self, moment: np.ndarray | None) -> np.ndarray | float:
        """Return the motion, shape (N - 1, 3), that a steer angle adds by its first moment (N,) [rad] in each sample.

        Notes
        -----
        h^2 A b q, with q of `Series.steer_first_moment`. The rates of a sample have the mean of its steer angle. What
        arrives early in the sample, with the same mean, has longer to act on the other velocities.
        """
        if moment is None or self._turned is None:
            return 0.0
        return self.recording.period**2 * moment[:-1, None] * self._turned

    @cached_property
    def _turned(self) -> np.ndarray | None:
        """A b of every transition, shape (N - 1, 3): each evaluation of a model asks for it."""
        return None if self.by_steer is None else _times(self.jacobian[:-1], self.by_steer[:-1])

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


def linearise(
    vehicle: Vehicle, series: Series, terms: Sequence[Term] = (), added: np.ndarray | float = 0.0
) -> Linearisation:
    """Return the linearisation of a model at the predicted states of a recording.

    Parameters
    ----------
    terms : sequence of Term
        What the model has beyond the vehicle file. Faults that correct channels count for nothing.
    added : ndarray, shape (N, 3, 3), optional
        Velocity Jacobians of what is added to the model's rates by lateral tyre forces [1/s], see `slopes`.

    Notes
    -----
    The Jacobian is taken at the commands that arrive: behind lags, delays and gains of the actuators.
    """
    relaxation = CATALOGUE["tire_relaxation"]
    model = [one for one in (*build_terms(vehicle), *terms) if one.moves_car and not one.corrects]
    acting = [one for one in model if one.acts_on_commands()]
    length = sum(one.parameters["length"] for one in model if isinstance(one, relaxation))
    rest = [one for one in model if not isinstance(one, relaxation) and one not in acting]
    at = (*series.predicted.T, *series.inputs(SingleTrack(vehicle, acting), series.predicted))
    where = {"yaw": series.yaw, "t": series.t, "s": series.s}
    jacobian = SingleTrack(vehicle, rest).velocity_jacobian(*at, **where) + added
    late = relaxation({"length": length})
    by_speed = late.fastest_rate(1.0)  # 0 for a length so short that forces build up at once
    rate = by_speed * np.abs(series.predicted[:, 0])
    if by_speed == 0.0 or np.median(rate) * series.period > _UNRESOLVED:
        if "delta" not in series.drive.held:
            return Linearisation(jacobian, jacobian, None, series.recording)
        over, by_steer = _to_motion(jacobian, series.period), _by_steer(SingleTrack(vehicle, rest), at, where)
        return Linearisation(jacobian, jacobian, None, series.recording, over, by_steer)
    slow = SingleTrack(vehicle, (*rest, late))
    held = {name: np.zeros(len(series)) for name in slow.state_names}
    immediate = slow.velocity_jacobian(*at, **where, states=held)
    return Linearisation(jacobian, immediate, rate, series.recording)


def slopes(rates_of: Callable[[Series], np.ndarray], series: Series) -> np.ndarray:
    """Return the velocity Jacobians of rates (N, 3) at the predicted states of a recording, shape (N, 3, 3) [1/s].

    By central differences; `rates_of` is called with the recording at other predicted states.
    """
    out = np.empty((len(series), 3, 3))
    for k, step in enumerate(_STEP * np.eye(3)):
        moved = (series.predicted + step, series.predicted - step)
        ahead, behind = (rates_of(replace(series, predicted=one)) for one in moved)
        out[:, :, k] = (ahead - behind) / (2.0 * _STEP)
    return out


def _to_motion(jacobian: np.ndarray, period: float) -> np.ndarray:
    """Return P of each transition, shape (N - 1, 3, 3), where inputs are held.

    Notes
    -----
    A linear model with held inputs moves by h phi_1(h A) f_0 over a sample, from rates f_0. At the mean of the ends of
    that motion its rates are (I + exp(h A))/2 f_0. So P = 2 (I + exp(h A))^-1 phi_1(h A), which is I - (h A)^2/12 up to
    fourth order.
    """
    mean = 0.5 * (jacobian[1:] + jacobian[:-1])
    phi, identity = phi_matrix(mean, period), np.eye(3)
    return np.linalg.solve(identity + 0.5 * period * mean @ phi, phi)


def _by_steer(model: SingleTrack, at: Sequence[np.ndarray], where: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return b, the derivative of the rates with respect to the steer angle, shape (N, 3), by central differences."""
    ahead, behind = (model.velocity_derivative(*at[:4], at[4] + step, **where) for step in (1e-6, -1e-6))
    return np.stack([(one - other) / 2e-6 for one, other in zip(ahead, behind, strict=True)], axis=-1)


def _times(jacobian: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", jacobian, deviation)
