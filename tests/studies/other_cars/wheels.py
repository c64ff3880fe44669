"""Where the four wheels of a car are, how they move, what they carry and are pushed by; parameters `p` of any car.

Wheels are ordered front left, front right, rear left, rear right.
"""

from math import cos, sin

from numba import njit

from tests.studies.other_cars.surroundings import GRAVITY


@njit(cache=True)
def wheel_place(is_front, is_left, p):
    """Return how far ahead and to the left of the CG a wheel is [m]."""
    return (p.front if is_front else -p.rear), (0.5 * p.track if is_left else -0.5 * p.track)


@njit(cache=True)
def wheel_load(is_front, is_left, vx, pitch, roll, p):
    """Return a wheel's load [N]: at rest, downforce, and what pitch takes off a front and roll off a left wheel."""
    static = 0.5 * (p.mass * GRAVITY) * (p.rear if is_front else p.front) / (p.front + p.rear)
    lift = 0.5 * (p.lift_front if is_front else p.lift_rear) * vx * vx
    share = p.roll_front if is_front else 1.0 - p.roll_front
    return static + lift + (-pitch if is_front else pitch) + (-share * roll if is_left else share * roll)


@njit(cache=True)
def wheel_travel(vx, vy, r, arm, side, c, s):
    """Return a wheel's speed along and across its own direction [m/s], of cosine c and sine s in the car."""
    travel_x, travel_y = vx - r * side, vy + r * arm
    return travel_x * c + travel_y * s, -travel_x * s + travel_y * c


@njit(cache=True)
def softened(load, over, p):
    """Return the load that stiffness goes with [N], for a wheel loaded by `over` more than its mean [1]."""
    softer = load * (1.0 - p.load_softening * over)
    return 0.2 * load if softer < 0.2 * load else softer


@njit(cache=True)
def wheel_torque(arrived, is_front, p):
    """Return a wheel's half of its axle's share of the torque [N m]; driving and braking have their own."""
    if arrived >= 0.0:
        return 0.5 * arrived * (p.drive_front if is_front else 1.0 - p.drive_front)
    return 0.5 * arrived * (p.brake_front if is_front else 1.0 - p.brake_front)


@njit(cache=True)
def write_pose_rates(x, out):
    """Write the rates of X, Y [m/s] and yaw [rad/s] of a state that begins with X, Y, yaw, v_x, v_y, r."""
    out[0] = x[3] * cos(x[2]) - x[4] * sin(x[2])
    out[1] = x[3] * sin(x[2]) + x[4] * cos(x[2])
    out[2] = x[5]
