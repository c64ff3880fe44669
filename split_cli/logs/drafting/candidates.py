"""What names, units and the types of messages say that recorded signals may be: candidates for channels."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from split_cli.logs.assembling.conversion import expected_unit
from split_cli.logs.drafting.draft import UNITS_OF
from split_cli.logs.drafting.message_fields import asks_by_type, field_candidates, is_no_measurement, is_of_a_command
from split_cli.logs.drafting.nameless import is_of_a_state
from split_cli.logs.drafting.naming import (
    COMMANDED,
    is_command,
    meanings,
    named_by_axis,
    named_without_source,
    spelled_without_unit,
    stated_unit,
    words_of,
)
from split_cli.logs.drafting.trial import TrialCandidate, names_of
from split_cli.logs.drafting.vocabulary import concepts_of, tokens_of
from split_cli.logs.drafting.wheel_torques import sums_of_torques
from split_cli.logs.raw import RawChannelInfo, RawRecording, split_stamps, time_column
from split_cli.logs.readers.named_arrays import is_time
from split_cli.signals import find_unit


def candidates_of(recording: RawRecording, infos: Sequence[RawChannelInfo]) -> list[TrialCandidate]:
    """Return what names and units suggest; a unit of another quantity rules a channel out."""
    found = _by_fields(infos)
    by_field = {name for candidate in found for name in (*candidate.sources, *names_of(candidate))}
    time = None if recording.clocks else time_column(infos)
    by_field |= {name for stamp in split_stamps(infos) for name in (stamp.whole, stamp.part)}
    columns = [info for info in infos if info != time and info.type_name != "text" and info.name not in by_field]
    columns = [info for info in columns if not _is_time_of_a_structure(info.name)]
    renamed = named_without_source(infos) | named_by_axis(infos)
    for info in columns:
        if not is_of_a_state(info, infos) and not is_no_measurement(info):
            found += _by_name(info, renamed.get(info.name, info))
    found = _with_level_axis(_by_pairs(_unfiltered(found), infos), infos)
    return [*_signed(found, infos), *_fixes(found)]


def _is_time_of_a_structure(name: str) -> bool:
    """Whether a field is the time of its structure: ``SteerAngle.Time``; a T is a torque."""
    structure, _, field = name.rpartition(".")
    return bool(structure) and field != "T" and is_time(field)


_FILTERS = frozenset("filt filtered filter smooth smoothed smth lp lowpass avg averaged".split())


def _unfiltered(found: list[TrialCandidate]) -> list[TrialCandidate]:
    """Return the candidates without those beside which the same name stands as measured: a filter delays.

    A yaw rate and an a_y that are filtered alike fit each other.
    """

    def spelled(c: TrialCandidate) -> tuple[str, ...]:
        return (c.channel, *(" ".join(words_of(source)) for source in c.sources))

    names = {spelled(c) for c in found}

    def as_measured(c: TrialCandidate) -> tuple[str, ...]:
        return (c.channel, *(" ".join(w for w in words_of(s) if w not in _FILTERS) for s in c.sources))

    return [c for c in found if as_measured(c) == spelled(c) or as_measured(c) not in names]


def _by_fields(infos: Sequence[RawChannelInfo]) -> list[TrialCandidate]:
    """Return what the types of messages and their fields say."""
    found = []
    for channel, sources, convert in field_candidates(infos):
        # Messages of ROS are in SI by its conventions (REP 103), positions of a fix in degrees.
        unit = "deg" if channel in ("latitude", "longitude") else expected_unit(channel)
        info = next((i for i in infos if i.name == sources[0]), None)
        stated = stated_unit(info) if info is not None else None
        fixed = bool(convert) or channel in ("latitude", "longitude")
        by_convention = stated is None and not fixed and info is not None and "/" in info.type_name
        unit = unit if fixed or by_convention else None
        asked = info is not None and asks_by_type(info)
        found.append(TrialCandidate(channel, sources, 3, stated or unit, convert, by_convention, asked=asked))
    return found


def _by_name(info: RawChannelInfo, read_as: RawChannelInfo) -> Iterator[TrialCandidate]:
    """Yield what the name of a column may mean, which is read without its source, or as the axis of a vector."""
    unit = stated_unit(info)
    si = getattr(find_unit(unit), "si", None) if unit else None
    asked = info.name.startswith("/") and is_of_a_command(info.name.rpartition("/")[0])
    for meaning in meanings(read_as):
        channel = meaning.channel
        if asked and channel not in COMMANDED:
            continue
        if channel == "brake" and si == "Pa":
            channel = "brake_pressure"
        between = (channel, si) == ("r", "rad") and re.search(r"(?i)d_?psi", info.name)
        if between or channel == "yaw" and re.search(r"(?i)delta_?psi", info.name):
            continue  # the angle between car and path
        if channel in ("yaw", "r") and si in ("rad", "rad/s"):
            channel = "yaw" if si == "rad" else "r"  # some call the rate yaw, as the axis
        if channel in ("X", "Y") and si == "rad":
            channel = {"X": "longitude", "Y": "latitude"}[channel]  # a position in an angle is one on the globe
        expected = UNITS_OF.get(channel) or expected_unit(channel)
        turning = channel.startswith("wheel_speed") and si == "rad/s"
        turning = turning or (channel in ("delta", "steering_wheel_angle") and unit == "%")
        if si is not None and expected is not None and si != expected and not turning:
            continue
        foreign = info.unit if info.unit and unit is None else ""
        weight = meaning.weight - info.name.startswith("_")
        yield TrialCandidate(channel, (info.name,), weight, unit, foreign_unit=foreign)


def _by_pairs(found: list[TrialCandidate], infos: Sequence[RawChannelInfo]) -> list[TrialCandidate]:
    """Return candidates with those put right of names that mean something else beside each other."""
    numbers = [info for info in infos if info.type_name != "text"]
    bare = {spelled_without_unit(info): info for info in numbers}
    for u, v in (("u", "v"), ("U", "V"), ("Vl", "Vq"), ("vl", "vq"), ("v_l", "v_q"), ("V_l", "V_q")):
        if u in bare and v in bare:
            # Beside a u, v is the lateral velocity of the textbooks; q is quer, German for it.
            found = [c for c in found if c.sources not in ((bare[v].name,), (bare[u].name,))]
            found += [
                TrialCandidate("vx", (bare[u].name,), 2, stated_unit(bare[u])),
                TrialCandidate("vy", (bare[v].name,), 2, stated_unit(bare[v])),
            ]
    lowered = {spelled_without_unit(info).lower(): info for info in numbers}
    lowered |= {"_".join(words_of(info.name)): info for info in numbers}
    for north, east in (("x_n", "y_e"), ("pos_n", "pos_e"), ("p_n", "p_e"), ("pn", "pe"), ("utm_n", "utm_e")):
        if north in lowered and east in lowered:
            # y_E alone may be an error; beside x_N it is east.
            pair = {"X": lowered[east], "Y": lowered[north]}
            found = [c for c in found if c.sources[0] not in {info.name for info in pair.values()}]
            found += [TrialCandidate(c, (info.name,), 3, info.unit) for c, info in pair.items()]
    if "e" in lowered and "n" not in lowered:
        # The distance from a path, called an error, is no position.
        found = [c for c in found if c.sources != (lowered["e"].name,)]
    accelerations = {"ax", "ay"} & set(lowered)
    if len(accelerations) == 2 and "gz" in lowered and not any(c.channel == "r" for c in found):
        # Beside a_x and a_y, g is the gyroscope; alone, gx, gy and gz are shares of gravity.
        found.append(TrialCandidate("r", (lowered["gz"].name,), 2, stated_unit(lowered["gz"])))
    fix = {c.channel: c.sources for c in reversed(found) if c.channel in ("latitude", "longitude")}
    if len(fix) == 2:
        # Beside a latitude, lon is no longitudinal acceleration.
        found = [c for c in found if c.channel in fix or c.sources not in fix.values()]
    return found


def _with_level_axis(found: list[TrialCandidate], infos: Sequence[RawChannelInfo]) -> list[TrialCandidate]:
    """Return candidates with Y from the axis z of a position whose y, up in many games, is not recorded."""
    if any(c.channel == "Y" for c in found):
        return found
    names = {info.name for info in infos if info.type_name != "text"}
    for c in [c for c in found if c.channel == "X" and len(c.sources) == 1]:
        y, z = (re.sub(r"[xX](?=[^xX]*$)", lambda m, a=a: a if m[0] == "x" else a.upper(), c.sources[0]) for a in "yz")
        if y not in names and z in names and z != c.sources[0]:
            note = "no y is recorded, so z is taken as the other level axis"
            return [*found, replace(c, channel="Y", sources=(z,), note=note)]
    return found


_SIGN_WORDS = frozenset({"vz", "vorzeichen", "sign", "sgn"})


def _signed(found: Sequence[TrialCandidate], infos: Sequence[RawChannelInfo]) -> list[TrialCandidate]:
    """Join a size with the column of its sign: named alike but for a word that says sign, as CAN data bases do."""
    signs = {}
    for info in infos:
        words = tokens_of(info.name)
        if _SIGN_WORDS & set(words):
            signs[tuple(w for w in words if w not in _SIGN_WORDS)] = info.name
    made = []
    for c in found:
        sign = signs.get(tuple(tokens_of(c.sources[0]))) if not c.convert and len(c.sources) == 1 else None
        if sign is None or sign == c.sources[0]:
            made.append(c)
        else:
            made.append(replace(c, sources=(c.sources[0], sign), convert="signed"))
    return made


def _fixes(found: Sequence[TrialCandidate]) -> list[TrialCandidate]:
    """Return X and Y from latitude and longitude, sums of wheel torques and brake pressures."""
    first = {c.channel: c for c in reversed(found) if c.channel in ("latitude", "longitude")}
    made = []
    if len(first) == 2:
        pair = (first["latitude"].sources[0], first["longitude"].sources[0])
        made += [TrialCandidate("X", pair, 2, "m", "local_x"), TrialCandidate("Y", pair, 2, "m", "local_y")]
    made += sums_of_torques(found)
    sides = {
        side: c
        for c in found
        if c.channel == "delta"
        for side in ("fl", "fr", "left", "right")
        if side in concepts_of(tokens_of(c.sources[0]))[0] and not is_command(c.sources[0])
    }
    for left, right in (("fl", "fr"), ("left", "right")):
        if left in sides and right in sides and sides[left].unit == sides[right].unit:
            both = (sides[left].sources[0], sides[right].sources[0])
            made.append(TrialCandidate("delta", both, 4, sides[left].unit, "pair_mean"))
    pressures = [c for c in found if c.channel == "brake_pressure"]
    if len(pressures) == 2:
        both = tuple(c.sources[0] for c in pressures)
        made.append(TrialCandidate("brake_pressure", both, 4, pressures[0].unit, "sum"))
    return made
