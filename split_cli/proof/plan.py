"""Which cases a seed stands for: kinds, terms, tiers, in fixed proportions whatever their number."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.errors import SplitError, nearest_names
from split_cli.proof.concealed import CONCEALED
from split_cli.proof.nominal_terms import NOMINAL_TERMS
from split_cli.proof.strange import STRANGE
from split_cli.vehicle.effects import CATALOGUE

FIRST_REPORTED_SEED = 10**6
"""Seeds from here on are for reports and never used in development, which has those below 1000."""

TIERS = {"easy": (1.0, 3.0), "realistic": (0.35, 1.0), "hard": (0.12, 0.35)}
"""Severity: rms of the effect's 0.05 s prediction error over sqrt(2) sigma, in the channel where it is largest."""

KINDS = ("null", "single", "pair", "strange", "set", "nominal-set", "hard-pair", "whole-car")
MIXED = KINDS[:4]
"""Kinds that `plan_case` mixes unless it is asked for others."""
# Of twenty cases: seven nulls, eight singles, two pairs, three effects outside the catalogue.
_PATTERN = "sn snsxnps nsnxs nspxns n".replace(" ", "")[:20] + "tmhw"
_LETTERS = dict(zip("nspxtmhw", KINDS, strict=True))
_TIER_PATTERN = ("realistic", "hard", "realistic", "easy", "hard", "realistic", "hard")
_PAIR_RANGE = (0.5, 1.5)
_SUBSTITUTES = 3
# Of what the two best terms of the catalogue leave of an effect outside it.
_STRANGE_RANGE = (0.35, 1.0)


@dataclass(frozen=True)
class CasePlan:
    """What a case is to conceal."""

    seed: int
    number: int
    kind: str  # one of `KINDS`
    # Ids of the catalogue; or kinds outside it, of which the first that can be built is taken.
    terms: tuple[str, ...]
    tier: str  # easy, realistic or hard for singles, else empty
    # low, high: between which the effect-to-noise ratio of each effect lies; of an effect outside the catalogue,
    # that of what the two best terms leave of it.
    low: float
    high: float
    # Terms to take in turn where no car, track and driver can be drawn that shows the first ones.
    instead: tuple[tuple[str, ...], ...] = ()

    def rng(self, *stream: int) -> np.random.Generator:
        """Return the case's own random stream."""
        return np.random.default_rng([self.seed, self.number, *stream])


def plan_case(seed: int, number: int, kinds: tuple[str, ...] = MIXED) -> CasePlan:
    """Return the plan of case `number` (from 0) of a seed.

    Raises
    ------
    SplitError
        If the seed is neither for development nor for reports, or a kind is unknown.
    """
    if not (0 <= seed < 1000 or seed >= FIRST_REPORTED_SEED):
        what = f"seed {seed} is neither one of development (0 to 999) nor one to report ({FIRST_REPORTED_SEED} on)"
        raise SplitError(what, where="--seed")
    for kind in kinds:
        if kind not in KINDS:
            raise SplitError(f"no kind of case is called {kind!r}", advice=nearest_names(kind, KINDS))
    pattern = [letter for letter in _PATTERN if _LETTERS[letter] in kinds]
    kind = _LETTERS[pattern[number % len(pattern)]]
    # How many of the kind came before, so that every term and tier comes up in turn.
    rounds, rest = divmod(number, len(pattern))
    turn = rounds * sum(_LETTERS[x] == kind for x in pattern) + sum(_LETTERS[x] == kind for x in pattern[:rest])
    order = np.random.default_rng([seed, 99])
    singles, strange = order.permutation(sorted(CONCEALED)), order.permutation(sorted(STRANGE))
    rng = np.random.default_rng([seed, number, 1])
    if kind in ("null", "whole-car"):
        return CasePlan(seed, number, kind, (), "", 0.0, 0.0)
    if kind == "single":
        # The tier moves on by one each time round the terms.
        tier = _TIER_PATTERN[(turn + turn // len(singles)) % len(_TIER_PATTERN)]
        first, *others = ((str(singles[(turn + i) % len(singles)]),) for i in range(1 + _SUBSTITUTES))
        return CasePlan(seed, number, kind, first, tier, *TIERS[tier], instead=tuple(others))
    if kind in ("pair", "hard-pair"):
        first, *others = (_draw_pair(rng) for _ in range(1 + _SUBSTITUTES))
        low, high = _PAIR_RANGE if kind == "pair" else TIERS["hard"]
        return CasePlan(seed, number, kind, first, "", low, high, instead=tuple(others))
    if kind in ("set", "nominal-set"):
        names = sorted(CONCEALED) if kind == "set" else sorted(NOMINAL_TERMS)
        first, *others = (_draw_set(rng, names) for _ in range(1 + _SUBSTITUTES))
        return CasePlan(seed, number, kind, first, "", *TIERS["realistic"], instead=tuple(others))
    # Some are all but a term of the catalogue in some cars; then the next kind takes the place.
    following = tuple(str(strange[(turn + i) % len(strange)]) for i in range(len(strange)))
    return CasePlan(seed, number, kind, following, "", *_STRANGE_RANGE)


def _draw_pair(rng: np.random.Generator) -> tuple[str, str]:
    """Return two terms that are not declared to look alike."""
    names = sorted(CONCEALED)
    while True:
        first, second = (str(name) for name in rng.choice(names, 2, replace=False))
        if not (_looks_like(first, second) or _looks_like(second, first)):
            return first, second


def _draw_set(rng: np.random.Generator, names: Sequence[str]) -> tuple[str, ...]:
    """Return three to five terms, none of which is declared to look like another."""
    count = int(rng.integers(3, 6))
    while True:
        drawn = tuple(str(name) for name in rng.choice(names, count, replace=False))
        if not any(_looks_like(one, other) for one in drawn for other in drawn if one != other):
            return drawn


def _looks_like(term: str, other: str) -> bool:
    return any(other in mimic.terms.split("+") for mimic in CATALOGUE[term].mimics)
