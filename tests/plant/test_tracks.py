"""Tracks close, are as long as they say and as smooth; their heading and curvature belong to their points."""

import numpy as np
import pytest

from split_cli.errors import SplitError
from split_cli.plant.tracks import TRACK_NAMES, circle, find_track


@pytest.mark.parametrize("name", TRACK_NAMES)
def test_curvature_and_direction_integrate_back_to_a_closed_lap(name):
    track = find_track(name)
    # The step from the last sample to the first is a step like any other; a gap would show here.
    steps = np.hypot(np.diff(track.x, append=track.x[0]), np.diff(track.y, append=track.y[0]))
    assert steps.sum() == pytest.approx(track.length, rel=1e-4)  # chords are shorter by (kappa ds)^2/24
    np.testing.assert_allclose(steps, track.spacing, rtol=2e-3)
    # Sums over a whole period of a smooth function are exact to rounding: closure of a lap from its heading alone.
    assert abs(np.sum(np.exp(1j * track.direction)) * track.spacing) < 1e-3 * track.half_width
    turned = np.sum(track.curvature) * track.spacing
    assert turned == pytest.approx(track.turn, abs=1e-6)
    jump = track.direction[0] + track.turn - track.direction[-1]
    assert jump == pytest.approx(track.spacing * track.curvature[0], abs=1e-4)


@pytest.mark.parametrize("name", TRACK_NAMES)
def test_curvature_is_the_rate_of_direction_and_has_no_steps(name):
    track = find_track(name)
    rate = (np.roll(track.direction, -1) - np.roll(track.direction, 1))[1:-1] / (2 * track.spacing)
    peak = np.abs(track.curvature).max()
    np.testing.assert_allclose(rate, track.curvature[1:-1], atol=2e-3 * peak)
    # C2: from sample to sample curvature changes by a small part of its peak, over the lap's end too.
    assert np.abs(np.diff(track.curvature, append=track.curvature[0])).max() < 0.06 * peak


def test_the_lengths_are_the_named_ones():
    assert {name: find_track(name).length for name in TRACK_NAMES} == pytest.approx(
        {"handling": 2300.0, "small": 580.0, "oval": 1250.0, "f1tenth": 52.0}
    )


def test_no_track_crosses_itself():
    for name in TRACK_NAMES:
        track = find_track(name)
        points = np.stack([track.x, track.y], axis=1)[:: max(1, len(track.x) // 400)]
        gap = np.linalg.norm(points[:, None] - points[None], axis=2)
        apart = np.abs(np.subtract.outer(np.arange(len(points)), np.arange(len(points))))
        apart = np.minimum(apart, len(points) - apart) * track.length / len(points)
        far = apart > 8 * track.half_width
        assert gap[far].min() > 2 * track.half_width  # lanes of different stretches do not touch


@pytest.mark.parametrize("radius", [30.0, -30.0])
def test_a_circle_turns_to_its_side(radius):
    track = circle(radius)
    centre = np.hypot(track.x, track.y - radius)
    np.testing.assert_allclose(centre, 30.0, rtol=1e-12)
    assert track.turn == pytest.approx(np.sign(radius) * 2 * np.pi)
    assert track.curvature[7] == 1.0 / radius


def test_an_unknown_track_names_the_nearest():
    with pytest.raises(SplitError, match="handling"):
        find_track("handlin")
