"""Screening: what a recording lacks (duration, speed, excitation, live channels), before anything else is done."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from split_cli.diagnosis.policy import STANDARD, Screening
from split_cli.logs.checking.jumps import in_jumps
from split_cli.logs.drive import Drive
from split_cli.signals import REQUIRED_CHANNELS
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.search import Course
from split_cli.vehicle.parameters import Vehicle

SMOOTHED_SECONDS = 0.2  # over which samples are averaged before they are compared
_STEP_SECONDS = 0.5  # over which a change of speed is taken
_OUTER_SHARE = 0.02  # of samples at each end that a range leaves out
# A velocity that stands still contradicts what it always moves with.
_MOVES_WITH = {"vx": ("vy", "r"), "vy": ("r",), "r": ("vy",), "delta": ("r",)}


def cleaned(
    drive: Drive, rules: Screening = STANDARD.screening, vehicle: Vehicle | None = None
) -> tuple[Drive, tuple[str, ...]]:
    """Leave out of a drive what is no recording, and say so.

    Returns
    -------
    Drive
        Without rows that are not finite, stretches in which a channel stands still while the car does not, and
        jumps of the speed that no tyre of the vehicle makes; with a new segment wherever the clock jumps; without
        position where it is not known throughout.
    tuple of str
        What was left out.
    """
    notes = []
    finite = np.all([np.isfinite(drive[name]) for name in ("t", *REQUIRED_CHANNELS)], axis=0)
    if not finite.all():
        bad = [name for name in ("t", *REQUIRED_CHANNELS) if not np.isfinite(drive[name]).all()]
        notes.append(f"{drive.name}: {int((~finite).sum())} samples without a number in {', '.join(bad)}")
        drive = drive.select(finite)
    if len(drive) < 2:
        return drive, tuple(notes)
    step = np.diff(drive["t"])
    jumps = (np.abs(step - drive.period) > 0.5 * drive.period) & (np.diff(drive.segment) == 0)
    if jumps.any():
        first = int(np.flatnonzero(jumps)[0])
        notes.append(
            f"{drive.name}: what lies across {int(jumps.sum())} jumps of the clock, the first by "
            f"{step[first]:.3g} s at t = {drive['t'][first]:.2f} s"
        )
        breaks = np.concatenate([[False], jumps | (np.diff(drive.segment) != 0)])
        drive = replace(drive, segment=np.cumsum(breaks).astype(np.int32))
    stuck = {name: _stuck(drive, name, rules) for name in _MOVES_WITH}
    for name, rows in stuck.items():
        # A channel that never moves is no dropout; `unfit` speaks of it.
        if rows.any() and np.ptp(drive[name]) > 0.0:
            where = drive["t"][int(np.argmax(rows))]
            notes.append(
                f"{drive.name}: {rows.sum() * drive.period:.1f} s in which {name} stands still while the car "
                f"turns, from t = {where:.2f} s"
            )
    moving = ~np.any([rows for name, rows in stuck.items() if np.ptp(drive[name]) > 0.0] or [[False]], axis=0)
    if not moving.all():
        drive = drive.select(np.broadcast_to(moving, (len(drive),)))
    jumping = in_jumps(drive, vehicle) if vehicle is not None else np.zeros(len(drive), dtype=bool)
    if jumping.any():
        notes.append(
            f"{drive.name}: {jumping.sum() * drive.period:.1f} s about jumps of the speed that no tyres can make, "
            f"the first at t = {drive['t'][int(np.argmax(jumping))]:.2f} s"
        )
        drive = drive.select(~jumping)
    drive, repaired = _with_sound_position(drive, rules)
    return drive, (*notes, *repaired)


def clean_drives(drives: Sequence[Drive], rules: Screening, vehicle: Vehicle) -> tuple[list[Drive], tuple[str, ...]]:
    """Clean several drives; return them, and what was left out of all of them."""
    pairs = [cleaned(drive, rules, vehicle) for drive in drives]
    return [drive for drive, _ in pairs], tuple(note for _, notes in pairs for note in notes)


def unfit(
    drive: Drive, vehicle: Vehicle, rules: Screening = STANDARD.screening, simulated: Sequence[Drive] = ()
) -> list[str]:
    """Return why a drive cannot be diagnosed at all; empty when it can.

    Parameters
    ----------
    simulated : sequence of Drive
        That the drive is compared with: what these have as well speaks of the vehicle file, not of another car.
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
        and _turns(drive, rules)
        and not _is_held(drive, whole, rules)
    ):
        frozen.append("delta")
    if np.ptp(drive["T"]) == 0.0 and "vx" not in frozen and _changes_speed(drive, rules):
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
    return _of_another_car(drive, vehicle, rules, [_ratios(one, vehicle, rules) for one in simulated])


