"""A front-driven heavy van: TMeasy tyres whose forces build up late, a body that rolls, roll steer, engine lag.

State, shape (19,): X, Y, yaw, v_x, v_y, r at the CG; roll angle, outward in a left turn, and its rate; four late side
forces [N]; the acceleration that moves load along [m/s^2]; road-wheel angle [rad]; wheel torque [N m]; heat of the
front and rear tyres; place and speed of a loose load. Wheels are ordered as those of the sports car.
"""

from math import cos, sin, sqrt
from typing import NamedTuple

from numba import njit

from tests.studies.other_cars.surroundings import GRAVITY, grip_at, grip_of_heat, gust, heating, slosh_spring
from tests.studies.other_cars.tyres import tmeasy_force
from tests.studies.other_cars.wheels import (
    softened,
    wheel_load,
    wheel_place,
    wheel_torque,
    wheel_travel,
    write_pose_rates,
)


class Van(NamedTuple):
    """Parameters in SI units; what all three cars have comes first. Neutral values switch an effect off."""

    mass: float = 2350.0
    yaw_inertia: float = 5300.0
    front: float = 1.45
    rear: float = 1.75
    height: float = 0.78
    track: float = 1.68
    radius: float = 0.34
    grip: float = 0.95
    grip_front: float = 1.0
    grip_rear: float = 1.0
    stiffness_front: float = 11.5
    stiffness_rear: float = 13.0
    relaxation: float = 0.60
    steer_delay: float = 0.0
    steer_lag: float = 0.050
    steer_gain: float = 1.0
    steer_offset: float = 0.0
    torque_delay: float = 0.0
    torque_lag: float = 0.15
    drive_gain: float = 1.0
    brake_gain: float = 1.0
    drag: float = 0.85
    rolling: float = 310.0
    lift_front: float = 0.0
    lift_rear: float = 0.0
    lock: float = 8.0  # as the sports car's, between the front wheels
    drive_front: float = 1.0
    brake_front: float = 0.68
    grade: float = 0.0
    bank: float = 0.0
    patch: float = 1.0
    patch_start: float = 0.0
    patch_end: float = 0.0
    lap: float = 1.0
    heat_loss: float = 0.0
    heat_capacity: float = 90000.0
    gust: float = 0.0
    gust_phase: float = 0.0
    gust_arm: float = 0.4
    loose_mass: float = 0.0
    loose_frequency: float = 0.6
    peak_ratio: float = 1.9  # TMeasy: slip of the peak over peak/slope; sliding is reached at 3.5 times it
    sliding: float = 0.88  # force of full sliding over the peak
    stiffness_along: float = 14.0  # slope along over load [1]
    load_softening: float = 0.20
    load_greasing: float = 0.05
    sprung: float = 0.88  # share of the mass that rolls
    roll_arm: float = 0.48  # of the sprung mass above the roll axis
    roll_inertia: float = 900.0
    roll_stiffness: float = 105000.0  # [N m/rad]
    roll_damping: float = 7500.0
    roll_front: float = 0.58
    roll_steer_front: float = 0.06  # toe out of the turn at the front, into it at the rear, over roll angle [1]
    roll_steer_rear: float = 0.04
    load_lag: float = 0.12
    wheel_inertia: float = 1.6


STATES = 19
STEP = 0.001
"""Of the integration [s]."""


def at_rest_of_turning(car: Van, speed: float, place: tuple[float, float, float]) -> list[float]:
    """Return the state of straight driving at a speed, at X, Y [m] and yaw [rad]."""
    return [*place, speed, *[0.0] * 15]


