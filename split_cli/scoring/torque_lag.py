"""First-order lag of the torque, estimated from training labels."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from split_cli.learning.labels import nominal_errors
from split_cli.scoring.evidence import TrainingDrive
from split_cli.scoring.late_inputs import torque_delay
from split_cli.vehicle.parameters import EffectSpec, Vehicle
from split_cli.vehicle.single_track import SingleTrack

#: Labels that the time constant is fitted to, spread over the drives [1]; judgement: with the 4,000 of two laps
#: the first-order estimate has an error of 0.3 ms, and that falls with their root.
_MOST_LABELS = 20_000
#: Multiples of the first-order delay within which the time constant is looked for [1], and how finely [1];
#: judgement: the two are of one size, since a lag delays a ramp by its time constant.
_RANGE = (0.25, 4.0)
_ACCURACY = 0.01
#: Effects of a vehicle file that make an input late, or a sensor: a file that has one is not corrected further.
_LATE = {
    "T": ("drive_lag", "drive_delay", "sensor_delay"),
    "delta": ("steer_lag", "steer_delay", "tire_relaxation", "sensor_delay"),
}


def may_show_a_lag(drives: Sequence[TrainingDrive], vehicle: Vehicle, channel: str = "T") -> bool:
    """Return whether labels can show a lag between the command of an input, ``T`` or ``delta``, and what arrives.

    Only a command can: a torque that was measured, or derived from an acceleration, includes the lag already, and
    so does a steer angle. A torque derived in another way, from a throttle by a motor's map say, may be either. A
    drive without metadata of the channel is taken for one with a command.
    """
    known = [part.drive.metadata for part in drives]
    arrived = any(one.is_derived(channel) or "measured" in one.kinds.get(channel, "") for one in known)
    return not arrived and not any(effect.term in _LATE[channel] for effect in vehicle.effects)


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
    Whether the lag is used is not decided here but on held-out blocks, against the file without it
    (`found_lags.decide`).
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
