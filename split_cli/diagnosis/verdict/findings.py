"""Findings: which named terms are trusted, with intervals, alternatives and shares, and what is left unexplained."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import STANDARD, Abstention, Policy
from split_cli.diagnosis.recording.measured import measures
from split_cli.diagnosis.remainder.autocorrelation import ResidualAutocorrelation, residual_autocorrelation
from split_cli.diagnosis.search.baselines import SearchOutcome
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, without_parts
from split_cli.diagnosis.search.form_error import residuals_beside_form_error
from split_cli.diagnosis.search.off_centre import confirmed_by_straights
from split_cli.diagnosis.search.rivals import Rival
from split_cli.diagnosis.search.selection import Selection, explaining_as_well
from split_cli.diagnosis.search.term_tests import term_size
from split_cli.diagnosis.statement.result import Combination, Finding, ParameterEstimate, RemainderTest, RivalSummary
from split_cli.diagnosis.statement.sentences import sentence_for, separations
from split_cli.diagnosis.statement.separation import exact_mimics, look_alike, separable_by_lacking, without_doubles
from split_cli.diagnosis.verdict.constancy import Bend, bends, beyond_form_error
from split_cli.diagnosis.verdict.estimates import PartEstimate, estimate_parts
from split_cli.diagnosis.verdict.joint_region import JointRegion, apart_along
from split_cli.diagnosis.verdict.tolerance import named_or_tolerated
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.search import Range

_SHOWN_RIVALS = 6  # other terms that are listed with a finding [1]
_SCALE_STEP = 1e-3  # half range of a known scale in a joint fit [1]


@dataclass(frozen=True)
class _Reported:
    """A finding, with its joint regions and declared alternatives."""

    finding: Finding
    regions: tuple[JointRegion, ...]  # of its parameters, one for each explanation that may be the true one
    declared: tuple[str, ...]  # alternatives by declaration of the terms, whatever the data


@dataclass(frozen=True)
class Description:
    """The findings of a search, and the remainder."""

    selection: Selection  # fitted without terms that are not trusted, in which only trusted ones are named
    searched: Selection  # that of the search, in which only trusted terms are named: others may be leads
    findings: tuple[Finding, ...]
    remainder: RemainderTest
    unexplained: bool  # whether a part of the gap is explained by no finding
    is_apart: bool  # whether the interval of some named term, trusted or not, excludes no effect


def describe(outcome: SearchOutcome, scales: Mapping[str, float] = MappingProxyType({})) -> Description:
    """Return the trusted findings of a search, and what is left.

    Parameters
    ----------
    scales : mapping of str to float
        Wrong scales of speed or yaw rate [1] that no finding accounts for, see `scales_as_terms`. An effect of the car
        is trusted only if its value does not change when these scales are corrected.

    Notes
    -----
    A named term loses its trust in three cases. It explains no more than the unexplained part (`_possibly_imitating`),
    the data do not single it out (`_vague`), or it changes with a corrected scale (`_stays_beside`). The others are
    refitted without it and tested again until none is lost. Then intervals contain the values with and without the lost
    terms.
    """
    selection, variance_inflation = outcome.selection, outcome.variance_inflation
    objective = outcome.structure.objective
    rules = objective.policy.abstention
    left = residuals_beside_form_error(objective, selection.chosen)
    remainder = _remainder(outcome, selection, left)
    reported = _findings(objective, selection, remainder.share)
    findings = _only_findings(reported)
    is_apart = any(map(excludes_no_effect, findings))
    autocorrelation = residual_autocorrelation(outcome.structure, left)
    bent = _sure_bends(objective, selection, variance_inflation)
    unexplained = not findings or _is_unexplained(findings, remainder, autocorrelation, outcome)
    unexplained |= bool(bent) or _errs_too_much(objective, selection, variance_inflation)
    kept = {one.term for one in findings}
    if unexplained or scales:
        imitating = _possibly_imitating(findings, remainder, bent, rules, _nameless_shares(selection))
        kept -= imitating - confirmed_by_witnesses(objective, selection)
    if scales:
        sensors = {one.term for one in findings if not one.exported}
        unexplained, kept = True, sensors | kept & _stays_beside(objective, selection, findings, scales)
    vague = _vague(objective, selection, reported) & kept
    kept -= vague
    while len(kept) < len(findings):
        # The trusted terms are refitted without the others and tested again. A term that lost its trust may be there
        # all the same, so intervals also contain the values beside it.
        unexplained, beside = True, {one.finding.term: one for one in reported}
        # Vague terms stay in the fit as nuisances: without them the others would take up their effect.
        selection = _only(objective, selection, kept | vague)
        left = residuals_beside_form_error(objective, selection.chosen)
        remainder = _remainder(outcome, selection, left)
        selection = _nameless(selection, vague)
        bent = _sure_bends(objective, selection, variance_inflation)
        reported = _findings(objective, selection, remainder.share, beside)
        findings = _only_findings(reported)
        imitating = _possibly_imitating(findings, remainder, bent, rules, _nameless_shares(selection, vague))
        imitating -= confirmed_by_witnesses(objective, selection)
        doubted = _vague(objective, selection, reported) - imitating
        kept = {one.term for one in findings} - doubted - imitating
        if scales:
            # The values have changed and are compared with the corrected scales once more.
            sensors = {one.term for one in findings if not one.exported}
            kept &= sensors | _stays_beside(objective, selection, findings, scales)
        vague |= doubted
    if findings and not (unexplained or all(named_or_tolerated(selection))):
        by_names = _left_by_names(outcome, selection)
        if by_names.p_value < objective.policy.selection.level and by_names.effect_to_noise > _large(outcome):
            unexplained, remainder = True, by_names
    doubted = {term.id for term in outcome.selection.terms} - {one.term for one in findings}
    return Description(selection, _nameless(outcome.selection, doubted), findings, remainder, unexplained, is_apart)


def _only_findings(reported: Sequence[_Reported]) -> tuple[Finding, ...]:
    return tuple(one.finding for one in reported)


def _sure_bends(objective: MarginalLikelihood, selection: Selection, variance_inflation: float) -> list[Bend]:
    """Return significant changes of named terms with a variable: another effect acts, too."""
    found = bends(objective, selection.chosen, selection.named, variance_inflation)
    return [one for one in found if one.p_value * len(found) < objective.policy.selection.level]


def _errs_too_much(objective: MarginalLikelihood, selection: Selection, variance_inflation: float) -> bool:
    """Return whether a named term would need a larger model-form error than a single track has."""
    found = beyond_form_error(objective, selection.chosen, selection.named, variance_inflation)
    return any(p_value * len(found) < objective.policy.selection.level for p_value in found.values())


def confirmed_by_witnesses(objective: MarginalLikelihood, selection: Selection) -> set[str]:
    """Return ids of terms that are confirmed independently of the equations of motion.

    These are sensor faults that remove a fair share of the witnesses' cost, and a steer offset that straights show. An
    unexplained effect of the car changes neither.
    """
    confirmed, rules = confirmed_by_straights(objective, selection.chosen), objective.policy.selection
    after = objective.witnesses_cost(selection.chosen.residuals)
    for part, without in zip(selection.chosen.parts, selection.without, strict=True):
        before = objective.witnesses_cost(without.residuals)
        if part.term.corrects and before - after > rules.fair_share * before:
            confirmed.add(part.candidate.term)
    return confirmed


def _stays_beside(
    objective: MarginalLikelihood, selection: Selection, findings: Sequence[Finding], scales: Mapping[str, float]
) -> set[str]:
    """Return ids of findings that resemble no scale error, and whose values hold when scales are corrected."""
    wrong = []
    for term, value in scales.items():
        ends = Range(value - _SCALE_STEP, value + _SCALE_STEP, _SCALE_STEP)
        wrong.append(Part(Candidate(term, "", {"scale": ends}, ()), {"scale": value}))
    beside = fit_parts(objective, (*selection.chosen.parts, *wrong), slopes_of=selection.chosen)
    values = {part.candidate.term: part.values for part in beside.parts}

    def stays(one: Finding) -> bool:
        ends = {name: estimate.interval_95 for name, estimate in one.parameters.items()}
        return all(low <= values[one.term][name] <= high for name, (low, high) in ends.items())

    return {one.term for one in findings if stays(one) and not any(look_alike(one.term, term) for term in scales)}


def _possibly_imitating(
    findings: Sequence[Finding],
    remainder: RemainderTest,
    bent: Sequence[Bend],
    rules: Abstention,
    nameless: Mapping[str, float] = MappingProxyType({}),
) -> set[str]:
    """Return ids of terms that explain no more than the unexplained part, which they may imitate.

    Included are terms that change with a variable by most of their effect. A steering offset that shows in hard turns
    only is a tyre that is weaker on one side, for example.

    The share of a term that is returned counts as unexplained for the terms that are declared to resemble it, and so do
    the shares in `nameless`: of vague terms and of those at the end of a car's range. Each of the resembling terms has
    to explain more than that and the remainder together. Examples are a CG shift against a tyre stiffness, if only the
    balance of the axles is left, and a steering gain beside tyres at the end of their range.
    """
    explained = {**{one.term: one.gap_explained for one in findings}, **nameless}
    shares = {term: share * (1.0 - remainder.share) for term, share in explained.items()}
    out = {one.term for one in bent if one.term in shares and one.size > rules.greater_part} | set(nameless)
    while True:
        unnamed = {
            term: remainder.share + sum(shares[other] for other in out if look_alike(term, other)) for term in shares
        }
        more = {term for term in shares if term not in out and shares[term] <= unnamed[term]}
        if not more:
            return out
        out |= more


def _declared(objective: MarginalLikelihood, selection: Selection, own: Candidate) -> tuple[str, ...]:
    """Return the alternatives that a term has on recordings of this kind by declaration, whatever the data.

    If model-form error is large, these include terms that only an unrecorded channel would distinguish from it, unless
    witnesses confirm the term.
    """
    little = objective.form_error_inflation <= objective.policy.selection.much_over_noise
    if little or own.term in confirmed_by_witnesses(objective, selection):
        return exact_mimics(own.term, own.variant)
    drives = [one.series.drive for one in objective.evidence]
    measured = {name for name in drives[0].columns if all(measures(drive, name) for drive in drives)}
    return *exact_mimics(own.term, own.variant), *separable_by_lacking(own.term, own.variant, measured)


def _vague(objective: MarginalLikelihood, selection: Selection, reported: Sequence[_Reported]) -> set[str]:
    """Return ids of terms that the data do not single out.

    Such a term has too many alternatives, an undetermined place, or an interval and joint region that contain no
    effect. Or it ends at a car's range after other terms were refitted.
    """
    parts = {part.candidate.term: part for part in selection.chosen.parts}
    rules, out = objective.policy.abstention, set()
    for one in reported:
        term, parameters = one.finding.term, one.finding.parameters
        if parts[term].candidate.at_limit(parts[term].values):
            out.add(term)
        others = without_doubles([name for name in one.finding.alternatives if name not in one.declared])
        if len(others) > rules.most_alternatives:
            out.add(term)
        if not excludes_no_effect(one.finding):
            out.add(term)
        for name in ("s_start", "s_end"):
            if name in parameters:
                low, high = parameters[name].interval_95
                if high - low > rules.greater_part * parts[term].candidate.ranges[name].upper:
                    out.add(term)
    return out


def excludes_no_effect(finding: Finding) -> bool:
    """Return whether the 95 % interval of a parameter, or their joint region, excludes no effect."""
    return finding.combination is not None or one_excludes_no_effect(finding.term, finding.parameters)


def one_excludes_no_effect(term: str, parameters: Mapping[str, ParameterEstimate]) -> bool:
    """Return whether some parameter's interval excludes its neutral value; true if no parameter has a neutral value."""
    neutral = CATALOGUE[term].neutral
    apart = [
        not low <= neutral[name] <= high
        for name, (low, high) in ((name, one.interval_95) for name, one in parameters.items())
        if name in neutral
    ]
    return any(apart) or not apart


