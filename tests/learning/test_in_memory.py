"""A set learned in memory: the same from one part or two, and from few labels with the default kernel."""

import numpy as np
import pytest

from split_cli.errors import DriveError
from split_cli.learning.in_memory import train_in_memory
from split_cli.learning.labels import Labels, Reason
from tests.factories import make_labels, road_car

CAR = road_car()


def planted(count: int) -> Labels:
    """Return labels of a smooth rate over slip angles and torque, with a little noise."""
    rng = np.random.default_rng(7)
    z = rng.uniform(-1.0, 1.0, (count, 3)) * [0.06, 0.06, 0.3]
    smooth = np.stack([z[:, 2], np.sin(20.0 * z[:, 0]), np.cos(20.0 * z[:, 1])], axis=1)
    return make_labels(z, smooth + 0.02 * rng.normal(size=smooth.shape), CAR)


def test_two_parts_give_the_points_that_one_gives():
    whole = planted(240)
    halves = [whole.take(slice(0, 120)), whole.take(slice(120, 240))]
    one, two = train_in_memory([whole], CAR), train_in_memory(halves, CAR)
    assert one.kernel.origin == two.kernel.origin == "fitted"
    np.testing.assert_array_equal(one.z, two.z)
    np.testing.assert_array_equal(one.y, two.y)
    joined = Labels.joined(halves)
    assert all(getattr(joined, name).tobytes() == getattr(whole, name).tobytes() for name in ("t", "row", "z", "y"))


def test_few_labels_keep_the_default_kernel_and_none_are_refused():
    few = planted(30)
    assert train_in_memory([few], CAR).kernel.origin == "default"
    none = make_labels(few.z, few.y, CAR, reason=np.full(len(few), int(Reason.GAP), dtype=np.int8))
    with pytest.raises(DriveError, match="no training sample lies inside the valid region"):
        train_in_memory([none], CAR)
