"""Drivers who follow a course late, with hands that shake, and the drive of a car under their commands."""

from dataclasses import dataclass
from math import atan2, cos, exp, pi, sin, sqrt

import numpy as np

from tests.studies.other_cars.cars import Car, CarKind
from tests.studies.other_cars.course import ClosedCourse
from tests.studies.other_cars.integration import advance_car

_HANDS = 0.08
"""Time constant of hands and feet [s]."""


class LostCar(Exception):
    """The car left the course or turned round: another driver has to be drawn."""


@dataclass(frozen=True)
class LateDriver:
    """One driver.

    Attributes
    ----------
    pace : float
        Lateral acceleration that is driven, over the grip [1].
    delay : float
        Between what is seen and what the hands do [s].
    preview : float
        Time to the point that is steered at [s].
    guess : float
        Understeer that is expected over the car's own [1].
    shake : float
        Of the steering, over what 1 m/s^2 needs [1].
    briskness : float
        Of the speed control [1/s].
    throws : bool
        Whether throttle and steering are thrown about, as in mixed driving.
    """

    pace: float
    delay: float
    preview: float
    guess: float
    shake: float
    briskness: float
    throws: bool


@dataclass(frozen=True)
class Driven:
    """A drive without sensors.

    Attributes
    ----------
    states : ndarray, shape (K, N)
        Of the car, at the begin of each period.
    felt : ndarray, shape (K, 2)
        Specific forces along and across at the CG [m/s^2].
    steer, torque, place : ndarray, shape (K,)
        Commands of each period [rad], [N m], and distance along the course [m].
    period : float
        [s].
    """

    car: Car
    course: ClosedCourse
    states: np.ndarray
    felt: np.ndarray
    steer: np.ndarray
    torque: np.ndarray
    place: np.ndarray
    period: float


def draw_driver(rng: np.random.Generator, style: str) -> LateDriver:
    """Return a driver for a style of course."""
    return LateDriver(
        pace=rng.uniform(0.42, 0.70),
        delay=rng.uniform(0.08, 0.16),
        preview=rng.uniform(0.55, 0.80) * (0.85 if style == "slalom" else 1.0),
        guess=rng.uniform(0.8, 1.2),
        shake=rng.uniform(0.15, 0.4),
        briskness=rng.uniform(0.6, 1.4),
        throws=style == "mixed driving",
    )


def drive(
    kind: CarKind, car: Car, course: ClosedCourse, driver: LateDriver, duration: float, rng: np.random.Generator
) -> Driven:
    """Return what a driver makes of a car on a course in a time [s].

    Raises
    ------
    LostCar
        If the car slides or leaves the course by more than a tenth of its radius.
    """
    period, base = kind.control, kind.base
    # People are no quicker with a small car, but see it from above: between its time scale and that of a road car.
    small = ((base.front + base.rear) / 2.7) ** 0.25
    wheelbase, gradient = base.front + base.rear, driver.guess * kind.gradient(base)
    lateral = driver.pace * 9.81 * base.grip
    drives = min(0.45 * lateral, 0.8 * kind.torques[0] / base.radius / base.mass)
    brakes = min(0.5 * lateral, 0.8 * kind.torques[1] / base.radius / base.mass)
    wanted = course.speeds(lateral, drives, brakes, kind.speeds)
    count, late = round(duration / period), max(round(driver.delay * small / period), 1)
    first = int(rng.integers(len(course.x)))
    place = first * course.spacing
    state = np.array(kind.start(car, float(wanted[first]), (course.x[first], course.y[first], course.heading[first])))
    states, felt = np.empty((count, len(state))), np.zeros((count, 2))
    steer, torque, places = np.zeros(count), np.zeros(count), np.empty(count)
    resting = (base.rolling + base.drag * state[3] ** 2) * base.radius
    steer[0], torque[0] = wheelbase * course.curvature[first], resting
    hands = 1.0 - exp(-period / (_HANDS * small))
    shaking, fades = 0.0, exp(-period / (0.3 * small))
    thrown = _Throws(rng, small) if driver.throws else None
    forces = (0.0, 0.0)
    for k in range(count):
        states[k], felt[k], places[k] = state, forces, place
        seen = max(k - late, 0)
        x, y, yaw, vx, vy, r = (float(value) for value in states[seen][:6])
        ahead = (k - seen) * period
        yaw, mean = yaw + r * ahead, yaw + 0.5 * r * ahead
        x += (vx * cos(mean) - vy * sin(mean)) * ahead
        y += (vx * sin(mean) + vy * cos(mean)) * ahead
        reach = max(vx * driver.preview * small, 1.2 * wheelbase)
        to = course.index(places[seen] + vx * ahead + reach)
        turn = atan2(course.y[to] - y, course.x[to] - x) - yaw - atan2(vy, vx)
        turn = (turn + pi) % (2.0 * pi) - pi
        asked = 2.0 * sin(turn) / reach * (wheelbase + gradient * vx * vx)
        shaking = fades * shaking + sqrt(1.0 - fades * fades) * rng.standard_normal()
        asked += driver.shake * shaking * (wheelbase / vx**2 + gradient)
        at = course.index(places[seen] + vx * (ahead + 0.3 * small))
        pushed = driver.briskness / small * (wanted[at] - vx) + (wanted[at] - wanted[course.index(places[seen])]) * 0.5
        if thrown is not None:
            turned, pressed = thrown.at(k * period)
            asked += turned * 0.25 * lateral * (wheelbase / vx**2 + gradient)
            pushed += pressed * 0.7 * drives
        pushed = min(max(pushed, -brakes), drives)
        needed = base.radius * (base.mass * pushed + base.rolling + base.drag * vx * vx)
        last = max(k - 1, 0)
        steer[k] = steer[last] + hands * (min(max(asked, -0.4), 0.4) - steer[last])
        torque[k] = torque[last] + hands * (min(max(needed, -kind.torques[1]), kind.torques[0]) - torque[last])
        forces = advance_car(state, k * period, period, kind.step, car, steer[: k + 1], torque[: k + 1], place, period)
        place = course.advanced(place, state[0], state[1])
        i = course.index(place)
        away = np.hypot(state[0] - course.x[i], state[1] - course.y[i])
        if not (away < 0.12 * kind.room and state[3] > 0.5 * kind.speeds[0] and abs(state[4]) < 0.35 * state[3]):
            raise LostCar(f"{away:.2f} m from the course at {k * period:.1f} s")
    return Driven(car, course, states, felt, steer, torque, places, period)


class _Throws:
    """Steps of the throttle and pulses of the steering, each of a random size and length."""

    def __init__(self, rng: np.random.Generator, scale: float) -> None:
        self.rng, self.scale = rng, scale
        self.turned, self.pressed, self.turns_until, self.presses_until = 0.0, 0.0, 0.0, 0.0

    def at(self, time: float) -> tuple[float, float]:
        """Return the steering and the throttle that are added, from -1 to 1 each [1]."""
        if time >= self.turns_until:
            self.turned = self.rng.uniform(-1.0, 1.0) if self.turned == 0.0 and self.rng.random() < 0.6 else 0.0
            self.turns_until = time + self.scale * self.rng.uniform(0.25, 0.9)
        if time >= self.presses_until:
            self.pressed = self.rng.uniform(-1.0, 1.0) if self.rng.random() < 0.7 else 0.0
            self.presses_until = time + self.scale * self.rng.uniform(0.5, 2.0)
        return self.turned, self.pressed
