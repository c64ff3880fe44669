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
_SETTLING = 0.4
"""Time for lags, late forces and roll to become those of the car with the effect [s]."""
_STARTS = 160


def effect_over_noise(kind: CarKind, driven: Driven, effect: PlantedEffect) -> float:
    """Return the rms change of v_x, v_y, r in 0.05 s over that of noise, in the channel where it is largest [1].

    Notes
    -----
    From states along a drive of the car without the effect, the same commands are driven with and without it. For an
    effect of the car, both cars drive for 0.4 s. Then the car with the effect keeps its inner states and takes the
    place and the velocities of the other; what counts is what differs after another 0.05 s. For sensors, the car
    starts as they read and is compared with what they read 0.05 s later. A difference of two samples has sqrt(2)
    times the noise of one.
    """
    noise = np.array([kind.noise[name] for name in ("vx", "vy", "r")])
    starts = np.linspace(0.03, 0.95, _STARTS) * len(driven.steer)
    if effect.sensors:
        errors = _of_sensors(kind, driven, effect, starts.astype(int))
    else:
        errors = _of_the_car(kind, driven, effect, starts.astype(int))
    return float((np.sqrt(np.mean(errors**2, axis=0)) / (np.sqrt(2.0) * noise)).max())


def _after(
    kind: CarKind, car: Car, driven: Driven, state: np.ndarray, first: int, duration: float = _STEP
) -> np.ndarray:
    """Return the state a time [s] after a period's begin, under the commands of a drive."""
    state = state.copy()
    start, place = first * driven.period, float(driven.place[first])
    advance_car(state, start, duration, kind.step, car, driven.steer, driven.torque, place, driven.period)
    return state


def _of_the_car(kind, driven, effect, starts) -> np.ndarray:
    errors = np.empty((len(starts), 3))
    changed, settling = effect.on_car(driven.car), round(_SETTLING / driven.period)
    for row, first in enumerate(starts):
        begin = driven.states[first + settling]
        settled = _after(kind, changed, driven, driven.states[first], first, _SETTLING)
        settled[kind.spinning] *= begin[3] / settled[3]
        settled[:6] = begin[:6]
        settled[4] += effect.moves_the_cg_by * begin[5]
        gained = _after(kind, changed, driven, settled, first + settling)[3:6] - settled[3:6]
        without = _after(kind, driven.car, driven, begin, first + settling)[3:6] - begin[3:6]
        errors[row] = gained - without
    return errors


def _of_sensors(kind, driven, effect, starts) -> np.ndarray:
    errors = np.empty((len(starts), 3))
    read = sensed(driven, effect.on_sensors(SensorFaults()))
    velocities = np.column_stack([read["vx"], read["vy"], read["r"]])
    ahead = _STEP / driven.period
    later, share = int(ahead), ahead - int(ahead)
    for row, first in enumerate(starts):
        state = driven.states[first].copy()
        state[kind.spinning] *= velocities[first, 0] / state[3]
        state[3:6] = velocities[first]
        at_end = (1.0 - share) * velocities[first + later] + share * velocities[first + later + 1]
        errors[row] = at_end - _after(kind, driven.car, driven, state, first)[3:6]
    return errors
