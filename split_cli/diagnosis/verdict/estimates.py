"""Values, standard errors and intervals of the parameters of an explanation."""

from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.delay_minima import other_minima
from split_cli.diagnosis.search.fitting import Fit, Part, sensitivity_of
from split_cli.diagnosis.search.form_error import moved_between_load_laws
from split_cli.diagnosis.search.term_tests import systematic_error, witnesses_disagree
from split_cli.diagnosis.statement.result import ParameterEstimate
from split_cli.diagnosis.verdict.joint_region import JointRegion, least_above, radius_95
from split_cli.vehicle.effects.search import Range

_CHI2_95 = 3.84  # of one parameter
_PLACES = ("s_start", "s_end")
_COLLINEAR = 1e-10  # ridge on the scaled normal matrix, below which a direction is not determined at all [1]


@dataclass(frozen=True)
class PartEstimate:
    """Estimates of the parameters of one part: one by one, and jointly."""

    parameters: dict[str, ParameterEstimate]  # each by itself
    # Joint region of all parameters with a neutral value; a second one with another load law, see
    # `moved_between_load_laws`. Empty if there is no such parameter.
    regions: tuple[JointRegion, ...]


def parameter_estimates(
    objective: MarginalLikelihood, fit: Fit, *, recorded: bool = True
) -> tuple[dict[str, ParameterEstimate], ...]:
    """Return the estimates of every part's parameters, by name; see `estimate_parts`."""
    return tuple(one.parameters for one in estimate_parts(objective, fit, recorded=recorded))


def estimate_parts(objective: MarginalLikelihood, fit: Fit, *, recorded: bool = True) -> tuple[PartEstimate, ...]:
    """Return the estimates of every part, with 95 % intervals and joint regions.

    Parameters
    ----------
    objective : MarginalLikelihood
    fit : Fit
    recorded : bool
        Whether the recording has these effects; if not, witnesses give no evidence of their sizes.

    Notes
    -----
    A standard error combines several contributions:

    - Random error: the sandwich (J^T J)^-1 (sum over blocks of s_b s_b^T) (J^T J)^-1 with the scores s_b of blocks of
      time (Liang and Zeger, 1986), at least that of unit noise, widened by model-form error. J contains the uncertainty
      of the shared discrepancy. With a fixed baseline it does not, and the variance is doubled: the simulation is as
      uncertain.
    - Systematic error by other terms, see `systematic_error`; none of the car's for a fault that witnesses see.
    - Difference between two recordings of one car, as between halves of the simulation.
    - Disagreement of witnesses about the size of a sensor fault.
    - Model-form error of the tyres, for terms that act through them.

    An interval also contains the value under the best load law between the variants (`moved_between_load_laws`), and
    every other minimum of the cost over a delay that explains as well (`other_minima`). It ends at the range of a real
    car. The cost is no parabola over a parameter with `Range.ends_complete`, so its random error is that of the cost
    itself (`_limits_by_cost`). A parameter that changes all rows by less than one standard deviation over its whole
    range was not excited, as a brake gain without braking. It gets its neutral value, and its range as interval. In a
    joint region the model-form error of the tyres is independent for each parameter; other systematic error is a common
    share of the effect.
    """
    from scipy.stats import t as student

    J = sensitivity_of(objective, fit)
    form_error = objective.policy.selection.form_error_share
    if not J.shape[1]:
        return ()
    random = _random_error(objective, fit, J)
    variance = np.maximum(np.diag(random.sandwich), np.diag(random.of_noise))
    wide = float(student.ppf(0.975, random.freedom))
    moved, out, column = moved_between_load_laws(objective, fit, recorded=recorded), [], 0
    for k, part in enumerate(fit.parts):
        term, estimated, names = part.term, {}, []
        shared = np.hypot(systematic_error(objective, fit, k), _between_recordings(objective, fit, k))
        if recorded:
            shared = np.hypot(shared, witnesses_disagree(objective, fit, k, objective.policy.selection))
        own = form_error if term.through_tires else 0.0
        first = column
        for name, unit in term.parameter_units(part.candidate.variant).items():
            value, physical = term.parameters[name], part.candidate.ranges[name]
            neutral = term.neutral.get(name)
            if neutral is not None and random.scale[column] * (physical.upper - physical.lower) < 1.0:
                estimated[name] = _not_shown(neutral, unit, physical)
                column += 1
                continue
            away = 0.0 if neutral is None else value - neutral
            error = float(np.hypot(np.sqrt(variance[column]), abs(away) * np.hypot(shared, own)))
            limits = (value - wide * error + min(moved[column], 0.0), value + wide * error + max(moved[column], 0.0))
            if name in _PLACES:
                rise = _CHI2_95 * max(float(np.max(variance / np.maximum(random.unit, 1e-300))), 1.0)
                limits = _limits_by_cost(objective, fit, k, name, rise)
                error = (limits[1] - limits[0]) / (2.0 * wide)
            elif physical.ends_complete:
                others = np.delete(J, column, axis=1)
                rise = wide**2 * variance[column] / max(random.unit[column], 1e-300)
                by_cost = np.array(_limits_by_cost(objective, fit, k, name, float(rise), others)) - value
                limits = tuple(value + np.sign(by_cost) * np.hypot(by_cost, wide * abs(away) * np.hypot(shared, own)))
            elif recorded and (minima := other_minima(objective, fit, k, name)):
                # Each minimum has the same width as the one that was found.
                reach = np.array(limits) - value
                limits = min(limits[0], min(minima) + reach[0]), max(limits[1], max(minima) + reach[1])
                error = (limits[1] - limits[0]) / (2.0 * wide)
            estimated[name] = ParameterEstimate(value, error, unit, _possible(limits, value, physical))
            if neutral is not None:
                names.append(name)
            column += 1
        regions: tuple[JointRegion, ...] = ()
        if names:
            at = first + np.flatnonzero([name in names for name in estimated])
            away = np.array([estimated[name].value - term.neutral[name] for name in names])
            errors = shared**2 * np.outer(away, away) + np.diag((own * away) ** 2)
            errors += least_above(random.sandwich[np.ix_(at, at)], random.of_noise[np.ix_(at, at)])
            region = JointRegion(tuple(names), away, errors, radius_95(len(at), random.freedom))
            regions = (region, region.moved(moved[at])) if moved[at].any() else (region,)
        out.append(PartEstimate(estimated, regions))
    return tuple(out)


