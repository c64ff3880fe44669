"""Common operating points: which rows of a recording lie where the simulation has been.

A row is compared if any of three descriptions of it is near a simulated row: slip angles, torque and speed as
commanded; axle forces and speed as the motion shows them, below the tyres' limit; or slip angles, speed and
longitudinal force. The second keeps rows whose commands or velocities are scaled or turned by a fault while the car
moves as it did. The third does so for torque, up to the limit.

A row is left out if an axle's lateral force is far beyond any in the simulation. With tyres that are too soft in the
vehicle file, or with an offset of v_y, such a row may have the slip angles of a gentle turn.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy, features
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.segment_means import SMOOTHED_SECONDS
from split_cli.diagnosis.recording.series import extended_model
from split_cli.vehicle.tire import is_beyond_peak


def comparable(
    one: Evidence,
    simulated: Sequence[Evidence],
    discrepancy: SharedDiscrepancy,
    reach: float,
    policy: Policy = STANDARD,
) -> np.ndarray:
    """Return which rows of a recording are fast enough and near a simulated row, bool, shape (G,).

    Parameters
    ----------
    simulated : sequence of Evidence
        Empty if the nominal model is the simulation. Rows of weight 0 do not count.
    reach : float
        Largest distance from the nearest simulated row, in scaled features [1].
    """
    fast = one.series.smooth[one.at, 0] >= policy.screening.valid_speed * one.vehicle.minimum_speed
    usable = fast & (one.weight > 0.0)
    if not simulated:
        return usable

    def asked(evidence: Evidence) -> np.ndarray:
        return (features(evidence.series, evidence.vehicle)[evidence.at] - discrepancy.center) / discrepancy.width

    believed = [evidence.weight > 0.0 for evidence in simulated]
    there = np.concatenate([asked(evidence)[rows] for evidence, rows in zip(simulated, believed, strict=True)])
    moved = np.concatenate([_forces(evidence)[rows] for evidence, rows in zip(simulated, believed, strict=True)])
    scale = np.maximum(np.quantile(np.abs(moved), 0.995, axis=0), 1e-9)
    scale[3] = discrepancy.width[3]
    wanted, mine = asked(one), _forces(one)
    # Near the tyres' limit the same forces may belong to other slip angles, so that near forces prove nothing.
    sure = (_share_of_grip(mine, one) < policy.believing.motion_share) & ~_slides(one)
    # With the same slip angles, speed and longitudinal force the tyres act alike, also at their limit.
    slipped, had_slipped = (
        np.column_stack([rows[:, [0, 1, 3]], forces[:, 2] / scale[2]])
        for rows, forces in ((wanted, mine), (there, moved))
    )
    return (
        usable
        & _within(*((rows / scale)[:, :2] for rows in (mine, moved)), reach)
        & (
            _near(wanted, there, reach)
            | (sure & _near(mine / scale, moved / scale, reach))
            | _near(slipped, had_slipped, reach)
        )
    )


def _within(forces: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:
    """Return which scaled lateral forces (N, 2) exceed the range of others (M, 2) by at most `reach`, bool (N,)."""
    low, high = others.min(axis=0) - reach, others.max(axis=0) + reach
    return np.all((forces > low) & (forces < high), axis=1)


def _near(points: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(others).query(points, k=1, distance_upper_bound=reach)
    return np.isfinite(distance)


def _forces(one: Evidence) -> np.ndarray:
    """Return front and rear lateral force, longitudinal force [N] from the motion, and v_x [m/s], shape (G, 4)."""
    series, car = one.series, one.vehicle
    size = max(1, int(round(SMOOTHED_SECONDS / series.period)))
    rates = np.zeros_like(series.smooth)
    for begin, end in series.recording.segments:
        if end - begin > 2:
            slope = np.gradient(series.smooth[begin:end], series.period, axis=0)
            rates[begin:end] = uniform_filter1d(slope, size, axis=0, mode="nearest")
    vx, vy, r = series.smooth.T
    along = car.mass * (rates[:, 0] - vy * r)
    side = car.mass * (rates[:, 1] + vx * r)
    turn = car.yaw_inertia * rates[:, 2]
    front = (side * car.cg_to_rear_axle + turn) / car.wheelbase
    return np.stack([front, side - front, along, vx], axis=1)[one.at]


def _share_of_grip(forces: np.ndarray, one: Evidence) -> np.ndarray:
    """Return the used share of the peak force, of the axle that uses more, shape (G,) [1]."""
    front, rear = one.vehicle.front_tire.D, one.vehicle.rear_tire.D
    share = np.abs(forces[:, 2]) / (front + rear)
    return np.hypot(np.maximum(np.abs(forces[:, 0]) / front, np.abs(forces[:, 1]) / rear), share)


def _slides(one: Evidence) -> np.ndarray:
    """Return where the rear slip angle is beyond the peak of the tyre curve, bool, shape (G,).

    Notes
    -----
    A fault of commands changes the front slip angle only. A large rear slip
    angle at small forces means that the velocities are wrong, as before a navigation system has found its heading.
    """
    rear = one.series.flow(extended_model(one.vehicle)).rear
    return is_beyond_peak(rear.B, rear.C, rear.slip_angle)[one.at]
