"""Wheel torque computed from how the car moved, from pedals or from a motor's current."""

import numpy as np

from split_cli.errors import MapError, nearest_names
from split_cli.logs.assembling.derivation import Derivation, DerivationInputs, Derived
from split_cli.logs.assembling.smoothing import derivative, smooth
from split_cli.logs.checking.checks import LEAST_CORRELATION
from split_cli.logs.checking.kinematics import fit_slope
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import slip_angles
from split_cli.vehicle.tire import lateral_force


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


def _run_torque_from_acceleration(situation: DerivationInputs) -> Derived:
    vehicle = situation.require_vehicle("torque-from-acceleration")
    c = situation.columns
    source = situation.settings.get("acceleration", "ax" if "ax" in c else "vx")
    apart = _contradiction(situation) if "acceleration" not in situation.settings and source == "ax" else ""
    source = "vx" if apart else source
    if source == "ax":
        ax = c["ax"] - float(situation.settings.get("offset", 0.0))
        how = "from measured a_x"
    elif source == "vx":
        ax = _acceleration_of_the_velocity(situation)
        how = "from dv_x/dt - v_y r of smoothed v_x"
    else:
        advice = "It is ax or vx."
        raise MapError(f"derivations.torque_from_acceleration.acceleration is {source!r}", advice=advice)
    T = torque_from_acceleration(ax, c["vx"], c["vy"], c["r"], c["delta"], vehicle)
    warning = (
        "T is derived from acceleration: the longitudinal label holds noise and what the derivation got wrong, "
        "and says nothing about the drive train"
    )
    warning += f"; {apart}" if apart else ""
    return Derived({"T": T}, f"torque {how} by the nominal model of {vehicle.name}", warning)


def _acceleration_of_the_velocity(situation: DerivationInputs) -> np.ndarray:
    """Return dv_x/dt - v_y r of smoothed v_x [m/s^2], shape (N,)."""
    c = situation.columns
    ax = np.empty(len(c["vx"]))
    for run in situation.segments:
        ax[run] = derivative(smooth(c["vx"][run]), situation.period) - c["vy"][run] * c["r"][run]
    return ax


def _contradiction(situation: DerivationInputs) -> str:
    """Say that a measured a_x does not follow the velocity and tells no torque; empty where it does."""
    measured = situation.columns["ax"].copy()
    for run in situation.segments:
        measured[run] = smooth(measured[run])
    found = fit_slope(measured, _acceleration_of_the_velocity(situation), np.ones(len(measured), dtype=bool))
    if found is None or found.correlation >= LEAST_CORRELATION:
        return ""
    return f"measured a_x and dv_x/dt - v_y r correlate by {found.correlation:.2f} only, so a_x was not used for T"


def _run_torque_from_pedals(situation: DerivationInputs) -> Derived:
    vehicle = situation.require_vehicle("torque-from-throttle-and-brake")
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
        advice = "For example `drive_map: [[0, 0], [1, 2600]]`, torque in N m at the wheels."
        raise MapError(f"{name}.drive_map must be [[throttle, torque], ...] with rising throttle", advice=advice)
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


def _settings_number(situation: DerivationInputs, name: str, key: str, default: float | None = None) -> float:
    value = situation.settings.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        advice = f"Write `derivations: {{{name}: {{{key}: ...}}}}` into the map."
        raise MapError(f"--derive {name} needs the number {key}", advice=advice)
    return float(value)


TORQUES = (
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
"""In the order in which they run."""
