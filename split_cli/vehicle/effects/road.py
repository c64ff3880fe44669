"""Terms of the road's inclination: gravity along and across the car."""

from typing import Any, ClassVar

import numpy as np

from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.effects.place import PLACE_COMPLEXITY, inside_stretch, place_ranges, stretch_in_words
from split_cli.vehicle.effects.search import Course, Range, Search
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.wording import Estimates, amount, number
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.operations import NUMPY, Operations
from split_cli.vehicle.parameters import Vehicle

__all__ = ["RoadBank", "RoadGrade"]

_WAVE = {"amplitude": "rad", "wavelength": "m", "phase": "rad"}
_STRETCH = {"angle": "rad", "s_start": "m", "s_end": "m"}


class _Incline(Term):
    """An angle that is constant, a wave over s, amplitude sin(2 pi s/wavelength + phase), or on a stretch."""

    units: ClassVar = {"angle": "rad"}
    variants: ClassVar = ("", "wave", "stretch")
    variant_words: ClassVar = {"wave": "in waves along the track", "stretch": "on one stretch"}
    variant_units: ClassVar = {"wave": _WAVE, "stretch": _STRETCH}
    neutral: ClassVar = {"angle": 0.0, "amplitude": 0.0}
    family = "place"
    directions: ClassVar[tuple[str, str]]
    steepest: ClassVar[dict[str, float]]
    source: ClassVar[str]

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        limits = Range(-cls.steepest[variant], cls.steepest[variant], 0.001, cls.source)
        reach = course.reach
        if variant == "wave":
            wavelength = Range(0.03 * reach, 4.0 * reach, 0.002 * reach)
            phase = Range(-40.0, 40.0, 0.02)
            ranges = {"amplitude": limits, "wavelength": wavelength, "phase": phase}
            return Search(ranges, located="wave", complexity=PLACE_COMPLEXITY)
        if variant == "stretch":
            return Search({"angle": limits, **place_ranges(reach)}, located="stretch", complexity=PLACE_COMPLEXITY)
        return Search({"angle": limits}, ({"angle": 0.005},))

    @classmethod
    def everywhere(cls, variant: str) -> tuple[Term, float]:
        """Return a constant angle, which is the default variant."""
        return cls({"angle": 0.005}), 0.005

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        up, down = cls.directions
        if variant == "wave":
            size = amount(p["amplitude"], one_sided=True, unsigned=True)
            return f"the road {up} and {down} by up to {size} in waves of {number(p['wavelength'].value)} m"
        size = amount(p["angle"], unsigned=True)
        text = f"the road {up if p['angle'].value >= 0.0 else down} by {size}"
        return f"{text} {stretch_in_words(p)}" if variant == "stretch" else text

    def sine(self, flow: Flow) -> Any:
        """Return the sine of the angle where the car is [1]."""
        if flow.recording is not None:
            return self._along(flow.s)
        return flow.ops.sin(self.profile(flow.ops, flow.s))

    def _along(self, s: np.ndarray) -> Any:
        """Return the sine of the angle at s [m] of a recording, shape (N,) [1]."""
        return self.cached(s, lambda: np.sin(self.profile(NUMPY, s)))

    def profile(self, ops: Operations, s: Any) -> Any:
        """Return the angle at s [m] [rad]."""
        p = self.parameters
        if self.variant == "wave":
            return p["amplitude"] * ops.sin(2.0 * np.pi / p["wavelength"] * s + p["phase"])
        if self.variant == "stretch":
            return p["angle"] * inside_stretch(ops, s, p["s_start"], p["s_end"])
        return p["angle"]

    def specific_weight(self, s: np.ndarray) -> Any:
        """Return the part of gravity along the inclination at s [m], shape (N,), uphill positive [m/s^2]."""
        return STANDARD_GRAVITY * self._along(s)


class RoadGrade(_Incline):
    """The road has a grade, uphill positive: F_x gains -m g sin(angle(s)).

    Source: Rajamani (2012), equation 4.1. A constant angle moves the car as rolling resistance does. An
    accelerometer along the car tells them apart, since it feels the grade alone: only then is it looked for.
    """

    id = "road_grade"
    titles: ClassVar = {"": "Road slopes along"}
    needs: ClassVar = frozenset({"torque", "known torque"})
    variant_needs: ClassVar = {"": frozenset({"ax"})}
    directions = ("climbs", "falls")
    steepest: ClassVar = {"": 0.35, "wave": 0.35, "stretch": 0.35}
    source = "judgement: the steepest streets climb 35 %"
    mimics: ClassVar = (
        Mimic(
            "rolling_resistance",
            "a constant grade is the same force",
            "an accelerometer along the car",
            variants=("",),
            without=("ax",),
        ),
        Mimic(
            "rolling_resistance",
            "the profile averages out over the lap",
            "a second lap, or the stretch in the other direction",
            variants=("wave", "stretch"),
        ),
        Mimic("wind", "one lap at one speed", "another speed, or the other direction"),
    )

    def external(self, flow: Flow) -> None:
        """Add the longitudinal part of gravity."""
        flow.force_x = flow.force_x - flow.mass * STANDARD_GRAVITY * self.sine(flow)

    def gravity_component(self, s: np.ndarray) -> tuple[Any, Any]:
        """Return what a_x gains."""
        return self.specific_weight(s), 0.0


class RoadBank(_Incline):
    """The road has a bank, left side higher positive: v_y' gains -g sin(angle(s)).

    Source: Rajamani (2012), equation 2.31, with the left side higher.
    """

    id = "road_bank"
    titles: ClassVar = {"": "Road slopes across"}
    needs: ClassVar = frozenset({"lateral velocity"})
    directions = ("rises to the left", "rises to the right")
    steepest: ClassVar = {"": 0.16, "wave": 0.6, "stretch": 0.6}
    source = (
        "AASHTO, A Policy on Geometric Design of Highways and Streets: superelevation of 12 % at most; the "
        "straights of ovals have up to 9 degrees all along, their turns up to 33"
    )
    mimics: ClassVar = (
        Mimic("steer_offset", "little change of speed", "curves to both sides: an offset also turns the car"),
        Mimic("wind", "a straight road in one direction", "the same road in the opposite direction"),
        Mimic("sensor_misalignment", "constant speed on a straight", "position and yaw, or changes of speed"),
        Mimic("yaw_rate_bias", "one speed, without yaw", "yaw, or the same road at two speeds"),
    )

    def external(self, flow: Flow) -> None:
        """Add the lateral part of gravity."""
        flow.force_y = flow.force_y - flow.mass * STANDARD_GRAVITY * self.sine(flow)

    def gravity_component(self, s: np.ndarray) -> tuple[Any, Any]:
        """Return what a_y gains."""
        return 0.0, self.specific_weight(s)
