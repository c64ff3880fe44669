"""Terms that add a force or a moment at the centre of gravity."""

from __future__ import annotations

from typing import ClassVar

from split_cli.vehicle.effects.term import Term
from split_cli.vehicle.single_track import Flow

__all__ = ["AeroDrag", "RollingResistance", "YawMomentDifferential"]


class AeroDrag(Term):
    """Drag beyond the nominal: F_x gains -drag v_x^2. Mimicked by rolling resistance at nearly constant speed."""

    id = "aero_drag"
    units: ClassVar = {"drag": "N/(m/s)^2"}

    def external(self, flow: Flow) -> None:
        """Add the drag force."""
        flow.force_x = flow.force_x - self.parameters["drag"] * flow.vx * flow.vx


class RollingResistance(Term):
    """A constant force against v_x: F_x gains -force. A constant road grade is the same thing."""

    id = "rolling_resistance"
    units: ClassVar = {"force": "N"}

    def external(self, flow: Flow) -> None:
        """Add the resistance; vehicles drive forward here, so its sign is fixed."""
        flow.force_x = flow.force_x - self.parameters["force"]


class YawMomentDifferential(Term):
    """A locked axle resists turning: M_z gains -yaw_damping r. Mimicked by cg_shift with tire_stiffness."""

    id = "yaw_moment_differential"
    units: ClassVar = {"yaw_damping": "N m s/rad"}

    def external(self, flow: Flow) -> None:
        """Add the moment."""
        flow.moment = flow.moment - self.parameters["yaw_damping"] * flow.r
