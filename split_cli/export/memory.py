"""States of an exported model beyond the first eight: those of its terms, and past commands on their way."""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from split_cli.errors import ExportError
from split_cli.vehicle.single_track import SingleTrack

Part = TypeVar("Part")

COMMANDS = ("T", "delta")
_LONGEST_LINE = 200
_FASTEST = 200.0  # products of rate and step that a series in the step's length still follows
_TOP_SPEED = 100.0
_USUAL_SPEEDS = 8.0  # times the minimum: as fast as exports are compared with Python


@dataclass(frozen=True)
class Memory:
    """States that follow the first eight, in this order: those of the terms, past torques, past steer angles."""

    # names, units: states of the terms, ``id.state``, and their units.
    names: tuple[str, ...]
    units: tuple[str, ...]
    plays: tuple[int, ...]  # which of them are a play
    delays: tuple[float, float]  # of torque and steer angle [s]
    # Past commands kept of each: T(t - step) ... T(t - length step).
    lengths: tuple[int, int]
    step: float  # spacing of past commands [s], and the only interval of the discrete step where there are any
    rates: tuple[float, float]  # (c, k): no state of a term reacts faster than c + k v_x [1/s]

    @property
    def states(self) -> int:
        """Number of the terms' states, S."""
        return len(self.names)

    @property
    def line(self) -> int:
        """Number of past commands."""
        return sum(self.lengths)

    @property
    def continuous(self) -> int:
        """Size of the state of the right-hand side, 8 + S."""
        return 8 + self.states

    @property
    def whole(self) -> int:
        """Size of the state of the discrete step."""
        return self.continuous + self.line

    @property
    def labels(self) -> tuple[str, ...]:
        """What each entry beyond the first eight is."""
        states = [f"{name} [{unit}]" for name, unit in zip(self.names, self.units, strict=True)]
        past = [
            f"{command} of {k} step{'s'[: k > 1]} ago [{unit}]"
            for command, unit, length in zip(COMMANDS, ("N m", "rad"), self.lengths, strict=True)
            for k in range(1, length + 1)
        ]
        return (*states, *past)

    def to_mapping(self) -> dict[str, Any]:
        """Return what manifests and documents say of it."""
        return {
            "states": list(self.labels),
            "continuous_states": self.continuous,
            "delays": dict(zip(COMMANDS, self.delays, strict=True)),
            "step": self.step if self.line else None,
        }

    def weights(self, command: int) -> np.ndarray:
        """Return the shares of command, command a step ago, ... in what arrives, shape (length + 1,).

        Linear between neighbours, as recorded inputs are delayed.
        """
        steps = np.arange(self.lengths[command] + 1)
        share: np.ndarray = np.maximum(0.0, 1.0 - np.abs(self.delays[command] / self.step - steps))
        return share


def nothing_kept(step: float) -> Memory:
    """Return the memory of a model that remembers nothing, with which it is stepped as any other."""
    return Memory((), (), (), (0.0, 0.0), (0, 0), step, (0.0, 0.0))


def present(part: Part | None) -> Part:
    """Return an optional part of an exported model or of its check, where the caller knows that there is one."""
    if part is None:
        raise ValueError("a part of the exported model is missing")
    return part


def exported_model(model: SingleTrack) -> SingleTrack:
    """Return a model without the terms of its sensors, which correct recordings and are no part of the car."""
    kept = [term for term in model.terms if getattr(term, "exported", True)]
    return SingleTrack(model.vehicle, kept)


def memory_of(model: SingleTrack, plays: tuple[int, ...], step: float) -> Memory | None:
    """Return what a model remembers, None where it has neither states nor delays.

    Parameters
    ----------
    model : SingleTrack
        As exported.
    plays : tuple of int
        Which of its states are a play.
    step : float
        Of the discrete step [s].

    Raises
    ------
    ExportError
        If a term with memory is named twice, reacts too fast for the step, looks ahead, or is later than any
        reasonable line of past commands.
    """
    where = f"vehicle {model.vehicle.name}, effects"
    delays = dict.fromkeys(COMMANDS, 0.0)
    remembering = [t for t in model.terms if getattr(t, "state_names", ()) or getattr(t, "input_delays", {})]
    for term in remembering:
        if sum(other.id == term.id for other in remembering) > 1:
            raise ExportError(f"{term.id} is named twice", where=where, advice="Name each term with memory once.")
        for channel, delay in getattr(term, "input_delays", {}).items():
            delays[channel] += float(delay)
    late = (delays["T"], delays["delta"])
    if not model.state_names and not any(late):
        return None
    # What is an exact number of steps but for rounding needs no further one.
    torque_line, steer_line = (int(np.ceil(delay / step - 1e-9)) for delay in late)
    lengths = (torque_line, steer_line)
    if max(lengths) > _LONGEST_LINE:
        what = f"a delay of {max(late):g} s takes {max(lengths)} past commands at a step of {step:g} s"
        raise ExportError(what, where=where, advice="Export for a longer --step.")
    units = tuple(
        getattr(term, "state_units", {}).get(name.rpartition(".")[2], "?")
        for term in model.terms
        for name in getattr(term, "state_names", ())
    )
    return Memory(model.state_names, units, plays, late, lengths, step, _rates(model, step, where))


def _rates(model: SingleTrack, step: float, where: str) -> tuple[float, float]:
    """Return c and k of the fastest reaction, c + k v_x."""
    standing, moving = 0.0, 0.0
    for term in model.terms:
        if not getattr(term, "state_names", ()):
            continue
        slow, fast = term.fastest_rate(0.0), term.fastest_rate(_TOP_SPEED)
        usual = term.fastest_rate(_USUAL_SPEEDS * model.vehicle.minimum_speed)
        # What no step resolves is reported before the controller finds not-a-number.
        if usual * step > _FASTEST:
            what = f"{term.id} reacts within {1.0 / usual:.2g} s, too fast for a step of {step:g} s"
            advice = "Leave out a lag or a relaxation this short, or export for a shorter --step."
            raise ExportError(what, where=where, advice=advice)
        standing, moving = max(standing, slow), max(moving, (fast - slow) / _TOP_SPEED)
    return standing, moving
