"""Data that pass through the stages of the single track: everything that a term may read or change."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from split_cli.vehicle.operations import Operations
from split_cli.vehicle.parameters import Vehicle


@dataclass
class AxleFlow:
    """One axle while the derivative is evaluated: B [1/rad], C [1], D [N], slip angle [rad], forces [N].

    `static_load` and `moved_load` [1] are shares of the static load in the vehicle file: what the mass and its place
    make of that load, and what accelerations and air add to it.
    """

    B: Any
    C: Any
    D: Any
    slip_angle: Any = 0.0
    longitudinal_force: Any = 0.0
    lateral_force: Any = 0.0
    static_load: Any = 1.0
    moved_load: Any = 0.0


@dataclass
class Flow:
    """Everything a term may read or alter while the derivative is evaluated, in SI units and CG frame."""

    ops: Operations
    vehicle: Vehicle
    # vx, vy, r: velocities at the CG [m/s], [m/s], [rad/s].
    vx: Any
    vy: Any
    r: Any
    # T, delta: torque [N m] and road-wheel angle [rad], as commanded until the stage `actuate` has passed.
    T: Any
    delta: Any
    # yaw, t, s: yaw angle [rad], time [s], track position [m]; 0 where the caller has none.
    yaw: Any
    t: Any
    s: Any
    mass: Any
    yaw_inertia: Any
    l_f: Any
    l_r: Any
    front: AxleFlow
    rear: AxleFlow
    # J/r_e^2 of what turns with the wheels, which only v_x' accelerates [kg].
    rotating_mass: Any = 0.0
    # sine, cosine: of `delta` once `actuate` has passed.
    sine: Any = 0.0
    cosine: Any = 1.0
    # force_x, force_y, moment: external forces [N] and moment [N m] at the CG.
    force_x: Any = 0.0
    force_y: Any = 0.0
    moment: Any = 0.0
    # Values of the terms' states; None means steady, each state at what it would settle at.
    states: Mapping[str, Any] | None = None
    # Given when the arrays are a whole recording: then states and delays are solved along it, from steady at each
    # segment's start.
    recording: Any = None
    # Share of the prior's variance that a trained set's labels explain here, from 0 to 1; 1 where there is no set.
    knowledge: Any = 1.0
    # rates, values: what the terms' states change by, each per second, and what they are; filled by the terms.
    rates: dict[str, Any] = field(default_factory=dict)
    values: dict[str, Any] = field(default_factory=dict)
    # Of states that are a play: where the source of this moment drags them at once, without the closing rate.
    pulled: dict[str, Any] = field(default_factory=dict)

    def cached(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return ``function(*arguments)``, from the recording's `ResultCache` where it has one."""
        cache = getattr(self.recording, "cache", None)
        return function(*arguments) if cache is None else cache(function, *arguments)


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
