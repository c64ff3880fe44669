"""Another car in the states of a recorded one, piece by piece: paired runs without a driver."""

import numpy as np

from split_cli.errors import SplitError
from split_cli.plant import _compiled, _loops_numba
from split_cli.plant._numbers import as_numbers
from split_cli.plant.cars import CarParameters
from split_cli.plant.road import Road
from split_cli.plant.simulation import CONTROL_PERIOD, STEP, Trajectory


def recorded_motion(run: Trajectory) -> np.ndarray:
    """Return X, Y, yaw, v_x, v_y, r of a run at its sample instants, shape (N, 6)."""
    return np.ascontiguousarray(run.states[:, : _compiled.R + 1])


def predict_windows(
    run: Trajectory, car: CarParameters, road: Road, *, motion: np.ndarray | None = None, horizon: float = 0.05
) -> np.ndarray:
    """Predict a run piece by piece with another car under the same commands.

    The other car is carried along: at every sample it is given the recorded pose and velocities, while its
    wheels, tyres, suspension and actuators go on living under them. At the start of each window a copy is let
    free for the horizon. With the car and road of the run itself the prediction is the run.

    Parameters
    ----------
    run : Trajectory
        Gives commands and places, and the motion unless it is given.
    car, road
        With which to predict.
    motion : ndarray, shape (N, 6), optional
        X, Y, yaw, v_x, v_y, r at ``run.t``: for example as a displaced sensor reports it.
    horizon : float
        Length of the windows, which do not overlap [s].

    Returns
    -------
    ndarray, shape (K, 3)
        v_x, v_y, r at the end of each window, ``run.t[window], run.t[2 window], ...``.

    Raises
    ------
    SplitError
        If the horizon is no whole number of samples.
    """
    period = float(run.t[1] - run.t[0])
    window = int(round(horizon / period))
    if window < 1 or abs(window * period - horizon) > 1e-9:
        raise SplitError(f"a horizon of {horizon:g} s is no whole number of samples of {period:g} s")
    motion = recorded_motion(run) if motion is None else np.ascontiguousarray(motion, dtype=float)
    return _loops_numba.follow(
        motion,
        np.ascontiguousarray(run.s),
        run.torque_command,
        run.steer_command,
        run.states[0].copy(),
        as_numbers(car),
        road.tables(),
        CONTROL_PERIOD,
        STEP,
        int(round(period / STEP)),
        window,
    )
