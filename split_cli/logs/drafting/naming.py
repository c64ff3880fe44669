"""What a recorded name probably means: the words in it, its unit suffix, and the channels that they fit."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from split_cli.logs.drafting.vocabulary import CORNERS, concepts_of, read_concepts, tokens_of, unfolded
from split_cli.logs.raw import RawChannelInfo
from split_cli.signals import TWO_WORDS, find_unit, with_short_unit

_UNIT_WORDS = {
    word: unit.symbol
    for word in """
        mps mps2 mpss kph kmh kmph mph kn knots rad mrad radps deg cdeg degps dps mdps degree degrees rpm s sec seconds
        us ns nm bar kpa pct percent mm m ft g mg n fps mil ftps lbft ftlb
    """.split()
    if (unit := find_unit(word))
}
_UNIT_WORDS |= {"ms2": "m/s^2", "cms": "cm/s", "mms": "mm/s", "rads": "rad/s", "degs": "deg/s"}
_UNIT_WORDS |= {"percentage": "%", "ftlbf": "lbf ft"}
_LAST_TWO = {tuple(words.split("_")): unit for words, unit in TWO_WORDS.items()}


@dataclass(frozen=True)
class Meaning:
    """One reading of a name."""

    channel: str  # a channel of the drive, or ``latitude``, ``sideslip``, ``steering_wheel_angle`` and the like
    weight: int  # how clearly the name says so; 3 is clear, 1 needs the data to agree


_CORNER = {
    "fl": r"(fl|lf|front_left|left_front|frontleft)",
    "fr": r"(fr|rf|front_right|right_front|frontright)",
    "rl": r"(rl|lr|rear_left|left_rear|rearleft|bl)",
    "rr": r"(rr|rear_right|right_rear|rearright|br)",
}
# One pattern a line, however long: a table is read by its columns.
_RULES: tuple[tuple[str, int, str], ...] = (
    ("vx", 3, r"v_?x(_(body|cg|local|vehicle|car|long\w*))?|u|vel(ocity)?_?x(_(body|cg|local))?|(body_)?v(el)?_x"),
    ("vx", 3, r"(v|vel|velocity|speed)_?long\w*|long(itudinal)?_?(vel\w*|speed)|lng_vel|veh(icle)?_?spd_?lgt\w*"),
    ("vx", 3, r"vel(ocity)?_?(forward|fwd)|(forward|fwd)_?(vel\w*|speed)|v_?fwd"),
    ("vx", 2, r"(ground|vehicle|veh|car|corr(ected)?|gps|vbox|body|can)_?(speed|spd|velocity|vel)"),
    ("vx", 2, r"speed_over_ground|sog|vf|car_?v|v_?car|u_?x"),
    ("vx", 2, r"v_ego|ego_speed|chassis_speed|vehspd\w*"),
    ("vx", 2, r"speed_2d|esp_vehiclespeed|vehiclespeed|wheel_?based_?vehicle_?speed"),
    ("vx", 1, r"speed|velocity|spd|v|vel|vel_encoder"),
    ("vx", 1, r"(non_?|un)?driv(en|ing)_?wheels?_?(speed|spd)"),
    ("vx", 1, r"spd_kmh|speed_actual|speed_measured|encoder_speed|odom_speed"),
    ("vy", 3, r"v_?y(_(body|cg|local|vehicle|car|lat\w*))?|vel(ocity)?_?y(_(body|cg|local))?|(body_)?v(el)?_y"),
    ("vy", 3, r"(v|vel|velocity|speed)_?lat\w*|lat(eral)?_?(vel\w*|speed)"),
    ("vy", 2, r"vl|u_?y"),
    ("sideslip", 3, r"(side_?)?slip(_angle)?(_?(cog|cg|body|vehicle))?|beta|body_slip\w*|float_angle|sideslip\w*"),
    ("r", 3, r"(imu_|body_|gyro_|can_)?yaw_?(rate|vel\w*|speed)\w*|psi_?(dot|p|d)|d_?psi"),
    ("r", 3, r"omega(_?z)?|w_?z|gyro_?z"),
    ("r", 3, r"av_?z(_\d)?"),
    ("r", 3, r"gyro_?yaw\w*|heading_rate|yawdot|orientation_?yaw_?(vel\w*|rate)"),
    ("r", 3, r"z_?(gyro|rate|ang\w*_vel\w*)|ang(ular)?_?(vel\w*|rate|speed)_?z|gps_gyro"),
    ("r", 2, r"rot(ation)?_?(rate_?)?z|turn_rate|rate_z|yr|w_imu|imu_w|gyro_?yaw"),
    ("r", 2, r"imu_g_?z|(imu_)?g_?z_(rps|dps|rad\w*|deg\w*)"),
    ("r", 2, r"gy_?z"),
    ("r", 1, r"r|w"),
    ("yaw", 3, r"yaw(_?angle)?|psi|true_head(ing)?\d?|unwrapped_yaw"),
    ("yaw", 3, r"vicon_yaw|attitude_yaw|euler_?(yaw|psi|z)|orientation_?yaw"),
    ("yaw", 2, r"heading(_angle)?|phi|hdg|theta|head_imu\d?|yaw_imu|azimuth"),
    ("course", 3, r"course(_over_ground)?|cog|gps_(heading|course|bearing)|bearing|track_angle"),
    ("course", 3, r"motion_heading|heading_motion"),
    ("latitude", 3, r"(gps_|pos_|ins_|rtk_|gnss_)?lat(itude)?(_?deg|_?min(utes)?|_?abs)?|breite(ngrad)?"),
    (
        "longitude",
        3,
        r"(gps_|pos_|ins_|rtk_|gnss_)?(lon|long|lng)(gitude|itude)?(_?deg|_?min(utes)?|_?abs)?|laenge(ngrad)?",
    ),
    ("X", 3, r"x|(pos(ition)?|loc(ation)?|local|enu|vicon|utm|map|odom|est)_?x(_pos\w*)?"),
    ("X", 3, r"x_?(pos\w*|m|cg|coord\w*)"),
    ("X", 3, r"(pos_?)?east(ing)?|pos_?e|utm_?e\w*|x_?cg(_tm)?|x_?o|xg|tx"),
    ("Y", 3, r"y|(pos(ition)?|loc(ation)?|local|enu|vicon|utm|map|odom|est)_?y(_pos\w*)?"),
    ("Y", 3, r"y_?(pos\w*|m|cg|coord\w*)"),
    ("Y", 3, r"(pos_?)?north(ing)?|pos_?n|utm_?n\w*|y_?cg(_tm)?|y_?o|yg|ty"),
    ("ax", 3, r"a_?x(_(body|cg|imu|vehicle))?|acc(el(eration)?)?_?x(_?(imu|body|cg))?|x_?acc\w*"),
    ("ax", 3, r"a_?lgt\d?|imu_a(cc\w*)?_?x"),
    ("ax", 2, r"ac_?x"),
    (
        "ax",
        3,
        r"(?!longitude|\w*(vel|speed|spd|pos|_min))"
        r"(g_?(force|sensor)_?|gps_|inline_?|a_?|acc\w*_?)?(long|lon|lng)\w*(_?(acc\w*|g|a))?",
    ),
    ("ax", 3, r"inline_?acc\w*|line?al_?(g|acc\w*)"),
    ("ax", 3, r"g_?(long|lon)|a_?long|a_?ego"),
    ("ay", 3, r"a_?y(_(body|cg|imu|vehicle))?|acc(el(eration)?)?_?y(_?(imu|body|cg))?|y_?acc\w*"),
    ("ay", 3, r"a_?lat\d?|imu_a(cc\w*)?_?y"),
    ("ay", 2, r"ac_?y"),
    ("ay", 3, r"(g_?force_?|gps_|a_?|acc\w*_?)?lat\w*_?(acc\w*|g|a|force)|g_?(force|sensor)_?lat\w*|g_?lat"),
    ("ay", 3, r"acc\w*_?lat\w*|a_?lat"),
    ("steering_wheel_angle", 3, r"(steering_?wheel|hand_?wheel|str?_?whl|sw)_?(angle|pos\w*|ang|a)?|swa"),
    ("steering_wheel_angle", 3, r"stw_?ang\w*|steer_?whl\w*"),
    ("steering_wheel_angle", 3, r"delta_?(d|h|hw|sw|driver|hand\w*)"),
    ("steering_wheel_angle", 3, r"steering_?wheel_?(angle_?)?\w*|lws_?angle|sas_?angle|wheel_?angle_?driver"),
    ("delta", 3, r"delta(_?(f|wheel|front|road))?|df|road_?wheel_?angle|rwa"),
    ("delta", 3, r"(steer(ing)?_?)?tire_?angle|tyre_angle|(m_)?front_?wheels?_?angle"),
    ("delta", 1, r"steer(ed|ing)?(_?(angle|ang|pos\w*|cmd|command|actual|measured|rad|input))?"),
    ("delta", 1, r"st_?angle|steering_?angle_?\d?"),
    ("T", 3, r"T|(wheel_?|total_?|axle_?|drive_?)?torque(_?(wheel\w*|total|cmd|command))?|tq"),
    ("T", 3, r"(t|m|tau)_?wheel(?!_?(sp|vel))\w*"),
    ("T", 3, r"axle_?trq|trq_?whl\w*"),
    ("wheel_torque", 3, rf"(pt_?)?(t|tq|torque|trq)_?(at_?w\w*|whl|wheel)?_?({'|'.join(_CORNER.values())})"),
    ("wheel_torque", 3, r"t_?wheel_?(fl|fr|rl|rr)"),
    ("wheel_torque", 3, r"my_?(wm|wc|dr)_?(l1|r1|l2|r2)"),
    ("throttle", 3, r"(ff_?)?thr(ottle)?(_?(p(os\w*|ed\w*)|cmd|\d|pct))?|acc(r|el)?_?ped\w*"),
    ("throttle", 3, r"accelerator(?!\w*(gradient|sign))\w*"),
    ("throttle", 3, r"gas(_ped\w*)?|tps|apps?\d?|aps|thrtl"),
    ("brake_pressure", 3, r"(p_?brake\w*|br(ake|k)_?pres(?!sed)\w*|fbp|rbp|brake_?line\w*|p_?brk\w*|mcp)"),
    ("brake", 3, r"brk?(ake)?(_?(p(os\w*|ed\w*)|cmd|pct|\d))?|brk_?pedl?\w*"),
    ("motor_current", 3, r"(motor_?|phase_?|iq_?)?current(_?motor)?|current_motor|i_?motor"),
    *(
        (
            f"wheel_speed_{c}",
            3,
            r"(wheel_?(speed_?|spd_?|vel\w*_?)?|w_?|ws_?|wspd_?|whl_?spd_?|v_?wheel_?|omega_?)?"
            rf"{p}(_?(whl[a-z]*|wheel[a-z]*|ws))?(_?(spd|speed))?",
        )
        for c, p in _CORNER.items()
    ),
)
_LETTERS = {("T", "N m"): "T", ("t", "N m"): "T", ("E", "m"): "X", ("e", "m"): "X", ("N", "m"): "Y", ("n", "m"): "Y"}
"""Single letters that only their unit makes clear."""
_COMPILED = tuple((channel, weight, re.compile(pattern)) for channel, weight, pattern in _RULES)
_MAKERS = frozenset("esp abs ecu can imu ins gps vbox obd ego odom mti oxts ff pf car vehicle vhcl".split())
"""Words in front that say which device measured, or that it is the car's."""
_JUDGED = {"innovation", "innovations", "innov", "innovs", "variances", "ratios", "inconsistency", "integ"}
"""Words of what an estimator says of measurements, whatever quantity its fields are called."""
_COMMAND_WORDS = frozenset(
    "cmd command ref target desired goal setpoint request reference plan planned predicted".split()
)
COMMANDED = ("delta", "T", "throttle", "brake", "brake_pressure")
"""Channels that a driver or a controller asks for: a command of any other one is no measurement of it."""
_NO_SOURCES = {
    *"other lead leader".split(),  # another car
    *"next old last first init initial start begin end".split(),  # another time
    *"mean avg average peak lim pred track centerline wall noise offset origin".split(),
}
"""Last words of what this car did not do there and then: no device measured it, however many names end so."""
_SEVERAL = 3
"""Channels whose names end with the same word, from which it says who measured and not what [1]; judgement."""
_COMMAND_IN_FRONT = "des"
"""Short for desired, in front of what is desired; elsewhere it is a French or German article."""


