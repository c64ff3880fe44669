"""The fit: gradient by finite differences, planted values found again, blocks of neighbouring cells."""

import numpy as np
import pytest
from scipy import stats

from split_cli.errors import SetError
from split_cli.learning._compiled import blocks_likelihood
from split_cli.learning.features import Z2, FeatureSet, parse_features
from split_cli.learning.hyperparameters import (
    default_kernel,
    fit_kernel,
    longest_scale,
    neighbour_blocks,
    scatter_variance,
)
from split_cli.learning.kernel import Kernel
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.region import Grid, Region, z2_grid
from tests.factories import kernel_to_yaml, make_labels, road_car, valid_features

UNBOUNDED = (-np.inf,) * 3, (np.inf,) * 3
GRID = Grid((0.02, 0.02, 0.1), *UNBOUNDED)


def draw(kernel: Kernel, z: np.ndarray, seed: int) -> np.ndarray:
    """Sample the process itself, with noise, at `z`."""
    rng = np.random.default_rng(seed)
    low = np.linalg.cholesky(kernel.correlation(z, z) + 1e-9 * np.eye(len(z)))
    return low @ rng.normal(size=(len(z), 3)) * np.sqrt(kernel.signal_variance) + rng.normal(
        size=(len(z), 3)
    ) * np.sqrt(kernel.noise_variance)


