"""Channels that are late by so much that a model would learn it: told without being asked, and not corrected."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.logs.checking.best_lag import fit_lag
from split_cli.logs.checking.channel_delays import DelayEstimate, estimate_delays, linear_tire_rows
from split_cli.logs.checking.checks import ACROSS, Unjudged
from split_cli.logs.checking.consistency import Consistency, corrected_columns
from split_cli.logs.checking.kinematics import Kinematics
from split_cli.logs.checking.measuring_point import PLACE_IN_DOUBT
from split_cli.logs.checking.relations import ConsistencyFinding
from split_cli.logs.drive import Drive
from split_cli.logs.drive_metadata import is_derived
from split_cli.vehicle.parameters import Vehicle

_LATE = 0.08
"""Delay from which on it is reported [s]: twice what filters of usual sensors, and their clocks, differ by."""
_SURE = 6.0
"""Of a delay, in its standard errors, from which on it is reported: systematic errors are as large as several."""
_STEP = 0.04
"""Between the rows that are looked at [s]: half of the shortest delay that is reported."""
_ROWS = 1500
"""Looked at, from the middle of the drive: a minute [1]."""
_STEERED_ROWS = 6000
"""Of these, where only the steer angle is looked at: four minutes [1]."""
_KNOWN_TO = 0.5
"""Of the car's own lag, as well as a file's yaw inertia and cornering stiffness are known [1]; judgement."""
_BY_CHANCE = 3.0
"""Standard errors of a delay beside what the file may be wrong by [1]; judgement."""
_MOVING = 0.3
"""Of the drive's highest speed, above which steering shows in the yaw rate [1]."""
_MOST = 3
"""Channels that are reported [1]; with more than that something else is wrong."""
_HELD = 0.3
"""Share of rows that repeat the one before, from which on a channel is one of steps [1]."""
_COMPARED = ("delta", "ax", "ay")
"""Channels that no other is compared with: their steps put off nothing but themselves."""
_UNTRUSTED = ("scale", "sign", "range", "hand", "swapped", "world", "constant", "copied", "course", "clock")


def late_channels(
    drive: Drive, vehicle: Vehicle | None, kinds: Mapping[str, str], known: Consistency
) -> tuple[list[ConsistencyFinding], list[Unjudged]]:
    """Return a finding for each measured channel that is late or early by `_LATE`, and where that does not show.

    Parameters
    ----------
    vehicle : Vehicle, optional
        Needed for the steer angle.
    kinds : mapping of str to str
        Derived channels have no clock of their own; a command that the car precedes is one that came late.
    known : Consistency
        A factor that it is sure of is taken out. A channel that is reported wrong without one is not looked at, and
        nothing is where v_x, r or the place of v_y is.
    """
    wrong = {f.channel for f in known.findings if f.check in _UNTRUSTED}
    wrong -= {"X" if channel == "hand" else channel for channel in known.factors}
    if not any("vy" in relation.powers for relation in known.relations):
        wrong.add("vy")  # nothing judged it: an identity that needs it may be off by v_y as well as by a clock
    if {"vx", "r", "time"} & wrong or any(f.check in ("place", "size") for f in known.findings):
        return [], []
    columns, period, segments, holds = _looked_at(drive, kinds, known, wrong, _ROWS)
    if "vx" not in columns:
        return [], []
    wanders = any(f.channel == "vy" and f.check == "bias on straights" for f in known.findings)
    # The place of v_y is not judged either while v_x or r has to be multiplied first.
    in_doubt = {"vx", "r"} & set(known.factors) or any(one.check == PLACE_IN_DOUBT for one in known.unjudged)
    if wanders or in_doubt:
        columns.pop("delta", None)  # an angle of v_y that wanders passes for a lag; the yaw rate tells without v_y
    found: list[ConsistencyFinding] = []
    timed: set[str] = set()
    for _ in range(_MOST):
        late, timed = _latest(columns, period, segments, vehicle, kinds, holds)
        if late is None:
            break
        found.append(_finding(late))
        # What is late makes others seem early: with it put right they are looked at again.
        t = period * np.arange(len(columns["vx"]))
        columns[late.channel] = np.interp(t + late.delay, t, columns[late.channel])
    if found:
        return found, []
    steered = _steered_late(*_looked_at(drive, kinds, known, wrong, _STEERED_ROWS), vehicle)
    if isinstance(steered, Unjudged):
        return [], [steered] if "delta" not in timed else []
    return [steered] if steered else [], []