def words_of(name: str) -> list[str]:
    """Return the words of a name in lower case: camel case, blanks, dots and hyphens part them.

    Of a message's field its last part counts, or the topic where the field is only ``data``; of a field of a
    structure or a file (``imu.yawRate``) the last part, with the one before where the last only says a direction
    (``velocity.longitudinal``), or a wheel (``wheel_torque_nm.fl``), which then stands in front.
    """
    tail = name = _signal_of(unfolded(name))
    if name.startswith("/"):
        topic, tail = name.rsplit("/", 1)
        if tail.lower() in ("data", "value"):
            tail = topic.rsplit("/", 1)[-1]
    parts = re.split(r"(?<=[\w\]])\.(?=[A-Za-z])", _wheel_in_front(tail))
    # Of orientation.w the w alone says nothing.
    tail = "_".join(parts[-2:]) if len(parts[-1]) == 1 or _directs(parts) else parts[-1]
    tail = with_short_unit(tail)
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z][a-z])", "_", tail)
    return [word for word in re.split(r"[^A-Za-z0-9]+", spaced.lower()) if word]


def _signal_of(name: str) -> str:
    """Return a signal's name without its device, message or number, and without the field that holds its values.

    INCA has ``signal\\device:raster``, CAN ``M::s``, a scan tool the number of SAE J1979: ``0D - Vehicle Speed``.
    """
    bare = re.sub(r"^[0-9A-F]{2} - ", "", name.split("\\")[0] or name)
    bare = bare.rpartition("::")[2] or bare
    return bare if bare.startswith("/") else re.sub(r"(?<=\w)\.([Dd]ata|[Vv]alues?)$", "", bare)


