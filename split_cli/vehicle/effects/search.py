"""Where the diagnosis looks for a term's parameters: limits, steps and starts, stated by the term itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from split_cli.vehicle.parameters import Vehicle

__all__ = ["DELAY_SEARCH", "GRAVITY", "LAG_SEARCH", "Course", "Range", "Search", "speed_unit", "time_unit"]

GRAVITY = 9.80665  # [m/s^2]


@dataclass(frozen=True)
class Range:
    """Of one parameter: bounds and the step its derivative is taken with, all in its unit."""

    lower: float
    upper: float
    step: float

    def times(self, size: float) -> Range:
        """Return the range in another unit."""
        return Range(self.lower * size, self.upper * size, self.step * size)


@dataclass(frozen=True)
class Search:
    """Where to look for the parameters of one variant of a term.

    Attributes
    ----------
    ranges : mapping of str to Range
        Limits that a real car of this size can have.
    starts : tuple of mapping of str to float
        Several where the cost has several valleys.
    located : str
        ``patch``, ``stretch`` or ``wave`` where start and end along the track, or a wavelength, are scanned for.
    complexity : float or None
        Parameters that are effectively searched for; a place counts more than a scale. By default their number.
    """

    ranges: Mapping[str, Range]
    starts: tuple[Mapping[str, float], ...] = ()
    located: str = ""
    complexity: float | None = None

    def times(self, sizes: Mapping[str, float]) -> Search:
        """Return the search with every parameter in another unit; those that `sizes` lacks stay."""
        ranges = {name: one.times(sizes.get(name, 1.0)) for name, one in self.ranges.items()}
        starts = tuple(
            {name: value * sizes.get(name, 1.0) for name, value in start.items()} for start in self.starts
        )
        return Search(ranges, starts, self.located, self.complexity)


@dataclass(frozen=True)
class Course:
    """What of a recording limits a search.

    Attributes
    ----------
    duration : float
        [s]
    reach : float
        Length of the lap, or of the way driven [m].
    """

    duration: float
    reach: float


# What is late by ten times as much promises nothing, so starts stand close; in units of `time_unit`.
DELAY_SEARCH = Search(
    {"delay": Range(0.0, 0.6, 0.001)}, tuple({"delay": value} for value in (0.001, 0.004, 0.015, 0.045, 0.13))
)
LAG_SEARCH = Search(
    {"tau": Range(0.0, 1.0, 0.001)}, tuple({"tau": value} for value in (0.001, 0.004, 0.015, 0.05, 0.16))
)


def time_unit(vehicle: Vehicle) -> float:
    """Return a second of a full-size car in a vehicle's own time, which shrinks with the root of length [s]."""
    return float(np.sqrt(vehicle.wheelbase / 2.7))


def speed_unit(vehicle: Vehicle) -> float:
    """Return the speed that is 20 m/s for a full-size car; speeds scale with the root of length [m/s]."""
    return float(np.sqrt(400.0 * vehicle.wheelbase / 2.7))