def _looked_at(
    drive: Drive, kinds: Mapping[str, str], known: Consistency, wrong: Collection[str], count: int
) -> tuple[dict[str, np.ndarray], float, list[slice], dict[str, float]]:
    """Return `count` rows amid a drive: columns, period [s], segments, and how long values are held."""
    stride = max(1, round(_STEP / drive.period))
    first = max(0, (len(drive) - count * stride) // 2)
    part = drive.stretch(first, min(first + count * stride, len(drive)))
    vy_judged = any(relation.name == ACROSS for relation in known.relations)
    whole = corrected_columns(part.columns, known.factors, vy_judged)
    segments = [slice(-(-s.start // stride), -(-s.stop // stride)) for s in part.segments()]
    holds = {channel: _hold(values, drive.period) for channel, values in whole.items()}
    columns = {
        channel: values[::stride]
        for channel, values in whole.items()
        if not is_derived(kinds.get(channel, ""))
        and channel not in wrong
        # Steps shorter than those between the rows that are looked at do not show.
        and (channel in _COMPARED or holds[channel] <= _STEP)
    }
    return columns, drive.period * stride, segments, holds


def _steered_late(
    columns: Mapping[str, np.ndarray],
    period: float,
    segments: list[slice],
    holds: Mapping[str, float],
    vehicle: Vehicle | None,
) -> ConsistencyFinding | Unjudged | None:
    """Return a finding where the steer angle follows what the yaw rate takes: no car turns before it is steered.

    Where a delay of `_LATE` would not show, how long one must be to show.

    Both axles' forces give delta = L r/v_x + (I_z/L) (1/C_f + 1/C_r) dr/dt + K v_x r, without v_y, unlike the
    identity of the front axle. Tyres and actuators lag besides, and without a vehicle file dr/dt is left out: the
    delay is a least one.
    """
    if not {"delta", "r"} <= set(columns):
        return None
    vx, r = columns["vx"], columns["r"]
    used, needed, own = vx > _MOVING * np.nanquantile(np.abs(vx), 0.95), r, 0.0
    speed = np.where(used, vx, np.nan)
    if vehicle is not None:
        front, rear = vehicle.front_tire, vehicle.rear_tire
        softness = 1.0 / front.cornering_stiffness + 1.0 / rear.cornering_stiffness
        reach = vehicle.yaw_inertia * softness / vehicle.wheelbase**2  # [s/m], of the lag at a speed
        needed = r + reach * vx * Kinematics(columns, period, segments, width=period).rate("r")
        used = used & linear_tire_rows(columns, vehicle)
        own = _KNOWN_TO * reach * float(np.nanmedian(speed))
    fit = fit_lag(columns["delta"], [needed / speed, vx * r], used, period, segments)
    lag = fit.lag - 0.5 * holds.get("delta", 0.0)
    unsure = own + _BY_CHANCE * fit.error if vehicle is not None else _SURE * fit.error
    if fit.refusal:
        return Unjudged("delay of delta", fit.refusal)
    if lag < unsure > _LATE:
        return Unjudged("delay of delta", f"{lag:.2f} s is measured, and less than {unsure:.2f} s does not show here")
    if lag < _LATE:
        return None
    error = own + fit.error
    if vehicle is None:
        late = f"delta follows r by {lag:.3f} +- {error:.3f} s. It is late by at least that"
    else:
        late = f"delta is late by {lag:.2f} +- {error:.2f} s for the yaw rate and this vehicle file"
    text = f"{late}, or r is early, since no car turns before it is steered. `--delay delta={lag:.3g}` moves it."
    return ConsistencyFinding("delay", "delta", text, lag, error)


def _finding(late: DelayEstimate) -> ConsistencyFinding:
    """Put a delay into words; where nothing ties it to v_x, the yaw rate may be what is late."""
    sense, other = ("late", "early") if late.delay > 0.0 else ("early", "late")
    remedy = f"`--estimate-delays` moves it, or `--delay {late.channel}={late.delay:.3g}`."
    if late.reference == "r":
        remedy = (
            f"Or r is as much {other}: nothing recorded decides. Pass `--delay {late.channel}={late.delay:.3g}` "
            f"or `--delay r={-late.delay:.3g}`."
        )
    elif late.channel == "r" and late.reference != "vx":
        remedy = f"`--delay r={late.delay:.3g}` moves it; `--estimate-delays` would move the others."
    if late.channel in ("T", "delta") and late.delay < 0.0:
        # Of a command it is no fault of a clock: moved, it would hide what the actuator does.
        otherwise = "" if late.reference == "r" else "Else "
        command = f"If {late.channel} is a command, which comes first, say `kind: command` in the map."
        remedy = f"{command} {otherwise}{remedy}"
    text = (
        f"{late.channel} is {abs(late.delay):.3f} +- {late.error:.3f} s {sense} against {late.reference} "
        f"(from {' and '.join(late.identities)}). {remedy}"
    )
    return ConsistencyFinding("delay", late.channel, text, late.delay, late.error)


def _hold(values: np.ndarray, period: float) -> float:
    """Return how long a channel in steps keeps its value [s] where it changes fast, 0 for one without steps.

    Not on average: coarse steps, and values written only on change, stand still where nothing happens, and are not
    late there.
    """
    changes = np.flatnonzero(np.diff(values) != 0.0)
    if len(changes) > (1.0 - _HELD) * len(values):
        return 0.0
    return period * float(np.quantile(np.diff(changes), 0.1)) if len(changes) > 1 else period * len(values)


def _latest(
    columns: Mapping[str, np.ndarray],
    period: float,
    segments: list[slice],
    vehicle: Vehicle | None,
    kinds: Mapping[str, str],
    holds: Mapping[str, float],
) -> tuple[DelayEstimate | None, set[str]]:
    """Return the estimate that is the surest of those to be reported, None where none is, and what has an estimate.

    A value that is held shows half a hold late, and that is no clock: it is taken off.
    """
    known = [
        replace(e, delay=e.delay - 0.5 * holds.get(e.channel, 0.0))
        for e in estimate_delays(columns, period, segments, vehicle, {c: c for c in columns})
        if not e.refusal and not e.channel.startswith("wheel_speed")
    ]
    late = [
        e
        for e in known
        if abs(e.delay) >= max(_LATE, _SURE * e.error)
        # What the car lags behind its command is the actuator's doing.
        and not ("command" in kinds.get(e.channel, "") and e.delay < 0.0)
    ]
    surest = _yaw_rate_itself(late, known) or max(late, key=lambda e: abs(e.delay) / e.error, default=None)
    return surest, {e.channel for e in known}


def _yaw_rate_itself(late: Sequence[DelayEstimate], known: Sequence[DelayEstimate]) -> DelayEstimate | None:
    """Return the delay of r where all that is compared with it is early, or late, alike; None elsewhere.

    What nothing ties to v_x is compared with r, which is taken to be on time. Two channels with the same delay are
    one that they are compared with.
    """
    compared = [e for e in known if e.reference == "r"]
    early = len({e.delay < 0.0 for e in compared}) == 1
    if len(compared) < 2 or not early or any(e not in late for e in compared):
        return None
    weights = np.array([1.0 / e.error**2 for e in compared])
    delay = -float(weights @ [e.delay for e in compared] / weights.sum())
    identities = tuple(dict.fromkeys(name for e in compared for name in e.identities))
    error = float(weights.sum() ** -0.5)
    return DelayEstimate("r", delay, error, " and ".join(e.channel for e in compared), identities)
