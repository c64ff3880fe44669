"""Hyperparameters: defaults, and the maximum-likelihood fit over blocks of neighbouring cells."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from split_cli.errors import SetError
from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import OUTPUTS, Kernel
from split_cli.learning.labels import Labels
from split_cli.learning.region import Grid
from split_cli.logs.scratch import in_pieces

LENGTH_SCALE_EDGES = 2.0
# Bounds of the fit: length scales in cell edges, variances in the label's mean square.
LENGTH_BOUNDS = (0.5, 100.0)
#: Longest scale over the cells of z2, in edges: beyond its data the correction is then gone two cells further on.
#: docs/decisions/0032 has what longer ones did to drives that go where training did not.
LONGEST_SCALE = 1.0
SIGNAL_BOUNDS = (1e-3, 1e3)
NOISE_BOUNDS = (1e-5, 1e1)
BLOCK_POINTS = 60
MAXIMUM_BLOCKS = 100
FEWEST_TO_FIT = 60
#: Labels that are looked at, spread over all [1]: as many as the blocks hold, which are chosen among them.
MOST_TO_FIT = MAXIMUM_BLOCKS * BLOCK_POINTS


@dataclass(frozen=True)
class KernelFit:
    """A fitted kernel and how it was found."""

    kernel: Kernel
    # points, blocks: what the likelihood was summed over.
    points: int
    blocks: int
    evaluations: int
    # Hyperparameters that ended on a bound: the labels ask for more, or do not determine them. Not length scales
    # at a `longest` that was asked for.
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
        For example `scatter_variance`. A tenth of the mean square is the least, also when it is not given: the
        part of the residual that the features do not explain counts as noise too, and exceeds a sensor's.
    """
    mean_square = np.maximum(_mean_square(y), 1e-12)
    noise = np.clip(0.0 if noise_variance is None else noise_variance, 0.1 * mean_square, mean_square)
    signal = np.maximum(mean_square - noise, 0.1 * mean_square)
    return Kernel(LENGTH_SCALE_EDGES * np.array(grid.edges), signal, noise, "default")


def _mean_square(y: np.ndarray) -> np.ndarray:
    """Return the mean of squares of each column, shape (3,): rows are added one by one, whatever the pieces."""
    total = np.zeros((0, y.shape[1]))
    for rows in in_pieces(len(y)):
        total = np.concatenate([total, np.square(y[rows])]).sum(axis=0, keepdims=True)
    mean: np.ndarray = total[0] / len(y)
    return mean


def scatter_variance(labels: Labels) -> np.ndarray:
    """Return a robust guess of the label noise from how successive labels differ, shape (3,).

    Half the squared median absolute difference of successive accepted labels, scaled as for a normal
    distribution; real change of the residual within h counts as noise.
    """
    good = labels.accepted
    together = good[1:] & good[:-1] & (np.diff(labels.segment) == 0)
    if not together.any():
        return np.zeros(3)
    median = np.zeros(3)
    for output in range(3):  # one by one: a long drive's labels have no room for more
        steps = [np.diff(labels.y[rows.start : rows.stop + 1, output])[together[rows]] for rows in in_pieces(len(good))]
        median[output] = np.median(np.abs(np.concatenate(steps)), overwrite_input=True)
    variance: np.ndarray = 0.5 * (median / 0.6745) ** 2
    return variance


