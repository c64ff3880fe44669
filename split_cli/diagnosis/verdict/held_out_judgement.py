"""Judgement of findings on held-out time: their shares of the gap, the improvement, and the corrected vehicle."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from split_cli.diagnosis.innovations.case import DiagnosisCase
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import Policy
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.statement.improvement import CorrectedVehicle, Improvement
from split_cli.diagnosis.statement.result import Finding, RemainderTest
from split_cli.diagnosis.verdict.corrected_vehicle import judge_corrected
from split_cli.diagnosis.verdict.findings import with_shares
from split_cli.diagnosis.verdict.held_out_split import HeldOut, explained_by, explained_shares, fitted_alone, hold_out
from split_cli.diagnosis.verdict.improvement import measure_improvement
from split_cli.vehicle.effects import Term
from split_cli.vehicle.parameters import EffectSpec


@dataclass(frozen=True)
class HeldOutFit:
    """All parts of an explanation, named or not, fitted on training time."""

    case: DiagnosisCase
    objective: MarginalLikelihood  # of all rows
    whole: Fit  # on all rows
    split: HeldOut
    trained: Fit  # the same parts on the training rows

    @property
    def recordings(self) -> list[tuple[Evidence, np.ndarray]]:
        """Return all real recordings and which of their samples are held out, masks of shape (N,)."""
        everything = [np.ones(len(one.series), dtype=bool) for one in self.case.holdout]
        pairs = zip(self.case.real, self.split.masks, strict=True)
        return [*pairs, *zip(self.case.holdout, everything, strict=True)]

    @cached_property
    def shares(self) -> tuple[float, ...] | None:
        """Return `explained_shares` of the parts; they do not depend on which are named."""
        return explained_shares(self.split, self.trained)

    def improvement(self, terms: Sequence[Term]) -> Improvement | None:
        """Return the held-out errors with terms, see `measure_improvement`."""
        case = self.case
        return measure_improvement(self.recordings, terms, case.discrepancy, case.posterior, case.simulated)


@dataclass(frozen=True)
class HeldOutJudgement:
    """Findings and remainder with their shares of the held-out error, the improvement, and the corrected vehicle."""

    findings: tuple[Finding, ...]
    remainder: RemainderTest
    improvement: Improvement | None
    corrected: CorrectedVehicle | None


def fit_without_held_out(case: DiagnosisCase, objective: MarginalLikelihood, whole: Fit, policy: Policy) -> HeldOutFit:
    """Return an explanation refitted without the held-out time.

    Parameters
    ----------
    objective : MarginalLikelihood
        Of all rows.
    whole : Fit
        The explanation on these rows.

    Notes
    -----
    For the refit a late channel is shifted as a whole by the delay of the whole fit, as in the search. Held-out errors
    are those of channels shifted by the refitted delay, see `DiagnosisCase.judged_with_residue`.
    """
    late = [term for term in whole.terms if term.moves_samples]
    split = hold_out(
        case.real,
        case.keep,
        case.holdout,
        case.keep_holdout,
        case.posterior,
        case.discrepancy,
        case.kinematics,
        policy,
        fixed_baseline=objective.fixed_baseline,
    )
    if late:
        split = replace(split, training=split.training.with_residue_moved(late))
    trained = fit_parts(split.training, whole.parts) if whole.parts else whole
    return HeldOutFit(case, objective, whole, split, trained)


def judge_names(
    fit: HeldOutFit, acting: Sequence[bool], findings: Sequence[Finding], remainder: RemainderTest
) -> HeldOutJudgement:
    """Judge findings on held-out time, without the parts that are not known to act.

    Parameters
    ----------
    acting : sequence of bool
        Of every part of the fit: whether it is named, or a sensor error within tolerance.
    """
    terms = tuple(part.term for part in fitted_alone(fit.split.training, fit.trained, acting, findings))
    corrected = judge_corrected(fit.recordings, terms)
    if corrected is not None and not all(acting):
        parts = fitted_alone(fit.objective, fit.whole, acting, findings)
        corrected = replace(corrected, values={one.candidate.term: one.values for one in parts})
    return HeldOutJudgement(
        with_shares(findings, fit.whole, fit.shares),
        replace(remainder, explained=explained_by(fit.split, fit.trained, terms)),
        fit.improvement(terms),
        corrected,
    )


def with_nameless_parts(fit: HeldOutFit, acting: Sequence[bool], judged: HeldOutJudgement) -> HeldOutJudgement:
    """Return the judgement of the whole fit, if the findings alone give no accepted vehicle.

    Notes
    -----
    Values of a joint fit belong together. Some parts are not named since the data do not distinguish them from others,
    and without them the findings may predict worse than the nominal model. Such a file is judged by the held-out time
    for the second time. So it must also be no worse on training time, and there better in some velocity after 2 s.
    """
    corrected = judged.corrected
    if corrected is None or corrected.accepted or all(acting):
        return judged
    further = tuple(
        _as_effect(part) for part, one in zip(fit.whole.parts, acting, strict=True) if not one and part.term.exported
    )
    together = judge_corrected(fit.recordings, fit.trained.terms) if further else None
    if together is None or not together.accepted:
        return judged
    fitted = judge_corrected([(one, ~held) for one, held in fit.recordings], fit.trained.terms)
    if fitted is None or not fitted.accepted or not any(one.is_better for one in fitted.farthest):
        return judged
    return replace(
        judged,
        corrected=replace(together, further=further, alone=corrected),
        improvement=fit.improvement(fit.trained.terms),
    )


def _as_effect(part: Part) -> EffectSpec:
    return EffectSpec(part.candidate.term, part.values, part.candidate.variant)
