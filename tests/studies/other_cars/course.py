"""Courses to drive on, drawn by a generator: closed courses, figures of eight, and slaloms around an oval."""

from dataclasses import dataclass

import numpy as np

STYLES = ("closed course", "slalom", "figure eight", "mixed driving")
"""Mixed driving is on a closed course, with steps of the throttle and pulses of the steering by the driver."""
_POINTS = 1600


@dataclass(frozen=True)
class ClosedCourse:
    """A closed path in equal steps of its length.

    Attributes
    ----------
    x, y, heading, curvature : ndarray, shape (N,)
        [m], [m], [rad] without jumps, [1/m], positive to the left.
    length : float
        [m].
    """

    style: str
    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    curvature: np.ndarray
    length: float

    @property
    def spacing(self) -> float:
        """Distance between points [m]."""
        return self.length / len(self.x)

    def index(self, place: float) -> int:
        """Return the point nearest to a distance along the path, which may be of any lap."""
        return round(place / self.spacing) % len(self.x)

    def advanced(self, place: float, x: float, y: float) -> float:
        """Return the distance along the path of the foot of a point, near `place` and not behind it [m]."""
        i = self.index(place)
        c, s = np.cos(self.heading[i]), np.sin(self.heading[i])
        ahead = (x - self.x[i]) * c + (y - self.y[i]) * s
        aside = -(x - self.x[i]) * s + (y - self.y[i]) * c
        bent = max(1.0 - self.curvature[i] * aside, 0.3)
        return place + max(ahead / bent + round(place / self.spacing) * self.spacing - place, 0.0)

    def speeds(self, lateral: float, driving: float, braking: float, bounds: tuple[float, float]) -> np.ndarray:
        """Return the speed at each point that keeps these accelerations [m/s^2] and bounds [m/s], shape (N,)."""
        slow, fast = bounds
        allowed = np.clip(np.sqrt(lateral / np.maximum(np.abs(self.curvature), 1e-6)), slow, fast)
        count = len(allowed)
        for i in range(2 * count):
            j = (i + 1) % count
            allowed[j] = min(allowed[j], np.sqrt(allowed[i % count] ** 2 + 2.0 * driving * self.spacing))
        for i in range(2 * count, 0, -1):
            j = (i - 1) % count
            allowed[j] = min(allowed[j], np.sqrt(allowed[i % count] ** 2 + 2.0 * braking * self.spacing))
        return allowed


def draw_course(rng: np.random.Generator, style: str, room: float) -> ClosedCourse:
    """Return a course of one of `STYLES` with a mean radius of about `room` [m]."""
    angle = np.linspace(0.0, 2.0 * np.pi, 20 * _POINTS, endpoint=False)
    if style == "figure eight":
        wide, high = room * rng.uniform(1.5, 1.9), room * rng.uniform(1.3, 1.7)
        x = wide * np.sin(angle) + 0.12 * room * np.sin(2.0 * angle + rng.uniform(0.0, 6.0))
        y = high * np.sin(angle) * np.cos(angle) + 0.08 * room * np.cos(3.0 * angle + rng.uniform(0.0, 6.0))
    elif style == "slalom":
        x, y = room * rng.uniform(1.3, 1.7) * np.cos(angle), room * rng.uniform(0.8, 1.0) * np.sin(angle)
        waves = round(2.0 * np.pi / rng.uniform(0.55, 0.85))
        swing = room * rng.uniform(0.008, 0.013) * (1.0 + 0.3 * np.sin(angle + rng.uniform(0.0, 6.0)))
        along_x, along_y = np.gradient(x), np.gradient(y)
        size = np.hypot(along_x, along_y)
        offset = swing * np.sin(waves * angle)
        x, y = x - offset * along_y / size, y + offset * along_x / size
    else:
        radius = np.full_like(angle, room)
        for k in range(2, 6):
            radius = radius + room * rng.uniform(0.15, 0.35) / k * np.cos(k * angle + rng.uniform(0.0, 6.0))
        x, y = radius * np.cos(angle), radius * np.sin(angle)
    if rng.random() < 0.5:
        y = -y
    turned = rng.uniform(0.0, 2.0 * np.pi)
    x, y = x * np.cos(turned) - y * np.sin(turned), x * np.sin(turned) + y * np.cos(turned)
    return _evenly(style, x, y)


def _evenly(style: str, x: np.ndarray, y: np.ndarray) -> ClosedCourse:
    closed_x, closed_y = np.append(x, x[0]), np.append(y, y[0])
    place = np.append(0.0, np.cumsum(np.hypot(np.diff(closed_x), np.diff(closed_y))))
    at = np.linspace(0.0, place[-1], _POINTS, endpoint=False)
    x, y = np.interp(at, place, closed_x), np.interp(at, place, closed_y)
    next_x, next_y = np.roll(x, -1) - np.roll(x, 1), np.roll(y, -1) - np.roll(y, 1)
    heading = np.unwrap(np.arctan2(next_y, next_x))
    turned = np.roll(heading, -1) - np.roll(heading, 1)
    turned = (turned + np.pi) % (2.0 * np.pi) - np.pi
    return ClosedCourse(style, x, y, heading, turned / (2.0 * place[-1] / _POINTS), float(place[-1]))
