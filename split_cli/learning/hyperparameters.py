"""Hyperparameters: defaults, a file of given ones, and the maximum-likelihood fit over blocks of cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.errors import SetError
from split_cli.learning.kernel import OUTPUTS, Kernel
from split_cli.learning.region import Grid

__all__ = ["KernelFit", "block_likelihood", "default_kernel", "fit_kernel", "neighbour_blocks"]

LENGTH_SCALE_EDGES = 2.0
# Bounds of the fit: length scales in cell edges, variances in the label's mean square.
LENGTH_BOUNDS = (0.5, 100.0)
SIGNAL_BOUNDS = (1e-3, 1e3)
NOISE_BOUNDS = (1e-5, 1e1)
BLOCK_POINTS = 180
MAXIMUM_BLOCKS = 40
_HALF_LOG_2PI = 0.5 * np.log(2.0 * np.pi)


@dataclass(frozen=True)
class KernelFit:
    """A fitted kernel and how it was found.

    Attributes
    ----------
    kernel : Kernel
    negative_log_likelihood : float
        Per point and output, at the optimum [nat].
    points, blocks : int
        What the likelihood was summed over.
    evaluations : int
    at_bound : tuple of str
        Hyperparameters that ended on a bound: the labels do not determine them.
    """

    kernel: Kernel
    negative_log_likelihood: float
    points: int
    blocks: int
    evaluations: int
    at_bound: tuple[str, ...]


def default_kernel(grid: Grid, y: np.ndarray, noise_variance: np.ndarray | None = None) -> Kernel:
    """Return the kernel used until one is fitted.

    Parameters
    ----------
    grid : Grid
        Length scales are two cell edges.
    y : ndarray, shape (N, 3)
        Labels; signal variance is their mean square less the noise, at least a tenth of it.
    noise_variance : ndarray, shape (3,), optional
        Where known; a tenth of the mean square otherwise.
    """
    mean_square = np.maximum(np.mean(np.square(y), axis=0), 1e-12)
    noise = 0.1 * mean_square if noise_variance is None else np.asarray(noise_variance, dtype=float)
    noise = np.clip(noise, NOISE_BOUNDS[0] * mean_square, mean_square)
    signal = np.maximum(mean_square - noise, 0.1 * mean_square)
    return Kernel(LENGTH_SCALE_EDGES * np.array(grid.edges), signal, noise, "default")


def fit_kernel(
    z: np.ndarray,
    y: np.ndarray,
    grid: Grid,
    start: Kernel,
    *,
    block_points: int = BLOCK_POINTS,
    maximum_blocks: int = MAXIMUM_BLOCKS,
) -> KernelFit:
    """Fit length scales, signal and noise variances by maximum likelihood.

    Parameters
    ----------
    z, y : ndarray, shape (N, D), (N, 3)
        Points of a trained set (or labels) of training blocks of time.
    grid : Grid
    start : Kernel
        Where the search begins; its length scales and four times them are tried.
    block_points : int
        Most points a block.
    maximum_blocks : int
        When there are more, so many are taken, evenly over the list of blocks.

    Returns
    -------
    KernelFit

    Raises
    ------
    SetError
        If there are fewer than 20 points.

    Notes
    -----
    The likelihood is the sum over blocks of neighbouring cells, each an independent Gaussian process, and over the
    outputs, with length scales in common (Rasmussen and Williams, Gaussian processes for machine learning, 2006,
    eq. 5.8 and 5.9). Cells alone are too small to tell a length scale of several edges from a smaller signal;
    docs/decisions tells how the block size was chosen, on held-out time.
    """
    from scipy.optimize import minimize

    if len(z) < 20:
        raise SetError(
            f"{len(z)} points are too few to fit hyperparameters to", advice="Use --hyperparameters default."
        )
    blocks = neighbour_blocks(grid.index(z)[0], block_points)
    if len(blocks) > maximum_blocks:
        chosen = np.linspace(0, len(blocks) - 1, maximum_blocks).round().astype(int)
        blocks = [blocks[i] for i in chosen]
    parts = [(z[rows], y[rows]) for rows in blocks]
    points = sum(len(rows) for rows in blocks)
    mean_square = np.maximum(np.mean(np.square(y), axis=0), 1e-12)
    low, high = _bounds(grid, mean_square)

    def objective(theta: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = block_likelihood(theta, parts)
        return value / points, gradient / points

    best, evaluations = None, 0
    for factor in (1.0, 4.0):
        kernel = Kernel(factor * start.length_scales, start.signal_variance, start.noise_variance)
        begin = np.clip(_pack(kernel), low, high)
        found = minimize(
            objective,
            begin,
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(low, high, strict=True)),
            options={"maxiter": 100, "ftol": 1e-8, "gtol": 1e-5},
        )
        evaluations += int(found.nfev)
        if best is None or found.fun < best.fun:
            best = found
    names = [f"length scale {i + 1}" for i in range(z.shape[1])]
    names += [f"{what} of {output}" for what in ("signal", "noise") for output in OUTPUTS]
    on_bound = np.isclose(best.x, low, atol=1e-6) | np.isclose(best.x, high, atol=1e-6)
    return KernelFit(
        kernel=_unpack(best.x, z.shape[1]),
        negative_log_likelihood=float(best.fun) / len(OUTPUTS),
        points=points,
        blocks=len(blocks),
        evaluations=evaluations,
        at_bound=tuple(name for name, on in zip(names, on_bound, strict=True) if on),
    )


def _bounds(grid: Grid, mean_square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = np.log(grid.edges)
    scale = np.log(mean_square)
    spans = (LENGTH_BOUNDS, SIGNAL_BOUNDS, NOISE_BOUNDS)
    return tuple(
        np.concatenate(
            [base + np.log(span[side]) for base, span in zip((edges, scale, scale), spans, strict=True)]
        )
        for side in (0, 1)
    )


def _pack(kernel: Kernel) -> np.ndarray:
    return np.log(np.concatenate([kernel.length_scales, kernel.signal_variance, kernel.noise_variance]))


def _unpack(theta: np.ndarray, dimension: int) -> Kernel:
    values = np.exp(theta)
    return Kernel(values[:dimension], values[dimension : dimension + 3], values[dimension + 3 :], "fitted")


def neighbour_blocks(index: np.ndarray, most: int) -> list[np.ndarray]:
    """Return rows grouped into blocks of neighbouring cells of at most `most` points, each cell in one block.

    Halves the longest side, in cells, at the median point until a block is small enough; a cell of more points
    than that stays whole and is thinned evenly.

    Parameters
    ----------
    index : ndarray of int64, shape (N, D)
        Cell indices, as of `Grid.index`.
    most : int
    """
    pending, blocks = [np.arange(len(index))], []
    while pending:
        rows = pending.pop()
        if len(rows) <= most:
            blocks.append(rows)
            continue
        inside = index[rows]
        side = int(np.argmax(inside.max(axis=0) - inside.min(axis=0)))
        values = inside[:, side]
        if values.min() == values.max():
            blocks.append(rows[np.linspace(0, len(rows) - 1, most).round().astype(int)])
            continue
        cut = max(int(np.median(values)), int(values.min()) + 1)
        pending += [rows[values >= cut], rows[values < cut]]
    return [rows for rows in blocks if len(rows)]


def block_likelihood(
    theta: np.ndarray, parts: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[float, np.ndarray]:
    """Return the negative log likelihood summed over blocks and outputs, and its gradient.

    Parameters
    ----------
    theta : ndarray, shape (D + 6,)
        Logarithms of length scales, signal and noise variances.
    parts : sequence of (ndarray, ndarray)
        Features (n, D) and labels (n, 3) of each block.

    Notes
    -----
    With K = S0 R + s^2 I and a = K^-1 y: -log p = y^T a/2 + log|K|/2 + n log(2 pi)/2, and its derivative is
    trace((K^-1 - a a^T) dK)/2, with dK/d log l_d = S0 R (z_d - z_d')^2/l_d^2, dK/d log S0 = S0 R,
    dK/d log s^2 = s^2 I.
    """
    from scipy.linalg import lapack

    dimension = len(theta) - 2 * len(OUTPUTS)
    kernel = _unpack(theta, dimension)
    total, gradient = 0.0, np.zeros_like(theta)
    for z, y in parts:
        distances = [
            np.square((z[:, None, d] - z[None, :, d]) / kernel.length_scales[d]) for d in range(dimension)
        ]
        correlation = np.exp(-0.5 * np.sum(distances, axis=0))
        for output in range(len(OUTPUTS)):
            signal, noise = kernel.signal_variance[output], kernel.noise_variance[output]
            covariance = signal * correlation
            covariance[np.diag_indices(len(z))] += noise
            factor, failed = lapack.dpotrf(covariance, lower=1, overwrite_a=1)
            if failed:
                # Only where noise is some 1e-16 of the signal, outside any bounds: a wall, not an answer.
                return 1e25, np.zeros_like(theta)
            weights, _ = lapack.dpotrs(factor, y[:, output], lower=1)
            inverse, _ = lapack.dpotri(factor, lower=1)
            inverse = np.tril(inverse) + np.tril(inverse, -1).T
            total += 0.5 * y[:, output] @ weights + np.log(np.diag(factor)).sum() + len(z) * _HALF_LOG_2PI
            slope = inverse - np.outer(weights, weights)
            weighted = slope * correlation * (0.5 * signal)
            for d in range(dimension):
                gradient[d] += np.vdot(weighted, distances[d])
            gradient[dimension + output] += weighted.sum()
            gradient[dimension + 3 + output] += 0.5 * noise * np.trace(slope)
    return total, gradient
