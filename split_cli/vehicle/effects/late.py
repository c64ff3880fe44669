"""Base of delays and lags: their unit, their search range, and how they act on the inputs."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from split_cli.vehicle.effects.search import DELAY_SEARCH, LAG_SEARCH, Course, Search, time_unit
from split_cli.vehicle.effects.term import Term
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

# No `__all__`: these are no terms of the catalogue.

_SHORTEST = 1e-4
"""Time constant below which an input arrives at once [s]: a hundredth of a sample of the fastest drive, 100 Hz."""


def rate_of(tau: Any) -> Any:
    """Return 1/tau [1/s]; infinite for a tau [s] that is too short to be seen, which 0 is."""
    return math.inf if isinstance(tau, int | float) and tau < _SHORTEST else 1.0 / tau


class Delayed(Term):
    """Inputs as they were `delay` [s] before: u(t - delay)."""

    units: ClassVar = {"delay": "s"}
    neutral: ClassVar = {"delay": 0.0}
    order = 0
    late_inputs: ClassVar[tuple[str, ...]] = ()  # of T and delta

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        """Return range and starts [s]: networks and clocks do not run faster in smaller cars."""
        return DELAY_SEARCH

    @property
    def input_delays(self) -> Mapping[str, float]:
        """Delay [s] by channel."""
        return dict.fromkeys(self.late_inputs, self.parameters["delay"])

    def actuate(self, flow: Flow) -> None:
        """Take the inputs of before."""
        for name in self.late_inputs:
            setattr(flow, name, self.delayed(flow, getattr(flow, name), self.parameters["delay"]))


class Lagging(Term):
    """An input that builds up: tau u' = u_command - u, steady at each start; `tau` in s."""

    units: ClassVar = {"tau": "s"}
    neutral: ClassVar = {"tau": 0.0}
    order = 3

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"tau": time_unit(vehicle)}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        """Return ranges and starts in units of `sizes`; of the plain variant alone."""
        return LAG_SEARCH if variant == "" else None

    @property
    def rate(self) -> Any:
        """1/tau [1/s]; infinite for a tau that is too short to be seen, which the neutral 0 is."""
        return rate_of(self.parameters["tau"])

    def fastest_rate(self, speed: float) -> float:
        """1/tau; what follows at once is not stepped."""
        rate = float(self.rate)
        return rate if math.isfinite(rate) else 0.0
