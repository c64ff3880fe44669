"""The vehicle file: parameters of the nominal single track, with where each value comes from."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from split_cli.errors import VehicleError, nearest_names
from split_cli.files import atomic_write_text
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.library import library_names, library_path
from split_cli.vehicle.tire import MagicFormula
from split_cli.yaml_file import read_yaml_mapping

VALUE_SOURCES = ("published", "assumed", "calibrated")


@dataclass(frozen=True)
class EffectSpec:
    """A named physical term that the nominal model includes.

    Attributes
    ----------
    term : str
        Id of the catalogue, for example ``aero_drag``.
    parameters : mapping of str to float
        What the real car has beyond the plain nominal vehicle, SI.
    variant : str
        Where physics allows several; empty for the term's default.
    """

    term: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    variant: str = ""

    @property
    def label(self) -> str:
        """``term`` or ``term (variant)``."""
        return f"{self.term} ({self.variant})" if self.variant else self.term


@dataclass(frozen=True)
class Vehicle:
    """Parameters of the nominal single-track model, SI units.

    Attributes
    ----------
    mass : float
        m [kg].
    yaw_inertia : float
        I_z [kg m^2].
    cg_to_front_axle, cg_to_rear_axle : float
        l_f, l_r [m].
    wheel_radius : float
        Rolling radius r_e [m].
    drive_split_front : float
        kappa [1], share of the torque at the front axle where T >= 0.
    brake_split_front : float
        The same where T < 0 [1].
    front_tire, rear_tire : MagicFormula
        Whole-axle lateral force.
    max_torque, max_brake_torque : float
        Largest total wheel torque, driving and braking (as a positive number) [N m].
    rolling_resistance_front, rolling_resistance_rear : float
        C_fr, C_rr [N].
    drag_coefficient : float
        C_w [N/(m/s)^2].
    cg_height : float or None
        [m]; informs some terms only.
    friction_coefficient : float or None
        [1]; informs some terms only.
    effects : tuple of EffectSpec
        Terms the nominal model includes.
    origins : mapping of str to str
        For a key (``front_tire.B``), ``published``, ``assumed`` or ``calibrated``, where the file says so.
    notes : mapping of str to str
        For a key, the file's own words about its value.
    """

    name: str
    mass: float
    yaw_inertia: float
    cg_to_front_axle: float
    cg_to_rear_axle: float
    wheel_radius: float
    drive_split_front: float
    brake_split_front: float
    front_tire: MagicFormula
    rear_tire: MagicFormula
    max_torque: float
    max_brake_torque: float
    rolling_resistance_front: float = 0.0
    rolling_resistance_rear: float = 0.0
    drag_coefficient: float = 0.0
    cg_height: float | None = None
    friction_coefficient: float | None = None
    effects: tuple[EffectSpec, ...] = ()
    origins: Mapping[str, str] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)

    @property
    def wheelbase(self) -> float:
        """l_f + l_r [m]."""
        return self.cg_to_front_axle + self.cg_to_rear_axle

    @property
    def static_load_front(self) -> float:
        """Vertical load of the front axle at rest [N]."""
        return self.mass * STANDARD_GRAVITY * self.cg_to_rear_axle / self.wheelbase

    @property
    def static_load_rear(self) -> float:
        """Vertical load of the rear axle at rest [N]."""
        return self.mass * STANDARD_GRAVITY * self.cg_to_front_axle / self.wheelbase

    @property
    def minimum_speed(self) -> float:
        """Speed below which samples are not used, 5 sqrt(wheelbase/2.7) [m/s]."""
        return 5.0 * float(np.sqrt(self.wheelbase / 2.7))

    @property
    def has_assumed_tires(self) -> bool:
        """Whether the file says that the stiffness of an axle is assumed, as `split init` writes it."""
        return "assumed" in (self.origins.get("front_tire.B"), self.origins.get("rear_tire.B"))

    @property
    def has_calibrated_tires(self) -> bool:
        """Whether `split calibrate` has fitted the stiffness of an axle, or found that the drives leave it open."""
        keys = ("front_tire.B", "rear_tire.B")
        return any(self.origins.get(key) == "calibrated" or self.notes.get(key) == LEFT_OPEN for key in keys)

    @property
    def lateral_grip(self) -> float:
        """Lateral acceleration that the peaks D of both axles carry [m/s^2]."""
        return (self.front_tire.D + self.rear_tire.D) / self.mass

    @property
    def understeer_gradient(self) -> float:
        """K = m/L (l_r/C_f - l_f/C_r) without the effects [rad/(m/s^2)]: steer angle is L r/v_x + K a_y."""
        front, rear = self.front_tire.cornering_stiffness, self.rear_tire.cornering_stiffness
        return self.mass / self.wheelbase * (self.cg_to_rear_axle / front - self.cg_to_front_axle / rear)

    def force_matrix(self) -> np.ndarray:
        """Return the invariant matrix, shape (3, 3): forces to rates at small steer angles.

        Columns are total longitudinal, front lateral and rear lateral force [N]; rows the derivatives of v_x,
        v_y [m/s^2] and r [rad/s^2]: SPLIT paper, the simplified error dynamics.
        """
        m, i, a, b = self.mass, self.yaw_inertia, self.cg_to_front_axle, self.cg_to_rear_axle
        return np.array([[1 / m, 0, 0], [0, 1 / m, 1 / m], [0, a / i, -b / i]])

    def digest(self) -> str:
        """Return the SHA-256 of the physics: every value, without name, origins and notes."""
        mapping = vehicle_to_mapping(replace(self, name="", origins={}, notes={}))
        return hashlib.sha256(json.dumps(mapping, sort_keys=True).encode()).hexdigest()

    def with_effects(self, *effects: EffectSpec) -> Vehicle:
        """Return the vehicle with terms appended."""
        return replace(self, effects=(*self.effects, *effects))


#: Note on the stiffness factor B of an axle whose given tyres `split calibrate` has kept.
LEFT_OPEN = "split calibrate kept the given tyres: its drives do not determine them"

_POSITIVE = (
    "mass",
    "yaw_inertia",
    "cg_to_front_axle",
    "cg_to_rear_axle",
    "wheel_radius",
    "max_torque",
    "max_brake_torque",
    "cg_height",
    "friction_coefficient",
)
_NOT_NEGATIVE = ("rolling_resistance_front", "rolling_resistance_rear", "drag_coefficient")
_SHARES = ("drive_split_front", "brake_split_front")
_OPTIONAL = {
    "brake_split_front",
    "max_brake_torque",
    "rolling_resistance_front",
    "rolling_resistance_rear",
    "drag_coefficient",
    "cg_height",
    "friction_coefficient",
}
_NUMBERS = (*_POSITIVE, *_NOT_NEGATIVE, *_SHARES)
_KEYS = ("name", *_NUMBERS, "front_tire", "rear_tire", "effects")


def read_vehicle(path: str | Path) -> Vehicle:
    """Read a vehicle YAML; a name that is no file is looked up in the library of vehicles.

    Raises
    ------
    VehicleError
        If the file is missing, not YAML, has unknown keys (the nearest known is named), lacks keys, or holds
        physically impossible values.
    """
    path = vehicle_file(path)
    advice = f"{nearest_names(str(path), library_names())} A vehicle is a YAML file or one of the library."
    content = read_yaml_mapping(path, VehicleError, advice=advice)
    return vehicle_from_mapping(content, where=str(path))


def vehicle_file(path: str | Path) -> Path:
    """Return the file that `read_vehicle` reads: the path itself, or the library's file of that name.

    A folder of that name, such as one that was written for the car, does not stand in the library's way.
    """
    path = Path(path)
    return path if path.exists() and not path.is_dir() else library_path(str(path)) or path


def vehicle_from_mapping(content: Mapping[str, Any], *, where: str = "vehicle") -> Vehicle:
    """Build a vehicle from the mapping a vehicle file holds; see `read_vehicle`."""
    for key in content:
        if key not in _KEYS:
            raise VehicleError(f"unknown key {key!r}", where=where, advice=nearest_names(str(key), _KEYS))
    values = _Values(where)
    lacking = [key for key in _NUMBERS if content.get(key) is None and key not in _OPTIONAL]
    lacking += [key for key in ("front_tire", "rear_tire") if content.get(key) is None]
    lacking += [
        f"{tire}.{letter}"
        for tire in ("front_tire", "rear_tire")
        if isinstance(content.get(tire), Mapping)
        for letter in ("B", "C", "D")
        if letter in content[tire] and content[tire][letter] is None
    ]
    if lacking:
        shown = ", ".join(f"{key} [{unit}]" if (unit := _unit_of(key)) else key for key in lacking)
        advice = "Write them in SI units, as in `mass: 1500`; docs/formats.md and a file of `split init` explain each."
        raise VehicleError(f"lacks {shown}", where=where, advice=advice)
    numbers = {key: values.number(key, content[key]) for key in _NUMBERS if content.get(key) is not None}
    for key in _POSITIVE:
        if key in numbers and not numbers[key] > 0:
            raise VehicleError(f"{key} is {numbers[key]:g}, it must be positive", where=where)
    for key in _NOT_NEGATIVE:
        if numbers.get(key, 0.0) < 0:
            raise VehicleError(f"{key} is {numbers[key]:g}, it must not be negative", where=where)
    for key in _SHARES:
        if not 0.0 <= numbers.get(key, 0.0) <= 1.0:
            raise VehicleError(f"{key} is {numbers[key]:g}, it must lie in 0 to 1", where=where)
    _refuse_no_car(numbers, where)
    numbers.setdefault("brake_split_front", numbers["drive_split_front"])
    numbers.setdefault("max_brake_torque", numbers["max_torque"])
    tires = [_tire(key, content.get(key), values) for key in ("front_tire", "rear_tire")]
    effects = _effects(content.get("effects") or [], where)
    name = str(content.get("name") or Path(where).stem)
    known: dict[str, Any] = {"front_tire": tires[0], "rear_tire": tires[1], **numbers}
    return Vehicle(name=name, **known, effects=effects, origins=values.origins, notes=values.notes)


class _Values:
    """Reads values, and keeps what a file says about them: origin and note."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.origins: dict[str, str] = {}
        self.notes: dict[str, str] = {}

    def number(self, key: str, value: Any) -> float:
        """Return the number of a plain value or of {value, source, note}."""
        if isinstance(value, Mapping):
            if "value" not in value or set(value) - {"value", "source", "note"}:
                what = f"{key} must be a number or {{value, source, note}}"
                advice = f"Write `{key}: NUMBER`, or give that key `value`, `source` and `note`."
                raise VehicleError(what, where=self.where, advice=advice)
            self._keep(key, value)
            value = value["value"]
        return _finite_number(key, value, self.where)

    def _keep(self, key: str, value: Mapping[str, Any]) -> None:
        source = value.get("source")
        if source is not None and source not in VALUE_SOURCES:
            advice = nearest_names(str(source), VALUE_SOURCES)
            raise VehicleError(f"{key} has source {source!r}", where=self.where, advice=advice)
        if source is not None:
            self.origins[key] = source
        if value.get("note") is not None:
            self.notes[key] = str(value["note"])


