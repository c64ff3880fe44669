"""Effects that are put in: changes of parameters of a car or its sensors, with catalogue names and true values."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tests.studies.other_cars.cars import Car, CarKind
from tests.studies.other_cars.course import ClosedCourse
from tests.studies.other_cars.recording import SensorFaults


@dataclass(frozen=True)
class PlantedEffect:
    """One effect of one size.

    Attributes
    ----------
    name : str
        Of `EFFECTS` or `STRANGE`.
    term : str
        Name in the catalogue (docs/catalogue.md), empty for a strange effect.
    values : dict of str to float
        True values of the term's parameters; those that have none, such as a differential's damping, are left out.
    scaled, added, sensors : dict of str to float
        Factors of parameters of the car, and what is added to others; what is added to those of the sensors.
    """

    name: str
    term: str
    values: dict[str, float] = field(default_factory=dict)
    scaled: dict[str, float] = field(default_factory=dict)
    added: dict[str, float] = field(default_factory=dict)
    sensors: dict[str, float] = field(default_factory=dict)

    @property
    def needs_position(self) -> bool:
        """Whether only a recorded position tells where it acts."""
        return self.term == "friction_patch"

    @property
    def moves_the_cg_by(self) -> float:
        """How far forward the CG is moved [m]."""
        return -self.added.get("front", 0.0)

    def on_car(self, car: Car) -> Car:
        """Return the car with the effect."""
        changes = {name: getattr(car, name) * factor for name, factor in self.scaled.items()}
        changes |= {name: getattr(car, name) + more for name, more in self.added.items()}
        return car._replace(**changes)

    def on_sensors(self, sensors: SensorFaults) -> SensorFaults:
        """Return the sensors with the effect."""
        return sensors._replace(**{name: getattr(sensors, name) + more for name, more in self.sensors.items()})


Drawn = Callable[[np.random.Generator, CarKind, Car, ClosedCourse], PlantedEffect]


def _either(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a size between two, of either sign."""
    return float(rng.uniform(low, high) * rng.choice((-1.0, 1.0)))


def _length(car: Car) -> float:
    return car.front + car.rear


def _pace(kind: CarKind) -> float:
    """Return the time scale of a car's size over that of a road car [1]."""
    return float(np.sqrt(_length(kind.base) / 2.7))


def _factor(name: str, term: str, parameter: str, fields: str, *ranges: tuple[float, float]) -> Drawn:
    """Return an effect that scales fields of the car by one factor, from one of several ranges."""

    def drawn(rng: np.random.Generator, kind: CarKind, car: Car, course: ClosedCourse) -> PlantedEffect:
        size = float(rng.uniform(*ranges[rng.integers(len(ranges))]))
        return PlantedEffect(name, term, {parameter: size}, scaled=dict.fromkeys(fields.split(), size))

    return drawn


def _time(name: str, term: str, parameter: str, changed: str, low: float, high: float) -> Drawn:
    """Return an effect that adds a time to a delay or a lag, in whole milliseconds; shorter in a small car [s]."""

    def drawn(rng: np.random.Generator, kind: CarKind, car: Car, course: ClosedCourse) -> PlantedEffect:
        size = round(float(rng.uniform(low, high)) * _pace(kind) ** 0.5, 3)
        # A servo of second order has no time constant of a first-order lag.
        is_servo = changed == "steer_lag" and "servo_rate" in car._fields
        return PlantedEffect(name, term, {} if is_servo else {parameter: size}, added={changed: size})

    return drawn


def _cg(rng, kind, car, course) -> PlantedEffect:
    dx = _either(rng, 0.02, 0.06) * _length(car)
    return PlantedEffect("CG moved", "cg_shift", {"dx": dx}, added={"front": -dx, "rear": dx})


def _cg_height(rng, kind, car, course) -> PlantedEffect:
    more = float(rng.uniform(0.15, 0.5)) * car.height
    return PlantedEffect("CG higher", "load_transfer", {"cg_height": more}, added={"height": more})


def _stiffness(rng, kind, car, course) -> PlantedEffect:
    sizes = {"front": 1.0, "rear": 1.0}
    for axle in (("front",), ("rear",), ("front", "rear"))[rng.integers(3)]:
        sizes[axle] = float(rng.uniform(0.72, 0.90) if rng.random() < 0.65 else rng.uniform(1.1, 1.3))
    values = {f"{axle}_scale": size for axle, size in sizes.items()}
    scaled = {f"stiffness_{axle}": size for axle, size in sizes.items()}
    return PlantedEffect("tyre stiffness", "tire_stiffness", values, scaled=scaled)


