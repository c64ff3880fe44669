"""Noise: planted levels are recovered, and what is no noise is refused with a reason."""

import re

import numpy as np
import pytest

from split_cli.logs.assembling.noise import difference_noise, estimate_noise, sum_of_noise
from split_cli.logs.assembling.resample import make_grid, resample_together

T = np.arange(0.0, 100.0, 0.01)
MOTION = 10.0 + 3.0 * np.sin(0.5 * T) + 0.3 * np.sin(4.0 * T)


def whole(values: np.ndarray) -> list[tuple[int, int]]:
    return [(0, len(values))]


@pytest.mark.parametrize("sigma", [0.003, 0.05])
def test_planted_noise_is_recovered(sigma):
    values = MOTION + sigma * np.random.default_rng(2).standard_normal(len(T))
    # 10,000 third differences, correlated over four: the median is good to about 3 %.
    assert estimate_noise("vx", values, whole(values)).sigma == pytest.approx(sigma, rel=0.06)


@pytest.mark.parametrize("order", [3, 4, 5])
def test_the_binomial_factor_of_every_order(order):
    values = np.random.default_rng(0).standard_normal(200_000)
    assert difference_noise(values, whole(values), order) == pytest.approx(1.0, rel=0.02)


def test_noise_on_the_drive_clock_is_what_remains_after_the_filter():
    rng = np.random.default_rng(4)
    fine = np.arange(0.0, 200.0, 0.001)
    noise = 0.2 * rng.standard_normal(len(fine))
    grid, _ = make_grid([[(0.0, 199.9)]], 0.01)
    (result,) = resample_together(fine, [np.sin(fine) + noise], grid, gap=0.1)
    found = estimate_noise("r", np.sin(fine) + noise, whole(fine), gain=result.gain)
    remains = np.std((result.values - np.sin(grid.time))[50:-50])
    assert found.sigma_raw == pytest.approx(0.2, rel=0.03)
    assert found.sigma == pytest.approx(remains, rel=0.05)


def test_a_clean_simulation_has_no_noise_whatever_its_motion():
    estimate = estimate_noise("vx", MOTION, whole(MOTION))
    # sin(4 t) at 100 Hz: third differences read 0.04^3 x 0.3/sqrt(20) = 4e-6 of motion; the truth is 0.
    assert estimate.sigma is not None and estimate.sigma < 1e-7


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (np.full(500, 3.0), "constant"),
        (np.repeat(MOTION[::3], 3), "repeat the one before"),
        (np.round(MOTION / 0.1) * 0.1, "repeat the one before|steps of 0.1"),
        (MOTION[:20], "fewer than 50"),
    ],
)
def test_what_differences_cannot_tell_is_none_with_a_reason(values, reason):
    estimate = estimate_noise("vx", values, whole(values))
    assert estimate.sigma is None and estimate.sigma_raw is None
    assert re.search(reason, estimate.reason)


def test_coarse_steps_of_a_moving_signal_are_not_called_noise():
    values = np.round(20.0 * np.sin(3.0 * T) / 0.05) * 0.05
    estimate = estimate_noise("vx", values, whole(values))
    assert estimate.sigma is None and "steps of 0.05" in estimate.reason


def test_independent_sources_add_their_variances():
    a = estimate_noise("T", MOTION + 0.03 * np.random.default_rng(1).standard_normal(len(T)), whole(T))
    b = estimate_noise("T", MOTION + 0.04 * np.random.default_rng(2).standard_normal(len(T)), whole(T))
    assert sum_of_noise("T", [a, b]).sigma == pytest.approx(0.05, rel=0.06)
