"""A chart of a report as a matplotlib figure: the same numbers, names and colours."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from split_cli.plots.chart import Chart, ChartLine
from split_cli.plots.palette import DASHED, DOTS, LIGHT
from split_cli.plots.style import quiet, save

#: Names of charts that a report may have. A report takes away those of an earlier one that it has not itself.
CHARTS = (
    *(f"{kind}-{of}" for kind in ("strip", "white", "coverage", "ratio", "label") for of in ("vx", "vy", "r")),
    *(f"strip-{channel}" for channel in ("ay", "delta", "T")),
    "gg",
    "path",
    "growth",
    "tire-front",
    "tire-rear",
    "force-x",
    "understeer",
    "response-gain",
    "response-phase",
)


def write_charts(charts: Iterable[Chart], folder: Path) -> tuple[str, ...]:
    """Write each chart into a folder as a PNG of its name; return the names of the files."""
    written = {f"{chart.name}.png": chart for chart in charts}
    for name, chart in written.items():
        save(draw_chart(chart), folder / name)
    return tuple(written)


def draw_chart(chart: Chart, *, other_x: bool = False, axes: Axes | None = None) -> Figure:
    """Return a chart as a matplotlib figure.

    Parameters
    ----------
    other_x : bool
        Draw over the other x, distance for strips.
    axes : Axes, optional
        Draw into these instead of a figure of its own.
    """
    if axes is None:
        figure = Figure(figsize=(10.0, 3.4) if chart.wide else (6.4, 4.8), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
    quiet(axes)
    for band in chart.bands:
        axes.axhspan(band.low, band.high, color="0.9", lw=0, label=band.name)
    for one in chart.series:
        if one.shown:
            _draw(axes, one, chart, other_x)
    over = bool(other_x and chart.other_x)
    axes.set(title=chart.title, xlabel=chart.other_x if over else chart.x, ylabel=chart.y)
    if chart.rows:
        axes.set_yticks(range(len(chart.rows)), chart.rows)
        axes.invert_yaxis()
    if chart.reference is not None:
        axes.axvline(chart.reference, color="0.5", ls="--", lw=1)
    low, high = axes.get_xlim()
    if chart.rows and high - low < chart.least_span:
        axes.set_xlim(0.5 * (low + high - chart.least_span), 0.5 * (low + high + chart.least_span))
    if chart.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if len(chart.series) > 1 or chart.bands:
        axes.legend(fontsize="small")
    return axes.figure


def _draw(axes: Axes, one: ChartLine, chart: Chart, other_x: bool) -> None:
    x = one.along if other_x and one.along is not None else one.x
    colour = LIGHT[one.role]
    if chart.rows:
        if one.kind == "bars":
            axes.barh(one.y, x, color=colour, height=0.6, label=one.name)
        else:
            axes.plot(x, one.y, "o", color=colour, label=one.name)
        if one.low is not None:
            axes.errorbar(x, one.y, xerr=np.abs([x - one.low, one.high - x]), fmt="none", ecolor="0.2", capsize=3)
        return
    if one.kind == "points":
        axes.plot(x, one.y, ".", color=colour, markersize=3, alpha=DOTS.get(one.role, 1.0), label=one.name)
        return
    dashes = [float(part) / 2.0 for part in DASHED[one.role].split()] if one.role in DASHED else None
    style = (0, tuple(dashes)) if dashes else "-"
    axes.plot(x, one.y, color=colour, linestyle=style, linewidth=1.4, label=one.name)
    if one.low is not None:
        axes.fill_between(x, one.low, one.high, color=colour, alpha=0.2, lw=0)
