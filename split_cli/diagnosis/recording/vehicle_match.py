"""Whether a recording fits a vehicle file: its steering and torque against what the file predicts.

A file of another car gives residuals that look like large effects. So a gross contradiction is refused before anything
is searched for.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from split_cli.diagnosis.policy import Screening
from split_cli.diagnosis.recording.excitation import torque_is_constant
from split_cli.diagnosis.recording.segment_means import away_from_ends, less_slow_part, smoothed
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.search import Course
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import slip_angles
from split_cli.vehicle.tire import is_beyond_peak

_MOST_ROWS = 800
"""Rows between which slopes are taken, evenly spread [1]: judgement, their 320,000 slopes take 20 ms."""


def of_another_car(
    drive: Drive, vehicle: Vehicle, rules: Screening, others: Sequence[tuple[float | None, float | None]]
) -> list[str]:
    """Return by how much steering and torque of a recording contradict a vehicle file, as sentences; empty if little.

    Parameters
    ----------
    others : sequence of (float or None, float or None)
        `vehicle_ratios` of the simulated drives. Where one of them gives a ratio, the recording is compared with the
        simulation instead of the file: a file that is wrong for both is wrong by itself. Then only a ratio counts that
        no gain of steering or torque within a car's range explains.
    """
    limits = (
        ("steer_gain", "gain", -1.0, 1.0 / rules.another_steering, rules.another_steering),
        ("drive_gain", "drive_gain", 1.0, 1.0 / rules.another_torque, rules.another_torque),
    )
    reasons, own = [], vehicle_ratios(drive, vehicle, rules)
    for k, (term, name, power, low, high) in enumerate(limits):
        known = [several[k] for several in others if several[k] is not None and several[k] > 0.0]
        ratio = own[k]
        if ratio is None:
            continue
        if known:
            ratio /= float(np.exp(np.mean(np.log(known))))
            gains = CATALOGUE[term].search(vehicle, Course(0.0, 0.0)).ranges[name]
            low, high = sorted((gains.lower**power, gains.upper**power))
        if low < ratio < high:
            continue
        reasons.append(_contradiction(drive, vehicle, ratio, steering=term == "steer_gain"))
    return reasons


def vehicle_ratios(drive: Drive, vehicle: Vehicle, rules: Screening) -> tuple[float | None, float | None]:
    """Return the ratios of recorded steering and torque effect to what a vehicle file predicts [1].

    Returns
    -------
    steering : float or None
        Recorded over predicted steer angle in gentle turns; None where too few samples or a weak correlation tell
        nothing.
    torque : float or None
        Recorded over predicted longitudinal acceleration by changes of the torque, likewise.

    Notes
    -----
    In gentle turns the predicted steer angle is (L + K v_x^2) r/v_x with the file's understeer gradient K (steady-state
    single track). On ice a turn is no gentle one although it accelerates little: there the front tyres slide. Along the
    car m R_w (v_x' - v_y r) is the torque less resistance. Air, rolling and cornering resistance change slowly, with
    speed and slip. What torque changes within `answer_seconds` accelerates the mass. Torque that changes more slowly
    tells nothing, since resistance may balance it. Ratios are median slopes.
    """
    v = {name: smoothed(drive, drive[name]) for name in ("vx", "vy", "r", "delta", "T")}
    sound = away_from_ends(drive) & (v["vx"] > vehicle.minimum_speed)
    if sound.sum() < rules.fewest_rows:
        return None, None
    understeer, grip = vehicle.understeer_gradient, vehicle.lateral_grip
    across = np.abs(v["vx"] * v["r"])
    gentle = (
        sound & (across < rules.gentle_to * grip) & (across > rules.gentle_from * grip) & ~_front_slides(v, vehicle)
    )
    expected = v["r"] / np.maximum(v["vx"], 1e-3) * (vehicle.wheelbase + understeer * v["vx"] ** 2)
    steering = _ratio(expected[gentle], v["delta"][gentle], rules)
    torque = None
    if not drive.metadata.torque_follows_motion and not torque_is_constant(v["T"][sound], vehicle, rules):
        along = np.gradient(v["vx"], drive.period) - v["vy"] * v["r"]
        made = vehicle.mass * vehicle.wheel_radius * along
        fast = [less_slow_part(drive, one, rules.answer_seconds)[sound] for one in (v["T"], made)]
        torque = _ratio(*fast, rules)
    return steering, torque


def _front_slides(v: Mapping[str, np.ndarray], vehicle: Vehicle) -> np.ndarray:
    """Return where the front slip angle is beyond the peak of the file's tyre curve, bool, shape (N,)."""
    slip, _ = slip_angles(v["vx"], v["vy"], v["r"], v["delta"], vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle)
    return is_beyond_peak(vehicle.front_tire.B, vehicle.front_tire.C, slip)


def _contradiction(drive: Drive, vehicle: Vehicle, ratio: float, *, steering: bool) -> str:
    """Return in words by how much steering or torque contradicts a vehicle file."""
    sign = "" if ratio > 0.0 else " Its sign may be turned." if steering else " The sign of T may be turned."
    if steering:
        return (
            f"{drive.name} does not fit this vehicle file: in gentle turns it steers {ratio:.2g} times what a "
            f"wheelbase of {vehicle.wheelbase:.2f} m needs.{sign} Is it a recording of this car?"
        )
    return (
        f"{drive.name} does not fit this vehicle file: torque accelerates it {ratio:.2g} times as much as a "
        f"mass of {vehicle.mass:.4g} kg on wheels of {vehicle.wheel_radius:.3g} m would.{sign} Is it a recording of "
        "this car?"
    )


def _ratio(expected: np.ndarray, found: np.ndarray, rules: Screening) -> float | None:
    """Return the slope of `found` over `expected`; None where too few rows or too loose a relation tell none.

    Notes
    -----
    The median of the slopes between pairs of rows (Theil, 1950; Sen, 1968): another car contradicts its file in most
    turns, a patch of ice in a few.
    """
    from scipy.stats import theilslopes

    if len(expected) < rules.fewest_rows or np.std(expected) == 0.0 or np.std(found) == 0.0:
        return None
    if abs(np.corrcoef(expected, found)[0, 1]) < rules.least_correlation:
        return None
    rows = np.linspace(0, len(expected) - 1, min(len(expected), _MOST_ROWS)).astype(np.int64)
    return float(theilslopes(found[rows], expected[rows]).slope)
