"""Terms of the tyres: grip of road, place and time, axle loads, combined slip."""

import math
import operator
from collections.abc import Mapping
from typing import Any, ClassVar

from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.effects.late import rate_of
from split_cli.vehicle.effects.place import PLACE_COMPLEXITY, inside_stretch, place_ranges, stretch_in_words
from split_cli.vehicle.effects.search import Course, Range, Search, cg_height, speed_unit, time_unit
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.wording import Estimates, amount, number, percent, scaled
from split_cli.vehicle.flow import AxleFlow, Flow
from split_cli.vehicle.operations import Operations
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import LEAST_CAPACITY, lateral_force, share_beside_longitudinal

# What the catalogue is made of: every name here is a term.
__all__ = ["AeroDownforce", "CombinedSlip", "FrictionPatch", "FrictionScale", "GripFade", "LoadTransfer"]

_SOME_BRAKING = 0.6  # share of the largest braking torque at which lost grip is stated
_LONG_AGAINST = 0.5  # relative error of a time constant beyond which only its ratio to the loss is known

_ELLIPSE = "judgement: grip along the car is more than half of that across it, which would be 4"
_GRIP = "judgement: tyre and road have a friction of 0.1 (wet ice) to 2.2 (racing tyres)"
_LEAST_FRICTION, _MOST_FRICTION = 0.1, 2.2
_FADE = "judgement: from a dry road to ice, or from cold tyres to warm ones"
_HEIGHT = "Heydinger et al. (1999), SAE 1999-01-1336: 0.17 to 0.3 wheelbases for cars and light trucks; judgement: 0.5"
_PITCH = "Gillespie (1992), chapter 5: cars pitch at 1 to 2 Hz, damped by 0.2 to 0.5 of the critical; judgement: 0.2 s"
# Of two tyres at loads 1 -+ l an axle keeps 1 - e l^2 [1]. Slope: half the curvature of sin(2 atan(F/F_c)) over its
# value, at a third of the load F_c where the slope is largest (Pacejka, 2012, section 4.3). Peak: judgement, friction
# falls by a tenth as the load doubles. The least keeps curves positive.
_SLOPE_OF_UNEQUAL_LOADS, _PEAK_OF_UNEQUAL_LOADS, _LEAST_OF_UNEQUAL_LOADS = 0.25, 0.1, 0.3
_TRACK = 0.58  # track width over wheelbase [1]; judgement: 0.5 to 0.7 in cars
_BENT = {"curve": frozenset({"hard turns"})}
LOAD_LAWS = {
    "loaded": "with tyre forces in proportion to the load",
    "peak": "with peak forces of the tyres alone in proportion to the load",
    "degressive": "with tyre forces less than in proportion to the load",
}
"""What a reader calls the variants of terms that load the tyres; see `scale_load`."""
_SCALED = {"curve": "of the whole tyre curve, stiffness included"}
_LOADED = (
    "judgement: with 7 m^2 of C_L A on 250 kg, most of any Formula Student car, an axle has 0.4, and 0.25 in "
    "Formula 1; a car may lack that much, and have twice as much"
)


def _grip_range(vehicle: Vehicle) -> Range:
    """Return scales that leave the whole car with a friction that tyres and roads have."""
    friction = (vehicle.front_tire.D + vehicle.rear_tire.D) / (vehicle.mass * STANDARD_GRAVITY)
    lower = min(max(_LEAST_FRICTION / friction, 0.15), 0.9)
    return Range(lower, max(_MOST_FRICTION / friction, 1.2), 0.01, _GRIP)


def _curve(variant: str) -> str:
    return "the tyres' whole curve" if variant == "curve" else "grip"


def scale_load(axle: AxleFlow, ratio: Any, variant: str, ops: Operations) -> None:
    """Let an axle's curve follow its static load, which becomes `ratio` of what it was, see `_follow_load`."""
    before = _load(axle, ops)
    axle.static_load = axle.static_load * ratio
    _follow_load(axle, _load(axle, ops) / before, variant)


