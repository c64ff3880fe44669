"""Bounds, step sizes and start values of the parameters of a term: each term states its own, a diagnosis uses them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from split_cli.vehicle.parameters import Vehicle

__all__ = [
    "CHANGED_LAG_SEARCH",
    "DELAY_SEARCH",
    "LAG_SEARCH",
    "LONGEST_DELAY",
    "Course",
    "Range",
    "Search",
    "cg_height",
    "speed_unit",
    "time_unit",
]

_USUAL_HEIGHT = 0.2  # of the CG over the wheelbase [1]: Heydinger et al. (1999), SAE 1999-01-1336
_WIDER = 4.0  # factor by which `Range.widened` moves the bounds away from no effect


@dataclass(frozen=True)
class Range:
    """Values of one parameter that a real car of this size can have: the prior of a diagnosis is flat between them."""

    # lower, upper, step: bounds, and the step of its finite difference, all in the parameter's unit.
    lower: float
    upper: float
    step: float
    source: str = ""  # of the bounds: a text, a standard, or ``judgement: ...``
    # Whether nothing is left of a quantity at the lower bound (no play, no drag), so that a value there is physical.
    ends_at_none: bool = False
    # Whether the effect is complete at the upper bound (a locked axle), so that a value there is physical.
    ends_complete: bool = False
    share_of_whole: bool = False  # whether it is the lost share p of a quantity, of which the ratio 1 - p > 0 is left
    # Whether the term equals another term at the lower bound, so that a value there is not claimed.
    ends_as_another: bool = False
    # Distance from no effect that any sound recording may have, so that it is no fault; in the parameter's unit.
    tolerance: float = 0.0
    # The same where no position was recorded: only position tells a fault of the sensor from one of the car.
    tolerance_without_position: float = 0.0
    # Distance from no effect that lateral acceleration, the witness without position, may show of any sound recording.
    # A smaller fault has to be shown by the equations of motion alone; in the parameter's unit.
    tolerance_by_acceleration: float = 0.0

    def times(self, size: float) -> Range:
        """Return the range times `size`: from units of `Term.sizes` to those of the vehicle file."""
        return replace(self, lower=self.lower * size, upper=self.upper * size, step=self.step * size)

    def widened(self, neutral: float) -> Range:
        """Return the range four times as wide about `neutral`, to see which value beyond its bounds would fit.

        A ratio, neutral at 1, is widened in its logarithm, and a lost share p in the logarithm of 1 - p. A bound at
        the neutral value stays, as does a lower bound with `ends_at_none` and an upper one with `ends_complete`.
        """
        if neutral == 1.0:
            return replace(self, lower=self.lower / _WIDER, upper=_WIDER * self.upper)
        if self.share_of_whole:
            least, most = (1.0 - self.upper) / _WIDER, _WIDER * (1.0 - self.lower)
            return replace(self, lower=1.0 - most, upper=1.0 - least)
        lower = self.lower if self.ends_at_none else neutral + _WIDER * (self.lower - neutral)
        upper = self.upper if self.ends_complete else neutral + _WIDER * (self.upper - neutral)
        return replace(self, lower=lower, upper=upper)


@dataclass(frozen=True)
class Search:
    """Bounds and start values of the parameters of one variant of a term."""

    ranges: Mapping[str, Range]  # by parameter
    starts: tuple[Mapping[str, float], ...] = ()  # several where the cost has several minima
    # ``patch`` or ``stretch``: start and end along the track are scanned for; ``wave``: a wavelength is; else empty.
    located: str = ""
    # Effective number of parameters, for the price of a term: a scanned place counts as more than one. By default
    # the number of parameters.
    complexity: float | None = None

    def times(self, sizes: Mapping[str, float]) -> Search:
        """Return the search with each parameter multiplied by its entry of `sizes`, see `Range.times`; others stay."""
        ranges = {name: one.times(sizes.get(name, 1.0)) for name, one in self.ranges.items()}
        starts = tuple({name: value * sizes.get(name, 1.0) for name, value in start.items()} for start in self.starts)
        return Search(ranges, starts, self.located, self.complexity)


@dataclass(frozen=True)
class Course:
    """Duration and length of a recording: no time constant or wavelength beyond them can be identified."""

    duration: float  # [s]
    reach: float  # length of the lap, or the distance driven where there are no laps [m]


# A delay whose start is ten times too large or small lowers the cost no more, so starts stand close.
_LATE = (
    "judgement: by-wire actuators and their networks are late by up to 0.3 s, clocks of a log that nobody aligned "
    "by up to a second, in a small car as in a large one"
)
_SLOW = "judgement: a turbo-charged engine builds up torque in up to a second, nothing in a car is slower"
#: Delays at which fits of a delay begin [s], spaced about evenly in ratio. Minima between them are found by
#: `split_cli.diagnosis.search.delay_minima`.
DELAYS = (0.004, 0.015, 0.045, 0.08, 0.13, 0.22, 0.38, 0.65)
#: Longest delay of a command or a channel that is searched for [s].
LONGEST_DELAY = 1.0
DELAY_SEARCH = Search(
    {"delay": Range(0.0, LONGEST_DELAY, 0.001, _LATE)}, tuple({"delay": value} for value in (0.001, *DELAYS))
)
#: In units of `time_unit`: engines and servos of small cars are quicker.
LAG_SEARCH = Search(
    {"tau": Range(0.0, 1.0, 0.001, _SLOW)}, tuple({"tau": value} for value in (0.001, 0.004, 0.015, 0.05, 0.16))
)
#: For a lag that the simulation has, too: ``shared`` is the time constant of both, ``tau`` what reality has beyond it;
#: in units of `time_unit`. Judgement: their sum reaches the bound of a single lag, starts lie near a servo's 30 ms.
CHANGED_LAG_SEARCH = Search(
    {"tau": Range(-0.5, 0.5, 0.001, _SLOW), "shared": Range(0.0, 0.5, 0.001, _SLOW)},
    ({"tau": 0.01, "shared": 0.03}, {"tau": -0.01, "shared": 0.03}),
)


def time_unit(vehicle: Vehicle) -> float:
    """Return sqrt(wheelbase / 2.7 m) [s]: one second of a full-size car, scaled to the vehicle (Froude)."""
    return float(np.sqrt(vehicle.wheelbase / 2.7))


def speed_unit(vehicle: Vehicle) -> float:
    """Return 20 m/s sqrt(wheelbase / 2.7 m) [m/s]: 20 m/s of a full-size car, scaled to the vehicle (Froude)."""
    return float(np.sqrt(400.0 * vehicle.wheelbase / 2.7))


def cg_height(vehicle: Vehicle) -> float:
    """Return the height of a vehicle's CG [m]; 0.2 wheelbases where its file has none."""
    return _USUAL_HEIGHT * vehicle.wheelbase if vehicle.cg_height is None else vehicle.cg_height
