"""Classical Runge-Kutta steps of any of the cars, with commands that arrive late.

Numba chooses the equations by the type of the parameters, when it compiles the loop for one car.
"""

import numpy as np
from numba import njit, types
from numba.extending import overload

from tests.studies.other_cars.model_car import ModelCar, model_car_rates
from tests.studies.other_cars.sports_car import SportsCar, sports_car_rates
from tests.studies.other_cars.van import Van, van_rates

_RATES = {SportsCar: sports_car_rates, Van: van_rates, ModelCar: model_car_rates}


def rates(t, x, steer, torque, place, p, out):
    """Write the rates of a car's state into `out`; return the specific forces along and across [m/s^2]."""
    return _RATES[type(p)].py_func(t, x, steer, torque, place, p, out)


@overload(rates)
def _rates_of(t, x, steer, torque, place, p, out):
    if isinstance(p, types.NamedUniTuple):
        chosen = _RATES[p.instance_class]
        return lambda t, x, steer, torque, place, p, out: chosen(t, x, steer, torque, place, p, out)
    return None


@njit(cache=True)
def _held_at(commands, time, period):
    """Return a command that keeps its value from one period's begin to the next's; before the begin, the first."""
    index = int(np.floor(time / period + 1e-6))
    return commands[min(max(index, 0), len(commands) - 1)]


@njit(cache=True)
def advance_car(x, start, duration, step, p, steer, torque, place, period):
    """Advance a state in place over a duration, and return the specific forces along and across [m/s^2] at its end.

    Parameters
    ----------
    x : ndarray, shape (N,)
    start, duration : float
        Time since the first command, and how long [s].
    step : float
        Longest step [s]; the duration is cut into equal ones.
    p : NamedTuple
        Parameters of a car.
    steer, torque : ndarray, shape (K,)
        Commands from time zero on, held over each period [rad], [N m]; they arrive by the car's delays later.
    place : float
        Distance along the course [m].
    period : float
        Of the commands [s].
    """
    steps = max(int(np.ceil(duration / step - 1e-6)), 1)
    h = duration / steps
    a, b, c, d = np.empty_like(x), np.empty_like(x), np.empty_like(x), np.empty_like(x)
    for i in range(steps):
        t = start + i * h
        # Commands change between steps, not inside them: each stage takes those of the middle.
        u = _held_at(steer, t + 0.5 * h - p.steer_delay, period)
        w = _held_at(torque, t + 0.5 * h - p.torque_delay, period)
        rates(t, x, u, w, place, p, a)
        rates(t + 0.5 * h, x + 0.5 * h * a, u, w, place, p, b)
        rates(t + 0.5 * h, x + 0.5 * h * b, u, w, place, p, c)
        rates(t + h, x + h * c, u, w, place, p, d)
        x += h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    end = start + duration
    u = _held_at(steer, end - 0.5 * h - p.steer_delay, period)
    w = _held_at(torque, end - 0.5 * h - p.torque_delay, period)
    return rates(end, x, u, w, place, p, a)
