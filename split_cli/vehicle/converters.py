"""Reading parameter files of other projects as vehicles: CommonRoad, F1TENTH, ForzaETH.

Each format is recognised by its keys. What a format does not hold (wheel radius, torque limits, often tyre peaks)
is assumed, marked so and said.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import VehicleError
from split_cli.vehicle.calibration.least_squares import solve
from split_cli.vehicle.parameters import Vehicle, vehicle_from_mapping
from split_cli.vehicle.tire import MagicFormula, lateral_force
from split_cli.yaml_file import read_yaml_mapping

_GRAVITY = 9.81  # what these projects' models use, so that their forces come out the same
_ASSUMED_C = 1.4
_WRAPPERS = ("vehicle_params", "params", "vehicle", "ros__parameters", "bridge", "car", "vehicle_model")


@dataclass(frozen=True)
class TireConversion:
    """How well B, C, D repeat the source's tyre."""

    axle: str
    law: str  # the source's law, in words
    largest_deviation: float  # over +-alpha_max [N]
    at: float  # slip angle of the largest deviation [rad]
    peak: float  # D [N], to compare with


@dataclass(frozen=True)
class Conversion:
    """A converted vehicle."""

    vehicle: Vehicle
    kind: str  # ``CommonRoad``, ``F1TENTH`` or ``ForzaETH``
    tires: tuple[TireConversion, ...]
    assumed: tuple[str, ...]  # what the source does not hold, in words


@dataclass(frozen=True)
class _Tire:
    """One axle's source law: force(slip angle) [N], how it is said, and B, C, D where they are exact."""

    law: str
    force: Callable[[np.ndarray], np.ndarray]
    start: MagicFormula
    free: bool


#: What a reader of a format returns: the mapping of a vehicle file, both axles' laws, what is assumed, in words.
_Read = tuple[dict[str, Any], Sequence[_Tire], list[str]]


def convert_parameters(sources: Sequence[str | Path], *, alpha_max: float = 0.18) -> Conversion:
    """Convert a parameter file, or files that belong together, to a vehicle.

    Parameters
    ----------
    sources : sequence of path
        YAML. Keys of later files are added to those of earlier ones (CommonRoad keeps tyres in a file of its
        own). A CommonRoad ``parameters_tire.yaml`` beside the first file is found by itself.
    alpha_max : float
        Tyres are fitted over +-alpha_max [rad].

    Raises
    ------
    VehicleError
        If a file cannot be read, is of no known kind or lacks what its kind needs.
    """
    content: dict[str, Any] = {}
    for source in sources:
        content |= _read(Path(source))
    where = str(sources[0])
    name = Path(sources[0]).stem
    if {"I_z", "a", "b", "T_sb"} <= content.keys():
        if "tire" not in content:
            beside = Path(sources[0]).with_name("parameters_tire.yaml")
            if not beside.is_file():
                what = "holds no tyre"
                raise VehicleError(what, where=where, advice="Name parameters_tire.yaml as a second file.")
            content |= _read(beside)
        return _finish("CommonRoad", *_commonroad(content, where), name, where, alpha_max)
    if {"C_Pf", "C_Pr"} <= content.keys() or ("l_f" in content and {"C_Sf", "C_Sr"} <= content.keys()):
        return _finish("ForzaETH", *_forzaeth(content, where), str(content.get("model_name", name)), where, alpha_max)
    flat = {_F1TENTH_LONG_NAMES.get(key, key): value for key, value in content.items()}
    if {"C_Sf", "C_Sr", "lf", "lr"} <= flat.keys():
        return _finish("F1TENTH", *_f1tenth(flat, where), name, where, alpha_max)
    shown = ", ".join(sorted(map(str, content))[:8])
    advice = "Known are CommonRoad (I_z, a, b, T_sb), F1TENTH (C_Sf, C_Sr, lf, lr) and ForzaETH (C_Pf, C_Pr)."
    raise VehicleError(f"is of no known kind; its keys begin with {shown}", where=where, advice=advice)


# The C++ simulator of F1TENTH names the same parameters otherwise than the gym.
_F1TENTH_LONG_NAMES = {
    "friction_coeff": "mu",
    "C_S_front": "C_Sf",
    "C_S_rear": "C_Sr",
    "l_cg2front": "lf",
    "l_cg2rear": "lr",
    "height_cg": "h",
    "mass": "m",
    "moment_inertia": "I",
    "max_accel": "a_max",
}
#: Keys of each project, and ours; those in `_OPTIONAL` may be missing.
_COMMONROAD = {
    "m": "mass",
    "I_z": "yaw_inertia",
    "a": "cg_to_front_axle",
    "b": "cg_to_rear_axle",
    "R_w": "wheel_radius",
    "T_se": "drive_split_front",
    "T_sb": "brake_split_front",
    "h_cg": "cg_height",
}
_F1TENTH = {
    "m": "mass",
    "I": "yaw_inertia",
    "lf": "cg_to_front_axle",
    "lr": "cg_to_rear_axle",
    "mu": "friction_coefficient",
    "h": "cg_height",
}
_FORZAETH = {
    "m": "mass",
    "I_z": "yaw_inertia",
    "l_f": "cg_to_front_axle",
    "l_r": "cg_to_rear_axle",
    "h_cg": "cg_height",
    "mu": "friction_coefficient",
}
_OPTIONAL = {"h_cg", "h", "mu"}


