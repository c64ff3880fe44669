"""The search under its two baselines: marginalised, and fixed where the first leaves doubt.

With a marginalised baseline, the uncertainty of the shared model discrepancy explains a gap before any term does.
That is right where the dictionary holds the simulation. It fails where model-form error is large, as between real
recordings. Nearly everything is uncertain there off the simulation's own path. A fault that takes a drive off that
path then hides in the discrepancy, as a steering gain of 0.8 does.

With a fixed baseline a term saves what it brings back to where the simulation has been. Only terms that alter
inputs or sensors do that. Where model-form error is large, only this second search names them, unless the first is
beyond doubt. A name that the second search confirms keeps the values of the first, since the discrepancy's error
off its path would go into the second ones. Other terms are named with a fixed baseline only where the first search
had chosen them, too small to name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from split_cli.diagnosis.innovations.case import Case
from split_cli.diagnosis.innovations.judge import Judge, alters_inputs, build_judge
from split_cli.diagnosis.policy import STANDARD, Policy, SelectionRules
from split_cli.diagnosis.remainder.flexible import FlexibleRows, flexible_rows
from split_cli.diagnosis.remainder.structure import FlexibleFit, Structure, build_structure
from split_cli.diagnosis.remainder.wander import wander_of
from split_cli.diagnosis.search.calibration import SelfTest, self_test
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.running import with_variants_that_run
from split_cli.diagnosis.search.selection import Selection, nothing, select_terms

__all__ = ["Reading", "read"]


@dataclass(frozen=True)
class Reading:
    """What a judge makes of the real recordings.

    Attributes
    ----------
    structure : Structure
        With the judge.
    gap : FlexibleFit
        Of the whole gap.
    selection : Selection
    known : SelfTest
        What the simulation shows against itself, read alike.
    inflation : float
        By which what wanders widens chi squared.
    judges : tuple of Judge
        With reserve, and to the letter where it was read so, too.
    """

    structure: Structure
    gap: FlexibleFit
    selection: Selection
    known: SelfTest
    inflation: float
    judges: tuple[Judge, ...] = ()


def read(
    case: Case,
    candidates: Sequence[Candidate],
    *,
    reach: float,
    policy: Policy = STANDARD,
    progress: Callable[[str], None] = lambda step: None,
) -> Reading:
    """Read with reserve; to the letter where misfit is much, and what is named alters inputs and is in doubt.

    Parameters
    ----------
    case : Case
    candidates : sequence of Candidate
    reach : float
        See `Comparison`.
    policy : Policy
    progress : callable
        Called with the name of each step.
    """
    progress("comparing")
    judge = build_judge(case.real, case.knowledge, case.common, case.keep, case.kinematics, policy=policy)
    known = _known(case, candidates, reach, policy)
    rows = [flexible_rows(one, case.common) for one in case.real]
    progress("naming")
    reading = _read(judge, rows, candidates, known)
    altering = [alters_inputs(term) for term in reading.selection.terms]
    sure = bool(altering) and reading.selection.first_p < policy.selection.sure_level
    if known.ratio <= policy.selection.much_misfit or sure or (altering and not any(altering)):
        return reading
    progress("naming to the letter")
    known = _known(case, candidates, reach, policy, to_the_letter=True)
    # The common physics follows at every step, and costs have more than one valley.
    wide = [one.widely_started() if _alters(one) else one for one in candidates]
    # What is small beside a name is misfit here, and would share a delay's savings with its like.
    alone = replace(policy, selection=replace(policy.selection, most_aside=0))
    letter = replace(judge.believed_to_the_letter(), policy=alone)
    again = _read(letter, rows, wide, known)
    kept = reading
    if _brings_back(again.selection, reading.selection, policy.selection):
        confirmed = bool(altering) and _ids(reading.selection) <= _ids(again.selection)
        kept = reading if confirmed else again
    elif altering:
        kept = replace(reading, selection=_without_names(reading.selection))
    return replace(kept, judges=(reading.structure.judge, again.structure.judge))


def _ids(selection: Selection) -> set[str]:
    return {term.id for term in selection.terms}


def _alters(candidate: Candidate) -> bool:
    return bool(candidate.starts) and alters_inputs(candidate.build(candidate.starts[0]))


def _brings_back(selection: Selection, reserved: Selection, rules: SelectionRules) -> bool:
    """Return whether a fair share of the cost goes with what is named to the letter, and all of it is believed.

    That is what alters inputs or sensors, and beyond doubt what the reading with reserve chose too, if only to
    keep it aside: a function that is wrong off its path looks like physics to the letter alone.
    """
    saved = selection.base.cost - selection.chosen.cost
    fair = saved > rules.letter_share * selection.base.cost
    chosen = {part.candidate.term for part in reserved.chosen.parts if selection.first_p < rules.sure_level}
    return bool(selection.terms) and fair and all(alters_inputs(t) or t.id in chosen for t in selection.terms)


def _without_names(selection: Selection) -> Selection:
    aside = tuple(False for _ in selection.named)
    nobody = tuple(() for _ in selection.named)
    return replace(selection, named=aside, rivals=nobody, siblings=nobody)


def _known(
    case: Case, candidates: Sequence[Candidate], reach: float, policy: Policy, *, to_the_letter: bool = False
) -> SelfTest:
    if not case.graded:
        return SelfTest()
    return self_test(
        case.graded,
        case.common,
        candidates,
        case.kinematics,
        inflation=policy.comparison.inflation,
        reach=reach,
        knowledge=case.knowledge if to_the_letter else None,
        policy=policy,
    )


def _read(
    judge: Judge,
    rows: Sequence[FlexibleRows],
    candidates: Sequence[Candidate],
    known: SelfTest,
) -> Reading:
    judge = known.allow(judge)
    structure = build_structure(judge, rows)
    base = nothing(judge)
    inflation = max(judge.policy.comparison.inflation, wander_of(structure, base.entries).ratio)
    gap = structure.fit(base.entries, inflation)
    judge = replace(judge, misfit=known.misfit_of(gap, judge.policy))
    structure = replace(structure, judge=judge)
    selection = select_terms(judge, candidates, inflation)
    selection = with_variants_that_run(structure, candidates, selection, inflation)
    return Reading(structure, gap, selection, known, inflation, (judge,))
