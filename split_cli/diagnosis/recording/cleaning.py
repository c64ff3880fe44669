"""Cleaning: parts of a drive that are no valid recording are left out, and each is reported.

Left out are samples that are not finite, stretches in which a channel is stuck, jumps of the speed and crawling. A
jump of the clock begins a new segment. A position with long gaps is dropped as a whole.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from split_cli.diagnosis.policy import STANDARD, Screening
from split_cli.diagnosis.recording.measured import measures
from split_cli.diagnosis.recording.segment_means import smoothed
from split_cli.logs.checking.jumps import in_jumps
from split_cli.logs.drive import Drive
from split_cli.signals import REQUIRED_CHANNELS
from split_cli.vehicle.parameters import Vehicle

#: For each channel those that vary while it does: a channel that is constant while they vary is stuck.
_MOVES_WITH = {"vx": ("vy", "r"), "vy": ("r",), "r": ("vy",), "delta": ("r",)}


def clean_drives(drives: Sequence[Drive], rules: Screening, vehicle: Vehicle) -> tuple[list[Drive], tuple[str, ...]]:
    """Clean several drives; return them, and what was left out of all of them, in words."""
    pairs = [cleaned(drive, rules, vehicle) for drive in drives]
    return [drive for drive, _ in pairs], tuple(note for _, notes in pairs for note in notes)


def cleaned(
    drive: Drive, rules: Screening = STANDARD.screening, vehicle: Vehicle | None = None
) -> tuple[Drive, tuple[str, ...]]:
    """Leave out of a drive what is no valid recording.

    Parameters
    ----------
    vehicle : Vehicle, optional
        Without it jumps of the speed are not looked for.

    Returns
    -------
    Drive
        Without rows that are not finite, stretches in which a channel is stuck while the car moves, and jumps of
        the speed that no tyre of the vehicle can cause; with a new segment wherever the clock jumps; without
        position where it is not known throughout.
    tuple of str
        What was left out, in words.
    """
    drive, notes = _finite_rows(drive)
    if len(drive) < 2:
        return drive, tuple(notes)
    for step in (_split_at_clock_jumps, _without_stuck_channels, _without_speed_jumps, _with_sound_position):
        drive, more = step(drive, rules, vehicle)
        notes += more
    return drive, tuple(notes)


def moving(drive: Drive, vehicle: Vehicle, rules: Screening = STANDARD.screening) -> Drive:
    """Return a drive without crawling and standing, where slip angles are not defined and nothing is compared.

    Runs that are shorter than a smoothing window are left out with it. A drive without such rows is returned as is.
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


def _finite_rows(drive: Drive) -> tuple[Drive, list[str]]:
    """Leave out samples at which a required channel is not finite."""
    finite = np.all([np.isfinite(drive[name]) for name in ("t", *REQUIRED_CHANNELS)], axis=0)
    if finite.all():
        return drive, []
    bad = [name for name in ("t", *REQUIRED_CHANNELS) if not np.isfinite(drive[name]).all()]
    note = f"{drive.name}: {int((~finite).sum())} samples without a number in {', '.join(bad)}"
    return drive.select(finite), [note]


def _split_at_clock_jumps(drive: Drive, rules: Screening, vehicle: Vehicle | None) -> tuple[Drive, list[str]]:
    """Begin a new segment wherever the step from one sample to the next differs from the period by more than half."""
    step = np.diff(drive["t"])
    jumps = (np.abs(step - drive.period) > 0.5 * drive.period) & (np.diff(drive.segment) == 0)
    if not jumps.any():
        return drive, []
    first = int(np.flatnonzero(jumps)[0])
    note = (
        f"{drive.name}: what lies across {int(jumps.sum())} jumps of the clock, the first by "
        f"{step[first]:.3g} s at t = {drive['t'][first]:.2f} s"
    )
    breaks = np.concatenate([[False], jumps | (np.diff(drive.segment) != 0)])
    return replace(drive, segment=np.cumsum(breaks).astype(np.int32)), [note]


