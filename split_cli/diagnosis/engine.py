"""The four questions in order: do they differ, where, what, does it help."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from split_cli.diagnosis.calibration import SelfTest, autocorrelation, comparable, self_test
from split_cli.diagnosis.candidates import Candidate, build_candidates
from split_cli.diagnosis.common import CommonPhysics, build_common_physics
from split_cli.diagnosis.constancy import parameter_drifts
from split_cli.diagnosis.estimates import parameter_estimates
from split_cli.diagnosis.evidence import Evidence, gather_evidence
from split_cli.diagnosis.fitting import Fit, fit_parts
from split_cli.diagnosis.formula import sparse_formula
from split_cli.diagnosis.heldout import HeldOut, explained_shares, hold_out
from split_cli.diagnosis.improvement import measure_improvement
from split_cli.diagnosis.judge import CommonKnowledge, Judge, build_judge, learn_common
from split_cli.diagnosis.kinematics import Kinematics, build_kinematics, habits
from split_cli.diagnosis.location import gap_forces, gap_series, locate
from split_cli.diagnosis.place import places_of
from split_cli.diagnosis.result import Diagnosis, Finding, InputFile, RemainderTest, RivalSummary
from split_cli.diagnosis.screening import clean_drives, idle, judgeable, tellable, unfit
from split_cli.diagnosis.selection import Rival, Rules, Selection, nothing, select_terms, term_size
from split_cli.diagnosis.sentences import sentence_for, separations, summarise
from split_cli.diagnosis.separation import exact_mimics
from split_cli.diagnosis.series import Series, build_series
from split_cli.diagnosis.spectrum import Line, strongest_line
from split_cli.diagnosis.structure import FlexibleFit, Structure, build_structure
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.parameters import Vehicle

__all__ = ["Settings", "diagnose"]

_SHOWN_RIVALS = 6


@dataclass(frozen=True)
class Settings:
    """One fixed setting for all cases.

    Attributes
    ----------
    level : float
        p below which simulation and reality differ.
    inflation : float
        By which autocorrelation widens chi squared.
    holdout_share : float
        Share of the real drives' time kept out, at the end, when no drive is given for it.
    nameless_share : float
        Share of the gap without a name from which on it is said to be unexplained.
    nameless_severity : float
        Severity below which a share without a name is not called so.
    nameless_size : float
        Severity of the remainder, over that of the gap, from which on it is unexplained whatever its share.
    reach : float
        How far, in scaled features, a real sample may be from the nearest simulated one.
    least_rows : int
        Rows of evidence below which nothing is decided.
    """

    level: float = 0.01
    inflation: float = 1.5
    holdout_share: float = 0.25
    nameless_share: float = 0.08
    nameless_severity: float = 0.12
    nameless_size: float = 0.12
    reach: float = 0.35
    least_rows: int = 250


def diagnose(
    real: Sequence[Drive],
    vehicle: Vehicle,
    simulated: Sequence[Drive] = (),
    holdout: Sequence[Drive] = (),
    *,
    inputs: Sequence[InputFile] = (),
    settings: Settings | None = None,
    progress: Callable[[str], None] = lambda step: None,
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
    settings : Settings, optional
    progress : callable
        Called with the name of each step.
    """
    settings = settings or Settings()
    described = {**asdict(settings), **{f"selection_{k}": v for k, v in asdict(Rules()).items()}}
    drives, notes = clean_drives([*real, *simulated, *holdout])
    roles = ["real"] * len(real) + ["sim"] * len(simulated) + ["holdout"] * len(holdout)
    reasons = [reason for drive in drives for reason in unfit(drive, vehicle)]
    reasons = [*reasons, *notes] if reasons else idle(drives[: len(real)], vehicle)
    if reasons:
        return _undecided(reasons, 0.0, inputs, described)
    progress("smoothing")
    places, lap = places_of(drives, vehicle.wheelbase)
    series = [
        build_series(drive, role, s, lap_length=lap, place_reference=reference)
        for drive, role, (s, reference) in zip(drives, roles, places, strict=True)
    ]
    progress("whitening")
    case = _gather(vehicle, series, settings)
    kept = sum(int(mask.sum()) for mask in case.keep)
    share = kept / max(sum(len(one.at) for one in case.real), 1)
    not_judged = (*notes, *judgeable(case.real, vehicle, share))
    if kept < settings.least_rows:
        reasons = [
            f"Only {share:.0%} of the real drive ({kept} rows of 0.04 s) lies where the simulation has been; "
            "drive both over the same speeds, torques and turns."
        ]
        return _undecided(reasons, share, inputs, described)
    progress("comparing")
    candidates = tellable(
        build_candidates(vehicle, case.real[0].series), [one.series for one in case.real], vehicle
    )
    judge = build_judge(case.real, case.knowledge, case.common, case.keep, case.kinematics)
    known = SelfTest()
    if case.simulated:
        known = self_test(
            case.simulated, case.real, case.common, candidates, case.kinematics,
            inflation=settings.inflation, reach=settings.reach,
        )  # fmt: skip
    judge = known.allow(judge)
    structure = build_structure(judge, case.common)
    base = nothing(judge)
    wider = max(settings.inflation, known.ratio, autocorrelation(structure, base.entries))
    settings = replace(settings, inflation=wider)
    gap = structure.fit(base.entries, settings.inflation)
    progress("naming")
    selection = select_terms(judge, candidates, settings.inflation)
    line = strongest_line(judge, selection.terms, case.simulated)
    line = line if line is not None and line.severity > settings.nameless_severity else None
    nameless = gap
    if selection.chosen.parts and not any(selection.named):
        # Physics that has a name, and is too small to be called by it, is no difference.
        nameless = structure.fit(selection.chosen.entries, settings.inflation)
    named_p = selection.first_p if any(selection.named) else 1.0
    p_value = min(1.0, 3.0 * min(nameless.p_value, named_p, line.p_value if line else 1.0))
    if p_value >= settings.level:
        summary = summarise("match")
        return Diagnosis(
            "match", p_value, share, not_judged, inputs=tuple(inputs), settings=described,
            history=selection.history, summary=summary, gaps=_gaps(case, ()),
        )  # fmt: skip
    progress("judging")
    return _mismatch(
        case, judge, structure, gap, selection, line, p_value, share, not_judged, inputs, described, settings
    )


