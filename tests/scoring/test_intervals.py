"""Intervals that are too narrow are told from those that miss by chance."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.scoring.intervals import interval_shares, interval_warnings, too_narrow
from tests.factories import make_training_set

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


def traces_of(name, deviation, seed):
    """Return what a predictor said of a drive whose errors have the deviations 1, 2, 1."""
    random, rows = np.random.default_rng(seed), np.arange(BLOCKS * ROWS)
    drive = type("Drive", (dict,), {"segment": np.zeros(len(rows), dtype=int)})(t=0.1 * rows)
    error = random.normal(size=(len(rows), 3)) * (1.0, 2.0, 1.0)
    told = SimpleNamespace(mean=np.zeros((len(rows), 3)), variance=np.full((len(rows), 3), 0.5 * deviation**2))
    tested = SimpleNamespace(y=error, row=rows)
    noise = np.full(3, 0.5 * deviation**2)
    held = SimpleNamespace(drive=drive)
    return SimpleNamespace(name=name, held=held, tested=tested, prediction=told, noise_variance=noise)


def test_each_predictor_that_is_shown_is_judged_by_its_own_intervals():
    narrow, right, wide = (traces_of(name, d, 3) for name, d in (("bcm", 0.5), ("rbcm", 1.0), ("projected", 2.0)))
    assert interval_warnings([wide]) == [] and interval_warnings([]) == []
    assert [text.split()[3] for text in interval_warnings([right, wide])] == ["v_y"]
    told = interval_warnings([narrow, right, wide])
    assert [text.split()[3] for text in told] == ["v_x", "v_y", "r"]
    # Of v_y 38 % lie inside 0.5 * 1.96 / 2 and 67 % inside 1.96 / 2 deviations; four times as wide would be right.
    found = re.search(r"hold only (\d+) % \(bcm\) and (\d+) % \(rbcm\) of the labels.* up to ([\d.]+) times", told[1])
    shares = [float(part) for part in found.groups()]
    assert shares == pytest.approx([37.6, 67.3, 4.0], rel=0.06) and "projected" not in told[1]
    assert "rbcm" not in told[0]


def test_shares_near_the_points_and_beyond_are_told_apart_and_in_the_warning():
    """Errors of one deviation on the points, of three a thousand length scales away, and intervals for one."""
    trained, random = make_training_set(seed=3, points=40), np.random.default_rng(5)
    trace = traces_of("projected", 1.0, 3)
    rows = len(trace.tested.row)
    far = np.arange(rows) % 4 == 0
    trace.features = "z2"
    trace.tested.y = random.normal(size=(rows, 3)) * np.where(far, 3.0, 1.0)[:, None]
    trace.tested.z = trained.z[random.integers(len(trained.z), size=rows)]
    trace.tested.z[far] += 1e3 * trained.kernel.length_scales
    trace.tested.y[8] = np.nan  # what cannot be labelled counts for neither
    near, beyond = interval_shares([trace], {"z2": trained})
    assert (near.near, near.samples, beyond.near, beyond.samples) == (True, 900, False, 299)
    assert near.share + beyond.share == pytest.approx(1.0)
    for share, coverage in zip((0.5, 0.9, 0.95), (near.coverage_50, near.coverage_90, near.coverage_95), strict=True):
        np.testing.assert_allclose(coverage, share, atol=0.05)  # three standard errors of 900 labels
    # Within a third of 1.96 deviations lie 48.6 %.
    np.testing.assert_allclose(beyond.coverage_95, 0.486, atol=0.09)
    told = interval_warnings([trace], (near, beyond))
    figures = re.search(r"hold (\d+) % near the points of the set and (\d+) % farther than a length scale", told[2])
    assert [float(part) for part in figures.groups()] == [round(100 * s.coverage_95[2]) for s in (near, beyond)]
