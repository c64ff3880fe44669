"""Displacements from position and yaw, to check a recording's velocity and yaw rate sensors.

Over windows of 0.5 s the lateral displacement of the car, from X, Y and yaw, is compared with the integral of the
recorded velocities. A turned or displaced velocity sensor contradicts the position; physics that a model lacks does
not. The longitudinal displacement and the change of yaw show scale errors of v_x and r.
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
    """Displacements of one recording over windows of 0.5 s, from positions and from velocities."""

    series: Series
    # begin, end: int64 (W,): first and last row of every window.
    begin: np.ndarray
    end: np.ndarray
    # across, along: (W,): displacement to the left and forward, in the vehicle frame at mid-window, from positions [m].
    across: np.ndarray
    along: np.ndarray
    angle: np.ndarray  # (N,): yaw, averaged over 0.2 s [rad]
    scale: float  # robust standard deviation of the difference, without the parts that faults of the sensor make [m]
    # (2,): weights of `error_patterns` in the simulated recordings, by yaw angle [m] and by distance [1].
    usual: np.ndarray

    def rows(self, terms: Sequence[Term]) -> np.ndarray:
        """Return `difference` less its usual part in the simulation, over `scale`, shape (W,): of unit variance."""
        return (self.difference(terms) - self.error_patterns @ self.usual) / self.scale

    def difference(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the displacement to the left by positions minus that by corrected velocities [m], shape (W,)."""
        return self.across - self._travelled(terms)[1]

    @property
    def kind(self) -> str:
        """Which redundant channel this is, see `Witness.kind`."""
        return "lateral"

    def is_changed_by(self, term: Term) -> bool:
        """Return whether a term can change the rows, as a fault of the velocity sensors does."""
        return term.corrects and self.series.is_moved_by(term)

    def ahead(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the displacement forward by corrected velocities [m], averaged as positions are, shape (W,)."""
        return self._travelled(terms)[0]

    def against_position(self, name: str, terms: Sequence[Term] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Return the integral of v_x [m] or r [rad] over windows, and the displacement or change of yaw, (W,) each.

        Both are averaged over 0.2 s, so that averaging removes the same share of quick motion from both.
        """
        if name == "v_x":
            return self.ahead(terms), self.along
        _, velocity = self.series.corrected(terms)
        return self._integral(velocity[:, 2], averaged=True), self.angle[self.end] - self.angle[self.begin]

    @cached_property
    def error_patterns(self) -> np.ndarray:
        """Return what a displaced sensor (per m) and a turned one (per rad) add to `difference`, shape (W, 2).

        These are the change of yaw [rad] and the distance [m] of every window.
        """
        _, velocity = self.series.corrected(())
        return np.stack([self._integral(velocity[:, 2]), self._integral(velocity[:, 0])], axis=1)

    @cached_property
    def drift_patterns(self) -> np.ndarray:
        """Return what a drifting angle (per rad/s) and a late v_y (per s) add to `difference`, shape (W, 2).

        `scale` is estimated without these parts, since a large fault would otherwise enlarge it.
        """
        v_y = self.series.corrected(())[1][:, 1]
        change = averaged_change(v_y, self.begin, self.end, self.series.period)
        return np.stack([self.error_patterns[:, 1] * self.series.t[self.begin], change], axis=1)

    def select(self, windows: np.ndarray) -> KinematicResiduals:
        """Return the same for a choice of windows, by mask or index."""
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
        # Integrated in the world frame once, then turned into the vehicle frame of each window.
        period = self.series.period
        x, y = displacements(velocity, sine, cosine, self.begin, self.end, edge_of(period))
        return _in_car_frame(middle, x * period, y * period)

    @cached_property
    def _direction(self) -> tuple[np.ndarray, np.ndarray]:
        return np.sin(self.series.yaw), np.cos(self.series.yaw)

    def _integral(self, rate: np.ndarray, averaged: bool = False) -> np.ndarray:
        return integral(rate, self.begin, self.end, self.series.period, averaged=averaged)


def build_kinematics(series: Series, usual: np.ndarray | None = None) -> KinematicResiduals | None:
    """Return the windows of a recording; None if position or yaw is missing, or if there are too few windows.

    Parameters
    ----------
    usual : ndarray, shape (2,), optional
        Of the simulated recordings, see `usual_weights`; by default zero.
    """
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
    left, causes = plain.difference(()), np.hstack([plain.error_patterns, plain.drift_patterns])
    left = left - causes @ np.linalg.lstsq(causes, left, rcond=None)[0]
    scale = 1.4826 * float(np.median(np.abs(left - np.median(left)))) + 1e-9
    return replace(plain, scale=scale)


def integral(rate: np.ndarray, begin: np.ndarray, end: np.ndarray, period: float, *, averaged: bool) -> np.ndarray:
    """Return the integral of a rate (N,) over windows, shape (W,); `averaged` over windows shifted within 0.2 s."""
    return integrals(rate, begin, end, edge_of(period) if averaged else 0) * period


def averaged_change(values: np.ndarray, begin: np.ndarray, end: np.ndarray, period: float) -> np.ndarray:
    """Return the change of values (N,), averaged over 0.2 s, from begin to end of windows, shape (W,)."""
    return changes(values, begin, end, edge_of(period))


def moving_mean(values: np.ndarray, period: float) -> np.ndarray:
    """Return the centred moving mean over 0.2 s of values (N,); ends are continued by their last value."""
    return uniform_filter1d(values, 2 * edge_of(period) + 1, mode="nearest")


def _in_car_frame(angle: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return forward and left components of world displacements x, y [m] at yaw angles [rad], shape (W,) each."""
    return np.cos(angle) * x + np.sin(angle) * y, -np.sin(angle) * x + np.cos(angle) * y


def usual_weights(several: Sequence[Any]) -> np.ndarray:
    """Return the weights of `error_patterns` in recordings, by least squares over all of one kind of witness.

    Returns
    -------
    ndarray, shape (2,) for lateral displacements, (3,) for a `Witness`
        Zero if there are no windows.
    """
    if not sum(len(one.begin) for one in several):
        return np.zeros(len(several[0].usual) if several else 2)
    causes = np.concatenate([one.error_patterns / one.scale for one in several])
    left = np.concatenate([one.difference(()) / one.scale for one in several])
    return np.linalg.lstsq(causes, left, rcond=None)[0]
