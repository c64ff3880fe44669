"""Predictors on drives: FITC's future, features at states of the model's own, terms with memory."""

from dataclasses import replace

import numpy as np

from split_cli.learning.features import Z1, Z2, FeatureSet
from split_cli.learning.labels import compute_labels
from split_cli.prediction import make_predictor
from split_cli.scoring.application import correction_from, features_at, future_rows, predict_rows
from split_cli.scoring.evaluation import HeldOutSamples, baseline_tallies, predictor_tally, score
from split_cli.scoring.metrics import ErrorSums
from split_cli.scoring.splits import hold_out_blocks
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import MissingForce, make_drive, make_training_set, road_car

CAR = road_car()


def test_future_rows_are_ten_states_100_ms_apart_inside_the_segment():
    drive = make_drive(0, segments=3, seconds=4.0, vehicle=CAR)  # 201 rows a segment at 20 ms
    np.testing.assert_array_equal(future_rows(drive, 10), 10 + 5 * np.arange(1, 11))
    np.testing.assert_array_equal(future_rows(drive, 183), [188, 193, 198, 200])
    np.testing.assert_array_equal(future_rows(drive, 200), [200])
    np.testing.assert_array_equal(future_rows(drive, 201), 201 + 5 * np.arange(1, 11))


def test_fitc_is_given_its_own_future_row_by_row_in_scores_and_rollouts():
    drive = make_drive(1, segments=4, seconds=4.0, vehicle=CAR)
    trained = make_training_set(points=300)
    z = Z2.compute(SingleTrack(CAR), drive)
    predictor = make_predictor("fitc", trained)
    rows = np.array([5, 90, 399])
    found = predict_rows(predictor, drive, z, rows)
    g = correction_from(predictor, drive, z, rows)
    for i, row in enumerate(rows):
        alone = predictor.at(z[future_rows(drive, row)]).predict(z[row][None])
        np.testing.assert_array_equal(found.mean[i], alone.mean[0])
        np.testing.assert_array_equal(found.variance[i], alone.variance[0])
    np.testing.assert_allclose(g(z[rows]), found.mean, atol=1e-12)


def test_features_follow_the_models_state_and_take_inputs_as_recorded():
    drive = make_drive(2, segments=4, vehicle=CAR)
    model = SingleTrack(CAR)
    rows = np.array([3, 77, 300])
    recorded = np.stack([drive[name][rows] for name in ("vx", "vy", "r")], axis=1)
    for features in (Z1, Z2, FeatureSet(("speed", "steer_rate", "alpha_f"))):
        z = features.compute(model, drive)
        np.testing.assert_allclose(features_at(features, model, drive, rows, recorded, z), z[rows], atol=1e-14)
        moved = recorded + [0.5, -0.1, 0.05]
        columns = dict(drive.columns)
        for name, values in zip(("vx", "vy", "r"), moved.T, strict=True):
            columns[name] = columns[name].copy()
            columns[name][rows] = values
        expected = features.compute(model, replace(drive, columns=columns))[rows]
        np.testing.assert_allclose(features_at(features, model, drive, rows, moved, z), expected, atol=1e-13)


def test_features_keep_the_memory_of_a_delay_along_the_drive():
    drive = make_drive(3, segments=4, vehicle=CAR)
    model = SingleTrack(CAR, (CATALOGUE["steer_delay"]({"delay": 0.1}, ""),))
    z = Z2.compute(model, drive)
    assert np.abs(z[:, 0] - Z2.compute(SingleTrack(CAR), drive)[:, 0]).max() > 0.01
    rows = np.arange(20, 180, 7)
    recorded = np.stack([drive[name][rows] for name in ("vx", "vy", "r")], axis=1)
    np.testing.assert_allclose(features_at(Z2, model, drive, rows, recorded, z), z[rows], atol=1e-13)


def test_scores_are_those_of_the_errors_themselves():
    drive = make_drive(4, segments=30, vehicle=CAR, terms=[MissingForce({"front_grip_loss": 0.15})])
    labels = compute_labels(drive, CAR, Z2)
    model = SingleTrack(CAR)
    held = HeldOutSamples(drive, hold_out_blocks(drive, 10, 0.3, 0.5), labels, Z2.compute(model, drive))
    predictor = make_predictor("bcm", make_training_set(points=500))
    tally, prediction = predictor_tally(held, predictor)
    tested = labels.take(held.tested)
    np.testing.assert_array_equal(prediction.mean, predictor.predict(tested.z).mean)
    error = tested.y - prediction.mean
    baselines = baseline_tallies(held, model, np.ones(3))
    found = score("bcm", tally, baselines)
    np.testing.assert_allclose(found.rmse[:3], np.sqrt(np.mean(error**2, axis=0)), rtol=1e-12)
    np.testing.assert_allclose(found.rmse[3], np.sqrt(np.mean(np.sum(error**2, axis=1))), rtol=1e-12)
    inside = ErrorSums.of(error[tested.accepted])
    np.testing.assert_allclose(found.rmse_valid[:3], inside.rmse, rtol=1e-12)
    share = np.mean(error**2, axis=0) / np.mean(tested.y**2, axis=0)
    np.testing.assert_allclose(found.skill_nominal[:3], 1.0 - share, rtol=1e-9)
    assert found.samples == len(tested)
    assert found.samples_valid == tested.accepted.sum()
