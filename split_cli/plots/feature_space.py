"""Maps over alpha_f and alpha_r in slices of the torque ratio: labels beside the learned mean, and coverage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from split_cli.learning.region import valid_cells
from split_cli.learning.training_set import TrainingSet
from split_cli.plots.style import EMPTY, LABEL_UNITS, STATES, new_figure
from split_cli.prediction.full import FullPredictor
from split_cli.scoring.evaluation import HeldOutSamples

_SLICES = 4
#: Where the deviation left is over this share of the prior's, the mean says nothing.
_UNKNOWN = 0.8
_COUNTS = (1, 2, 4, 8, 16, 32, 64)


@dataclass(frozen=True)
class CellMap:
    """One slice: layers of cells of the torque ratio laid on top of each other."""

    # low, high: torque ratio from and to [1].
    low: float
    high: float
    values: np.ndarray  # (F, R): by cell of alpha_f and of alpha_r; NaN where there is nothing


def coverage_maps(trained: TrainingSet) -> tuple[list[CellMap], list[CellMap]]:
    """Return slices with the number of points held, and with the number of valid cells.

    The slices share the torque layers that hold points evenly by points, and reach over all layers.
    """
    grid = trained.grid
    layers, slip_shape, origin = _layout(trained)
    held_at = grid.unpack(trained.cell_numbers) - origin
    valid_at = grid.unpack(valid_cells(trained.vehicle, trained.region, grid)) - origin
    points = np.diff(trained.offsets)
    bounds = _slices(np.repeat(held_at[:, 2], points), layers)
    held, valid = [], []
    for first, last in bounds:
        edges = [(origin[2] + first) * grid.edges[2], (origin[2] + last) * grid.edges[2]]
        for maps, at, weights in ((held, held_at, points), (valid, valid_at, np.ones(len(valid_at)))):
            mine = (at[:, 2] >= first) & (at[:, 2] < last)
            total = np.zeros(slip_shape)
            np.add.at(total, (at[mine, 0], at[mine, 1]), weights[mine])
            maps.append(CellMap(*edges, total))
    return held, valid


def draw_coverage(trained: TrainingSet) -> Figure:
    """Draw which valid cells hold points, and how many."""
    held, valid = coverage_maps(trained)
    # Two beside each other: four in a row are too small to see single cells.
    across = min(2, len(held))
    down = -(-len(held) // across)
    figure = new_figure(0.9 + 4.0 * down)
    axes = np.atleast_2d(figure.subplots(down, across, sharex=True, sharey=True))
    for spare in axes.flat[len(held) :]:
        spare.set_visible(False)
    colours = ["#FDE725", "#A0DA39", "#4AC16D", "#1FA187", "#277F8E", "#365C8D", "#440154"]
    norm = BoundaryNorm([*_COUNTS, 1 << 20], len(colours))
    for axis, points, cells in zip(axes.flat, held, valid, strict=False):
        empty = np.where((points.values == 0) & (cells.values > 0), 1.0, np.nan)
        _mesh(axis, trained, empty, cmap=ListedColormap([EMPTY]))
        mesh = _mesh(
            axis, trained, np.where(points.values > 0, points.values, np.nan), cmap=ListedColormap(colours), norm=norm
        )
        filled, total = int(points.values.sum()), int(cells.values.sum())
        axis.set_title(f"{_slice_name(points)}\n{filled} points, {total} valid cells", fontsize="medium")
    bar = figure.colorbar(mesh, ax=axes, label="points held", pad=0.01, spacing="uniform")
    bar.set_ticks(_COUNTS, labels=[str(count) for count in _COUNTS[:-1]] + [f"{_COUNTS[-1]}+"])
    _label_axes(axes, trained, (*held, *valid))
    valid_numbers = valid_cells(trained.vehicle, trained.region, trained.grid)
    known = int(np.isin(valid_numbers, trained.cell_numbers).sum())
    outside = trained.cell_count - known
    figure.suptitle(
        f"{known} of {len(valid_numbers)} valid cells hold points ({100 * known / len(valid_numbers):.0f} %; "
        f"grey: none), {trained.size} points in all; negative torque brakes, $T_{{max}}$ drives"
        + (f"; {outside} cells with points have their centre outside" if outside else "")
    )
    return figure


def label_maps(
    trained: TrainingSet, drives: Sequence[HeldOutSamples], output: int
) -> tuple[list[CellMap], list[CellMap]]:
    """Return slices with the mean of the labels in each cell, and with the dense process' mean at its centre.

    Labels are the accepted ones of all drives. The learned mean is taken at the slice's median torque ratio, in
    cells that are valid there, and is NaN where the deviation left is over 80 % of the prior's.
    """
    grid = trained.grid
    layers, slip_shape, origin = _layout(trained)
    z = np.concatenate([part.labels.z[part.labels.accepted] for part in drives])
    y = np.concatenate([part.labels.y[part.labels.accepted, output] for part in drives])
    index, inside = grid.index(z)
    z, y, at = z[inside], y[inside], index[inside] - origin
    numbers = valid_cells(trained.vehicle, trained.region, grid)
    valid_at, centers = grid.unpack(numbers) - origin, grid.centers(numbers)
    predictor = FullPredictor(trained)
    labels, learned = [], []
    for first, last in _slices(at[:, 2], layers):
        edges = [(origin[2] + first) * grid.edges[2], (origin[2] + last) * grid.edges[2]]
        mine = (at[:, 2] >= first) & (at[:, 2] < last)
        total, count = np.zeros((2, *slip_shape))
        np.add.at(total, (at[mine, 0], at[mine, 1]), y[mine])
        np.add.at(count, (at[mine, 0], at[mine, 1]), 1.0)
        with np.errstate(invalid="ignore"):
            labels.append(CellMap(*edges, total / count))
        middle = float(np.median(z[mine, 2])) if mine.any() else 0.5 * sum(edges)
        layer = int(np.clip(np.floor(middle / grid.edges[2]) - origin[2], first, last - 1))
        here = valid_at[:, 2] == layer
        queries = centers[here].copy()
        queries[:, 2] = middle
        found = predictor.predict(queries)
        unknown = found.variance[:, output] > _UNKNOWN**2 * trained.kernel.signal_variance[output]
        values = np.full(slip_shape, np.nan)
        values[valid_at[here, 0], valid_at[here, 1]] = np.where(unknown, np.nan, found.mean[:, output])
        learned.append(CellMap(middle, middle, values))
    return labels, learned


def draw_labels(trained: TrainingSet, drives: Sequence[HeldOutSamples], output: int) -> Figure:
    """Draw the mean label of each cell above the learned mean, for one state."""
    labels, learned = label_maps(trained, drives, output)
    figure = new_figure(5.9)
    axes = np.atleast_2d(figure.subplots(2, len(labels), sharex=True, sharey=True, squeeze=False))
    every = np.abs(np.concatenate([part.values.ravel() for part in labels]))
    # One colour scale for both rows, not stretched by the few cells of a single label.
    bound = max(float(np.nanquantile(every, 0.97)) if np.isfinite(every).any() else 0.0, 1e-9)
    norm = TwoSlopeNorm(0.0, -bound, bound)
    for column, (above, below) in enumerate(zip(labels, learned, strict=True)):
        mesh = _mesh(axes[0, column], trained, above.values, cmap="PuOr_r", norm=norm)
        axes[0, column].set_title(f"{_slice_name(above)}\nmean of the labels", fontsize="medium")
        _mesh(axes[1, column], trained, below.values, cmap="PuOr_r", norm=norm)
        axes[1, column].set_title(f"learned mean at {below.low:.2f}", fontsize="medium")
    for axis in axes.flat:
        axis.set_facecolor("0.93")
    _label_axes(axes, trained, (*labels, *learned))
    figure.colorbar(mesh, ax=axes, label=f"label of {STATES[output]} [{LABEL_UNITS[output]}]", extend="both", pad=0.01)
    figure.suptitle(_finding(labels, output))
    return figure


def _finding(labels: list[CellMap], output: int) -> str:
    known = np.concatenate([part.values[np.isfinite(part.values)] for part in labels])
    if not len(known):
        return f"No label of {STATES[output]} lies in the valid region"
    low, high, unit = known.min(), known.max(), LABEL_UNITS[output]
    return (
        f"Error of the nominal model (label) in {STATES[output]}: {low:.2g} to {high:.2g} {unit} "
        "over cells\n(grey: no label in the upper row, no points in the lower row)"
    )


def _layout(trained: TrainingSet) -> tuple[int, tuple[int, int], np.ndarray]:
    """Return the number of torque layers, of cells of alpha_f and alpha_r, and the first cell's index (3,)."""
    origin = trained.grid.first.astype(np.int64)
    count = trained.grid.last.astype(np.int64) - origin + 1
    return int(count[2]), (int(count[0]), int(count[1])), origin


