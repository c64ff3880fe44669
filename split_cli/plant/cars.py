"""The cars: geometry, inertia, tyres, aerodynamics and actuators of a double track, with their sources.

Every coefficient that physics could change between a simulation and a real car is a field here, so that a
changed car is ``dataclasses.replace(ROAD_CAR, cg_height=0.6)`` and nothing else.
"""

from dataclasses import dataclass, replace

from split_cli.errors import SplitError, nearest_names
from split_cli.plant.tire import TireParameters
from split_cli.signals import STANDARD_GRAVITY


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


_TOURING_TIRE = TireParameters(
    nominal_load=4000.0,
    p_cx1=1.685,
    p_dx1=1.210,
    p_dx2=-0.037,
    p_ex1=0.344,
    p_ex2=0.095,
    p_ex3=-0.020,
    p_kx1=21.51,
    p_kx2=-0.163,
    p_kx3=0.245,
    p_cy1=1.193,
    p_dy1=0.990,
    p_dy2=-0.145,
    p_ey1=-1.003,
    p_ey2=-0.537,
    p_ky1=14.95,
    p_ky2=2.130,
    r_bx1=12.35,
    r_bx2=10.77,
    r_cx1=1.092,
    r_by1=6.461,
    r_by2=4.196,
    r_cy1=1.081,
    relaxation_longitudinal=0.15,
    relaxation_lateral=0.45,
    rolling_resistance=0.011,
)
"""205/60 R15 91V at 2.2 bar: Pacejka, Tyre and Vehicle Dynamics, 2nd ed. 2006, Appendix 3, without the shifts
and asymmetries, so that left and right are mirror images. Relaxation lengths: ch. 1 and 9 of the same book
give 0.3 to 0.6 m across and about a third of it along for such a tyre. Rolling resistance: Gillespie,
Fundamentals of Vehicle Dynamics, ch. 4, a radial on asphalt (0.010 to 0.015)."""

_TOURING_TIRE_STEERED = replace(_TOURING_TIRE, p_ky1=0.8 * _TOURING_TIRE.p_ky1)
"""The same tyre behind an elastic steering system, which takes a fifth of the axle's cornering stiffness
(assumed); with it the car understeers by about 2 deg/g, as production saloons do (Gillespie, ch. 6)."""

ROAD_CAR = CarParameters(
    name="road_car",
    mass=1573.0,
    yaw_inertia=2873.0,
    cg_to_front_axle=1.10,
    cg_to_rear_axle=1.58,
    cg_height=0.54,
    track_front=1.54,
    track_rear=1.54,
    roll_center_front=0.06,
    roll_center_rear=0.12,
    roll_stiffness_front_share=0.58,
    load_transfer_frequency=11.0,
    load_transfer_damping=0.5,
    wheel_radius=0.30,
    wheel_inertia_front=1.1,
    wheel_inertia_rear=1.1,
    drive_split_front=0.45,
    brake_split_front=0.75,
    drag_area=0.66,
    side_area=1.6,
    downforce_area_front=-0.05,
    downforce_area_rear=-0.10,
    ackermann_fraction=0.6,
    toe_front=0.001,
    toe_rear=0.002,
    max_steer_angle=0.60,
    steer_lag=0.03,
    steer_rate=0.9,
    drive_lag=0.05,
    torque_rate=20000.0,
    max_torque=2600.0,
    max_brake_torque=5600.0,
    max_power=150e3,
    front_tire=_TOURING_TIRE_STEERED,
    rear_tire=_TOURING_TIRE,
)
"""A medium saloon with electric all-wheel drive.

Published: mass, yaw inertia and axle distances, Rajamani, Vehicle Dynamics and Control, 2nd ed., the passenger
saloon of chapters 2 and 3 (1573 kg, 2873 kg m^2, 1.1 m, 1.58 m); drag area, Hucho, Aerodynamics of Road Vehicles
(c_d 0.30, 2.2 m^2) and the slight lift of such bodies; CG height, 0.2 of the wheelbase, the NHTSA inertia
database's average for saloons. Assumed, typical of the class: tracks, roll centres, roll stiffness share (stiffer
front), roll frequency 1.75 Hz, wheel inertia with the electric drive's share, splits (braking leaves the rear
axle a reserve, as type approval asks), toe, Ackermann, actuators, torques (0.56 g driving, 1.2 g braking), power.
"""

_MODEL_CAR_TIRE_FRONT = TireParameters(
    nominal_load=9.17,
    p_cx1=1.50,
    p_dx1=0.84,
    p_dx2=-0.06,
    p_ex1=-0.6,
    p_ex2=0.0,
    p_ex3=0.0,
    p_kx1=9.0,
    p_kx2=0.0,
    p_kx3=0.0,
    p_cy1=1.50,
    p_dy1=0.80,
    p_dy2=-0.08,
    p_ey1=-1.0,
    p_ey2=0.0,
    p_ky1=6.05,
    p_ky2=2.4,
    r_bx1=5.0,
    r_bx2=5.0,
    r_cx1=1.08,
    r_by1=3.6,
    r_by2=3.0,
    r_cy1=1.06,
    relaxation_longitudinal=0.025,
    relaxation_lateral=0.05,
    rolling_resistance=0.025,
)
_MODEL_CAR_TIRE_REAR = replace(_MODEL_CAR_TIRE_FRONT, p_ky1=7.00)

