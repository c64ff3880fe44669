"""Held-out time: its split from training time, and the share of its error that terms explain."""

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
    """The objective on training time and on held-out time."""

    training: MarginalLikelihood
    testing: MarginalLikelihood | None  # None if too little is held out
    masks: tuple[np.ndarray, ...]  # bool (N,): held-out samples of each real recording


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
    """Hold out the recordings given for it, or else the last share of the time of every real one.

    Parameters
    ----------
    real, others : sequence of Evidence
        Others are held out as a whole.
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
    objective: MarginalLikelihood, fit: Fit, acting: Sequence[bool], findings: Sequence[Finding]
) -> tuple[Part, ...]:
    """Return the parts of a fit that are known to act, refitted without the others and within their 95 % intervals.

    Parameters
    ----------
    objective : MarginalLikelihood
    fit : Fit
        Of all parts.
    acting : sequence of bool
        Of every part: whether it is named, or a sensor error within tolerance.
    findings : sequence of Finding
        Whose 95 % intervals bound the values.

    Notes
    -----
    Values of a joint fit belong together: a low grip beside stiff tyres is too low without these. A vehicle file with
    the findings alone lacks the parts without a name, so its values are those that are best without them. A parameter
    that the drive does not excite keeps the value of its finding.
    """
    parts = tuple(part for part, one in zip(fit.parts, acting, strict=True) if one)
    if len(parts) in (0, len(fit.parts)):
        return parts
    by_term = {one.term: one for one in findings}
    bounded = [_within(part, by_term[term]) if (term := part.candidate.term) in by_term else part for part in parts]
    alone = fit_parts(objective, bounded)
    return tuple(Part(part.candidate, one.values) for part, one in zip(parts, alone.parts, strict=True))


def _within(part: Part, finding: Finding) -> Part:
    """Return a part whose ranges are the 95 % intervals of its finding."""
    ranges = dict(part.candidate.ranges)
    for name, one in finding.parameters.items():
        is_shown = one.value != part.term.neutral.get(name)
        lower, upper = one.interval_95 if is_shown else (one.value, one.value)
        ranges[name] = replace(ranges[name], lower=lower, upper=upper)
    return Part(replace(part.candidate, ranges=ranges), part.values)


def explained_shares(split: HeldOut, fit: Fit) -> tuple[float, ...] | None:
    """Return the share of held-out squared error above the noise floor that each part explains beside the others [1].

    Parameters
    ----------
    fit : Fit
        On the training rows.

    Returns
    -------
    tuple of float or None
        Of every part, between 0 and 1; None if too little was held out.
    """
    if split.testing is None or not fit.parts:
        return None
    return tuple(_share(split, fit, fit.parts[:k] + fit.parts[k + 1 :]) for k in range(len(fit.parts)))


def explained_by(split: HeldOut, fit: Fit, terms: Sequence[Term]) -> float | None:
    """Return the share of held-out squared error above the noise floor that terms explain by themselves [1].

    Parameters
    ----------
    fit : Fit
        On the training rows, of all parts. The floor is its held-out error, or that of noise alone if smaller.
    terms : sequence of Term
        The findings, fitted without the other parts, see `fitted_alone`.

    Returns
    -------
    float or None
        Between 0 and 1; None without terms, or if too little was held out.
    """
    if split.testing is None or not terms:
        return None
    _, bare, above = _held_out_costs(split, fit)
    return float(np.clip((bare - split.testing.cost(tuple(terms))) / above, 0.0, 1.0))


def _share(split: HeldOut, fit: Fit, others: Sequence[Part]) -> float:
    """Return by how much the held-out squared error rises with `others` alone, as a share of that above the floor."""
    full, bare, above = _held_out_costs(split, fit)
    without = split.testing.cost(fit_parts(split.training, tuple(others)).terms) if others else bare
    return float(np.clip((without - full) / above, 0.0, 1.0))


def _held_out_costs(split: HeldOut, fit: Fit) -> tuple[float, float, float]:
    """Return the held-out squared error with a fit, without any part, and the latter above the noise floor."""
    full, bare = split.testing.cost(fit.terms), split.testing.cost(())
    return full, bare, max(bare - min(full, float(len(split.testing.weight))), 1e-9)
