"""The car, compiled: the layout of its state, tyre, derivative, integration step.

Numba keeps compiled code beside a file until that file changes, whatever it calls in others. So what calls each
other stands here in one file; the loops, which call what other files hold, tell in `_loops_numba` how they do it.
The equations are documented where they are offered: `tire`, `dynamics`.
"""

import math

import numpy as np
from numba import njit

from split_cli.signals import STANDARD_GRAVITY

TURN = 2.0 * math.pi

# State vector.
X, Y, YAW, VX, VY, R = 0, 1, 2, 3, 4, 5
WHEEL = 6  # spin [rad/s] of front left, front right, rear left, rear right
SLIP = 10  # relaxed slip ratio of each wheel [1]
TANGENT = 14  # relaxed tangent of the slip angle of each wheel [1]
TORQUE, STEER = 18, 19  # what the actuators deliver: [N m], [rad]
AX_LOAD, AX_RATE, AY_LOAD, AY_RATE = 20, 21, 22, 23  # specific forces as the suspension passes them on
STATE_SIZE = 24

# Quantities that follow from state and input.
OUT_AX, OUT_AY = 0, 1
OUT_LOAD, OUT_FX, OUT_FY = 2, 6, 10
OUT_POWER_IN, OUT_POWER_TIRE, OUT_POWER_ROLLING, OUT_POWER_AIR, OUT_POWER_GRAVITY = 14, 15, 16, 17, 18
OUT_SIZE = 19

# Surroundings of the car at one instant.
ENV_FRICTION, ENV_GRADE, ENV_BANK, ENV_WIND_X, ENV_WIND_Y, ENV_FRICTION_REAR = 0, 1, 2, 3, 4, 5
# What a fault does at that instant; see `faults`. All zero in a sound car.
ENV_FORCE_Y, ENV_MOMENT, ENV_REAR_STEER = 6, 7, 8
ENV_GRIP_LOSS, ENV_DRAG_TORQUE = 9, 13
ENV_SIZE = 17

compiled = njit(cache=True, error_model="numpy")


@compiled
def tire_force_one(kappa, tangent, load, friction, tire):
    """Return F_x, F_y of one wheel; `tangent` is tan(alpha)."""
    if load <= 0.0:
        return 0.0, 0.0
    alpha = math.atan(tangent)
    df = (load - tire.nominal_load) / tire.nominal_load

    peak = (tire.p_dx1 + tire.p_dx2 * df) * load * friction
    slope = load * (tire.p_kx1 + tire.p_kx2 * df) * math.exp(tire.p_kx3 * df)
    curvature = tire.p_ex1 + tire.p_ex2 * df + tire.p_ex3 * df * df
    b = slope / (tire.p_cx1 * peak) * kappa
    fx = peak * math.sin(tire.p_cx1 * math.atan(b - curvature * (b - math.atan(b))))

    peak = (tire.p_dy1 + tire.p_dy2 * df) * load * friction
    slope = tire.p_ky1 * tire.nominal_load * math.sin(2.0 * math.atan(load / (tire.p_ky2 * tire.nominal_load)))
    curvature = tire.p_ey1 + tire.p_ey2 * df
    b = slope / (tire.p_cy1 * peak) * alpha
    fy = peak * math.sin(tire.p_cy1 * math.atan(b - curvature * (b - math.atan(b))))

    width_x = tire.r_bx1 / math.sqrt(1.0 + (tire.r_bx2 * kappa) ** 2)
    width_y = tire.r_by1 / math.sqrt(1.0 + (tire.r_by2 * alpha) ** 2)
    weight_x = math.cos(tire.r_cx1 * math.atan(width_x * alpha))
    weight_y = math.cos(tire.r_cy1 * math.atan(width_y * kappa))
    fx *= 1.0 - tire.combined_slip * (1.0 - weight_x)
    fy *= 1.0 - tire.combined_slip * (1.0 - weight_y)
    return fx, fy


