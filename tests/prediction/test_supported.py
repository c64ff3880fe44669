"""The labels of a cell count as far as they support a correction: against dense algebra, and planted truths."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.export.documents import read_npz
from split_cli.learning.cells import learn
from split_cli.learning.kernel import Kernel
from split_cli.learning.region import Region, z2_grid
from split_cli.learning.training_set import read_set, write_set
from split_cli.learning.trust import Trust
from split_cli.prediction import make_predictor
from split_cli.prediction.supported import believed, cell_shares, supported
from split_cli.workflows.export import export_set
from split_cli.workflows.verifying.verify import verify
from tests.factories import make_labels, make_training_set, road_car, write_forged_set

BY_CELL = Trust((0.5, 1.0, 0.8), "held-out", 12, (0.1, 0.0, 0.2), by_cell=True)


def posterior_of(z, y, kernel, at, output):
    """Return mean and variance of the dense process at `at`, written out."""
    signal, noise = kernel.signal_variance[output], kernel.noise_variance[output]
    among, across = (
        signal * np.exp(-0.5 * np.square((one[:, None] - z) / kernel.length_scales).sum(axis=-1)) for one in (z, at)
    )
    inverse = np.linalg.inv(among + noise * np.eye(len(z)))
    return across @ inverse @ y[:, output], signal - np.einsum("ij,jk,ik->i", across, inverse, across)


@pytest.fixture(scope="module")
def noisy():
    """Return a set of points alone, whose labels have noise of half their size."""
    s = make_training_set(5, 200, noise=0.2, length_scale_cells=0.4)
    return replace(s, information=None, absorbed=None)


def test_shares_are_those_of_the_dense_process(noisy):
    shares = cell_shares(noisy)
    assert shares.shape == (noisy.cell_count, 3)
    for output in range(3):
        mean, variance = posterior_of(noisy.z, noisy.y, noisy.kernel, noisy.z, output)
        for cell in range(noisy.cell_count):
            rows = slice(noisy.offsets[cell], noisy.offsets[cell + 1])
            left_open = variance[rows] / noisy.kernel.signal_variance[output]
            expected = max(0.0, 1.0 - (variance[rows] * (1.0 - left_open)).sum() / np.square(mean[rows]).sum())
            # Of two points with a gain below noise/signal the process leaves one out.
            assert shares[cell, output] == pytest.approx(expected, abs=0.02)
    assert (shares == 0.0).any() and (shares > 0.8).any()


def test_noise_alone_makes_the_square_that_counts_for_nothing():
    """One label of noise N and nothing to correct: m^2 has the mean v (1 - v/S), in closed form and drawn."""
    signal, noise = 0.3, 0.7
    left_open = noise / (signal + noise)
    drawn = signal / (signal + noise) * np.sqrt(noise) * np.random.default_rng(1).normal(size=200_000)
    by_chance = signal * left_open * (1.0 - left_open)
    assert by_chance == pytest.approx(signal**2 * noise / (signal + noise) ** 2)
    assert np.mean(np.square(drawn)) == pytest.approx(by_chance, rel=0.01)  # standard error sqrt(2/200,000)


def test_a_right_nominal_model_stays_nearly_as_it_is():
    """Labels of noise alone: the process takes some of it for a correction, of which next to nothing is left."""
    region, car = Region.of(road_car()), road_car()
    z = make_training_set(2, 600).z
    y = 0.3 * np.random.default_rng(9).normal(size=z.shape)
    grid = z2_grid(car, region)
    kernel = Kernel(2.0 * np.array(grid.edges), np.full(3, 0.04), np.full(3, 0.09))
    made = learn([make_labels(z, y, car)], vehicle=car, grid=grid, kernel=kernel, capacity=10)
    before, after = (make_predictor("full", s).mean(z) for s in (made, supported(made)))
    assert np.square(after).sum() < 0.15 * np.square(before).sum()


def test_exact_labels_lose_nothing():
    made = make_training_set(2, 600, noise=0.001)
    before, after = (make_predictor("full", s).mean(made.z) for s in (made, supported(made)))
    assert np.abs(after - before).max() < 0.03 * np.abs(before).max()


def test_a_cell_that_is_only_crossed_teaches_less_than_one_that_was_driven_in():
    """Two places far apart err by as much. One has 60 labels, the other 2 that went with a torque on its way."""
    car = road_car()
    grid, scales = z2_grid(car, Region.of(car)), np.array([0.02, 0.02, 0.1])
    driven, crossed = np.array([0.05, 0.03, 0.35]), np.array([0.01, 0.01, -0.35])
    rng = np.random.default_rng(4)
    z = np.concatenate([np.tile(driven, (60, 1)), np.tile(crossed, (2, 1))]) + 0.1 * scales * rng.normal(size=(62, 3))
    # Of v_x and v_y a label is mostly noise, as on the road car; of r it is not.
    kernel = Kernel(scales, np.full(3, 0.01), np.array([0.05, 0.05, 0.001]))
    made = learn([make_labels(z, np.full((62, 3), 0.1), car)], vehicle=car, grid=grid, kernel=kernel, capacity=10)
    before, after = (make_predictor("projected", s).mean(np.stack([driven, crossed])) for s in (made, supported(made)))
    assert (before[0] > 0.08).all() and (after[0] > 0.8 * before[0]).all()
    assert (before[1] > 0.02).all() and (np.abs(after[1, :2]) < 1e-12).all() and after[1, 2] > 0.9 * before[1, 2]


@pytest.mark.parametrize("name", ["bcm", "rbcm", "projected", "full"])
def test_every_predictor_has_the_mean_of_the_supported_labels_and_the_variance_of_all(noisy, name):
    z = noisy.z[::5] + 0.002
    trusted = make_predictor(name, replace(noisy, trust=BY_CELL))
    plain, less = make_predictor(name, noisy), make_predictor(name, supported(noisy))
    np.testing.assert_array_equal(trusted.mean(z), BY_CELL.array * less.mean(z))
    if name != "projected":  # which estimates from the labels how much of the variance its points leave open
        np.testing.assert_allclose(less.predict(z).variance, plain.predict(z).variance, rtol=1e-12)
    assert not trusted.training_set.trust.by_cell
    again = believed(trusted.training_set)
    np.testing.assert_array_equal(again.y, trusted.training_set.y)


def test_sums_over_all_labels_go_with_the_points():
    made = make_training_set(1, 900, noise=0.3)
    less, share = supported(made), np.repeat(cell_shares(made), np.diff(made.offsets), axis=0)
    np.testing.assert_array_equal(less.absorbed, share * made.absorbed)
    np.testing.assert_array_equal(less.information, made.information)


def test_an_empty_set_supports_nothing(noisy):
    nothing = {name: getattr(noisy, name)[:0] for name in ("cell_numbers", "z", "y", "gamma", "t", "source", "row")}
    empty = replace(noisy, offsets=noisy.offsets[:1], trust=BY_CELL, **nothing)
    assert believed(empty).size == 0 and not believed(empty).trust.by_cell


def test_the_file_says_it_and_a_file_without_the_key_is_as_before(noisy, tmp_path):
    path = tmp_path / "car.split"
    for trust in (BY_CELL, replace(BY_CELL, by_cell=False)):
        write_set(replace(noisy, trust=trust), path)
        assert read_set(path).trust == trust
        assert (b"by_cell" in path.read_bytes()) == trust.by_cell
    write_forged_set(replace(noisy, trust=BY_CELL), path, lambda described: described["trust"].update(by_cell=3))
    with pytest.raises(Exception, match="trust.by_cell is 3"):
        read_set(path)


@pytest.mark.parametrize("predictor", ["rbcm", "projected"])
def test_an_export_holds_the_supported_labels_and_agrees_with_its_set(tmp_path, predictor):
    made = replace(make_training_set(6, 150, noise=0.3), trust=BY_CELL)
    write_set(made, tmp_path / "car.split")
    export_set(tmp_path / "car.split", tmp_path, ["npz"], predictor=predictor, queries=100, insist=True)
    np.testing.assert_array_equal(read_npz(tmp_path / "car.npz").arrays["y"], supported(made).y)
    assert verify(tmp_path).passed
