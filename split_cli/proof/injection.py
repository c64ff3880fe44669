"""Known faults put into recorded channels, as if the car or its sensors had had them.

A fault between command and car is put in backwards: the recording shows what the car did, so the command that a
faulty actuator would have needed to do just that is written in place of the one recorded. Another car is put in
forwards, see `altered_car`.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.errors import DriveError, SplitError
from split_cli.logs.drive import Drive
from split_cli.proof.altered_car import ALTERATIONS, altered_vehicle, driven_by, moved_reference
from split_cli.vehicle.effects import CATALOGUE, Recording, Term
from split_cli.vehicle.parameters import Vehicle


@dataclass(frozen=True)
class InjectedFault:
    """A fault and its size."""

    name: str
    term: str  # id of the catalogue that names it; empty for none
    parameters: tuple[tuple[str, float], ...]  # True values; a parameter that is not among them is neutral
    variant: str = ""  # of the term

    @property
    def value(self) -> float:
        """The first parameter's value."""
        return self.parameters[0][1] if self.parameters else 0.0

    def built(self) -> Term:
        """Return the term that names it, with its other parameters neutral."""
        kind = CATALOGUE[self.term]
        units = kind.parameter_units(self.variant)
        neutral = {name: value for name, value in kind.neutral.items() if name in units}
        return kind({**neutral, **dict(self.parameters)}, self.variant)


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault: the term, its variant and parameter that name it, and three sizes of it."""

    term: str
    parameter: str
    sizes: tuple[float, float, float]
    variant: str = ""
    also: tuple[str, ...] = ()  # other parameters of the term that get the same value


FAULTS: dict[str, FaultKind] = {
    "steering late": FaultKind("steer_delay", "delay", (0.16, 0.08, 0.04)),
    "steering logged late": FaultKind("steer_signal_delay", "delay", (0.16, 0.08, 0.04)),
    "steering scaled": FaultKind("steer_gain", "gain", (0.80, 0.90, 0.95)),
    "steering offset": FaultKind("steer_offset", "offset", (0.020, 0.010, 0.005)),
    "velocity rotated": FaultKind("sensor_misalignment", "angle", (0.04, 0.02, 0.01)),
    "velocity moved": FaultKind("sensor_lever_arm", "dx", (1.6, 0.8, 0.4)),
    "reference moved": FaultKind("sensor_lever_arm", "dx", (1.6, 0.8, 0.4), "unit"),
    "velocity biased": FaultKind("velocity_bias", "angle", (0.04, 0.02, 0.01)),
    "velocity drifts": FaultKind("velocity_bias", "drift", (0.0008, 0.0004, 0.0002)),
    "lateral velocity late": FaultKind("channel_delay", "vy", (0.16, 0.08, 0.04), "vy"),
    "speed scaled": FaultKind("speed_scale", "scale", (0.90, 0.95, 0.98), "vx"),
    "yaw rate late": FaultKind("channel_delay", "r", (0.16, 0.08, 0.04), "r"),
    "yaw rate scaled": FaultKind("yaw_rate_scale", "scale", (0.90, 0.95, 0.98)),
    "yaw rate biased": FaultKind("yaw_rate_bias", "r", (0.020, 0.010, 0.005)),
    "lateral acceleration biased": FaultKind("acceleration_bias", "ay", (1.6, 0.8, 0.4), "ay"),
    "clocks shifted": FaultKind("sensor_delay", "delay", (0.16, 0.08, 0.04)),
    "torque scaled": FaultKind("drive_gain", "drive_gain", (0.60, 0.80, 0.90), also=("brake_gain",)),
    "torque late": FaultKind("drive_delay", "delay", (0.16, 0.08, 0.04)),
    "heavier": FaultKind("mass", "scale", (1.5, 1.25, 1.1)),
    "less grip": FaultKind("friction_scale", "scale", (0.60, 0.75, 0.90)),
    "softer tyres": FaultKind("tire_stiffness", "front_scale", (0.60, 0.75, 0.90), also=("rear_scale",)),
    "CG moved": FaultKind("cg_shift", "dx", (0.4, 0.2, 0.1)),
}
"""By name; sizes in [s], [m] for a wheelbase of 2.7 m, [rad], [rad/s], [m/s^2] or [1], as of the parameter.

