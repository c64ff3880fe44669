"""Whether a term saves in many moments or in one: entries that are simply given, without recordings."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import ttest_1samp

import split_cli.diagnosis.search.term_tests as term_tests
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.search.fitting import Fit, Part
from split_cli.diagnosis.search.term_tests import block_t, block_z, blocks_p, is_spread


def objective_of(blocks: int, rows: int) -> MarginalLikelihood:
    block = np.repeat(np.arange(blocks), rows)
    empty = np.zeros(0)
    return MarginalLikelihood((), None, None, (), empty, empty.reshape(0, 0), block, np.ones(len(block)), empty)


def fit_of(residuals: np.ndarray) -> Fit:
    return Fit((), float(residuals @ residuals), residuals, np.empty((len(residuals), 0)))


def test_block_z_is_a_t_of_the_blocks_sums():
    rng = np.random.default_rng(2)
    one, other = rng.standard_normal((2, 120))
    sums = [float(np.sum(other[k : k + 10] ** 2 - one[k : k + 10] ** 2)) for k in range(0, 120, 10)]
    expected = np.mean(sums) / (np.std(sums, ddof=1) / np.sqrt(len(sums)))
    assert block_z(objective_of(12, 10), fit_of(one), fit_of(other)) == pytest.approx(expected, rel=1e-6)


def test_what_is_saved_in_one_moment_counts_for_one():
    """All in one of n blocks: z is 1, however much it is; a tenth in every block: z grows without bound."""
    base = np.ones(200)
    once, always = base.copy(), base - 0.1 + 1e-3 * np.tile([1.0, -1.0], 100)
    once[:10] = 0.0
    objective = objective_of(20, 10)
    assert block_z(objective, fit_of(once), fit_of(base)) == pytest.approx(1.0, rel=1e-6)
    assert block_z(objective, fit_of(always), fit_of(base)) > 100.0


def test_block_t_is_a_regression_on_blocks_own_sizes():
    """Each block tells its own size of d: mean 1, and t is what the spread of these means leaves of it."""
    rng = np.random.default_rng(3)
    d = rng.standard_normal(120)
    sizes = 1.0 + 0.3 * rng.standard_normal(12)
    without = np.repeat(sizes, 10) * d
    weight = np.array([float(np.sum(d[k : k + 10] ** 2)) for k in range(0, 120, 10)])
    best = float(weight @ sizes / weight.sum())
    left = without - best * d
    error = np.sqrt(np.sum((weight * (sizes - best)) ** 2)) / weight.sum()
    assert block_t(objective_of(12, 10), fit_of(left), fit_of(without)) == pytest.approx(best / error, rel=1e-6)


def test_blocks_in_which_an_effect_acts_alike_are_students_sample_and_one_block_says_nothing():
    rng = np.random.default_rng(5)
    sizes, d = 1.0 + 0.8 * rng.standard_normal(9), np.ones(90)
    without = np.repeat(sizes, 10)
    objective, left = objective_of(9, 10), without - sizes.mean()
    student = ttest_1samp(sizes, 0.0)
    # The sandwich has n in the place of n - 1.
    same = block_t(objective, fit_of(left), fit_of(without)) * np.sqrt(8 / 9)
    assert same == pytest.approx(student.statistic, rel=1e-6)
    assert 0.5 * student.pvalue < blocks_p(objective, fit_of(left), fit_of(without)) < student.pvalue
    # All that acts lies in one block: there is no other that could agree.
    without[10:] -= sizes.repeat(10)[10:]
    assert blocks_p(objective, fit_of(without - sizes[0] * d * (without != 0.0)), fit_of(without)) == pytest.approx(1.0)


def test_few_blocks_that_agree_are_believed_and_few_that_do_not_are_not(monkeypatch):
    """In three blocks of forty: z stays below 3.29 however large it is; t asks whether they say the same.

    If they do not, only what is larger than the noise is believed.
    """
    rng = np.random.default_rng(4)
    objective, rules = objective_of(40, 25), STANDARD.selection
    noise, acts = 0.2 * rng.standard_normal(1000), np.array([4, 16, 29])
    for sizes, believed in (((1.0, 1.0, 1.0), True), ((2.6, 0.3, 0.1), False)):
        d, without = np.zeros((40, 25)), noise.reshape(40, 25).copy()
        d[acts] = 3.0
        without[acts] += 3.0 * np.array(sizes)[:, None]
        d, without = d.ravel(), without.ravel()
        left = without - float(d @ without / (d @ d)) * d
        fit = replace(fit_of(left), parts=(Part(SimpleNamespace(located=""), {}),))
        assert block_z(objective, fit, fit_of(without)) < STANDARD.comparison.deviations
        for effect_to_noise in (0.9, 1.1):
            monkeypatch.setattr(term_tests, "term_size", lambda *_, effect_to_noise=effect_to_noise: effect_to_noise)
            expected = believed or effect_to_noise > 1.0
            assert is_spread(objective, fit, 0, fit_of(without), rules) == expected