@dataclass(frozen=True)
class _Case:
    """Everything whitened: real recordings, held-out ones, and what the simulation knows."""

    vehicle: Vehicle
    real: tuple[Evidence, ...]
    holdout: tuple[Evidence, ...]
    common: CommonPhysics
    knowledge: CommonKnowledge | None
    keep: tuple[np.ndarray, ...]
    kinematics: tuple[Kinematics, ...]
    simulated: tuple[Evidence, ...] = ()
    keep_holdout: tuple[np.ndarray, ...] = ()

    def common_rates(self, evidence: Evidence) -> np.ndarray:
        """Return what the simulation knows beyond the nominal model along a recording, shape (N, 3)."""
        if self.knowledge is None:
            return np.zeros_like(evidence.series.measured)
        return self.common.columns(evidence.series) @ self.knowledge.weights


def _gather(vehicle: Vehicle, series: Sequence[Series], settings: Settings) -> _Case:
    by_role = {role: [one for one in series if one.role == role] for role in ("real", "sim", "holdout")}
    common = build_common_physics(vehicle, (by_role["sim"] or by_role["real"])[0])
    simulated = [gather_evidence(vehicle, one, common) for one in by_role["sim"]]
    least = np.max([one.disturbance for one in simulated], axis=0) if simulated else None
    real = [gather_evidence(vehicle, one, common, least) for one in by_role["real"]]
    holdout = [gather_evidence(vehicle, one, common, least) for one in by_role["holdout"]]
    knowledge = learn_common(simulated, settings.inflation) if simulated else None
    keep = [comparable(one, simulated, common, settings.reach) for one in real]
    kept_out = [comparable(one, simulated, common, settings.reach) for one in holdout]
    habit = habits(by_role["sim"])
    kinematics = [one for one in (build_kinematics(series, habit) for series in by_role["real"]) if one]
    return _Case(
        vehicle, tuple(real), tuple(holdout), common, knowledge, tuple(keep), tuple(kinematics), tuple(simulated),
        tuple(kept_out),
    )  # fmt: skip


