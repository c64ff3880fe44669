"""Every predictor against the dense Gaussian process, in the limits where they must agree, and its derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import NumericalRepairWarning, SetError, SplitError
from split_cli.learning.cells import learn
from split_cli.learning.kernel import Kernel
from split_cli.learning.region import Grid
from split_cli.prediction import PREDICTORS, make_predictor
from split_cli.prediction.bcm import BcmPredictor
from split_cli.prediction.factorization import cholesky
from split_cli.prediction.fitc import FitcPredictor
from split_cli.prediction.full import FullPredictor
from split_cli.prediction.online_process import OnlineProcess
from tests.factories import make_labels, road_car


def dense(kernel, points, labels, z):
    """Yield an output's prior, and its posterior by one general solve: the definition, written down."""
    for o in range(3):
        s0, noise = kernel.signal_variance[o], kernel.noise_variance[o]
        gram = s0 * kernel.correlation(points, points) + noise * np.eye(len(points))
        cross = s0 * kernel.correlation(points, z)
        variance = s0 - np.einsum("pn,pn->n", cross, np.linalg.solve(gram, cross))
        yield s0, noise, cross.T @ np.linalg.solve(gram, labels[:, o]), variance


def textbook_posterior(stored, z):
    answers = [(mean, variance) for *_, mean, variance in dense(stored.kernel, stored.z, stored.y, z)]
    return tuple(np.stack(answers, axis=-1))


def textbook_committee(stored, z, *, noisy_experts=False, robust=False):
    """Tresp's formula as printed (mean by Sigma): experts one by one, priors subtracted at the end.

    With `robust` that of Deisenroth and Ng, where experts count by what they have learned.
    """
    mean, precision = np.zeros((len(z), 3)), np.zeros((len(z), 3))
    for i in range(stored.cell_count):
        rows = slice(stored.offsets[i], stored.offsets[i + 1])
        for o, (s0, noise, expert, variance) in enumerate(dense(stored.kernel, stored.z[rows], stored.y[rows], z)):
            variance = variance + noise if noisy_experts else variance
            weight = 0.5 * np.log(s0 / variance) if robust else 1.0
            mean[:, o] += weight * expert / variance
            precision[:, o] += weight * (1.0 / variance - 1.0 / s0)
    precision += 1.0 / stored.kernel.signal_variance
    return mean / precision, 1.0 / precision


def alike(found, expected, **tolerance):
    """Demand the same mean, to 1e-9 if nothing else is said, and the same variance."""
    pairs = [one if isinstance(one, tuple) else (one.mean, one.variance) for one in (found, expected)]
    np.testing.assert_allclose(pairs[0][0], pairs[1][0], rtol=0.0, atol=tolerance.get("atol", 1e-9))
    np.testing.assert_allclose(pairs[0][1], pairs[1][1], **(tolerance or {"atol": 1e-9}))


def query_points(stored, count, seed, spread=1.3):
    random = np.random.default_rng(seed)
    low, high = stored.z.min(axis=0), stored.z.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    return middle + spread * half * random.uniform(-1, 1, (count, stored.z.shape[1]))


LEARNED = {}  # a table takes seconds to fill; a predictor keeps its set, so that no other gets its id


def made(name, stored, z):
    # What weights leaves out jumps at the reach, by as much as its bound; a difference divides that by the step.
    if (name, id(stored)) not in LEARNED:
        bound = {"bound": 1e-10} if name == "weights" else {}
        LEARNED[name, id(stored)] = make_predictor(name, stored, **bound)
    predictor = LEARNED[name, id(stored)]
    return predictor.at(z[:10]) if predictor.needs_context else predictor


def test_full_is_the_textbook_posterior(driven_set):
    z = query_points(driven_set, 200, 1)
    # The gram matrix has a condition of about 1e4 to 1e5 here, so two solvers agree to about 1e-11.
    alike(FullPredictor(driven_set).predict(z), textbook_posterior(driven_set, z))


