"""Everything compiled: tyre, derivative, integration step, road, driver, the loop around them.

One file on purpose: numba's cache watches the file of a function, not those of the functions it calls, so a
change spread over several files could run old code. The equations are documented where they are offered:
`tire`, `dynamics`, `road`, `drivers`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

GRAVITY = 9.80665
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
OUT_STEER_LEFT, OUT_STEER_RIGHT = 19, 20
OUT_SIZE = 21

# Surroundings of the car at one instant.
ENV_FRICTION, ENV_GRADE, ENV_BANK, ENV_WIND_X, ENV_WIND_Y, ENV_FRICTION_REAR = 0, 1, 2, 3, 4, 5
# What a fault does at that instant; see `faults`. All zero in a sound car.
ENV_FORCE_Y, ENV_MOMENT, ENV_REAR_STEER = 6, 7, 8
ENV_GRIP_LOSS, ENV_DRAG_TORQUE = 9, 13
ENV_SIZE = 17

# What faults remember.
MEM_WHEEL_ANGLE, MEM_BRAKE_HEAT, MEM_TIRE_HEAT, MEM_STUCK, MEM_SLOSH, MEM_SLOSH_RATE, MEM_PULSE = (
    0, 1, 2, 3, 4, 5, 6,
)  # fmt: skip
MEM_SIZE = 7

# Why a run ended.
FINISHED, TOO_SLOW, LEFT_TRACK, SPUN, NOT_FINITE, OUT_OF_TIME = 0, 1, 2, 3, 4, 5

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
def derivative(x, torque_command, steer_command, env, car, dx, out):
    """Write the state's rate to `dx` and what follows from state and input to `out`."""
    vx, vy, r = x[VX], x[VY], x[R]
    cos_yaw, sin_yaw = math.cos(x[YAW]), math.sin(x[YAW])
    wheelbase = car.cg_to_front_axle + car.cg_to_rear_axle

    air_x = vx - (cos_yaw * env[ENV_WIND_X] + sin_yaw * env[ENV_WIND_Y])
    air_y = vy - (-sin_yaw * env[ENV_WIND_X] + cos_yaw * env[ENV_WIND_Y])
    pressure = 0.5 * car.air_density * math.sqrt(air_x * air_x + air_y * air_y)
    air_fx = -pressure * car.drag_area * air_x
    air_fy = -pressure * car.side_area * air_y
    head_pressure = 0.5 * car.air_density * air_x * air_x

    weight = car.mass * GRAVITY * math.cos(env[ENV_GRADE]) * math.cos(env[ENV_BANK])
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

    torque = x[TORQUE]
    split = car.drive_split_front if torque >= 0.0 else car.brake_split_front
    steer_left, steer_right = wheel_angles(x[STEER] + car.steer_offset, car)
    out[OUT_STEER_LEFT], out[OUT_STEER_RIGHT] = steer_left, steer_right

    # Summed axle by axle, so that a mirrored state gives mirrored rates to the last bit.
    front_fx, front_fy, front_moment = 0.0, 0.0, 0.0
    rear_fx, rear_fy, rear_moment = 0.0, 0.0, 0.0
    power_in, power_tire, power_rolling = 0.0, 0.0, 0.0
    for wheel in range(4):
        is_front = wheel < 2
        is_left = wheel % 2 == 0
        tire = car.front_tire if is_front else car.rear_tire
        arm = car.cg_to_front_axle if is_front else -car.cg_to_rear_axle
        half = 0.5 * (car.track_front if is_front else car.track_rear)
        side = half if is_left else -half
        inertia = car.wheel_inertia_front if is_front else car.wheel_inertia_rear
        locking = car.differential_locking_front if is_front else car.differential_locking_rear
        if is_front:
            angle = steer_left if is_left else steer_right
        else:
            angle = env[ENV_REAR_STEER] + (-car.toe_rear if is_left else car.toe_rear)
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

        other = x[WHEEL + wheel + (1 if is_left else -1)]
        # Brakes and rolling resistance turn with the wheel; near standstill the sign is let go smoothly.
        turning = math.tanh(rim / 0.05)
        applied = 0.5 * (split if is_front else 1.0 - split) * torque
        if torque < 0.0:
            applied *= turning
        applied -= env[ENV_DRAG_TORQUE + wheel] * turning
        rolling = tire.rolling_resistance * load * car.wheel_radius * turning
        locked = locking * (other - spin)
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
    gravity_x = -GRAVITY * math.sin(env[ENV_GRADE])
    gravity_y = -GRAVITY * math.sin(env[ENV_BANK])
    dx[X] = vx * cos_yaw - vy * sin_yaw
    dx[Y] = vx * sin_yaw + vy * cos_yaw
    dx[YAW] = r
    dx[VX] = ax + vy * r + gravity_x
    dx[VY] = ay - vx * r + gravity_y
    dx[R] = (front_moment + rear_moment + env[ENV_MOMENT]) / car.yaw_inertia

    demand = torque_command * (car.drive_gain if torque_command >= 0.0 else car.brake_gain)
    dx[TORQUE] = smooth_limit((demand - torque) / car.drive_lag, car.torque_rate)
    dx[STEER] = smooth_limit((steer_command - x[STEER]) / car.steer_lag, car.steer_rate)
    w, zeta = car.load_transfer_frequency, car.load_transfer_damping
    dx[AX_LOAD] = x[AX_RATE]
    dx[AX_RATE] = w * w * (ax - x[AX_LOAD]) - 2.0 * zeta * w * x[AX_RATE]
    dx[AY_LOAD] = x[AY_RATE]
    dx[AY_RATE] = w * w * (ay - x[AY_LOAD]) - 2.0 * zeta * w * x[AY_RATE]

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
    derivative(x, torque_command, steer_command, env, car, k1, out)
    for i in range(STATE_SIZE):
        trial[i] = x[i] + 0.5 * step * k1[i]
    derivative(trial, torque_command, steer_command, env, car, k2, out)
    for i in range(STATE_SIZE):
        trial[i] = x[i] + 0.5 * step * k2[i]
    derivative(trial, torque_command, steer_command, env, car, k3, out)
    for i in range(STATE_SIZE):
        trial[i] = x[i] + step * k3[i]
    derivative(trial, torque_command, steer_command, env, car, k4, out)
    for i in range(STATE_SIZE):
        x[i] += step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])


