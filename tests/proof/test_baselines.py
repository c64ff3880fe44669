"""The baselines against planted sparse truths and against the package they stand for."""

import numpy as np
import pytest

from split_cli.proof.baseline_regressors import Library, greedy_selection
from split_cli.proof.baselines import Regression, greedy_bic, sequentially_thresholded, stlsq
from tests.optional import needed


@pytest.fixture
def planted():
    rng = np.random.default_rng(0)
    matrix = rng.standard_normal((3000, 8))
    terms = ("mass", "wind", "wind", "aero_drag", "cg_shift", "steer_gain", "steer_lag", "yaw_inertia")
    target = matrix @ np.array([0.0, 0.4, 0.3, 0.0, 0.0, -0.5, 0.0, 0.0]) + rng.standard_normal(3000)
    return Regression(Library(matrix, terms), target)


def test_both_find_a_planted_pair(planted):
    # Errors of the weights are 1/sqrt(3000) = 0.018, a fifth of the threshold and a twentieth of what is planted.
    for method in (stlsq, greedy_bic):
        statement = method(planted)
        assert {f.term for f in statement.findings} == {"wind", "steer_gain"}
        assert not statement.unexplained


def test_both_say_match_where_there_is_noise_only(planted):
    rng = np.random.default_rng(1)
    noise = Regression(planted.library, rng.standard_normal(3000))
    # BIC accepts one of eight columns wrongly with a probability of 8 P(chi^2 > ln 3000) = 4 %.
    assert stlsq(noise).verdict == "match"
    assert greedy_bic(noise).verdict == "match"


def test_thresholding_is_that_of_pysindy(planted):
    sindy = needed("pysindy", in_tests=False)
    optimizer = sindy.STLSQ(threshold=0.1, alpha=0.05)
    optimizer.fit(planted.library.matrix, planted.target[:, None])
    ours = sequentially_thresholded(planted.library.matrix, planted.target, 0.1, 0.05)
    # pysindy refits without ridge at the end; over 3000 rows a ridge of 0.05 is worth 2e-5.
    np.testing.assert_allclose(ours, np.ravel(optimizer.coef_), atol=1e-4)


def test_greedy_selection_takes_terms_whole_and_tells_what_is_left(planted):
    noiseless = planted.library.matrix @ np.array([0.0, 0.4, 0.3, 0.0, 0.0, -0.4, 0.0, 0.0])
    (first, left_first), (second, left_second) = greedy_selection(planted.library, noiseless, 2)
    assert (first, second) == ("wind", "steer_gain")
    # Random columns are orthogonal to 1/sqrt(3000) = 0.018, twice of which enters a share of squares by each pair.
    assert left_first == pytest.approx(0.4**2 / (0.4**2 + 0.3**2 + 0.4**2), rel=0.1)
    assert left_second < 1e-20
