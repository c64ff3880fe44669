"""Model-form error of terms: a share of each effect that a single-track model gets wrong, by operating point.

A term in a single track acts on two tyres instead of four, so that some percent of its effect are wrong. Of a large
effect that is far more than noise. Of two similar terms the one with the smaller error would win. Here that share is a
random effect with a normal prior, so that the rest of the difference decides.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from split_cli.diagnosis.baseline.body import alters_body
from split_cli.diagnosis.baseline.discrepancy import scaled_features
from split_cli.diagnosis.innovations.evidence import Evidence, integrated
from split_cli.diagnosis.innovations.objective import MarginalLikelihood, alters_inputs
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, sensitivity_of
from split_cli.vehicle.effects import Term
from split_cli.vehicle.parameters import Vehicle

_ROWS_AT_A_TIME = 512  # rows of all parts' columns that are whitened at a time [1]; affects memory alone
_DISCREPANCY = "varied discrepancy"  # key of the objective's cache: columns of the shared discrepancy
_ASKED = "asked beside"  # key of the objective's cache: `_FormError` of the last explanation


@dataclass(frozen=True)
class _FormError:
    """Columns of the model-form error of one explanation, cached for comparisons with many further terms."""

    fit: Fit
    basis: np.ndarray  # `basis` of the objective, to recognise it
    columns: np.ndarray  # (R, Q): M as in `costs_beside_form_error`, with those of the shared discrepancy last
    own: int  # number of columns of the explanation's terms
    laws: np.ndarray  # (R, V): `_other_load_laws`

    @cached_property
    def normal(self) -> np.ndarray:
        """I + M^T M, shape (Q, Q)."""
        return _normal(self.columns)


def forget_form_error(objective: MarginalLikelihood) -> None:
    """Drop the cached columns of the last explanation, which are as large as a sensitivity."""
    objective.memo.pop(_ASKED, None)


def _form_error_of(objective: MarginalLikelihood, fit: Fit) -> _FormError:
    """Return the model-form error of an explanation, from the cache if it is that of the last call."""
    known = objective.memo.get(_ASKED)
    if known is None or known.fit is not fit or known.basis is not objective.basis:
        forget_form_error(objective)  # first, since both may be large
        laws = _other_load_laws(objective, fit)
        shared = _columns_of_discrepancy(objective, fit.terms)
        columns = columns_of_parts(objective, _of_the_car(fit)) if laws.shape[1] or shared.shape[1] else shared
        own = columns.shape[1]
        if shared.shape[1]:
            columns = np.hstack([columns, shared])
        known = objective.memo[_ASKED] = _FormError(fit, objective.basis, columns, own, laws)
    return known


def saved_in_place_of(objective: MarginalLikelihood, before: Fit, after: Fit, variance_inflation: float) -> float:
    """Return by how much less an explanation costs than another one beside model-form error [chi squared].

    It is the smaller of two savings over the variance inflation. In the first, errors of both explanations are allowed
    for both (`costs_beside_form_error`): an error that happens to resemble the difference decides nothing. In the
    second, each has its own and pays for it (`marginal_cost`): a large effect may get so much wrong that it could
    explain anything.
    """
    there, here = costs_beside_form_error(objective, [before, after])
    own = marginal_cost(objective, before, variance_inflation) - marginal_cost(objective, after, variance_inflation)
    return min((there - here) / variance_inflation, own)


def costs_beside_form_error(objective: MarginalLikelihood, fits: Sequence[Fit]) -> list[float]:
    """Return the cost of each fit beside the model-form errors of all of them, allowed for all [chi squared].

    Notes
    -----
    M has the whitened effects times functions of the operating point, times the policy's `form_error_share`. Its
    weights have standard normal priors and are integrated out: with the residuals e the cost is e^T (I + M M^T)^-1 e =
    |e|^2 - |L^-1 M^T e|^2, L L^T = I + M^T M.
    """
    parts = [(fit.terms, k) for fit in fits for k in range(len(fit.parts))]
    return _costs_beside(objective, parts, [fit.residuals for fit in fits])[0]


def marginal_cost(objective: MarginalLikelihood, fit: Fit, variance_inflation: float) -> float:
    """Return twice the negative logarithm of a fit's marginal likelihood beside its own model-form error.

    A constant is left out that all fits of an objective have. Sensor faults have no model-form error.

    Notes
    -----
    With the variance inflation v and M as in `costs_beside_form_error`, e has the covariance v (I + M M^T). So the cost
    is e^T (I + M M^T)^-1 e / v + ln det(I + M M^T), where the determinant is that of I + M^T M (Rasmussen and Williams,
    2006, equation 2.30).
    """
    (cost,), price = _costs_beside(objective, _of_the_car(fit), [fit.residuals])
    return cost / variance_inflation + price


def _of_the_car(fit: Fit) -> list[tuple[tuple[Term, ...], int]]:
    """Return the terms of a fit and the number of each that is no sensor fault: these have model-form error."""
    return [(fit.terms, k) for k, term in enumerate(fit.terms) if term.exported]


def _costs_beside(
    objective: MarginalLikelihood, parts: Sequence[tuple[tuple[Term, ...], int]], rows: Sequence[np.ndarray]
) -> tuple[list[float], float]:
    """Return the costs of rows, (R,) each, beside the model-form errors of parts, and ln det(I + M M^T).

    Parts are given as terms and number.
    """
    if not parts:
        return [float(one @ one) for one in rows], 0.0
    residuals = np.stack(rows, axis=1)
    normal, scores = _products(objective, parts, residuals)
    normal += np.eye(len(normal))
    explained = np.sum(scores * np.linalg.solve(normal, scores), axis=0)
    costs = [float(one @ one - part) for one, part in zip(residuals.T, explained, strict=True)]
    return costs, float(np.linalg.slogdet(normal)[1])


def _products(
    objective: MarginalLikelihood, parts: Sequence[tuple[tuple[Term, ...], int]], residuals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return M^T M and M^T e of whitened residuals e (R, K), summed over stretches of time to save memory.

    Parameters
    ----------
    parts : sequence
        As for `columns_of_parts`, which would return M, shape (R, Q).

    Notes
    -----
    Let X be the rows before `MarginalLikelihood.whiten`, which multiplies by W = I - V D V^T, with W^2 = I - V V^T.
    Then M^T M = X^T X - (V^T X)^T (V^T X) and M^T e = X^T e - (V^T X)^T D V^T e, times the policy's share.
    """
    count, basis = 18 * len(parts), objective.basis
    share = np.repeat([share_of_error(objective, terms[k]) for terms, k in parts], 18)
    normal, scores = np.zeros((count, count)), np.zeros((count, residuals.shape[1]))
    seen, end = np.zeros((basis.shape[1], count)), 0
    for one, keep in zip(objective.evidence, objective.keep, strict=True):
        left, functions = _left_by_all(one, parts), _functions(one)
        effects = [_effect(one, terms, k, left[id(terms)]) for terms, k in parts]
        estimate = np.zeros((6, count))
        for at, rows, whitener in one.whitener.stretches(_ROWS_AT_A_TIME):
            varied = [_varied_by(one, effect[at], by_axle, functions[at]) for effect, by_axle in effects]
            x = whitener(np.concatenate(varied, axis=2), estimate)[keep[rows]].reshape(-1, count)
            here = slice(end, end + len(x))
            x *= share * objective.weight[here, None]
            normal += x.T @ x
            scores += x.T @ residuals[here]
            seen += basis[here].T @ x
            end = here.stop
    return normal - seen.T @ seen, scores - seen.T @ (objective.root[:, None] * (basis.T @ residuals))


