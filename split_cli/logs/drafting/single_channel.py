"""Channels that no relation judges without a vehicle file: torque by acceleration, side-slip angle by v_y."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.logs.checking.checks import LEAST_CORRELATION
from split_cli.logs.checking.kinematics import Kinematics, Slope, block_interval, fit_slope
from split_cli.logs.checking.mistakes import HIGHEST_RATIO
from split_cli.logs.checking.plausible import NO_CAR_EXCEEDS
from split_cli.logs.drafting.draft import Suggestion
from split_cli.logs.drafting.steering import is_full_size
from split_cli.logs.drafting.wheel_torques import note_on_part

_LEAST_OF_A_CAR = 50.0
"""Mass times wheel radius of the lightest car that a person drives: 250 kg on wheels of 0.2 m [kg m]."""
_MOST_OF_A_LORRY = 4e4
"""Mass times wheel radius of 60 t on wheels of 0.6 m, with margin [kg m]."""
_AT_REST = 0.1
"""Speed below which a car stands, noise of its sensor included [m/s]."""
_REST_SECONDS = 3.0
"""Of standing in all that tell what an accelerometer reads at rest [s]."""
_TILTED = 2.5
"""At rest on level ground a sensor along the car reads 0, on a slope of 1 in 4 a quarter of gravity [m/s^2]."""
_GRAVITY_AT_REST = "while the car stands: gravity"
_OTHER_AXIS = "and does not go with it: along another axis?"
_BY_CHANCE = 3.0
"""Standard errors of a correlation that is none [1]."""
_RADII = 0.02, 0.9
"""Of wheels, from models to lorries [m]."""
_LEAST_OF_A_CAR_WHEEL = 0.15
"""Radius of the smallest wheel that a person drives at 12 m/s and more [m]."""
_ROLLING = {"m/s": 1.0, "km/h": 3.6, "mph": 2.237, "kn": 1.944}
_ALIKE = 0.05
"""Of a wheel's speed, by which it differs from v_x with slip and a tyre that wears [1]."""
_MOST_SHARE, _MOST_PERCENT = 1.2, 120.0
"""Of a pedal's travel, sensors that overshoot included: as a share of 1, and in per cent."""


def _kinematics(columns: Mapping[str, np.ndarray], rate: float) -> Kinematics:
    return Kinematics(columns, 1.0 / rate, [slice(0, len(columns["vx"]))])


def read_torque(s: Suggestion, columns: Mapping[str, np.ndarray], rate: float) -> Suggestion:
    """Say whether T goes with the acceleration; how much per m/s^2 shows a torque of the engine or of one axle."""
    of_part = note_on_part(s.sources)
    if s.status == "open" or not {"vx", "T"} <= set(columns):
        if of_part and s.status == "stated":
            return replace(s, status="assumed", reason=f"{of_part}{s.reason}")
        return s
    k = _kinematics(columns, rate)
    carried = k.of("vy r", lambda: columns["vy"] * columns["r"]) if {"vy", "r"} <= set(columns) else 0.0
    slope = fit_slope(k.signal("T"), k.rate("vx") - carried, k.moving)
    if slope is None or abs(slope.correlation) < LEAST_CORRELATION:
        how = "cannot be judged" if slope is None else f"correlate by {slope.correlation:.2f} only"
        remark = f"T and dv_x/dt {how}: is it the torque at the wheels?"
        if slope is not None and s.status != "stated" and _go_apart(k.signal("T"), k.rate("vx") - carried, k.moving):
            remark = f"T and dv_x/dt {how}: it drives nothing, as the torque in a steering column does"
            return s.left_open(remark)
        return replace(s, status="assumed", reason="; ".join(filter(None, (of_part, remark))))
    size = f"{abs(slope.slope):.3g} N m for 1 m/s^2, to compare with mass times wheel radius in SI units"
    if slope.slope < 0.0:
        s, size = replace(s, scale=-s.scale), f"its sign is turned; {size}"
    if abs(slope.slope) * HIGHEST_RATIO < _LEAST_OF_A_CAR <= abs(slope.slope) * 1e3 and is_full_size(columns):
        # No gears make a car's torque of so little.
        remark = f"{'the file says ' + s.unit if s.unit else 'unit not stated'}, and {size}: in kN m that is right"
        return replace(s, unit="kN m", status="assumed", reason=remark)
    if abs(slope.slope) < _LEAST_OF_A_CAR and is_full_size(columns):
        remark = f"{size}: too small for a car, so of the engine? `scale:` with ratio times efficiency makes it T"
        return s.left_open(remark)
    if abs(slope.slope) > _MOST_OF_A_LORRY:
        remark = f"the file says {s.foreign_unit!r}, which is no known unit; " if s.foreign_unit else ""
        return s.left_open(f"{remark}{size}: more than any lorry's. Give its `scale:`")
    status = "assumed" if of_part or s.unit is None or s.foreign_unit else "judged"
    unit = s.unit or "N m"
    remark = "" if s.unit else "unit not stated"
    if s.foreign_unit:
        remark = f"the file says {s.foreign_unit!r}, which is no known unit; {unit} assumed"
    return replace(s, status=status, unit=unit, reason="; ".join(filter(None, (of_part, remark, size))))


