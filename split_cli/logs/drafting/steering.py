"""Whether a recorded steering signal is the road wheels', the steering wheel's or a command without unit."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from split_cli.logs.checking.kinematics import fit_linear, fit_slope, robust_spread
from split_cli.logs.checking.plausible import NO_CAR_EXCEEDS
from split_cli.logs.drafting.draft import Suggestion, quoted
from split_cli.logs.drafting.vocabulary import concepts_of, tokens_of
from split_cli.signals import find_unit
from split_cli.vehicle.parameters import Vehicle

_LONGEST_WHEELBASE = 6.5
"""Of a lorry with understeer [m]; what steers more a turn than that is no road wheel."""
_SHORTEST_CAR = 1.8
"""Wheelbase of a full-size car, the smallest [m]."""
_LONGEST_CAR = 4.0
"""Wheelbase of the longest car, 3.9 m, with margin [m]."""
_SHORTEST_RACER = 1.5
"""Wheelbase of the smallest car that is as fast as a full-size one [m]: formula cars of students have 1.525."""
_COPY = 0.9999
"""Correlation with the yaw rate, from which on a signal is the yaw rate again [1]."""
_OUTLIERS = 6.0
"""Robust deviations beyond which a sample is no part of the steady relation [1]."""
_LARGEST_ERROR = 0.15
"""Of the angle over curvature without understeer, by blocks of time, to be believed [1]."""
_MOST_TURNS = 25.0
"""Four turns to each side, more than a lorry's steering wheel makes [rad]."""
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
    if slope is None or ("r" in columns and _is_yaw_rate(delta, columns["r"], moving)):
        return None
    without_understeer = _at_rest(delta, curvature, vx, moving)
    if without_understeer is not None and without_understeer * slope.slope > 0.0:
        return without_understeer
    return None if abs(slope.correlation) < 0.85 else slope.slope


def _is_yaw_rate(delta: np.ndarray, r: np.ndarray, mask: np.ndarray) -> bool:
    """Whether a signal is the yaw rate itself: no tyres answer a steering without delay."""
    copy = fit_slope(delta, r, mask)
    return copy is not None and abs(copy.correlation) > _COPY


def _at_rest(delta: np.ndarray, curvature: np.ndarray, vx: np.ndarray, mask: np.ndarray) -> float | None:
    """Return the steer angle over curvature that the steady single track has towards rest [m].

    delta = (L + K v_x^2) curvature: at 250 km/h understeer multiplies the angle. None where the speeds or the
    curves do not separate the two, or the relation is not this one.
    """
    use = mask & np.isfinite(delta) & np.isfinite(curvature) & np.isfinite(vx)
    if np.count_nonzero(use) < 200:
        return None
    d, k = delta[use], curvature[use]
    terms = np.stack([k, k * vx[use] ** 2, np.ones(len(k))], axis=1)
    near = np.ones(len(d), dtype=bool)
    for _ in range(3):
        fitted = terms @ np.linalg.lstsq(terms[near], d[near], rcond=None)[0]
        residual = d - fitted
        near = np.abs(residual - np.median(residual)) <= max(_OUTLIERS * robust_spread(residual), 1e-12)
    if np.count_nonzero(near) < 200 or np.std(d[near]) == 0.0 or np.std(residual[near]) > 0.5 * np.std(d[near]):
        return None
    d, terms = d[near], terms[near]
    value, error = fit_linear(terms, d)
    return float(value[0]) if error[0] < _LARGEST_ERROR * abs(value[0]) else None


