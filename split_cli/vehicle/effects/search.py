"""Where the diagnosis looks for a term's parameters: limits, steps and starts, stated by the term itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from split_cli.vehicle.parameters import Vehicle

__all__ = [
    "CHANGED_LAG_SEARCH",
    "DELAY_SEARCH",
    "LAG_SEARCH",
    "Course",
    "Range",
    "Search",
    "cg_height",
    "speed_unit",
    "time_unit",
]

_USUAL_HEIGHT = 0.2  # of the CG over the wheelbase [1]: Heydinger et al. (1999), SAE 1999-01-1336
_WIDER = 4.0  # how far beyond what a car can have an explanation is followed, to tell what it would need


@dataclass(frozen=True)
class Range:
    """What values of one parameter a real car of this size can have: the prior of a diagnosis."""

    # lower, upper, step: bounds, and the step its derivative is taken with, all in its unit.
    lower: float
    upper: float
    step: float
    source: str = ""  # why no real car lies beyond: a text, a standard, or a judgement, said so
    # Whether the lower bound is where all there is has been taken off, so that a value there is sound.
    ends_at_none: bool = False
    share_of_whole: bool = False  # whether it is a share that a whole loses: 1 less it is a ratio, above 0
    # Whether the term is another one at the lower bound, so that a value there is no explanation of its own.
    ends_as_another: bool = False
    # Distance from no effect up to which any sound recording may have it, so that it is no fault, in its unit.
    tolerance: float = 0.0
    tolerance_without_position: float = (
        0.0  # the same where no position was recorded, which tells a sensor from the car
    )

    def times(self, size: float) -> Range:
        """Return the range in another unit."""
        return replace(self, lower=self.lower * size, upper=self.upper * size, step=self.step * size)

    def widened(self, neutral: float) -> Range:
        """Return the range four times as wide about its neutral value, to see what an explanation would need.

        A ratio, neutral at 1, is widened by its logarithm, and a share that is lost as the ratio that is left; a
        bound at the neutral value, or where nothing is left to take off, stays.
        """
        if neutral == 1.0:
            return replace(self, lower=self.lower / _WIDER, upper=_WIDER * self.upper)
        if self.share_of_whole:
            least, most = (1.0 - self.upper) / _WIDER, _WIDER * (1.0 - self.lower)
            return replace(self, lower=1.0 - most, upper=1.0 - least)
        lower = self.lower if self.ends_at_none else neutral + _WIDER * (self.lower - neutral)
        return replace(self, lower=lower, upper=neutral + _WIDER * (self.upper - neutral))


@dataclass(frozen=True)
class Search:
    """Where to look for the parameters of one variant of a term."""

    ranges: Mapping[str, Range]  # what a real car of this size can have, with the source
    starts: tuple[Mapping[str, float], ...] = ()  # several where the cost has several valleys
    # ``patch``, ``stretch`` or ``wave`` where start and end along the track, or a wavelength, are scanned for.
    located: str = ""
    # Parameters that are effectively searched for; a place counts more than a scale. By default their number.
    complexity: float | None = None

    def times(self, sizes: Mapping[str, float]) -> Search:
        """Return the search with every parameter in another unit; those that `sizes` lacks stay."""
        ranges = {name: one.times(sizes.get(name, 1.0)) for name, one in self.ranges.items()}
        starts = tuple({name: value * sizes.get(name, 1.0) for name, value in start.items()} for start in self.starts)
        return Search(ranges, starts, self.located, self.complexity)


@dataclass(frozen=True)
class Course:
    """What of a recording limits a search."""

    duration: float  # [s]
    reach: float  # length of the lap, or of the way driven [m]


# What is late by ten times as much promises nothing, so starts stand close.
_LATE = (
    "judgement: by-wire actuators and their networks are late by up to 0.3 s, clocks of a log that nobody aligned "
    "by up to twice that, in a small car as in a large one"
)
_SLOW = "judgement: a turbo-charged engine builds up torque in up to a second, nothing in a car is slower"
#: Sizes at which fits of a delay begin [s]: about evenly in ratio; see `valleys` for what lies between.
DELAYS = (0.004, 0.015, 0.045, 0.08, 0.13, 0.22, 0.38)
DELAY_SEARCH = Search({"delay": Range(0.0, 0.6, 0.001, _LATE)}, tuple({"delay": value} for value in (0.001, *DELAYS)))
#: In units of `time_unit`: small engines and servos are quicker.
LAG_SEARCH = Search(
    {"tau": Range(0.0, 1.0, 0.001, _SLOW)}, tuple({"tau": value} for value in (0.001, 0.004, 0.015, 0.05, 0.16))
)
#: Of a lag that the simulation has, too: by how much it is longer, and what both share; in units of `time_unit`.
#: Judgement: together they reach what a lag alone may have, and starts to both sides stand near a servo's 30 ms.
CHANGED_LAG_SEARCH = Search(
    {"tau": Range(-0.5, 0.5, 0.001, _SLOW), "shared": Range(0.0, 0.5, 0.001, _SLOW)},
    ({"tau": 0.01, "shared": 0.03}, {"tau": -0.01, "shared": 0.03}),
)


def time_unit(vehicle: Vehicle) -> float:
    """Return a second of a full-size car in a vehicle's own time, which shrinks with the root of length [s]."""
    return float(np.sqrt(vehicle.wheelbase / 2.7))


def speed_unit(vehicle: Vehicle) -> float:
    """Return the speed that is 20 m/s for a full-size car; speeds scale with the root of length [m/s]."""
    return float(np.sqrt(400.0 * vehicle.wheelbase / 2.7))


def cg_height(vehicle: Vehicle) -> float:
    """Return the height of a vehicle's CG, what is usual for its wheelbase where its file has none [m]."""
    return _USUAL_HEIGHT * vehicle.wheelbase if vehicle.cg_height is None else vehicle.cg_height
