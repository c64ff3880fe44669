"""Sensors of a drive: where they sit, what they do wrong, their noise; and the table that a logger writes."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.studies.other_cars.cars import CarKind
from tests.studies.other_cars.driver import Driven


class SensorFaults(NamedTuple):
    """What sensors do wrong; all values neutral by default.

    Attributes
    ----------
    lever : float
        How far ahead of the CG the velocity sensor sits [m].
    turned : float
        Angle by which it is turned counter-clockwise [rad].
    angle_bias : float
        Angle by which the recorded velocity is turned counter-clockwise [rad].
    speed : float
        Factor of the recorded velocity [1].
    yaw_rate_late : float
        Delay of the yaw rate [s].
    yaw_rate_bias : float
        [rad/s].
    """

    lever: float = 0.0
    turned: float = 0.0
    angle_bias: float = 0.0
    speed: float = 1.0
    yaw_rate_late: float = 0.0
    yaw_rate_bias: float = 0.0


def sensed(driven: Driven, sensors: SensorFaults) -> dict[str, np.ndarray]:
    """Return what noiseless sensors read of a drive, SI units, shape (K,) each, once a period of the commands."""
    x, y, yaw, vx, vy, r = driven.states[:, :6].T
    t = driven.period * np.arange(len(yaw))
    ahead, left = vx, vy + sensors.lever * r
    angle = sensors.angle_bias - sensors.turned
    c, s = np.cos(angle), np.sin(angle)
    rate = np.interp(t - sensors.yaw_rate_late, t, r) + sensors.yaw_rate_bias
    return {
        **{"t": t, "X": x, "Y": y, "yaw": yaw, "vx": sensors.speed * (c * ahead - s * left)},
        **{"vy": sensors.speed * (s * ahead + c * left), "r": rate, "ax": driven.felt[:, 0], "ay": driven.felt[:, 1]},
        **{"delta": driven.steer, "T": driven.torque},
    }


def recorded(
    kind: CarKind,
    driven: Driven,
    sensors: SensorFaults,
    period: float,
    rng: np.random.Generator,
    *,
    position: bool,
    acceleration: bool,
) -> dict[str, np.ndarray]:
    """Return a recording with noise at a period that is a multiple of that of the commands [s].

    Parameters
    ----------
    position, acceleration : bool
        Whether X, Y and yaw, and whether a_x and a_y are recorded.
    """
    every = round(period / driven.period)
    columns = {name: values[::every].copy() for name, values in sensed(driven, sensors).items()}
    left_out = (() if position else ("X", "Y", "yaw")) + (() if acceleration else ("ax", "ay"))
    for name, size in kind.noise.items():
        drawn = rng.standard_normal(len(columns["t"]))
        columns[name] += size * drawn
    return {name: values for name, values in columns.items() if name not in left_out}


#: For each car the columns of its logger: channel, header, SI value of one unit, and the unit as a map says it.
#: The van's logger has y to the right and z down.
_DEGREE, _SHARP = np.pi / 180.0, 15.2
_LOGGERS: dict[str, tuple[tuple[str, str, float, str], ...]] = {
    "sports car": (
        *(("X", "east", 1.0, "m"), ("Y", "north", 1.0, "m"), ("yaw", "heading", _DEGREE, "deg")),
        *(("vx", "speed_ahead", 1.0 / 3.6, "km/h"), ("vy", "speed_left", 1.0 / 3.6, "km/h")),
        *(("r", "yaw_rate", _DEGREE, "deg/s"), ("ax", "acc_ahead", 9.80665, "g"), ("ay", "acc_left", 9.80665, "g")),
        *(("delta", "steering_wheel", _DEGREE / _SHARP, "deg"), ("T", "wheel_torque", 1.0, "N m")),
    ),
    "van": (
        *(("X", "pos_x", 1.0, "m"), ("Y", "pos_y", 1.0, "m"), ("yaw", "psi", 1.0, "rad")),
        *(("vx", "u", 1.0, "m/s"), ("vy", "v", -1.0, "m/s"), ("r", "psi_dot", -1.0, "rad/s")),
        *(("ax", "a_x", 1.0, "m/s^2"), ("ay", "a_y", -1.0, "m/s^2")),
        *(("delta", "wheel_angle", -_DEGREE, "deg"), ("T", "torque_command", 1.0, "N m")),
    ),
    "model car": (
        *(("X", "x", 1.0, "m"), ("Y", "y", 1.0, "m"), ("yaw", "theta", 1.0, "rad")),
        *(("vx", "v_x", 1.0, "m/s"), ("vy", "v_y", 1.0, "m/s"), ("r", "omega", 1.0, "rad/s")),
        *(("ax", "a_x", 1.0, "m/s^2"), ("ay", "a_y", 1.0, "m/s^2")),
        *(("delta", "servo_angle", 1.0, "rad"), ("T", "motor_torque", 1.0, "N m")),
    ),
}


def write_log(kind: CarKind, columns: dict[str, np.ndarray], path: Path) -> None:
    """Write a recording as the car's logger does: CSV with names and units of its own."""
    table = {"stamp": columns["t"]}
    for channel, header, unit, _ in _LOGGERS[kind.name]:
        if channel in columns:
            table[header] = columns[channel] / unit
    lines = [",".join(table)]
    lines += [",".join(f"{value:.9g}" for value in row) for row in np.column_stack([*table.values()])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def signal_map(kind: CarKind) -> str:
    """Return the signal map of the car's logger, as its engineer writes it for `split ingest` (docs/formats.md)."""
    sort = "command" if kind.commands_are_logged else "measured"
    down = kind.name == "van"
    lines = [f"name: {kind.name}", "time: {source: stamp, unit: s}", f"frame: {'frd' if down else 'flu'}", "channels:"]
    for channel, header, _, unit in _LOGGERS[kind.name]:
        more = f", scale: 1/{_SHARP}" if header == "steering_wheel" else ""
        more += f", kind: {sort}" if channel in ("delta", "T") else ""
        more += ", optional: true" if channel in ("X", "Y", "yaw", "ax", "ay") else ""
        lines.append(f"  {channel}: {{source: {header}, unit: {unit}{more}}}")
    return "\n".join(lines) + "\n"


def vehicle_text(kind: CarKind, car: NamedTuple) -> str:
    """Return a vehicle file (docs/formats.md) of what an engineer knows of a car: no tyres yet, which are guessed."""
    weight, base = car.mass * 9.81, car.front + car.rear
    loads = weight * car.rear / base, weight * car.front / base
    tyres = [f"{{B: {9.0:g}, C: 1.4, D: {0.95 * car.grip * load:.5g}}}" for load in loads]
    return (
        f"name: {kind.name}\nmass: {car.mass:.6g}\nyaw_inertia: {car.yaw_inertia:.6g}\n"
        f"cg_to_front_axle: {car.front:.6g}\ncg_to_rear_axle: {car.rear:.6g}\ncg_height: {car.height:.6g}\n"
        f"wheel_radius: {car.radius:.6g}\ndrive_split_front: {car.drive_front:g}\n"
        f"brake_split_front: {car.brake_front:g}\n"
        f"rolling_resistance_front: {car.rolling * car.rear / base:.6g}\n"
        f"rolling_resistance_rear: {car.rolling * car.front / base:.6g}\ndrag_coefficient: {car.drag:.6g}\n"
        f"front_tire: {tyres[0]}\nrear_tire: {tyres[1]}\n"
        f"max_torque: {kind.torques[0]:g}\nmax_brake_torque: {kind.torques[1]:g}\n"
    )
