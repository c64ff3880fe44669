"""A draft of a signal map: names and units suggest, the data and the consistency checks judge."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from split_cli.errors import SplitError
from split_cli.logs.assembling.clean import newest_first
from split_cli.logs.assembling.gather import fitting_presets
from split_cli.logs.assembling.marks_of_nothing import without_marks
from split_cli.logs.checking.checks import ACROSS
from split_cli.logs.checking.consistency import Consistency
from split_cli.logs.drafting.candidates import candidates_of
from split_cli.logs.drafting.cars_in_columns import columns_of_one_car
from split_cli.logs.drafting.clock import clock_of_rows, is_cut_in_degrees
from split_cli.logs.drafting.corrections import as_others_turn, as_siblings, correct, with_status
from split_cli.logs.drafting.draft import Draft, Suggestion, line_on_cars, quoted, render_draft
from split_cli.logs.drafting.fix_beside import along_the_fix
from split_cli.logs.drafting.forms import hints_on_the_form
from split_cli.logs.drafting.handedness import (
    as_bearing_by_name,
    channels_with_a_side,
    path_is_certain,
    what_tells_left,
    without_a_side,
    without_its_side,
)
from split_cli.logs.drafting.nameless import named_by_motion
from split_cli.logs.drafting.naming import Meaning, is_command, meanings, stated_unit, words_of
from split_cli.logs.drafting.other_axes import without_other_axes, without_the_world
from split_cli.logs.drafting.single_channel import (
    read_acceleration,
    read_pedal,
    read_sideslip,
    read_torque,
    read_wheel,
    read_yaw,
    read_yaw_rate,
    without_the_tilted,
)
from split_cli.logs.drafting.speed_units import copies_of_others, with_units_of_multiples
from split_cli.logs.drafting.steering import read_steering
from split_cli.logs.drafting.trial import Trial, TrialCandidate, names_of
from split_cli.logs.drafting.vector_axes import (
    along_the_car,
    doubt_of_height,
    names_of_triples,
    side_by_gravity,
    unit_by_gravity,
)
from split_cli.logs.drafting.vocabulary import concepts_of, tokens_of
from split_cli.logs.drafting.wheel_torques import PARTS, note_on_brakes, note_on_engine, torques_alike
from split_cli.logs.listing import with_all_elements
from split_cli.logs.one_car import of_one_car, several_cars
from split_cli.logs.raw import Clock, RawChannelInfo, RawRecording, RawSignal, time_column, turned
from split_cli.signals import find_unit
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Draft", "Suggestion", "draft_map", "render_draft", "suggest_map"]

_MOST_RIVALS = 4
_CLOSE = 0.95
"""Mean correlation of a channel with what the others say, from which on no rival is tried [1]."""
_OF_MOTION = frozenset({"vx", "vy", "r", "yaw", "X", "Y", "ax", "ay"})
"""Channels of which no two can be one column."""
_HELPERS = ("latitude", "longitude", *PARTS, "engine_torque", "course")
"""Meanings that make channels of the drive and are none."""


def draft_map(recording: RawRecording, *, row_rate: float | None = None, vehicle: Vehicle | None = None) -> Draft:
    """Draft a map for a recording.

    Parameters
    ----------
    row_rate : float, optional
        Of a table without a column of time [Hz].
    vehicle : Vehicle, optional
        Lets the steer angle, T and the place of v_y be judged too.

    Notes
    -----
    Names and units give candidates. Of several for one channel the one is taken with which the recording
    contradicts itself least. A unit that nobody states and a sign are corrected where the checks name one mistake
    as clearly the best explanation; what they do not settle is left open or marked.
    """
    cars = None if hasattr(recording, "parts") else several_cars(recording)
    if cars is not None:
        own = of_one_car(recording, {cars.column: next(iter(cars.counts))})
        return replace(draft_map(own, row_rate=row_rate, vehicle=vehicle), rows=line_on_cars(cars))
    infos, said_of_cars = columns_of_one_car(recording.channels())
    candidates = candidates_of(recording, infos)
    if not any(c.channel in _OF_MOTION for c in candidates):
        candidates += named_by_motion(recording, infos)
    triples = names_of_triples(infos)
    read, clock = _with_common_clock(recording, _read(recording, candidates, triples))
    read = {name: without_marks(signal)[0] for name, signal in read.items()}
    signals = _of_one_table(read)
    candidates = [c for c in candidates if not set(names_of(c)) & (read.keys() - signals.keys())]
    time, line, known = clock_of_rows(recording, infos, signals, candidates, row_rate)
    if clock:
        line = f"time: {{clock: {clock}}}   # CHECK: by the {recording.clocks[0]} times, no moment is in all topics"
    candidates = [c for c in candidates if f"source: {quoted(c.sources[0])}," not in line]
    if time is not None and newest_first(time):
        time, signals = turned(time, signals)
        line += "   # rows in reverse order: turned round"
    candidates = along_the_car(candidates, triples, signals, time)
    candidates = with_units_of_multiples(candidates, signals)
    trial = Trial(signals, time, vehicle, known)
    trial.torques = torques_alike(candidates)
    usable, opened = _usable(candidates, trial)
    chosen = _choose(usable, trial)
    while world := without_the_world(usable, chosen, trial):  # a receiver and an inertial unit may both give one
        opened += world
        chosen = _choose(usable, trial)
    chosen = along_the_fix(chosen, usable, trial, lambda candidate: _first_guess(candidate, trial))
    corrected, consistency = _with_rivals_that_fit(*correct(chosen, trial), usable, trial)
    corrected = as_others_turn(as_siblings(corrected, consistency), consistency)
    line += "".join(f"   # CHECK: {f.text}" for f in consistency.findings if f.channel == "time")
    suggestions = _judged(corrected, consistency, trial, infos, triples)
    taken = {name for s in suggestions for name in s.sources}
    known = {s.channel for s in suggestions}
    left_out, opened = opened, [s for s in opened if s.channel not in known and not set(s.sources) & taken]
    left_over = (i.name for i in infos if i.name not in taken and f": {quoted(i.name)}," not in line)
    unused = tuple(with_all_elements(recording, left_over))
    bare = {note.where for note in recording.notes if note.what.startswith("not readable")}
    undefined = dict.fromkeys(i.type_name for i in infos if i.name in bare and "/" in i.type_name)
    mapped = {s.channel: s for s in suggestions if s.status != "open"}
    by_wheels = trial.outer_wheels_are_faster({**trial.speed_of_wheels(mapped), **trial.columns(mapped)})
    left_by = what_tells_left(mapped, infos, by_wheels)
    if not left_by:
        suggestions = [without_a_side(s) for s in suggestions]
    elif path_is_certain(mapped):
        sided_channels = channels_with_a_side(mapped, consistency.relations, by_wheels)
        unknown = {"r", "vy", "ay", "delta"} - sided_channels
        suggestions = [
            without_its_side(s) if s.channel in unknown and s.status in ("judged", "stated") else s for s in suggestions
        ]
    by_gravity = "" if left_by else side_by_gravity({s.channel: s for s in suggestions}, triples, signals)
    hints = hints_on_the_form(recording, infos)
    still = {name for s in left_out if s.never_changes for name in s.sources}
    presets = fitting_presets(recording, still)
    whole = (*suggestions, *dict.fromkeys(opened))
    gap = trial.gap(mapped) if trial.time_is_known else 0.0
    return Draft(whole, line, unused, tuple(undefined), left_by, hints, by_gravity, presets, gap, cars=said_of_cars)


def _usable(
    candidates: Sequence[TrialCandidate], trial: Trial
) -> tuple[dict[str, list[TrialCandidate]], list[Suggestion]]:
    """Return the candidates of each channel that the data allow, and the others as open, with the reason."""
    opened: list[Suggestion] = []
    usable: dict[str, list[TrialCandidate]] = {}
    copies = copies_of_others(candidates, trial.signals)
    candidates = [trial.with_unit_of_the_fix(candidate) for candidate in candidates]
    for candidate in candidates:
        reason = trial.unusable(candidate) or copies.get(candidate.sources, "")
        if reason:
            opened.append(Suggestion(candidate.channel, candidate.sources, status="open", reason=reason))
        else:
            usable.setdefault(candidate.channel, []).append(candidate)
    _only_measured(usable, opened)
    opened += without_other_axes(usable, trial, lambda candidate: _first_guess(candidate, trial))
    return usable, opened


def _judged(
    corrected: Mapping[str, Suggestion],
    consistency: Consistency,
    trial: Trial,
    infos: Sequence[RawChannelInfo],
    triples: Sequence[tuple[str, str, str]],
) -> list[Suggestion]:
    """Return what the map says of each channel: by the checks, then, where these are silent, by its own values.

    The steering comes last, read by the motion that is not in doubt.
    """
    suggestions = [with_status(s, corrected, consistency) for s in corrected.values()]
    suggestions = [s for s in suggestions if s.channel not in ("delta", "steering_wheel_angle", *_HELPERS)]
    suggestions = [_as_course(s, consistency, trial, corrected) if s.channel == "yaw" else s for s in suggestions]
    in_doubt = {s.channel for s in suggestions if s.status == "open"}
    clear = {c: values for c, values in trial.columns(corrected).items() if c not in in_doubt}
    turning = {**trial.speed_of_wheels(corrected), **trial.motion_of_pose(clear, ("vx", "r")), **clear}
    steering = read_steering(corrected, turning, trial.vehicle)
    hand = next((s.reason for s in suggestions if s.status == "open" and "positive is undecided" in s.reason), "")
    alone = {
        **({"T": read_torque} if trial.time_is_known else {}),
        "sideslip": read_sideslip,
        "throttle": read_pedal,
        "brake": read_pedal,
        "ax": read_acceleration,
        "ay": read_acceleration,
        "r": read_yaw_rate,
        "yaw": read_yaw,
    }
    suggestions = [alone[s.channel](s, clear, trial.rate) if s.channel in alone else s for s in suggestions]
    suggestions = [as_bearing_by_name(s, corrected, clear.get("yaw")) if s.channel == "yaw" else s for s in suggestions]
    suggestions = [unit_by_gravity(s, triples, trial.signals) for s in suggestions]
    suggestions = _with_sideslip(suggestions) if "vy" in clear else suggestions
    suggestions = [_as_engines(s, infos, clear.get("T")) if s.channel == "T" else s for s in suggestions]
    suggestions = _in_pairs(doubt_of_height(without_the_tilted(suggestions), triples, trial.signals, trial.time))
    suggestions = [read_wheel(s, clear, trial.rate) if s.channel.startswith("wheel_speed") else s for s in suggestions]
    steered = [s.left_open(hand) if hand and s.status != "open" else s for s in steering]
    return [*suggestions, *steered]


def suggest_map(recording: RawRecording, *, row_rate: float | None = None, vehicle: Vehicle | None = None) -> str:
    """Return a draft map as YAML text: each channel with its evidence, or commented out with its reason."""
    return render_draft(draft_map(recording, row_rate=row_rate, vehicle=vehicle), recording.name)


def _as_course(s: Suggestion, verdict: Consistency, trial: Trial, chosen: Mapping[str, Suggestion]) -> Suggestion:
    """Leave a yaw open that is called a course over ground, or that only a satellite receiver can have told.

    Unless the sideslip between the two is seen.
    """
    if s.status == "open" or any(r.name == ACROSS and r.holds for r in verdict.relations):
        return s
    named = [m for name in s.sources for m in meanings(RawChannelInfo(name, "column", None))]
    if Meaning("yaw", 3) not in named and s.world == "ned":
        if _changes_with_the_fix(s, trial):
            why = "changes only with the satellite fix: of one antenna it is the direction of travel, not yaw"
            return s.left_open(why)
        if "r" not in chosen and chosen.get("X", s).convert == "local_x":
            why = (
                "a bearing beside a satellite fix, without yaw rate: the direction of travel if of the receiver. "
                "A v_y derived from it would be zero"
            )
            return s.left_open(why)
    if "course" not in {m.channel for m in named}:
        return s
    return s.left_open("by its name the direction of travel: yaw plus sideslip, not yaw")


def _with_sideslip(suggestions: Sequence[Suggestion]) -> list[Suggestion]:
    """Judge a v_y that nothing else judges by the side-slip angle that agrees with it: size, and one sign."""
    slip = next((s for s in suggestions if s.channel == "sideslip" and s.status == "judged"), None)
    agrees = slip is not None and "sign is turned" not in slip.reason
    return [
        replace(s, status="judged", reason="v_y/v_x is the side-slip angle")
        if agrees and s.channel == "vy" and s.status in ("assumed", "stated")
        else s
        for s in suggestions
    ]


def _as_engines(s: Suggestion, infos: Sequence[RawChannelInfo], torque: np.ndarray | None) -> Suggestion:
    """Mark a torque that may be the engine's, or that lacks the brakes that are recorded beside it."""
    names = [info.name for info in infos if info.type_name != "text"]
    why = note_on_engine(s.sources, names) or note_on_brakes(s.sources, names, torque)
    return replace(s, status="assumed", reason=f"{why}; {s.reason}") if why and s.status != "open" else s


