"""Forces at the axles that a recording shows, beside those of models."""

from dataclasses import dataclass

import numpy as np

from split_cli.learning.features import Z2, flow_along
from split_cli.learning.labels import Labels, compute_labels
from split_cli.logs.drive import Drive
from split_cli.prediction import Prediction
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack


@dataclass(frozen=True)
class AxleForces:
    """Forces over one drive; columns are total longitudinal, front lateral and rear lateral force [N]."""

    labels: Labels  # of the nominal model, finite ones only
    slip: np.ndarray  # (N, 2): front and rear slip angle of the nominal model [rad]
    torque: np.ndarray  # (N,): [N m]
    # nominal, measured: (N, 3)
    nominal: np.ndarray
    measured: np.ndarray


def forces_of_rates(vehicle: Vehicle, rates: np.ndarray) -> np.ndarray:
    """Return rates left out, shape (N, 3), as forces [N] through the inverse of the invariant matrix."""
    return rates @ np.linalg.inv(vehicle.force_matrix()).T


def axle_forces(drive: Drive, vehicle: Vehicle) -> AxleForces:
    """Return the forces that a drive shows at the axles of a vehicle.

    Notes
    -----
    What is measured is the nominal model's force plus the label of that moment as a force (design: forces are
    computed from y, never from a damped average), so the cloud does not depend on the label interval.
    """
    labels = compute_labels(drive, vehicle, Z2)
    labels = labels.take(np.isfinite(labels.y).all(axis=1))
    model = SingleTrack(vehicle)
    flow = flow_along(model, drive)
    every = np.zeros(len(drive))
    columns = (
        flow.front.longitudinal_force + flow.rear.longitudinal_force + every,
        flow.front.lateral_force + every,
        flow.rear.lateral_force + every,
    )
    nominal = np.stack(columns, axis=1)[labels.row]
    slip = np.stack([flow.front.slip_angle + every, flow.rear.slip_angle + every], axis=1)[labels.row]
    return AxleForces(labels, slip, drive["T"][labels.row], nominal, nominal + forces_of_rates(vehicle, labels.y))


def force_deviation(vehicle: Vehicle, prediction: Prediction) -> np.ndarray:
    """Return the standard deviation of a predicted residual as forces [N], shape (N, 3)."""
    matrix = np.linalg.inv(vehicle.force_matrix())
    deviation: np.ndarray = np.sqrt(prediction.variance @ (matrix**2).T)
    return deviation


def binned(
    x: np.ndarray, values: np.ndarray, width: float, fewest: int = 8
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centres of equal bins, the mean in each, and the standard deviation in each; NaN-free.

    Parameters
    ----------
    x, values : ndarray, shape (N,)
    width : float
        Of a bin, in units of `x`.
    fewest : int
        Bins with fewer samples are left out.
    """
    cell = np.floor(x / width).astype(int)
    names, inverse, count = np.unique(cell, return_inverse=True, return_counts=True)
    mean = np.bincount(inverse, values) / count
    square = np.bincount(inverse, values**2) / count
    kept = count >= fewest
    return (names[kept] + 0.5) * width, mean[kept], np.sqrt(np.maximum(square - mean**2, 0.0))[kept]