def read_steering(
    chosen: Mapping[str, Suggestion], columns: Mapping[str, np.ndarray], vehicle: Vehicle | None
) -> list[Suggestion]:
    """Return the suggestions for ``delta`` and ``steering_wheel_angle``.

    Parameters
    ----------
    columns : mapping of str to ndarray
        Of the suggestions, SI.
    vehicle : Vehicle, optional
        Its wheelbase turns the apparent wheelbase into a steering ratio.
    """
    drafted = []
    shares = [s for c, s in chosen.items() if c in ("delta", "steering_wheel_angle") and s.unit == "%"]
    chosen = {c: s for c, s in chosen.items() if s not in shares}
    if shares and "delta" not in chosen:
        drafted += [replace(s, channel="delta", status="open", reason=_share(s, columns)) for s in shares[:1]]
    by_ratio = None
    if "steering_wheel_angle" in chosen:
        wheel = _hand_wheel(chosen["steering_wheel_angle"], columns)
        drafted.append(wheel)
        if "delta" not in chosen and _is_of_the_road(wheel, columns):
            as_delta = {**columns, "delta": columns[wheel.channel]}
            drafted[-1] = _road_wheel(replace(wheel, channel="delta"), as_delta, vehicle)
        else:
            reach = (
                apparent_wheelbase(columns.get("steering_wheel_angle", np.zeros(0)), columns)
                if ("steering_wheel_angle" in columns)
                else None
            )
            found = chosen["steering_wheel_angle"]
            if reach is not None and found.unit != wheel.unit and wheel.unit == "deg":
                reach *= np.pi / 180.0
            size = None if reach is None else abs(reach)
            reason = _ratio(reach, wheel, vehicle)
            by_ratio = Suggestion("delta", wheel.sources, status="open", reason=reason, reach=size)
    if "delta" in chosen:
        drafted.append(_road_wheel(chosen["delta"], columns, vehicle))
    if by_ratio is not None and not any(s.channel == "delta" and s.status != "open" for s in drafted):
        drafted.append(by_ratio)
    return drafted


def _share(s: Suggestion, columns: Mapping[str, np.ndarray]) -> str:
    """Say of steering in per cent how it becomes an angle."""
    text = f"a share of the steering's lock, no angle: write {_line(s, 'rad', 'ANGLE/100')} with the"
    text += " road wheels' angle at 100 %"
    reach = apparent_wheelbase(columns[s.channel], columns) if s.channel in columns else None
    if reach is None:
        return text
    return f"{text}, near wheelbase/{abs(reach):.3g} m{' with a minus sign' if reach < 0.0 else ''}"


def _hand_wheel(s: Suggestion, columns: Mapping[str, np.ndarray]) -> Suggestion:
    """Return the steering wheel's angle with its unit: as stated, as its size over curvature tells, or assumed."""
    reach = apparent_wheelbase(columns[s.channel], columns) if s.channel in columns else None
    if reach is not None and reach < 0.0:
        s = replace(s, scale=-s.scale)
    if s.status == "stated":
        return replace(s, reason="; its sign is turned" if reach is not None and reach < 0.0 else "")
    if s.unit is None and reach is not None and is_full_size(columns):
        unit, of_road = _read_size(abs(reach))
        if unit and not of_road:
            size = abs(reach) * (np.pi / 180.0 if unit == "deg" else 1.0)
            hand = "; its sign is turned" if reach < 0.0 else ""
            return replace(s, unit=unit, status="judged", reason=f"{unit}: {size:.3g} m over curvature{hand}")
    remark = f"{s.reason}; unit not stated" if s.reason else "unit not stated"
    if s.unit is None and s.channel in columns:
        largest = float(np.nanquantile(np.abs(columns[s.channel]), 0.99))
        if largest > _MOST_TURNS:
            return replace(s, unit="deg", reason=f"{remark}; it reaches {largest:.3g}, so degrees")
    return replace(s, reason=remark)


def _is_of_the_road(wheel: Suggestion, columns: Mapping[str, np.ndarray]) -> bool:
    """Whether an angle that is called the steering wheel's is as small over curvature as a wheelbase."""
    reach = apparent_wheelbase(columns[wheel.channel], columns) if wheel.channel in columns else None
    if reach is None or not is_full_size(columns):
        return False
    # Of an angle without unit the size tells the unit too.
    unit, of_road = _read_size(abs(reach))
    return of_road and (wheel.unit is None or unit == "rad")