def _in_pairs(suggestions: Sequence[Suggestion]) -> list[Suggestion]:
    """Leave X and Y open together: one of them alone is no position."""
    why = next((s.reason for s in suggestions if s.channel in ("X", "Y") and s.status == "open"), None)
    if len({s.channel for s in suggestions} & {"X", "Y"}) == 1:
        why = "its other axis was not found, and one alone is no position"
    return [s.left_open(why) if why and s.channel in ("X", "Y") else s for s in suggestions]


def _changes_with_the_fix(s: Suggestion, trial: Trial) -> bool:
    """Whether a heading is held on the rows of a table on which its latitude is held too, and on few others."""
    latitude = next((x for x in trial.signals.values() if _first_meaning(x.name) == "latitude"), None)
    heading = trial.signals.get(s.sources[0])
    if latitude is None or heading is None or len(latitude.values) != len(heading.values):
        return False
    fixes, turns = (np.diff(x.values) != 0.0 for x in (latitude, heading))
    rows = len(fixes)
    return 20 < np.sum(turns) < 0.5 * rows and np.sum(turns & fixes) > 0.9 * np.sum(turns) and np.mean(fixes) < 0.5


def _first_meaning(name: str) -> str:
    """Return the channel that a column's name means first; empty where it means none."""
    return next((meaning.channel for meaning in meanings(RawChannelInfo(name, "column", None))), "")