def _relaxation(rng, kind, car, course) -> PlantedEffect:
    more = float(rng.uniform(0.10, 0.22)) * _length(car)
    return PlantedEffect("longer relaxation", "tire_relaxation", {"length": more}, added={"relaxation": more})


def _steer_offset(rng, kind, car, course) -> PlantedEffect:
    size = _either(rng, 0.004, 0.014) / _pace(kind) ** 0.5
    return PlantedEffect("steering offset", "steer_offset", {"offset": size}, added={"steer_offset": size})


def _drive_gain(rng, kind, car, course) -> PlantedEffect:
    values = {"drive_gain": float(rng.uniform(0.75, 0.93)), "brake_gain": 1.0}
    return PlantedEffect("drive gain", "drive_gain", values, scaled=values)


def _brake_gain(rng, kind, car, course) -> PlantedEffect:
    values = {"drive_gain": 1.0, "brake_gain": float(rng.uniform(0.70, 0.90))}
    return PlantedEffect("brake gain", "drive_gain", values, scaled=values)


def _drag(rng, kind, car, course) -> PlantedEffect:
    more = float(rng.uniform(0.4, 1.3)) * car.drag
    return PlantedEffect("more drag", "aero_drag", {"drag": more}, added={"drag": more})


def _rolling(rng, kind, car, course) -> PlantedEffect:
    more = float(rng.uniform(0.7, 2.0)) * car.rolling
    return PlantedEffect("more rolling resistance", "rolling_resistance", {"force": more}, added={"rolling": more})


def _downforce(rng, kind, car, course) -> PlantedEffect:
    # Up to that of a racing car with wings; the model car's scaled by the square of its length.
    most = {"sports car": 1.5, "van": 1.2, "model car": 0.05}[kind.name]
    front, rear = (float(rng.uniform(0.2, 1.0)) * most for _ in range(2))
    values = {"front": front, "rear": rear}
    return PlantedEffect("downforce", "aero_downforce", values, added={"lift_front": front, "lift_rear": rear})


def _differential(rng, kind, car, course) -> PlantedEffect:
    # Slip makes of a coupling less damping than its own, so that the term's parameter has no true value.
    own = {"sports car": (120.0, 500.0), "van": (120.0, 500.0), "model car": (0.01, 0.08)}[kind.name]
    more = float(np.exp(rng.uniform(*np.log(own))))
    return PlantedEffect("stiffer differential", "yaw_moment_differential", added={"lock": more})


def _grade(rng, kind, car, course) -> PlantedEffect:
    size = _either(rng, 0.008, 0.03)
    return PlantedEffect("grade", "road_grade", {"angle": size}, added={"grade": size})


def _bank(rng, kind, car, course) -> PlantedEffect:
    size = _either(rng, 0.008, 0.03)
    return PlantedEffect("bank", "road_bank", {"angle": size}, added={"bank": size})


def _patch(rng, kind, car, course) -> PlantedEffect:
    size, share = float(rng.uniform(0.55, 0.82)), float(rng.uniform(0.15, 0.35))
    start = float(rng.uniform(0.0, 1.0 - share)) * course.length
    added = {"patch_start": start, "patch_end": start + share * course.length, "patch": size - 1.0}
    added["lap"] = course.length - car.lap
    return PlantedEffect("patch of grip", "friction_patch", {"scale": size}, added=added)


def _lever(rng, kind, car, course) -> PlantedEffect:
    size = _either(rng, 0.04, 0.15) * _length(car)
    return PlantedEffect("velocity sensor moved", "sensor_lever_arm", {"dx": size}, sensors={"lever": size})


def _sensor(name: str, term: str, parameter: str, changed: str, low: float, high: float, power: float = 0.0) -> Drawn:
    """Return a fault of the sensors of either sign, for a small car times its time scale to a power."""

    def drawn(rng: np.random.Generator, kind: CarKind, car: Car, course: ClosedCourse) -> PlantedEffect:
        size = _either(rng, low, high) * _pace(kind) ** power
        return PlantedEffect(name, term, {parameter: size}, sensors={changed: size})

    return drawn


