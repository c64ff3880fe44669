"""Labels while a late torque is on its way: against the dense process with their own noise, and a planted truth."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.learning.cells import empty_set, extend
from split_cli.learning.kernel import Kernel
from split_cli.learning.late_labels import freed_of_late_torque, rate_along
from split_cli.learning.region import Region, z2_grid
from split_cli.prediction import make_predictor
from split_cli.scoring.torque_lag import lagging
from tests.factories import make_labels, road_car

TAU, NOISE = 0.06, 0.05
SCALES = np.array([0.02, 0.02, 0.1])


def blank(found: bool = True):
    car = lagging(road_car(), TAU) if found else road_car()
    region = Region.of(car)
    kernel = Kernel(SCALES, np.array([0.01, 0.02, 0.03]), np.array([NOISE, 0.001, 0.001]))
    features = make_labels(np.zeros((1, 3)), np.zeros((1, 3))).features
    made = empty_set(car, features, region, z2_grid(car, region), kernel, horizon=0.05)
    return replace(made, found_effects=int(found))


def driven(count: int = 240, seed: int = 3):
    """Return labels of a drive that holds a torque for 4 labels and then steps to another, with random errors."""
    rng = np.random.default_rng(seed)
    torque = np.repeat(rng.uniform(-0.4, 0.4, count // 4), 4)
    z = np.column_stack([rng.normal(0.0, 0.01, (count, 2)), torque])
    return make_labels(z, 0.2 * rng.normal(size=(count, 3)), blank().vehicle)


def rates(z, car):
    """Return the rate of the force over mass, written out: the next label is 0.05 s away."""
    force = z[:, 2] * car.max_torque / (car.mass * car.wheel_radius)
    rate = np.diff(force) / 0.05
    return np.append(rate, rate[-1])


def test_the_process_of_freed_labels_is_that_of_labels_with_their_own_noise():
    made, labels = blank(), driven()
    freed = freed_of_late_torque(made, labels)
    correlation = np.exp(-0.5 * np.square((labels.z[:, None] - labels.z) / SCALES).sum(axis=-1))
    torque_rate = np.diff(labels.z[:, 2]) / 0.05
    torque_rate = np.append(torque_rate, torque_rate[-1])
    for output, noise in enumerate((NOISE, 0.001, 0.001)):
        signal = made.kernel.signal_variance[output] * correlation
        # v_x: the force that is short. v_y and r: the prior variance of the slope over torque is S/l^2.
        slope = np.sqrt(made.kernel.signal_variance[output]) / SCALES[2]
        unknown = TAU * (slope * torque_rate if output else rates(labels.z, made.vehicle))
        expected = signal @ np.linalg.inv(signal + np.diag(noise + np.square(unknown))) @ labels.y[:, output]
        got = signal @ np.linalg.inv(signal + noise * np.eye(len(signal))) @ freed.y[:, output]
        # With a noise of 1e-3 of a variance of 240 labels K + N has a condition of 1e4: digits to spare.
        np.testing.assert_allclose(got, expected, atol=1e-9 * np.abs(expected).max())


def test_a_yaw_rate_of_a_torque_that_is_still_there_is_not_learned_at_the_one_asked_for():
    """0.5 of the torque turns the car and is let go late: what is asked for passes 0, where it is held elsewhere."""
    count, car = 400, blank().vehicle
    asked = np.tile([0.5, 0.5, 0.5, 0.0, -0.3, -0.3, 0.0, 0.0], count // 8)
    arrived = np.tile([0.5, 0.5, 0.5, 0.5, 0.0, -0.3, 0.0, 0.0], count // 8)
    y = np.zeros((count, 3))
    y[:, 2] = np.where(arrived == 0.5, -0.5, 0.0)
    z = np.column_stack([np.random.default_rng(2).normal(0.0, 0.003, (count, 2)), asked])
    labels = make_labels(z, y, car)
    plain, freed = extend(replace(blank(False), vehicle=car), [labels]), extend(blank(), [labels])
    at = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    before, after = (make_predictor("full", s).mean(at)[:, 2] for s in (plain, freed))
    # Of the labels at 0 a third have what the torque of before makes.
    assert before[0] == pytest.approx(-0.5 / 3.0, abs=0.05) and abs(after[0]) < 0.02
    assert after[1] == pytest.approx(-0.5, abs=0.05)


def test_what_a_step_of_the_torque_leaves_does_not_act_at_a_steady_torque():
    """The lag is 5 ms too long at each step down through a torque that is never held: what is learned there is none."""
    count, car = 400, blank().vehicle
    torque = np.tile([0.4, 0.4, 0.4, 0.05, -0.3, -0.3, -0.3, -0.3], count // 8)
    z = np.column_stack([np.zeros((count, 2)), torque])
    z[:, :2] += np.random.default_rng(2).normal(0.0, 0.003, (count, 2))
    rate = rates(z, car)
    y = np.zeros((count, 3))
    y[:, 0] = 0.005 * rate
    y[torque == -0.3, 0] += 0.2  # what is wrong while the torque is held
    labels = make_labels(z, y, car)
    plain = extend(replace(blank(False), vehicle=car), [labels])
    freed = extend(blank(), [labels])
    at = np.array([[0.0, 0.0, 0.05], [0.0, 0.0, -0.3]])
    before, after = (make_predictor("full", s).mean(at)[:, 0] for s in (plain, freed))
    assert abs(before[0]) > 0.02 and abs(after[0]) < 0.1 * abs(before[0])
    assert after[1] == pytest.approx(0.2, abs=0.05)


def test_without_a_lag_labels_stay_as_they_are():
    labels = driven()
    assert freed_of_late_torque(blank(False), labels) is labels
    steady = replace(labels, z=np.column_stack([labels.z[:, :2], np.full(len(labels), 0.1)]))
    np.testing.assert_array_equal(freed_of_late_torque(blank(), steady).y, steady.y)


def test_a_gap_starts_the_rate_anew():
    labels = make_labels(np.zeros((6, 3)), np.zeros((6, 3)))
    force = np.array([0.0, 1.0, 3.0, 10.0, 10.5, 99.0])
    labels = replace(labels, row=np.array([0, 1, 2, 10, 11, 30]))
    np.testing.assert_allclose(rate_along(labels, force), np.array([1.0, 2.0, 2.0, 0.5, 0.5, 0.0]) / 0.05)
    assert rate_along(labels.take(slice(0, 1)), force[:1]).tolist() == [0.0]


def test_a_drive_that_is_appended_does_not_depend_on_what_was_learned_before():
    first, second = driven(seed=3), replace(driven(seed=4), sha256="1" * 64)
    together, one_by_one = extend(blank(), [first, second]), extend(extend(blank(), [first]), [second])
    np.testing.assert_array_equal(together.y, one_by_one.y)
