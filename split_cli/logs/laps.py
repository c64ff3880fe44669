"""Laps of a drive: by its own lap channel, else by where its path comes back to its start."""

import numpy as np

from split_cli.errors import DriveError
from split_cli.logs.drive import Drive
from split_cli.logs.track_position import AWAY, CLOSE_ANGLE, closing_distance


def first_lap(drive: Drive, wheelbase: float) -> slice:
    """Return the rows of the first lap, or all of a drive that has no laps; see `lap_numbers`."""
    try:
        lap = lap_numbers(drive, wheelbase)
    except DriveError:
        return slice(0, len(drive))
    return slice(0, int(np.argmax(lap != lap[0])))


def lap_numbers(drive: Drive, wheelbase: float) -> np.ndarray:
    """Return the lap each sample belongs to, from 1, shape (N,).

    A lap ends where the path crosses the line through its first sample, square to the travel there, within 5 m of
    it and 0.35 rad of its direction, both for a car of 2.7 m wheelbase and scaled with the car.

    Parameters
    ----------
    drive : Drive
        With a channel ``lap``, or ``X`` and ``Y`` [m].
    wheelbase : float
        [m].

    Raises
    ------
    DriveError
        If it has neither, or its path never comes back.
    """
    if "lap" in drive.columns:
        lap = np.round(drive["lap"])
        if np.isfinite(lap).all() and len(np.unique(lap)) > 1:
            return np.unique(lap, return_inverse=True)[1].astype(np.int64) + 1
    if not {"X", "Y"} <= set(drive.columns):
        advice = "Map X and Y, or a column `lap` in `extras`, or leave out --per-lap."
        raise DriveError("has no position and no lap channel, so it has no laps", where=drive.name, advice=advice)
    x, y = drive["X"] - drive["X"][0], drive["Y"] - drive["Y"][0]
    limit = closing_distance(wheelbase)
    distance = np.hypot(x, y)
    left = np.flatnonzero(distance > limit)
    heading = np.arctan2(y[left[0]], x[left[0]]) if len(left) else 0.0
    along = x * np.cos(heading) + y * np.sin(heading)
    direction = np.arctan2(np.gradient(y), np.gradient(x))
    same_way = np.abs(np.angle(np.exp(1j * (direction - heading)))) < CLOSE_ANGLE
    crossed = (along[:-1] < 0.0) & (along[1:] >= 0.0) & (distance[1:] < limit) & same_way[1:]
    ends, away = [], False
    crossing = set((np.flatnonzero(crossed) + 1).tolist())
    for row in range(len(x)):
        away = away or distance[row] > AWAY * limit
        if away and row in crossing:
            ends.append(row)
            away = False
    if not ends:
        advice = "Give a drive of two laps or more, or leave out --per-lap."
        raise DriveError("never comes back to where it began, so it has no laps", where=drive.name, advice=advice)
    lap = np.zeros(len(x), dtype=np.int64)
    lap[ends] = 1
    return np.cumsum(lap) + 1
