"""Redundant channels that can confirm a sensor fault: changes of yaw and of position, and accelerations.

Every witness compares, over windows of half a second, what one instrument says with what the velocities make of
it. Physics that a model lacks moves none of them; faults of sensors do. What the simulation's recordings leave in
the same way (a scale, a bias and a delay of each witness) is usual and no difference.
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
    usual_part,
)
from split_cli.diagnosis.recording.measured import measures
from split_cli.diagnosis.recording.series import VISIBLE, Series
from split_cli.diagnosis.recording.windows import LEAST_WINDOWS, edge_of, windows_within
from split_cli.vehicle.effects import Term

_CHANNELS = {"a_x": "ax", "a_y": "ay"}
_KINDS = ("turn", "way", *_CHANNELS)
# A channel that is recorded finer than this share of its spread is no noise but the number of its last digit.
_LEAST_SPREAD = 1e-3


@dataclass(frozen=True)
class Witness:
    """One instrument of a recording against its velocities, window by window."""

    kind: str  # ``turn`` (yaw against r) [rad], ``way`` (positions against v_x) [m], ``a_x`` or ``a_y`` [m/s]
    series: Series
    # begin, end: int64 (W,): first and last row of every window.
    begin: np.ndarray
    end: np.ndarray
    position: KinematicResiduals | None  # with the displacements of the windows, for ``way`` and ``turn``
    scale: float  # spread of what the velocities leave
    usual: np.ndarray  # (3,): what the simulation's recordings leave by scale, bias and delay

    def rows(self, terms: Sequence[Term]) -> np.ndarray:
        """Return this difference, less what the simulation shows too, over its spread, shape (W,)."""
        return (self.difference(terms) - self.causes @ self.usual) / self.scale

    def difference(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the instrument's value minus that computed from the velocities, shape (W,)."""
        said, made, _ = self._compared(terms)
        return said - made

    def feels(self, term: Term) -> bool:
        """Return whether a term can change the rows: a sensor's fault, or a lean that accelerometers feel."""
        if self.position is not None:
            return self.position.feels(term)
        return term.corrects or term.is_felt

    @cached_property
    def causes(self) -> np.ndarray:
        """Return the patterns of an error of scale, of a bias and of a delay of the instrument, shape (W, 3)."""
        _, made, rate = self._compared(())
        return np.stack([made, (self.end - self.begin) * self.series.period, self._change(rate)], axis=1)

    @cached_property
    def slow_causes(self) -> np.ndarray:
        """Return the pattern of a bias that drifts, shape (W, 1)."""
        return self.causes[:, 1:2] * self.series.t[self.begin, None]

    def select(self, windows: np.ndarray) -> Witness:
        """Return these windows alone."""
        position = None if self.position is None else self.position.select(windows)
        return replace(self, begin=self.begin[windows], end=self.end[windows], position=position)

    def _compared(self, terms: Sequence[Term]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return each window's value by instrument and by velocities, (W,) each, and the rate behind it, (N,)."""
        _, velocity = self.series.corrected(terms)
        v_x, v_y, r = velocity.T
        if self.kind == "turn":
            angle = self.position.angle
            return angle[self.end] - angle[self.begin], self._integral(r), r
        if self.kind == "way":
            return self.position.along, self.position.ahead(terms), v_x
        felt = self.series.accelerations(terms)[_CHANNELS[self.kind]]
        # In a turn the velocities' own axes turn: a_x = v_x' - v_y r and a_y = v_y' + v_x r.
        changing, turning = (v_x, -v_y * r) if self.kind == "a_x" else (v_y, v_x * r)
        return self._integral(felt), self._change(changing) + self._integral(turning), felt

    def _change(self, values: np.ndarray) -> np.ndarray:
        return averaged_change(values, self.begin, self.end, self.series.period)

    def _integral(self, rate: np.ndarray) -> np.ndarray:
        return integral(rate, self.begin, self.end, self.series.period, averaged=True)


def build_witnesses(
    series: Series, usual_by_kind: Mapping[str, np.ndarray] | None = None, rules: Believing = STANDARD.believing
) -> list[KinematicResiduals | Witness]:
    """Return all that a recording can be held against; what is usual by kind, of the simulation's recordings."""
    usual_by_kind, found = usual_by_kind or {}, []
    measured_position = measures(series.drive, "X", "Y", "yaw")
    position = build_kinematics(series, usual_by_kind.get("across")) if measured_position else None
    if position is not None:
        found.append(position)
    for kind in _KINDS:
        one = _witness(kind, series, position, rules)
        if one is None:
            continue
        left, causes = one.difference(()), one.causes
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


def usual_parts(witnesses: Iterable[KinematicResiduals | Witness]) -> dict[str, np.ndarray]:
    """Return what recordings leave of each kind of witness: by kind, shape (2,) or (3,)."""
    by_kind: dict[str, list[KinematicResiduals | Witness]] = {}
    for one in witnesses:
        by_kind.setdefault(one.kind, []).append(one)
    return {kind: usual_part(several) for kind, several in by_kind.items()}


def late_against_position(series: Series, policy: Policy = STANDARD) -> bool:
    """Return whether yaw rate or velocity is some samples early or late against yaw or position.

    Velocities that were derived from position are not; what was shifted since, or read with another clock, is.
    """
    witnesses = build_witnesses(series, rules=policy.believing)
    delays = [abs(usual_part([one])[2]) for one in witnesses if one.kind in ("turn", "way")]
    return max(delays, default=0.0) > policy.screening.late_samples * series.period


def is_integral(series: Series, share: float) -> bool:
    """Return whether the yaw is the integral of the yaw rate of the same recording, its noise included.

    Parameters
    ----------
    series : Series
    share : float
        Of how far noise carries an integral away, within which a yaw is that integral.

    Notes
    -----
    White noise sigma of the yaw rate carries its integral over N samples away by h sigma sqrt(N) from the yaw of
    any other instrument. One that was integrated stays with it to rounding. Where r has no noise nobody can tell.
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
    """Return whether a witness is the displacement across the car between positions."""
    return isinstance(one, KinematicResiduals)


def _witness(kind: str, series: Series, position: KinematicResiduals | None, rules: Believing) -> Witness | None:
    if kind in ("turn", "way"):
        if position is None:
            return None
        # The yaw angle is averaged, and its change again: twice the edge is unknown at both ends of a run.
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
    # Samples without a number were filled: windows that hold one, once all is averaged, witness nothing.
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
    """Return in which windows samples tell a rate, shape (W,): they jump at most `most` times as far as elsewhere.

    Where torque chatters, an accelerometer jumps from sample to sample, and what it did in between is unknown.

    Notes
    -----
    With every other sample the trapezoidal rule makes h (a_0 - 2 a_1 + a_2)/2 more of two steps h (Richardson,
    1911). The root of the sum of its squares is how far a window's integral may be off.
    """
    apart = np.zeros(len(rate))
    apart[1:-1] = 0.5 * period * (rate[2:] - 2.0 * rate[1:-1] + rate[:-2])
    total, way = np.cumsum(apart**2), np.cumsum(rate) * period
    rough = np.sqrt(total[end - 1] - total[begin])
    return rough <= most * max(float(np.median(rough)), _LEAST_SPREAD * float(np.std(way[end] - way[begin])))


def _least_squares(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    scale = np.abs(columns).max(axis=0) + 1e-300
    return np.linalg.lstsq(columns / scale, target, rcond=1e-8)[0] / scale
