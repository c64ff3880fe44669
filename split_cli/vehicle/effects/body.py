"""Terms of the body: mass, what turns with the wheels, yaw inertia, the centre of gravity's place."""

from collections.abc import Mapping
from typing import ClassVar

from split_cli.vehicle.effects.search import Course, Range, Search
from split_cli.vehicle.effects.term import Mimic, Term
from split_cli.vehicle.effects.tires import LOAD_LAWS, scale_load
from split_cli.vehicle.effects.wording import Estimates, amount, scaled
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

__all__ = ["CgShift", "Mass", "RotatingMass", "YawInertia", "gyration", "inertia_range", "least_mass"]

# In wheelbases.
_MOVED, _FURTHEST = 0.17, 0.75
_PLACE = (
    "judgement: people and luggage move the CG by less than 0.17 wheelbases, and no axle carries more than three "
    "quarters of a car"
)
_MASS = (
    "judgement: a payload of 70 % of the kerb mass is beyond any car, as is one that lacks 45 %, or so much that "
    "the file's yaw inertia were more than 1.3 m l_f l_r"
)
_INERTIA = (
    "Heydinger et al. (1999), SAE 1999-01-1336: I_z/(m l_f l_r) of cars lies within 0.8 and 1.2; judgement: 1.3, "
    "and 0.2 for mass that is carried between the axles"
)
_TURNING = (
    "Gillespie (1992), chapter 2: what turns resists like 4 % of a car's mass without gears, and like half of it "
    "in first gear"
)
# I_z/(m l_f l_r), the squared radius of gyration over the product of the arms.
_LEAST_GYRATION, _MOST_GYRATION = 0.2, 1.3
_ANY_FILE = 1.15  # by how much a file may be wrong whatever it says


def gyration(vehicle: Vehicle) -> float:
    """Return I_z/(m l_f l_r) of a vehicle file [1]."""
    arms = vehicle.cg_to_front_axle * vehicle.cg_to_rear_axle
    return vehicle.yaw_inertia / (vehicle.mass * arms)


def inertia_range(vehicle: Vehicle) -> tuple[float, float]:
    """Return the least and the most of the file's yaw inertia that a real car can have with its mass and arms [1].

    A file may have guessed the inertia, so what bounds it is where a car carries its mass, whatever the file says.
    """
    known = gyration(vehicle)
    return (min(max(_LEAST_GYRATION / known, 0.4), 1.0 / _ANY_FILE), max(min(_MOST_GYRATION / known, 2.5), _ANY_FILE))


def least_mass(vehicle: Vehicle) -> float:
    """Return the least of the file's mass that a real car with its yaw inertia and arms can have [1]."""
    return max(0.55, min(gyration(vehicle) / _MOST_GYRATION, 1.0 / _ANY_FILE))


