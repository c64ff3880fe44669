"""Known faults of the multi-body car: parameters of its own, forces from outside, or its recorded channels."""

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from split_cli.logs.drive import Drive
from split_cli.proof.injection import InjectedFault, inject, require_known
from tests.studies.multibody_car import MULTIBODY_STATE, MultiBody

_GRAVITY = 9.81  # the package's
_VX = MULTIBODY_STATE.vx
_LATERAL = (MULTIBODY_STATE.vy, 15, 20)  # lateral velocity of the body and of either axle
_DRAG = 6e-4  # [1/m], of the mass


@dataclass(frozen=True)
class MultiBodyFault:
    """A fault, what it is called, and how the car or its recording comes to have it."""

    name: str
    term: str = ""  # id of the catalogue that names it; empty for none or where the catalogue has no name for it
    # Car -> true values as ((name, value), ...), the first of which is reported.
    parameters: Callable[[MultiBody], tuple[tuple[str, float], ...]] = lambda car: ()
    alter: Callable[[MultiBody], MultiBody] = lambda car: car  # car -> car with the fault
    # Drive -> drive as faulty sensors or a faulty actuator would have recorded it.
    record: Callable[[Drive], Drive] = lambda drive: drive
    in_catalogue: bool = True  # whether there is nothing to name, or a name for it
    track: int = 0  # faults of one number are driven on one track


def _with(car: MultiBody, change: Callable[[SimpleNamespace], None]) -> MultiBody:
    parameters = deepcopy(car.parameters)
    change(parameters)
    return replace(car, parameters=parameters)


def _scaled(*paths: str, by: float) -> Callable[[MultiBody], MultiBody]:
    """Return an alteration that scales parameters; ``tire.x`` is one of the tyre's."""

    def change(p: SimpleNamespace) -> None:
        for path in paths:
            *owner, name = path.split(".")
            holder = p.tire if owner else p
            setattr(holder, name, by * getattr(holder, name))

    return lambda car: _with(car, change)


def _payload(share: float) -> Callable[[MultiBody], MultiBody]:
    def change(p: SimpleNamespace) -> None:
        extra = share * p.m
        p.m, p.m_s = p.m + extra, p.m_s + extra

    return lambda car: _with(car, change)


def _forward(dx: float) -> Callable[[MultiBody], MultiBody]:
    def change(p: SimpleNamespace) -> None:
        p.a, p.b = p.a - dx, p.b + dx

    return lambda car: _with(car, change)


def _pushed(along: Callable[[float], float] = lambda vx: 0.0, across: float = 0.0) -> Callable[[MultiBody], MultiBody]:
    """Return an alteration that adds accelerations from outside [m/s^2]; `along` takes v_x."""

    def alter(car: MultiBody) -> MultiBody:
        def derivative(x, u, p):
            rates = car.derivative(x, u, p)
            rates[_VX] += along(x[_VX])
            for k in _LATERAL:
                rates[k] += across
            return rates

        return replace(car, derivative=derivative)

    return alter


def _geared(drive: float, brake: float) -> Callable[[MultiBody], MultiBody]:
    """Return an alteration by which a share of what is asked for arrives."""

    def alter(car: MultiBody) -> MultiBody:
        def derivative(x, u, p):
            return car.derivative(x, [u[0], u[1] * (drive if u[1] > 0.0 else brake)], p)

        return replace(car, derivative=derivative)

    return alter


def _recorded(name: str, term: str, parameter: str, value: float) -> MultiBodyFault:
    parameters = ((parameter, value),)
    return MultiBodyFault(
        name, term, lambda car: parameters, record=lambda drive: inject(drive, InjectedFault(name, term, parameters))
    )


def _altered(name: str, term: str, alter, *parameters: tuple[str, float]) -> MultiBodyFault:
    return MultiBodyFault(name, term, lambda car: parameters, alter)


def _column(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Drive], Drive]:
    return lambda drive: replace(drive, columns={**drive.columns, name: change(drive[name])}, sha256="")


MULTIBODY_FAULTS: tuple[MultiBodyFault, ...] = (
    MultiBodyFault("none"),
    MultiBodyFault("none on another track", track=1),
    MultiBodyFault("none on a third track", track=2),
    _altered("payload", "mass", _payload(0.10), ("scale", 1.10)),
    _altered("less grip", "friction_scale", _scaled("tire.p_dx1", "tire.p_dy1", by=0.9), ("scale", 0.9)),
    _altered(
        "softer tyres", "tire_stiffness", _scaled("tire.p_ky1", by=0.88), ("front_scale", 0.88), ("rear_scale", 0.88)
    ),
    _altered("more yaw inertia", "yaw_inertia", _scaled("I_z", by=1.2), ("scale", 1.2)),
    _altered("mass ahead", "cg_shift", _forward(0.06), ("dx", 0.06)),
    _altered("weak torque", "drive_gain", _geared(0.9, 0.95), ("drive_gain", 0.9), ("brake_gain", 0.95)),
    MultiBodyFault(
        "drag", "aero_drag", lambda car: (("drag", _DRAG * car.mass),), _pushed(lambda vx: -_DRAG * vx * vx)
    ),
    MultiBodyFault(
        "resistance", "rolling_resistance", lambda car: (("force", 0.15 * car.mass),), _pushed(lambda vx: -0.15)
    ),
    _altered("bank", "road_bank", _pushed(across=0.35), ("angle", -float(np.arcsin(0.35 / _GRAVITY)))),
    _recorded("steering late", "steer_delay", "delay", 0.03),
    _recorded("steering scaled", "steer_gain", "gain", 0.95),
    _recorded("steering offset", "steer_offset", "offset", 0.006),
    _recorded("velocity rotated", "sensor_misalignment", "angle", 0.01),
    _recorded("velocity moved", "sensor_lever_arm", "dx", 0.3),
    _recorded("clocks shifted", "sensor_delay", "delay", 0.03),
    MultiBodyFault(
        "speed read 3 % high", "speed_scale", lambda car: (("scale", 1.03),), record=_column("vx", lambda vx: 1.03 * vx)
    ),
    MultiBodyFault("yaw rate bent", record=_column("r", lambda r: r * (1.0 + 0.1 * np.abs(r))), in_catalogue=False),
)
"""With the true values of their parameters; the last has no name in the catalogue."""


def multibody_faults(only: Sequence[str] | None = None) -> tuple[MultiBodyFault, ...]:
    """Return the faults of these names, or all.

    Raises
    ------
    SplitError
        If a name is no fault.
    """
    known = {fault.name: fault for fault in MULTIBODY_FAULTS}
    require_known(only or (), known)
    return tuple(known[name] for name in only) if only else MULTIBODY_FAULTS
