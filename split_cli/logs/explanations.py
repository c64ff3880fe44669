"""The fewest known mistakes that account for all measured factors between channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from split_cli.logs.kinematics import Slope
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Finding", "Relation", "explain"]

_DEGREES = 180.0 / np.pi
_LARGEST_SET = 3


@dataclass(frozen=True)
class Finding:
    """Something that does not fit together.

    Attributes
    ----------
    check : str
        ``scale``, ``sign``, ``bias on straights``, ``place``, ``direction``, ``swapped``, ``constant``.
    channel : str
        The one to look at.
    text : str
        What was measured, what it probably is, and what to do.
    measured : float or None
        Slope, factor or bias.
    error : float or None
        Its standard error from blocks of time.
    """

    check: str
    channel: str
    text: str
    measured: float | None = None
    error: float | None = None


@dataclass(frozen=True)
class Relation:
    """A measured ratio that should be 1.

    Attributes
    ----------
    name : str
    powers : mapping of str to int
        Channel to the power with which its factor enters.
    slope : Slope
    tolerance : float
        Of the logarithm of the ratio.
    """

    name: str
    powers: Mapping[str, int]
    slope: Slope
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether the ratio is 1 within its tolerance."""
        return self.slope.slope > 0 and abs(np.log(self.slope.slope)) <= self.tolerance


@dataclass(frozen=True)
class _Mistake:
    """A known mistake: the channel is `low` to `high` times what it should be, its sign turned where `turned`."""

    channel: str
    low: float
    high: float
    turned: bool
    what: str
    remedy: str


def _exact(channel: str, factor: float, what: str, remedy: str) -> list[_Mistake]:
    turned = f"{what}, and has the opposite sign" if what else "has the opposite sign"
    turned_remedy = f"{remedy} and `scale: -1`" if remedy else "use `scale: -1`"
    plain = [_Mistake(channel, factor, factor, False, what, remedy)] if factor != 1.0 else []
    return [*plain, _Mistake(channel, factor, factor, True, turned, turned_remedy)]


def _known_mistakes(channels: Sequence[str], vehicle: Vehicle | None) -> list[_Mistake]:
    known: list[_Mistake] = []
    for channel in channels:
        sign = {
            "r": ("is left-handed (clockwise positive)", "use `scale: -1` or `frame: frd`"),
            "yaw": ("is clockwise positive", "use `scale: -1` or `world: ned`"),
            "delta": ("is right-positive", "use `scale: -1` or `frame: frd`"),
            "ay": ("is right-positive", "use `scale: -1` or `frame: frd`"),
            "ax": ("is positive when braking", "use `scale: -1`"),
            "T": ("is positive when braking", "use `scale: -1`"),
            "hand": ("are mirrored: X and Y exchanged", "exchange them or set `world: ned`"),
        }.get(channel, ("has the opposite sign", "use `scale: -1`"))
        known.append(_Mistake(channel, 1.0, 1.0, True, *sign))
        if channel in ("r", "yaw", "delta"):
            unit = "deg/s" if channel == "r" else "deg"
            known += _exact(channel, _DEGREES, f"is in {unit}", f"set `unit: {unit}`")
            twice = "was converted from degrees although it is in radians"
            known += _exact(channel, 1.0 / _DEGREES, twice, "set `unit: rad" + ("/s`" if channel == "r" else "`"))
        if channel == "vx" or channel.startswith("wheel_speed"):
            for factor, unit in ((3.6, "km/h"), (1 / 0.44704, "mph"), (1 / 0.514444, "kn")):
                known += _exact(channel, factor, f"is in {unit}", f"set `unit: {unit}`")[:1]
            known += _exact(channel, 1 / 3.6, "was converted from km/h although it is in m/s", "set `unit: m/s`")[
                :1
            ]
        if channel.startswith("wheel_speed") and vehicle is not None:
            known += _exact(channel, 1.0 / vehicle.wheel_radius, "is in rad/s", "set `unit: rad/s`")[:1]
        if channel in ("ax", "ay"):
            known += _exact(channel, 1.0 / 9.80665, "is in g", "set `unit: g`")
        if channel == "X":
            for factor, unit in ((1 / 0.3048, "ft"), (1e-3, "km"), (100.0, "cm"), (1000.0, "mm")):
                known += _exact(channel, factor, f"and Y are in {unit}", f"set `unit: {unit}`")[:1]
        if channel == "delta":
            for turned in (False, True):
                hand = ", right-positive," if turned else ""
                ratio = "give its ratio as `scale: 1/ratio`"
                known.append(_Mistake(channel, 8.0, 25.0, turned, f"is the steering-wheel angle{hand}", ratio))
                known.append(
                    _Mistake(
                        channel,
                        8.0 * _DEGREES,
                        25.0 * _DEGREES,
                        turned,
                        f"is the steering-wheel angle{hand} in degrees",
                        f"set `unit: deg` and {ratio}",
                    )
                )
        if channel == "T":
            known.append(
                _Mistake(channel, 1 / 20.0, 1 / 2.5, False, "is the torque of engine or motor, or of one wheel",
                         "scale it to the sum at the wheels")
            )  # fmt: skip
    return known


