"""The dense process through few of its points: what a table is filled from, whatever the size of the set."""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpstrf

from split_cli.learning.kernel import Kernel
from split_cli.prediction.factorization import most_informative

#: Points that span the process [1]; a decomposition of that order takes seconds. Sets of fewer are used whole.
MOST_INDUCING = 2000
_CHUNK = 2048
#: Points of smaller gain span nothing of their own in double precision: K_uu then keeps half its digits.
_REDUNDANT = 1e-8
_UNINFORMED = 1e-5
#: Largest set whose correlation matrix is made whole: 6,000 squared numbers are 288 MB.
_WHOLE_MATRIX = 6000


class BatchProcess:
    """All labels, projected on the most informative points; with every point chosen, the dense process.

    Parameters
    ----------
    z : ndarray, shape (N, D)
    y : ndarray, shape (N, 3)
    most : int
        Largest number of points U to project on.

    Attributes
    ----------
    rank : int
        Points projected on.

    Notes
    -----
    Seeger, Williams and Lawrence, Fast forward selection to speed up sparse Gaussian process regression, AISTATS
    2003. With L L^T = C_uu, V = L^-1 C_uf and the eigenvalues V V^T = E diag(lambda) E^T, a query's coordinates
    are t = E^T L^-1 c_u; mean = sum_e t_e (E^T V y)_e/(lambda_e + rho), and the share of the signal variance that
    is known sum_e t_e^2 lambda_e/(lambda_e + rho). One decomposition serves the three outputs. What the chosen
    points do not span stays unknown, so that the variance is never smaller than the dense one by more than
    rounding.
    """

    def __init__(self, z: np.ndarray, y: np.ndarray, kernel: Kernel, most: int = MOST_INDUCING) -> None:
        self.kernel = kernel
        rows, factor = _chosen(z, kernel, most)
        self._points = z[rows] / kernel.length_scales
        self._squares = 0.5 * np.square(self._points).sum(axis=1)
        self.rank = len(rows)
        gram, right = np.zeros((self.rank, self.rank)), np.zeros((self.rank, y.shape[1]))
        for begin in range(0, len(z), _CHUNK):
            some = slice(begin, begin + _CHUNK)
            projected = solve_triangular(factor, self._cross(z[some]), lower=True)
            gram += projected @ projected.T
            right += projected @ y[some]
        values, vectors = np.linalg.eigh(gram)
        values = np.maximum(values, 0.0)  # a Gram matrix has no negative ones but by rounding
        turn = solve_triangular(factor, vectors, lower=True, trans=1).T
        ratio = kernel.noise_variance / kernel.signal_variance
        damped = values[:, None] + ratio
        self._weights = turn.T @ (vectors.T @ right / damped)
        # As sum t_e^2 <= 1, directions of a share below 1e-5 change the known share by less than that.
        informed = values > _UNINFORMED * ratio.min()
        self._turn, self._shares = np.ascontiguousarray(turn[informed]), (values[:, None] / damped)[informed]

    def mean_and_known(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean (N, 3) and the share of the signal variance that is known (N, 3), 0 at the prior."""
        mean, known = np.empty((2, len(z), self._weights.shape[1]))
        for begin in range(0, len(z), _CHUNK):
            some = slice(begin, begin + _CHUNK)
            cross = self._cross(z[some])
            mean[some] = cross.T @ self._weights
            known[some] = np.square(self._turn @ cross).T @ self._shares
        return mean, np.clip(known, 0.0, 1.0)

    def _cross(self, z: np.ndarray) -> np.ndarray:
        """Return correlations with the chosen points, shape (rank, N), by one matrix product.

        Expanding the square costs about 1e-14 of a correlation; a table is filled to 1e-3.
        """
        scaled = z / self.kernel.length_scales
        exponent = self._points @ scaled.T
        exponent -= self._squares[:, None]
        exponent -= 0.5 * np.square(scaled).sum(axis=1)
        correlation: np.ndarray = np.exp(exponent, out=exponent)
        return correlation


def _chosen(z: np.ndarray, kernel: Kernel, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of largest gain one after another, and the Cholesky factor of their correlations.

    Pivoted Cholesky is that selection; LAPACK's is the faster one while the whole matrix fits.
    """
    if len(z) > _WHOLE_MATRIX:
        rows, _ = most_informative(z, kernel.length_scales, most, threshold=_REDUNDANT)
        return rows, np.linalg.cholesky(kernel.correlation(z[rows], z[rows]))
    factor, pivots, rank, _ = dpstrf(kernel.correlation(z, z), tol=_REDUNDANT, lower=1, overwrite_a=1)
    rank = min(int(rank), most)
    return pivots[:rank] - 1, np.tril(factor[:rank, :rank])
