"""The channels of a drive and the units logs come in. Imports only `errors`.

Frames and signs are ISO 8855 at the centre of gravity: x forward, y left, z up, yaw counter-clockwise
positive. A left turn has positive steer angle, yaw rate and lateral acceleration; driving torque is positive.
"""

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from split_cli.errors import MapError, nearest_names

Kind = Literal["continuous", "held", "angle"]
STANDARD_GRAVITY = 9.80665  # [m/s^2], by definition (CGPM, 1901)


@dataclass(frozen=True)
class Channel:
    """One canonical channel of a drive.

    Attributes
    ----------
    name : str
        Column name in the drive file.
    unit : str
        SI unit.
    kind : {"continuous", "held", "angle"}
        How it is resampled: continuous signals are low-passed before decimation and interpolated, held ones
        (commands) keep their last value, angles are unwrapped first.
    meaning : str
        What it is, with frame and sign.
    limit : float
        A greater magnitude is no measurement of anything on wheels but a damaged number: far beyond what a wrong
        unit makes of one, so that wrong units are still named as such.
    """

    name: str
    unit: str
    kind: Kind
    meaning: str
    limit: float = 1e9


CHANNELS: dict[str, Channel] = {
    channel.name: channel
    for channel in (
        Channel("t", "s", "continuous", "time from the first sample of the recording's uniform clock", 1e15),
        Channel("X", "m", "continuous", "position of the CG, world frame, east or along the map's X"),
        Channel("Y", "m", "continuous", "position of the CG, world frame, north or along the map's Y"),
        Channel("yaw", "rad", "angle", "yaw angle, counter-clockwise from X, unwrapped", 1e6),
        Channel("vx", "m/s", "continuous", "longitudinal velocity of the CG, forward positive", 1e5),
        Channel("vy", "m/s", "continuous", "lateral velocity of the CG, left positive", 1e5),
        Channel("r", "rad/s", "continuous", "yaw rate, counter-clockwise positive", 1e4),
        Channel("T", "N m", "held", "total torque at the wheels, driving positive, braking negative"),
        Channel("delta", "rad", "held", "road-wheel steer angle, left positive", 1e4),
        Channel("ax", "m/s^2", "continuous", "longitudinal specific force at the CG, in the vehicle plane", 1e6),
        Channel("ay", "m/s^2", "continuous", "lateral specific force at the CG, left positive", 1e6),
    )
}

REQUIRED_CHANNELS = ("vx", "vy", "r", "T", "delta")


@dataclass(frozen=True)
class Unit:
    """A unit and its way to SI: SI value = factor * value + offset.

    Attributes
    ----------
    symbol : str
        How it is written here.
    si : str
        The SI unit it converts to.
    """

    symbol: str
    si: str
    factor: float
    offset: float = 0.0


_DEGREE = np.pi / 180.0
_POUND_FORCE = 4.4482216152605

