"""The drift model of the same package as reality: a single track with combined slip.

Its state is given the places of the multi-body car's, so that drivers, tests and faults serve both. Its tyres take
slip along and across together, loads follow the acceleration, each axle is one wheel with its own spin; nothing
rolls or pitches. Parameters are those of the multi-body car.
Source: Althoff and Wuersching, CommonRoad: Vehicle Models (2020), single-track drift model.
"""

import math
from dataclasses import replace

from split_cli.errors import SplitError
from tests.studies.multibody_car import MULTIBODY_STATE, MultiBody, load_car

_STATES = 29
_AT = MULTIBODY_STATE
_FRONT_SPIN, _REAR_SPIN = _AT.spins.start, _AT.spins.start + 2


def load_drift_car(number: int = 2) -> MultiBody:
    """Return the drift model of a car of the package, see `load_car`.

    Raises
    ------
    SplitError
        If the package is not installed.
    """
    car = load_car(number)
    try:
        from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std
    except ImportError as error:
        advice = "pip install -U 'split-cli[test]'"
        raise SplitError("this commonroad-vehicle-models has no drift model", advice=advice) from error

    def derivative(x, u, p) -> list[float]:
        """Return rates in the places of the multi-body car's state; the model's own are speed and slip angle."""
        speed, slip = math.hypot(x[_AT.vx], x[_AT.vy]), math.atan2(x[_AT.vy], x[_AT.vx])
        own = [x[_AT.X], x[_AT.Y], x[_AT.delta], speed, x[_AT.yaw], x[_AT.r], slip, x[_FRONT_SPIN], x[_REAR_SPIN]]
        rates = vehicle_dynamics_std(own, list(u), p)
        out = [0.0] * _STATES
        for place, rate in zip((_AT.X, _AT.Y, _AT.delta, _AT.yaw, _AT.r), (*rates[:3], *rates[4:6]), strict=True):
            out[place] = rate
        out[_AT.vx] = rates[3] * math.cos(slip) - speed * math.sin(slip) * rates[6]
        out[_AT.vy] = rates[3] * math.sin(slip) + speed * math.cos(slip) * rates[6]
        out[_FRONT_SPIN], out[_REAR_SPIN] = rates[7], rates[8]
        return out

    return replace(car, derivative=derivative, initial=_rolling)


def _rolling(start, p) -> list[float]:
    """Return the state of a car that rolls straight ahead: X, Y, steer angle, speed, yaw."""
    x = [0.0] * _STATES
    x[_AT.X], x[_AT.Y], x[_AT.delta], x[_AT.vx], x[_AT.yaw] = start[:5]
    x[_FRONT_SPIN] = x[_REAR_SPIN] = start[3] / p.R_w
    return x