def _go_apart(y: np.ndarray, x: np.ndarray, mask: np.ndarray) -> bool:
    """Tell two signals whose correlation is no more than its own standard error makes it."""
    use = mask & np.isfinite(x * y)
    both = np.stack([x[use], y[use]])
    value, error = block_interval(lambda rows: np.corrcoef(both[:, rows])[:1, 1], both.shape[1])
    return bool(abs(value[0]) < _BY_CHANCE * error[0])


def read_pedal(s: Suggestion, columns: Mapping[str, np.ndarray], rate: float) -> Suggestion:
    """Tell a pedal in per cent from one in shares of 1 by how far it goes."""
    if s.status == "open" or s.channel not in columns or s.unit not in (None, "1"):
        return s
    largest = float(np.nanmax(np.abs(columns[s.channel])))
    if largest <= _MOST_SHARE or s.status == "stated":
        return s
    if largest > _MOST_PERCENT:
        remark = f"reaches {largest:.4g}: neither a share nor per cent of the pedal's travel. Give its `scale:`"
        return s.left_open(remark)
    return replace(s, unit="%", reason=f"unit not stated; it reaches {largest:.3g}, so per cent")


def read_yaw_rate(s: Suggestion, columns: Mapping[str, np.ndarray], rate: float) -> Suggestion:
    """Tell degrees from radians by how fast a car turns, where nobody states the unit and nothing judges it."""
    limit, unit = NO_CAR_EXCEEDS["r"]
    if s.status != "assumed" or s.unit != unit or s.channel not in columns:
        return s
    reach = float(np.nanquantile(np.abs(columns[s.channel]), 0.99))
    if np.radians(reach) > limit:
        remark = f"unit not stated; it reaches {reach:.3g}, more than any car's in rad/s or deg/s. Give its `scale:`"
        return s.left_open(remark)
    remark = f"unit not stated; it reaches {reach:.3g}, and no car's exceeds {limit:g} {unit}, so deg/s"
    return replace(s, unit="deg/s", reason=remark) if reach > limit else s


def read_yaw(s: Suggestion, columns: Mapping[str, np.ndarray], rate: float) -> Suggestion:
    """Leave out a yaw that nothing judged and that does not turn with X, Y, such as a part of a quaternion."""
    if s.status != "assumed" or not {"X", "Y", "vx"} <= set(columns) or s.channel not in columns:
        return s
    k = _kinematics(columns, rate)
    slope = fit_slope(k.rate("yaw"), k.course_rate(), k.moving)
    if slope is None or abs(slope.correlation) >= LEAST_CORRELATION:
        return s
    remark = f"dyaw/dt and the turning of X, Y correlate by {slope.correlation:.2f} only: not the car's yaw, or late"
    return s.left_open(remark)


def read_wheel(s: Suggestion, columns: Mapping[str, np.ndarray], rate: float) -> Suggestion:
    """Tell the unit of a wheel speed by v_x: what rolls is as fast, what turns has a radius that wheels have."""
    if s.status != "assumed" or not {s.channel, "vx"} <= set(columns):
        return s
    k = _kinematics(columns, rate)
    found = fit_slope(k.signal(s.channel), k.signal("vx"), k.moving)
    if found is None:
        return s
    if found.correlation < LEAST_CORRELATION:
        remark = f"{s.channel} and v_x correlate by {found.correlation:.2f} only: not the speed of a wheel"
        return s.left_open(remark)
    slope, remark = found.slope, f"{s.channel} against v_x {found.slope:.3g}"
    for unit, factor in _ROLLING.items():
        if abs(slope / factor - 1.0) < _ALIKE:
            return replace(s, unit=unit, status="judged", reason=f"{remark}, unit not stated")
    turning = {unit: factor / slope for unit, factor in (("rad/s", 1.0), ("rpm", 30.0 / np.pi))}
    least = _LEAST_OF_A_CAR_WHEEL if is_full_size(columns) else _RADII[0]
    for unit, radius in turning.items():
        if least < radius < _RADII[1]:
            remark = f"unit not stated; in {unit} it is a wheel of {radius:.3g} m radius"
            return replace(s, unit=unit, status="assumed", reason=remark)
    radius = 0.5 / np.pi / slope
    if least < radius < _RADII[1]:
        remark = f"unit not stated; in turns per second, `unit: rad/s, scale: 6.2832`, it is a wheel of {radius:.3g} m"
        return s.left_open(f"{remark} radius")
    return s.left_open(f"{remark}: neither a speed nor the turning of a wheel")


