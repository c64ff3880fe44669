"""How cases conceal each term of the catalogue in the plant: one shape drawn, one size found by effect over noise."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from split_cli.plant.cars import CarParameters
from split_cli.plant.tire import TireParameters
from split_cli.proof.world import ProofWorld, road_of
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.effects.body import inertia_range, least_mass

_PLACES = 512
_FASTEST = 6e-4  # time constant of an actuator of the plant that follows at once [s]


@dataclass(frozen=True)
class Concealed:
    """An effect with its shape drawn; only the size is open."""

    term: str  # id in the catalogue, or the kind of an effect outside it
    apply: Callable[[ProofWorld, float], ProofWorld]  # (world, size) -> world with the effect
    # start, most: a size to begin the search with, and the largest that makes sense.
    start: float
    most: float
    # (world without, size) -> physical values of the term's parameters; parameters it leaves out are effective and
    # fitted to paired runs.
    known: Callable[[ProofWorld, float], Mapping[str, float]] = lambda world, size: {}
    # world -> the world in which the effect's own quantity is absent.
    neutral: Callable[[ProofWorld], ProofWorld] = lambda world: world
    # Parameters that are given, not fitted: where a stretch lies, how long a wave is.
    shape: Mapping[str, float] = field(default_factory=dict)
    variant: str = ""  # of the term, with which effective parameters are fitted


def _car(world: ProofWorld, **changes: float) -> ProofWorld:
    return replace(world, car=replace(world.car, **changes))


def sensor_with(world: ProofWorld, **changes: float) -> ProofWorld:
    """Return a world whose sensor has other numbers."""
    return replace(world, sensor=replace(world.sensor, **changes))


def _tires(world: ProofWorld, change: Callable[[TireParameters], TireParameters]) -> ProofWorld:
    return _car(world, front_tire=change(world.car.front_tire), rear_tire=change(world.car.rear_tire))


def _pace(car: CarParameters) -> float:
    return float(np.sqrt(car.wheelbase / 2.7))


def _along(world: ProofWorld) -> np.ndarray:
    return np.arange(_PLACES) * world.track.length / _PLACES


def of_one_number(
    term: str,
    number: str,
    parameter: str,
    start: float,
    most: float,
    *,
    base: float = 0.0,
    least: float = 0.0,
    both_sides: bool = False,
    put: Callable[..., ProofWorld] = _car,
    **absent: float,
) -> Callable[[np.random.Generator, ProofWorld], Concealed]:
    """Return what draws an effect that is one number of the car, or of its sensor.

    Parameters
    ----------
    number, parameter : str
        Its name in the plant, and that of the term's parameter; empty for an effect outside the catalogue.
    base : float
        The parameter without the effect, to which the size is added; to a side that is drawn if it has two.
    least : float
        What the plant's number is more than the parameter [its unit]: the shortest time constant that it follows.
    absent : float
        Numbers of the world in which the effect's own quantity is absent.
    """

    def drawn(rng: np.random.Generator, world: ProofWorld) -> Concealed:
        sign = rng.choice((-1.0, 1.0)) if both_sides else 1.0
        return Concealed(
            term,
            lambda w, size: put(w, **{number: least + (base + sign * size)}),
            start,
            most,
            known=lambda w, size: {parameter: base + sign * size} if parameter else {},
            neutral=lambda w: put(w, **absent) if absent else w,
        )

    return drawn


def _combined_slip(rng, world):
    def strength(value):
        return lambda tire: replace(tire, combined_slip=value)

    return Concealed(
        "combined_slip", lambda w, size: _tires(w, strength(size)), 0.5, 1.0, neutral=lambda w: _tires(w, strength(0.0))
    )


def _friction_scale(rng, world):
    sign = rng.choice((-1.0, -1.0, 1.0))
    return Concealed(
        "friction_scale",
        lambda w, size: replace(w, road=replace(w.road, friction=np.array([1.0 + sign * size]))),
        0.15,
        0.6,
    )


def _stretch(rng, world: ProofWorld, least: float, most: float) -> tuple[float, float]:
    """Return start and end of a stretch about one of the track's sharper bends [m]."""
    track = world.track
    bend = np.abs(track.curvature)
    sharp = np.flatnonzero(bend > np.quantile(bend, 0.75))
    length = rng.uniform(least, most) * track.length
    middle = float(rng.choice(sharp)) * track.spacing
    # Away from the start line, so that a stretch does not depend on where a lap is said to begin.
    start = float(np.clip(middle - 0.5 * length, 0.03 * track.length, 0.97 * track.length - length))
    return start, start + length


