"""Joint confidence regions of the parameters of one term.

The intervals of front and rear downforce may both contain zero while that of their sum does not. So whether a term has
an effect is decided by the joint region of its parameters, not by the interval of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

_STEPS = 500  # iterations of the search for the point nearest to no effect


@dataclass(frozen=True)
class JointRegion:
    """An ellipsoid that contains the true parameters of a term with a probability of 95 %."""

    names: tuple[str, ...]  # parameters that have a neutral value
    centre: np.ndarray  # (P,): estimates less neutral values, in the parameters' units
    covariance: np.ndarray  # (P, P), in the products of these units
    radius: float  # Mahalanobis distance from the centre to the surface, see `radius_95`

    def moved(self, by: np.ndarray) -> JointRegion:
        """Return the region shifted by a step of the parameters, shape (P,)."""
        return replace(self, centre=self.centre + by)

    def along(self, weights: np.ndarray) -> tuple[float, float]:
        """Return the ends of a weighted sum of the parameters over the region (Scheffe)."""
        middle, half = (float(weights @ self.centre), self.radius * float(np.sqrt(weights @ self.covariance @ weights)))
        return middle - half, middle + half


def radius_95(count: int, freedom: float) -> float:
    """Return the Mahalanobis distance that holds 95 % for `count` parameters: Hotelling's T, Student's t for one.

    Notes
    -----
    With n degrees of freedom, T^2 = p n/(n - p + 1) F_0.95(p, n - p + 1).
    """
    from scipy.stats import f as fisher

    rest = max(freedom - count + 1.0, 1.0)
    return float(np.sqrt(count * freedom / rest * fisher.ppf(0.95, count, rest)))


def least_above(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return a covariance (P, P) that is no smaller than either of two: their maximum along common axes.

    Notes
    -----
    With first = A diag(w) A^T and second = A A^T it is A diag(max(w, 1)) A^T.
    """
    share, back = eigh(first, second)
    axes = np.linalg.inv(back).T
    return (axes * np.maximum(share, 1.0)) @ axes.T


def apart_along(regions: Sequence[JointRegion]) -> np.ndarray | None:
    """Return weights (P,) of a sum of parameters that is positive all over the regions; None if there is none.

    Any of the explanations of the regions, or one between them, may be true. Their convex hull excludes no effect if
    and only if such a sum exists.

    Parameters
    ----------
    regions : sequence of JointRegion
        Of the same parameters; the first belongs to the chosen explanation.

    Notes
    -----
    Gilbert's (1966) algorithm for the point of a convex set nearest to the origin, in coordinates in which the first
    covariance is the unit matrix. With one region it is the Wald test, with the weights V^-1 d.
    """
    root = np.linalg.cholesky(regions[0].covariance)
    shapes = []
    for one in regions:
        half = np.linalg.solve(root, np.linalg.cholesky(one.covariance))
        shapes.append((np.linalg.solve(root, one.centre), half @ half.T, one.radius))
    nearest = shapes[0][0]
    for _ in range(_STEPS):
        if not np.linalg.norm(nearest) > 1e-9:
            return None
        ends = [_lowest(nearest, *shape) for shape in shapes]
        lowest = min(ends, key=lambda end: float(nearest @ end))
        if float(nearest @ lowest) > 0.0:
            return np.linalg.solve(root.T, nearest)
        step = lowest - nearest
        nearest = nearest + np.clip(-(nearest @ step) / max(float(step @ step), 1e-300), 0.0, 1.0) * step
    return None


def _lowest(along: np.ndarray, centre: np.ndarray, covariance: np.ndarray, radius: float) -> np.ndarray:
    """Return the point of an ellipsoid with the smallest product with a direction."""
    spread = covariance @ along
    return centre - radius * spread / max(float(np.sqrt(along @ spread)), 1e-300)