def known_together(
    term: str, parameters: Mapping[str, ParameterEstimate], regions: Sequence[JointRegion]
) -> Combination | None:
    """Return a weighted sum of parameters whose interval excludes no effect, if no single interval does; else None.

    Parameters
    ----------
    regions : sequence of JointRegion
        Of the same parameters, one for each explanation that may be the true one.
    """
    if not regions or len(regions[0].names) < 2 or one_excludes_no_effect(term, parameters):
        return None
    weights = apart_along(regions)
    if weights is None:
        return None
    weights = weights / np.abs(weights).max()
    if weights @ regions[0].centre < 0.0:
        weights = -weights
    ends = [one.along(weights) for one in regions]
    names = regions[0].names
    units = {parameters[name].unit for name in names}
    return Combination(
        dict(zip(names, weights.tolist(), strict=True)),
        float(weights @ regions[0].centre),
        units.pop() if len(units) == 1 else "",
        (min(low for low, _ in ends), max(high for _, high in ends)),
    )


def _is_unexplained(
    findings: Sequence[Finding],
    remainder: RemainderTest,
    autocorrelation: ResidualAutocorrelation,
    outcome: SearchOutcome,
) -> bool:
    """Return whether the remainder is large and not noise, by the flexible fit or by autocorrelation."""
    policy = outcome.structure.objective.policy
    least, selection, large = policy.allowances.unnamed, policy.selection, _large(outcome)
    usual = outcome.self_test.usual_autocorrelation(autocorrelation.rows)
    if is_autocorrelated(autocorrelation, usual, policy) and autocorrelation.effect_to_noise > large:
        return True
    if remainder.p_value >= selection.level or remainder.effect_to_noise < least:
        return False
    return remainder.effect_to_noise > large or remainder.share > selection.fair_share