class Mass(Term):
    """The car is heavier or lighter: m scale.

    Variants: the axles' capacity D and their rolling resistance stay (default), follow the load in proportion
    (``loaded``), or follow it degressively (``degressive``, as in `load_transfer`).

    Only forces divided by m and I_z are observable, so other terms together can explain the same motion; see
    below.
    """

    id = "mass"
    factors: ClassVar = {"scale": ("Mass", "more", "less")}
    units: ClassVar = {"scale": "1"}
    neutral: ClassVar = {"scale": 1.0}
    family = "along"
    needs: ClassVar = frozenset({"torque"})
    discrepancy: ClassVar = (("", "scale", 0.1),)
    variants: ClassVar = ("", "loaded", "degressive")
    variant_words: ClassVar = LOAD_LAWS
    loads_tires: ClassVar = True
    mimics: ClassVar = (
        Mimic(
            "friction_scale+drive_gain+yaw_inertia+aero_drag+rolling_resistance",
            "only F/m and F/I_z are observable: the whole curve, torque, drag and inertia scale with 1/scale",
            exact=True,
        ),
        Mimic("drive_gain", "straight driving", "hard turns, and coasting"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return Search({"scale": Range(least_mass(vehicle), 1.7, 0.01, _MASS)}, ({"scale": 1.03},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"the car is {scaled(p['scale'], 'heavier', 'lighter')}"

    def body(self, flow: Flow) -> None:
        """Scale the mass."""
        flow.mass = flow.mass * self.parameters["scale"]

    def tire(self, flow: Flow) -> None:
        """Let the axles follow the load where the variant says so."""
        if not self.variant:
            return
        scale, car = self.parameters["scale"], flow.vehicle
        for axle, resistance in ((flow.front, car.rolling_resistance_front), (flow.rear, car.rolling_resistance_rear)):
            scale_load(axle, scale, self.variant, flow.ops)
            axle.longitudinal_force = axle.longitudinal_force - (scale - 1.0) * resistance


class RotatingMass(Term):
    """Wheels, brakes and drive line turn faster as the car does: (m + mass) v_x' = F_x + m v_y r.

    `mass` is J/r_e^2, with J the inertia of all that turns, referred to the wheels. Driving across and turning do
    not accelerate it. At a steady speed it takes no torque, by which it differs from `drive_gain`. Terms that act
    by the force along the car (`load_transfer`, `combined_slip`) keep that of the whole torque. While the car
    accelerates it is larger than the force at the ground, by the share mass/m. That hardly matters to
    `load_transfer`, since wheels that spin up take their moment from the road, too: F (m h + mass r_e)/(m + mass)
    instead of F h, with r_e near h. Source: Gillespie (1992), chapter 2.
    """

    id = "rotating_mass"
    titles: ClassVar = {"": "Wheels and drive line heavy to spin up"}
    in_every_car: ClassVar = True
    units: ClassVar = {"mass": "kg"}
    neutral: ClassVar = {"mass": 0.0}
    family = "along"
    needs: ClassVar = frozenset({"torque", "torque changes"})
    mimics: ClassVar = (
        Mimic("drive_gain", "torque that is mostly spent on acceleration", "a fast straight at a steady speed"),
        Mimic("mass", "straight driving", "hard turns"),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"mass": vehicle.mass}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        return Search({"mass": Range(0.0, 0.5, 0.005, _TURNING)}, ({"mass": 0.03},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"what turns with the wheels resists acceleration like {amount(p['mass'], one_sided=True)} of mass"

    def body(self, flow: Flow) -> None:
        """Add the mass that turns."""
        flow.rotating_mass = flow.rotating_mass + self.parameters["mass"]


class YawInertia(Term):
    """The yaw inertia differs: I_z scale. The effect shows in transients only."""

    id = "yaw_inertia"
    factors: ClassVar = {"scale": ("Yaw inertia", "more", "less")}
    units: ClassVar = {"scale": "1"}
    neutral: ClassVar = {"scale": 1.0}
    family = "body"
    shows_late = True
    discrepancy: ClassVar = (("", "scale", 0.1),)
    mimics: ClassVar = (
        Mimic("tire_relaxation", "gentle transients at one speed", "steer steps at two speeds"),
        Mimic("steer_lag", "gentle transients", "a fast slalom: lag delays v_y and r alike"),
    )

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        lower, upper = inertia_range(vehicle)
        return Search({"scale": Range(lower, upper, 0.01, _INERTIA)}, ({"scale": 1.03},))

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"the yaw inertia is {scaled(p['scale'], 'larger', 'smaller')}"

    def body(self, flow: Flow) -> None:
        """Scale the inertia."""
        flow.yaw_inertia = flow.yaw_inertia * self.parameters["scale"]


class CgShift(Term):
    """The centre of gravity lies dx further forward: l_f - dx, l_r + dx. The recording refers to the true one.

    Variants: D stays (default), or follows the static loads in proportion (``loaded``) or degressively
    (``degressive``).
    """

    id = "cg_shift"
    titles: ClassVar = {"": "Centre of gravity off along the car"}
    through_tires: ClassVar = True
    units: ClassVar = {"dx": "m"}
    neutral: ClassVar = {"dx": 0.0}
    family = "body"
    discrepancy: ClassVar = (("", "dx", 0.03),)
    variants: ClassVar = ("", "loaded", "degressive")
    variant_words: ClassVar = LOAD_LAWS
    loads_tires: ClassVar = True
    mimics: ClassVar = (
        Mimic(
            "sensor_lever_arm+tire_stiffness+yaw_moment_differential",
            "moderate slip: arms, speeds at the axles and yaw moments change together",
            "position and yaw against v_y, and turns near the limit",
        ),
        Mimic("tire_stiffness", "steady turns", "steer steps"),
    )

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        return {"dx": vehicle.wheelbase}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        front = vehicle.cg_to_front_axle / vehicle.wheelbase
        lower, upper = max(-_MOVED, front - _FURTHEST), min(_MOVED, front - 1.0 + _FURTHEST)
        return Search({"dx": Range(min(lower, -0.02), max(upper, 0.02), 0.002, _PLACE)}, ({"dx": 0.005},))

    @classmethod
    def limits(cls, vehicle: Vehicle) -> dict[str, tuple[float, float]]:
        """Return where both axles still carry something: a hundredth short of them."""
        return {"dx": (-0.99 * vehicle.cg_to_rear_axle, 0.99 * vehicle.cg_to_front_axle)}

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        return f"the centre of gravity lies {amount(p['dx'], more='further forward', less='further back')}"

    def body(self, flow: Flow) -> None:
        """Move the axles."""
        flow.l_f = flow.l_f - self.parameters["dx"]
        flow.l_r = flow.l_r + self.parameters["dx"]

    def tire(self, flow: Flow) -> None:
        """Let the axles follow the static loads where the variant says so."""
        if self.variant:
            car, dx = flow.vehicle, self.parameters["dx"]
            scale_load(flow.front, 1.0 + dx / car.cg_to_rear_axle, self.variant, flow.ops)
            scale_load(flow.rear, 1.0 - dx / car.cg_to_front_axle, self.variant, flow.ops)
