"""Whether a match says anything: what would hide behind what the simulation shows against itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.term_tests import effect_to_noise_of_terms
from split_cli.diagnosis.statement.result import Detectable
from split_cli.diagnosis.statement.wording import number, term_name
from split_cli.vehicle.effects import CATALOGUE

__all__ = ["hidden_effect"]


def hidden_effect(
    objective: MarginalLikelihood,
    candidates: Sequence[Candidate],
    gap_to_noise: float,
    detectable: Sequence[Detectable] = (),
) -> str:
    """Return why no match can be said, in words; empty where a big effect would have been seen.

    Parameters
    ----------
    objective : MarginalLikelihood
    candidates : sequence of Candidate
        That these recordings can tell.
    gap_to_noise : float
        Effect-to-noise ratio of all that differs between simulation and reality.
    detectable : sequence of Detectable
        From which size on each term would have been named.

    Notes
    -----
    Simulation and reality may differ by no more than halves of the simulation do, and yet by as much as a big
    effect makes: then silence is no match. An effect is big when it is a fair share of what a car can have; it
    counts when it is larger than the noise on these drives. What differs has a shape of its own: an effect of
    another shape is told from it, and hides only where even this size of it would not have been named.
    """
    smallest = {one.term: one.parameters for one in detectable}
    plain = objective.policy.selection.plain
    if gap_to_noise <= plain:
        return ""
    for one in candidates:
        for name, value, values in _big(one, objective.policy.abstention.big_effect):
            if _would_be_named(one, name, value, smallest.get(one.term, {})):
                continue
            if plain < effect_to_noise_of_terms(objective, (one.build(values),)) <= gap_to_noise:
                return (
                    f"Simulation and reality differ by {number(gap_to_noise, 2)} times sensor noise in a step, "
                    f"and so do halves of the simulation. A {term_name(one.term)} with {name} = "
                    f"{number(value, 2)} would hide in that. Drive both alike and longer, or "
                    "calibrate the vehicle file (split calibrate)."
                )
    return ""


def _would_be_named(
    one: Candidate, name: str, value: float, smallest: Mapping[str, tuple[float | None, str]]
) -> bool:
    """Return whether a value of a term's parameter lies beyond that from which on the term is named."""
    neutral, (least, _) = CATALOGUE[one.term].neutral[name], smallest.get(name, (None, ""))
    return least is not None and abs(least - neutral) <= abs(value - neutral)


def _big(one: Candidate, share: float) -> list[tuple[str, float, dict[str, float]]]:
    """Return each size of a term of the car, its value on the way to its nearer bound, and all values."""
    kind = CATALOGUE[one.term]
    if one.located or not kind.exported or kind.family in ("time", "air", "place"):
        return []
    found = []
    start = {name: kind.neutral.get(name, value) for name, value in one.starts[0].items()}
    for name, limits in one.ranges.items():
        if name in kind.neutral:
            ends = [end for end in (limits.lower, limits.upper) if end != kind.neutral[name]]
            nearer = min(ends, key=lambda end: abs(end - kind.neutral[name]))
            value = kind.neutral[name] + share * (nearer - kind.neutral[name])
            found.append((name, value, {**start, name: value}))
    return found
