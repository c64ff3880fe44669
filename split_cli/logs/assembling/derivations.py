"""Channels computed from others: only when asked for, and marked as derived."""

from collections.abc import Collection

from split_cli.errors import MapError, nearest_names
from split_cli.logs.assembling.derivation import Derivation
from split_cli.logs.assembling.derived_motion import MOTIONS
from split_cli.logs.assembling.derived_torque import TORQUES

DERIVATIONS: dict[str, Derivation] = {entry.name: entry for entry in (*MOTIONS, *TORQUES)}
"""In the order in which they run: velocities before what needs them."""

_TORQUE_OF_MOTION = "torque-from-acceleration"
_ACROSS_THE_PATH = "lateral-acceleration-from-path"
WITHOUT_RATE = "yaw-rate-from-lateral-acceleration"
"""What stands in for a gyro or a heading, where neither is recorded."""
#: Derivations with what they are asked for, the most trustworthy first.
_CHOICES = (
    ("lateral-velocity-from-sideslip", {"vy"}),
    ("velocity-from-pose", {"vx", "vy"}),
    ("longitudinal-velocity-from-wheels", {"vx"}),
    ("yaw-rate-from-yaw", {"r"}),
    ("lateral-velocity-from-accelerations", {"vy"}),
    (WITHOUT_RATE, {"r"}),
)


def derivation_named(name: str) -> Derivation:
    """Return a derivation by name; underscores may stand for hyphens.

    Raises
    ------
    MapError
        If there is none; the nearest are reported.
    """
    spelled = name.replace("_", "-")
    if spelled not in DERIVATIONS:
        raise MapError(f"no derivation {name!r}", advice=nearest_names(spelled, DERIVATIONS))
    return DERIVATIONS[spelled]


def reachable(recorded: Collection[str]) -> set[str]:
    """Return the channels that are recorded or that some derivation makes of them, directly or by steps."""
    reached: set[str] = set()
    step = set(recorded)
    while step - reached:
        reached |= step
        step = {made for entry in DERIVATIONS.values() if set(entry.needs) <= reached for made in entry.makes}
    return reached


def can_derive(name: str, channel: str, reached: Collection[str]) -> bool:
    """Tell whether a derivation makes a channel of what is recorded or derived.

    A torque takes what every drive has, and a pedal or a current that is recorded, or nothing but the motion.
    """
    entry = DERIVATIONS[name]
    if channel == "T":
        return name == _TORQUE_OF_MOTION or bool({default for _, default in entry.choices} & set(reached))
    return set(entry.needs) <= set(reached)


def derivations_for(missing: Collection[str], mapped: Collection[str]) -> list[str]:
    """Return the derivations that a log asks for, in the order to run them.

    A torque takes nothing that a drive may lack, and stands last. A lateral acceleration is made of a path only where
    a yaw rate takes one.
    """
    there, chosen = set(mapped), []
    while name := next((n for n, wanted in _CHOICES if _serves(n, wanted & set(missing) - there, there)), ""):
        chosen.append(name)
        there |= set(DERIVATIONS[name].makes)
    if "r" in set(missing) - there and "ay" not in there and _serves(_ACROSS_THE_PATH, {"ay"}, there):
        return [*chosen, _ACROSS_THE_PATH, *derivations_for(set(missing) - there, there | {"ay"})]
    return [*chosen, _TORQUE_OF_MOTION] if "T" in missing else chosen


def _serves(name: str, wanted: Collection[str], there: Collection[str]) -> bool:
    return bool(wanted) and set(DERIVATIONS[name].needs) <= set(there)
