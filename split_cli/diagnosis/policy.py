"""All constants that decide in a diagnosis, each with unit, meaning and origin.

One immutable `Policy` is passed to all packages. Constants of numerical resolution stand beside their algorithm. The
origin of a constant is ``theory`` (it follows from a formula or definition), ``study`` (a command of this project
measured it) or ``judgement`` (it was chosen, and no better value has been measured).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, asdict, dataclass, fields, replace
from statistics import NormalDist
from typing import Any

from split_cli.diagnosis.policy_numbers import CHOSEN, JUDGEMENT, THEORY, number
from split_cli.diagnosis.policy_recordings import Believing, Screening, Unnamed

__all__ = [
    "STANDARD",
    "Abstention",
    "Allowances",
    "Believing",
    "ComparisonRules",
    "Policy",
    "Reporting",
    "Screening",
    "SelectionRules",
    "SelfTestRules",
    "Unnamed",
    "deciding_numbers",
]


def _two_sided(level: float) -> float:
    """Return the size that a normal deviate exceeds with probability `level`."""
    return NormalDist().inv_cdf(1.0 - level / 2.0)


@dataclass(frozen=True)
class ComparisonRules:
    """What is compared, and from which evidence on simulation and reality differ."""

    level: float = number(
        0.001,
        "1",
        "p value below which simulation and reality differ",
        CHOSEN + "; true differences mostly give less than 1e-6, model-form error more often than chance 1e-4 to 1e-2",
    )
    variance_inflation: float = number(
        1.5, "1", "variance inflation factor: by how much autocorrelation widens chi squared at least", CHOSEN
    )
    holdout_share: float = number(
        0.25,
        "1",
        "share of the real drives' time kept out, at the end, when no drive is given for it",
        JUDGEMENT + "a quarter is the usual share of a hold-out",
    )
    reach: float = number(
        0.35,
        "1",
        "largest distance in scaled features of a compared real row from the nearest simulated one; up to "
        "twice as much if hardly any row is nearer",
        CHOSEN,
    )
    least_rows: int = number(
        250,
        "rows of 0.04 s",
        "compared rows that a decision needs. Half of it is needed in a half of the simulation, and a "
        "quarter on held-out time for a share of the gap. It is also the length of the stretches between "
        "which instruments drift, and of the longest block when a simulation is split into halves",
        JUDGEMENT + "ten seconds of driving",
    )
    least_share: float = number(
        0.1, "1", "compared share of the real drive below which a difference without a name is undecided", CHOSEN
    )

    @property
    def far_reach(self) -> float:
        """Distance in scaled features that is taken at most where hardly any real row is nearer: twice `reach`."""
        return 2.0 * self.reach

    @property
    def rows_of_half(self) -> float:
        """Rows that a half of the simulation needs to be judged by the other."""
        return self.least_rows / 2

    @property
    def rows_kept_out(self) -> float:
        """Rows that have to be kept out for a share of the gap: a quarter of what a decision takes."""
        return self.least_rows / 4

    @property
    def deviations(self) -> float:
        """Standard errors of a normal deviate at the level, two-sided: that a saving needs, block by block."""
        return _two_sided(self.level)


@dataclass(frozen=True)
class SelectionRules:
    """Which physical terms are named, kept as nuisances, or listed as alternatives."""

    price: float = number(
        8.0,
        "chi squared",
        "cost over the variance inflation that each searched parameter has to save. Up to this difference "
        "another explanation is as good. Witnesses of a channel that save less are no evidence",
        THEORY + "between the prices of AIC (2) and BIC (ln n, about 9 for an hour's rows)",
    )
    most_nuisances: int = number(
        2, "terms", "nuisance terms, which save more than chance but are too small to name", CHOSEN
    )
    few_names: int = number(
        3,
        "terms",
        "named terms up to which the search over all terms at once is only run if structure is left",
        JUDGEMENT + "computing time: three effects at once are usual, and the search adds half a minute",
    )
    full_fits: int = number(9, "fits", "candidates that are fitted fully in each step", JUDGEMENT + "computing time")
    form_error_across: float = number(
        0.07, "1", "model-form error over the size of the chosen terms, where they hardly act", CHOSEN
    )
    considered: int = number(3, "terms", "further terms that are considered in each step, those that save most", CHOSEN)
    sure: float = number(
        15.0,
        "standard errors",
        "size of a term over its standard error from blocks of time, above which it need not save in enough of them",
        CHOSEN,
    )
    above_noise: float = number(
        1.0,
        "effect-to-noise ratio",
        "effect-to-noise ratio above which a term need not save in enough blocks of time, and above which a "
        "remainder is unexplained however large the gap",
        THEORY + "as large as the noise",
    )
    much_over_noise: float = number(
        3.0,
        "1",
        "variance over that of noise that counts as large. Between halves of a simulation, a term at a "
        "place then has to save in many blocks too. In a channel, a term that removes nearly all of it is "
        "then no model-form error",
        CHOSEN,
    )
    fair_share: float = number(
        0.2,
        "1",
        "share that matters. Of what witnesses contradict: a sensor fault removes more. Of the variance "
        "left in a channel: below it a term has removed nearly all. Of the forces over 2 s: above it a "
        "hidden effect leaves no match. Of a saving: another term that lacks less is as good. Of the gap "
        "without a name: above it the gap is unexplained. Of either drive: so much has to be common to both "
        "for a name",
        CHOSEN + "; a force wrong by a fifth spoils any prediction",
    )
    sure_level: float = number(
        1e-12, "1", "p value below which a name stands although a fixed baseline does not confirm it", CHOSEN
    )
    rounds: int = number(
        4,
        "rounds",
        "rounds in which terms are added again after rivals have taken places",
        JUDGEMENT + "computing time",
    )
    swaps: int = number(2, "swaps", "rounds in which a rival may take a term's place", JUDGEMENT + "computing time")
    tie: float = number(
        1.0,
        "chi squared",
        "difference of cost over the variance inflation up to which explanations tie: fits of the same "
        "terms count as one, and a rival does not replace a term",
        JUDGEMENT + "what one parameter saves by chance",
    )
    beginnings: int = number(
        2, "searches", "other first terms from which the search begins anew", JUDGEMENT + "computing time"
    )
    level: float = number(
        0.01,
        "1",
        "level of the tests of a name, after Bonferroni correction for the terms tried, and of the test of a remainder",
        JUDGEMENT + "a usual level",
    )
    form_error_share: float = number(
        0.10,
        "1",
        "model-form error of a term, or at most of the shared discrepancy, over its size: the standard "
        "deviation of its prior. It is also the least share of larger terms that a further term must reach, and the "
        "least relative error of a parameter that acts through the tyres. A variant must be better open "
        "loop by this share. A larger share of the gap is unexplained. Its square is the share of a cost, "
        "which grows with the square of a size",
        JUDGEMENT + "two curves stand for four tyres",
    )
    deviations: float = number(
        1.96,
        "standard deviations",
        "standard deviations that hold 95 %: of the prior from no effect to the largest that a car can "
        "have, of the difference between halves of the simulation, of the error of what the two share, and of "
        "the drift of instruments",
        THEORY + "95 % of a normal deviate, two-sided",
    )

    @property
    def same_within(self) -> float:
        """Standard errors of a paired difference, block by block, up to which two explanations are as good."""
        return _two_sided(self.level)

    @property
    def form_error_cost(self) -> float:
        """Share of a cost that model-form error makes: costs grow with the square of a size."""
        return self.form_error_share**2


@dataclass(frozen=True)
class Abstention:
    """When something is said to have no name."""

    most_alternatives: int = number(
        4,
        "terms",
        "alternatives, exact degeneracies not counted, above which none of them is named",
        JUDGEMENT + "a list of more helps nobody",
    )
    greater_part: float = number(
        0.5,
        "1",
        "share that counts as most. Of the best saving: a lead explains more. Of a saving: a rival that is "
        "estimated to save less is not fitted. Of the track: the place of a wider interval is undetermined. "
        "Of the drift of an integral: a yaw that stays nearer is that integral. Of a car's range: effects "
        "of this size are asked for behind a match. Of all effects: if more would not show, a match is "
        "undecided",
        JUDGEMENT + "a half",
    )
    most_leads: int = number(2, "leads", "leads that are reported", JUDGEMENT + "a list of more helps nobody")

    @property
    def worth_following(self) -> float:
        """Share that a term at a bound has to save for it to be followed beyond: half of a lead's."""
        return 0.5 * self.greater_part


