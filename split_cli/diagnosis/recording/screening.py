"""Screening: why a drive cannot be diagnosed at all (duration, rate, speed, constant channels, another car)."""

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.policy import STANDARD, Screening
from split_cli.diagnosis.recording.cleaning import steering_is_held
from split_cli.diagnosis.recording.excitation import changes_speed, turns
from split_cli.diagnosis.recording.vehicle_match import of_another_car, vehicle_ratios
from split_cli.logs.drive import Drive
from split_cli.vehicle.parameters import Vehicle


def unfit(
    drive: Drive, vehicle: Vehicle, rules: Screening = STANDARD.screening, simulated: Sequence[Drive] = ()
) -> list[str]:
    """Return why a drive cannot be diagnosed at all, as sentences; empty if it can.

    Parameters
    ----------
    simulated : sequence of Drive
        Simulated drives that the drive is compared with, by which `of_another_car` tells a wrong vehicle file from
        another car.
    """
    if drive.metadata.sideslip_is_of_tires:
        return [
            f"{drive.name} has no recorded yaw rate: r and v_y follow from a_y and the rear tyres of the vehicle file, "
            "so a finding would be about this assumption. Record a gyro or a heading."
        ]
    longest = max((run.stop - run.start for run in drive.segments()), default=0)
    seconds = longest * drive.period
    if seconds < rules.least_seconds:
        return [
            f"{drive.name} has {seconds:.1f} s without a gap at most; {rules.least_seconds:.0f} s are needed, a "
            "minute is better."
        ]
    if drive.period > rules.longest_period:
        return [f"{drive.name} has {drive.rate:.3g} samples a second; {1 / rules.longest_period:.0f} are needed."]
    frozen = [name for name in ("vx", "vy", "r") if np.ptp(drive[name]) == 0.0]
    whole = slice(0, len(drive))
    if (
        np.ptp(drive["delta"]) == 0.0
        and "r" not in frozen
        and turns(drive, rules)
        and not steering_is_held(drive, whole, rules)
    ):
        frozen.append("delta")
    if np.ptp(drive["T"]) == 0.0 and "vx" not in frozen and changes_speed(drive, rules):
        frozen.append("T")
    if frozen:
        return [
            f"{drive.name}: {', '.join(frozen)} never changes while the car moves, unlike a recorded signal. "
            "Check the signal map that it was ingested with."
        ]
    slowest = rules.valid_speed * vehicle.minimum_speed
    fast = np.mean(drive["vx"] >= slowest)
    if fast < rules.least_fast:
        return [
            f"{drive.name} is slower than {slowest:.1f} m/s for {100.0 * (1 - fast):.0f} % of its time; "
            "slip angles are not reliable there. Drive faster, or check that it is a recording of this vehicle."
        ]
    return of_another_car(drive, vehicle, rules, [vehicle_ratios(one, vehicle, rules) for one in simulated])