@compiled
def tire_force_many(kappa, tangent, load, friction, tire, force):
    """Write F_x, F_y of many wheels, each shape (N,), to the rows of `force`."""
    for i in range(kappa.shape[0]):
        force[0, i], force[1, i] = tire_force_one(kappa[i], tangent[i], load[i], friction, tire)


@compiled
def axle_loads(total, moment, track):
    """Split an axle's load between left and right; a wheel that lifts leaves all of it to the other."""
    shift = moment / track
    shift = min(max(shift, -0.5 * total), 0.5 * total)
    return 0.5 * total - shift, 0.5 * total + shift


@compiled
def wheel_angles(steer, car):
    """Return the angles of the left and right front wheel for a mean road-wheel angle."""
    wheelbase = car.cg_to_front_axle + car.cg_to_rear_axle
    tangent = math.tan(steer)
    shift = car.ackermann_fraction * 0.5 * car.track_front / wheelbase * tangent
    left = math.atan(tangent / (1.0 - shift)) - car.toe_front
    right = math.atan(tangent / (1.0 + shift)) + car.toe_front
    return left, right


@compiled
def smooth_limit(rate, limit):
    """Return a rate that never exceeds its limit, smooth so that integration keeps its order."""
    return limit * math.tanh(rate / limit)


@compiled
def wheel_loads(x, head_pressure, env, car, out):
    """Write the vertical load of each wheel to `out`: weight, pitch, downforce, roll."""
    wheelbase = car.cg_to_front_axle + car.cg_to_rear_axle
    weight = car.mass * STANDARD_GRAVITY * math.cos(env[ENV_GRADE]) * math.cos(env[ENV_BANK])
    pitch_shift = car.pitch_transfer * car.mass * x[AX_LOAD] * car.cg_height / wheelbase
    front = weight * car.cg_to_rear_axle / wheelbase - pitch_shift + head_pressure * car.downforce_area_front
    rear = weight * car.cg_to_front_axle / wheelbase + pitch_shift + head_pressure * car.downforce_area_rear
    front_share = car.cg_to_rear_axle / wheelbase
    roll_axis = front_share * car.roll_center_front + (1.0 - front_share) * car.roll_center_rear
    roll_arm = car.cg_height - roll_axis
    lateral = car.mass * x[AY_LOAD]
    moment_front = lateral * (front_share * car.roll_center_front + car.roll_stiffness_front_share * roll_arm)
    moment_rear = lateral * (
        (1.0 - front_share) * car.roll_center_rear + (1.0 - car.roll_stiffness_front_share) * roll_arm
    )
    load_0, load_1 = axle_loads(max(front, 0.0), moment_front, car.track_front)
    load_2, load_3 = axle_loads(max(rear, 0.0), moment_rear, car.track_rear)
    out[OUT_LOAD], out[OUT_LOAD + 1], out[OUT_LOAD + 2], out[OUT_LOAD + 3] = load_0, load_1, load_2, load_3


@compiled
def air_forces(x, env, car):
    """Return the air's force along and across the car [N], and the pressure that makes downforce [Pa]."""
    cos_yaw, sin_yaw = math.cos(x[YAW]), math.sin(x[YAW])
    air_x = x[VX] - (cos_yaw * env[ENV_WIND_X] + sin_yaw * env[ENV_WIND_Y])
    air_y = x[VY] - (-sin_yaw * env[ENV_WIND_X] + cos_yaw * env[ENV_WIND_Y])
    pressure = 0.5 * car.air_density * math.sqrt(air_x * air_x + air_y * air_y)
    head_pressure = 0.5 * car.air_density * air_x * air_x
    return -pressure * car.drag_area * air_x, -pressure * car.side_area * air_y, head_pressure