@compiled
def interpolate(table, position, closed):
    """Return the table at a fractional index; wrapped round when closed, else held at the ends."""
    n = table.shape[0]
    if closed:
        low = math.floor(position)
        part = position - low
        i = int(low) % n
        j = (i + 1) % n
    else:
        position = min(max(position, 0.0), n - 1.0)
        i = min(int(position), n - 2) if n > 1 else 0
        j = min(i + 1, n - 1)
        part = position - i
    return table[i] + part * (table[j] - table[i])


@compiled
def surroundings(s, t, road, car, env):
    """Write grade, bank and wind at track position `s` of the CG and time `t`, and friction where each axle is."""
    position = s / road.spacing
    closed = road.closed > 0.5
    moment = t / road.time_spacing
    grip = interpolate(road.grip, moment, False)
    front = (s + car.cg_to_front_axle) / road.spacing
    rear = (s - car.cg_to_rear_axle) / road.spacing
    env[ENV_FRICTION] = interpolate(road.friction, front, closed) * grip
    env[ENV_FRICTION_REAR] = interpolate(road.friction, rear, closed) * grip
    env[ENV_GRADE] = interpolate(road.grade, position, closed)
    env[ENV_BANK] = interpolate(road.bank, position, closed)
    env[ENV_WIND_X] = interpolate(road.wind_x, moment, False)
    env[ENV_WIND_Y] = interpolate(road.wind_y, moment, False)


@compiled
def angle_at(table, position, turn):
    """Return an unwrapped angle of a closed path at a fractional index; `turn` is what one lap adds."""
    n = table.shape[0]
    low = math.floor(position)
    i = int(low) % n
    end = table[i + 1] if i + 1 < n else table[0] + turn
    return table[i] + (position - low) * (end - table[i])


@compiled
def project(px, py, s, path):
    """Return arc length and signed distance (left positive) of the path's point nearest to (px, py)."""
    error = 0.0
    for _ in range(4):
        position = s / path.spacing
        heading = angle_at(path.direction, position, path.turn)
        cos_h, sin_h = math.cos(heading), math.sin(heading)
        ex = px - interpolate(path.x, position, True)
        ey = py - interpolate(path.y, position, True)
        error = -sin_h * ex + cos_h * ey
        ahead = cos_h * ex + sin_h * ey
        curvature = interpolate(path.curvature, position, True)
        shrink = max(1.0 - curvature * error, 0.2)
        s += ahead / shrink
    return s, error


