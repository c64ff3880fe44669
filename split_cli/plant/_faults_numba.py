"""Between command and car, compiled: delay, gain and play of the actuators, and faults.

Called by the loops of `_loops_numba` only. The equations are documented in `cars` and `faults`.
"""

import math

from numba import njit

from split_cli.plant._compiled import (
    ENV_DRAG_TORQUE,
    ENV_FORCE_Y,
    ENV_GRIP_LOSS,
    ENV_MOMENT,
    ENV_REAR_STEER,
    OUT_AY,
    OUT_POWER_TIRE,
    STEER,
    TORQUE,
    TURN,
    VX,
    VY,
    WHEEL,
    R,
)

# What faults remember.
MEM_WHEEL_ANGLE, MEM_BRAKE_HEAT, MEM_TIRE_HEAT, MEM_STUCK, MEM_SLOSH, MEM_SLOSH_RATE, MEM_PULSE = (0, 1, 2, 3, 4, 5, 6)
MEM_SIZE = 7

inner = njit(error_model="numpy")  # not kept by itself: the loops keep it, see `_loops_numba`


@inner
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


@inner
def command_at(t, commands, before, control, ramp):
    """Return a command at time `t`: held since its instant, or led there in a straight line over a period."""
    position = t / control + 1e-9
    k = int(math.floor(position))
    now = commands[k] if k >= 0 else before
    if ramp == 0.0:
        return now
    last = commands[k - 1] if k >= 1 else before
    return last + (position - k) * (now - last)


@inner
def arriving(t, torques, steers, played, x0, car, control, step):
    """Return the torque and steer commands that reach the actuators at `t`: late, scaled, through the play."""
    # A straight line is best held over a step at its middle.
    t += 0.5 * step * car.command_ramp
    torque = command_at(t - car.drive_delay, torques, x0[TORQUE], control, car.command_ramp)
    steer = car.steer_gain * command_at(t - car.steer_delay, steers, x0[STEER], control, car.command_ramp)
    half_play = 0.5 * car.steer_backlash
    return torque, min(max(played, steer - half_play), steer + half_play)