F1TENTH_CAR = CarParameters(
    name="f1tenth_car",
    mass=3.74,
    yaw_inertia=0.04712,
    cg_to_front_axle=0.15875,
    cg_to_rear_axle=0.17145,
    cg_height=0.074,
    track_front=0.25,
    track_rear=0.25,
    roll_center_front=0.015,
    roll_center_rear=0.020,
    roll_stiffness_front_share=0.52,
    load_transfer_frequency=22.0,
    load_transfer_damping=0.45,
    wheel_radius=0.0508,
    wheel_inertia_front=1.2e-4,
    wheel_inertia_rear=1.2e-4,
    drive_split_front=0.5,
    brake_split_front=0.5,
    drag_area=0.030,
    side_area=0.05,
    ackermann_fraction=0.8,
    max_steer_angle=0.4189,
    steer_lag=0.03,
    steer_rate=3.2,
    drive_lag=0.03,
    torque_rate=40.0,
    max_torque=1.2,
    max_brake_torque=1.2,
    max_power=120.0,
    front_tire=_MODEL_CAR_TIRE_FRONT,
    rear_tire=_MODEL_CAR_TIRE_REAR,
    differential_locking_front=1e-4,
    differential_locking_rear=1e-4,
)
"""A 1:10 all-wheel-drive race car.

Published (the F1TENTH Gym's default vehicle): mass, yaw inertia, axle distances, CG height, steer limit 0.4189 rad
and rate 3.2 rad/s, and the tyres' slope: mu C_S = 1.0489 x 4.718 front and 1.0489 x 5.4562 rear [1/rad] at the
static load. The peak 0.8 lies between the friction values in use for such cars (0.523 indoors, 1.0489). Wheel
radius: the 4-inch tyre of the platform. Assumed: the tyres' curvature, combined slip and relaxation (a
contact length), roll and pitch, wheel inertia with the motor's share through the gear, drag, torque (0.6 g).
"""

_SLICK_TIRE = TireParameters(
    nominal_load=700.0,
    p_cx1=1.60,
    p_dx1=1.60,
    p_dx2=-0.16,
    p_ex1=0.1,
    p_ex2=0.0,
    p_ex3=0.0,
    p_kx1=38.0,
    p_kx2=0.0,
    p_kx3=0.0,
    p_cy1=1.45,
    p_dy1=1.55,
    p_dy2=-0.18,
    p_ey1=-0.4,
    p_ey2=0.0,
    p_ky1=36.0,
    p_ky2=2.2,
    r_bx1=13.0,
    r_bx2=10.0,
    r_cx1=1.08,
    r_by1=10.0,
    r_by2=8.0,
    r_cy1=1.06,
    relaxation_longitudinal=0.10,
    relaxation_lateral=0.25,
    rolling_resistance=0.018,
)

FORMULA_CAR = CarParameters(
    name="formula_car",
    mass=246.0,
    yaw_inertia=150.0,
    cg_to_front_axle=0.810,
    cg_to_rear_axle=0.730,
    cg_height=0.30,
    track_front=1.20,
    track_rear=1.18,
    roll_center_front=0.03,
    roll_center_rear=0.05,
    roll_stiffness_front_share=0.54,
    load_transfer_frequency=22.0,
    load_transfer_damping=0.6,
    wheel_radius=0.23,
    wheel_inertia_front=0.25,
    wheel_inertia_rear=0.45,
    drive_split_front=0.0,
    brake_split_front=0.62,
    drag_area=1.42,
    side_area=1.0,
    downforce_area_front=1.45,
    downforce_area_rear=1.70,
    ackermann_fraction=0.3,
    toe_front=-0.002,
    toe_rear=0.003,
    max_steer_angle=0.42,
    steer_lag=0.03,
    steer_rate=1.6,
    drive_lag=0.025,
    torque_rate=8000.0,
    max_torque=560.0,
    max_brake_torque=950.0,
    max_power=80e3,
    front_tire=replace(_SLICK_TIRE, p_ky1=33.0),
    rear_tire=_SLICK_TIRE,
    differential_locking_rear=6.0,
)
"""A Formula Student car with wings and rear-wheel drive.

Published by teams (FST Lisboa's FST10d): mass, yaw inertia, wheelbase 1.54 m, drag 1.2 x 1.18 m^2, wheel radius;
downforce near 4 N/(m/s)^2 at full speed is what wings of that class give, less is taken here. Power: the rules'
80 kW. Assumed: the rest; the tyre follows the shape of public fits of 10-inch slicks (peak 1.5 to 1.7 on asphalt).
"""

CARS = {car.name: car for car in (ROAD_CAR, F1TENTH_CAR, FORMULA_CAR)}


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
