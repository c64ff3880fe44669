"""Learning interval by interval is learning the drive; the committee that follows is the committee."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.control.grip import PeakShift
from split_cli.control.iol_learner import DictionaryResidual, IolLearner
from split_cli.control.learner import NoLearner, SplitLearner, learning_region
from split_cli.control.residual import PredictorResidual
from split_cli.learning.cells import empty_set, extend
from split_cli.learning.features import Z2
from split_cli.learning.iol import Dictionary
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.region import z2_grid
from split_cli.prediction.bcm import BcmPredictor
from split_cli.prediction.full import FullPredictor
from split_cli.prediction.online_process import OnlineProcess
from tests.factories import MissingForce, make_drive, road_car

PERIOD, WINDOW = 0.01, 5


@pytest.fixture(scope="module")
def drive():
    terms = (MissingForce({"front_grip_loss": 0.1}),)
    return make_drive(2, segments=1, seconds=30.0, period=PERIOD, terms=terms)


@pytest.fixture(scope="module")
def empty():
    car = road_car()
    region = learning_region(car, 0.18, 0.10, 0.9)
    grid = z2_grid(car, region)
    kernel = Kernel(2 * np.array(grid.edges), np.array([0.1, 0.5, 0.3]), np.array([0.01, 0.02, 0.01]))
    return empty_set(car, Z2, region, grid, kernel, horizon=WINDOW * PERIOD)


def driven(learner, drive):
    learner.begin_lap("lap", float(drive["t"][0]))
    for first in range(0, len(drive) - WINDOW, WINDOW):
        learner.learn(drive.select(slice(first, first + WINDOW + 1)), first)
    return learner.end_lap(float(drive["t"][-1] - drive["t"][0]))


def test_a_lap_learned_online_is_the_lap_learned_from_its_drive(drive, empty):
    online = driven(SplitLearner(empty), drive)
    labels = compute_labels(drive, empty.vehicle, Z2, empty.region, horizon=empty.horizon)
    offline = extend(empty, [labels])
    assert online.size == offline.size > 50
    for name in ("cell_numbers", "offsets", "z", "gamma", "t", "row"):
        assert np.array_equal(getattr(online, name), getattr(offline, name)), name
    # Labels of windows computed one by one and together are summed in another order.
    assert online.y == pytest.approx(offline.y, abs=1e-9)
    ours, theirs = online.sources[-1], offline.sources[-1]
    assert (ours.accepted, ours.insertions, ours.replacements) == (
        theirs.accepted,
        theirs.insertions,
        theirs.replacements,
    )


def test_a_lap_has_its_learners_labels(drive, empty):
    learner, lap = NoLearner(empty), drive.select(slice(0, 1001))
    parts = [lap.select(slice(first, first + WINDOW + 1)) for first in range(0, len(lap) - WINDOW, WINDOW)]
    found = Labels.joined([learner.learn(part, WINDOW * k).labels for k, part in enumerate(parts)])
    labels = compute_labels(lap, empty.vehicle, Z2, empty.region, horizon=empty.horizon).inside(empty.grid)
    assert np.array_equal(found.row, labels.row) and np.array_equal(found.reason, labels.reason)
    assert found.y == pytest.approx(labels.y, abs=1e-9) and labels.accepted.any() and len(labels) == 200


def test_a_lap_that_was_watched_is_a_lap_that_was_driven(drive, empty):
    labels = compute_labels(drive, empty.vehicle, Z2, empty.region, horizon=empty.horizon)
    learner = SplitLearner(empty)
    learner.begin_lap("lap", float(drive["t"][0]))
    updates = learner.watch(labels)
    watched = learner.end_lap(float(drive["t"][-1] - drive["t"][0]))
    own = driven(SplitLearner(empty), drive)
    assert np.array_equal(watched.z, own.z) and watched.y == pytest.approx(own.y, abs=1e-9)
    assert updates == watched.sources[-1].insertions + watched.sources[-1].replacements > 50


def test_the_committee_that_follows_updates_is_the_committee(drive, empty):
    learner = SplitLearner(empty)
    trained = driven(learner, drive)
    rng = np.random.default_rng(1)
    z = trained.z[rng.integers(0, trained.size, 200)] + rng.normal(0, 0.01, (200, 3))
    found = learner.residual.along(z)
    reference = BcmPredictor(trained)
    # Cells beyond the distance at which a kernel entry is 1e-6 are left out; their weights are a few deviations.
    expected = reference.predict(z)
    assert found.mean == pytest.approx(expected.mean, abs=1e-4)
    assert found.variance == pytest.approx(expected.variance, rel=1e-3)
    damped = PredictorResidual(trained, "bcm").along(z)
    assert found.slope == pytest.approx(damped.slope, abs=2e-2)
    np.testing.assert_allclose(damped.slope, reference.jacobian(z) * damped.knowledge[:, :, None], rtol=1e-12)


def test_the_process_that_follows_updates_has_absorbed_every_valid_label_of_the_lap(drive, empty):
    learner = SplitLearner(empty, "projected")
    trained = driven(learner, drive)
    labels = compute_labels(drive, empty.vehicle, Z2, empty.region, horizon=empty.horizon).inside(empty.grid)
    process = OnlineProcess(empty.kernel, threshold=0.0)
    process.learn(labels.z[labels.accepted], labels.y[labels.accepted])
    found = learner.residual.along(trained.z)
    mean, variance, _ = process.along(trained.z)
    noise = np.sqrt(empty.kernel.noise_variance)
    assert np.sqrt(np.mean(np.square((found.mean - mean) / noise))) < 0.02
    assert (np.abs(found.variance - variance) < 0.2 * empty.kernel.signal_variance).all()
    # A prior mean that moves later: the labels kept are learned beyond it, as a dense process learns them.
    shift = PeakShift(empty.vehicle, Z2, np.array([0.9, 0.95]))
    learner.residual.rest_on(shift)
    beyond = replace(trained, y=trained.y - shift.at(trained.z)[0])
    z = trained.z[::5] + 0.003
    moved = learner.residual.along(z).mean - shift.at(z)[0]
    assert np.sqrt(np.mean(np.square((moved - FullPredictor(beyond).mean(z)) / noise))) < 0.02


def test_process_and_table_have_the_slope_of_the_dense_process_where_the_committee_has_not(drive, empty):
    """A controller steers by the slope: of few points a cell the committee gets it wrong (decision 0034)."""
    off = {}
    for name in ("projected", "table", "bcm"):
        learner = SplitLearner(empty, name)
        trained = driven(learner, drive)
        learner.residual.rest_on(None)
        dense = FullPredictor(trained).jacobian(trained.z)[:, 1, :2]
        found = learner.residual.along(trained.z)
        found = found.slope[:, 1, :2] / found.knowledge[:, 1, None]
        off[name] = np.sqrt(np.square(found - dense).mean() / np.square(dense).mean())
    assert off["projected"] < 0.05 and off["table"] < 0.1 < off["bcm"]


def test_learners_rest_on_the_same_prior_mean_while_they_learn(drive, empty):
    shift = PeakShift(empty.vehicle, Z2, np.array([0.9, 0.95]))
    for learner in (SplitLearner(empty), IolLearner(empty, printed=False)):
        learner.residual.rest_on(shift)
        trained = driven(learner, drive)
        if isinstance(learner, IolLearner):
            learner.residual.refresh()
        z = trained.z[::5] + 0.003
        beyond = replace(trained, y=trained.y - shift.at(trained.z)[0])
        reference = (FullPredictor if isinstance(learner, IolLearner) else BcmPredictor)(beyond)
        expected = reference.predict(z).mean + shift.at(z)[0]
        assert learner.residual.along(z).mean == pytest.approx(expected, abs=1e-4)


def test_the_dictionary_in_the_loop_is_the_dense_process(drive, empty):
    learner = IolLearner(empty, printed=False)
    trained = driven(learner, drive)
    assert 20 < trained.size <= 400
    learner.residual.refresh()
    assert learner.size == trained.size
    z = trained.z[:50] + 0.003
    found, expected = learner.residual.along(z), FullPredictor(trained).predict(z)
    assert found.mean == pytest.approx(expected.mean, abs=1e-6)
    assert found.variance == pytest.approx(expected.variance, abs=1e-6)
    step = 1e-6
    ahead = DictionaryResidual(learner.dictionary, empty)
    for feature in range(3):
        move = np.zeros(3)
        move[feature] = step
        slope = (ahead.along(z + move).mean - ahead.along(z - move).mean) / (2 * step)
        known = ahead.along(z).knowledge
        assert ahead.along(z).slope[:, :, feature] == pytest.approx(slope * known, abs=1e-4)


def test_a_slow_dictionary_skips_what_comes_while_it_works(drive, empty):
    fast, slow = IolLearner(empty, printed=False), IolLearner(empty, printed=True)
    slow.costs = {1: 0.5, 400: 0.5}  # half a second an update: ten intervals of 50 ms
    everything, some = driven(fast, drive), driven(slow, drive)
    assert slow.skipped > 200
    # After each update nine or ten intervals pass unseen, so that 30 s hold no more than 60 updates.
    assert some.size <= 60 < everything.size
    assert isinstance(slow.dictionary, Dictionary)
