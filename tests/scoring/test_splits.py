"""Held-out blocks: disjoint, guarded, spread, the same every time."""

import numpy as np
import pytest

from split_cli.errors import DriveError
from split_cli.learning.features import Z2
from split_cli.learning.labels import compute_labels
from split_cli.logs.drive import Drive
from split_cli.scoring.evaluation import HeldOutSamples
from split_cli.scoring.splits import hold_out_blocks, whole_drive
from tests.factories import make_drive, one_run, road_car


def clock(rows: int, period: float = 0.02) -> Drive:
    return one_run({"vx": np.zeros(rows)}, period, "clock")


@pytest.mark.parametrize(
    ("rows", "blocks", "holdout", "guard"),
    [(5000, 10, 0.3, 1.0), (4999, 7, 0.5, 0.0), (3001, 5, 0.2, 0.33), (2000, 2, 0.9, 1.0)],
)
def test_train_and_test_are_apart_by_the_guard(rows, blocks, holdout, guard):
    split = hold_out_blocks(clock(rows), blocks, holdout, guard)
    assert not (split.train & split.test).any()
    tested, trained = np.flatnonzero(split.test), np.flatnonzero(split.train)
    # The distance from each training row to the nearest test row, by brute force.
    after = np.searchsorted(tested, trained)
    gaps = np.minimum(
        np.abs(trained - tested[np.minimum(after, len(tested) - 1)]), np.abs(trained - tested[np.maximum(after - 1, 0)])
    )
    margin = int(np.ceil(guard / 0.02))
    assert gaps.min() == margin + 1
    # Nothing more is thrown away than the guards: every other row trains.
    unused = ~split.train & ~split.test
    assert unused.sum() <= 2 * margin * len(split.held_out)
    assert len(split.held_out) == min(max(1, round(holdout * blocks)), blocks - 1)
    sizes = np.bincount(split.block)
    assert sizes.max() - sizes.min() <= 1


def test_held_out_blocks_are_spread_and_told_in_seconds():
    split = hold_out_blocks(clock(5000), 10, 0.3, 1.0)
    assert split.held_out == (1, 5, 8)  # the middles of thirds of ten blocks
    for (begin, end), block in zip(split.intervals, split.held_out, strict=True):
        assert begin == pytest.approx(block * 10.0)
        assert end == pytest.approx((block + 1) * 10.0 - 0.02)
    again = hold_out_blocks(clock(5000), 10, 0.3, 1.0)
    assert np.array_equal(again.train, split.train)
    assert again.intervals == split.intervals


def test_no_window_of_a_test_label_touches_a_training_row_nor_the_other_way():
    car = road_car()
    drive = make_drive(3, segments=20, seconds=6.0, vehicle=car)
    split = hold_out_blocks(drive, 10, 0.3, 0.5)
    labels = compute_labels(drive, car, Z2, stride=1)
    held = HeldOutSamples(drive, split, labels, labels.z)
    span = np.arange(labels.window + 1)
    tested = labels.row[held.tested][:, None] + span
    trained = labels.within(split.train)
    inside = trained.row[trained.accepted][:, None] + span
    assert split.test[tested].all()
    assert split.train[inside].all()
    # All of them: a label is left out only for its window or because it cannot be computed.
    fits = split.test[np.minimum(labels.row[:, None] + span, len(drive) - 1)].all(axis=1)
    assert len(held.tested) == (fits & np.isfinite(labels.y).all(axis=1)).sum()


@pytest.mark.parametrize(
    ("blocks", "holdout", "guard"), [(1, 0.3, 1.0), (10, 0.0, 1.0), (10, 1.0, 1.0), (10, 0.3, -1.0), (10, 0.3, 20.0)]
)
def test_splits_that_cannot_be_made_are_refused(blocks, holdout, guard):
    with pytest.raises(DriveError, match="clock"):
        hold_out_blocks(clock(1000), blocks, holdout, guard)


def test_a_whole_drive_tests_and_trains_nothing():
    split = whole_drive(clock(100))
    assert split.test.all()
    assert not split.train.any()
    assert split.intervals == ((0.0, pytest.approx(1.98)),)
