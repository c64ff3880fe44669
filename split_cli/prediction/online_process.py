"""A process that learns label by label in bounded time and memory: all labels, on the points that span them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from split_cli.learning.kernel import Kernel, correlation
from split_cli.learning.online import OnlineSet
from split_cli.prediction._process_numba import absorb, answer
from split_cli.prediction.factorization import most_informative

#: Points that span the process at most [1]. It bounds memory (12 MB) and time (0.3 ms an update) where length
#: scales are short; at two cells, 200 points span the valid region of a road car.
MOST_SPANNING = 600
#: Points of smaller gain are none, however small the noise [1]: the inverse of their correlations, kept up to date
#: by its rows, would lose four digits with each.
_REDUNDANT = 1e-4
#: Share of the points that may be chosen at once [1]; the others stay for places that are driven later.
_AT_ONCE = 0.75
#: Gain of a point where slopes are asked [1]. A mean may be wrong by a share of the noise; a slope is a difference
#: of means. After a race it is then wrong by 1 to 5 %, and by 34 to 67 % with points at the noise (decision 0034).
SLOPE_GAIN = 1e-3
#: Gain at one length scale from a lone point [1]. Whatever is driven farther from all points becomes one, however
#: noisy a label is: noise averages out over many, and one point alone learns next to nothing.
_NEAR = 1.0 - np.exp(-1.0)
#: Points that span the variances at most [1]. Their cost goes with the square, and they need no slope.
_MOST_OF_VARIANCES = 300


def noise_to_signal(kernel: Kernel) -> float:
    """Return the smallest ratio of noise to signal variance over the outputs [1]."""
    return float((kernel.noise_variance / kernel.signal_variance).min())


@dataclass(frozen=True)
class ProcessState:
    """The state of an `OnlineProcess` on U points, to evaluate it elsewhere."""

    points: np.ndarray  # (U, D): in length scales
    inverse: np.ndarray  # (U, U): Q, the inverse of the points' correlations
    learned: np.ndarray  # (3, U, U): T, what data have added to the prior's covariance
    weights: np.ndarray  # (3, U)
    absent: np.ndarray  # (3,): 1 - kappa
    threshold: float

    @cached_property
    def whitened(self) -> tuple[np.ndarray, np.ndarray]:
        """Return L (U, U), with L L^T = Q, and S = L^-1 (Q + T) L^-T (3, U, U): what `open_share` takes.

        With t = L^T c nothing cancels: t is at most 1 long and S lies between 0 and 1, where c.Q c takes a
        difference of large numbers.
        """
        lower = np.linalg.cholesky(self.inverse)
        half = np.linalg.solve(lower, self.inverse + self.learned)
        return lower, np.linalg.solve(lower, half.transpose(0, 2, 1))

    def mean_and_open_share(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and variance over signal variance, (N, 3) each, at `z` (N, D) in length scales."""
        c = correlation(z, self.points, np.ones(self.points.shape[1]))
        left = open_share(c, *self.whitened, self.absent, self.threshold)
        return c @ self.weights.T, np.maximum(left, 0.0)  # below 0 is rounding


def open_share(
    c: np.ndarray, lower: np.ndarray, spread: np.ndarray, absent: np.ndarray, threshold: float | np.ndarray
) -> np.ndarray:
    """Return the variance over the signal variance of queries with correlations `c` (N, U), shape (N, 3).

    Parameters
    ----------
    lower, spread : ndarray
        As of `ProcessState.whitened`; of the symmetric matrices S a triangle will do, with twice what is off the
        diagonal.
    absent, threshold
        As of a `ProcessState`.
    """
    t = c @ lower
    gain = np.clip(1.0 - np.square(t).sum(axis=1), 0.0, 1.0)[:, None]
    left = np.stack([((t @ matrix) * t).sum(axis=1) for matrix in spread], axis=1)
    share: np.ndarray = gain + left - absent * np.minimum(gain, threshold) * (1.0 - gain)
    return share


