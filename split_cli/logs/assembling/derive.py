"""Channels computed from others: only when asked for, and marked as derived."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from split_cli.errors import MapError, nearest_names
from split_cli.logs.assembling.dead_reckoning import TOLERANCE, lateral_velocity_from_accelerations
from split_cli.logs.assembling.smoothing import derivative, smooth
from split_cli.logs.checking.kinematics import Kinematics
from split_cli.logs.checking.straights import course_of, straight_rows, straight_stretches
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import slip_angles
from split_cli.vehicle.tire import lateral_force

__all__ = [
    "DERIVATIONS",
    "Derivation",
    "Derived",
    "derivation_named",
    "derivations_for",
    "reachable",
    "torque_from_acceleration",
    "torque_from_current",
    "torque_from_throttle_and_brake",
    "velocity_from_pose",
]


@dataclass(frozen=True)
class Derived:
    """What a derivation made.

    Attributes
    ----------
    columns : mapping of str to ndarray
        Channel to samples `(N,)`, SI.
    how : str
        For the drive's metadata, after ``derived: ``.
    warning : str
        What the reader must know before using it.
    keeps_noise : bool
        Whether its noise is that of the channel it replaces.
    """

    columns: Mapping[str, np.ndarray]
    how: str
    warning: str = ""
    keeps_noise: bool = False


@dataclass(frozen=True)
class DerivationInputs:
    """What a derivation may use.

    Attributes
    ----------
    columns : mapping of str to ndarray
        Of the drive so far, SI, at the CG.
    period : float
        [s].
    segments : list of slice
    vehicle : Vehicle or None
    settings : mapping
        The map's `derivations` entry.
    time : ndarray, shape (N,), or None
        Of every row [s]; None counts rows.
    """

    columns: Mapping[str, np.ndarray]
    period: float
    segments: list[slice]
    vehicle: Vehicle | None
    settings: Mapping[str, Any]
    time: np.ndarray | None = None


@dataclass(frozen=True)
class Derivation:
    """A way to compute channels.

    Attributes
    ----------
    name : str
        As ``--derive`` takes it.
    makes, needs : tuple of str
        Channels.
    settings : tuple of str
        Keys that the map may give.
    run : callable
        DerivationInputs to Derived.
    choices : tuple of (str, str)
        Settings that name a channel it needs too, each with its default.
    """

    name: str
    makes: tuple[str, ...]
    needs: tuple[str, ...]
    settings: tuple[str, ...]
    run: Callable[[DerivationInputs], Derived]
    choices: tuple[tuple[str, str], ...] = ()

    def inputs(self, settings: Mapping[str, Any], mapped: Collection[str]) -> tuple[str, ...]:
        """Return the channels it needs under the map's settings; a default that is not mapped is left out."""
        chosen = [str(settings.get(key, default if default in mapped else "")) for key, default in self.choices]
        return tuple(dict.fromkeys([*self.needs, *filter(None, chosen)]))


def torque_from_acceleration(
    ax: np.ndarray, vx: np.ndarray, vy: np.ndarray, r: np.ndarray, delta: np.ndarray, vehicle: Vehicle
) -> np.ndarray:
    """Return the wheel torque that the nominal model needs for a longitudinal specific force [N m], shape (N,).

    Parameters
    ----------
    ax : ndarray, shape (N,)
        Specific force at the CG [m/s^2]: v_x' - v_y r on a flat road.
    vx, vy, r, delta : ndarray, shape (N,)
    vehicle : Vehicle
        Its terms are not considered, only the plain nominal model.

    Notes
    -----
    m a_x = F_rx + F_fx cos delta - F_fy sin delta - C_w v_x^2 solved for T, exact for any steer angle:
    T = r_e (m a_x + C_w v_x^2 + C_rr + C_fr cos delta + F_fy sin delta)/(1 - kappa + kappa cos delta), kappa by
    the sign of the force.
    """
    slip_front, _ = slip_angles(vx, vy, r, delta, vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle)
    tire = vehicle.front_tire
    front_y = lateral_force(tire.B, tire.C, tire.D, slip_front)
    force = (
        vehicle.mass * ax
        + vehicle.drag_coefficient * vx * vx
        + vehicle.rolling_resistance_rear
        + vehicle.rolling_resistance_front * np.cos(delta)
        + front_y * np.sin(delta)
    )
    kappa = np.where(force < 0.0, vehicle.brake_split_front, vehicle.drive_split_front)
    return vehicle.wheel_radius * force / (1.0 - kappa + kappa * np.cos(delta))


