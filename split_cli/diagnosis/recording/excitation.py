"""Excitation: how much a recording turns, changes its speed and varies its torque."""

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.policy import STANDARD, Screening
from split_cli.logs.drive import Drive
from split_cli.vehicle.parameters import Vehicle

_STEP_SECONDS = 0.5  # over which a change of speed is taken
_OUTER_SHARE = 0.02  # of samples at each end that a range leaves out


def largest_lateral_acceleration(drive: Drive) -> float:
    """Return the lateral acceleration |v_x r| that one sample in a hundred exceeds [m/s^2]."""
    return float(np.quantile(np.abs(drive["vx"] * drive["r"]), 1.0 - 0.5 * _OUTER_SHARE))


def torque_is_constant(torque: np.ndarray, vehicle: Vehicle, rules: Screening = STANDARD.screening) -> bool:
    """Return whether the torque [N m], shape (N,), varies by less than a twentieth of the car's largest torque."""
    return _range(torque) < rules.least_torque * vehicle.max_torque


def turns(drive: Drive, rules: Screening = STANDARD.screening) -> bool:
    """Return whether the car turns: the range of its lateral acceleration v_x r exceeds the policy's least one."""
    return _range(drive["vx"] * drive["r"]) > rules.least_acceleration


def changes_speed(drive: Drive, rules: Screening = STANDARD.screening) -> bool:
    """Return whether the car gains and loses speed by more than a coasting car does."""
    every = max(1, round(_STEP_SECONDS / drive.period))
    steps = [np.diff(drive["vx"][run][::every]) / _STEP_SECONDS for run in drive.segments()]
    return _range(np.concatenate(steps), 0.05) > rules.least_surge


def idle(real: Sequence[Drive], vehicle: Vehicle, rules: Screening = STANDARD.screening) -> list[str]:
    """Return why the real drives excite nothing, as sentences; empty if they excite something.

    A torque that was derived from acceleration excites nothing longitudinal: it contains whatever acts there.
    """
    derived = any(drive.metadata.torque_follows_motion for drive in real)
    for drive in real:
        steady = _range(drive["vx"]) < rules.still_share * np.mean(drive["vx"])
        along = not (derived or (steady and torque_is_constant(drive["T"], vehicle, rules)))
        if along or largest_lateral_acceleration(drive) > rules.least_acceleration:
            return []
    if derived:
        most = max(map(largest_lateral_acceleration, real))
        return [
            f"The real drive hardly turns ({most:.2g} m/s^2 across the car; {rules.least_acceleration:g} are "
            "needed), and its torque is derived from how it moved, so that nothing along the car shows either. A "
            "slalom would show the steering and the tyres, a logged torque command the drive."
        ]
    return [
        "The real drive is straight at constant speed and torque. A slalom would show the steering and the tyres, "
        "torque steps the drive, a coast-down drag and resistance."
    ]


def _range(values: np.ndarray, left_out: float = _OUTER_SHARE) -> float:
    """Return the range of values without a share at each end."""
    return float(np.ptp(np.quantile(values, [left_out, 1.0 - left_out])))
