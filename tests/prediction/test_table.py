"""The table against the process it is filled from, at its edges, and after updates."""

import numpy as np
import pytest

from split_cli.export.tables import lines_of
from split_cli.prediction.full import FullPredictor
from split_cli.prediction.online_process import SLOPE_GAIN
from split_cli.prediction.projected import ProjectedPredictor
from split_cli.prediction.spline import fit_spline, lattice_over
from split_cli.prediction.table import TablePredictor
from tests.factories import make_training_set, smooth_residual


@pytest.fixture(scope="module")
def trained():
    return make_training_set(3, 500, length_scale_cells=3.0, noise=0.1)


@pytest.fixture(scope="module")
def table(trained):
    return TablePredictor(trained)


def near(stored, count, seed, spread=0.5):
    """Queries whose coordinates are within `spread` length scales of a point's."""
    rng = np.random.default_rng(seed)
    away = rng.uniform(-spread, spread, (count, 3)) * stored.kernel.length_scales
    return stored.z[rng.integers(0, stored.size, count)] + away


@pytest.fixture(scope="module")
def process(trained):
    return ProjectedPredictor(trained, threshold=SLOPE_GAIN)


def test_what_it_is_filled_from_is_the_process_by_another_formula(trained, process):
    """The compiled process sums over its inverse, the filling over whitened correlations, many queries at once."""
    z = np.concatenate([near(trained, 300, 1), near(trained, 20, 1, spread=4.0)])
    mean, left = process.process.known().mean_and_open_share(z / trained.kernel.length_scales)
    expected = process.predict(z)
    deviation = np.sqrt(trained.kernel.signal_variance)
    np.testing.assert_allclose(mean / deviation, expected.mean / deviation, atol=1e-9)
    np.testing.assert_allclose(left, expected.variance / trained.kernel.signal_variance, atol=1e-9)


def test_a_spline_takes_the_values_at_its_nodes_and_converges_with_the_fourth_order():
    """A function that vanishes at the edge with its derivatives, so that nothing but the spacing matters."""

    def bump(z):
        return np.exp(-0.5 * np.square(z).sum(axis=1, keepdims=True)) * np.array([1.0, -2.0])

    rng = np.random.default_rng(3)
    z = rng.uniform(-2.0, 2.0, (400, 3))
    errors = []
    for spacing in (1.0, 0.5, 0.25):
        lattice = lattice_over(np.full(3, -7.0), np.full(3, 7.0), np.full(3, spacing))
        spline = fit_spline(lattice, bump(lattice.nodes()))
        np.testing.assert_allclose(spline.value(lattice.nodes()), bump(lattice.nodes()), atol=1e-10)
        errors.append(np.abs(spline.value(z) - bump(z)).max())
    # Sixteen times a halving in the limit; before it, higher orders of a Gaussian help.
    assert errors[0] > 10.0 * errors[1] > 140.0 * errors[2]


def test_slopes_are_derivatives_and_continuous_across_nodes():
    rng = np.random.default_rng(4)
    lattice = lattice_over(np.zeros(3), np.full(3, 5.0), np.array([1.0, 0.5, 0.7]))
    spline = fit_spline(lattice, rng.normal(size=(lattice.size, 2)))
    z = rng.uniform(-0.5, 5.5, (200, 3))
    z[:60] = np.round(z[:60] / lattice.spacing) * lattice.spacing  # on nodes, where the pieces meet
    slope = spline.value_and_slope(z)[1]
    for d in range(3):
        step = np.zeros(3)
        step[d] = 1e-5
        expected = (spline.value(z + step) - spline.value(z - step)) / 2e-5
        np.testing.assert_allclose(slope[:, :, d], expected, atol=2e-4)


def test_coefficients_of_16_bits_move_no_value_by_more_than_half_a_unit():
    rng = np.random.default_rng(7)
    lattice = lattice_over(np.zeros(3), np.full(3, 5.0), np.array([1.0, 0.5, 0.7]))
    exact = fit_spline(lattice, rng.normal(size=(lattice.size, 2)) * [1.0, 1e-3])
    rounded, z = exact.in_integers(), rng.uniform(-0.5, 5.5, (500, 3))
    assert rounded.coefficients.dtype == np.int16 and np.abs(rounded.coefficients).max() == 32767
    error = np.abs(rounded.value(z) - exact.value(z)).max(axis=0)
    assert (error <= 0.5 * rounded.unit).all() and (error >= 0.05 * rounded.unit).all()
    nothing = fit_spline(lattice, np.zeros((lattice.size, 2))).in_integers()
    assert not nothing.coefficients.any() and np.isfinite(nothing.unit).all()


