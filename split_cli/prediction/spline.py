"""A tricubic B-spline over a box of three features: nodes, coefficients, and zero outside."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded

from split_cli.prediction import _compiled

#: Coefficients that are 0 on each side of an axis, so that a query beyond the box meets nothing else.
PADDING = 3


@dataclass(frozen=True)
class Lattice:
    """Nodes at whole multiples of a spacing, so that a lattice over a larger box has the same nodes."""

    spacing: np.ndarray  # (3,): in the features' units
    first: np.ndarray  # int64 (3,): number of the first node an axis; node n lies at n times the spacing
    shape: tuple[int, int, int]  # nodes an axis

    @property
    def size(self) -> int:
        """Number of nodes."""
        return int(np.prod(self.shape))

    def axes(self) -> tuple[np.ndarray, ...]:
        """Return the nodes' places along each axis."""
        return tuple(
            (first + np.arange(count)) * step
            for first, count, step in zip(self.first, self.shape, self.spacing, strict=True)
        )

    def nodes(self) -> np.ndarray:
        """Return all nodes, shape (size, 3), last axis fastest."""
        return np.stack(np.meshgrid(*self.axes(), indexing="ij"), axis=-1).reshape(-1, 3)


def lattice_over(lower: np.ndarray, upper: np.ndarray, spacing: np.ndarray) -> Lattice:
    """Return the lattice over the box from `lower` to `upper`, shape (3,) each, rounded outwards."""
    first = np.floor(lower / spacing).astype(np.int64)
    last = np.ceil(upper / spacing).astype(np.int64)
    return Lattice(np.asarray(spacing, dtype=float), first, tuple((last - first + 1).tolist()))


@dataclass(frozen=True)
class Spline:
    """Values s(z) = sum of coefficients times products of cubic B-splines; twice continuously differentiable."""

    origin: np.ndarray  # (3,): place of the first coefficient
    spacing: np.ndarray  # (3,)
    # (n0, n1, n2, W), in units of `unit`: the outer `PADDING` of each axis are 0, so that s is 0 outside the box.
    coefficients: np.ndarray
    unit: np.ndarray  # (W,)

    def value(self, z: np.ndarray) -> np.ndarray:
        """Return the values at `z` (N, 3), shape (N, W); NaN where a query is not a number."""
        values = _compiled.spline(z, self.origin, 1.0 / self.spacing, self.coefficients, False)[0]
        scaled: np.ndarray = values * self.unit
        return scaled

    def value_and_slope(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values (N, W) and their derivatives (N, W, 3)."""
        values, slopes = _compiled.spline(z, self.origin, 1.0 / self.spacing, self.coefficients, True)
        return values * self.unit, slopes * self.unit[:, None]

    def in_integers(self) -> "Spline":
        """Return the spline with coefficients of 16 bits; no value moves by more than half a unit.

        The unit of an output is its largest coefficient over 32767. B-splines are positive and add up to 1, so the
        rounding of a value is a mean of the coefficients' roundings.
        """
        largest = np.abs(self.coefficients * self.unit).max(axis=(0, 1, 2))
        unit = np.where(largest > 0.0, largest, 1.0) / np.iinfo(np.int16).max
        whole = np.rint(self.coefficients * (self.unit / unit)).astype(np.int16)
        return Spline(self.origin, self.spacing, whole, unit)


def fit_spline(lattice: Lattice, values: np.ndarray) -> Spline:
    """Return the spline that takes `values`, shape (size, W), at the nodes and is 0 beyond the padding.

    Notes
    -----
    A cubic B-spline at a node is c_(i-1)/6 + 4 c_i/6 + c_(i+1)/6: one tridiagonal system an axis, with
    coefficients outside the lattice 0. Interpolation of a smooth function is of fourth order in the spacing.
    """
    table = values.reshape(*lattice.shape, -1)
    for axis, count in enumerate(lattice.shape):
        bands = np.full((3, count), 1.0 / 6.0)
        bands[1] = 4.0 / 6.0
        lines = np.moveaxis(table, axis, 0)
        solved = solve_banded((1, 1), bands, lines.reshape(count, -1), check_finite=False)
        table = np.moveaxis(solved.reshape(lines.shape), 0, axis)
    padded: np.ndarray = np.pad(table, [(PADDING, PADDING)] * 3 + [(0, 0)])
    origin = (lattice.first - PADDING) * lattice.spacing
    return Spline(origin, lattice.spacing, np.ascontiguousarray(padded), np.ones(padded.shape[3]))


def smooth_step(position: np.ndarray) -> np.ndarray:
    """Return 0 below 0, 1 above 1, and between them the quintic with two derivatives 0 at both ends."""
    x = np.clip(position, 0.0, 1.0)
    smooth: np.ndarray = x * x * x * (10.0 + x * (6.0 * x - 15.0))
    return smooth