def _finite_number(key: str, value: Any, where: str) -> float:
    # YAML 1.1 reads 2.6e3, without a sign in the exponent, as text.
    if isinstance(value, str):
        with contextlib.suppress(ValueError):
            value = float(value)
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**300:
        raise VehicleError(f"{key} has more than 300 digits, a finite number was expected", where=where)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        unit = _unit_of(key)
        what = f"{key} is {value!r}, a finite number{f' in {unit}' if unit else ''} was expected"
        raise VehicleError(what, where=where, advice=f"Write `{key.rpartition('.')[2]}: NUMBER`.")
    return float(value)


def _tire(key: str, content: Any, source: _Values) -> MagicFormula:
    where = source.where
    if not isinstance(content, Mapping):
        raise VehicleError(f"lacks {key}", where=where, advice="It needs B, C and D.")
    for name in content:
        if name not in ("B", "C", "D"):
            advice = "Convert tyres with E or normalised D by `split calibrate --convert`."
            raise VehicleError(f"unknown key {name!r} in {key}", where=where, advice=advice)
    values = {}
    for name in ("B", "C", "D"):
        if name not in content:
            raise VehicleError(f"{key} lacks {name}", where=where)
        values[name] = source.number(f"{key}.{name}", content[name])
        if not values[name] > 0:
            raise VehicleError(f"{key}.{name} is {values[name]:g}, it must be positive", where=where)
    if values["C"] >= 2.0:
        raise VehicleError(f"{key}.C is {values['C']:g}: the force would change sign at large slip", where=where)
    _refuse_no_car(values, where, f"{key}.")
    return MagicFormula(**values)


