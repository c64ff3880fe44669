"""Terms between command and car: what becomes of torque and steer angle on their way."""

from typing import ClassVar

from split_cli.vehicle.effects.late import Delayed, Lagging, rate_of
from split_cli.vehicle.effects.search import Course, Range, Search
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.wording import Estimates, amount, late, scaled
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

__all__ = ["DriveDelay", "DriveGain", "DriveLag", "SteerBacklash", "SteerDelay", "SteerGain", "SteerLag", "SteerOffset"]

_RATIO = "judgement: steering ratios of road cars lie within 12 and 20, so a wrong one is off by less than 1.8"
_NOT_SHOWN = 100.0  # [%] within which a torque may be off that a drive does not show, as without any braking
_PLAY = "judgement: six degrees at the wheel, the worst linkage of a model car"
_ZERO = "judgement: six degrees at the wheel, 90 at a steering wheel, would be seen by any driver"


class DriveDelay(Delayed):
    """The torque arrives late by `delay`: T(t - delay). Only a logged command can show it."""

    id = "drive_delay"
    titles: ClassVar = {"": "Drive torque late"}
    late_inputs = ("T",)
    family = "along"
    needs: ClassVar = frozenset({"torque", "torque changes"})
    mimics: ClassVar = (
        Mimic("drive_lag", "torque that changes slowly", "a torque step"),
        Mimic("sensor_delay", "steering that hardly changes", "a steer step"),
    )

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"torque arrives {late(p['delay'])}"


