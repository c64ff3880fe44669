"""What all matplotlib figures share: colours, names with units, size, and how a figure is made and saved."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

#: Okabe and Ito (2008), which the common forms of colour blindness can tell apart.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
#: Cells in which nothing is known.
EMPTY = "#DDDDDD"
STATES = ("$v_x$", "$v_y$", "$r$")
LABEL_UNITS = ("m/s²", "m/s²", "rad/s²")

_DPI = 120
_WIDTH = 10.0
_LEGEND = 125  # characters that fit side by side at the default size
_KEY = 8  # characters that a key and the space beside it take


def new_figure(height: float) -> Figure:
    """Return an empty figure 1200 pixels wide and `height` inches (120 pixels each) high."""
    figure = Figure(figsize=(_WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def legend_below(figure: Figure, axes: Axes) -> None:
    """Write the legend of some axes below a figure, in as many columns as its width has room for."""
    handles, labels = axes.get_legend_handles_labels()
    room = int(_LEGEND / (max(map(len, labels), default=1) + _KEY))
    rows = -(-len(labels) // max(1, room))
    columns = -(-len(labels) // max(1, rows))
    figure.legend(handles, labels, loc="outside lower center", ncols=max(1, columns), frameon=False)


def quiet(axes: Axes) -> None:
    """Take away the frame's upper and right line, and put a light grid behind."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, without the time or version of the writer; it is laid out and drawn once each."""
    engine = figure.get_layout_engine()
    if engine is not None:  # else `savefig` does both twice
        figure.set_dpi(_DPI)
        engine.execute(figure)
        figure.set_layout_engine(None)
    figure.savefig(path, format="png", dpi=_DPI, metadata={"Software": None})
