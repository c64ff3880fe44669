"""Trust: the moments of a mixture, the plain method untouched, and its place in the set's file."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.learning.training_set import read_set, write_set
from split_cli.learning.trust import Trust, supported_variance
from tests.factories import make_training_set, write_forged_set

SIGNAL = np.array([0.5, 2.0, 0.1])


def test_mean_and_variance_are_those_of_the_shrunk_process():
    """Drawn a million times: tau of the posterior, and sqrt(1 - tau^2) of an independent draw from the prior."""
    trust, rng, draws = Trust((0.3, 0.8, 0.5)), np.random.default_rng(0), 1_000_000
    mean, variance = np.array([[0.7, -2.0, 0.2]]), np.array([[0.1, 0.4, 0.02]])
    tau = trust.array
    learned = mean + np.sqrt(variance) * rng.standard_normal((draws, 3))
    sample = tau * learned + np.sqrt((1.0 - tau**2) * SIGNAL) * rng.standard_normal((draws, 3))
    m, v = trust.apply(mean, variance, SIGNAL)
    # Five standard errors of a mean, and some of a variance.
    assert np.all(np.abs(m[0] - sample.mean(axis=0)) < 5.0 * np.sqrt(v[0] / draws))
    np.testing.assert_allclose(v[0], sample.var(axis=0), rtol=0.01)


def test_full_trust_changes_no_bit_none_leaves_the_prior_and_a_measured_doubt_is_added():
    rng = np.random.default_rng(1)
    mean, variance = rng.normal(size=(50, 3)), rng.random((50, 3)) * SIGNAL
    m, v = Trust.full().apply(mean, variance, SIGNAL)
    assert m.tobytes() == mean.tobytes() and v.tobytes() == variance.tobytes()
    m, v = Trust((0.0, 0.0, 0.0)).apply(mean, variance, SIGNAL)
    assert not m.any() and np.array_equal(v, np.tile(SIGNAL, (50, 1)))
    measured = Trust((1.0, 1.0, 1.0), "held-out", 9, (0.5, 0.0, 0.25))
    assert not measured.is_full
    np.testing.assert_allclose(measured.apply(mean, variance, SIGNAL)[1], variance + [0.5, 0.0, 0.25])


def test_far_from_the_data_the_variance_of_the_prior_returns_however_little_is_trusted():
    """And where the process knows all, the doubt is left; never less than the share that the mean has."""
    trust = Trust((0.2, 0.0, 0.9), "held-out", 9, tuple(SIGNAL * [0.3, 0.1, 0.5]))
    signal = SIGNAL[None]
    found = trust.apply(np.zeros((1, 3)), signal, SIGNAL)[1][0]
    np.testing.assert_allclose(found, SIGNAL * [1.0, 1.0, 0.81 + 0.5], rtol=1e-14)
    np.testing.assert_allclose(trust.apply(np.zeros((1, 3)), 0.0 * signal, SIGNAL)[1][0], trust.doubt)


def test_an_interval_is_supported_as_far_as_one_exact_label_reaches():
    """One exact label leaves (1 - e^(-d^2)) S0 at d length scales: the bound lies at one, whatever the trust."""
    share, doubt = np.array([0.2, 0.0, 0.9]), SIGNAL * [0.3, 1.2, 0.5]
    trust = Trust(tuple(share), "held-out", 9, tuple(doubt))
    for distance in (0.9, 1.1):
        left = (1.0 - np.exp(-(distance**2))) * SIGNAL[None]
        believed = trust.apply(np.zeros((1, 3)), left, SIGNAL)[1][0]
        # v_y: with a doubt of the whole prior the variance is the same everywhere and tells nothing.
        np.testing.assert_array_equal(
            believed <= supported_variance(share, doubt, SIGNAL), [distance < 1.0, True, distance < 1.0]
        )


def test_a_doubt_that_is_no_variance_is_refused():
    for doubt in ((1.0, 2.0), (1.0, -1.0, 0.0), (np.inf, 0.0, 0.0)):
        with pytest.raises(ValueError, match="three variances"):
            Trust((1.0, 1.0, 1.0), doubt=doubt)


@pytest.mark.parametrize("share", [(1.0, 0.5), (1.0, 0.5, 1.1), (-0.1, 0.0, 0.0), (np.nan, 0.0, 0.0)])
def test_what_is_no_share_is_refused(share):
    with pytest.raises(ValueError, match="three numbers from 0 to 1"):
        Trust(share)


def test_the_file_keeps_trust_and_an_older_one_is_read_as_fully_trusted(tmp_path):
    path, old = tmp_path / "car.split", tmp_path / "old.split"
    trained = replace(make_training_set(0, 300), trust=Trust((0.25, 0.0, 1.0), "held-out", 12, (0.5, 0.0, 0.1)))
    write_set(trained, path)
    assert read_set(path).trust == trained.trust

    def of_old(described):
        described.pop("trust")
        described["format"] = "split-set/1"

    write_forged_set(replace(trained, information=None, absorbed=None), old, of_old)
    again = read_set(old)
    assert again.trust.is_full and np.array_equal(again.z, trained.z)
