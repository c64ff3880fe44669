"""Labels: the rate that the nominal model leaves out, from recorded windows of length h."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np

from split_cli.errors import DriveError
from split_cli.learning.features import FeatureSet, flow_along, place_of, recording_of
from split_cli.learning.pieces import DrivePiece, pieces
from split_cli.learning.region import Grid, Region
from split_cli.learning.set_limits import LARGEST_LABEL
from split_cli.logs.drive import Drive
from split_cli.logs.scratch import PIECE, GrowingColumn, in_pieces, let_go, room
from split_cli.vehicle.effects.recording import Recording
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.integration import Situation
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.windows import RecordedInputs, recorded_inputs

DEFAULT_HORIZON = 0.05
_CHUNK = 4096  # temporaries of that length stay in the cache
_VELOCITIES = ("vx", "vy", "r")
_ARRAYS = ("t", "row", "segment", "z", "y", "reason")


class Reason(IntEnum):
    """Why a sample is not learned; the first that applies, in this order."""

    ACCEPTED = 0
    GAP = 1
    NON_FINITE = 2
    SPEED = 3
    SLIP = 4
    SLIP_DIFFERENCE = 5
    ELLIPSE = 6
    GRID = 7
    GAIN = 8

    @property
    def word(self) -> str:
        """How files and tables write it; empty for an accepted sample."""
        return "" if self is Reason.ACCEPTED else self.name.lower()


@dataclass(frozen=True)
class Labels:
    """What the nominal model gets wrong over windows of a drive.

    Attributes
    ----------
    drive, sha256 : str
        Name and content hash of the drive.
    vehicle_digest : str
        `Vehicle.digest` of the nominal model.
    horizon : float
        h [s], a whole number of samples.
    window : int
        Samples in h.
    plain : bool
        Whether y is the paper's plain difference, damped by the nominal dynamics, for reproduction only.
    start_time, duration : float
        First time stamp and length of the drive [s].
    t : ndarray, shape (N,)
        Time of a window's start [s].
    row : ndarray of int64, shape (N,)
        Its row in the drive.
    segment : ndarray of int32, shape (N,)
    z : ndarray, shape (N, D)
        Features at the start.
    y : ndarray, shape (N, 3)
        Rate left out, of v_x, v_y [m/s^2] and r [rad/s^2]; NaN where it cannot be computed (gap, non_finite,
        speed).
    reason : ndarray of int8, shape (N,)
        `Reason` of each sample.
    faults, remarks : tuple of str
        What ingest found wrong with channels that labels are made of, and what else it found.
    circular : tuple of str
        States whose labels say nothing of the car (`logs.drive_metadata.CIRCULAR`).
    """

    drive: str
    sha256: str
    vehicle_digest: str
    features: FeatureSet
    region: Region
    horizon: float
    window: int
    plain: bool
    start_time: float
    duration: float
    t: np.ndarray
    row: np.ndarray
    segment: np.ndarray
    z: np.ndarray
    y: np.ndarray
    reason: np.ndarray
    faults: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    circular: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.row)

    @property
    def accepted(self) -> np.ndarray:
        """Whether a sample is inside the valid region and usable, bool shape (N,)."""
        accepted: np.ndarray = self.reason == Reason.ACCEPTED
        return accepted

    def take(self, index: np.ndarray | slice) -> Labels:
        """Return the labels at `index` (mask, indices or slice), in that order."""
        return replace(self, **{name: getattr(self, name)[index] for name in _ARRAYS})

    @classmethod
    def joined(cls, parts: Sequence[Labels]) -> Labels:
        """Return the labels of several parts, one after the other; all that is no array is the first's."""
        arrays: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in _ARRAYS}
        return replace(parts[0], **arrays)

    def within(self, rows: np.ndarray) -> Labels:
        """Return the labels whose whole window, start to end, lies on rows where the mask is true.

        Parameters
        ----------
        rows : ndarray of bool, shape (rows of the drive,)
            For example the training blocks; a window that touches a held-out row is left out.
        """
        blocked = np.concatenate([[0], np.cumsum(~np.asarray(rows, dtype=bool))])
        last = np.minimum(self.row + self.window + 1, len(rows))
        return self.take(blocked[last] == blocked[self.row])

    def between(self, first: int, last: int) -> Labels:
        """Return the labels whose whole window lies on the rows [first, last), which are counted from `first`."""
        begin, end = np.searchsorted(self.row, (first, last - self.window))
        kept = self.take(slice(int(begin), int(end)))
        return replace(kept, row=kept.row - first)

    @property
    def nbytes(self) -> int:
        """Memory of the arrays [bytes]."""
        return sum(getattr(self, name).nbytes for name in _ARRAYS)

    def without_grid(self) -> Labels:
        """Return the labels with those that lay outside another grid accepted again."""
        return replace(self, reason=np.where(self.reason == Reason.GRID, np.int8(Reason.ACCEPTED), self.reason))

    def inside(self, grid: Grid) -> Labels:
        """Return the labels with accepted samples outside the grid marked as such."""
        reason = self.reason.copy()
        for rows in in_pieces(len(reason)):
            accepted = reason[rows] == Reason.ACCEPTED
            reason[rows][accepted & ~grid.index(self.z[rows])[1]] = Reason.GRID
        return replace(self, reason=reason)

    def counts(self) -> dict[str, int]:
        """Return how many samples were rejected, by the reason's word, in the order they are tested."""
        numbers = np.zeros(len(Reason), dtype=np.int64)
        for rows in in_pieces(len(self)):
            numbers += np.bincount(self.reason[rows], minlength=len(Reason))
        return {reason.word: int(numbers[reason]) for reason in Reason if reason and numbers[reason]}


