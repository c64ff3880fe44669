"""Held-out time: whether terms fitted on the rest explain it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import DiscrepancyPosterior, MarginalLikelihood, build_objective
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.statement.result import Finding
from split_cli.vehicle.effects import Term


@dataclass(frozen=True)
class HeldOut:
    """The real recordings' rows in two."""

    training: MarginalLikelihood
    testing: MarginalLikelihood | None  # None where too little is kept out to judge by
    masks: tuple[np.ndarray, ...]  # bool (N,): samples kept out of each real recording


def hold_out(
    real: Sequence[Evidence],
    keep: Sequence[np.ndarray],
    others: Sequence[Evidence],
    keep_others: Sequence[np.ndarray],
    posterior: DiscrepancyPosterior | None,
    discrepancy: SharedDiscrepancy,
    kinematics: Sequence[KinematicResiduals],
    policy: Policy = STANDARD,
    *,
    fixed_baseline: bool = False,
) -> HeldOut:
    """Keep out the recordings named for it, else the last share of the time of every real one.

    Parameters
    ----------
    real, others : sequence of Evidence
        Others are kept out as a whole.
    keep, keep_others : sequence of ndarray of bool, shape (G,)
        Rows that are compared.
    posterior, discrepancy, kinematics
        As for `build_objective`.
    fixed_baseline : bool
        Whether the simulation is a fixed baseline.
    """

    def objective_of(recordings: Sequence[Evidence], rows: Sequence[np.ndarray], *positions) -> MarginalLikelihood:
        objective = build_objective(recordings, posterior, discrepancy, rows, *positions, policy=policy)
        return objective.with_fixed_baseline() if fixed_baseline else objective

    if others:
        masks = tuple(np.zeros(len(one.series), dtype=bool) for one in real)
    else:
        masks = tuple(one.series.t > (1.0 - policy.comparison.holdout_share) * one.series.t[-1] for one in real)
    before = [mask & ~held[one.at] for one, mask, held in zip(real, keep, masks, strict=True)]
    training = objective_of(real, before, kinematics)
    pairs = list(zip(others, keep_others, strict=True)) if others else []
    if not others:
        pairs = [(one, mask & held[one.at]) for one, mask, held in zip(real, keep, masks, strict=True)]
    pairs = [(one, mask) for one, mask in pairs if mask.any()]
    if sum(int(mask.sum()) for _, mask in pairs) < policy.comparison.rows_kept_out:
        return HeldOut(training, None, masks)
    testing = objective_of([one for one, _ in pairs], [mask for _, mask in pairs])
    return HeldOut(training, testing, masks)


def fitted_alone(
    objective: MarginalLikelihood, fit: Fit, known: Sequence[bool], findings: Sequence[Finding]
) -> tuple[Part, ...]:
    """Return the known parts of a fit as they explain most without the others, within what is known of them.

    Parameters
    ----------
    objective : MarginalLikelihood
    fit : Fit
        Of which the parts that are not known leave.
    known : sequence of bool
        Of every part: whether it has a name, or is what any sound recording may have.
    findings : sequence of Finding
        With the 95 % intervals that no value leaves.

    Notes
    -----
    A value of a joint fit is right beside all of that fit: grip that is low beside stiff tyres is too low without
    them. A vehicle with the names alone has none of what has no name. Of the values that the data allow, it takes
    those that are best then. What a drive does not show keeps the value of its finding.
    """
    parts = tuple(part for part, one in zip(fit.parts, known, strict=True) if one)
    if len(parts) in (0, len(fit.parts)):
        return parts
    by_term = {one.term: one for one in findings}
    bounded = [_within(part, by_term[term]) if (term := part.candidate.term) in by_term else part for part in parts]
    alone = fit_parts(objective, bounded)
    return tuple(Part(part.candidate, one.values) for part, one in zip(parts, alone.parts, strict=True))


def _within(part: Part, finding: Finding) -> Part:
    """Return a part whose ranges are the intervals of its finding."""
    ranges = dict(part.candidate.ranges)
    for name, one in finding.parameters.items():
        is_shown = one.value != part.term.neutral.get(name)
        lower, upper = one.interval_95 if is_shown else (one.value, one.value)
        ranges[name] = replace(ranges[name], lower=lower, upper=upper)
    return Part(replace(part.candidate, ranges=ranges), part.values)


def explained_shares(split: HeldOut, fit: Fit) -> tuple[float, ...] | None:
    """Return the drop in held-out squared error above the noise floor when a part is removed last, as shares [1].

    Parameters
    ----------
    fit : Fit
        On the training rows.

    Returns
    -------
    tuple of float or None
        Of every part, between 0 and 1; None where too little was kept out.
    """
    if split.testing is None or not fit.parts:
        return None
    return tuple(_share(split, fit, fit.parts[:k] + fit.parts[k + 1 :]) for k in range(len(fit.parts)))


def explained_by(split: HeldOut, fit: Fit, terms: Sequence[Term]) -> float | None:
    """Return which share [1] of the held-out squared error above the noise floor named terms take by themselves.

    Parameters
    ----------
    fit : Fit
        On the training rows, of all parts: what it leaves beyond noise is above the floor, too.
    terms : sequence of Term
        The named ones as they explain most without the others, see `fitted_alone`.

    Returns
    -------
    float or None
        Between 0 and 1; None where nothing has a name or too little was kept out.
    """
    if split.testing is None or not terms:
        return None
    _, bare, above = _held_out_costs(split, fit)
    return float(np.clip((bare - split.testing.cost(tuple(terms))) / above, 0.0, 1.0))


def _share(split: HeldOut, fit: Fit, others: Sequence[Part]) -> float:
    """Return what of the held-out squared error above the noise floor returns where only `others` are fitted."""
    full, bare, above = _held_out_costs(split, fit)
    without = split.testing.cost(fit_parts(split.training, tuple(others)).terms) if others else bare
    return float(np.clip((without - full) / above, 0.0, 1.0))


def _held_out_costs(split: HeldOut, fit: Fit) -> tuple[float, float, float]:
    """Return the held-out squared error with a fit, without any part, and what of the latter is above noise."""
    full, bare = split.testing.cost(fit.terms), split.testing.cost(())
    return full, bare, max(bare - min(full, float(len(split.testing.weight))), 1e-9)
