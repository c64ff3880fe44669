"""What the words of a recorded name mean together: quantity, direction, object, in several languages.

A name is taken apart into words, compounds too (``WhlSpdFL``, ``Querbeschleunigung``, ``横摆角速度``). Each word
stands for a concept; the set of concepts decides the channel. Words that say who measured, where or how well are
neutral.
"""

import re
import unicodedata
from functools import lru_cache
from itertools import pairwise

_WORDS: dict[str, str] = {
    "velocity": (
        "v vel velo velocity velocities velocidad velocita speed speeds spd speedo speedometer tacho vss vitesse "
        "geschwindigkeit geschw fahrgeschwindigkeit 车速 速度"
    ),
    "acceleration": (
        "a acc acl accel accelerometer acceleration "
        "accelerations beschleunigung beschl gforce aceleracion accelerazione 加速度"
    ),
    "rate": ("rate rates rt rot rotationrate gyro gyr gyroscope omega dot punkt drehrate geschwindigkeitsrate 角速度"),
    "angular": "angular",
    "rotation": "rotation rotacion rotazione",
    "yaw": "yaw psi heading hdg gier lacet guinada imbardata 横摆 航向",
    "angle": "angle angles ang winkel angulo angolo 角 角度 转角",
    "position": (
        "pose pos posn position center centre loc location coordinate coord displacement displacements 位置 坐标"
    ),
    "long": (
        "x xv long longi longitudinal longitudinale lng lngt lgt fwd forward forwards surge inline lineal laengs 纵向"
    ),
    "lat": (
        "y yv lat lateral laterale side sideways sway quer transverse transversal transversale trasversale 侧向 横向"
    ),
    "up": "z zv vert vertical heave up down hoch",
    "linear": "linear lin",
    "steer": "steer steered steering eps str strg lenk 转向 lenkung braquage direccion sterzo sterzata",
    "handwheel": "handwheel lws lrw lenkrad stw swa sw msw volant volante 方向盘 转向盘",
    "wheel": "wheel wheels whl whls roadwheel roue roues rueda ruedas ruota ruote 轮 车轮",
    "road": "road tire tyre",
    "torque": "torque torques trq tq moment mom drehmoment couple par coppia 转矩 扭矩 力矩",
    "brake": "brake brakes freinage frenata frenado braking brk brems bremse frein freins freno freni 制动 刹车",
    "pressure": "pressure press pres prs druck pression presion pressione 压力",
    "throttle": (
        "throttle thr thrt gas accelerator app tps fahrpedal gaspedal accelerateur acelerador acceleratore 油门"
    ),
    "pedal": "pedal ped 踏板",
    "engine": "engine eng motor mot mgu vesc gearbox transmission getriebe kurbelwelle 发动机 电机",
    "current": "current curr strom",
    "drive": "drive drv antrieb antriebs total sum axle axles powertrain net gesamt summe 总 驱动",
    "slip": "slip sideslip beta schwimm bodyslip derive deriva assetto 侧偏",
    "east": "east easting ost ostwert rechtswert",
    "north": "north northing nord nordwert hochwert",
    "world": "world map global earth inertial utm enu ned ground over abs",
    "fl": "fl lf l1 vl wfl cfl",
    "fr": "fr rf r1 vr wfr cfr",
    "rl": "rl lr lb l2 hl wrl crl",
    "rr": "rr rb r2 hr wrr crr",
    "front": "front frnt avant anteriore delantera delantero vorn vorne vorder vorderachse va 前",
    "rear": "rear hinten arriere posteriore trasera trasero hinter hinterachse ha 后",
    "left": "left gauche sinistra sinistro izquierda izquierdo links 左",
    "right": "right droite droit destra destro derecha derecho rechts 右",
    "command": (
        "cmd cmded command commanded commands demand demanded dmd request requested req desired target "
        "goal setpoint reference ref plan planned predicted soll sollwert 目标 期望 指令"
    ),
    "other": (
        "std stddev sigma cov covariance var variance err error accuracy quality status valid validity "
        "hacc vacc sacc eph epv flag sign vorzeichen vz count cnt counter id seq index "
        "min max limit bias temp temperature lap age confidence jerk "
        "roll rolling pitch pitching tilt bank bearing course slope grade altitude height kappa curvature "
        "radius distance dist combined combo gear ratio level battery voltage power fuel lean satellites "
        "sats hdop aax aay aaz residual spring damper jounce suspension steps engine_speed orientation quaternion "
        "roulis tangage rollio beccheggio balanceo cabeceo wank nick "
        "quat relative opp opponent rival obstacle ghost prev previous"
    ),
    "driver": "driver fahrer",
    "user": "user pilot",
    "velocity long": "vx vlong vlon vlgt vfwd vlaengs",
    "velocity lat": "vy vlat vquer vq",
    "acceleration long": "ax along alon algt alaengs",
    "acceleration lat": "ay alat aquer",
    "yaw rate": "wz avz psip yr yawrate psidot psipunkt dpsi",
    "velocity wheel": "rotv radgeschw radgeschwindigkeit raddrehzahl",
    "angular long": "avx",
    "angular lat": "avy",
    "torque wheel": "radmoment radmomente raddrehmoment",
    "steer road angle": "radlenkwinkel vorderradlenkwinkel spurwinkel 前轮转角",
    "pedal acceleration": "加速踏板",
    "position long": "px xpos",
    "position lat": "py ypos",
    "": (
        "car vehicle veh vhcl ego body chassis cg cog com cm sensor sens meas measured act actual est "
        "estimated estimate filt filtered filter raw ins imu gps gnss dgps odo odom odometry vbox ecu can "
        "obd esp abs1 state states signal sig value val fused kf ekf ukf local frame field header twist "
        "pf amcl slam msg fahrzeug ist corr corrected mti oxts novatel vicon optitrack mocap rt3000 "
        "of in the at from to s de del des di du la le au aux della sm tm ii 2d "
        "3d dev device coor sys e1 sim simulated model true truth gt log data input "
        "output feedback scene stellung stand rohwert wert 车辆 车身 质心 开度 实际 测量"
    ),
}
_OF_OTHER_SCRIPTS: dict[str, str] = {
    "velocity": "車速 скорость скорости",
    "acceleration": "ускорение",
    "angular": "угловая",
    "rate": "レート レイト",
    "yaw": "ヨー ヨーイング 方位 рыскания рыскание",
    "angle": "угол",
    "position": "координата",
    "long": "前後 продольное продольная",
    "lat": "横 поперечное поперечная боковое",
    "steer": "操舵 舵角",
    "handwheel": "ハンドル ステアリング руля руль рулевого",
    "wheel": "車輪 колеса колесо",
    "torque": "トルク момент",
    "brake": "ブレーキ тормоза тормоз",
    "throttle": "アクセル дроссель",
    "": "поворота 車両",
}
"""The same in Japanese and Russian."""
_CONCEPT = {
    word: concept for table in (_WORDS, _OF_OTHER_SCRIPTS) for concept, words in table.items() for word in words.split()
}
CORNERS = ("fl", "fr", "rl", "rr")
_FOLD = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "ψ": "psi", "β": "beta", "δ": "delta"})
_PARTS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
_VOICED = "\u3099\u309a"
"""Marks that make other syllables of Japanese ones, no accents."""
_SIDES = ("left", "right")
_AXES = ("x", "y", "z")


