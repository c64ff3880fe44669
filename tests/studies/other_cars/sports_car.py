"""A rear-driven sports car: four wheels that spin, brush tyres of combined slip, load by roll stiffness, downforce.

State, shape (22,): X, Y, yaw, v_x, v_y, r at the CG; four wheel speeds [rad/s]; four late slips across [1]; the
accelerations that move load [m/s^2]; road-wheel angle [rad]; wheel torque [N m]; heat of the front and rear tyres;
place and speed of a loose load [m], [m/s]. Wheels are ordered front left, front right, rear left, rear right.
"""

from math import cos, sin
from typing import NamedTuple

from numba import njit

from tests.studies.other_cars.surroundings import GRAVITY, grip_at, grip_of_heat, gust, heating, slosh_spring
from tests.studies.other_cars.tyres import brush_force
from tests.studies.other_cars.wheels import (
    softened,
    wheel_load,
    wheel_place,
    wheel_torque,
    wheel_travel,
    write_pose_rates,
)


class SportsCar(NamedTuple):
    """Parameters in SI units; what all three cars have comes first. Neutral values switch an effect off."""

    mass: float = 1450.0
    yaw_inertia: float = 2150.0
    front: float = 1.32  # from the CG to the front axle
    rear: float = 1.23
    height: float = 0.46  # of the CG
    track: float = 1.56
    radius: float = 0.33
    grip: float = 1.15
    grip_front: float = 1.0  # factors of the grip
    grip_rear: float = 1.0
    stiffness_front: float = 17.0  # slope across over load [1/rad]
    stiffness_rear: float = 20.0
    relaxation: float = 0.35
    steer_delay: float = 0.0
    steer_lag: float = 0.030
    steer_gain: float = 1.0
    steer_offset: float = 0.0
    torque_delay: float = 0.0
    torque_lag: float = 0.060
    drive_gain: float = 1.0
    brake_gain: float = 1.0
    drag: float = 0.42  # [N/(m/s)^2]
    rolling: float = 190.0  # [N], of all wheels
    lift_front: float = 0.35  # downforce [N/(m/s)^2]
    lift_rear: float = 0.55
    # Between the driven wheels: twice the torque on either, over the difference of their speeds [N m s/rad].
    lock: float = 30.0
    drive_front: float = 0.0
    brake_front: float = 0.62
    grade: float = 0.0
    bank: float = 0.0
    patch: float = 1.0
    patch_start: float = 0.0
    patch_end: float = 0.0
    lap: float = 1.0
    heat_loss: float = 0.0
    heat_capacity: float = 60000.0
    gust: float = 0.0
    gust_phase: float = 0.0
    gust_arm: float = 0.3  # ahead of the CG
    loose_mass: float = 0.0  # part of `mass`
    loose_frequency: float = 0.7
    stiffness_along: float = 22.0
    load_softening: float = 0.25  # loss of stiffness over load for a wheel of twice its static mean load
    load_greasing: float = 0.06  # the same of the grip
    roll_front: float = 0.56  # share of the roll stiffness
    load_lag: float = 0.08
    wheel_inertia: float = 1.4


STATES = 22
STEP = 0.001
"""Of the integration [s]."""


def at_rest_of_turning(car: SportsCar, speed: float, place: tuple[float, float, float]) -> list[float]:
    """Return the state of straight driving at a speed, at X, Y [m] and yaw [rad]."""
    return [*place, speed, 0.0, 0.0, *[speed / car.radius] * 4, *[0.0] * 12]


@njit(cache=True)
def sports_car_rates(t, x, steer, torque, place, p, out):
    """Write the rates of the state into `out`; return the specific forces along and across [m/s^2].

    `steer` [rad] and `torque` [N m] are the commands that have arrived, `place` the distance along the course [m].
    """
    vx, vy, r = x[3], x[4], x[5]
    wheelbase = p.front + p.rear
    weight = p.mass * GRAVITY
    mean_load = 0.25 * weight
    pitch = 0.5 * p.mass * p.height * x[14] / wheelbase
    roll = p.mass * p.height * x[15] / p.track
    gripping = p.grip * grip_at(place, p.patch, p.patch_start, p.patch_end, p.lap)
    angle = x[16] + p.steer_offset
    arrived = x[17] * (p.drive_gain if x[17] > 0.0 else p.brake_gain)
    coupled = p.lock * (x[9] - x[8])
    along_sum = across_sum = moment = 0.0
    power_front = power_rear = 0.0
    for i in range(4):
        is_front, is_left = i < 2, i % 2 == 0
        arm, side = wheel_place(is_front, is_left, p)
        load = max(wheel_load(is_front, is_left, vx, pitch, roll, p), 20.0)
        turned = angle if is_front else 0.0
        c, s = cos(turned), sin(turned)
        rolls, slides = wheel_travel(vx, vy, r, arm, side, c, s)
        speed = rolls if rolls > 0.5 else 0.5
        along = (x[6 + i] * p.radius - rolls) / speed
        across = x[10 + i]
        out[10 + i] = speed / p.relaxation * (-slides / speed - across)
        over = load / mean_load - 1.0
        axle_grip = p.grip_front if is_front else p.grip_rear
        hot = grip_of_heat(x[18] if is_front else x[19], p.heat_loss)
        limit = gripping * axle_grip * hot * load * (1.0 - p.load_greasing * over)
        softer = softened(load, over, p)
        stiffness = (p.stiffness_front if is_front else p.stiffness_rear) * softer
        fx, fy = brush_force(along, across, p.stiffness_along * softer, stiffness, limit)
        resistance = 0.25 * p.rolling * p.radius
        pushed = wheel_torque(arrived, is_front, p)
        if not is_front:
            pushed += 0.5 * coupled if is_left else -0.5 * coupled
        out[6 + i] = (pushed - resistance - p.radius * fx) / p.wheel_inertia
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
    loose = slosh_spring(x[20], x[21], p.loose_mass, p.loose_frequency, 0.08)
    felt_x = (along_sum - p.drag * vx * abs(vx)) / p.mass
    felt_y = (across_sum + blown + loose) / (p.mass - p.loose_mass)
    write_pose_rates(x, out)
    out[3] = felt_x - GRAVITY * sin(p.grade) + vy * r
    out[4] = felt_y - GRAVITY * sin(p.bank) - vx * r
    out[5] = (moment + blown * p.gust_arm) / p.yaw_inertia
    out[14] = (felt_x - x[14]) / p.load_lag
    out[15] = (felt_y - x[15]) / p.load_lag
    out[16] = (p.steer_gain * steer - x[16]) / p.steer_lag
    out[17] = (torque - x[17]) / p.torque_lag
    out[18] = heating(power_front, p.heat_capacity, x[18])
    out[19] = heating(power_rear, p.heat_capacity, x[19])
    out[20] = x[21]
    out[21] = -slosh_spring(x[20], x[21], 1.0, p.loose_frequency, 0.08) - felt_y
    return felt_x, felt_y


def understeer_gradient(car: SportsCar) -> float:
    """Return the understeer gradient of gentle turns without downforce [rad s^2/m]."""
    base = car.front + car.rear
    loads = car.mass * GRAVITY * car.rear / base, car.mass * GRAVITY * car.front / base
    slopes = []
    for load, slope in zip(loads, (car.stiffness_front, car.stiffness_rear), strict=True):
        over = 2.0 * load / (car.mass * GRAVITY) - 1.0
        slopes.append(slope * load * (1.0 - car.load_softening * over))
    return car.mass / base * (car.rear / slopes[0] - car.front / slopes[1])
