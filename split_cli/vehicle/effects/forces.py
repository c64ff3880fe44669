"""Terms that add a force or a moment at the centre of gravity: air, rolling, a locked axle."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.effects.search import Course, Range, Search, cg_height, speed_unit
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.wording import Estimates, amount
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import lateral_force

__all__ = ["AeroDrag", "RollingResistance", "Wind", "YawMomentDifferential"]

_DRAG = "judgement: a fifth of the weight at 20 m/s is several times what any body with wings has"
_ROLLING = "judgement: a quarter of the weight is what deep sand takes"
_LOCKED = "judgement: half of what the tyres themselves damp at a brisk speed; a locked axle's tyres do no more"
_SPOOL = "judgement: an axle is locked whose coupling is 20 times as stiff as its tyres are at a brisk speed"
_STORM = "judgement: 30 m/s for a full-size car, a violent storm, in which nobody tests"

# w^2 C_x/4 over L^2 C_F [1], with the track width w, the wheelbase L, an axle's slip stiffness C_x and its cornering
# stiffness C_F. Judgement: tracks are 0.5 to 0.8 of a wheelbase wide (0.06 to 0.16 of its square). Tyres are as stiff
# along as across or up to 1.5 times as stiff (Pacejka, 2012, chapter 4); from half to 2.5 times is allowed.
_USUAL_SLIP_STIFFNESS = 0.1
_LEAST_SLIP_STIFFNESS = 0.03
_MOST_SLIP_STIFFNESS = 0.4
_TRACKS = "judgement: tracks of 0.5 to 0.8 wheelbases, tyres 0.5 to 2.5 times as stiff along as across"
_OF_SLIP = ("slip", "rear slip")  # the variants whose moment the tyres' slip limits
# Slip angle below which a tyre's secant is that at this angle [rad]. Judgement: no curve bends within 1 mrad.
_SMALL_SLIP_ANGLE = 1e-3
# Model-form error of the moment over its size [1]: what is left of it in the project's own cars near their limits,
# with both parameters fitted (docs/decisions/0044), and in two cars of other equations (docs/records).
_ASSUMED = 0.25
_AS_LOCKED = 20.0  # stiffness of a coupling over that of its tyres at a brisk speed [1], see `_SPOOL`


class AeroDrag(Term):
    """The drag is larger than the nominal one: F_x gains -drag v_x^2.

    Source: any text on vehicle dynamics, for example Rajamani (2012), section 4.1.1.
    """

    id = "aero_drag"
    titles: ClassVar = {"": "Added drag"}
    units: ClassVar = {"drag": "N/(m/s)^2"}
    neutral: ClassVar = {"drag": 0.0}
    family = "along"
    needs: ClassVar = frozenset({"torque"})
    discrepancy: ClassVar = (("", "drag", 0.2),)
    mimics: ClassVar = (
        Mimic("rolling_resistance", "the speed hardly changes", "coasting over a wide range of speed"),
        Mimic("mass+drive_gain", "torque mostly balances drag", "hard acceleration and braking at one speed"),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"drag": 0.1 * vehicle.mass * STANDARD_GRAVITY / speed_unit(vehicle) ** 2}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        # No car pushes itself: what is taken off is at most what the nominal has.
        least = vehicle.drag_coefficient / cls.sizes(vehicle)["drag"]
        return Search({"drag": Range(-least, 2.0, 0.01, _DRAG, ends_at_none=True)}, ({"drag": 0.1},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"there is {amount(p['drag'], more='more drag', less='less drag')}"

    def external(self, flow: Flow) -> None:
        """Add the drag force."""
        flow.force_x = flow.force_x - self.parameters["drag"] * flow.vx * flow.vx


class RollingResistance(Term):
    """A constant force opposes the wheels' rolling, shared by the axles like their static loads.

    The front share points along the front wheels, as the nominal resistance does, and so slightly reduces
    turning. It is a part of the tyres' longitudinal force, and acts before what that leaves of their lateral one.
    Vehicles only drive forward here, so the sign of the force is fixed. Source: Rajamani (2012), section 4.1.2.
    """

    order = 2  # before combined slip
    id = "rolling_resistance"
    titles: ClassVar = {"": "Added rolling resistance"}
    units: ClassVar = {"force": "N"}
    neutral: ClassVar = {"force": 0.0}
    family = "along"
    needs: ClassVar = frozenset({"torque"})
    discrepancy: ClassVar = (("", "force", 0.01),)
    mimics: ClassVar = (
        Mimic("road_grade", "a constant grade is the same force m g sin(angle) along the car", exact=True),
        Mimic("aero_drag", "the speed hardly changes", "coasting over a wide range of speed"),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"force": vehicle.mass * STANDARD_GRAVITY}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        nominal = vehicle.rolling_resistance_front + vehicle.rolling_resistance_rear
        least = nominal / cls.sizes(vehicle)["force"]
        return Search({"force": Range(-least, 0.25, 0.001, _ROLLING, ends_at_none=True)}, ({"force": 0.005},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"there is {amount(p['force'], more='more resistance', less='less resistance')} to rolling"

    def lateral(self, flow: Flow) -> None:
        """Take the resistance from the axles' longitudinal forces."""
        car = flow.vehicle
        for axle, lever in ((flow.front, car.cg_to_rear_axle), (flow.rear, car.cg_to_front_axle)):
            axle.longitudinal_force = axle.longitudinal_force - self.parameters["force"] * lever / car.wheelbase


