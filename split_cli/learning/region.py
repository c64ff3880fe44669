"""The valid region of the feature space and the grid of cells it is kept in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from split_cli.errors import DriveError
from split_cli.learning.features import Z2, FeatureSet
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import lateral_force

Z2_EDGES = (0.02, 0.02, 0.1)
_CELLS_A_RANGE = 18


@dataclass(frozen=True)
class Region:
    """Limits of the physically valid region."""

    # p_long, p_ellipse: shape of the force ellipse [1].
    p_long: float = 0.9
    p_ellipse: float = 0.95
    alpha_max: float = 0.18  # largest slip angle [rad]
    dalpha_max: float = 0.10  # largest |alpha_f - alpha_r| [rad]
    minimum_speed: float = 5.0  # [m/s]

    @classmethod
    def of(cls, vehicle: Vehicle, **overrides: float) -> Region:
        """Return the defaults for a vehicle, its minimum speed scaled by the root of the wheelbase."""
        return cls(**{"minimum_speed": vehicle.minimum_speed, **overrides})

    def inside_ellipse(
        self, vehicle: Vehicle, alpha_f: np.ndarray, alpha_r: np.ndarray, torque: np.ndarray
    ) -> np.ndarray:
        """Return whether both axles' nominal forces satisfy (p_long F_x)^2 + F_y^2 <= (p_ellipse D)^2, shape (N,).

        SPLIT paper, the tire forces constraint.
        """
        kappa = np.where(torque < 0.0, vehicle.brake_split_front, vehicle.drive_split_front)
        force = torque / vehicle.wheel_radius
        inside = np.ones(np.shape(torque), dtype=bool)
        for tire, alpha, force_x in (
            (vehicle.front_tire, alpha_f, kappa * force - vehicle.rolling_resistance_front),
            (vehicle.rear_tire, alpha_r, (1.0 - kappa) * force - vehicle.rolling_resistance_rear),
        ):
            force_y = lateral_force(tire.B, tire.C, tire.D, alpha)
            inside &= (self.p_long * force_x) ** 2 + force_y**2 <= (self.p_ellipse * tire.D) ** 2
        return inside

    def inside_slip(self, alpha_f: np.ndarray, alpha_r: np.ndarray) -> np.ndarray:
        """Return whether both slip angles are within alpha_max, shape (N,)."""
        inside: np.ndarray = (np.abs(alpha_f) <= self.alpha_max) & (np.abs(alpha_r) <= self.alpha_max)
        return inside

    def inside_slip_difference(self, alpha_f: np.ndarray, alpha_r: np.ndarray) -> np.ndarray:
        """Return whether |alpha_f - alpha_r| is within dalpha_max, shape (N,)."""
        inside: np.ndarray = np.abs(alpha_f - alpha_r) <= self.dalpha_max
        return inside


@dataclass(frozen=True)
class Grid:
    """Cells of equal edges: index floor(z/edge), half-open, the last cell of a bounded feature closed."""

    edges: tuple[float, ...]  # cell edge a feature, in the feature's unit
    # lower, upper: bounds a feature; infinite where there are none. A sample outside has no cell.
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def coarser(self, factor: float) -> Grid:
        """Return the grid with edges of `factor` times the length; bounds stay."""
        return Grid(tuple(factor * edge for edge in self.edges), self.lower, self.upper)

    @property
    def size(self) -> float:
        """Number of cells between the bounds of those features that have bounds."""
        edges, lower, upper = self._arrays
        bounded = np.isfinite(upper - lower)
        with np.errstate(over="ignore"):
            return float(np.prod(((upper - lower) / edges)[bounded]))

    @property
    def bits(self) -> int:
        """Bits of a cell number each feature's index takes."""
        return 62 // len(self.edges)

    @cached_property
    def _arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Edges and bounds, shape (D,) each: asked for with every sample while driving."""
        return np.array(self.edges), np.array(self.lower), np.array(self.upper)

    @cached_property
    def first(self) -> np.ndarray:
        """Index of each feature's first cell, shape (D,); minus infinity where there is no bound."""
        index: np.ndarray = np.floor(np.array(self.lower) / np.array(self.edges) + 1e-9)
        return index

    @cached_property
    def last(self) -> np.ndarray:
        """Index of each feature's last cell, shape (D,); infinity where there is no bound."""
        index: np.ndarray = np.ceil(np.array(self.upper) / np.array(self.edges) - 1e-9) - 1.0
        return index

    @cached_property
    def table(self) -> np.ndarray:
        """Edges, lower and upper bounds, first and last index, shape (5, D): for compiled code."""
        return np.stack([*self._arrays, self.first, self.last])

    def index(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the cell index a feature, int64 shape (N, D), and whether the sample has a cell, shape (N,)."""
        z = np.asarray(z, dtype=float)
        edges, lower, upper = self._arrays
        half = 1 << (self.bits - 1)
        with np.errstate(invalid="ignore", over="ignore"):
            position = np.floor(z / edges)
            # A value on the upper bound belongs to the cell below it: the last cell is closed. At the lower bound
            # the division may round into a cell that is not there.
            within = (z >= lower) & (z <= upper)
            position = np.where(within, np.minimum(np.maximum(position, self.first), self.last), position)
            valid = (within & (np.abs(position) < half)).all(axis=1)
        index = np.where(valid[:, None], position, 0.0).astype(np.int64)
        return index, valid

    def pack(self, index: np.ndarray) -> np.ndarray:
        """Return the cell number, int64 shape (N,), of indices (N, D); the first feature is most significant."""
        half = 1 << (self.bits - 1)
        number = np.zeros(len(index), dtype=np.int64)
        for feature in range(index.shape[1]):
            number = (number << self.bits) | (index[:, feature] + half)
        return number

    def unpack(self, number: np.ndarray) -> np.ndarray:
        """Return the indices (N, D) of cell numbers (N,)."""
        number = np.asarray(number, dtype=np.int64).copy()
        half, mask = 1 << (self.bits - 1), (1 << self.bits) - 1
        index = np.empty((len(number), len(self.edges)), dtype=np.int64)
        for feature in range(len(self.edges) - 1, -1, -1):
            index[:, feature] = (number & mask) - half
            number >>= self.bits
        return index

    def centers(self, number: np.ndarray) -> np.ndarray:
        """Return cell centres, shape (N, D), in feature units."""
        centre: np.ndarray = (self.unpack(number) + 0.5) * np.array(self.edges)
        return centre


def z2_grid(vehicle: Vehicle, region: Region) -> Grid:
    """Return the grid over [alpha_f, alpha_r, T/T_max], reaching -max_brake_torque/max_torque."""
    lower = (-region.alpha_max, -region.alpha_max, -vehicle.max_brake_torque / vehicle.max_torque)
    return Grid(Z2_EDGES, lower, (region.alpha_max, region.alpha_max, 1.0))


def build_grid(features: FeatureSet, vehicle: Vehicle, region: Region, z: np.ndarray | None = None) -> Grid:
    """Return the grid for a feature set.

    Parameters
    ----------
    z : ndarray, shape (N, D), optional
        Valid samples of the first drive, from which edges of features outside z2 are taken, once for the life of
        a set; z2 needs none.

    Raises
    ------
    DriveError
        If a feature outside z2 does not vary, or has no valid samples to show its range.

    Notes
    -----
    A feature of z2 keeps its edge and bounds in any list; another one has the edge (99.9 % quantile - 0.1 %
    quantile)/18, as many cells as a slip angle has, and no bounds.
    """
    known = z2_grid(vehicle, region)
    columns = []
    for position, name in enumerate(features.names):
        if name in Z2.names:
            place = Z2.names.index(name)
            columns.append((known.edges[place], known.lower[place], known.upper[place]))
            continue
        if z is None or len(z) == 0:
            raise DriveError(f"no valid samples to take the range of {name} from")
        low, high = np.quantile(z[:, position], [0.001, 0.999])
        if not high - low > 1e-9 * max(abs(low), abs(high), 1e-300):
            advice = "Leave it out of --features."
            raise DriveError(f"the feature {name} does not vary, it is {low:g}", advice=advice)
        columns.append((float(high - low) / _CELLS_A_RANGE, -np.inf, np.inf))
    edges, lower, upper = zip(*columns, strict=True)
    return Grid(edges, lower, upper)


def valid_cells(vehicle: Vehicle, region: Region, grid: Grid) -> np.ndarray:
    """Return the numbers, ascending, of the z2 cells whose centre lies in the valid region, int64 shape (C,).

    Raises
    ------
    ValueError
        If the grid is not a bounded one over the three features of z2.
    """
    if len(grid.edges) != 3 or not np.isfinite([*grid.lower, *grid.upper]).all():
        raise ValueError("valid cells are counted for the bounded grid of z2 only")
    ranges = [np.arange(a, b + 1.0).astype(np.int64) for a, b in zip(grid.first, grid.last, strict=True)]
    index = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3)
    numbers = grid.pack(index)
    alpha_f, alpha_r, ratio = grid.centers(numbers).T
    valid = region.inside_slip(alpha_f, alpha_r) & region.inside_slip_difference(alpha_f, alpha_r)
    valid &= region.inside_ellipse(vehicle, alpha_f, alpha_r, ratio * vehicle.max_torque)
    known: np.ndarray = numbers[valid]
    return known


def valid_cell_count(vehicle: Vehicle, region: Region, grid: Grid) -> int:
    """Return how many z2 cells have their centre in the valid region."""
    return len(valid_cells(vehicle, region, grid))
