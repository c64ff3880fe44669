"""Measured motion and the model's own motion over the recorded inputs, on one clock and with accelerations."""

from dataclasses import replace

import numpy as np

from split_cli.logs.drive import Drive
from split_cli.scoring.application import Correction
from split_cli.scoring.rollouts import roll_out
from split_cli.vehicle.single_track import SingleTrack

STEP = 0.05
_SMOOTH = 0.25  # [s] of the quadratic that a derivative is read from
_VELOCITIES = ("vx", "vy", "r")


def rate_of_change(values: np.ndarray, drive: Drive) -> np.ndarray:
    """Return the time derivative of a channel, shape (N,), never across a gap.

    Notes
    -----
    The slope of a quadratic fitted to 0.25 s around each sample (Savitzky and Golay); of a stretch shorter than
    that, central differences.
    """
    from scipy.signal import savgol_filter

    out = np.zeros(len(drive))
    width = max(5, 2 * round(0.5 * _SMOOTH / drive.period) + 1)
    for run in drive.segments():
        length = run.stop - run.start
        if length >= width:
            out[run] = savgol_filter(values[run], width, 2, deriv=1, delta=drive.period)
        elif length > 1:
            out[run] = np.gradient(values[run], drive.period)
    return out


def lateral_acceleration(drive: Drive) -> np.ndarray:
    """Return a_y at the CG [m/s^2], shape (N,): recorded, else v_y' + v_x r."""
    if "ay" in drive:
        return drive["ay"]
    lateral: np.ndarray = rate_of_change(drive["vy"], drive) + drive["vx"] * drive["r"]
    return lateral


def distance(drive: Drive) -> np.ndarray:
    """Return the track position of every sample [m], shape (N,): recorded, else the distance driven."""
    if "s" in drive:
        return drive["s"]
    within = np.append(np.diff(drive.segment) == 0, False)
    return np.concatenate([[0.0], np.cumsum((drive["vx"] * drive.period * within)[:-1])])


def measured_motion(drive: Drive) -> Drive:
    """Return a drive thinned to `STEP`, with ``ax``, ``ay`` [m/s^2] and the distance driven ``s`` [m]."""
    columns = dict(drive.columns)
    columns["ay"] = lateral_acceleration(drive)
    if "ax" not in drive:
        columns["ax"] = rate_of_change(drive["vx"], drive) - drive["vy"] * drive["r"]
    columns["s"] = distance(drive)
    whole = replace(drive, columns=columns)
    every = max(1, round(STEP / drive.period))
    if every == 1:
        return whole
    rows = np.concatenate([np.arange(run.start, run.stop, every) for run in drive.segments()])
    columns = {name: values[rows] for name, values in columns.items()}
    return Drive(drive.name, columns, drive.segment[rows], every * drive.period, drive.metadata, drive.sha256)


def free_run(
    model: SingleTrack,
    drive: Drive,
    seconds: float,
    *,
    correction: Correction | None = None,
    recorded_speed: bool = False,
) -> Drive | None:
    """Return the model's own motion over the recorded inputs, set back to the recording every `seconds`.

    Its steps take `STEP`, rounded to whole samples.

    Parameters
    ----------
    seconds : float
        Length of a free run [s]; runs follow each other without overlap, and none crosses a gap.
    correction : Correction, optional
        A learned residual that the model applies.
    recorded_speed : bool
        Take v_x from the recording after every step, as is usual where only the lateral motion is compared.

    Returns
    -------
    Drive or None
        With ``t, vx, vy, r, T, delta, ax, ay, s``, one segment a run. None where no run fits. Runs in which the
        recording is slower than the model is meant for, or that leave the finite numbers, are left out.
    """
    window = max(1, round(STEP / drive.period))
    steps = max(1, round(seconds / (window * drive.period)))
    length = steps * window
    slow = np.concatenate([[0], np.cumsum(drive["vx"] < model.vehicle.minimum_speed)])
    starts = np.array([at for run in drive.segments() for at in range(run.start, run.stop - length, length)], dtype=int)
    starts = starts[slow[starts + length + 1] == slow[starts]] if len(starts) else starts
    if not len(starts):
        return None
    after = roll_out(model, drive, starts, steps, window, correction, recorded_speed=recorded_speed)[:, :, -3:]
    first = np.stack([drive[name][starts] for name in _VELOCITIES], axis=1)
    path = np.concatenate([first[:, None], after], axis=1)
    kept = np.isfinite(path).all(axis=(1, 2)) & (np.abs(path[:, :, 0]).max(axis=1) < 200.0)
    path, starts = path[kept], starts[kept]
    if not len(starts):
        return None
    rows = (starts[:, None] + window * np.arange(steps + 1)).ravel()
    period = window * drive.period
    vx, vy, r = (path[:, :, k] for k in range(3))
    rate = [np.gradient(one, period, axis=1) for one in (vx, vy)]
    columns = {"vx": vx, "vy": vy, "r": r, "ax": rate[0] - vy * r, "ay": rate[1] + vx * r}
    columns = {name: values.ravel() for name, values in columns.items()}
    columns |= {name: drive[name][rows] for name in ("t", "T", "delta")} | {"s": distance(drive)[rows]}
    segment = np.repeat(np.arange(len(starts), dtype=np.int32), steps + 1)
    return Drive(drive.name, columns, segment, period)
