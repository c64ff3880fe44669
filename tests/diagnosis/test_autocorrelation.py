"""What wanders, against processes whose long-run variance is known."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from split_cli.diagnosis.remainder.autocorrelation import residual_autocorrelation
from split_cli.diagnosis.remainder.structure import Structure


def first_order(rows: int, rho: float, rng: np.random.Generator) -> np.ndarray:
    """Return a first-order process of unit variance, shape (rows,)."""
    return lfilter([1.0], [1.0, -rho], rng.standard_normal(rows) * np.sqrt(1.0 - rho**2))


def without_columns(rows: int) -> Structure:
    objective = SimpleNamespace(keep=(np.ones(rows, dtype=bool),))
    return Structure(objective, (np.zeros((3 * rows, 1)),), (), ("none",), np.eye(1))


def test_the_ratio_is_the_long_run_variance_of_a_first_order_process():
    rng = np.random.default_rng(4)
    rows, rho = 40_000, 0.8
    path = np.stack([first_order(rows, rho, rng) for _ in range(3)], axis=1)
    k = np.arange(1, 25)
    expected = 1.0 + 2.0 * np.sum((1.0 - k / 25) * rho**k)
    found = residual_autocorrelation(without_columns(rows), path.ravel())
    # Relative error of a Bartlett estimate: sqrt(4/3 * 25 / rows), 3 %; the worst of three is taken.
    assert found.ratio == pytest.approx(expected, rel=0.1)
    # What a row shares with the four next, on average: rho to rho^4.
    assert found.effect_to_noise == pytest.approx(np.sqrt(np.mean(rho ** np.arange(1, 5))), rel=0.1)
    assert found.p_value(1.0) < 1e-6
    assert found.p_value(expected) > 0.5


def test_white_rows_do_not_autocorrelate_more_often_than_they_may():
    rng = np.random.default_rng(5)
    structure = without_columns(2000)
    p_values = [residual_autocorrelation(structure, rng.standard_normal(6000)).p_value(1.0) for _ in range(200)]
    # Half as much again is allowed, so that 1 % is more than there should be.
    assert sum(p < 0.01 for p in p_values) <= 2


def test_rows_of_a_simulation_without_noise_count_as_noisy_ones():
    rng = np.random.default_rng(6)
    path = np.stack([first_order(5000, 0.9, rng) for _ in range(3)], axis=1)
    assert residual_autocorrelation(without_columns(5000), 0.05 * path.ravel()).ratio < 1.1
