"""The whitener against the dense covariance it stands for."""

import numpy as np

from split_cli.diagnosis.innovations.whitening import build_whitener, cost_by_disturbance

PERIOD = 0.01
NOISE = np.array([0.03, 0.02, 0.004])
DISTURBANCE = np.array([0.2, 0.1, 0.05])


def jacobians(count: int, rng: np.random.Generator) -> np.ndarray:
    """Stable, full matrices that change along the recording, as a car's do."""
    base = np.array([[-0.3, 0.4, 0.1], [-0.2, -6.0, -15.0], [0.05, 1.5, -7.0]])
    return base + 0.5 * rng.standard_normal((count, 3, 3))


def dense_covariance(A: np.ndarray) -> np.ndarray:
    """Covariance of z_k = w_k + (I - hA_{k+1}/2) n_{k+1} - (I + hA_k/2) n_k, written as one matrix."""
    n = len(A)
    mix = np.zeros((3 * (n - 1), 3 * n))
    for k in range(n - 1):
        rows = slice(3 * k, 3 * k + 3)
        mix[rows, 3 * k : 3 * k + 3] = -(np.eye(3) + 0.5 * PERIOD * A[k])
        mix[rows, 3 * k + 3 : 3 * k + 6] = np.eye(3) - 0.5 * PERIOD * A[k + 1]
    shaken = np.kron(np.eye(n - 1), np.diag(DISTURBANCE * PERIOD))
    return mix @ np.kron(np.eye(n), np.diag(NOISE**2)) @ mix.T + shaken


def test_costs_are_those_of_the_dense_gaussian():
    rng = np.random.default_rng(4)
    A = jacobians(40, rng)
    begins = np.zeros(39, dtype=bool)
    begins[0] = True
    whitener = build_whitener(A, PERIOD, NOISE, DISTURBANCE, begins, np.arange(39))
    z = rng.standard_normal((39, 3)) * 0.03
    covariance = dense_covariance(A)
    expected = z.ravel() @ np.linalg.solve(covariance, z.ravel()) + np.linalg.slogdet(covariance)[1]
    # Both are sums of some hundred terms of order one; the recursion is exact, not approximate.
    cost = cost_by_disturbance(z, A, PERIOD, NOISE, begins)(DISTURBANCE)
    np.testing.assert_allclose(cost, expected, rtol=1e-10)
    rows = whitener(z)
    np.testing.assert_allclose(np.sum(rows**2), z.ravel() @ np.linalg.solve(covariance, z.ravel()), rtol=1e-10)


def test_stretches_one_after_the_other_are_the_whole():
    rng = np.random.default_rng(8)
    begins = np.zeros(40, dtype=bool)
    begins[[0, 23]] = True
    group = np.repeat([0, 1, 2, 3, 4, 5, -1, 6, 7], [5, 5, 5, 5, 3, 4, 3, 5, 5])
    whitener = build_whitener(jacobians(41, rng), PERIOD, NOISE, DISTURBANCE, begins, group)
    z, estimate = rng.standard_normal((40, 3, 2)), np.zeros((3, 2))
    pieces = [one(z[at], estimate) for at, _, one in whitener.stretches(3)]
    assert [len(piece) for piece in pieces] == [3, 3, 2]
    np.testing.assert_array_equal(np.concatenate(pieces), whitener(z))


def test_a_gap_makes_two_recordings_of_one():
    rng = np.random.default_rng(5)
    A = jacobians(30, rng)
    z = rng.standard_normal((29, 3))
    begins = np.zeros(29, dtype=bool)
    begins[[0, 12]] = True
    whole = build_whitener(A, PERIOD, NOISE, DISTURBANCE, begins, np.arange(29))(z)
    again = np.zeros(17, dtype=bool)
    again[0] = True
    part = build_whitener(A[12:], PERIOD, NOISE, DISTURBANCE, again, np.arange(17))(z[12:])
    np.testing.assert_allclose(whole[12:], part, rtol=1e-12)


def test_rows_are_white_and_columns_are_whitened_as_the_target_is():
    rng = np.random.default_rng(6)
    n = 8000
    A = jacobians(n, rng)
    begins = np.zeros(n - 1, dtype=bool)
    begins[0] = True
    group = np.repeat(np.arange((n - 1) // 4), 4)
    group = np.concatenate([group, np.full(n - 1 - len(group), -1)])
    whitener = build_whitener(A, PERIOD, NOISE, DISTURBANCE, begins, group)
    noise = rng.standard_normal((n, 3)) * NOISE
    shaken = rng.standard_normal((n - 1, 3)) * np.sqrt(DISTURBANCE * PERIOD)
    onward = np.einsum("nij,nj->ni", np.eye(3) - 0.5 * PERIOD * A[1:], noise[1:])
    back = np.einsum("nij,nj->ni", np.eye(3) + 0.5 * PERIOD * A[:-1], noise[:-1])
    rows = whitener(shaken + onward - back)
    # 2,000 rows: a variance is known to 3 %, a correlation to 0.022; four deviations are allowed.
    np.testing.assert_allclose(rows.var(axis=0), 1.0, atol=0.13)
    for lag in (1, 2, 3):
        assert np.all(np.abs(np.mean(rows[lag:] * rows[:-lag], axis=0)) < 0.09)
    several = rng.standard_normal((n - 1, 3, 4))
    together = whitener(several)
    for k in range(4):
        np.testing.assert_array_equal(together[:, :, k], whitener(several[:, :, k]))
