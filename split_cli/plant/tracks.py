"""Closed tracks as smooth centrelines with heading and curvature."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from split_cli.errors import SplitError, nearest_names
from split_cli.yaml_file import read_yaml_mapping


@dataclass(frozen=True)
class Track:
    """A closed centreline sampled at even arc length; the last sample is one spacing before the first."""

    name: str
    spacing: float  # arc length between samples [m]
    # x, y: (N,): points [m].
    x: np.ndarray
    y: np.ndarray
    direction: np.ndarray  # (N,): angle of the tangent, unwrapped [rad]
    curvature: np.ndarray  # (N,): positive in a left turn [1/m]
    half_width: float  # from the centreline to the edge [m]

    @property
    def length(self) -> float:
        """Length of a lap [m]."""
        return self.spacing * len(self.x)

    @property
    def turn(self) -> float:
        """Angle by which the tangent turns in a lap: one whole turn, positive counter-clockwise [rad]."""
        return float(2.0 * np.pi * np.round(np.sum(self.curvature) * self.spacing / (2.0 * np.pi)))


@dataclass(frozen=True)
class _Outline:
    """Corners of a polygon, each rounded by an arc, then smoothed."""

    # (x, y, radius): [m]; the lap starts in the middle of the edge from the last corner to the first.
    corners: list[list[float]]
    length: float  # the finished centreline is scaled to it [m]
    smoothing: float  # standard deviation of the Gaussian over arc length that turns arcs into easements [m]
    # spacing, half_width: [m]
    spacing: float
    half_width: float


_OUTLINES = {
    name: _Outline(**given)
    for name, given in read_yaml_mapping(Path(__file__).with_name("tracks.yaml"), SplitError).items()
}

TRACK_NAMES = tuple(_OUTLINES)


@lru_cache(maxsize=16)
def find_track(name: str) -> Track:
    """Return the track called `name`.

    Raises
    ------
    SplitError
        If there is none; names the nearest.
    """
    if name not in _OUTLINES:
        raise SplitError(f"no track is called {name!r}", where="--track", advice=nearest_names(name, _OUTLINES))
    outline = _OUTLINES[name]
    return _from_closed_points(
        name, _smooth_closed(_rounded_polygon(outline), outline), outline.length, outline.spacing, outline.half_width
    )


def circle(radius: float) -> Track:
    """Return a circle to the left (or, with a negative radius, to the right) that starts at the origin.

    Parameters
    ----------
    radius : float
        [m]
    """
    size = abs(radius)
    count = int(np.ceil(2.0 * np.pi / 0.005))
    angle = np.arange(count) * 2.0 * np.pi / count
    sign = np.sign(radius)
    return Track(
        name=f"circle {radius:g} m",
        spacing=2.0 * np.pi * size / count,
        x=size * np.sin(angle),
        y=sign * size * (1.0 - np.cos(angle)),
        direction=sign * angle,
        curvature=np.full(count, 1.0 / radius),
        half_width=4.0,
    )


def _rounded_polygon(outline: _Outline) -> np.ndarray:
    """Return dense points (N, 2) of the polygon with its corners rounded by arcs."""
    corners = np.array([corner[:2] for corner in outline.corners], dtype=float)
    points = [0.5 * (corners[-1] + corners[0])]
    for i, (x, y, radius) in enumerate(outline.corners):
        corner = np.array([x, y])
        inward = corner - corners[i - 1]
        outward = corners[(i + 1) % len(corners)] - corner
        inward, outward = inward / np.linalg.norm(inward), outward / np.linalg.norm(outward)
        turn = np.arctan2(inward[0] * outward[1] - inward[1] * outward[0], inward @ outward)
        cut = radius * np.tan(abs(turn) / 2.0)
        start = corner - cut * inward
        normal = np.sign(turn) * np.array([-inward[1], inward[0]])
        swept = np.linspace(0.0, turn, max(8, int(np.ceil(abs(turn) * 60))))
        begin = np.arctan2(-normal[1], -normal[0])
        centre = start + radius * normal
        points.extend(centre + radius * np.stack([np.cos(begin + swept), np.sin(begin + swept)], axis=1))
    return np.array(points)


def _smooth_closed(points: np.ndarray, outline: _Outline) -> np.ndarray:
    """Return even points (N, 2) after a periodic Gaussian over arc length; infinitely smooth and closed."""
    closed = np.vstack([points, points[:1]])
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    count = 4096
    even = np.linspace(0.0, s[-1], count, endpoint=False)
    path = np.interp(even, s, closed[:, 0]) + 1j * np.interp(even, s, closed[:, 1])
    waves = np.fft.fftfreq(count, s[-1] / count) * 2.0 * np.pi
    smooth = np.fft.ifft(np.fft.fft(path) * np.exp(-0.5 * (waves * outline.smoothing) ** 2))
    return np.stack([smooth.real, smooth.imag], axis=1)


def _from_closed_points(name: str, points: np.ndarray, length: float, spacing: float, half_width: float) -> Track:
    """Return the track through closed points, scaled to a length, by a periodic quintic spline (C4)."""
    count = len(points)
    spline = make_interp_spline(np.arange(count + 1.0), np.vstack([points, points[:1]]), k=5, bc_type="periodic")
    speed = spline.derivative()
    fine = np.linspace(0.0, count, 8 * count + 1)
    rate = np.linalg.norm(speed(fine), axis=1)
    # Trapezoids over a period of a smooth periodic function converge faster than any power.
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * (fine[1] - fine[0]))])
    scale = length / arc[-1]
    samples = int(round(length / spacing))
    parameter = np.interp(np.arange(samples) * arc[-1] / samples, arc, fine)
    velocity, bend = speed(parameter), spline.derivative(2)(parameter)
    curvature = (velocity[:, 0] * bend[:, 1] - velocity[:, 1] * bend[:, 0]) / np.linalg.norm(velocity, axis=1) ** 3
    # Each coordinate lies in one piece, as those of a test circle do: the loop is compiled for one layout.
    x, y = np.ascontiguousarray(((spline(parameter) - spline(0.0)) * scale).T)
    return Track(
        name=name,
        spacing=length / samples,
        x=x,
        y=y,
        direction=np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0])),
        curvature=curvature / scale,
        half_width=half_width,
    )