def moving(drive: Drive, vehicle: Vehicle, rules: Screening = STANDARD.screening) -> Drive:
    """Return a drive without its crawling and standing: slip is not defined there, and nothing of it is compared.

    Runs too short for a smoothing window go with it. A drive without such rows is returned as it is.
    """
    rows = drive["vx"] >= rules.crawl * vehicle.minimum_speed
    if rows.all():
        return drive
    left = drive.select(rows)
    long = [run for run in left.segments() if (run.stop - run.start) * drive.period > rules.shortest_run]
    kept = np.zeros(len(left), dtype=bool)
    for run in long:
        kept[run] = True
    return left.select(kept)


def idle(real: Sequence[Drive], vehicle: Vehicle, rules: Screening = STANDARD.screening) -> list[str]:
    """Return why nothing was excited in the real drives; empty when something was.

    A torque that was derived from how the car moved excites nothing along the car: whatever acts there is in it.
    """
    derived = any(drive.metadata.torque_follows_motion for drive in real)
    for drive in real:
        steady = _range(drive["vx"]) < rules.still_share * np.mean(drive["vx"])
        along = not (derived or (steady and torque_is_constant(drive["T"], vehicle, rules)))
        if along or acceleration_across(drive) > rules.least_acceleration:
            return []
    if derived:
        most = max(map(acceleration_across, real))
        return [
            f"The real drive hardly turns ({most:.2g} m/s^2 across the car; {rules.least_acceleration:g} are "
            "needed), and its torque is derived from how it moved, so that nothing along the car shows either. A "
            "slalom would show the steering and the tyres, a logged torque command the drive."
        ]
    return [
        "The real drive is straight at constant speed and torque. A slalom would show the steering and the tyres, "
        "torque steps the drive, a coast-down drag and resistance."
    ]


def acceleration_across(drive: Drive) -> float:
    """Return the lateral acceleration v_x r that a hundredth of a drive exceeds in size [m/s^2]."""
    return float(np.quantile(np.abs(drive["vx"] * drive["r"]), 1.0 - 0.5 * _OUTER_SHARE))


def measures(drive: Drive, *channels: str) -> bool:
    """Return whether channels were recorded and can contradict others: none was derived from them, nor they."""
    if "ay" in channels and drive.metadata.lateral_velocity_is_integrated:
        return False
    return all(name in drive.columns and not drive.metadata.is_derived(name) for name in channels)


def velocity_is_from_position(drive: Drive) -> bool:
    """Return whether the velocities were differentiated from position and yaw: none is late against the others."""
    known = drive.metadata
    return any(known.is_derived(name) and "X, Y" in known.kinds[name] for name in ("vx", "vy", "r"))


def torque_is_constant(torque: np.ndarray, vehicle: Vehicle, rules: Screening = STANDARD.screening) -> bool:
    """Return whether the torque varies by less than a twentieth of what the car has."""
    return _range(torque) < rules.least_torque * vehicle.max_torque


def _range(values: np.ndarray, left_out: float = _OUTER_SHARE) -> float:
    """Return the range of samples without a share at each end."""
    return float(np.ptp(np.quantile(values, [left_out, 1.0 - left_out])))


def _turns(drive: Drive, rules: Screening) -> bool:
    return _range(drive["vx"] * drive["r"]) > rules.least_acceleration


def _changes_speed(drive: Drive, rules: Screening) -> bool:
    """Return whether the car gains and loses speed as no coasting car does."""
    every = max(1, round(_STEP_SECONDS / drive.period))
    steps = [np.diff(drive["vx"][run][::every]) / _STEP_SECONDS for run in drive.segments()]
    return _range(np.concatenate(steps), 0.05) > rules.least_surge