def fit_kernel(
    z: np.ndarray, y: np.ndarray, grid: Grid, start: Kernel, *, longest: float | np.ndarray = LENGTH_BOUNDS[1]
) -> KernelFit:
    """Fit length scales, signal and noise variances by maximum likelihood.

    Parameters
    ----------
    z, y : ndarray, shape (N, D), (N, 3)
        Accepted labels of training blocks of time; thinned evenly to 6,000.
    start : Kernel
        Where the search begins; its length scales and four times them are tried.
    longest : float or ndarray, shape (D,)
        Upper bound of the length scales, in cell edges; `longest_scale` has those that sets are trained with.

    Raises
    ------
    SetError
        If there are fewer than 60 labels.

    Notes
    -----
    The likelihood is the sum over blocks of neighbouring cells, each an independent Gaussian process, and over the
    outputs, with length scales in common (Rasmussen and Williams, Gaussian processes for machine learning, 2006,
    eq. 5.8 and 5.9). Labels rather than the points a set keeps, and blocks of 60 rather than of 200, scored best
    on held-out time over several recordings (docs/decisions/0010).
    """
    from split_cli.learning._compiled import blocks_likelihood

    z, y, blocks = _blocks_to_fit(z, y, grid)
    rows = np.concatenate(blocks)
    offsets = np.concatenate([[0], np.cumsum([len(block) for block in blocks])])
    z_blocks, y_blocks, points = z[rows], y[rows], len(rows)
    mean_square = np.maximum(np.mean(np.square(y), axis=0), 1e-12)
    low, high = _bounds(grid, mean_square, longest)

    def objective(theta: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = blocks_likelihood(z_blocks, y_blocks, offsets, *_split(theta))
        if not np.isfinite(value):  # K does not factor, with noise of 1e-16 of the signal: a wall
            return 1e25, np.zeros_like(theta)
        return value / points, gradient / points

    dimension = z.shape[1]
    begins = [
        _pack(Kernel(factor * start.length_scales, start.signal_variance, start.noise_variance))
        for factor in (1.0, 4.0)
    ]
    found = _searched(objective, begins, low, high)
    best = min(found, key=lambda one: float(one.fun))
    at_low, at_high = (np.isclose(best.x, bound, atol=1e-6) for bound in (low, high))
    # A lower bound was asked for: neither the labels nor the search are at fault.
    at_high[:dimension] &= np.asarray(longest) >= LENGTH_BOUNDS[1]
    return KernelFit(
        kernel=Kernel(*_split(best.x), origin="fitted"),
        points=points,
        blocks=len(blocks),
        evaluations=sum(int(one.nfev) for one in found),
        at_bound=_names_of(at_low | at_high, dimension),
    )


def likelihood_blocks(z: np.ndarray, grid: Grid) -> list[np.ndarray]:
    """Return rows of labels grouped into blocks of neighbouring cells, as `fit_kernel` takes them.

    Parameters
    ----------
    z : ndarray, shape (N, D)
        Features of labels inside the grid.
    """
    blocks = neighbour_blocks(grid.index(z)[0], BLOCK_POINTS)
    return [blocks[i] for i in _evenly(len(blocks), MAXIMUM_BLOCKS)]


def negative_log_likelihood(z: np.ndarray, y: np.ndarray, kernel: Kernel, blocks: Sequence[np.ndarray]) -> float:
    """Return the negative log likelihood of labels, summed over blocks and outputs; infinite where it has no value.

    Parameters
    ----------
    z, y : ndarray, shape (N, D), (N, 3)
    blocks : sequence of ndarray
        Rows of each block, as of `likelihood_blocks`: each is a Gaussian process of its own.
    """
    from split_cli.learning._compiled import blocks_likelihood

    rows = np.concatenate(blocks)
    offsets = np.concatenate([[0], np.cumsum([len(block) for block in blocks])])
    parts = (kernel.length_scales, kernel.signal_variance, kernel.noise_variance)
    value = float(blocks_likelihood(z[rows], y[rows], offsets, *parts)[0])
    return value if np.isfinite(value) else np.inf


def _searched(
    objective: Callable[[np.ndarray], tuple[float, np.ndarray]],
    begins: Sequence[np.ndarray],
    low: np.ndarray,
    high: np.ndarray,
) -> list[Any]:
    """Return what a bounded quasi-Newton search finds from each beginning."""
    from scipy.optimize import minimize

    bounds = list(zip(low, high, strict=True))
    options = {"maxiter": 100, "ftol": 1e-8, "gtol": 1e-5}
    return [
        minimize(objective, np.clip(one, low, high), jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        for one in begins
    ]


def _blocks_to_fit(z: np.ndarray, y: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Return labels within the grid, thinned, and the rows of each block."""
    inside = grid.index(z)[1]
    z, y = z[inside], y[inside]
    if len(z) < FEWEST_TO_FIT:
        what = f"{len(z)} valid labels are too few to fit hyperparameters to, {FEWEST_TO_FIT} are needed"
        raise SetError(what, advice="Use --hyperparameters default.")
    thinned = labels_to_fit(len(z))
    z, y = z[thinned], y[thinned]
    return z, y, likelihood_blocks(z, grid)


def labels_to_fit(count: int) -> np.ndarray:
    """Return the numbers of those of `count` labels within the grid that `fit_kernel` looks at, ascending."""
    return _evenly(count, MOST_TO_FIT)


def _evenly(count: int, most: int) -> np.ndarray:
    """Return the numbers of at most so many of a row of things, evenly spread."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(int)


def longest_scale(features: FeatureSet, grid: Grid, z: np.ndarray) -> np.ndarray:
    """Return the upper bounds of length scales for sets that other driving will use, shape (D,), in cell edges.

    Parameters
    ----------
    features : FeatureSet
        Of the labels.
    z : ndarray, shape (N, D)
        Of the training labels.

    Notes
    -----
    One edge over z2, whose cells are of a size that is known. Over other lists five dimensions would leave nearly
    every query without a neighbour. There it is half the range in the labels, from the 0.1 to the 99.9 % quantile,
    of each feature that the valid region does not limit. A correction that speed does not change in slow bends may
    fail in fast ones, and a longer scale would carry it there (docs/decisions/0032).
    """
    if features.is_z2:
        return np.full(len(grid.edges), LONGEST_SCALE)
    half = 0.5 * np.diff(np.quantile(z, [0.001, 0.999], axis=0), axis=0)[0]
    longest: np.ndarray = np.clip(half / np.array(grid.edges), *LENGTH_BOUNDS)
    return np.where(features.within_region, LENGTH_BOUNDS[1], longest)


def _names_of(on_bound: np.ndarray, dimension: int) -> tuple[str, ...]:
    """Return the names of the parameters on a bound."""
    names = [f"length scale {i + 1}" for i in range(dimension)]
    names += [f"{what} of {output}" for what in ("signal", "noise") for output in OUTPUTS]
    return tuple(name for name, on in zip(names, on_bound, strict=True) if on)


def _bounds(grid: Grid, mean_square: np.ndarray, longest: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = np.log(grid.edges)
    scale = np.log(mean_square)
    spans = ((LENGTH_BOUNDS[0], longest), SIGNAL_BOUNDS, NOISE_BOUNDS)
    low, high = (
        np.concatenate([base + np.log(span[side]) for base, span in zip((edges, scale, scale), spans, strict=True)])
        for side in (0, 1)
    )
    return low, high


def _pack(kernel: Kernel) -> np.ndarray:
    values = np.concatenate([kernel.length_scales, kernel.signal_variance, kernel.noise_variance])
    theta: np.ndarray = np.log(values)
    return theta


def _split(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return length scales, signal and noise variances from their logarithms."""
    values = np.exp(theta)
    dimension = len(theta) - 2 * len(OUTPUTS)
    return values[:dimension], values[dimension : dimension + 3], values[dimension + 3 :]


def neighbour_blocks(index: np.ndarray, most: int) -> list[np.ndarray]:
    """Return rows grouped into blocks of neighbouring cells of at most `most` points, each cell in one block.

    Halves the longest side, in cells, at the median point until a block is small enough; a cell of more points
    than that stays whole and is thinned evenly.

    Parameters
    ----------
    index : ndarray of int64, shape (N, D)
        Cell indices, as of `Grid.index`.
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
