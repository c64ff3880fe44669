"""Persistence in label units against closed forms."""

from dataclasses import replace

import numpy as np

from split_cli.learning.features import Z2
from split_cli.learning.labels import compute_labels
from split_cli.scoring.persistence import label_persistence_errors, phi_at, velocity_persistence_errors
from split_cli.vehicle.integration import integrate_recorded
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import MissingForce, make_drive, make_labels, road_car


def test_velocity_held_is_the_label_of_a_prediction_that_stays():
    """A prediction p has the error Phi^-1 (x(t + h) - p)/h: with p = f_h the label, with p = x(t) persistence."""
    car = road_car()
    drive = make_drive(1, segments=8, vehicle=car, terms=[MissingForce({"front_lateral": 300.0})])
    model = SingleTrack(car)
    labels = compute_labels(drive, car, Z2, stride=7)
    error = velocity_persistence_errors(model, drive, labels)
    ok = np.isfinite(labels.y).all(axis=1)
    rows = labels.row[ok]
    velocity = np.stack([drive[name] for name in ("vx", "vy", "r")], axis=1)
    span = rows[:, None] + np.arange(labels.window + 1)
    predicted = integrate_recorded(model, velocity[rows], drive["T"][span], drive["delta"][span], drive.period, 16)
    moved = np.linalg.solve(phi_at(model, drive, rows, labels.horizon), (predicted - velocity[rows])[:, :, None])
    # error - label = Phi^-1 (f_h - x)/h. Labels take steps of |lambda| step <= 1, here up to 20 ms at 8 m/s, where
    # RK4 is off by up to 6e-4; f_h here takes sixteen times finer ones. Persistence itself is some 1 m/s^2.
    np.testing.assert_allclose(error[ok] - labels.y[ok], moved[:, :, 0] / labels.horizon, atol=1e-3)
    assert np.isnan(error[~ok]).all()


def test_coasting_straight_without_drag_is_predicted_by_persistence():
    free = road_car(drag_coefficient=0.0, rolling_resistance_front=0.0, rolling_resistance_rear=0.0)
    drive = make_drive(0, segments=1, seconds=2.0, vehicle=free)
    still = {name: np.full(len(drive), value) for name, value in (("vx", 15.0), ("vy", 0.0), ("r", 0.0))}
    still |= {"T": np.zeros(len(drive)), "delta": np.zeros(len(drive))}
    coasting = replace(drive, columns={**drive.columns, **still})
    labels = compute_labels(coasting, free, Z2)
    np.testing.assert_array_equal(velocity_persistence_errors(SingleTrack(free), coasting, labels)[:-1], 0.0)


def test_straight_acceleration_reads_its_rate():
    """Straight ahead, torque alone: v_x' = T/(r_e m), and A's first row is 0, so that Phi leaves it alone."""
    free = road_car(drag_coefficient=0.0, rolling_resistance_front=0.0, rolling_resistance_rear=0.0)
    base = make_drive(0, segments=1, seconds=2.0, vehicle=free)
    rate = 900.0 / (free.wheel_radius * free.mass)
    columns = {**base.columns, "vy": np.zeros(len(base)), "r": np.zeros(len(base)), "delta": np.zeros(len(base))}
    columns |= {"T": np.full(len(base), 900.0), "vx": 12.0 + rate * np.arange(len(base)) * base.period}
    drive = replace(base, columns=columns)
    labels = compute_labels(drive, free, Z2)
    error = velocity_persistence_errors(SingleTrack(free), drive, labels)
    usable = np.isfinite(labels.y).all(axis=1)
    np.testing.assert_allclose(error[usable], np.tile([rate, 0.0, 0.0], (usable.sum(), 1)), atol=1e-10)
    np.testing.assert_allclose(labels.y[usable], 0.0, atol=1e-10)


def test_plain_labels_have_plain_persistence():
    car: Vehicle = road_car()
    drive = make_drive(2, segments=4, vehicle=car)
    labels = compute_labels(drive, car, Z2, plain=True)
    error = velocity_persistence_errors(SingleTrack(car), drive, labels)
    ok = np.isfinite(labels.y).all(axis=1)
    change = drive["vy"][labels.row[ok] + labels.window] - drive["vy"][labels.row[ok]]
    np.testing.assert_allclose(error[ok, 1], change / labels.horizon, rtol=1e-12)


def test_last_label_is_one_whose_window_had_ended_in_the_same_segment():
    z = np.zeros((8, 3))
    y = np.arange(8.0)[:, None] * [1.0, 10.0, 100.0]
    y[5] = np.nan
    labels = make_labels(z, y)
    # Windows of two samples, starts every sample: the label of row k is known at row k + 2.
    labels = replace(labels, window=2, segment=np.array([0, 0, 0, 0, 1, 1, 1, 1], dtype=np.int32))
    error = label_persistence_errors(labels)
    expected = np.full((8, 3), np.nan)
    expected[[2, 3, 6]] = 2.0 * np.array([1.0, 10.0, 100.0])
    np.testing.assert_array_equal(error, expected)