def _large(outcome: SearchOutcome) -> float:
    """Return the effect-to-noise ratio beyond which a remainder is unexplained, whatever its share of the gap [1]."""
    policy = outcome.structure.objective.policy
    of_gap = policy.selection.form_error_share * outcome.gap.effect_to_noise
    return max(policy.allowances.large, min(of_gap, policy.selection.above_noise))


def is_autocorrelated(autocorrelation: ResidualAutocorrelation, usual: float, policy: Policy = STANDARD) -> bool:
    """Return whether rows are autocorrelated by more than in the simulation, and by enough to matter."""
    return (
        autocorrelation.effect_to_noise > policy.allowances.unnamed
        and autocorrelation.p_value(usual, policy.self_test) < policy.selection.level
    )


def with_shares(findings: Sequence[Finding], chosen: Fit, shares: Sequence[float] | None) -> tuple[Finding, ...]:
    """Return findings with their shares on held-out time, if there are any, in descending order of share."""
    if shares is None:
        return tuple(findings)
    by_term = {part.candidate.term: share for part, share in zip(chosen.parts, shares, strict=True)}
    shared = [replace(one, gap_explained=by_term[one.term]) for one in findings]
    return tuple(sorted(shared, key=lambda finding: -finding.gap_explained))


def _remainder(outcome: SearchOutcome, selection: Selection, residuals: np.ndarray) -> RemainderTest:
    """Return the test of residuals, which are those beyond the terms' model-form error."""
    p_value, structure, left = outcome.remainder(residuals)
    share = structure.unnamed_share(left, selection.base.cost - selection.chosen.cost, outcome.variance_inflation)
    return RemainderTest(p_value, share, left.effect_to_noise, left.group_saved)


