"""Base class of the named terms: stages, states, parameters, how it corrects a recording, and which terms mimic it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from split_cli.vehicle.effects.recording import (
    Recording,
    first_order_from_means,
    first_order_response,
    play_response,
    shifted,
)
from split_cli.vehicle.effects.search import Course, Search
from split_cli.vehicle.effects.wording import Estimates, amount
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Mimic", "Term"]

# Backlash as a differential equation closes onto the edge of its play this fast; the exact operator is the limit.
_PLAY_RATE = 200.0


@dataclass(frozen=True)
class Mimic:
    """Another explanation that looks alike.

    Attributes
    ----------
    terms : str
        Ids; a combination is written ``a+b``.
    when : str
        In which recordings the two cannot, or can hardly, be told apart.
    separated_by : str
        The excitation or the channel that tells them apart; empty when nothing in a drive can.
    exact : bool
        Whether the same right-hand side can be reached with the other's parameters.
    variants : tuple of str
        Variants of the term of which this is true; empty for all.
    without : tuple of str
        Measured channels of which the two look alike in any recording that lacks one; empty where other conditions
        have to hold as well.
    """

    terms: str
    when: str
    separated_by: str = ""
    exact: bool = False
    variants: tuple[str, ...] = ()
    without: tuple[str, ...] = ()

    def holds(self, variant: str) -> bool:
        """Return whether a variant of the term is mimicked."""
        return not self.variants or variant in self.variants


class Term:
    """A small physical model added to the nominal single track.

    A term overrides the stages at which its physics acts. Its right-hand side is stated once: states and delays
    go through `first_order`, `play` and `delayed`, which know whether a continuous model, a symbolic export or a
    whole recording is being evaluated.

    Attributes
    ----------
    id : str
        Name in the catalogue.
    variants : tuple of str
        Alternatives where physics allows several; the first, usually empty, is the default.
    parameter_units : mapping of str to mapping of str to str
        For a variant, parameter names and units; variants that are not named share those of the default.
    order : int
        Place within a stage: lower acts first (steering: delay, gain, backlash, lag, offset).
    states : tuple of str
        States the term appends to the model.
    state_units : mapping of str to str
        Their units.
    neutral : mapping of str to float
        Values at which the term vanishes; parameters it does not name are free at that point.
    constants : frozenset of str
        Parameters that say how the effect acts, and not how large it is. They have no neutral value.
    exported : bool
        Whether the term is part of the car (sensor terms are not).
    through_tires : bool
        Whether its parameters are known only as well as one curve says what an axle's tyres do.
    states_peak : bool
        Whether its parameters say which peak force the tyres reach, so that a vehicle file that has it no longer
        assumes one.
    loads_tires : bool
        Whether its variants are laws of how a tyre carries another load; a real one lies between them.
    scales_curve : bool
        Whether it scales the curve of tyres. Two such terms may nearly cancel, and what they get wrong is a share of
        what they do together.
    form_error : float
        Model-form error over the size of the effect [1], where more is known to be wrong of it than of any term, as
        where constants are assumed that a vehicle file has not.
    in_every_car : bool
        Whether no real car is without it, while the plain single track is: physics that it leaves out, and what
        load that moves sideways makes of an axle's tyres. It is no surprise where no simulation has it in common.
    family : str
        Kind of physics, by which the manoeuvre is chosen that tells two terms apart: ``tires``, ``body``,
        ``along`` (forces along the car), ``steering``, ``place``, ``time``, ``air``, ``measurement``, ``clock``.
    needs : frozenset of str
        What a recording has to have, to show the term: ``position`` (with yaw), ``measured position``
        (not derived from velocities), ``measured velocities`` (not derived from position), ``derived velocities``
        (from position), ``torque`` (logged, not derived from how the car moved), ``known torque`` (not from pedals by
        an assumed map), ``torque changes``,
        ``lateral velocity`` (not integrated from a_y), ``hard turns`` (beyond the nearly linear part of the tyres'
        curves), ``ax`` or ``ay`` (measured), ``witness`` (measured position or acceleration to the left),
        ``scale witness`` (measured position, or acceleration to the left in simulation and reality),
        ``simulation`` (a recording of it).
    variant_needs : mapping of str to frozenset of str
        What a variant needs beside that.
    moves_samples : bool
        Whether a correction moves a channel in time: then the signal is moved and its noise stays.
    shows_late : bool
        Whether it acts in transients alone, though it has neither states nor delays.
    moves_car : bool
        Whether it changes the motion; a term that only remembers serves as features.
    on_command_clock : bool
        Whether a fault of the measurement is taken into account by taking commands later, not by `correct`.
    titles : mapping of str to str
        By variant, what a headline calls it, the part of the car first: ``Steering late``. A variant that is not
        named is called as the default, a term without any by its own name.
    variant_words : mapping of str to str
        What a reader calls a variant, behind the term's name and a comma: ``on one stretch``.
    factors : mapping of str to (str, str, str)
        Of a parameter that is a factor, or of ``variant/parameter``: the part of the car, and the words for above
        and below 1: ``Brakes``, ``strong``, ``weak``.
    discrepancy : tuple of (str, str, float)
        Variant, parameter and step from neutral, in units of `sizes`: what a single track typically lacks of any
        real car by this term. Simulation and reality may share it; the step is its prior standard deviation.

    Parameters
    ----------
    parameters : mapping of str to float
        Values in the units above: what the real car has beyond the plain vehicle.
    """

    id: ClassVar[str]
    units: ClassVar[Mapping[str, str]]
    variants: ClassVar[tuple[str, ...]] = ("",)
    variant_units: ClassVar[Mapping[str, Mapping[str, str]]] = {}
    order: ClassVar[int] = 5
    states: ClassVar[tuple[str, ...]] = ()
    state_units: ClassVar[Mapping[str, str]] = {}
    mimics: ClassVar[tuple[Mimic, ...]] = ()
    neutral: ClassVar[Mapping[str, float]] = {}
    constants: ClassVar[frozenset[str]] = frozenset()
    exported: ClassVar[bool] = True
    through_tires: ClassVar[bool] = False
    states_peak: ClassVar[bool] = False
    loads_tires: ClassVar[bool] = False
    scales_curve: ClassVar[bool] = False
    in_every_car: ClassVar[bool] = False
    form_error: ClassVar[float] = 0.0
    family: ClassVar[str] = "tires"
    needs: ClassVar[frozenset[str]] = frozenset()
    variant_needs: ClassVar[Mapping[str, frozenset[str]]] = {}
    moves_samples: ClassVar[bool] = False
    shows_late: ClassVar[bool] = False
    moves_car: ClassVar[bool] = True
    on_command_clock: ClassVar[bool] = False
    titles: ClassVar[Mapping[str, str]] = {}
    variant_words: ClassVar[Mapping[str, str]] = {}
    factors: ClassVar[Mapping[str, tuple[str, str, str]]] = {}
    discrepancy: ClassVar[tuple[tuple[str, str, float], ...]] = ()

    _last: tuple[Any, Any] | None = None  # array and result of `cached`

    def __init__(self, parameters: Mapping[str, float], variant: str = "") -> None:
        self.parameters: dict[str, float] = dict(parameters)
        self.variant = variant

    def cached(self, array: Any, compute: Callable[[], Any]) -> Any:
        """Return ``compute()``, or its last result if `array`, which nobody alters, is the same object as then.

        A search evaluates a term along one recording again and again while it changes other terms.
        """
        last = self._last
        if last is None or last[0] is not array:
            self._last = last = array, compute()
        return last[1]

    @property
    def moves_position(self) -> bool:
        """Whether a sensor fault changes position and yaw with the velocities, so that they cannot show it."""
        return False

    @classmethod
    def parameter_units(cls, variant: str = "") -> Mapping[str, str]:
        """Return the parameters of a variant and their units."""
        return cls.variant_units.get(variant, cls.units)

    @classmethod
    def laws(cls, variant: str = "") -> tuple[str, ...]:
        """Return the other variants with the same parameters: other laws of the same quantity."""
        own = set(cls.parameter_units(variant))
        return tuple(one for one in cls.variants if one != variant and set(cls.parameter_units(one)) == own)

    @classmethod
    def sizes(cls, vehicle: Vehicle) -> Mapping[str, float]:
        """Return by parameter the unit that `search` counts in, in units of the file; 1 for one that is not named."""
        return {}

    @classmethod
    def search(cls, vehicle: Vehicle, course: Course, variant: str = "") -> Search | None:
        """Return bounds and start values of a variant's parameters for a diagnosis, in units of `sizes`.

        Parameters
        ----------
        course : Course
            Duration and length of the real recordings.

        Returns
        -------
        Search or None
            None where the term makes no sense for the vehicle, or is never claimed.
        """
        return None

    @classmethod
    def limits(cls, vehicle: Vehicle) -> dict[str, tuple[float, float]]:
        """Return the bounds (lower, upper) that a vehicle file must keep, by parameter, in units of the file.

        They are the widened bounds of the search (`Range.widened`), the widest of all variants and of all drives of at
        least 1 s and 1 m.
        """
        limits: dict[str, tuple[float, float]] = {}
        courses = (Course(1.0, 1.0), Course(np.inf, np.inf))
        searches = [cls.search(vehicle, course, variant) for variant in cls.variants for course in courses]
        for search in (one.times(cls.sizes(vehicle)) for one in searches if one is not None):
            for name, found in search.ranges.items():
                wide = found.widened(cls.neutral[name]) if name in cls.neutral else found
                low, high = limits.get(name, (np.inf, -np.inf))
                limits[name] = min(low, wide.lower), max(high, wide.upper)
        return limits

    @classmethod
    def everywhere(cls, variant: str) -> tuple[Term, float]:
        """Return a located term extended over the whole road, and the distance of its size from no effect."""
        raise NotImplementedError(f"{cls.id} has no place")

    @classmethod
    def statement(cls, p: Estimates, variant: str = "") -> str:
        """Return in words what estimated parameters mean for car or measurement, without subject or full stop."""
        shown = ", ".join(f"{name} {amount(one)}" for name, one in p.items())
        return f"{cls.id.replace('_', ' ')} is there: {shown}"

    @classmethod
    def example(cls, p: Estimates, vehicle: Vehicle) -> str:
        """Return in words what estimated parameters mean in forces [N] of a vehicle, to add to `statement`."""
        return ""

    @classmethod
    def acts_late(cls) -> bool:
        """Return whether the term shows in transients: by states, delays, or because it resists them."""
        return bool(cls.states) or "delay" in cls.units or cls.shows_late

    @classmethod
    def acts_on_commands(cls) -> bool:
        """Return whether the term changes torque or steer angle on their way to the car."""
        return cls.actuate is not Term.actuate

    @property
    def corrects(self) -> bool:
        """Whether the term is taken into account by correcting the recorded channels."""
        return not self.exported and not self.on_command_clock

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states in the model's list, ``id.state``."""
        return tuple(f"{self.id}.{name}" for name in self.states)

    def fastest_rate(self, speed: float) -> float:
        """Return the largest |eigenvalue| the term's own states add [1/s], for the choice of substeps."""
        return 0.0

    def actuate(self, flow: Flow) -> None:
        """Change T [N m] and delta [rad] from the command to what reaches the wheels."""

    def body(self, flow: Flow) -> None:
        """Change mass, inertia or the CG's place."""

    def tire(self, flow: Flow) -> None:
        """Change B, C, D of an axle; slip angles and longitudinal forces are known."""

    def lateral(self, flow: Flow) -> None:
        """Change the axles' lateral forces once computed."""

    def external(self, flow: Flow) -> None:
        """Add forces and a moment at the CG."""

    def gravity_component(self, s: np.ndarray) -> tuple[Any, Any]:
        """Return the components of gravity that the term adds to a_x and a_y by inclining the car [m/s^2].

        Accelerometers read a_x = v_x' - v_y r + g sin(grade) and a_y = v_y' + v_x r + g sin(bank). The arc length s [m]
        has shape (N,).
        """
        return 0.0, 0.0

    @property
    def inclines_car(self) -> bool:
        """Whether the term inclines the car, so that `gravity_component` is not 0."""
        return type(self).gravity_component is not Term.gravity_component

    def correct(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Return the channels of a recording without the term's sensor fault; unchanged by default."""
        return dict(columns)

    def correct_noise(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Return the noise that smoothing left in channels, shifted in time as `correct` shifts the signal."""
        return dict(columns)

    def corrupt(self, columns: Mapping[str, np.ndarray], recording: Recording) -> dict[str, np.ndarray]:
        """Return true channels with the term's sensor fault: the inverse of `correct`."""
        return dict(columns)

    def first_order(self, flow: Flow, name: str, target: Any, rate: Any) -> Any:
        """Return the state `name` that follows `target`: y' = rate (target - y), from steady state.

        Parameters
        ----------
        name : str
            One of `states`.
        target : array or symbol
            What the state settles at.
        rate : array or symbol
            [1/s]; infinite where the state is its target at once.
        """
        key = f"{self.id}.{name}"
        if isinstance(rate, float) and math.isinf(rate):
            value = target
            if flow.states is not None:
                flow.rates[key] = 0.0 * target
        elif flow.recording is not None:
            # Responding in time and taking means over samples can change places: the response to means, in
            # straight lines from one sample's middle to the next, is the response's mean.
            value = first_order_response(target, rate, flow.recording, key)
            if flow.recording.means:
                flow.values[key] = first_order_from_means(target, rate, flow.recording, key)
                return value
        elif flow.states is None:
            value = target
        else:
            value = flow.states[key]
            flow.rates[key] = rate * (target - value)
        flow.values[key] = value
        return value

    def play(self, flow: Flow, name: str, source: Any, width: Any) -> Any:
        """Return the state `name` that `source` drags along with a total play of `width`."""
        key = f"{self.id}.{name}"
        if flow.recording is not None:
            value = play_response(source, width, flow.recording, key)
            if flow.recording.means:
                # A row's mean has dragged the state only once its sample has begun.
                flow.values[key] = shifted(value, flow.recording.period, flow.recording)
                return value
        elif flow.states is None:
            value = source
        else:
            value = flow.states[key]
            pulled = flow.ops.minimum(flow.ops.maximum(value, source - 0.5 * width), source + 0.5 * width)
            flow.pulled[key] = pulled
            flow.rates[key] = _PLAY_RATE * (pulled - value)
        flow.values[key] = value
        return value

    def delayed(self, flow: Flow, source: Any, delay: float) -> Any:
        """Return `source` as it was `delay` [s] before: an exact shift along a recording.

        Outside a recording the model has no past: the caller passes inputs that are already late
        (`recorded_inputs`).
        """
        return source if flow.recording is None else shifted(source, delay, flow.recording)
