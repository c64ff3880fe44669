"""Whether v_y, and X, Y from which it may be derived, are of the place where a_y is measured."""

from dataclasses import replace

import numpy as np

from split_cli.logs.checking.checks import ACROSS, Checks, Unjudged
from split_cli.logs.checking.kinematics import fit_linear, has_dependent_columns
from split_cli.logs.checking.relations import ConsistencyFinding
from split_cli.vehicle.parameters import Vehicle

PLACE_IN_DOUBT = "place of v_y"
"""What stands under *could not be judged* where v_y is of no axle, nor of the CG."""
_SURE = 4.0
"""Standard errors from which on a place differs from another [1]."""
_FAR_BETTER = 0.5
"""Of the variance that a place of v_y leaves, below which a factor is reported in its stead, and the reverse [1]."""
_LEAST_FACTOR = 0.15
"""Natural logarithm of a factor of v_y that is reported [1]: less is a place or tyres near their limit."""
_BETTER = 0.5
"""Variance that a place leaves, of what delays, gain and offset leave without it, from which on it is one [1]: a
right log of brisk driving leaves 0.98 to 1.00, half the distance to the rear axle 0.02 to 0.35."""
_NEAR = 0.3
"""Of the distance from the CG to an axle, within which a place is that axle's, or the CG's [1]."""


def place_of_lateral_velocity(checks: Checks, by_accelerometer: bool) -> list[ConsistencyFinding]:
    """Tell where v_y is measured: by the path across yaw, the accelerometer or the sideslip that tyres need.

    In this order, from the surest: the path and the accelerometer need no tyre, and the path no other sensor.
    """
    found = (
        _by_the_path(checks)
        or (behind_the_accelerometer(checks) if by_accelerometer else [])
        or _by_the_sideslip(checks)
    )
    if not found and checks.possible_arm and not any(relation.name == ACROSS for relation in checks.relations):
        name, entry = _name_and_entry(checks)
        reason = f"{name} may be measured {_place_by_the_path(checks.vehicle, checks.possible_arm)}{entry} if so"
        checks.unjudged.append(Unjudged(PLACE_IN_DOUBT, reason))
    return found


def _by_the_path(checks: Checks) -> list[ConsistencyFinding]:
    if not checks.arm:
        return []
    name, entry = _name_and_entry(checks)
    text = f"{name} is measured {_place_by_the_path(checks.vehicle, checks.arm)}{entry}."
    return [ConsistencyFinding("place", "vy", text, checks.vehicle.cg_to_rear_axle - checks.arm, None)]


def _place_by_the_path(car: Vehicle, arm: float) -> str:
    """Say how far behind the CG v_y is measured, `arm` [m], and what the map says then."""
    at = "rear_axle" if arm > 0.0 else "front_axle"
    axle = car.cg_to_rear_axle if arm > 0.0 else -car.cg_to_front_axle
    near = abs(arm - axle) < _NEAR * abs(axle)
    side = "behind" if arm > 0.0 else "ahead of"
    of_axle = f": near the {at.replace('_', ' ')}" if near else ""
    place = at if near else f"{{x: {-arm:.2f}, y: 0.0}}"
    return f"{abs(arm):.2f} m {side} the CG, by the path across yaw{of_axle}. Set `position: {place}`"


def or_its_place(finding: ConsistencyFinding, checks: Checks) -> ConsistencyFinding:
    """Say of a v_y whose sign is blamed that it may be of another place, which fits the path better."""
    if finding.channel != "vy" or finding.check != "sign" or not checks.possible_arm or checks.vehicle is None:
        return finding
    place = _place_by_the_path(checks.vehicle, checks.possible_arm)
    text = f"{finding.text} Or it is measured {place} and keep its sign: that fits the path better."
    return replace(finding, text=text)


def _by_the_sideslip(checks: Checks) -> list[ConsistencyFinding]:
    """Tell from the fit of the sideslip at which distance p ahead of the rear axle v_y is measured.

    The rear tyres need the slip m l_f a/(L C_r), so q > 0; at the CG p is l_r. Between the axle and the CG a place
    is not distinguished from tyres near their limit, and stands under what could not be judged, unless the
    accelerometer is at the same place: it needs no tyre.
    """
    fit = checks.sideslip_fit()
    if fit is None:
        return []
    name, entry = _name_and_entry(checks)
    (p, q), (error, _) = fit[0][:2], fit[1][:2]
    car, l_r = checks.vehicle, checks.vehicle.cg_to_rear_axle
    where = f"{name} follows a place {p:.2f} +- {error:.2f} m ahead of the rear axle, the CG is at {l_r:.2f} m"
    if q > 0.0 and abs(p) < _NEAR * l_r and p + _SURE * error < 0.6 * l_r:
        text = f"{where}: it is measured at the rear axle, or near it. Set `position: rear_axle`{entry}."
        return [ConsistencyFinding("place", "vy", text, float(p), float(error))]
    if q > 0.0 and p - _SURE * error > 1.5 * l_r and abs(p - car.wheelbase) < _NEAR * car.wheelbase:
        text = f"{where}: it is near the front axle: `position: front_axle`{entry}."
        return [ConsistencyFinding("place", "vy", text, float(p), float(error))]
    if q > 0.0 and abs(p - l_r) > _NEAR * l_r + _SURE * error and not checks.beside_accelerometer:
        reason = f"{where}. If the sensor is elsewhere, give its `position:`; tyres near their limit look alike"
        checks.unjudged.append(Unjudged(PLACE_IN_DOUBT, reason))
    return []


