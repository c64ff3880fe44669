"""Properties of labels and learning that hold for any driving: mirrors, copies, units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from split_cli.learning.cells import learn
from split_cli.learning.features import parse_features
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.region import Region
from split_cli.prediction import make_predictor
from tests.factories import make_drive, make_training_set, road_car

SEEDS = st.integers(0, 2**31 - 1)
MIRRORED = ("vy", "r", "delta", "Y", "yaw", "ay")


def some_labels(seed: int, segments: int = 3) -> Labels:
    drive = make_drive(seed, segments=segments, seconds=2.0, vehicle=road_car())
    return compute_labels(drive, road_car(), parse_features("z2"), Region.of(road_car()), horizon=0.05)


def learned(labels: list[Labels], **over):
    base = make_training_set(points=20)
    return learn(labels, vehicle=road_car(), grid=base.grid, kernel=base.kernel, **over)


@settings(max_examples=3, deadline=None, derandomize=True)
@given(SEEDS)
def test_labels_of_mirrored_driving_are_mirrored(seed):
    drive = make_drive(seed, segments=2, seconds=2.0, vehicle=road_car())
    columns = {name: -v if name in MIRRORED else v for name, v in drive.columns.items()}
    z2, region = parse_features("z2"), Region.of(road_car())
    one = compute_labels(drive, road_car(), z2, region, horizon=0.05)
    other = compute_labels(replace(drive, columns=columns), road_car(), z2, region, horizon=0.05)
    assert np.array_equal(one.reason, other.reason)
    # Slip angles and lateral outputs turn their sign, torque and longitudinal output do not; to rounding.
    np.testing.assert_allclose(other.z, one.z * [-1, -1, 1], atol=1e-12)
    np.testing.assert_allclose(other.y, one.y * [1, -1, -1], atol=1e-9)


@settings(max_examples=3, deadline=None, derandomize=True)
@given(SEEDS)
def test_a_sample_that_comes_twice_is_kept_once(seed):
    labels = some_labels(seed)
    once, twice = learned([labels], capacity=200), learned([labels, labels], capacity=200)
    assert once.size == twice.size
    np.testing.assert_array_equal(once.z, twice.z)


@settings(max_examples=3, deadline=None, derandomize=True)
@given(SEEDS, st.sampled_from([1e-3, 0.3048, 3.6, 1e3]))
def test_a_change_of_unit_changes_answers_by_that_unit(seed, factor):
    base = make_training_set(seed=seed % 1000, points=120)
    k = base.kernel
    signal, noise = k.signal_variance * factor**2, k.noise_variance * factor**2
    scaled = replace(base, y=base.y * factor, kernel=Kernel(k.length_scales, signal, noise, origin=k.origin))
    queries = base.z[:30] + 0.003
    for name in ("full", "rbcm"):
        one, other = make_predictor(name, base).predict(queries), make_predictor(name, scaled).predict(queries)
        np.testing.assert_allclose(other.mean, one.mean * factor, rtol=1e-7, atol=1e-9 * factor)
        np.testing.assert_allclose(other.variance, one.variance * factor**2, rtol=1e-7)
