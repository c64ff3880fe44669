"""Informative sets of each size, and the first lap of a drive."""

import numpy as np

from split_cli.learning.kernel import Kernel, correlation
from split_cli.prediction.full import FullPredictor
from split_cli.scoring.feature_sets import ALL, informative_sets
from tests.factories import make_labels, road_car, smooth_residual, valid_features

CAR = road_car()
KERNEL = Kernel(np.array([0.05, 0.05, 0.3]), np.array([0.3, 0.4, 0.5]), np.array([0.01, 0.01, 0.01]))


def candidates(count: int = 120):
    z = valid_features(CAR, make_labels(np.zeros((1, 3)), np.zeros((1, 3))).region, count, seed=3)
    reason = np.where(np.arange(count) % 5 == 0, 3, 0).astype(np.int8)
    return make_labels(z, smooth_residual(z), reason=reason)


def test_sets_hold_the_greedy_choice_among_accepted_samples():
    labels = candidates()
    accepted = np.flatnonzero(labels.accepted)
    z = labels.z[accepted]
    # The definition, anew at every step: 1 - k^T K^-1 k of each candidate given those chosen.
    chosen: list[int] = [0]
    for _ in range(11):
        cross = correlation(z, z[chosen], KERNEL.length_scales)
        inverse = np.linalg.inv(correlation(z[chosen], z[chosen], KERNEL.length_scales))
        gamma = 1.0 - np.einsum("nk,kl,nl->n", cross, inverse, cross)
        gamma[chosen] = -np.inf
        chosen.append(int(np.argmax(gamma)))
    sets = informative_sets(CAR, labels, KERNEL, (5, 12))
    assert [size for size, _ in sets] == [5, 12]
    for size, made in sets:
        np.testing.assert_array_equal(made.row, labels.row[accepted[chosen[:size]]])
        np.testing.assert_array_equal(made.y, labels.y[made.row])


def test_all_is_every_accepted_sample_and_more_than_there_is_gives_what_there_is():
    labels = candidates()
    (_, everything), (_, more) = informative_sets(CAR, labels, KERNEL, (ALL, 5000))
    np.testing.assert_array_equal(np.sort(everything.row), labels.row[labels.accepted])
    assert more.size <= everything.size


def test_the_process_on_a_set_is_the_dense_one_on_its_samples():
    labels = candidates()
    ((_, made),) = informative_sets(CAR, labels, KERNEL, (30,))
    query = candidates(20).z
    found = FullPredictor(made).predict(query)
    for output in range(3):
        prior, noise = KERNEL.signal_variance[output], KERNEL.noise_variance[output]
        matrix = prior * KERNEL.correlation(made.z, made.z) + noise * np.eye(made.size)
        cross = prior * KERNEL.correlation(query, made.z)
        np.testing.assert_allclose(found.mean[:, output], cross @ np.linalg.solve(matrix, made.y[:, output]), atol=1e-9)
        left = prior - np.einsum("nk,kn->n", cross, np.linalg.solve(matrix, cross.T))
        np.testing.assert_allclose(found.variance[:, output], left, atol=1e-9)
