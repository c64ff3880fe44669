"""Feature sets compared at equal size: the N most informative samples of each, by marginal gain."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from split_cli.learning.cells import empty_set
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import Labels
from split_cli.learning.region import Grid
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.factorization import most_informative
from split_cli.vehicle.parameters import Vehicle

#: Size 0 stands for all training samples, thinned evenly to `MOST_SAMPLES` (the dense process is cubic).
ALL = 0
MOST_SAMPLES = 2000
DEFAULT_SIZES = (50, 100, 200, 500, 1000, ALL)
PAPER_SIZE = 100


def point_set(vehicle: Vehicle, labels: Labels, kernel: Kernel, index: np.ndarray) -> TrainingSet:
    """Return the set that holds exactly the labels at `index`, in one cell, for the dense process.

    Parameters
    ----------
    index : ndarray of int, shape (P,)
    """
    width = len(labels.features.names)
    unbounded = Grid(tuple(2.0 * kernel.length_scales), (-np.inf,) * width, (np.inf,) * width)
    empty = empty_set(
        vehicle, labels.features, labels.region, unbounded, kernel, horizon=labels.horizon, plain=labels.plain
    )
    return replace(
        empty,
        cell_numbers=np.zeros(1, dtype=np.int64),
        offsets=np.array([0, len(index)], dtype=np.int64),
        z=labels.z[index],
        y=labels.y[index],
        gamma=np.ones(len(index)),
        t=labels.t[index],
        source=np.zeros(len(index), dtype=np.int16),
        row=labels.row[index],
    )


def informative_sets(
    vehicle: Vehicle, labels: Labels, kernel: Kernel, sizes: Sequence[int]
) -> list[tuple[int, TrainingSet]]:
    """Return for each size asked for the set of the most informative samples.

    Parameters
    ----------
    labels : Labels
        Candidates; only accepted ones are taken.
    kernel : Kernel
        Its length scales serve the marginal gain and the process alike.
    sizes : sequence of int
        `ALL` for all, the same samples whatever the features. A size larger than what carries information gives a
        smaller set; its true size is ``set.size``.
    """
    accepted = np.flatnonzero(labels.accepted)
    largest = min(max(sizes, default=0), MOST_SAMPLES, len(accepted))
    order, _ = most_informative(labels.z[accepted], kernel.length_scales, largest)
    everything = np.unique(np.linspace(0, len(accepted) - 1, min(MOST_SAMPLES, len(accepted))).astype(int))
    chosen = [everything if size == ALL else order[:size] for size in sizes]
    return [
        (size, point_set(vehicle, labels, kernel, accepted[index])) for size, index in zip(sizes, chosen, strict=True)
    ]
