"""How much an effect changes of what is recorded in a short time, over the sensors' noise."""

import numpy as np

from tests.studies.other_cars.cars import Car, CarKind
from tests.studies.other_cars.driver import Driven
from tests.studies.other_cars.effects import PlantedEffect
from tests.studies.other_cars.integration import advance_car
from tests.studies.other_cars.recording import SensorFaults, sensed

LEAST_VISIBLE = 0.35
"""Effects that change less, over noise, are drawn again [1]; the lower end of normal sizes in docs/proof.md."""
_STEP = 0.05
"""Time over which a change is measured [s]."""
_STARTS = 160


def effect_over_noise(kind: CarKind, driven: Driven, effect: PlantedEffect) -> float:
    """Return the rms change of v_x, v_y, r in 0.05 s over that of noise, in the channel where it is largest [1].

    Notes
    -----
    From states along a drive of the car without the effect, the same commands are driven with and without it. An
    effect of the car has 0.05 s for its inner states, and counts in the 0.05 s after that. For sensors, the car
    starts as they read and is compared with what they read 0.05 s later. A difference of two samples has sqrt(2)
    times the noise of one.
    """
    noise = np.array([kind.noise[name] for name in ("vx", "vy", "r")])
    every = round(_STEP / driven.period)
    starts = np.linspace(0.05, 0.97, _STARTS) * len(driven.steer)
    if effect.sensors:
        errors = _of_sensors(kind, driven, effect, starts.astype(int), every)
    else:
        errors = _of_the_car(kind, driven, effect, starts.astype(int), every)
    return float((np.sqrt(np.mean(errors**2, axis=0)) / (np.sqrt(2.0) * noise)).max())


def _after(kind: CarKind, car: Car, driven: Driven, state: np.ndarray, first: int, every: int) -> np.ndarray:
    """Return the state 0.05 s after a period's begin, under the commands of a drive."""
    state = state.copy()
    start, place = first * driven.period, float(driven.place[first])
    advance_car(state, start, every * driven.period, kind.step, car, driven.steer, driven.torque, place, driven.period)
    return state


def _of_the_car(kind, driven, effect, starts, every) -> np.ndarray:
    errors = np.empty((len(starts), 3))
    changed = effect.on_car(driven.car)
    for row, first in enumerate(starts):
        moved = driven.states[first].copy()
        moved[4] += effect.moves_the_cg_by * moved[5]
        gains = []
        for car, state in ((changed, moved), (driven.car, driven.states[first])):
            settled = _after(kind, car, driven, state, first, every)
            gains.append(_after(kind, car, driven, settled, first + every, every)[3:6] - settled[3:6])
        errors[row] = gains[0] - gains[1]
    return errors


def _of_sensors(kind, driven, effect, starts, every) -> np.ndarray:
    errors = np.empty((len(starts), 3))
    read = sensed(driven, effect.on_sensors(SensorFaults()))
    velocities = np.column_stack([read["vx"], read["vy"], read["r"]])
    for row, first in enumerate(starts):
        state = driven.states[first].copy()
        state[kind.spinning] *= velocities[first, 0] / state[3]
        state[3:6] = velocities[first]
        errors[row] = velocities[first + every] - _after(kind, driven.car, driven, state, first, every)[3:6]
    return errors
