"""Random smooth closed tracks, so that no case can be won by knowing the place."""

import numpy as np
from scipy.interpolate import make_interp_spline

from split_cli.errors import SplitError
from split_cli.plant.tracks import Track


def random_track(rng: np.random.Generator, length: float, spacing: float, half_width: float) -> Track:
    """Return a random closed track without crossings, counter-clockwise or clockwise.

    The radius over the angle is 1 plus random waves, r = 1 + sum a_k cos(k phi + p_k); the curve is scaled to the
    length and sampled at even arc length.

    Parameters
    ----------
    length, spacing, half_width : float
        [m]; the tightest radius of curvature is at least 1/90 of the length.

    Raises
    ------
    SplitError
        If no acceptable track came out of 200 trials.
    """
    for _ in range(200):
        track = _trial(rng, length, spacing, half_width)
        if np.abs(track.curvature).max() * length < 90.0:
            return track
    raise SplitError("no random track was wide enough in its bends")


def _trial(rng: np.random.Generator, length: float, spacing: float, half_width: float) -> Track:
    phi = np.linspace(0.0, 2.0 * np.pi, 721)
    radius = np.ones_like(phi)
    for k in range(2, 7):
        radius += rng.normal(0.0, 0.42 / k) * np.cos(k * phi + rng.uniform(0.0, 2.0 * np.pi))
    radius = np.maximum(radius, 0.25)
    stretch = rng.uniform(0.6, 1.0)
    sign = rng.choice((-1.0, 1.0))
    points = np.stack([radius * np.cos(phi), sign * stretch * radius * np.sin(phi)], axis=1)
    points[-1] = points[0]
    spline = make_interp_spline(phi, points, k=5, bc_type="periodic")
    fine = np.linspace(0.0, 2.0 * np.pi, 20001)
    rate = np.linalg.norm(spline(fine, 1), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(fine))])
    count = int(round(length / spacing))
    scale = length / arc[-1]
    bend = _curvature(spline, fine)
    # The lap starts where it is straightest.
    start = arc[np.argmin(np.abs(bend[:-1]))]
    at = np.interp((start + np.arange(count) * arc[-1] / count) % arc[-1], arc, fine)
    velocity = spline(at, 1)
    xy = (spline(at) - spline(at[0])) * scale
    direction = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    return Track(
        name="random",
        spacing=length / count,
        x=xy[:, 0],
        y=xy[:, 1],
        direction=direction,
        curvature=_curvature(spline, at) / scale,
        half_width=half_width,
    )


def _curvature(spline, at: np.ndarray) -> np.ndarray:
    velocity, bend = spline(at, 1), spline(at, 2)
    cross = velocity[:, 0] * bend[:, 1] - velocity[:, 1] * bend[:, 0]
    return cross / np.linalg.norm(velocity, axis=1) ** 3
