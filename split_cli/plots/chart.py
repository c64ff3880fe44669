"""A chart as numbers and words: drawn by the page of a report and by matplotlib alike."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from split_cli.plots.palette import ROLES

MOST_POINTS = 2400


@dataclass(frozen=True)
class ChartLine:
    """One series of a chart."""

    name: str
    # x, y: (N,): NaN breaks a line.
    x: np.ndarray
    y: np.ndarray
    role: str = "measured"  # one of `ROLES`; it chooses the colour
    # {"line", "points", "bars"} Bars begin at 0; with `Chart.rows`, y counts the rows from the top.
    kind: Literal["line", "points", "bars"] = "line"
    # low, high: interval of y, or of x where the chart has rows.
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    along: np.ndarray | None = None  # the other x, for charts with `Chart.other_x`
    shown: bool = True  # whether it is drawn before a reader asks for it
    emphasis: tuple[bool, ...] = ()  # with rows, which of them are the best

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise ValueError(f"no role {self.role!r}, one of {', '.join(ROLES)} was expected")


@dataclass(frozen=True)
class Band:
    """A stretch of y that something lies in by itself: noise, a bound."""

    low: float
    high: float
    name: str


@dataclass(frozen=True)
class Chart:
    """A chart."""

    name: str  # unique on a page; letters, digits and hyphens
    title: str
    # x, y: titles of the axes with units.
    x: str
    y: str
    series: tuple[ChartLine, ...]
    note: str = ""  # what a reader must know to read it
    bands: tuple[Band, ...] = ()
    other_x: str = ""  # title of the other x axis; empty without one
    # Whether a page begins with the other x: two recordings meet at a place, not at a time.
    other_first: bool = False
    rows: tuple[str, ...] = ()  # names in the place of a y axis, from the top
    reference: float | None = None  # with rows, the x at which a line stands, always within the frame
    least_span: float = 0.0  # with rows, what the axis of x spans at least: less is no difference to be seen
    equal: bool = False  # one unit is as long in x as in y
    wide: bool = False  # over the whole width of a page
    group: str = ""  # charts of one group share the zoom of their x axis


def thinned(count: int, most: int = MOST_POINTS) -> slice:
    """Return the slice that leaves at most `most` of `count` samples, evenly."""
    return slice(0, count, max(1, -(-count // most)))