def unfolded(name: str) -> str:
    """Return a name with umlauts as two letters, and the Greek letters of the field as words."""
    return re.sub(r"[ÄÖÜ]", lambda m: {"Ä": "Ae", "Ö": "Oe", "Ü": "Ue"}[m[0]], name).translate(_FOLD)


def tokens_of(name: str) -> list[str]:
    """Return the words of a name in lower case; compounds of known words are parted, others stay whole."""
    folded = unfolded(name)
    folded = re.sub(r"(?i)(?<![a-z])g[-_ ]?force", "gforce", folded)
    folded = "".join(
        ch for ch in unicodedata.normalize("NFKD", folded) if ch in _VOICED or not unicodedata.combining(ch)
    )
    folded = unicodedata.normalize("NFC", folded)
    found: list[str] = []
    for piece in re.findall(r"[A-Za-z0-9]+|[\u0400-\u04ff]+|[\u3040-\u30ff\u4e00-\u9fff]+", folded):
        if "\u0400" <= piece[0] < "\u0500":
            found.append(piece.lower())
            continue
        if piece[0] > "\u303f":
            found += _of_characters(piece)
            continue
        # L1 is a wheel and FL a corner: what is a word as it stands is not parted at its capitals.
        if piece.lower() in _CONCEPT:
            found.append(piece.lower())
            continue
        for part in _PARTS.findall(piece):
            found += _segmented(part.lower())
    return [word for word in found if not word.isdigit()]


