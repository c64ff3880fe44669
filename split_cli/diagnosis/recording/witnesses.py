"""Witnesses: redundant channels that can confirm or contradict a sensor fault.

A witness compares one instrument with the velocities over windows of 0.5 s: the change of yaw with the integral of r,
the distance between positions with the integral of v_x, and accelerations with the change of the velocities. Physics
that a model lacks changes none of these differences; faults of sensors do. A scale error, a bias or a delay that the
simulated recordings show in the same way is called usual and is no difference between the two.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from split_cli.diagnosis.policy import STANDARD, Believing, Policy
from split_cli.diagnosis.recording.kinematics import (
    KinematicResiduals,
    averaged_change,
    build_kinematics,
    integral,
    usual_weights,
)
from split_cli.diagnosis.recording.measured import measures
from split_cli.diagnosis.recording.series import VISIBLE, Series
from split_cli.diagnosis.recording.windows import LEAST_WINDOWS, edge_of, windows_within
from split_cli.vehicle.effects import Term

_CHANNELS = {"a_x": "ax", "a_y": "ay"}
_KINDS = ("yaw", "distance", *_CHANNELS)
# Least deviation of a difference over that of the channel [1]: smaller ones are rounding.
_LEAST_SPREAD = 1e-3


@dataclass(frozen=True)
class Witness:
    """One instrument of a recording compared with its velocities, window by window."""

    # ``yaw``: change of yaw and integral of r [rad]; ``distance``: distance and integral of v_x [m]; ``a_x`` or
    # ``a_y``: integral of the acceleration and change of v_x or v_y [m/s].
    kind: str
    series: Series
    # begin, end: int64 (W,): first and last row of every window.
    begin: np.ndarray
    end: np.ndarray
    position: KinematicResiduals | None  # with the displacements of the windows, for ``distance`` and ``yaw``
    scale: float  # robust standard deviation of the difference, in the unit of the kind
    usual: np.ndarray  # (3,): scale error [1], bias per second and delay [s] in the simulated recordings

    def rows(self, terms: Sequence[Term]) -> np.ndarray:
        """Return `difference` less its usual part in the simulation, over `scale`, shape (W,): of unit variance."""
        return (self.difference(terms) - self.error_patterns @ self.usual) / self.scale

    def difference(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the instrument's value minus that from corrected velocities, shape (W,), in the unit of the kind."""
        said, made, _ = self._compared(terms)
        return said - made

    def is_changed_by(self, term: Term) -> bool:
        """Return whether a term can change the rows: a sensor fault or, for accelerations, a road angle."""
        if self.position is not None:
            return self.position.is_changed_by(term)
        return term.corrects or term.inclines_car

    @cached_property
    def error_patterns(self) -> np.ndarray:
        """Return what a unit scale error, bias and delay of the instrument add to `difference`, shape (W, 3)."""
        _, made, rate = self._compared(())
        return np.stack([made, (self.end - self.begin) * self.series.period, self._change(rate)], axis=1)

    @cached_property
    def drift_patterns(self) -> np.ndarray:
        """Return what a bias that drifts at unit rate adds to `difference`, shape (W, 1)."""
        return self.error_patterns[:, 1:2] * self.series.t[self.begin, None]

    def select(self, windows: np.ndarray) -> Witness:
        """Return the same for a choice of windows, by mask or index."""
        position = None if self.position is None else self.position.select(windows)
        return replace(self, begin=self.begin[windows], end=self.end[windows], position=position)

    def _compared(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return each window's value by instrument and by velocities, (W,) each, and the rate behind it, (N,)."""
        _, velocity = self.series.corrected(terms)
        v_x, v_y, r = velocity.T
        if self.kind == "yaw":
            angle = self.position.angle
            return angle[self.end] - angle[self.begin], self._integral(r), r
        if self.kind == "distance":
            return self.position.along, self.position.ahead(terms), v_x
        felt = self.series.accelerations(terms)[_CHANNELS[self.kind]]
        # The vehicle frame rotates: a_x = v_x' - v_y r and a_y = v_y' + v_x r.
        changing, turning = (v_x, -v_y * r) if self.kind == "a_x" else (v_y, v_x * r)
        return self._integral(felt), self._change(changing) + self._integral(turning), felt

    def _change(self, values: np.ndarray) -> np.ndarray:
        return averaged_change(values, self.begin, self.end, self.series.period)

    def _integral(self, rate: np.ndarray) -> np.ndarray:
        return integral(rate, self.begin, self.end, self.series.period, averaged=True)


def build_witnesses(
    series: Series, usual_by_kind: Mapping[str, np.ndarray] | None = None, rules: Believing = STANDARD.believing
) -> list[KinematicResiduals | Witness]:
    """Return all witnesses of a recording.

    Parameters
    ----------
    usual_by_kind : mapping of str to ndarray, optional
        Of the simulated recordings, see `usual_weights_by_kind`; by default zero.
    """
    usual_by_kind, found = usual_by_kind or {}, []
    measured_position = measures(series.drive, "X", "Y", "yaw")
    position = build_kinematics(series, usual_by_kind.get("lateral")) if measured_position else None
    if position is not None:
        found.append(position)
    for kind in _KINDS:
        one = _witness(kind, series, position, rules)
        if one is None:
            continue
        left, causes = one.difference(()), one.error_patterns
        own = left - causes @ _least_squares(causes, left)
        spread = 1.4826 * float(np.median(np.abs(own - np.median(own))))
        size = float(np.std(causes[:, 0]))
        if not np.isfinite(spread) or size <= 0.0:
            continue
        usual = usual_by_kind.get(kind)
        found.append(
            replace(one, scale=max(spread, _LEAST_SPREAD * size), usual=np.zeros(3) if usual is None else usual)
        )
    return found


def usual_weights_by_kind(witnesses: Iterable[KinematicResiduals | Witness]) -> dict[str, np.ndarray]:
    """Return `usual_weights` of each kind of witness, shape (2,) or (3,), by kind."""
    by_kind: dict[str, list[KinematicResiduals | Witness]] = {}
    for one in witnesses:
        by_kind.setdefault(one.kind, []).append(one)
    return {kind: usual_weights(several) for kind, several in by_kind.items()}


def late_against_position(series: Series, policy: Policy = STANDARD) -> bool:
    """Return whether yaw rate or velocity has a delay of some samples against yaw or position, of either sign.

    Velocities derived from position have none, unless they were shifted later or read with another clock.
    """
    witnesses = build_witnesses(series, rules=policy.believing)
    delays = [abs(usual_weights([one])[2]) for one in witnesses if one.kind in ("yaw", "distance")]
    return max(delays, default=0.0) > policy.screening.late_samples * series.period


def is_integral(series: Series, share: float) -> bool:
    """Return whether the yaw is the integral of the yaw rate of the same recording, its noise included.

    Parameters
    ----------
    series : Series
    share : float
        Of the drift that noise of the yaw rate causes [1]. A yaw that stays closer to the integral is that integral.

    Notes
    -----
    White noise sigma of the yaw rate makes its integral over N samples of h drift by h sigma sqrt(N) from the yaw of
    an independent instrument. A yaw that was integrated from it agrees to rounding. Without noise the two cases cannot
    be distinguished, and the answer is no.
    """
    noise, r = series.noise[2], series.measured[:, 2]
    if noise <= VISIBLE * r.std() or series.drive.metadata.is_derived("r"):
        return False
    for begin, end in series.recording.segments:
        before, after, yaw = r[begin : end - 1], r[begin + 1 : end], series.yaw[begin + 1 : end]
        ways = (before, after, 0.5 * (before + after))
        apart = [np.ptp(yaw - series.period * np.cumsum(rate)) for rate in ways if len(rate)]
        if min(apart, default=0.0) > share * series.period * noise * np.sqrt(end - begin):
            return False
    return True


def is_witness_of_position(one: KinematicResiduals | Witness) -> bool:
    """Return whether a witness compares lateral displacements between positions."""
    return isinstance(one, KinematicResiduals)


def _witness(kind: str, series: Series, position: KinematicResiduals | None, rules: Believing) -> Witness | None:
    if kind in ("yaw", "distance"):
        if position is None:
            return None
        # The yaw angle is averaged, and its change again: windows keep twice the edge from both ends of a segment.
        edge = 2 * edge_of(series.period)
        first, last = np.array(series.recording.segments, dtype=np.int64).T
        run = np.searchsorted(first, position.begin, side="right") - 1
        whole = (position.begin - edge >= first[run]) & (position.end + edge < last[run])
        if whole.sum() < LEAST_WINDOWS:
            return None
        position = position.select(whole)
        return Witness(kind, series, position.begin, position.end, position, 1.0, np.zeros(3))
    if not measures(series.drive, _CHANNELS[kind]):
        return None
    begin, size = windows_within(series.recording.segments, series.period)
    edge = edge_of(series.period)
    # Windows with interpolated samples, averaging included, are left out.
    unknown = np.cumsum(~np.isfinite(series.drive[_CHANNELS[kind]]))
    last = np.minimum(begin + size + 2 * edge, len(unknown) - 1)
    begin = begin[unknown[last] == unknown[np.maximum(begin - 2 * edge, 0)]]
    if not len(begin):
        return None
    felt = series.accelerations(())[_CHANNELS[kind]]
    begin = begin[_resolved(felt, begin - edge, begin + size + edge, series.period, rules.huber)]
    if len(begin) < LEAST_WINDOWS:
        return None
    return Witness(kind, series, begin, begin + size, None, 1.0, np.zeros(3))


def _resolved(rate: np.ndarray, begin: np.ndarray, end: np.ndarray, period: float, most: float) -> np.ndarray:
    """Return in which windows the sampling resolves a rate, bool (W,).

    Where the torque chatters, an acceleration jumps from sample to sample, and its values in between are unknown.

    Parameters
    ----------
    most : float
        Largest error of a window's integral, in medians of all windows [1].

    Notes
    -----
    With every second sample the trapezoidal rule over two steps h differs by h (a_0 - 2 a_1 + a_2)/2 (Richardson,
    1911). The root of the sum of the squares estimates the error of a window's integral.
    """
    apart = np.zeros(len(rate))
    apart[1:-1] = 0.5 * period * (rate[2:] - 2.0 * rate[1:-1] + rate[:-2])
    total, way = np.cumsum(apart**2), np.cumsum(rate) * period
    rough = np.sqrt(total[end - 1] - total[begin])
    return rough <= most * max(float(np.median(rough)), _LEAST_SPREAD * float(np.std(way[end] - way[begin])))


def _least_squares(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    scale = np.abs(columns).max(axis=0) + 1e-300
    return np.linalg.lstsq(columns / scale, target, rcond=1e-8)[0] / scale
