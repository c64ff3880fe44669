"""The diagnosis, step by step: whether simulation and reality differ, where, by which effects, and whether these help.

`diagnose` calls the packages of `split_cli/diagnosis/` in their order; docs/inside_diagnosis.md shows the objects that
one step hands to the next.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from split_cli.diagnosis.innovations.case import DiagnosisCase, gather_case
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.parallel import map_in_threads
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.cleaning import clean_drives, moving
from split_cli.diagnosis.recording.excitation import idle
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.diagnosis.recording.scales import in_sentences, out_of_scale, scales_as_terms
from split_cli.diagnosis.recording.screening import unfit
from split_cli.diagnosis.recording.series import Series, build_series
from split_cli.diagnosis.recording.witnesses import Witness, is_witness_of_position
from split_cli.diagnosis.remainder.autocorrelation import residual_autocorrelation
from split_cli.diagnosis.remainder.formula import sparse_formula
from split_cli.diagnosis.remainder.location import gap_forces, gap_series, locate
from split_cli.diagnosis.remainder.spectrum import Line, strongest_line
from split_cli.diagnosis.search.baselines import SearchOutcome, ends_beyond, search, with_witnessed_names
from split_cli.diagnosis.search.candidates import Candidate, build_candidates
from split_cli.diagnosis.search.identifiable import identifiable, what_was_not_excited
from split_cli.diagnosis.search.instrument_drift import with_drift_tolerances
from split_cli.diagnosis.search.self_test import SelfTest
from split_cli.diagnosis.statement.result import Detectable, Diagnosis, InputFile
from split_cli.diagnosis.statement.sentences import acting_in_a_part, summarise
from split_cli.diagnosis.verdict.detectable import detection_limits
from split_cli.diagnosis.verdict.faulty_commands import saving_on_faulty_recordings
from split_cli.diagnosis.verdict.findings import Description, confirmed_by_witnesses, describe, is_autocorrelated
from split_cli.diagnosis.verdict.held_out_judgement import (
    HeldOutJudgement,
    fit_without_held_out,
    judge_names,
    with_nameless_parts,
)
from split_cli.diagnosis.verdict.leads import find_leads
from split_cli.diagnosis.verdict.power import (
    hidden_effects,
    hidden_in_words,
    is_blind,
    most_unseen_in_words,
    much_form_error_in_words,
    no_match_in_words,
    unseen_in_words,
)
from split_cli.diagnosis.verdict.tolerance import named_or_tolerated, tolerance_leads
from split_cli.diagnosis.verdict.withdrawn import as_leads, withdrawn, without_names
from split_cli.logs.drive import Drive
from split_cli.logs.track_position import places_of
from split_cli.vehicle.parameters import Vehicle

_FAR = (
    "common operating points: the simulation has hardly any of those of the real drive, so samples further off "
    "than usual are compared; drive both over the same speeds, torques and turns"
)
_FAR_AND_UNNAMED = (
    "The simulation has hardly any of the real drive's operating points, and no effect of the catalogue explains "
    "the gap. It may come from operating points that the simulation lacks. Drive both over the same speeds, "
    "torques and turns."
)
_DRIVEN_DIFFERENTLY = (
    "Reality and simulation were driven too differently: {ours:.0f} % of the real drive's operating points are "
    "among the simulation's, and {theirs:.0f} % the other way round. What the vehicle file gets wrong looks like "
    "an effect then. Drive both over the same speeds, torques and turns."
)
_SHORT_SIMULATION = (
    "The simulation has {rows} rows of 0.04 s of driving; {least} are needed to tell what the vehicle file gets "
    "wrong and by how much two drives of one car differ. Simulate a longer drive."
)
#: Number of distances, from the usual to the largest one, that are tried in turn [1]. Judgement.
_REACHES = 8
_TESTS = 5  # tests of whether there is a difference, see `_compare`; p values are multiplied by it (Bonferroni)


def diagnose(
    real: Sequence[Drive],
    vehicle: Vehicle,
    simulated: Sequence[Drive] = (),
    holdout: Sequence[Drive] = (),
    *,
    inputs: Sequence[InputFile] = (),
    policy: Policy = STANDARD,
    progress: Callable[[str], None] = lambda step: None,
    improved: bool = True,
) -> Diagnosis:
    """Diagnose what reality has beyond a simulation.

    Parameters
    ----------
    real : sequence of Drive
        At least one.
    vehicle : Vehicle
        The nominal model.
    simulated : sequence of Drive
        Without any, the nominal model is the simulation.
    holdout : sequence of Drive
        Real drives on which the improvement is measured; by default the last share of `real`.
    inputs : sequence of InputFile
        Names and hashes of the files, for the result.
    policy : Policy
        All constants that decide; the same for all cases.
    progress : callable
        Called with the name of each step.
    improved : bool
        Whether to measure the improvement on held-out time and to judge the corrected vehicle. Without it the shares
        that findings explain are those of all time.

    Returns
    -------
    Diagnosis
        With the verdict ``undecided`` and its reasons if the drives cannot be compared.
    """
    record = {"inputs": tuple(inputs), "settings": policy.described()}
    drives, roles, notes, reasons = _screened(real, vehicle, simulated, holdout, policy)
    if reasons:
        return _undecided(reasons, 0.0, record)
    progress("smoothing")
    series = _smoothed(drives, roles, vehicle)
    progress("whitening")
    case, kept, reach = _compared(gather_case(vehicle, series, policy), policy)
    share = kept / max(_rows_of(case.real), 1)
    reasons = _too_little(case, kept, share, policy)
    if reasons:
        return _undecided(reasons, share, record)
    is_far = reach > policy.comparison.reach
    not_judged = (*notes, *what_was_not_excited(case.real, vehicle, share, policy), *((_FAR,) if is_far else ()))
    candidates = _candidates(case, vehicle, policy)
    outcome = search(case, candidates, reach=reach, policy=policy, progress=progress)
    case = outcome.case or case
    if outcome.self_test.ratio > policy.selection.much_over_noise:
        not_judged += (much_form_error_in_words(vehicle),)
    # A scale error that a named sensor fault explains is no contradiction any more.
    positions = _lateral_witnesses(case)
    contradictions = out_of_scale(*positions, outcome.selection.terms, policy.screening)
    not_judged += contradictions
    scales = scales_as_terms(*positions, outcome.selection.terms, policy.screening)
    found = _compare(case, outcome, contradictions, scales)
    progress("sizing")
    detectable = _detection_limits(case, candidates, outcome, reach, policy)
    if found.p_value >= policy.comparison.level:
        judged = _with_known_torque(candidates, real) if case.simulated else []
        return _match(case, found, vehicle, judged, share, not_judged, {**record, "detectable": detectable})
    progress("judging")
    theirs = case.visited(reach, policy)
    apart = bool(case.simulated) and not _is_common(share, theirs, outcome.self_test, policy)
    if apart:
        found = replace(found, outcome=with_witnessed_names(outcome), description=None)
    stated = _mismatch(case, found, policy, improved, apart=apart)
    differently = _DRIVEN_DIFFERENTLY.format(ours=100.0 * share, theirs=100.0 * theirs.sum() / max(len(theirs), 1))
    hardly = apart or is_far or share < policy.comparison.least_share
    if hardly and not stated.findings and not contradictions:
        return _undecided([differently if apart else _FAR_AND_UNNAMED], share, record)
    if apart:
        not_judged += (f"effects of the car: {differently[:1].lower()}{differently[1:]}",)
    return replace(stated, compared_share=share, not_judged=not_judged, detectable=detectable, **record)


def _screened(
    real: Sequence[Drive], vehicle: Vehicle, simulated: Sequence[Drive], holdout: Sequence[Drive], policy: Policy
) -> tuple[list[Drive], list[str], Sequence[str], list[str]]:
    """Clean and screen all drives.

    Returns
    -------
    drives, roles : list
        Without crawling; empty if there are reasons.
    notes : sequence of str
        What was left out, in words.
    reasons : list of str
        Why the drives cannot be diagnosed, as sentences.
    """
    drives, notes = clean_drives([*real, *simulated, *holdout], policy.screening, vehicle)
    roles = ["real"] * len(real) + ["sim"] * len(simulated) + ["holdout"] * len(holdout)
    of_simulation = drives[len(real) : len(real) + len(simulated)]
    reasons = [
        reason
        for drive, role in zip(drives, roles, strict=True)
        for reason in unfit(drive, vehicle, policy.screening, () if role == "sim" else of_simulation)
    ]
    reasons = (
        list(dict.fromkeys([*reasons, *notes])) if reasons else idle(drives[: len(real)], vehicle, policy.screening)
    )
    return [moving(one, vehicle, policy.screening) for one in drives if not reasons], roles, notes, reasons


def _smoothed(drives: Sequence[Drive], roles: Sequence[str], vehicle: Vehicle) -> list[Series]:
    """Return the drives with smoothed and predicted states, and with positions on a common track."""
    places, lap = places_of(drives, vehicle.wheelbase)
    return map_in_threads(
        lambda one: build_series(one[0], one[1], one[2][0], lap_length=lap, place_reference=one[2][1]),
        zip(drives, roles, places, strict=True),
    )


def _compared(case: DiagnosisCase, policy: Policy) -> tuple[DiagnosisCase, int, float]:
    """Return a case, the number of its compared rows, and the distance up to which rows count as common.

    If too few rows are within the usual distance, the smallest distance is taken with which enough are, up to the
    policy's largest one.
    """
    settings = policy.comparison
    if not case.simulated or _rows(case) >= settings.least_rows:
        return case, _rows(case), settings.reach
    for reach in np.linspace(settings.reach, settings.far_reach, _REACHES)[1:].tolist():
        further = case.compared(reach, policy)
        if _rows(further) >= settings.least_rows:
            break
    return further, _rows(further), reach


def _too_little(case: DiagnosisCase, kept: int, share: float, policy: Policy) -> list[str]:
    """Return why too little of a case can be compared for a diagnosis, as sentences; empty if it is enough.

    Parameters
    ----------
    kept : int
        Compared rows of the real drives.
    share : float
        The same as a share of all their rows [1].
    """
    least = policy.comparison.least_rows
    simulated = _rows_of(case.simulated)
    if kept >= least:
        return [_SHORT_SIMULATION.format(rows=simulated, least=least)] if 0 < simulated < least else []
    lacking = (
        f"The simulation has only {100.0 * share:.0f} % of the real drive's operating points "
        f"({kept} rows of 0.04 s); drive both over the same speeds, torques and turns."
    )
    short = (
        f"Only {kept} rows of 0.04 s move fast enough to be compared, and {least} are needed. "
        "Record a minute or more, or pass several drives."
    )
    is_short = _rows_of(case.real) < least or not case.simulated
    return [
        short if is_short else lacking,
        *in_sentences(out_of_scale(*_lateral_witnesses(case), rules=policy.screening)),
    ]


def _candidates(case: DiagnosisCase, vehicle: Vehicle, policy: Policy) -> list[Candidate]:
    """Return the effects that recordings of this kind can show, with tolerances by how far instruments drift."""
    real, simulated = ([one.series for one in several] for several in (case.real, case.simulated))
    candidates = identifiable(build_candidates(vehicle, real[0]), real, vehicle, policy, simulated)
    return with_drift_tolerances(case, candidates, policy)


def _detection_limits(
    case: DiagnosisCase, candidates: Sequence[Candidate], outcome: SearchOutcome, reach: float, policy: Policy
) -> tuple[Detectable, ...]:
    """Return the smallest size of each effect that would have been named beside the names of a search."""
    chosen = outcome.selection.chosen
    return detection_limits(
        outcome.objectives,
        candidates,
        outcome.variance_inflation,
        policy.comparison.level / _TESTS,
        partial(saving_on_faulty_recordings, case=case, reach=reach),
        [part for part, named in zip(chosen.parts, outcome.selection.named, strict=True) if named],
    )


def _lateral_witnesses(case: DiagnosisCase) -> list[tuple[KinematicResiduals | Witness, ...]]:
    """Return the comparisons of position with velocity, of the real and of the simulated recordings."""
    return [tuple(filter(is_witness_of_position, several)) for several in (case.kinematics, case.simulated_kinematics)]


def _rows_of(recordings: Sequence[Evidence]) -> int:
    """Return the number of rows of recordings, compared or not."""
    return sum(len(one.at) for one in recordings)


def _is_common(share: float, theirs: np.ndarray, tested: SelfTest, policy: Policy) -> bool:
    """Return whether both drives have enough common operating points for effects of the car to be named.

    What the vehicle file gets wrong depends on the driving. Unless halves of the simulation show little of that, common
    points must hold a fair share of the real drive. Of the simulation they must hold a fair share, or as many rows as a
    decision needs: further driving of the simulation does no harm.

    Parameters
    ----------
    share : float
        Share of the real rows that are compared [1].
    theirs : ndarray of bool, shape (M,)
        Which rows of the simulation are near a real one.
    """
    fair = policy.selection.fair_share
    if tested.rows and tested.ratio <= policy.selection.much_over_noise:
        return True
    return share >= fair and bool(theirs.mean() >= fair or theirs.sum() >= policy.comparison.least_rows)


def _match(
    case: DiagnosisCase,
    found: _Comparison,
    vehicle: Vehicle,
    judged: Sequence[Candidate],
    share: float,
    not_judged: tuple[str, ...],
    record: Mapping[str, Any],
) -> Diagnosis:
    """Return the verdict ``match``, or ``undecided`` if a large effect, or most effects, would not have been seen."""
    objective, gap = found.outcome.structure.objective, found.outcome.gap.effect_to_noise
    hidden = hidden_effects(objective, judged, gap, record["detectable"]) if judged else ()
    reasons = list(filter(None, (hidden_in_words(hidden), unseen_in_words(record["detectable"]))))
    open_questions = []
    if hidden and hidden[0].share > objective.policy.selection.fair_share:
        open_questions = [no_match_in_words(hidden[0], gap, vehicle)]
    elif is_blind(record["detectable"], objective.policy):
        open_questions = [most_unseen_in_words(vehicle), *reasons]
    if open_questions:
        stated = _undecided(open_questions, share, record)
        return replace(stated, not_judged=(*stated.not_judged, *not_judged))
    return Diagnosis(
        "match",
        found.p_value,
        share,
        (*not_judged, *reasons),
        leads=tolerance_leads(objective, found.outcome.selection, found.outcome.variance_inflation, taken_off=False),
        history=found.outcome.selection.history,
        sentences=summarise("match", reasons=reasons, compared_share=share),
        gaps=_gaps(case),
        **record,
    )


def _with_known_torque(candidates: Sequence[Candidate], real: Sequence[Drive]) -> list[Candidate]:
    """Return the candidates without those that need the torque, if that follows from pedals by an assumed map."""
    guessed = any(drive.metadata.torque_is_from_pedals for drive in real)
    return [one for one in candidates if not (guessed and "torque" in one.needs)]


def _rows(case: DiagnosisCase) -> int:
    return sum(int(mask.sum()) for mask in case.keep)


@dataclass(frozen=True)
class _Comparison:
    """The tests of whether simulation and reality differ, and what the search found.

    Attributes
    ----------
    line : Line or None
        The strongest line in the spectrum of the residuals, if it is large enough.
    p_value : float
        Of no difference, over all tests (Bonferroni).
    contradictions : tuple of str
        Sensors with a wrong scale, see `out_of_scale`.
    scales : mapping of str to float
        The same as scales [1] by term.
    description : Description or None
        Findings and remainder, if the search named anything.
    """

    outcome: SearchOutcome
    line: Line | None
    p_value: float
    contradictions: tuple[str, ...]
    scales: Mapping[str, float]
    description: Description | None


def _compare(
    case: DiagnosisCase, outcome: SearchOutcome, contradictions: tuple[str, ...], scales: Mapping[str, float]
) -> _Comparison:
    """Test in five ways whether there is a difference.

    The tests are: a named term, a term in a part of the drive, a fit without names (of flexible functions or of
    oscillators), a spectral line, and residual autocorrelation. A sensor that contradicts position or yaw is a
    difference in any case. Named terms are none if the intervals of all of them contain no effect: p values consider
    noise alone, intervals also model-form error.
    """
    policy = outcome.structure.objective.policy
    description = describe(outcome, scales) if any(outcome.selection.named) else None
    is_named = description is not None and description.is_apart
    structure, selection = outcome.structure, outcome.selection
    # Nuisance terms, which are too small to be named, are no difference.
    left = selection.base.residuals if any(selection.named) else selection.chosen.residuals
    unnamed, *_ = outcome.remainder(left)
    line = strongest_line(structure.objective, selection.terms, case.simulated)
    line = line if line is not None and line.effect_to_noise > policy.allowances.unnamed else None
    autocorrelation = residual_autocorrelation(structure, selection.chosen.residuals)
    usual = outcome.self_test.usual_autocorrelation(autocorrelation.rows)
    partly = None if is_named else selection.partly()
    ways = [
        unnamed,
        selection.first_p if is_named or ends_beyond(selection, policy) else 1.0,
        1.0 if partly is None else partly.p_value,
        line.p_value if line else 1.0,
        autocorrelation.p_value(usual, policy.self_test) if is_autocorrelated(autocorrelation, usual, policy) else 1.0,
    ]
    p_value = 0.0 if contradictions else min(1.0, _TESTS * min(ways))
    return _Comparison(outcome, line, p_value, contradictions, scales, description)


def _mismatch(case: DiagnosisCase, found: _Comparison, policy: Policy, improved: bool, *, apart: bool) -> Diagnosis:
    """Return the verdict ``mismatch`` with location, findings, leads and improvement.

    Parameters
    ----------
    apart : bool
        Whether reality and simulation were driven too differently for effects of the car to be named.
    """
    case = case.judged_with_residue()
    described = found.description or describe(found.outcome, found.scales)
    selection, findings, remainder = described.selection, described.findings, described.remainder
    structured, unexplained = described.unexplained, described.unexplained or found.line is not None
    judged, leads = HeldOutJudgement(findings, remainder, None, None), ()
    if improved:
        objective = found.outcome.structure.objective
        fit = fit_without_held_out(case, objective, selection.chosen, policy)
        judged = judge_names(fit, named_or_tolerated(selection), findings, remainder)
        gone, reason = (), ""
        # Differences as large as those between the halves of the simulation are never called unexplained. If these
        # are large, an unexplained part may be hidden.
        if structured or found.outcome.self_test.ratio > policy.selection.much_over_noise:
            confirmed = confirmed_by_witnesses(objective, selection)
            gone, reason = withdrawn(judged.findings, judged.improvement, judged.corrected, confirmed)
        if gone:
            structured = unexplained = True
            leads = as_leads(gone, reason, case.vehicle)
            selection, *reported = without_names(selection, findings, remainder, gone)
            judged = judge_names(fit, named_or_tolerated(selection), *reported)
        judged = with_nameless_parts(fit, named_or_tolerated(selection), judged)
    findings, remainder = judged.findings, judged.remainder
    improvement, corrected = judged.improvement, judged.corrected
    forces, after = (
        [gap_forces(one, terms, case.discrepancy_rates(one, terms)) for one in case.real]
        for terms in ((), selection.terms)
    )
    if unexplained:
        # A line may be all that is left, or stand beside a smooth remainder.
        smooth = sparse_formula(case.real, after, case.keep, policy.reporting) if structured else ""
        line = found.line.in_words() if found.line else ""
        remainder = replace(remainder, formula="; and ".join(filter(None, (smooth, line))))
    location = locate(case.real, forces, after, case.keep, policy.reporting)
    searched = found.outcome.structure.objective, described.searched, found.outcome.variance_inflation
    return Diagnosis(
        "mismatch",
        found.p_value,
        0.0,
        location=location,
        findings=findings,
        unexplained=unexplained,
        remainder=remainder,
        improvement=improvement,
        gaps=tuple(map(gap_series, case.real, case.keep, forces, after)),
        leads=(
            *leads,
            *find_leads(*searched, apart=apart),
            *tolerance_leads(*searched, taken_off=improvement is not None),
        ),
        history=selection.history,
        sentences=summarise(
            "mismatch",
            findings,
            unexplained,
            location,
            remainder,
            [*in_sentences(found.contradictions), *_in_a_part(found, bool(findings), policy)],
            improvement,
            case.vehicle,
            corrected,
        ),
        corrected_vehicle=corrected,
    )


def _in_a_part(found: _Comparison, named: bool, policy: Policy) -> list[str]:
    """Return what terms explain in a part of the drive, if no term is named for all of it, as sentences.

    A part that covers nearly all of the drive does not count.
    """
    one = None if named else found.outcome.selection.partly()
    if one is None or _TESTS * one.p_value >= policy.comparison.level or one.share > policy.reporting.everywhere:
        return []
    several = len(found.outcome.structure.objective.evidence) > 1
    most = policy.abstention.most_alternatives
    return [acting_in_a_part(one.readings, one.begin, one.end, most, one.recording + 1 if several else None)]


def _gaps(case: DiagnosisCase):
    forces = [gap_forces(one, (), case.discrepancy_rates(one)) for one in case.real]
    return tuple(map(gap_series, case.real, case.keep, forces, forces))


def _undecided(reasons: Sequence[str], share: float, record: Mapping[str, Any]) -> Diagnosis:
    return Diagnosis(
        "undecided", None, share, tuple(reasons), sentences=summarise("undecided", reasons=reasons), **record
    )