def _without_stuck_channels(drive: Drive, rules: Screening, vehicle: Vehicle | None) -> tuple[Drive, list[str]]:
    """Leave out stretches in which a channel repeats one value while the car moves.

    A channel that never changes at all has no dropouts: `unfit` reports it.
    """
    stuck = {name: _stuck(drive, name, rules) for name in _MOVES_WITH if np.ptp(drive[name]) > 0.0}
    notes = [
        f"{drive.name}: {rows.sum() * drive.period:.1f} s in which {name} stands still while the car "
        f"turns, from t = {drive['t'][int(np.argmax(rows))]:.2f} s"
        for name, rows in stuck.items()
        if rows.any()
    ]
    return (drive.select(~np.any(list(stuck.values()), axis=0)), notes) if notes else (drive, [])


def _without_speed_jumps(drive: Drive, rules: Screening, vehicle: Vehicle | None) -> tuple[Drive, list[str]]:
    """Leave out samples around changes of the speed that no tyres of the vehicle can cause."""
    jumping = in_jumps(drive, vehicle) if vehicle is not None else np.zeros(len(drive), dtype=bool)
    if not jumping.any():
        return drive, []
    note = (
        f"{drive.name}: {jumping.sum() * drive.period:.1f} s about jumps of the speed that no tyres can make, "
        f"the first at t = {drive['t'][int(np.argmax(jumping))]:.2f} s"
    )
    return drive.select(~jumping), [note]


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
            # After a step of the steer angle the car needs time to respond, although the angle is constant again.
            answer = int(round(rules.answer_seconds / drive.period)) if name == "delta" else 0
            later = slice(rows.start + answer, rows.stop)
            if name == "delta" and steering_is_held(drive, later, rules):
                continue
            if name == "vx" and _path_is_as_steady(drive, rows, rules):
                continue
            if any(
                np.std(drive[other][later]) > rules.still_share * np.std(drive[other]) > 0.0
                for other in _MOVES_WITH[name]
            ):
                found[rows] = True
    return found


def steering_is_held(drive: Drive, rows: slice, rules: Screening) -> bool:
    """Return whether a constant steer angle is real: the driver holds it, and the car drives circles.

    Parameters
    ----------
    rows : slice
        Samples during which the recorded steer angle is constant.

    Notes
    -----
    With a held steer angle the yaw rate has its sign and is a function of the speed: delta v_x/(L + K v_x^2) in
    gentle turns, another smooth function near the limit. A polynomial of fourth degree in the speed is fitted. If the
    sensor is stuck instead, the yaw rate changes sign, or varies at one speed. The yaw rate is used and not the
    curvature, which a standing car does not have.
    """
    angle, speed = drive["delta"][rows], np.maximum(drive["vx"][rows], 1e-3)
    if not len(speed) or not angle.any():
        return False
    rate = smoothed(drive, drive["r"])[rows] * np.sign(angle[0])
    scaled = speed / speed.max()
    columns = np.stack([scaled**k for k in range(1, 5)], axis=1)
    left = rate - columns @ np.linalg.lstsq(columns, rate, rcond=None)[0]
    return bool(np.std(left) < rules.turn_spread * np.mean(rate))


def _path_is_as_steady(drive: Drive, rows: slice, rules: Screening) -> bool:
    """Return whether the position confirms a constant v_x, as under a cruise controller: the steps along X, Y are even.

    In a simulation such a v_x is exactly constant. The steps may vary by the share that any other channel may vary
    by while a stuck one is constant.
    """
    if not drive.has_position or not measures(drive, "vx", "X", "Y"):
        return False
    steps = np.hypot(np.diff(drive["X"][rows]), np.diff(drive["Y"][rows])) / drive.period
    return bool(np.std(steps) <= rules.still_share * np.std(drive["vx"]))


def _with_sound_position(drive: Drive, rules: Screening, vehicle: Vehicle | None) -> tuple[Drive, list[str]]:
    """Fill short gaps of position and yaw; drop both where gaps are long, or where they are constant while driving."""
    if not drive.has_position:
        return drive, []
    names = ("X", "Y", "yaw")
    known = np.all([np.isfinite(drive[name]) for name in names], axis=0)
    columns = dict(drive.columns)
    gaps = np.diff(np.flatnonzero(np.concatenate([[True], known, [True]])))
    still = (np.diff(drive["X"]) == 0.0) & (np.diff(drive["Y"]) == 0.0)
    # A constant position is no fault while the car stands.
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
        return replace(drive, columns=columns), []
    for name in names:
        del columns[name]
    return replace(drive, columns=columns), [f"{drive.name}: position and yaw: {reason}"]
