"""Rows that keep the car within the valid region: slip angles within the ellipse, and their difference."""

from dataclasses import dataclass

import numpy as np

from split_cli.control.model import Linearization
from split_cli.control.policy import (
    ALPHA_MAX,
    DALPHA_MAX,
    LEAST_SIDE,
    NO_FORCE,
    P_ELLIPSE,
    P_LONG,
    SATURATED,
    SHARE_LEARNED,
    SHARE_NOMINAL,
    SHARE_STEP,
)
from split_cli.control.residual import ResidualValues
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

SLIP_ROWS = 3
"""Rows a stage that `slip_rows` returns [1]: the slip angle of each axle, and their difference."""


@dataclass(frozen=True)
class Limits:
    """Bounds of the controller, narrower than the region in which samples are learned."""

    # p_long, p_ellipse: shape of the force ellipse [1].
    p_long: float = P_LONG
    p_ellipse: float = P_ELLIPSE
    # alpha_max, dalpha_max: slip angle and difference of slip angles [rad].
    alpha_max: float = ALPHA_MAX
    dalpha_max: float = DALPHA_MAX
    p_unknown: float | None = None  # ellipse where the residual knows nothing [1]; as `p_ellipse` when it is None
    # Whether the slip limits move with the load that driving and braking shift (`load_shift`), the torque is
    # bounded by the ellipse (`torque_limit`), and learned peaks are the residual's prior mean (`PeakShift`).
    guarded: bool = False

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


def nominal_share(vehicle: Vehicle) -> float:
    """Return the share of the peak forces that a vehicle file may use by itself, before anything is learned [1].

    Notes
    -----
    `SHARE_LEARNED` where the file knows the peaks: both axles' D is calibrated or published, or a term of the file
    tells it (grip found by a diagnosis). `SHARE_NOMINAL` where a peak is assumed, or its source is not stated.
    """
    sources = {vehicle.origins.get(f"{axle}.D") for axle in ("front_tire", "rear_tire")}
    known = sources <= {"calibrated", "published"}
    known |= any(CATALOGUE[effect.term].states_peak for effect in vehicle.effects)
    return SHARE_LEARNED if known else SHARE_NOMINAL


def first_share(vehicle: Vehicle) -> float:
    """Return the share of the peak forces that the first lap of a race may use [1].

    Notes
    -----
    That of `nominal_share`, and `SHARE_STEP` less where the file assumes its peaks: on a track that nobody drove
    yet, the nominal model does not know how much side force is left while it brakes into a bend.
    """
    share = nominal_share(vehicle)
    return share if share == SHARE_LEARNED else share - SHARE_STEP


def load_shift(vehicle: Vehicle) -> np.ndarray:
    """Return by which share each axle's load grows with the whole longitudinal force, shape (2,) [1/N].

    Notes
    -----
    Braking moves h/L F_x from the rear axle to the front one, and the peak with it. The nominal single track
    leaves that out of its forces; its limits need not. Zeros where the file has no height of the centre of
    gravity, and where a term of the vehicle moves the peaks with the torque by itself.
    """
    if vehicle.cg_height is None:
        return np.zeros(2)
    model = SingleTrack(vehicle)
    free, braked = (model.flow(20.0, 0.0, 0.0, torque, 0.0) for torque in (0.0, -0.2 * vehicle.max_brake_torque))
    if free.front.D != braked.front.D or free.rear.D != braked.rear.D:
        return np.zeros(2)
    moved = vehicle.cg_height / vehicle.wheelbase
    return np.array([-moved / vehicle.static_load_front, moved / vehicle.static_load_rear])