@compiled
def slow_rates(x, torque_command, steer_command, ax, ay, car, dx):
    """Write the rates of the actuators, and of the specific forces as the suspension passes them on."""
    demand = torque_command * (car.drive_gain if torque_command >= 0.0 else car.brake_gain)
    dx[TORQUE] = smooth_limit((demand - x[TORQUE]) / car.drive_lag, car.torque_rate)
    dx[STEER] = smooth_limit((steer_command - x[STEER]) / car.steer_lag, car.steer_rate)
    w, zeta = car.load_transfer_frequency, car.load_transfer_damping
    dx[AX_LOAD] = x[AX_RATE]
    dx[AX_RATE] = w * w * (ax - x[AX_LOAD]) - 2.0 * zeta * w * x[AX_RATE]
    dx[AY_LOAD] = x[AY_RATE]
    dx[AY_RATE] = w * w * (ay - x[AY_LOAD]) - 2.0 * zeta * w * x[AY_RATE]


@compiled
def wheel_place(wheel, steer_left, steer_right, env, car):
    """Return how far before and left of the CG a wheel stands [m], and its angle [rad]."""
    is_left = wheel % 2 == 0
    if wheel < 2:
        half = 0.5 * car.track_front
        return car.cg_to_front_axle, half if is_left else -half, steer_left if is_left else steer_right
    half = 0.5 * car.track_rear
    angle = env[ENV_REAR_STEER] + (-car.toe_rear if is_left else car.toe_rear)
    return -car.cg_to_rear_axle, half if is_left else -half, angle


@compiled
def wheel_torques(x, wheel, load, tire, env, car):
    """Return a wheel's torque of drive and brakes, of the differential, and of rolling resistance [N m]."""
    is_front = wheel < 2
    torque, spin = x[TORQUE], x[WHEEL + wheel]
    split = car.drive_split_front if torque >= 0.0 else car.brake_split_front
    locking = car.differential_locking_front if is_front else car.differential_locking_rear
    # Brakes and rolling resistance turn with the wheel; near standstill the sign is let go smoothly.
    turning = math.tanh(spin * car.wheel_radius / 0.05)
    applied = 0.5 * (split if is_front else 1.0 - split) * torque
    if torque < 0.0:
        applied *= turning
    applied -= env[ENV_DRAG_TORQUE + wheel] * turning
    other = x[WHEEL + wheel + (1 if wheel % 2 == 0 else -1)]
    return applied, locking * (other - spin), tire.rolling_resistance * load * car.wheel_radius * turning


