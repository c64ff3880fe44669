"""The generalised robust committee: every cell's expert shares one set of points with all the others."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.factorization import cholesky, most_informative, queries
from split_cli.prediction.predictor import Prediction, Predictor

#: Points all experts share. Ten times a cell's capacity, so that a shared point costs as much as ten own ones.
DEFAULT_SHARED = 100
_CHUNK = 256


@dataclass(frozen=True)
class _Experts:
    """Cells of one size given the shared points, for one noise ratio.

    rows (C, n) of the points; inverse (C, n, n) of their remaining covariance; weights (C, n, outputs) of it;
    leaning (C, n, S) of the points on the whitened shared ones.
    """

    rows: np.ndarray
    inverse: np.ndarray
    weights: np.ndarray
    leaning: np.ndarray


#: Noise ratio, factor and whitened labels of the shared points, and the experts given them.
_Conditioned = tuple[float, np.ndarray, np.ndarray, list[_Experts]]


class GrbcmPredictor(Predictor):
    """Liu et al.'s committee, which becomes the dense process as the shared points or the one expert hold all.

    Parameters
    ----------
    shared : int
        Points in the communication set: those of greatest marginal gain over the whole set.

    Notes
    -----
    Liu, Cai, Wang and Ong, Generalized robust Bayesian committee machine for large-scale Gaussian process
    regression, ICML 2018, eqs. 9 and 10: with mu_c, v_c of the shared points alone and mu_i, v_i of the shared
    points with a cell's others, 1/v = sum b_i/v_i - (sum b_i - 1)/v_c and mu = v (sum b_i mu_i/v_i -
    (sum b_i - 1) mu_c/v_c), b_1 = 1 and b_i = log(v_c/v_i)/2. The first expert is the largest cell.

    By the partitioned inverse v_i = v_c - d^T S_i^-1 d and mu_i = mu_c + d^T S_i^-1 e_i, with d what covariance
    the shared points leave between query and cell: P S + P M operations a query. Every cell is visited, since a
    shared point may tie a far cell to the query.
    """

    name: str = "grbcm"

    def __init__(self, training_set: TrainingSet, shared: int = DEFAULT_SHARED) -> None:
        super().__init__(training_set)
        if shared < 1:
            raise ValueError(f"{shared} shared points, at least 1 was expected")
        kernel, s = training_set.kernel, training_set
        chosen, _ = most_informative(s.z, kernel.length_scales, shared) if s.size else (np.empty(0, int), None)
        self.shared = np.sort(chosen)
        ratio = kernel.noise_variance / kernel.signal_variance
        self._parts: list[tuple[np.ndarray, _Conditioned]] = []
        for value in dict.fromkeys(ratio.tolist()):
            outputs = np.flatnonzero(ratio == value)
            self._parts.append((outputs, self._condition(value, outputs)))

    def _condition(self, ratio: float, outputs: np.ndarray) -> _Conditioned:
        """Return factor and whitened labels of the shared points, and experts given them, largest cell first."""
        s, kernel = self.training_set, self.training_set.kernel
        common = s.z[self.shared]
        factor = cholesky(kernel.correlation(common, common), ratio)
        whitened = solve_triangular(factor, s.y[np.ix_(self.shared, outputs)], lower=True)
        own = np.ones(s.size, dtype=bool)
        own[self.shared] = False
        cells = np.repeat(np.arange(s.cell_count), np.diff(s.offsets))
        counts = np.bincount(cells[own], minlength=s.cell_count)
        experts = []
        for count in sorted(set(counts.tolist()) - {0}, reverse=True):
            rows = np.flatnonzero(own & (counts[cells] == count)).reshape(-1, count)
            flat = kernel.correlation(common, s.z[rows.ravel()])
            leaning = solve_triangular(factor, flat, lower=True).T.reshape(len(rows), count, -1)
            away = (s.z[rows][:, :, None] - s.z[rows][:, None]) / kernel.length_scales
            left = np.exp(-0.5 * np.square(away).sum(axis=-1)) - leaning @ leaning.transpose(0, 2, 1)
            inverse = np.linalg.inv(left + ratio * np.eye(count))
            surprise = s.y[rows][:, :, outputs] - leaning @ whitened
            experts.append(_Experts(rows, inverse, inverse @ surprise, leaning))
        return ratio, factor, whitened, experts

    def predict(self, z: np.ndarray) -> Prediction:
        return self._answer(z, slopes=False)[0]

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        return self._answer(z, slopes=True)[1]

    def _answer(self, z: np.ndarray, slopes: bool) -> tuple[Prediction, np.ndarray]:
        z, kernel = queries(z, self.training_set), self.training_set.kernel
        mean, jacobian = np.zeros((len(z), 3)), np.zeros((len(z), 3, z.shape[1]))
        variance = np.tile(kernel.signal_variance, (len(z), 1))
        for begin in range(0, len(z) if self.training_set.size else 0, _CHUNK):
            at = slice(begin, begin + _CHUNK)
            cross = kernel.correlation(self.training_set.z, z[at])
            directions = []
            if slopes:
                away = (self.training_set.z[:, None, :] - z[None, at]) / np.square(kernel.length_scales)
                directions = [cross * away[:, :, d] for d in range(z.shape[1])]
            for outputs, known in self._parts:
                mean[at, outputs], left, by_feature = self._combine(cross, directions, known)
                variance[at, outputs] *= left[:, None]
                for d, slope in enumerate(by_feature):
                    jacobian[at, outputs, d] = slope
        return Prediction(mean, variance), jacobian

    def _combine(
        self, cross: np.ndarray, directions: Sequence[np.ndarray], known: _Conditioned
    ) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Return mean (N, outputs), variance in S0 (N,) and the mean's slope along each direction.

        Sums are relative to the shared points: the precision is 1/v_c + sum b_i (1/v_i - 1/v_c), and the mean
        mu_c + sum b_i (mu_i - mu_c)/v_i over it, so that nothing large cancels.
        """
        (ratio, factor, whitened, experts), n = known, cross.shape[1]
        lean = solve_triangular(factor, cross[self.shared], lower=True)
        lean_slopes = [solve_triangular(factor, c[self.shared], lower=True) for c in directions]
        floor = ratio / (len(cross) + ratio)
        v_c = np.maximum(1.0 - np.square(lean).sum(axis=0), floor)
        dv_c = [-2.0 * (lean * slope).sum(axis=0) for slope in lean_slopes]
        precision, top = 1.0 / v_c, np.zeros((n, whitened.shape[1]))
        d_precision = [-dv / v_c**2 for dv in dv_c]
        d_top = [np.zeros_like(top) for _ in lean_slopes]
        first = True
        for e in experts:
            d = cross[e.rows] - e.leaning @ lean
            solved = e.inverse @ d
            gain = (d * solved).sum(axis=1)
            v = np.maximum(v_c - gain, floor)
            shift = np.einsum("cin,cio->cno", d, e.weights)
            b = 0.5 * np.log(v_c / v)
            if first:
                b[0] = 1.0
            precision = precision + (b * (1.0 / v - 1.0 / v_c)).sum(axis=0)
            top += np.einsum("cn,cno->no", b / v, shift)
            for k, (c, slope) in enumerate(zip(directions, lean_slopes, strict=True)):
                dd = c[e.rows] - e.leaning @ slope
                dv = dv_c[k] - 2.0 * (dd * solved).sum(axis=1)
                db = 0.5 * (dv_c[k] / v_c - dv / v)
                if first:
                    db[0] = 0.0
                d_precision[k] = d_precision[k] + (db * (1.0 / v - 1.0 / v_c) + b * (dv_c[k] / v_c**2 - dv / v**2)).sum(
                    axis=0
                )
                d_shift = np.einsum("cin,cio->cno", dd, e.weights)
                d_top[k] += np.einsum("cn,cno->no", db / v - b * dv / v**2, shift)
                d_top[k] += np.einsum("cn,cno->no", b / v, d_shift)
            first = False
        mean = lean.T @ whitened + top / precision[:, None]
        slopes = [
            slope.T @ whitened + (dt - top / precision[:, None] * dp[:, None]) / precision[:, None]
            for slope, dt, dp in zip(lean_slopes, d_top, d_precision, strict=True)
        ]
        return mean, 1.0 / precision, slopes
