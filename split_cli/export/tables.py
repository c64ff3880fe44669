"""What an exported committee evaluates: points, eigenvectors and weights of every cell, far cells bounded."""

from dataclasses import asdict, dataclass

import numpy as np

from split_cli.errors import ExportError
from split_cli.export.projection import ProjectionData, digest_of
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.bcm import committee_tables
from split_cli.prediction.table import TablePredictor

SKIP_TOLERANCE = {"double": 1e-13, "float": 1e-6}
"""Bound on what skipping far cells may change, in signal deviations (mean) and signal variances."""


@dataclass(frozen=True)
class BcmTables:
    """Constants of the Bayesian committee machine, cells in ascending number, points in slot order.

    Notes
    -----
    With c(z) the correlations between query and points of a cell, t = V^T c, x = sum t_j^2 gain_j and
    m = sum t_j weight_j: q/S0 = x and the expert's mean is m, hence precision P = 1 + sum x/(1 - x) in units of
    1/S0, mean = (sum m/(1 - x))/P and variance = S0/P. It is the paper's BCM, eq. of the aggregated mean and
    covariance, in the form that does not cancel. One set of eigenvectors serves all outputs since they share
    length scales, at less than a half of three inverses' work; and rounding of t is amplified by
    1/sqrt(rho) only, where an inverse amplifies it by 1/rho, which is what makes single precision usable.

    A cell whose points are all at least `d` scaled lengths away has x <= n exp(-d^2)/(lambda_min + rho) = X and
    |m| <= sqrt(S0 x h), h = y^T (K + s^2 I)^-1 y. Leaving it out moves the variance by at most S0 X/(1 - X) and
    the mean by at most sqrt(S0) (sqrt(X h) + H X)/(1 - X), H the sum of sqrt(h) over all cells, since
    |mean| <= sqrt(S0) H. `reach` makes the sum over all cells stay below `skip_tolerance`.
    """

    real: str  # {"double", "float"} Precision the tables are rounded to (they are stored as float64 all the same)
    length_scales: np.ndarray  # (D,)
    signal_variance: np.ndarray  # (3,): S0
    noise_ratio: np.ndarray  # (3,): rho = s^2/S0
    trust: np.ndarray  # (3,): tau, the share of the correction that is applied
    doubt: np.ndarray  # (3,): w, the variance of what is not trusted; `learning.trust.Trust` says what is answered
    offsets: np.ndarray  # int64 (C + 1,): points of cell c are rows ``offsets[c]:offsets[c + 1]``
    reference: np.ndarray  # (C, D): a place in the cell, in feature units; exactly representable in `real`
    points: np.ndarray  # (P, D): points relative to their cell's reference, divided by the length scales
    # (sum of n^2,): V of each cell's correlation matrix, row-major, column j an eigenvector.
    eigenvectors: np.ndarray
    gains: np.ndarray  # (P, 3): 1/(lambda_j + rho), row j the eigenvector j of the point's cell
    weights: np.ndarray  # (P, 3): (V^T y)_j/(lambda_j + rho)
    reach: np.ndarray  # (C,): squared scaled distance from the reference beyond which a cell is skipped
    skip_tolerance: float
    # Whether an expert counts by b = log(1/(1 - x))/2 (`rbcm`). The bound of `reach` holds all the more, since b
    # is below 1 where x is below a half.
    robust: bool = False

    @property
    def cell_count(self) -> int:
        """C."""
        return len(self.reference)

    @property
    def feature_count(self) -> int:
        """D."""
        return len(self.length_scales)

    @property
    def largest_cell(self) -> int:
        """Most points a cell has."""
        return int(np.diff(self.offsets).max())

    @property
    def square_offsets(self) -> np.ndarray:
        """Start of each cell's matrix in `eigenvectors`, int64 shape (C + 1,)."""
        return np.concatenate([[0], np.cumsum(np.diff(self.offsets) ** 2)]).astype(np.int64)

    def digest(self) -> str:
        """Return the SHA-256 of every number in the tables."""
        names = (
            "length_scales",
            "signal_variance",
            "noise_ratio",
            "trust",
            "doubt",
            "offsets",
            "reference",
            "points",
            "eigenvectors",
            "gains",
            "weights",
            "reach",
        )
        what = self.real + (" robust" if self.robust else "")
        return digest_of(what, (getattr(self, name) for name in names))


@dataclass(frozen=True)
class TableData:
    """Constants of a tricubic B-spline of mean and deviation; see `prediction.table`."""

    real: str  # {"double", "float"} Precision the numbers are rounded to (they are stored as float64 all the same)
    # origin, spacing: (3,): place of the first coefficient and distance of the nodes, in feature units.
    origin: np.ndarray
    spacing: np.ndarray
    # int16 (n0, n1, n2, 6): of the mean and of 1 - deviation/prior deviation, in units of `unit`; three layers of
    # zeros on every side.
    coefficients: np.ndarray
    unit: np.ndarray  # (6,)
    # signal_variance, least: (3,): S0, and the smallest deviation as a share of the prior's.
    signal_variance: np.ndarray
    least: np.ndarray
    trust: np.ndarray  # (3,): tau, the share of the correction that is applied
    doubt: np.ndarray  # (3,): w, the variance of what is not trusted
    error: dict[str, float]  # bound and measured errors of the spacing, as `prediction.table.TableError`

    @property
    def feature_count(self) -> int:
        """D, always 3."""
        return 3

    def digest(self) -> str:
        """Return the SHA-256 of every number in the table."""
        names = ("origin", "spacing", "coefficients", "unit", "signal_variance", "least", "trust", "doubt")
        return digest_of(self.real, (getattr(self, name) for name in names))