def share_of_error(objective: MarginalLikelihood, term: Term) -> float:
    """Return the model-form error of a term over its size: that of any term, or what is known of its kind [1]."""
    return max(objective.policy.selection.form_error_share, term.form_error)


def saved_beside_form_error(objective: MarginalLikelihood, before: Fit, after: Fit, *, shared: bool = True) -> float:
    """Return the saving of an explanation against another, beside the model-form error of the other's terms.

    The error of an effect is proportional to the effect and depends on the operating point. It is independent for each
    axle if the term acts on tyres or changes their forces, else for each channel. The shared discrepancy has such an
    error too. A load law between the variants of a term is allowed as well. What a further term saves beyond is
    evidence for it.

    Sensor faults have no such error. If the other explanation has them alone, all that a term of the car saves is
    evidence: after the sensors are corrected, the model has its usual error.

    Parameters
    ----------
    shared : bool
        Whether an error of the shared discrepancy is allowed for.

    Notes
    -----
    With P = (I + M M^T)^-1 as in `costs_beside_form_error` and the columns V of `_other_load_laws`, each cost is the
    minimum of (e - V u)^T P (e - V u) over u from 0 (the chosen variant) to 1 (another one).
    """
    here, there = costs_of_rows(objective, before, [before.residuals, after.residuals], shared=shared)
    return here - there


