"""What a logger writes of a run of the plant: one clock, aligned commands, sensor faults and noise."""

from dataclasses import dataclass

import numpy as np

from split_cli.logs.assembling.noise import estimate_noise
from split_cli.logs.drive import Drive, DriveMetadata
from split_cli.plant.cars import CarParameters
from split_cli.plant.sensors import sensors_of
from split_cli.plant.simulation import Trajectory, commands_at

RATE = 100.0
START = 0.2
"""When a recording begins after the run's start: the first samples of a late channel would be made up [s]."""
_MEASURED = ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay")


@dataclass(frozen=True)
class Alignment:
    """How much later than the command its effect begins in a sound car, which the logger's clock takes off [s]."""

    torque: float
    steer: float


@dataclass(frozen=True)
class SensorFault:
    """What is wrong with the measurement; nothing by default."""

    dx: float = 0.0  # the velocity sensor sits so far ahead of where it is said to be [m]
    angle: float = 0.0  # it is turned counter-clockwise [rad]
    delay: float = 0.0  # every measured channel is late by it [s]
    speed_gain: float = 1.0  # v_x is recorded so many times too large [1]
    gyro_curve: float = 0.0  # r is recorded as r (1 + curve |r|) [s/rad]
    gyro_delay: float = 0.0  # r alone is late [s]


def alignment_of(car: CarParameters) -> Alignment:
    """Return a first alignment of a car's log: its actuators' lags, and its relaxation at a middling speed."""
    speed = 20.0 * (car.wheelbase / 2.7) ** 0.5
    return Alignment(car.drive_lag, car.steer_lag + car.front_tire.relaxation_lateral / speed)


def command_channels(run: Trajectory, at: np.ndarray, alignment: Alignment) -> tuple[np.ndarray, np.ndarray]:
    """Return T [N m] and delta [rad] as logged at times `at` [s], each shape (N,)."""
    return commands_at(run, "T", at - alignment.torque), commands_at(run, "delta", at - alignment.steer)


def exact_motion(run: Trajectory, fault: SensorFault, at: np.ndarray) -> np.ndarray:
    """Return X, Y, yaw, v_x, v_y, r, a_x, a_y as faulty but noise-free sensors report them, shape (N, 8).

    A displaced or turned velocity sensor leaves position, yaw and accelerations as they are: v_y gains dx r; then
    (v_x, v_y) is turned by -angle.
    """

    def value(name: str, late: float = 0.0) -> np.ndarray:
        return np.interp(at - fault.delay - late, run.t, run.channel(name))

    r = value("r", fault.gyro_delay)
    vx, vy = value("vx"), value("vy") + fault.dx * value("r")
    cosine, sine = np.cos(fault.angle), np.sin(fault.angle)
    vx, vy = fault.speed_gain * (cosine * vx + sine * vy), cosine * vy - sine * vx
    r = r * (1.0 + fault.gyro_curve * np.abs(r))
    return np.stack([value("X"), value("Y"), value("yaw"), vx, vy, r, value("ax"), value("ay")], axis=1)


def record(
    run: Trajectory, alignment: Alignment, name: str, rng: np.random.Generator | None, fault: SensorFault | None = None
) -> Drive:
    """Return a run as a drive at 100 Hz.

    Parameters
    ----------
    rng : Generator or None
        Of the sensors' noise; None for a simulation, which has none.
    """
    first = START
    t = np.arange(int((run.t[-1] - first) * RATE + 1e-6)) / RATE + first
    motion = exact_motion(run, fault or SensorFault(), t)
    torque, steer = command_channels(run, t, alignment)
    if rng is not None:
        motion = motion + noise_of(run.car.name) * rng.standard_normal(motion.shape)
    columns = {"t": np.round(t - first, 6), **dict(zip(_MEASURED, motion.T, strict=True)), "T": torque, "delta": steer}
    length = len(t)
    noise = tuple(estimate_noise(c, columns[c], [(0, length)]) for c in _MEASURED)
    kinds = {c: "measured" for c in _MEASURED} | {"T": "command", "delta": "command"}
    course = "continuous" if run.car.command_ramp else "held"
    metadata = DriveMetadata(kinds=kinds, noise=noise, between={"T": course, "delta": course})
    return Drive(name, columns, np.zeros(length, dtype=np.int32), 1.0 / RATE, metadata)


def noise_of(car_name: str) -> np.ndarray:
    """Return the noise of the measured channels, shape (8,): standard deviations, SI."""
    state, inertial = sensors_of(car_name)[:2]
    return np.array([(inertial if c in ("ax", "ay") else state).channels[c].noise for c in _MEASURED])
