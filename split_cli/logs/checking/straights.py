"""The direction of the recorded velocity on straights over time: constant, stepping, drifting or wandering.

On a straight a car has no sideslip, whatever its tyres. What v_y/v_x reads there is the sensor: turned, offset, or
losing its heading, as satellite and inertial units do over minutes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.logs.checking.kinematics import Kinematics

_STRAIGHT_LATERAL = 0.3
"""Of v_x r [m/s^2]: a thirtieth of what tyres carry, whose slip angle is then a few milliradians."""
SHORTEST = 0.8
"""Of a straight that counts [s]: four times the width that signals are smoothed with."""
LONGEST = 4.0
"""A longer straight is parted, so that a step within it can be placed [s]."""
_FEWEST = 6
"""Straights from which a course over time is reported; with fewer only their mean."""
_SMALLEST = 2e-3
"""Change of direction that is worth telling [rad]: crossfall of 2.5 % tilts a car's path by about as much."""
_WORTH = 10.0
"""Of the Bayesian information criterion that another course must gain [1]: odds of 150 to 1."""


@dataclass(frozen=True)
class Stretch:
    """One straight, or a part of one."""

    time: float  # of its middle [s]
    seconds: float
    angle: float  # median of v_y/v_x [rad]


@dataclass(frozen=True)
class Direction:
    """How the direction of v_y goes over a drive."""

    kind: str  # ``constant``, ``drifting``, ``stepping`` or ``wandering``
    # time, angle: (K,): knots [s], [rad]; a straight line between two, constant beyond the ends.
    time: np.ndarray
    angle: np.ndarray
    # mean, error: over the straights, and its standard error [rad].
    mean: float
    error: float
    scatter: float  # what is left of the straights around the course [rad], rms
    count: int  # straights it is found on

    def at(self, t: np.ndarray) -> np.ndarray:
        """Return the angle at times t [s], shape (N,)."""
        return np.interp(t, self.time, self.angle)

    def words(self) -> str:
        """Return the course in words, with its size."""
        low, high = 1e3 * float(self.angle.min()), 1e3 * float(self.angle.max())
        first, last = 1e3 * float(self.angle[0]), 1e3 * float(self.angle[-1])
        span = float(self.time[-1] - self.time[0])
        if self.kind == "constant":
            if not np.isfinite(self.error):
                return f"{1e3 * self.mean:+.1f} mrad on one straight, which shows no interval"
            return f"constant, {1e3 * self.mean:+.1f} +- {1e3 * self.error:.1f} mrad on {self.count} straights"
        if self.kind == "drifting":
            return f"drifting from {first:+.1f} to {last:+.1f} mrad within {span:.0f} s"
        if self.kind == "stepping":
            when = float(np.mean(self.time[1:3]))
            return f"stepping from {first:+.1f} to {last:+.1f} mrad at t = {when:.0f} s"
        return f"wandering between {low:+.1f} and {high:+.1f} mrad within {span:.0f} s"


def straight_rows(k: Kinematics) -> np.ndarray:
    """Return the rows where the car neither turns nor begins to, shape (N,); needs v_x and r."""
    r = k.signal("r")
    straight = k.moving & (np.abs(k.signal("vx") * r) < _STRAIGHT_LATERAL) & (np.abs(k.rate("r")) < 0.1)
    return straight & (np.abs(r) < max(0.02, 0.05 * float(np.nanquantile(np.abs(r), 0.95))))


def straight_stretches(
    t: np.ndarray, vx: np.ndarray, vy: np.ndarray, straight: np.ndarray, period: float, segments: Sequence[slice]
) -> list[Stretch]:
    """Return the straights of a drive, long ones in parts.

    Parameters
    ----------
    t, vx, vy : ndarray, shape (N,)
        [s], [m/s].
    straight : ndarray of bool, shape (N,)
        Rows where the car neither turns nor begins to.
    period : float
        [s].
    """
    found = []
    for segment in segments:
        rows = np.arange(segment.start, segment.stop)[straight[segment]]
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            parts = max(int(np.ceil(len(run) * period / LONGEST)), 1)
            for part in np.array_split(run, parts):
                if len(part) * period < SHORTEST:
                    continue
                angle = float(np.nanmedian(vy[part] / vx[part]))
                if np.isfinite(angle):
                    found.append(Stretch(float(np.mean(t[part])), len(part) * period, angle))
    return found


