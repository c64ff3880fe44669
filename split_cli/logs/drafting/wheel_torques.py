"""Torques of wheels and axles: which belong together, and whether they are all of the car's."""

from collections.abc import Sequence

import numpy as np

from split_cli.logs.drafting.trial import TrialCandidate
from split_cli.logs.drafting.vocabulary import concepts_of, place_and_rest, tokens_of

PARTS = ("wheel_torque", "axle_torque")
"""Meanings that together make T."""
_BRAKES = 0.1
"""Of the largest torque of the drive, the largest one of braking of what drives alone [1]; a motor's drag is less."""
_AXLE_OF = {"fl": "front", "fr": "front", "rl": "rear", "rr": "rear", "front": "front", "rear": "rear"}


def torques_alike(found: Sequence[TrialCandidate]) -> list[list[TrialCandidate]]:
    """Return torques of wheels or axles in groups named alike but for the place.

    Drive torques are not summed with those of brakes or of another sensor.
    """
    groups: dict[tuple[str, ...], list[TrialCandidate]] = {}
    for candidate in found:
        if candidate.channel in PARTS:
            groups.setdefault((candidate.channel, *place_and_rest(candidate.sources[0])[1]), []).append(candidate)
    return list(groups.values())


def sums_of_torques(found: Sequence[TrialCandidate]) -> list[TrialCandidate]:
    """Return T as the sum of four wheels, of two axles or of two wheels, and as the torque of a single axle."""
    made = []
    for group in torques_alike(found):
        sources = tuple(c.sources[0] for c in group)
        if len(group) in (2, 4):
            made.append(TrialCandidate("T", sources, 4, group[0].unit, "sum"))
        elif len(group) == 1 and group[0].channel == "axle_torque":
            made.append(TrialCandidate("T", sources, 2, group[0].unit))
    return made


def note_on_part(sources: Sequence[str]) -> str:
    """Return what to say of a torque that is that of one axle or of a list, empty where it is the whole car's.

    Parameters
    ----------
    sources : sequence of str
        Recorded names that T is made of.
    """
    places = [place_and_rest(name)[0] for name in sources]
    known = {place for place in places if place}
    if len(sources) == 2 and {_AXLE_OF[place] for place in known} != {"front", "rear"}:
        return "sum of two wheels: those of the other axle may drive or brake too"
    if len(sources) == 1 and sources[0].endswith("[0]"):
        return "the first of a list: the others may be those of other wheels or axles, `sum:` adds them"
    if len(sources) == 1 and known:
        which = _AXLE_OF[known.pop()]
        return f"of the {which} axle alone: the other may drive or brake too"
    return ""


def note_on_engine(sources: Sequence[str], names: Sequence[str]) -> str:
    """Return what to say of a torque that may be the engine's, empty where its name tells, or no engine is seen.

    It goes with the acceleration as the torque at the wheels does: only its size differs, by the gear ratio.

    Parameters
    ----------
    sources : sequence of str
        Recorded names that T is made of.
    names : sequence of str
        All recorded names: an engine shows by its speed or by a gear.
    """
    if len(sources) != 1 or concepts_of(tokens_of(sources[0]))[0] & {"wheel", "drive", "road"}:
        return ""
    for name in names:
        words = set(tokens_of(name))
        wheel = concepts_of(list(words))[0] & {"wheel", *_AXLE_OF}
        if words & {"gear", "rpm"} and not wheel:
            return (
                f"beside {name!r} it may be the engine's, which is no torque at the wheels: then `scale:` with "
                "gear ratio times efficiency makes it T, where one gear is driven"
            )
    return ""


def note_on_brakes(sources: Sequence[str], names: Sequence[str], torque: np.ndarray | None) -> str:
    """Return what to say of a torque that hardly brakes beside recorded ones of brakes; empty where none is.

    Parameters
    ----------
    sources : sequence of str
        Recorded names that T is made of.
    names : sequence of str
        All recorded names.
    torque : ndarray, optional
        T, shape (N,) [N m].
    """
    if torque is None or -np.nanquantile(torque, 0.01) > _BRAKES * np.nanquantile(torque, 0.99):
        return ""

    def brakes(name: str) -> bool:
        concepts = concepts_of(tokens_of(name))[0]
        return {"brake", "torque"} <= concepts and not concepts & {"drive", "command", "other"}

    others = [name for name in names if name not in sources and brakes(name)]
    if not others or any(map(brakes, sources)):
        return ""
    shown = ", ".join(others[:4]) + (" and others" if len(others) > 4 else "")
    return f"without {shown}: add the brakes to `sum:`, with `scale: -1` where their torque is positive"
