"""The shared model discrepancy of a car with another mass, inertia or centre of gravity.

The discrepancy is learned as rates, but it stands for forces. The same forces accelerate a car with another mass or
inertia differently. If the rates were kept instead, a changed inertia would seem smaller than it is wherever the
discrepancy is as large as the nominal model's moments. With another centre of gravity the axles have other slip angles
at the same velocities, and their forces change with those.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from split_cli.vehicle.effects import Term, build_terms
from split_cli.vehicle.flow import AxleFlow, Flow
from split_cli.vehicle.operations import NUMPY
from split_cli.vehicle.parameters import Vehicle


def alters_body(term: Term) -> bool:
    """Return whether a term changes mass, inertia or the centre of gravity's place."""
    return type(term).body is not Term.body


def moved_axles(vehicle: Vehicle, terms: Sequence[Term]) -> Vehicle:
    """Return a vehicle with the axle positions that terms give it; the vehicle itself if none moves an axle."""
    moved = _body(vehicle, [term for term in terms if alters_body(term)])
    return with_cg_ahead(vehicle, vehicle.cg_to_front_axle - float(moved.l_f))


def moves_axles(vehicle: Vehicle, term: Term) -> bool:
    """Return whether a term changes the position of the CG between the axles, and so their slip angles."""
    return moved_axles(vehicle, [term]) is not vehicle


def with_cg_ahead(vehicle: Vehicle, ahead: float) -> Vehicle:
    """Return a vehicle whose CG lies further forward by `ahead` [m]; the vehicle itself at 0."""
    if not ahead:
        return vehicle
    l_f, l_r = vehicle.cg_to_front_axle - ahead, vehicle.cg_to_rear_axle + ahead
    return replace(vehicle, cg_to_front_axle=l_f, cg_to_rear_axle=l_r)


def at_another_body(rates: np.ndarray, vehicle: Vehicle, terms: Sequence[Term]) -> np.ndarray:
    """Return the rates, shape (N, 3), that the same forces cause with the mass and inertia that terms give a vehicle.

    Parameters
    ----------
    rates : ndarray, shape (N, 3)
        Of v_x, v_y [m/s^2] and r [rad/s^2], with the mass and inertia of the vehicle file and its effects.
    terms : sequence of Term
        Terms that change neither mass nor inertia are ignored. Axle positions are those of `vehicle`, see
        `moved_axles`.

    Notes
    -----
    m (v_x', v_y') = (F_x, F_f + F_r) and I_z r' = l_f F_f - l_r F_r. Where tyres follow the load, their lateral forces
    are scaled before, see `at_other_tires`. The force along the car is kept: most of it follows the torque.
    """
    altering = [term for term in terms if alters_body(term)]
    if not altering:
        return rates
    own = [term for term in build_terms(vehicle) if alters_body(term)]
    old, new = _body(vehicle, own), _body(vehicle, [*own, *altering])
    along = (old.mass + old.rotating_mass) / (new.mass + new.rotating_mass)
    return rates * np.array([along, old.mass / new.mass, old.yaw_inertia / new.yaw_inertia])


def _body(vehicle: Vehicle, terms: Sequence[Term]) -> Flow:
    """Return a `Flow` in which terms have set mass, inertia and axle positions, and nothing else is evaluated."""
    flow = Flow(
        ops=NUMPY,
        vehicle=vehicle,
        vx=0.0,
        vy=0.0,
        r=0.0,
        T=0.0,
        delta=0.0,
        yaw=0.0,
        t=0.0,
        s=0.0,
        mass=vehicle.mass,
        yaw_inertia=vehicle.yaw_inertia,
        l_f=vehicle.cg_to_front_axle,
        l_r=vehicle.cg_to_rear_axle,
        front=AxleFlow(0.0, 0.0, 0.0),
        rear=AxleFlow(0.0, 0.0, 0.0),
    )
    for term in terms:
        term.body(flow)
    return flow