@dataclass(frozen=True)
class Allowances:
    """Differences too small to be called one: what any nominal model misses in one way of driving only."""

    term: float = number(
        0.05,
        "effect-to-noise ratio",
        "effect-to-noise ratio below which a term is not named, beside a simulation",
        CHOSEN,
    )
    unnamed: float = number(
        0.10,
        "effect-to-noise ratio",
        "effect-to-noise ratio below which a difference without a name does not count. It is the same for a "
        "term beside another one of the car, and for any term against the bare nominal model. Above twice "
        "this, a remainder is unexplained whatever its share, a hidden effect is a lead, and a fault that "
        "witnesses show is no model-form error",
        CHOSEN,
    )
    discrepancy_share: float = number(
        0.03, "1", "share of the shared model discrepancy that its basis functions miss, in each channel", CHOSEN
    )
    structure_floor: float = number(
        1e-4, "1", "share of the discrepancy's cost that a flexible fit may save without a difference", CHOSEN
    )
    term_floor: float = number(
        1e-5, "1", "share of the discrepancy's cost that a single term may save without a difference", CHOSEN
    )

    @property
    def large(self) -> float:
        """Effect-to-noise ratio of what no model-form error makes: twice that of an unnamed difference."""
        return 2.0 * self.unnamed


@dataclass(frozen=True)
class SelfTestRules:
    """What the simulation shows against itself, half by half, and how much more reality has to show."""

    unnamed_margin: float = number(
        2.0,
        "1",
        "factor by which a saving without a name, or the amplitude of a spectral line, must exceed that "
        "between halves of the simulation. It is also the cost by chance of each effective parameter of a "
        "flexible fit",
        JUDGEMENT + "reality may cover other ground than the second half did",
    )
    term_margin: float = number(
        1.5,
        "1",
        "factor by which the saving of a term, or residual autocorrelation, must exceed that between halves "
        "of the simulation. Within this factor witnesses agree about the size of a fault",
        CHOSEN,
    )
    kindred: float = number(
        0.33, "1", "share of the largest saving between halves of the simulation that is allowed for every term", CHOSEN
    )
    blocks: int = number(
        8,
        "blocks",
        "least number of blocks of driving time into which a simulation is split alternately",
        JUDGEMENT + "four to either side",
    )


