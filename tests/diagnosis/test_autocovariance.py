"""Long-run variances against sums over windows."""

import numpy as np
import pytest

from split_cli.diagnosis.innovations.autocovariance import autocovariances, bartlett_sum


@pytest.mark.parametrize("width", [1, 2, 7])
def test_the_bartlett_sum_is_the_mean_square_of_sums_over_windows(width):
    rows = np.random.default_rng(1).standard_normal((60, 3)).cumsum(axis=0)
    windows = np.stack([np.convolve(column, np.ones(width)) for column in rows.T], axis=1)
    expected = np.sum(windows**2, axis=0) / (width * len(rows))
    found = np.mean(rows**2, axis=0) + bartlett_sum(autocovariances(rows, width - 1), width)
    # An identity: the two differ by rounding.
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_fewer_lags_than_the_width_keep_their_weights():
    covariances = np.array([[3.0, 1.0], [2.0, -1.0]])
    # By hand: 2 (0.9 * 3 + 0.8 * 2) and 2 (0.9 - 0.8).
    np.testing.assert_allclose(bartlett_sum(covariances, 10), [8.6, 0.2])
