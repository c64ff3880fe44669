"""What is known of several parameters together: closed forms of the joint test."""

import numpy as np
import pytest
from scipy.stats import t

from split_cli.diagnosis.statement.result import ParameterEstimate
from split_cli.diagnosis.statement.sentences import sentence_for
from split_cli.diagnosis.verdict.findings import known_together
from split_cli.diagnosis.verdict.joint_region import JointRegion, apart_along, least_above, radius_95

NAMES = ("front", "rear")
AGAINST = np.array([[1.0, -0.98], [-0.98, 1.0]])  # what one axle has more, the other may have less


def region(centre, covariance=AGAINST, radius=2.5) -> JointRegion:
    return JointRegion(NAMES, np.array(centre, dtype=float), np.array(covariance), radius)


def test_one_parameter_has_the_radius_of_students_t():
    assert radius_95(1, 24.0) == pytest.approx(t.ppf(0.975, 24.0))


def test_two_parameters_lie_in_the_region_as_often_as_it_says():
    """A mean of two of 30 draws, its covariance estimated, 20,000 times: the definition of Hotelling's T."""
    rng = np.random.default_rng(3)
    draws = rng.multivariate_normal(np.zeros(2), AGAINST, (20_000, 30))
    means = draws.mean(axis=1)
    apart = draws - means[:, None]
    covariances = np.einsum("nij,nik->njk", apart, apart) / 29.0 / 30.0
    squared = np.einsum("nj,nj->n", means, np.linalg.solve(covariances, means[:, :, None])[:, :, 0])
    assert np.mean(squared < radius_95(2, 29.0) ** 2) == pytest.approx(0.95, abs=0.006)


@pytest.mark.parametrize("shift", [0.4, 0.55, 0.7, 1.2])
def test_one_region_is_the_wald_test(shift):
    """The sum is known to 0.2, each axle to 1: the direction that tells most is near the sum's."""
    one = region((shift, shift - 0.3))
    wald = np.sqrt(one.centre @ np.linalg.solve(one.covariance, one.centre))
    weights = apart_along([one])
    assert (weights is not None) == (wald > one.radius)
    if weights is not None:
        expected = np.linalg.solve(one.covariance, one.centre)
        assert weights / weights[0] == pytest.approx(expected / expected[0])
        assert one.along(weights)[0] > 0.0


def test_what_lies_between_explanations_may_be_true_as_well():
    """Of one explanation the sum is more, of another it is less: between them lies no effect at all."""
    more, less = region((1.0, 0.0)), region((-0.9, 0.1))
    assert apart_along([more]) is not None and apart_along([less]) is not None
    assert apart_along([more, less]) is None
    # Two that agree about the sum, and about neither part.
    assert apart_along([more, region((-2.0, 3.0))]) is not None


def test_sums_that_separate_do_so_for_every_region():
    """Against a search of all directions, for pairs of regions at random."""
    rng, angle = np.random.default_rng(5), np.linspace(0.0, 2.0 * np.pi, 3601)
    every = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    found = []
    for _ in range(60):
        shapes = rng.normal(0.0, 1.0, (2, 2, 2))
        several = [region(rng.normal(0.0, 3.0, 2), a @ a.T + 0.1 * np.eye(2), 2.0) for a in shapes]
        least = [min(one.along(weights)[0] for one in several) for weights in every]
        if abs(max(least)) < 0.02:
            continue  # too close for the steps that are taken
        weights = apart_along(several)
        found.append(weights is not None)
        assert found[-1] == (max(least) > 0.0)
        if weights is not None:
            assert min(one.along(weights)[0] for one in several) > 0.0
    assert 5 < sum(found) < 55


def test_the_larger_of_two_covariances_is_no_smaller_than_either():
    rng = np.random.default_rng(8)
    first, second = (a @ a.T + 0.1 * np.eye(3) for a in rng.normal(0.0, 1.0, (2, 3, 3)))
    both = least_above(first, second)
    for one in (first, second):
        assert np.linalg.eigvalsh(both - one).min() > -1e-9
    assert least_above(first, 0.5 * first) == pytest.approx(first)


def estimate(value: float, half: float) -> ParameterEstimate:
    return ParameterEstimate(value, half / 2.0, "N/(m/s)^2", (value - half, value + half))


def test_a_downforce_of_which_the_sum_is_known_has_a_name_that_says_so():
    alone = {"front": estimate(0.8, 2.5), "rear": estimate(0.4, 2.5)}
    found = known_together("aero_downforce", alone, (region((0.8, 0.4)),))
    assert found is not None and found.unit == "N/(m/s)^2" and max(found.weights.values()) == 1.0
    assert found.value == pytest.approx(0.8 * found.weights["front"] + 0.4 * found.weights["rear"])
    assert 0.0 < found.interval_95[0] < found.value < found.interval_95[1]
    said = sentence_for("aero_downforce", "", alone, (), None, found)
    assert "known together" in said and "front" in said and "N/(m/s)^2" in said
    # Half as much is none; and where one is known by itself, nothing needs to be said of both.
    assert known_together("aero_downforce", alone, (region((0.3, 0.15)),)) is None
    assert known_together("aero_downforce", {**alone, "front": estimate(0.8, 0.5)}, (region((0.8, 0.4)),)) is None