def window_samples(horizon: float, period: float) -> int:
    """Return h in whole samples, at least one."""
    if not (np.isfinite(horizon / period) and horizon > 0):
        raise DriveError(f"the label horizon is {horizon!r}, a positive time in seconds was expected")
    return max(1, round(horizon / period))


def compute_labels(
    drive: Drive,
    vehicle: Vehicle,
    features: FeatureSet,
    region: Region | None = None,
    *,
    horizon: float = DEFAULT_HORIZON,
    stride: int | None = None,
    plain: bool = False,
) -> Labels:
    """Compute the labels of a drive.

    Parameters
    ----------
    region : Region, optional
        The vehicle's default region when not given.
    horizon : float
        h [s], rounded to whole samples, at least one.
    stride : int, optional
        Samples between starts; h by default, so that windows do not overlap.
    plain : bool
        The paper's plain difference instead of a rate that does not depend on h.

    Returns
    -------
    Labels
        One for every start. A start whose window would reach over a gap is kept, with the reason `gap`; the
        last, incomplete window of the recording is none.

    Raises
    ------
    DriveError
        If no window fits into any segment, or a feature is unknown.

    Notes
    -----
    y = Phi^-1 B_d^+ (x(t + h) - f_h(x(t)))/h with f_h the nominal model integrated by RK4 over the recorded
    inputs and Phi = (1/h) int_0^h exp(A s) ds, A the nominal Jacobian at t, that of what
    the terms remember included (`Windows.phi`). SPLIT paper, the residual model,
    has the plain difference; Phi undoes what the stiff lateral dynamics damp within h (docs/errata.md).

    The drive is labelled piece by piece, with what the terms remember handed on: the labels do not depend on the
    pieces. With delays among the terms it is labelled as a whole.
    """
    region = region or Region.of(vehicle)
    model = SingleTrack(vehicle)
    window = window_samples(horizon, drive.period)
    starts = _window_starts(drive, window, window if stride is None else stride)
    t, reason = room(len(starts)), np.empty(len(starts), dtype=np.int8)
    segment = np.empty(len(starts), dtype=np.int32)
    z, y = (room(len(starts) * width).reshape(-1, width) for width in (len(features.names), 3))
    for rows, piece in pieces(model, drive, starts, window):
        local = starts[rows] - piece.first
        t[rows], segment[rows] = piece.drive["t"][local], piece.drive.segment[local]
        flow = flow_along(model, piece.drive, piece.recording)
        z[rows] = features.of_flow(model, piece.drive, flow)[local]
        reason[rows] = _reject(piece, model, region, local, window, z[rows], flow)
        usable = ~np.isin(reason[rows], (Reason.GAP, Reason.NON_FINITE, Reason.SPEED))
        y[rows][usable] = nominal_errors(
            model, piece.drive, local[usable], window, plain=plain, recording=piece.recording
        )
        # A vanishing Phi or a diverging window shows as a value that is no label: it must not be learned.
        reason[rows][usable & ~(np.abs(y[rows]) <= LARGEST_LABEL).all(axis=1)] = Reason.NON_FINITE
        let_go()
    begin, end = (float(drive.part("t", row, row + 1)[0]) for row in (0, len(drive) - 1))
    return Labels(
        drive=drive.name,
        sha256=drive.sha256,
        vehicle_digest=vehicle.digest(),
        features=features,
        region=region,
        horizon=window * drive.period,
        window=window,
        plain=plain,
        start_time=begin,
        duration=end - begin,
        t=t,
        row=starts,
        segment=segment,
        z=z,
        y=y,
        reason=reason,
        faults=drive.metadata.faults,
        remarks=drive.metadata.remarks,
        circular=drive.metadata.circular,
    )


