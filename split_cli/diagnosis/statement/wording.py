"""Numbers, terms and variables in words, for sentences of a diagnosis."""

from split_cli.vehicle.effects.wording import amount, number, percent

__all__ = [
    "STATES",
    "amount",
    "is_swinging",
    "number",
    "percent",
    "swinging_in_words",
    "term_name",
    "term_with_id",
    "variable_name",
]

#: The velocities and their units, in the order of columns.
STATES = (("v_x", "m/s"), ("v_y", "m/s"), ("r", "rad/s"))
_SWINGING = "swinging"

_VARIABLES = {
    "v_x": ("longitudinal velocity", "m/s"),
    "v_y": ("lateral velocity", "m/s"),
    "r": ("yaw rate", "rad/s"),
    "T": ("torque", "N m"),
    "delta": ("steer angle", "rad"),
    "alpha_f": ("front slip angle", "rad"),
    "alpha_r": ("rear slip angle", "rad"),
    "a_x": ("longitudinal acceleration", "m/s^2"),
    "a_y": ("lateral acceleration", "m/s^2"),
    "steer_rate": ("steer rate", "rad/s"),
    "t": ("time", "s"),
    "s": ("track position", "m"),
}


def term_name(term: str) -> str:
    """Return a term in words: ``cg_shift+steer_gain`` is "CG shift and steer gain together"."""
    parts = [part.replace("_", " ").replace("cg ", "CG ") for part in term.split("+")]
    if len(parts) == 1:
        return parts[0]
    return f"{', '.join(parts[:-1])} and {parts[-1]} together"


def term_with_id(term: str) -> str:
    """Return a term in words with its id behind."""
    return f"{term_name(term)} ({term})"


def swinging_in_words(frequency: float) -> str:
    """Return what oscillators of a natural frequency [Hz] are called among functions without a name."""
    return f"{_SWINGING} at {frequency:.2g} Hz"


def is_swinging(kind: str) -> bool:
    """Return whether a group of functions without a name are oscillators."""
    return kind.startswith(_SWINGING)


def variable_name(name: str) -> tuple[str, str]:
    """Return a variable's name in words and its unit."""
    return _VARIABLES.get(name, (name.replace("_", " "), ""))