def _late_yaw_rate(rng, kind, car, course) -> PlantedEffect:
    size = float(rng.uniform(0.015, 0.05))
    return PlantedEffect("yaw rate late", "channel_delay", {"r": size}, sensors={"yaw_rate_late": size})


def _speed_scale(rng, kind, car, course) -> PlantedEffect:
    size = 1.0 + _either(rng, 0.015, 0.05)
    return PlantedEffect("speed scaled", "speed_scale", {"scale": size}, sensors={"speed": size - 1.0})


_GRIP = ("friction_scale", "scale")
EFFECTS: dict[str, Drawn] = {
    "mass": _factor("mass", "mass", "scale", "mass", (1.08, 1.25), (0.84, 0.93)),
    "yaw inertia": _factor("yaw inertia", "yaw_inertia", "scale", "yaw_inertia", (1.15, 1.4), (0.72, 0.87)),
    "CG moved": _cg,
    "CG higher": _cg_height,
    "grip": _factor("grip", *_GRIP, "grip", (0.72, 0.92)),
    "front grip": _factor("front grip", *_GRIP, "grip_front", (0.75, 0.92)),
    "rear grip": _factor("rear grip", *_GRIP, "grip_rear", (0.80, 0.93)),
    "tyre stiffness": _stiffness,
    "longer relaxation": _relaxation,
    "steering late": _time("steering late", "steer_delay", "delay", "steer_delay", 0.015, 0.06),
    "steering lags": _time("steering lags", "steer_lag", "tau", "steer_lag", 0.02, 0.07),
    "steering gain": _factor("steering gain", "steer_gain", "gain", "steer_gain", (0.88, 0.97), (1.03, 1.12)),
    "steering offset": _steer_offset,
    "torque late": _time("torque late", "drive_delay", "delay", "torque_delay", 0.04, 0.15),
    "torque lags": _time("torque lags", "drive_lag", "tau", "torque_lag", 0.05, 0.20),
    "drive gain": _drive_gain,
    "brake gain": _brake_gain,
    "more drag": _drag,
    "more rolling resistance": _rolling,
    "downforce": _downforce,
    "stiffer differential": _differential,
    "grade": _grade,
    "bank": _bank,
    "patch of grip": _patch,
    "velocity sensor moved": _lever,
    "velocity sensor turned": _sensor("velocity sensor turned", "sensor_misalignment", "angle", "turned", 0.006, 0.02),
    "yaw rate late": _late_yaw_rate,
    "yaw rate biased": _sensor("yaw rate biased", "yaw_rate_bias", "r", "yaw_rate_bias", 0.004, 0.012, -1.0),
    "velocity biased": _sensor("velocity biased", "velocity_bias", "angle", "angle_bias", 0.006, 0.02),
    "speed scaled": _speed_scale,
}
"""By name, how each is drawn."""


def _hot_tyres(rng, kind, car, course) -> PlantedEffect:
    return PlantedEffect("tyres lose grip with heat", "", added={"heat_loss": float(rng.uniform(0.25, 0.5))})


def _gusts(rng, kind, car, course) -> PlantedEffect:
    size = float(rng.uniform(0.02, 0.06)) * car.mass * 9.81
    return PlantedEffect("gusts", "", added={"gust": size, "gust_phase": float(rng.uniform(0.0, 6.0))})


def _loose_load(rng, kind, car, course) -> PlantedEffect:
    return PlantedEffect("load sloshes", "", added={"loose_mass": float(rng.uniform(0.12, 0.3)) * car.mass})


STRANGE: dict[str, Drawn] = {"tyres lose grip with heat": _hot_tyres, "gusts": _gusts, "load sloshes": _loose_load}
"""Effects that the catalogue does not have, by name."""
_NOT_TOGETHER = (
    {"velocity sensor turned", "velocity biased"},  # a constant angle is both
    {"more rolling resistance", "grade"},  # a constant force is both
)


def may_join(effect: PlantedEffect, others: list[PlantedEffect]) -> bool:
    """Tell whether an effect may stand beside others: another term, and nothing that no drive could separate."""
    names = {effect.name, *(other.name for other in others)}
    return effect.term not in {other.term for other in others} and not any(pair <= names for pair in _NOT_TOGETHER)