def _read(path: Path) -> dict[str, Any]:
    content: Any = read_yaml_mapping(path, VehicleError)
    while isinstance(content, Mapping):
        inner = next((content[key] for key in _WRAPPERS if isinstance(content.get(key), Mapping)), None)
        if inner is None:
            return dict(content)
        content = inner
    advice = "Name the project's YAML file with the parameters."
    raise VehicleError("holds no keys", where=str(path), advice=advice)


def _value(content: Mapping[str, Any], key: str, where: str) -> float:
    if key not in content:
        raise VehicleError(f"lacks {key}", where=where)
    try:
        return float(content[key])
    except (TypeError, ValueError):
        raise VehicleError(f"{key} is {content[key]!r}, a number was expected", where=where) from None


def _axle_loads(m: float, l_f: float, l_r: float) -> tuple[float, float]:
    return m * _GRAVITY * l_r / (l_f + l_r), m * _GRAVITY * l_f / (l_f + l_r)


def _published(content: Mapping[str, Any], names: Mapping[str, str], where: str) -> dict[str, Any]:
    """Return our keys with what a source says of them."""
    there = {ours: theirs for theirs, ours in names.items() if theirs in content or theirs not in _OPTIONAL}
    return {ours: {"value": _value(content, theirs, where), "source": "published"} for ours, theirs in there.items()}


def _commonroad(content: Mapping[str, Any], where: str) -> _Read:
    """CommonRoad: Althoff, Koschi, Manzinger (2017), "CommonRoad: Vehicle Models", tables of parameters.

    Pure lateral slip: D = p_dy1 F_z, C = p_cy1, E = p_ey1, B C D = |p_ky1| F_z, without shifts and camber.
    """

    def get(key: str, of: Mapping[str, Any] = content) -> float:
        return _value(of, key, where)

    tire = content["tire"]
    loads = _axle_loads(get("m"), get("a"), get("b"))
    mu, C, E, k = get("p_dy1", tire), get("p_cy1", tire), get("p_ey1", tire), abs(get("p_ky1", tire))
    tires = [_pacejka(k / (C * mu), C, mu * load, E) for load in loads]
    mapping = _published(content, _COMMONROAD, where) | _published(tire, {"p_dy1": "friction_coefficient"}, where)
    longitudinal = content.get("longitudinal") or {}
    limit = _value(longitudinal, "a_max", where) * get("m") * get("R_w")
    mapping |= _assumed(max_torque=limit, max_brake_torque=limit)
    return mapping, tires, ["torque limits from the largest acceleration a_max", "no drag, no rolling resistance"]


def _f1tenth(content: Mapping[str, Any], where: str) -> _Read:
    """F1TENTH gym and simulator: F_y = mu C_S F_z alpha, C_S in 1/rad, as in CommonRoad's single track."""

    def get(key: str) -> float:
        return _value(content, key, where)

    mu = get("mu")
    loads = _axle_loads(get("m"), get("lf"), get("lr"))
    tires = tuple(_linear(mu * get(key) * load, mu * load) for key, load in zip(("C_Sf", "C_Sr"), loads, strict=True))
    mapping = _published(content, _F1TENTH, where) | _small_car(content, get("m"))
    return mapping, tires, [*_SMALL_CAR_ASSUMED, "C = 1.4: the source's tyre is linear"]


def _forzaeth(content: Mapping[str, Any], where: str) -> _Read:
    """ForzaETH race stack, On-Track-SysID: C_Pf, C_Pr = [B, C, D, E], D over axle load; or linear C_Sf, C_Sr."""

    def get(key: str) -> float:
        return _value(content, key, where)

    loads = _axle_loads(get("m"), get("l_f"), get("l_r"))
    mu = get("mu") if "mu" in content else 1.0
    assumed = list(_SMALL_CAR_ASSUMED)
    if "C_Pf" in content:
        tires = tuple(
            _pacejka(*_four(content[key], key, load, where)) for key, load in zip(("C_Pf", "C_Pr"), loads, strict=True)
        )
    else:
        tires = tuple(_linear(get(key) * load, mu * load) for key, load in zip(("C_Sf", "C_Sr"), loads, strict=True))
        assumed.append("C = 1.4: the source's tyre is linear")
    return _published(content, _FORZAETH, where) | _small_car(content, get("m")), tires, assumed


def _four(values: Any, key: str, load: float, where: str) -> tuple[float, float, float, float]:
    try:
        B, C, D, E = (float(value) for value in values)
    except (TypeError, ValueError):
        raise VehicleError(f"{key} is {values!r}, [B, C, D, E] was expected", where=where) from None
    return B, C, D * load, E


