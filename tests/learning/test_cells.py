"""The fast update against the printed one, and what must not change a trained set."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from split_cli.errors import NumericalRepairWarning, SetError
from split_cli.learning.cells import empty_set, extend, learn, recompute_gains
from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import Kernel, correlation
from split_cli.learning.labels import Reason
from split_cli.learning.region import Grid, Region
from split_cli.learning.training_set import TrainingSet
from tests.factories import make_labels, make_training_set, road_car, smooth_residual, valid_features
from tests.printed_learner import PrintedLearner

CAR = road_car()


def unbounded_grid(edges: tuple[float, ...]) -> Grid:
    return Grid(edges, (-np.inf,) * len(edges), (np.inf,) * len(edges))


def kernel_of(grid: Grid, cells: float) -> Kernel:
    return Kernel(cells * np.array(grid.edges), np.ones(3), np.full(3, 0.01))


def random_walk(count: int, dimension: int, seed: int) -> np.ndarray:
    """Features as a drive makes them: slowly moving, often back where they were, in a few cells."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(0.0, 0.15, (count, dimension))
    z = np.empty((count, dimension))
    now = np.zeros(dimension)
    for i, step in enumerate(steps):
        now = 0.95 * now + step
        z[i] = now
    return z


def same_sets(a: TrainingSet, b: TrainingSet) -> bool:
    names = ("cell_numbers", "offsets", "z", "y", "gamma", "t", "source", "row")
    alike = all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in names)
    return alike and all(one.tobytes() == other.tobytes() for one, other in zip(a.sums(), b.sums(), strict=True))