@dataclass(frozen=True)
class _RandomError:
    """Random error of the parameters of a fit, without systematic error."""

    scale: np.ndarray  # (P,): length of the change of whitened rows by a unit of each parameter
    sandwich: np.ndarray  # (P, P): covariance from the scores of blocks of time
    of_noise: np.ndarray  # (P, P): covariance by unit noise, widened by model-form error
    unit: np.ndarray  # (P,): variances by unit noise alone
    freedom: int  # degrees of freedom of the sandwich


def _random_error(objective: MarginalLikelihood, fit: Fit, J: np.ndarray) -> _RandomError:
    """Return the random error of a fit with sensitivity J, shape (R, P), see `estimate_parts`."""
    scale = np.sqrt(np.sum(J**2, axis=0)) + 1e-120
    normal = np.linalg.inv((J / scale).T @ (J / scale) + _COLLINEAR * np.eye(J.shape[1]))
    scores = objective.block_sums((J / scale) * fit.residuals[:, None])
    blocks = len(scores)
    middle = scores.T @ scores * blocks / max(blocks - J.shape[1], 1)
    covariance = normal @ middle @ normal / np.outer(scale, scale)
    known = normal / np.outer(scale, scale) * max(objective.form_error_inflation, 1.0)
    if objective.fixed_baseline:
        covariance, known = 2.0 * covariance, 2.0 * known
    return _RandomError(scale, covariance, known, np.diag(normal) / scale**2, max(blocks - J.shape[1], 2))


def _not_shown(neutral: float, unit: str, physical: Range) -> ParameterEstimate:
    """Return the estimate of a parameter that was not excited: neutral, with its range as interval."""
    limits = _possible((physical.lower, physical.upper), neutral, physical)
    return ParameterEstimate(neutral, 0.5 * (limits[1] - limits[0]), unit, limits)


def _between_recordings(objective: MarginalLikelihood, fit: Fit, k: int) -> float:
    """Return the standard deviation of a part's size between two recordings of one car, over its size [1].

    It is the root of the saving between halves of the simulation over the saving here, since savings grow with the
    square of the size.
    """
    part = fit.parts[k]
    first = sum(len(one.values) for one in fit.parts[:k])
    names, neutral = part.term.parameter_units(part.candidate.variant), part.term.neutral
    away = np.array([part.term.parameters[name] - neutral.get(name, part.term.parameters[name]) for name in names])
    moved = sensitivity_of(objective, fit)[:, first : first + len(away)] @ away
    return float(
        np.sqrt(objective.self_test_savings.get(part.candidate.effect, 0.0) / max(float(moved @ moved), 1e-300))
    )


def _possible(limits: tuple[float, float], value: float, physical: Range) -> tuple[float, float]:
    """Return the part of an interval within a real car's range; it always contains the value."""
    return min(value, max(limits[0], physical.lower)), max(value, min(limits[1], physical.upper))


def _limits_by_cost(
    objective: MarginalLikelihood, fit: Fit, k: int, name: str, rise: float, others: np.ndarray | None = None
) -> tuple[float, float]:
    """Return the interval of a parameter within which the cost rises by less than `rise`, within its range.

    For parameters in which the cost is not quadratic. Between two turns the data do not determine where a stretch ends.
    An axle that is nearly locked says how much slip there is at least, and not by how much a stiffer coupling would
    change it.

    Parameters
    ----------
    k : int
        Number of the part.
    others : ndarray, shape (R, Q), optional
        Sensitivity to other parameters, which follow the parameter linearly. Without it they keep their values.
    """
    part = fit.parts[k]
    limit, here = part.candidate.ranges[name], part.values[name]
    across = np.zeros((len(fit.residuals), 0)) if others is None else np.linalg.qr(others)[0]

    def cost_at(value: float) -> float:
        moved = Part(part.candidate, {**part.values, name: value})
        terms = [*fit.terms[:k], moved.term, *fit.terms[k + 1 :]]
        residuals = objective.whiten(objective.raw_residual(terms))
        return float(residuals @ residuals - np.sum((across.T @ residuals) ** 2))

    allowed = cost_at(here) + rise
    ends = []
    for end in (limit.lower, limit.upper):
        inside, outside = here, here
        step = limit.step
        while outside != end and cost_at(outside) <= allowed:
            inside = outside
            outside = max(end, outside - step) if end < here else min(end, outside + step)
            step *= 2.0
        if cost_at(outside) > allowed:
            while abs(outside - inside) > limit.step:
                middle = 0.5 * (inside + outside)
                inside, outside = (middle, outside) if cost_at(middle) <= allowed else (inside, middle)
        ends.append(float(outside))
    return ends[0], ends[1]
