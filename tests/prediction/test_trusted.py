"""Trust acts on every predictor alike: on mean, variance and Jacobian."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.learning.kernel import Kernel
from split_cli.learning.trust import Trust
from split_cli.prediction import make_predictor
from tests.factories import make_training_set

TRUST = Trust((0.4, 0.0, 1.0), "given")


@pytest.fixture(scope="module")
def stored():
    return make_training_set(3, 300)


@pytest.mark.parametrize("name", ["bcm", "full", "fitc"])
def test_predictions_are_the_trusted_share_of_the_plain_ones(stored, name):
    plain, trusted = make_predictor(name, stored), make_predictor(name, replace(stored, trust=TRUST))
    z = stored.z[::7] + 0.003
    if plain.needs_context:
        plain, trusted = plain.at(stored.z[:20]), trusted.at(stored.z[:20])
    assert trusted.name == name and trusted.needs_context == plain.needs_context
    raw, got = plain.predict(z), trusted.predict(z)
    prior = stored.kernel.signal_variance
    np.testing.assert_array_equal(got.mean, TRUST.array * raw.mean)
    np.testing.assert_array_equal(got.mean, trusted.predict(z).mean)
    np.testing.assert_allclose(got.variance[:, 0], 0.16 * raw.variance[:, 0] + 0.84 * prior[0])
    np.testing.assert_allclose(got.variance[:, 1], prior[1], rtol=1e-15)
    np.testing.assert_array_equal(got.variance[:, 2], raw.variance[:, 2])
    np.testing.assert_array_equal(trusted.jacobian(z), TRUST.array[:, None] * plain.jacobian(z))


def test_the_jacobian_is_the_slope_of_the_trusted_mean(stored):
    trusted = make_predictor("bcm", replace(stored, trust=TRUST))
    z, step = stored.z[::20] + 0.002, 1e-6
    slope = trusted.jacobian(z)
    for feature in range(3):
        shift = step * np.eye(3)[feature]
        measured = (trusted.mean(z + shift) - trusted.mean(z - shift)) / (2.0 * step)
        # Central differences of a mean of size 1 lose 1e-16/1e-6, and curvature adds step squared.
        np.testing.assert_allclose(slope[:, :, feature], measured, atol=2e-7 * np.abs(slope).max())


@pytest.mark.parametrize("name", ["bcm", "rbcm", "projected", "full", "local"])
def test_what_is_known_of_a_lone_label_in_closed_form_whatever_the_trust(name, make_set):
    """At a label 1 - v/S0 is S0/(S0 + s^2), of the output with the largest signal for its noise; far away 0."""
    kernel = Kernel(np.array([0.02, 0.03, 0.2]), np.array([0.5, 1.0, 2.0]), np.array([0.05, 0.01, 0.1]))
    one = make_set(np.array([[0.01, -0.02, 0.3]]), np.ones((1, 3)), kernel)
    ratio = kernel.signal_variance / (kernel.signal_variance + kernel.noise_variance)
    predictor = make_predictor(name, one)
    assert kernel.clearest == int(np.argmax(ratio))
    if name != "rbcm":  # an expert of it counts by what it has learned
        np.testing.assert_allclose(predictor.knowledge(one.z), ratio.max(), rtol=1e-9)
    np.testing.assert_allclose(predictor.knowledge(one.z + 40.0 * kernel.length_scales), 0.0, atol=1e-12)
    doubted = make_predictor(name, replace(one, trust=Trust((0.0, 0.3, 0.5), "held-out", 9, (1.0, 2.0, 3.0))))
    mean, known = doubted.mean_and_knowledge(one.z)
    np.testing.assert_array_equal(known, predictor.knowledge(one.z))
    np.testing.assert_allclose(mean, doubted.mean(one.z), rtol=1e-12)
