"""Greedy selection of the most informative samples against the definition, step by step."""

import numpy as np

from split_cli.learning.kernel import correlation
from split_cli.prediction.factorization import most_informative


def brute_force(z, scales, count):
    """Evaluate gamma of every candidate anew at every step, by a general solve."""
    chosen: list[int] = []
    gains = []
    for _ in range(count):
        cross = correlation(z, z[chosen], scales)
        known = np.einsum("nk,kn->n", cross, np.linalg.solve(correlation(z[chosen], z[chosen], scales), cross.T))
        gamma = 1.0 - known if chosen else np.ones(len(z))
        gamma[chosen] = -np.inf
        chosen.append(int(np.argmax(gamma)))
        gains.append(gamma.max())
    return np.array(chosen), np.array(gains)


def test_pivoted_cholesky_is_the_exact_greedy_selection():
    random = np.random.default_rng(1)
    z = random.normal(size=(150, 3))
    scales = np.array([0.7, 1.0, 1.5])
    rows, gains = most_informative(z, scales, 40)
    want_rows, want_gains = brute_force(z, scales, 40)
    assert np.array_equal(rows, want_rows)
    # The smallest of these gains is about 0.1: both ways hold it to rounding.
    np.testing.assert_allclose(gains, want_gains, atol=1e-10)


def test_two_points_in_closed_form():
    """The first of equals comes first; then the point farthest from it, of gain 1 - c^2."""
    rows, gains = most_informative(np.array([[0.0], [0.5], [2.0]]), np.array([1.0]), 3)
    assert rows.tolist() == [0, 2, 1]
    np.testing.assert_allclose(gains[:2], [1.0, 1.0 - np.exp(-4.0)], rtol=1e-14)


def test_selection_ends_when_nothing_is_left_to_learn():
    rows, gains = most_informative(np.array([[0.0], [0.0], [9.0], [9.0]]), np.array([1.0]), 4)
    assert rows.tolist() == [0, 2] and (np.diff(gains) <= 0).all()
