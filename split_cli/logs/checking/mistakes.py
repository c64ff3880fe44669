"""The usual mistakes of unit, sign and source in a recording, each with its factor and its remedy."""

from dataclasses import dataclass

import numpy as np

from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.parameters import Vehicle

DEGREES = 180.0 / np.pi

# Costs are negative logarithms of how often a channel carries such a mistake, as judged from forums and from the
# recordings of others that this project was tried on: one in twenty, or one in a hundred and fifty.
COMMON = 3.0
RARE = 5.0
DOUBLE = 5.0

OTHER_RADIUS = "rolls on another radius than it was made with, here or in the logger"


@dataclass(frozen=True)
class Mistake:
    """A known mistake: the channel is `low` to `high` times what it should be, its sign turned where `turned`."""

    channel: str  # a channel; ``hand`` stands for the order of X and Y
    # low, high: factor, or its range where the mistake has no fixed one [1].
    low: float
    high: float
    turned: bool
    # what, remedy: in words.
    what: str
    remedy: str
    cost: float = COMMON  # negative logarithm of its frequency [1]
    unit: str = ""  # the unit that the channel is in, where the mistake is one of unit

    @property
    def factor(self) -> float | None:
        """Signed factor, None where only a range is known."""
        return (-self.low if self.turned else self.low) if self.low == self.high else None


_SIGNS = {
    "vx": (
        "has the opposite sign, or the car drives backwards",
        "use `scale: -1` if it drove ahead; driving backwards is not modelled",
    ),
    "r": ("is left-handed (clockwise positive)", "use `scale: -1` or `frame: frd` for it"),
    "yaw": ("is clockwise positive", "use `scale: -1` for it"),
    "delta": ("is right-positive", "use `scale: -1` or `frame: frd` for it"),
    "vy": ("is right-positive", "use `scale: -1` or `frame: frd` for it"),
    "ay": ("is right-positive", "use `scale: -1` or `frame: frd` for it"),
    "ax": ("is positive when braking", "use `scale: -1`"),
    "T": ("is positive when braking", "use `scale: -1`"),
    "hand": ("are mirrored: X and Y exchanged", "exchange their sources"),
}
_SPEED_UNITS = ((3.6, "km/h"), (1 / 0.44704, "mph"), (1 / 0.514444, "kn"))
_RARE_SPEED_UNITS = ((1 / 0.3048, "ft/s"), (100.0, "cm/s"), (1000.0, "mm/s"))
_MILE_IN_KM = 1.609344
_LENGTH_UNITS = ((1 / 0.3048, "ft"), (1e-3, "km"), (100.0, "cm"), (1000.0, "mm"))
_STEERING_RATIOS = (8.0, 25.0)
"""Of steering wheel to road wheel, from racing cars to lorries [1]."""

HIGHEST_RATIO = 20.0
"""Of an engine's speed to a wheel's, in first gear [1]: gearbox times final drive reach 13 to 17 in passenger cars.
Judgement."""
_REDUCTIONS = (5.0, HIGHEST_RATIO)
"""Of a motor's speed to that of the wheel that it drives alone [1]: electric race cars have 8 to 16. Judgement."""
_RADIUS_RATIOS = (0.7, 1.4)
"""Of a wheel's radius as stated to the one that it rolls on [1]: all tyres of one class of cars."""