def test_lines_without_their_zeros_are_the_whole_table(table):
    """Every run of four nodes that a query can read, found as the C finds it."""
    whole = table.spline.coefficients
    lines, (planes, rows, count) = lines_of(whole), whole.shape[:3]
    assert len(lines.nodes) < 0.7 * planes * rows * count
    for line in range(planes * rows):
        for first in range(count - 3):
            inside = max(-4, min(lines.length[line], first - lines.lowest[line]))
            start = lines.begin[line] + inside
            assert np.array_equal(lines.nodes[start : start + 4], whole[line // rows, line % rows][first : first + 4])


def test_the_table_equals_the_process_within_its_stated_bound(trained, process, table):
    assert table.error.met and table.error.queries == 1000
    z = near(trained, 600, 5)
    exact, got = process.predict(z), table.predict(z)
    deviation = np.sqrt(trained.kernel.signal_variance)
    error = np.abs(got.mean - exact.mean) / deviation
    # Other places than the thousand tried: the largest may be a little larger.
    assert error.max() <= 2.0 * table.bound and np.sqrt(np.mean(error**2)) <= 0.3 * table.bound
    assert np.abs(np.sqrt(got.variance) - np.sqrt(exact.variance)).max() <= 0.03 * deviation.max()


def test_it_knows_what_rejected_labels_tell():
    """Cells of one point reject most noisy labels: a table of all is nearer to the truth than the points are."""
    noisy = make_training_set(4, 3000, length_scale_cells=4.0, noise=0.6, capacity=1)
    z = near(noisy, 300, 8)
    wrong = [
        np.sqrt(np.mean(np.square(p(noisy).mean(z) - smooth_residual(z)))) for p in (TablePredictor, FullPredictor)
    ]
    assert noisy.size < 1200 and wrong[0] < 0.8 * wrong[1]


def test_a_tighter_bound_comes_nearer_to_the_process(trained, process, table):
    finer = TablePredictor(trained, bound=1e-3)
    z = near(trained, 300, 6)
    errors = [np.sqrt(np.mean((t.mean(z) - process.mean(z)) ** 2)) for t in (table, finer)]
    assert errors[1] < 0.4 * errors[0] and finer.error.mean < table.error.mean


def test_outside_the_box_it_is_the_prior_and_on_the_way_there_it_is_smooth(trained, table):
    deviation = np.sqrt(trained.kernel.signal_variance)
    line = np.linspace(0.0, 1.0, 4001)[:, None]
    start = trained.z[np.argmax(trained.z[:, 2])]
    path = start + line * np.array([0.0, 0.0, 6.0]) * trained.kernel.length_scales
    got = table.predict(path)
    assert np.array_equal(got.mean[-1], np.zeros(3))
    np.testing.assert_allclose(got.variance[-1], deviation**2, rtol=1e-15)
    # 0.0015 length scales a step: a cliff would show as a step of the size of the mean itself.
    assert np.abs(np.diff(got.mean, axis=0)).max() < 0.01 * deviation.max()
    slopes = table.jacobian(path)[:, :, 2] * trained.kernel.length_scales[2]
    assert np.abs(np.diff(slopes, axis=0)).max() < 0.05 * deviation.max()
    assert (got.variance <= trained.kernel.signal_variance).all() and (got.variance > 0.0).all()


def test_queries_that_are_not_finite(trained, table):
    z = np.array([[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0, -np.inf], [1e300, 0.0, 0.0]])
    got = table.predict(z)
    assert np.isnan(got.mean[0]).all() and np.isnan(got.variance[0]).all()
    assert np.array_equal(got.mean[1:], np.zeros((3, 3)))
    np.testing.assert_allclose(got.variance[1:], np.tile(trained.kernel.signal_variance, (3, 1)))
