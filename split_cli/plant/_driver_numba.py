"""Road and driver, compiled: what surrounds the car at its place, and what the driver asks for there.

Called by the loops of `_loops_numba` only. The equations are documented in `road` and `drivers`.
"""

import math

from numba import njit

from split_cli.plant._compiled import (
    ENV_BANK,
    ENV_FRICTION,
    ENV_FRICTION_REAR,
    ENV_GRADE,
    ENV_WIND_X,
    ENV_WIND_Y,
    SLIP,
    TURN,
    VX,
    VY,
    YAW,
    R,
)
from split_cli.signals import STANDARD_GRAVITY

inner = njit(error_model="numpy")  # not kept by itself: the loops keep it, see `_loops_numba`


@inner
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


@inner
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


@inner
def angle_at(table, position, turn):
    """Return an unwrapped angle of a closed path at a fractional index; `turn` is what one lap adds."""
    n = table.shape[0]
    low = math.floor(position)
    i = int(low) % n
    end = table[i + 1] if i + 1 < n else table[0] + turn
    return table[i] + (position - low) * (end - table[i])


@inner
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


@inner
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


@inner
def torque_for(x, target_speed, target_acceleration, driver, car, noise):
    """Return the wheel torque that follows a speed, by feed-forward and a proportional correction."""
    vx = x[VX]
    mass = car.mass + 2.0 * (car.wheel_inertia_front + car.wheel_inertia_rear) / car.wheel_radius**2
    resistance = 0.5 * car.air_density * car.drag_area * vx * vx
    resistance += (
        car.mass * STANDARD_GRAVITY * 0.5 * (car.front_tire.rolling_resistance + car.rear_tire.rolling_resistance)
    )
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


@inner
def commands(x, s, error, path, plan, script, driver, car, control, last_torque, last_steer, k):
    """Return torque and steer commands at instant k.

    A script value that is NaN leaves the choice to the driver, an infinite one holds the last command.
    """
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
    return torque, steer