def _inside(world: ProofWorld, start: float, end: float) -> np.ndarray:
    s = _along(world)
    edge = 0.003 * world.track.length
    return np.clip((s - start) / edge, 0.0, 1.0) * np.clip((end - s) / edge, 0.0, 1.0)


def _friction_patch(rng, world):
    start, end = _stretch(rng, world, 0.07, 0.16)
    return Concealed(
        "friction_patch",
        lambda w, size: replace(w, road=road_of(w.track, w.road, friction=1.0 - size * _inside(w, start, end))),
        0.3,
        0.8,
        shape={"s_start": start, "s_end": end},
    )


def _grip_fade(rng, world):
    tau = rng.uniform(15.0, 60.0)
    clock = np.arange(0.0, 1200.0, 0.5)

    def fade(w, size):
        return replace(w, road=replace(w.road, time_spacing=0.5, grip=1.0 - size * (1.0 - np.exp(-clock / tau))))

    return Concealed("grip_fade", fade, 0.25, 0.6, shape={"tau": tau})


def _tire_relaxation(rng, world):
    least = {"road_car": 0.027, "f1tenth_car": 0.004, "formula_car": 0.018}[world.car.name]

    def length(value):
        return lambda tire: replace(tire, relaxation_lateral=value)

    return Concealed(
        "tire_relaxation",
        lambda w, size: _tires(w, length(least + size)),
        0.2 * world.car.wheelbase / 2.7,
        3.0 * world.car.wheelbase / 2.7,
        neutral=lambda w: _tires(w, length(least)),
    )


def _load_transfer(rng, world):
    return Concealed(
        "load_transfer",
        lambda w, size: _car(w, pitch_transfer=size / w.car.cg_height),
        0.2 * world.car.wheelbase,
        0.45 * world.car.wheelbase,
        neutral=lambda w: _car(w, pitch_transfer=0.0),
    )


def _tire_stiffness(rng, world):
    which = rng.choice(("front", "rear", "both"))
    sign_front, sign_rear = rng.choice((-1.0, 1.0), 2)
    front = 0.0 if which == "rear" else sign_front
    rear = 0.0 if which == "front" else sign_rear * rng.uniform(0.4, 1.0)

    def stiff(w, size):
        tires = {}
        for axle, direction in (("front_tire", front), ("rear_tire", rear)):
            tire = getattr(w.car, axle)
            tires[axle] = replace(tire, p_ky1=tire.p_ky1 * float(np.exp(direction * size)))
        return _car(w, **tires)

    return Concealed("tire_stiffness", stiff, 0.12, 0.5)


def _aero_downforce(rng, world):
    sign = rng.choice((-1.0, 1.0, 1.0))
    share = rng.uniform(0.2, 0.8)

    def lift(w, size):
        area = 2.0 * sign * size / w.car.air_density
        return _car(
            w,
            downforce_area_front=w.car.downforce_area_front + share * area,
            downforce_area_rear=w.car.downforce_area_rear + (1.0 - share) * area,
        )

    # A size at which the load at a brisk speed has changed by a tenth; at most what an axle of a car can have.
    unit = 0.1 * world.car.mass * STANDARD_GRAVITY / (20.0 * _pace(world.car)) ** 2
    return Concealed("aero_downforce", lift, unit, 5.0 * unit if sign > 0 else 2.5 * unit)