class OnlineProcess:
    """The dense process on few points, every label absorbed as it comes.

    Parameters
    ----------
    most : int
        Largest number U of points.
    threshold : float or None
        Gain, as a share of the signal variance, from which a label's place becomes a point. By default the
        smallest ratio of noise to signal variance, so that what the points do not span is below a label's noise,
        and at most the gain at one length scale from a lone point. The first label is always a point.

    Attributes
    ----------
    count : int
        Points so far.

    Notes
    -----
    Csato and Opper, Sparse on-line Gaussian processes, Neural Computation 14 (2002), without their deletion of
    points, and with the gain of a label that is no point counted as its noise (FITC: Snelson and Ghahramani 2006).
    With c the correlations of a query with the points, Q their inverse matrix, mean = c.w and the variance is
    S0 (1 + c.T c), T being what data have added to the prior's covariance. A label of gain 1 - c.Qc below the
    threshold adds s = T c + Q c to the weights and takes its square from T; any other becomes a point first. Where
    every label becomes a point, the answer is the dense process'. Time and memory are O(U^2), however many labels
    came. Labels that came before a point are not projected on it.

    The prior's variance holds the gain of a query. The dense process would learn that rest from many labels; this
    one cannot, and would count it whole at every query. Its share is estimated from the labels: of one that is no
    point, the squared error before it is absorbed has the mean s^2 + S0 c.(Q + T)c + kappa S0 gain. Found by least
    squares weighted by these errors' variances, from a prior of mean and deviation 1, and at most 1, kappa takes
    S0 (1 - kappa) min(gain, threshold) (1 - gain) from the variance: nothing far from points, and nothing where
    each label became one.
    """

    def __init__(self, kernel: Kernel, most: int = MOST_SPANNING, threshold: float | None = None) -> None:
        self.kernel = kernel
        self._scales = np.ascontiguousarray(kernel.length_scales, dtype=float)
        self._ratio = np.ascontiguousarray(kernel.noise_variance / kernel.signal_variance)
        self._threshold = max(min(noise_to_signal(kernel), _NEAR) if threshold is None else threshold, _REDUNDANT)
        self.count = 0
        self._points = np.zeros((most, len(self._scales)))
        self._inverse, self._learned = np.zeros((most, most)), np.zeros((3, most, most))
        self._weights, self._unspanned = np.zeros((3, most)), np.zeros((2, 3))
        self._signal = np.ascontiguousarray(kernel.signal_variance, dtype=float)

    @property
    def nbytes(self) -> int:
        """Memory [bytes], whatever it has learned."""
        return self._points.nbytes + self._inverse.nbytes + self._learned.nbytes + self._weights.nbytes

    @property
    def unspanned_share(self) -> np.ndarray:
        """kappa, the share of the variance that points do not span of which labels show a trace, shape (3,)."""
        # Of a squared error the variance is twice its mean squared; so a prior of deviation 1 counts 2.
        seen, possible = self._unspanned
        share: np.ndarray = np.clip((seen + 2.0) / (possible + 2.0), 0.0, 1.0)
        return share

    @property
    def points(self) -> np.ndarray:
        """The points, shape (count, D)."""
        points: np.ndarray = self._points[: self.count] * self._scales
        return points

    def known(self) -> ProcessState:
        """Return a copy of what has been learned so far, its matrices whole."""
        n = self.count
        inverse, *learned = (
            np.tril(matrix) + np.tril(matrix, -1).T
            for matrix in (self._inverse[:n, :n], *(part[:n, :n] for part in self._learned))
        )
        return ProcessState(
            self._points[:n].copy(),
            inverse,
            np.array(learned),
            self._weights[:, :n].copy(),
            1.0 - self.unspanned_share,
            self._threshold,
        )

    def span(self, z: np.ndarray) -> None:
        """Choose the first points from features `z`, shape (N, D), before any label is absorbed.

        The most informative come first. If not all fit, later points need a larger gain than those left out.
        """
        room = int(_AT_ONCE * len(self._points))
        rows, gains = most_informative(z, self.kernel.length_scales, room, self._threshold)
        self.count = n = len(rows)
        self._points[:n] = z[rows] / self._scales
        self._inverse[:n, :n] = np.tril(np.linalg.inv(self.kernel.correlation(z[rows], z[rows])))
        if n == room:
            self._threshold = float(gains[-1])

    def learn(self, z: np.ndarray, y: np.ndarray) -> None:
        """Absorb labels `y`, shape (N, 3), at features `z`, shape (N, D), one after the other."""
        for at, label in zip(z / self._scales, np.asarray(y, dtype=float), strict=True):
            self.count = absorb(
                at,
                label,
                self.count,
                self._signal,
                self._ratio,
                self._threshold,
                self._points,
                self._inverse,
                self._weights,
                self._learned,
                self._unspanned,
            )

    def inform(
        self, z: np.ndarray, offsets: np.ndarray, information: np.ndarray, absorbed: np.ndarray, open_share: np.ndarray
    ) -> None:
        """Absorb the sums over all labels of a set, in place of the labels learned so far; the points stay.

        Parameters
        ----------
        z, offsets, information, absorbed : ndarray
            As of a `TrainingSet` that absorbs.
        open_share : ndarray, shape (C,)
            Of each cell, the gain up to which labels were rejected [1]. It counts as their noise.

        Notes
        -----
        A label of a cell observes e.f, with f the process at the cell's points. By the points that span, f is
        C Q f_u, with C its correlations with them. With K = L L^T of the points, X = L^-1 C^T, A and B the cell's
        sums of e e^T and e y^T, and rho its noise, H is the sum of X A X^T/rho and h that of X B/rho. Then the
        weights are L^-T (1 + H)^-1 h and T is L^-T ((1 + H)^-1 - 1) L^-1: the projected process of Seeger,
        Williams and Lawrence (AISTATS 2003), each label projected on its cell first.
        """
        n, begin = self.count, 0
        points, scaled, unit = self._points[:n], z / self._scales, np.ones_like(self._scales)
        lower = np.linalg.cholesky(correlation(points, points, unit))
        known, right = np.zeros((3, n, n)), np.zeros((3, n))
        for cell, (first, last) in enumerate(pairwise(offsets.tolist())):
            end = begin + (last - first) ** 2
            own, begin = information[begin:end].reshape(last - first, -1), end
            cross = correlation(points, scaled[first:last], unit)
            x, noise = solve_triangular(lower, cross, lower=True), self._ratio + open_share[cell]
            known += (x @ own @ x.T) / noise[:, None, None]
            right += (x @ absorbed[first:last]).T / noise[:, None]
        white = solve_triangular(lower, np.eye(n), lower=True)
        self._inverse[:n, :n] = np.tril(white.T @ white)
        for output in range(3):
            values, vectors = np.linalg.eigh(known[output])
            values = np.maximum(values, 0.0)  # sums of squares: below zero is rounding
            turned = white.T @ vectors
            self._learned[output, :n, :n] = np.tril(-(turned * (values / (1.0 + values))) @ turned.T)
            self._weights[output, :n] = turned @ (vectors.T @ right[output] / (1.0 + values))

    def along(self, z: np.ndarray, certainty: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mean (N, 3), latent variance (N, 3) and the mean's Jacobian (N, 3, D) at `z`, shape (N, D).

        Without `certainty` the variance is not computed, and is the prior's.
        """
        mean, spread, slope = answer(
            np.ascontiguousarray(z / self._scales),
            self.count,
            self._points,
            self._inverse,
            self._weights,
            self._learned,
            self._threshold,
            1.0 - self.unspanned_share,
            certainty,
        )
        return mean, spread * self.kernel.signal_variance, slope / self._scales


class OnlineProjection:
    """The online process beside an `OnlineSet`, with labels taken beyond a prior mean that may move.

    Notes
    -----
    Mean and slope come from a process of many points, whose cost for them is linear in the points. Variances cost
    the square, and a process of fewer points gives them nearly as well.

    What was absorbed cannot be given another prior mean. Where that moves, both begin again from the labels that
    the set keeps; what they had learned from labels that their cells rejected is lost then.
    """

    def __init__(self, online: OnlineSet) -> None:
        self.online, self.kernel = online, online.header.kernel
        self.rest_on(None)

    def rest_on(self, beyond: Callable[[np.ndarray, np.ndarray], np.ndarray] | None) -> None:
        """Predict `beyond`(z, y), shape (n, 3), instead of the labels y, and learn those of the set anew."""
        self.beyond = beyond
        self.process = OnlineProcess(self.kernel, threshold=SLOPE_GAIN)
        self.certainty = OnlineProcess(self.kernel, _MOST_OF_VARIANCES)
        cells = [self.online.cell(position) for position in range(self.online.cell_count)]
        if cells:
            z, y = (np.concatenate(parts) for parts in zip(*cells, strict=True))
            self.process.span(z)
            self.certainty.span(z)
            self.learn(z, y)

    def learn(self, z: np.ndarray, y: np.ndarray) -> None:
        """Absorb labels `y`, shape (N, 3), at features `z`, shape (N, D)."""
        if self.beyond is not None:
            y = self.beyond(z, y)
        self.process.learn(z, y)
        self.certainty.learn(z, y)

    def along(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mean (N, 3), latent variance (N, 3) and the mean's Jacobian (N, 3, D) at `z`, shape (N, D)."""
        mean, _, slope = self.process.along(z, certainty=False)
        return mean, self.certainty.along(z)[1], slope