@compiled
def steer_for(x, s, error, path, plan, driver, car, k):
    """Return the road-wheel angle asked for: the road's arc and the way back to the line, within grip."""
    vx, vy, r = x[VX], x[VY], x[R]
    speed = math.sqrt(vx * vx + vy * vy)
    wheelbase = car.cg_to_front_axle + car.cg_to_rear_axle
    place = s / plan.spacing
    offset = interpolate(plan.line_offset, place, False)
    lean = (interpolate(plan.line_offset, place + 1.0, False) - offset) / plan.spacing
    astray = x[YAW] + math.atan2(vy, vx) - angle_at(path.direction, s / path.spacing, path.turn) - lean
    astray -= TURN * math.floor(astray / TURN + 0.5)
    ahead = interpolate(path.curvature, (s + driver.turn_in_time * speed) / path.spacing, True)
    reach = driver.preview_time * speed
    # The arc that would lead back to the line within the previewed distance, added to the road's own.
    curvature = ahead - 2.0 * (math.sin(astray) * reach + error - offset) / (reach * reach)

    demand = speed * speed * abs(curvature) / (1.0 + driver.downforce * speed * speed)
    extra = interpolate(driver.slip_difference, demand / driver.lateral_spacing, False)
    steer = math.atan(wheelbase * curvature) + math.copysign(extra, curvature)
    steer += driver.yaw_gain * wheelbase / max(speed, 1.0) * (speed * curvature - r)
    steer += plan.steer_noise[k] / (1.0 + (speed / driver.calm_speed) ** 2)
    rear_angle = -math.atan2(vy - car.cg_to_rear_axle * r, vx)
    excess = abs(rear_angle) - driver.rear_angle_limit
    if excess > 0.0:
        steer -= math.copysign(1.5 * excess, rear_angle)
    free = math.atan2(vy + car.cg_to_front_axle * r, vx)
    steer = min(max(steer, free - driver.slip_angle_limit), free + driver.slip_angle_limit)
    return min(max(steer, -car.max_steer_angle), car.max_steer_angle)


@compiled
def torque_for(x, target_speed, target_acceleration, driver, car, noise):
    """Return the wheel torque that follows a speed, by feed-forward and a proportional correction."""
    vx = x[VX]
    mass = car.mass + 2.0 * (car.wheel_inertia_front + car.wheel_inertia_rear) / car.wheel_radius**2
    resistance = 0.5 * car.air_density * car.drag_area * vx * vx
    resistance += car.mass * GRAVITY * 0.5 * (car.front_tire.rolling_resistance + car.rear_tire.rolling_resistance)
    force = mass * (target_acceleration + driver.speed_gain * (target_speed - vx)) + resistance
    torque = car.wheel_radius * force * (1.0 + noise)
    slipping = 0.0
    for wheel in range(4):
        slipping = max(slipping, abs(x[SLIP + wheel]))
    if slipping > driver.slip_ratio_limit:
        torque *= max(0.15, 1.0 - (slipping - driver.slip_ratio_limit) / driver.slip_ratio_limit)
    rear_angle = abs(math.atan2(x[VY] - car.cg_to_rear_axle * x[R], vx))
    if rear_angle > driver.rear_angle_limit:
        torque *= max(0.0, 1.0 - 8.0 * (rear_angle - driver.rear_angle_limit))
    most = min(car.max_torque, car.max_power * car.wheel_radius / max(vx, 1.0))
    return min(max(torque, -car.max_brake_torque), most)


