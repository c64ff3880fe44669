"""What a recording cannot tell, said before anything is concluded from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.common import features
from split_cli.diagnosis.evidence import Evidence
from split_cli.logs.drive import Drive
from split_cli.vehicle.parameters import Vehicle

__all__ = ["judgeable", "unfit"]

_LEAST_SECONDS = 8.0


def unfit(drive: Drive, vehicle: Vehicle) -> list[str]:
    """Return why a drive cannot be diagnosed at all; empty when it can."""
    reasons = []
    longest = max((run.stop - run.start for run in drive.segments()), default=0)
    seconds = longest * drive.period
    if seconds < _LEAST_SECONDS:
        reasons.append(
            f"{drive.name} has {seconds:.1f} s without a gap at most; {_LEAST_SECONDS:.0f} s are needed."
        )
        return reasons
    frozen = [name for name in ("vx", "vy", "r") if np.ptp(drive[name]) == 0.0]
    if frozen:
        reasons.append(f"{drive.name}: {', '.join(frozen)} never changes; a recorded signal does.")
    fast = np.mean(drive["vx"] >= 0.6 * vehicle.minimum_speed)
    if fast < 0.2:
        reasons.append(
            f"{drive.name} is slower than {0.6 * vehicle.minimum_speed:.1f} m/s for {1 - fast:.0%} of its time; "
            "slip angles mean little there. Drive faster."
        )
    return reasons


def judgeable(real: Sequence[Evidence], vehicle: Vehicle) -> tuple[str, ...]:
    """Return which kinds of physics the real recordings could not show, and the manoeuvre that would."""
    out = []
    z = np.concatenate([features(one.series, vehicle)[one.at] for one in real])
    torque = z[:, 2] * vehicle.max_torque
    speed = z[:, 3]
    slip = np.quantile(np.abs(z[:, :2]), 0.99, axis=0)
    peak = [1.0 / tire.B for tire in (vehicle.front_tire, vehicle.rear_tire)]
    if np.ptp(np.quantile(speed, [0.02, 0.98])) < 0.15 * np.mean(speed):
        out.append("drag against rolling resistance: the speed hardly changes; coast down from high speed")
    if np.ptp(np.quantile(torque, [0.02, 0.98])) < 0.05 * vehicle.max_torque:
        out.append("drive gain, lag and delay: the torque hardly changes; drive torque steps")
    elif np.quantile(torque, 0.02) > -0.02 * vehicle.max_brake_torque:
        out.append("brake gain: there is no braking; brake hard once")
    if max(slip[0] / peak[0], slip[1] / peak[1]) < 0.25:
        out.append("peak grip: no turn comes near the limit; turn harder")
    if max(slip) < 0.004:
        out.append("everything lateral: there are no turns; drive a slalom")
    for one in real:
        if not one.series.drive.has_position:
            out.append("place, wind and velocity sensor against car: no position and yaw; record them")
            break
    kinds = {name: one.series.drive.metadata.kinds.get(name, "") for one in real for name in ("T", "delta")}
    if kinds.get("delta") == "measured":
        out.append("the steering actuator: the steer angle is a measurement; log the command")
    if kinds.get("T", "").startswith("derived"):
        out.append("everything longitudinal: torque is derived from acceleration; log the torque command")
    return tuple(out)