def _left_by_names(outcome: SearchOutcome, selection: Selection) -> RemainderTest:
    """Return the test of what named terms and sensor errors within tolerance leave without the nuisance terms.

    Nuisance terms may stand for an effect that the search did not find, so what they take up is not explained.
    """
    known = named_or_tolerated(selection)
    named = [part for part, is_known in zip(selection.chosen.parts, known, strict=True) if is_known]
    objective = outcome.structure.objective
    alone = replace(selection, chosen=fit_parts(objective, named))
    left = residuals_beside_form_error(objective, alone.chosen)
    return _remainder(outcome, alone, left)


def _shares(selection: Selection, terms: Set[str]) -> dict[str, float]:
    """Return the share of the explained cost that is lost without each of these terms, by id [1]."""
    chosen = selection.chosen
    total = max(selection.base.cost - chosen.cost, 1e-9)
    return {
        part.candidate.term: float(np.clip((without.cost - chosen.cost) / total, 0.0, 1.0))
        for part, without in zip(chosen.parts, selection.without, strict=True)
        if part.candidate.term in terms
    }


def _nameless_shares(selection: Selection, vague: Set[str] = frozenset()) -> dict[str, float]:
    """Return the shares of vague terms and of unnamed terms at the end of a car's range, by id [1]."""
    unnamed = zip(selection.chosen.parts, selection.named, strict=True)
    ends = {part.candidate.term for part, named in unnamed if not named and part.candidate.at_limit(part.values)}
    return _shares(selection, vague | ends)


def _only(objective: MarginalLikelihood, selection: Selection, terms: set[str]) -> Selection:
    """Return the selection refitted with only these of its named terms; nuisance terms stay."""
    keep = [
        k
        for k, (part, named) in enumerate(zip(selection.chosen.parts, selection.named, strict=True))
        if part.candidate.term in terms or not named
    ]
    parts = tuple(selection.chosen.parts[k] for k in keep)
    chosen = fit_parts(objective, parts) if parts else selection.base
    others = tuple(_as_another(part, selection.rivals[k]) for part, k in zip(chosen.parts, keep, strict=True))
    if any(another is not part for another, part in zip(others, chosen.parts, strict=True)):
        chosen = fit_parts(objective, others)
    return replace(
        selection,
        chosen=chosen,
        without=without_parts(objective, selection.base, chosen),
        rivals=tuple(selection.rivals[k] for k in keep),
        siblings=tuple(selection.siblings[k] for k in keep),
        named=tuple(selection.named[k] for k in keep),
    )