def _aero_drag(rng, world):
    unit = 0.5 * world.car.air_density * world.car.drag_area
    return Concealed(
        "aero_drag",
        lambda w, size: _car(w, drag_area=w.car.drag_area + 2.0 * size / w.car.air_density),
        0.3 * unit,
        6.0 * unit,
        known=lambda w, size: {"drag": size},
    )


def _profile(rng, world: ProofWorld) -> tuple[str, np.ndarray, dict[str, float]]:
    """Return variant, shape (512,) along the lap with greatest value 1, and the parameters that are given."""
    if rng.random() < 0.5:
        waves, phase = int(rng.integers(1, 4)), rng.uniform(0.0, 2.0 * np.pi)
        given = {"wavelength": world.track.length / waves, "phase": phase}
        return "wave", np.sin(2.0 * np.pi * waves * np.arange(_PLACES) / _PLACES + phase), given
    start, end = _stretch(rng, world, 0.15, 0.35)
    return "stretch", _inside(world, start, end), {"s_start": start, "s_end": end}


def _inclined(term: str, road: str, sign: float, variant: str, profile: np.ndarray, given: dict[str, float]):
    name = "amplitude" if variant == "wave" else "angle"
    return Concealed(
        term,
        lambda w, size: replace(w, road=road_of(w.track, w.road, **{road: sign * size * profile})),
        0.02,
        0.2,
        known=lambda w, size: {name: sign * size},
        shape=given,
        variant=variant,
    )


def _road_grade(rng, world):
    profile = _profile(rng, world)
    return _inclined("road_grade", "grade", rng.choice((-1.0, 1.0)), *profile)


def _road_bank(rng, world):
    sign = rng.choice((-1.0, 1.0))
    everywhere = ("", np.ones(_PLACES), {})
    return _inclined("road_bank", "bank", sign, *(everywhere if rng.random() < 0.4 else _profile(rng, world)))


def _wind(rng, world):
    direction = rng.uniform(0.0, 2.0 * np.pi)
    x, y = float(np.cos(direction)), float(np.sin(direction))
    side = world.car.drag_area * 2.5

    def blow(w, size):
        return replace(w, road=replace(w.road, wind_x=np.array([x * size]), wind_y=np.array([y * size])))

    return Concealed(
        "wind",
        blow,
        6.0 * _pace(world.car),
        25.0 * _pace(world.car),
        known=lambda w, size: {"wx": x * size, "wy": y * size},
        neutral=lambda w: _car(w, side_area=side),
        variant="side",
    )


def _drive_gain(rng, world):
    drive, brake = rng.choice((-1.0, 0.0, 1.0)), rng.choice((-1.0, 1.0))

    def gains(size):
        return {"drive_gain": 1.0 + drive * size, "brake_gain": 1.0 + brake * size}

    return Concealed("drive_gain", lambda w, size: _car(w, **gains(size)), 0.1, 0.5, known=lambda w, size: gains(size))


def _rolling_resistance(rng, world):
    def roll(w, size):
        return _tires(w, lambda tire: replace(tire, rolling_resistance=tire.rolling_resistance + size))

    return Concealed("rolling_resistance", roll, 0.01, 0.15)


def _yaw_moment_differential(rng, world):
    car = world.car
    # A viscous lock of this size carries the torque that a tyre would pass at a twentieth of slip.
    unit = 0.05 * car.static_load_rear * car.wheel_radius / (20.0 * _pace(car) / car.wheel_radius) * 20.0
    return Concealed(
        "yaw_moment_differential",
        lambda w, size: _car(w, differential_locking_rear=size),
        unit,
        300.0 * unit,
        neutral=lambda w: _car(w, differential_locking_rear=0.0),
    )


