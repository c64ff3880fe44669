"""The reference that every export is held to, against extended precision and the dense process."""

import numpy as np
import pytest

from split_cli.export.check import check_queries
from split_cli.export.reference import CommitteeReference
from split_cli.learning.kernel import correlation
from tests.export.export_support import take_cells
from tests.factories import make_training_set


def inverse_in_extended_precision(matrix: np.ndarray) -> np.ndarray:
    """Gauss-Jordan with row pivots in long double."""
    count = len(matrix)
    work = np.concatenate([matrix, np.eye(count, dtype=np.longdouble)], axis=1)
    for i in range(count):
        pivot = i + int(np.argmax(np.abs(work[i:, i])))
        work[[i, pivot]] = work[[pivot, i]]
        work[i] /= work[i, i]
        others = np.arange(count) != i
        work[others] -= work[others, i, None] * work[i]
    return work[:, count:]


def committee_in_extended_precision(training_set, z):
    """The BCM as the design prints it, in long double: precision 1/S0 + sum q/(S0 (S0 - q))."""
    kernel = training_set.kernel
    scales = kernel.length_scales.astype(np.longdouble)
    points, queries = training_set.z.astype(np.longdouble) / scales, z.astype(np.longdouble) / scales
    mean, variance = np.empty((len(z), 3)), np.empty((len(z), 3))
    for output in range(3):
        S0 = np.longdouble(kernel.signal_variance[output])
        noise = np.longdouble(kernel.noise_variance[output])
        precision = np.full(len(z), 1 / S0, dtype=np.longdouble)
        weighted = np.zeros(len(z), dtype=np.longdouble)
        for first, last in zip(training_set.offsets[:-1], training_set.offsets[1:], strict=True):
            p = points[first:last]
            K = S0 * np.exp(-0.5 * ((p[:, None] - p[None]) ** 2).sum(-1))
            k = S0 * np.exp(-0.5 * ((queries[:, None] - p[None]) ** 2).sum(-1))
            weights = k @ inverse_in_extended_precision(K + noise * np.eye(len(p), dtype=np.longdouble))
            q = (weights * k).sum(1)
            precision += q / (S0 * (S0 - q))
            weighted += (weights @ training_set.y[first:last, output].astype(np.longdouble)) / (S0 - q)
        mean[:, output], variance[:, output] = weighted / precision, 1 / precision
    return mean, variance


@pytest.mark.parametrize("noise", [0.05, 0.003])
def test_the_reference_equals_extended_precision(noise):
    # Tolerance: rounding of 1e-16 grows by 1/sqrt(rho), here at most 100, and by the number of cells that share.
    training_set = take_cells(make_training_set(seed=8, points=3000, noise=noise), 60)
    z = check_queries(training_set, 400)
    z = z[(np.abs(z) < 10.0).all(axis=1)]
    reference = CommitteeReference(training_set)
    found = reference.predict(z)
    mean, variance = committee_in_extended_precision(training_set, z)
    assert np.abs((found.mean - mean) / reference.deviation).max() < 3e-13
    assert np.abs((found.variance - variance) / reference.deviation**2).max() < 3e-14


def test_one_cell_is_the_exact_process():
    # With a single cell there is nothing to combine: BCM is the Gaussian process itself.
    training_set = make_training_set(seed=2, points=3000)
    fullest = int(np.argmax(np.diff(training_set.offsets)))
    first, last = training_set.offsets[fullest : fullest + 2]
    single = take_cells(training_set, 1)
    single = type(single)(
        **{
            **{name: getattr(single, name) for name in single.__dataclass_fields__},
            "z": training_set.z[first:last],
            "y": training_set.y[first:last],
            "offsets": np.array([0, last - first]),
            "cell_numbers": training_set.cell_numbers[fullest : fullest + 1],
        }
    )
    z = single.z[:3] + 0.01
    found = CommitteeReference(single).predict(z)
    kernel = single.kernel
    for output in range(3):
        S0 = kernel.signal_variance[output]
        K = S0 * correlation(single.z, single.z, kernel.length_scales)
        k = S0 * correlation(z, single.z, kernel.length_scales)
        solved = np.linalg.solve(K + kernel.noise_variance[output] * np.eye(len(K)), k.T)
        assert np.allclose(found.mean[:, output], solved.T @ single.y[:, output], rtol=1e-9)
        assert np.allclose(found.variance[:, output], S0 - (k.T * solved).sum(0), rtol=1e-9)


def test_queries_hold_points_borders_and_places_far_away(small_set):
    z = check_queries(small_set, 2000)
    edges = np.array(small_set.grid.edges)
    on_points = (z[:, None] == small_set.z[None]).all(-1).any(1)
    steps = z / edges
    on_borders = (np.abs(steps - np.round(steps)) < 1e-12).any(axis=1)
    exactly = (np.round(steps) * edges == z).all(axis=1)
    on_limits = (z == small_set.grid.upper) | (z == small_set.grid.lower)
    assert on_points.sum() >= 200
    assert exactly.sum() >= 5 and (on_borders & ~exactly).sum() >= 200
    assert on_limits.any(axis=1).sum() >= 200
    assert np.abs(z).max() >= 1e299
    assert np.array_equal(z, check_queries(small_set, 2000))
