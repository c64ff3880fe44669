"""What the sensors make of a run: their own clocks, latency, delay, bias, noise and resolution, all seeded."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from split_cli.errors import SplitError
from split_cli.plant.simulation import Trajectory, commands_at


@dataclass(frozen=True)
class ChannelSpec:
    """How a sensor reports one channel: value = truth(t - delay) * gain + bias + noise, rounded to resolution."""

    noise: float = 0.0  # standard deviation, white [SI unit of the channel]
    bias: float = 0.0  # standard deviation of a constant that is drawn once a recording [SI unit]
    resolution: float = 0.0  # step of the reported value, 0 for none [SI unit]
    delay: float = 0.0  # how late the channel is against the sensor's own time stamp [s]
    gain: float = 1.0  # [1]


@dataclass(frozen=True)
class SensorSpec:
    """A device that reports several channels at once."""

    name: str
    rate: float  # reports per second [Hz]
    channels: Mapping[str, ChannelSpec]  # channels of `Trajectory.channel`
    # Standard deviation of the sampling instants about an even clock [s]; the stamp says the true instant.
    clock_jitter: float = 0.0
    # latency, latency_jitter: from the stamp to the arrival at the logger: least value and mean of an exponential
    # excess [s].
    latency: float = 0.0
    latency_jitter: float = 0.0
    is_command: bool = False  # sent, not measured: stamped at the control instants and exact but for resolution
    # position_x, position_y: where the device sits ahead of and left of the CG [m]; moves X, Y, vx, vy.
    position_x: float = 0.0
    position_y: float = 0.0
    turned: float = 0.0  # how far it is turned counter-clockwise against the car [rad]; turns vx, vy and ax, ay


@dataclass(frozen=True)
class Reading:
    """What a device reported."""

    sensor: SensorSpec
    stamp: np.ndarray  # (N,): of the device, seconds of the run [s]
    arrival: np.ndarray  # (N,): at the logger [s]
    values: Mapping[str, np.ndarray] = field(default_factory=dict)  # (N,): SI units


def sensors_of(car_name: str) -> tuple[SensorSpec, ...]:
    """Return the usual instruments of a car.

    Full-size cars carry a GNSS-aided inertial system of the better kind (data sheets of that class state
    0.03 km/h, 0.1 deg and 0.02 m r.m.s.) and production sensors; the model car a motion-capture pose with a
    filter's velocities and a hobby inertial unit.
    """
    small = car_name == "f1tenth_car"
    corners = ("fl", "fr", "rl", "rr")
    if small:
        state = {
            "X": ChannelSpec(0.004, 0.0, 1e-4),
            "Y": ChannelSpec(0.004, 0.0, 1e-4),
            "yaw": ChannelSpec(0.003, 0.0, 1e-4),
            "vx": ChannelSpec(0.012, 0.0, 1e-3),
            "vy": ChannelSpec(0.008, 0.0, 1e-3),
            "r": ChannelSpec(0.006, 0.0, 1e-3),
        }
        inertial = {
            "r": ChannelSpec(0.006, 0.003, 1e-3),
            "ax": ChannelSpec(0.08, 0.02, 5e-3),
            "ay": ChannelSpec(0.08, 0.02, 5e-3),
        }
        command = {"T": ChannelSpec(resolution=1e-4), "delta": ChannelSpec(resolution=1e-5)}
        report = {"delta_actual": ChannelSpec(0.001, 0.0, 5e-4, delay=0.010), "T_actual": ChannelSpec(0.01, 0, 1e-3)}
        wheels = {f"wheel_speed_{corner}": ChannelSpec(0.3, 0.0, 0.05) for corner in corners}
    else:
        state = {
            "X": ChannelSpec(0.010, 0.0, 1e-3),
            "Y": ChannelSpec(0.010, 0.0, 1e-3),
            "yaw": ChannelSpec(0.0012, 0.0, 1e-4),
            "vx": ChannelSpec(0.008, 0.0, 1e-3),
            "vy": ChannelSpec(0.008, 0.0, 1e-3),
            "r": ChannelSpec(0.0015, 0.0, 2e-4),
        }
        inertial = {
            "r": ChannelSpec(0.002, 0.0004, 2e-4),
            "ax": ChannelSpec(0.03, 0.01, 2e-3),
            "ay": ChannelSpec(0.03, 0.01, 2e-3),
        }
        command = {"T": ChannelSpec(resolution=0.01), "delta": ChannelSpec(resolution=1e-5)}
        report = {"delta_actual": ChannelSpec(0.0004, 0.0, 1e-4, delay=0.015), "T_actual": ChannelSpec(8.0, 0.0, 1.0)}
        wheels = {f"wheel_speed_{corner}": ChannelSpec(0.03, 0.0, 0.01) for corner in corners}
    return (
        SensorSpec("state", 100.0, state, 2e-4, 0.004, 0.001),
        SensorSpec("inertial", 100.0 if small else 200.0, inertial, 1e-4, 0.001, 0.0005),
        SensorSpec("command", 50.0, command, 0.0, 0.001, 0.001, is_command=True),
        SensorSpec("report", 50.0, report, 5e-4, 0.003, 0.002),
        SensorSpec("wheels", 50.0, wheels, 5e-4, 0.003, 0.002),
        SensorSpec("position", 20.0, {"X": ChannelSpec(0.02), "Y": ChannelSpec(0.02)}, 1e-3, 0.030, 0.010),
    )


def lean(sensors: tuple[SensorSpec, ...]) -> tuple[SensorSpec, ...]:
    """Return what a modest logger keeps: state, commands, and the inertial unit at 50 Hz."""
    kept = {sensor.name: sensor for sensor in sensors}
    half = replace(kept["inertial"], rate=50.0)
    return (kept["state"], half, kept["command"])


def perfect(sensors: tuple[SensorSpec, ...]) -> tuple[SensorSpec, ...]:
    """Return the same devices without any error: same rates, no noise, bias, delay, jitter or rounding."""
    return tuple(
        SensorSpec(s.name, s.rate, {name: ChannelSpec() for name in s.channels}, is_command=s.is_command)
        for s in sensors
    )


def measure(
    run: Trajectory, sensors: tuple[SensorSpec, ...], seed: int = 0, *, one_clock: float | None = None
) -> tuple[Reading, ...]:
    """Return what the devices report of a run.

    Parameters
    ----------
    seed : int
        Every device draws from a stream of its own, so that adding one does not change the others.
    one_clock : float, optional
        Sample every device at this even rate [Hz] without jitter, as a table with one time column needs.

    Raises
    ------
    SplitError
        If the run is shorter than a report of the slowest device.
    """
    readings = []
    for number, sensor in enumerate(sensors):
        rng = np.random.default_rng([seed, 100 + number])
        if one_clock is not None:
            sensor = replace(sensor, rate=one_clock, clock_jitter=0.0, latency=0.0, latency_jitter=0.0)
        stamp = _stamps(run, sensor, rng, phase=0.0 if one_clock is not None else float(rng.uniform(0, 0.9)))
        if len(stamp) < 2:
            raise SplitError(f"the run of {run.t[-1]:.2g} s is too short for {sensor.name} at {sensor.rate:g} Hz")
        excess = sensor.latency_jitter * rng.standard_exponential(len(stamp))
        values = {
            name: _report(_truth(run, sensor, name, stamp - spec.delay), spec, rng)
            for name, spec in sensor.channels.items()
        }
        readings.append(Reading(sensor, stamp, stamp + sensor.latency + excess, values))
    return tuple(readings)


def _stamps(run: Trajectory, sensor: SensorSpec, rng: np.random.Generator, phase: float) -> np.ndarray:
    period = float(run.command_t[1] - run.command_t[0])
    if sensor.is_command and sensor.clock_jitter == 0.0 and np.isclose(sensor.rate, 1.0 / period):
        return run.command_t[run.command_t <= run.t[-1]]
    count = int((run.t[-1] - run.t[0]) * sensor.rate + 1e-6) + 1
    stamp = run.t[0] + (np.arange(count) + phase) / sensor.rate
    stamp = stamp + np.clip(rng.standard_normal(count), -3, 3) * sensor.clock_jitter
    return stamp[(stamp >= run.t[0]) & (stamp <= run.t[-1])]


def _truth(run: Trajectory, sensor: SensorSpec, name: str, at: np.ndarray) -> np.ndarray:
    """Return a channel where the device sits and as it is turned, at times `at`, shape (N,)."""

    def value(channel: str) -> np.ndarray:
        if channel in ("T", "delta"):
            return commands_at(run, channel, at)
        return np.interp(at, run.t, run.channel(channel))

    x, y, angle = sensor.position_x, sensor.position_y, sensor.turned
    if name in ("vx", "vy"):
        along, across = value("vx") - y * value("r"), value("vy") + x * value("r")
    elif name in ("ax", "ay"):
        along, across = value("ax"), value("ay")
    elif name == "X":
        return value("X") + x * np.cos(value("yaw")) - y * np.sin(value("yaw"))
    elif name == "Y":
        return value("Y") + x * np.sin(value("yaw")) + y * np.cos(value("yaw"))
    else:
        return value(name)
    if name in ("vx", "ax"):
        return np.cos(angle) * along + np.sin(angle) * across
    return -np.sin(angle) * along + np.cos(angle) * across


def _report(truth: np.ndarray, spec: ChannelSpec, rng: np.random.Generator) -> np.ndarray:
    bias = spec.bias * rng.standard_normal()
    values = truth * spec.gain + bias + spec.noise * rng.standard_normal(len(truth))
    if spec.resolution > 0:
        values = np.round(values / spec.resolution) * spec.resolution
    return values
