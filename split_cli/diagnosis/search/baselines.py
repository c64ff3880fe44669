"""`search`: the search for terms with a marginalised baseline, and with a fixed one where the first leaves doubt.

With a marginalised baseline the uncertain shared discrepancy explains a part of the gap before any term does. That is
right if its basis functions represent the simulation. If model-form error is large, as between real recordings, the
discrepancy is uncertain at all operating points that the simulation has not visited. A fault that takes a drive there,
such as a steering gain of 0.8, then hides in the discrepancy.

With a fixed baseline such a fault saves cost, if its correction leads back to operating points of the simulation. Only
terms that alter inputs or sensors do that. So if model-form error is large, both searches are made, and `reconciled`
takes names and values from the one with the smaller p value. Other terms are named with a fixed baseline only if the
first search had chosen them too. Finally `late_channel` asks the witnesses for a delay.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from split_cli.diagnosis.innovations.case import DiagnosisCase
from split_cli.diagnosis.innovations.objective import MarginalLikelihood, alters_inputs, build_objective
from split_cli.diagnosis.policy import STANDARD, Policy, SelectionRules
from split_cli.diagnosis.remainder.autocorrelation import residual_autocorrelation
from split_cli.diagnosis.remainder.flexible import flexible_rows
from split_cli.diagnosis.remainder.oscillation import Oscillators, build_oscillators, oscillator_rows
from split_cli.diagnosis.remainder.structure import FlexibleFit, Structure, build_structure
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.form_error import residuals_beside_form_error
from split_cli.diagnosis.search.late_channel import with_late_channel
from split_cli.diagnosis.search.off_centre import with_offset_of_straights
from split_cli.diagnosis.search.selection import Selection, explaining_as_well, nothing, select_terms, with_chosen
from split_cli.diagnosis.search.self_test import SelfTest, self_test
from split_cli.diagnosis.search.term_tests import is_witnessed, term_p, witnessed_p
from split_cli.diagnosis.search.variant_choice import with_variants_by_rollout
from split_cli.diagnosis.statement.separation import exact_mimics
from split_cli.vehicle.effects import Term


@dataclass(frozen=True)
class SearchOutcome:
    """What the search found in the real recordings."""

    structure: Structure  # with the objective
    gap: FlexibleFit  # of the residuals without any term: the whole gap
    selection: Selection
    self_test: SelfTest  # of the halves of the simulation, with the same baseline
    variance_inflation: float  # factor by which residual autocorrelation widens chi squared [1]
    # With a marginalised baseline, and with a fixed one if that was searched too.
    objectives: tuple[MarginalLikelihood, ...] = ()
    oscillators: Oscillators | None = None  # the fits of oscillators to the same rows
    case: DiagnosisCase | None = None  # the case that was searched; None for one search alone

    def remainder(self, residuals: np.ndarray) -> tuple[float, Structure, FlexibleFit]:
        """Test whether whitened residuals (R,) are noise, by the flexible fit and by oscillators.

        Of the fits that noise does not explain the larger one counts, otherwise the one that noise makes less likely.

        Returns
        -------
        p_value : float
            Of noise alone, corrected for the number of tests (Bonferroni).
        structure : Structure
            The fit that counts.
        fit : FlexibleFit
            Its result.
        """
        flexible = self.structure.fit(residuals, self.variance_inflation)
        if self.oscillators is None:
            return flexible.p_value, self.structure, flexible
        tested = [
            (flexible.p_value, self.structure, flexible),
            self.oscillators.least_likely(residuals, self.variance_inflation),
        ]
        tested = [(min(1.0, len(tested) * p_value), structure, fit) for p_value, structure, fit in tested]
        level = self.structure.objective.policy.selection.level
        sure = [one for one in tested if one[0] < level]
        return max(sure, key=lambda one: one[2].effect_to_noise) if sure else min(tested, key=lambda one: one[0])


def search(
    case: DiagnosisCase,
    candidates: Sequence[Candidate],
    *,
    reach: float,
    policy: Policy = STANDARD,
    progress: Callable[[str], None] = lambda step: None,
) -> SearchOutcome:
    """Search for the terms that explain the gap, with one baseline or with both, see above.

    The search is repeated on rows whitened about the found explanation, if these differ by more than a tie
    (`DiagnosisCase.whitened_about`). If a channel is late, it is repeated with that channel shifted as a whole: fast
    signal that stays in its place looks like a lag.

    Parameters
    ----------
    reach : float
        See `ComparisonRules`.
    progress : callable
        Called with the name of each step.
    """
    progress("comparing")
    objective = _objective_of(case, policy)
    tested, tested_fixed = _self_tests_of(case, candidates, reach, policy)
    progress("naming")
    found = _search_by_baselines(candidates, objective, tested, tested_fixed, progress)
    terms = found.selection.chosen.terms
    again = case.whitened_about(terms, policy)
    if again is not case and _differ(objective, other := _objective_of(again, policy), terms):
        progress("naming again beside what was found")
        if again.rewhitened is not case.rewhitened:
            tested, tested_fixed = _self_tests_of(again, candidates, reach, policy)
        case, objective = again, other
        del found  # its caches are as large as those of the second search
        found = _search_by_baselines(candidates, objective, tested, tested_fixed, progress)
    late = [term for term in found.selection.terms if term.moves_samples]
    if late:
        progress("naming with the late channel put right")
        objective = objective.with_residue_moved(late)
        found = _search_by_baselines(candidates, objective, tested, tested_fixed, progress)
    return replace(found, case=case)


def _objective_of(case: DiagnosisCase, policy: Policy) -> MarginalLikelihood:
    rows = case.real, case.posterior, case.discrepancy, case.keep, case.kinematics
    return replace(build_objective(*rows, policy=policy), about_explanation=bool(case.explaining))


def _differ(one: MarginalLikelihood, other: MarginalLikelihood, terms: Sequence[Term]) -> bool:
    """Return whether two objectives of the same recordings differ by more than a tie in the rows of an explanation."""
    before, after = (objective.whiten(objective.raw_residual(terms)) for objective in (one, other))
    tie = one.policy.selection.tie * one.policy.comparison.variance_inflation
    return float(np.sum((after - before) ** 2)) > tie


def _search_by_baselines(
    candidates: Sequence[Candidate],
    objective: MarginalLikelihood,
    tested: SelfTest,
    tested_fixed: Callable[[], SelfTest],
    progress: Callable[[str], None],
) -> SearchOutcome:
    """Search with a marginalised baseline, and with a fixed one if model-form error is large.

    `tested` and `tested_fixed` are the self-tests of the simulation with either baseline.
    """
    first = _search(objective, candidates, tested)
    if tested.ratio <= objective.policy.selection.much_over_noise:
        asked = first.structure.objective, first.selection, candidates, first.variance_inflation
        return replace(first, selection=with_offset_of_straights(*asked))
    progress("naming with a fixed baseline")
    again = search_with_fixed_baseline(candidates, objective, tested_fixed())
    again = with_names_of_first(first, again, candidates)
    found = reconciled(first, again, objective.policy.selection)
    asked = found if any(found.selection.named) else again
    late = with_late_channel(asked.structure.objective, asked.selection, candidates, asked.variance_inflation)
    return found if late is None else replace(asked, selection=late, objectives=found.objectives)


def search_with_fixed_baseline(
    candidates: Sequence[Candidate], objective: MarginalLikelihood, tested: SelfTest
) -> SearchOutcome:
    """Search with a fixed baseline on the rows and with the policy of a marginalised objective."""
    policy = objective.policy
    # The discrepancy changes at every step of a fit, so that costs have several minima.
    wide = [one.widely_started() if _alters(one) else one for one in candidates]
    # Small terms are model-form error here, and would share the saving of a delay.
    alone = replace(policy, selection=replace(policy.selection, most_nuisances=0))
    return _search(replace(objective.with_fixed_baseline(), policy=alone), wide, tested)


def reconciled(first: SearchOutcome, again: SearchOutcome, rules: SelectionRules) -> SearchOutcome:
    """Return the result of two searches: `first` with a marginalised, `again` with a fixed baseline.

    In this order:

    1. If all names of `again` may be believed (`_brings_back`) and its p value is smaller, it is the result.
    2. If they may be believed and include all names of `first`, further names of `again` are added that are sure by
       themselves; without any, `first` is the result.
    3. If `again` names nothing, because an actuator or sensor would be beyond a car's range, it is the result.
    4. If `first` is not sure, it keeps only the names that `again` shares. If none is left, `again` is the result where
       `first` has its names as nuisance terms.
    5. If `first` is sure as a whole, it keeps each name that is sure by itself or that `again` shares.
    """
    marginalised, fixed = first.selection, again.selection
    confirmed = bool(marginalised.terms) and _ids(marginalised) <= _ids(fixed)
    surer = not marginalised.terms or fixed.first_p <= marginalised.first_p
    brought_back = _brings_back(fixed, first, rules)
    kept = first
    if brought_back and surer:
        kept = again
    elif brought_back and confirmed:
        more = _only_named(fixed, _undoubted(again, _ids(marginalised), rules))
        kept = replace(again, selection=more) if _ids(more) > _ids(marginalised) else first
    elif surer and ends_beyond(fixed, again.structure.objective.policy):
        kept = again
    elif marginalised.terms and marginalised.first_p >= rules.sure_level:
        shared = _ids(fixed) if brought_back else set()
        both = [part.candidate.term in shared for part in marginalised.chosen.parts]
        kept = replace(first, selection=_only_named(marginalised, both))
        explained = {part.candidate.term for part in marginalised.chosen.parts}
        # Both searches contain it; in the first it was too small to be named.
        kept = again if brought_back and not any(kept.selection.named) and _ids(fixed) <= explained else kept
    elif len(marginalised.terms) > 1:
        kept = replace(first, selection=_only_named(marginalised, _undoubted(first, _ids(fixed), rules)))
    return replace(kept, objectives=(first.structure.objective, again.structure.objective))


def with_names_of_first(first: SearchOutcome, again: SearchOutcome, candidates: Sequence[Candidate]) -> SearchOutcome:
    """Return the search with a fixed baseline, in which a term named by the first replaces one that is no better.

    Rotating masses reduce the acceleration as a weak torque does, for example, so that either search may name either.
    """
    objective, selection = again.structure.objective, again.selection
    missing = _ids(first.selection) - _ids(selection)
    for k, (term, several) in enumerate(zip(selection.chosen.terms, selection.rivals, strict=True)):
        if alters_inputs(term) or term.id in _ids(first.selection):
            continue
        for rival in explaining_as_well(objective, selection, k, several):
            if rival.fit.parts[-1].candidate.term in missing:
                explore = Explorer(objective, tuple(candidates), again.variance_inflation)
                found = with_chosen(explore, selection, rival.fit)
                note = f"{rival.fit.parts[-1].candidate.label} replaces {term.id}, which explains no better"
                return replace(again, selection=replace(found, history=(*selection.history, note)))
    return again


def ends_beyond(selection: Selection, policy: Policy) -> bool:
    """Return whether nothing is named because the explanation needs an actuator or sensor beyond a car's range.

    Then there is a difference without a finding, and a lead reports the value that it would need.
    """
    if selection.terms or selection.first_p >= policy.selection.sure_level:
        return False
    chosen, least = (selection.chosen, policy.abstention.greater_part * (selection.base.cost - selection.chosen.cost))
    return any(
        part.candidate.at_limit(part.values) and alters_inputs(part.term) and without.cost - chosen.cost > least
        for part, without in zip(chosen.parts, selection.without, strict=True)
    )


def _ids(selection: Selection) -> set[str]:
    return {term.id for term in selection.terms}


def _alters(candidate: Candidate) -> bool:
    return bool(candidate.starts) and alters_inputs(candidate.build(candidate.starts[0]))


def _brings_back(selection: Selection, first: SearchOutcome, rules: SelectionRules) -> bool:
    """Return whether all names of a search with a fixed baseline may be believed.

    These are terms that alter inputs or sensors. If the search is sure, they are also terms that the search with a
    marginalised baseline chose, named or as a nuisance, or could not distinguish from a named one. With a fixed
    baseline alone, an error of the discrepancy off the simulation's operating points looks like physics.
    """
    chosen: set[str] = set()
    for k in range(len(first.selection.chosen.parts)) if selection.first_p < rules.sure_level else ():
        for one in _indistinguishable(first, k):
            # Exact alternatives count as chosen: a whole friction curve is its peak with both stiffnesses.
            alike = (name for terms in exact_mimics(one.term, one.variant) for name in terms.split("+"))
            chosen |= {one.term, *alike}
    return bool(selection.terms) and all(alters_inputs(t) or t.id in chosen for t in selection.terms)


def _indistinguishable(outcome: SearchOutcome, k: int) -> list[Candidate]:
    """Return the candidate of a chosen part and, if it is named, those that explain as well."""
    selection = outcome.selection
    several = selection.rivals[k] if selection.named[k] else ()
    alike = explaining_as_well(outcome.structure.objective, selection, k, several) if several else ()
    return [selection.chosen.parts[k].candidate, *(rival.fit.parts[-1].candidate for rival in alike)]


def _undoubted(outcome: SearchOutcome, confirmed: set[str], rules: SelectionRules) -> list[bool]:
    """Return which parts of a search are confirmed by the other search, or sure by themselves beside the others."""
    objective, selection = outcome.structure.objective, outcome.selection
    chosen = selection.chosen

    def is_sure(k: int) -> bool:
        saved = selection.without[k].cost - chosen.cost
        p_value = min(
            term_p(objective, chosen, k, saved, outcome.variance_inflation),
            witnessed_p(objective, chosen, k, selection.without[k], rules),
        )
        return p_value * max(len(selection.first), 1) < rules.sure_level

    return [part.candidate.term in confirmed or is_sure(k) for k, part in enumerate(chosen.parts)]


def _only_named(selection: Selection, kept: Sequence[bool]) -> Selection:
    """Return a selection in which only chosen parts keep their names; the others become nuisance terms."""
    named = tuple(one and keep for one, keep in zip(selection.named, kept, strict=True))
    rivals, siblings = (
        tuple(several if keep else () for several, keep in zip(those, named, strict=True))
        for those in (selection.rivals, selection.siblings)
    )
    return replace(selection, named=named, rivals=rivals, siblings=siblings)


def with_witnessed_names(outcome: SearchOutcome) -> SearchOutcome:
    """Return an outcome in which only sensor faults that witnesses see are named.

    No model of the car is used for these, so the operating points of the simulation do not matter.
    """
    objective, chosen = outcome.structure.objective, outcome.selection.chosen
    seen = [is_witnessed(objective, chosen, k) for k in range(len(chosen.parts))]
    return replace(outcome, selection=_only_named(outcome.selection, seen))


def _self_tests_of(
    case: DiagnosisCase, candidates: Sequence[Candidate], reach: float, policy: Policy
) -> tuple[SelfTest, Callable[[], SelfTest]]:
    """Return the self-test with a marginalised baseline, and a function that computes the one with a fixed baseline."""
    asked = partial(_self_test_of, case, candidates, reach, policy)
    return asked(), cache(partial(asked, fixed_baseline=True))


def _self_test_of(
    case: DiagnosisCase, candidates: Sequence[Candidate], reach: float, policy: Policy, *, fixed_baseline: bool = False
) -> SelfTest:
    """Return the self-test of the simulation; one without rows if there is no simulation."""
    if not case.rewhitened:
        return SelfTest()
    return self_test(
        case.rewhitened,
        case.discrepancy,
        candidates,
        case.kinematics,
        variance_inflation=policy.comparison.variance_inflation,
        reach=reach,
        posterior=case.posterior,
        fixed_baseline=fixed_baseline,
        policy=policy,
    )


def _search(objective: MarginalLikelihood, candidates: Sequence[Candidate], tested: SelfTest) -> SearchOutcome:
    """Search on one objective, with the thresholds of a self-test."""
    objective = tested.allow(objective)
    pieces = [flexible_rows(one, objective.discrepancy) for one in objective.evidence]
    structure = build_structure(objective, pieces, tested.floor(tested.unnamed, objective))
    floors = {group: tested.floor(saved, objective) for group, saved in tested.swinging.items()}
    oscillators = build_oscillators(objective, list(map(oscillator_rows, objective.evidence)), floors)
    base = nothing(objective)
    variance_inflation = max(
        objective.policy.comparison.variance_inflation, residual_autocorrelation(structure, base.residuals).ratio
    )
    gap = structure.fit(base.residuals, variance_inflation)
    objective = replace(objective, form_error_inflation=tested.form_error_inflation_of(gap, objective.policy))
    structure, oscillators = replace(structure, objective=objective), oscillators.with_objective(objective)
    policy = objective.policy

    def is_structure(residuals: np.ndarray) -> bool:
        left = structure.fit(residuals, variance_inflation)
        return left.p_value < policy.selection.level and left.effect_to_noise > policy.allowances.unnamed

    selection = select_terms(
        objective,
        candidates,
        variance_inflation,
        lambda fit: is_structure(residuals_beside_form_error(objective, fit)),
        lambda fit: is_structure(fit.residuals),
    )
    selection = with_variants_by_rollout(structure, candidates, selection, variance_inflation)
    return SearchOutcome(structure, gap, selection, tested, variance_inflation, (objective,), oscillators)
