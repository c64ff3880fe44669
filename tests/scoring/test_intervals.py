"""Intervals that are too narrow are told from those that miss by chance."""

from __future__ import annotations

import numpy as np
import pytest

from split_cli.scoring.intervals import too_narrow

BLOCKS, ROWS = 20, 60


def drawn(seed, true_deviation, between=0.0):
    random = np.random.default_rng(seed)
    block = np.repeat(np.arange(BLOCKS), ROWS)
    error = true_deviation * random.normal(size=BLOCKS * ROWS) + between * random.normal(size=BLOCKS)[block]
    return error, np.ones(BLOCKS * ROWS), block


def test_right_intervals_are_believed_and_narrow_ones_are_told_with_the_factor_they_lack():
    alarms = sum(too_narrow(*drawn(seed, 1.0)) is not None for seed in range(200))
    assert alarms == 0
    share, factor = too_narrow(*drawn(1, 2.0))
    assert share == pytest.approx(0.673, abs=0.03) and factor == pytest.approx(2.0, rel=0.06)
    assert too_narrow(*drawn(1, 0.5)) is None


def test_blocks_count_and_not_samples():
    """Errors that a few blocks share may miss by chance, and three blocks tell nothing."""
    error, deviation, block = drawn(2, 1.0)
    error[block == 7] += 4.0
    assert np.mean(np.abs(error) < 1.96) < 0.92 and too_narrow(error, deviation, block) is None
    assert too_narrow(error, 0.3 * deviation, block) is not None
    few = block < 3
    assert too_narrow(error[few], 0.3 * deviation[few], block[few]) is None