"reference moved" is an inertial unit whose place was entered wrongly: v_y and the accelerations are measured dx
further forward, not v_y alone as with "velocity moved".
"""
_NEEDS_TORQUE = ("drive_gain", "drive_delay", "sensor_delay", "mass")
_MOVED = ("sensor_lever_arm", "cg_shift")


def faults_for(drive: Drive, vehicle: Vehicle, only: Sequence[str] | None = None) -> list[InjectedFault]:
    """Return the faults to put into a drive, each in three sizes, and none as the first.

    A torque that was derived from the motion is neither scaled nor shifted: it would say nothing of the car, and
    clocks that are late for the steering alone are a steering that is late. Nor is the car made heavier: without a
    torque a heavier car is one with softer tyres and less grip. Sensors that were not recorded have no fault.

    Raises
    ------
    SplitError
        If a name in `only` is no fault.
    """
    require_known(only or (), FAULTS)
    derived = drive.metadata.torque_follows_motion
    found = [InjectedFault("none", "", ())]
    for name, kind in FAULTS.items():
        if (only and name not in only) or (derived and kind.term in _NEEDS_TORQUE):
            continue
        if "ay" not in drive.columns and name in ("lateral acceleration biased", "reference moved"):
            continue
        for size in kind.sizes:
            value = size * vehicle.wheelbase / 2.7 if kind.term in _MOVED else size
            parameters = tuple((one, value) for one in (kind.parameter, *kind.also))
            found.append(InjectedFault(name, kind.term, parameters, kind.variant))
    return found


def faults_of_sizes(
    faults: Iterable[InjectedFault], promised: Mapping[tuple[str, str], float], factors: Sequence[float]
) -> list[InjectedFault]:
    """Return each kind of fault in multiples of the size from which on it is promised to be named.

    Parameters
    ----------
    faults : iterable of InjectedFault
        Of each kind one or more; those without a term are returned as they are.
    promised : mapping of (str, str) to float
        By term and parameter; a fault whose first parameter is not there is left out.
    factors : sequence of float
        Multiples of what the fault does to the recording: of a gain below 1, how far one over it lies from 1.
    """
    kinds = {fault.name: fault for fault in reversed(list(faults))}
    found = [fault for fault in kinds.values() if not fault.term]
    for fault in reversed(kinds.values()):
        (name, _), *_ = fault.parameters or (("", 0.0),)
        if (fault.term, name) not in promised:
            continue
        neutral, value = CATALOGUE[fault.term].neutral[name], promised[fault.term, name]
        for factor in factors:
            less = neutral == 1.0 and value < 1.0
            size = 1.0 / (1.0 + factor * (1.0 / value - 1.0)) if less else neutral + factor * (value - neutral)
            found.append(replace(fault, parameters=tuple((each, size) for each, _ in fault.parameters)))
    return found


def split_in_halves(drive: Drive) -> tuple[Drive, Drive]:
    """Return the first and the second half of the time of a drive."""
    first = drive["t"] - drive["t"][0] < 0.5 * (drive["t"][-1] - drive["t"][0])
    return drive.select(first), drive.select(~first)


def require_known(names: Iterable[str], known: Collection[str]) -> None:
    """Raise SplitError, listing those there are, if a name is no fault."""
    for name in names:
        if name not in known:
            advice = f"There are {', '.join(known)}."
            raise SplitError(f"no fault is called {name!r}", where="--faults", advice=advice)


def inject(drive: Drive, fault: InjectedFault, vehicle: Vehicle | None = None) -> Drive:
    """Return a drive with a fault in its channels.

    Parameters
    ----------
    vehicle : Vehicle, optional
        Of the recorded car; a fault of the car itself needs it.

    Raises
    ------
    SplitError
        If the car with the fault could not have made the drive.
    """
    if not fault.term:
        return drive
    value = fault.value
    if fault.name == "reference moved":
        return moved_reference(drive, value)
    if fault.term in ALTERATIONS and vehicle is not None:
        return driven_by(drive, vehicle, altered_vehicle(vehicle, fault.term, value))
    columns = dict(drive.columns)
    commands: dict[str, Callable[[], dict[str, np.ndarray]]] = {
        "steer_delay": lambda: {"delta": _earlier(drive, "delta", value)},
        "steer_gain": lambda: {"delta": columns["delta"] / value},
        "steer_offset": lambda: {"delta": columns["delta"] - value},
        "sensor_delay": lambda: {name: _earlier(drive, name, value) for name in ("T", "delta")},
        "drive_gain": lambda: {"T": columns["T"] / value},
        "drive_delay": lambda: {"T": _earlier(drive, "T", value)},
    }
    changed = commands[fault.term]() if fault.term in commands else _misread(drive, fault)
    return replace(drive, columns={**columns, **changed}, sha256="")


def _misread(drive: Drive, fault: InjectedFault) -> dict[str, np.ndarray]:
    """Return the columns that a faulty sensor recorded, and all others."""
    recording = Recording(drive.period, tuple((run.start, run.stop) for run in drive.segments()))
    return fault.built().corrupt(dict(drive.columns), recording)


def _earlier(drive: Drive, channel: str, by: float) -> np.ndarray:
    """Return a channel moved earlier by so many seconds inside each segment, its last value held."""
    out = np.array(drive[channel], dtype=float)
    for rows in drive.segments():
        t = drive["t"][rows]
        out[rows] = np.interp(t + by, t, drive[channel][rows])
    return out


def split_in_blocks(drive: Drive, block: float) -> tuple[Drive, Drive]:
    """Return the even and the odd blocks of time of a drive; no sample is in both.

    Parameters
    ----------
    block : float
        Length of a block [s].

    Raises
    ------
    DriveError
        If the drive has fewer than eight blocks.
    """
    number = np.floor((drive["t"] - drive["t"][0]) / block).astype(int)
    if number.max() < 7:
        what = f"has {number.max() + 1} blocks of {block:g} s, at least 8 are needed"
        raise DriveError(what, where=drive.name, advice="Use a longer recording or --block.")
    even = number % 2 == 0
    return drive.select(even), drive.select(~even)