def torque_from_throttle_and_brake(
    throttle: np.ndarray,
    brake: np.ndarray,
    vx: np.ndarray,
    *,
    drive_map: np.ndarray,
    brake_gain: float,
    wheel_radius: float,
    max_power: float | None = None,
) -> np.ndarray:
    """Return the wheel torque of a pedal map [N m], shape (N,).

    Parameters
    ----------
    throttle : ndarray, shape (N,)
        0 to 1.
    brake : ndarray, shape (N,)
        Pressure [Pa] or pedal 0 to 1.
    vx : ndarray, shape (N,)
        [m/s].
    drive_map : ndarray, shape (K, 2)
        Throttle [1] and drive torque at the wheels [N m], linear in between.
    brake_gain : float
        Brake torque at the wheels for one unit of `brake` [N m/Pa] or [N m].
    wheel_radius : float
        [m].
    max_power : float, optional
        At the wheels [W].
    """
    drive = np.interp(throttle, drive_map[:, 0], drive_map[:, 1])
    if max_power is not None:
        drive = np.minimum(drive, max_power * wheel_radius / np.maximum(np.abs(vx), 0.1))
    return drive - brake_gain * np.maximum(brake, 0.0) * np.tanh(vx / 0.1)


def torque_from_current(
    current: np.ndarray, torque_constant: float, gear_ratio: float, efficiency: float = 1.0
) -> np.ndarray:
    """Return the wheel torque of a motor [N m], shape (N,).

    Parameters
    ----------
    current : ndarray, shape (N,)
        Motor current, driving positive [A].
    torque_constant : float
        [N m/A].
    gear_ratio : float
        Motor turns a wheel turn [1].
    efficiency : float
        Of the gears [1]; losses help braking.
    """
    return current * torque_constant * gear_ratio * np.where(current >= 0.0, efficiency, 1.0 / efficiency)


