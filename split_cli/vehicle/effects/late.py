"""Base of delays and lags: their unit, their search range, and how they act on the inputs."""

from collections.abc import Mapping
from typing import Any, ClassVar

from split_cli.vehicle.effects.search import DELAY_SEARCH, LAG_SEARCH, Course, Search, time_unit
from split_cli.vehicle.effects.term import Term
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

# No `__all__`: these are no terms of the catalogue.


class Delayed(Term):
    """Inputs as they were `delay` [s] before: u(t - delay)."""

    units: ClassVar = {"delay": "s"}
    neutral: ClassVar = {"delay": 0.0}
    order = 0
    late_inputs: ClassVar[tuple[str, ...]] = ()  # of T and delta

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"delay": time_unit(vehicle)}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
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
        """1/tau [1/s], where tau may reach zero."""
        return 1.0 / _positive(self.parameters["tau"])

    def fastest_rate(self, speed: float) -> float:
        """1/tau."""
        return float(self.rate)


def _positive(tau: Any) -> Any:
    """Return a time constant that can be divided by; 1e-6 s is instantaneous at any sample rate met here."""
    return max(tau, 1e-6) if isinstance(tau, int | float) else tau