@njit(cache=True)
def van_rates(t, x, steer, torque, place, p, out):
    """Write the rates of the state into `out`; return the specific forces along and across [m/s^2].

    `steer` [rad] and `torque` [N m] are the commands that have arrived, `place` the distance along the course [m].
    Wheels do not spin: the torque is the force along, and turning parts add to the mass that it accelerates. A viscous
    coupling of the driven wheels acts by the difference of their speeds, of which the tyres' slip takes its part.
    """
    vx, vy, r = x[3], x[4], x[5]
    wheelbase = p.front + p.rear
    weight = p.mass * GRAVITY
    mean_load = 0.25 * weight
    pitch = 0.5 * p.mass * p.height * x[12] / wheelbase
    # Springs and dampers carry the body's moment; what acts at the roll axis goes through the links.
    through_links = (p.height - p.sprung * p.roll_arm) * (x[8] + x[9] + x[10] + x[11])
    moved = (p.roll_stiffness * x[6] + p.roll_damping * x[7] + through_links) / p.track
    gripping = p.grip * grip_at(place, p.patch, p.patch_start, p.patch_end, p.lap)
    arrived = x[14] * (p.drive_gain if x[14] > 0.0 else p.brake_gain)
    # In series with the slip of both tyres, by which wheels of unlike speeds push at all.
    slipping = p.lock * max(vx, 1.0) / (p.stiffness_along * mean_load * p.radius * p.radius)
    coupled = p.lock * r * p.track / p.radius / (1.0 + slipping)
    along_sum = across_sum = moment = 0.0
    power_front = power_rear = 0.0
    for i in range(4):
        is_front, is_left = i < 2, i % 2 == 0
        arm, side = wheel_place(is_front, is_left, p)
        load = max(wheel_load(is_front, is_left, vx, pitch, moved, p), 20.0)
        turned = x[13] + p.steer_offset - p.roll_steer_front * x[6] if is_front else p.roll_steer_rear * x[6]
        c, s = cos(turned), sin(turned)
        rolls, slides = wheel_travel(vx, vy, r, arm, side, c, s)
        speed = rolls if rolls > 0.5 else 0.5
        slip = -slides / speed
        over = load / mean_load - 1.0
        axle_grip = p.grip_front if is_front else p.grip_rear
        hot = grip_of_heat(x[15] if is_front else x[16], p.heat_loss)
        limit = gripping * axle_grip * hot * load * (1.0 - p.load_greasing * over)
        softer = softened(load, over, p)
        slope = (p.stiffness_front if is_front else p.stiffness_rear) * softer
        pushed = wheel_torque(arrived, is_front, p)
        if is_front:
            pushed += 0.5 * coupled if is_left else -0.5 * coupled
        fx = pushed / p.radius - 0.25 * p.rolling
        used = fx / limit
        if used > 0.95:
            used = 0.95
        elif used < -0.95:
            used = -0.95
        fx = used * limit
        peak_slip = p.peak_ratio * limit / slope
        steady = tmeasy_force(slip, slope, limit, peak_slip, p.sliding * limit, 3.5 * peak_slip)
        out[8 + i] = speed / p.relaxation * (steady * sqrt(1.0 - used * used) - x[8 + i])
        fy = x[8 + i]
        ahead, left = fx * c - fy * s, fx * s + fy * c
        along_sum += ahead
        across_sum += left
        moment += left * arm - ahead * side
        heated = abs(fy * slip) * speed + 0.05 * abs(fx) * speed
        if is_front:
            power_front += heated
        else:
            power_rear += heated
    blown = gust(t, p.gust, p.gust_phase)
    loose = slosh_spring(x[17], x[18], p.loose_mass, p.loose_frequency, 0.06)
    turning = 4.0 * p.wheel_inertia / (p.radius * p.radius)
    pull = along_sum - p.drag * vx * abs(vx) - weight * sin(p.grade)
    out[3] = (pull + p.mass * vy * r) / (p.mass + turning)
    felt_x = out[3] - vy * r + GRAVITY * sin(p.grade)
    # The sprung mass leans out of the turn: m f - m_s h p' = F, and (I + m_s h^2) p' = m_s h (f + g phi) - K phi - c p.
    rolling = p.sprung * p.mass * p.roll_arm
    pushes = across_sum + blown + loose
    inert = p.mass - p.loose_mass
    held = rolling * GRAVITY * sin(x[6]) - p.roll_stiffness * x[6] - p.roll_damping * x[7]
    inertia = p.roll_inertia + rolling * p.roll_arm - rolling * rolling / inert
    out[7] = (rolling * pushes / inert + held) / inertia
    felt_y = (pushes + rolling * out[7]) / inert
    out[6] = x[7]
    write_pose_rates(x, out)
    out[4] = felt_y - GRAVITY * sin(p.bank) - vx * r
    out[5] = (moment + blown * p.gust_arm) / p.yaw_inertia
    out[12] = (felt_x - x[12]) / p.load_lag
    out[13] = (p.steer_gain * steer - x[13]) / p.steer_lag
    out[14] = (torque - x[14]) / p.torque_lag
    out[15] = heating(power_front, p.heat_capacity, x[15])
    out[16] = heating(power_rear, p.heat_capacity, x[16])
    out[17] = x[18]
    out[18] = -slosh_spring(x[17], x[18], 1.0, p.loose_frequency, 0.06) - felt_y
    return felt_x, felt_y


def understeer_gradient(car: Van) -> float:
    """Return the understeer gradient of gentle turns, with that of roll steer [rad s^2/m]."""
    base = car.front + car.rear
    weight = car.mass * GRAVITY
    slopes = []
    for share, slope in ((car.rear / base, car.stiffness_front), (car.front / base, car.stiffness_rear)):
        slopes.append(slope * share * weight * (1.0 - car.load_softening * (2.0 * share - 1.0)))
    rolling = car.sprung * car.mass * car.roll_arm
    leaning = rolling / (car.roll_stiffness - rolling * GRAVITY)
    of_tyres = car.mass / base * (car.rear / slopes[0] - car.front / slopes[1])
    return of_tyres + (car.roll_steer_front + car.roll_steer_rear) * leaning
