"""Track position: arc length along the first real drive, laps and other drives projected onto it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.logs.drive import Drive

#: How far the direction of travel may differ where a path closes [rad]; judgement.
CLOSE_ANGLE = 0.35
#: Times the closing distance that a car must have been away before it can come back [1]; judgement.
AWAY = 4.0
_CLOSE_DISTANCE = 5.0
_FULL_SIZE_WHEELBASE = 2.7


def closing_distance(wheelbase: float) -> float:
    """Return how far beside its start a car may come back [m]: half a race track's width, scaled with the car."""
    return _CLOSE_DISTANCE * wheelbase / _FULL_SIZE_WHEELBASE


@dataclass(frozen=True)
class TrackReference:
    """The path on which places are given."""

    # x, y, s: (P,): points and their arc length [m]; the first lap where the path closes.
    x: np.ndarray
    y: np.ndarray
    s: np.ndarray
    lap_length: float | None  # [m]; None for an open path


def build_reference(drive: Drive, wheelbase: float) -> TrackReference | None:
    """Return the reference path of the first real drive, or None without position.

    The path closes where it first comes back within 5 m and 0.35 rad of its start, scaled by the car's size,
    after having been four times as far away.
    """
    if "X" not in drive or "Y" not in drive:
        return None
    x, y = _quiet_path(drive)
    s = _arc_length(drive)
    distance = np.hypot(x - x[0], y - y[0])
    limit = closing_distance(wheelbase)
    away = np.flatnonzero(distance > AWAY * limit)
    if not len(away):
        return TrackReference(x, y, s, None)
    direction = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
    turned = np.abs(np.angle(np.exp(1j * (direction - direction[:5].mean()))))
    back = np.flatnonzero((np.arange(len(x)) > away[0]) & (distance < limit) & (turned < CLOSE_ANGLE))
    if not len(back):
        return TrackReference(x, y, s, None)
    run = back[: int(np.argmax(np.diff(back, append=back[-1] + 10) > 1)) + 1]
    close = int(run[np.argmin(distance[run])])
    return TrackReference(x[: close + 1], y[: close + 1], s[: close + 1], float(s[close]))


def track_position(drive: Drive, reference: TrackReference | None, *, first: bool) -> tuple[np.ndarray, str]:
    """Return s of every sample [m], shape (N,), and whether it is ``position`` or ``dead_reckoned``."""
    own = _arc_length(drive)
    if reference is None or "X" not in drive or "Y" not in drive:
        return own, "dead_reckoned"
    if reference.lap_length is None and first:
        return own, "position"
    from scipy.spatial import cKDTree

    step = max(1, len(reference.s) // 20000)
    tree = cKDTree(np.stack([reference.x[::step], reference.y[::step]], axis=1))
    x, y = _quiet_path(drive)
    far, nearest = tree.query(np.stack([x, y], axis=1), k=1)
    s = reference.s[::step][nearest]
    # Between points of the path the sample's own arc length carries on; the difference is smoothed.
    lap = reference.lap_length
    if lap:
        lead = np.unwrap((s - own) * 2.0 * np.pi / lap) * lap / (2.0 * np.pi)
        return np.mod(own + _running_mean(lead, max(5, int(0.5 / drive.period))), lap), "position"
    # A drive that leaves the path has no place on it beyond its ends.
    carried = own + _running_mean(s - own, max(5, int(0.5 / drive.period)))
    return np.clip(carried, reference.s[0], reference.s[-1]), "position"


def places_of(drives: Sequence[Drive], wheelbase: float) -> tuple[list[tuple[np.ndarray, str]], float | None]:
    """Return track positions of several drives, the first of which is the reference, and the lap length."""
    reference = build_reference(drives[0], wheelbase)
    places = [track_position(drive, reference, first=k == 0) for k, drive in enumerate(drives)]
    return places, reference.lap_length if reference else None


def _arc_length(drive: Drive) -> np.ndarray:
    speed = np.hypot(drive["vx"], drive["vy"])
    step = 0.5 * (speed[1:] + speed[:-1]) * np.diff(drive["t"])
    return np.concatenate([[0.0], np.cumsum(step)])


def _quiet_path(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    width = max(3, int(0.1 / drive.period))
    return _running_mean(drive["X"], width), _running_mean(drive["Y"], width)


def _running_mean(values: np.ndarray, width: int) -> np.ndarray:
    from scipy.ndimage import uniform_filter1d

    return uniform_filter1d(values, width, mode="nearest")
