"""Trust acts on every predictor alike: on mean, variance and Jacobian."""

from dataclasses import replace

import numpy as np
import pytest

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