def _of_characters(piece: str) -> list[str]:
    """Return the words of a name written without blanks, each time the longest that is known."""
    found, rest = [], piece
    while rest:
        size = next((n for n in range(min(len(rest), 8), 0, -1) if rest[:n] in _CONCEPT), 1)
        found.append(rest[:size])
        rest = rest[size:]
    return found


@lru_cache(maxsize=4096)
def _segmented(word: str) -> tuple[str, ...]:
    """Return a word as known words in a row, the fewest; whole where that does not go up.

    Inside a compound a word has three letters or more, a corner or ``sw`` two, and an axis one, at an end.
    """
    if word in _CONCEPT or len(word) > 40:
        return (word,)
    best: list[tuple[str, ...] | None] = [(), *[None] * len(word)]
    for end in range(1, len(word) + 1):
        for start in range(end):
            head, part = best[start], word[start:end]
            is_axis = part in _AXES and end == len(word) and start > 2
            fits = part in _CONCEPT and (len(part) > 2 or part in (*CORNERS, "rt", "tq") or is_axis)
            # German joins words with an s.
            if part == "s" and start > 0 and end < len(word):
                fits = True
            if head is not None and fits and (best[end] is None or len(head) + 1 < len(best[end] or ())):
                best[end] = (*head, part)
    return best[-1] or (word,)


def _with_joined_corners(words: list[str]) -> list[str]:
    """Return words with two letters for an axle and one for a side as the corner: FrL, ReR."""
    ends, sides = {"fr": "f", "re": "r"}, ("l", "r")
    joined = [ends[a] + b for a, b in pairwise(words) if a in ends and b in sides]
    if len(joined) != 1:
        return words
    at = next(n for n, (a, b) in enumerate(pairwise(words)) if a in ends and b in sides)
    return [*words[:at], joined[0], *words[at + 2 :]]


