"""Rows that keep the car within the valid region: slip angles within the ellipse, and their difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from split_cli.control.model import Linearization
from split_cli.vehicle.parameters import Vehicle

__all__ = ["SLIP_ROWS", "Limits", "slip_limit", "slip_rows"]

SLIP_ROWS = 5


@dataclass(frozen=True)
class Limits:
    """Bounds of the controller, narrower than the region in which samples are learned.

    Attributes
    ----------
    p_long, p_ellipse : float
        Shape of the force ellipse [1].
    alpha_max, dalpha_max : float
        Slip angle and difference of slip angles [rad].
    """

    p_long: float = 0.9
    p_ellipse: float = 0.95
    alpha_max: float = 0.18
    dalpha_max: float = 0.10


def slip_limit(vehicle: Vehicle, limits: Limits, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest slip angle of front and rear [rad] and its slope by torque, each shape (N, 2).

    Notes
    -----
    SPLIT paper, the tire forces constraint, solved for the slip angle:
    |alpha| <= tan(asin(sqrt(p_ellipse^2 - (p_long F_x/D)^2))/C)/B. As a force the constraint's slope changes sign
    past the peak, and a linearised controller then steers into the slide instead of out of it.
    """
    kappa = np.where(torque < 0.0, vehicle.brake_split_front, vehicle.drive_split_front)
    out, slope = np.empty((len(torque), 2)), np.empty((len(torque), 2))
    parts = (
        (vehicle.front_tire, kappa, vehicle.rolling_resistance_front),
        (vehicle.rear_tire, 1.0 - kappa, vehicle.rolling_resistance_rear),
    )
    for axle, (tire, share, rolling) in enumerate(parts):
        gain = limits.p_long / tire.D
        used = gain * (share * torque / vehicle.wheel_radius - rolling)
        # An axle that brakes with all it has keeps a tenth of its side force, so that a slope is left.
        left = np.sqrt(np.maximum(limits.p_ellipse**2 - used**2, (0.1 * limits.p_ellipse) ** 2))
        angle = np.arcsin(left) / tire.C
        alpha = np.tan(angle) / tire.B
        inside = (used**2 < 0.99 * limits.p_ellipse**2) & (alpha < limits.alpha_max)
        d_left = -used * gain * share / vehicle.wheel_radius / left
        d_alpha = d_left / np.sqrt(1.0 - left**2) / tire.C / np.cos(angle) ** 2 / tire.B
        out[:, axle] = np.minimum(alpha, limits.alpha_max)
        slope[:, axle] = np.where(inside, d_alpha, 0.0)
    return out, slope


def slip_rows(
    vehicle: Vehicle, limits: Limits, torque: np.ndarray, found: Linearization, free: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows C (N, 5, n) of a step dx, with lower and upper bounds (N, 5).

    Two rows an axle (alpha - limit <= 0 and alpha + limit >= 0), one for the difference of slip angles.

    Parameters
    ----------
    torque : ndarray, shape (N,)
        At the points of linearisation [N m].
    free : float
        What stands for no bound.
    """
    bound, slope = slip_limit(vehicle, limits, torque)
    count, n = found.slip_slope.shape[0], found.slip_slope.shape[2]
    C = np.zeros((count, SLIP_ROWS, n))
    lower, upper = np.full((count, SLIP_ROWS), -free), np.full((count, SLIP_ROWS), free)
    for axle in range(2):
        for side, row in ((1.0, 2 * axle), (-1.0, 2 * axle + 1)):
            C[:, row] = found.slip_slope[:, axle]
            C[:, row, 6] -= side * slope[:, axle]
            gap = side * bound[:, axle] - found.slip[:, axle]
            (upper if side > 0 else lower)[:, row] = gap
    C[:, 4] = found.slip_slope[:, 0] - found.slip_slope[:, 1]
    difference = found.slip[:, 0] - found.slip[:, 1]
    lower[:, 4], upper[:, 4] = -limits.dalpha_max - difference, limits.dalpha_max - difference
    return C, lower, upper