class YawMomentDifferential(Term):
    """A locked axle forces its wheels to equal speeds and resists turning: M_z gains -yaw_damping r.

    The term is the moment of a coupling that is weak against its tyres. A viscous coupling with the torque
    k (w_right - w_left) has a yaw damping of k w^2/r_e^2, with the track width w.

    Variant ``slip``: the tyres' slip limits the moment. A coupling that is not weak makes the wheels slip, and acts
    in series with this slip: M_z gains -(r - r_0)/(1/yaw_damping + v_x/K). Here K = w^2 C_x/4, and C_x is the slip
    stiffness of the driven axles. At low speed this is the default. An axle that is locked, of infinite damping,
    leaves -(r - r_0) K/v_x: its slips are -+ r w/(2 v_x). At the yaw rate r_0 = v_x F_x h a_y/(g K) the wheels
    are equally fast. The reason is that the inner wheel carries less load and slips more under the same
    force. F_x is the force of the driven axles and h the CG height, 0.2 L where the file has none.

    A tyre that slips across by the angle alpha has its force in the direction of its slip. So little slip along meets
    the secant F_y(alpha)/alpha in place of the cornering stiffness C_F. A vehicle file has neither w nor C_x. So
    K = slip_stiffness L^2 F_y(alpha)/alpha, summed over the driven axles, with the wheelbase L. `slip_stiffness` is
    w^2/(4 L^2) times a tyre's stiffness along over that across. Near 0.1 is usual; a diagnosis fits it
    between 0.03 and 0.4, and takes no value of it for a finding.

    Variant ``driven`` is older: r - v_x (F_x/F_z) (a_y/g)/(4 L) replaces r, with F_x and F_z of the driving axle. The
    factor 1/4 was fitted to two of the project's simulated cars (0.25 and 0.26). It is large: theory gives 0.11
    and 0.17 for these two, and in cars of other equations it was 0.06. A diagnosis does not try it.

    Source: Milliken and Milliken (1995), chapter 20; the series of coupling and slip follows from the balance of
    each wheel; slip along and across: Pacejka (2012), section 3.2 (similarity).
    """

    id = "yaw_moment_differential"
    form_error = _ASSUMED
    titles: ClassVar = {"": "Locked differential"}
    in_every_car: ClassVar = True
    through_tires: ClassVar = True
    units: ClassVar = {"yaw_damping": "N m s/rad"}
    variant_units: ClassVar = dict.fromkeys(_OF_SLIP, {"yaw_damping": "N m s/rad", "slip_stiffness": "1"})
    neutral: ClassVar = {"yaw_damping": 0.0}
    constants: ClassVar = frozenset({"slip_stiffness"})
    discrepancy: ClassVar = (("", "yaw_damping", 0.2), ("driven", "yaw_damping", 0.2))
    variants: ClassVar = ("", "driven", *_OF_SLIP)
    variant_words: ClassVar = {
        "driven": "less by drive force in turns",
        "slip": "limited by the slip of the tyres",
        "rear slip": "limited by the slip of the rear tyres",
    }
    mimics: ClassVar = (
        Mimic("cg_shift+tire_stiffness", "steady turns", "steer steps: damping acts at once, slip builds up"),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        # Damping that takes a tenth of what the tyres damp at a brisk speed.
        capacity = vehicle.front_tire.D + vehicle.rear_tire.D
        return {"yaw_damping": 0.25 * capacity * vehicle.wheelbase**2 / speed_unit(vehicle)}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        if variant == "driven" or (variant == "rear slip" and not all(cls._coupled(vehicle, "slip"))):
            return None
        start = {"yaw_damping": 0.05}
        if variant in _OF_SLIP:
            tires, coupled = (vehicle.front_tire, vehicle.rear_tire), cls._coupled(vehicle, variant)
            stiffness = sum(one.cornering_stiffness for one, on in zip(tires, coupled, strict=True) if on)
            limit = _USUAL_SLIP_STIFFNESS * vehicle.wheelbase**2 * stiffness
            most = _AS_LOCKED * limit / speed_unit(vehicle) / cls.sizes(vehicle)["yaw_damping"]
            ranges = {
                "yaw_damping": Range(0.0, most, 0.01, _SPOOL, ends_complete=True),
                "slip_stiffness": Range(_LEAST_SLIP_STIFFNESS, _MOST_SLIP_STIFFNESS, 0.005, _TRACKS),
            }
            return Search(ranges, ({**start, "slip_stiffness": _USUAL_SLIP_STIFFNESS},))
        return Search({"yaw_damping": Range(0.0, 5.0, 0.01, _LOCKED)}, (start,))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        damping = amount(p["yaw_damping"], one_sided=True)
        falling = " at low speed, and less the faster the car is," if variant in _OF_SLIP else ""
        return f"a yaw damping of {damping}{falling} opposes turning, as a locked differential does"

    def external(self, flow: Flow) -> None:
        """Add the moment."""
        damping, dragged = self.parameters["yaw_damping"], flow.r
        if self.variant == "driven":
            dragged = flow.r - self._spun(flow)
        elif self.variant in _OF_SLIP:
            limit = self._tire_limit(flow)
            dragged = flow.r - flow.vx * self._moment_of_loads(flow) / limit
            damping = damping / (1.0 + damping * flow.vx / limit)
        flow.moment = flow.moment - damping * dragged

    @staticmethod
    def _coupled(car: Vehicle, variant: str) -> tuple[bool, bool]:
        """Return whether the front axle's wheels are coupled, and whether the rear axle's are."""
        if variant == "rear slip":
            return False, True
        return car.drive_split_front > 0.0, car.drive_split_front < 1.0

    def _tire_limit(self, flow: Flow) -> Any:
        """Return K, the moment of locked axles over r/v_x [N m]."""
        ops = flow.ops
        secants = []
        for axle, on in zip((flow.front, flow.rear), self._coupled(flow.vehicle, self.variant), strict=True):
            if on:
                angle = ops.sqrt(axle.slip_angle * axle.slip_angle + _SMALL_SLIP_ANGLE**2)
                secants.append(lateral_force(axle.B, axle.C, axle.D, angle, ops) / angle)
        return self.parameters["slip_stiffness"] * flow.vehicle.wheelbase**2 * sum(secants)

    def _moment_of_loads(self, flow: Flow) -> Any:
        """Return the moment of the driving forces if the wheels of an axle slip alike, so that loads share them [N m].

        A wheel's share is that of its load, which the lateral acceleration moves by h a_y/(g w) of the axle's.
        """
        coupled = zip((flow.front, flow.rear), self._coupled(flow.vehicle, self.variant), strict=True)
        force = sum(axle.longitudinal_force for axle, on in coupled if on)
        return force * cg_height(flow.vehicle) * self._side(flow)

    @staticmethod
    def _side(flow: Flow) -> Any:
        """Return the lateral acceleration that the axles give, over g [1]."""
        return (flow.front.lateral_force + flow.rear.lateral_force) / (flow.vehicle.mass * STANDARD_GRAVITY)

    @classmethod
    def _spun(cls, flow: Flow) -> Any:
        """Return the yaw rate at which the driving axle's force alone makes its wheels differ in speed [rad/s]."""
        car = flow.vehicle
        in_front = car.drive_split_front > 0.5
        axle, load = (flow.front, car.static_load_front) if in_front else (flow.rear, car.static_load_rear)
        return flow.vx * (axle.longitudinal_force / load) * cls._side(flow) / (4.0 * car.wheelbase)


class Wind(Term):
    """The air moves over the ground with (wx, wy) in X, Y; the car meets u = v - R(yaw)^T w.

    F = -c |u| u per axis replaces the nominal drag. Lengthwise c is the nominal C_w. The side coefficient of a
    body is several times C_w; the variants take 1 (default), 2.5 (``side``) and 6 (``broadside``) times.
    Without nominal drag the term has no effect. Source: Hucho (1998), chapter 5.
    """

    id = "wind"
    titles: ClassVar = {"": "Wind"}
    units: ClassVar = {"wx": "m/s", "wy": "m/s"}
    neutral: ClassVar = {"wx": 0.0, "wy": 0.0}
    family = "air"
    needs: ClassVar = frozenset({"position"})
    variants: ClassVar = ("", "side", "broadside")
    variant_words: ClassVar = {
        "side": "with a side coefficient 2.5 times that of drag",
        "broadside": "with a side coefficient 6 times that of drag",
    }
    side_ratio: ClassVar = {"": 1.0, "side": 2.5, "broadside": 6.0}
    mimics: ClassVar = (
        Mimic("road_bank+road_grade", "one pass of an open road", "the same place driven in both directions"),
        Mimic("aero_drag", "a straight road in one direction", "a closed lap, or the opposite direction"),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"wx": speed_unit(vehicle), "wy": speed_unit(vehicle)}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        if vehicle.drag_coefficient == 0.0:
            return None
        limits = Range(-1.5, 1.5, 0.01, _STORM)
        return Search({"wx": limits, "wy": limits}, ({"wx": 0.1, "wy": 0.1},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        along = amount(p["wx"], more="along X", less="against X")
        return f"the air moves over the ground, {along} and {amount(p['wy'], more='along Y', less='against Y')}"

    def external(self, flow: Flow) -> None:
        """Replace still-air drag by that of moving air."""
        ops, car = flow.ops, flow.vehicle
        if flow.recording is None:
            cosine, sine = ops.cos(flow.yaw), ops.sin(flow.yaw)
        else:
            cosine, sine = self.cached(flow.yaw, lambda: (np.cos(flow.yaw), np.sin(flow.yaw)))
        wx, wy = self.parameters["wx"], self.parameters["wy"]
        u_x = flow.vx - (wx * cosine + wy * sine)
        u_y = flow.vy - (wy * cosine - wx * sine)
        # In still air the nominal model has no side force, so the part of v_y alone is taken off again.
        still = ops.sqrt(flow.vx * flow.vx + flow.vy * flow.vy + 1e-6)
        speed = ops.sqrt(u_x * u_x + u_y * u_y + 1e-6)
        side = self.side_ratio[self.variant] * car.drag_coefficient
        flow.force_x = flow.force_x - car.drag_coefficient * (speed * u_x - still * flow.vx)
        flow.force_y = flow.force_y - side * (speed * u_y - still * flow.vy)