def _stuck(drive: Drive, name: str, rules: Screening) -> np.ndarray:
    """Return rows of runs in which a channel repeats itself while its companions move, shape (N,)."""
    values, found = drive[name], np.zeros(len(drive), dtype=bool)
    least = int(round((rules.held_seconds if name == "delta" else rules.stuck_seconds) / drive.period))
    for run in drive.segments():
        same = np.flatnonzero(np.diff(values[run]) != 0.0)
        edges = np.concatenate([[0], same + 1, [run.stop - run.start]])
        for begin, end in zip(edges[:-1], edges[1:], strict=True):
            if end - begin < max(least, 5):
                continue
            rows = slice(run.start + int(begin), run.start + int(end))
            # To a steer angle that is held after a step the car first has to answer.
            answer = int(round(rules.answer_seconds / drive.period)) if name == "delta" else 0
            later = slice(rows.start + answer, rows.stop)
            if name == "delta" and _is_held(drive, later, rules):
                continue
            if name == "vx" and _path_is_as_steady(drive, rows, rules):
                continue
            if any(
                np.std(drive[other][later]) > rules.still_share * np.std(drive[other]) > 0.0
                for other in _MOVES_WITH[name]
            ):
                found[rows] = True
    return found


def _is_held(drive: Drive, rows: slice, rules: Screening) -> bool:
    """Return whether a car turns as one whose steering is held on purpose, in steady circles at any speed.

    Notes
    -----
    Its yaw rate has the sign of the steer angle and is a function of speed, delta v_x/(L + K v_x^2) in gentle
    turns; near the limit, a smooth one. With a frozen sensor it goes to both sides, or up and down at one speed.
    Yaw rate and not curvature is compared, since a car that stands or starts has none.
    """
    angle, speed = drive["delta"][rows], np.maximum(drive["vx"][rows], 1e-3)
    if not len(speed) or not angle.any():
        return False
    rate = _quiet(drive, drive["r"])[rows] * np.sign(angle[0])
    scaled = speed / speed.max()
    columns = np.stack([scaled**k for k in range(1, 5)], axis=1)
    left = rate - columns @ np.linalg.lstsq(columns, rate, rcond=None)[0]
    return bool(np.std(left) < rules.turn_spread * np.mean(rate))


def _path_is_as_steady(drive: Drive, rows: slice, rules: Screening) -> bool:
    """Return whether the recorded path grows as evenly as a v_x that repeats itself: a controller holds the speed.

    A simulation of one does so exactly. What the path may vary by is what a companion of a frozen channel may.
    """
    if not drive.has_position or not measures(drive, "vx", "X", "Y"):
        return False
    steps = np.hypot(np.diff(drive["X"][rows]), np.diff(drive["Y"][rows])) / drive.period
    return bool(np.std(steps) <= rules.still_share * np.std(drive["vx"]))


def _with_sound_position(drive: Drive, rules: Screening) -> tuple[Drive, tuple[str, ...]]:
    """Fill short gaps of position and yaw; leave them off where gaps are long, or where they stand still."""
    if not drive.has_position:
        return drive, ()
    names = ("X", "Y", "yaw")
    known = np.all([np.isfinite(drive[name]) for name in names], axis=0)
    columns = dict(drive.columns)
    gaps = np.diff(np.flatnonzero(np.concatenate([[True], known, [True]])))
    still = (np.diff(drive["X"]) == 0.0) & (np.diff(drive["Y"]) == 0.0)
    # Where the car stands, its position does too.
    still &= drive["vx"][1:] * rules.stuck_seconds > 1.0
    standing = np.diff(np.flatnonzero(np.concatenate([[True], ~still, [True]])))
    if (gaps.max() - 1) * drive.period > rules.position_gap_seconds:
        reason = f"it is not known for {(gaps.max() - 1) * drive.period:.1f} s"
    elif (standing.max() - 1) * drive.period > rules.stuck_seconds:
        reason = f"it stands still for {(standing.max() - 1) * drive.period:.1f} s while the car drives"
    else:
        if not known.all():
            for name in names:
                values = np.unwrap(drive[name][known]) if name == "yaw" else drive[name][known]
                columns[name] = np.interp(drive["t"], drive["t"][known], values)
        return replace(drive, columns=columns), ()
    for name in names:
        del columns[name]
    return replace(drive, columns=columns), (f"{drive.name}: position and yaw: {reason}",)


def _of_another_car(
    drive: Drive, vehicle: Vehicle, rules: Screening, others: Sequence[tuple[float | None, float | None]]
) -> list[str]:
    """Return how grossly steering and torque of a recording contradict a vehicle file.

    A file that is off for the simulation as well, whose ratios are `others`, is off by its own. Beside one that
    tells a ratio, it is another car only where no gain of steering or torque that a car can have explains it.
    """
    limits = (
        ("steer_gain", "gain", -1.0, 1.0 / rules.another_steering, rules.another_steering),
        ("drive_gain", "drive_gain", 1.0, 1.0 / rules.another_torque, rules.another_torque),
    )
    reasons, own = [], _ratios(drive, vehicle, rules)
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


