"""Terms of what slip makes of a tyre: its stiffness, and the distance over which its force builds up."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from split_cli.vehicle.effects.late import BuildsUp
from split_cli.vehicle.effects.search import Course, Range, Search
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.wording import Estimates, amount, scaled
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

__all__ = ["TireRelaxation", "TireStiffness"]

# Relaxation length below which forces build up at once [m]; the shortest of a model car is 30 times that.
_SHORTEST_LENGTH = 1e-3
_ROLLED = "Pacejka (2012), section 5.4: lengths of the order of a wheel's radius and of twice that; judgement beyond"
_STIFF = "judgement: make, pressure and wear change a tyre's stiffness by less than a factor of 1.8"


class TireRelaxation(BuildsUp):
    """The lateral force builds up over distance: length F' = v_x (F_ss - F) per axle.

    The term is a lag in distance, so at twice the speed its time constant is half. Source: Pacejka (2012),
    section 5.4.
    """

    id = "tire_relaxation"
    titles: ClassVar = {"": "Tyres build up force late"}
    in_every_car: ClassVar = True
    through_tires: ClassVar = True
    slow = "length"
    variants: ClassVar = ("", "changed")
    variant_words: ClassVar = {"changed": "longer or shorter than the simulation's"}
    units: ClassVar = {"length": "m"}
    variant_units: ClassVar = {"changed": {"length": "m", "shared": "m"}}
    neutral: ClassVar = {"length": 0.0}
    discrepancy: ClassVar = (("", "length", 0.15), ("", "length", 0.5))
    order = 9
    states = ("front", "rear")
    state_units: ClassVar = {"front": "N", "rear": "N", "front_shared": "N", "rear_shared": "N"}
    mimics: ClassVar = (
        Mimic("steer_lag", "one speed", "the same manoeuvre at two speeds; relaxation also acts at the rear"),
        Mimic("yaw_inertia", "gentle transients at one speed", "steer steps at two speeds"),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"length": vehicle.wheelbase / 2.7, "shared": vehicle.wheelbase / 2.7}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        if variant == "changed":
            # Starts to both sides, from a tyre's usual length.
            starts = ({"length": 0.1, "shared": 0.4}, {"length": -0.1, "shared": 0.4})
            return Search({"length": Range(-1.75, 1.75, 0.02, _ROLLED), "shared": Range(0.0, 1.75, 0.02)}, starts)
        return Search({"length": Range(0.0, 3.5, 0.02, _ROLLED)}, tuple({"length": value} for value in (0.1, 0.5, 1.5)))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        if variant == "changed":
            over = amount(p["length"], more="longer", less="shorter")
            return f"lateral force builds up over a distance {over} than in the simulation, where it is late as well"
        return f"lateral force builds up over {amount(p['length'], one_sided=True)} of travel"

    def fastest_rate(self, speed: float) -> float:
        """v_x over the length, of the quicker response."""
        return self.quickest(lambda length: _rolling_rate(length, speed))

    def lateral(self, flow: Flow) -> None:
        """Let each axle's force follow its steady value."""
        for name, axle in (("front", flow.front), ("rear", flow.rear)):
            axle.lateral_force = self.arrived(
                flow, name, axle.lateral_force, lambda length: flow.cached(_rolling_rate, length, flow.vx)
            )


def _rolling_rate(length: Any, speed: Any) -> Any:
    """Return v_x over a relaxation length [1/s]; infinite where forces build up at once."""
    return math.inf if isinstance(length, int | float) and length < _SHORTEST_LENGTH else speed / length


class TireStiffness(Term):
    """The tyres of an axle have another stiffness: B front_scale, B rear_scale. The peak stays."""

    id = "tire_stiffness"
    factors: ClassVar = {
        "front_scale": ("Front tyres", "stiffer", "softer"),
        "rear_scale": ("Rear tyres", "stiffer", "softer"),
    }
    scales_curve: ClassVar = True
    in_every_car: ClassVar = True
    through_tires: ClassVar = True
    units: ClassVar = {"front_scale": "1", "rear_scale": "1"}
    neutral: ClassVar = {"front_scale": 1.0, "rear_scale": 1.0}
    discrepancy: ClassVar = (("", "front_scale", 0.15), ("", "rear_scale", 0.15))
    mimics: ClassVar = (
        Mimic("friction_scale", "no turn near the limit", "a turn near the limit"),
        Mimic("cg_shift", "steady turns", "steer steps"),
        Mimic("steer_gain", "small steer angles at one speed", "turns at low and at high speed"),
        Mimic("aero_downforce", "one speed in every turn", "the same turn at two speeds"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        limits = Range(0.55, 1.8, 0.01, _STIFF)
        return Search({"front_scale": limits, "rear_scale": limits}, ({"front_scale": 0.97, "rear_scale": 0.97},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        front, rear = (scaled(p[name], "stiffer", "softer") for name in ("front_scale", "rear_scale"))
        return f"the front tyres are {front} and the rear tyres {rear}"

    def tire(self, flow: Flow) -> None:
        """Scale B of each axle."""
        flow.front.B = flow.front.B * self.parameters["front_scale"]
        flow.rear.B = flow.rear.B * self.parameters["rear_scale"]
