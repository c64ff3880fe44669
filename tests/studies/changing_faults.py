"""Faults that no part of the package puts in: of one axle or side, and those that change in the course of a drive.

Each takes a drive, a size and the vehicle, and returns the drive with the fault. A fault of the car is put in
forwards, by `proof.altered_car`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from split_cli.logs.drive import Drive
from split_cli.proof.altered_car import altered_vehicle, driven_by
from split_cli.proof.injection import InjectedFault, inject
from split_cli.vehicle.parameters import Vehicle

Put = Callable[[Drive, float, Vehicle], Drive]


@dataclass(frozen=True)
class ChangingFault:
    """A fault: how it is put in, and the term and the parameter that would name it, empty if none would."""

    put: Put
    term: str = ""
    parameter: str = ""


def _share(drive: Drive) -> np.ndarray:
    """Return how much of the drive's time has passed, 0 to 1, shape (N,)."""
    t = drive["t"] - drive["t"][0]
    return t / t[-1]


def _with(drive: Drive, **columns: np.ndarray) -> Drive:
    return replace(drive, columns={**drive.columns, **columns}, sha256="")


def _scaled(channel: str, factor: Callable[[Drive, float], np.ndarray]) -> Put:
    return lambda drive, size, vehicle: _with(drive, **{channel: drive[channel] * factor(drive, size)})


def _added(channel: str, what: Callable[[Drive, float], np.ndarray]) -> Put:
    return lambda drive, size, vehicle: _with(drive, **{channel: drive[channel] + what(drive, size)})


def _grip_falls(drive: Drive, size: float, vehicle: Vehicle) -> Drive:
    """Return a drive with less grip in its second half."""
    late = _share(drive) >= 0.5
    begin = drive.select(late)
    after = driven_by(begin, vehicle, altered_vehicle(vehicle, "friction_scale", size))
    columns = {name: np.array(values) for name, values in drive.columns.items()}
    for name in columns:
        columns[name][late] = after[name]
    return replace(drive, columns=columns, sha256="")


def _clocks_drift(drive: Drive, size: float, vehicle: Vehicle) -> Drive:
    """Return a drive whose commands are recorded earlier by a time that grows from 0 to `size` [s]."""
    out = {name: np.array(drive[name], dtype=float) for name in ("T", "delta")}
    late = size * _share(drive)
    for rows in drive.segments():
        t = drive["t"][rows]
        for name in out:
            out[name][rows] = np.interp(t + late[rows], t, drive[name][rows])
    return _with(drive, **out)


def _rows_lost(drive: Drive, size: float, vehicle: Vehicle) -> Drive:
    """Return a drive in which a share `size` of measured rows was lost, and the last one stands in their place."""
    lost = np.random.default_rng(15).random(len(drive)) < size
    lost[[rows.start for rows in drive.segments()]] = False
    last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(drive))))
    return _with(drive, **{name: np.asarray(drive[name])[last] for name in ("vx", "vy", "r")})


def _late_now_and_then(drive: Drive, size: float, vehicle: Vehicle) -> Drive:
    """Return a drive whose yaw rate is late in every second stretch of 5 s."""
    late = inject(drive, InjectedFault("yaw rate late", "channel_delay", (("r", size),), "r"), vehicle)
    now = np.floor((drive["t"] - drive["t"][0]) / 5.0).astype(int) % 2 == 1
    return _with(drive, r=np.where(now, late["r"], drive["r"]))


def _with_softer_front(vehicle: Vehicle, scale: float) -> Vehicle:
    tire = vehicle.front_tire
    return replace(vehicle, effects=(), front_tire=replace(tire, B=scale * tire.B))


CHANGING: dict[str, ChangingFault] = {
    "front tyres softer": ChangingFault(
        lambda drive, size, vehicle: driven_by(drive, vehicle, _with_softer_front(vehicle, size)),
        "tire_stiffness",
        "front_scale",
    ),
    "more yaw inertia": ChangingFault(
        lambda drive, size, vehicle: driven_by(
            drive, vehicle, replace(vehicle, effects=(), yaw_inertia=size * vehicle.yaw_inertia)
        ),
        "yaw_inertia",
        "scale",
    ),
    "grip falls": ChangingFault(_grip_falls),
    "steering offset steps": ChangingFault(
        _added("delta", lambda drive, size: -size * (_share(drive) >= 0.5)), "steer_offset", "offset"
    ),
    "steering scaled to the left": ChangingFault(
        _scaled("delta", lambda drive, size: np.where(drive["delta"] > 0.0, 1.0 / size, 1.0)), "steer_gain", "gain"
    ),
    "steering reversed": ChangingFault(_scaled("delta", lambda drive, size: size * np.ones(len(drive)))),
    "yaw rate reversed": ChangingFault(_scaled("r", lambda drive, size: size * np.ones(len(drive)))),
    "lateral velocity reversed": ChangingFault(_scaled("vy", lambda drive, size: size * np.ones(len(drive)))),
    "yaw rate drifts": ChangingFault(_added("r", lambda drive, size: size * _share(drive)), "yaw_rate_bias", "r"),
    "torque fades": ChangingFault(
        # The car did what a weaker drive does, so that the command was larger.
        _scaled("T", lambda drive, size: 1.0 / (1.0 + (size - 1.0) * _share(drive))),
        "drive_gain",
        "drive_gain",
    ),
    "clocks drift": ChangingFault(_clocks_drift, "sensor_delay", "delay"),
    "rows lost": ChangingFault(_rows_lost),
    "yaw rate late now and then": ChangingFault(_late_now_and_then, "channel_delay", "r"),
}
"""By name; sizes as of the parameter, a share of rows [1] for "rows lost", and -1 for what is reversed."""
