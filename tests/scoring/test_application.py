"""Predictors on drives: FITC's future, features at states of the model's own, terms with memory."""

from dataclasses import replace

import numpy as np

from split_cli.learning.features import Z1, Z2, FeatureSet
from split_cli.learning.in_memory import train_in_memory
from split_cli.learning.labels import compute_labels
from split_cli.learning.trust import Trust
from split_cli.prediction import make_predictor
from split_cli.scoring.application import correction_from, features_at, future_rows, left_by_model, predict_rows
from split_cli.scoring.evaluation import HeldOutSamples, baseline_tallies, labels_left, predictor_tally, score
from split_cli.scoring.metrics import ErrorSums
from split_cli.scoring.report import EvaluationSettings
from split_cli.scoring.rollouts import roll_out
from split_cli.scoring.splits import hold_out_blocks
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.evaluate import evaluate
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
    correction = correction_from(predictor, drive, z, rows)
    for i, row in enumerate(rows):
        alone = predictor.at(z[future_rows(drive, row)]).predict(z[row][None])
        np.testing.assert_array_equal(found.mean[i], alone.mean[0])
        np.testing.assert_array_equal(found.variance[i], alone.variance[0])
    np.testing.assert_allclose(correction.residual(z[rows]), found.mean, atol=1e-12)
    kernel = trained.kernel
    explained = 1.0 - found.variance[:, kernel.clearest] / kernel.signal_variance[kernel.clearest]
    np.testing.assert_allclose(correction.answers(z[rows], True)[1], explained, atol=1e-12)


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
    tested = labels_left(held, predictor)
    tally, prediction = predictor_tally(held, predictor, tested)
    np.testing.assert_array_equal(tested.row, labels.row[held.tested])
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


LATE = road_car(effects=(EffectSpec("steer_lag", {"tau": 0.1}, "learned"),))


def of_a_part():
    """Return a set of a car that steers late, learned where the front slips little, a drive, its features, labels."""
    drive = make_drive(4, segments=6, vehicle=CAR, terms=[CATALOGUE["steer_lag"]({"tau": 0.1})])
    labels = compute_labels(drive, LATE, Z2)
    labels = labels.take(np.isfinite(labels.y).all(axis=1))
    slip = np.abs(labels.z[:, 0])
    made = train_in_memory([labels.take(slip < np.median(slip))], LATE)
    return replace(made, found_effects=1), drive, Z2.compute(SingleTrack(LATE), drive), labels


def test_a_lag_acts_as_far_as_the_set_knows_in_one_step_and_in_rollouts(monkeypatch):
    trained, drive, z, labels = of_a_part()
    predictor = make_predictor("bcm", trained)
    known = predictor.knowledge(z[labels.row])
    assert known.max() > 0.9 and known.min() < 1e-6
    left = left_by_model(predictor, drive, z, labels)
    every = compute_labels(drive, CAR, Z2)
    of_file = every.y[np.isin(every.row, labels.row)]
    # Between both models by what is known, to first order in the part of the angle that acts.
    between = of_file + known[:, None] * (labels.y - of_file)
    apart, lag = (np.sqrt(np.square(one).mean(axis=0)) for one in (left - between, labels.y - of_file))
    assert (apart < 0.1 * lag).all()
    far = known < 1e-6
    np.testing.assert_allclose(left[far], of_file[far], rtol=0.0, atol=1e-6)
    correction = correction_from(predictor, drive, z, labels.row)
    (ends,) = roll_out(SingleTrack(LATE), drive, labels.row, 1, labels.window, correction).transpose(1, 0, 2)
    (nominal,) = roll_out(SingleTrack(CAR), drive, labels.row, 1, labels.window).transpose(1, 0, 2)
    np.testing.assert_allclose(ends[far], nominal[far], rtol=0.0, atol=1e-6)
    # In pieces as at once: what the wheel remembers is handed on.
    monkeypatch.setattr("split_cli.learning.pieces.PIECE_ROWS", 100)
    np.testing.assert_allclose(left_by_model(predictor, drive, z, labels), left, rtol=0.0, atol=1e-10)


def test_what_a_model_leaves_is_worked_out_once_for_all_ways_to_trust_it(monkeypatch):
    trained, drive, z, labels = of_a_part()
    trained = replace(trained, trust=Trust((0.5, 0.9, 0.8), "held-out", 9, (1.0, 1.0, 1.0)))
    asked = []

    def counted(predictor, *arguments):
        asked.append(predictor.name)
        return left_by_model(predictor, *arguments)

    monkeypatch.setattr("split_cli.scoring.evaluation.left_by_model", counted)
    settings = EvaluationSettings(predictors=("bcm", "projected"), rollout=())
    run = evaluate([drive], CAR, settings, trained)
    assert asked == ["bcm", "projected"] and len(run.traces) == 6
    for trace in run.traces:
        predictor = make_predictor(trace.name.split(",")[0], trained)
        rows = np.isin(labels.row, trace.tested.row)
        expected = left_by_model(predictor, drive, z, labels.take(rows))
        np.testing.assert_allclose(trace.tested.y, expected, rtol=0.0, atol=1e-12)


def test_without_such_a_lag_labels_are_what_is_left():
    drive = make_drive(4, segments=2, vehicle=CAR)
    trained, labels = make_training_set(points=50), compute_labels(drive, CAR, Z2)
    z = Z2.compute(SingleTrack(CAR), drive)
    assert left_by_model(make_predictor("bcm", trained), drive, z, labels) is labels.y