# Each unit with its other spellings. Superscripts and dots are folded before the look-up.
_UNIT_TABLE: tuple[tuple[Unit, str], ...] = (
    (Unit("s", "s", 1.0), "sec second seconds с сек"),
    (Unit("ms", "s", 1e-3), "msec millisecond milliseconds мс"),
    (Unit("us", "s", 1e-6), "μs usec microseconds"),
    (Unit("0.1ms", "s", 1e-4), "100us"),
    (Unit("0.1us", "s", 1e-7), "100ns"),
    (Unit("ns", "s", 1e-9), "nsec nanoseconds"),
    (Unit("min", "s", 60.0), "minutes"),
    (Unit("d", "s", 86400.0), "day days"),
    (Unit("m", "m", 1.0), "metre metres meter meters м"),
    (Unit("mm", "m", 1e-3), ""),
    (Unit("cm", "m", 1e-2), ""),
    (Unit("km", "m", 1e3), ""),
    (Unit("ft", "m", 0.3048), "feet foot"),
    (Unit("in", "m", 0.0254), "inch"),
    (Unit("m/s", "m/s", 1.0), "mps m/sec ms-1 m.s-1 м/с"),
    (Unit("km/h", "m/s", 1.0 / 3.6), "kmh kph kmph km/hr км/ч"),
    (Unit("mph", "m/s", 0.44704), "mi/h miles/h"),
    (Unit("kn", "m/s", 1852.0 / 3600.0), "knot knots kt"),
    (Unit("ft/s", "m/s", 0.3048), "fps ftps ft/sec"),
    (Unit("rad", "rad", 1.0), "radian radians рад"),
    (Unit("mrad", "rad", 1e-3), ""),
    (Unit("deg", "rad", _DEGREE), "° degree degrees град"),
    (Unit("cdeg", "rad", 1e-2 * _DEGREE), "centideg centidegrees"),
    (Unit("arcmin", "rad", _DEGREE / 60.0), "arcminute arcminutes \u2032"),
    (Unit("arcsec", "rad", _DEGREE / 3600.0), "arcsecond arcseconds \u2033"),
    (Unit("gon", "rad", np.pi / 200.0), ""),
    (Unit("mil", "rad", np.pi / 3200.0), "mils"),  # of NATO, 6400 to the turn
    (Unit("semicircle", "rad", np.pi / 2.0**31), "semicircles"),  # of receivers, a half turn in 32 bits
    (Unit("rev", "rad", 2.0 * np.pi), "turn turns revolution revolutions"),
    (Unit("rad/s", "rad/s", 1.0), "radps rad/sec rad.s-1 рад/с"),
    (Unit("deg/s", "rad/s", _DEGREE), "degps °/s deg/sec deg.s-1 dps град/с"),
    (Unit("mdeg/s", "rad/s", 1e-3 * _DEGREE), "mdps milli-dps millidps"),
    (Unit("rpm", "rad/s", 2.0 * np.pi / 60.0), "1/min rev/min U/min min-1"),
    (Unit("m/s^2", "m/s^2", 1.0), "м/с2 м/с^2 m/s2 mps2 mpss m/s/s m/sec2 m/sec^2 ms-2 m.s-2"),
    (Unit("g", "m/s^2", STANDARD_GRAVITY), "gn G g's g-force"),
    (Unit("mg", "m/s^2", 1e-3 * STANDARD_GRAVITY), "milli-g millig mG"),
    (Unit("rad/s^2", "rad/s^2", 1.0), "rad/s2 radps2 rad.s-2"),
    (Unit("deg/s^2", "rad/s^2", _DEGREE), "deg/s2 degps2 °/s2"),
    (Unit("N m", "N m", 1.0), "Нм Н.м Nm N.m N-m newtonmetre newtonmeter newton-m newton-metre newton-meter"),
    (Unit("N mm", "N m", 1e-3), "Nmm N.mm N-mm newton-mm newtonmillimetre newtonmillimeter"),
    (Unit("kN m", "N m", 1e3), "kNm kN.m"),
    (Unit("kgf m", "N m", STANDARD_GRAVITY), "kgfm kgf.m kgf-m"),
    (Unit("lbf in", "N m", _POUND_FORCE * 0.0254), "lbin in-lb in-lbf inlb lbf.in lb-in"),
    (Unit("lbf ft", "N m", _POUND_FORCE * 0.3048), "lbft ft-lb ft-lbf ftlb lbf.ft lbf-ft lb-ft lb.ft"),
    (Unit("N", "N", 1.0), "newton"),
    (Unit("kN", "N", 1e3), ""),
    (Unit("lbf", "N", _POUND_FORCE), ""),
    (Unit("kg", "kg", 1.0), ""),
    (Unit("Pa", "Pa", 1.0), "pascal"),
    (Unit("kPa", "Pa", 1e3), ""),
    (Unit("MPa", "Pa", 1e6), ""),
    (Unit("bar", "Pa", 1e5), ""),
    (Unit("psi", "Pa", 6894.757293168), ""),
    (Unit("A", "A", 1.0), "amp ampere"),
    (Unit("V", "V", 1.0), "volt"),
    (Unit("%", "1", 1e-2), "percent pct"),
    (Unit("1", "1", 1.0), "- none unitless ratio"),
    (Unit("degC", "K", 1.0, 273.15), "°c c celsius"),
    (Unit("K", "K", 1.0), "kelvin"),
)


UNITS: tuple[Unit, ...] = tuple(unit for unit, _ in _UNIT_TABLE)

# Spellings that are in use with two meanings; case folding must not settle them, and none is a safe guess.
_AMBIGUOUS = {
    "rps": "Write rad/s, or rpm with scale: 60 for revolutions a second.",
    "rads": "Write rad or rad/s.",
    "degs": "Write deg or deg/s.",
    "mPa": "Write MPa or kPa.",
    "M": "Write m.",
    "Ms": "Write ms or s.",
    "MS": "Write ms or m/s.",
    "Kn": "Write kN or knots.",
    "KN": "Write kN or knots.",
}
_FOLDED_SIGNS = str.maketrans({"²": "2", "⁻": "-", "¹": "1", "·": ".", "⋅": ".", "*": ".", "µ": "μ", "º": "°"})