def _slices(layer: np.ndarray, layers: int) -> list[tuple[int, int]]:
    """Return [first, last) layers of up to four slices that share the samples evenly and cover all layers."""
    if not len(layer):
        return [(0, layers)]
    inner = np.quantile(layer, np.arange(1, _SLICES) / _SLICES, method="nearest")
    borders = np.unique(np.concatenate([[0], inner, [layers]])).astype(int).tolist()
    return list(zip(borders[:-1], borders[1:], strict=True))


def _mesh(axis: Axes, trained: TrainingSet, values: np.ndarray, **style: object):
    edges, first = trained.grid.edges, trained.grid.first
    borders = [(first[i] + np.arange(values.shape[i] + 1)) * edges[i] for i in range(2)]
    return axis.pcolormesh(*borders, values.T, **style)


def _slice_name(part: CellMap) -> str:
    return f"$T/T_{{max}}$ {part.low:.1f} to {part.high:.1f}"


def _label_axes(axes: np.ndarray, trained: TrainingSet, maps: Sequence[CellMap]) -> None:
    """Name the axes, and cut them to the cells that hold anything, one cell around."""
    grid = np.atleast_2d(axes)
    used = np.any([np.isfinite(part.values) & (part.values != 0.0) for part in maps], axis=0)
    for feature, cut in ((0, grid[0, 0].set_xlim), (1, grid[0, 0].set_ylim)):
        at = np.flatnonzero(used.any(axis=1 - feature))
        if len(at):
            edge, first = trained.grid.edges[feature], trained.grid.first[feature]
            cut((first + at[0] - 1) * edge, (first + at[-1] + 2) * edge)
    for axis in grid[-1]:
        axis.set_xlabel(r"$\alpha_f$ [rad]")
    for axis in grid[:, 0]:
        axis.set_ylabel(r"$\alpha_r$ [rad]")
    for axis in grid.flat:
        axis.set_aspect("equal")
        axis.xaxis.set_major_locator(MaxNLocator(4))