def _read(
    recording: RawRecording, candidates: Sequence[TrialCandidate], triples: Sequence[tuple[str, str, str]]
) -> dict[str, RawSignal]:
    """Read what candidates need and what may be a clock; a signal that cannot be read is left out."""
    names = {name for c in candidates for name in names_of(c)}
    names |= {name for three in triples if names & set(three) for name in three}
    listed = recording.channels()
    if not recording.clocks:
        names |= {
            info.name
            for info in listed
            if re.search(r"time|stamp|millis|micros|epoch|^t(_\d*(s|ms|us|ns)?)?$", info.name, re.IGNORECASE)
        }
        names |= {info.name for info in [time_column(listed)] if info is not None}
        names |= {info.name for info in listed if info.type_name != "text" and info is listed[0]}
        names |= {info.name for info in listed if getattr(find_unit(stated_unit(info) or ""), "si", "") == "s"}
    text = {info.name for info in listed if info.type_name == "text"}
    known = {info.name for info in listed}
    wanted = sorted(names & known - text)
    with suppress(SplitError):
        return recording.read(wanted)
    signals: dict[str, RawSignal] = {}
    for name in wanted:
        with suppress(SplitError):
            signals |= recording.read([name])
    return signals


def _with_common_clock(
    recording: RawRecording, signals: dict[str, RawSignal]
) -> tuple[dict[str, RawSignal], Clock | None]:
    """Return the signals by a clock that all topics share, and its name where that is not the usual one."""

    def meet(read: Mapping[str, RawSignal]) -> bool:
        stamps = [s.time[np.isfinite(s.time)] for s in read.values() if s.time is not None]
        spans = [(stamp.min(), stamp.max()) for stamp in stamps if len(stamp)]
        return not spans or max(first for first, _ in spans) < min(last for _, last in spans)

    for clock in recording.clocks[1:] if not meet(signals) else ():
        with suppress(SplitError):
            if meet(read := recording.read(list(signals), clock)):
                return read, clock
    return signals, None


