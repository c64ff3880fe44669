"""Greedy selection of terms against a planted sparse truth."""

import numpy as np
import pytest

from split_cli.proof.beyond_catalogue import Library, greedy_selection


def test_greedy_selection_takes_terms_whole_and_tells_what_is_left():
    matrix = np.random.default_rng(0).standard_normal((3000, 8))
    terms = ("mass", "wind", "wind", "aero_drag", "cg_shift", "steer_gain", "steer_lag", "yaw_inertia")
    noiseless = matrix @ np.array([0.0, 0.4, 0.3, 0.0, 0.0, -0.4, 0.0, 0.0])
    (first, left_first), (second, left_second) = greedy_selection(Library(matrix, terms), noiseless, 2)
    assert (first, second) == ("wind", "steer_gain")
    # Random columns are orthogonal to 1/sqrt(3000) = 0.018, twice of which enters a share of squares by each pair.
    assert left_first == pytest.approx(0.4**2 / (0.4**2 + 0.3**2 + 0.4**2), rel=0.1)
    assert left_second < 1e-20
