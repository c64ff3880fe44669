"""Every number that decides something in a diagnosis, with its unit, its meaning and where it comes from.

One frozen `Policy` is passed down. Numbers that only set how finely something is computed stand beside the
algorithm they belong to. The origin of a number is ``theory`` (it follows from a formula or a definition),
``study`` (a command of this project measured it) or ``judgement`` (somebody chose it, and nobody has measured a
better one).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, asdict, dataclass, field, fields, replace
from typing import Any

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

_THEORY, _JUDGEMENT = "theory: ", "judgement: "
_CHOSEN = _JUDGEMENT + "chosen while developing on cases of `split prove`, without a study of its own"


def _number(default: float, unit: str, meaning: str, origin: str) -> Any:
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "origin": origin})


@dataclass(frozen=True)
class ComparisonRules:
    """What is compared, and from which evidence on simulation and reality differ."""

    level: float = _number(
        0.001,
        "1",
        "p value below which simulation and reality differ",
        _CHOSEN
        + "; true differences mostly give less than 1e-6, model-form error more often than chance 1e-4 to 1e-2",
    )
    variance_inflation: float = _number(
        1.5, "1", "variance inflation factor: by how much autocorrelation widens chi squared at least", _CHOSEN
    )
    holdout_share: float = _number(
        0.25,
        "1",
        "share of the real drives' time kept out, at the end, when no drive is given for it",
        _JUDGEMENT + "a quarter is the usual share of a hold-out",
    )
    reach: float = _number(
        0.35, "1", "distance in scaled features up to which a real row lies where the simulation has been", _CHOSEN
    )
    far_reach: float = _number(
        0.7, "1", "the same distance where hardly any row is nearer", _JUDGEMENT + "twice the usual reach"
    )
    least_rows: int = _number(
        250, "rows of 0.04 s", "evidence below which nothing is decided", _JUDGEMENT + "ten seconds of driving"
    )
    least_share: float = _number(
        0.1, "1", "compared share of the real drive below which what has no name is not decided", _CHOSEN
    )


@dataclass(frozen=True)
class SelectionRules:
    """Which physical terms are named, kept as nuisances, or listed as alternatives."""

    price: float = _number(
        8.0,
        "chi squared",
        "cost that a searched parameter has to save, before variance inflation",
        _THEORY + "between the prices of AIC (2) and BIC (ln n, about 9 for an hour's rows)",
    )
    most_nuisances: int = _number(
        2,
        "terms",
        "nuisance terms, which save more than chance but are too small to name",
        _CHOSEN,
    )
    nuisance_size: float = _number(
        0.12,
        "effect-to-noise ratio",
        "size below which model-form error of other terms is a nuisance, too",
        _CHOSEN,
    )
    most_of_lap: float = _number(
        0.75,
        "1",
        "share of the lap from which on a stretch is no stretch",
        _JUDGEMENT + "what acts nearly all round",
    )
    full_fits: int = _number(
        9, "fits", "candidates that are fitted fully in each step", _JUDGEMENT + "computing time"
    )
    followed: int = _number(
        5,
        "fits",
        "best candidates in which the shared model discrepancy follows the inputs they change",
        _JUDGEMENT + "computing time",
    )
    same_within: float = _number(
        2.5,
        "standard errors",
        "paired block difference up to which two explanations are as good",
        _THEORY + "98.8 % of a normal deviate, two-sided",
    )
    same_excess: float = _number(
        9.0,
        "chi squared",
        "cost above the chosen explanation up to which another is as good, after variance inflation",
        _THEORY + "three standard errors of one parameter",
    )
    same_share: float = _number(
        0.15, "1", "share of what the chosen term saves beyond which a rival is worse whatever its error", _CHOSEN
    )
    same_form_error: float = _number(
        0.01, "1", "share of what the chosen term saves that no single-track model fits better than", _CHOSEN
    )
    least_size: float = _number(0.10, "effect-to-noise ratio", "least size of a further term", _CHOSEN)
    least_witnessed: float = _number(
        0.20,
        "effect-to-noise ratio",
        "size in what a recording knows twice from which on a sensor's fault is no model-form error",
        _CHOSEN,
    )
    form_error_across: float = _number(
        0.07, "1", "model-form error over the size of the chosen terms, where they hardly act", _CHOSEN
    )
    settled: float = _number(
        0.8,
        "1",
        "share of what is left in a channel: a term that takes more is no model-form error of others",
        _JUDGEMENT + "nearly all of it",
    )
    settled_noise: float = _number(
        4.0,
        "1",
        "variance left over noise variance from which on `settled` applies",
        _JUDGEMENT + "twice the noise",
    )
    discrepancy_form_error: float = _number(
        0.10, "1", "model-form error over the size of the shared model discrepancy, in that channel", _CHOSEN
    )
    considered: int = _number(
        3, "terms", "further terms that are considered in each step, those that save most", _CHOSEN
    )
    spread: float = _number(
        3.5,
        "standard errors",
        "saving that a term needs, from differences block by block",
        _THEORY + "5e-4 of a normal deviate, two-sided",
    )
    sure: float = _number(15.0, "standard errors", "or its size, from scores block by block", _CHOSEN)
    plain: float = _number(
        1.0, "effect-to-noise ratio", "or its size against noise", _THEORY + "as large as the noise"
    )
    much_form_error: float = _number(
        3.0,
        "1",
        "variance inflation by model-form error from which on a place is believed like any few moments",
        _CHOSEN,
    )
    fixed_share: float = _number(
        0.2,
        "1",
        "share of the cost to be saved with a fixed baseline",
        _CHOSEN + "; halves of one recording save a ninth",
    )
    sure_level: float = _number(
        1e-12, "1", "p value below which a name needs no second search with a fixed baseline", _CHOSEN
    )
    rounds: int = _number(
        4,
        "rounds",
        "rounds in which terms are added again after rivals have taken places",
        _JUDGEMENT + "computing time",
    )
    swaps: int = _number(
        2, "swaps", "rounds in which a rival may take a term's place", _JUDGEMENT + "computing time"
    )
    least_swap: float = _number(
        1.0,
        "chi squared",
        "cost that a rival has to save to take a term's place",
        _JUDGEMENT + "terms that tie stay",
    )
    beginnings: int = _number(
        2, "searches", "other first terms from which the search begins anew", _JUDGEMENT + "computing time"
    )
    level: float = _number(
        0.01,
        "1",
        "level of the minimum-effect test of a name, after counting the terms tried",
        _JUDGEMENT + "a usual level",
    )
    same_cost: float = _number(
        0.5,
        "chi squared",
        "cost up to which two explanations of the same terms are one, before variance inflation",
        _JUDGEMENT + "a half of what one parameter saves by chance",
    )
    searched_places: float = _number(
        14.0,
        "chi squared",
        "what the best of some thousand stretches saves of model-form error beyond one stretch",
        _THEORY + "2 ln 1000",
    )
    form_error_share: float = _number(
        0.10, "1", "prior deviation of a term's model-form error, as a share of the term's effect", _CHOSEN
    )
    range_deviations: float = _number(
        2.0,
        "standard deviations",
        "between no effect and the largest that a car can have, in the prior of all terms at once",
        _THEORY + "a range holds 95 % of the cars",
    )
    runs_better: float = _number(
        0.9,
        "1",
        "free-running error, over that of the best in one step, below which a variant takes its place",
        _JUDGEMENT + "the error of a rollout is known no better",
    )


@dataclass(frozen=True)
class Abstention:
    """When something is said to have no name."""

    level: float = _number(0.01, "1", "p value below which what is left is no noise", _JUDGEMENT + "a usual level")
    big_effect: float = _number(
        0.5,
        "1",
        "share of what a car can have: where such an effect hides behind what the simulation shows against "
        "itself, no match is said",
        _JUDGEMENT + "half of the way to the bound, for grip about a half",
    )
    share: float = _number(0.08, "1", "share of the gap without a name from which on it is unexplained", _CHOSEN)
    effect_to_noise: float = _number(
        0.12, "effect-to-noise ratio", "size below which nothing is called unexplained", _CHOSEN
    )
    size: float = _number(
        0.12,
        "1",
        "size of the remainder over that of the gap from which on it is unexplained whatever its share",
        _CHOSEN,
    )
    most: float = _number(
        0.6, "effect-to-noise ratio", "size of the remainder from which on it is unexplained in any case", _CHOSEN
    )
    most_alternatives: int = _number(
        4,
        "terms",
        "alternatives, exact degeneracies not counted, above which none of them is named",
        _JUDGEMENT + "a list of more helps nobody",
    )
    lead_share: float = _number(
        0.5,
        "1",
        "share of what the best explanation saves, from which on one that no real car has is reported as a lead",
        _JUDGEMENT + "a half",
    )
    lead_as_good: float = _number(
        0.15,
        "1",
        "share of a lead's saving that a plausible term may lack and still be reported beside it",
        _JUDGEMENT + "as `same_share` of the selection",
    )
    most_leads: int = _number(2, "leads", "leads that are reported", _JUDGEMENT + "a list of more helps nobody")
    widest_place: float = _number(
        0.5,
        "1",
        "share of the track that the interval of a stretch's end may cover",
        _JUDGEMENT + "half the track",
    )


@dataclass(frozen=True)
class Allowances:
    """Differences too small to be called one: what any nominal model misses in one way of driving only."""

    term: float = _number(
        0.05, "effect-to-noise ratio", "size below which a term is not named, beside a simulation", _CHOSEN
    )
    bare: float = _number(
        0.09, "effect-to-noise ratio", "the same against the bare nominal model, which misses more", _CHOSEN
    )
    unnamed: float = _number(
        0.10, "effect-to-noise ratio", "size below which a difference without a name is none", _CHOSEN
    )
    discrepancy_share: float = _number(
        0.03, "1", "share of the shared model discrepancy, by channel, that its dictionary misses", _CHOSEN
    )
    structure_floor: float = _number(
        1e-4, "1", "share of the discrepancy's cost that a flexible fit may save without a difference", _CHOSEN
    )
    term_floor: float = _number(1e-5, "1", "the same for a single term", _CHOSEN)
    form_error_a_parameter: float = _number(
        1.8, "chi squared", "what a flexible fit may save beyond chance by each effective parameter", _CHOSEN
    )


@dataclass(frozen=True)
class SelfTestRules:
    """What the simulation shows against itself, half by half, and how much more reality has to show."""

    least_rows: int = _number(
        150, "rows of 0.04 s", "rows below which a half tells nothing", _JUDGEMENT + "six seconds of driving"
    )
    unnamed_margin: float = _number(
        2.0,
        "1",
        "by how much more reality has to show without a name",
        _JUDGEMENT + "reality may cover other ground than the second half did",
    )
    term_margin: float = _number(1.5, "1", "by how much more reality has to show of a term", _CHOSEN)
    kindred: float = _number(0.33, "1", "share of the largest term's saving that any term may show", _CHOSEN)


@dataclass(frozen=True)
class Screening:
    """What a drive must be before it is judged; what is left out of it."""

    least_seconds: float = _number(8.0, "s", "longest run without a gap below which a drive is refused", _CHOSEN)
    longest_period: float = _number(
        0.1, "s", "sample period above which a drive is refused", _JUDGEMENT + "a yaw mode of 1 to 2 Hz needs ten"
    )
    least_fast: float = _number(
        0.2, "1", "share of the time at a valid speed below which a drive is refused", _CHOSEN
    )
    valid_speed: float = _number(
        0.6, "1", "speed over the vehicle's minimum speed from which on rows are compared", _CHOSEN
    )
    crawl: float = _number(
        0.5,
        "1",
        "the same below which rows are left out before anything is computed",
        _JUDGEMENT + "below the one",
    )
    shortest_run: float = _number(
        0.5,
        "s",
        "length below which a run between crawling is left out",
        _THEORY + "longer than a smoothing window",
    )
    stuck_seconds: float = _number(
        1.0, "s", "time after which a velocity that repeats itself stands still", _CHOSEN
    )
    turn_spread: float = _number(
        0.3,
        "1",
        "spread of yaw rate that speed does not explain, over its mean, below which steering is held on purpose",
        _JUDGEMENT + "a steered car's varies by all of its mean, real circles leave 0.05 to 0.15",
    )
    held_seconds: float = _number(3.0, "s", "the same for a steer angle, which drivers hold", _CHOSEN)
    answer_seconds: float = _number(
        2.0, "s", "time that a car is given to answer a step of the steer angle", _CHOSEN
    )
    position_gap_seconds: float = _number(
        0.5, "s", "gap of position and yaw that is filled by straight lines", _CHOSEN
    )
    least_torque: float = _number(
        0.05, "1", "range of torque over the car's largest below which it is constant", _CHOSEN
    )
    least_steer_ratio: float = _number(
        0.6, "1", "steering over what the file makes of it, below which the recording is of another car", _CHOSEN
    )
    most_steer_ratio: float = _number(1.6, "1", "the same ratio above which it is of another car", _CHOSEN)
    least_torque_ratio: float = _number(
        0.5, "1", "acceleration by torque over what the file makes of it, below which it is another car", _CHOSEN
    )
    most_torque_ratio: float = _number(2.0, "1", "the same ratio above which it is another car", _CHOSEN)
    balance_seconds: float = _number(
        2.0,
        "s",
        "time over which resistance balances torque: what is slower is not taken for acceleration",
        _JUDGEMENT + "a driver's torque steps last less, a change of speed that alters resistance takes longer",
    )
    least_correlation: float = _number(
        0.7, "1", "correlation below which such a ratio is not told", _JUDGEMENT + "half the variance explained"
    )
    least_scale_error: float = _number(
        0.01,
        "1",
        "error of a sensor's scale that is reported",
        _JUDGEMENT + "wheels wear and gyroscopes drift by less",
    )
    sure_scale_error: float = _number(
        6.0, "standard errors", "size of that error from which on it is reported", _CHOSEN
    )


@dataclass(frozen=True)
class Believing:
    """How far rows are believed: wheels that slip, noise of a simulation, and where motion alone compares."""

    rolling_share: float = _number(
        0.9, "1", "share of an axle's peak force asked for, from which on wheels may spin or lock", _CHOSEN
    )
    lost_share: float = _number(0.1, "1", "share of the force asked for that is lost while they do", _CHOSEN)
    rolling_seconds: float = _number(0.2, "s", "time that wheels take to roll again", _CHOSEN)
    least_rolling: float = _number(
        0.5,
        "1",
        "share of the time below which the vehicle file is wrong about the tyres instead",
        _JUDGEMENT + "no driver slips half the time",
    )
    cycling_seconds: float = _number(0.3, "s", "time in which a slip control goes back and forth", _CHOSEN)
    cycling_share: float = _number(
        0.8, "1", "share of the peak force by which a slip control goes back and forth", _CHOSEN
    )
    least_noise: float = _number(
        1e-3,
        "1",
        "least variance that a whitened residual of a simulation is believed to have",
        _JUDGEMENT + "no dictionary holds the physics of a real car",
    )
    most_noise: float = _number(5.0, "1", "largest variance of the same, beyond which nothing is known", _CHOSEN)
    motion_share: float = _number(
        0.7, "1", "share of the tyres' peak up to which rows that moved the same are compared", _CHOSEN
    )
    huber: float = _number(
        4.0, "spreads", "whitened residual from which on a row loses weight", _JUDGEMENT + "far outside the normal"
    )


@dataclass(frozen=True)
class Unnamed:
    """Lines of the spectrum and residual autocorrelation: what is no smooth function of the operating point."""

    slowest: float = _number(
        3.0, "Hz", "least frequency of a line in time, for a full-size car", _JUDGEMENT + "drivers steer slower"
    )
    longest: float = _number(
        4.0, "wheelbases", "longest wave over distance", _JUDGEMENT + "longer waves are the track's"
    )
    fewest: int = _number(2048, "samples", "length of a recording below which no line is sought", _CHOSEN)
    line_level: float = _number(
        1e-3, "1", "p value below which a line is seen, all frequencies counted", _JUDGEMENT + "a usual level"
    )
    shared: float = _number(
        0.5, "1", "share of a line's amplitude from which on the simulation shows it too", _CHOSEN
    )
    line_margin: float = _number(2.0, "1", "amplitude over lines that the simulation has elsewhere", _CHOSEN)
    autocorrelation_margin: float = _number(
        1.5, "1", "long-run variance over that of the simulation that is allowed", _CHOSEN
    )


@dataclass(frozen=True)
class Reporting:
    """What is said of a value, a place and a gap."""

    systematic: float = _number(
        0.03,
        "effect-to-noise ratio",
        "systematic error of a parameter: what one term may take of another",
        _CHOSEN,
    )
    through_tires: float = _number(
        0.10,
        "1",
        "share of itself by which a parameter that acts through the tyres is uncertain",
        _JUDGEMENT + "two curves stand for four tyres",
    )
    least_heldout: int = _number(
        60, "rows of 0.04 s", "rows kept out below which no share of the gap is reported", _CHOSEN
    )
    least_dependence: float = _number(
        0.15, "1", "share of the gap that a variable explains from which on a region of it is reported", _CHOSEN
    )
    clearly_more: float = _number(
        0.1, "1", "by how much place or time has to explain more than how the car is driven", _CHOSEN
    )
    everywhere: float = _number(
        0.8,
        "1",
        "share of the samples from which on a region is everywhere",
        _JUDGEMENT + "it tells nobody where to look",
    )
    local_gap: float = _number(0.3, "1", "share of the gap that a place or a time has to hold", _CHOSEN)
    local_samples: float = _number(0.4, "1", "share of the samples that it may hold at most", _CHOSEN)
    local_ratio: float = _number(2.0, "1", "the share of the gap over that of the samples", _CHOSEN)
    most_gap: float = _number(
        0.6, "1", "share of the gap from which on a place is reported whatever depends on it less", _CHOSEN
    )
    most_ratio: float = _number(4.0, "1", "the same over the share of the samples", _CHOSEN)
    stable: float = _number(
        0.7,
        "1",
        "share of half samples that choose a function for it to stand in the formula",
        _THEORY + "stability selection, Meinshausen and Buehlmann (2010), 0.6 to 0.9",
    )
    formula_terms: int = _number(3, "terms", "functions in the formula at most", _JUDGEMENT + "a lead is short")
    much_slipping: float = _number(
        0.02, "1", "share of the drive with slipping wheels from which on it is reported", _CHOSEN
    )
    least_compared: float = _number(0.7, "1", "compared share of the drive below which it is reported", _CHOSEN)


@dataclass(frozen=True)
class Policy:
    """All numbers that decide, by what they decide on.

    Attributes
    ----------
    comparison : ComparisonRules
    selection : SelectionRules
    abstention : Abstention
    allowances : Allowances
    self_test : SelfTestRules
    screening : Screening
    believing : Believing
    unnamed : Unnamed
    reporting : Reporting
    """

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