def explain(relations: Sequence[Relation], vehicle: Vehicle | None) -> list[Finding]:
    """Name the fewest known mistakes that make every relation hold.

    Parameters
    ----------
    relations : sequence of Relation
    vehicle : Vehicle, optional
        Its wheel radius tells wheel speeds in rad/s.

    Returns
    -------
    list of Finding
        Empty when all relations hold. Where several smallest sets do equally well, each finding says the other
        possibility; where none does, the broken relations themselves are told.
    """
    broken = [relation for relation in relations if not relation.holds]
    if not broken:
        return []
    channels = sorted({channel for relation in broken for channel in relation.powers})
    mistakes = _known_mistakes(channels, vehicle)
    for size in range(1, _LARGEST_SET + 1):
        fitting = [
            chosen
            for chosen in combinations(mistakes, size)
            if len({m.channel for m in chosen}) == size and all(_accounts(chosen, r) for r in relations)
        ]
        if fitting:
            return _told(fitting, broken)
    return [_unexplained(relation) for relation in broken]


def _accounts(chosen: Sequence[_Mistake], relation: Relation) -> bool:
    """Tell whether a relation is what the chosen mistakes make of it."""
    sign, low, high = 1.0, 0.0, 0.0
    for mistake in chosen:
        power = relation.powers.get(mistake.channel, 0)
        if power:
            sign *= -1.0 if mistake.turned else 1.0
            ends = sorted((power * np.log(mistake.low), power * np.log(mistake.high)))
            low, high = low + ends[0], high + ends[1]
    measured = relation.slope.slope
    size = float(np.log(abs(measured)))
    return measured * sign > 0 and low - relation.tolerance <= size <= high + relation.tolerance


def _told(fitting: Sequence[Sequence[_Mistake]], broken: Sequence[Relation]) -> list[Finding]:
    """Put the first fitting set into words, with the others as alternatives."""
    first = fitting[0]
    others = [chosen for chosen in fitting[1:] if {m.channel for m in chosen} != {m.channel for m in first}]
    alternative = ""
    if others:
        told = [" and ".join(f"{_name(m.channel)} {m.what}" for m in chosen) for chosen in others[:3]]
        alternative = f" Or: {'; or '.join(dict.fromkeys(told))}: nothing recorded decides."
    found = []
    for mistake in first:
        shown = [r for r in broken if mistake.channel in r.powers] or list(broken)
        evidence = "; ".join(
            f"{r.name}: slope {r.slope.slope:.4g} +- {r.slope.error:.1g}, correlation {r.slope.correlation:.3f}"
            for r in shown
        )
        channel = "X" if mistake.channel == "hand" else mistake.channel
        check = "sign" if mistake.turned and mistake.low == mistake.high == 1.0 else "scale"
        remedy = mistake.remedy[:1].upper() + mistake.remedy[1:]
        text = f"{_name(mistake.channel)} {mistake.what} ({evidence}). {remedy}"
        found.append(
            Finding(check, channel, f"{text} in the map.{alternative}", shown[0].slope.slope, shown[0].slope.error)
        )
    return found


def _unexplained(relation: Relation) -> Finding:
    slope = relation.slope
    channel = next(iter(relation.powers))
    return Finding(
        "scale" if slope.slope > 0 else "sign",
        channel,
        f"{relation.name}: slope {slope.slope:.4g} +- {slope.error:.1g} where 1 was expected "
        f"(correlation {slope.correlation:.3f}); no usual mistake of unit or sign gives that. "
        f"Check the scale of {' and '.join(_name(c) for c in relation.powers if c != 'hand')}.",
        slope.slope,
        slope.error,
    )


def _name(channel: str) -> str:
    return "X, Y" if channel == "hand" else channel
