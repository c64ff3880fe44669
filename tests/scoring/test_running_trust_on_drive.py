"""A set that follows a drive: its shares are causal, do no harm on another car, and stay on a like one."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.learning.features import Z2
from split_cli.learning.in_memory import train_in_memory
from split_cli.learning.labels import compute_labels
from split_cli.logs.drive import Drive
from split_cli.prediction import Predictor, make_predictor
from split_cli.scoring.application import predict_rows
from split_cli.scoring.evaluation import HeldOutSamples, labels_left, rollout_trajectories
from split_cli.scoring.rollouts import score_rollouts
from split_cli.scoring.running_trust_on_drive import FollowedPredictor
from split_cli.scoring.splits import hold_out_blocks, whole_drive
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import MissingForce, make_drive, road_car

CAR = road_car()
LIKE, UNLIKE = MissingForce({"front_grip_loss": 0.15}), MissingForce({"front_grip_loss": -0.15})


def whole(drive: Drive) -> HeldOutSamples:
    return HeldOutSamples(
        drive, whole_drive(drive), compute_labels(drive, CAR, Z2), Z2.compute(SingleTrack(CAR), drive)
    )


def followed_along(predictor: Predictor, held: HeldOutSamples) -> FollowedPredictor:
    return FollowedPredictor(predictor, held, labels_left(held, predictor))


@pytest.fixture(scope="module")
def predictor() -> Predictor:
    """Of a set that is trusted whole."""
    drive = make_drive(0, segments=8, seconds=5.0, terms=[LIKE], vehicle=CAR)
    return make_predictor("bcm", train_in_memory([compute_labels(drive, CAR, Z2)], CAR))


def errors(held: HeldOutSamples, predictor: Predictor) -> dict[str, np.ndarray]:
    """Return root mean square errors of rollouts of 1 s, shape (3,), nominal, as stored and followed."""
    ways = {("stored", ""): (held, predictor), ("followed", ""): (held, followed_along(predictor, held))}
    starts, rolled = rollout_trajectories(held, SingleTrack(CAR), ways, 20)
    sums = score_rollouts(held.drive, starts, held.labels.window, rolled)
    return {name: sums.rmse[-1] for (name, _), sums in sums.items()}


def test_on_another_car_it_does_no_harm_and_on_a_like_one_it_keeps_the_gain(predictor):
    like = errors(whole(make_drive(1, segments=8, seconds=5.0, terms=[LIKE], vehicle=CAR)), predictor)
    unlike = errors(whole(make_drive(1, segments=8, seconds=5.0, terms=[UNLIKE], vehicle=CAR)), predictor)
    # On the other car the residual has the other sign, so that the stored trust nearly doubles the errors.
    assert (unlike["stored"][1:] > 1.6 * unlike["nominal"][1:]).all()
    # Squares are weighed over all states together, so that one may lose a little where another gains more.
    assert (unlike["followed"] < 1.1 * unlike["nominal"]).all()
    assert (like["stored"][1:] < 0.4 * like["nominal"][1:]).all()
    assert (like["followed"][1:] < 0.5 * like["nominal"][1:]).all()


def test_shares_rest_on_what_was_driven_before(predictor):
    drive = make_drive(1, segments=2, seconds=5.0, terms=[LIKE], vehicle=CAR)
    other = make_drive(1, segments=2, seconds=5.0, terms=[UNLIKE], vehicle=CAR)
    row = 120
    columns = {name: np.concatenate([drive[name][:row], other[name][row:]]) for name in drive.columns}
    mixed = Drive("mixed", columns, drive.segment, drive.period, metadata=drive.metadata)
    found, changed = (followed_along(predictor, whole(d)) for d in (drive, mixed))
    before, after = np.arange(row), np.arange(row + 25, len(drive))
    np.testing.assert_array_equal(found.shares(before), changed.shares(before))
    assert not np.array_equal(found.shares(after), changed.shares(after))
    window = whole(drive).labels.window
    stored = np.tile(predictor.training_set.trust.array, (window, 1))
    np.testing.assert_array_equal(found.shares(np.arange(window)), stored)


def test_rows_that_train_say_nothing(predictor):
    drive = make_drive(1, segments=2, seconds=5.0, terms=[LIKE], vehicle=CAR)
    other = make_drive(1, segments=2, seconds=5.0, terms=[UNLIKE], vehicle=CAR)
    split = hold_out_blocks(drive, blocks=4, holdout=0.5, guard=0.2)
    columns = {name: np.where(split.test, drive[name], other[name]) for name in drive.columns}
    mixed = Drive("mixed", columns, drive.segment, drive.period, metadata=drive.metadata)
    shares = [
        followed_along(predictor, replace(whole(one), split=split)).shares(np.arange(len(drive)))
        for one in (drive, mixed)
    ]
    assert shares[0].any()
    np.testing.assert_array_equal(*shares)


def test_its_predictions_are_the_sets_times_the_shares(predictor):
    held = whole(make_drive(1, segments=2, seconds=5.0, terms=[LIKE], vehicle=CAR))
    followed, rows = followed_along(predictor, held), np.array([0, 40, 41, 300])
    found = predict_rows(followed, held.drive, held.z, rows)
    raw = predictor.predict(held.z[rows])
    np.testing.assert_allclose(found.mean, followed.shares(rows) * raw.mean)
    with pytest.raises(TypeError, match="row of the drive"):
        followed.predict(held.z[rows])
