"""Whether a recorded steering signal is the road wheels', the steering wheel's or a command without unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from split_cli.logs.kinematics import fit_slope
from split_cli.signals import find_unit
from split_cli.vehicle.parameters import Vehicle

__all__ = ["apparent_wheelbase", "read_steering"]

_LONGEST_WHEELBASE = 6.5
"""Of a lorry with understeer [m]; what steers more a turn than that is no road wheel."""
_SHORTEST_STEERING_WHEEL = 12.0
"""Wheelbase of a small car, 1.9 m, times its steering ratio, at least 8, with margin [m]."""


def apparent_wheelbase(delta: np.ndarray, columns: Mapping[str, np.ndarray]) -> float | None:
    """Return the slope of the steer angle over the path's curvature [m]: wheelbase times ratio, times the unit.

    Parameters
    ----------
    delta : ndarray, shape (N,)
        As recorded, in radians if it says so.
    columns : mapping of str to ndarray
        ``vx`` and ``r``, or ``vx`` and ``ay``.

    Returns
    -------
    float or None
        Signed; None where the car hardly turns or the two do not go together.
    """
    if "vx" not in columns:
        return None
    vx = columns["vx"]
    moving = np.abs(vx) > max(0.3 * float(np.nanquantile(np.abs(vx), 0.95)), 0.3)
    safe = np.where(moving, vx, np.nan)
    if "r" in columns:
        curvature = columns["r"] / safe
    elif "ay" in columns:
        curvature = columns["ay"] / safe**2
    else:
        return None
    slope = fit_slope(delta, curvature, moving)
    return None if slope is None or abs(slope.correlation) < 0.85 else slope.slope


def read_steering(
    chosen: Mapping[str, Any], columns: Mapping[str, np.ndarray], vehicle: Vehicle | None, make: Any
) -> list[Any]:
    """Return the suggestions for ``delta`` and ``steering_wheel_angle``.

    Parameters
    ----------
    chosen : mapping of str to Suggestion
    columns : mapping of str to ndarray
        Of the suggestions, SI.
    vehicle : Vehicle, optional
        Its wheelbase turns the apparent wheelbase into a steering ratio.
    make : type
        ``Suggestion``.
    """
    told = []
    if "steering_wheel_angle" in chosen:
        wheel = chosen["steering_wheel_angle"]
        told.append(replace(wheel, reason="" if wheel.status == "stated" else "unit not stated"))
        if "delta" not in chosen:
            reach = apparent_wheelbase(columns.get("steering_wheel_angle", np.zeros(0)), columns) if (
                "steering_wheel_angle" in columns) else None  # fmt: skip
            told.append(make("delta", wheel.sources, status="open", reason=_ratio(reach, wheel.unit, vehicle)))
    if "delta" in chosen:
        told.append(_road_wheel(chosen["delta"], columns, vehicle))
    return told


def _ratio(reach: float | None, unit: str | None, vehicle: Vehicle | None) -> str:
    text = f"the steering wheel's angle: {{source: ..., unit: {unit or 'rad'}, scale: 1/RATIO}} with its ratio"
    if reach is None:
        return text
    turned = " and a minus sign" if reach < 0 else ""
    if vehicle is not None:
        return f"{text}, here about {abs(reach) / vehicle.wheelbase:.3g} (understeer included){turned}"
    return f"{text}: {abs(reach):.3g} m over the wheelbase (understeer included){turned}"


def _road_wheel(s: Any, columns: Mapping[str, np.ndarray], vehicle: Vehicle | None) -> Any:
    """Judge a steering signal by the curvature that it gives."""
    if "delta" not in columns:
        return replace(s, status="open", reason="cannot be read")
    values = columns["delta"]
    reach = apparent_wheelbase(values, columns)
    unit = find_unit(s.unit) if s.unit else None
    is_clear = s.status == "judged" or (unit is not None and unit.si == "rad")
    if reach is None:
        if is_clear and unit is not None and "steer" not in s.sources[0].lower():
            return replace(s, status="stated", reason="; a road-wheel angle by its name; not judged")
        why = "does not follow the curvature of the path, or the car hardly turns" if "vx" in columns else "no v_x"
        return replace(s, status="open", reason=f"road wheel, steering wheel or command? Not judged: {why}")
    turned = {"scale": -1.0} if reach < 0 else {}
    hand = "; its sign is turned" if reach < 0 else ""
    size = abs(reach)
    if unit is None:
        return _without_unit(s, size, float(np.nanquantile(np.abs(values), 0.999)), turned, hand, columns)
    if size <= _LONGEST_WHEELBASE:
        reason = f"{size:.3g} m of angle over curvature is a wheelbase{hand}"
        return replace(s, status="judged", reason=reason, **turned)
    if size >= _SHORTEST_STEERING_WHEEL:
        return replace(s, status="open", reason=_ratio(reach, s.unit, vehicle))
    return replace(s, status="open", reason=f"{size:.3g} m of angle over curvature is neither wheelbase nor ratio")


def _without_unit(
    s: Any, size: float, largest: float, turned: dict, hand: str, columns: Mapping[str, np.ndarray]
) -> Any:
    """Judge a steering signal without a unit: radians only where the wheelbase is that of a car of that speed."""
    if abs(largest - 1.0) < 0.02 or largest == 1.0:
        why = f"reaches 1 and no more: a command in -1..1; give a `curve:` or `scale:` ({size:.3g} m/curvature)"
        return replace(s, status="open", reason=why)
    named = s.sources[0].lower()
    full_size = float(np.nanquantile(np.abs(columns["vx"]), 0.95)) > 12.0
    if "steer" not in named and 0.05 < size < _LONGEST_WHEELBASE:
        reason = f"rad: {size:.3g} m of angle over curvature is a wheelbase{hand}"
        return replace(s, unit="rad", status="judged", reason=reason, **turned)
    if full_size and 1.8 <= size <= _LONGEST_WHEELBASE:
        reason = f"rad: {size:.3g} m of angle over curvature is a wheelbase{hand}"
        return replace(s, unit="rad", status="judged", reason=reason, **turned)
    why = f"unit not stated, {size:.3g} m of it over curvature: radians of which wheel, or a command without unit?"
    return replace(s, status="open", reason=why)
