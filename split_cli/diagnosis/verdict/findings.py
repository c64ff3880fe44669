"""What may be said of an explanation: findings, what looks the same, and what is left without a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.diagnosis.innovations.judge import Judge
from split_cli.diagnosis.policy import STANDARD, Abstention, Policy
from split_cli.diagnosis.remainder.structure import Structure
from split_cli.diagnosis.remainder.wander import Wander, wander_of
from split_cli.diagnosis.search.fitting import Fit, fit_parts
from split_cli.diagnosis.search.misfit import entries_beside_misfit
from split_cli.diagnosis.search.reading import Reading
from split_cli.diagnosis.search.selection import Rival, Selection, explaining_as_well, term_size, without_parts
from split_cli.diagnosis.statement.result import Finding, ParameterEstimate, RemainderTest, RivalSummary
from split_cli.diagnosis.statement.sentences import sentence_for, separations
from split_cli.diagnosis.statement.separation import exact_mimics
from split_cli.diagnosis.verdict.constancy import parameter_drifts
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from split_cli.vehicle.effects import CATALOGUE

__all__ = ["describe", "wanders", "with_shares"]

_SHOWN_RIVALS = 6


def describe(
    reading: Reading, contradicted: bool = False
) -> tuple[Selection, tuple[Finding, ...], RemainderTest, bool]:
    """Return what is trusted of a reading's selection, its findings, what is left, and whether that has no name.

    Parameters
    ----------
    reading : Reading
    contradicted : bool
        Whether speed or yaw rate is out of scale: then physics is not named, which might stand for it.
    """
    structure, selection, inflation = reading.structure, reading.selection, reading.inflation
    judge = structure.judge
    rules = judge.policy.abstention
    left = entries_beside_misfit(judge, selection.chosen)
    remainder = _remainder(structure, selection, inflation, left)
    findings = _findings(judge, selection, remainder.share)
    wander = wander_of(structure, left)
    unexplained = not findings or _is_unexplained(findings, remainder, wander, reading, rules)
    kept = {one.term for one in findings}
    if contradicted:
        unexplained, kept = True, {one.term for one in findings if not one.exported}
    elif unexplained:
        # Where something is left, terms that explain less than it does imitate what has no name.
        explained = 1.0 - remainder.share
        kept = {one.term for one in findings if one.gap_explained * explained > remainder.share}
    kept -= _vague(selection, findings, rules)
    if len(kept) < len(findings):
        unexplained = True
        selection = _only(judge, selection, kept)
        left = entries_beside_misfit(judge, selection.chosen)
        remainder = _remainder(structure, selection, inflation, left)
        findings = _findings(judge, selection, remainder.share)
    return selection, findings, remainder, unexplained


def _vague(selection: Selection, findings: Sequence[Finding], rules: Abstention) -> set[str]:
    """Return terms that the data do not single out: many others do as well, or nothing tells where they act."""
    ranges = {part.candidate.term: part.candidate.ranges for part in selection.chosen.parts}
    out = set()
    for one in findings:
        exact = exact_mimics(one.term, one.variant)
        if sum(name not in exact for name in one.alternatives) > rules.most_alternatives:
            out.add(one.term)
        for name in ("s_start", "s_end"):
            if name in one.parameters:
                low, high = one.parameters[name].interval_95
                if high - low > rules.widest_place * ranges[one.term][name].upper:
                    out.add(one.term)
    return out


def _is_unexplained(
    findings: Sequence[Finding],
    remainder: RemainderTest,
    wander: Wander,
    reading: Reading,
    rules: Abstention,
) -> bool:
    """Return whether what is left is structured and large, or wanders."""
    large = max(2.0 * rules.severity, min(rules.size * reading.gap.severity, rules.most))
    if wanders(wander, reading.known.wander, reading.structure.judge.policy) and wander.severity > large:
        return True
    if remainder.p_value >= rules.level or remainder.severity < rules.severity:
        return False
    return remainder.severity > large or remainder.share > rules.share


def wanders(wander: Wander, usual: float, policy: Policy = STANDARD) -> bool:
    """Return whether rows vary together by more than they usually do, and by enough to matter."""
    rules = policy.abstention
    return wander.severity > rules.severity and wander.p_value(usual, policy.unnamed) < rules.level


def with_shares(findings: Sequence[Finding], chosen: Fit, shares: Sequence[float] | None) -> tuple[Finding, ...]:
    """Replace what findings explain of all rows by what they explain of those kept out, where enough were."""
    if shares is None:
        return tuple(findings)
    by_term = {part.candidate.term: share for part, share in zip(chosen.parts, shares, strict=True)}
    told = [replace(one, gap_explained=by_term[one.term]) for one in findings]
    return tuple(sorted(told, key=lambda finding: -finding.gap_explained))


def _remainder(
    structure: Structure, selection: Selection, inflation: float, entries: np.ndarray
) -> RemainderTest:
    """Return what is left beyond what the named terms may get wrong; `entries` of `entries_beside_misfit`."""
    left = structure.fit(entries, inflation)
    named = selection.base.cost - selection.chosen.cost
    drifts = tuple((one.variable, one.saved) for one in parameter_drifts(structure.judge, selection.chosen)[:3])
    share = structure.nameless_share(left, named, inflation)
    return RemainderTest(left.p_value, share, left.severity, left.group_saved, drifts=drifts)


def _only(judge: Judge, selection: Selection, terms: set[str]) -> Selection:
    """Return an explanation with these of its named terms, refitted; what was kept aside stays."""
    keep = [
        k
        for k, (part, named) in enumerate(zip(selection.chosen.parts, selection.named, strict=True))
        if part.candidate.term in terms or not named
    ]
    parts = tuple(selection.chosen.parts[k] for k in keep)
    chosen = fit_parts(judge, parts) if parts else selection.base
    return replace(
        selection,
        chosen=chosen,
        without=without_parts(judge, selection.base, chosen),
        rivals=tuple(selection.rivals[k] for k in keep),
        siblings=tuple(selection.siblings[k] for k in keep),
        named=tuple(selection.named[k] for k in keep),
    )


def _findings(judge: Judge, selection: Selection, nameless: float) -> tuple[Finding, ...]:
    chosen = selection.chosen
    estimates = parameter_estimates(judge, chosen)
    total = max(selection.base.cost - chosen.cost, 1e-9)
    out = []
    for k, (part, rivals) in enumerate(zip(chosen.parts, selection.rivals, strict=True)):
        if not selection.named[k]:
            continue
        term, variant = part.candidate.term, part.candidate.variant
        alternatives = _alternatives(judge, selection, k)
        parameters = _with_variants(judge, selection, k, estimates[k], nameless)
        out.append(
            Finding(
                term,
                variant,
                parameters,
                float(np.clip((selection.without[k].cost - chosen.cost) / total, 0.0, 1.0)),
                alternatives,
                sentence_for(term, variant, parameters, alternatives, judge.evidence[0].vehicle),
                term_size(judge, chosen, k),
                _runners_up(rivals),
                separations(term, variant, alternatives),
                CATALOGUE[term].exported,
            )
        )
    return tuple(sorted(out, key=lambda finding: -finding.gap_explained))


def _with_variants(
    judge: Judge, selection: Selection, k: int, own: Mapping[str, ParameterEstimate], nameless: float
) -> dict[str, ParameterEstimate]:
    """Widen a part's intervals by those of its term's other variants, where they explain the data as well.

    Of variants that differ by less than the share of the gap that is `nameless`, either may be the better one.
    """
    out = dict(own)
    for sibling in explaining_as_well(judge, selection, k, selection.siblings[k], nameless):
        theirs = parameter_estimates(judge, sibling.fit)[-1]
        out = {name: one.covering(theirs[name]) if name in theirs else one for name, one in out.items()}
    return out


def _alternatives(judge: Judge, selection: Selection, k: int) -> tuple[str, ...]:
    """Return terms that fit as well here, and those that always would: exact degeneracies."""
    own = selection.chosen.parts[k].candidate
    rivals = explaining_as_well(judge, selection, k, selection.rivals[k])
    names = [rival.fit.parts[-1].candidate.term for rival in rivals]
    names += exact_mimics(own.term, own.variant)
    taken = {part.candidate.term for part in selection.chosen.parts}
    return tuple(name for name in dict.fromkeys(names) if name not in taken)


def _runners_up(rivals: Sequence[Rival]) -> tuple[RivalSummary, ...]:
    """Return the best variant of each of the best other terms."""
    best: dict[str, RivalSummary] = {}
    for rival in rivals:
        one = rival.fit.parts[-1].candidate
        best.setdefault(one.term, RivalSummary(one.term, one.variant, rival.excess, rival.z))
    return tuple(best.values())[:_SHOWN_RIVALS]