def is_full_size(columns: Mapping[str, np.ndarray]) -> bool:
    """Tell whether a recording is of a car that a person drives: it is faster than models are."""
    return "vx" in columns and float(np.nanquantile(np.abs(columns["vx"]), 0.95)) > 12.0


def _read_size(size: float) -> tuple[str, bool]:
    """Return unit and whether it is the road wheel's angle, of a full-size car by its angle over curvature [m].

    Wheelbases of 1.8 to 6.5 m with understeer, ratios of 8 and more, radians and degrees give four stretches that
    do not meet; empty between them.
    """
    degree = 180.0 / np.pi
    if _SHORTEST_CAR <= size <= _LONGEST_WHEELBASE:
        return "rad", True
    if _SHORTEST_STEERING_WHEEL <= size < _SHORTEST_CAR * degree:
        return "rad", False
    if _SHORTEST_CAR * degree <= size <= _LONGEST_WHEELBASE * degree:
        return "deg", True
    if _SHORTEST_STEERING_WHEEL * degree <= size < 30.0 * _LONGEST_WHEELBASE * degree:
        return "deg", False
    return "", False


def _ratio(reach: float | None, wheel: Suggestion, vehicle: Vehicle | None) -> str:
    text = f"the steering wheel's angle: write {_line(wheel, wheel.unit or 'rad', '1/RATIO')} with its ratio"
    if reach is None:
        return text
    turned = " and a minus sign" if reach < 0 else ""
    if vehicle is not None:
        return f"{text}, here about {abs(reach) / vehicle.wheelbase:.3g} (roughly: understeer may add){turned}"
    return f"{text}: {abs(reach):.3g} m over the wheelbase (roughly: understeer may add){turned}"


def _road_wheel(s: Suggestion, columns: Mapping[str, np.ndarray], vehicle: Vehicle | None) -> Suggestion:
    """Judge a steering signal by the curvature that it gives."""
    if "delta" not in columns:
        return s.left_open("cannot be read")
    values = columns["delta"]
    reach = apparent_wheelbase(values, columns)
    unit = find_unit(s.unit) if s.unit else None
    is_clear = s.status == "judged" or (unit is not None and unit.si == "rad")
    if reach is None:
        far, (limit, _) = float(np.nanquantile(np.abs(values), 0.99)), NO_CAR_EXCEEDS["delta"]
        if is_clear and unit is not None and "steer" not in s.sources[0].lower():
            if far > limit:
                text = f"reaches {far:.3g} rad in the unit that the file states, no car's exceeds {limit:g}"
                return s.left_open(text)
            return replace(s, status="stated", reason="; a road-wheel angle by its name; not judged")
        why = "does not follow the curvature of the path, or the car hardly turns"
        why = why if "vx" in columns else "no speed to compare it with"
        return s.left_open(f"road wheel, steering wheel or command? Not judged: {why}")
    turned = {"scale": -1.0} if reach < 0 else {}
    hand = "; its sign is turned" if reach < 0 else ""
    size = abs(reach)
    s = replace(s, reach=size)
    if unit is None:
        return _without_unit(s, size, float(np.nanquantile(np.abs(values), 0.999)), turned, hand, columns)
    if size <= _LONGEST_WHEELBASE:
        reason = f"{size:.3g} m of steer angle over the curvature of the path, a wheelbase{hand}"
        return replace(s, status="judged", reason=reason, **turned)
    if size >= _SHORTEST_STEERING_WHEEL:
        return s.left_open(_ratio(reach, s, vehicle))
    return s.left_open(_between(reach, s))


def _line(s: Suggestion, unit: str, scale: str) -> str:
    """Return the line of a map that makes a recorded angle or share that of the road wheels."""
    names = ", ".join(map(quoted, s.sources))
    source = f"[{names}], convert: {s.convert}" if s.convert else names
    return f"`delta: {{source: {source}, unit: {unit}, scale: {scale}}}`"