def _of_one_table(signals: dict[str, RawSignal]) -> dict[str, RawSignal]:
    """Return the signals without vectors of other lengths than most have, as a map or a table of settings has."""
    lengths = Counter(len(signal.values) for signal in signals.values() if signal.time is None)
    if len(lengths) < 2:
        return signals
    rows = max(lengths, key=lambda length: lengths[length])
    return {name: s for name, s in signals.items() if s.time is not None or len(s.values) == rows}


def _first_guess(candidate: TrialCandidate, trial: Trial) -> Suggestion:
    unit = candidate.unit
    if unit is None and candidate.channel in ("yaw", "sideslip") and candidate.convert == "":
        values = trial.signals[candidate.sources[0]].values
        if candidate.channel == "yaw" and is_cut_in_degrees(values):
            unit = "deg"
    to_the_right = (
        candidate.channel in ("vy", "ay")
        and not candidate.convert
        and ("right" in concepts_of(tokens_of(candidate.sources[0]))[0])
    )
    return Suggestion(
        candidate.channel,
        candidate.sources,
        unit,
        convert=candidate.convert,
        scale=-1.0 if to_the_right else 1.0,
        reason=candidate.note or ("to the right by its name" if to_the_right else ""),
        status="stated" if candidate.unit else "assumed",
        command=candidate.asked or all(is_command(name) for name in candidate.sources),
        by_convention=candidate.by_convention,
        foreign_unit=candidate.foreign_unit,
    )


