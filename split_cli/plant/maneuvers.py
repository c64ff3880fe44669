"""Standard tests of a car: open loop, or with a driver who holds speed or a circle.

Every test takes an intensity, the share of the car's grip it asks for: 0.35 is gentle enough for calibration.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from split_cli.errors import SplitError, nearest_names
from split_cli.plant.cars import CarParameters
from split_cli.plant.drivers import DRIVER_STYLES, Grip, grip_of
from split_cli.plant.simulation import CONTROL_PERIOD, Script, Trajectory, drive_script
from split_cli.plant.tracks import Track, circle

CALIBRATION_TESTS = (
    "coast_down",
    "throttle_steps",
    "brake_steps",
    "constant_radius",
    "constant_radius_right",
    "sine_sweep",
    "step_steer",
)
"""The gentle tests from which a nominal model can be calibrated honestly."""


@dataclass(frozen=True)
class Maneuver:
    """A test ready to be driven."""

    name: str
    script: Script
    speed: float  # at the start [m/s]
    track: Track | None = None  # a circle to follow; None for open ground


@dataclass(frozen=True)
class _ManeuverCar:
    """What a test is built from: the car, its grip, the share asked for, seconds per full-size second."""

    car: CarParameters
    grip: Grip
    intensity: float
    pace: float

    def speed(self, full_size: float) -> float:
        """Return a full-size car's speed scaled to this car [m/s]."""
        return full_size * self.pace

    def clock(self, full_size_seconds: float) -> np.ndarray:
        """Return the control instants of a test that takes a full-size car so long [s]."""
        return np.arange(int(round(full_size_seconds * self.pace / CONTROL_PERIOD))) * CONTROL_PERIOD

    def steer_for(self, lateral: float, speed: float) -> float:
        """Return the road-wheel angle of a steady turn [rad]."""
        extra = np.interp(
            abs(lateral) / self.grip.lateral_spacing,
            np.arange(len(self.grip.slip_difference)),
            self.grip.slip_difference,
        )
        return float(np.sign(lateral) * (np.arctan(self.car.wheelbase * abs(lateral) / speed**2) + extra))

    def most_torque(self, share: float = 1.0, *, braking: bool = False) -> float:
        """Return the size of the wheel torque that asks for a share of the intensity, at most the car's [N m]."""
        grip = self.grip.braking if braking else self.grip.driving
        limit = self.car.max_brake_torque if braking else self.car.max_torque
        return min(limit, share * self.intensity * grip * self.car.mass * self.car.wheel_radius)

    def turn(self, share: float) -> tuple[Track, float]:
        """Return a circle and the speed at which it asks for a share of the intensity [m/s]."""
        radius = 60.0 * self.car.wheelbase / 2.7
        return circle(radius), float(np.sqrt(share * self.intensity * self.grip.lateral * radius))


def _free(clock: np.ndarray) -> np.ndarray:
    return np.full(len(clock), np.nan)


def _steps(clock: np.ndarray, levels: tuple[float, ...], ramp: float) -> np.ndarray:
    """Return levels of equal length, joined by half-cosine ramps of `ramp` seconds."""
    length = (clock[-1] + CONTROL_PERIOD) / len(levels)
    values = np.full(len(clock), levels[0], dtype=float)
    for number in range(1, len(levels)):
        part = np.clip((clock - number * length) / max(ramp, 1e-9), 0.0, 1.0)
        values += (levels[number] - levels[number - 1]) * 0.5 * (1.0 - np.cos(np.pi * part))
    return values


def _step_steer(setting: _ManeuverCar) -> Maneuver:
    """Steps of the steering left and right at constant speed (ISO 7401)."""
    speed = setting.speed(22.0)
    clock = setting.clock(36.0)
    lateral = setting.intensity * setting.grip.lateral
    half, full = setting.steer_for(0.5 * lateral, speed), setting.steer_for(lateral, speed)
    steer = _steps(clock, (0, half, 0, -half, 0, full, 0, -full, 0), 0.15 * setting.pace)
    return Maneuver("step_steer", Script(_free(clock), steer, np.full(len(clock), speed)), speed)


def _sine_sweep(setting: _ManeuverCar) -> Maneuver:
    """A sine of the steering whose frequency rises from 0.2 to 3 Hz (full size) at constant speed (ISO 7401)."""
    speed = setting.speed(20.0)
    clock = setting.clock(40.0)
    low, high = 0.2 / setting.pace, 3.0 / setting.pace
    total = clock[-1] + CONTROL_PERIOD
    phase = 2.0 * np.pi * low * total / np.log(high / low) * (np.power(high / low, clock / total) - 1.0)
    fade = np.minimum(1.0, np.minimum(clock, total - clock) / (1.0 * setting.pace))
    steer = setting.steer_for(0.8 * setting.intensity * setting.grip.lateral, speed) * fade * np.sin(phase)
    return Maneuver("sine_sweep", Script(_free(clock), steer, np.full(len(clock), speed)), speed)


