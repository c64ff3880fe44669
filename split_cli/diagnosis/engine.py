"""A diagnosis, step by step: do simulation and reality differ, where, by which effect, and does it help to know it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from split_cli.diagnosis.innovations.case import DiagnosisCase, gather_case
from split_cli.diagnosis.parallel import map_in_threads
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.cleaning import clean_drives, moving
from split_cli.diagnosis.recording.excitation import idle
from split_cli.diagnosis.recording.scales import in_sentences, out_of_scale, scales_as_terms
from split_cli.diagnosis.recording.screening import unfit
from split_cli.diagnosis.recording.series import Series, build_series
from split_cli.diagnosis.recording.witnesses import is_witness_of_position
from split_cli.diagnosis.remainder.autocorrelation import residual_autocorrelation
from split_cli.diagnosis.remainder.formula import sparse_formula
from split_cli.diagnosis.remainder.location import gap_forces, gap_series, locate
from split_cli.diagnosis.remainder.spectrum import Line, strongest_line
from split_cli.diagnosis.search.baselines import SearchOutcome, ends_beyond, search, with_witnessed_names
from split_cli.diagnosis.search.candidates import Candidate, build_candidates
from split_cli.diagnosis.search.identifiable import identifiable, what_was_not_excited
from split_cli.diagnosis.search.instrument_drift import with_drift_tolerances
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.statement.result import Diagnosis, InputFile
from split_cli.diagnosis.statement.sentences import acting_in_a_part, summarise
from split_cli.diagnosis.verdict.detectable import detection_limits
from split_cli.diagnosis.verdict.findings import Description, confirmed_by_witnesses, describe, is_autocorrelated
from split_cli.diagnosis.verdict.held_out_judgement import (
    HeldOutJudgement,
    fit_without_held_out,
    judge_names,
    with_nameless_parts,
)
from split_cli.diagnosis.verdict.leads import find_leads
from split_cli.diagnosis.verdict.planted import planted_saving
from split_cli.diagnosis.verdict.power import (
    MOST_UNSEEN,
    hidden_effects,
    hidden_in_words,
    is_blind,
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
_MUCH_FORM_ERROR = (
    "small effects: halves of the simulation differ by far more than noise, and smaller effects are not "
    "identified; calibrate the vehicle file (split calibrate), or drive both more alike"
)
_TAUGHT_LITTLE = (
    "The simulation has {rows} rows of 0.04 s of driving; {least} are needed to tell what the vehicle file gets "
    "wrong and by how much two drives of one car differ. Simulate a longer drive."
)
#: Distances from the usual to the far one that are tried in turn [1]. Judgement: the least is found to a seventh of
#: what lies between them.
_REACHES = 8
_TESTS = 5  # of whether there is a difference, see `_compare`


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
        Real drives to judge the improvement on; else the last share of `real`.
    inputs : sequence of InputFile
        For the record.
    policy : Policy
        One for all cases; every number that decides.
    progress : callable
        Called with the name of each step.
    improved : bool
        Whether to measure on held-out time what naming improves, and to judge the corrected vehicle. Without,
        only findings are stated, and the shares that they explain are those of all time.
    """
    settings = policy.comparison
    record = {"inputs": tuple(inputs), "settings": policy.described()}
    drives, roles, notes, reasons = _screened(real, vehicle, simulated, holdout, policy)
    if reasons:
        return _undecided(reasons, 0.0, record)
    progress("smoothing")
    series = _smoothed(drives, roles, vehicle)
    progress("whitening")
    case, kept, reach = _compared(gather_case(vehicle, series, policy), policy)
    is_far = reach > settings.reach
    share = kept / max(sum(len(one.at) for one in case.real), 1)
    not_judged = (*notes, *what_was_not_excited(case.real, vehicle, share, policy), *((_FAR,) if is_far else ()))
    positions = [
        tuple(filter(is_witness_of_position, several)) for several in (case.kinematics, case.simulated_kinematics)
    ]
    if kept < settings.least_rows:
        lacking = (
            f"The simulation has only {100.0 * share:.0f} % of the real drive's operating points "
            f"({kept} rows of 0.04 s); drive both over the same speeds, torques and turns."
        )
        short = (
            f"Only {kept} rows of 0.04 s move fast enough to be compared, and {settings.least_rows} are needed. "
            "Record a minute or more, or pass several drives."
        )
        is_short = sum(len(one.at) for one in case.real) < settings.least_rows
        reasons = [
            short if is_short or not simulated else lacking,
            *in_sentences(out_of_scale(*positions, rules=policy.screening)),
        ]
        return _undecided(reasons, share, record)
    taught = sum(len(one.at) for one in case.simulated)
    if 0 < taught < settings.least_rows:
        return _undecided([_TAUGHT_LITTLE.format(rows=taught, least=settings.least_rows)], share, record)
    candidates = identifiable(
        build_candidates(vehicle, case.real[0].series),
        [one.series for one in case.real],
        vehicle,
        policy,
        [one.series for one in case.simulated],
    )
    candidates = with_drift_tolerances(case, candidates, policy)
    outcome = search(case, candidates, reach=reach, policy=policy, progress=progress)
    if outcome.self_test.ratio > policy.selection.much_over_noise:
        not_judged += (_MUCH_FORM_ERROR,)
    # What a named sensor accounts for contradicts nothing any more.
    contradictions = out_of_scale(*positions, outcome.selection.terms, policy.screening)
    not_judged += contradictions
    scales = scales_as_terms(*positions, outcome.selection.terms, policy.screening)
    found = _compare(case, outcome, contradictions, scales)
    progress("sizing")
    chosen = outcome.selection.chosen
    detectable = detection_limits(
        outcome.objectives,
        candidates,
        outcome.variance_inflation,
        settings.level / _TESTS,
        partial(planted_saving, case=case, reach=reach),
        [part for part, named in zip(chosen.parts, outcome.selection.named, strict=True) if named],
    )
    if found.p_value >= settings.level:
        judged = _with_known_torque(candidates, real) if simulated else []
        return _match(case, found, judged, share, not_judged, {**record, "detectable": detectable})
    progress("judging")
    theirs = case.visited(reach, policy)
    apart = bool(case.simulated) and not _is_common(share, theirs, policy)
    if apart:
        found = replace(found, outcome=with_witnessed_names(outcome), description=None)
    stated = _mismatch(case, found, policy, improved, apart=apart)
    hardly = apart or is_far or share < settings.least_share
    differently = _DRIVEN_DIFFERENTLY.format(ours=100.0 * share, theirs=100.0 * float(np.mean(theirs)))
    if apart:
        not_judged += (f"effects of the car: {differently[:1].lower()}{differently[1:]}",)
    if hardly and not stated.findings and not contradictions:
        return _undecided([differently if apart else _FAR_AND_UNNAMED], share, record)
    return replace(stated, compared_share=share, not_judged=not_judged, detectable=detectable, **record)