def concepts_of(words: list[str]) -> tuple[set[str], int]:
    """Return what the words stand for, and how many are not known."""
    words = _with_joined_corners(words)
    known = [_CONCEPT[word] for word in words if word in _CONCEPT]
    concepts = {concept for entry in known for concept in entry.split()}
    if {"steer", "driver"} <= concepts:
        concepts = (concepts - {"steer"}) | {"handwheel"}
    if words[:1] == ["a"] and "steer" in concepts:
        # In front of it, a is the letter of angles (aSteer beside nYaw and vCar).
        concepts = (concepts - {"acceleration"}) | {"angle"}
    known_words = len(known)
    if "delta" in words and concepts == {"command"}:
        # The letter of the steer angle; beside a quantity it is a difference.
        concepts, known_words = {"steer", "road", "command"}, known_words + 1
    if "vesc" in words and "velocity" in concepts:
        # The speed that a motor controller tells is the car's, if the trial against other channels agrees.
        concepts = concepts - {"engine"}
    if {"axle", "axles"} & set(words):
        # An axle has two ends and no corners: AxleTrqFr, AxleTrqRr.
        ends = {"fr": "front", "rr": "rear"}
        concepts = {ends.get(concept, concept) for concept in concepts}
    if concepts & {"front", "rear"} and (letter := {"l", "r"} & set(words)):
        # Angle_Wheel_Front_L: beside an axle a letter is a side.
        concepts |= {"left" if word == "l" else "right" for word in letter}
        known_words += len(letter)
    for end in ("front", "rear"):
        for hand in ("left", "right"):
            if {end, hand} <= concepts:
                concepts -= {end, hand}
                concepts.add(end[0] + hand[0])
    if "rpm" in words and concepts & {*CORNERS}:
        concepts, known_words = concepts | {"wheel"}, known_words + 1  # what turns at a corner is a wheel
    if {"steer", "wheel"} <= concepts and not concepts & {"road", "front", *CORNERS}:
        concepts = (concepts - {"steer", "wheel"}) | {"handwheel"}
    if "rotation" in concepts:
        # Of an axis it is a rate; the rotation called yaw is an angle beside pitch and roll (CARLA).
        concepts = (concepts - {"rotation"}) | {"angle" if "yaw" in concepts else "rate"}
    if "roadwheel" in words:
        concepts |= {"road"}
    return concepts, len(words) - known_words


def place_and_rest(name: str) -> tuple[str, tuple[str, ...]]:
    """Return the wheel or axle that a name is of, empty where it says none, and its other words."""
    words = tokens_of(name)
    place = next(iter(sorted(concepts_of(words)[0] & {*CORNERS, "front", "rear"})), "")
    rest = tuple(w for w in words if _CONCEPT.get(w) not in (*CORNERS, "front", "rear", *_SIDES))
    return place, rest


def read_concepts(words: list[str]) -> tuple[str, int] | None:
    """Return the channel that a name's words fit and how clearly (3 clear, 1 vague); None where none.

    A command is a command of an input: steering, torque or a pedal.
    """
    if words[-1:] == ["status"] and len(words) > 1:
        # What a bus calls the status of a quantity may be its value; few values show a flag (`Trial.unusable`).
        said = read_concepts(words[:-1])
        return said and (said[0], 1)
    concepts, unknown = concepts_of(words)
    if not concepts or "other" in concepts:
        return None
    found = _motion(concepts) or _input(concepts)
    # An x beside words that nobody knows is an axis of anything.
    if found is None and not unknown and "x" in words and concepts <= {"long", "world"}:
        found = "X", 2
    if found is None and not unknown and "y" in words and concepts <= {"lat", "world"}:
        found = "Y", 2
    if found is None:
        return None
    channel, weight = found
    if unknown and channel == "delta" and concepts <= {"user", "angle"}:
        return None  # an angle of something else
    if channel == "vx" and weight == 1 and {"n", "e", "d", "u"} & set(words):
        return None  # along north, east, down or up
    inputs = (
        "delta",
        "steering_wheel_angle",
        "T",
        "wheel_torque",
        "axle_torque",
        "throttle",
        "brake",
        "brake_pressure",
    )
    if "command" in concepts and channel not in inputs:
        return None
    if "absolute" in words and channel in ("vy", "r", "ax", "ay"):
        return None  # a size without its sign
    return channel, max(weight - min(unknown, 2), 1)


