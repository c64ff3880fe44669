"""Torques of wheels and axles: which belong together, and whether they are all of the car's."""

from __future__ import annotations

from collections.abc import Sequence

from split_cli.logs.drafting.trial import TrialCandidate
from split_cli.logs.drafting.vocabulary import place_and_rest

__all__ = ["PARTS", "sums_of_torques", "told_of_a_part", "torques_alike"]

PARTS = ("wheel_torque", "axle_torque")
"""Meanings that together make T."""
_AXLE_OF = {"fl": "front", "fr": "front", "rl": "rear", "rr": "rear", "front": "front", "rear": "rear"}
_WHOLE = ({"fl", "fr", "rl", "rr"}, {"front", "rear"})


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


def told_of_a_part(sources: Sequence[str]) -> str:
    """Return what to say of a torque that is that of one axle, empty where it is the whole car's.

    Parameters
    ----------
    sources : sequence of str
        Recorded names that T is made of.
    """
    places = [place_and_rest(name)[0] for name in sources]
    known = {place for place in places if place}
    if len(sources) == 2 and {_AXLE_OF[place] for place in known} != {"front", "rear"}:
        return "sum of two wheels: those of the other axle may drive or brake too"
    if len(sources) == 1 and known:
        which = _AXLE_OF[known.pop()]
        return f"of the {which} axle alone: the other may drive or brake too"
    return ""
