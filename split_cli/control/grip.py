"""Where the tyres' peaks are, as labels tell it: the vehicle file assumes them, gentle tests leave them open.

The peaks bound the slip angles, and they are the prior mean of a residual: what it says where it has no data.
"""

import numpy as np

from split_cli.control.policy import GRIP_DOUBT, GRIP_RANGE, GRIP_STEP, GRIP_TORQUE
from split_cli.learning.features import FeatureSet
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.tire import lateral_force, lateral_force_slope


def tells_peaks(vehicle: Vehicle, features: FeatureSet) -> bool:
    """Return whether labels of these features can tell where the peaks are.

    Slip angles have to be among them, and no term of the vehicle may alter the tyres, since it says itself what it
    knows.
    """
    return {"alpha_f", "alpha_r"} <= set(features.names) and _as_filed(vehicle)


def learned_grip(
    vehicle: Vehicle, features: FeatureSet, z: np.ndarray, y: np.ndarray, assumed: float = 1.0
) -> np.ndarray:
    """Return the peak of front and rear over the vehicle file's, shape (2,) [1].

    Parameters
    ----------
    z : ndarray, shape (N, D)
    y : ndarray, shape (N, 3)
        Labels: rates left out of v_x, v_y [m/s^2] and r [rad/s^2].
    assumed : float
        What the peaks are taken for without labels [1].

    Returns
    -------
    ndarray, shape (2,)
        `assumed` where the labels do not contradict it: where no axle came near its peak, or where `tells_peaks`
        is false.

    Notes
    -----
    The labels are forces, m dv_y' = dF_f + dF_r and I_z dr' = l_f dF_f - l_r dF_r (SPLIT paper, the invariant
    matrix, inverted). An axle's whole force D sin(C atan(B alpha)) + dF is compared with
    s D sin(C atan(B alpha/s)), which keeps the slope that gentle tests know and moves the peak. Of all s that fit
    within `GRIP_DOUBT` of the best by least squares, the one nearest to `assumed` is taken: below their peaks
    tyres tell little of them, and the range of s that fits is wide.
    """
    names = features.names
    if not len(z) or not tells_peaks(vehicle, features):
        return np.full(2, assumed)
    if "torque_ratio" in names:
        light = np.abs(z[:, names.index("torque_ratio")]) < GRIP_TORQUE
        z, y = z[light], y[light]
    if not len(z):
        return np.full(2, assumed)
    m, inertia, l_f, l_r = vehicle.mass, vehicle.yaw_inertia, vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle
    front = (l_r * m * y[:, 1] + inertia * y[:, 2]) / (l_f + l_r)
    missing = front, m * y[:, 1] - front
    tires = vehicle.front_tire, vehicle.rear_tire
    alphas = z[:, names.index("alpha_f")], z[:, names.index("alpha_r")]
    return np.array([_scale(*one, assumed) for one in zip(tires, alphas, missing, strict=True)])


class PeakShift:
    """The rates that a vehicle's model leaves out when its tyres' peaks are others than the file's.

    Parameters
    ----------
    features : FeatureSet
        Slip angles are among them.
    grip : ndarray, shape (2,)
        Peak of front and rear over the file's [1], as `learned_grip` returns it.
    """

    def __init__(self, vehicle: Vehicle, features: FeatureSet, grip: np.ndarray) -> None:
        m, inertia = vehicle.mass, vehicle.yaw_inertia
        arms = vehicle.cg_to_front_axle, -vehicle.cg_to_rear_axle
        names = features.names
        self._axles = [
            (names.index(name), tire, float(scale), np.array([0.0, 1.0 / m, arm / inertia]))
            for name, tire, scale, arm in zip(
                ("alpha_f", "alpha_r"), (vehicle.front_tire, vehicle.rear_tire), grip, arms, strict=True
            )
        ]

    def at(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rates, shape (N, 3), of v_x, v_y [m/s^2] and r [rad/s^2] at features `z`, shape (N, D), and their
        Jacobian, shape (N, 3, D).

        Notes
        -----
        dF = s D sin(C atan(B alpha/s)) - D sin(C atan(B alpha)) of each axle, turned into rates as `learned_grip`
        turns labels into forces: cos(delta) is 1, and what a steered wheel takes from v_x is left out.
        """
        mean, slope = np.zeros((len(z), 3)), np.zeros((len(z), 3, z.shape[1]))
        for column, tire, s, rates in self._axles:
            alpha = z[:, column]
            force, steepness = (
                s * law(tire.B / s, tire.C, tire.D, alpha) - law(tire.B, tire.C, tire.D, alpha)
                for law in (lateral_force, lateral_force_slope)
            )
            mean += force[:, None] * rates
            slope[:, :, column] += steepness[:, None] * rates
        return mean, slope


def _scale(tire, alpha: np.ndarray, missing: np.ndarray, assumed: float) -> float:
    """Return the scale of one axle's peak, of those that fit the one nearest to `assumed`."""
    force = lateral_force(tire.B, tire.C, tire.D, alpha) + missing
    scales = np.round(np.arange(GRIP_RANGE[0], GRIP_RANGE[1] + 0.5 * GRIP_STEP, GRIP_STEP), 6)
    curves = np.array([s * lateral_force(tire.B / s, tire.C, tire.D, alpha) for s in scales])
    squares = np.square(curves - force).sum(axis=1)
    likely = scales[squares <= squares.min() * (1.0 + GRIP_DOUBT / len(alpha))]
    return float(likely[np.argmin(np.abs(likely - assumed))])


def _as_filed(vehicle: Vehicle) -> bool:
    """Return whether the tyres are those of the file, whatever the terms do."""
    flow = SingleTrack(vehicle).flow(20.0, 0.3, 0.2, -0.2 * vehicle.max_brake_torque, 0.05)
    pairs = (flow.front, vehicle.front_tire), (flow.rear, vehicle.rear_tire)
    return all((axle.B, axle.C, axle.D) == (tire.B, tire.C, tire.D) for axle, tire in pairs)
