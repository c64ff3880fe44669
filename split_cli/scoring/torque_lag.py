"""First-order lag of the torque, estimated from training labels and kept if held-out blocks improve by it.

Features of one moment cannot represent a lag; a state of the model can. Without it slip angles and torque stand in
for the lag, differently in each style of driving, and the correction does harm in another style.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from scipy.optimize import minimize_scalar

from split_cli.learning.labels import nominal_errors
from split_cli.learning.training_set import TrainingSet
from split_cli.scoring.evidence import TrainingDrive
from split_cli.scoring.late_inputs import torque_delay
from split_cli.scoring.trust import judge_correction
from split_cli.vehicle.parameters import EffectSpec, Vehicle
from split_cli.vehicle.single_track import SingleTrack

Made = TypeVar("Made")

#: Labels that the time constant is fitted to, spread over the drives [1]; judgement: with the 4,000 of two laps
#: the first-order estimate has an error of 0.3 ms, and that falls with their root.
_MOST_LABELS = 20_000
#: Multiples of the first-order delay within which the time constant is looked for [1], and how finely [1];
#: judgement: the two are of one size, since a lag delays a ramp by its time constant.
_RANGE = (0.25, 4.0)
_ACCURACY = 0.01
#: Effects of a vehicle file that make a torque late, or a sensor: a file that has one is not corrected further.
_LATE = ("drive_lag", "drive_delay", "sensor_delay")


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
    """Find the trust of a set on held-out blocks, and with it whether a lag of the torque enters the set's model.

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
        One of the two, its set with its trust: that with a lag only if held-out blocks gain more with it.
    """
    trust, gain, needed = judge_correction(by_file.drives, by_file.empty, progress=progress)
    by_file = replace(by_file, empty=replace(by_file.empty, trust=trust), needed=needed)
    if relabel is None or trust.origin == "unjudged":
        return by_file
    progress("looking for a torque that arrives late")
    late = fit_torque_lag(by_file.drives, by_file.empty.vehicle)
    if late is None:
        return by_file
    other = relabel(late)
    empty = replace(other.empty, found_effects=1)
    # The lag frees the correction of v_x from what it stood in for. Those of v_y and r are what they were, so the
    # more cautious of two judgements of them counts. Where the file shows no gain at all, there is one: its errors
    # of v_x hide what the others gain, and 0 for these would forbid the lag as well.
    most = (1.0, *trust.share[1:]) if gain > 0.0 else (1.0, 1.0, 1.0)
    trust, other_gain, needed = judge_correction(other.drives, empty, progress=progress, most=most)
    return replace(other, empty=replace(empty, trust=trust), needed=needed) if other_gain > gain else by_file


def may_show_a_lag(drives: Sequence[TrainingDrive], vehicle: Vehicle) -> bool:
    """Return whether labels can show a lag between command and torque.

    Only a command can: a torque that was measured, or derived from an acceleration, includes the lag already. A
    torque derived in another way, from a throttle by a motor's map say, may be either. A drive without metadata of
    its torque is taken for one with a command.
    """
    known = [part.drive.metadata for part in drives]
    arrived = any(one.is_derived("T") or "measured" in one.kinds.get("T", "") for one in known)
    return not arrived and not any(effect.term in _LATE for effect in vehicle.effects)


def fit_torque_lag(drives: Sequence[TrainingDrive], vehicle: Vehicle) -> Vehicle | None:
    """Return the vehicle with the lag that leaves the smallest labels of v_x, or None where none is clear.

    Parameters
    ----------
    drives : sequence of TrainingDrive
        With labels of `vehicle`.

    Returns
    -------
    Vehicle or None
        With ``drive_lag`` as its last effect; None where the torque is no command, the file has such an effect,
        labels do not go with dT/dt clearly (`torque_delay`), or no time constant leaves smaller labels.

    Notes
    -----
    tau minimises the sum of squares of y_vx over accepted labels, y_vx from the model with tau T' = T_command - T
    along the whole recording. Only the force along the car lags (variant ``along``): labels of v_x show it, and
    v_y and r, which the lagging force would move by its share of the steered axle, stay as the file has them.
    Whether the lag is used is not decided here but on held-out blocks (`decide`), against the file without it.
    """
    if not drives or not may_show_a_lag(drives, vehicle):
        return None
    delay = torque_delay([part.drive for part in drives], [part.labels for part in drives], vehicle)
    if delay is None:
        return None
    stride = max(1, -(-sum(int(part.labels.accepted.sum()) for part in drives) // _MOST_LABELS))

    def squares(tau: float) -> float:
        late = SingleTrack(lagging(vehicle, tau))
        total = 0.0
        for part in drives:
            how, rows = part.labels, part.labels.row[part.labels.accepted][::stride]
            made = nominal_errors(late, part.drive, rows, how.window, plain=how.plain)
            total += float(np.square(made[:, 0]).sum())
        return total

    bounds = (_RANGE[0] * delay, _RANGE[1] * delay)
    best = minimize_scalar(squares, bounds=bounds, method="bounded", options={"xatol": _ACCURACY * delay})
    before = sum(float(np.square(p.labels.y[p.labels.accepted][::stride, 0]).sum()) for p in drives)
    return lagging(vehicle, round(float(best.x), 4)) if best.fun < before else None


def lagging(vehicle: Vehicle, tau: float) -> Vehicle:
    """Return a vehicle whose longitudinal force follows its command with the time constant `tau` [s]."""
    return vehicle.with_effects(EffectSpec("drive_lag", {"tau": tau}, "along"))


def found_lag(training_set: TrainingSet) -> float | None:
    """Return the time constant of the torque that training found beyond the vehicle file [s], None without one."""
    return next((one.parameters["tau"] for one in training_set.found if one.term == "drive_lag"), None)


def lag_note(training_set: TrainingSet) -> str:
    """Return the note of a training on the lag that it found."""
    tau = found_lag(training_set)
    return (
        f"torque follows its command {tau:.3f} s late. The set models this lag (drive_lag), since held-out blocks "
        "improve by it; the vehicle file does not change. Where the set corrects v_x by nothing else, errors of "
        "v_y after 0.5 s may be a few per cent larger. `split train --lag none` leaves the lag out"
    )
