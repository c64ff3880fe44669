"""The peaks that labels tell: recovered from forces, left at the file's where nothing came near them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from split_cli.control.grip import PeakShift, learned_grip
from split_cli.control.residual import Residual, ResidualValues
from split_cli.learning.features import Z2, FeatureSet
from split_cli.vehicle.parameters import EffectSpec, read_vehicle
from split_cli.vehicle.tire import lateral_force

CAR = read_vehicle(Path(__file__).resolve().parents[2] / "sample_logs" / "road_car.yaml")


def labels(reach: float, scales=(0.86, 0.94), count: int = 800):
    """Return z and y of a car whose peaks are `scales` of the file's, with the noise of usual sensors."""
    rng = np.random.default_rng(4)
    z = np.stack([reach * rng.uniform(-1, 1, count), 0.8 * reach * rng.uniform(-1, 1, count),
                  rng.uniform(-0.5, 0.4, count)], axis=1)  # fmt: skip
    missing = []
    for tire, alpha, s in zip((CAR.front_tire, CAR.rear_tire), z.T, scales, strict=False):
        true = s * lateral_force(tire.B / s, tire.C, tire.D, alpha)
        missing.append(true - lateral_force(tire.B, tire.C, tire.D, alpha))
    front, rear = missing
    y = np.stack([
        np.zeros(count),
        (front + rear) / CAR.mass,
        (CAR.cg_to_front_axle * front - CAR.cg_to_rear_axle * rear) / CAR.yaw_inertia,
    ], axis=1)  # fmt: skip
    return z, y + rng.normal(0.0, [0.23, 0.23, 0.04], (count, 3))


def test_peaks_are_recovered_from_labels_near_them():
    found = learned_grip(CAR, Z2, *labels(0.15))
    # A tenth of a metre a second squared of noise a label leaves about one per cent; the nearest to 1 is taken.
    assert found == pytest.approx([0.86, 0.94], abs=0.03)
    assert (found >= [0.85, 0.93]).all()


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


class Known(Residual):
    """Half a metre a second squared wherever `share` of the label is known."""

    def __init__(self, share: float) -> None:
        self.share = share

    def of_data(self, z):
        full = np.full((len(z), 3), 1.0)
        return ResidualValues(0.5 * self.share * full, np.zeros((len(z), 3, z.shape[1])), 1.0 - self.share * full,
                              self.share * full)  # fmt: skip


def test_where_nothing_is_known_the_moved_peaks_speak_and_where_all_is_known_the_data():
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
    for share in (0.0, 0.3, 1.0):
        residual = Known(share)
        plain = residual.along(z)
        residual.peak = shift
        found = residual.along(z)
        assert found.mean == pytest.approx(plain.mean + (1.0 - share) * mean)
        assert found.slope == pytest.approx((1.0 - share) * slope)
        assert (found.variance == plain.variance).all()