def _between(reach: float, s: Suggestion) -> str:
    """Say of a size that a small car's steering wheel has, or a lorry's road wheels, what to write for each."""
    sign = "-" if reach < 0 else ""
    of_wheel = _line(s, s.unit or "rad", f"{sign}1/RATIO")
    return (
        f"{abs(reach):.3g} m of steer angle over the curvature of the path: more than a wheelbase, little for a "
        f"steering wheel. If it is the steering wheel's, write {of_wheel}, its ratio being that over the wheelbase; "
        "if the road wheels', leave the scale out"
    )


def _without_unit(
    s: Suggestion, size: float, largest: float, turned: dict, hand: str, columns: Mapping[str, np.ndarray]
) -> Suggestion:
    """Judge a steering signal without a unit: radians only where the wheelbase is that of a car of that speed."""
    if abs(largest - 1.0) < 0.02 or largest == 1.0:
        why = f"reaches 1 and no more: a command in -1..1. {_scale_of_command(size, bool(turned))}"
        return s.left_open(why)
    named = s.sources[0].lower()
    if "user" in concepts_of(tokens_of(named))[0]:
        why = f"what the driver or a pilot asks for: a command without unit. {_scale_of_command(size, bool(turned))}"
        return s.left_open(why)
    if "steer" not in named and 0.05 < size < _LONGEST_WHEELBASE:
        reason = f"rad: {size:.3g} m of steer angle over the curvature of the path, a wheelbase{hand}"
        return replace(s, unit="rad", status="judged", reason=reason, **turned)
    if is_full_size(columns):
        unit, of_road = _read_size(size)
        if of_road:
            factor = 1.0 if unit == "rad" else np.pi / 180.0
            reason = f"{unit}: {size * factor:.3g} m of steer angle over the curvature of the path, a wheelbase{hand}"
            if unit == "rad" and not concepts_of(tokens_of(s.sources[0]))[0] & {"angle", "road", "wheel"}:
                # A command in -1..1 of a simulator, with its lock near a radian, looks alike.
                remark = (
                    f"rad, or a command in -1..1? {size:.3g} m of it over the curvature of the path may be a "
                    f"wheelbase{hand}"
                )
                return replace(s, unit=unit, status="assumed", reason=remark, **turned)
            if size * factor > _LONGEST_CAR:
                remark = (
                    f"{size * factor:.3g} m of angle over curvature is a lorry's wheelbase; of a car's steering "
                    f"it makes a share of the lock: `scale: {'-' if turned else ''}WHEELBASE/{size:.3g}`"
                )
                return replace(s, unit=unit, status="assumed", reason=remark, **turned)
            return replace(s, unit=unit, status="judged", reason=reason, **turned)
        if unit == "rad" and size >= _SHORTEST_RACER * 180.0 / np.pi:
            sign = "-" if turned else ""
            why = (
                f"unit not stated: degrees of the road wheels of a car of {np.radians(size):.3g} m wheelbase "
                f"(`unit: deg, scale: {sign}1`), or radians of the steering wheel, with {size:.3g} m over the "
                f"wheelbase as ratio (`unit: rad, scale: {sign}1/RATIO`)"
            )
            return s.left_open(why)
        if unit:
            reach = (-size if turned else size) * find_unit(unit).factor
            return replace(s, unit=unit, status="open", reason=_ratio(reach, replace(s, unit=unit), None))
    if not is_full_size(columns) and re.search("ang|tire|tyre", named) and 0.05 < size < 1.8:
        reason = f"unit not stated, rad assumed: {size:.3g} m over curvature may be a small car's wheelbase{hand}"
        return replace(s, unit="rad", status="assumed", reason=reason, **turned)
    why = f"unit not stated: radians of which wheel, or a command? {_scale_of_command(size, bool(turned))}"
    return s.left_open(why)


def _scale_of_command(size: float, is_turned: bool) -> str:
    """Say which scale makes a command the road wheels' angle, by its size over the path's curvature [m]."""
    sign, hand = ("-", "it is right-positive; ") if is_turned else ("", "")
    scale = f"`scale: {sign}WHEELBASE/{size:.3g}`"
    how = "with the wheelbase in m makes it an angle, roughly: understeer may add to it"
    return f"Compared with the path, {hand}{scale} {how}"
