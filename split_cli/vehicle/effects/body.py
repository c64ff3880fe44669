"""Terms of the body: mass, yaw inertia, the centre of gravity's place."""

from __future__ import annotations

from typing import ClassVar

from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.tires import scale_load
from split_cli.vehicle.flow import Flow

__all__ = ["CgShift", "Mass", "YawInertia"]


class Mass(Term):
    """A heavier or lighter car: m scale.

    Variants: the axles' capacity D and their rolling resistance stay (default), or follow the load, in proportion
    (``loaded``) or degressively (``degressive``, as in `load_transfer`).
    Only forces over m and I_z are seen, so the same motion has another reading, below.
    """

    id = "mass"
    units: ClassVar = {"scale": "1"}
    neutral: ClassVar = {"scale": 1.0}
    variants: ClassVar = ("", "loaded", "degressive")
    mimics: ClassVar = (
        Mimic(
            "friction_scale+drive_gain+yaw_inertia+aero_drag+rolling_resistance",
            "only F/m and F/I_z are seen: the whole curve, torque, drag and inertia scaled by 1/scale",
            exact=True,
        ),
        Mimic("drive_gain", "straight driving", "hard turns, and coasting"),
    )

    def body(self, flow: Flow) -> None:
        """Scale the mass."""
        flow.mass = flow.mass * self.parameters["scale"]

    def tire(self, flow: Flow) -> None:
        """Let the axles follow the load where the variant says so."""
        if not self.variant:
            return
        scale, car = self.parameters["scale"], flow.vehicle
        for axle, resistance in (
            (flow.front, car.rolling_resistance_front),
            (flow.rear, car.rolling_resistance_rear),
        ):
            scale_load(axle, scale, self.variant)
            axle.longitudinal_force = axle.longitudinal_force - (scale - 1.0) * resistance


class YawInertia(Term):
    """Another yaw inertia: I_z scale. Seen in transients only."""

    id = "yaw_inertia"
    units: ClassVar = {"scale": "1"}
    neutral: ClassVar = {"scale": 1.0}
    mimics: ClassVar = (
        Mimic("tire_relaxation", "gentle transients at one speed", "steer steps at two speeds"),
        Mimic("steer_lag", "gentle transients", "a fast slalom: lag delays v_y and r alike"),
    )

    def body(self, flow: Flow) -> None:
        """Scale the inertia."""
        flow.yaw_inertia = flow.yaw_inertia * self.parameters["scale"]


class CgShift(Term):
    """A centre of gravity dx further forward: l_f - dx, l_r + dx; the recording stays at the true one.

    Variants: D stays (default), or follows the static loads, in proportion (``loaded``) or degressively.
    """

    id = "cg_shift"
    through_tires: ClassVar = True
    units: ClassVar = {"dx": "m"}
    neutral: ClassVar = {"dx": 0.0}
    variants: ClassVar = ("", "loaded", "degressive")
    mimics: ClassVar = (
        Mimic(
            "sensor_lever_arm+tire_stiffness+yaw_moment_differential",
            "moderate slip: arms, speeds at the axles and yaw moments change together",
            "position and yaw against v_y, and turns near the limit",
        ),
        Mimic("tire_stiffness", "steady turns", "steer steps"),
    )

    def body(self, flow: Flow) -> None:
        """Move the axles."""
        flow.l_f = flow.l_f - self.parameters["dx"]
        flow.l_r = flow.l_r + self.parameters["dx"]

    def tire(self, flow: Flow) -> None:
        """Let the axles follow the static loads where the variant says so."""
        if self.variant:
            car, dx = flow.vehicle, self.parameters["dx"]
            scale_load(flow.front, 1.0 + dx / car.cg_to_rear_axle, self.variant)
            scale_load(flow.rear, 1.0 - dx / car.cg_to_front_axle, self.variant)
