"""Names that held-out time takes back: it is predicted worse with them, beside what has no name."""

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
    """Return findings that held-out time speaks against, and how it does so, in words.

    Asked where a part of the gap has no name, or none could be seen: where halves of the simulation differ much, a
    remainder of that size counts as model-form error. Either alone says little. Model-form error beside a name has
    no name, either, and a right name of a small effect may predict worse by what else the car lacks. Both together
    say that the name stands for what has none.

    Notes
    -----
    Held-out time speaks against all names if one step is predicted worse with them beyond chance. It speaks against
    those of the car if a vehicle file with them is worse after 2 s in some velocity and better in none, both beyond
    chance, unless one step is predicted better with them beyond chance. What an instrument does stays where its
    witnesses have `confirmed` it.
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
    """Return a selection, findings and remainder in which what is `gone` has no name and counts as unexplained."""
    terms = {one.term for one in gone}
    named = tuple(
        one and part.candidate.term not in terms
        for one, part in zip(selection.named, selection.chosen.parts, strict=True)
    )
    share = remainder.share + (1.0 - remainder.share) * sum(one.gap_explained for one in gone)
    left = tuple(one for one in findings if one.term not in terms)
    return replace(selection, named=named), left, replace(remainder, share=min(share, 1.0))


def as_leads(gone: Sequence[Finding], reason: str, vehicle: Vehicle) -> tuple[Lead, ...]:
    """Return withdrawn names as leads, which say why they are none."""
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