def _spelling(symbol: str) -> str:
    # A degree or a square in UTF-8 that was read as Western European has a letter in front.
    bare = re.sub(r"\s+|Â(?=[°²³·µ])", "", symbol.strip()).strip("[](){}").replace("**", "^")
    return bare.translate(_FOLDED_SIGNS)


_BY_EXACT: dict[str, Unit] = {}
_BY_FOLDED: dict[str, Unit] = {}
for _unit, _aliases in _UNIT_TABLE:
    for _name in (_unit.symbol, *_aliases.split()):
        _BY_EXACT[_spelling(_name)] = _unit
        # The exact spelling comes first, so m and M or g and G stay apart where case has a meaning.
        _BY_FOLDED.setdefault(_spelling(_name).lower(), _unit)


def find_unit(symbol: str) -> Unit | None:
    """Return the unit written `symbol`, or None when it is not known or has two meanings."""
    spelled = _spelling(symbol)
    if spelled in _AMBIGUOUS:
        return None
    return _known_unit(spelled) or (_known_unit(in_words) if (in_words := _from_words(spelled)) else None)


def _known_unit(spelled: str) -> Unit | None:
    known = _BY_EXACT.get(spelled) or _BY_FOLDED.get(spelled.lower())
    return known or _quotient(spelled) or _part_of_ten(spelled) or _by_negative_power(spelled)


_NEGATIVE_POWER = re.compile(r"(?P<above>.*[^.^/-])\.?(?P<below>s|sec|h|hr|min)\^?-(?P<power>[12])", re.IGNORECASE)


def _by_negative_power(spelled: str) -> Unit | None:
    """Return a length or an angle times a negative power of a time: km.h-1, rad s^-1, m.s-2."""
    found = _NEGATIVE_POWER.fullmatch(spelled)
    if found is None:
        return None
    quotient = f"{found['above']}/{found['below']}{'2' if found['power'] == '2' else ''}"
    return _BY_EXACT.get(quotient) or _BY_FOLDED.get(quotient.lower()) or _quotient(quotient)


_PART_OF_TEN = re.compile(r"(1e-\d{1,2}|0\.0*1)([^\d.].*)", re.IGNORECASE)
"""A power of ten before a unit, of a step that a whole number counts: 1e-7deg, 0.01 m/s."""


def _part_of_ten(spelled: str) -> Unit | None:
    found = _PART_OF_TEN.fullmatch(spelled)
    unit = _known_unit(found[2]) if found else None
    if found is None or unit is None or unit.offset:
        return None
    return Unit(f"{float(found[1]):g} {unit.symbol}", unit.si, float(found[1]) * unit.factor)


#: Words within a unit's name. Some lack letters, since bus databases cut names (``Unit_MeterPerSeconSquar``).
_WORDS_OF_UNITS = {
    word: symbol
    for symbol, words in {
        "%": "percent",
        "k": "kilo",
        "m": "milli metre meter",
        "c": "centi",
        "deg": "degreeofarc degreofarc",
        "rad": "radian radia",
        "s": "second secon",
        "h": "hour",
        "min": "minute minut",
        "^2": "squared square squar",
        "N": "newton newto",
        "bar": "bar",
        "/": "per",
        "g": "forceofgravi",
    }.items()
    for word in words.split()
}
_PARTS_OF_UNITS = re.compile("|".join(sorted(_WORDS_OF_UNITS, key=len, reverse=True)))


def _from_words(spelled: str) -> str:
    """Return the symbol of a unit in words, as in bus databases (``Unit_KiloMeterPerHour``), or nothing."""
    bare = re.sub("^unit_?", "", spelled.lower())
    parts = _PARTS_OF_UNITS.findall(bare)
    return "".join(_WORDS_OF_UNITS[part] for part in parts) if len("".join(parts)) == len(bare) else ""


_SPANS = {
    **dict.fromkeys(("s", "sec", "second"), 1.0),
    "ms": 1e-3,
    **dict.fromkeys(("min", "minute"), 60.0),
    **dict.fromkeys(("h", "hr", "hour"), 3600.0),
}


