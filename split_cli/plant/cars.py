"""The cars: geometry, inertia, tyres, aerodynamics and actuators of a double track; ``cars.yaml`` has their sources.

Every coefficient that physics could change between a simulation and a real car is a field here, so that a
changed car is ``dataclasses.replace(ROAD_CAR, cg_height=0.6)`` and nothing else.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from split_cli.errors import SplitError, nearest_names
from split_cli.plant.tire import TireParameters
from split_cli.signals import STANDARD_GRAVITY
from split_cli.yaml_file import read_yaml_mapping


@dataclass(frozen=True)
class CarParameters:
    """A four-wheeled car."""

    name: str
    mass: float  # total [kg]
    yaw_inertia: float  # about the vertical axis through the CG [kg m^2]
    # cg_to_front_axle, cg_to_rear_axle: l_f, l_r [m].
    cg_to_front_axle: float
    cg_to_rear_axle: float
    cg_height: float  # of the total mass above the road [m]
    # track_front, track_rear: distance between the wheels of an axle [m].
    track_front: float
    track_rear: float
    # roll_center_front, roll_center_rear: heights [m]; lateral force reacts through them without rolling the body.
    roll_center_front: float
    roll_center_rear: float
    # Part of the roll stiffness at the front axle [1]; decides which axle takes the load transfer.
    roll_stiffness_front_share: float
    # load_transfer_frequency, load_transfer_damping: natural frequency [rad/s] and damping ratio [1] with which
    # the suspension passes load on.
    load_transfer_frequency: float
    load_transfer_damping: float
    wheel_radius: float  # effective rolling radius, taken as the loaded radius too [m]
    # wheel_inertia_front, wheel_inertia_rear: of one wheel about its spin axis with the drive line's share [kg
    # m^2].
    wheel_inertia_front: float
    wheel_inertia_rear: float
    # drive_split_front, brake_split_front: part of a driving or braking torque at the front axle [1].
    drive_split_front: float
    brake_split_front: float
    # drag_area, side_area: coefficient times area of the air's force along and across the car [m^2].
    drag_area: float
    max_steer_angle: float  # of the road wheels [rad]
    steer_lag: float
    steer_rate: float
    drive_lag: float
    torque_rate: float
    # max_torque, max_brake_torque: at all wheels together [N m], both positive.
    max_torque: float
    max_brake_torque: float
    max_power: float  # at the wheels [W]
    # front_tire, rear_tire: of one wheel.
    front_tire: TireParameters
    rear_tire: TireParameters
    side_area: float = 0.0
    # downforce_area_front, downforce_area_rear: coefficient times area of the load the air adds to an axle [m^2].
    downforce_area_front: float = 0.0
    downforce_area_rear: float = 0.0
    air_density: float = 1.2  # [kg/m^3]
    ackermann_fraction: float = 0.0  # 1 for wheels whose axes meet in a point, 0 for parallel wheels [1]
    # toe_front, toe_rear: toe-in of each wheel [rad].
    toe_front: float = 0.0
    toe_rear: float = 0.0
    # differential_locking_front, differential_locking_rear: viscous torque between the wheels of an axle per
    # difference of their speeds [N m s/rad]; 0 is open.
    differential_locking_front: float = 0.0
    differential_locking_rear: float = 0.0
    # steer_delay, steer_gain, steer_backlash, steer_lag, steer_rate, steer_offset: steering actuator in the order
    # in which they act: delay [s], gain [1], total play [rad], first-order time constant [s] with the greatest
    # rate [rad/s], offset of the road wheels [rad].
    steer_delay: float = 0.0
    steer_gain: float = 1.0
    steer_backlash: float = 0.0
    steer_offset: float = 0.0
    # drive_delay, drive_gain, brake_gain, drive_lag, torque_rate: torque path in the order in which they act:
    # delay [s], gains for positive and negative commands [1], first-order time constant [s] with the greatest rate
    # [N m/s].
    drive_delay: float = 0.0
    drive_gain: float = 1.0
    brake_gain: float = 1.0
    # Part of the load transfer between the axles that takes place; 0 for a simulation that leaves it out [1].
    pitch_transfer: float = 1.0
    # 0 for commands held over a control period, 1 for set points led there in a straight line, one period late
    # [1]; the line is what counts as the command then.
    command_ramp: float = 0.0

    @property
    def wheelbase(self) -> float:
        """Distance between the axles [m]."""
        return self.cg_to_front_axle + self.cg_to_rear_axle

    @property
    def static_load_front(self) -> float:
        """Load of the front axle at rest on a level road [N]."""
        return self.mass * STANDARD_GRAVITY * self.cg_to_rear_axle / self.wheelbase

    @property
    def static_load_rear(self) -> float:
        """Load of the rear axle at rest on a level road [N]."""
        return self.mass * STANDARD_GRAVITY * self.cg_to_front_axle / self.wheelbase

    @property
    def effective_mass(self) -> float:
        """Mass that a longitudinal force has to accelerate, rolling wheels included [kg]."""
        return self.mass + 2.0 * (self.wheel_inertia_front + self.wheel_inertia_rear) / self.wheel_radius**2

    @property
    def crawl_speed(self) -> float:
        """Speed below which the plant is not meant to be used and a run ends [m/s]."""
        return 2.5 * (self.wheelbase / 2.7) ** 0.5


def _cars_of_file() -> dict[str, CarParameters]:
    """Return the cars of ``cars.yaml`` by name, with the tyres that they name."""
    content = read_yaml_mapping(Path(__file__).with_name("cars.yaml"), SplitError)
    tires: dict[str, TireParameters] = {}
    for name, given in content["tires"].items():
        like = given.pop("like", None)
        tires[name] = replace(tires[like], **given) if like else TireParameters(**given)
    return {
        name: CarParameters(
            name=name, front_tire=tires[given.pop("front_tire")], rear_tire=tires[given.pop("rear_tire")], **given
        )
        for name, given in content["cars"].items()
    }


CARS = _cars_of_file()
ROAD_CAR, F1TENTH_CAR, FORMULA_CAR = CARS["road_car"], CARS["f1tenth_car"], CARS["formula_car"]


def find_car(name: str) -> CarParameters:
    """Return the car called `name`.

    Raises
    ------
    SplitError
        If there is none; names the nearest.
    """
    if name not in CARS:
        raise SplitError(f"no car is called {name!r}", where="--car", advice=nearest_names(name, CARS))
    return CARS[name]
