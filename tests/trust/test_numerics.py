"""Properties of labels and learning that hold for any driving: mirrors, copies, units."""

import itertools
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from split_cli.learning.cells import learn
from split_cli.learning.features import parse_features
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.region import Region
from split_cli.prediction import make_predictor
from tests.factories import make_drive, make_labels, make_training_set, road_car

SEEDS = st.integers(0, 2**31 - 1)
MIRRORED = ("vy", "r", "delta", "Y", "yaw", "ay")


def some_labels(seed: int, segments: int = 3) -> Labels:
    drive = make_drive(seed, segments=segments, seconds=2.0, vehicle=road_car())
    return compute_labels(drive, road_car(), parse_features("z2"), Region.of(road_car()), horizon=0.05)


def learned(labels: list[Labels], **over):
    base = make_training_set(points=20)
    return learn(labels, vehicle=road_car(), grid=base.grid, kernel=base.kernel, **over)


@settings(max_examples=3, deadline=None, derandomize=True)
@given(SEEDS)
def test_labels_of_mirrored_driving_are_mirrored(seed):
    drive = make_drive(seed, segments=2, seconds=2.0, vehicle=road_car())
    columns = {name: -v if name in MIRRORED else v for name, v in drive.columns.items()}
    z2, region = parse_features("z2"), Region.of(road_car())
    one = compute_labels(drive, road_car(), z2, region, horizon=0.05)
    other = compute_labels(replace(drive, columns=columns), road_car(), z2, region, horizon=0.05)
    assert np.array_equal(one.reason, other.reason)
    # Slip angles and lateral outputs turn their sign, torque and longitudinal output do not; to rounding.
    np.testing.assert_allclose(other.z, one.z * [-1, -1, 1], atol=1e-12)
    np.testing.assert_allclose(other.y, one.y * [1, -1, -1], atol=1e-9)


@settings(max_examples=3, deadline=None, derandomize=True)
@given(SEEDS)
def test_a_sample_that_comes_twice_is_kept_once(seed):
    labels = some_labels(seed)
    once, twice = learned([labels], capacity=200), learned([labels, labels], capacity=200)
    assert once.size == twice.size
    np.testing.assert_array_equal(once.z, twice.z)


@settings(max_examples=3, deadline=None, derandomize=True)
@given(SEEDS, st.sampled_from([1e-3, 0.3048, 3.6, 1e3]))
def test_a_change_of_unit_changes_answers_by_that_unit(seed, factor):
    base = make_training_set(seed=seed % 1000, points=120)
    k = base.kernel
    signal, noise = k.signal_variance * factor**2, k.noise_variance * factor**2
    scaled = replace(base, y=base.y * factor, kernel=Kernel(k.length_scales, signal, noise, origin=k.origin))
    queries = base.z[:30] + 0.003
    for name in ("full", "rbcm"):
        one, other = make_predictor(name, base).predict(queries), make_predictor(name, scaled).predict(queries)
        np.testing.assert_allclose(other.mean, one.mean * factor, rtol=1e-7, atol=1e-9 * factor)
        np.testing.assert_allclose(other.variance, one.variance * factor**2, rtol=1e-7)


