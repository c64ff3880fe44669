"""Base classes of delays and first-order lags of inputs: units, search range, and effect on T and delta."""

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from split_cli.vehicle.effects.search import CHANGED_LAG_SEARCH, DELAY_SEARCH, LAG_SEARCH, Course, Search, time_unit
from split_cli.vehicle.effects.term import Term
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

# No `__all__`: these are no terms of the catalogue.

_SHORTEST = 1e-4
"""Time constant below which an input arrives at once [s]: a hundredth of a sample of the fastest drive, 100 Hz."""


def rate_of(tau: Any) -> Any:
    """Return 1/tau [1/s]; infinite for tau below 1e-4 s, at which the input arrives at once."""
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


class BuildsUp(Term):
    """What follows its steady value by a first-order lag, of which one parameter says how long it takes.

    The variant ``changed`` is for a lag that simulation and reality share and the vehicle file lacks: the parameter
    is `shared` in the simulation, and in reality `shared` + its own value, which is negative for a shorter lag. What
    arrives is the steady value, with the difference of the two responses. `shared` shapes that difference, and is
    no measurement of the simulation's lag: what is learned of the simulation takes a part of it.
    """

    slow: ClassVar[str]  # the parameter
    variant_needs: ClassVar = {"changed": frozenset({"simulation"})}

    @property
    def state_names(self) -> tuple[str, ...]:
        """What follows, in reality and, where its lag is shared, in the simulation."""
        shared = (f"{self.id}.{name}_shared" for name in self.states if "shared" in self.parameters)
        return (*super().state_names, *shared)

    def quickest(self, rate: Callable[[Any], Any]) -> float:
        """Return the largest rate of the responses [1/s]; what follows at once is not stepped.

        Parameters
        ----------
        rate : callable
            Rate [1/s] of a value of the parameter; infinite where that is too short to be seen.
        """
        rates = (float(rate(one)) for one in self._of_both())
        return max((one for one in rates if math.isfinite(one)), default=0.0)

    def arrived(self, flow: Flow, name: str, steady: Any, rate: Callable[[Any], Any]) -> Any:
        """Return what has arrived of a steady value that the state `name` follows; `rate` as in `quickest`."""
        own, shared = self._of_both()
        value = self.first_order(flow, name, steady, rate(own))
        if "shared" not in self.parameters:
            return value
        return steady + value - self.first_order(flow, f"{name}_shared", steady, rate(shared))

    def _of_both(self) -> tuple[Any, Any]:
        """Return the parameter in reality and in the simulation, where it is 0 by default."""
        shared = self.parameters.get("shared", 0.0)
        return self.parameters[self.slow] + shared, shared


class Lagging(BuildsUp):
    """An input that builds up: tau u' = u_command - u, steady at each start; `tau` in s."""

    slow = "tau"
    units: ClassVar = {"tau": "s"}
    variant_units: ClassVar = {"changed": {"tau": "s", "shared": "s"}}
    neutral: ClassVar = {"tau": 0.0}
    order = 3

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"tau": time_unit(vehicle), "shared": time_unit(vehicle)}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        """Return ranges and starts in units of `sizes`, of a lag alone and of one that the simulation has, too."""
        return {"": LAG_SEARCH, "changed": CHANGED_LAG_SEARCH}.get(variant)

    def fastest_rate(self, speed: float) -> float:
        """1/tau, of the quicker response."""
        return self.quickest(rate_of)
