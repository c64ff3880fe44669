"""Identifiability: which effects these recordings can show at all, and which driving would show the others."""

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import features
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.excitation import largest_lateral_acceleration, torque_is_constant
from split_cli.diagnosis.recording.measured import measures, velocity_is_from_position
from split_cli.diagnosis.recording.series import Series
from split_cli.diagnosis.recording.witnesses import late_against_position
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.vehicle.parameters import Vehicle


def what_was_not_excited(
    real: Sequence[Evidence], vehicle: Vehicle, share: float = 1.0, policy: Policy = STANDARD
) -> tuple[str, ...]:
    """Return which kinds of physics the real recordings could not show, and the manoeuvre that would.

    Parameters
    ----------
    share : float
        Compared share of the real recordings [1].
    """
    out = []
    if share < policy.reporting.least_compared:
        out.append(
            f"{100.0 * (1.0 - share):.0f} % of the real drive, at operating points that the simulation lacks; "
            "drive both over the same speeds, torques and turns"
        )
    slipping = 1.0 - np.mean(np.concatenate([one.rolls for one in real]))
    if slipping > policy.reporting.much_slipping:
        out.append(
            f"{100.0 * slipping:.0f} % of the real drive, where the demanded longitudinal force exceeds the "
            "tyres' limit and wheels may spin or lock; drive and brake less hard"
        )
    z = np.concatenate([features(one.series, vehicle)[one.at] for one in real])
    torque = z[:, 2] * vehicle.max_torque
    speed = z[:, 3]
    drives = [one.series.drive for one in real]
    if np.ptp(np.quantile(speed, [0.02, 0.98])) < 0.15 * np.mean(speed):
        out.append("drag against rolling resistance: the speed hardly changes; coast down from high speed")
    if torque_is_constant(torque, vehicle, policy.screening):
        out.append("drive gain, lag and delay: the torque hardly changes; drive torque steps")
    elif np.quantile(torque, 0.02) > -0.02 * vehicle.max_brake_torque:
        out.append("brake gain: there is no braking; brake hard once")
    if max(map(largest_lateral_acceleration, drives)) < policy.screening.least_acceleration:
        out.append("lateral effects: there are no turns; drive a slalom")
    elif not _leaves_linear_range([one.series for one in real], vehicle, policy):
        out.append("peak grip: no turn comes near the limit; turn harder")
    if not all(drive.has_position for drive in drives):
        out.append("effects of place, wind and velocity sensors: position and yaw are missing; record them")
    if any(drive.metadata.kinds.get("delta") == "measured" for drive in drives):
        out.append("the steering actuator: the steer angle is a measurement; log the command")
    if any(drive.metadata.torque_follows_motion for drive in drives):
        out.append("longitudinal effects: torque is derived from acceleration; log the torque command")
    if any(drive.metadata.lateral_velocity_is_integrated for drive in drives):
        out.append(
            "velocity sensors, the bank of the road and slow sideslip: lateral velocity is integrated from a_y; "
            "record it, or position with a heading"
        )
    if any(drive.metadata.torque_is_from_pedals for drive in drives):
        out.append(
            "drive train and pedal map apart: torque comes from throttle, brake or current by an assumed map, "
            "whose errors may look like drive gain, lag, drag or mass; log the torque command"
        )
    if any(drive.period > 0.05 for drive in drives):
        out.append("lags and delays shorter than a sample; record at 50 Hz or more")
    return tuple(out)


def _leaves_linear_range(real: Sequence[Series], vehicle: Vehicle, policy: Policy) -> bool:
    """Return whether one sample in a hundred is beyond the nearly linear part of the tyre curves.

    Either the slip angles on the curves of the vehicle file show it, or the acceleration relative to the file's grip.
    """
    linear = policy.screening.gentle_to
    slip = np.concatenate([features(one, vehicle)[:, :2] for one in real])
    most = np.quantile(np.abs(slip), 0.99, axis=0)
    axles = (vehicle.front_tire, vehicle.rear_tire)
    bent = (tire.C * np.arctan(tire.B * alpha) for tire, alpha in zip(axles, most, strict=True))
    used = [np.sin(min(one, 0.5 * np.pi)) for one in bent]
    grip = sum(tire.D for tire in axles) / vehicle.mass
    return max(*used, max(largest_lateral_acceleration(one.drive) for one in real) / grip) > linear


def identifiable(
    candidates: Sequence[Candidate],
    real: Sequence[Series],
    vehicle: Vehicle,
    policy: Policy = STANDARD,
    simulated: Sequence[Series] = (),
) -> list[Candidate]:
    """Return the candidates that are identifiable from recordings of this kind.

    Each candidate states what it needs, see `Term.needs`. The needs that the recordings lack are collected here:

    - Places need position, since distance travelled is equivalent to time; wind needs position and yaw.
    - Longitudinal effects need a torque that was not derived from the motion, some of them one that changes. A wrong
      map of pedals, as with a slipping clutch, looks like a climbing road.
    - Velocity sensors, and effects that tilt a_y, need a lateral velocity that was not integrated from a_y.
    - Grip that scales the stiffness too needs hard turns; in gentle ones it equals a stiffness.
    - Velocities derived from position have no sensor faults against position, in a simulation too.
    - Scales of speed and yaw rate against a_y need the simulation, since the roll of the body is part of a_y.
    - A lag can be longer than the simulation's only with a simulation.

    Without measured position, sensor faults get larger tolerances, see `Candidate.without_position`.
    """
    lacking = set() if simulated else {"simulation"}
    drives = [one.drive for one in real]
    if not all(drive.has_position for drive in drives):
        lacking.add("position")
    if not all(measures(drive, "X", "Y", "yaw") for drive in drives):
        lacking.add("measured position")
    lacking |= {name for name in ("ax", "ay") if not all(measures(drive, name) for drive in drives)}
    if {"measured position", "ay"} <= lacking:
        lacking.add("witness")
    felt = simulated and all(measures(one.drive, "ay") for one in (*real, *simulated))
    if "measured position" in lacking and not felt:
        lacking.add("scale witness")
    derived = [velocity_is_from_position(one.drive) and not late_against_position(one, policy) for one in real]
    lacking |= {"measured velocities"} if any(derived) else set()
    lacking |= set() if all(derived) and not simulated else {"derived velocities"}
    if any(drive.metadata.lateral_velocity_is_integrated for drive in drives):
        lacking.add("lateral velocity")
    if any(drive.metadata.torque_follows_motion for drive in drives):
        lacking.add("torque")
    if any(drive.metadata.torque_is_from_pedals for drive in drives):
        lacking.add("known torque")
    if torque_is_constant(np.concatenate([drive["T"] for drive in drives]), vehicle, policy.screening):
        lacking.add("torque changes")
    if not _leaves_linear_range(real, vehicle, policy):
        lacking.add("hard turns")
    allowed = [one for one in candidates if not lacking & one.needs]
    if "measured position" in lacking:
        return [one.without_position(beside_simulation=bool(simulated)) for one in allowed]
    return allowed
