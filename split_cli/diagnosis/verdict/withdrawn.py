"""Names that held-out time takes back: what predicts worse with them, beside what has no name."""

from collections.abc import Sequence, Set
from dataclasses import replace

from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.statement.improvement import Improvement
from split_cli.diagnosis.statement.result import Finding, Lead, RemainderTest
from split_cli.diagnosis.statement.sentences import withdrawn_sentence
from split_cli.vehicle.parameters import Vehicle


def withdrawn(
    findings: Sequence[Finding], improvement: Improvement | None, confirmed: Set[str] = frozenset()
) -> tuple[Finding, ...]:
    """Return findings that held-out time speaks against, where a part of the gap has no name or none could be seen.

    Each of both alone says little. Model-form error beside a name has no name, either, and a right name of a small
    effect may predict worse by what else the car lacks. Both together say that the name stands for what has none.
    Where halves of the simulation differ much, a remainder of that size counts as model-form error: held-out time
    is asked alone. What an instrument does is not withdrawn where its witnesses have `confirmed` it.
    """
    removed = None if improvement is None else improvement.removed.get("physics")
    if removed is None or removed[2] >= 0.0:
        return ()
    return tuple(one for one in findings if one.exported or one.term not in confirmed)


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


def as_leads(gone: Sequence[Finding], improvement: Improvement, vehicle: Vehicle) -> tuple[Lead, ...]:
    """Return withdrawn names as leads, which say why they are none."""
    rises = tuple(-one for one in improvement.removed["physics"])
    return tuple(
        Lead(
            one.term,
            one.variant,
            one.parameters,
            {},
            one.gap_explained,
            one.alternatives,
            withdrawn_sentence(one.term, one.variant, one.parameters, rises, vehicle),
        )
        for one in gone
    )
