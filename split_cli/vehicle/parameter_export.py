"""Writing vehicles as parameter files of other projects: the reverse of `converters`."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from split_cli.errors import VehicleError, nearest_names
from split_cli.vehicle.converters import full_magic_formula
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import MagicFormula, lateral_force

_GRAVITY = 9.81  # as in `converters`, so that forces come out the same


@dataclass(frozen=True)
class ForeignParameters:
    """A vehicle in another project's words."""

    kind: str
    content: dict[str, Any]  # keys and numbers of the file
    # Largest difference of the lateral force of the front and the rear axle over +-alpha_max [N].
    deviations: tuple[float, float]
    lost: tuple[str, ...]  # what the format has no place for, in words


def foreign_parameters(vehicle: Vehicle, kind: str, alpha_max: float = 0.18) -> ForeignParameters:
    """Return the parameters of a vehicle as ``f1tenth``, ``forzaeth`` or ``commonroad`` has them.

    Parameters
    ----------
    alpha_max : float
        Forces are compared over +-alpha_max [rad].

    Raises
    ------
    VehicleError
        If there is no such format.

    Notes
    -----
    ForzaETH takes B, C, D/F_z and E = 0 of each axle, exactly. F1TENTH is linear: mu C_S F_z is the slope at no
    slip, mu the mean of D/F_z. CommonRoad has one tyre for both axles, B C D/F_z and D/F_z averaged by load.
    """
    if kind not in KINDS:
        raise VehicleError(f"no format {kind!r} to write", advice=nearest_names(kind, KINDS))
    m, front, rear = vehicle.mass, vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle
    loads = np.array([rear, front]) * m * _GRAVITY / (front + rear)
    tires = (vehicle.front_tire, vehicle.rear_tire)
    content, laws, lost = KINDS[kind](vehicle, loads, tires)
    if vehicle.cg_height is not None:
        content["h_cg" if kind != "f1tenth" else "h"] = float(vehicle.cg_height)
    alpha = np.linspace(-alpha_max, alpha_max, 361)
    front_off, rear_off = (
        float(np.abs(lateral_force(t.B, t.C, t.D, alpha) - law(alpha)).max())
        for t, law in zip(tires, laws, strict=True)
    )
    lost += ["drag, rolling resistance and brake torque"]
    lost += [f"effects: {', '.join(e.term for e in vehicle.effects)}"] if vehicle.effects else []
    return ForeignParameters(kind, content, (front_off, rear_off), tuple(lost))


_Law = Callable[[np.ndarray], np.ndarray]
_Parts = tuple[dict[str, Any], list[_Law], list[str]]


def _largest_acceleration(vehicle: Vehicle) -> float:
    return vehicle.max_torque / (vehicle.mass * vehicle.wheel_radius)


def _f1tenth(vehicle: Vehicle, loads: np.ndarray, tires: tuple[MagicFormula, MagicFormula]) -> _Parts:
    mu = float(sum(t.D for t in tires) / loads.sum())
    slopes = [t.B * t.C * t.D for t in tires]
    stiffness = [slope / (mu * load) for slope, load in zip(slopes, loads.tolist(), strict=True)]
    content = {
        "mu": mu,
        "C_Sf": stiffness[0],
        "C_Sr": stiffness[1],
        "lf": vehicle.cg_to_front_axle,
        "lr": vehicle.cg_to_rear_axle,
        "m": vehicle.mass,
        "I": vehicle.yaw_inertia,
        "a_max": _largest_acceleration(vehicle),
    }
    laws: list[_Law] = [partial(np.multiply, slope) for slope in slopes]
    return content, laws, ["the tyres' saturation: the format is linear", "limits of steering and size of the car"]


def _forzaeth(vehicle: Vehicle, loads: np.ndarray, tires: tuple[MagicFormula, MagicFormula]) -> _Parts:
    rows = [[t.B, t.C, t.D / load, 0.0] for t, load in zip(tires, loads.tolist(), strict=True)]
    content: dict[str, Any] = {
        "C_Pf": rows[0],
        "C_Pr": rows[1],
        "I_z": vehicle.yaw_inertia,
        "l_f": vehicle.cg_to_front_axle,
        "l_r": vehicle.cg_to_rear_axle,
        "l_wb": vehicle.wheelbase,
        "m": vehicle.mass,
        "mu": 1.0,
        "a_max": _largest_acceleration(vehicle),
        "model_name": vehicle.name,
        "tire_model": "pacejka",
    }
    laws: list[_Law] = [
        partial(full_magic_formula, r[0], r[1], r[2] * load, 0.0) for r, load in zip(rows, loads.tolist(), strict=True)
    ]
    return content, laws, ["wheel radius and torque split"]


def _commonroad(vehicle: Vehicle, loads: np.ndarray, tires: tuple[MagicFormula, MagicFormula]) -> _Parts:
    mu = float(sum(t.D for t in tires) / loads.sum())
    slope = float(sum(t.B * t.C * t.D for t in tires) / loads.sum())
    C = float(np.average([t.C for t in tires], weights=loads))
    content: dict[str, Any] = {
        "m": vehicle.mass,
        "I_z": vehicle.yaw_inertia,
        "a": vehicle.cg_to_front_axle,
        "b": vehicle.cg_to_rear_axle,
        "R_w": vehicle.wheel_radius,
        "T_sb": vehicle.brake_split_front,
        "T_se": vehicle.drive_split_front,
        "longitudinal": {"a_max": _largest_acceleration(vehicle)},
        "tire": {"p_cy1": C, "p_dy1": mu, "p_ey1": 0.0, "p_ky1": -slope},
    }
    laws: list[_Law] = [partial(full_magic_formula, slope / (C * mu), C, mu * load, 0.0) for load in loads.tolist()]
    return content, laws, ["the difference of the axles' tyres", "limits of steering and size of the car"]


KINDS: dict[str, Callable[..., _Parts]] = {"f1tenth": _f1tenth, "forzaeth": _forzaeth, "commonroad": _commonroad}
