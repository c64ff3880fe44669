"""How large each effect would have had to be to be named: what a silence about it is worth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from split_cli.diagnosis.candidates import Candidate
from split_cli.diagnosis.exploration import Rules
from split_cli.diagnosis.judge import Judge, alters_inputs
from split_cli.diagnosis.result import Detectable
from split_cli.diagnosis.selection import p_of_effect
from split_cli.diagnosis.severity import severities_of
from split_cli.diagnosis.structure import term_allowances
from split_cli.diagnosis.together import together
from split_cli.vehicle.effects import CATALOGUE

__all__ = ["smallest_named"]

_ROUNDS = 3  # an effect of twice the size saves nearly four times as much, and what is left of that is learned
_FURTHEST = 1e4
# Steps after which what alters inputs, and what does not, is as told.
_NEAR, _PROPORTIONAL = np.log(1.2), np.log(4.0)


def smallest_named(
    judges: Sequence[Judge], candidates: Sequence[Candidate], inflation: float, level: float
) -> tuple[Detectable, ...]:
    """Return from which size on each term of the catalogue would be named alone on these recordings.

    Parameters
    ----------
    judges : sequence of Judge
        The last of them, where it believes the simulation to the letter, names what alters inputs or sensors.
    candidates : sequence of Candidate
        Those that act at a place are left out: it depends on the place.
    inflation : float
    level : float
        Of the minimum-effect test.

    Notes
    -----
    Were an effect there, its term would save the squared length of what it moves in the whitened rows. Its size is
    searched where the test that is asked of every name is passed just so. Chance makes it pass a little earlier or
    later; what looks the same may be named in its stead.
    """
    first: dict[str, Candidate] = {}
    for one in candidates:
        if one.starts:
            first.setdefault(one.term, one)

    def smallest(candidate: Candidate) -> Detectable:
        altering = alters_inputs(candidate.build(candidate.starts[0]))
        return _smallest(judges[-1 if altering else 0], candidate, inflation, level / len(candidates))

    return tuple(together(smallest, first.values()))


def _smallest(judge: Judge, candidate: Candidate, inflation: float, level: float) -> Detectable:
    kind, start = CATALOGUE[candidate.term], dict(candidate.starts[len(candidate.starts) // 2])
    neutral = {name: kind.neutral[name] for name in start if kind.neutral.get(name) is not None}
    altering = alters_inputs(candidate.build(start))
    nothing = judge.residual(())
    left = judge.whiten(nothing)
    own = float(left @ left)

    def values_at(size: float) -> dict[str, float]:
        moved = {name: value + size * (start[name] - value) for name, value in neutral.items()}
        return {**start, **moved}

    def excess(size: float, saved: float, severity: np.ndarray) -> float:
        """Return by how much a size passes, above 0, or fails, below."""
        p_value = p_of_effect(judge, candidate, float(np.max(severity / term_allowances(judge))), saved, inflation)
        margin = np.log(level) - np.log(max(p_value, 1e-300))
        if judge.to_the_letter:
            margin = min(margin, np.log(saved / (saved + own)) - np.log(Rules().letter_share))
        return float(margin)

    size, inside = 1.0, True
    for _ in range(_ROUNDS):
        term = candidate.build(values_at(size))
        moved = judge.whiten(judge.residual((term,)) - judge.shift((term,)) - nothing)
        saved = float(moved @ moved)
        rows = zip(judge.evidence, judge.keep, strict=True)
        severity = np.max([severities_of(one, one.at[mask], (term,)) for one, mask in rows], axis=0)

        def passes(log: float, size=size, saved=saved, severity=severity) -> float:
            more = np.exp(log)
            return excess(size * more, more**2 * saved, more * severity)

        far = np.log(_FURTHEST)
        if not saved > 0.0 or passes(far) < 0.0:
            inside = False
            break
        log = -far if passes(-far) > 0.0 else brentq(passes, -far, far, xtol=0.01)
        size *= float(np.exp(log))
        values = values_at(size)
        inside = all(limit.lower <= values[name] <= limit.upper for name, limit in candidate.ranges.items())
        if not inside or abs(log) < (_NEAR if altering else _PROPORTIONAL):
            break
    units = kind.parameter_units(candidate.variant)
    found = {name: (value, units[name]) for name, value in values_at(size).items()} if inside else {}
    return Detectable(candidate.term, found)