# What any vehicle on wheels can have, from a model on a desk to a loaded mining truck. A value outside is a unit
# gone wrong (g for kg, mm for m), not a choice.
_VALUES_OF_CARS = {
    "mass": (0.01, 1e6, "kg"),
    "yaw_inertia": (1e-6, 1e8, "kg m^2"),
    "cg_to_front_axle": (5e-3, 50.0, "m"),
    "cg_to_rear_axle": (5e-3, 50.0, "m"),
    "wheel_radius": (2e-3, 5.0, "m"),
    "max_torque": (1e-4, 1e7, "N m"),
    "max_brake_torque": (1e-4, 1e7, "N m"),
    "cg_height": (1e-3, 20.0, "m"),
    "friction_coefficient": (1e-3, 10.0, ""),
    "rolling_resistance_front": (0.0, 1e6, "N"),
    "rolling_resistance_rear": (0.0, 1e6, "N"),
    "drag_coefficient": (0.0, 1e4, "N/(m/s)^2"),
    "B": (1e-2, 1e3, "1/rad"),
    "C": (1e-3, 2.0, ""),
    "D": (1e-3, 1e8, "N"),
}


def _unit_of(key: str) -> str:
    """Return the unit of a parameter, also of a tyre's as ``front_tire.D``; empty where it has none."""
    return _VALUES_OF_CARS.get(key.rpartition(".")[2], (0.0, 0.0, ""))[2]


