"""Figures of merit against closed forms, SciPy, and Gaussians whose coverage is known."""

import numpy as np
import pytest
from scipy.stats import binom, norm

from split_cli.scoring.metrics import ErrorSums, ProbabilitySums, skill


def test_root_mean_squares_and_norm_of_known_errors():
    sums = ErrorSums.of(np.array([[3.0, 0.0, 1.0], [-1.0, 2.0, 1.0]]))
    np.testing.assert_allclose(sums.rmse, np.sqrt([5.0, 2.0, 1.0]), rtol=1e-15)
    assert sums.norm == pytest.approx(np.sqrt(8.0))  # sqrt of the mean of 10 and 6


def test_drives_are_pooled_by_squares_not_by_means_of_roots():
    rng = np.random.default_rng(0)
    long, short = rng.normal(0.0, 1.0, (900, 3)), rng.normal(0.0, 5.0, (10, 3))
    pooled = ErrorSums.of(long) + ErrorSums.of(short)
    together = ErrorSums.of(np.concatenate([long, short]))
    np.testing.assert_allclose(pooled.rmse, together.rmse, rtol=1e-14)
    # The mean of the two roots would be near 3, the truth is near 1.1.
    assert 0.9 < pooled.rmse[0] < 1.5


def test_rows_that_are_not_numbers_are_left_out_of_sum_and_count():
    errors = np.array([[1.0, 1.0, 1.0], [np.nan, 5.0, 5.0], [np.inf, 0.0, 0.0]])
    assert ErrorSums.of(errors).count == 1
    np.testing.assert_array_equal(ErrorSums.of(errors).rmse, 1.0)
    assert ProbabilitySums.of(errors, np.ones((3, 3))).count == 1
    assert np.isnan(ErrorSums.of(errors[1:]).rmse).all()


def test_skill_is_one_zero_and_negative():
    reference = ErrorSums.of(np.full((4, 3), 2.0))
    np.testing.assert_array_equal(skill(ErrorSums.of(np.zeros((4, 3))), reference), 1.0)
    np.testing.assert_array_equal(skill(reference, reference), 0.0)
    np.testing.assert_allclose(skill(ErrorSums.of(np.full((9, 3), 4.0)), reference), -3.0, rtol=1e-14)
    assert np.isnan(skill(reference, ErrorSums.of(np.zeros((4, 3))))).all()


def test_negative_log_density_equals_scipys():
    rng = np.random.default_rng(1)
    errors, variance = rng.normal(size=(50, 3)), rng.uniform(0.1, 4.0, (50, 3))
    expected = -norm.logpdf(errors, scale=np.sqrt(variance)).mean(axis=0)
    np.testing.assert_allclose(ProbabilitySums.of(errors, variance).nlpd, expected, rtol=1e-13)
    # Halves add up to the whole.
    halves = ProbabilitySums.of(errors[:20], variance[:20]) + ProbabilitySums.of(errors[20:], variance[20:])
    np.testing.assert_allclose(halves.nlpd, expected, rtol=1e-13)
    # One variance for all samples is the same as that variance for each.
    constant = ProbabilitySums.of(errors, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(constant.nlpd, -norm.logpdf(errors, scale=np.sqrt([1.0, 2.0, 3.0])).mean(axis=0))


def test_coverage_of_gaussians_with_the_right_and_half_the_deviation():
    rng = np.random.default_rng(2)
    count = 20_000
    variance = rng.uniform(0.2, 3.0, (count, 3))
    errors = np.sqrt(variance) * rng.normal(size=(count, 3))
    right = ProbabilitySums.of(errors, variance)
    levels, observed = right.reliability_curve
    # Each count is binomial; 1e-6 of either tail, over 57 counts, keeps the test's own false alarms below 1e-4.
    for level, row in zip(levels, observed, strict=True):
        low, high = binom.ppf([1e-6, 1 - 1e-6], count, level) / count
        assert ((low <= row) & (row <= high)).all()
    np.testing.assert_allclose(right.coverage[1], observed[-1], atol=1e-12)  # both are the 95 % interval
    np.testing.assert_allclose(right.coverage[0], observed[9], atol=1e-12)
    narrow = ProbabilitySums.of(errors, 0.25 * variance)
    # An interval of half the width holds 2 Phi(1.96/2) - 1 = 67.3 %; four standard errors are 1.3 %.
    np.testing.assert_allclose(narrow.coverage[1], 2 * norm.cdf(norm.ppf(0.975) / 2) - 1, atol=0.014)
