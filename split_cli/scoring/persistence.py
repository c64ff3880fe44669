"""Reference predictions: velocities held over the horizon (persistence), and the last label held."""

import numpy as np

from split_cli.learning.labels import Labels, inputs_along
from split_cli.learning.pieces import pieces
from split_cli.logs.drive import Drive
from split_cli.vehicle.single_track import SingleTrack


def phi_at(model: SingleTrack, drive: Drive, rows: np.ndarray, horizon: float) -> np.ndarray:
    """Return Phi of the nominal model at ascending rows of a drive, shape (N, 3, 3)."""
    phi = np.empty((len(rows), 3, 3))
    for span, piece in pieces(model, drive, rows, 0):
        here = rows[span] - piece.first
        velocity = np.stack([piece.drive[name][here] for name in ("vx", "vy", "r")], axis=1)
        windows = inputs_along(model, piece.drive, piece.recording).windows(here, 0)
        phi[span] = windows.phi(model, velocity, windows.jacobian(model, velocity), horizon)
    return phi


def velocity_persistence_errors(model: SingleTrack, drive: Drive, labels: Labels) -> np.ndarray:
    """Return the error of "nothing changes within h" in label units, shape (N, 3).

    Notes
    -----
    A prediction p of x(t + h) has the label-unit error Phi^-1 B_d^+ (x(t + h) - p)/h; with p = f_h it is the
    label itself, here p = x(t). NaN where the label is.
    """
    errors = np.full((len(labels), 3), np.nan)
    usable = np.isfinite(labels.y).all(axis=1)
    rows = labels.row[usable]
    columns = (drive[name] for name in ("vx", "vy", "r"))
    rate = np.stack([column[rows + labels.window] - column[rows] for column in columns], axis=1) / labels.horizon
    if labels.plain:
        errors[usable] = rate
    else:
        phi = phi_at(model, drive, rows, labels.horizon)
        errors[usable] = np.linalg.solve(phi, rate[:, :, None])[:, :, 0]
    return errors


def label_persistence_errors(labels: Labels) -> np.ndarray:
    """Return label minus the last label whose window had ended by then, in the same segment, shape (N, 3).

    Parameters
    ----------
    labels : Labels
        All labels of a drive, in order: the label before a held-out block is known when the block begins.

    Returns
    -------
    ndarray
        NaN where there is no such label, or either is NaN.
    """
    latest = np.searchsorted(labels.row, labels.row - labels.window, side="right") - 1
    known = latest >= 0
    known &= labels.segment[np.maximum(latest, 0)] == labels.segment
    errors: np.ndarray = labels.y - labels.y[np.maximum(latest, 0)]
    errors[~known] = np.nan
    return errors