def _wheel_in_front(address: str) -> str:
    """Return an address whose last part only names a wheel or axle, with that in front."""
    parts = address.split(".")
    if len(parts) > 1 and concepts_of(tokens_of(parts[-1]))[0] in [{place} for place in (*CORNERS, "front", "rear")]:
        parts[-2:] = [f"{parts[-1]}_{parts[-2]}"]
    return ".".join(parts)


def _directs(parts: list[str]) -> bool:
    """Tell whether the last part of an address only says along which axis the one before it is."""
    if len(parts) < 2:
        return False
    last = [word for word in tokens_of(parts[-1]) if word not in _UNIT_WORDS]
    own, before = concepts_of(last)[0], concepts_of(tokens_of(parts[-2]))[0]
    # A position.lat is a latitude, a displacement.lateral is none.
    moved = {"displacement", "displacements"} & set(tokens_of(parts[-2]))
    if concepts_of(last)[1]:
        return False  # w_z says more than a direction
    return (
        bool(own)
        and own <= {"long", "lat", "up", "yaw"}
        and bool(before & {"velocity", "acceleration", "rate"} or moved)
    )


def named_by_axis(infos: Sequence[RawChannelInfo]) -> dict[str, RawChannelInfo]:
    """Return elements of vectors of three as if they were called x, y and z: ``acc[1]`` as ``acc.y``.

    Those of wheels and joints are left out: they are counted, not directed.
    """
    vectors: dict[str, dict[int, RawChannelInfo]] = {}
    for info in infos:
        match = re.fullmatch(r"(.+)\[(\d+)\]", info.name)
        if match:
            vectors.setdefault(match[1], {})[int(match[2])] = info
    named = {}
    for listed, elements in vectors.items():
        # A list of values inside its quantity says nothing itself: acceleration.v of openpilot.
        bare = re.sub(r"(?<=\w)\.([vV]|[Vv]alues?|[Dd]ata)$", "", listed)
        whole = set(re.findall(r"[a-z]+", f"{bare} {elements[min(elements)].type_name}".lower()))
        counted = concepts_of(tokens_of(bare))[0] & {"wheel", "steer", "torque"} or {"joint", "jointstate"} & whole
        if set(elements) == {0, 1, 2} and not counted:
            named |= {info.name: replace(info, name=f"{bare}.{'xyz'[k]}") for k, info in elements.items()}
    return named


