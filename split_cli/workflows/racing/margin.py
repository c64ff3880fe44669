"""The error of the learned model in a lap: the next lap's distance to the border is proportional to it."""

import numpy as np

from split_cli.control.policy import FIRST_ERROR
from split_cli.learning.labels import Labels
from split_cli.logs.drive import Drive
from split_cli.scoring.noise import noise_floor
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.racing.result import Lap


def acceleration_error(error: np.ndarray, noise: np.ndarray, count: int, vehicle: Vehicle) -> float:
    """Return the error of a model's lateral and yaw acceleration, free of noise, as one acceleration [m/s^2].

    Parameters
    ----------
    error : ndarray, shape (3,)
        RMS of label less prediction, of v_x, v_y [m/s^2] and r [rad/s^2].
    noise : ndarray, shape (3,)
        Standard deviation of the labels' noise, in the same units.
    count : int
        Number of labels.

    Notes
    -----
    e^2 = e_y^2 + (I_z/m) e_r^2, in which yaw is weighted by the radius of gyration as in kinetic energy, and
    e_i^2 = max(error_i^2 - noise_i^2, noise_i^2 sqrt(2/count)): the difference has that standard error.
    """
    noise = np.square(noise)
    squares = np.maximum(np.square(error) - noise, noise * np.sqrt(2.0 / max(count, 1)))
    return float(np.sqrt(squares[1] + vehicle.yaw_inertia / vehicle.mass * squares[2]))


def relative_model_error(lap: Lap, drive: Drive, labels: Labels, vehicle: Vehicle) -> float:
    """Return e = `acceleration_error` of a lap over its largest lateral acceleration a [1], at most `FIRST_ERROR`.

    An error of position grows as error t^2/2, and the time t in which a car gets anywhere as sqrt(length/a), so errors
    of position are proportional to e. `FIRST_ERROR`, the value for a model that has learned nothing, is returned where
    the noise is not known, too.

    Parameters
    ----------
    drive, labels : Drive, Labels
        Recording of the lap, and the labels that were learned in it; their noise is estimated from both.
    vehicle : Vehicle
        Vehicle of the control model, terms included.
    """
    noise = noise_floor(SingleTrack(vehicle), drive, labels).rms
    if noise is None:
        return FIRST_ERROR
    error = acceleration_error(np.array(lap.error_after), noise, lap.accepted, vehicle)
    return min(error / (lap.max_lateral * STANDARD_GRAVITY), FIRST_ERROR)
