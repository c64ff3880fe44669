"""The shared model discrepancy of a car with other tyres, or on another road: its lateral forces scale with theirs.

The error of an axle's lateral force is learned at one grip, and is taken to be proportional to the force. With half the
grip it is half as large. If it were kept instead, a correction learned on rubber could be as large on ice as the force
of a whole axle, and it would hide a change of grip. The same holds for tyres that follow the load of a heavier car.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from split_cli.diagnosis.recording.series import Series, extended_model
from split_cli.vehicle.compiled_operations import COMPILED
from split_cli.vehicle.effects import Term
from split_cli.vehicle.flow import AxleFlow, Flow
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import lateral_force


def alters_tires(term: Term) -> bool:
    """Return whether a term may change an axle's lateral force at the same slip angle.

    It changes the curve, as a mass does whose tyres follow the load. Or it acts on the force itself (`acts_on_force`).
    """
    return type(term).tire is not Term.tire or acts_on_force(term)


def acts_on_force(term: Term) -> bool:
    """Return whether a term changes lateral forces once computed: they build up late, or share the grip."""
    return term.through_tires and type(term).lateral is not Term.lateral


# Step between scaled slips at which the discrepancy is evaluated, of the logarithm of the scale [1]. Judgement, of
# computing time: with random weights interpolated rates err by two to four thousandths of the largest ones
# (tests/diagnosis/test_tires.py).
_SLIP_STEP = 0.1
# Logarithm of the largest scale of slips, and of the inverse of the smallest [1]. Judgement: at twenty times its slip a
# tyre slides, and at a twentieth it is linear. It bounds the evaluations where a wheel has next to no load.
_MOST_SCALED = 3.0

#: A factor [1] that is the same all along, or shape (N,).
Ratio = float | np.ndarray
#: A factor for each axle whose lateral force changes, by the number of the force: 1 in front, 2 behind.
Ratios = Mapping[int, Ratio]


@dataclass(frozen=True)
class Similarity:
    """How the curves of axles became others of the same shape: F'(alpha) = peak F(slip alpha).

    With F = D sin(C atan(B alpha)), `peak` is D'/D and `slip` is B'/B. Source: Pacejka (2012), section 4.2.
    """

    peak: Ratios
    slip: Ratios


def similarity(series: Series, vehicle: Vehicle, terms: Sequence[Term]) -> Similarity:
    """Return how terms change the curves of the axles along a recording; an axle with an unchanged one is left out."""
    changed = _changed_axles(series, vehicle, terms)
    return Similarity(
        {k: after.D / before.D for k, (before, after) in changed.items()},
        {k: after.B / before.B for k, (before, after) in changed.items()},
    )


def tire_ratios(series: Series, vehicle: Vehicle, terms: Sequence[Term]) -> Ratios:
    """Return the ratios of lateral axle forces with and without terms; an axle with an unchanged curve is left out.

    Both are at the slip angles of the car with the terms, which may move its axles.
    """
    return {k: _ratio(*pair) for k, pair in _changed_axles(series, vehicle, terms).items()}


def _changed_axles(series: Series, vehicle: Vehicle, terms: Sequence[Term]) -> Mapping[int, tuple[AxleFlow, AxleFlow]]:
    """Return the axles whose curve terms change along a recording, without and with the terms."""
    old, new = (series.flow(extended_model(vehicle, some)) for some in ((), terms))
    axles = {1: (old.front, new.front), 2: (old.rear, new.rear)}
    return {
        k: (before, after)
        for k, (before, after) in axles.items()
        if np.any(after.D != before.D) or np.any(after.B != before.B)
    }


@dataclass(frozen=True)
class AxleBalance:
    """Which forces cause rates along a recording: F_x of the car, and those across the front and the rear wheels [N].

    The front wheels' force has a part along the car where they are steered.
    """

    vehicle: Vehicle  # with the axles where the rates were evaluated
    steer_angle: np.ndarray  # (N,) [rad]

    def of_rates(self, rates: np.ndarray) -> np.ndarray:
        """Return the forces (N, 3) of rates (N, 3) of v_x, v_y [m/s^2] and r [rad/s^2]."""
        forces = rates @ np.linalg.inv(self.vehicle.force_matrix()).T
        across = forces[:, 1].copy()  # the front axle's, across the car
        forces[:, 0] += np.tan(self.steer_angle) * across
        forces[:, 1] = across / np.cos(self.steer_angle)
        return forces

    def to_rates(self, forces: np.ndarray) -> np.ndarray:
        """Return the rates (N, 3) that forces (N, 3) cause."""
        turned = forces.copy()
        turned[:, 0] -= np.sin(self.steer_angle) * forces[:, 1]
        turned[:, 1] *= np.cos(self.steer_angle)
        return turned @ self.vehicle.force_matrix().T


def at_other_tires(rates: np.ndarray, axles: AxleBalance, ratios: Ratios) -> np.ndarray:
    """Return rates, shape (N, 3), whose lateral axle forces are scaled by the change of the tyres' curves.

    Parameters
    ----------
    rates : ndarray, shape (N, 3)
        Of v_x, v_y [m/s^2] and r [rad/s^2], in the middle of the samples of a recording.
    axles : AxleBalance
    ratios : mapping of int to float or ndarray of shape (N,)
        Factors of the forces in front (1) and behind (2): `Similarity.peak` where the rates were evaluated at the slips
        that it has, else `tire_ratios`.

    Notes
    -----
    The factor g'/g of `tire_ratios` has the curve g = D sin(C atan(B alpha)) of the axle at its slip angle, and the
    changed curve g'. It is exact if the whole curve is scaled. If only the peak is scaled, it is exact at small slip,
    where nothing changes, and at the limit.
    """
    if not ratios:
        return rates
    forces = axles.of_rates(rates)
    for k, ratio in ratios.items():
        forces[:, k] *= ratio
    return axles.to_rates(forces)


def at_scaled_slips(rates_at: Callable[[float], np.ndarray], slips: Ratios, axles: AxleBalance) -> np.ndarray:
    """Return rates, shape (N, 3), whose lateral axle forces are those at scaled slip angles.

    Parameters
    ----------
    rates_at : callable
        ``rates_at(scale)`` returns the rates with the slip angles of both axles scaled.
    slips : mapping of int to float or ndarray of shape (N,)
        Factors of the slip angles in front (1) and behind (2) [1]; 1 for an axle that is left out.
    axles : AxleBalance

    Notes
    -----
    The force of each axle is interpolated between steps of its own factor, since the rates are smooth in it. That the
    other axle's slips are scaled alike is an approximation, of the small part of the force that depends on them.
    """
    if not slips:
        return rates_at(1.0)

    @cache
    def forces_at(step: float) -> np.ndarray:
        return axles.of_rates(rates_at(float(np.exp(_SLIP_STEP * step))))

    forces = forces_at(0.0).copy()
    for k, slip in slips.items():
        steps = np.clip(np.log(slip), -_MOST_SCALED, _MOST_SCALED) / _SLIP_STEP * np.ones(len(forces))
        below = np.floor(steps)
        share, force = steps - below, np.zeros(len(forces))
        for step in np.unique([below, np.ceil(steps)]):
            weight = np.where(below == step, 1.0 - share, np.where(below + 1.0 == step, share, 0.0))
            force += weight * forces_at(float(step))[:, k]
        forces[:, k] = force
    return axles.to_rates(forces)


def with_terms_on_forces(rates: np.ndarray, axles: AxleBalance, flow: Flow, terms: Sequence[Term]) -> np.ndarray:
    """Return rates, shape (N, 3), whose lateral axle forces are late, or share the grip, as the terms say.

    Parameters
    ----------
    rates, axles
        As in `at_other_tires`.
    flow : Flow
        The nominal model with all terms along the same recording.
    terms : sequence of Term
        Those with `acts_on_force`, in the order in which they act. All of them are linear in the force.
    """
    forces = axles.of_rates(rates)
    front, rear = (
        replace(axle, lateral_force=np.ascontiguousarray(force))
        for axle, force in ((flow.front, forces[:, 1]), (flow.rear, forces[:, 2]))
    )
    acted = replace(flow, rates={}, values={}, front=front, rear=rear)
    for term in terms:
        term.lateral(acted)
    return axles.to_rates(np.stack([forces[:, 0], acted.front.lateral_force, acted.rear.lateral_force], axis=1))


def _ratio(old: AxleFlow, new: AxleFlow) -> np.ndarray:
    """Return the ratio of the new to the old curve's force at the new slip angles, shape (N,) [1]."""
    slip = np.where(new.slip_angle == 0.0, 1e-9, new.slip_angle)  # at zero slip: the ratio of stiffnesses
    before, after = (lateral_force(one.B, one.C, one.D, slip, COMPILED) for one in (old, new))
    return after / before