def _motion(c: set[str]) -> tuple[str, int] | None:
    """Return velocity, acceleration, yaw, yaw rate, position or wheel speed; see `read_concepts`."""
    corner = next((name for name in CORNERS if name in c), None)
    if c & {"steer", "handwheel", "torque", "throttle", "brake", "pressure", "current", "engine"}:
        return None
    if corner is not None:
        return (f"wheel_speed_{corner}", 3) if _spins(c) else None
    turning = "yaw" in c or ("up" in c and bool(c & {"rate", "angular"} or {"angle", "velocity"} <= c))
    if "acceleration" in c:
        return _acceleration(c)
    if turning and c & {"rate", "velocity", "angular"}:
        return ("r", 3) if not c & {"long", "lat"} else None
    if c == {"angle", "up"}:
        return "r", 1  # one of angX, angY, angZ, which is a rate beside an angle of its own name
    if "yaw" in c:
        return ("yaw", 3) if c <= {"yaw", "angle", "world", "position", "north"} else None
    if "rate" in c or "angular" in c or "angle" in c:
        return ("sideslip", 3) if "slip" in c and "rate" not in c else None
    if "slip" in c:
        return ("sideslip", 2) if c <= {"slip", "angle"} else None
    if "velocity" in c or "linear" in c:
        return _velocity(c)
    return _position(c)


def _spins(c: set[str]) -> bool:
    """Whether the words of a wheel are its spin: its rate about the lateral axis (CarSim: AVy_L1)."""
    other = "angle" in c or "angular" in c and c & {"long", "up", "acceleration"}
    return {"angular", "lat"} <= c or ("velocity" in c or "wheel" in c) and not other


def _acceleration(c: set[str]) -> tuple[str, int] | None:
    if c & {"angular", "yaw", "up"}:
        return None
    if c == {"acceleration"}:
        return "ax", 1
    return ("ax", 3) if "long" in c else ("ay", 3) if c & {"lat", *_SIDES} else None


def _position(c: set[str]) -> tuple[str, int] | None:
    if c & {"east", "north"}:
        return ("X", 3) if "east" in c else ("Y", 3)
    if "position" in c:
        return ("X", 3) if "long" in c else ("Y", 3) if "lat" in c else None
    return None


def _velocity(c: set[str]) -> tuple[str, int] | None:
    if c & {"up", "wheel", "east", "north"}:
        return None
    if "world" in c and c & {"long", "lat"}:
        return None  # along the axes of the world, not the car's
    if "long" in c:
        return "vx", 3
    if c & {"lat", *_SIDES}:
        return "vy", 3
    return ("vx", 1) if "velocity" in c and "world" not in c else None


def _input(c: set[str]) -> tuple[str, int] | None:
    """Return steering, torque, pedal or pressure; see `read_concepts`."""
    corner = next((name for name in CORNERS if name in c), None)
    if "pressure" in c:
        return ("brake_pressure", 3) if "brake" in c else None
    if "torque" in c:
        return _torque(c, corner)
    if c & {"rate", "velocity", "acceleration", "slip"}:
        return None
    if "handwheel" in c:
        return "steering_wheel_angle", 3
    if "steer" in c or ("angle" in c and ("road" in c or ("wheel" in c and corner is not None))):
        if corner in ("rl", "rr") or "rear" in c:
            return None
        clear = "road" in c or corner is not None or "front" in c
        return "delta", 3 if clear else 1
    if "angle" in c and c <= {"user", "angle"}:
        return "delta", 1  # an angle of no more words is that of the steering, where it follows the path
    if "throttle" in c or {"long", "pedal"} <= c or {"acceleration", "pedal"} <= c:
        return "throttle", 3
    if "brake" in c:
        return "brake", 2
    if {"engine", "current"} <= c:
        return "motor_current", 2
    return None


def _torque(c: set[str], corner: str | None) -> tuple[str, int] | None:
    if c <= {"torque", "engine"} and "engine" in c:
        return "engine_torque", 3
    if c & {"steer", "handwheel", "yaw"} or ("engine" in c and not c & {"wheel", "road"}):
        return None  # the driver's hand, or before the gearbox
    if "brake" in c and "drive" not in c:
        return None
    if corner is not None:
        return "wheel_torque", 3
    if c & {"front", "rear"}:
        return "axle_torque", 3
    return "T", 3 if c & {"wheel", "drive"} else 2