def _name_and_entry(checks: Checks) -> tuple[str, str]:
    return ("The side-slip angle", " for `sideslip`") if checks.of_sideslip else ("v_y", "")


def _as_factor(rising: np.ndarray, others: np.ndarray, rest: np.ndarray) -> tuple[float, float]:
    """Return the variance that a factor of v_y leaves of a_y - v_x r - dv_y/dt, and the factor.

    Of a v_y recorded F times too large the rest is (1/F - 1) dv_y/dt as recorded.
    """
    design = np.column_stack([rising, others])
    fitted = np.linalg.lstsq(design, rest, rcond=None)[0]
    factor = 1.0 / (1.0 + fitted[0]) if fitted[0] > -0.9 else np.inf
    if not _LEAST_FACTOR < abs(np.log(factor)) < np.inf:
        return np.inf, 1.0
    left = float(np.var(rest - design @ fitted))
    # A v_y that is mostly error has another size too; of this one what is left is small beside what it says.
    is_error = left > _BETTER**2 * float(np.var(rising)) / factor**2
    return (np.inf, 1.0) if is_error else (left, float(factor))


def behind_the_accelerometer(checks: Checks) -> list[ConsistencyFinding]:
    """Tell how far behind the accelerometer v_y is measured, as far as an axle is from the CG.

    a_y - v_x r - dv_y/dt = x dr/dt + tau v_x dr/dt + sigma da_y/dt + c a_y + b, with x the distance [m]. Delays
    tau of r and sigma of a_y, a gain c and an offset b are not reported, and where they do as well, no place is. A
    message of odometry is often of the middle of the rear axle. A factor of v_y looks much the same: its share of
    dv_y/dt is set against the place.
    """
    k, car = checks.k, checks.vehicle
    if checks.of_pose and not checks.usable("ay"):
        away = "a v_y derived from a pose off the CG is wrong by its distance times r, and no a_y tells the distance"
        checks.unjudged.append(
            Unjudged("place of X, Y", f"{away}: set `position:` for X and Y if they are not of the CG")
        )
    if car is None or not checks.usable("r", "ay") or not checks.known("vx"):
        return []
    if not (checks.of_pose or checks.usable("vy")):
        return []
    lateral, turning = k.signal("ay"), k.rate("r")
    rest = lateral - k.turning() - k.rate("vy")
    delayed = k.rate("ay")
    use = k.moving & np.isfinite(rest * turning * delayed)
    if np.count_nonzero(use) < 300:
        return []
    late = k.signal("vx") * turning
    design = np.stack([part[use] for part in (turning, late, delayed, lateral, np.ones(k.count))], axis=1)
    y = rest[use]
    if has_dependent_columns(design):
        return []
    fitted, errors = fit_linear(design, y)
    x, error = float(fitted[0]), float(errors[0])
    checks.beside_accelerometer = abs(x) + _SURE * error < _NEAR * min(car.cg_to_front_axle, car.cg_to_rear_axle)
    # A delay acts as a place does at one speed; of a large one, the first derivative is not all.
    without = np.delete(design, 0, axis=1)
    rest_without = float(np.var(y - without @ np.linalg.lstsq(without, y, rcond=None)[0]))
    of_place = float(np.var(y - design @ fitted))
    # The path across yaw needs no accelerometer: where it judges v_y, its size is judged by it.
    sized_by_path = checks.of_pose or any(relation.name == ACROSS for relation in checks.relations)
    of_factor, factor = (np.inf, 1.0) if sized_by_path else _as_factor(k.rate("vy")[use], without, y)
    sized = f"v_y changes {factor:.2f} times as much as a_y - v_x r says: `scale: {1.0 / factor:.3f}` puts it right"
    if of_factor < min(_FAR_BETTER * of_place, _BETTER * rest_without):
        return [ConsistencyFinding("size", "vy", f"{sized}, or its unit.", factor, None)]
    if of_place > _BETTER * rest_without:
        return []
    axle, reach = ("rear", car.cg_to_rear_axle) if x > 0.0 else ("front", car.cg_to_front_axle)
    if not max(_SURE * error, _NEAR * reach) < abs(x) < (1.0 + _NEAR) * reach:
        return []
    whose, entries = ("X, Y and v_y of them are", "X and Y") if checks.of_pose else ("v_y is", "vx and vy")
    if checks.of_sideslip:
        whose, entries = "The side-slip angle is", "`sideslip`"
    near = abs(abs(x) - reach) < _NEAR * reach
    place = f"{axle}_axle" if near else f"{{x: {-x:.2f}, y: 0.0}}"
    text = (
        f"{whose} of a point {abs(x):.2f} +- {max(error, 0.01):.2f} m {'behind' if x > 0.0 else 'ahead of'} the "
        f"accelerometer: by a_y - v_x r - dv_y/dt against dr/dt. If that is at the CG"
        f"{f', it is the {axle} axle' if near else ''}: set `position: {place}` for {entries}. If not, give "
        "`position:` of ax and ay."
    )
    if _FAR_BETTER * of_factor < of_place:
        text += f" Or {sized}: these data hardly tell the two apart."
    return [ConsistencyFinding("place", "vy", text, car.cg_to_rear_axle - x, error)]