@dataclass(frozen=True)
class Reporting:
    """What is said of a value, a place and a gap."""

    systematic: float = number(
        0.03,
        "effect-to-noise ratio",
        "systematic error of a parameter, as an effect-to-noise ratio: what one term may absorb of another",
        CHOSEN,
    )
    least_dependence: float = number(
        0.15, "1", "share of the gap that a variable explains from which on a region of it is reported", CHOSEN
    )
    clearly_more: float = number(
        0.1, "1", "by how much place or time has to explain more than how the car is driven", CHOSEN
    )
    everywhere: float = number(
        0.8,
        "1",
        "share of the samples, or of the lap, from which on a region is everywhere and a stretch is none",
        JUDGEMENT + "it tells nobody where to look",
    )
    local_gap: float = number(0.3, "1", "share of the gap that a place or a time has to hold", CHOSEN)
    local_ratio: float = number(2.0, "1", "the share of the gap over that of the samples", CHOSEN)
    stable: float = number(
        0.7,
        "1",
        "share of half samples that choose a function for it to stand in the formula",
        THEORY + "stability selection, Meinshausen and Buehlmann (2010), 0.6 to 0.9",
    )
    formula_terms: int = number(3, "terms", "functions in the formula at most", JUDGEMENT + "a lead is short")
    much_slipping: float = number(
        0.02, "1", "share of the drive with slipping wheels from which on it is reported", CHOSEN
    )
    least_compared: float = number(0.7, "1", "compared share of the drive below which it is reported", CHOSEN)

    @property
    def concentrated(self) -> tuple[float, float]:
        """`local_gap` and `local_ratio` of what lies in one place for the most part: twice as clear as local."""
        return 2.0 * self.local_gap, 2.0 * self.local_ratio


@dataclass(frozen=True)
class Policy:
    """All numbers that decide, by what they decide on."""

    comparison: ComparisonRules = ComparisonRules()
    selection: SelectionRules = SelectionRules()
    abstention: Abstention = Abstention()
    allowances: Allowances = Allowances()
    self_test: SelfTestRules = SelfTestRules()
    screening: Screening = Screening()
    believing: Believing = Believing()
    unnamed: Unnamed = Unnamed()
    reporting: Reporting = Reporting()

    def altered(self, group: str, **values: float) -> Policy:
        """Return a policy with other values of some numbers of one group."""
        return replace(self, **{group: replace(getattr(self, group), **values)})

    def described(self) -> dict[str, float]:
        """Return all numbers by name, as `diagnosis.json` lists them: those of the comparison without prefix."""
        return {
            name if group == "comparison" else f"{group}_{name}": value
            for group, numbers in asdict(self).items()
            for name, value in numbers.items()
        }


STANDARD = Policy()


def deciding_numbers(policy: Policy = STANDARD) -> Iterator[tuple[str, Field[Any], float]]:
    """Yield the group, the field (its metadata hold unit, meaning and origin) and the value of every number."""
    for group in fields(policy):
        numbers = getattr(policy, group.name)
        for one in fields(numbers):
            yield group.name, one, getattr(numbers, one.name)
