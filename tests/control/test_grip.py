"""The peaks that labels tell: recovered from forces, left at the file's where nothing came near them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from split_cli.control.grip import learned_grip
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
