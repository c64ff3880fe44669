"""Growth of a trained set: points, cells and updates, drive by drive and over driving time."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from split_cli.learning.training_set import TrainingSet
from split_cli.plots.style import PALETTE, legend_below, new_figure, quiet
from split_cli.scoring.run import EvaluationRun


def kept_over_time(trained: TrainingSet) -> tuple[np.ndarray, np.ndarray]:
    """Return driving time at which each point kept was met [s], ascending, and the number met by then.

    Drives follow one another as they were learned. Points replaced since are not in it.
    """
    before = np.concatenate([[0.0], np.cumsum([source.duration for source in trained.sources])])
    begin = np.array([source.start_time for source in trained.sources])
    met = np.sort(before[trained.source] + trained.t - begin[trained.source])
    return met, np.arange(1, len(met) + 1)


def draw_growth(run: EvaluationRun) -> Figure:
    """Draw the points kept over driving time and, for several drives, size and updates after each."""
    figure = new_figure(4.2)
    sets = list(zip(run.report.settings.features, run.sets, strict=True))
    drives = max(len(trained.sources) for trained in run.sets)
    axes = figure.subplots(1, 3 if drives > 1 else 1, squeeze=False)[0]
    for position, (features, trained) in enumerate(sets):
        colour = PALETTE[position % len(PALETTE)]
        met, count = kept_over_time(trained)
        axes[-1].plot(met, count, color=colour, label=features, drawstyle="steps-post")
        if drives > 1:
            _draw_size(axes[0], trained, colour)
            _draw_updates(axes[1], trained, colour, position, len(sets))
    for axis in axes:
        quiet(axis)
        axis.set_ylim(0.0, 1.05 * axis.get_ylim()[1])
    axes[-1].set(xlabel="driving time [s]", ylabel="points", title="points kept, by when they were met")
    if drives > 1:
        axes[0].set(xlabel="drives learned", ylabel="count", title="points (dots), cells (squares)")
        axes[1].set(xlabel="drive", ylabel="updates", title="insertions, replacements (hatched)")
        for axis in axes[:2]:
            axis.set_xticks(np.unique(np.linspace(1, drives, min(drives, 8)).round().astype(int)))
            axis.set_xlim(0.4, drives + 0.6)
    for axis in axes:
        axis.title.set_size("medium")
    legend_below(figure, axes[-1])
    figure.suptitle("\n".join(_finding(features, trained) for features, trained in sets))
    return figure


def _draw_size(axis: Axes, trained: TrainingSet, colour: str) -> None:
    number = np.arange(1, len(trained.sources) + 1)
    axis.plot(number, [s.points for s in trained.sources], "o-", color=colour)
    axis.plot(number, [s.cells for s in trained.sources], "s--", color=colour, fillstyle="none")


def _draw_updates(axis: Axes, trained: TrainingSet, colour: str, position: int, sets: int) -> None:
    width = 0.8 / sets
    number = np.arange(1, len(trained.sources) + 1) + (position - 0.5 * (sets - 1)) * width
    inserted = np.array([s.insertions for s in trained.sources])
    replaced = [s.replacements for s in trained.sources]
    axis.bar(number, inserted, width, color=colour)
    replaced_style = {"color": colour, "alpha": 0.4, "hatch": "//", "edgecolor": "white"}
    axis.bar(number, replaced, width, bottom=inserted, **replaced_style)


def _finding(features: str, trained: TrainingSet) -> str:
    accepted = sum(source.accepted for source in trained.sources)
    drives = f"{len(trained.sources)} drive" + ("s" if len(trained.sources) != 1 else "")
    share = trained.size / accepted if accepted else 0.0
    return (
        f"{features}: {trained.size} points in {trained.cell_count} cells after {drives}, "
        f"{100 * share:.0f} % of the samples offered"
    )
