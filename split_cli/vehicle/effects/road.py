"""Terms of the road's inclination: gravity along and across the car."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from split_cli.vehicle.effects.place import inside_stretch
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.flow import Flow

__all__ = ["RoadBank", "RoadGrade"]

GRAVITY = 9.80665

_WAVE = {"amplitude": "rad", "wavelength": "m", "phase": "rad"}
_STRETCH = {"angle": "rad", "s_start": "m", "s_end": "m"}


class _Incline(Term):
    """An angle that is constant, a wave over s, amplitude sin(2 pi s/wavelength + phase), or on a stretch."""

    units: ClassVar = {"angle": "rad"}
    variants: ClassVar = ("", "wave", "stretch")
    variant_units: ClassVar = {"wave": _WAVE, "stretch": _STRETCH}
    neutral: ClassVar = {"angle": 0.0, "amplitude": 0.0}

    def angle(self, flow: Flow) -> Any:
        """Return the angle where the car is [rad]."""
        p = self.parameters
        if self.variant == "wave":
            return p["amplitude"] * flow.ops.sin(2.0 * np.pi / p["wavelength"] * flow.s + p["phase"])
        if self.variant == "stretch":
            return p["angle"] * inside_stretch(flow.ops, flow.s, p["s_start"], p["s_end"])
        return p["angle"]


class RoadGrade(_Incline):
    """Gravity along the car, uphill positive: F_x gains -m g sin(angle(s)).

    Source: Rajamani (2012), equation 4.1. A constant angle is the same as rolling resistance and is never
    claimed as a grade; the variants over s are.
    """

    id = "road_grade"
    mimics: ClassVar = (
        Mimic("rolling_resistance", "a constant grade is the same force", exact=True, variants=("",)),
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
        flow.force_x = flow.force_x - flow.mass * GRAVITY * flow.ops.sin(self.angle(flow))


class RoadBank(_Incline):
    """Gravity across the car, left side higher positive: v_y' gains -g sin(angle(s)).

    Source: Rajamani (2012), equation 2.31, with the left side higher.
    """

    id = "road_bank"
    mimics: ClassVar = (
        Mimic("steer_offset", "little change of speed", "curves to both sides: an offset also turns the car"),
        Mimic("wind", "a straight road in one direction", "the way back"),
        Mimic("sensor_misalignment", "constant speed on a straight", "position and yaw, or changes of speed"),
    )

    def external(self, flow: Flow) -> None:
        """Add the lateral part of gravity."""
        flow.force_y = flow.force_y - flow.mass * GRAVITY * flow.ops.sin(self.angle(flow))
