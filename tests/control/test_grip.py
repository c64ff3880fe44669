"""The peaks that labels tell: recovered from forces, left at the file's where nothing came near them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from split_cli.control.grip import PeakShift, learned_grip
from split_cli.control.learner import learning_region
from split_cli.control.residual import PredictorResidual
from split_cli.learning.cells import empty_set
from split_cli.learning.features import Z2, FeatureSet
from split_cli.learning.kernel import Kernel
from split_cli.learning.region import build_grid
from split_cli.vehicle.parameters import EffectSpec, read_vehicle
from split_cli.vehicle.tire import lateral_force

CAR = read_vehicle(Path(__file__).resolve().parents[2] / "sample_logs" / "road_car.yaml")


def labels(reach: float, scales=(0.86, 0.94), count: int = 800):
    """Return z and y of a car whose peaks are `scales` of the file's, with the noise of usual sensors."""
    rng = np.random.default_rng(4)
    z = np.stack(
        [reach * rng.uniform(-1, 1, count), 0.8 * reach * rng.uniform(-1, 1, count), rng.uniform(-0.5, 0.4, count)],
        axis=1,
    )
    missing = []
    for tire, alpha, s in zip((CAR.front_tire, CAR.rear_tire), z.T, scales, strict=False):
        true = s * lateral_force(tire.B / s, tire.C, tire.D, alpha)
        missing.append(true - lateral_force(tire.B, tire.C, tire.D, alpha))
    front, rear = missing
    y = np.stack(
        [
            np.zeros(count),
            (front + rear) / CAR.mass,
            (CAR.cg_to_front_axle * front - CAR.cg_to_rear_axle * rear) / CAR.yaw_inertia,
        ],
        axis=1,
    )
    return z, y + rng.normal(0.0, [0.23, 0.23, 0.04], (count, 3))


def test_peaks_are_recovered_from_labels_near_them():
    found = learned_grip(CAR, Z2, *labels(0.15))
    # A tenth of a metre a second squared of noise a label leaves about one per cent; the nearest to 1 is taken.
    assert found == pytest.approx([0.86, 0.94], abs=0.03)
    assert (found >= [0.85, 0.93]).all()


def test_what_is_told_of_a_road_is_believed_as_far_as_labels_allow():
    # Of the peaks that fit the same labels the one nearest to the told one is taken, from either side.
    from_above, from_below = (learned_grip(CAR, Z2, *labels(0.08), assumed=assumed) for assumed in (1.0, 0.5))
    assert (from_below < from_above - 0.02).all()
    assert from_below == pytest.approx([0.86, 0.94], abs=0.025) and (from_above > [0.86, 0.94]).all()
    z, y = labels(0.08)
    assert learned_grip(CAR, Z2, z[:0], y[:0], assumed=0.5).tolist() == [0.5, 0.5]


def test_gentle_driving_leaves_the_file_as_it_is():
    assert learned_grip(CAR, Z2, *labels(0.02)).tolist() == [1.0, 1.0]


def test_what_cannot_tell_the_peak_does_not():
    z, y = labels(0.15)
    assert learned_grip(CAR, FeatureSet(("vx", "vy", "r")), z, y).tolist() == [1.0, 1.0]
    corrected = CAR.with_effects(EffectSpec("friction_scale", {"scale": 0.9}))
    assert learned_grip(corrected, Z2, z, y).tolist() == [1.0, 1.0]
    # A lag leaves the tyres as they are.
    late = CAR.with_effects(EffectSpec("steer_lag", {"tau": 0.05}))
    assert learned_grip(late, Z2, z, y)[0] < 0.9
    assert learned_grip(CAR, Z2, z[:0], y[:0]).tolist() == [1.0, 1.0]