def _constant_radius(setting: _ManeuverCar, side: float = 1.0) -> Maneuver:
    """A circle driven ever faster (ISO 4138)."""
    radius = side * 40.0 * setting.car.wheelbase / 2.7
    clock = setting.clock(45.0)
    low = max(setting.speed(6.0), 1.3 * setting.car.crawl_speed)
    high = np.sqrt(setting.intensity * setting.grip.lateral * abs(radius))
    # Lateral acceleration, not speed, rises evenly, so that no range of it is passed in a hurry.
    part = np.clip(clock / clock[-1] * 1.1 - 0.05, 0.0, 1.0)
    speed = np.sqrt(low**2 + (high**2 - low**2) * part)
    name = "constant_radius" if side > 0 else "constant_radius_right"
    return Maneuver(name, Script(_free(clock), _free(clock), speed), float(low), circle(radius))


def _constant_radius_right(setting: _ManeuverCar) -> Maneuver:
    """The same circle to the right."""
    return _constant_radius(setting, -1.0)


def _throttle_steps(setting: _ManeuverCar) -> Maneuver:
    """Steps of driving torque with lift-offs between, straight ahead."""
    clock = setting.clock(30.0)
    most = setting.most_torque()
    torque = _steps(clock, (0.5 * most, 0, 0.9 * most, 0, 0.35 * most, 0.7 * most), 0.1 * setting.pace)
    return Maneuver("throttle_steps", Script(torque, np.zeros(len(clock)), _free(clock)), setting.speed(10.0))


def _brake_steps(setting: _ManeuverCar) -> Maneuver:
    """Steps of braking torque with rolling between, straight ahead."""
    clock = setting.clock(24.0)
    most = setting.most_torque(braking=True)
    torque = _steps(clock, (0, -0.25 * most, 0, -0.5 * most, 0, -0.9 * most), 0.1 * setting.pace)
    return Maneuver("brake_steps", Script(torque, np.zeros(len(clock)), _free(clock)), setting.speed(36.0))


def _coast_down(setting: _ManeuverCar) -> Maneuver:
    """Rolling out in neutral, straight ahead (ISO 10521)."""
    clock = setting.clock(60.0)
    idle = np.zeros(len(clock))
    return Maneuver("coast_down", Script(idle, idle, _free(clock)), setting.speed(34.0))


def _brake_in_turn(setting: _ManeuverCar) -> Maneuver:
    """A steady turn, then the brakes with the wheel held (ISO 7975)."""
    track, speed = setting.turn(0.7)
    clock = setting.clock(12.0)
    braking = clock >= 7.0 * setting.pace
    torque, steer = _free(clock), _free(clock)
    most = setting.most_torque(0.7, braking=True)
    ramp = np.clip((clock - 7.0 * setting.pace) / (0.3 * setting.pace), 0.0, 1.0)
    torque[braking] = -most * ramp[braking]
    steer[braking] = np.inf
    return Maneuver("brake_in_turn", Script(torque, steer, np.full(len(clock), speed)), speed, track)


def _throttle_in_turn(setting: _ManeuverCar) -> Maneuver:
    """A steady turn, then power on and lift-off in turn with the wheel held (ISO 9816)."""
    track, speed = setting.turn(0.6)
    clock = setting.clock(16.0)
    held = clock >= 7.0 * setting.pace
    most = setting.most_torque(0.5)
    torque, steer = _free(clock), _free(clock)
    torque[held] = _steps(clock[held] - clock[held][0], (0.8 * most, 0.0, 0.8 * most, 0.0), 0.15 * setting.pace)
    steer[held] = np.inf
    return Maneuver("throttle_in_turn", Script(torque, steer, np.full(len(clock), speed)), speed, track)


_BUILDERS: dict[str, Callable[[_ManeuverCar], Maneuver]] = {
    build.__name__.removeprefix("_"): build
    for build in (
        _step_steer,
        _sine_sweep,
        _constant_radius,
        _constant_radius_right,
        _throttle_steps,
        _brake_steps,
        _coast_down,
        _brake_in_turn,
        _throttle_in_turn,
    )
}
MANEUVER_NAMES = tuple(_BUILDERS)


def build_maneuver(name: str, car: CarParameters, intensity: float = 0.35) -> Maneuver:
    """Return the test called `name`, scaled to a car.

    Speeds and times scale with the square root of the wheelbase, lengths with the wheelbase, so that accelerations
    stay those of a full-size car (Froude scaling).

    Parameters
    ----------
    intensity : float
        Share of the car's grip that is asked for, above 0 to 1 [1].

    Raises
    ------
    SplitError
        If there is no such test or the intensity makes no sense.
    """
    if name not in _BUILDERS:
        advice = nearest_names(name, _BUILDERS)
        raise SplitError(f"no maneuver is called {name!r}", where="--maneuver", advice=advice)
    if not 0.0 < intensity <= 1.0:
        raise SplitError(f"intensity must lie above 0 and not above 1, got {intensity:g}")
    return _BUILDERS[name](_ManeuverCar(car, grip_of(car), intensity, float(np.sqrt(car.wheelbase / 2.7))))


def run_maneuver(car: CarParameters, maneuver: Maneuver, **circumstances: Any) -> Trajectory:
    """Drive a test; `circumstances` are seed, road, faults and sample period of `drive_script`.

    Raises
    ------
    SplitError
        If the car left its circle or spun.
    """
    calm = DRIVER_STYLES["smooth"]
    return drive_script(car, maneuver.script, calm, speed=maneuver.speed, track=maneuver.track, **circumstances)
