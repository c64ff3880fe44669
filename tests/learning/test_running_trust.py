"""Running trust: against a slow reference that sums over all that was driven, and with planted truth."""

import numpy as np
import pytest
from scipy.optimize import minimize

from split_cli.learning.running_trust import MEMORY, SPAN, RunningTrust

H = 0.05
MOST = np.array([1.0, 0.8, 0.9])


def driving(count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return random stable transitions, noise, and what corrections add, of `count` intervals."""
    rng = np.random.default_rng(seed)
    transition = np.eye(3) + 0.1 * rng.standard_normal((count, 3, 3)) - 0.1 * np.eye(3)
    response = 0.02 * rng.standard_normal((count, 1, 3)) * np.eye(3) + 0.002 * rng.standard_normal((count, 3, 3))
    return transition, 0.01 * rng.standard_normal((count, 3)), response


def follow(most: np.ndarray, transition: np.ndarray, innovation: np.ndarray, response: np.ndarray) -> RunningTrust:
    """Return the running trust after all intervals."""
    trust = RunningTrust(most, H)
    for known in zip(transition, innovation, response, strict=True):
        trust.observe(*known)
    return trust


def reference(most: np.ndarray, transition: np.ndarray, innovation: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Return the share by definition: every error as a sum over all intervals before it, then SciPy's minimum.

    What falls short of `most` is shrunk by its variance over its square. Where no state's squares are larger with
    `most` than without any correction, it is `most`.
    """
    count, kept = len(innovation), 1.0 / (1.0 + H / SPAN)
    error, change = np.zeros((count, 3)), np.zeros((count, 3, 3))
    for end in range(count):
        carried = np.eye(3)
        for begin in range(end, -1, -1):
            share = kept ** (end - begin + 1) * carried
            error[end] += share @ innovation[begin]
            change[end] += share @ response[begin]
            carried = carried @ transition[begin]
    weight = np.exp(-H / MEMORY) ** np.arange(count)[::-1]
    size = weight @ error**2

    def left(share: np.ndarray) -> float:
        return float(np.sum(weight @ (error - change @ share) ** 2 / size))

    if (weight @ (error - change @ most) ** 2 <= size).all():
        return most

    bounds = [(0.0, m) for m in most]
    found: np.ndarray = minimize(left, 0.5 * most, bounds=bounds, options={"ftol": 1e-15, "gtol": 1e-10}).x
    squares = np.array([np.sum(weight @ change[:, :, j] ** 2 / size) for j in range(3)])
    variance = left(found) / 3.0 * (2.0 * SPAN / MEMORY) / squares
    kept: np.ndarray = found * np.maximum(1.0 - (1.0 - found / most) * variance / found**2, 0.0)
    return kept


def test_it_is_what_the_sums_over_the_whole_drive_give() -> None:
    transition, noise, response = driving(120)
    innovation = noise + response @ np.array([0.9, 0.5, 0.3])
    found = follow(MOST, transition, innovation, response).share
    # Three sweeps an interval follow the minimum closely, since it moves little from one to the next.
    assert found == pytest.approx(reference(MOST, transition, innovation, response), abs=0.01)


@pytest.mark.parametrize("planted", [(0.9, 0.5, 0.3), (0.2, 0.7, 0.0)])
def test_the_planted_share_is_found(planted: tuple[float, float, float]) -> None:
    transition, noise, response = driving(2000)
    found = follow(MOST, transition, 0.2 * noise + response @ np.array(planted), response).share
    assert found == pytest.approx(np.array(planted), abs=0.03)


def test_the_stored_trust_is_never_exceeded_and_a_wrong_correction_is_not_applied() -> None:
    transition, noise, response = driving(500)
    assert follow(MOST, transition, response @ (3.0 * MOST), response).share == pytest.approx(MOST)
    assert not follow(MOST, transition, response @ (-MOST), response).share.any()
    assert not follow(np.zeros(3), transition, noise, response).share.any()
    assert RunningTrust(MOST, H).share == pytest.approx(MOST), "nothing was driven that speaks against it"


def test_the_stored_trust_holds_until_a_state_is_worse_with_it_than_without() -> None:
    transition, _, response = driving(500)
    # Too large by 1/0.7 it leaves 3/7 of the errors; with one output's sign wrong it doubles those of a state.
    assert follow(MOST, transition, response @ (0.7 * MOST), response).share == pytest.approx(MOST)
    found = follow(MOST, transition, response @ (MOST * [1.0, 1.0, -1.0]), response).share
    assert found == pytest.approx(MOST * [1.0, 1.0, 0.0], abs=0.05)


def test_a_share_that_noise_alone_would_make_is_hardly_applied() -> None:
    """Corrections that have nothing to do with the errors: least squares would apply some of them all the time."""
    transition, noise, response = driving(4000)
    trust = RunningTrust(MOST, H)
    shares = [trust.observe(*known).copy() for known in zip(transition, noise, response, strict=True)]
    assert np.mean(shares[400:]) < 0.01


def test_a_correction_that_becomes_wrong_is_taken_back_within_the_memory() -> None:
    transition, _, response = driving(1200)
    sign = np.where(np.arange(1200) < 600, 1.0, -1.0)
    trust, shares = RunningTrust(MOST, H), []
    for known in zip(transition, sign[:, None] * (response @ MOST), response, strict=True):
        shares.append(trust.observe(*known).copy())
    assert shares[599] == pytest.approx(MOST, abs=1e-6)
    assert not shares[600 + round(MEMORY / H)].any()


def test_a_harm_that_adds_up_is_seen_where_one_step_gains() -> None:
    """A biased rate: it halves every label's error by chance of sign, and doubles what the errors add up to."""
    rng = np.random.default_rng(3)
    noise = np.where(np.arange(2000) % 2, 1.0, -1.0)[:, None] * np.array([1.0, 0.0, 0.0])
    right = 0.6 * noise + 0.01 * rng.standard_normal((2000, 3)) * [1.0, 0.0, 0.0]
    biased = right + np.array([0.3, 0.0, 0.0])
    response = biased[:, :, None] * np.array([1.0, 0.0, 0.0])
    assert np.sum((noise - biased) ** 2) < 0.5 * np.sum(noise**2)
    share = follow(np.ones(3), np.broadcast_to(np.eye(3), (2000, 3, 3)), noise, response).share
    assert share[0] < 0.05


def test_a_gap_and_a_number_that_is_none_begin_the_errors_anew() -> None:
    transition, noise, response = driving(60)
    trust = follow(MOST, transition, noise + response @ MOST, response)
    before = trust.share.copy()
    assert trust.observe(transition[0], np.full(3, np.nan), response[0]) == pytest.approx(before)
    fresh = RunningTrust(MOST, H)
    for known in zip(transition, noise + response @ MOST, response, strict=True):
        fresh.observe(*known)
    fresh.interrupt()
    following = transition[1], noise[1], response[1]
    assert trust.observe(*following) == pytest.approx(fresh.observe(*following))