def add_load(axle: AxleFlow, share: Any, variant: str, ops: Operations) -> None:
    """Let an axle's curve follow a load that is added to it, a share of the static load in the vehicle file.

    Loads of several terms add up: what braking moves to an axle is a smaller part of its load where air presses on it.
    """
    before = _load(axle, ops)
    axle.moved_load = axle.moved_load + share
    _follow_load(axle, _load(axle, ops) / before, variant)


def _load(axle: AxleFlow, ops: Operations) -> Any:
    """Return the load of an axle as a share of the static load in the vehicle file [1]; no axle lifts off."""
    return ops.maximum(axle.static_load + axle.moved_load, LEAST_CAPACITY)


def _follow_load(axle: AxleFlow, ratio: Any, variant: str) -> None:
    """Let an axle's curve follow its load, which is `ratio` of that before.

    Peak and stiffness in proportion by default, degressively (peak by the power 0.9, stiffness by 0.5, as tyres
    near their rated load do: Pacejka, 2012, section 4.3) for ``degressive``, the peak alone for ``peak``.
    """
    if variant == "peak":
        _scale_grip(axle, ratio, False)
    elif variant.startswith("degressive"):
        axle.D = axle.D * ratio**0.9
        axle.B = axle.B * ratio**-0.4
    else:
        axle.D = axle.D * ratio


def _scale_grip(axle: AxleFlow, scale: Any, whole_curve: bool) -> None:
    """Scale an axle's peak, F = scale D sin(C atan(B alpha/scale)), or its whole curve, scale F."""
    axle.D = axle.D * scale
    if not whole_curve:
        axle.B = axle.B / scale


