"""The shared model discrepancy of a car with another body: it was learned as rates, and consists of forces.

A car with a fifth more yaw inertia turns in a fifth slower under all moments, those included that no single track
has. Were these left as they are, a single track that misses as much as it holds would say that nothing changed.
Where the centre of gravity lies elsewhere, the axles slip otherwise at the same velocities, and a tyre's force is
that of its slip.
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
    """Return a vehicle with the axles where terms put them; itself where none moves one."""
    moved = _body(vehicle, [term for term in terms if alters_body(term)])
    return with_cg_ahead(vehicle, vehicle.cg_to_front_axle - float(moved.l_f))


def moves_axles(vehicle: Vehicle, term: Term) -> bool:
    """Return whether a term puts the axles elsewhere, by which these slip otherwise."""
    return moved_axles(vehicle, [term]) is not vehicle


def with_cg_ahead(vehicle: Vehicle, ahead: float) -> Vehicle:
    """Return a vehicle whose CG lies further ahead [m]; itself at 0."""
    if not ahead:
        return vehicle
    l_f, l_r = vehicle.cg_to_front_axle - ahead, vehicle.cg_to_rear_axle + ahead
    return replace(vehicle, cg_to_front_axle=l_f, cg_to_rear_axle=l_r)


def at_another_body(rates: np.ndarray, vehicle: Vehicle, terms: Sequence[Term]) -> np.ndarray:
    """Return rates that the same forces give the mass and the inertia that terms make of a vehicle's.

    Parameters
    ----------
    rates : ndarray, shape (N, 3)
        Of v_x, v_y [m/s^2] and r [rad/s^2], at the vehicle's own body, the effects of its file included.
    terms : sequence of Term
        Those that alter no body are passed over, and where axles lie is the vehicle's, see `moved_axles`.

    Notes
    -----
    m (v_x', v_y') = (F_x, F_f + F_r) and I_z r' = l_f F_f - l_r F_r. The forces stay where a variant lets the
    nominal ones follow the load, too: what a single track lacks is mostly of torque.
    """
    altering = [term for term in terms if alters_body(term)]
    if not altering:
        return rates
    own = [term for term in build_terms(vehicle) if alters_body(term)]
    old, new = _body(vehicle, own), _body(vehicle, [*own, *altering])
    along = (old.mass + old.rotating_mass) / (new.mass + new.rotating_mass)
    return rates * np.array([along, old.mass / new.mass, old.yaw_inertia / new.yaw_inertia])


def _body(vehicle: Vehicle, terms: Sequence[Term]) -> Flow:
    """Return a flow as far as the body."""
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
