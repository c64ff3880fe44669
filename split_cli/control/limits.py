"""Rows that keep the car within the valid region: slip angles within the ellipse, and their difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from split_cli.control.model import Linearization
from split_cli.control.policy import ALPHA_MAX, DALPHA_MAX, LEAST_SIDE, P_ELLIPSE, P_LONG, SATURATED
from split_cli.control.residual import ResidualValues

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
    p_unknown : float or None
        Ellipse where the residual knows nothing [1]; as `p_ellipse` when it is None.
    """

    p_long: float = P_LONG
    p_ellipse: float = P_ELLIPSE
    alpha_max: float = ALPHA_MAX
    dalpha_max: float = DALPHA_MAX
    p_unknown: float | None = None

    def ellipse(self, residual: ResidualValues) -> np.ndarray:
        """Return the share of the axles' peak that may be used at N places, shape (N,).

        Notes
        -----
        From `p_unknown` where nothing was learned to `p_ellipse` where everything is known, in proportion to the
        knowledge 1 - variance/prior of v_y and r, the lesser of the two. Beyond its data a process says zero, and
        so the nominal model speaks: the very model whose grip is not to be trusted there.
        """
        if self.p_unknown is None:
            return np.full(len(residual.mean), self.p_ellipse)
        known = residual.knowledge[:, 1:].min(axis=1)
        return self.p_unknown + known * (self.p_ellipse - self.p_unknown)


def slip_limit(
    limits: Limits, found: Linearization, grip: np.ndarray | float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest slip angle of front and rear [rad], shape (N, 2), and its slope by the state (N, 2, n).

    Notes
    -----
    SPLIT paper, the tire forces constraint, solved for the slip angle:
    |alpha| <= tan(asin(sqrt(p_ellipse^2 - (p_long F_x/D)^2))/C)/B. As a force the constraint's slope changes sign
    past the peak, and a linearised controller then steers into the slide instead of out of it. B, C, D are taken
    as they are at the point; only the force moves with the state. `grip`, shape (2,), moves the peaks of front and
    rear: grip D, B/grip (see `learned_grip`).
    """
    ellipse = limits.ellipse(found.residual)[:, None]
    B, C, D = found.curve[:, :, 0] / grip, found.curve[:, :, 1], found.curve[:, :, 2] * grip
    used = limits.p_long * found.force / D
    left = np.sqrt(np.maximum(ellipse**2 - used**2, (LEAST_SIDE * ellipse) ** 2))
    angle = np.arcsin(left) / C
    alpha = np.tan(angle) / B
    inside = (used**2 < SATURATED * ellipse**2) & (alpha < limits.alpha_max)
    by_force = -used * limits.p_long / D / left / np.sqrt(1.0 - left**2) / C / np.cos(angle) ** 2 / B
    slope = np.where(inside, by_force, 0.0)[:, :, None] * found.force_slope
    return np.minimum(alpha, limits.alpha_max), slope


def slip_rows(
    limits: Limits, found: Linearization, free: float, grip: np.ndarray | float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows C (N, 5, n) of a step dx, with lower and upper bounds (N, 5).

    Two rows an axle (alpha - limit <= 0 and alpha + limit >= 0), one for the difference of slip angles.

    Parameters
    ----------
    limits : Limits
    found : Linearization
    free : float
        What stands for no bound.
    grip : ndarray, shape (2,)
        Peak of front and rear over the model's [1].
    """
    bound, slope = slip_limit(limits, found, grip)
    count, n = found.slip_slope.shape[0], found.slip_slope.shape[2]
    C = np.zeros((count, SLIP_ROWS, n))
    lower, upper = np.full((count, SLIP_ROWS), -free), np.full((count, SLIP_ROWS), free)
    for axle in range(2):
        for side, row in ((1.0, 2 * axle), (-1.0, 2 * axle + 1)):
            C[:, row] = found.slip_slope[:, axle] - side * slope[:, axle]
            gap = side * bound[:, axle] - found.slip[:, axle]
            (upper if side > 0 else lower)[:, row] = gap
    C[:, 4] = found.slip_slope[:, 0] - found.slip_slope[:, 1]
    difference = found.slip[:, 0] - found.slip[:, 1]
    lower[:, 4], upper[:, 4] = -limits.dalpha_max - difference, limits.dalpha_max - difference
    return C, lower, upper