def _mass(rng, world):
    sign = rng.choice((-1.0, 1.0, 1.0))
    most = 0.4 if sign > 0.0 else 0.95 * (1.0 - least_mass(world.car))
    return Concealed(
        "mass",
        lambda w, size: _car(w, mass=w.car.mass * (1.0 + sign * size)),
        0.08,
        most,
        known=lambda w, size: {"scale": 1.0 + sign * size},
    )


def _yaw_inertia(rng, world):
    sign = rng.choice((-1.0, 1.0))
    lower, upper = inertia_range(world.car)
    return Concealed(
        "yaw_inertia",
        lambda w, size: _car(w, yaw_inertia=w.car.yaw_inertia * float(np.exp(sign * size))),
        0.2,
        0.95 * float(np.log(upper) if sign > 0.0 else -np.log(lower)),
        known=lambda w, size: {"scale": float(np.exp(sign * size))},
    )


def _cg_shift(rng, world):
    sign = rng.choice((-1.0, 1.0))

    def shift(w, size):
        dx = sign * size
        return _car(w, cg_to_front_axle=w.car.cg_to_front_axle - dx, cg_to_rear_axle=w.car.cg_to_rear_axle + dx)

    length = world.car.wheelbase
    return Concealed("cg_shift", shift, 0.03 * length, 0.15 * length, known=lambda w, size: {"dx": sign * size})


def _sensor_lever_arm(rng, world):
    sign = rng.choice((-1.0, 1.0))
    return Concealed(
        "sensor_lever_arm",
        lambda w, size: sensor_with(w, dx=sign * size),
        0.1 * world.car.wheelbase,
        1.5 * world.car.wheelbase,
        known=lambda w, size: {"dx": sign * size},
    )


CONCEALED: dict[str, Callable[[np.random.Generator, ProofWorld], Concealed]] = {
    "combined_slip": _combined_slip,
    "friction_scale": _friction_scale,
    "friction_patch": _friction_patch,
    "grip_fade": _grip_fade,
    "tire_relaxation": _tire_relaxation,
    "load_transfer": _load_transfer,
    "tire_stiffness": _tire_stiffness,
    "aero_downforce": _aero_downforce,
    "aero_drag": _aero_drag,
    "road_grade": _road_grade,
    "road_bank": _road_bank,
    "wind": _wind,
    "drive_gain": _drive_gain,
    "drive_lag": of_one_number("drive_lag", "drive_lag", "tau", 0.08, 0.8, least=_FASTEST, drive_lag=_FASTEST),
    "drive_delay": of_one_number("drive_delay", "drive_delay", "delay", 0.05, 0.5),
    "rolling_resistance": _rolling_resistance,
    "yaw_moment_differential": _yaw_moment_differential,
    "steer_offset": of_one_number("steer_offset", "steer_offset", "offset", 0.005, 0.08, both_sides=True),
    "steer_gain": of_one_number("steer_gain", "steer_gain", "gain", 0.06, 0.4, base=1.0, both_sides=True),
    "steer_delay": of_one_number("steer_delay", "steer_delay", "delay", 0.03, 0.3),
    "steer_lag": of_one_number(
        "steer_lag", "steer_lag", "tau", 0.04, 0.3, least=_FASTEST, steer_lag=_FASTEST, steer_rate=30.0
    ),
    "steer_backlash": of_one_number("steer_backlash", "steer_backlash", "width", 0.01, 0.08),
    "mass": _mass,
    "yaw_inertia": _yaw_inertia,
    "cg_shift": _cg_shift,
    "sensor_lever_arm": _sensor_lever_arm,
    "sensor_misalignment": of_one_number(
        "sensor_misalignment", "angle", "angle", 0.01, 0.15, both_sides=True, put=sensor_with
    ),
    "sensor_delay": of_one_number("sensor_delay", "delay", "delay", 0.03, 0.19, put=sensor_with),
}
"""By id of the catalogue."""


def draw_effect(term: str, rng: np.random.Generator, world: ProofWorld) -> Concealed:
    """Return the effect of a catalogue id, its shape drawn for a world."""
    return CONCEALED[term](rng, world)
