"""Data that pass through the stages of the single track: everything that a term may read or change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from split_cli.vehicle.operations import Operations
from split_cli.vehicle.parameters import Vehicle

__all__ = ["AxleFlow", "Flow", "FlowTerm"]


@dataclass
class AxleFlow:
    """One axle while the derivative is evaluated: B [1/rad], C [1], D [N], slip angle [rad], forces [N]."""

    B: Any
    C: Any
    D: Any
    slip_angle: Any = 0.0
    longitudinal_force: Any = 0.0
    lateral_force: Any = 0.0


@dataclass
class Flow:
    """Everything a term may read or alter while the derivative is evaluated, in SI units and CG frame.

    Attributes
    ----------
    vx, vy, r : array or symbol
        Velocities at the CG [m/s], [m/s], [rad/s].
    T, delta : array or symbol
        Torque [N m] and road-wheel angle [rad], as commanded until the stage `actuate` has passed.
    yaw, t, s : array or symbol
        Yaw angle [rad], time [s], track position [m]; 0 where the caller has none.
    mass, yaw_inertia, l_f, l_r : array or symbol
    sine, cosine : array or symbol
        Of `delta` once `actuate` has passed.
    force_x, force_y, moment : array or symbol
        External forces [N] and moment [N m] at the CG.
    states : mapping of str to array, or None
        Values of the terms' states; None means steady, each state at what it would settle at.
    recording : Recording or None
        Given when the arrays are a whole recording: then states and delays are solved along it, from steady at
        each segment's start.
    rates, values : dict
        What the terms' states change by, each per second, and what they are; filled by the terms.
    pulled : dict
        Of states that are a play: where the source of this moment drags them at once, without the closing rate.
    """

    ops: Operations
    vehicle: Vehicle
    vx: Any
    vy: Any
    r: Any
    T: Any
    delta: Any
    yaw: Any
    t: Any
    s: Any
    mass: Any
    yaw_inertia: Any
    l_f: Any
    l_r: Any
    front: AxleFlow
    rear: AxleFlow
    sine: Any = 0.0
    cosine: Any = 1.0
    force_x: Any = 0.0
    force_y: Any = 0.0
    moment: Any = 0.0
    states: Mapping[str, Any] | None = None
    recording: Any = None
    rates: dict[str, Any] = field(default_factory=dict)
    values: dict[str, Any] = field(default_factory=dict)
    pulled: dict[str, Any] = field(default_factory=dict)


class FlowTerm(Protocol):
    """A named term: it overrides the stages at which its physics acts; each alters the flow in place."""

    @property
    def id(self) -> str: ...
    @property
    def order(self) -> int: ...
    @property
    def parameters(self) -> Mapping[str, float]: ...
    @property
    def state_names(self) -> tuple[str, ...]: ...

    def fastest_rate(self, speed: float) -> float: ...
    def delayed(self, flow: Flow, source: Any, delay: float) -> Any: ...
    def actuate(self, flow: Flow) -> None: ...
    def body(self, flow: Flow) -> None: ...
    def tire(self, flow: Flow) -> None: ...
    def lateral(self, flow: Flow) -> None: ...
    def external(self, flow: Flow) -> None: ...