def named_without_source(infos: Sequence[RawChannelInfo]) -> dict[str, RawChannelInfo]:
    """Return columns whose last word says who measured, as if it were not there: ``x_opti`` as ``x``.

    A last word is a source if it is known as one, or ends the names of several channels. So is one beside it, as
    in ``vx_vesc`` beside ``vx_opti``. A name that means something else as it stands is left out.
    """
    ends: dict[str, dict[str, RawChannelInfo]] = {}  # by last word and stem
    for info in infos:
        *stem, word = words_of(info.name) or [""]
        other = concepts_of([word])[0] - {"engine"} or word in {*_UNIT_WORDS, *_JUDGED, *_NO_SOURCES}
        if stem and word.isalpha() and len(word) > 2 and not other and not info.name.startswith("/"):
            ends.setdefault(word, {})["_".join(stem)] = info
    bare = {(word, stem): replace(info, name=stem) for word, stems in ends.items() for stem, info in stems.items()}
    meant = {
        word: {m.channel for stem in stems for m in meanings(bare[word, stem])[:1]} for word, stems in ends.items()
    }
    sources = {word for word in ends if concepts_of([word]) == (set(), 1) or len(meant[word]) >= _SEVERAL}
    sources |= {word for word in ends if any(set(ends[word]) & set(ends[source]) for source in sources)}
    found = {}
    for word in sources:
        for stem, info in ends[word].items():
            own = {m.channel for m in meanings(info)}
            if not own or own == {m.channel for m in meanings(bare[word, stem])}:
                found[info.name] = bare[word, stem]
    return found