def nominal_errors(
    model: SingleTrack,
    drive: Drive,
    starts: np.ndarray,
    window: int,
    *,
    plain: bool = False,
    compiled: bool = True,
    recording: Recording | None = None,
    knowledge: np.ndarray | None = None,
) -> np.ndarray:
    """Return y for windows that start at rows `starts`, shape (N, 3) [m/s^2], [m/s^2], [rad/s^2].

    Parameters
    ----------
    starts : ndarray of int64, shape (N,)
        Every window must lie inside one segment.
    window : int
        Samples in h.
    plain : bool
        Without the inverse of Phi.
    compiled : bool
        Whether the compiled path may serve. It covers the nominal model without terms that move the car, and agrees
        with the plain one to rounding, or to 1e-8 where a term only remembers: its Jacobian is exact.
    recording : Recording, optional
        As of `flow_along`.
    knowledge : ndarray, shape (N,), optional
        How much a trained set knows where each window begins, for terms that ask; 1 if not given, as at its labels.
    """
    if compiled and not model.in_motion.terms:
        from split_cli.learning._windows_numba import window_errors

        # Copies: columns of a file are read-only, a type of its own to the compiler.
        vx, vy, r, T, delta = (np.array(drive[name], dtype=float) for name in (*_VELOCITIES, "T", "delta"))
        run_on = np.array([name not in drive.held for name in ("T", "delta")], dtype=float)
        constants = _nominal_constants(model.vehicle)
        return window_errors(vx, vy, r, T, delta, starts, window, drive.period, constants, plain, run_on)
    inputs = inputs_along(model, drive, recording)
    parts = [
        _window_errors_reference(
            model,
            drive,
            inputs,
            starts[first : first + _CHUNK],
            window,
            plain,
            None if knowledge is None else knowledge[first : first + _CHUNK],
        )
        for first in range(0, len(starts), _CHUNK)
    ]
    return np.concatenate(parts) if parts else np.empty((0, 3))


def inputs_along(model: SingleTrack, drive: Drive, recording: Recording | None = None) -> RecordedInputs:
    """Return a drive's inputs as the delays among the terms leave them, and the situation at every sample.

    `recording` as of `flow_along`.
    """
    velocity = np.stack([drive[name] for name in _VELOCITIES], axis=1)
    situation = Situation(drive["t"], place_of(drive), drive.columns.get("yaw", 0.0))
    clock = recording or recording_of(drive)
    return recorded_inputs(model, velocity, drive["T"], drive["delta"], clock, situation, held=drive.held)


