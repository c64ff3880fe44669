"""Effects outside the catalogue, which a diagnosis should leave unexplained."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from split_cli.proof.concealed import Concealed, of_one_number, sensor_with
from split_cli.proof.world import ProofWorld


def _fault(world: ProofWorld, **changes: float) -> ProofWorld:
    return replace(world, faults=replace(world.faults, active=True, **changes))


def _damaged_tire(rng, world):
    """One wheel's tyre gives less force: turns to one side differ, and braking pulls."""
    corner = rng.choice(("fl", "fr", "rl", "rr"))
    return Concealed("damaged_tire", lambda w, size: _fault(w, **{f"grip_loss_{corner}": size}), 0.3, 0.9)


def _ripple(rng, world):
    """A driveline out of balance: torque that swings with the wheel's angle, once a turn or in two or four."""
    order = float(rng.choice((0.25, 0.5, 1.0)))
    return Concealed("ripple", lambda w, size: _fault(w, ripple=size, ripple_order=order), 0.1, 1.0)


def _brake_fade(rng, world):
    """Brakes that get hot and weak, and recover."""
    car = world.car
    speed = 18.0 * (car.wheelbase / 2.7) ** 0.5
    capacity = 0.5 * car.mass * speed**2 * float(rng.uniform(0.8, 1.6))
    return Concealed(
        "brake_fade",
        lambda w, size: _fault(w, brake_fade=size, brake_heat_capacity=capacity, brake_cooling_time=12.0),
        0.3,
        0.95,
    )


def _rear_steer(rng, world):
    """A four-wheel steering left in the wrong map."""
    speed = 15.0 * (world.car.wheelbase / 2.7) ** 0.5
    return Concealed("rear_steer", lambda w, size: _fault(w, rear_steer=size, rear_steer_speed=speed), 0.1, 0.6)


def _hot_tires(rng, world):
    """Tyres that lose grip as they slide and get it back as they cool."""
    car = world.car
    # Sliding sideways takes up to some m g in power; with a quarter of that they were as hot as can be all along.
    power = 0.06 * car.mass * 9.81 * 18.0 * (car.wheelbase / 2.7) ** 0.5
    seconds = float(rng.uniform(2.0, 5.0))
    return Concealed(
        "hot_tires",
        lambda w, size: _fault(w, tire_heat_loss=size, tire_heat_power=power, tire_heat_time=seconds),
        0.3,
        0.8,
    )


def _slosh(rng, world):
    """A liquid load that swings across."""
    frequency = float(rng.uniform(0.5, 1.0)) / (world.car.wheelbase / 2.7) ** 0.5
    arm = -0.2 * world.car.wheelbase
    mass = world.car.mass
    return Concealed(
        "slosh", lambda w, size: _fault(w, slosh_mass=size * mass, slosh_arm=arm, slosh_frequency=frequency), 0.05, 0.35
    )


def _pulses(rng, world):
    """A stability control that brakes one wheel now and then."""
    car = world.car
    threshold = float(rng.uniform(0.02, 0.035))
    unit = 0.05 * car.max_brake_torque
    return Concealed("pulses", lambda w, size: _fault(w, pulse_torque=size * unit, pulse_threshold=threshold), 1.0, 8.0)


def _gusts(rng, world):
    """Wind that comes and goes within seconds, from all sides."""
    from split_cli.plant.drivers import wander

    car = world.car
    tables = [wander(rng, 1200, 3.0, 1.0) for _ in range(2)]
    side = car.drag_area * 2.5

    def blow(w, size):
        return replace(w, road=replace(w.road, time_spacing=0.5, wind_x=size * tables[0], wind_y=size * tables[1]))

    pace = (car.wheelbase / 2.7) ** 0.5
    return Concealed(
        "gusts", blow, 6.0 * pace, 30.0 * pace, neutral=lambda w: replace(w, car=replace(w.car, side_area=side))
    )


def _steer_rate(rng, world):
    """A steering motor too weak to follow: its rate is limited."""
    # The harder the limit, the larger the size: the rate is 1/size.
    return Concealed(
        "steer_rate",
        lambda w, size: replace(w, car=replace(w.car, steer_rate=1.0 / size)),
        5.0 * (world.car.wheelbase / 2.7) ** 0.5,
        60.0,
        neutral=lambda w: replace(w, car=replace(w.car, steer_rate=30.0)),
    )


STRANGE: dict[str, Callable[[np.random.Generator, ProofWorld], Concealed]] = {
    "damaged_tire": _damaged_tire,
    # An engine map that bends: full pedal gives less than twice half pedal.
    "torque_bend": of_one_number("torque_bend", "torque_bend", "", 0.3, 0.9, put=_fault),
    "ripple": _ripple,
    "brake_fade": _brake_fade,
    # Drive shafts of unequal length: the pedal turns the wheel.
    "torque_steer": of_one_number("torque_steer", "torque_steer", "", 0.02, 0.15, both_sides=True, put=_fault),
    "rear_steer": _rear_steer,
    "hot_tires": _hot_tires,
    # The front left brake lets go late.
    "stuck_brake": of_one_number("stuck_brake", "stuck_brake", "", 0.05, 0.5, put=_fault),
    "slosh": _slosh,
    "pulses": _pulses,
    "gusts": _gusts,
    "steer_rate": _steer_rate,
    # A yaw-rate sensor that reads high in fast turns.
    "gyro_curve": of_one_number("gyro_curve", "gyro_curve", "", 0.1, 2.0, both_sides=True, put=sensor_with),
    # A yaw-rate sensor that alone is late.
    "gyro_late": of_one_number("gyro_late", "gyro_delay", "", 0.03, 0.15, put=sensor_with),
    # A speed sensor with the wrong scale.
    "speed_gain": of_one_number("speed_gain", "speed_gain", "", 0.03, 0.3, base=1.0, both_sides=True, put=sensor_with),
}


NAMED_SINCE = {"gyro_late": "channel_delay", "speed_gain": "speed_scale"}
"""Unmodelled effects that the catalogue has a name for by now; their kind stays, so that cases do."""


def draw_strange(kind: str, rng: np.random.Generator, world: ProofWorld) -> Concealed:
    """Return an effect outside the catalogue, its shape drawn for a world."""
    return STRANGE[kind](rng, world)
