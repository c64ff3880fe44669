"""Where the tyres' peaks are, as labels tell it: the vehicle file assumes them, gentle tests leave them open."""

from __future__ import annotations

import numpy as np

from split_cli.control.policy import GRIP_DOUBT, GRIP_RANGE, GRIP_STEP, GRIP_TORQUE
from split_cli.learning.features import FeatureSet
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.tire import lateral_force

__all__ = ["learned_grip"]


def learned_grip(vehicle: Vehicle, features: FeatureSet, z: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the peak of front and rear over the vehicle file's, shape (2,) [1].

    Parameters
    ----------
    vehicle : Vehicle
    features : FeatureSet
    z : ndarray, shape (N, D)
    y : ndarray, shape (N, 3)
        Labels: rates left out of v_x, v_y [m/s^2] and r [rad/s^2].

    Returns
    -------
    ndarray, shape (2,)
        1 where the labels do not contradict it: where no axle came near its peak, where terms of the vehicle alter
        the tyres and so say themselves what they know, or where slip angles are not among the features.

    Notes
    -----
    The labels are forces, m dv_y' = dF_f + dF_r and I_z dr' = l_f dF_f - l_r dF_r (SPLIT paper, the invariant
    matrix, inverted). An axle's whole force D sin(C atan(B alpha)) + dF is compared with
    s D sin(C atan(B alpha/s)), which keeps the slope that gentle tests know and moves the peak. Of all s that fit
    within `GRIP_DOUBT` of the best by least squares, the one nearest to 1 is taken.
    """
    names = features.names
    if not {"alpha_f", "alpha_r"} <= set(names) or not len(z) or not _as_filed(vehicle):
        return np.ones(2)
    if "torque_ratio" in names:
        light = np.abs(z[:, names.index("torque_ratio")]) < GRIP_TORQUE
        z, y = z[light], y[light]
    if not len(z):
        return np.ones(2)
    m, inertia, l_f, l_r = vehicle.mass, vehicle.yaw_inertia, vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle
    front = (l_r * m * y[:, 1] + inertia * y[:, 2]) / (l_f + l_r)
    missing = front, m * y[:, 1] - front
    tires = vehicle.front_tire, vehicle.rear_tire
    alphas = z[:, names.index("alpha_f")], z[:, names.index("alpha_r")]
    return np.array([_scale(*one) for one in zip(tires, alphas, missing, strict=True)])


def _scale(tire, alpha: np.ndarray, missing: np.ndarray) -> float:
    """Return the scale of one axle's peak."""
    force = lateral_force(tire.B, tire.C, tire.D, alpha) + missing
    scales = np.round(np.arange(GRIP_RANGE[0], GRIP_RANGE[1] + 0.5 * GRIP_STEP, GRIP_STEP), 6)
    curves = np.array([s * lateral_force(tire.B / s, tire.C, tire.D, alpha) for s in scales])
    squares = np.square(curves - force).sum(axis=1)
    likely = scales[squares <= squares.min() * (1.0 + GRIP_DOUBT / len(alpha))]
    return float(likely[np.argmin(np.abs(likely - 1.0))])


def _as_filed(vehicle: Vehicle) -> bool:
    """Return whether the tyres are those of the file, whatever the terms do."""
    flow = SingleTrack(vehicle).flow(20.0, 0.3, 0.2, -0.2 * vehicle.max_brake_torque, 0.05)
    pairs = (flow.front, vehicle.front_tire), (flow.rear, vehicle.rear_tire)
    return all((axle.B, axle.C, axle.D) == (tire.B, tire.C, tire.D) for axle, tire in pairs)
