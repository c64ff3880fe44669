"""From statements and answers to rates: by kind and tier, confusions, interval coverage, gap removed."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.errors import VehicleError
from split_cli.proof.cases import Answer
from split_cli.proof.outcome import OUTCOMES, Named, Rate, Statement, judge, share_of_true
from split_cli.proof.plan import TIERS
from split_cli.proof.strange import NAMED_SINCE
from split_cli.proof.truth import ExactDrive, removed_share
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import Vehicle


@dataclass(frozen=True)
class CaseScore:
    """How a case was answered."""

    name: str
    answer: Answer
    said: Statement
    outcome: str  # of `outcome.OUTCOMES`
    # ``term.parameter`` of rightly named terms, and whether the 95 % interval holds the truth.
    covered: tuple[tuple[str, bool], ...] = ()
    # Share of the held-out gap the findings remove over what the true terms remove [1].
    removed: float | None = None

    @property
    def group(self) -> str:
        """``null``, ``single easy`` ..., ``pair``, ``strange``."""
        return f"{self.answer.kind} {self.answer.tier}".strip()


def score_case(
    name: str, answer: Answer, said: Statement, heldout: ExactDrive | None, noise: np.ndarray, vehicle: Vehicle
) -> CaseScore:
    """Score a statement against the answer."""
    truth, judged = [effect.term for effect in answer.effects], said
    if answer.kind == "whole-car":
        # What is there and small may be named; it is not asked for.
        small = {effect.term for effect in answer.effects if effect.effect_to_noise < TIERS["realistic"][0]}
        truth = [term for term in truth if term not in small]
        judged = replace(said, findings=tuple(one for one in said.findings if one.term not in small))
    strange = answer.kind == "strange"
    outcome = judge(truth, judged, in_catalogue=not strange)
    if strange and said.findings and {one.term for one in said.findings} == {NAMED_SINCE.get(truth[0])}:
        outcome = "exact"
    by_term = {finding.term: finding for finding in said.findings}
    covered = []
    for effect in answer.effects:
        finding = by_term.get(effect.term)
        for parameter in effect.scored if finding else ():
            if parameter in finding.parameters:
                _, low, high = finding.parameters[parameter]
                true = effect.parameters[parameter]
                # A wave of negative amplitude is one of positive amplitude, half a wave on.
                held = low <= true <= high or (parameter == "amplitude" and low <= -true <= high)
                covered.append((f"{effect.term}.{parameter}", held))
    removed = None
    if heldout is not None and answer.kind in ("single", "pair") and answer.removed > 0.05:
        removed = found_terms_removed(answer, said, heldout, noise, vehicle) / answer.removed
    return CaseScore(name, answer, said, outcome, tuple(covered), removed)


def found_terms_removed(
    answer: Answer, said: Statement, heldout: ExactDrive, noise: np.ndarray, vehicle: Vehicle
) -> float:
    """Return the share of the held-out gap that the findings remove [1]; what fits no term counts as 0."""
    terms = []
    for finding in said.findings:
        values = {parameter: value for parameter, (value, _, _) in finding.parameters.items()}
        kind = CATALOGUE.get(finding.term)
        variant = finding.variant or (_variant_of(kind, values) if kind else "")
        if kind is None or set(kind.parameter_units(variant)) != set(values):
            continue
        terms.append(kind(_on_the_centreline(values, answer), variant))
    try:
        share = removed_share(heldout, vehicle, terms, noise)
    except VehicleError:
        return 0.0
    return share if np.isfinite(share) else 0.0


def _variant_of(kind, values: dict[str, float]) -> str:
    """Return the first variant whose parameters have these names."""
    return next((v for v in kind.variants if set(kind.parameter_units(v)) == set(values)), "")


def _on_the_centreline(values: dict[str, float], answer: Answer) -> dict[str, float]:
    """Return parameters with places along the drive turned into places along the track's centreline."""
    if not answer.lap_driven:
        return values
    ratio, origin, lap = answer.lap_length / answer.lap_driven, answer.s_origin, answer.lap_length
    out = dict(values)
    for name in ("s_start", "s_end"):
        if name in out:
            out[name] = (origin + ratio * out[name]) % lap
    if "wavelength" in out:
        out["wavelength"] = ratio * out["wavelength"]
        out["phase"] = out["phase"] - 2.0 * np.pi * origin / out["wavelength"]
    return out


@dataclass(frozen=True)
class CaseSetScore:
    """The score of a set of cases."""

    groups: tuple[tuple[str, dict[str, Rate]], ...]  # for each kind and tier, the rate of each outcome
    # What is asked for, in words; the goal; what was reached; whether it is met (None when nothing counted).
    targets: tuple[tuple[str, str, Rate | float | None, bool | None], ...]
    # Truth, statement, how often; only where they differ from the truth alone.
    confusion: tuple[tuple[str, str, int], ...]
    coverage: Rate
    coverage_by_parameter: tuple[tuple[str, Rate], ...]
    # seconds_median, seconds_most, memory_most: of one identification [s], [s], [MB].
    seconds_median: float = 0.0
    seconds_most: float = 0.0
    memory_most: float = 0.0