def course_of(stretches: Sequence[Stretch]) -> Direction | None:
    """Return how the direction goes over the straights; None without any.

    Notes
    -----
    A constant, a line and a step are fitted by least squares weighted by duration; the Bayesian information
    criterion decides. Where neighbours around the best of them are alike (lag-1 correlation above 0.5), the
    direction drifts, and its knots are the straights averaged with their neighbours.
    """
    if not stretches:
        return None
    names = ("time", "seconds", "angle")
    time, seconds, angle = (np.array([getattr(stretch, name) for stretch in stretches]) for name in names)
    mean = float(np.average(angle, weights=seconds))
    spread = float(np.sqrt(np.average((angle - mean) ** 2, weights=seconds)))
    error = spread / np.sqrt(max(len(angle) - 1, 1)) if len(angle) > 1 else np.inf
    ends = np.array([time[0], max(time[-1], time[0] + 1e-3)])
    constant = Direction("constant", ends, np.array([mean, mean]), mean, error, spread, len(angle))
    if len(angle) < _FEWEST:
        return constant
    weight = seconds / seconds.mean()
    best, criterion = constant, _criterion(angle - mean, weight, 1)
    line = np.polyfit(time, angle, 1, w=np.sqrt(weight))
    for candidate, parameters in ((_line(constant, line, ends), 2), (_step(constant, time, angle, weight), 3)):
        if candidate is None or np.ptp(candidate.angle) < _SMALLEST:
            continue
        value = _criterion(angle - candidate.at(time), weight, parameters)
        if value < criterion - _WORTH:
            best, criterion = candidate, value
    rest = angle - best.at(time)
    best = _with_scatter(best, rest, weight)
    if len(angle) >= 2 * _FEWEST and best.scatter > 0.5 * _SMALLEST:
        together = float(np.corrcoef(rest[:-1], rest[1:])[0, 1])
        wandering = _wandering(constant, time, angle, weight)
        if together > 0.5 and np.ptp(wandering.angle) > 2.0 * _SMALLEST:
            return _with_scatter(wandering, angle - wandering.at(time), weight)
    return best


def _with_scatter(course: Direction, rest: np.ndarray, weight: np.ndarray) -> Direction:
    scatter = float(np.sqrt(np.average(rest**2, weights=weight)))
    return Direction(course.kind, course.time, course.angle, course.mean, course.error, scatter, course.count)


def _criterion(rest: np.ndarray, weight: np.ndarray, parameters: int) -> float:
    # A tenth of a milliradian is below what any of these sensors resolves.
    variance = float(np.average(rest**2, weights=weight)) + 1e-8
    return len(rest) * np.log(variance) + parameters * np.log(len(rest))


def _line(constant: Direction, line: np.ndarray, ends: np.ndarray) -> Direction:
    return Direction("drifting", ends, np.polyval(line, ends), constant.mean, constant.error, 0.0, constant.count)


def _step(constant: Direction, time: np.ndarray, angle: np.ndarray, weight: np.ndarray) -> Direction | None:
    best, least = None, np.inf
    for place in range(2, len(angle) - 1):
        before = float(np.average(angle[:place], weights=weight[:place]))
        after = float(np.average(angle[place:], weights=weight[place:]))
        rest = np.concatenate([angle[:place] - before, angle[place:] - after])
        cost = float(np.average(rest**2, weights=weight))
        if cost < least:
            middle = 0.5 * (time[place - 1] + time[place])
            knots = np.array([time[0], middle - 1e-3, middle + 1e-3, time[-1]])
            levels = np.array([before, before, after, after])
            best = Direction("stepping", knots, levels, constant.mean, constant.error, 0.0, constant.count)
            least = cost
    return best


def _wandering(constant: Direction, time: np.ndarray, angle: np.ndarray, weight: np.ndarray) -> Direction:
    width = 2.0 * float(np.median(np.diff(time)))
    kernel = np.exp(-0.5 * ((time[:, None] - time[None, :]) / width) ** 2) * weight[None, :]
    smooth = kernel @ angle / kernel.sum(axis=1)
    return Direction("wandering", time, smooth, constant.mean, constant.error, 0.0, constant.count)