def _refuse_no_car(values: Mapping[str, float], where: str, prefix: str = "") -> None:
    for key, value in values.items():
        least, most, unit = _VALUES_OF_CARS.get(key, (-np.inf, np.inf, ""))
        if not least <= value <= most:
            what = f"{prefix}{key} is {value:g} {unit}".rstrip() + f", no vehicle is outside {least:g} to {most:g}"
            raise VehicleError(what, where=where, advice="Is it in SI units?")


def _effects(content: Any, where: str) -> tuple[EffectSpec, ...]:
    if not isinstance(content, list):
        raise VehicleError("effects must be a list of {term, parameters}", where=where)
    effects = []
    for entry in content:
        if not isinstance(entry, Mapping) or "term" not in entry or set(entry) - {"term", "parameters", "variant"}:
            raise VehicleError(f"an effect is {entry!r}, {{term, parameters, variant}} was expected", where=where)
        term = str(entry["term"])
        parameters = entry.get("parameters") or {}
        if not isinstance(parameters, Mapping):
            what = f"effects.{term}.parameters is {parameters!r}, {{name: number}} expected"
            raise VehicleError(what, where=where)
        values = {str(k): _finite_number(f"effects.{term}.{k}", v, where) for k, v in parameters.items()}
        effects.append(EffectSpec(term, values, str(entry.get("variant") or "")))
    return tuple(effects)


def vehicle_to_mapping(vehicle: Vehicle) -> dict[str, Any]:
    """Return what a vehicle file holds; `vehicle_from_mapping` reads it back to an equal vehicle."""

    def entry(key: str, value: float) -> Any:
        if key not in vehicle.origins and key not in vehicle.notes:
            return value
        notes = {"source": vehicle.origins.get(key), "note": vehicle.notes.get(key)}
        return {"value": value, **{name: text for name, text in notes.items() if text is not None}}

    mapping: dict[str, Any] = {"name": vehicle.name}
    for key in _NUMBERS:
        value = getattr(vehicle, key)
        if value is not None:
            mapping[key] = entry(key, value)
    for key in ("front_tire", "rear_tire"):
        tire = getattr(vehicle, key)
        mapping[key] = {name: entry(f"{key}.{name}", getattr(tire, name)) for name in ("B", "C", "D")}
    if vehicle.effects:
        mapping["effects"] = [
            {"term": e.term, "parameters": dict(e.parameters), **({"variant": e.variant} if e.variant else {})}
            for e in vehicle.effects
        ]
    return mapping


_PHYSICS = "Physics as written:"


def physics_as_written(text: str) -> str | None:
    """Return the digest of the physics that `write_vehicle` wrote into the head of a file; None without one."""
    found = re.search(rf"^# {_PHYSICS} ([0-9a-f]{{64}})$", text, flags=re.MULTILINE)
    return found[1] if found else None


def write_vehicle(vehicle: Vehicle, path: str | Path, *, comment: str = "") -> None:
    """Write a vehicle YAML, whole or not at all, with `comment` as leading ``#`` lines.

    A comment tells what made the file; the digest of its physics follows it, which tells later changes by hand.
    """
    text = f"{comment.rstrip()}\n{_PHYSICS} {vehicle.digest()}" if comment else ""
    head = "".join(f"# {line}\n" for line in text.splitlines())
    body = yaml.safe_dump(vehicle_to_mapping(vehicle), sort_keys=False, default_flow_style=None, width=100)
    atomic_write_text(path, head + body)
