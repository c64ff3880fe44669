"""Common operating points: the rows of a recording whose operating point the simulation has visited too.

It has been there if it was asked for the same, or if it moved the same. A steering that is scaled, a velocity that
is turned, take every turn away from where the simulation was asked to be, and the car still moves as it did. A
torque that is scaled does so on every straight, and the tyres still slip as they did and push as they did.

But where axles push harder to a side than they ever did, slips say nothing of what the simulation knows. With a
vehicle file whose tyres are too soft, or a velocity beside its zero, a hard turn to one side has the slips of a
gentle one to the other.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy, features
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.segment_means import SMOOTHED_SECONDS
from split_cli.diagnosis.recording.series import extended_model


def comparable(
    one: Evidence,
    simulated: Sequence[Evidence],
    discrepancy: SharedDiscrepancy,
    reach: float,
    policy: Policy = STANDARD,
) -> np.ndarray:
    """Return the rows of a recording that are fast enough and near where a simulation has been, shape (G,).

    Parameters
    ----------
    simulated : sequence of Evidence
        None, if the nominal model is the simulation; only rows of positive weight count.
    reach : float
        How far a row may be from the nearest simulated one, in scaled features.
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
    # Nearer the tyres' limit the same motion may come of other slips, and a row nearby proves nothing.
    sure = (_share_of_grip(mine, one) < policy.believing.motion_share) & ~_slides(one)
    # At the same slips, speed and force along the car, the tyres do the same at their limit, too.
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
    """Return which lateral forces (N, 2) are no further than `reach` beyond those of others (M, 2), shape (N,)."""
    low, high = others.min(axis=0) - reach, others.max(axis=0) + reach
    return np.all((forces > low) & (forces < high), axis=1)


def _near(points: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(others).query(points, k=1, distance_upper_bound=reach)
    return np.isfinite(distance)


def _forces(one: Evidence) -> np.ndarray:
    """Return what the motion says: lateral force of the axles, force along the car [N], and v_x [m/s], (G, 4)."""
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
    """Return which share of the tyres' peak forces a motion takes, the busier axle's, shape (G,)."""
    front, rear = one.vehicle.front_tire.D, one.vehicle.rear_tire.D
    share = np.abs(forces[:, 2]) / (front + rear)
    return np.hypot(np.maximum(np.abs(forces[:, 0]) / front, np.abs(forces[:, 1]) / rear), share)


def _slides(one: Evidence) -> np.ndarray:
    """Return where the rear axle slips beyond its tyres' peak, shape (G,).

    Notes
    -----
    The peak is at C arctan(B |alpha|) = pi/2. A scaled or late command moves the front axle's slip, none the
    rear's: a car that slides without the forces of sliding is recorded with another's velocity, as before a
    navigation system has found its heading.
    """
    rear = one.series.flow(extended_model(one.vehicle)).rear
    return (rear.C * np.arctan(rear.B * np.abs(rear.slip_angle)) > 0.5 * np.pi)[one.at]