@compiled
def disturb(x, torque, steer, faults, car, out, memory, env, step):
    """Let faults act: return torque and steer angle as they arrive, write the rest to `env`; see `faults`."""
    vx, r = x[VX], x[R]
    spin = 0.25 * (x[WHEEL] + x[WHEEL + 1] + x[WHEEL + 2] + x[WHEEL + 3])
    delivered = x[TORQUE]

    braking = max(-delivered, 0.0)
    heat = memory[MEM_BRAKE_HEAT]
    power = braking * spin
    memory[MEM_BRAKE_HEAT] += step * (power / faults.brake_heat_capacity - heat / faults.brake_cooling_time)
    if torque < 0.0:
        torque *= 1.0 - faults.brake_fade * min(heat, 1.0)
    elif torque > 0.0:
        torque *= 1.0 - faults.torque_bend * torque / car.max_torque

    memory[MEM_WHEEL_ANGLE] += step * spin
    torque += faults.ripple * car.max_torque * math.sin(faults.ripple_order * memory[MEM_WHEEL_ANGLE])
    steer += faults.torque_steer * delivered / car.max_torque
    env[ENV_REAR_STEER] = faults.rear_steer * x[STEER] * (vx / faults.rear_steer_speed - 1.0)

    sliding = max(out[OUT_POWER_TIRE], 0.0)
    warm = memory[MEM_TIRE_HEAT]
    memory[MEM_TIRE_HEAT] += step / faults.tire_heat_time * (sliding / faults.tire_heat_power - warm)
    warm_loss = faults.tire_heat_loss * min(warm, 1.0)
    env[ENV_GRIP_LOSS] = 1.0 - (1.0 - faults.grip_loss_fl) * (1.0 - warm_loss)
    env[ENV_GRIP_LOSS + 1] = 1.0 - (1.0 - faults.grip_loss_fr) * (1.0 - warm_loss)
    env[ENV_GRIP_LOSS + 2] = 1.0 - (1.0 - faults.grip_loss_rl) * (1.0 - warm_loss)
    env[ENV_GRIP_LOSS + 3] = 1.0 - (1.0 - faults.grip_loss_rr) * (1.0 - warm_loss)

    stuck = faults.stuck_brake * braking
    if stuck > memory[MEM_STUCK]:
        memory[MEM_STUCK] = stuck
    memory[MEM_STUCK] -= step * memory[MEM_STUCK] / faults.stuck_brake_time
    env[ENV_DRAG_TORQUE] = memory[MEM_STUCK] if braking == 0.0 else 0.0

    w, zeta = TURN * faults.slosh_frequency, 0.1
    push = w * w * memory[MEM_SLOSH] + 2.0 * zeta * w * memory[MEM_SLOSH_RATE]
    # The liquid's mass is part of the car's, so only what it does beyond a frozen load is added.
    env[ENV_FORCE_Y] = faults.slosh_mass * (push + out[OUT_AY])
    env[ENV_MOMENT] = faults.slosh_arm * env[ENV_FORCE_Y]
    memory[MEM_SLOSH_RATE] -= step * (push + out[OUT_AY])
    memory[MEM_SLOSH] += step * memory[MEM_SLOSH_RATE]

    rear_angle = math.atan2(x[VY] - car.cg_to_rear_axle * r, vx)
    if abs(rear_angle) > faults.pulse_threshold and memory[MEM_PULSE] <= -faults.pulse_pause:
        memory[MEM_PULSE] = faults.pulse_time
    memory[MEM_PULSE] -= step
    # The brake of the front wheel on the outside of the turn.
    outside = 1 if r > 0.0 else 0
    env[ENV_DRAG_TORQUE + 1] = 0.0
    if memory[MEM_PULSE] > 0.0:
        env[ENV_DRAG_TORQUE + outside] += faults.pulse_torque
    return torque, steer


@compiled
def command_at(t, commands, before, control, ramp):
    """Return a command at time `t`: held since its instant, or led there in a straight line over a period."""
    position = t / control + 1e-9
    k = int(math.floor(position))
    now = commands[k] if k >= 0 else before
    if ramp == 0.0:
        return now
    last = commands[k - 1] if k >= 1 else before
    return last + (position - k) * (now - last)


@compiled
def arriving(t, torques, steers, played, x0, car, control, step):
    """Return the torque and steer commands that reach the actuators at `t`: late, scaled, through the play."""
    # A straight line is best held over a step at its middle.
    t += 0.5 * step * car.command_ramp
    torque = command_at(t - car.drive_delay, torques, x0[TORQUE], control, car.command_ramp)
    steer = car.steer_gain * command_at(t - car.steer_delay, steers, x0[STEER], control, car.command_ramp)
    half_play = 0.5 * car.steer_backlash
    return torque, min(max(played, steer - half_play), steer + half_play)