def _quotient(spelled: str) -> Unit | None:
    """Return a length or an angle per time (``mm/s``, ``degrees/sec``), or per time squared (``mm/s^2``)."""
    above, _, below = spelled.lower().partition("/")
    bare = re.sub(r"\^?2$", "", below)
    length = _BY_FOLDED.get(above)
    if length is None or length.si not in ("m", "rad") or bare not in _SPANS:
        return None
    power = 1 if bare == below else 2
    per = "/s" if power == 1 else "/s^2"
    known = next((u for u in UNITS if u.si == length.si + per and u.symbol == length.symbol + per), None)
    if known is not None and _SPANS[bare] == 1.0:
        return known
    symbol = f"{length.symbol}/{bare}{'^2' if power == 2 else ''}"
    return Unit(symbol, length.si + per, length.factor / _SPANS[bare] ** power)


def convert_to_si(
    values: np.ndarray, unit: str, *, expected: str | None = None, channel: str = "it", where: str | None = None
) -> np.ndarray:
    """Convert an array from `unit` to the SI unit of the same quantity.

    Parameters
    ----------
    values : ndarray
        Any shape.
    unit : str
        A symbol of this module's table, for example ``km/h``.
    expected : str, optional
        The SI unit that the result must be in.
    channel : str
        What the values are, for the error.
    where : str, optional
        What to name in the error.

    Raises
    ------
    MapError
        If the unit is not known, has two meanings, or measures another quantity; never guessed.
    """
    found = find_unit(unit)
    if found is None:
        spelled = _spelling(unit)
        if spelled in _AMBIGUOUS:
            raise MapError(f"the unit {unit!r} has two meanings", where=where, advice=_AMBIGUOUS[spelled])
        advice = nearest_names(unit, [entry.symbol for entry in UNITS])
        raise MapError(f"unknown unit {unit!r}", where=where, advice=advice)
    if expected is not None and found.si != expected:
        raise MapError(f"{found.symbol} is a unit of {found.si}, {channel} is in {expected}", where=where)
    values = np.asarray(values, dtype=float)
    if found.factor == 1.0 and found.offset == 0.0:
        return values
    return values * found.factor + found.offset


_FULL_WIDTH = {code: code - 0xFEE0 for code in range(0xFF01, 0xFF5F)} | {0x3000: " ", 0x3010: "[", 0x3011: "]"}
"""Signs as wide as a Chinese or Japanese character, brackets among them, by the usual ones."""
_BARRED = re.compile(r'"?(?P<name>[^"|]+)"?\|"?(?P<unit>[^"|]*)"?(\|[-+.\deE]*)+')
_BRACKETED = re.compile(r"^(?P<name>.*?)\s*[\(\[](?P<unit>[^()\[\]]*)[\)\]]\s*$")
_BEHIND = re.compile(r"^(?P<name>.*\S)(?:\s*,\s+|\s+in\s+|\s+/\s+)(?P<unit>[^\s,]+)$")
"""A unit behind a comma, behind "in", or as divisor of its quantity (DIN 1313): ``Yaw rate, deg/s``, ``v / m/s``."""
TWO_WORDS = {
    "m_s": "m/s",
    "m_s2": "m/s^2",
    "km_h": "km/h",
    "cm_s": "cm/s",
    "mm_s": "mm/s",
    "ft_s": "ft/s",
    "rad_s": "rad/s",
    "deg_s": "deg/s",
    "mrad_s": "mrad/s",
}
"""Units as the two last words of a name (``v_y_cm_s``), whose last alone would be another."""
_PER = re.compile(
    r"(?P<name>.*(?:_|(?<=[a-z0-9])(?=[A-Z])))(?P<above>[A-Za-z]+?)_?[Pp]er_?(?P<below>[A-Za-z]+?)"
    r"(?P<square>_?(?:2|[Ss]q(?:uared)?))?"
)
_SHORT = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("km", "kilometer", "kilometers", "kilometre", "kilometres"), "km"),
    **dict.fromkeys(("ft", "foot", "feet"), "ft"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("deg", "degree", "degrees"), "deg"),
    **dict.fromkeys(("s", "sec", "second", "seconds"), "s"),
    **dict.fromkeys(("h", "hr", "hour"), "h"),
}
"""Words of which a unit at the end of a name is made, with their symbols."""
_LONGEST_NAME = 200
"""Characters, beyond which a name is not searched for words of a unit: the search takes their square."""


