"""Base of delays and lags: their unit, their search range, and how they act on the inputs."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from split_cli.vehicle.effects.search import CHANGED_LAG_SEARCH, DELAY_SEARCH, LAG_SEARCH, Course, Search, time_unit
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
    """An input that builds up: tau u' = u_command - u, steady at each start; `tau` in s.

    The variant ``changed`` is for a lag that simulation and reality share and the vehicle file lacks: its time
    constant is `shared` in the simulation and `shared` + `tau` in reality. What arrives is the command, with the
    difference of the two responses. A shorter lag has a negative `tau`. `shared` shapes that difference, and is no
    measurement of the simulation's lag: what is learned of the simulation takes a part of it.
    """

    units: ClassVar = {"tau": "s"}
    variant_units: ClassVar = {"changed": {"tau": "s", "shared": "s"}}
    variant_needs: ClassVar = {"changed": frozenset({"simulation"})}
    neutral: ClassVar = {"tau": 0.0}
    order = 3

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"tau": time_unit(vehicle), "shared": time_unit(vehicle)}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        """Return ranges and starts in units of `sizes`, of a lag alone and of one that the simulation has, too."""
        return {"": LAG_SEARCH, "changed": CHANGED_LAG_SEARCH}.get(variant)

    @property
    def state_names(self) -> tuple[str, ...]:
        """What follows the command, in reality and, where its lag is shared, in the simulation."""
        shared = (f"{self.id}.{name}_shared" for name in self.states if "shared" in self.parameters)
        return (*super().state_names, *shared)

    @property
    def rate(self) -> Any:
        """1/tau [1/s]; infinite for a tau that is too short to be seen, which the neutral 0 is."""
        return rate_of(self.parameters["tau"] + self.parameters.get("shared", 0.0))

    def fastest_rate(self, speed: float) -> float:
        """1/tau, of the quicker response; what follows at once is not stepped."""
        shared = rate_of(self.parameters.get("shared", 0.0))
        return max((one for one in map(float, (self.rate, shared)) if math.isfinite(one)), default=0.0)

    def arrived(self, flow: Flow, name: str, command: Any) -> Any:
        """Return what arrives of a command that the state `name` follows."""
        value = self.first_order(flow, name, command, self.rate)
        if "shared" not in self.parameters:
            return value
        return command + value - self.first_order(flow, f"{name}_shared", command, rate_of(self.parameters["shared"]))