def test_moved_peaks_leave_out_what_labels_of_them_say():
    z, y = labels(0.15, count=50)
    shift = PeakShift(CAR, Z2, np.array([0.86, 0.94]))
    mean, slope = shift.at(z)
    # The same forces the other way round: labels of moved peaks are what the shift says, but for their noise.
    assert np.sqrt(np.mean(np.square(y - mean), axis=0)) == pytest.approx([0.23, 0.23, 0.04], rel=0.35)
    assert np.abs(mean[:, 1]).max() > 0.5
    step = 1e-6
    for column in range(2):
        moved = z.copy()
        moved[:, column] += step
        assert slope[:, :, column] == pytest.approx((shift.at(moved)[0] - mean) / step, abs=1e-4)
    assert not slope[:, :, 2].any()


def half_grip_set():
    """Return a set of a road with half the grip, exact labels, and the shift of its peaks."""
    scales = np.array([0.5, 0.5])
    z, _ = labels(0.1, count=150)
    shift = PeakShift(CAR, Z2, scales)
    region = learning_region(CAR, 0.18, 0.10, 1.2)
    grid = build_grid(Z2, CAR, region)
    kernel = Kernel(2.0 * np.array(grid.edges), np.array([0.1, 4.0, 3.0]), np.array([0.05, 0.05, 0.002]))
    blank = empty_set(CAR, Z2, region, grid, kernel, horizon=0.05)
    rng = np.random.default_rng(5)
    y = 1.1 * shift.at(z)[0] + 0.1 * rng.normal(size=z.shape)  # forces that the shift alone does not explain
    number = np.zeros(len(z))
    return replace(
        blank,
        z=z,
        y=y,
        cell_numbers=np.array([0]),
        offsets=np.array([0, len(z)]),
        gamma=number,
        t=number,
        source=number.astype(np.int16),
        row=np.arange(len(z)),
        capacity=len(z),
    ), shift


def test_the_prior_mean_is_that_of_a_dense_process():
    known, shift = half_grip_set()
    residual = PredictorResidual(known, "full")
    plain = residual.along(known.z)
    rng = np.random.default_rng(6)
    z = np.concatenate([known.z[:20], 0.2 * rng.normal(size=(30, 3))])
    residual.rest_on(shift)
    found, kernel = residual.along(z), known.kernel
    for o in range(3):
        variance, noise = kernel.signal_variance[o], kernel.noise_variance[o]
        K = variance * kernel.correlation(known.z, known.z) + noise * np.eye(known.size)
        cross = variance * kernel.correlation(z, known.z)
        beyond = known.y[:, o] - shift.at(known.z)[0][:, o]
        expected = shift.at(z)[0][:, o] + cross @ np.linalg.solve(K, beyond)
        assert found.mean[:, o] == pytest.approx(expected, abs=1e-6)
    far = np.array([[0.14, -0.14, 30.0]])
    assert residual.along(far).mean == pytest.approx(shift.at(far)[0])
    assert residual.along(far).slope == pytest.approx(shift.at(far)[1])
    residual.rest_on(None)
    assert residual.along(known.z).mean == pytest.approx(plain.mean)


def test_on_half_the_grip_the_slope_is_that_of_the_mean_at_the_edge_of_the_data():
    known, shift = half_grip_set()
    z = np.stack([np.linspace(0.08, 0.14, 20), np.linspace(0.07, 0.11, 20), np.full(20, -0.45)], axis=1)
    off = {}
    for name, prior in (("zero", None), ("shift", shift)):
        residual = PredictorResidual(known, "full")
        residual.rest_on(prior)
        step = np.array([1e-5, 0.0, 0.0])
        steepness = (residual.along(z + step).mean - residual.along(z - step).mean)[:, 1] / 2e-5
        off[name] = np.abs(residual.along(z).slope[:, 1, 0] - steepness).max()
    # Damping takes a share of a slope: of all that half the grip leaves out, or of what the shift leaves of it.
    assert off["shift"] < 0.5 * off["zero"] and off["zero"] > 5.0
