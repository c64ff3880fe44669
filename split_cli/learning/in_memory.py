"""A set from labels in memory, with hyperparameters fitted to them: for evaluation, notebooks and figures."""

from collections.abc import Sequence

import numpy as np

from split_cli.errors import DriveError
from split_cli.learning.cells import learn
from split_cli.learning.hyperparameters import (
    FEWEST_TO_FIT,
    default_kernel,
    fit_kernel,
    longest_scale,
    scatter_variance,
)
from split_cli.learning.kernel import Kernel
from split_cli.learning.labels import Labels
from split_cli.learning.region import Grid, build_grid
from split_cli.learning.training_set import TrainingSet
from split_cli.vehicle.parameters import Vehicle


def train_in_memory(labels: Sequence[Labels], vehicle: Vehicle) -> TrainingSet:
    """Learn a set from training labels, with hyperparameters fitted to them, see `fitted_grid_and_kernel`."""
    grid, kernel = fitted_grid_and_kernel(labels, vehicle)
    return learn(labels, vehicle=vehicle, grid=grid, kernel=kernel)


def fitted_grid_and_kernel(labels: Sequence[Labels], vehicle: Vehicle, cell_edge: float = 1.0) -> tuple[Grid, Kernel]:
    """Return the grid, its cells `cell_edge` times as long as usual, and the kernel fitted to training labels.

    With fewer than 60 valid labels the defaults stay (the kernel then says so).

    Raises
    ------
    DriveError
        If no label is valid.
    """
    z = np.concatenate([part.z[part.accepted] for part in labels])
    if not len(z):
        advice = "`split label` counts why; look at units and signs with `split info`."
        raise DriveError("no training sample lies inside the valid region", where=labels[0].drive, advice=advice)
    y = np.concatenate([part.y[part.accepted] for part in labels])
    grid = build_grid(labels[0].features, vehicle, labels[0].region, z).coarser(cell_edge)
    kernel = default_kernel(grid, y, scatter_variance(labels[0]))
    if len(z) >= FEWEST_TO_FIT:
        kernel = fit_kernel(z, y, grid, kernel, longest=longest_scale(labels[0].features, grid, z)).kernel
    return grid, kernel