class DriveGain(Term):
    """The torque is scaled: drive_gain T where T > 0, brake_gain T where T < 0."""

    id = "drive_gain"
    factors: ClassVar = {"drive_gain": ("Drive torque", "strong", "weak"), "brake_gain": ("Brakes", "strong", "weak")}
    units: ClassVar = {"drive_gain": "1", "brake_gain": "1"}
    neutral: ClassVar = {"drive_gain": 1.0, "brake_gain": 1.0}
    family = "along"
    needs: ClassVar = frozenset({"torque", "torque changes"})
    discrepancy: ClassVar = (("", "drive_gain", 0.1), ("", "brake_gain", 0.1))
    order = 1
    mimics: ClassVar = (
        Mimic("mass+friction_scale+yaw_inertia", "only F/m is observable", exact=True),
        Mimic("rolling_resistance", "torque of one size", "driving at several torques"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        source = "judgement: a torque that a file does not know better is another car's"
        limits = Range(0.3, 2.5, 0.01, source)
        ranges = {"drive_gain": limits, "brake_gain": limits}
        return Search(ranges, ({"drive_gain": 0.97, "brake_gain": 0.97},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        gains = {
            kind: (p[name], scaled(p[name], "too strong", "too weak"))
            for kind, name in (("driving", "drive_gain"), ("braking", "brake_gain"))
        }
        right = [kind for kind, (one, _) in gains.items() if one.interval_95[0] <= 1.0 <= one.interval_95[1]]
        if len(right) != 1:
            return f"driving torque arrives {gains['driving'][1]} and braking torque {gains['braking'][1]}"
        # What differs comes first; of the other half the data only say how little it can differ.
        (wrong,) = set(gains) - set(right)
        most = 100.0 * max(abs(limit - 1.0) for limit in gains[right[0]][0].interval_95)
        if most >= _NOT_SHOWN:
            return f"{wrong} torque arrives {gains[wrong][1]}; of {right[0]} torque the drive tells nothing"
        return (
            f"{wrong} torque arrives {gains[wrong][1]}, while {right[0]} torque is as it should be, within {most:.2g} %"
        )

    def actuate(self, flow: Flow) -> None:
        """Scale the torque by its sign."""
        p = self.parameters
        flow.T = flow.T * flow.ops.where(flow.T > 0.0, p["drive_gain"], p["brake_gain"])


class DriveLag(Lagging):
    """The torque follows its command with a first-order lag: tau T' = T_command - T, steady at each start.

    In the variant ``along`` only the longitudinal force lags: F_x = (T - T_command)/r_e is added to the plain
    model. Training adds this variant to a set (scoring/torque_lag.py), because the lateral corrections of the
    set are learned with the command.
    """

    id = "drive_lag"
    titles: ClassVar = {"": "Drive torque lags"}
    in_every_car: ClassVar = True
    variants: ClassVar = ("", "changed", "along")
    variant_words: ClassVar = {
        "changed": "longer or shorter than the simulation's",
        "along": "in the force along the car alone",
    }
    family = "along"
    needs: ClassVar = frozenset({"torque", "torque changes"})
    discrepancy: ClassVar = (("", "tau", 0.03), ("", "tau", 0.10))
    states = ("torque",)
    state_units: ClassVar = {"torque": "N m", "torque_shared": "N m"}
    mimics: ClassVar = (
        Mimic("drive_delay", "torque that changes slowly", "a torque step"),
        Mimic("sensor_delay", "steering that hardly changes", "a steer step"),
    )

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"torque builds up with a time constant {_constant(p, variant)}"

    def actuate(self, flow: Flow) -> None:
        """Let the torque follow its command."""
        if self.variant != "along":
            flow.T = self.arrived(flow, "torque", flow.T, rate_of)

    def external(self, flow: Flow) -> None:
        """Let the force along the car alone follow the command."""
        if self.variant == "along":
            late = self.arrived(flow, "torque", flow.T, rate_of) - flow.T
            flow.force_x = flow.force_x + late / flow.vehicle.wheel_radius


def _constant(p: Estimates, variant: str) -> str:
    """Return what is said of a time constant, after "with a time constant"."""
    if variant != "changed":
        return f"of {amount(p['tau'], one_sided=True)}"
    return f"{amount(p['tau'], more='longer', less='shorter')} than in the simulation, which lags as well"


class SteerDelay(Delayed):
    """The steering responds late by `delay`: delta(t - delay)."""

    id = "steer_delay"
    titles: ClassVar = {"": "Steering late"}
    late_inputs = ("delta",)
    through_tires: ClassVar = True
    family = "steering"
    mimics: ClassVar = (
        Mimic("steer_lag", "steering below about 1 Hz", "a steer step, or fast slalom"),
        Mimic("sensor_delay", "torque that hardly changes", "a torque step"),
        Mimic("tire_relaxation", "one speed", "the same manoeuvre at two speeds"),
    )

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"the steering answers {late(p['delay'])}"


class SteerGain(Term):
    """The steering ratio differs from the nominal one: gain delta."""

    id = "steer_gain"
    factors: ClassVar = {"gain": ("Steering", "more than commanded", "less than commanded")}
    through_tires: ClassVar = True
    units: ClassVar = {"gain": "1"}
    neutral: ClassVar = {"gain": 1.0}
    family = "steering"
    discrepancy: ClassVar = (("", "gain", 0.05),)
    order = 1
    mimics: ClassVar = (Mimic("tire_stiffness", "small steer angles at one speed", "turns at low and at high speed"),)

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return Search({"gain": Range(0.5, 1.8, 0.005, _RATIO)}, ({"gain": 0.98},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"the wheels turn {scaled(p['gain'], 'more than commanded', 'less than commanded')}"

    def actuate(self, flow: Flow) -> None:
        """Scale the steer angle."""
        flow.delta = flow.delta * self.parameters["gain"]


class SteerBacklash(Term):
    """The steering has play of total `width`: the wheel keeps its angle until it is pushed or pulled.

    As a differential equation, the wheel is drawn to the edge of the play at 200 1/s. Along a recording the
    exact play operator is used, centred at each start.
    """

    id = "steer_backlash"
    titles: ClassVar = {"": "Steering play"}
    units: ClassVar = {"width": "rad"}
    neutral: ClassVar = {"width": 0.0}
    family = "steering"
    order = 2
    states = ("angle",)
    state_units: ClassVar = {"angle": "rad"}
    mimics: ClassVar = (
        Mimic("steer_delay", "steering at one rate", "slow and fast steering, and holding still after a turn"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        starts = tuple({"width": value} for value in (0.0003, 0.001, 0.003, 0.01, 0.03))
        return Search({"width": Range(0.0, 0.1, 0.0001, _PLAY)}, starts)

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"the steering has a play of {amount(p['width'], one_sided=True)} in all"

    def fastest_rate(self, speed: float) -> float:
        """The rate at which the play closes."""
        return 200.0

    def actuate(self, flow: Flow) -> None:
        """Drag the wheel along."""
        flow.delta = self.play(flow, "angle", flow.delta, self.parameters["width"])


class SteerLag(Lagging):
    """The steering follows its command with a first-order lag: tau delta' = delta_command - delta.

    The lag is steady at each start. In the variant ``learned`` it acts as far as a trained set knows. Of the lag
    the share 1 - v/S0 counts, where v is the variance of the set's process and S0 its prior. Training adds this
    variant to a set (scoring/likeliest_lag.py): at slips without labels, early wheels may cancel another error.
    """

    id = "steer_lag"
    titles: ClassVar = {"": "Steering lags"}
    in_every_car: ClassVar = True
    through_tires: ClassVar = True
    family = "steering"
    variants: ClassVar = ("", "changed", "learned")
    variant_words: ClassVar = {
        "changed": "longer or shorter than the simulation's",
        "learned": "as far as the trained set knows",
    }
    discrepancy: ClassVar = (("", "tau", 0.02), ("", "tau", 0.06))
    states = ("angle",)
    state_units: ClassVar = {"angle": "rad", "angle_shared": "rad"}
    mimics: ClassVar = (
        Mimic("steer_delay", "steering below about 1 Hz", "a steer step, or fast slalom"),
        Mimic("sensor_delay", "torque that hardly changes, steering below about 1 Hz", "a torque step"),
        Mimic("tire_relaxation", "one speed", "the same manoeuvre at two speeds"),
    )

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"steering builds up with a time constant {_constant(p, variant)}"

    @property
    def asks_knowledge(self) -> bool:
        """Whether the lag acts only as far as a trained set has learned."""
        return self.variant == "learned"

    def actuate(self, flow: Flow) -> None:
        """Let the steer angle follow its command."""
        arrived = self.arrived(flow, "angle", flow.delta, rate_of)
        flow.delta = flow.delta + flow.knowledge * (arrived - flow.delta) if self.asks_knowledge else arrived


class SteerOffset(Term):
    """The steering has a zero offset: delta + offset, applied after all other actuator terms."""

    id = "steer_offset"
    titles: ClassVar = {"": "Steering off centre"}
    units: ClassVar = {"offset": "rad"}
    neutral: ClassVar = {"offset": 0.0}
    family = "steering"
    order = 4
    mimics: ClassVar = (
        Mimic("road_bank", "little change of speed", "curves to both sides at several speeds"),
        Mimic("sensor_misalignment", "steady driving", "position and yaw"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return Search({"offset": Range(-0.1, 0.1, 0.0005, _ZERO)}, ({"offset": 0.002},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"the road wheels are {amount(p['offset'], more='too far to the left', less='too far to the right')}"

    def actuate(self, flow: Flow) -> None:
        """Shift the steer angle."""
        flow.delta = flow.delta + self.parameters["offset"]