def read_acceleration(s: Suggestion, columns: Mapping[str, np.ndarray], rate: float) -> Suggestion:
    """Leave out an acceleration that nothing supports and that reads gravity while the car stands.

    An a_x that varies less than v_x makes it vary, and has nothing to do with it, lies along another axis.
    """
    if s.status not in ("assumed", "stated") or not {s.channel, "vx"} <= set(columns):
        return s
    if s.channel == "ax" and s.status == "assumed":
        k = _kinematics(columns, rate)
        own, change = k.signal("ax"), k.rate("vx")
        use = k.moving & np.isfinite(own * change)
        less = np.count_nonzero(use) > _REST_SECONDS * rate and np.std(own[use]) < np.std(change[use])
        if less and _go_apart(own, change, k.moving):
            return s.left_open(f"varies less than dv_x/dt {_OTHER_AXIS}")
    standing = np.abs(columns["vx"]) < _AT_REST
    values = columns[s.channel][standing & np.isfinite(columns[s.channel])]
    if len(values) < _REST_SECONDS * rate or abs(np.median(values)) < _TILTED:
        return s
    remark = f"reads {np.median(values):.3g} m/s^2 {_GRAVITY_AT_REST}, so it is not along a level axis"
    return s.left_open(remark)


def without_the_tilted(suggestions: Sequence[Suggestion]) -> list[Suggestion]:
    """Leave out what nothing supports of a sensor whose other axis reads gravity: neither is along the car."""
    why = {_GRAVITY_AT_REST: "reads gravity while the car stands", _OTHER_AXIS: "is not along the car"}
    both = [(s, why[mark]) for s in suggestions for mark in why if s.channel[0] == "a" and mark in s.reason]
    if not both:
        return list(suggestions)
    remark = f"of the sensor of {both[0][0].sources[0]}, which {both[0][1]}"
    return [
        s.left_open(remark) if s.channel in ("ax", "ay") and s.status in ("assumed", "stated") else s
        for s in suggestions
    ]


def read_sideslip(s: Suggestion, columns: Mapping[str, np.ndarray], rate: float) -> Suggestion:
    """Compare a side-slip angle with v_y/v_x, or with the path across yaw; one of the other hand is turned."""
    if s.status == "assumed" and s.unit == "rad" and "sideslip" in columns:
        largest = float(np.nanmax(np.abs(columns["sideslip"]), initial=0.0))
        if largest > np.pi:
            s = replace(s, unit="deg", reason=f"unit not stated; it reaches {largest:.3g}, so degrees")
            columns = {**columns, "sideslip": np.radians(columns["sideslip"])}
    slope = _of_sideslip(columns, rate) if s.status != "open" and {"vx", "sideslip"} <= set(columns) else None
    if slope is None or abs(slope.correlation) < LEAST_CORRELATION or abs(np.log(abs(slope.slope))) > 0.3:
        return s
    remark = f"against v_y/v_x or the path {slope.slope:.3g}"
    if slope.slope < 0.0:
        turned = "its sign is turned; " if s.scale > 0.0 else ""
        remark = f"against v_y/v_x or the path {abs(slope.slope):.3g}"
        return replace(s, scale=-s.scale, status="judged", reason=f"{turned}{remark}")
    return replace(s, status="judged", reason=remark)


def _of_sideslip(columns: Mapping[str, np.ndarray], rate: float) -> Slope | None:
    k = _kinematics(columns, rate)
    if "vy" in columns:
        with np.errstate(divide="ignore", invalid="ignore"):
            return fit_slope(k.signal("sideslip"), k.signal("vy") / k.signal("vx"), k.moving)
    if {"X", "Y", "yaw"} <= set(columns):
        across = np.angle(np.exp(1j * (np.arctan2(k.rate("Y"), k.rate("X")) - k.signal("yaw"))))
        return fit_slope(k.signal("sideslip"), across, k.moving)
    return None
