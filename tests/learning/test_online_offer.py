"""One label offered from numbers alone: the set that `extend` makes, and the grid's own cell numbers."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import SetError
from split_cli.learning._compiled import cell_number
from split_cli.learning.cells import extend, without_points
from split_cli.learning.label_sums import SUMS
from split_cli.learning.labels import Reason
from split_cli.learning.online import OnlineSet
from tests.factories import make_labels, make_training_set, valid_features

SAMPLES = 400


@pytest.fixture(scope="module")
def empty():
    return without_points(make_training_set(0, 50))


@pytest.fixture(scope="module")
def labels(empty):
    z = valid_features(empty.vehicle, empty.region, SAMPLES, seed=3)
    made = make_labels(z, np.random.default_rng(3).normal(size=(SAMPLES, 3)), empty.vehicle)
    made.reason[5], made.z[9] = Reason.SPEED, np.nan
    return made


def test_numbers_alone_make_the_set_that_the_labels_make(empty, labels):
    alone, by_label = OnlineSet(empty), OnlineSet(empty)
    for online in (alone, by_label):
        online.begin_drive(labels.drive, labels.start_time)
    for k in range(SAMPLES):
        one = labels.take(slice(k, k + 1))
        change = alone.offer_one(labels.z[k], labels.y[k], labels.t[k], labels.row[k], labels.reason[k])
        assert change == by_label.offer(one)
    offline = extend(empty, [labels])
    for online in (alone, by_label):
        made = online.end_drive(labels.duration)
        for name in ("cell_numbers", "offsets", "z", "y", "gamma", "t", "row", "source", *SUMS):
            assert np.array_equal(getattr(made, name), getattr(offline, name)), name
        for name in ("samples", "accepted", "rejected", "insertions", "replacements"):
            assert getattr(made.sources[0], name) == getattr(offline.sources[0], name), name


def test_the_compiled_cell_number_is_that_of_the_grid(empty):
    grid = empty.grid
    rng = np.random.default_rng(1)
    low, high = np.array(grid.lower), np.array(grid.upper)
    z = low + (high - low) * rng.uniform(-0.1, 1.1, (2000, 3))
    z[:3], z[3], z[4:40, 0] = (low, high, low), np.nan, np.array(grid.edges)[0] * np.arange(-18, 18)
    index, valid = grid.index(z)
    expected = np.where(valid, grid.pack(index), -1)
    assert [cell_number(one, np.zeros(3), grid.table, grid.bits) for one in z] == expected.tolist()
    open_ended = replace(grid, lower=(-np.inf, *grid.lower[1:]), upper=(np.inf, *grid.upper[1:]))
    index, valid = open_ended.index(1e3 * z)
    expected = np.where(valid, open_ended.pack(index), -1)
    assert [cell_number(one, np.zeros(3), open_ended.table, grid.bits) for one in 1e3 * z] == expected.tolist()


def test_a_label_that_is_not_finite_is_not_learned(empty, labels):
    online = OnlineSet(empty)
    with pytest.raises(SetError, match="no drive was begun"):
        online.offer_one(labels.z[0], labels.y[0], 0.0)
    online.begin_drive("lap", 0.0)
    assert online.offer_one(labels.z[0], np.array([0.0, np.nan, 0.0]), 0.0).updates == 0
    assert online.end_drive(1.0).sources[0].rejected == {"non_finite": 1} and online.size == 0