def torque_limit(
    limits: Limits,
    found: Linearization,
    vehicle: Vehicle,
    grip: np.ndarray | float = 1.0,
    shift: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest braking and driving torque [N m], both positive, shape (N,), that the ellipse allows.

    Notes
    -----
    p_long |F_x| = p_ellipse D of the axle that comes to it first. At this force the slip limit has shrunk to its
    floor and no longer tells that less force would open it, so the force itself is bounded. `grip` and `shift` are
    as of `slip_limit`.
    """
    peak = limits.ellipse(found.residual)[:, None] * found.curve[:, :, 2] * _scale(found, grip, shift)
    shares = (np.array([split, 1.0 - split]) for split in (vehicle.brake_split_front, vehicle.drive_split_front))
    braking, driving = (
        (vehicle.wheel_radius * np.sqrt(SATURATED) * peak / (limits.p_long * np.maximum(share, 1e-9))).min(axis=1)
        for share in shares
    )
    return braking, driving


def _scale(found: Linearization, grip: np.ndarray | float, shift: np.ndarray | float) -> np.ndarray:
    """Return by what the axles' peaks are moved, shape (N, 2)."""
    return grip * np.maximum(1.0 + shift * found.force.sum(axis=1)[:, None], LEAST_SIDE)


def slip_limit(
    limits: Limits, found: Linearization, grip: np.ndarray | float = 1.0, shift: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the largest slip angle of front and rear, and how it falls with the state and bends with the force.

    Returns
    -------
    alpha : ndarray, shape (N, 2)
        The limit [rad].
    slope : ndarray, shape (N, 2, n)
        Its slope by the state.
    curvature : ndarray, shape (N, 2)
        Its second derivative by the axle's own force [rad/N^2], at most zero.

    Notes
    -----
    SPLIT paper, the tire forces constraint, solved for the slip angle:
    |alpha| <= tan(asin(sqrt(p_ellipse^2 - (p_long F_x/D)^2))/C)/B. As a force the constraint's slope changes sign
    past the peak, and a linearised controller then steers into the slide instead of out of it. B, C, D are taken
    as they are at the point; only the forces move with the state. A scale s moves the peaks of front and rear, s D
    and B/s: `grip`, shape (2,) (see `learned_grip`), times 1 + `shift` F_x, shape (2,) (see `load_shift`).

    With the whole peak (p_ellipse 1) the limit has a corner at no force, tan(acos(p_long |F_x|/D)/C)/B. There
    the slope is the mean of both sides, zero, and so is the curvature.
    """
    ellipse = limits.ellipse(found.residual)[:, None]
    scale = _scale(found, grip, shift)
    B, C, D = found.curve[:, :, 0] / scale, found.curve[:, :, 1], found.curve[:, :, 2] * scale
    asked = limits.p_long * found.force / D
    used = np.clip(asked, -np.sqrt(SATURATED) * ellipse, np.sqrt(SATURATED) * ellipse)
    unused = np.maximum(1.0 - ellipse**2, 0.0)
    left, rest = np.sqrt(ellipse**2 - used**2), np.maximum(np.sqrt(unused + used**2), NO_FORCE)
    angle = np.arctan2(left, rest) / C
    alpha = np.tan(angle) / B
    inside = (np.abs(asked) == np.abs(used)) & (alpha < limits.alpha_max)
    by_angle = 1.0 / C / np.cos(angle) ** 2 / B
    by_force = np.where(inside, -used / rest * limits.p_long / D / left * by_angle, 0.0)
    bend = 2.0 * np.tan(angle) / C * (used / rest) ** 2 - (used**4 + unused * ellipse**2) / left / rest**3
    curvature = np.where(
        alpha < limits.alpha_max, np.minimum(bend, 0.0) * by_angle * (limits.p_long / D / left) ** 2, 0.0
    )
    by_scale = np.where(inside, alpha / scale + used**2 / rest / scale / left * by_angle, 0.0)
    of_whole = by_scale * grip * shift
    slope = by_force[:, :, None] * found.force_slope
    slope += of_whole[:, :, None] * found.force_slope.sum(axis=1)[:, None, :]
    return np.minimum(alpha, limits.alpha_max), slope, curvature


def slip_rows(
    limits: Limits, found: Linearization, grip: np.ndarray | float = 1.0, shift: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return rows C (N, 3, n) of a step dx, with lower and upper bounds (N, 3), and how an axle's rows bend.

    The latter, of shape (N, 2, n, n), is the second derivative by the state of what its rows bound, not negative.
    One row an axle, one for the difference of slip angles.

    Parameters
    ----------
    grip, shift : ndarray, shape (2,)
        As of `slip_limit`.

    Notes
    -----
    An axle slips to one side, and cannot reach both ends of -limit <= alpha <= limit in one programme. So its row
    is alpha - side limit with the side to which it slips, and the limit moves with the state at this end. The other
    end stays where it is at the point, so that no step leads through to the far side. A row for each end has the
    same answers (5e-5 of the scaled inputs on 240 programmes of races) and takes an eighth longer.
    """
    bound, slope, curvature = slip_limit(limits, found, grip, shift)
    count, n = found.slip_slope.shape[0], found.slip_slope.shape[2]
    C = np.empty((count, SLIP_ROWS, n))
    lower, upper = np.empty((count, SLIP_ROWS)), np.empty((count, SLIP_ROWS))
    side = np.where(found.slip < 0.0, -1.0, 1.0)
    C[:, :2] = found.slip_slope - side[:, :, None] * slope
    lower[:, :2], upper[:, :2] = -bound - found.slip, bound - found.slip
    C[:, 2] = found.slip_slope[:, 0] - found.slip_slope[:, 1]
    difference = found.slip[:, 0] - found.slip[:, 1]
    lower[:, 2], upper[:, 2] = -limits.dalpha_max - difference, limits.dalpha_max - difference
    bend = -curvature[:, :, None, None] * found.force_slope[:, :, :, None] * found.force_slope[:, :, None, :]
    return C, lower, upper, bend
