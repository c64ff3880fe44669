"""Names, numbers and p values as the HTML pages print them."""

import html
import math
import re
import unicodedata
from collections.abc import Sequence

from split_cli.diagnosis.statement.wording import variable_name
from split_cli.vehicle.effects import CATALOGUE

FORCE_IDS = ("longitudinal", "front_lateral", "rear_lateral")
FORCES = {"longitudinal": "Longitudinal", "front_lateral": "Front lateral", "rear_lateral": "Rear lateral"}
CHANNELS = (("v_x", "Longitudinal", "m/s²"), ("v_y", "Lateral", "m/s²"), ("r", "Yaw", "rad/s²"))
_INVISIBLE = ("Cc", "Cf", "Cs", "Zl", "Zp", "Co", "Cn")


def readable(text: str) -> str:
    """Return text with what cannot be seen, or turns the direction of reading, spelled as an escape."""
    return "".join(
        character if unicodedata.category(character) not in _INVISIBLE else ascii(character)[1:-1] for character in text
    )


def escape(text: object) -> str:
    """Return text for HTML, inside an element or a quoted attribute."""
    return html.escape(readable(str(text)), quote=True)


def prose(text: object) -> str:
    """Return a sentence of a command for HTML: typeset, what it quotes as code as it stands."""
    parts = escape(text).split("`")
    quoted = len(parts) % 2 == 1  # else a quotation does not end, and none is one
    return "".join(
        f"<code>{part}</code>" if quoted and k % 2 else typeset(part) if quoted else typeset(f"{'`' * (k > 0)}{part}")
        for k, part in enumerate(parts)
    )


def heading(text: object) -> str:
    """Return text for HTML, typeset."""
    return typeset(escape(text))


def term_title(term: str, variant: str = "") -> str:
    """Return a term's name in words: ``steer_gain`` is "Steer gain"; what a variant is stands behind a comma."""
    words = " + ".join(part.replace("_", " ").capitalize() for part in term.split("+")).replace("Cg ", "CG ")
    if not variant:
        return words
    known = CATALOGUE[term].variant_words if term in CATALOGUE else {}
    return f"{words}, {known.get(variant, variant.replace('_', ' '))}"


def variable(name: str) -> tuple[str, str]:
    """Return a variable's name in words and its unit."""
    words, unit = variable_name(name)
    return words, unit.replace("^2", "²")


def number(value: float, digits: int = 3) -> str:
    """Return a number with some significant digits, and a power of ten only where zeros would be counted."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if size < -4 or size >= 7:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        return _minus(f"{mantissa} × 10{raised}")
    return _minus(f"{value:,.{max(0, digits - 1 - size)}f}")


def parameter(value: float, half_width: float) -> str:
    """Return a value to the second digit of its uncertainty [same unit]."""
    if not (math.isfinite(half_width) and half_width > 0.0):
        return number(value, 4)
    places = 1 - math.floor(math.log10(half_width))
    return number(value, 4) if places > 7 else _minus(f"{value:,.{max(0, places)}f}")


def percent(share: float) -> str:
    """Return a share in per cent; never 100 or 0 for what only comes close."""
    if not math.isfinite(share):
        return "–"
    scaled = 100.0 * share
    if 0.0 < scaled < 1.0:
        return "< 1 %"
    if 99.0 < scaled < 100.0:
        return "> 99 %"
    return _minus(f"{scaled:.0f} %")


def span(share: Sequence[float]) -> str:
    """Return the interval of a share given as (value, low, high), in per cent: ``81 to 97 %``."""
    low, high = (f"{100.0 * v:.0f}" for v in share[1:])
    return _minus(f"{low} to {high} %")


def chance(p_value: float | None) -> str:
    """Return a p value as an equation or inequality."""
    if p_value is None:
        return "–"
    if p_value < 1e-6:
        return "p < 10⁻⁶"
    if p_value > 0.995:
        return "p = 1"
    return f"p = {number(p_value, 2)}"


def typeset(text: str) -> str:
    """Return a sentence with the signs of print: ``-1.8 m/s^2`` is ``−1.8 m/s²``; no line ends before a unit."""
    signed = re.sub(r"(?<![\w.])-(?=\d)", "−", text.replace("+-", "±")).replace("^2", "²").replace(" N m", " N\u00a0m")
    return re.sub(r"(?<=\d) (?=%|(?:N|m|m/s|s|ms|rad|deg|g|Hz|km/h)(?![\w-]))", "\u00a0", signed)


def quantity(value: float, unit: str) -> str:
    """Return a value with its unit, none for ``1``."""
    return number(value) if unit in ("", "1") else f"{number(value)} {unit}"


def _minus(text: str) -> str:
    return text.replace("-", "−")