@settings(max_examples=3, deadline=None, derandomize=True)
@given(SEEDS)
def test_the_order_of_logs_matters_only_where_both_have_been(seed):
    one, other = some_labels(seed), some_labels(seed + 1)
    first, second = learned([one, other], capacity=200), learned([other, one], capacity=200)
    # Cells that only one of the drives has visited hold the same points, whichever drive came first.
    shared = set(learned([one]).cell_numbers) & set(learned([other]).cell_numbers)
    assert {*first.cell_numbers} == {*second.cell_numbers} and len(shared) < first.cell_count

    def points(trained) -> np.ndarray:
        alone = ~np.isin(np.repeat(trained.cell_numbers, np.diff(trained.offsets)), list(shared))
        return np.concatenate([trained.z[alone], trained.y[alone], trained.gamma[alone, None]], axis=1)

    np.testing.assert_array_equal(points(first), points(second))
    # Of the same points the order does not matter to a predictor.
    rng = np.random.default_rng(seed)
    order = np.concatenate([a + rng.permutation(b - a) for a, b in itertools.pairwise(first.offsets)])
    fields = ("z", "y", "gamma", "t", "row", "source")
    shuffled = replace(first, **{name: getattr(first, name)[order] for name in fields})
    queries = first.z[::7] + 1e-3
    for name in ("full", "rbcm"):
        a, b = make_predictor(name, first).predict(queries), make_predictor(name, shuffled).predict(queries)
        np.testing.assert_allclose(a.mean, b.mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(a.variance, b.variance, rtol=1e-8)


@settings(max_examples=3, deadline=None, derandomize=True)
@given(SEEDS, st.sampled_from([2.0**-10, 0.25, 8.0, 2.0**10]))
def test_features_in_other_units_with_the_kernel_scaled_alike_learn_the_same(seed, factor):
    """A power of two changes no digit, so the same points are chosen and answers are the same to the bit."""
    base, labels = make_training_set(points=20), some_labels(seed)
    k, grid = base.kernel, base.grid
    scales = factor * np.asarray(k.length_scales)
    kernel = Kernel(scales, k.signal_variance, k.noise_variance, origin=k.origin)
    bounds = (tuple(factor * np.array(values)) for values in (grid.edges, grid.lower, grid.upper))
    known = learn([labels], vehicle=road_car(), grid=grid, kernel=k)
    scaled = learn([replace(labels, z=factor * labels.z)], vehicle=road_car(), grid=type(grid)(*bounds), kernel=kernel)
    np.testing.assert_array_equal(scaled.z, factor * known.z)
    np.testing.assert_array_equal(scaled.gamma, known.gamma)
    queries = known.z[::5] + 2.0**-9
    for name in ("full", "bcm", "rbcm"):
        one, other = make_predictor(name, known), make_predictor(name, scaled)
        np.testing.assert_array_equal(other.predict(factor * queries).mean, one.predict(queries).mean)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(SEEDS, st.sampled_from([1e-3, 1e-5, 1e-7, 1e-9]))
def test_a_cell_of_points_that_nearly_coincide_answers_as_a_solver_in_more_digits(seed, apart):
    """Their kernel matrix without noise is singular to rounding; the threshold keeps what can be told apart."""
    base, rng = make_training_set(points=20), np.random.default_rng(seed)
    edges = np.array(base.grid.edges)
    # The middle of a cell; half of the points are spread over it, the others nearly coincide.
    centre = (np.floor(base.z[0] / edges) + 0.5) * edges
    spread = np.where(np.arange(24)[:, None] % 2, apart, 0.4) * edges
    z, y = centre + spread * rng.uniform(-1.0, 1.0, (24, 3)), rng.normal(0.0, 0.3, (24, 3))
    trained = learned([make_labels(z, y, road_car(), base.features)], capacity=24, threshold=1e-7)
    assert trained.size >= 8 and trained.cell_count == 1 and (trained.gamma > 0.0).all()
    k = trained.kernel
    between = np.exp(-0.5 * _squares(trained.z, trained.z, k.length_scales))
    eye = np.eye(trained.size, dtype=np.longdouble)
    exact = 1.0 / np.diag(_solved(between, eye))
    np.testing.assert_allclose(trained.gamma, exact.astype(float), rtol=1e-4, atol=1e-13)
    queries = centre + 0.4 * edges * rng.uniform(-1.0, 1.0, (20, 3))
    across = np.exp(-0.5 * _squares(queries, trained.z, k.length_scales))
    for name in ("full", "bcm"):
        answer = make_predictor(name, trained).predict(queries)
        for output, (signal, noise) in enumerate(zip(k.signal_variance, k.noise_variance, strict=True)):
            covariance = signal * between + noise * eye
            mean = signal * across @ _solved(covariance, trained.y[:, output, None].astype(np.longdouble))
            np.testing.assert_allclose(answer.mean[:, output], mean[:, 0].astype(float), rtol=0, atol=1e-8)
        assert (answer.variance > 0.0).all()
        assert (answer.variance <= (k.signal_variance + k.noise_variance) * (1.0 + 1e-9)).all()


def _squares(a: np.ndarray, b: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return squared distances in units of the length scales, shape (A, B), in the longest floats there are."""
    difference = a[:, None].astype(np.longdouble) - b[None]
    return np.sum((difference / np.asarray(scales)) ** 2, axis=-1)


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return matrix^-1 right by Gauss's elimination with pivots, in the type of its arguments."""
    rows = np.concatenate([matrix, right], axis=1)
    count = len(matrix)
    for k in range(count):
        pivot = k + int(np.argmax(np.abs(rows[k:, k])))
        rows[[k, pivot]] = rows[[pivot, k]]
        rows[k] /= rows[k, k]
        others = np.arange(count) != k
        rows[others] -= rows[others, k, None] * rows[k]
    return rows[:, count:]