def likelihood(theta: np.ndarray, parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[float, np.ndarray]:
    """Return the negative log likelihood of blocks (z, y) and its gradient, as the fit asks for them."""
    z, y = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    offsets = np.concatenate([[0], np.cumsum([len(part[0]) for part in parts])])
    return blocks_likelihood(z, y, offsets, *np.split(np.exp(theta), [z.shape[1], z.shape[1] + 3]))


def test_gradient_equals_central_differences():
    rng = np.random.default_rng(0)
    parts = [(rng.normal(size=(n, 4)), rng.normal(size=(n, 3))) for n in (1, 12, 30)]
    theta = rng.normal(0.0, 0.4, 4 + 6)
    _, gradient = likelihood(theta, parts)
    step = 1e-5
    for i in range(len(theta)):
        shift = step * np.eye(len(theta))[i]
        difference = likelihood(theta + shift, parts)[0] - likelihood(theta - shift, parts)[0]
        # Truncation is of order step^2 = 1e-10, rounding 1e-16 * 100/1e-5 = 1e-9.
        assert gradient[i] == pytest.approx(difference / (2 * step), rel=1e-6, abs=1e-7)


def test_likelihood_is_the_density_of_the_process():
    rng = np.random.default_rng(1)
    parts = [(rng.normal(size=(n, 3)), rng.normal(size=(n, 3))) for n in (1, 2, 17, 60)]
    theta = rng.normal(0.0, 0.5, 9)
    kernel = Kernel(*np.split(np.exp(theta), 3))
    expected = 0.0
    for z, y in parts:
        for i, (signal, noise) in enumerate(zip(kernel.signal_variance, kernel.noise_variance, strict=True)):
            covariance = signal * kernel.correlation(z, z) + noise * np.eye(len(z))
            expected -= stats.multivariate_normal(cov=covariance).logpdf(y[:, i])
    # Covariances of condition below 1e3: thirteen digits.
    assert likelihood(theta, parts)[0] == pytest.approx(expected, rel=1e-12)


def test_planted_hyperparameters_are_found_again():
    car = road_car()
    z = valid_features(car, Region.of(car), 1500, seed=3, spread=0.15)
    truth = Kernel([0.05, 0.03, 0.25], [0.4, 0.9, 0.1], [0.01, 0.04, 0.02])
    fit = fit_kernel(z, draw(truth, z, seed=4), GRID, Kernel([0.04, 0.04, 0.2], np.ones(3), np.full(3, 0.1)))
    # 1,500 points over some 40 correlation volumes: a variance is known to about sqrt(2/40) = 22 %, a length scale
    # to about half of that, noise to sqrt(2/1500) = 4 %.
    np.testing.assert_allclose(fit.kernel.length_scales, truth.length_scales, rtol=0.25)
    np.testing.assert_allclose(fit.kernel.signal_variance, truth.signal_variance, rtol=0.7)
    np.testing.assert_allclose(fit.kernel.noise_variance, truth.noise_variance, rtol=0.15)
    assert fit.at_bound == ()
    assert fit.kernel.origin == "fitted"


def test_a_feature_that_does_nothing_ends_on_its_bound_and_is_named():
    rng = np.random.default_rng(5)
    grid = Grid((0.1, 0.1), (-np.inf,) * 2, (np.inf,) * 2)
    z = rng.uniform(-1.0, 1.0, (600, 2))
    y = np.sin(3.0 * z[:, :1]) * [1.0, 0.5, 2.0] + 0.05 * rng.normal(size=(600, 3))
    fit = fit_kernel(z, y, grid, default_kernel(grid, y))
    assert fit.at_bound == ("length scale 2",)
    assert fit.kernel.length_scales[1] == pytest.approx(10.0)  # a hundred edges


def test_length_scales_that_are_limited_end_there_without_complaint():
    """Over z2 a set's length scales are at most an edge: the same labels ask for 2.5, 1.5 and 2.5."""
    car = road_car()
    z = valid_features(car, Region.of(car), 1500, seed=3, spread=0.15)
    truth = Kernel([0.05, 0.03, 0.25], [0.4, 0.9, 0.1], [0.01, 0.04, 0.02])
    grid = z2_grid(car, Region.of(car))
    fit = fit_kernel(z, draw(truth, z, seed=4), grid, truth, longest=longest_scale(Z2, grid, z))
    np.testing.assert_allclose(fit.kernel.length_scales, grid.edges, rtol=1e-6)
    assert fit.at_bound == ()


def test_a_feature_outside_z2_is_believed_no_further_than_it_varied():
    """A correction that no speed changes in slow bends had a scale of 91 m/s, and acted on fast ones whole."""
    rng = np.random.default_rng(5)
    grid = Grid((0.1, 0.1), (-np.inf,) * 2, (np.inf,) * 2)
    z = rng.uniform(-1.0, 1.0, (600, 2))
    y = np.sin(3.0 * z[:, :1]) * [1.0, 0.5, 2.0] + 0.05 * rng.normal(size=(600, 3))
    fit = fit_kernel(z, y, grid, default_kernel(grid, y), longest=longest_scale(FeatureSet(("vx", "r")), grid, z))
    # Half the range of a uniform feature from -1 to 1 is 1; of 600 samples the outermost are left out.
    assert fit.kernel.length_scales[1] == pytest.approx(1.0, rel=0.02) and fit.at_bound == ()
    # The valid region limits slip angles and what follows them, wherever a car drives.
    bounds = longest_scale(parse_features("alpha_f,speed"), grid, z)
    assert bounds[0] == 100.0 and bounds[1] == pytest.approx(10.0, rel=0.02)


def test_blocks_hold_whole_neighbouring_cells():
    car = road_car()
    z = valid_features(car, Region.of(car), 5000, seed=6)
    index = z2_grid(car, Region.of(car)).index(z)[0]
    blocks = neighbour_blocks(index, 60)
    assert np.sort(np.concatenate(blocks)).tolist() == list(range(5000))
    assert max(len(rows) for rows in blocks) <= 60
    owner = np.empty(5000, dtype=int)
    for number, rows in enumerate(blocks):
        owner[rows] = number
    _, cell = np.unique(index, axis=0, return_inverse=True)
    cell = cell.ravel()
    for number in np.unique(cell):
        assert len(np.unique(owner[cell == number])) == 1
    # A block is a box of cells: boxes of two blocks never overlap.
    low = np.array([index[rows].min(axis=0) for rows in blocks])
    high = np.array([index[rows].max(axis=0) for rows in blocks])
    apart = ((low[:, None] > high[None]) | (high[:, None] < low[None])).any(axis=2)
    assert (apart | np.eye(len(blocks), dtype=bool)).all()


def test_a_crowded_cell_is_thinned_evenly():
    blocks = neighbour_blocks(np.zeros((1000, 3), dtype=np.int64), 60)
    assert len(blocks) == 1
    assert len(blocks[0]) == 60
    assert blocks[0][[0, -1]].tolist() == [0, 999]


def test_scatter_is_the_noise_of_slowly_changing_labels():
    rng = np.random.default_rng(7)
    t = np.linspace(0.0, 30.0, 5000)
    y = np.sin(t)[:, None] + rng.normal(size=(5000, 3)) * [0.1, 0.2, 0.4]
    labels = make_labels(np.zeros((5000, 1)), y, features=FeatureSet(("f",)))
    # A median of 5,000 is known to about 2.5 % of its deviation, the variance to 5 %.
    np.testing.assert_allclose(scatter_variance(labels), [0.01, 0.04, 0.16], rtol=0.15)


def test_too_few_labels_are_refused():
    with pytest.raises(SetError, match="12 valid labels are too few"):
        fit_kernel(np.zeros((12, 3)), np.zeros((12, 3)), GRID, Kernel(np.ones(3), np.ones(3), np.ones(3)))


def test_given_hyperparameters_round_trip_and_mistakes_are_named(tmp_path):
    features = FeatureSet(("alpha_f", "alpha_r"))
    kernel = Kernel([0.05, 0.04], [0.1, 0.2, 0.3], [0.01, 0.02, 0.03])
    path = tmp_path / "kernel.yaml"
    path.write_text(kernel_to_yaml(kernel, features))
    again = read_kernel(path, features)
    for name in ("length_scales", "signal_variance", "noise_variance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(kernel, name))
    text = path.read_text()
    for wrong, message in (
        (text.replace("alpha_r", "alpha_x"), "unknown key 'alpha_x' in length_scales.*alpha_r"),
        (text.replace("0.04", "-0.04"), "length_scales.alpha_r is -0.04"),
        (text.replace("noise_variance", "noise"), "unknown key 'noise'"),
        ("3", "holds no keys"),
        ("a: [", "is not YAML"),
    ):
        path.write_text(wrong)
        with pytest.raises(SetError, match=message):
            read_kernel(path, features)
    with pytest.raises(SetError, match="no such file"):
        read_kernel(tmp_path / "none.yaml", features)