def _window_errors_reference(
    model: SingleTrack,
    drive: Drive,
    inputs: RecordedInputs,
    starts: np.ndarray,
    window: int,
    plain: bool,
    knowledge: np.ndarray | None,
) -> np.ndarray:
    begin = np.stack([drive[name][starts] for name in _VELOCITIES], axis=1)
    end = np.stack([drive[name][starts + window] for name in _VELOCITIES], axis=1)
    windows, horizon = inputs.windows(starts, window).knowing(knowledge), window * drive.period
    jacobian = windows.jacobian(model, begin)
    rate = (end - windows.predict(model, begin, jacobian)) / horizon
    return rate if plain else np.linalg.solve(windows.phi(model, begin, jacobian, horizon), rate[:, :, None])[:, :, 0]


def _nominal_constants(car: Vehicle) -> np.ndarray:
    """Return what the compiled nominal model needs, in the order it unpacks them."""
    front, rear = car.front_tire, car.rear_tire
    return np.array(
        [
            car.mass,
            car.yaw_inertia,
            car.cg_to_front_axle,
            car.cg_to_rear_axle,
            car.wheel_radius,
            car.drive_split_front,
            car.brake_split_front,
            car.rolling_resistance_front,
            car.rolling_resistance_rear,
            car.drag_coefficient,
            front.B,
            front.C,
            front.D,
            rear.B,
            rear.C,
            rear.D,
        ]
    )


def _window_starts(drive: Drive, window: int, stride: int) -> np.ndarray:
    if stride < 1:
        raise DriveError(f"the stride is {stride} samples, at least 1 was expected", where=drive.name)
    runs = drive.segments()
    longest = max((run.stop - run.start for run in runs), default=0)
    if longest <= window:
        what = (
            f"is too short for a label: its longest stretch without a gap has {longest} samples, "
            f"a window of {window * drive.period:g} s needs {window + 1}"
        )
        raise DriveError(what, where=drive.name, advice="Use a shorter horizon.")
    starts = GrowingColumn(np.int64)
    for run in runs:
        stop = run.stop - window if run is runs[-1] else run.stop
        for first in range(run.start, stop, PIECE * stride):
            starts.append(np.arange(first, min(first + PIECE * stride, stop), stride))
    return starts.finished()


def _reject(
    piece: DrivePiece, model: SingleTrack, region: Region, starts: np.ndarray, window: int, z: np.ndarray, flow: Flow
) -> np.ndarray:
    """Return the reason of every start, int8 shape (N,)."""
    drive = piece.drive
    last = np.empty(len(drive), dtype=np.int64)
    for run in drive.segments():
        last[run] = run.stop - 1
    gap = starts + window > last[starts]
    broken = np.zeros(len(drive), dtype=bool)
    for name in (*_VELOCITIES, "T", "delta"):
        broken |= ~np.isfinite(drive[name])
    before = np.concatenate([[0], np.cumsum(broken)])
    non_finite = before[np.minimum(starts + window + 1, len(drive))] > before[starts]
    non_finite |= ~np.isfinite(z).all(axis=1)
    alpha_f, alpha_r = flow.front.slip_angle[starts], flow.rear.slip_angle[starts]
    tests = (
        (Reason.GAP, gap),
        (Reason.NON_FINITE, non_finite),
        (Reason.SPEED, ~(drive["vx"][starts] > region.minimum_speed)),
        (Reason.SLIP, ~region.inside_slip(alpha_f, alpha_r)),
        (Reason.SLIP_DIFFERENCE, ~region.inside_slip_difference(alpha_f, alpha_r)),
        (Reason.ELLIPSE, ~region.inside_ellipse(model.vehicle, alpha_f, alpha_r, drive["T"][starts])),
    )
    reason = np.zeros(len(starts), dtype=np.int8)
    for code, failed in reversed(tests):
        reason[failed] = code
    return reason
