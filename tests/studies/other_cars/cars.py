"""What the study knows of its cars by name: parameters, equations, size, driver's abilities, sensors."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.studies.other_cars import model_car, sports_car, van
from tests.studies.other_cars.model_car import ModelCar
from tests.studies.other_cars.sports_car import SportsCar
from tests.studies.other_cars.van import Van

Car = SportsCar | Van | ModelCar

#: Relative standard deviation by which a pair's car differs from the printed one [1], and what differs.
_SPREAD = 0.06
_VARIED = (
    "mass yaw_inertia height grip stiffness_front stiffness_rear relaxation steer_lag torque_lag drag rolling".split()
)


@dataclass(frozen=True)
class CarKind:
    """One of the cars, and what the study has to know of its size.

    Attributes
    ----------
    noise : dict of str to float
        Standard deviation of each recorded channel in a sample [SI unit of the channel].
    speeds : tuple of float
        Slowest and fastest driving [m/s].
    torques : tuple of float
        Largest driving and braking torque [N m].
    room : float
        Mean radius of a course [m].
    control, periods : float, tuple of float
        Period of the driver's commands, and of recordings, one of which is drawn [s].
    commands_are_logged : bool
        Whether steering and torque are logged as commands that are held over a sample; else as measurements.
    """

    name: str
    base: Car
    start: Callable[[Any, float, tuple[float, float, float]], list[float]]
    gradient: Callable[[Any], float]
    step: float
    noise: dict[str, float]
    speeds: tuple[float, float]
    torques: tuple[float, float]
    room: float
    control: float
    periods: tuple[float, ...]
    commands_are_logged: bool
    # Entries of the state that are speeds of wheels.
    spinning: slice

    def varied(self, rng: np.random.Generator) -> Car:
        """Return a car like the printed one whose parameters differ by some per cent."""
        changes = {name: getattr(self.base, name) * float(np.exp(_SPREAD * rng.standard_normal())) for name in _VARIED}
        return self.base._replace(**changes)


_ROAD_NOISE = {
    **{"vx": 0.015, "vy": 0.015, "r": 0.003, "ax": 0.08, "ay": 0.08, "X": 0.02, "Y": 0.02, "yaw": 0.001},
    **{"delta": 0.0004, "T": 6.0},
}
KINDS: dict[str, CarKind] = {
    "sports car": CarKind(
        name="sports car",
        base=SportsCar(),
        start=sports_car.at_rest_of_turning,
        gradient=sports_car.understeer_gradient,
        step=sports_car.STEP,
        noise=_ROAD_NOISE,
        speeds=(8.0, 34.0),
        torques=(2600.0, 5500.0),
        room=90.0,
        control=0.005,
        periods=(0.01, 0.02),
        commands_are_logged=False,
        spinning=slice(6, 10),
    ),
    "van": CarKind(
        name="van",
        base=Van(),
        start=van.at_rest_of_turning,
        gradient=van.understeer_gradient,
        step=van.STEP,
        noise=_ROAD_NOISE | {"vx": 0.018, "T": 8.0},
        speeds=(7.5, 25.0),
        torques=(2400.0, 6500.0),
        room=80.0,
        control=0.02,
        periods=(0.02,),
        commands_are_logged=True,
        spinning=slice(0),
    ),
    "model car": CarKind(
        name="model car",
        base=ModelCar(),
        start=model_car.at_rest_of_turning,
        gradient=model_car.understeer_gradient,
        step=model_car.STEP,
        noise={
            **{"vx": 0.012, "vy": 0.010, "r": 0.02, "ax": 0.12, "ay": 0.12, "X": 0.003, "Y": 0.003, "yaw": 0.003},
            **{"delta": 0.0, "T": 0.0},
        },
        speeds=(2.0, 5.5),
        torques=(0.45, 0.6),
        room=3.2,
        control=0.01,
        periods=(0.01,),
        commands_are_logged=True,
        spinning=slice(6, 9),
    ),
}