def costs_of_rows(
    objective: MarginalLikelihood, before: Fit, rows: Sequence[np.ndarray], *, shared: bool = True
) -> list[float]:
    """Return the costs of rows, (R,) each, beside the model-form error of an explanation, see above."""
    if before.parts and not any(term.exported for term in before.terms):
        return [float(one @ one) for one in rows]
    wrong = _form_error_of(objective, before)
    laws = wrong.laws
    if not wrong.columns.shape[1]:
        return _costs_beside(objective, _of_the_car(before), rows)[0]
    count = wrong.columns.shape[1] if shared else wrong.own
    columns, normal = wrong.columns[:, :count], wrong.normal[:count, :count]
    costs = _costs(columns, normal, rows)
    if not laws.shape[1]:
        return costs
    low = np.zeros(laws.shape[1])
    return [cost - _bounded_fit(columns, normal, laws, one, low)[1] for cost, one in zip(costs, rows, strict=True)]


def moved_between_load_laws(objective: MarginalLikelihood, fit: Fit, *, recorded: bool = True) -> np.ndarray:
    """Return the change of a fit's parameters, shape (P,), with the best load law between the variants.

    The mass that explains a drive depends on how much more force its tyres carry, for example. Zeros if no term loads
    the tyres.

    Parameters
    ----------
    recorded : bool
        Whether the recording has these effects, so that other variants can be fitted to it.

    Notes
    -----
    The minimum of (e + J x - V u)^T P (e + J x - V u), as in `saved_beside_form_error`, with the sensitivity J. This is
    a linearisation, and V grows with the term. With a law by which the term has (1 + c) times the effect, its size is
    1/(1 + c) of what it was, while the linearisation gives 1 - c; `divided_out` corrects that. If the linear change
    leads beyond a car's range, the other variants are fitted instead.
    """
    laws, slopes = _other_load_laws(objective, fit), sensitivity_of(objective, fit)
    if not laws.shape[1]:
        return np.zeros(slopes.shape[1])
    effect = np.linalg.norm(slopes, axis=0)
    scale = np.where(effect > 0.0, effect, np.inf)  # parameters without effect do not change
    low = np.repeat([-np.inf, 0.0], [slopes.shape[1], laws.shape[1]])
    columns = np.hstack([-slopes / scale, laws])
    form_error = form_error_columns(objective, fit)
    found, _ = _bounded_fit(form_error, _normal(form_error), columns, fit.residuals, low)
    moved, first = found[: len(scale)] / scale, 0
    for part in fit.parts:
        own = slice(first, first + len(part.values))
        if part.term.loads_tires:
            neutral = part.term.neutral
            away = np.array([value - neutral.get(name, value) for name, value in part.values.items()])
            moved[own] = divided_out(moved[own], away, slopes[:, own])
        first = own.stop
    values = np.array([value for part in fit.parts for value in part.values.values()])
    ranges = [part.candidate.ranges[name] for part in fit.parts for name in part.values]
    inside = [one.lower <= value <= one.upper for one, value in zip(ranges, values + moved[: len(values)], strict=True)]
    return _moved_by_refits(objective, fit, values) if recorded and not all(inside) else moved


