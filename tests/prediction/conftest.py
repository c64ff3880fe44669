"""Trained sets made in memory from given points, without labels or learning."""

from collections.abc import Callable

import numpy as np
import pytest

from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import Kernel
from split_cli.learning.region import Grid, Region
from split_cli.learning.training_set import TrainingSet
from tests.factories import road_car

CAR = road_car(max_brake_torque=6500.0, rolling_resistance_front=0.0, rolling_resistance_rear=0.0)


def set_from_points(
    z: np.ndarray, y: np.ndarray, kernel: Kernel, cell: np.ndarray | None = None, features: FeatureSet | None = None
) -> TrainingSet:
    """Return a set that holds the points in the cells given (all in one by default), sorted by cell."""
    cell = np.zeros(len(z), dtype=np.int64) if cell is None else np.asarray(cell, dtype=np.int64)
    order = np.argsort(cell, kind="stable")
    numbers, counts = np.unique(cell, return_counts=True)
    width = z.shape[1]
    names = ("alpha_f", "alpha_r", "torque_ratio") if width == 3 else tuple(f"feature{i}" for i in range(width))
    edges = (0.02, 0.02, 0.1) if width == 3 else (1.0,) * width
    return TrainingSet(
        vehicle=CAR,
        features=features or FeatureSet(names),
        region=Region(),
        grid=Grid(edges, (-np.inf,) * width, (np.inf,) * width),
        kernel=kernel,
        horizon=0.05,
        capacity=max(10, int(counts.max(initial=1))),
        threshold=1e-3,
        forgetting=None,
        cell_numbers=numbers,
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        z=z[order],
        y=y[order],
        gamma=np.ones(len(z)),
        t=np.arange(len(z), dtype=float),
        source=np.zeros(len(z), dtype=np.int16),
        row=np.arange(len(z), dtype=np.int64),
    )


@pytest.fixture(scope="session")
def make_set() -> Callable[..., TrainingSet]:
    """Return `set_from_points`."""
    return set_from_points


@pytest.fixture(scope="session")
def driven_set() -> TrainingSet:
    """A set like one lap leaves: 300 cells near the origin of z2, up to ten points each, smooth labels."""
    random = np.random.default_rng(5)
    edges = np.array([0.02, 0.02, 0.1])
    index = np.unique(np.round(random.normal(0.0, [3.0, 3.0, 3.0], (900, 3))).astype(int), axis=0)[:300]
    cell = np.repeat(np.arange(len(index)), random.integers(1, 11, len(index)))
    z = (index[cell] + random.uniform(0.0, 1.0, (len(cell), 3))) * edges
    kernel = Kernel(np.array([0.03, 0.04, 0.2]), np.array([0.3, 0.8, 1.5]), np.array([0.01, 0.02, 0.06]))
    y = np.stack([np.sin(30 * z[:, 0]) * z[:, 2], np.sin(25 * z[:, 0] - 20 * z[:, 1]), 8 * z[:, 1] + z[:, 2]], axis=1)
    y += random.normal(0.0, np.sqrt(kernel.noise_variance), y.shape)
    return set_from_points(z, y, kernel, cell)