@pytest.mark.parametrize("name", ["bcm", "rbcm"])
def test_a_committee_is_the_printed_one_without_its_cancellation(driven_set, name):
    z = query_points(driven_set, 200, 2)
    # The printed form subtracts 299 priors, which costs it two to three digits of sixteen.
    expected = textbook_committee(driven_set, z, robust=name == "rbcm")
    alike(make_predictor(name, driven_set).predict(z), expected, rtol=1e-9)


def test_bcm_of_one_cell_is_the_full_posterior(make_set):
    random = np.random.default_rng(3)
    kernel = Kernel(np.array([0.02, 0.03, 0.2]), np.array([0.5, 1.0, 2.0]), np.array([0.05, 0.01, 0.1]))
    stored = make_set(random.uniform(-0.03, 0.03, (10, 3)) * [1, 1, 5], random.normal(size=(10, 3)), kernel)
    z = query_points(stored, 300, 4, spread=2.0)
    alike(BcmPredictor(stored).predict(z), FullPredictor(stored).predict(z), atol=1e-12)


def test_bcm_of_cells_far_apart_is_the_full_posterior(make_set):
    """Cells 12 length scales apart correlate by e^-72 = 5e-32: the committee's assumption then holds exactly."""
    random = np.random.default_rng(5)
    kernel = Kernel(np.full(3, 0.02), np.array([0.5, 1.0, 2.0]), np.array([0.05, 0.01, 0.1]))
    cell = np.repeat(np.arange(8), 6)
    corners = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)])
    z = corners[cell] * 0.3 + random.uniform(-0.03, 0.03, (48, 3))
    stored = make_set(z, random.normal(size=(48, 3)), kernel, cell)
    query = stored.z + random.normal(0.0, 0.01, stored.z.shape)
    alike(BcmPredictor(stored).predict(query), FullPredictor(stored).predict(query), atol=1e-12)