def with_short_unit(name: str) -> str:
    """Return a name whose unit is written in words, ``speed_m_per_s`` or ``rateDegPerSec``, with it as ``_m_s``."""
    name = _without_factor(name)[0]
    found = _PER.fullmatch(name) if len(name) < _LONGEST_NAME and "per" in name.lower() else None
    if found is None:
        return name
    above, below = (_SHORT.get(found[part].lower()) for part in ("above", "below"))
    short = f"{above}_{below}{'2' if found['square'] else ''}"
    return f"{found['name'].rstrip('_')}_{short}" if short in TWO_WORDS else name


_SUFFIXES = {
    suffix: suffix
    for suffix in """
        mps2 mpss mps kmph kph kmh mph fps radps rad degps dps deg rpm Nm bar kPa psi pct ns us sec mm
    """.split()
} | TWO_WORDS
_SUFFIX_UNITS = {suffix.lower(): unit for suffix, symbol in _SUFFIXES.items() if (unit := find_unit(symbol))}
# The longest first: deg_s before s, mps2 before any shorter one.
_SUFFIX_ORDER = sorted(_SUFFIX_UNITS, key=len, reverse=True)
# An element of an array, q[0]; a unit of 1 stands apart, throttle [1].
_INDEXED = re.compile(r"\S\[\d+\]$")
# _ms is milliseconds on a time and metres a second on a speed, so the name must say which.
_TIME_IN_MS = re.compile(r"(^|.*_)(t|time|utc|epoch|timestamp|stamp|dt|delay|duration|latency|period)_ms$")

_TIMES = re.compile(r"(?P<name>.+)_?[x*×](?P<power>10{1,6})", re.IGNORECASE)
"""A factor behind the unit at the end of a name, of whole numbers that count its parts: ``v_kmh_x10``."""


def _without_factor(name: str) -> tuple[str, int]:
    """Return a name without the factor behind its unit, and that factor; 1 where it has none."""
    found = _TIMES.fullmatch(name) if len(name) < _LONGEST_NAME else None
    bare = found["name"].rstrip("_") if found else name
    if found is None or not any(bare.lower().endswith("_" + suffix) for suffix in _SUFFIX_ORDER):
        return name, 1
    return bare, int(found["power"])


_TICKS = {"sampletimefine": "0.1ms"}
"""Clocks in ticks that no name states: of Xsens, whose ticks are those of 10 kHz (MT Low-Level Communication)."""


def symbol_of(stated: str | None) -> str | None:
    """Return a unit as this module writes it, one that it does not know as stated, None where nothing is."""
    unit = find_unit(stated) if stated and stated.strip() else None
    return unit.symbol if unit else (stated or "").strip() or None


def split_name_and_unit(header: str) -> tuple[str, str | None]:
    """Split a column header into name and unit.

    ``vx(m/s)``, ``vx [m/s]`` and ``vx|m/s|0|90|50`` (unit, range and rate, as RaceCapture writes them) give
    ``("vx", "m/s")``; a known suffix as in ``vx_mps`` gives
    ``("vx_mps", "m/s")`` with the name left as it is, since users address columns by it. The bracket of ``q[0]``
    holds an index.

    Returns
    -------
    (str, str or None)
        The name, stripped of quotes, ``#`` and a bracketed unit; the unit's symbol as this module writes it,
        the bracket's own text when not known, None when nothing was said.
    """
    text = header.translate(_FULL_WIDTH).strip().lstrip("#").strip().strip('"').strip()
    if _INDEXED.search(text):
        return text, None
    behind = _BEHIND.match(text) if len(text) < _LONGEST_NAME else None
    # A single capital is a direction: Velocity, N.
    if behind and find_unit(behind["unit"]) and not re.fullmatch(r"[A-Z]|\d+", behind["unit"]):
        return behind["name"], symbol_of(behind["unit"])
    match = _BARRED.fullmatch(text) or _BRACKETED.match(text)
    if match and match["name"] and match["unit"].strip().lower() not in ("x", "y", "z"):
        return match["name"].strip(' "'), symbol_of(match["unit"])
    lowered = with_short_unit(text).lower()
    for suffix in _SUFFIX_ORDER:
        if lowered.endswith("_" + suffix):
            symbol, power = _SUFFIX_UNITS[suffix].symbol, _without_factor(text)[1]
            return text, symbol if power == 1 else symbol_of(f"{1.0 / power:g} {symbol}")
    return text, "ms" if _TIME_IN_MS.match(lowered) else _TICKS.get(lowered)
