"""The line a controller follows: a centre line with its borders, closed or open, and errors against it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from split_cli.errors import SplitError


@dataclass(frozen=True)
class PathPoint:
    """The line at N places."""

    # x, y: (N,): [m]
    x: np.ndarray
    y: np.ndarray
    direction: np.ndarray  # (N,): angle of the tangent, unwrapped over laps [rad]
    curvature: np.ndarray  # (N,): positive in a left turn [1/m]
    # left, right: (N,): distance to the borders, both positive [m].
    left: np.ndarray
    right: np.ndarray


@dataclass(frozen=True)
class Path:
    """A line sampled at even arc length."""

    name: str
    spacing: float  # arc length between samples [m]
    # x, y, direction, curvature, left, right: (N,): as in `PathPoint`.
    x: np.ndarray
    y: np.ndarray
    direction: np.ndarray
    curvature: np.ndarray
    left: np.ndarray
    right: np.ndarray
    # Whether the last sample is one spacing before the first. An open line goes on straight beyond its ends.
    closed: bool = True

    @property
    def length(self) -> float:
        """Of a lap, or from end to end [m]."""
        return self.spacing * (len(self.x) if self.closed else len(self.x) - 1)

    @cached_property
    def turn(self) -> float:
        """Angle by which the tangent turns in a lap [rad]."""
        return float(2.0 * np.pi * np.round(np.sum(self.curvature) * self.spacing / (2.0 * np.pi)))

    def at(self, s: np.ndarray) -> PathPoint:
        """Return the line at arc lengths `s` [m], shape (N,); between samples it is straight."""
        s = np.asarray(s, dtype=float)
        count = len(self.x)
        if self.closed:
            laps = np.floor(s / self.length)
            position = s / self.spacing - laps * count
            low = np.clip(np.floor(position).astype(np.int64), 0, count - 1)
            high, share = (low + 1) % count, position - low
            wrapped = (high == 0).astype(float)
            start = laps * self.turn
            direction = self.direction[low] + share * (self.direction[high] + wrapped * self.turn - self.direction[low])
            extra_x = extra_y = 0.0
        else:
            inside = np.clip(s, 0.0, self.length)
            position = inside / self.spacing
            low = np.clip(np.floor(position).astype(np.int64), 0, count - 2)
            high, share = low + 1, position - low
            start = 0.0
            direction = self.direction[low] + share * (self.direction[high] - self.direction[low])
            extra_x, extra_y = (s - inside) * np.cos(direction), (s - inside) * np.sin(direction)

        def mixed(values: np.ndarray) -> np.ndarray:
            return values[low] + share * (values[high] - values[low])

        return PathPoint(
            mixed(self.x) + extra_x,
            mixed(self.y) + extra_y,
            direction + start,
            mixed(self.curvature),
            mixed(self.left),
            mixed(self.right),
        )

    def project(self, x: float, y: float, near: float, reach: float = 10.0) -> float:
        """Return the arc length [m] where (x, y) has no lag error, within `reach` of `near`."""
        s = near + np.linspace(-reach, reach, 81)
        point = self.at(s)
        s = float(s[np.argmin(np.hypot(point.x - x, point.y - y))])
        for _ in range(4):
            lag = contour_and_lag(self.at(np.array([s])), np.array([x]), np.array([y]))[1][0]
            s -= lag
        return s

    def nearest(self, x: float, y: float) -> float:
        """Return the arc length [m] of the nearest place of the whole line."""
        i = int(np.argmin(np.hypot(self.x - x, self.y - y)))
        return self.project(x, y, i * self.spacing, reach=2.0 * self.spacing)


def contour_and_lag(point: PathPoint, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return contour and lag error [m] of places (x, y) against points of the line, shapes (N,).

    Notes
    -----
    SPLIT paper, the lag and contour errors: e_l = -cos(Phi)(X - X_c) - sin(Phi)(Y - Y_c),
    e_c = sin(Phi)(X - X_c) - cos(Phi)(Y - Y_c). A car left of the line has a negative contour error, a car that
    is ahead of its reference a negative lag error. Along the line de_c/dtheta = -curvature e_l and
    de_l/dtheta = 1 + curvature e_c.
    """
    sine, cosine = np.sin(point.direction), np.cos(point.direction)
    dx, dy = x - point.x, y - point.y
    return sine * dx - cosine * dy, -cosine * dx - sine * dy