@compiled
def state_rate(x, torque_command, steer_command, env, car, dx, out):
    """Write the state's rate to `dx` and what follows from state and input to `out`."""
    vx, vy, r = x[VX], x[VY], x[R]
    cos_yaw, sin_yaw = math.cos(x[YAW]), math.sin(x[YAW])

    air_fx, air_fy, head_pressure = air_forces(x, env, car)
    wheel_loads(x, head_pressure, env, car, out)

    steer_left, steer_right = wheel_angles(x[STEER] + car.steer_offset, car)

    # Summed axle by axle, so that a mirrored state gives mirrored rates to the last bit.
    front_fx, front_fy, front_moment = 0.0, 0.0, 0.0
    rear_fx, rear_fy, rear_moment = 0.0, 0.0, 0.0
    power_in, power_tire, power_rolling = 0.0, 0.0, 0.0
    for wheel in range(4):
        is_front = wheel < 2
        tire = car.front_tire if is_front else car.rear_tire
        inertia = car.wheel_inertia_front if is_front else car.wheel_inertia_rear
        arm, side, angle = wheel_place(wheel, steer_left, steer_right, env, car)
        cos_a, sin_a = math.cos(angle), math.sin(angle)
        hub_x = vx - side * r
        hub_y = vy + arm * r
        along = cos_a * hub_x + sin_a * hub_y
        across = -sin_a * hub_x + cos_a * hub_y
        spin = x[WHEEL + wheel]
        rim = spin * car.wheel_radius
        speed = abs(along)
        load = out[OUT_LOAD + wheel]

        dx[SLIP + wheel] = (rim - along - speed * x[SLIP + wheel]) / tire.relaxation_longitudinal
        dx[TANGENT + wheel] = (-across - speed * x[TANGENT + wheel]) / tire.relaxation_lateral
        friction = env[ENV_FRICTION] if is_front else env[ENV_FRICTION_REAR]
        fx, fy = tire_force_one(x[SLIP + wheel], x[TANGENT + wheel], load, friction, tire)
        fx *= 1.0 - env[ENV_GRIP_LOSS + wheel]
        fy *= 1.0 - env[ENV_GRIP_LOSS + wheel]

        applied, locked, rolling = wheel_torques(x, wheel, load, tire, env, car)
        dx[WHEEL + wheel] = (applied + locked - rolling - fx * car.wheel_radius) / inertia

        body_x = cos_a * fx - sin_a * fy
        body_y = sin_a * fx + cos_a * fy
        moment = arm * body_y - side * body_x
        if is_front:
            front_fx += body_x
            front_fy += body_y
            front_moment += moment
        else:
            rear_fx += body_x
            rear_fy += body_y
            rear_moment += moment
        out[OUT_FX + wheel] = fx
        out[OUT_FY + wheel] = fy
        power_in += applied * spin
        power_rolling += (rolling - locked) * spin
        power_tire += fx * (rim - along) - fy * across

    ax = (front_fx + rear_fx + air_fx) / car.mass
    ay = (front_fy + rear_fy + air_fy + env[ENV_FORCE_Y]) / car.mass
    gravity_x = -STANDARD_GRAVITY * math.sin(env[ENV_GRADE])
    gravity_y = -STANDARD_GRAVITY * math.sin(env[ENV_BANK])
    dx[X] = vx * cos_yaw - vy * sin_yaw
    dx[Y] = vx * sin_yaw + vy * cos_yaw
    dx[YAW] = r
    dx[VX] = ax + vy * r + gravity_x
    dx[VY] = ay - vx * r + gravity_y
    dx[R] = (front_moment + rear_moment + env[ENV_MOMENT]) / car.yaw_inertia

    slow_rates(x, torque_command, steer_command, ax, ay, car, dx)
    out[OUT_AX], out[OUT_AY] = ax, ay
    out[OUT_POWER_IN] = power_in
    out[OUT_POWER_TIRE] = power_tire
    out[OUT_POWER_ROLLING] = power_rolling
    out[OUT_POWER_AIR] = -(air_fx * vx + air_fy * vy)
    out[OUT_POWER_GRAVITY] = car.mass * (gravity_x * vx + gravity_y * vy)


@compiled
def rk4_step(x, torque_command, steer_command, env, car, step, work, out):
    """Advance `x` in place by one step of the classical Runge-Kutta method, inputs held."""
    k1, k2, k3, k4, trial = work[0], work[1], work[2], work[3], work[4]
    state_rate(x, torque_command, steer_command, env, car, k1, out)
    for i in range(STATE_SIZE):
        trial[i] = x[i] + 0.5 * step * k1[i]
    state_rate(trial, torque_command, steer_command, env, car, k2, out)
    for i in range(STATE_SIZE):
        trial[i] = x[i] + 0.5 * step * k2[i]
    state_rate(trial, torque_command, steer_command, env, car, k3, out)
    for i in range(STATE_SIZE):
        trial[i] = x[i] + step * k3[i]
    state_rate(trial, torque_command, steer_command, env, car, k4, out)
    for i in range(STATE_SIZE):
        x[i] += step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])


@compiled
def advance(x, torque_command, steer_command, env, car, step, count):
    """Advance a state by `count` steps with held inputs; returns the new state and its outputs."""
    x = x.copy()
    work = np.empty((5, STATE_SIZE))
    out = np.empty(OUT_SIZE)
    for _ in range(count):
        rk4_step(x, torque_command, steer_command, env, car, step, work, out)
    state_rate(x, torque_command, steer_command, env, car, work[0], out)
    return x, out
