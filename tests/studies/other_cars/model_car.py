"""A 1:10 electric car with four driven wheels on one shaft, a servo of second order and tyres with long relaxation.

State, shape (22,): X, Y, yaw, v_x, v_y, r at the CG; speed of the shaft at the wheels, half the difference of the
right and left wheel's speeds at the front and the rear axle [rad/s]; four late slips across [1]; angle and rate of the
servo at the wheels; motor torque at the wheels [N m]; heat of the front and rear tyres; place and speed of a loose
load; the accelerations that move load [m/s^2]. Wheels are ordered as those of the sports car.
"""

from math import cos, sin
from typing import NamedTuple

from numba import njit

from tests.studies.other_cars.surroundings import GRAVITY, grip_at, grip_of_heat, gust, heating, slosh_spring
from tests.studies.other_cars.tyres import magic_force
from tests.studies.other_cars.wheels import wheel_load, wheel_place, wheel_travel, write_pose_rates


class ModelCar(NamedTuple):
    """Parameters in SI units; what all three cars have comes first. Neutral values switch an effect off.

    `steer_lag` is 2 zeta/w of the servo, by which it follows slow commands late; a longer one lowers w alone.
    """

    mass: float = 3.6
    yaw_inertia: float = 0.056
    front: float = 0.165
    rear: float = 0.155
    height: float = 0.050
    track: float = 0.23
    radius: float = 0.033
    grip: float = 0.85
    grip_front: float = 1.0
    grip_rear: float = 1.0
    stiffness_front: float = 8.5
    stiffness_rear: float = 9.5
    relaxation: float = 0.12
    steer_delay: float = 0.0
    steer_lag: float = 0.045
    steer_gain: float = 1.0
    steer_offset: float = 0.0
    torque_delay: float = 0.0
    torque_lag: float = 0.050
    drive_gain: float = 1.0
    brake_gain: float = 1.0
    drag: float = 0.035
    rolling: float = 1.0
    lift_front: float = 0.0
    lift_rear: float = 0.0
    lock: float = 0.001  # of either axle: torque over the difference of its wheels' speeds [N m s/rad]
    drive_front: float = 0.5  # the shaft itself has no split; this is what slip makes of it
    brake_front: float = 0.5
    grade: float = 0.0
    bank: float = 0.0
    patch: float = 1.0
    patch_start: float = 0.0
    patch_end: float = 0.0
    lap: float = 1.0
    heat_loss: float = 0.0
    heat_capacity: float = 45.0
    gust: float = 0.0
    gust_phase: float = 0.0
    gust_arm: float = 0.03
    loose_mass: float = 0.0
    loose_frequency: float = 1.2
    shape: float = 1.45  # C of the Magic Formula
    load_greasing: float = 0.08
    roll_front: float = 0.52
    load_lag: float = 0.05
    servo_damping: float = 0.8
    servo_rate: float = 6.0  # largest rate of the wheels [rad/s]
    wheel_inertia: float = 3.0e-5
    shaft_inertia: float = 1.5e-4  # of motor and shaft, at the wheels


STATES = 22
STEP = 0.0005
"""Of the integration [s]."""


def at_rest_of_turning(car: ModelCar, speed: float, place: tuple[float, float, float]) -> list[float]:
    """Return the state of straight driving at a speed, at X, Y [m] and yaw [rad]."""
    return [*place, speed, 0.0, 0.0, speed / car.radius, *[0.0] * 15]


