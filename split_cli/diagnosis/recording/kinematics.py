"""True velocities from position and yaw, to check a recording's velocity and yaw rate sensors.

Over windows of half a second the displacement across the car, from X, Y and yaw, is compared with the integral of
the recorded velocities. A velocity sensor that is turned or displaced contradicts its own position; no missing
physics does. Displacement along the car and the turn of yaw tell the scales of v_x and r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from split_cli.diagnosis.recording.series import Series
from split_cli.diagnosis.recording.windows import (
    LEAST_WINDOWS,
    changes,
    displacements,
    edge_of,
    integrals,
    windows_within,
)
from split_cli.vehicle.effects import Term


@dataclass(frozen=True)
class KinematicResiduals:
    """Displacements of one recording over windows of half a second: positions against velocities."""

    series: Series
    # begin, end: int64 (W,): first and last row of every window.
    begin: np.ndarray
    end: np.ndarray
    # across, along: (W,): displacement to the car's left and ahead at mid-window, from positions [m].
    across: np.ndarray
    along: np.ndarray
    angle: np.ndarray  # (N,): yaw, averaged over 0.2 s [rad]
    scale: float  # spread of what velocities leave of it [m], faults of the sensor taken off
    # (2,): share of yaw angle [m] and of distance [1] that the simulation's recordings leave too.
    usual: np.ndarray

    def rows(self, terms: Sequence[Term]) -> np.ndarray:
        """Return this difference, less what the simulation shows too, over its spread, shape (W,)."""
        return (self.difference(terms) - self.causes @ self.usual) / self.scale

    def difference(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the displacement to the left by positions minus that by velocities [m], shape (W,)."""
        return self.across - self._travelled(terms)[1]

    @property
    def kind(self) -> str:
        """Name among the witnesses of a recording."""
        return "across"

    def feels(self, term: Term) -> bool:
        """Return whether a term can change the rows: a fault of the velocities."""
        return term.corrects and self.series.is_moved_by(term)

    def ahead(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the displacement ahead by velocities [m], averaged as positions are, shape (W,)."""
        return self._travelled(terms)[0]

    def against_position(self, name: str, terms: Sequence[Term] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Return the integral of v_x [m] or r [rad] over windows, and the change of position or yaw, (W,) each.

        Both are averaged over 0.2 s, so that both lose as much of a quick turn.
        """
        if name == "v_x":
            return self.ahead(terms), self.along
        _, velocity = self.series.corrected(terms)
        return self._integral(velocity[:, 2], averaged=True), self.angle[self.end] - self.angle[self.begin]

    @cached_property
    def causes(self) -> np.ndarray:
        """Return the yaw angle [rad] and the distance [m] of every window, shape (W, 2)."""
        _, velocity = self.series.corrected(())
        return np.stack([self._integral(velocity[:, 2]), self._integral(velocity[:, 0])], axis=1)

    @cached_property
    def slow_causes(self) -> np.ndarray:
        """Return the patterns of a sensor whose angle drifts [m s] and one whose v_y is late [m/s], shape (W, 2).

        The spread is taken without them: a large fault would hide in a spread that it makes itself.
        """
        v_y = self.series.corrected(())[1][:, 1]
        change = averaged_change(v_y, self.begin, self.end, self.series.period)
        return np.stack([self.causes[:, 1] * self.series.t[self.begin], change], axis=1)

    def select(self, windows: np.ndarray) -> KinematicResiduals:
        """Return these windows alone."""
        chosen = {name: getattr(self, name)[windows] for name in ("begin", "end", "across", "along")}
        return replace(self, **chosen)

    def _travelled(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray]:
        """Return displacements ahead and to the left at mid-window, from velocities [m], shape (W,) each.

        They are averaged over 0.2 s as positions are, and turned by yaw as recorded: a mean of 0.2 s lags where a
        car turns in, and the noise of yaw averages over the window.
        """
        _, velocity = self.series.corrected([term for term in terms if not term.moves_position])
        middle = self.angle[(self.begin + self.end) // 2]
        sine, cosine = self._direction
        # In the world frame once, then into the car's frame of each window.
        period = self.series.period
        x, y = displacements(velocity, sine, cosine, self.begin, self.end, edge_of(period))
        return _in_car_frame(middle, x * period, y * period)

    @cached_property
    def _direction(self) -> tuple[np.ndarray, np.ndarray]:
        return np.sin(self.series.yaw), np.cos(self.series.yaw)

    def _integral(self, rate: np.ndarray, averaged: bool = False) -> np.ndarray:
        return integral(rate, self.begin, self.end, self.series.period, averaged=averaged)


def build_kinematics(series: Series, usual: np.ndarray | None = None) -> KinematicResiduals | None:
    """Return the windows of a recording, or None without position and yaw, or with too few windows."""
    drive = series.drive
    if not drive.has_position:
        return None
    begin, size = windows_within(series.recording.segments, series.period)
    if len(begin) < LEAST_WINDOWS:
        return None
    end = begin + size
    x, y, angle = (moving_mean(values, series.period) for values in (drive["X"], drive["Y"], series.yaw))
    middle = angle[(begin + end) // 2]
    along, across = _in_car_frame(middle, x[end] - x[begin], y[end] - y[begin])
    plain = KinematicResiduals(series, begin, end, across, along, angle, 1.0, np.zeros(2) if usual is None else usual)
    left, causes = plain.difference(()), np.hstack([plain.causes, plain.slow_causes])
    left = left - causes @ np.linalg.lstsq(causes, left, rcond=None)[0]
    scale = 1.4826 * float(np.median(np.abs(left - np.median(left)))) + 1e-9
    return replace(plain, scale=scale)


def integral(rate: np.ndarray, begin: np.ndarray, end: np.ndarray, period: float, *, averaged: bool) -> np.ndarray:
    """Return the integral of a rate over windows, shape (W,), over 0.2 s of shifted windows if `averaged`."""
    return integrals(rate, begin, end, edge_of(period) if averaged else 0) * period


def averaged_change(values: np.ndarray, begin: np.ndarray, end: np.ndarray, period: float) -> np.ndarray:
    """Return the change of values, averaged over 0.2 s, over windows, shape (W,)."""
    return changes(values, begin, end, edge_of(period))


def moving_mean(values: np.ndarray, period: float) -> np.ndarray:
    """Return the centred moving mean over 0.2 s of values (N,); ends are continued by their last value."""
    return uniform_filter1d(values, 2 * edge_of(period) + 1, mode="nearest")


def _in_car_frame(angle: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the components ahead and to the left of displacements in the world, for cars at these yaw angles."""
    return np.cos(angle) * x + np.sin(angle) * y, -np.sin(angle) * x + np.cos(angle) * y


def usual_part(several: Sequence[Any]) -> np.ndarray:
    """Return what recordings leave by each cause of one kind of witness: of displacements across the car, by yaw
    angle [m] and distance [1], shape (2,).
    """
    if not sum(len(one.begin) for one in several):
        return np.zeros(len(several[0].usual) if several else 2)
    causes = np.concatenate([one.causes / one.scale for one in several])
    left = np.concatenate([one.difference(()) / one.scale for one in several])
    return np.linalg.lstsq(causes, left, rcond=None)[0]
