"""Result of a race: its laps and the track."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from split_cli.control.path import Path


@dataclass(frozen=True)
class Lap:
    """One lap."""

    number: int  # 0 for the nominal lap
    time: float | None  # [s]; None when it was not finished
    # mean_speed, max_lateral: [m/s]; greatest lateral acceleration [g].
    mean_speed: float
    max_lateral: float
    # updates, size, cells: insertions and replacements; points and non-empty cells at its end.
    updates: int
    size: int
    cells: int
    # error_before, error_after: root mean square of the labels, and of what the residual left of them when they
    # came in: v_x, v_y [m/s^2], r [rad/s^2].
    error_before: tuple[float, ...]
    error_after: tuple[float, ...]
    # samples, accepted: control intervals, and those whose label lay in the learned region.
    samples: int
    accepted: int
    # solver_ms, step_ms: median, 99 % and worst of HPIPM, and of the whole step with model and residual [ms].
    solver_ms: tuple[float, ...]
    step_ms: tuple[float, ...]
    update_ms: tuple[float, ...]  # the same of label and update [ms]
    failures: int  # programmes without a solution
    outside: float  # farthest that a side of the car was beyond the border [m]; 0 for a clean lap
    ended: str = ""  # why the lap was not finished; empty when it was
    # motion_before, motion_after: the same of the exact motion, which no sensor's noise adds to; zeros where it
    # was not computed.
    motion_before: tuple[float, ...] = (0.0, 0.0, 0.0)
    motion_after: tuple[float, ...] = (0.0, 0.0, 0.0)
    margin: float = 0.0  # kept from the car's side to the border in the plan, where the track is narrowest [m]
    share: float = 0.0  # of the peak force that the plan might use [1]
    outside_at: float | None = None  # where `outside` was, along the centre line from the start [m]; None within

    @property
    def clean(self) -> bool:
        """Whether the lap was finished without leaving the track."""
        return self.time is not None and self.outside == 0.0


@dataclass(frozen=True)
class RaceResult:
    """What was driven."""

    track: str
    car: str
    vehicle: str
    learner: str
    length: float  # of a lap [m]
    laps: tuple[Lap, ...]
    output: str | None  # the drive
    set_path: str | None
    notes: tuple[str, ...]
    # Of each lap, a row an interval: t, s, X, Y, yaw, v_x, v_y, r, T, delta, a_x, a_y, contour error.
    traces: tuple[np.ndarray, ...] = ()
    path: Path | None = None  # the track
    # Peak of front and rear over the vehicle file's [1], as learned before lap 1 and after each lap since.
    grips: tuple[tuple[float, ...], ...] = ()
    verdict: str = ""  # whether learning helped, in words; empty where nobody learned
    start: str = ""  # the trained set or export that the race starts with, in words; empty for the nominal model

    def summary(self) -> RaceResult:
        """Return the result without its traces and its track."""
        return replace(self, traces=(), path=None)
