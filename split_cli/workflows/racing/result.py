"""Result of a race: its laps and the track."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from split_cli.control.path import Path

__all__ = ["Lap", "RaceResult"]


@dataclass(frozen=True)
class Lap:
    """One lap.

    Attributes
    ----------
    number : int
        0 for the nominal lap.
    time : float or None
        [s]; None when it was not finished.
    mean_speed, max_lateral : float
        [m/s]; greatest lateral acceleration [g].
    updates, size, cells : int
        Insertions and replacements; points and non-empty cells at its end.
    error_before, error_after : tuple of float
        Root mean square of the labels, and of what the residual left of them when they came in: v_x, v_y
        [m/s^2], r [rad/s^2].
    motion_before, motion_after : tuple of float
        The same of the exact motion, which no sensor's noise adds to; zeros where it was not computed.
    samples, accepted : int
        Control intervals, and those whose label lay in the learned region.
    solver_ms, step_ms : tuple of float
        Median, 99 % and worst of HPIPM, and of the whole step with model and residual [ms].
    update_ms : tuple of float
        The same of label and update [ms].
    failures : int
        Programmes without a solution.
    outside : float
        Farthest that a side of the car was beyond the border [m]; 0 for a clean lap.
    ended : str
        Why the lap was not finished; empty when it was.
    margin : float
        Kept from the car's side to the border in the plan [m].
    """

    number: int
    time: float | None
    mean_speed: float
    max_lateral: float
    updates: int
    size: int
    cells: int
    error_before: tuple[float, ...]
    error_after: tuple[float, ...]
    samples: int
    accepted: int
    solver_ms: tuple[float, ...]
    step_ms: tuple[float, ...]
    update_ms: tuple[float, ...]
    failures: int
    outside: float
    ended: str = ""
    motion_before: tuple[float, ...] = (0.0, 0.0, 0.0)
    motion_after: tuple[float, ...] = (0.0, 0.0, 0.0)
    margin: float = 0.0

    @property
    def clean(self) -> bool:
        """Whether the lap was finished without leaving the track."""
        return self.time is not None and self.outside == 0.0


@dataclass(frozen=True)
class RaceResult:
    """What was driven.

    Attributes
    ----------
    track, car, vehicle, learner : str
    length : float
        Of a lap [m].
    laps : tuple of Lap
    output : str or None
        The drive.
    set_path : str or None
    notes : tuple of str
    path : Path
        The track.
    grips : tuple of tuple of float
        Peak of front and rear over the vehicle file's [1], as learned before lap 1 and after each lap since.
    verdict : str
        Whether learning helped, in words; empty where nobody learned.
    traces : tuple of ndarray
        Of each lap, a row an interval: t, s, X, Y, yaw, v_x, v_y, r, T, delta, a_x, a_y, contour error.
    """

    track: str
    car: str
    vehicle: str
    learner: str
    length: float
    laps: tuple[Lap, ...]
    output: str | None
    set_path: str | None
    notes: tuple[str, ...]
    traces: tuple[np.ndarray, ...] = ()
    path: Path | None = None
    grips: tuple[tuple[float, ...], ...] = ()
    verdict: str = ""

    def summary(self) -> RaceResult:
        """Return the result without its traces and its track."""
        return replace(self, traces=(), path=None)