class CombinedSlip(Term):
    """An axle that drives or brakes has less lateral grip: F_y sqrt(1 - strength (F_x/D)^2) per axle.

    Strength 1 is the friction ellipse with equal axes. F_x is the nominal longitudinal force of the axle.
    Source: Pacejka (2012), section 3.2; Rajamani (2012), section 13.5.
    """

    id = "combined_slip"
    titles: ClassVar = {"": "Tyres share their grip"}
    in_every_car: ClassVar = True
    through_tires: ClassVar = True
    units: ClassVar = {"strength": "1"}
    neutral: ClassVar = {"strength": 0.0}
    discrepancy: ClassVar = (("", "strength", 0.5),)
    order = 3
    mimics: ClassVar = (
        Mimic("load_transfer", "braking in turns only", "driving and braking in turns: the two differ in sign"),
        Mimic("friction_scale", "torque of one size in every turn", "turns without torque"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return Search({"strength": Range(0.0, 4.0, 0.02, _ELLIPSE)}, ({"strength": 0.3},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"driving and braking reduce lateral grip, with a strength of {amount(p['strength'], one_sided=True)}"

    @classmethod
    def example(cls, p: Estimates, vehicle: Vehicle) -> str:
        """Return how much lateral force an axle loses under hard braking, where it loses most."""
        torque = _SOME_BRAKING * vehicle.max_brake_torque / vehicle.wheel_radius
        front = vehicle.brake_split_front * torque / vehicle.front_tire.D
        rear = (1.0 - vehicle.brake_split_front) * torque / vehicle.rear_tire.D
        axle, used = ("front", front) if front >= rear else ("rear", rear)
        lost = 1.0 - math.sqrt(max(1.0 - p["strength"].value * used**2, 0.0))
        return (
            f": the {axle} axle loses {number(100.0 * lost, 2)} % of its lateral force at "
            f"{percent(_SOME_BRAKING)} of the largest braking torque"
        )

    def lateral(self, flow: Flow) -> None:
        """Take from the lateral force what the longitudinal uses."""
        for axle in (flow.front, flow.rear):
            left = flow.cached(
                share_beside_longitudinal, axle.longitudinal_force, axle.D, self.parameters["strength"], flow.ops
            )
            axle.lateral_force = flow.cached(operator.mul, axle.lateral_force, left)


class FrictionScale(Term):
    """The grip of the whole road differs: by default the peak, scale D sin(C atan(B alpha/scale)).

    The default keeps the stiffness. Variant ``curve`` scales the whole curve. Variants ``front`` and ``rear``
    scale the peak of one axle alone: its tyres are others, or worn, or cold. Source: Pacejka (2012), section 4.3.1, the
    factor lambda_mu.
    """

    id = "friction_scale"
    factors: ClassVar = {
        "scale": ("Tyre grip", "more", "less"),
        "front/scale": ("Grip of the front tyres", "more", "less"),
        "rear/scale": ("Grip of the rear tyres", "more", "less"),
    }
    scales_curve: ClassVar = True
    in_every_car: ClassVar = True
    through_tires: ClassVar = True
    states_peak: ClassVar = True
    units: ClassVar = {"scale": "1"}
    neutral: ClassVar = {"scale": 1.0}
    discrepancy: ClassVar = (("", "scale", -0.15),)
    variants: ClassVar = ("", "curve", "front", "rear")
    variant_words: ClassVar = {**_SCALED, "front": "of the front axle alone", "rear": "of the rear axle alone"}
    variant_needs: ClassVar = _BENT
    axles: ClassVar = ("front", "rear")
    mimics: ClassVar = (
        Mimic(
            "friction_scale+tire_stiffness",
            "scaling the curve scales its peak and both stiffnesses",
            exact=True,
            variants=("curve",),
        ),
        Mimic("tire_stiffness", "no turn near the limit", "a turn near the limit"),
        Mimic("grip_fade", "short drives", "gentle and hard turns at the start and at the end"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return Search({"scale": _grip_range(vehicle)}, ({"scale": 0.97},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        what = scaled(p["scale"], "higher", "lower")
        if variant in cls.axles:
            return f"grip of the {variant} axle is {what}"
        return f"{_curve(variant)} is {what} on the whole road"

    def tire(self, flow: Flow) -> None:
        """Scale both axles, or one."""
        for name in (self.variant,) if self.variant in self.axles else self.axles:
            _scale_grip(getattr(flow, name), self.parameters["scale"], self.variant == "curve")


class FrictionPatch(Term):
    """The grip differs on one stretch, [s_start, s_end), for each axle while it is there.

    The variants are those of `friction_scale`.
    """

    id = "friction_patch"
    factors: ClassVar = {"scale": ("Grip on one stretch", "more", "less")}
    through_tires: ClassVar = True
    units: ClassVar = {"scale": "1", "s_start": "m", "s_end": "m"}
    neutral: ClassVar = {"scale": 1.0}
    family = "place"
    needs: ClassVar = frozenset({"position"})
    variants: ClassVar = ("", "curve")
    variant_words: ClassVar = _SCALED
    variant_needs: ClassVar = _BENT
    mimics: ClassVar = (
        Mimic("friction_scale", "turns only inside the stretch", "turns elsewhere"),
        Mimic("grip_fade", "the stretch is passed once", "a second lap"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        ranges = {"scale": _grip_range(vehicle), **place_ranges(course.reach)}
        return Search(ranges, located="patch", complexity=PLACE_COMPLEXITY)

    @classmethod
    def everywhere(cls, variant: str) -> tuple[Term, float]:
        """Return a little less grip all along."""
        return cls({"scale": 0.97, "s_start": 0.0, "s_end": 1e12}, variant), -0.03

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        size = scaled(p["scale"], "higher", "lower")
        return f"{stretch_in_words(p)} {_curve(variant)} is {size} than elsewhere"

    def tire(self, flow: Flow) -> None:
        """Scale each axle while it is on the stretch."""
        p = self.parameters
        for axle, ahead in ((flow.front, flow.l_f), (flow.rear, -flow.l_r)):
            inside = inside_stretch(flow.ops, flow.s + ahead, p["s_start"], p["s_end"])
            _scale_grip(axle, 1.0 + (p["scale"] - 1.0) * inside, self.variant == "curve")


class GripFade(Term):
    """The grip changes with time: 1 - final_loss (1 - exp(-t/tau)), t from the drive's first sample.

    A negative loss is growing grip (tyres that warm up). If t stays short compared with tau, only the ratio of
    final_loss to tau is observable. The variants are those of `friction_scale`.
    """

    id = "grip_fade"
    titles: ClassVar = {"": "Tyre grip fades"}
    through_tires: ClassVar = True
    states_peak: ClassVar = True
    units: ClassVar = {"final_loss": "1", "tau": "s"}
    neutral: ClassVar = {"final_loss": 0.0}
    family = "time"
    variants: ClassVar = ("", "curve")
    variant_words: ClassVar = _SCALED
    variant_needs: ClassVar = _BENT
    mimics: ClassVar = (
        Mimic("friction_scale", "tau much shorter than the drive", "hard driving in the first seconds"),
        Mimic("friction_patch", "the stretch is passed once, late", "a second lap"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        duration = course.duration
        # A fade that is over at once is less grip all along, `friction_scale`.
        tau = Range(0.02 * duration, 10.0 * duration, 0.02 * duration, ends_as_another=True)
        starts = tuple({"final_loss": 0.05, "tau": share * duration} for share in (0.1, 0.3, 1.0))
        loss = Range(-0.9, 0.9, 0.01, _FADE, share_of_whole=True)
        return Search({"final_loss": loss, "tau": tau}, starts)

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        loss, tau = p["final_loss"], p["tau"]
        verb = "fades" if loss.value >= 0.0 else "grows"
        if tau.std_error is not None and tau.std_error > _LONG_AGAINST * abs(tau.value):
            rate = number(100.0 * abs(loss.value / tau.value), 2)
            return f"{_curve(variant)} {verb} with time, at first by {rate} % a second (how far it goes is not known)"
        size, pace = amount(loss, share=True, more="less", less="more"), number(tau.value)
        return f"{_curve(variant)} {verb} with time, to {size} in the end, with a time constant of {pace} s"

    def tire(self, flow: Flow) -> None:
        """Scale both axles by the grip of the moment."""
        p = self.parameters
        # An export's caller may give any time; before the first sample nothing has faded.
        driven = flow.ops.maximum(flow.t, 0.0)
        scale = 1.0 - p["final_loss"] * (1.0 - flow.ops.exp(-driven / p["tau"]))
        for axle in (flow.front, flow.rear):
            _scale_grip(axle, scale, self.variant == "curve")


class LoadTransfer(Term):
    """Acceleration moves load to the rear axle: dF_z = m a_x h/L, and D follows the load.

    `cg_height` is the total height h. The specific force a_x in the vehicle plane comes from the forces of this
    same model. The lateral forces in it are those before the transfer. Variants: ``peak`` keeps the stiffness
    and scales the peak only; ``degressive`` scales the peak by the power 0.9 of the load and the stiffness by
    the power 0.5. Source: Rajamani (2012), section 4.1.5 (longitudinal tyre load).

    The variants ``late`` and ``degressive late`` let the body pitch on its springs first. The load is a state of
    the model there: tau dF_z' = m a_x h/L - dF_z, steady at each start. An oscillator of natural frequency w and
    damping ratio zeta follows slow changes by 2 zeta/w late. Source: Gillespie (1992), chapter 5.

    Variant ``higher`` is `degressive` for a CG that is higher than the file's by `cg_height`, and takes what it
    costs in turns. Of an axle's two loads 1 -+ l with l = 2 h a_y/(g w), the curve of a tyre over its load makes
    1 - e l^2. The nominal tyres have that for their own height h_0; the axles lose e (l^2 - l_0^2) more. Here
    e = 0.25 for the stiffness and 0.1 for the peak, and a track w of 0.58 L is assumed; without `cg_height` in
    the file h_0 = 0.2 L. Source: Milliken and Milliken (1995), chapter 18.
    """

    id = "load_transfer"
    titles: ClassVar = {"": "Load transfer, as of a centre of gravity at a height"}
    in_every_car: ClassVar = True
    through_tires: ClassVar = True
    units: ClassVar = {"cg_height": "m"}
    variant_units: ClassVar = dict.fromkeys(("late", "degressive late"), {"cg_height": "m", "tau": "s"})
    neutral: ClassVar = {"cg_height": 0.0}
    discrepancy: ClassVar = (("", "cg_height", 0.2), ("peak", "cg_height", 0.2))
    variants: ClassVar = ("", "peak", "degressive", "late", "degressive late", "higher")
    variant_words: ClassVar = {
        **LOAD_LAWS,
        "late": "after the body has pitched",
        "degressive late": f"after the body has pitched, {LOAD_LAWS['degressive']}",
        "higher": "of a centre of gravity that is higher than the file's",
    }
    variant_needs: ClassVar = {"higher": frozenset({"simulation"})}
    loads_tires: ClassVar = True
    state_units: ClassVar = {"moved": "N"}
    mimics: ClassVar = (
        Mimic("combined_slip", "braking in turns only", "driving and braking in turns: the two differ in sign"),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"cg_height": vehicle.wheelbase, "tau": time_unit(vehicle)}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        ranges, start = {"cg_height": Range(0.0, 0.5, 0.005, _HEIGHT)}, {"cg_height": 0.05}
        if variant in cls.variant_units:
            ranges["tau"], start["tau"] = Range(0.0, 0.2, 0.001, _PITCH), 0.05
        return Search(ranges, (start,))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        if variant == "higher":
            return f"the centre of gravity is {amount(p['cg_height'], one_sided=True, more='higher', less='lower')}"
        height = amount(p["cg_height"], one_sided=True, more="high", less="high")
        late = f", with a time constant of {amount(p['tau'], one_sided=True)}" if "tau" in p else ""
        return f"accelerating and braking move axle load as a centre of gravity {height} does{late}"

    @classmethod
    def example(cls, p: Estimates, vehicle: Vehicle) -> str:
        """Return the load that an acceleration moves."""
        return f": {number(vehicle.mass * p['cg_height'].value / vehicle.wheelbase)} N for each m/s^2"

    @property
    def state_names(self) -> tuple[str, ...]:
        """Name of the load that has moved, where it follows late."""
        return (f"{self.id}.moved",) if "tau" in self.parameters else ()

    @property
    def rate(self) -> Any:
        """1/tau [1/s]; infinite for a tau that is too short to be seen."""
        return rate_of(self.parameters["tau"])

    def fastest_rate(self, speed: float) -> float:
        """1/tau; what follows at once is not stepped."""
        rate = float(self.rate) if "tau" in self.parameters else math.inf
        return rate if math.isfinite(rate) else 0.0

    def tire(self, flow: Flow) -> None:
        """Move capacity between the axles."""
        front, rear, car, ops = flow.front, flow.rear, flow.vehicle, flow.ops
        side = lateral_force(front.B, front.C, front.D, front.slip_angle, ops)
        force_x = (
            rear.longitudinal_force
            + front.longitudinal_force * ops.cos(flow.delta)
            - side * ops.sin(flow.delta)
            - car.drag_coefficient * flow.vx * flow.vx
        )
        moved = force_x * self.parameters["cg_height"] / car.wheelbase
        if "tau" in self.parameters:
            moved = self.first_order(flow, "moved", moved, self.rate)
        lost = self._moved_across(flow, side) if self.variant == "higher" else None
        for axle, change in ((front, -moved / car.static_load_front), (rear, moved / car.static_load_rear)):
            add_load(axle, change, self._law, ops)
            if lost is not None:
                peak = ops.maximum(1.0 - _PEAK_OF_UNEQUAL_LOADS * lost, _LEAST_OF_UNEQUAL_LOADS)
                slope = ops.maximum(1.0 - _SLOPE_OF_UNEQUAL_LOADS * lost, _LEAST_OF_UNEQUAL_LOADS)
                axle.D, axle.B = axle.D * peak, axle.B * slope / peak

    @property
    def _law(self) -> str:
        return "degressive" if self.variant == "higher" else self.variant

    def _moved_across(self, flow: Flow, side: Any) -> Any:
        """Return l^2 - l_0^2 of the loads that lateral acceleration moves [1]; `side` is the front axle's force."""
        car, rear = flow.vehicle, flow.rear
        force = side + lateral_force(rear.B, rear.C, rear.D, rear.slip_angle, flow.ops)
        own, width = cg_height(car), _TRACK * car.wheelbase
        height = own + self.parameters["cg_height"]
        per_g = 4.0 * (height * height - own * own) / (width * width)
        return per_g * (force / (car.mass * STANDARD_GRAVITY)) ** 2

    @classmethod
    def laws(cls, variant: str = "") -> tuple[str, ...]:
        """Return the laws of load along the car; what moves across is an effect of its own."""
        return () if variant == "higher" else tuple(one for one in super().laws(variant) if one != "higher")


class AeroDownforce(Term):
    """The axle load grows with speed: D (1 + c v_x^2/F_z,static), with c `front` and `rear`.

    The rolling resistance grows likewise. The variants are laws of load as in `load_transfer`. Source: Milliken
    and Milliken (1995), chapter 15.
    """

    id = "aero_downforce"
    titles: ClassVar = {"": "Downforce"}
    in_every_car: ClassVar = True
    through_tires: ClassVar = True
    units: ClassVar = {"front": "N/(m/s)^2", "rear": "N/(m/s)^2"}
    neutral: ClassVar = {"front": 0.0, "rear": 0.0}
    discrepancy: ClassVar = (("", "front", 0.3), ("", "rear", 0.3))
    variants: ClassVar = ("", "peak", "degressive")
    variant_words: ClassVar = LOAD_LAWS
    loads_tires: ClassVar = True
    mimics: ClassVar = (
        Mimic("tire_stiffness", "one speed in every turn", "the same turn at two speeds"),
        Mimic("friction_scale", "one speed in every turn", "the same turn at two speeds"),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        # What changes an axle's load by its static weight at a brisk speed: 5.4 N/(m/s)^2 for 250 kg on 1.53 m.
        unit = 0.5 * vehicle.mass * STANDARD_GRAVITY / speed_unit(vehicle) ** 2
        return {"front": unit, "rear": unit}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        limits = Range(-0.4, 0.8, 0.02, _LOADED)
        return Search({"front": limits, "rear": limits}, ({"front": 0.1, "rear": 0.1},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        front, rear = (amount(p[name], more="more", less="less") for name in ("front", "rear"))
        return f"axle load changes with speed squared: {front} at the front, {rear} at the rear"

    def tire(self, flow: Flow) -> None:
        """Raise D with speed."""
        car, speed2 = flow.vehicle, flow.vx * flow.vx
        for axle, name, load, resistance in (
            (flow.front, "front", car.static_load_front, car.rolling_resistance_front),
            (flow.rear, "rear", car.static_load_rear, car.rolling_resistance_rear),
        ):
            share = flow.ops.maximum(self.parameters[name] * speed2 / load, LEAST_CAPACITY - 1.0)
            add_load(axle, share, self.variant, flow.ops)
            axle.longitudinal_force = axle.longitudinal_force - share * resistance
