"""The trained set: the points each cell kept, and everything needed to predict with them or to go on learning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import Kernel
from split_cli.learning.region import Grid, Region
from split_cli.vehicle.parameters import Vehicle

__all__ = ["SetSource", "TrainingSet"]


@dataclass(frozen=True)
class SetSource:
    """One drive a set was trained on, and what became of its samples.

    Attributes
    ----------
    name, sha256 : str
    samples : int
        Labels offered.
    accepted : int
        Labels inside the valid region.
    rejected : mapping of str to int
        By reason: speed, ellipse, slip, slip_difference, grid, gap, non_finite, gain.
    insertions, replacements : int
        Updates of the set.
    points, cells : int
        Size of the set and non-empty cells after this drive.
    start_time, duration : float
        First time stamp and length of the drive [s]; with forgetting, ages run over the drives one after another.
    """

    name: str
    sha256: str
    samples: int
    accepted: int
    rejected: Mapping[str, int]
    insertions: int
    replacements: int
    points: int
    cells: int
    start_time: float = 0.0
    duration: float = 0.0


@dataclass(frozen=True)
class TrainingSet:
    """A SPLIT training set.

    Attributes
    ----------
    vehicle : Vehicle
    features : FeatureSet
    region : Region
    grid : Grid
    kernel : Kernel
        Of the residual; the marginal gain uses its length scales with unit variance and no noise.
    horizon : float
        Label interval h [s].
    capacity : int
        M, points a cell may keep.
    threshold : float
        Marginal gain a point needs to enter a cell that has room.
    forgetting : float or None
        Time constant of forgetting [s]; None is off.
    cell_numbers : ndarray of int64, shape (C,)
        Non-empty cells, ascending.
    offsets : ndarray of int64, shape (C + 1,)
        Points of cell c are rows ``offsets[c]:offsets[c + 1]``, in slot order.
    z : ndarray, shape (P, D)
    y : ndarray, shape (P, 3)
        Labels [m/s^2], [m/s^2], [rad/s^2].
    gamma : ndarray, shape (P,)
        Marginal gain of a point given the others of its cell.
    t : ndarray, shape (P,)
        Time in its drive [s].
    source : ndarray of int16, shape (P,)
        Index into `sources`.
    row : ndarray of int64, shape (P,)
        Row in its drive.
    sources : tuple of SetSource
    plain : bool
        Whether y are the paper's plain differences, which depend on the horizon: for reproduction only.
    """

    vehicle: Vehicle
    features: FeatureSet
    region: Region
    grid: Grid
    kernel: Kernel
    horizon: float
    capacity: int
    threshold: float
    forgetting: float | None
    cell_numbers: np.ndarray
    offsets: np.ndarray
    z: np.ndarray
    y: np.ndarray
    gamma: np.ndarray
    t: np.ndarray
    source: np.ndarray
    row: np.ndarray
    sources: tuple[SetSource, ...] = ()
    plain: bool = False

    @property
    def size(self) -> int:
        """Number of points."""
        return len(self.z)

    @property
    def cell_count(self) -> int:
        """Number of non-empty cells."""
        return len(self.cell_numbers)
