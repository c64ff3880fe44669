"""Multi-step prediction with recorded inputs: nominal, corrected, and persistence, from many start points."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from split_cli.learning.labels import inputs_along
from split_cli.learning.pieces import pieces
from split_cli.logs.drive import Drive
from split_cli.scoring.application import Correction, features_at
from split_cli.vehicle.integration import Situation
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.windows import RecordedInputs

Model = TypeVar("Model", bound=Hashable)

_MOST_STARTS = 200
_MOST_SUBSTEPS = 50  # a sample; a rollout that needs more is leaving the finite numbers
_VELOCITIES = ("vx", "vy", "r")


@dataclass(frozen=True)
class RolloutSums:
    """Squared errors of rollouts at the end of every step, pooled over starts and drives."""

    squared: np.ndarray  # (K, 3): of v_x, v_y [m^2/s^2] and r [rad^2/s^2]
    squared_distance: np.ndarray  # (K,): of the position [m^2]; NaN where the drive has none
    count: int  # start points
    diverged: int  # start points left out for every model because one of them left the finite numbers

    def __add__(self, other: RolloutSums) -> RolloutSums:
        return RolloutSums(
            self.squared + other.squared,
            self.squared_distance + other.squared_distance,
            self.count + other.count,
            self.diverged + other.diverged,
        )

    @property
    def rmse(self) -> np.ndarray:
        """Root mean square error of v_x, v_y, r at the end of every step, shape (K, 3)."""
        return np.sqrt(self.squared / max(self.count, 1))

    @property
    def distance(self) -> np.ndarray:
        """Root mean square position error at the end of every step, shape (K,) [m]."""
        return np.sqrt(self.squared_distance / max(self.count, 1))


def rollout_starts(
    drive: Drive, rows: np.ndarray, length: int, minimum_speed: float, most: int = _MOST_STARTS
) -> np.ndarray:
    """Return start rows whose next `length` samples lie on `rows` (a mask), in one segment, above the speed.

    At most `most`, evenly spread over all that qualify.
    """
    fit = rows & (drive["vx"] > minimum_speed)
    blocked = np.concatenate([[0], np.cumsum(~fit)])
    starts: np.ndarray = np.arange(max(len(drive) - length, 0))
    starts = starts[(blocked[starts + length + 1] == blocked[starts])]
    starts = starts[drive.segment[starts + length] == drive.segment[starts]]
    if len(starts) > most:
        starts = starts[np.linspace(0, len(starts) - 1, most).astype(int)]
    return starts


def roll_out(
    model: SingleTrack,
    drive: Drive,
    starts: np.ndarray,
    steps: int,
    window: int,
    correction: Correction | None = None,
    *,
    recorded_speed: bool = False,
) -> np.ndarray:
    """Predict `steps` steps of h = `window` samples over the recorded inputs.

    With `recorded_speed`, v_x is set to the recording's after every step.

    Returns
    -------
    ndarray, shape (N, steps, 3) or (N, steps, 6)
        (v_x, v_y, r) after every step, or (X, Y, yaw, v_x, v_y, r) where the drive has a position.

    Notes
    -----
    Each step x+ = f_h(x) + h B_d Phi(x) g(z(x)), everything at the model's own state; inputs as recorded. A lag that
    asks for it acts in f_h as far as the correction's set knows at z(x). Terms
    with memory (lags, tyre relaxation) begin each step with the memory that the recording gives them; terms of
    place take the track position from the channel ``s`` [m], 0 without one.
    """
    names = ("X", "Y", "yaw", *_VELOCITIES) if drive.has_position else _VELOCITIES
    if not len(starts):
        return np.empty((0, steps, len(names)))
    if drive.stays_in_file:
        begins, place = np.unique(starts, return_inverse=True)
        drive, inputs, rows = _gathered(model, drive, begins, steps * window)
        correction = None if correction is None else replace(correction, z=correction.z[rows])
        starts = place * (steps * window + 1)
    else:
        inputs = inputs_along(model, drive)
    state = np.stack([drive[name][starts] for name in names], axis=1)
    trajectory = np.empty((len(starts), steps, len(names)))
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(steps):
            rows = starts + step * window
            state = _one_step(model, drive, inputs, rows, state, window, correction)
            if recorded_speed:
                state[:, -3] = drive["vx"][rows + window]
            trajectory[:, step] = state
    return trajectory


def _gathered(
    model: SingleTrack, drive: Drive, starts: np.ndarray, length: int
) -> tuple[Drive, RecordedInputs, np.ndarray]:
    """Return the stretches of `length` samples from ascending `starts`, end to end, and the rows they are."""
    rows = starts[:, None] + np.arange(length + 1)
    columns: list[dict[str, np.ndarray]] = []
    inputs: list[RecordedInputs] = []
    for span, piece in pieces(model, drive, starts, length):
        here = (rows[span] - piece.first).ravel()
        known = inputs_along(model, piece.drive, piece.recording)
        columns.append({name: values[here] for name, values in piece.drive.columns.items()})
        parts = known.torque[here], known.steer_angle[here], known.situation.at(here)
        inputs.append(RecordedInputs(known.period, *parts, known.held))
    joined = {name: np.concatenate([part[name] for part in columns]) for name in columns[0]}
    segment = np.repeat(np.arange(len(starts), dtype=np.int32), length + 1)
    together = RecordedInputs(
        drive.period,
        np.concatenate([part.torque for part in inputs]),
        np.concatenate([part.steer_angle for part in inputs]),
        Situation.joined([part.situation for part in inputs]),
        inputs[0].held,
    )
    return replace(drive, columns=joined, segment=segment), together, rows.ravel()


def _one_step(
    model: SingleTrack,
    drive: Drive,
    inputs: RecordedInputs,
    rows: np.ndarray,
    state: np.ndarray,
    window: int,
    correction: Correction | None,
) -> np.ndarray:
    windows, finite = inputs.windows(rows, window), np.isfinite(state).all(axis=1)
    if correction is not None:
        at = features_at(correction.features, model, drive, rows, state[:, -3:], correction.z)
        finite &= np.isfinite(at).all(axis=1)
        at = np.where(finite[:, None], at, 0.0)
        residual, known = correction.answers(at, model.asks_knowledge)
        windows = windows.knowing(known) if model.asks_knowledge else windows
    jacobian = windows.jacobian(model, state)
    finite &= np.isfinite(jacobian).all(axis=(1, 2))
    after = windows.predict(model, state, jacobian, _MOST_SUBSTEPS)
    if correction is not None:
        horizon = window * drive.period
        jacobian = np.where(finite[:, None, None], jacobian, 0.0)
        phi = windows.phi(model, state, jacobian, horizon)
        after[:, -3:] += horizon * np.einsum("nij,nj->ni", phi, residual)
    return after


def hold_velocity(drive: Drive, starts: np.ndarray, steps: int, window: int) -> np.ndarray:
    """Return the rollout in which v_x, v_y and r stay what they are: a circular arc; shape as `roll_out`."""
    elapsed = np.arange(1, steps + 1) * window * drive.period
    vx, vy, r = (np.broadcast_to(drive[name][starts][:, None], (len(starts), steps)) for name in _VELOCITIES)
    held = np.stack([vx, vy, r], axis=2)
    if not drive.has_position:
        return held
    half = 0.5 * r * elapsed
    # sin(rt)/r and (1 - cos(rt))/r, without the division where r is small.
    along = elapsed * np.sinc(2.0 * half / np.pi)
    across = elapsed * half * np.sinc(half / np.pi) ** 2
    ahead, left = vx * along - vy * across, vx * across + vy * along
    yaw = drive["yaw"][starts][:, None]
    x = drive["X"][starts][:, None] + ahead * np.cos(yaw) - left * np.sin(yaw)
    y = drive["Y"][starts][:, None] + ahead * np.sin(yaw) + left * np.cos(yaw)
    return np.concatenate([np.stack([x, y, yaw + r * elapsed], axis=2), held], axis=2)


def score_rollouts(
    drive: Drive, starts: np.ndarray, window: int, trajectories: Mapping[Model, np.ndarray]
) -> dict[Model, RolloutSums]:
    """Compare rollouts with the recording; start points where any model diverged count for none.

    Parameters
    ----------
    starts : ndarray of int, shape (N,)
    window : int
        Samples a step.
    trajectories : mapping of names to ndarray
        Of `roll_out` and `hold_velocity`, one a model, all of one length.
    """
    finite = np.ones(len(starts), dtype=bool)
    for trajectory in trajectories.values():
        finite &= np.isfinite(trajectory).all(axis=(1, 2))
    sums = {}
    for name, trajectory in trajectories.items():
        rows = starts[finite, None] + window * np.arange(1, trajectory.shape[1] + 1)
        truth = np.stack([drive[channel][rows] for channel in _VELOCITIES], axis=2)
        squared = np.square(trajectory[finite][:, :, -3:] - truth).sum(axis=0)
        distance = np.full(trajectory.shape[1], np.nan)
        if drive.has_position:
            position = np.stack([drive["X"][rows], drive["Y"][rows]], axis=2)
            distance = np.square(trajectory[finite][:, :, :2] - position).sum(axis=(0, 2))
        sums[name] = RolloutSums(squared, distance, int(finite.sum()), int((~finite).sum()))
    return sums