def velocity_from_pose(
    X: np.ndarray, Y: np.ndarray, yaw: np.ndarray, period: float, segments: list[slice]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return v_x, v_y [m/s] and r [rad/s], shapes (N,), from a smoothed pose.

    Parameters
    ----------
    X, Y : ndarray, shape (N,)
        Position of the CG [m].
    yaw : ndarray, shape (N,)
        Unwrapped [rad].
    period : float
        [s].
    segments : list of slice
        Stretches without a gap.

    Notes
    -----
    Each of X, Y, yaw is smoothed as much as its own noise asks for (see `smooth`), differentiated by differences
    of fourth order, and turned into the vehicle's frame by the smoothed yaw.
    """
    out = np.empty((3, len(X)))
    for run in segments:
        smoothed = [smooth(channel[run]) for channel in (X, Y, yaw)]
        dX, dY, dyaw = (derivative(channel, period) for channel in smoothed)
        cosine, sine = np.cos(smoothed[2]), np.sin(smoothed[2])
        out[:, run] = cosine * dX + sine * dY, cosine * dY - sine * dX, dyaw
    return out[0], out[1], out[2]


def _require_vehicle(situation: DerivationInputs, name: str) -> Vehicle:
    if situation.vehicle is None:
        raise MapError(f"--derive {name} needs the vehicle", advice="Give it with --vehicle.")
    return situation.vehicle


def _settings_number(situation: DerivationInputs, name: str, key: str, default: float | None = None) -> float:
    value = situation.settings.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MapError(
            f"--derive {name} needs the number {key}",
            advice=f"Write `derivations: {{{name}: {{{key}: ...}}}}` into the map.",
        )
    return float(value)


def _run_torque_from_acceleration(situation: DerivationInputs) -> Derived:
    vehicle = _require_vehicle(situation, "torque-from-acceleration")
    c = situation.columns
    source = situation.settings.get("acceleration", "ax" if "ax" in c else "vx")
    if source == "ax":
        ax = c["ax"] - float(situation.settings.get("offset", 0.0))
        how = "from measured a_x"
    elif source == "vx":
        ax = np.empty(len(c["vx"]))
        for run in situation.segments:
            ax[run] = derivative(smooth(c["vx"][run]), situation.period) - c["vy"][run] * c["r"][run]
        how = "from dv_x/dt - v_y r of smoothed v_x"
    else:
        raise MapError(
            f"derivations.torque_from_acceleration.acceleration is {source!r}", advice="It is ax or vx."
        )
    T = torque_from_acceleration(ax, c["vx"], c["vy"], c["r"], c["delta"], vehicle)
    warning = (
        "T is derived from acceleration: the longitudinal label holds noise and what the derivation got wrong, "
        "and says nothing about the drive train"
    )
    return Derived({"T": T}, f"torque {how} by the nominal model of {vehicle.name}", warning)


def _run_torque_from_pedals(situation: DerivationInputs) -> Derived:
    vehicle = _require_vehicle(situation, "torque-from-throttle-and-brake")
    name = "torque_from_throttle_and_brake"
    settings = situation.settings
    throttle, brake = str(settings.get("throttle", "throttle")), str(settings.get("brake", "brake"))
    no_brake = "brake" not in settings and brake not in situation.columns
    for channel in (throttle,) if no_brake else (throttle, brake):
        if channel not in situation.columns:
            raise MapError(f"{name} needs {channel}", advice=nearest_names(channel, situation.columns))
    points = settings.get("drive_map", [[0.0, 0.0], [1.0, vehicle.max_torque]])
    drive_map = np.asarray(points, dtype=float)
    if drive_map.ndim != 2 or drive_map.shape[1] != 2 or np.any(np.diff(drive_map[:, 0]) <= 0):
        raise MapError(
            f"{name}.drive_map must be [[throttle, torque], ...] with rising throttle",
            advice="For example `drive_map: [[0, 0], [1, 2600]]`, torque in N m at the wheels.",
        )
    full_scale = _settings_number(situation, name, "brake_full_scale", 1.0)
    gain = _settings_number(situation, name, "brake_gain", vehicle.max_brake_torque / full_scale)
    power = settings.get("max_power")
    T = torque_from_throttle_and_brake(
        situation.columns[throttle],
        np.zeros_like(situation.columns["vx"]) if no_brake else situation.columns[brake],
        situation.columns["vx"],
        drive_map=drive_map,
        brake_gain=gain,
        wheel_radius=vehicle.wheel_radius,
        max_power=None if power is None else float(power),
    )
    how = f"torque from {throttle} by a map to {drive_map[-1, 1]:g} N m"
    warning = "T follows from pedal maps: their errors appear in the longitudinal label"
    if no_brake:
        return Derived({"T": T}, f"{how}, no brake recorded", f"{warning}; no brake is recorded, none is in T")
    return Derived({"T": T}, f"{how} and {brake} times {gain:.4g} N m a unit", warning)


def _run_torque_from_current(situation: DerivationInputs) -> Derived:
    name = "torque_from_current"
    channel = str(situation.settings.get("current", "motor_current"))
    if channel not in situation.columns:
        raise MapError(f"{name} needs {channel}", advice=nearest_names(channel, situation.columns))
    constant = _settings_number(situation, name, "torque_constant")
    ratio = _settings_number(situation, name, "gear_ratio")
    efficiency = _settings_number(situation, name, "efficiency", 1.0)
    T = torque_from_current(situation.columns[channel], constant, ratio, efficiency)
    return Derived(
        {"T": T}, f"torque from {channel} times {constant:g} N m/A times {ratio:g}, efficiency {efficiency:g}"
    )


def _run_velocity_from_pose(situation: DerivationInputs) -> Derived:
    c = situation.columns
    vx, vy, r = velocity_from_pose(c["X"], c["Y"], c["yaw"], situation.period, situation.segments)
    made = {"vx": vx, "vy": vy, "r": r}
    only = situation.settings.get("channels", [name for name in made if name not in c])
    for name in only:
        if name not in made:
            raise MapError(f"velocity_from_pose.channels names {name!r}", advice=nearest_names(str(name), made))
    return Derived(
        {name: made[name] for name in only},
        "from X, Y, yaw smoothed by their noise",
        f"{', '.join(only)} derived from pose: their noise is not white and not known",
    )


def _run_lateral_velocity_from_sideslip(situation: DerivationInputs) -> Derived:
    c = situation.columns
    return Derived({"vy": c["vx"] * np.tan(c["sideslip"])}, "v_x times the tangent of the measured sideslip angle")


def _run_lateral_velocity_from_straights(situation: DerivationInputs) -> Derived:
    columns = situation.columns if situation.time is None else {**situation.columns, "t": situation.time}
    k = Kinematics(columns, situation.period, situation.segments)
    stretches = straight_stretches(
        k.times(), k.signal("vx"), k.signal("vy"), straight_rows(k), situation.period, situation.segments
    )
    course = course_of(stretches)
    if course is None:
        raise MapError(
            "--derive lateral-velocity-from-straights needs straights, and the car hardly goes straight",
            advice="Give an `offset` for vy in the map instead.",
        )
    vx, vy = situation.columns["vx"], situation.columns["vy"]
    return Derived(
        {"vy": vy - vx * np.tan(course.at(k.times()))},
        f"v_y less its direction on straights ({course.words()}; {1e3 * course.scatter:.1f} mrad are left)",
        "" if course.count >= 6 else f"v_y was corrected on {course.count} straights: a course over time takes 6",
        keeps_noise=True,
    )


def _run_lateral_velocity_from_accelerations(situation: DerivationInputs) -> Derived:
    name = "lateral-velocity-from-accelerations"
    vehicle = _require_vehicle(situation, name)
    made = lateral_velocity_from_accelerations(situation.columns, situation.period, situation.segments, vehicle)
    speed = np.maximum(np.abs(situation.columns["vx"]), vehicle.minimum_speed)
    sure = made.std <= TOLERANCE * speed if made is not None else np.zeros(len(speed), dtype=bool)
    if made is None or not sure.any():
        raise MapError(
            f"--derive {name} needs gentle driving, straight or nearly so, and finds too little",
            advice="Integrated accelerations drift between such moments. Record v_y, the sideslip or a pose.",
        )
    if not made.belongs:
        raise MapError(
            f"--derive {name}: a_y {made.doubt}",
            advice="Its unit, sign or frame is wrong, it is late against r, or it comes too slowly for this car.",
        )
    std = made.std[sure]
    rest = f"; {1.0 - sure.mean():.0%} of the rows left out, less sure than {TOLERANCE:g} rad"
    return Derived(
        {"vy": np.where(sure, made.vy, np.nan), "vy_std": made.std},
        "v_y from a_y - v_x r, held where driving is gentle; standard deviation "
        f"{np.median(std):.2g} m/s typical, {np.max(std):.2g} worst{rest if not sure.all() else ''}",
        f"v_y is derived from a_y ({made.words()}): its label repeats a_y and the tyre forces of the nominal "
        "model. Roll and bank that follow the turns, a clock between a_y and r, and the accelerometer's place "
        "stay in it",
    )


def _run_yaw_rate_from_yaw(situation: DerivationInputs) -> Derived:
    made = np.empty(len(situation.columns["yaw"]))
    for run in situation.segments:
        made[run] = derivative(smooth(situation.columns["yaw"][run]), situation.period)
    return Derived({"r": made}, "from smoothed yaw")


def _run_acceleration_from_velocity(situation: DerivationInputs) -> Derived:
    c = situation.columns
    made = {"ax": np.empty(len(c["vx"])), "ay": np.empty(len(c["vx"]))}
    for run in situation.segments:
        vx, vy = smooth(c["vx"][run]), smooth(c["vy"][run])
        made["ax"][run] = derivative(vx, situation.period) - vy * c["r"][run]
        made["ay"][run] = derivative(vy, situation.period) + vx * c["r"][run]
    return Derived(
        {name: values for name, values in made.items() if name not in c}, "from smoothed velocity, flat road"
    )


DERIVATIONS: dict[str, Derivation] = {
    entry.name: entry
    for entry in (
        Derivation(
            "velocity-from-pose", ("vx", "vy", "r"), ("X", "Y", "yaw"), ("channels",), _run_velocity_from_pose
        ),
        Derivation(
            "lateral-velocity-from-sideslip",
            ("vy",),
            ("vx", "sideslip"),
            (),
            _run_lateral_velocity_from_sideslip,
        ),
        Derivation(
            "lateral-velocity-from-straights",
            ("vy",),
            ("vx", "vy", "r"),
            (),
            _run_lateral_velocity_from_straights,
        ),
        Derivation("yaw-rate-from-yaw", ("r",), ("yaw",), (), _run_yaw_rate_from_yaw),
        Derivation(
            "lateral-velocity-from-accelerations",
            ("vy",),
            ("vx", "r", "ay"),
            (),
            _run_lateral_velocity_from_accelerations,
        ),
        Derivation(
            "acceleration-from-velocity", ("ax", "ay"), ("vx", "vy", "r"), (), _run_acceleration_from_velocity
        ),
        Derivation(
            "torque-from-acceleration",
            ("T",),
            ("vx", "vy", "r", "delta"),
            ("acceleration", "offset"),
            _run_torque_from_acceleration,
            (("acceleration", "ax"),),
        ),
        Derivation(
            "torque-from-throttle-and-brake",
            ("T",),
            ("vx",),
            ("throttle", "brake", "drive_map", "brake_gain", "brake_full_scale", "max_power"),
            _run_torque_from_pedals,
            (("throttle", "throttle"), ("brake", "brake")),
        ),
        Derivation(
            "torque-from-current",
            ("T",),
            (),
            ("current", "torque_constant", "gear_ratio", "efficiency"),
            _run_torque_from_current,
            (("current", "motor_current"),),
        ),
    )
}
"""In the order in which they run: velocities before what needs them."""

#: Derivations with what they are asked for, the most trustworthy first.
_CHOICES = (
    ("lateral-velocity-from-sideslip", {"vy"}),
    ("velocity-from-pose", {"vx", "vy"}),
    ("yaw-rate-from-yaw", {"r"}),
    ("lateral-velocity-from-accelerations", {"vy"}),
)


def derivation_named(name: str) -> Derivation:
    """Return a derivation by name; underscores may stand for hyphens.

    Raises
    ------
    MapError
        If there is none; the nearest are told.
    """
    spelled = name.replace("_", "-")
    if spelled not in DERIVATIONS:
        raise MapError(f"no derivation {name!r}", advice=nearest_names(spelled, DERIVATIONS))
    return DERIVATIONS[spelled]


def reachable(recorded: Collection[str]) -> set[str]:
    """Return the channels that are recorded or that some derivation makes of them, directly or by steps."""
    reached: set[str] = set()
    step = set(recorded)
    while step - reached:
        reached |= step
        step = {made for entry in DERIVATIONS.values() if set(entry.needs) <= reached for made in entry.makes}
    return reached


def derivations_for(missing: Collection[str], mapped: Collection[str]) -> list[str]:
    """Return the derivations that a log asks for, in the order to run them.

    A torque takes nothing that a drive may lack, and stands last.
    """
    there, chosen = set(mapped), []
    for name, wanted in _CHOICES:
        entry = DERIVATIONS[name]
        if wanted & set(missing) - there and set(entry.needs) <= there:
            chosen.append(name)
            there |= set(entry.makes)
    return [*chosen, "torque-from-acceleration"] if "T" in missing else chosen
