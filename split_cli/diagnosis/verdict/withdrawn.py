"""Withdrawn findings: those with which held-out time is predicted worse, while a part of the gap is unexplained."""

from collections.abc import Sequence, Set
from dataclasses import replace

from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.statement.improvement import CorrectedVehicle, Improvement
from split_cli.diagnosis.statement.result import Finding, Lead, RemainderTest
from split_cli.diagnosis.statement.sentences import error_rises, nothing_is_better, withdrawn_sentence
from split_cli.vehicle.parameters import Vehicle


def withdrawn(
    findings: Sequence[Finding],
    improvement: Improvement | None,
    corrected: CorrectedVehicle | None = None,
    confirmed: Set[str] = frozenset(),
) -> tuple[tuple[Finding, ...], str]:
    """Return findings that are withdrawn because of held-out time, and the reason in words.

    It is called if a part of the gap is unexplained, or if none could be seen because halves of the simulation differ
    much. Neither that nor a worse prediction alone is evidence against a finding: a model-form error is unexplained
    too, and a true small effect may predict worse because of other errors. Both together indicate that the finding
    stands for an unexplained effect.

    Notes
    -----
    All findings are withdrawn if one step is predicted worse with them beyond chance. Those of the car are withdrawn if
    a vehicle file with them is worse after 2 s in some velocity and better in none, both beyond chance, unless one step
    is predicted better beyond chance. Sensor faults that witnesses have `confirmed` stay.
    """
    removed = None if improvement is None else improvement.removed.get("physics")
    if removed is not None and removed[2] < 0.0:
        gone = tuple(one for one in findings if one.exported or one.term not in confirmed)
        return gone, error_rises((-removed[0], -removed[1], -removed[2]))
    is_better = removed is not None and removed[1] > 0.0
    if corrected is not None and corrected.is_refuted and not is_better:
        return tuple(one for one in findings if one.exported), nothing_is_better(corrected)
    return (), ""


def without_names(
    selection: Selection, findings: Sequence[Finding], remainder: RemainderTest, gone: Sequence[Finding]
) -> tuple[Selection, tuple[Finding, ...], RemainderTest]:
    """Return selection, findings and remainder without the findings `gone`, whose shares count as unexplained."""
    terms = {one.term for one in gone}
    named = tuple(
        one and part.candidate.term not in terms
        for one, part in zip(selection.named, selection.chosen.parts, strict=True)
    )
    share = remainder.share + (1.0 - remainder.share) * sum(one.gap_explained for one in gone)
    left = tuple(one for one in findings if one.term not in terms)
    return replace(selection, named=named), left, replace(remainder, share=min(share, 1.0))


def as_leads(gone: Sequence[Finding], reason: str, vehicle: Vehicle) -> tuple[Lead, ...]:
    """Return withdrawn findings as leads that state the reason."""
    return tuple(
        Lead(
            one.term,
            one.variant,
            one.parameters,
            {},
            one.gap_explained,
            one.alternatives,
            withdrawn_sentence(one.term, one.variant, one.parameters, reason, vehicle),
        )
        for one in gone
    )
