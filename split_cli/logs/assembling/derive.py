"""Channels computed from others: only when asked for, and marked as derived."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from split_cli.errors import MapError, nearest_names
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
    "smooth",
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


def smooth(values: np.ndarray) -> np.ndarray:
    """Smooth evenly spaced noisy samples by penalising third differences, shape (N,).

    Notes
    -----
    z = (I + lambda D'D)^-1 x with D the third difference (Whittaker's smoother, the discrete quintic spline),
    lambda by generalised cross-validation: least RSS/(1 - dof/N)^2, dof/N the mean of the filter's frequency
    response. The noise need not be known, only be white. Computed as x - lambda D'(I + lambda DD')^-1 D x, which
    leaves a parabola alone to rounding at any lambda.
    """
    if len(values) < 12:
        return values
    from scipy.linalg import solveh_banded
    from scipy.optimize import minimize_scalar

    third = np.diff(values, n=3)
    bands = _third_difference_bands(len(third))
    frequency = np.linspace(0.0, np.pi, 20001)[1:]
    response = (2.0 - 2.0 * np.cos(frequency)) ** 3

    def correction(log_lambda: float) -> np.ndarray:
        system = np.exp(log_lambda) * bands
        system[-1] += 1.0
        inner = np.exp(log_lambda) * solveh_banded(system, third)
        # D' inner, written out: each third difference reaches four samples.
        out = np.zeros(len(values))
        for shift, weight in enumerate((-1.0, 3.0, -3.0, 1.0)):
            out[shift : shift + len(inner)] += weight * inner
        return out

    def score(log_lambda: float) -> float:
        dof = float(np.mean(1.0 / (1.0 + np.exp(log_lambda) * response)))
        rss = float(np.sum(correction(log_lambda) ** 2))
        return np.log(max(rss, 1e-300)) - 2.0 * np.log(1.0 - dof)

    grid = np.linspace(np.log(1e-4), np.log(1e12), 20)
    best = int(np.argmin([score(point) for point in grid]))
    around = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
    chosen = minimize_scalar(score, bounds=around, method="bounded", options={"xatol": 0.05}).x
    return values - correction(float(chosen))


def _third_difference_bands(count: int) -> np.ndarray:
    """Return DD' of the third difference in upper banded form, shape (4, count): a Toeplitz band."""
    bands = np.empty((4, count))
    for offset, value in enumerate((20.0, -15.0, 6.0, -1.0)):
        bands[3 - offset] = value
    return bands


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


def derivative(values: np.ndarray, period: float) -> np.ndarray:
    """Return d/dt of evenly spaced samples, shape (N,): of fourth order, of second at the two rows of each end."""
    if len(values) < 5:
        return np.gradient(values, period) if len(values) > 1 else np.zeros_like(values)
    slope = np.gradient(values, period, edge_order=2)
    slope[2:-2] = (values[:-4] - 8.0 * values[1:-3] + 8.0 * values[3:-1] - values[4:]) / (12.0 * period)
    return slope


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
