"""How large labels are that sensor noise alone makes."""

from __future__ import annotations

import numpy as np

from split_cli.learning.labels import Labels
from split_cli.logs.drive import Drive
from split_cli.vehicle.integration import phi_matrix
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

__all__ = ["label_noise_variance", "scatter_variance"]

_AT_MOST = 2000


def label_noise_variance(drive: Drive, vehicle: Vehicle, labels: Labels) -> np.ndarray | None:
    """Return the variance of labels from the noise of v_x, v_y and r, shape (3,), or None if that is not known.

    Parameters
    ----------
    drive : Drive
        With the noise estimates of ingest.
    vehicle : Vehicle
    labels : Labels
        Of that drive; the mean is over the accepted ones, at most 2,000 of them, evenly chosen.

    Notes
    -----
    An error e of the recorded velocities makes the label Phi^-1 (e(t + h) - exp(A h) e(t))/h, to first order in e;
    e(t) and e(t + h) are correlated as the drive's filter has made them. Noise of torque and steer angle is not
    in it: both are commands in most drives.
    """
    estimates = [drive.metadata.noise_of(name) for name in ("vx", "vy", "r")]
    rows = labels.row[labels.accepted]
    if not len(rows) or any(estimate is None or estimate.sigma is None for estimate in estimates):
        return None
    rows = rows[:: max(1, len(rows) // _AT_MOST)]
    variance = np.array([estimate.sigma**2 for estimate in estimates])
    lag = [dict(enumerate(estimate.autocorrelation)).get(labels.window, 0.0) for estimate in estimates]
    jacobian = SingleTrack(vehicle).velocity_jacobian(*(drive[n][rows] for n in ("vx", "vy", "r", "T", "delta")))
    phi = phi_matrix(jacobian, labels.horizon)
    from_end = np.broadcast_to(np.eye(3), phi.shape) if labels.plain else np.linalg.inv(phi)
    from_end = from_end / labels.horizon
    # exp(A h) = I + h A Phi
    from_start = from_end @ (np.eye(3) + labels.horizon * jacobian @ phi)
    squared = from_end**2 + from_start**2 - 2.0 * np.array(lag) * from_end * from_start
    return (squared @ variance).mean(axis=0)


def scatter_variance(labels: Labels) -> np.ndarray:
    """Return a robust guess of the label noise from how successive labels differ, shape (3,).

    Half the squared median absolute difference of successive accepted labels, scaled as for a normal
    distribution: an upper guess, since real change of the residual within h counts as noise.
    """
    good = labels.accepted
    together = good[1:] & good[:-1] & (np.diff(labels.segment) == 0)
    if not together.any():
        return np.zeros(3)
    difference = np.abs(np.diff(labels.y, axis=0)[together])
    return 0.5 * (np.median(difference, axis=0) / 0.6745) ** 2