def _contradiction(drive: Drive, vehicle: Vehicle, ratio: float, *, steering: bool) -> str:
    """Return in words by how much steering or torque contradicts a vehicle file."""
    if steering:
        sign = " Its sign may be turned." if ratio < 0.0 else ""
        return (
            f"{drive.name} does not fit this vehicle file: in gentle turns it steers {ratio:.2g} times what a "
            f"wheelbase of {vehicle.wheelbase:.2f} m needs.{sign} Is it a recording of this car?"
        )
    return (
        f"{drive.name} does not fit this vehicle file: torque accelerates it {ratio:.2g} times as much as a "
        f"mass of {vehicle.mass:.4g} kg on wheels of {vehicle.wheel_radius:.3g} m would. Is it a recording of "
        "this car?"
    )


def _ratios(drive: Drive, vehicle: Vehicle, rules: Screening) -> tuple[float | None, float | None]:
    """Return the steer angle, and what torque accelerates, over what a vehicle file makes of them [1].

    Notes
    -----
    In gentle turns the steer angle is (L + K v_x^2) r / v_x with K the understeer of mass, axles and cornering
    stiffness (steady-state single track); along the car m R_w (v_x' - v_y r) is the torque, less resistance.
    Resistances of air, tyres and cornering change with speed and slip, so slowly; what torque does within
    `answer_seconds` it does to the mass. Torque that rises so slowly that resistance balances it tells nothing.
    Regressions give the ratio of what was recorded to what the file makes of it.
    """
    v = {name: _quiet(drive, drive[name]) for name in ("vx", "vy", "r", "delta", "T")}
    sound = _inner(drive) & (v["vx"] > vehicle.minimum_speed)
    if sound.sum() < rules.fewest_rows:
        return None, None
    understeer, grip = vehicle.understeer_gradient, vehicle.lateral_grip
    across = np.abs(v["vx"] * v["r"])
    gentle = sound & (across < rules.gentle_to * grip) & (across > rules.gentle_from * grip)
    expected = v["r"] / np.maximum(v["vx"], 1e-3) * (vehicle.wheelbase + understeer * v["vx"] ** 2)
    steering = _ratio(expected[gentle], v["delta"][gentle], rules)
    torque = None
    if not drive.metadata.torque_follows_motion and not torque_is_constant(v["T"][sound], vehicle, rules):
        along = np.gradient(v["vx"], drive.period) - v["vy"] * v["r"]
        made = vehicle.mass * vehicle.wheel_radius * along
        torque = _ratio(_changes(drive, v["T"], rules)[sound], _changes(drive, made, rules)[sound], rules)
    return steering, torque


def _changes(drive: Drive, values: np.ndarray, rules: Screening) -> np.ndarray:
    """Return values less their mean over `answer_seconds` around each sample, shape (N,)."""
    from scipy.ndimage import uniform_filter1d

    out, width = np.array(values, dtype=float), max(3, round(rules.answer_seconds / drive.period))
    for run in drive.segments():
        out[run] -= uniform_filter1d(out[run], width, mode="nearest")
    return out


def _ratio(expected: np.ndarray, found: np.ndarray, rules: Screening) -> float | None:
    """Return the slope of `found` over `expected`; None where too few rows or too loose a relation tell none."""
    if len(expected) < rules.fewest_rows or np.std(expected) == 0.0 or np.std(found) == 0.0:
        return None
    if abs(np.corrcoef(expected, found)[0, 1]) < rules.least_correlation:
        return None
    table = np.stack([expected / np.abs(expected).max(), np.ones_like(expected)], axis=1)
    return float(np.linalg.lstsq(table, found, rcond=None)[0][0] / np.abs(expected).max())


def _width(drive: Drive) -> int:
    return max(3, int(round(SMOOTHED_SECONDS / drive.period)))


def _quiet(drive: Drive, values: np.ndarray) -> np.ndarray:
    from scipy.ndimage import uniform_filter1d

    out = np.array(values, dtype=float)
    for run in drive.segments():
        out[run] = uniform_filter1d(out[run], _width(drive), mode="nearest")
    return out


def _inner(drive: Drive) -> np.ndarray:
    """Return rows away from the ends of segments, shape (N,)."""
    inner, width = np.zeros(len(drive), dtype=bool), _width(drive)
    for run in drive.segments():
        inner[run.start + width : max(run.stop - width, run.start + width)] = True
    return inner
