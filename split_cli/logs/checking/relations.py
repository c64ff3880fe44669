"""Measured relations between channels, what is found in them, and how a story accounts for them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from split_cli.logs.checking.kinematics import Slope
from split_cli.logs.checking.mistakes import Mistake

UNKNOWN = 8.0
"""Cost of a factor that no known mistake gives: dearer than one of unit and sign at the edge of the tolerance."""
_BEYOND_PHYSICS = 4.0
"""Cost of a magnitude e times what a car can reach."""
OF_THE_BODY = ("vy", "ay", "delta")
SHARED = ("vx", "r")
"""Channels that enter several relations; every other one enters one."""
OVER_TIME = (
    "r against dyaw/dt",
    "r against the turning of X, Y",
    "v_x against the speed of X, Y",
    "a_x against dv_x/dt - v_y r",
)
"""Relations to a rate of change, which a wrong clock puts off by one factor."""


@dataclass(frozen=True)
class ConsistencyFinding:
    """Something that does not fit together."""

    # ``scale``, ``sign``, ``hand``, ``bias on straights``, ``place``, ``direction``, ``swapped``, ``world``,
    # ``constant``, ``copied``, ``range``, ``contradiction``, ``course``, ``clock``, ``uneven``, ``factor``,
    # ``stopped``.
    check: str
    channel: str  # the one to look at
    text: str  # what was measured, what it probably is, and what to do
    measured: float | None = None  # slope, factor or bias
    error: float | None = None  # its standard error from blocks of time


@dataclass(frozen=True)
class Relation:
    """A measured ratio that should be 1."""

    name: str
    powers: Mapping[str, int]  # channel to the power with which its factor enters
    slope: Slope
    tolerance: float  # of the logarithm of the ratio: what right recordings show
    # Takes the factors of v_x and r and returns the ratio that is left after both are corrected, for relations
    # that are no plain product; None where `powers` says it all.
    corrected: Callable[[float, float], float] | None = None
    of_the_world: bool = False  # whether it turns its sign when yaw and the order of X, Y are both turned
    # Whether the channel that only this relation has is beyond doubt: a path of satellite fixes, a compass.
    certain: bool = False

    @property
    def holds(self) -> bool:
        """Whether the ratio is 1 within its tolerance."""
        return self.slope.slope > 0 and abs(np.log(self.slope.slope)) <= self.tolerance

    @property
    def leaf(self) -> str:
        """The channel that enters this relation only."""
        return next(channel for channel in self.powers if channel not in SHARED)

    def without(self, factors: Mapping[str, float]) -> float:
        """Return the ratio that is left when v_x and r are divided by `factors`."""
        if self.corrected is not None:
            return self.corrected(factors.get("vx", 1.0), factors.get("r", 1.0))
        ratio = self.slope.slope
        for channel in SHARED:
            ratio *= factors.get(channel, 1.0) ** -self.powers.get(channel, 0)
        return ratio


@dataclass(frozen=True)
class Plausible:
    """A magnitude that physics bounds: `value` is the product of channels to their `powers`."""

    name: str
    powers: Mapping[str, int]
    # value, high: what it reaches, and what no car reaches, SI.
    value: float
    high: float
    unit: str

    def cost(self, factors: Mapping[str, float]) -> float:
        """Return what it costs that the corrected magnitude is larger than any car's."""
        value = self.value
        for channel, power in self.powers.items():
            value *= abs(factors.get(channel, 1.0)) ** -power
        return _BEYOND_PHYSICS * float(max(np.log(max(value, 1e-12) / self.high), 0.0))


@dataclass(frozen=True)
class Leaf:
    """How one relation is accounted for, given the shared channels: a mistake, nothing, or an unknown factor."""

    relation: Relation
    mistake: Mistake | None
    cost: float
    left: float
    rivals: tuple[Mistake, ...] = ()
    charged: float = 0.0

    @property
    def unknown(self) -> bool:
        return self.mistake is None and self.cost >= UNKNOWN


@dataclass(frozen=True)
class Story:
    """One assignment of mistakes to all channels, with its cost."""

    shared: tuple[Mistake, ...]
    leaves: tuple[Leaf, ...]
    cost: float
    axes: str = ""
    """``world`` where the whole pose has the other hand, ``car`` where all of the car has; else empty."""

    @property
    def mirrored(self) -> frozenset[str]:
        """Channels that one turned set of axes accounts for."""
        if self.axes == "car":
            return frozenset({"r", *(leaf.relation.leaf for leaf in self.leaves if leaf.relation.leaf in OF_THE_BODY)})
        return frozenset({"yaw", "hand"} if self.axes else ())

    @property
    def mistakes(self) -> tuple[Mistake, ...]:
        return (*self.shared, *(leaf.mistake for leaf in self.leaves if leaf.mistake is not None))

    @property
    def blamed(self) -> frozenset[tuple[str, str]]:
        unknown = ((leaf.relation.leaf, "unknown") for leaf in self.leaves if leaf.unknown)
        return frozenset([*((m.channel, m.what) for m in self.mistakes), *unknown])