@njit(cache=True)
def model_car_rates(t, x, steer, torque, place, p, out):
    """Write the rates of the state into `out`; return the specific forces along and across [m/s^2].

    `steer` [rad] and `torque` [N m] are the commands that have arrived, `place` the distance along the course [m].
    """
    vx, vy, r = x[3], x[4], x[5]
    wheelbase = p.front + p.rear
    weight = p.mass * GRAVITY
    mean_load = 0.25 * weight
    pitch = 0.5 * p.mass * p.height * x[20] / wheelbase
    roll = p.mass * p.height * x[21] / p.track
    gripping = p.grip * grip_at(place, p.patch, p.patch_start, p.patch_end, p.lap)
    angle = x[13] + p.steer_offset
    arrived = x[15] * (p.drive_gain if x[15] > 0.0 else p.brake_gain)
    along_sum = across_sum = moment = 0.0
    power_front = power_rear = 0.0
    load_on_shaft = unequal_front = unequal_rear = 0.0
    for i in range(4):
        is_front, is_left = i < 2, i % 2 == 0
        arm, side = wheel_place(is_front, is_left, p)
        load = max(wheel_load(is_front, is_left, vx, pitch, roll, p), 0.2)
        turned = angle if is_front else 0.0
        c, s = cos(turned), sin(turned)
        rolls, slides = wheel_travel(vx, vy, r, arm, side, c, s)
        speed = rolls if rolls > 0.2 else 0.2
        differs = x[7] if is_front else x[8]
        spin = x[6] - differs if is_left else x[6] + differs
        along = (spin * p.radius - rolls) / speed
        across = x[9 + i]
        out[9 + i] = speed / p.relaxation * (-slides / speed - across)
        over = load / mean_load - 1.0
        axle_grip = p.grip_front if is_front else p.grip_rear
        hot = grip_of_heat(x[16] if is_front else x[17], p.heat_loss)
        limit = gripping * axle_grip * hot * load * (1.0 - p.load_greasing * over)
        stiffness = (p.stiffness_front if is_front else p.stiffness_rear) * load
        fx, fy = magic_force(along, across, stiffness, p.shape, limit)
        load_on_shaft += p.radius * (fx + 0.25 * p.rolling)
        if is_front:
            unequal_front += -fx if is_left else fx
        else:
            unequal_rear += -fx if is_left else fx
        ahead, left = fx * c - fy * s, fx * s + fy * c
        along_sum += ahead
        across_sum += left
        moment += left * arm - ahead * side
        heated = abs(fy * across) * speed + abs(fx * along) * speed
        if is_front:
            power_front += heated
        else:
            power_rear += heated
    blown = gust(t, p.gust, p.gust_phase)
    loose = slosh_spring(x[18], x[19], p.loose_mass, p.loose_frequency, 0.08)
    felt_x = (along_sum - p.drag * vx * abs(vx)) / p.mass
    felt_y = (across_sum + blown + loose) / (p.mass - p.loose_mass)
    write_pose_rates(x, out)
    out[3] = felt_x - GRAVITY * sin(p.grade) + vy * r
    out[4] = felt_y - GRAVITY * sin(p.bank) - vx * r
    out[5] = (moment + blown * p.gust_arm) / p.yaw_inertia
    out[6] = (arrived - load_on_shaft) / (4.0 * p.wheel_inertia + p.shaft_inertia)
    out[7] = -(p.lock * x[7] + 0.5 * p.radius * unequal_front) / p.wheel_inertia
    out[8] = -(p.lock * x[8] + 0.5 * p.radius * unequal_rear) / p.wheel_inertia
    w = 2.0 * p.servo_damping / p.steer_lag
    rate = x[14]
    if rate > p.servo_rate:
        rate = p.servo_rate
    elif rate < -p.servo_rate:
        rate = -p.servo_rate
    out[13] = rate
    out[14] = w * w * (p.steer_gain * steer - x[13]) - 2.0 * p.servo_damping * w * x[14]
    out[15] = (torque - x[15]) / p.torque_lag
    out[16] = heating(power_front, p.heat_capacity, x[16])
    out[17] = heating(power_rear, p.heat_capacity, x[17])
    out[18] = x[19]
    out[19] = -slosh_spring(x[18], x[19], 1.0, p.loose_frequency, 0.08) - felt_y
    out[20] = (felt_x - x[20]) / p.load_lag
    out[21] = (felt_y - x[21]) / p.load_lag
    return felt_x, felt_y


def understeer_gradient(car: ModelCar) -> float:
    """Return the understeer gradient of gentle turns with open differentials [rad s^2/m].

    Stiffness is in proportion to the load, so only the two slopes over load count. The shaft that makes both axles
    turn at one speed adds less than a hundredth of the wheelbase's angle.
    """
    return (1.0 / car.stiffness_front - 1.0 / car.stiffness_rear) / GRAVITY
