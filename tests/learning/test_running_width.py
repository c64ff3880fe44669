"""Running width: the bound that holds for any labels, and intervals far too narrow that come to hold."""

import numpy as np
import pytest
from scipy.stats import norm

from split_cli.learning.running_width import RunningWidth

LEVELS = np.array([0.5, 0.9, 0.95])


def follow(ratios: np.ndarray) -> tuple[np.ndarray, RunningWidth]:
    width = RunningWidth()
    return np.array([width.observe(ratio) for ratio in ratios]), width


@pytest.mark.parametrize("scale", [0.05, 1.0, 8.0])
def test_the_share_inside_is_off_by_no_more_than_the_bound(scale):
    """Heavy tails, drifting and correlated: nothing of them is known to the widths."""
    rng = np.random.default_rng(5)
    drift = np.exp(np.cumsum(0.02 * rng.standard_normal((2000, 3)), axis=0))
    inside, width = follow(scale * drift * rng.standard_t(3, (2000, 3)))
    off = np.abs(inside.mean(axis=0) - LEVELS[:, None])
    moved = np.abs(np.log(width.widths / norm.ppf(0.5 + 0.5 * LEVELS)[:, None]))
    np.testing.assert_allclose(off, moved / (0.1 * 2000), atol=1e-9)
    assert off.max() < 0.03


def test_where_the_deviation_is_right_the_widths_stay_a_gaussians():
    inside, width = follow(np.random.default_rng(6).standard_normal((4000, 3)))
    assert np.abs(inside.mean(axis=0) - LEVELS[:, None]).max() < 0.005
    assert np.abs(np.log(width.widths / norm.ppf(0.5 + 0.5 * LEVELS)[:, None])).max() < 0.6


def test_what_is_not_finite_changes_nothing():
    width = RunningWidth()
    before = width.widths.copy()
    assert not width.observe(np.full(3, np.nan)).any()
    np.testing.assert_array_equal(width.widths, before)