@compiled
def run(x0, s0, car, faults, road, path, plan, script, driver, control, step, substeps, keep, stop):
    """Drive the car; see `simulation.simulate`.

    A script value that is NaN leaves the choice to the driver, an infinite one holds the last command.
    """
    steps = script.torque.shape[0]
    rows = steps * (substeps // keep)
    times = np.empty(rows)
    states = np.empty((rows, STATE_SIZE))
    outs = np.empty((rows, OUT_SIZE))
    places = np.empty(rows)
    torques = np.empty(steps)
    steers = np.empty(steps)
    x = x0.copy()
    work = np.empty((5, STATE_SIZE))
    out = np.empty(OUT_SIZE)
    out[:] = 0.0
    env = np.zeros(ENV_SIZE)
    memory = np.zeros(MEM_SIZE)
    on_track = path.length > 0.0
    s = s0
    error = 0.0
    row = 0
    used = 0
    played = x[STEER]
    last_torque, last_steer = x[TORQUE], x[STEER]
    reason = OUT_OF_TIME if stop.distance < 1e300 else FINISHED
    for k in range(steps):
        if on_track:
            s, error = project(x[X], x[Y], s, path)
        if s - s0 >= stop.distance:
            reason = FINISHED
            break
        if x[VX] < stop.speed:
            reason = TOO_SLOW
            break
        if abs(error) > stop.off_track:
            reason = LEFT_TRACK
            break
        if abs(math.atan2(x[VY], x[VX])) > 0.8:
            reason = SPUN
            break
        if not math.isfinite(x[VX] + x[R]):
            reason = NOT_FINITE
            break

        steer = script.steer[k]
        if math.isnan(steer):
            steer = steer_for(x, s, error, path, plan, driver, car, k)
            most = driver.steer_rate * control
            steer = min(max(steer, last_steer - most), last_steer + most)
        elif math.isinf(steer):
            steer = last_steer
        torque = script.torque[k]
        if math.isnan(torque):
            target, slope = script.speed[k], script.acceleration[k]
            if math.isnan(target):
                ahead = s + x[VX] * driver.speed_preview
                scale = interpolate(plan.speed_scale, ahead / plan.spacing, False)
                target = interpolate(path.speed, s / path.spacing, True)
                target *= interpolate(plan.speed_scale, s / plan.spacing, False)
                slope = interpolate(path.acceleration, ahead / path.spacing, True) * scale * scale
            torque = torque_for(x, target, slope, driver, car, plan.torque_noise[k])
            most = driver.torque_rate * control
            torque = min(max(torque, last_torque - most), last_torque + most)
        elif math.isinf(torque):
            torque = last_torque
        last_torque, last_steer = torque, steer
        torques[k], steers[k] = torque, steer
        used = k + 1

        for j in range(substeps):
            t = k * control + j * step
            torque_now, played = arriving(t, torques, steers, played, x0, car, control, step)
            torque_in, steer_in = torque_now, played
            surroundings(s, t, road, car, env)
            if faults.active > 0.0:
                torque_in, steer_in = disturb(x, torque_now, played, faults, car, out, memory, env, step)
            if j % keep == 0:
                derivative(x, torque_in, steer_in, env, car, work[0], out)
                times[row] = t
                states[row] = x
                outs[row] = out
                places[row] = s
                row += 1
            rk4_step(x, torque_in, steer_in, env, car, step, work, out)
            s += math.sqrt(x[VX] * x[VX] + x[VY] * x[VY]) * step
    return times[:row], states[:row], outs[:row], places[:row], torques[:used], steers[:used], reason


@compiled
def follow(motion, places, torques, steers, x0, car, road, control, step, keep, window):
    """Predict a recorded motion piece by piece with a car of one's own; see `replay.predict`."""
    rows = motion.shape[0]
    count = (rows - 1) // window
    predicted = np.empty((count, 3))
    x = x0.copy()
    work = np.empty((5, STATE_SIZE))
    out = np.zeros(OUT_SIZE)
    env = np.zeros(ENV_SIZE)
    played = car.steer_gain * x0[STEER]
    free = x.copy()
    for row in range(count * window):
        for i in range(6):
            x[i] = motion[row, i]
        if row % window == 0:
            if row > 0:
                predicted[row // window - 1] = free[VX : R + 1]
            free[:] = x
        for j in range(keep):
            t = (row * keep + j) * step
            torque, played = arriving(t, torques, steers, played, x0, car, control, step)
            surroundings(places[row], t, road, car, env)
            rk4_step(x, torque, played, env, car, step, work, out)
            rk4_step(free, torque, played, env, car, step, work, out)
    predicted[count - 1] = free[VX : R + 1]
    return predicted


@compiled
def advance(x, torque_command, steer_command, env, car, step, count):
    """Advance a state by `count` steps with held inputs; returns the new state and its outputs."""
    x = x.copy()
    work = np.empty((5, STATE_SIZE))
    out = np.empty(OUT_SIZE)
    for _ in range(count):
        rk4_step(x, torque_command, steer_command, env, car, step, work, out)
    derivative(x, torque_command, steer_command, env, car, work[0], out)
    return x, out