def resampled(
    name: str, points: np.ndarray, left: np.ndarray, right: np.ndarray, *, closed: bool, spacing: float = 0.25
) -> Path:
    """Return the smooth line through points, by a cubic spline over arc length.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
        [m]; of a closed line the first is not repeated at the end.
    left, right : ndarray, shape (N,)
        [m]
    spacing : float
        Of the result, about [m].
    """
    from scipy.interpolate import CubicSpline

    order = np.concatenate([points, points[:1]]) if closed else points
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(order, axis=0), axis=1))])
    spline = CubicSpline(chord, order, bc_type="periodic" if closed else "natural")
    fine = np.linspace(0.0, chord[-1], max(2000, int(8 * chord[-1] / spacing)))
    rate = np.linalg.norm(spline(fine, 1), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(fine))])
    count = max(8, int(round(arc[-1] / spacing)))
    s = np.arange(count) * arc[-1] / count if closed else np.linspace(0.0, arc[-1], count + 1)
    parameter = np.interp(s, arc, fine)
    xy, first, second = spline(parameter), spline(parameter, 1), spline(parameter, 2)
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / np.linalg.norm(first, axis=1) ** 3
    widths = [np.interp(parameter, chord, np.append(w, w[0]) if closed else w) for w in (left, right)]
    direction = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
    return Path(name, float(s[1]), xy[:, 0], xy[:, 1], direction, curvature, *widths, closed)


def check_path(path: Path, width: float) -> None:
    """Refuse a track on which a car of `width` [m] cannot drive.

    Raises
    ------
    SplitError
        If it is narrower than the car somewhere, bends tighter than its own border, or crosses itself.
    """
    room = path.left + path.right
    tightest = int(np.argmin(room))
    if room[tightest] <= width:
        what = f"is {room[tightest]:.2f} m wide at {tightest * path.spacing:.0f} m, the car is {width:.2f} m"
        advice = "Give widths in metres, widen the track, or name a narrower car with --width."
        raise SplitError(what, where=path.name, advice=advice)
    inner = np.where(path.curvature > 0.0, path.left, path.right) * np.abs(path.curvature)
    fold = int(np.argmax(inner))
    if inner[fold] >= 1.0:
        raise SplitError(
            f"bends with a radius of {1 / abs(path.curvature[fold]):.1f} m at {fold * path.spacing:.0f} m, less "
            "than the distance to its inner border",
            where=path.name,
            advice="Smooth the centre line or narrow the track there.",
        )
    found = _crossing(path)
    if found is not None:
        what = f"crosses itself: {found[0]:.0f} m and {found[1]:.0f} m along it meet"
        raise SplitError(what, where=path.name, advice="Draw the centre line so that it does not cross itself.")


def _crossing(path: Path) -> tuple[float, float] | None:
    """Return two arc lengths [m] whose lanes overlap, None when there are none."""
    every = max(1, int(round(2.0 / path.spacing)), len(path.x) // 1500)
    x, y, reach = path.x[::every], path.y[::every], np.maximum(path.left, path.right)[::every]
    s = np.arange(len(x)) * every * path.spacing
    apart = np.abs(s[:, None] - s[None, :])
    if path.closed:
        apart = np.minimum(apart, path.length - apart)
    distance = np.hypot(x[:, None] - x[None, :], y[:, None] - y[None, :])
    lanes = reach[:, None] + reach[None, :]
    # Neighbours on the line are near as well: only what is far along it (half a circle of both lanes) may not be.
    touching = (distance < 0.5 * lanes) & (apart > 0.5 * np.pi * lanes + 4.0 * every * path.spacing)
    if not touching.any():
        return None
    i, j = np.unravel_index(int(np.argmax(touching)), touching.shape)
    return float(s[i]), float(s[j])