def stated_unit(info: RawChannelInfo) -> str | None:
    """Return the unit that the file states or that the name ends with; None where nobody says."""
    if info.unit and find_unit(info.unit):
        return find_unit(info.unit).symbol
    words = words_of(info.name)
    if _is_speed_by_unit(info.name):
        return find_unit(info.name).symbol
    if len(words) > 2 and tuple(words[-2:]) in _LAST_TWO:
        return _LAST_TWO[tuple(words[-2:])]
    if len(words) > 1 and words[-1] in _UNIT_WORDS:
        return _UNIT_WORDS[words[-1]]
    if words[:1] == ["g"] and concepts_of(words[1:])[0] <= {"acceleration", "long", "lat", "up"} and words[1:]:
        return "g"  # g_lat, g_force_lon
    return "rpm" if "rpm" in words or "rpm" in tokens_of(info.name) else None


def _own_part(info: RawChannelInfo) -> str:
    """Return the part of an address that names the quantity: the field of a message, else the whole name."""
    if not info.name.startswith("/"):
        return _wheel_in_front(_signal_of(info.name))
    topic, field = info.name.rsplit("/", 1)
    return _wheel_in_front(topic.rsplit("/", 1)[-1] if field.lower() in ("data", "value") else field)


def spelled_without_unit(info: RawChannelInfo) -> str:
    """Return the name without the unit that it ends with, parts joined by underscores, capitals kept."""
    words = [word for word in re.split(r"[^\w]+|_", with_short_unit(_own_part(info))) if word]
    lowered = [word.lower() for word in words]
    if len(words) > 2 and tuple(lowered[-2:]) in _LAST_TWO:
        return "_".join(words[:-2])
    if len(words) > 1 and lowered[-1] in _UNIT_WORDS:
        return "_".join(words[:-1])
    return "_".join(words)


