"""Robust least squares with bounds, and uncertainty by resampling blocks of time."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from split_cli.vehicle.descent import Slopes, descend

Residual = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""parameters (P,) to residuals (M,) and their Jacobian (M, P)."""

_HUBER = 1.5
_LEAST_GAIN = 1e-7  # of a step over the loss, below which a stage ends
_TRIES = 12


@dataclass(frozen=True)
class LeastSquaresFit:
    """A solution of robust least squares."""

    parameters: np.ndarray  # (P,)
    cost: float  # sum of weight times Huber loss, in units of the squared residual
    scale: float  # robust standard deviation of the residuals
    curvature: np.ndarray  # (F, F): J^T W J of the free parameters
    scores: np.ndarray  # (M, F): each sample's share of the gradient, for sums over blocks
    free: np.ndarray  # (F,)

    def covariance(self, block: np.ndarray) -> np.ndarray:
        """Return the covariance of the free parameters, shape (F, F), robust to correlation within blocks.

        Notes
        -----
        The sandwich H^-1 (sum over blocks of g_b g_b^T) H^-1 B/(B - F), after Liang and Zeger (1986).
        """
        sums = _sum_by_block(self.scores, block)
        blocks, count = sums.shape
        inverse = np.linalg.pinv(self.curvature)
        covariance: np.ndarray = inverse @ (sums.T @ sums) @ inverse * blocks / max(blocks - count, 1)
        return covariance

    def design_effect(self, block: np.ndarray) -> float:
        """Return by how much correlation within blocks widens variances, in the mean, and at least 1."""
        sums = _sum_by_block(self.scores, block)
        meat = np.linalg.pinv(self.curvature) @ (sums.T @ sums)
        return max(1.0, float(np.trace(meat)) / (len(self.free) * self.scale**2))


def _sum_by_block(values: np.ndarray, block: np.ndarray) -> np.ndarray:
    _, index = np.unique(block, return_inverse=True)
    sums = np.zeros((index.max() + 1, values.shape[1]))
    np.add.at(sums, index, values)
    return sums


def robust_scale(residual: np.ndarray) -> float:
    """Return the standard deviation of a normal law with the residuals' median absolute deviation from 0."""
    return float(np.median(np.abs(residual)) / 0.674489750196)


def solve(
    residual: Residual,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    free: np.ndarray | None = None,
    weight: np.ndarray | None = None,
    scale: float | None = None,
    iterations: int = 60,
) -> LeastSquaresFit:
    """Minimise the Huber loss of the residuals inside bounds, see `descend`.

    Parameters
    ----------
    residual : callable
        Parameters (P,) to residuals (M,) and Jacobian (M, P).
    start, lower, upper : ndarray, shape (P,)
    free : ndarray of int, optional
        Which parameters may move; the others stay at `start`. All by default.
    weight : ndarray, shape (M,), optional
        Of each sample, for example how often resampling drew its block.
    scale : float, optional
        Residuals beyond 1.5 of it count linearly; by default found from the residuals at each of three stages.
    iterations : int
        At most so many steps a stage.
    """
    free = np.arange(len(start)) if free is None else np.asarray(free)
    parameters = np.clip(np.asarray(start, dtype=float), lower, upper)
    weights = 1.0 if weight is None else weight
    width, state = 1.0 if scale is None else scale, residual(parameters)

    def evaluate(x: np.ndarray) -> tuple[float, tuple[np.ndarray, np.ndarray]]:
        value, jacobian = residual(x)
        return _loss(value, width, weight), (value, jacobian)

    def linearise(x: np.ndarray, state: tuple[np.ndarray, np.ndarray]) -> Slopes:
        value, jacobian = state
        influence = weights * _influence(value, width)
        return Slopes(jacobian, jacobian.T @ (influence * value), (jacobian * influence[:, None]).T @ jacobian)

    for _ in range(1 if scale is not None else 3):
        if scale is None:
            width = max(robust_scale(state[0]), 1e-9)
        found = descend(
            evaluate,
            linearise,
            parameters,
            lower,
            upper,
            iterations=iterations,
            tries=_TRIES,
            movable=np.isin(np.arange(len(parameters)), free),
            enough=lambda gained, cost: gained < _LEAST_GAIN * cost or gained == 0.0,
        )
        parameters, state = found.parameters, found.state
    value, jacobian = state
    influence = weights * _influence(value, width)
    reduced = jacobian[:, free]
    curvature = (reduced * influence[:, None]).T @ reduced
    scores = reduced * (influence * value)[:, None]
    return LeastSquaresFit(parameters, _loss(value, width, weight), width, curvature, scores, free)


def _influence(value: np.ndarray, width: float) -> np.ndarray:
    limit = _HUBER * width
    influence: np.ndarray = np.minimum(1.0, limit / np.maximum(np.abs(value), 1e-300))
    return influence


def _loss(value: np.ndarray, width: float, weight: np.ndarray | None) -> float:
    limit = _HUBER * width
    size = np.abs(value)
    loss = np.where(size <= limit, 0.5 * size * size, limit * (size - 0.5 * limit))
    return float(loss.sum() if weight is None else loss @ weight)


def block_weights(block: np.ndarray, draws: int, seed: int) -> Iterator[np.ndarray]:
    """Yield, `draws` times, how often each sample's block is drawn with replacement, shape (M,).

    The bootstrap of blocks (Kuensch 1989) keeps the correlation inside a block.
    """
    _, index = np.unique(block, return_inverse=True)
    count = int(index.max()) + 1
    rng = np.random.default_rng(seed)
    for _ in range(draws):
        drawn = np.bincount(rng.integers(0, count, count), minlength=count)
        yield drawn[index].astype(float)