def _screened(
    real: Sequence[Drive], vehicle: Vehicle, simulated: Sequence[Drive], holdout: Sequence[Drive], policy: Policy
) -> tuple[list[Drive], list[str], Sequence[str], list[str]]:
    """Return what moves of all drives, their roles, what was left out, and why they cannot be diagnosed."""
    drives, notes = clean_drives([*real, *simulated, *holdout], policy.screening, vehicle)
    roles = ["real"] * len(real) + ["sim"] * len(simulated) + ["holdout"] * len(holdout)
    taught = drives[len(real) : len(real) + len(simulated)]
    reasons = [
        reason
        for drive, role in zip(drives, roles, strict=True)
        for reason in unfit(drive, vehicle, policy.screening, () if role == "sim" else taught)
    ]
    reasons = (
        list(dict.fromkeys([*reasons, *notes])) if reasons else idle(drives[: len(real)], vehicle, policy.screening)
    )
    return [moving(one, vehicle, policy.screening) for one in drives if not reasons], roles, notes, reasons


def _smoothed(drives: Sequence[Drive], roles: Sequence[str], vehicle: Vehicle) -> list[Series]:
    places, lap = places_of(drives, vehicle.wheelbase)
    return map_in_threads(
        lambda one: build_series(one[0], one[1], one[2][0], lap_length=lap, place_reference=one[2][1]),
        zip(drives, roles, places, strict=True),
    )


def _compared(case: DiagnosisCase, policy: Policy) -> tuple[DiagnosisCase, int, float]:
    """Return a case, how many of its rows are compared, and up to which distance.

    Where hardly any row is as near as usual, that is the least distance within which enough are, or the far one.
    """
    settings = policy.comparison
    if not case.simulated or _rows(case) >= settings.least_rows:
        return case, _rows(case), settings.reach
    for reach in np.linspace(settings.reach, settings.far_reach, _REACHES)[1:].tolist():
        further = case.compared(reach, policy)
        if _rows(further) >= settings.least_rows:
            break
    return further, _rows(further), reach


def _is_common(share: float, theirs: np.ndarray, policy: Policy) -> bool:
    """Return whether both drives tell what the car does where both have been.

    A fair share of the real drive has to be there, and of the simulation a fair share or as many rows as a
    decision takes: what else the simulation holds does no harm.

    Parameters
    ----------
    share : float
        Of the real rows, those that are compared.
    theirs : ndarray, bool, shape (M,)
        Which of the simulation's rows lie where the real drive has been.
    """
    fair = policy.selection.fair_share
    return share >= fair and bool(theirs.mean() >= fair or theirs.sum() >= policy.comparison.least_rows)