def is_command(name: str) -> bool:
    """Tell whether a name says that it is what was asked for, not what was measured."""
    return "command" in concepts_of(tokens_of(name))[0]


def _is_speed_by_unit(name: str) -> bool:
    """Tell whether a column is called by nothing but a unit of speed: Knots, km/h.

    In brackets it is of a row of units, and fps counts frames.
    """
    unit = find_unit(name) if name[:1].isalpha() and name.lower() != "fps" else None
    return unit is not None and unit.si == "m/s"


def _said_by_unit(info: RawChannelInfo) -> list[str]:
    """Return the word that a unit stands for where the name leaves it out: M_Rad_VL in N m is a torque.

    What turns at a corner of the car, n_FL in rpm, is a wheel.
    """
    unit = find_unit(stated_unit(info) or "")
    if _is_speed_by_unit(info.name):
        return ["velocity"]
    if unit is not None and unit.si == "rad/s" and concepts_of(tokens_of(info.name))[0] & {*CORNERS}:
        return ["wheel"]
    return ["torque"] if unit is not None and unit.si == "N m" else []


def meanings(info: RawChannelInfo) -> tuple[Meaning, ...]:
    """Return the channels that the name of a signal fits, the clearest first."""
    if info.name.strip() == "T":
        return (Meaning("T", 3),)
    if info.name.strip() in ("t", "time"):
        return ()
    bare = spelled_without_unit(info)
    if (bare, stated_unit(info)) in _LETTERS:
        return (Meaning(_LETTERS[bare, stated_unit(info)], 2),)
    if info.name.startswith("/") and re.search(
        r"(orientation|rotation)(?!\W+yaw)|covariance|quaternion|header\.(seq|stamp)", info.name
    ):
        return ()
    if _JUDGED & set(tokens_of(info.name)):
        return ()
    words = words_of(info.name)
    spellings = {"_".join(words)}
    if len(words) > 2 and tuple(words[-2:]) in _LAST_TWO:
        spellings.add("_".join(words[:-2]))
    if len(words) > 1 and words[-1] in _UNIT_WORDS:
        spellings.add("_".join(words[:-1]))
    for spelling in [*spellings]:
        first, _, rest = spelling.partition("_")
        if rest and first in _MAKERS:
            spellings.add(rest)
    # What stands in brackets is a place or a source rather than a unit: "acc x (IMU)".
    found: dict[str, int] = {}
    for channel, weight, expression in _COMPILED:
        if any(expression.fullmatch(spelling) for spelling in spellings):
            found[channel] = max(found.get(channel, 0), weight)
    if not found:
        read = read_concepts([*tokens_of(bare), *_said_by_unit(info)])
        if read is None and info.name.count("/") > 1:
            # Of /eps/angle the field alone says nothing.
            read = read_concepts(tokens_of("_".join(info.name.rsplit("/", 2)[1:])))
        if read is None and info.group:
            # "Long" says nothing by itself, and under "Vehicle Acceleration" it does.
            read = read_concepts(tokens_of(f"{info.group} {bare}"))
        if read is not None:
            found[read[0]] = read[1]
    if {"wheel_torque", "T"} & set(found):
        of_all = concepts_of(tokens_of(bare))[0]
        if "brake" in of_all and "drive" not in of_all:
            found = {}  # its group says so: Brake.Trq_FL
    if _COMMAND_WORDS & set(words) or words[:1] == [_COMMAND_IN_FRONT]:
        found = {c: w for c, w in found.items() if c in COMMANDED}
    return tuple(Meaning(c, w) for c, w in sorted(found.items(), key=lambda entry: -entry[1]))