def _mismatch(
    case: _Case,
    judge: Judge,
    structure: Structure,
    gap: FlexibleFit,
    selection: Selection,
    line: Line | None,
    p_value: float,
    share: float,
    not_judged: tuple[str, ...],
    inputs: Sequence[InputFile],
    described: dict,
    settings: Settings,
) -> Diagnosis:
    remainder = _remainder(structure, selection, settings)
    findings = _findings(judge, selection)
    unexplained = not findings or _is_unexplained(remainder, gap, settings)
    if unexplained and findings:
        trusted = _without_imitations(judge, selection, findings, remainder)
        if trusted is not selection:
            selection = trusted
            remainder = _remainder(structure, selection, settings)
            findings = _findings(judge, selection)
    unexplained = unexplained or line is not None
    chosen = selection.chosen
    forces = [gap_forces(one, (), case.common_rates(one)) for one in case.real]
    after = [gap_forces(one, selection.terms, case.common_rates(one)) for one in case.real]
    if unexplained:
        lead = line.in_words() if line else sparse_formula(case.real, after, case.keep)
        remainder = replace(remainder, formula=lead)
    location = locate(case.real, forces, after, case.keep)
    split = hold_out(
        case.real, case.keep, case.holdout, case.keep_holdout, case.knowledge, case.common, case.kinematics,
        settings.holdout_share,
    )  # fmt: skip
    trained = fit_parts(split.training, chosen.parts) if chosen.parts else chosen
    findings = _with_shares(findings, chosen, explained_shares(split, trained))
    named = tuple(term for term, is_named in zip(trained.terms, selection.named, strict=True) if is_named)
    improvement = _improvement(case, split, named)
    gaps = tuple(map(gap_series, case.real, case.keep, forces, after))
    return Diagnosis(
        "mismatch", p_value, share, not_judged, location, findings, unexplained, remainder, improvement,
        tuple(inputs), described, gaps, selection.history,
        summarise("mismatch", findings, unexplained, location, remainder, (), improvement, case.vehicle),
    )  # fmt: skip


def _remainder(structure: Structure, selection: Selection, settings: Settings) -> RemainderTest:
    left = structure.fit(selection.chosen.entries, settings.inflation)
    named = selection.base.cost - selection.chosen.cost
    chance = settings.inflation * left.freedom + structure.allowed(left.freedom)
    nameless = max(left.saved - chance, 0.0)
    drifts = tuple((one.variable, one.saved) for one in parameter_drifts(structure.judge, selection.chosen)[:3])
    share = nameless / max(nameless + named, 1e-9)
    return RemainderTest(left.p_value, share, left.severity, left.group_saved, drifts=drifts)


def _is_unexplained(remainder: RemainderTest, gap: FlexibleFit, settings: Settings) -> bool:
    if remainder.p_value >= settings.level or remainder.severity < settings.nameless_severity:
        return False
    large = max(2.0 * settings.nameless_severity, settings.nameless_size * gap.severity)
    return remainder.severity > large or remainder.share > settings.nameless_share


def _without_imitations(
    judge: Judge, selection: Selection, findings: Sequence[Finding], remainder: RemainderTest
) -> Selection:
    """Return the explanation without terms that explain less than what is left: they imitate what has no name."""
    explained = 1.0 - remainder.share
    trusted = {one.term for one in findings if one.gap_explained * explained > remainder.share}
    keep = [
        k
        for k, (part, named) in enumerate(zip(selection.chosen.parts, selection.named, strict=True))
        if part.candidate.term in trusted or not named
    ]
    if len(keep) == len(selection.chosen.parts):
        return selection
    parts = tuple(selection.chosen.parts[k] for k in keep)
    chosen = fit_parts(judge, parts) if parts else selection.base
    return replace(
        selection,
        chosen=chosen,
        rivals=tuple(selection.rivals[k] for k in keep),
        named=tuple(selection.named[k] for k in keep),
    )