def known_mistakes(channel: str, vehicle: Vehicle | None) -> list[Mistake]:
    """Return the mistakes that a channel may carry; `vehicle` gives the wheel radius that rad/s depends on."""
    known = []
    if channel != "X":  # a speed over ground has no sign, and the order of X and Y is the hand's
        sign = _SIGNS.get(channel, ("has the opposite sign", "use `scale: -1`"))
        known.append(Mistake(channel, 1.0, 1.0, True, *sign))
    if channel in ("r", "yaw", "delta"):
        per_second = "/s" if channel == "r" else ""
        known += _unit(channel, DEGREES, f"deg{per_second}", turned=True)
        twice = "was converted from degrees although it is in radians"
        known += _factor(channel, 1.0 / DEGREES, twice, f"set `unit: rad{per_second}`", RARE, f"rad{per_second}")
    if channel in ("vx", "vy") or channel.startswith("wheel_speed"):
        for factor, unit in _SPEED_UNITS:
            known += _unit(channel, factor, unit)
        for factor, unit in _RARE_SPEED_UNITS:
            known += _factor(channel, factor, f"is in {unit}", f"set `unit: {unit}`", RARE, unit)
        twice = "was converted from km/h although it is in m/s"
        known += _factor(channel, 1.0 / 3.6, twice, "set `unit: m/s`", RARE, "m/s")
        for stated, unit, factor in (("km/h", "mph", _MILE_IN_KM), ("mph", "km/h", 1.0 / _MILE_IN_KM)):
            what = f"was converted from {stated} although it is in {unit}"
            known += _factor(channel, 1.0 / factor, what, f"set `unit: {unit}`", RARE, unit)
    if channel.startswith("wheel_speed"):
        what = "counts the turns of a motor, before its reduction"
        remedy = "set `scale:` to 1 over the ratio of the reduction, or leave it out"
        known.append(Mistake(channel, *_REDUCTIONS, False, what, remedy, DOUBLE + 1.0))
    if channel.startswith("wheel_speed") and vehicle is not None:
        for factor, unit in ((1.0, "rad/s"), (30.0 / np.pi, "rpm")):
            turns = factor / vehicle.wheel_radius
            known += _unit(channel, turns, unit)
            what = f"is in {unit}, and the wheel {OTHER_RADIUS}"
            remedy = f"correct `wheel_radius` in the vehicle file, and set `unit: {unit}`"
            low, high = (turns * ratio for ratio in _RADIUS_RATIOS)
            known.append(Mistake(channel, low, high, False, what, remedy, DOUBLE + 1.0))
        what = OTHER_RADIUS
        remedy = "correct `wheel_radius` in the vehicle file where it counts turns, else set `scale:`"
        known.append(Mistake(channel, *_RADIUS_RATIOS, False, what, remedy, 4.0))
    if channel in ("ax", "ay"):
        known += _unit(channel, 1.0 / STANDARD_GRAVITY, "g", turned=True)
        for factor, unit in ((1 / 0.3048, "ft/s^2"), (1000.0, "mm/s^2")):
            known += _factor(channel, factor, f"is in {unit}", f"set `unit: {unit}`", RARE, unit)
        twice = "was converted from g although it is in m/s^2"
        known += _factor(channel, STANDARD_GRAVITY, twice, "set `unit: m/s^2`", RARE, "m/s^2")
    if channel == "X":
        for factor, unit in _LENGTH_UNITS:
            known += _factor(channel, factor, f"and Y are in {unit}", f"set `unit: {unit}`", COMMON, unit)
    if channel == "delta":
        known += _steering_wheel()
    if channel == "T":
        known += _factor("T", 1e-3, "is in kN m", "set `unit: kN m`", COMMON, "kN m")
        what = "is the torque of engine or motor, or of one wheel or axle"
        remedy = "leave T out and pass `--derive torque-from-acceleration`, or scale it to the sum at the wheels"
        known.append(Mistake("T", 1 / HIGHEST_RATIO, 1 / 2.5, False, what, remedy, 4.0))
    return known


def _factor(channel: str, factor: float, what: str, remedy: str, cost: float, unit: str) -> list[Mistake]:
    return [Mistake(channel, factor, factor, False, what, remedy, cost, unit)]


def _unit(channel: str, factor: float, unit: str, turned: bool = False) -> list[Mistake]:
    made = _factor(channel, factor, f"is in {unit}", f"set `unit: {unit}`", COMMON, unit)
    if turned:
        what, remedy = f"is in {unit}, and has the opposite sign", f"set `unit: {unit}` and `scale: -1`"
        made.append(Mistake(channel, factor, factor, True, what, remedy, DOUBLE, unit))
    return made


def _steering_wheel() -> list[Mistake]:
    made = []
    low, high = _STEERING_RATIOS
    for turned in (False, True):
        hand, cost = (", right-positive,", DOUBLE) if turned else ("", COMMON)
        ratio = "give its ratio as `scale: 1/ratio`"
        what = f"is the steering-wheel angle{hand}"
        made.append(Mistake("delta", low, high, turned, what, ratio, cost))
        made.append(
            Mistake(
                "delta",
                low * DEGREES,
                high * DEGREES,
                turned,
                f"{what} in degrees",
                f"set `unit: deg` and {ratio}",
                cost + 0.5,
                "deg",
            )
        )
    return made