def test_fitc_with_the_training_inputs_as_pseudo_inputs_is_the_full_posterior(make_set):
    """Points a length scale apart, so that C_uu is well conditioned and no pseudo-input is redundant."""
    random = np.random.default_rng(6)
    lattice = np.stack(np.meshgrid(np.arange(3), np.arange(3), np.arange(2), indexing="ij"), -1).reshape(-1, 3)
    kernel = Kernel(np.array([0.02, 0.02, 0.1]), np.array([0.5, 1.0, 2.0]), np.array([0.05, 0.01, 0.1]))
    z = lattice * kernel.length_scales * 1.2 + random.uniform(-0.002, 0.002, (18, 3))
    stored = make_set(z, random.normal(size=(18, 3)), kernel, np.arange(18) // 5)
    query = query_points(stored, 200, 7)
    alike(FitcPredictor(stored).at(stored.z).predict(query), FullPredictor(stored).predict(query), atol=1e-10)


def test_fitc_drops_repeated_pseudo_inputs_without_a_change(driven_set):
    context = query_points(driven_set, 6, 8, spread=0.4)
    z = query_points(driven_set, 50, 9)
    once = FitcPredictor(driven_set).at(context).predict(z)
    twice = FitcPredictor(driven_set).at(np.repeat(context, 3, axis=0)).predict(z)
    alike(twice, once, atol=1e-12)


def test_fitc_without_a_situation_says_what_to_do(driven_set):
    with pytest.raises(SplitError, match="at"):
        FitcPredictor(driven_set).predict(driven_set.z[:1])


@pytest.mark.parametrize("name", sorted(PREDICTORS))
def test_far_away_every_predictor_returns_to_the_prior(name, driven_set):
    """Forty length scales off, correlations are e^-800 = 0 in floating point."""
    near = query_points(driven_set, 10, 10)
    far = driven_set.z[:5] + 40 * driven_set.kernel.length_scales + 3.0
    predictor = made(name, driven_set, near)
    got = predictor.predict(far)
    assert np.array_equal(got.mean, np.zeros((5, 3)))
    np.testing.assert_allclose(got.variance, np.tile(driven_set.kernel.signal_variance, (5, 1)), rtol=1e-15)
    assert np.array_equal(predictor.jacobian(far), np.zeros((5, 3, 3)))


@pytest.mark.parametrize("name", sorted(PREDICTORS))
def test_jacobian_is_the_derivative_of_the_mean(name, driven_set):
    """Central differences of a thousandth of a length scale: truncation is (1e-3)^2/6 times a third derivative
    of order mean/l^3, so a few 1e-7 of the largest slope; a wrong factor would show at order one."""
    z = query_points(driven_set, 40, 11, spread=0.7)
    predictor = made(name, driven_set, z)
    jacobian = predictor.jacobian(z)
    for feature, scale in enumerate(driven_set.kernel.length_scales):
        step = np.zeros(3)
        step[feature] = 1e-3 * scale
        slope = (predictor.mean(z + step) - predictor.mean(z - step)) / (2 * step[feature])
        smooth = np.ones(len(z), dtype=bool)
        if name == "local":  # jumps where the set of neighbours changes: some steps cross such a place
            smooth = (np.abs(jacobian[:, :, feature] - slope) < 1e-5 * np.abs(jacobian).max()).all(axis=1)
            assert smooth.mean() > 0.8
        np.testing.assert_allclose(jacobian[smooth][:, :, feature], slope[smooth], atol=1e-5 * np.abs(jacobian).max())


@pytest.mark.parametrize("name", sorted(PREDICTORS))
def test_a_batch_is_its_queries_one_by_one(name, driven_set):
    z = query_points(driven_set, 30, 12)
    predictor = made(name, driven_set, z)
    batch, slopes, means = predictor.predict(z), predictor.jacobian(z), predictor.mean(z)
    for i in range(len(z)):
        one = predictor.predict(z[i : i + 1])
        # Matrix products of other shapes may add in another order; the numba loops may not.
        tolerance = 0.0 if name in ("bcm", "rbcm", "table") else 1e-11
        np.testing.assert_allclose(one.mean[0], batch.mean[i], rtol=0, atol=tolerance)
        np.testing.assert_allclose(one.variance[0], batch.variance[i], rtol=0, atol=tolerance)
        one_slope = predictor.jacobian(z[i : i + 1])[0]
        np.testing.assert_allclose(one_slope, slopes[i], rtol=0, atol=1e-9)
    np.testing.assert_allclose(means, batch.mean, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", sorted(PREDICTORS))
def test_an_empty_set_is_the_prior(name, make_set):
    kernel = Kernel(np.full(3, 0.1), np.array([1.0, 2.0, 3.0]), np.ones(3))
    stored = make_set(np.zeros((0, 3)), np.zeros((0, 3)), kernel)
    z = np.zeros((4, 3)) + np.arange(4)[:, None]
    got = made(name, stored, z).predict(z)
    assert np.array_equal(got.mean, np.zeros((4, 3)))
    np.testing.assert_allclose(got.variance, np.tile([1.0, 2.0, 3.0], (4, 1)), rtol=1e-15)


def test_noisy_experts_against_a_noise_free_prior_turn_negative_and_ours_do_not(driven_set):
    """Each far expert then has precision 1/(S0 + s^2) < 1/S0; 300 of them take away more than the prior has."""
    z = query_points(driven_set, 200, 13)
    _, naive = textbook_committee(driven_set, z, noisy_experts=True)
    assert (naive < 0).any()
    ours = BcmPredictor(driven_set).predict(z).variance
    assert (ours > 0).all() and (ours <= driven_set.kernel.signal_variance).all()


def test_bcm_keeps_a_positive_variance_where_the_printed_form_loses_all_digits(make_set):
    """Signal to noise 1e8 and ten thousand equal cells: rounding of the subtracted priors is visible, ours not."""
    random = np.random.default_rng(14)
    kernel = Kernel(np.full(3, 0.02), np.ones(3), np.full(3, 1e-8))
    z = np.repeat(random.uniform(-0.1, 0.1, (60, 3)), 5, axis=0) + random.normal(0, 1e-4, (300, 3))
    stored = make_set(z, random.normal(size=(300, 3)), kernel, np.repeat(np.arange(60), 5))
    got = BcmPredictor(stored).predict(stored.z)
    # Five points at most cannot bring the variance below rho/(5 + rho) an expert; 60 experts share at most that.
    assert (got.variance >= 1e-8 / 6 / 60).all()
    assert np.isfinite(got.mean).all()


@pytest.mark.parametrize("neglect", [1e-3, 1e-6, 1e-9])
def test_what_bcm_neglects_stays_within_the_stated_bound(neglect, make_set):
    """Length scales of half a cell, so that most cells are beyond reach."""
    random = np.random.default_rng(15)
    edges = np.array([0.02, 0.02, 0.1])
    index = random.integers(-8, 8, (400, 3))
    cell = np.repeat(np.arange(400), 4)
    kernel = Kernel(0.5 * edges, np.array([0.3, 0.8, 1.5]), np.array([0.001, 0.002, 0.006]))
    z = (index[cell] + random.uniform(0, 1, (1600, 3))) * edges
    stored = make_set(z, random.normal(size=(1600, 3)), kernel, cell)
    query = query_points(stored, 500, 16)
    exact, quick = BcmPredictor(stored, neglect=0.0), BcmPredictor(stored, neglect=neglect)
    a, b = exact.predict(query), quick.predict(query)
    deviation = np.sqrt(kernel.signal_variance)
    assert (np.abs(a.variance - b.variance) <= neglect * kernel.signal_variance).all()
    assert (np.abs(a.mean - b.mean) <= neglect * (deviation + np.abs(a.mean))).all()
    assert not np.array_equal(a.mean, b.mean), "nothing was neglected, the test proves nothing"


def test_features_of_another_width_work_and_a_wrong_width_is_refused(make_set):
    random = np.random.default_rng(18)
    kernel = Kernel(np.full(5, 0.7), np.ones(3), np.full(3, 0.05))
    stored = make_set(random.normal(size=(30, 5)), random.normal(size=(30, 3)), kernel)
    z = random.normal(size=(20, 5))
    np.testing.assert_allclose(BcmPredictor(stored).mean(z), FullPredictor(stored).mean(z), atol=1e-11)
    with pytest.raises(SetError, match="three features"):
        make_predictor("table", stored)
    for name in PREDICTORS.keys() - {"table"}:
        with pytest.raises(ValueError, match="shape"):
            make_predictor(name, stored).at(z).predict(z[:, :3])


def test_an_unknown_predictor_names_the_nearest(driven_set):
    with pytest.raises(SplitError, match="bcm"):
        make_predictor("bmc", driven_set)


def test_repair_of_a_singular_matrix_is_loud_and_bounded():
    with pytest.warns(NumericalRepairWarning, match="singular"):
        factor = cholesky(np.ones((3, 3)) - 1e-13 * np.eye(3), 0.0)
    np.testing.assert_allclose(factor @ factor.T, np.ones((3, 3)), atol=1e-6)
    with pytest.warns(NumericalRepairWarning), pytest.raises(SetError, match="noise"):
        cholesky(np.ones((3, 3)) - 1e-3 * np.eye(3), 0.0)


# ---- beyond the paper ------------------------------------------------------------------------------------------


def test_rbcm_goes_to_the_dense_process_on_the_points_as_the_noise_vanishes(make_set):
    """There an expert's precision grows without bound, so that its weight cancels; so does the dense process'.

    The remaining difference is the prior's share, 1/(b u): u about 1e5 to 1e9, falling with the noise.
    """
    random = np.random.default_rng(22)
    differences = []
    for noise in (1e-4, 1e-6, 1e-8):
        kernel = Kernel(np.full(3, 0.02), np.ones(3), np.full(3, noise))
        z = random.uniform(-0.02, 0.02, (5, 3))
        stored = make_set(z, np.sin(40.0 * z), kernel)
        dense, robust = FullPredictor(stored).predict(z), make_predictor("rbcm", stored).predict(z)
        differences.append(np.abs(dense.mean - robust.mean).max())
        assert (robust.variance < 10.0 * noise).all()
    assert differences[0] < 1e-3 and differences[2] < 1e-6 and differences[1] < 0.1 * differences[0]


def test_grbcm_of_one_cell_is_the_dense_process_whatever_is_shared(make_set):
    random = np.random.default_rng(23)
    kernel = Kernel(np.array([0.02, 0.03, 0.2]), np.array([0.5, 1.0, 2.0]), np.array([0.05, 0.01, 0.1]))
    stored = make_set(random.uniform(-0.03, 0.03, (40, 3)) * [1, 1, 5], random.normal(size=(40, 3)), kernel)
    z = query_points(stored, 200, 24, spread=1.5)
    full = FullPredictor(stored).predict(z)
    for shared in (1, 7, 25):
        got = make_predictor("grbcm", stored, shared=shared).predict(z)
        alike(got, full, atol=1e-9)


def test_grbcm_that_shares_every_point_is_the_dense_process(make_set):
    random = np.random.default_rng(25)
    kernel = Kernel(np.full(3, 0.02), np.array([0.5, 1.0, 2.0]), np.array([0.05, 0.01, 0.1]))
    stored = make_set(random.uniform(-0.1, 0.1, (60, 3)), random.normal(size=(60, 3)), kernel, np.arange(60) // 5)
    z = query_points(stored, 200, 26)
    alike(make_predictor("grbcm", stored, shared=60).predict(z), FullPredictor(stored).predict(z), atol=1e-9)


def test_local_with_every_point_as_neighbour_is_the_dense_process(driven_set):
    z = query_points(driven_set, 10, 27)
    full = FullPredictor(driven_set).predict(z)
    got = make_predictor("local", driven_set, neighbours=driven_set.size).predict(z)
    alike(got, full, atol=1e-10)


@pytest.mark.parametrize("bound", [1e-2, 1e-4, 1e-8])
def test_weights_stay_within_the_stated_bound_of_the_dense_mean(bound, driven_set):
    z = query_points(driven_set, 200, 28)
    full, got = FullPredictor(driven_set), make_predictor("weights", driven_set, bound=bound, neighbours=30)
    error = np.abs(got.mean(z) - full.mean(z)) / np.sqrt(driven_set.kernel.signal_variance)
    assert error.max() <= bound
    assert (got.predict(z[:20]).variance >= full.predict(z[:20]).variance * (1.0 - 1e-9)).all()


def test_weights_without_a_bound_are_the_dense_mean(driven_set):
    z = query_points(driven_set, 50, 29)
    got = make_predictor("weights", driven_set, bound=0.0)
    np.testing.assert_allclose(got.mean(z), FullPredictor(driven_set).mean(z), atol=1e-11)


def apart(make_set, seed):
    """Return a set of 64 points a length scale apart."""
    random = np.random.default_rng(seed)
    lattice = np.stack(np.meshgrid(*[np.arange(4.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    kernel = Kernel(np.full(3, 1.0), np.array([0.5, 1.0, 2.0]), np.array([0.05, 0.01, 0.1]))
    return make_set(lattice + 0.1 * random.normal(size=(64, 3)), random.normal(size=(64, 3)), kernel)


@pytest.mark.parametrize(
    ("name", "all_of_them", "fewer"),
    [("iol", {"capacity": 64}, {"capacity": 20}), ("projected", {"threshold": 0.0}, {"threshold": 0.0, "most": 32})],
)
def test_with_room_for_every_point_it_is_the_dense_process(name, all_of_them, fewer, make_set):
    """Points a length scale apart, so that none lacks the gain to enter; with less room it is another."""
    stored = apart(make_set, 32)
    z = query_points(stored, 100, 31)
    full = FullPredictor(stored).predict(z)
    alike(make_predictor(name, stored, **all_of_them).predict(z), full, atol=1e-10)
    assert np.abs(make_predictor(name, stored, **fewer).mean(z) - full.mean).max() > 0.1


def test_a_set_that_needs_more_points_than_projected_has_is_spanned_as_a_whole(make_set):
    """In order of time the first places would take all room, and the last would be left at the prior."""
    stored = apart(make_set, 32)
    order = np.lexsort((stored.row, stored.source))
    late = stored.z[order[-16:]]
    process = OnlineProcess(stored.kernel, most=24, threshold=0.0)
    process.learn(stored.z[order], stored.y[order])
    left = make_predictor("projected", stored, most=24, threshold=0.0).predict(late).variance
    assert (left.mean(axis=0) < 0.8 * process.along(late)[1].mean(axis=0)).all()


@pytest.mark.parametrize(("drawn", "least", "most"), [(True, 0.2, 1.0), (False, 0.0, 0.15)])
def test_projected_finds_how_much_of_the_unspanned_variance_is_in_the_labels(drawn, least, most):
    """A draw of the kernel's own prior holds what points leave open, a plane holds nothing of it.

    The truth is known, so 50 and 95 % intervals must hold these shares of it: 400 queries times three outputs, of
    which neighbours agree, make chance 3 points at 50 % and 2 at 95 %; three times that is allowed. With the whole
    unspanned variance the intervals of the plane hold 79 and 99.9 %.
    """
    random = np.random.default_rng(34)
    kernel = Kernel(np.full(3, 1.0), np.ones(3), np.full(3, 0.1))
    waves, phase = random.normal(size=(3000, 3)), random.uniform(0.0, 2.0 * np.pi, 3000)
    heights = random.normal(size=(3000, 3)) * np.sqrt(2.0 / 3000)

    def truth(z):
        return np.cos(z @ waves.T + phase) @ heights if drawn else 0.3 * z

    z, asked = random.uniform(0.0, 4.0, (2500, 3)), random.uniform(0.0, 4.0, (400, 3))
    process = OnlineProcess(kernel)
    process.learn(z, truth(z) + np.sqrt(0.1) * random.normal(size=z.shape))
    share = process.unspanned_share
    assert (share >= least).all() and (share <= most).all()
    mean, variance, _ = process.along(asked)
    inside = [np.mean(np.abs(truth(asked) - mean) <= k * np.sqrt(variance)) for k in (0.6745, 1.96)]
    assert abs(inside[0] - 0.5) < 0.09 and abs(inside[1] - 0.95) < 0.06


def fitc_at_once(kernel: Kernel, points: np.ndarray, z: np.ndarray, y: np.ndarray, asked: np.ndarray):
    """Return mean and variance from C_uu, C_uf and the gains, solved at once (Snelson and Ghahramani 2006)."""
    cuu, cuf, cua = (kernel.correlation(points, other) for other in (points, z, asked))
    gain = np.maximum(1.0 - np.einsum("uf,uf->f", cuf, np.linalg.solve(cuu, cuf)), 0.0)
    mean, variance = np.empty((2, len(asked), 3))
    for o, ratio in enumerate(kernel.noise_variance / kernel.signal_variance):
        # Woodbury: weights of the points given all labels, each with noise ratio + gain.
        precision = cuu + cuf / (ratio + gain) @ cuf.T
        mean[:, o] = cua.T @ np.linalg.solve(precision, cuf @ (y[:, o] / (ratio + gain)))
        left = 1.0 - np.einsum("ua,ua->a", cua, np.linalg.solve(cuu, cua) - np.linalg.solve(precision, cua))
        variance[:, o] = kernel.signal_variance[o] * left
    return mean, variance


def test_projected_absorbs_labels_as_fitc_on_its_points(make_set):
    """Points far apart come first; all labels after them are told as if at once."""
    random = np.random.default_rng(33)
    lattice = 2.0 * np.stack(np.meshgrid(*[np.arange(3.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    kernel = Kernel(np.full(3, 1.5), np.array([0.5, 1.0, 2.0]), np.array([0.05, 0.4, 0.1]))
    z = np.concatenate([lattice, random.uniform(0.0, 4.0, (300, 3))])
    y = random.normal(size=(len(z), 3))
    process = OnlineProcess(kernel, most=len(lattice))
    process.learn(z, y)
    np.testing.assert_allclose(process.points, lattice, rtol=1e-14)
    asked = random.uniform(-1.0, 5.0, (80, 3))
    mean, variance, slope = process.along(asked)
    at_once = fitc_at_once(kernel, lattice, z, y, asked)
    np.testing.assert_allclose((mean, variance), at_once, atol=1e-9)
    # Points chosen first, labels afterwards: no label precedes a point, so the order of labels is all the same.
    for order in (slice(None), slice(None, None, -1)):
        chosen = OnlineProcess(kernel, threshold=0.05)
        chosen.span(z)
        first = chosen.points
        chosen.learn(z[order], y[order])
        assert np.array_equal(chosen.points, first) and 27 < len(first) < 100
        at_once = fitc_at_once(kernel, first, z, y, asked)
        np.testing.assert_allclose(chosen.along(asked)[:2], at_once, atol=1e-9)
    # More labels leave memory as it is, and what they say is kept: the second lot weighs in.
    before = process.count
    process.learn(z[27:], y[27:])
    assert process.count == before and np.abs(process.along(asked)[0] - mean).max() > 0.01
    assert (process.along(asked)[1] <= variance + 1e-12).all() and slope.shape == (80, 3, 3)


def test_points_chosen_at_once_leave_room_for_places_that_tell_more():
    random = np.random.default_rng(34)
    kernel = Kernel(np.ones(3), np.ones(3), np.full(3, 0.1))
    dense, far = random.uniform(0.0, 3.0, (300, 3)), np.array([[20.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    process = OnlineProcess(kernel, most=16, threshold=1e-3)
    process.span(dense)
    assert process.count == 12
    # What was left out tells less than what was chosen, and takes no room; a place never seen does.
    process.learn(dense, random.normal(size=(300, 3)))
    assert process.count == 12
    process.learn(far, np.ones((2, 3)))
    assert process.count == 14
    np.testing.assert_allclose(process.along(far)[0], 1.0 / 1.1, rtol=1e-6)


def test_noise_above_the_signal_averages_out_over_many_labels():
    """Points are a length scale apart at most, where those of the noise alone would be one."""
    random = np.random.default_rng(35)
    kernel = Kernel(np.ones(1), np.ones(3), np.full(3, 2.0))
    z = random.uniform(0.0, 6.0, (4000, 1))
    truth = np.sin(z) * [1.0, -0.5, 1.5]
    y = truth + np.sqrt(2.0) * random.normal(size=truth.shape)
    errors = {}
    for threshold in (None, 2.0):
        process = OnlineProcess(kernel, threshold=threshold)
        process.learn(z, y)
        errors[threshold] = process.count, np.sqrt(np.mean((process.along(z)[0] - truth) ** 2))
    assert errors[2.0][0] == 1 and errors[2.0][1] > 0.5
    assert 3 < errors[None][0] < 10 and errors[None][1] < 0.15


def test_labels_that_cells_reject_count_as_in_the_dense_process():
    """Twenty labels at each point: the paper keeps one of them, the process knows all."""
    random = np.random.default_rng(36)
    points = 2.0 * np.stack(np.meshgrid(*[np.arange(3.0)] * 3, indexing="ij"), -1).reshape(-1, 3) + 1.0
    kernel = Kernel(np.full(3, 1.5), np.array([0.5, 1.0, 2.0]), np.array([0.05, 0.4, 0.1]))
    z = np.repeat(points, 20, axis=0)
    y = random.normal(size=(len(z), 3))
    grid = Grid((4.0,) * 3, (-np.inf,) * 3, (np.inf,) * 3)
    labels = make_labels(z, y, features="vx,vy,r")
    trained = learn([labels], vehicle=road_car(), grid=grid, kernel=kernel, threshold=1e-9)
    assert trained.size == 27 and trained.cell_count == 8 and trained.sources[0].rejected == {"gain": 513}
    predictor = make_predictor("projected", trained, threshold=0.0)
    asked = random.uniform(-1.0, 7.0, (80, 3))
    mean, variance = fitc_at_once(kernel, points, z, y, asked)
    np.testing.assert_allclose(predictor.mean(asked), mean, atol=1e-6)
    np.testing.assert_allclose(predictor.predict(asked).variance, variance, atol=1e-4)
    alone = make_predictor("projected", replace(trained, information=None, absorbed=None), threshold=0.0)
    assert np.abs(alone.mean(asked) - mean).max() > 0.2