def _nameless(selection: Selection, terms: Set[str]) -> Selection:
    """Return a selection in which these terms are nuisance terms."""
    named = tuple(
        one and part.candidate.term not in terms
        for one, part in zip(selection.named, selection.chosen.parts, strict=True)
    )
    return replace(selection, named=named)


def _as_another(part: Part, rivals: Sequence[Rival]) -> Part:
    """Return the alternative that a part is equal to at its values, as a grip that fades at once; else the part."""
    if not part.candidate.is_another(part.values):
        return part
    own = part.candidate
    alike = (rival.fit.parts[-1] for rival in rivals)
    return next((one for one in alike if look_alike(own.term, one.candidate.term)), part)


def _findings(
    objective: MarginalLikelihood,
    selection: Selection,
    unnamed: float,
    beside: Mapping[str, _Reported] = MappingProxyType({}),
) -> tuple[_Reported, ...]:
    """Return the findings of a selection.

    Parameters
    ----------
    unnamed : float
        Unexplained share of the gap [1].
    beside : mapping of str to _Reported
        Earlier results by term, whose intervals are included.
    """
    chosen = selection.chosen
    estimates = estimate_parts(objective, chosen)
    shares = _shares(selection, {part.candidate.term for part in chosen.parts})
    vehicle, out = objective.evidence[0].vehicle, []
    for k, (part, rivals) in enumerate(zip(chosen.parts, selection.rivals, strict=True)):
        if not selection.named[k]:
            continue
        term, variant = part.candidate.term, part.candidate.variant
        declared = _declared(objective, selection, part.candidate)
        alternatives = _alternatives(objective, selection, k, declared)
        parameters, regions = _with_variants(objective, selection, k, estimates[k], unnamed)
        if term in beside:
            parameters = _covering(parameters, beside[term].finding.parameters)
            regions += _of_the_same(regions, beside[term].regions)
        combination = known_together(term, parameters, regions)
        finding = Finding(
            term,
            variant,
            parameters,
            shares[term],
            alternatives,
            sentence_for(term, variant, parameters, alternatives, vehicle, combination),
            term_size(objective, chosen, k),
            _runners_up(rivals),
            separations(term, variant, alternatives),
            CATALOGUE[term].exported,
            combination,
        )
        out.append(_Reported(finding, regions, declared))
    return tuple(sorted(out, key=lambda one: -one.finding.gap_explained))


def _with_variants(
    objective: MarginalLikelihood, selection: Selection, k: int, own: PartEstimate, unnamed: float
) -> tuple[dict[str, ParameterEstimate], tuple[JointRegion, ...]]:
    """Return estimates and regions of a part, with those of other variants that explain the data as well.

    Variants whose savings differ by less than the share `unnamed` of the gap count as equally good.
    """
    parameters, regions = dict(own.parameters), own.regions
    for sibling in explaining_as_well(objective, selection, k, selection.siblings[k], unnamed):
        other = estimate_parts(objective, sibling.fit)[-1]
        parameters = _covering(parameters, other.parameters)
        regions += _of_the_same(regions, other.regions)
    return parameters, regions


def _of_the_same(regions: Sequence[JointRegion], others: Sequence[JointRegion]) -> tuple[JointRegion, ...]:
    """Return the regions that have the same parameters."""
    return tuple(one for one in others if regions and one.names == regions[0].names)


def _covering(
    own: Mapping[str, ParameterEstimate], others: Mapping[str, ParameterEstimate]
) -> dict[str, ParameterEstimate]:
    """Return estimates whose intervals also contain those of others of the same name."""
    return {name: one.covering(others[name]) if name in others else one for name, one in own.items()}


def _alternatives(
    objective: MarginalLikelihood, selection: Selection, k: int, declared: Sequence[str]
) -> tuple[str, ...]:
    """Return ids of terms that explain the data as well as part k, and the declared alternatives."""
    rivals = explaining_as_well(objective, selection, k, selection.rivals[k])
    names = [*(rival.fit.parts[-1].candidate.term for rival in rivals), *declared]
    taken = {part.candidate.term for part in selection.chosen.parts}
    return tuple(name for name in dict.fromkeys(names) if name not in taken)


def _runners_up(rivals: Sequence[Rival]) -> tuple[RivalSummary, ...]:
    """Return the best variant of each of the best other terms."""
    best: dict[str, RivalSummary] = {}
    for rival in rivals:
        one = rival.fit.parts[-1].candidate
        best.setdefault(one.term, RivalSummary(one.term, one.variant, rival.excess, rival.z))
    return tuple(best.values())[:_SHOWN_RIVALS]