_SMALL_CAR_ASSUMED = (
    "wheel radius 0.05 m, torque shared evenly",
    "torque limits from the largest acceleration a_max",
    "no drag, no rolling resistance",
)


def _small_car(content: Mapping[str, Any], mass: float) -> dict[str, Any]:
    limit = float(content.get("a_max", 5.0)) * mass * 0.05
    return _assumed(wheel_radius=0.05, drive_split_front=0.5, max_torque=limit, max_brake_torque=limit)


def _assumed(**values: float) -> dict[str, Any]:
    return {key: {"value": value, "source": "assumed"} for key, value in values.items()}


def _pacejka(B: float, C: float, D: float, E: float) -> _Tire:
    law = f"B = {B:.4g}, C = {C:.4g}, D = {D:.4g} N, E = {E:.4g}"
    start = MagicFormula(B, min(C, 1.95), D)
    return _Tire(law, lambda alpha: full_magic_formula(B, C, D, E, alpha), start, free=E != 0.0 or C >= 2.0)


def _linear(stiffness: float, peak: float) -> _Tire:
    start = MagicFormula(stiffness / (_ASSUMED_C * peak), _ASSUMED_C, peak)
    return _Tire(f"linear, {stiffness:.4g} N/rad", lambda alpha: stiffness * alpha, start, free=False)


def full_magic_formula(B: float, C: float, D: float, E: float, slip_angle: np.ndarray) -> np.ndarray:
    """Return D sin(C atan(B a - E (B a - atan(B a)))) [N], Pacejka's formula with curvature E."""
    reduced = B * np.asarray(slip_angle)
    return D * np.sin(C * np.arctan(reduced - E * (reduced - np.arctan(reduced))))


def fit_magic_formula(
    force: Callable[[np.ndarray], np.ndarray], start: MagicFormula, alpha_max: float
) -> tuple[MagicFormula, float, float]:
    """Fit B, C, D to a force law over +-alpha_max.

    Returns
    -------
    MagicFormula
    float
        Largest deviation [N].
    float
        Slip angle where it is [rad].

    Notes
    -----
    Least squares on an even grid; C stays in (0, 1.99), where the force keeps its sign.
    """
    grid = np.linspace(-alpha_max, alpha_max, 361)
    target = force(grid)

    def residual(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        B, C, D = np.exp(p[0]), p[1], np.exp(p[2])
        u = np.arctan(B * grid)
        sine, cosine = np.sin(C * u), np.cos(C * u)
        jacobian = np.column_stack([D * cosine * C * B * grid / (1.0 + (B * grid) ** 2), D * cosine * u, D * sine])
        return D * sine - target, jacobian

    lower, upper = np.array([-np.inf, 0.05, -np.inf]), np.array([np.inf, 1.99, np.inf])
    begins = [start, *(MagicFormula(start.B * b, c, start.D) for b in (0.5, 2.0) for c in (1.1, 1.5, 1.9))]
    size = float(np.max(np.abs(target)))
    # A scale of the whole force makes the loss quadratic everywhere: there are no outliers here.
    fits = [
        solve(residual, np.array([np.log(t.B), t.C, np.log(t.D)]), lower, upper, scale=size, iterations=300)
        for t in begins
    ]
    p = min(fits, key=lambda fit: fit.cost).parameters
    tire = MagicFormula(float(np.exp(p[0])), float(p[1]), float(np.exp(p[2])))
    return tire, *_deviation(force, tire, grid)


def _deviation(force: Callable[[np.ndarray], np.ndarray], tire: MagicFormula, grid: np.ndarray) -> tuple[float, float]:
    error = np.abs(lateral_force(tire.B, tire.C, tire.D, grid) - force(grid))
    return float(error.max()), float(abs(grid[error.argmax()]))


def _finish(
    kind: str,
    mapping: dict[str, Any],
    tires: Sequence[_Tire],
    assumed: list[str],
    name: str,
    where: str,
    alpha_max: float,
) -> Conversion:
    reports = []
    for axle, source in zip(("front", "rear"), tires, strict=True):
        if source.free:
            tire, deviation, at = fit_magic_formula(source.force, source.start, alpha_max)
        else:
            tire = source.start
            deviation, at = _deviation(source.force, tire, np.linspace(-alpha_max, alpha_max, 361))
        note = f"from {source.law}; off by at most {deviation:.3g} N up to {alpha_max:g} rad"
        mapping[f"{axle}_tire"] = {
            "B": {"value": tire.B, "source": "published", "note": note},
            "C": {"value": tire.C, "source": "assumed" if source.law.startswith("linear") else "published"},
            "D": {"value": tire.D, "source": "assumed" if source.law.startswith("linear") else "published"},
        }
        reports.append(TireConversion(axle, source.law, deviation, at, tire.D))
    vehicle = vehicle_from_mapping({"name": name, **mapping}, where=where)
    return Conversion(vehicle, kind, tuple(reports), tuple(assumed))