def _only_measured(usable: dict[str, list[TrialCandidate]], opened: Sequence[Suggestion]) -> None:
    """Leave out the yaw rate of a message whose v_y never changes, where another is recorded.

    An odometry without v_y computes its yaw rate from the steering.
    """
    still = [s.sources[0] for s in opened if s.channel == "vy" and s.never_changes]
    silent = {name.rpartition("/")[0] for name in still if "/" in name}
    measured = [c for c in usable.get("r", []) if c.sources[0].rpartition("/")[0] not in silent]
    if measured:
        usable["r"] = measured


def _beside(x: TrialCandidate, options: Sequence[TrialCandidate], trial: Trial) -> dict[str, Suggestion]:
    """Return the Y that was recorded with an X: of the same fix, or named alike but for the axis."""
    if x.convert == "local_x":
        return {"Y": _first_guess(replace(x, channel="Y", convert="local_y"), trial)}
    named = re.sub(r"[xX](?=[^xX]*$)", lambda m: "y" if m[0] == "x" else "Y", x.sources[0])
    partner = next((y for y in options if y.sources == (named,)), None)
    return {} if partner is None else {"Y": _first_guess(partner, trial)}


def _with_rivals_that_fit(
    chosen: dict[str, Suggestion], verdict: Consistency, usable: Mapping[str, Sequence[TrialCandidate]], trial: Trial
) -> tuple[dict[str, Suggestion], Consistency]:
    """Exchange a channel that goes with the others badly for a rival that goes better, with all units put right.

    The first choice is made with units as they are guessed: there a rival in another unit contradicts the others.
    A rival of the wrong size is taken too, and left open with its size: what turns with the car is its channel.
    """
    for channel in ("r", "yaw", "ax", "ay", "vy"):
        rivals = [c for c in usable.get(channel, [])[:_MOST_RIVALS] if c.sources != chosen[channel].sources]
        taken = {s.sources for s in chosen.values()}
        for rival in rivals:
            if rival.sources in taken or _closeness(verdict, channel) > _CLOSE:
                continue
            attempt, found = correct({**chosen, channel: _first_guess(rival, trial)}, trial)
            lost = [c for c in chosen if c != channel and _closeness(verdict, c) > 0.0 == _closeness(found, c)]
            if not lost and _closeness(found, channel) > _closeness(verdict, channel):
                chosen, verdict = attempt, found
    return chosen, verdict


