"""Whether T is what the motion takes, both driving and braking: without the brakes, or of one axle, it is not."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from split_cli.logs.checking.checks import TORQUE_TOLERANCE, Checks
from split_cli.logs.checking.kinematics import fit_linear, has_dependent_columns
from split_cli.logs.checking.relations import ConsistencyFinding
from split_cli.vehicle.parameters import Vehicle

_SURE = 3.0
"""Standard errors by which a share is beyond a bound, and the two shares differ [1]; judgement."""
_OFF = 0.2
"""Share by which T differs from what the motion takes, or its two sides differ, where that is reported [1].

Sound drives of simulated cars read 0.94 to 1.11 (`tests.studies.torque_factors`); rotating masses and losses of real
ones give as much. Judgement."""
_LIKE = 0.5 * _OFF
"""Distance of a share to that of a known cause, beside its error, within which it may be that [1]."""
_DERIVE = "`--derive torque-from-acceleration`"
_LEAST_ROWS = 100
"""Samples of driving, and of braking, that a share is measured on [1]; judgement."""
_ROUNDS = 8
"""Gauss-Newton steps [1]: shares of the bundled drives of the road car move by less than 1e-4 after three."""


@dataclass(frozen=True)
class _TorqueShares:
    """T over what the motion takes, where the car is driven and where it is braked."""

    # shares, errors: driving and braking, with standard errors from blocks of time [1].
    shares: np.ndarray
    errors: np.ndarray

    def are_like(self, driving: float, braking: float) -> bool:
        return bool(np.all(np.abs(self.shares - (driving, braking)) <= _LIKE + self.errors))


def torque_sides(checks: Checks, wrong: Collection[str], has_factor: bool = False) -> list[ConsistencyFinding]:
    """Compare T with what the motion takes, apart where that drives and where it brakes.

    Parameters
    ----------
    wrong : collection of str
        Channels that are off by what nothing tells: with delta or r among them, turning is left out.
    has_factor : bool
        Whether one factor was found that puts T right as a whole. The shares have to differ by more than the
        tolerance then.

    Notes
    -----
    What differs by 20 % and lies within the tolerance may be the car's, and is reported as a remark.
    """
    sides = _measure(checks, not {"delta", "r"} & set(wrong))
    if sides is None:
        return []
    car, shares, margins = checks.vehicle, sides.shares, _SURE * sides.errors
    assert car is not None  # without one nothing is measured

    def are_beyond(bound: float) -> bool:
        return bool(np.any((shares + margins < 1.0 / bound) | (shares - margins > bound)))

    within = np.exp(TORQUE_TOLERANCE)
    uneven = abs(shares[0] - shares[1]) - np.hypot(*margins) > _OFF * np.abs(shares).max()
    one_will_do = has_factor and (not uneven or shares.min() * within > shares.max())
    if one_will_do or not (uneven or are_beyond(1.0 + _OFF)):
        return []
    driving, braking = (f"{s:.2f} +- {max(e, 0.01):.2f}" for s, e in zip(shares, sides.errors, strict=True))
    takes = f"the torque that the motion takes with the file's mass of {car.mass:g} kg and wheel radius of "
    takes += f"{car.wheel_radius:g} m"
    text = f"T is {driving} times {takes} where the car is driven, and {braking} times where it is braked"
    known = [words for words, share in _known_causes(car, shares) if sides.are_like(*share)]
    if known:
        text += f". It may be {', or '.join(known)}"
    elif uneven:
        text += ". The brakes or the other axle are missing from it, or counted twice"
    else:
        fits = float(np.mean(shares)) * car.mass * car.wheel_radius
        text += f". A mass times wheel radius of {fits:.3g} kg m would fit, or another gear ratio"
    if are_beyond(within):
        check, text = "scale", f"{text}. Correct it in the map, or leave T out and pass {_DERIVE}."
    else:
        check = "uneven" if uneven else "factor"
        text = f"{text}; or the car drives or brakes otherwise than T says. Look at its entry in the map."
    worst = int(np.argmax(np.abs(np.log(np.maximum(shares, 1e-3)))))
    return [ConsistencyFinding(check, "T", text, float(shares[worst]), float(sides.errors[worst]))]


def _measure(checks: Checks, turning: bool) -> _TorqueShares | None:
    """Fit T = s_d max(N + R, 0) + s_b min(N + R, 0), with R = c + d v_x^2 for rolling and drag.

    N is what accelerating takes, and the front tyres in a turn where `turning`: r_e m (v_x' - v_y r + l_r/L v_x r
    sin delta). R is fitted, since files leave it out: it moves the zero of T, so that a T without brakes has a share
    of 0 there and of 1 where it drives.
    """
    parts = checks.torque_parts()
    if parts is None:
        return None
    k, car = checks.k, checks.vehicle
    inertial, speed, torque = parts[0], k.signal("vx"), k.signal("T")
    if turning and checks.usable("delta") and checks.known("r") and car is not None:
        columns, lever = k.columns, car.wheel_radius * car.mass * car.cg_to_rear_axle / car.wheelbase
        front = k.of("vx r sin delta", lambda: columns["vx"] * columns["r"] * np.sin(columns["delta"]))
        inertial = inertial + lever * front
    use = k.moving & np.isfinite(inertial) & np.isfinite(torque)
    inertial, torque, speed = inertial[use], torque[use], speed[use]
    resistance = parts[1][use]
    for _ in range(_ROUNDS):
        needed = inertial + resistance
        if min(np.count_nonzero(needed > 0.0), np.count_nonzero(needed < 0.0)) < _LEAST_ROWS:
            return None
        sides = (np.maximum(needed, 0.0), np.minimum(needed, 0.0))
        slopes = np.linalg.lstsq(np.stack(sides, axis=1), torque, rcond=None)[0]
        slope = np.where(needed > 0.0, *slopes)
        design = np.stack([*sides, slope, slope * speed**2], axis=1)
        if has_dependent_columns(design):
            return None
        shares, errors = fit_linear(design, torque)
        resistance = resistance + shares[2] + shares[3] * speed**2
    return _TorqueShares(shares[:2], errors[:2])


def _known_causes(car: Vehicle, shares: np.ndarray) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield what T often is in place of the sum at the wheels, in words, with its shares driving and braking.

    A share of 0 tells what is missing, whatever a wrong mass or wheel radius of the file makes of the other one.
    """
    driving, braking = np.clip(shares, np.exp(-TORQUE_TOLERANCE), np.exp(TORQUE_TOLERANCE))
    yield "without the brakes", (driving, 0.0)
    yield "without the drive", (0.0, braking)
    yield "that of one of two wheels", (0.5, 0.5)
    yield "in lbf ft", (0.73756, 0.73756)
    front, brakes = car.drive_split_front, car.brake_split_front
    for axle, drives, brakes_too in (("front", front, brakes), ("rear", 1.0 - front, 1.0 - brakes)):
        if 0.0 < drives + brakes_too < 2.0:
            yield f"that of the {axle} axle", (drives, brakes_too)
        if 0.0 < drives < 1.0:
            yield f"that of the {axle} axle without the brakes", (drives, 0.0)
