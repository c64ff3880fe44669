"""A chart as numbers and words: drawn by the page of a report and by matplotlib alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from split_cli.plots.palette import ROLES

__all__ = ["Band", "Chart", "ChartLine", "thinned"]

MOST_POINTS = 2400


@dataclass(frozen=True)
class ChartLine:
    """One series of a chart.

    Attributes
    ----------
    x, y : ndarray, shape (N,)
        NaN breaks a line.
    role : str
        One of `ROLES`; it chooses the colour.
    kind : {"line", "points", "bars"}
        Bars begin at 0; with `Chart.rows`, y counts the rows from the top.
    low, high : ndarray or None
        Interval of y, or of x where the chart has rows.
    along : ndarray or None
        The other x, for charts with `Chart.other_x`.
    shown : bool
        Whether it is drawn before a reader asks for it.
    emphasis : tuple of bool
        With rows, which of them are the best.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    role: str = "measured"
    kind: Literal["line", "points", "bars"] = "line"
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    along: np.ndarray | None = None
    shown: bool = True
    emphasis: tuple[bool, ...] = ()

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
    """A chart.

    Attributes
    ----------
    name : str
        Unique on a page; letters, digits and hyphens.
    x, y : str
        Titles of the axes with units.
    note : str
        What a reader must know to read it.
    other_x : str
        Title of the other x axis; empty without one.
    other_first : bool
        Whether a page begins with the other x: two recordings meet at a place, not at a time.
    rows : tuple of str
        Names in the place of a y axis, from the top.
    equal : bool
        One unit is as long in x as in y.
    wide : bool
        Over the whole width of a page.
    group : str
        Charts of one group share the zoom of their x axis.
    """

    name: str
    title: str
    x: str
    y: str
    series: tuple[ChartLine, ...]
    note: str = ""
    bands: tuple[Band, ...] = ()
    other_x: str = ""
    other_first: bool = False
    rows: tuple[str, ...] = ()
    equal: bool = False
    wide: bool = False
    group: str = ""


def thinned(count: int, most: int = MOST_POINTS) -> slice:
    """Return the slice that leaves at most `most` of `count` samples, evenly."""
    return slice(0, count, max(1, -(-count // most)))