def _closeness(verdict: Consistency, channel: str) -> float:
    """Return the mean correlation of a channel's relations [1]; 0 where it has none."""
    mine = [abs(r.slope.correlation) for r in verdict.relations if channel in r.powers]
    return float(np.mean(mine)) if mine else 0.0


def _choose(usable: Mapping[str, list[TrialCandidate]], trial: Trial) -> dict[str, Suggestion]:
    """Take the clearest candidate of each channel; among rivals the one that contradicts the others least."""
    # Steering in per cent is a share of the lock, of which an angle beside it is the more.
    ranked = {
        channel: sorted(
            options, key=lambda c: (-c.weight, channel == "delta" and c.unit == "%", c.unit is None, len(c.sources))
        )[:_MOST_RIVALS]
        for channel, options in usable.items()
    }
    taken: dict[tuple[str, ...], str] = {}
    for channel, options in sorted(ranked.items(), key=lambda entry: -entry[1][0].weight):
        for candidate in list(options):
            owner = taken.get(candidate.sources)
            if owner is not None and not candidate.convert and (len(options) > 1 or {owner, channel} <= _OF_MOTION):
                options.remove(candidate)
        if options:
            taken.setdefault(options[0].sources, channel)
    ranked = {channel: options for channel, options in ranked.items() if options}
    chosen = {channel: _first_guess(options[0], trial) for channel, options in ranked.items()}
    for channel in ("vx", "r", "yaw", "X", "ax", "ay", "vy"):
        options = ranked.get(channel, [])
        if len(options) < 2:
            continue
        scored = []
        for place, candidate in enumerate(options):
            attempt = {**chosen, channel: _first_guess(candidate, trial)}
            if channel == "X":
                attempt |= _beside(candidate, ranked.get("Y", []), trial)
                attempt |= _yaw_of_the_pose(attempt, ranked.get("yaw", []), trial)
            verdict = trial.judge(attempt)
            mine = [r for r in verdict.relations if channel in r.powers]
            # A relation that could be measured counts for a candidate, a contradiction against it.
            score = verdict.cost - len(mine) - sum(abs(r.slope.correlation) for r in mine)
            scored.append((score + 2.0 * (options[0].weight - candidate.weight), place, attempt))
        chosen = min(scored, key=lambda entry: entry[:2])[2]
    return chosen | _yaw_of_the_pose(chosen, ranked.get("yaw", []), trial)


def _yaw_of_the_pose(
    chosen: Mapping[str, Suggestion], options: Sequence[TrialCandidate], trial: Trial
) -> dict[str, Suggestion]:
    """Return the yaw of the message or source that X is taken from: two estimators have two axes X.

    Of a table's columns the last word is the source: ``x_opti`` and ``yaw_opti``, beside ``yaw_imu``. Of several
    files, ``pose.x`` and ``pose.q.w``, the first is.
    """

    def message(sources: Sequence[str]) -> str:
        topic, words = sources[0].rpartition("/")[0], words_of(sources[0])
        of_file = sources[0].partition(".")[0] if "." in sources[0] else ""
        return topic or of_file or (words[-1] if len(words) > 1 else "")

    place = message(chosen["X"].sources) if "X" in chosen else ""
    same = next((c for c in options if place and message(c.sources) == place), None)
    if same is None or ("yaw" in chosen and message(chosen["yaw"].sources) == place):
        return {}
    return {"yaw": _first_guess(same, trial)}
