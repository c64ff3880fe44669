"""The loops around the car, compiled: a drive from its start to its end, and the following of a recorded one.

Numba keeps compiled code until the file of a function, its code or the values that it closes over change. It does
not look at functions of other files. So both loops close over a digest of the files that they call.
"""

import hashlib
import math
from pathlib import Path

import numpy as np
from numba import njit

from split_cli.plant import _compiled, _driver_numba, _faults_numba
from split_cli.plant._compiled import (
    ENV_SIZE,
    OUT_SIZE,
    STATE_SIZE,
    STEER,
    TORQUE,
    VX,
    VY,
    R,
    X,
    Y,
    rk4_step,
    state_rate,
)
from split_cli.plant._driver_numba import commands, project, surroundings
from split_cli.plant._faults_numba import MEM_SIZE, arriving, disturb

# Why a run ended.
FINISHED, TOO_SLOW, LEFT_TRACK, SPUN, NOT_FINITE, OUT_OF_TIME = 0, 1, 2, 3, 4, 5
GOING_ON = -1

inner = njit(error_model="numpy")
kept = njit(cache=True, error_model="numpy")


@inner
def ending_of(x, driven, error, stop):
    """Return why a run ends here, `GOING_ON` if it does not."""
    if driven >= stop.distance:
        return FINISHED
    if x[VX] < stop.speed:
        return TOO_SLOW
    if abs(error) > stop.off_track:
        return LEFT_TRACK
    if abs(math.atan2(x[VY], x[VX])) > 0.8:
        return SPUN
    if not math.isfinite(x[VX] + x[R]):
        return NOT_FINITE
    return GOING_ON


@inner
def copy(values, into):
    """Copy element by element: with a slice numba compiles the texts of its error, a fifth of the time."""
    for i in range(values.shape[0]):
        into[i] = values[i]


def _driving(called):
    """Return `run`, compiled anew whenever the digest `called` is another one."""

    @kept
    def run(x0, s0, car, faults, road, path, plan, script, driver, control, step, substeps, keep, stop):
        """Drive the car; see `simulation.simulate`."""
        _ = called
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
        out = np.zeros(OUT_SIZE)
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
            ending = ending_of(x, s - s0, error, stop)
            if ending != GOING_ON:
                reason = ending
                break
            last_torque, last_steer = commands(
                x, s, error, path, plan, script, driver, car, control, last_torque, last_steer, k
            )
            torques[k], steers[k] = last_torque, last_steer
            used = k + 1

            for j in range(substeps):
                t = k * control + j * step
                torque_now, played = arriving(t, torques, steers, played, x0, car, control, step)
                torque_in, steer_in = torque_now, played
                surroundings(s, t, road, car, env)
                if faults.active > 0.0:
                    torque_in, steer_in = disturb(x, torque_now, played, faults, car, out, memory, env, step)
                if j % keep == 0:
                    state_rate(x, torque_in, steer_in, env, car, work[0], out)
                    times[row] = t
                    copy(x, states[row])
                    copy(out, outs[row])
                    places[row] = s
                    row += 1
                rk4_step(x, torque_in, steer_in, env, car, step, work, out)
                s += math.sqrt(x[VX] * x[VX] + x[VY] * x[VY]) * step
        return times[:row], states[:row], outs[:row], places[:row], torques[:used], steers[:used], reason

    return run


def _following(called):
    """Return `follow`, compiled anew whenever the digest `called` is another one."""

    @kept
    def follow(motion, places, torques, steers, x0, car, road, control, step, keep, window):
        """Predict a recorded motion piece by piece with a car of one's own; see `replay.predict`."""
        _ = called
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
                    copy(free[VX : R + 1], predicted[row // window - 1])
                copy(x, free)
            for j in range(keep):
                t = (row * keep + j) * step
                torque, played = arriving(t, torques, steers, played, x0, car, control, step)
                surroundings(places[row], t, road, car, env)
                rk4_step(x, torque, played, env, car, step, work, out)
                rk4_step(free, torque, played, env, car, step, work, out)
        copy(free[VX : R + 1], predicted[count - 1])
        return predicted

    return follow


_CALLED = b"".join(Path(module.__file__).read_bytes() for module in (_compiled, _driver_numba, _faults_numba))
_DIGEST = int.from_bytes(hashlib.sha256(_CALLED).digest()[:7], "big")
run, follow = _driving(_DIGEST), _following(_DIGEST)