def _moved_by_refits(objective: MarginalLikelihood, fit: Fit, values: np.ndarray) -> np.ndarray:
    """Return the change of parameters, shape (P,), in the refit with another load law that costs least."""
    fits = [
        fit_parts(
            objective,
            (*fit.parts[:k], Part(replace(part.candidate, variant=variant), part.values), *fit.parts[k + 1 :]),
            slopes_of=fit,
        )
        for k, part in enumerate(fit.parts)
        for variant in (type(part.term).laws(part.candidate.variant) if part.term.loads_tires else ())
    ]
    best = min(fits, key=lambda one: one.cost)
    return np.array([value for part in best.parts for value in part.values.values()]) - values


def divided_out(moved: np.ndarray, away: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Return the change of parameters, (P,), corrected for the nonlinearity of a load law that increases the effect.

    Parameters
    ----------
    moved : ndarray, shape (P,)
        Change to first order.
    away : ndarray, shape (P,)
        Parameters less their neutral values.
    slopes : ndarray, shape (R, P)
        Derivatives of the residuals with respect to the parameters.

    Notes
    -----
    The share of the effect that the first-order change removes, by least squares on the rows, is -c of 1/(1 + c). So a
    load law changes neither the sign of an effect nor makes it vanish.
    """
    effect = slopes @ away
    share = float(effect @ (slopes @ moved)) / max(float(effect @ effect), 1e-300)
    return moved + (share / (1.0 - share) - share) * away if share < 0.0 else moved


def _bounded_fit(
    form_error: np.ndarray, normal: np.ndarray, columns: np.ndarray, residuals: np.ndarray, low: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return weights of columns beside model-form error, within bounds, and the cost that they save.

    Weights with the lower bound 0 have the upper bound 1; others are free.

    Notes
    -----
    The minimum of |e - M w - V u|^2 + |w|^2, with w = (I + M^T M)^-1 M^T (e - V u). So u is fitted to the stacked rows
    of e - M w and w by their QR factor. V^T P V would square the condition number, and has no Cholesky factor if a
    column is zero, as that of brakes that were not used.
    """
    count, both = columns.shape[1], np.column_stack([columns, residuals])
    weights = np.linalg.solve(normal, form_error.T @ both)
    beside = np.linalg.qr(np.vstack([both - form_error @ weights, weights]), mode="r")[:count]
    small = np.sqrt(1e-9) * np.diag(np.linalg.norm(beside[:, :count], axis=0))
    root, target = np.vstack([beside[:, :count], small]), np.concatenate([beside[:, count], np.zeros(count)])
    found = lsq_linear(root, target, (low, np.where(np.isinf(low), np.inf, 1.0)))
    return found.x, float(target @ target) - 2.0 * float(found.cost)


def residuals_beside_form_error(objective: MarginalLikelihood, fit: Fit, rows: np.ndarray | None = None) -> np.ndarray:
    """Return residuals less the most likely model-form error of an explanation's terms, shape (R,) or (R, K).

    Parameters
    ----------
    rows : ndarray, shape (R,) or (R, K), optional
        The residuals; by default those of the explanation.

    Notes
    -----
    e - M (I + M^T M)^-1 M^T e, with M as in `costs_beside_form_error`.
    """
    left = fit.residuals if rows is None else rows
    form_error = form_error_columns(objective, fit)
    if not form_error.shape[1]:
        return left
    return left - form_error @ _likeliest_weights(form_error, left)


def _likeliest_weights(form_error: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Return (I + M^T M)^-1 M^T of residuals (R,) or (R, K): the most likely weights of M."""
    return np.linalg.solve(_normal(form_error), form_error.T @ left)


def _normal(form_error: np.ndarray) -> np.ndarray:
    """Return I + M^T M, shape (Q, Q)."""
    return np.eye(form_error.shape[1]) + form_error.T @ form_error


def form_error_columns(objective: MarginalLikelihood, fit: Fit) -> np.ndarray:
    """Return M of an explanation's parts, shape (R, 18 a part), see `costs_beside_form_error`."""
    return columns_of_parts(objective, [(fit.terms, k) for k in range(len(fit.parts))])


def free_to_form_error(objective: MarginalLikelihood, fit: Fit, *, together: bool = True) -> np.ndarray:
    """Return N, (R, 18 a part of the car), with N N^T = I - (I + M M^T)^-1, see `costs_beside_form_error`.

    Parameters
    ----------
    together : bool
        Whether terms that scale the tyres' curves have one common error of their joint effect. Otherwise each has an
        error of its own, to compare them with each other.
    """
    form_error = columns_of_parts(objective, _of_the_car(fit), together=together)
    lower = np.linalg.cholesky(_normal(form_error))
    return solve_triangular(lower, form_error.T, lower=True, overwrite_b=True).T


def _other_load_laws(objective: MarginalLikelihood, fit: Fit) -> np.ndarray:
    """Return the change of residuals if terms that load tyres had another variant, at the same values, (R, V)."""
    here, columns = objective.raw_residual(fit.terms), []
    for k, term in enumerate(fit.terms):
        for variant in type(term).laws(term.variant) if term.loads_tires else ():
            other = type(term)(term.parameters, variant)
            columns.append(here - objective.raw_residual((*fit.terms[:k], other, *fit.terms[k + 1 :])))
    if not columns:
        return np.empty((len(here), 0))
    columns = objective.whiten(np.stack(columns, axis=1))
    return columns[:, np.linalg.norm(columns, axis=0) > 0.0]


def columns_of_parts(
    objective: MarginalLikelihood, parts: Sequence[tuple[tuple[Term, ...], int]], *, together: bool = True
) -> np.ndarray:
    """Return M, shape (R, 18 a part), of parts; each is given as a list of terms and a number in it."""
    out = np.empty((len(objective.weight), 18 * len(parts)))
    left = [_left_by_all(one, parts) for one in objective.evidence]
    for own, (terms, k) in zip(np.split(out, max(len(parts), 1), axis=1), parts, strict=False):
        varied = _varied(objective, terms, k, [several[id(terms)] for several in left], together=together)
        np.multiply(share_of_error(objective, terms[k]), objective.whiten(varied), out=own)
    return out


def _columns_of_discrepancy(objective: MarginalLikelihood, terms: tuple[Term, ...]) -> np.ndarray:
    """Return M of the shared discrepancy beside terms, shape (R, 18) or (R, 36); without columns if nothing is shared.

    The first columns are the discrepancy's own error, a share that the self-test measures. The others are the error of
    its change by the terms, which is computed to first order.
    """
    if objective.posterior is None:
        return np.empty((len(objective.weight), 0))
    own = objective.shared_error * varied_discrepancy(objective)
    changes = [objective.change_by(one, terms) for one in objective.evidence]
    if not any(one.any() for one in changes):
        return own
    share = objective.policy.selection.form_error_share
    return np.hstack([own, share * objective.whiten(_varied_rates(objective, changes))])


def varied_discrepancy(objective: MarginalLikelihood) -> np.ndarray:
    """Return the shared discrepancy split by force and times each of six functions, whitened, shape (R, 18)."""
    # The memo is shared with the objective of a fixed baseline, which whitens otherwise.
    if _DISCREPANCY not in objective.memo:
        weights = objective.posterior.weights
        rates = [objective.discrepancy.rates(one.series, weights) for one in objective.evidence]
        objective.memo[_DISCREPANCY] = _varied_rates(objective, rates)
    return objective.whiten(objective.memo[_DISCREPANCY])


def _varied_rates(objective: MarginalLikelihood, rates: Sequence[np.ndarray]) -> np.ndarray:
    """Return rates of each recording, (N, 3) each, by force and times six functions, before `whiten`, (R, 18)."""
    rows = []
    for one, some in zip(objective.evidence, rates, strict=True):
        shared = integrated(one.series, some, one.linear)
        rows.append(one.whitener(_varied_by(one, shared, True, _functions(one))))
    return objective.stack(rows)


def _costs(form_error: np.ndarray, normal: np.ndarray, residuals: Sequence[np.ndarray]) -> list[float]:
    """Return the costs of residuals, (R,) each, beside M, with I + M^T M given as `normal`."""
    scores = form_error.T @ np.stack(residuals, axis=1)
    explained = np.sum(scores * np.linalg.solve(normal, scores), axis=0)
    return [float(one @ one - part) for one, part in zip(residuals, explained, strict=True)]


def _varied(
    objective: MarginalLikelihood,
    terms: tuple[Term, ...],
    k: int,
    left: Sequence[np.ndarray] = (),
    *,
    together: bool = True,
) -> np.ndarray:
    """Return the effect of term k, split in three and times each of six functions, before `whiten`, shape (R, 18).

    `left` are the defects that all terms leave of each recording, if known.
    """
    left = left or [one.defects(terms) for one in objective.evidence]
    return objective.stack(
        [
            one.whitener(_varied_by(one, *_effect(one, terms, k, own, together=together), _functions(one)))
            for one, own in zip(objective.evidence, left, strict=True)
        ]
    )


def _left_by_all(one: Evidence, parts: Sequence[tuple[tuple[Term, ...], int]]) -> dict[int, np.ndarray]:
    """Return the defects that each list of terms leaves, (N - 1, 3), by the id of the list."""
    return {number: one.defects(terms) for number, terms in {id(terms): terms for terms, _ in parts}.items()}


def _effect(
    one: Evidence, terms: tuple[Term, ...], k: int, left: np.ndarray, *, together: bool = True
) -> tuple[np.ndarray, bool]:
    """Return the defects that term k explains beside the others, (N - 1, 3), and whether its error is by axle.

    Terms that scale the tyres' curves may nearly cancel. If `together`, the first of them gets their joint effect and
    the others none.
    """
    several = together and terms[k].scales_curve
    alike = [number for number, term in enumerate(terms) if term.scales_curve] if several else [k]
    others = tuple(term for number, term in enumerate(terms) if number not in alike)
    # A heavier car needs larger tyre forces, so terms of the body have the error of the tyres too.
    by_axle = (terms[k].through_tires or alters_body(terms[k])) and not alters_inputs(terms[k])
    if k != alike[0]:
        return np.zeros_like(left), by_axle
    return one.defects(others) - left, by_axle


def _varied_by(one: Evidence, effect: np.ndarray, by_axle: bool, functions: np.ndarray) -> np.ndarray:
    """Return an effect (N - 1, 3), split by force or channel, times each of six functions, (N - 1, 3, 18)."""
    pieces = _by_force(effect, one.vehicle) if by_axle else effect[:, :, None] * np.eye(3)
    return (pieces[:, :, :, None] * functions[:, None, None, :]).reshape(len(effect), 3, -1)


def _by_force(effect: np.ndarray, vehicle: Vehicle) -> np.ndarray:
    """Return the parts of an effect (N, 3) by longitudinal, front lateral and rear lateral force, shape (N, 3, 3).

    The yaw moment is a small difference of two large ones, to which the error of either axle contributes in full.
    """
    matrix = vehicle.force_matrix()
    return (effect @ np.linalg.inv(matrix).T)[:, None, :] * matrix


def _functions(one: Evidence) -> np.ndarray:
    """Return 1, a^2, b^2, c, |c| and v in the middle of each transition, shape (N - 1, 6).

    These are front and rear slip angle, torque and speed, scaled to about [-1, 1].
    """
    a, b, c, v = np.clip(scaled_features(one.series, one.vehicle), -1.5, 1.5).T
    out = np.stack([np.ones_like(a), a * a, b * b, c, np.abs(c), v], axis=1)
    return 0.5 * (out[1:] + out[:-1])