def plain_sums(
    z: np.ndarray, y: np.ndarray, scales: np.ndarray, capacity: int, threshold: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums of one cell as `TrainingSet` defines them, by dense solves at every label: the slow way."""
    points, information, absorbed = np.zeros((0, z.shape[1])), np.zeros((0, 0)), np.zeros((0, 3))
    for at, label in zip(z, y, strict=True):
        n, k = len(points), correlation(points, at[None], scales)[:, 0]
        kernel = correlation(points, points, scales)
        gains = 1.0 / np.diag(np.linalg.inv(kernel))
        bound = gains.min() if n == capacity else threshold
        shares = [np.linalg.solve(kernel[:i, :i], k[:i]) for i in range(1, n + 1)]
        spans = next((e for e in shares if 1.0 - k[: len(e)] @ e <= bound), None)
        if spans is not None:
            e = np.pad(spans, (0, n - len(spans)))
        elif n < capacity:
            points, e = np.vstack([points, at]), np.append(np.zeros(n), 1.0)
            information, absorbed = np.pad(information, (0, 1)), np.pad(absorbed, ((0, 1), (0, 0)))
        else:
            slot = int(np.argmin(gains))
            old, points[slot] = points[slot].copy(), at
            kernel, left = correlation(points, points, scales), correlation(points, old[None], scales)[:, 0]
            told, e = np.eye(n), np.eye(n)[slot]
            told[slot] = np.linalg.solve(kernel, left)
            information, absorbed = told.T @ information @ told, told.T @ absorbed
        information, absorbed = information + np.outer(e, e), absorbed + np.outer(e, label)
    return information, absorbed


def test_a_cell_absorbs_every_label_as_the_plain_sums_do():
    """Also those that it rejects, and what a point knew that was replaced."""
    rng = np.random.default_rng(4)
    z, y, grid = rng.uniform(0.0, 1.0, (300, 2)), rng.normal(size=(300, 3)), unbounded_grid((1.0, 1.0))
    kernel = Kernel(np.full(2, 0.6), np.ones(3), np.full(3, 0.01))
    features = FeatureSet(("vx", "vy"))
    labels = [make_labels(z, y, CAR, features=features)]
    trained = learn(labels, vehicle=CAR, grid=grid, kernel=kernel, capacity=6, threshold=1e-2)
    assert trained.sources[0].replacements >= 5 and trained.sources[0].rejected["gain"] > 200
    information, absorbed = plain_sums(z, y, kernel.length_scales, 6, 1e-2)
    np.testing.assert_allclose(trained.information.reshape(6, 6), information, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(trained.absorbed, absorbed, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("dimension", "capacity", "length_cells", "threshold", "forgetting"),
    [
        (3, 10, 2.0, 1e-3, None),
        (3, 10, 1.0, 1e-3, None),
        (5, 10, 2.0, 1e-3, None),
        (2, 4, 0.7, 1e-2, None),
        (3, 1, 1.0, 1e-3, None),
        (3, 6, 1.0, 1e-3, 40.0),
        (2, 10, 3.0, 1e-2, 20.0),
    ],
)
def test_keeps_the_points_of_the_printed_way(dimension, capacity, length_cells, threshold, forgetting):
    grid = unbounded_grid((0.4,) * dimension)
    kernel = kernel_of(grid, length_cells)
    z = random_walk(6000, dimension, seed=capacity + dimension)
    features = FeatureSet(tuple(f"f{i}" for i in range(dimension)))
    labels = make_labels(z, np.arange(18_000.0).reshape(-1, 3), CAR, features)
    trained = learn(
        [labels], vehicle=CAR, grid=grid, kernel=kernel, capacity=capacity, threshold=threshold, forgetting=forgetting
    )
    printed = PrintedLearner(kernel.length_scales, capacity, threshold, forgetting)
    numbers = grid.pack(grid.index(z)[0])
    for sample in range(len(z)):
        printed.offer(sample, int(numbers[sample]), z[sample], float(labels.t[sample]))

    assert printed.updates > 200
    source = trained.sources[0]
    assert source.insertions + source.replacements == printed.updates
    assert trained.cell_numbers.tolist() == sorted(printed.cells)
    for position, number in enumerate(trained.cell_numbers.tolist()):
        points = slice(trained.offsets[position], trained.offsets[position + 1])
        assert trained.row[points].tolist() == printed.cells[number].samples
        # Both invert matrices of a condition of about 1e5, as the threshold makes them: 1e-11, and a hundredfold.
        np.testing.assert_allclose(trained.gamma[points], printed.cells[number].gamma, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(trained.y, labels.y[trained.row])
    np.testing.assert_array_equal(trained.z, z[trained.row])


def test_gain_is_the_schur_complement_of_a_dense_inverse():
    trained = make_training_set(3, 4000, length_scale_cells=1.5)
    scales = trained.kernel.length_scales
    for first, last in zip(trained.offsets[:-1], trained.offsets[1:], strict=True):
        z = trained.z[first:last]
        expected = 1.0 / np.diag(np.linalg.inv(correlation(z, z, scales)))
        np.testing.assert_allclose(trained.gamma[first:last], expected, rtol=1e-8)
    assert trained.gamma.tobytes() == recompute_gains(trained).tobytes()


@pytest.mark.parametrize("batch", [1, 7, 400, 10_000])
@pytest.mark.parametrize("forgetting", [None, 15.0])
def test_batches_do_not_change_a_bit(batch, forgetting):
    z = valid_features(CAR, Region.of(CAR), 3000, seed=5, spread=0.1)
    labels = make_labels(z, smooth_residual(z), CAR)
    start = make_training_set(0, 50, vehicle=CAR)
    fresh = empty_set(CAR, start.features, start.region, start.grid, start.kernel, horizon=0.05, forgetting=forgetting)
    whole = extend(fresh, [labels])
    assert whole.sources[0].replacements > 20
    assert same_sets(extend(fresh, [labels], batch=batch), whole)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), cut=st.integers(1, 3), forgetting=st.sampled_from([None, 10.0]))
def test_appending_equals_one_run_bit_for_bit(seed, cut, forgetting):
    start = make_training_set(0, 50, vehicle=CAR)
    drives = []
    for number in range(4):
        z = valid_features(CAR, start.region, 300, seed=seed + number, spread=0.08)
        drives.append(make_labels(z, smooth_residual(z), CAR, name=f"drive{number}"))
    fresh = empty_set(CAR, start.features, start.region, start.grid, start.kernel, horizon=0.05, forgetting=forgetting)
    once = extend(fresh, drives)
    twice = extend(extend(fresh, drives[:cut]), drives[cut:])
    assert same_sets(once, twice)
    assert once.sources == twice.sources


def test_equal_gain_does_not_replace():
    # At capacity 1 every lone point has gain 1; a new sample reaches it only at infinite distance. Two points at
    # the same place leave a gain of exactly 0, which exceeds nothing.
    grid = unbounded_grid((1.0,))
    z = np.array([[0.5], [0.5], [0.5]])
    labels = make_labels(z, np.zeros((3, 3)), CAR, FeatureSet(("f",)))
    trained = learn([labels], vehicle=CAR, grid=grid, kernel=kernel_of(grid, 1.0), capacity=1)
    assert trained.row.tolist() == [0]
    # Far beyond the length scale gains are exactly 1 on both sides: a tie, and the old point stays.
    z = np.array([[0.1], [0.9]])
    labels = make_labels(z, np.zeros((2, 3)), CAR, FeatureSet(("f",)))
    trained = learn([labels], vehicle=CAR, grid=grid, kernel=kernel_of(grid, 1e-3), capacity=1)
    assert trained.row.tolist() == [0]


def test_cells_learn_independently_of_what_is_interleaved():
    """A cell's points depend on its own samples only."""
    start = make_training_set(0, 50, vehicle=CAR)
    z = valid_features(CAR, start.region, 2000, seed=8, spread=0.15)
    labels = make_labels(z, smooth_residual(z), CAR)
    fresh = empty_set(CAR, start.features, start.region, start.grid, start.kernel, horizon=0.05)
    whole = extend(fresh, [labels])
    numbers = start.grid.pack(start.grid.index(z)[0])
    busiest = np.unique(numbers, return_counts=True)
    for number in busiest[0][np.argsort(busiest[1])[-5:]]:
        alone = extend(fresh, [labels.take(numbers == number)])
        place = int(np.searchsorted(whole.cell_numbers, number))
        points = slice(whole.offsets[place], whole.offsets[place + 1])
        assert alone.row.tobytes() == whole.row[points].tobytes()
        assert alone.gamma.tobytes() == whole.gamma[points].tobytes()


def test_every_sample_is_accounted_for():
    z = valid_features(CAR, Region.of(CAR), 2000, seed=2, spread=0.1)
    z[::50, 2] = 1.2  # beyond the largest torque
    reason = np.zeros(2000, dtype=np.int8)
    reason[3:2000:40] = Reason.SPEED
    start = make_training_set(0, 50, vehicle=CAR)
    trained = learn(
        [make_labels(z, smooth_residual(z), CAR, reason=reason)], vehicle=CAR, grid=start.grid, kernel=start.kernel
    )
    source = trained.sources[0]
    assert source.rejected["speed"] == 50
    assert source.rejected["grid"] == 40
    assert source.accepted == 2000 - 90
    assert source.accepted == source.insertions + source.replacements + source.rejected["gain"]
    assert source.points == trained.size == source.insertions
    assert source.cells == trained.cell_count


def test_forgetting_lets_old_points_leave_when_the_car_changes():
    """The same roads driven before and after a change: without forgetting the old labels stay, with it they go."""
    region = Region.of(CAR)
    before = valid_features(CAR, region, 6000, seed=1, spread=0.05)
    after = valid_features(CAR, region, 6000, seed=2, spread=0.05)
    start = make_training_set(0, 50, vehicle=CAR, length_scale_cells=2.0)
    drives = [
        make_labels(before, np.full((6000, 3), -1.0), CAR, name="dry"),
        make_labels(after, np.full((6000, 3), 1.0), CAR, name="wet"),
    ]

    def old_share(forgetting: float | None) -> float:
        fresh = empty_set(CAR, start.features, region, start.grid, start.kernel, horizon=0.05, forgetting=forgetting)
        trained = extend(fresh, drives)
        busy = np.repeat(np.diff(trained.offsets) >= 3, np.diff(trained.offsets))
        return float((trained.y[busy, 0] < 0).mean())

    # Each drive takes 300 s. With a time constant of 60 s an old point's gain has fallen to 4e-6 of itself.
    assert old_share(None) > 0.5
    assert old_share(60.0) < 0.1


def test_repair_is_counted_and_warned_of():
    """Learning itself keeps K regular; a set made elsewhere may hold a point twice, and K is then singular."""
    grid = unbounded_grid((1.0,))
    kernel = kernel_of(grid, 0.3)
    features = FeatureSet(("f",))
    z = np.array([[0.1], [0.5], [0.9]])
    sound = learn([make_labels(z, np.zeros((3, 3)), CAR, features)], vehicle=CAR, grid=grid, kernel=kernel, capacity=4)
    doubled = replace(sound, z=np.array([[0.1], [0.1], [0.9]]))
    gains = recompute_gains(doubled)
    # Twice the same point with jitter e: its gain is about 2 e, at most 2e-10; the third is far from both.
    assert (gains[:2] < 3e-10).all()
    assert gains[2] == pytest.approx(1.0 - np.exp(-((0.8 / 0.3) ** 2)), rel=1e-6)
    more = make_labels(np.array([[0.5]]), np.zeros((1, 3)), CAR, features)
    with pytest.warns(NumericalRepairWarning, match="1 kernel matrices of cells needed jitter"):
        assert extend(doubled, [more]).size == 4
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        extend(sound, [more])


def test_refuses_what_does_not_belong():
    start = make_training_set(0, 50, vehicle=CAR)
    z = valid_features(CAR, start.region, 10, seed=0)
    other = make_labels(z, smooth_residual(z), road_car(mass=1600.0))
    with pytest.raises(SetError, match="another vehicle"):
        extend(start, [other])
    with pytest.raises(SetError, match="features"):
        extend(start, [make_labels(np.tile(z, 2)[:, :5], smooth_residual(z), CAR, "z1")])
    for bad in ({"capacity": 0}, {"threshold": 0.0}, {"threshold": 1.0}, {"forgetting": -1.0}):
        with pytest.raises(SetError, match="expected"):
            empty_set(CAR, start.features, start.region, start.grid, start.kernel, horizon=0.05, **bad)
