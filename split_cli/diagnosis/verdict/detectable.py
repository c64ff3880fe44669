"""How large each effect would have had to be to be named: what a silence about it is worth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from split_cli.diagnosis.innovations.objective import MarginalLikelihood, alters_inputs
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit
from split_cli.diagnosis.search.selection import nothing
from split_cli.diagnosis.search.term_tests import over_allowance, p_of_effect
from split_cli.diagnosis.statement.result import Detectable
from split_cli.diagnosis.together import together
from split_cli.vehicle.effects import CATALOGUE

__all__ = ["smallest_named"]

_ROUNDS = 3  # an effect of twice the size saves nearly four times as much, and what is left of that is learned
_FURTHEST = 1e4
_BY_CHANCE = 2.0  # standard errors: a projection of noise on what an effect moves is mostly less
# Steps after which what alters inputs, and what does not, is as told.
_NEAR, _PROPORTIONAL = np.log(1.2), np.log(4.0)


def smallest_named(
    objectives: Sequence[MarginalLikelihood],
    candidates: Sequence[Candidate],
    variance_inflation: float,
    level: float,
) -> tuple[Detectable, ...]:
    """Return from which size on each term of the catalogue would be named alone on these recordings.

    Parameters
    ----------
    objectives : sequence of MarginalLikelihood
        The last of them, where its baseline is fixed, names what alters inputs or
        sensors.
    candidates : sequence of Candidate
        Those that act at a place are left out: it depends on the place.
    variance_inflation : float
    level : float
        Of the minimum-effect test.

    Notes
    -----
    Were an effect there, its term would save the squared length of what it moves in the whitened rows, less what
    the difference that is there already may take off: nobody knows the sign of an effect beforehand. Its size is
    searched where the test that is asked of every name is passed just so. Chance makes it pass a little earlier or
    later; what looks the same may be named in its stead.
    """
    variants: dict[str, list[Candidate]] = {}
    for one in candidates:
        if one.starts:
            variants.setdefault(one.term, []).append(one)
    bare = [nothing(objective) for objective in objectives]

    def smallest(candidate: Candidate) -> tuple[float, dict[str, float]]:
        last = -1 if alters_inputs(candidate.build(candidate.starts[0])) else 0
        return _smallest(objectives[last], bare[last], candidate, variance_inflation, level / len(candidates))

    every = [one for several in variants.values() for one in several]
    found = dict(zip((one.label for one in every), together(smallest, every), strict=True))
    out = []
    for term, several in variants.items():
        # Which of them is there nobody knows: what is reported holds for all.
        worst = max(several, key=lambda one: found[one.label][0])
        units = CATALOGUE[term].parameter_units(worst.variant)
        values = found[worst.label][1]
        out.append(Detectable(term, {name: (values[name], units[name]) for name in values}))
    return tuple(out)


def _smallest(
    objective: MarginalLikelihood, bare: Fit, candidate: Candidate, variance_inflation: float, level: float
) -> tuple[float, dict[str, float]]:
    """Return how many times its start an effect has to be, and its values; infinity and none beyond its range."""
    start = candidate.starts[len(candidate.starts) // 2]
    near = _NEAR if alters_inputs(candidate.build(start)) else _PROPORTIONAL

    def excess(size: float, saved: float) -> float:
        """Return by how much an effect, its size over what is allowed, passes, above 0, or fails, below."""
        p_value = p_of_effect(objective, candidate, size, saved, variance_inflation)
        margin = np.log(level) - np.log(max(p_value, 1e-300))
        apart = objective.policy.self_test.apart**2 * objective.own_savings.get(candidate.effect, 0.0)
        if apart > 0.0:
            margin = min(margin, np.log(saved / apart))
        if objective.fixed_baseline:
            margin = min(
                margin, np.log(saved / (saved + bare.cost)) - np.log(objective.policy.selection.fixed_share)
            )
        return float(margin)

    values, factor, inside = dict(start), 1.0, True
    for _ in range(_ROUNDS):
        term = candidate.build(values)
        moved = objective.whiten(objective.residual((term,)) - objective.shift((term,))) - bare.residuals
        length, size = float(np.sqrt(moved @ moved)), over_allowance(objective, (term,), ())
        # What is there already may point the other way, and has to be made up for first.
        against = abs(float(moved @ bare.residuals)) / max(length, 1e-300)
        against = max(against - _BY_CHANCE * np.sqrt(variance_inflation), 0.0)

        def passes(log: float, length=length, size=size, against=against) -> float:
            return excess(np.exp(log) * size, max(np.exp(log) * length - against, 1e-6) ** 2)

        far = np.log(_FURTHEST)
        if not length > 0.0 or passes(far) < 0.0:
            inside = False
            break
        log = -far if passes(-far) > 0.0 else brentq(passes, -far, far, xtol=0.01)
        factor *= float(np.exp(log))
        values = candidate.moved(start, factor)
        if candidate.is_everyday(values):
            # As large as this it is seen, and yet no fault.
            factor *= min(limit.everyday / abs(values[name]) for name, limit in candidate.ranges.items())
            values = candidate.moved(start, factor)
        inside = candidate.allows(values)
        if not inside or abs(log) < near:
            break
    return (factor, values) if inside else (np.inf, {})