def _findings(judge: Judge, selection: Selection) -> tuple[Finding, ...]:
    chosen = selection.chosen
    estimates = parameter_estimates(judge, chosen)
    total = max(selection.base.cost - chosen.cost, 1e-9)
    out = []
    for k, (part, rivals) in enumerate(zip(chosen.parts, selection.rivals, strict=True)):
        if not selection.named[k]:
            continue
        term, variant = part.candidate.term, part.candidate.variant
        others = chosen.parts[:k] + chosen.parts[k + 1 :]
        without = fit_parts(judge, others).cost if others else selection.base.cost
        alternatives = _alternatives(part.candidate, rivals, chosen, without - chosen.cost)
        out.append(
            Finding(
                term,
                variant,
                estimates[k],
                float(np.clip((without - chosen.cost) / total, 0.0, 1.0)),
                alternatives,
                sentence_for(term, variant, estimates[k], alternatives, judge.evidence[0].vehicle),
                term_size(judge, chosen, k),
                _runners_up(rivals),
                separations(term, variant, alternatives),
                CATALOGUE[term].exported,
            )
        )
    return tuple(sorted(out, key=lambda finding: -finding.gap_explained))


def _with_shares(
    findings: Sequence[Finding], chosen: Fit, shares: Sequence[float] | None
) -> tuple[Finding, ...]:
    """Replace what findings explain of all rows by what they explain of those kept out, where enough were."""
    if shares is None:
        return tuple(findings)
    by_term = {part.candidate.term: share for part, share in zip(chosen.parts, shares, strict=True)}
    told = [replace(one, gap_explained=by_term[one.term]) for one in findings]
    return tuple(sorted(told, key=lambda finding: -finding.gap_explained))


def _alternatives(own: Candidate, rivals: Sequence[Rival], chosen: Fit, saved: float) -> tuple[str, ...]:
    """Return terms that fit as well here, and those that always would: exact degeneracies."""
    rules = Rules()
    names = [
        rival.fit.parts[-1].candidate.term
        for rival in rivals
        if rival.excess < rules.same_excess
        or (rival.z < rules.same_within and rival.excess < rules.same_share * saved)
    ]
    names += exact_mimics(own.term, own.variant)
    taken = {part.candidate.term for part in chosen.parts}
    return tuple(name for name in dict.fromkeys(names) if name not in taken)


def _runners_up(rivals: Sequence[Rival]) -> tuple[RivalSummary, ...]:
    """Return the best variant of each of the best other terms."""
    best: dict[str, RivalSummary] = {}
    for rival in rivals:
        one = rival.fit.parts[-1].candidate
        best.setdefault(one.term, RivalSummary(one.term, one.variant, rival.excess, rival.z))
    return tuple(best.values())[:_SHOWN_RIVALS]


def _improvement(case: _Case, split: HeldOut, terms: Sequence[Term]):
    """Compare on what was kept out; the terms were fitted on the rest."""
    everything = [np.ones(len(one.series), dtype=bool) for one in case.holdout]
    recordings = [*zip(case.real, split.masks, strict=True), *zip(case.holdout, everything, strict=True)]
    return measure_improvement(recordings, terms, case.common, case.knowledge)


def _gaps(case: _Case, terms):
    forces = [gap_forces(one, (), case.common_rates(one)) for one in case.real]
    return tuple(map(gap_series, case.real, case.keep, forces, forces))


def _undecided(reasons: Sequence[str], share: float, inputs: Sequence[InputFile], described: dict) -> Diagnosis:
    return Diagnosis(
        "undecided", None, share, tuple(reasons), inputs=tuple(inputs), settings=described,
        summary=summarise("undecided", reasons=reasons),
    )  # fmt: skip
