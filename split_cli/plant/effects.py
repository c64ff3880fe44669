"""Named changes of a car, its surroundings or its instruments, as ``NAME:parameter=value,...`` tells them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from split_cli.errors import SplitError, nearest_names
from split_cli.plant.cars import CarParameters
from split_cli.plant.faults import Faults
from split_cli.plant.road import Road
from split_cli.plant.sensors import SensorSpec
from split_cli.plant.tire import TireParameters
from split_cli.signals import STANDARD_GRAVITY

_PLACES = 512


@dataclass(frozen=True)
class Setting:
    """Everything an effect may change."""

    car: CarParameters
    road: Road
    faults: Faults
    sensors: tuple[SensorSpec, ...]
    lap_length: float = 0.0  # of the track's centreline; 0 without a track [m]


@dataclass(frozen=True)
class Bounds:
    """Unit and range of a parameter; `default` is taken when it is left out, None makes it required."""

    unit: str
    lower: float
    upper: float
    default: float | None = None


_Apply = Callable[[Setting, Mapping[str, float]], Setting]
"""(setting, values) -> setting with the effect."""
_Change = Callable[[CarParameters, Mapping[str, float]], float]
"""(car, values) -> value of a field."""


@dataclass(frozen=True)
class EffectKind:
    """An effect that can be asked for."""

    about: str  # what the car, road or sensors then have
    parameters: Mapping[str, Bounds]
    apply: _Apply


@dataclass(frozen=True)
class Effect:
    """One effect with its values."""

    name: str
    values: Mapping[str, float]  # SI

    @property
    def text(self) -> str:
        """The effect as one would type it."""
        return f"{self.name}:" + ",".join(f"{name}={value:g}" for name, value in self.values.items())


def parse_effect(text: str) -> Effect:
    """Return the effect of ``NAME:parameter=value,...``.

    Raises
    ------
    SplitError
        If the name or a parameter is unknown, missing, no number or beyond what the plant can do.
    """
    name, _, rest = text.partition(":")
    where = f"--effect {text}"
    if name not in EFFECTS:
        advice = f"{nearest_names(name, EFFECTS)} All: {', '.join(EFFECTS)}."
        raise SplitError(f"no effect is called {name!r}", where=where, advice=advice)
    known = EFFECTS[name].parameters
    usage = "Write " + name + ":" + ",".join(f"{p}=VALUE" for p in known) + "."
    values: dict[str, float] = {}
    for part in filter(None, rest.split(",")):
        parameter, _, value = part.partition("=")
        if parameter not in known:
            raise SplitError(f"{name} has no parameter {parameter!r}", where=where, advice=usage)
        try:
            values[parameter] = float(value)
        except ValueError:
            raise SplitError(f"{parameter} is no number: {value!r}", where=where, advice=usage) from None
    for parameter, limits in known.items():
        if parameter not in values:
            if limits.default is None:
                raise SplitError(f"{name} lacks {parameter}", where=where, advice=usage)
            values[parameter] = limits.default
        if not limits.lower <= values[parameter] <= limits.upper:
            raise SplitError(
                f"{parameter} must lie between {limits.lower:g} and {limits.upper:g} {limits.unit}, "
                f"got {values[parameter]:g}",
                where=where,
            )
    return Effect(name, {parameter: values[parameter] for parameter in known})


def apply_effects(setting: Setting, effects: tuple[Effect, ...]) -> Setting:
    """Return a setting with effects, in the order given.

    Raises
    ------
    SplitError
        If an effect has a place and there is no track.
    """
    for effect in effects:
        setting = EFFECTS[effect.name].apply(setting, effect.values)
    return setting


def _changed(part: str, fixed: Mapping[str, bool], change: Mapping[str, _Change]) -> _Apply:
    """Return an `apply` that replaces fields of a part of the setting."""

    def apply(setting: Setting, v: Mapping[str, float]) -> Setting:
        changed = {name: value(setting.car, v) for name, value in change.items()}
        return replace(setting, **{part: replace(getattr(setting, part), **fixed, **changed)})

    return apply


def _car(**change: _Change) -> _Apply:
    return _changed("car", {}, change)


def _fault(**change: _Change) -> _Apply:
    return _changed("faults", {"active": True}, change)


def _tires(change: Callable[[TireParameters, CarParameters, Mapping[str, float], str], TireParameters]) -> _Apply:
    """Return an `apply` that changes the tyres of both axles."""

    def apply(setting: Setting, v: Mapping[str, float]) -> Setting:
        car = setting.car
        front, rear = (change(getattr(car, f"{axle}_tire"), car, v, axle) for axle in ("front", "rear"))
        return replace(setting, car=replace(car, front_tire=front, rear_tire=rear))

    return apply


def _along_lap(setting: Setting, **tables: Callable[[np.ndarray], np.ndarray]) -> Setting:
    """Return the setting with tables over the lap; each takes its old values and the places s."""
    if setting.lap_length <= 0.0:
        raise SplitError("an effect with a place needs a track", where="--effect", advice="Add --track.")
    s = np.arange(_PLACES) * setting.lap_length / _PLACES
    road = setting.road
    old = {name: np.broadcast_to(getattr(road, name), _PLACES).copy() for name in ("friction", "grade", "bank")}
    new = {name: change(old[name], s) for name, change in tables.items()}
    return replace(setting, road=replace(road, spacing=setting.lap_length / _PLACES, closed=True, **{**old, **new}))


def _inside(s: np.ndarray, v: Mapping[str, float], lap: float) -> np.ndarray:
    """Return 1 from s_start to s_end, past the start line when s_start is the larger."""
    place, end = (s - v["s_start"]) % lap, (v["s_end"] - v["s_start"]) % lap or lap
    edge = lap / _PLACES
    return np.clip(np.minimum(place / edge + 1.0, (end - place) / edge + 0.5), 0.0, 1.0)


def _patch(setting: Setting, v: Mapping[str, float]) -> Setting:
    lap = setting.lap_length
    return _along_lap(setting, friction=lambda old, s: old * (1.0 + (v["scale"] - 1.0) * _inside(s, v, lap)))


def _incline(axis: str) -> _Apply:
    def apply(setting: Setting, v: Mapping[str, float]) -> Setting:
        waves = 2.0 * np.pi * v["waves"] / max(setting.lap_length, 1.0)
        return _along_lap(setting, **{axis: lambda old, s: old + v["amplitude"] * np.sin(waves * s + v["phase"])})

    return apply


def _grip(setting: Setting, v: Mapping[str, float]) -> Setting:
    return replace(setting, road=replace(setting.road, friction=setting.road.friction * v["scale"]))


def _fade(setting: Setting, v: Mapping[str, float]) -> Setting:
    clock = np.arange(0.0, 20.0 * v["tau"] + 1.0, min(0.5, 0.1 * v["tau"]))
    grip = 1.0 - v["final_loss"] * (1.0 - np.exp(-clock / v["tau"]))
    return replace(setting, road=replace(setting.road, time_spacing=float(clock[1]), grip=grip))


def _wind(setting: Setting, v: Mapping[str, float]) -> Setting:
    return replace(setting, road=replace(setting.road, wind_x=np.array([v["wx"]]), wind_y=np.array([v["wy"]])))


def _late(setting: Setting, v: Mapping[str, float]) -> Setting:
    def late(sensor: SensorSpec) -> SensorSpec:
        if sensor.is_command:
            return sensor
        channels = {name: replace(spec, delay=spec.delay + v["delay"]) for name, spec in sensor.channels.items()}
        return replace(sensor, channels=channels)

    return replace(setting, sensors=tuple(map(late, setting.sensors)))


def _turned(setting: Setting, v: Mapping[str, float]) -> Setting:
    turned = tuple(replace(s, turned=v["angle"]) if "vx" in s.channels else s for s in setting.sensors)
    return replace(setting, sensors=turned)


def _stiff(tire: TireParameters, car: CarParameters, v: Mapping[str, float], axle: str) -> TireParameters:
    return replace(tire, p_ky1=tire.p_ky1 * v[f"{axle}_scale"])


def _rolling(tire: TireParameters, car: CarParameters, v: Mapping[str, float], axle: str) -> TireParameters:
    return replace(tire, rolling_resistance=tire.rolling_resistance + v["force"] / (car.mass * STANDARD_GRAVITY))


def _scale(lower: float = 0.2, upper: float = 3.0) -> Bounds:
    return Bounds("", lower, upper)


_DELAY = {"delay": Bounds("s", 0.0, 0.5)}
# The plant's own step is 1 ms; a shorter time constant would make it stiff.
_LAG = {"tau": Bounds("s", 0.002, 1.0)}
_WAVE = {"amplitude": Bounds("rad", -0.3, 0.3), "waves": Bounds("", 1, 8, 1.0), "phase": Bounds("rad", -7, 7, 0.0)}
_PLACE = {"s_start": Bounds("m", 0.0, 1e5), "s_end": Bounds("m", 0.0, 1e5)}

EFFECTS: dict[str, EffectKind] = {
    "steer_offset": EffectKind(
        "the road wheels' zero is off",
        {"offset": Bounds("rad", -0.1, 0.1)},
        _car(steer_offset=lambda car, v: car.steer_offset + v["offset"]),
    ),
    "steer_gain": EffectKind(
        "the wheels turn by a share of the command",
        {"gain": _scale(0.3, 2.0)},
        _car(steer_gain=lambda car, v: car.steer_gain * v["gain"]),
    ),
    "steer_delay": EffectKind(
        "steering begins late", _DELAY, _car(steer_delay=lambda car, v: car.steer_delay + v["delay"])
    ),
    "steer_lag": EffectKind(
        "steering builds up with this time constant, instead of the car's own",
        _LAG,
        _car(steer_lag=lambda car, v: v["tau"]),
    ),
    "steer_backlash": EffectKind(
        "total play of the steering", {"width": Bounds("rad", 0.0, 0.2)}, _car(steer_backlash=lambda car, v: v["width"])
    ),
    "drive_gain": EffectKind(
        "driving and braking torque arrive scaled",
        {"drive_gain": Bounds("", 0.1, 2.0, 1.0), "brake_gain": Bounds("", 0.1, 2.0, 1.0)},
        _car(
            drive_gain=lambda car, v: car.drive_gain * v["drive_gain"],
            brake_gain=lambda car, v: car.brake_gain * v["brake_gain"],
        ),
    ),
    "drive_delay": EffectKind(
        "torque begins late", _DELAY, _car(drive_delay=lambda car, v: car.drive_delay + v["delay"])
    ),
    "drive_lag": EffectKind(
        "torque builds up with this time constant, instead of the car's own",
        _LAG,
        _car(drive_lag=lambda car, v: v["tau"]),
    ),
    "mass": EffectKind("a load at the CG", {"scale": _scale(0.5)}, _car(mass=lambda car, v: car.mass * v["scale"])),
    "yaw_inertia": EffectKind(
        "another yaw inertia", {"scale": _scale()}, _car(yaw_inertia=lambda car, v: car.yaw_inertia * v["scale"])
    ),
    "cg_shift": EffectKind(
        "the CG lies further forward",
        {"dx": Bounds("m", -1.0, 1.0)},
        _car(
            cg_to_front_axle=lambda car, v: car.cg_to_front_axle - v["dx"],
            cg_to_rear_axle=lambda car, v: car.cg_to_rear_axle + v["dx"],
        ),
    ),
    "load_transfer": EffectKind(
        "the CG's height, instead of the car's own",
        {"cg_height": Bounds("m", 0.0, 1.5)},
        _car(cg_height=lambda car, v: v["cg_height"]),
    ),
    "aero_drag": EffectKind(
        "added drag",
        {"drag": Bounds("N/(m/s)^2", -2.0, 10.0)},
        _car(drag_area=lambda car, v: max(car.drag_area + 2.0 * v["drag"] / car.air_density, 0.0)),
    ),
    "aero_downforce": EffectKind(
        "added load on the axles",
        {"front": Bounds("N/(m/s)^2", -2.0, 10.0), "rear": Bounds("N/(m/s)^2", -2.0, 10.0)},
        _car(
            downforce_area_front=lambda car, v: car.downforce_area_front + 2.0 * v["front"] / car.air_density,
            downforce_area_rear=lambda car, v: car.downforce_area_rear + 2.0 * v["rear"] / car.air_density,
        ),
    ),
    "yaw_moment_differential": EffectKind(
        "viscous torque between the rear wheels",
        {"locking": Bounds("N m s/rad", 0.0, 1e5)},
        _car(differential_locking_rear=lambda car, v: v["locking"]),
    ),
    "rolling_resistance": EffectKind("added rolling resistance", {"force": Bounds("N", -1e3, 1e4)}, _tires(_rolling)),
    "tire_stiffness": EffectKind(
        "cornering stiffness of the axles",
        {"front_scale": Bounds("", 0.3, 3.0, 1.0), "rear_scale": Bounds("", 0.3, 3.0, 1.0)},
        _tires(_stiff),
    ),
    "tire_relaxation": EffectKind(
        "distance over which lateral force builds up, instead of the tyre's own",
        {"length": Bounds("m", 0.002, 5.0)},
        _tires(lambda tire, car, v, axle: replace(tire, relaxation_lateral=v["length"])),
    ),
    "combined_slip": EffectKind(
        "how much longitudinal and lateral force take from each other, 1 in a sound tyre",
        {"strength": Bounds("", 0.0, 1.0)},
        _tires(lambda tire, car, v, axle: replace(tire, combined_slip=v["strength"])),
    ),
    "friction_scale": EffectKind("grip of the whole road", {"scale": _scale(0.2, 1.5)}, _grip),
    "friction_patch": EffectKind(
        "grip between two places of the centreline", {"scale": _scale(0.2, 1.5), **_PLACE}, _patch
    ),
    "grip_fade": EffectKind(
        "grip that drifts with time", {"final_loss": Bounds("", -0.5, 0.8), "tau": Bounds("s", 1.0, 1e4)}, _fade
    ),
    "road_grade": EffectKind("waves a lap of grade, uphill positive", _WAVE, _incline("grade")),
    "road_bank": EffectKind("waves a lap of bank, left side higher positive", _WAVE, _incline("bank")),
    "wind": EffectKind(
        "air that moves over the ground", {"wx": Bounds("m/s", -40, 40), "wy": Bounds("m/s", -40, 40)}, _wind
    ),
    "sensor_delay": EffectKind("every measured channel is late", _DELAY, _late),
    "sensor_misalignment": EffectKind(
        "the velocity sensor is turned counter-clockwise", {"angle": Bounds("rad", -0.3, 0.3)}, _turned
    ),
    "torque_bend": EffectKind(
        "not in the catalogue: driving torque T arrives as T (1 - bend T/T_max)",
        {"bend": Bounds("", 0.0, 0.95)},
        _fault(torque_bend=lambda car, v: v["bend"]),
    ),
    "torque_steer": EffectKind(
        "not in the catalogue: full driving torque turns the front wheels by this angle",
        {"angle": Bounds("rad", -0.2, 0.2)},
        _fault(torque_steer=lambda car, v: v["angle"]),
    ),
    "brake_fade": EffectKind(
        "not in the catalogue: brakes that lose this share of their torque when hot",
        {"loss": Bounds("", 0.0, 0.95)},
        _fault(
            brake_fade=lambda car, v: v["loss"],
            # About the energy of one stop from 18 m/s.
            brake_heat_capacity=lambda car, v: 0.5 * car.mass * 18.0**2 * car.wheelbase / 2.7,
        ),
    ),
}
"""What a drive can have that its simulation lacks; most share their name with a term of the diagnosis."""
