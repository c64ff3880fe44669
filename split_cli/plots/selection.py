"""Accuracy against cost: every candidate of `split evaluate --select`, the front, and the choice."""

from pathlib import Path

from matplotlib.figure import Figure

from split_cli.files import atomic_directory
from split_cli.plots.style import PALETTE, new_figure, quiet, save
from split_cli.scoring.selection import SetSelection

_NAME = "selection.png"


def write_selection(selection: SetSelection, folder: str | Path) -> str:
    """Draw into a folder; return the name of the file."""
    with atomic_directory(folder) as temporary:
        save(draw_selection(selection), temporary / _NAME)
    return _NAME


def draw_selection(selection: SetSelection) -> Figure:
    """Draw error relative to the nominal model's over the points kept."""
    figure = new_figure(5.0)
    axes = figure.subplots()
    quiet(axes)
    kinds = list(dict.fromkeys((one.features, one.cell_edge) for one in selection.candidates))
    for number, kind in enumerate(kinds):
        same = [one for one in selection.candidates if (one.features, one.cell_edge) == kind]
        axes.plot(
            [one.points for one in same],
            [one.error for one in same],
            "o",
            color=PALETTE[number % len(PALETTE)],
            label=f"{kind[0]}, cell edge {kind[1]:g}",
        )
    front = [one for one in selection.candidates if one.on_front]
    axes.step(
        [one.points for one in front],
        [one.error for one in front],
        where="post",
        color="black",
        linewidth=1.0,
        label="front",
    )
    best = next(one for one in selection.candidates if one.chosen)
    axes.plot(best.points, best.error, "o", markersize=14, markerfacecolor="none", color="black", label="chosen")
    axes.set_xscale("log")
    axes.set_xlabel("points kept")
    axes.set_ylabel("error over the nominal model's")
    axes.legend(frameon=False)
    figure.suptitle(
        f"capacity {best.capacity}, threshold {best.threshold:g}, cell edge {best.cell_edge:g}: "
        f"{best.points:.0f} points, error {best.error:.3f} on held-out blocks"
    )
    return figure