#: What an export evaluates.
Constants = BcmTables | TableData | ProjectionData


def table_data(table: TablePredictor, real: str = "double") -> TableData:
    """Return a table's constants, rounded to `real`."""
    precision = np.float32 if real == "float" else np.float64
    spline, kernel = table.spline, table.training_set.kernel
    reals = {
        "origin": spline.origin,
        "spacing": spline.spacing,
        "unit": spline.unit,
        "signal_variance": kernel.signal_variance,
        "least": table.least,
        "trust": table.training_set.trust.array,
        "doubt": table.training_set.trust.doubts(kernel.signal_variance),
    }
    rounded = {name: np.asarray(values).astype(precision).astype(float) for name, values in reals.items()}
    return TableData(real=real, error=asdict(table.error), coefficients=spline.coefficients, **rounded)


@dataclass(frozen=True)
class Lines:
    """A table's coefficients without what is 0 along the last axis, four nodes of zeros around every stretch."""

    nodes: np.ndarray  # int16 (K, 6): of the lines that hold anything, one after the other
    # int64 (n0 n1,), for each line of n2 nodes: where in `nodes` the stretch begins, its first node's number in
    # the line, and how many nodes it has. A line of zeros has -4, which keeps a query in the zeros before it.
    begin: np.ndarray
    lowest: np.ndarray
    length: np.ndarray


def lines_of(coefficients: np.ndarray) -> Lines:
    """Return what a table needs to store, shape (n0, n1, n2, 6) given."""
    whole = coefficients.reshape(-1, *coefficients.shape[2:])
    filled: np.ndarray = np.any(whole, axis=2)
    some: np.ndarray = np.any(filled, axis=1)
    lowest = np.where(some, filled.argmax(axis=1), 0)
    length = np.where(some, filled.shape[1] - filled[:, ::-1].argmax(axis=1) - lowest, -4)
    begin = np.where(some, 4 + np.cumsum(length + 4) - (length + 4), 4)
    zeros = np.zeros((4, coefficients.shape[3]), dtype=coefficients.dtype)
    parts = [zeros]
    for line in np.flatnonzero(some):
        parts += [whole[line, lowest[line] : lowest[line] + length[line]], zeros]
    return Lines(np.concatenate(parts), begin, lowest, length)


def require_usable(training_set: TrainingSet) -> None:
    """Refuse a set that holds nothing to export.

    Raises
    ------
    ExportError
        If the set is empty or holds non-finite numbers.
    """
    if training_set.size == 0:
        advice = "Train it on a drive first."
        raise ExportError("the trained set is empty, there is nothing to export", advice=advice)
    for name in ("z", "y"):
        if not np.isfinite(getattr(training_set, name)).all():
            raise ExportError(f"the trained set holds non-finite {name}", advice="Run `split verify` on it.")


def build_tables(training_set: TrainingSet, real: str = "double", robust: bool = False) -> BcmTables:
    """Solve every cell once and return the committee's tables.

    Parameters
    ----------
    real : {"double", "float"}
    robust : bool
        For `rbcm`.

    Raises
    ------
    ExportError
        If the set is empty or holds non-finite numbers.
    """
    require_usable(training_set)
    precision = np.float32 if real == "float" else np.float64
    kernel, exact = training_set.kernel, committee_tables(training_set)
    offsets, counts, z = exact.offsets, np.diff(exact.offsets), np.asarray(training_set.z, dtype=float)
    first = offsets[:-1]
    middle = 0.5 * (np.minimum.reduceat(z, first) + np.maximum.reduceat(z, first))
    reference = middle.astype(precision).astype(float)
    points = (z - np.repeat(reference, counts, axis=0)) / kernel.length_scales
    radius = np.sqrt(np.maximum.reduceat(np.square(points).sum(axis=1), first))
    tolerance = SKIP_TOLERANCE[real]
    reach = _reach(radius, counts, exact.smallest, exact.energy, tolerance)
    rounded = {
        "length_scales": kernel.length_scales,
        "signal_variance": kernel.signal_variance,
        "noise_ratio": kernel.noise_variance / kernel.signal_variance,
        "trust": training_set.trust.array,
        "doubt": training_set.trust.doubts(kernel.signal_variance),
        "reference": reference,
        "points": points,
        "eigenvectors": exact.vectors,
        "gains": exact.gains,
        "weights": exact.turned,
    }
    rounded = {name: values.astype(precision).astype(float) for name, values in rounded.items()}
    # Rounded up, so that the bound survives the rounding.
    reach = np.nextafter(reach.astype(precision), precision(np.inf)).astype(float)
    return BcmTables(real=real, offsets=offsets, reach=reach, skip_tolerance=tolerance, robust=robust, **rounded)


def _reach(
    radius: np.ndarray, count: np.ndarray, smallest: np.ndarray, energy: np.ndarray, tolerance: float
) -> np.ndarray:
    """Return the squared distance at which each cell's bound (see `BcmTables`) is its share of `tolerance`."""
    share = tolerance / (4.0 * len(radius))
    total = np.sqrt(energy).sum(axis=0)
    largest = np.minimum(np.minimum(share**2 / np.maximum(energy, 1e-300), share / (1.0 + total)), 0.5)
    farthest = -np.log((largest * smallest / count[:, None]).min(axis=1))
    reach: np.ndarray = (radius + np.sqrt(np.maximum(farthest, 0.0))) ** 2
    return reach
