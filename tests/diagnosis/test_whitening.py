"""The whitener against the dense covariance it stands for."""

import numpy as np
import pytest

from split_cli.diagnosis.innovations.linearisation import Linearisation
from split_cli.diagnosis.innovations.noise_memory import NoiseModel, noise_model
from split_cli.diagnosis.innovations.whitening import build_whitener, cost_by_disturbance
from split_cli.vehicle.effects.recording import Recording

PERIOD = 0.01
NOISE = np.array([0.03, 0.02, 0.004])
DISTURBANCE = np.array([0.2, 0.1, 0.05])


def jacobians(count: int, rng: np.random.Generator) -> np.ndarray:
    """Stable, full matrices that change along the recording, as a car's do."""
    base = np.array([[-0.3, 0.4, 0.1], [-0.2, -6.0, -15.0], [0.05, 1.5, -7.0]])
    return base + 0.5 * rng.standard_normal((count, 3, 3))


def linearised(A: np.ndarray, rate: float = 0.0, over: np.ndarray | None = None) -> Linearisation:
    """Matrices of which the lower two rows are forces that build up at a rate [1/s]; 0 if they do at once."""
    rows, immediate = len(A), A.copy()
    immediate[:, 1:] *= 0.3
    rates = rate * (1.0 + 0.2 * np.sin(np.arange(rows))) if rate else None
    return Linearisation(A, immediate, rates, Recording.single(PERIOD, rows), over)


def model_of(A: np.ndarray, rate: float = 0.0) -> NoiseModel:
    return noise_model(linearised(A, rate))


def dense_covariance(linear: Linearisation) -> np.ndarray:
    """Covariance of z_k = w_k + n_{k+1} - n_k - P (h/2) (a_k + a_{k+1}), a the answer to the noise, as one matrix."""
    n = len(linear.jacobian)
    mix = np.empty((3 * (n - 1), 3 * n))
    for k in range(3 * n):
        noise = np.zeros(3 * n)
        noise[k] = 1.0
        noise = noise.reshape(n, 3)
        answer = linear.of_deviation(noise)
        halfway = 0.5 * PERIOD * (answer[1:] + answer[:-1])
        over = halfway if linear.to_motion is None else np.einsum("nij,nj->ni", linear.to_motion, halfway)
        mix[:, k] = (np.diff(noise, axis=0) - over).ravel()
    shaken = np.kron(np.eye(n - 1), np.diag(DISTURBANCE * PERIOD))
    return mix @ np.kron(np.eye(n), np.diag(NOISE**2)) @ mix.T + shaken


@pytest.mark.parametrize(("rate", "turns"), [(0.0, False), (0.0, True), (4.0, False), (40.0, False), (900.0, False)])
def test_costs_are_those_of_the_dense_gaussian(rate, turns):
    rng = np.random.default_rng(4)
    A = jacobians(40, rng)
    begins = np.zeros(39, dtype=bool)
    begins[0] = True
    # Strongly turning rates: of a deviation halfway up to a third is gone within the sample.
    over = np.eye(3) - 0.3 * rng.random((39, 3, 3)) if turns else None
    linear = linearised(A, rate, over)
    model = noise_model(linear)
    whitener = build_whitener(model, NOISE, DISTURBANCE, PERIOD, begins, np.arange(39))
    z = rng.standard_normal((39, 3)) * 0.03
    covariance = dense_covariance(linear)
    expected = z.ravel() @ np.linalg.solve(covariance, z.ravel()) + np.linalg.slogdet(covariance)[1]
    # Both are sums of some hundred terms of order one; the recursion is exact, not approximate.
    cost = cost_by_disturbance(z, model, NOISE, PERIOD, begins)(DISTURBANCE)
    np.testing.assert_allclose(cost, expected, rtol=1e-10)
    rows = whitener(z)
    np.testing.assert_allclose(np.sum(rows**2), z.ravel() @ np.linalg.solve(covariance, z.ravel()), rtol=1e-10)


def test_forces_that_build_up_within_a_sample_are_those_that_do_at_once():
    rng = np.random.default_rng(9)
    A, z = jacobians(40, rng), rng.standard_normal((39, 3)) * 0.03
    begins = np.arange(39) == 0
    at_once, quick = (
        build_whitener(model_of(A, rate), NOISE, DISTURBANCE, PERIOD, begins, np.arange(39))(z) for rate in (0.0, 1e7)
    )
    np.testing.assert_allclose(quick, at_once, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("rate", [0.0, 40.0])
def test_stretches_one_after_the_other_are_the_whole(rate):
    rng = np.random.default_rng(8)
    begins = np.zeros(40, dtype=bool)
    begins[[0, 23]] = True
    group = np.repeat([0, 1, 2, 3, 4, 5, -1, 6, 7], [5, 5, 5, 5, 3, 4, 3, 5, 5])
    whitener = build_whitener(model_of(jacobians(41, rng), rate), NOISE, DISTURBANCE, PERIOD, begins, group)
    z, estimate = rng.standard_normal((40, 3, 2)), np.zeros((6, 2))
    pieces = [one(z[at], estimate) for at, _, one in whitener.stretches(3)]
    assert [len(piece) for piece in pieces] == [3, 3, 2]
    np.testing.assert_array_equal(np.concatenate(pieces), whitener(z))


@pytest.mark.parametrize("rate", [0.0, 40.0])
def test_a_gap_makes_two_recordings_of_one(rate):
    rng = np.random.default_rng(5)
    A = jacobians(30, rng)
    z = rng.standard_normal((29, 3))
    begins = np.zeros(29, dtype=bool)
    begins[[0, 12]] = True
    model = model_of(A, rate)
    whole = build_whitener(model, NOISE, DISTURBANCE, PERIOD, begins, np.arange(29))(z)
    again = np.zeros(17, dtype=bool)
    again[0] = True
    part = build_whitener(model.at(np.arange(12, 29)), NOISE, DISTURBANCE, PERIOD, again, np.arange(17))(z[12:])
    np.testing.assert_allclose(whole[12:], part, rtol=1e-12)


@pytest.mark.parametrize("rate", [0.0, 40.0])
def test_rows_are_white_and_columns_are_whitened_as_the_target_is(rate):
    rng = np.random.default_rng(6)
    n = 8000
    A = jacobians(n, rng)
    begins = np.zeros(n - 1, dtype=bool)
    begins[0] = True
    group = np.repeat(np.arange((n - 1) // 4), 4)
    group = np.concatenate([group, np.full(n - 1 - len(group), -1)])
    whitener = build_whitener(model_of(A, rate), NOISE, DISTURBANCE, PERIOD, begins, group)
    noise = rng.standard_normal((n, 3)) * NOISE
    shaken = rng.standard_normal((n - 1, 3)) * np.sqrt(DISTURBANCE * PERIOD)
    answer = linearised(A, rate).of_deviation(noise)
    rows = whitener(shaken + np.diff(noise, axis=0) - 0.5 * PERIOD * (answer[1:] + answer[:-1]))
    # 2,000 rows: a variance is known to 3 %, a correlation to 0.022; four deviations are allowed.
    np.testing.assert_allclose(rows.var(axis=0), 1.0, atol=0.13)
    for lag in (1, 2, 3):
        assert np.all(np.abs(np.mean(rows[lag:] * rows[:-lag], axis=0)) < 0.09)
    several = rng.standard_normal((n - 1, 3, 4))
    together = whitener(several)
    for k in range(4):
        np.testing.assert_array_equal(together[:, :, k], whitener(several[:, :, k]))
