"""Terms that add a force or a moment at the centre of gravity: air, rolling, a locked axle."""

from __future__ import annotations

from typing import ClassVar

from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.flow import Flow

__all__ = ["AeroDrag", "RollingResistance", "Wind", "YawMomentDifferential"]


class AeroDrag(Term):
    """Drag beyond the nominal: F_x gains -drag v_x^2.

    Source: any text on vehicle dynamics, for example Rajamani (2012), section 4.1.1.
    """

    id = "aero_drag"
    units: ClassVar = {"drag": "N/(m/s)^2"}
    neutral: ClassVar = {"drag": 0.0}
    mimics: ClassVar = (
        Mimic("rolling_resistance", "the speed hardly changes", "coasting over a wide range of speed"),
        Mimic("mass+drive_gain", "torque mostly balances drag", "hard acceleration and braking at one speed"),
    )

    def external(self, flow: Flow) -> None:
        """Add the drag force."""
        flow.force_x = flow.force_x - self.parameters["drag"] * flow.vx * flow.vx


class RollingResistance(Term):
    """A constant force against v_x: F_x gains -force.

    Vehicles drive forward here, so its sign is fixed. Source: Rajamani (2012), section 4.1.2.
    """

    id = "rolling_resistance"
    units: ClassVar = {"force": "N"}
    neutral: ClassVar = {"force": 0.0}
    mimics: ClassVar = (
        Mimic("road_grade", "a constant grade is the same force m g sin(angle)", exact=True),
        Mimic("aero_drag", "the speed hardly changes", "coasting over a wide range of speed"),
    )

    def external(self, flow: Flow) -> None:
        """Add the resistance."""
        flow.force_x = flow.force_x - self.parameters["force"]


class YawMomentDifferential(Term):
    """A locked axle drags its wheels at different speeds and resists turning: M_z gains -yaw_damping r.

    The wheels' slips are -+ r w/(2 v_x) and saturate like any tyre's; the term is the linear part. Source:
    Milliken and Milliken (1995), chapter 20.
    """

    id = "yaw_moment_differential"
    through_tires: ClassVar = True
    units: ClassVar = {"yaw_damping": "N m s/rad"}
    neutral: ClassVar = {"yaw_damping": 0.0}
    mimics: ClassVar = (
        Mimic("cg_shift+tire_stiffness", "steady turns", "steer steps: damping acts at once, slip builds up"),
    )

    def external(self, flow: Flow) -> None:
        """Add the moment."""
        flow.moment = flow.moment - self.parameters["yaw_damping"] * flow.r


class Wind(Term):
    """Air that moves over the ground with (wx, wy) in X, Y; the car meets u = v - R(yaw)^T w.

    F = -c |u| u per axis in place of the nominal drag, with the nominal C_w lengthwise. The side coefficient of
    a body is several times C_w; the variants take 1 (default), 2.5 (``side``) and 6 (``broadside``) times.
    Without nominal drag the term does nothing. Source: Hucho (1998), chapter 5.
    """

    id = "wind"
    units: ClassVar = {"wx": "m/s", "wy": "m/s"}
    neutral: ClassVar = {"wx": 0.0, "wy": 0.0}
    variants: ClassVar = ("", "side", "broadside")
    side_ratio: ClassVar = {"": 1.0, "side": 2.5, "broadside": 6.0}
    mimics: ClassVar = (
        Mimic("road_bank+road_grade", "one pass of an open road", "the same place driven in both directions"),
        Mimic("aero_drag", "a straight road in one direction", "a closed lap, or the way back"),
    )

    def external(self, flow: Flow) -> None:
        """Replace still-air drag by that of moving air."""
        ops, car = flow.ops, flow.vehicle
        cosine, sine = ops.cos(flow.yaw), ops.sin(flow.yaw)
        wx, wy = self.parameters["wx"], self.parameters["wy"]
        u_x = flow.vx - (wx * cosine + wy * sine)
        u_y = flow.vy - (wy * cosine - wx * sine)
        # In still air the nominal model has no side force, so the part of v_y alone is taken off again.
        still = ops.sqrt(flow.vx * flow.vx + flow.vy * flow.vy + 1e-6)
        speed = ops.sqrt(u_x * u_x + u_y * u_y + 1e-6)
        side = self.side_ratio[self.variant] * car.drag_coefficient
        flow.force_x = flow.force_x - car.drag_coefficient * (speed * u_x - still * flow.vx)
        flow.force_y = flow.force_y - side * (speed * u_y - still * flow.vy)
