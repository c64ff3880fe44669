"""Lags of torque and steering that training finds beyond the vehicle file, kept if held-out blocks improve by them.

Features of one moment cannot represent a lag; a state of the model can. Without it slip angles and torque stand in
for the lag, differently in each style of driving, and the correction does harm in another style.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from split_cli.learning.training_set import TrainingSet
from split_cli.scoring.evidence import TrainingDrive
from split_cli.scoring.likeliest_lag import likeliest_lag
from split_cli.scoring.torque_lag import fit_torque_lag
from split_cli.scoring.trust import judge_correction
from split_cli.vehicle.parameters import Vehicle

Made = TypeVar("Made")

#: Outputs v_x, v_y, r whose correction stands in for a late input.
_FREED_BY_TORQUE, _FREED_BY_STEERING = np.array([True, False, False]), np.array([False, True, True])

#: What is said of each lag, by its term.
_NOTES = {
    "drive_lag": "torque follows its command {tau:.3f} s late. The set models this lag (drive_lag), since held-out "
    "blocks improve by it; the vehicle file does not change. Where the set corrects v_x by nothing else, errors of "
    "v_y after 0.5 s may be a few per cent larger. `split train --lag none` leaves the lag out",
    "steer_lag": "the steering follows its command {tau:.3f} s late. The set models this lag (steer_lag), since "
    "held-out blocks improve by it; it acts less the farther a state is from what was learned. The vehicle file does "
    "not change. `split train --lag none` leaves the lag out",
}


@dataclass(frozen=True)
class Prepared(Generic[Made]):
    """A set before it learns, and what it will learn from."""

    empty: TrainingSet  # without points; its vehicle is that of the labels
    drives: Sequence[TrainingDrive]  # what its trust is found on
    made: Made  # what else whoever prepared it needs of it later
    needed: int | None = None  # times as much driving as there is that would show a gain; see `driving_needed`


def decide(
    by_file: Prepared[Made],
    relabel: Callable[[Vehicle], Prepared[Made]] | None,
    progress: Callable[[str], None] = lambda text: None,
) -> Prepared[Made]:
    """Find the trust of a set on held-out blocks, and with it which lags enter the set's model.

    Parameters
    ----------
    by_file : Prepared
        With the vehicle file as it is.
    relabel : callable or None
        Prepares the same for another vehicle; None where no lag is looked for.
    progress : callable
        Called with a line of text at each step.

    Returns
    -------
    Prepared
        The set has its trust, and of the torque's lag and the steering's those with which held-out blocks gain more.
    """
    trust, gain, needed = judge_correction(by_file.drives, by_file.empty, progress=progress)
    chosen = replace(by_file, empty=replace(by_file.empty, trust=trust), needed=needed)
    if relabel is None or trust.origin == "unjudged":
        return chosen
    progress("looking for a torque that arrives late")
    late = fit_torque_lag(chosen.drives, chosen.empty.vehicle)
    # The lag frees the correction of v_x from what it stood in for. Those of v_y and r are what they were, so the
    # more cautious of two judgements of them counts.
    chosen, gain = _with_lag(chosen, gain, late, relabel, _FREED_BY_TORQUE, progress)
    progress("looking for a steering that arrives late")
    late = likeliest_lag(chosen.drives, chosen.empty, "delta")
    chosen, gain = _with_lag(chosen, gain, late, relabel, _FREED_BY_STEERING, progress)
    if [effect.term for effect in chosen.empty.found] == ["steer_lag"]:
        # Without the torque's the steering's makes v_y worse (decision 0032), and labels alone may have hidden it.
        late = likeliest_lag(chosen.drives, chosen.empty, "T")
        chosen, gain = _with_lag(chosen, gain, late, relabel, _FREED_BY_TORQUE, progress)
    return chosen


def _with_lag(
    before: Prepared[Made],
    gain: float,
    late: Vehicle | None,
    relabel: Callable[[Vehicle], Prepared[Made]],
    freed: np.ndarray,
    progress: Callable[[str], None],
) -> tuple[Prepared[Made], float]:
    """Return what was prepared with the lag of a vehicle where held-out blocks gain more, else as before; its gain.

    Parameters
    ----------
    late : Vehicle or None
        With one effect more than that of `before`; None leaves it.
    freed : ndarray of bool, shape (3,)
        Outputs whose correction the lag frees of what it stood in for. Trust of the others is at most what it was.
    """
    if late is None:
        return before, gain
    other = relabel(late)
    empty = replace(other.empty, found_effects=before.empty.found_effects + 1)
    # Where no gain was found at all, there is no judgement that could bound: errors of one output hide what the
    # others gain, and 0 for these would forbid the lag as well.
    most = np.where(freed, 1.0, before.empty.trust.share) if gain > 0.0 else np.ones(3)
    trust, other_gain, needed = judge_correction(other.drives, empty, progress=progress, most=tuple(most.tolist()))
    if not other_gain > gain:
        return before, gain
    return replace(other, empty=replace(empty, trust=trust), needed=needed), other_gain


def lag_notes(training_set: TrainingSet) -> tuple[str, ...]:
    """Return the notes of a training on the lags that it found, in the order in which they were found."""
    found = training_set.found
    return tuple(_NOTES[one.term].format(tau=one.parameters["tau"]) for one in found if one.term in _NOTES)