def _match(
    case: DiagnosisCase,
    found: _Comparison,
    judged: Sequence[Candidate],
    share: float,
    not_judged: tuple[str, ...],
    record: Mapping[str, Any],
) -> Diagnosis:
    """State that no difference was found, unless a force that matters or most effects could hide at any size."""
    objective, gap = found.outcome.structure.objective, found.outcome.gap.effect_to_noise
    hidden = hidden_effects(objective, judged, gap, record["detectable"]) if judged else ()
    reasons = list(filter(None, (hidden_in_words(hidden), unseen_in_words(record["detectable"]))))
    open_questions = []
    if hidden and hidden[0].share > objective.policy.selection.fair_share:
        open_questions = [no_match_in_words(hidden[0], gap)]
    elif is_blind(record["detectable"], objective.policy):
        open_questions = [MOST_UNSEEN, *reasons]
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
        sentences=summarise("match", reasons=reasons),
        gaps=_gaps(case),
        **record,
    )


def _with_known_torque(candidates: Sequence[Candidate], real: Sequence[Drive]) -> list[Candidate]:
    """Return the candidates without those of a torque that came of pedals: its map is a guess."""
    guessed = any(drive.metadata.torque_is_from_pedals for drive in real)
    return [one for one in candidates if not (guessed and "torque" in one.needs)]


def _rows(case: DiagnosisCase) -> int:
    return sum(int(mask.sum()) for mask in case.keep)


@dataclass(frozen=True)
class _Comparison:
    """Simulation against reality: the whole gap, what explains it, and how likely it is none.

    Attributes
    ----------
    line : Line or None
        In the spectrum, if it is large enough.
    contradictions : tuple of str
        Sensors out of scale, see `out_of_scale`.
    scales : mapping of str to float
        The same as scales by term.
    description : Description or None
        Of the outcome's names, where it has any.
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

    A name, a name in a part of the drive, a smooth function, a line, or residual autocorrelation.

    A sensor that contradicts position or yaw is one, however small the rest. Names show none if the intervals of
    all hold no effect: their p values know of noise alone, and intervals of model-form error, too.
    """
    policy = outcome.structure.objective.policy
    description = describe(outcome, scales) if any(outcome.selection.named) else None
    is_named = description is not None and description.is_apart
    structure, selection = outcome.structure, outcome.selection
    unnamed = outcome.gap
    if selection.chosen.parts and not any(selection.named):
        # Physics that has a name, and is too small to be called by it, is no difference.
        unnamed = structure.fit(selection.chosen.residuals, outcome.variance_inflation)
    line = strongest_line(structure.objective, selection.terms, case.simulated)
    line = line if line is not None and line.effect_to_noise > policy.allowances.unnamed else None
    autocorrelation = residual_autocorrelation(structure, selection.chosen.residuals)
    usual = outcome.self_test.usual_autocorrelation(autocorrelation.rows)
    ways = [
        unnamed.p_value,
        selection.first_p if is_named or ends_beyond(selection, policy) else 1.0,
        1.0 if is_named else _p_of_a_part(selection),
        line.p_value if line else 1.0,
        autocorrelation.p_value(usual, policy.self_test) if is_autocorrelated(autocorrelation, usual, policy) else 1.0,
    ]
    p_value = 0.0 if contradictions else min(1.0, _TESTS * min(ways))
    return _Comparison(outcome, line, p_value, contradictions, scales, description)


def _p_of_a_part(selection: Selection) -> float:
    partly = selection.partly()
    return 1.0 if partly is None else partly.p_value


def _mismatch(case: DiagnosisCase, found: _Comparison, policy: Policy, improved: bool, *, apart: bool) -> Diagnosis:
    """Say where the difference is, what it is, and whether naming it helps; `apart` if driven too differently."""
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
        # What the simulation shows against itself is called unexplained of no drive: where that is much, much hides.
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
        # A line may be all that is left, or swing beside much that a smooth function holds.
        smooth = sparse_formula(case.real, after, case.keep, policy.reporting) if structured else ""
        line = found.line.in_words() if found.line else ""
        remainder = replace(remainder, formula="; and ".join(filter(None, (smooth, line))))
    location = locate(case.real, forces, after, case.keep, policy.reporting)
    searched = found.outcome.structure.objective, found.outcome.selection, found.outcome.variance_inflation
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
    """Return what terms explain of a gap without a name in a part of the drive, as sentences.

    A part that is nearly all of the drive is none.
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