def score_of_cases(scores: Sequence[CaseScore]) -> CaseSetScore:
    """Return rates, targets and confusions of scored cases."""
    names = sorted({score.group for score in scores}, key=_group_order)
    groups = tuple(
        (name, {kind: share_of_true([s.outcome == kind for s in scores if s.group == name]) for kind in OUTCOMES})
        for name in names
    )
    covered = [entry for score in scores for entry in score.covered]
    parameters = sorted({name for name, _ in covered})
    ratios = [score.removed for score in scores if score.removed is not None]
    coverage = share_of_true([inside for _, inside in covered])
    median = float(np.median(ratios)) if ratios else None
    return CaseSetScore(
        groups=groups,
        targets=_targets(scores, coverage, median),
        confusion=_confusion(scores),
        coverage=coverage,
        coverage_by_parameter=tuple(
            (parameter, share_of_true([inside for name, inside in covered if name == parameter]))
            for parameter in parameters
        ),
    )


def _group_order(name: str) -> tuple[int, str]:
    singles = ("single easy", "single realistic", "single hard")
    order = ("null", *singles, "pair", "hard-pair", "set", "nominal-set", "whole-car", "strange")
    return (order.index(name) if name in order else len(order), name)


def _targets(scores: Sequence[CaseScore], coverage: Rate, median: float | None) -> tuple:
    def rate(group: str, *outcomes: str) -> Rate:
        return share_of_true([s.outcome in outcomes for s in scores if s.group.startswith(group)])

    singles_wrong = rate("single", "wrong")
    sets = [score for score in scores if score.answer.kind.endswith("set")]
    entries = (
        [
            ("sets: effects named, or in class", "at least 95 %", _recall(sets), 0.95, True),
            ("sets: names that are none of theirs, of all named", "at most 2 %", _wrongly_named(sets), 0.02, False),
            (
                "sets complete",
                "at least 80 %",
                share_of_true([s.outcome in ("exact", "class") for s in sets]),
                0.80,
                True,
            ),
        ]
        if sets
        else []
    )
    whole = [score for score in scores if score.answer.kind == "whole-car"]
    entries += (
        [
            ("whole cars: physics above 0.35 named, or in class", "at least 85 %", _recall(whole), 0.85, True),
            ("whole cars: names of what is not there, of all named", "none", _wrongly_named(whole), 0.0, False),
        ]
        if whole
        else []
    )
    entries += [
        ("nulls called a mismatch", "at most 2 %", rate("null", "wrong"), 0.02, False),
        ("singles named exactly, realistic", "at least 95 %", rate("single realistic", "exact"), 0.95, True),
        ("singles exact or in class, hard", "at least 75 %", rate("single hard", "exact", "class"), 0.75, True),
        ("singles confidently wrong", "at most 2 %", singles_wrong, 0.02, False),
        ("singles named rightly and called unexplained as well", "at most 5 %", _doubted(scores), 0.05, False),
        ("pairs, both right", "at least 85 %", rate("pair", "exact", "class"), 0.85, True),
        ("hard pairs, both right", "at least 75 %", rate("hard-pair", "exact", "class"), 0.75, True),
        ("outside the catalogue unexplained", "at least 85 %", rate("strange", "exact"), 0.85, True),
        ("95 % intervals hold the truth", "at least 88 %", coverage, 0.88, True),
    ]
    found = [
        (what, goal, r, None if r.share is None else (r.share >= bound if least else r.share <= bound))
        for what, goal, r, bound, least in entries
    ]
    met = None if median is None else median >= 0.95
    return (*found, ("held-out gap removed, median, of what the true terms remove", "at least 0.95", median, met))


def _doubted(scores: Sequence[CaseScore]) -> Rate:
    """Return how many singles that are named rightly are called unexplained beside that."""
    return share_of_true(
        [
            score.said.unexplained
            for score in scores
            if score.answer.kind == "single" and score.outcome in ("exact", "class")
        ]
    )


def _recall(sets: Sequence[CaseScore]) -> Rate:
    """Return how many effects of sets are named, or among the alternatives of a finding."""
    return share_of_true(
        [
            any(effect.term == one.term or effect.term in one.alternatives for one in score.said.findings)
            for score in sets
            for effect in score.answer.effects
            if score.answer.kind != "whole-car" or effect.effect_to_noise >= TIERS["realistic"][0]
        ]
    )


def _wrongly_named(sets: Sequence[CaseScore]) -> Rate:
    """Return how many findings in sets are none of the effects, nor have one among their alternatives."""
    return share_of_true(
        [
            not {one.term, *one.alternatives} & {effect.term for effect in score.answer.effects}
            for score in sets
            for one in score.said.findings
        ]
    )


def _confusion(scores: Sequence[CaseScore]) -> tuple[tuple[str, str, int], ...]:
    counted: Counter[tuple[str, str]] = Counter()
    for score in scores:
        if score.outcome == "exact":
            continue
        truth = " + ".join(sorted(e.term for e in score.answer.effects)) or "nothing"
        counted[truth, in_short(score.said)] += 1
    return tuple((truth, said, n) for (truth, said), n in sorted(counted.items()))


def in_short(said: Statement) -> str:
    """Return a statement in short."""
    if said.verdict != "mismatch":
        return said.verdict
    names = " + ".join(sorted(finding.term for finding in said.findings)) or "no name"
    return f"{names}, unexplained" if said.unexplained else names


def statement_of(diagnosis: dict) -> Statement:
    """Return what a `diagnosis.json` says."""

    def named(finding: dict) -> Named:
        values = {name: (entry["value"], *entry["interval_95"]) for name, entry in finding["parameters"].items()}
        return Named(finding["term"], values, tuple(finding["alternatives"]), finding.get("variant", "") or "")

    return Statement(diagnosis["verdict"], tuple(map(named, diagnosis["findings"])), bool(diagnosis["unexplained"]))
