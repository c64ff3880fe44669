"""Constancy of a finding: whether its effect changes with side, slip, torque, speed, heat or time (a *bend*).

A term that is named in place of another effect would have to change with the variables that the other effect depends
on. The test has few degrees of freedom, so it detects what the flexible fit of the remainder does not.

A single track gets a share of an effect wrong, by operating point. That share does not depend on the side of the turn,
on time or on heat. A term that changes by more than this share leaves a part unexplained. One that changes by most of
its effect is not named. A part is also unexplained if a term's model-form error by operating point would have to be
larger than that of a single track.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import scaled_features
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.remainder.flexible import HEAT_SECONDS
from split_cli.diagnosis.remainder.structure import minimum_effect_p
from split_cli.diagnosis.search.fitting import Fit, Part, raw_slopes, sensitivity_of
from split_cli.diagnosis.search.form_error import form_error_columns
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.recording import first_order_response

_WAVES = 4  # half waves over a recording
_FREE = 1e6  # prior variance of the parameters' own changes, in units of noise: next to free


@dataclass(frozen=True)
class Bend:
    """How much the effect of a term would have to change with a variable."""

    term: str
    variable: str
    size: float  # change of the effect over the effect, rms on whitened rows [1]
    p_value: float  # of a change no larger than the model-form error of a term


def bends(
    objective: MarginalLikelihood, fit: Fit, named: Sequence[bool], variance_inflation: float
) -> tuple[Bend, ...]:
    """Return how the effects of named parts change with each variable, smallest p value first.

    Parameters
    ----------
    named : sequence of bool
        Of every part of the fit.

    Notes
    -----
    Let E be the first-order effect of a part and W the columns E f with the functions f of one variable. Let S = v I +
    A A^T be the covariance of noise, of the parts' own parameters (next to free) and of their model-form error by
    operating point. The change is W g with g = (W^T S^-1 W)^-1 W^T S^-1 e and the residuals e (generalised least
    squares). It saves e^T S^-1 W g, tested against a change by `form_error_share` of E, see `minimum_effect_p`.
    """
    if not any(named):
        return ()
    share = objective.policy.selection.form_error_share
    noise = max(variance_inflation, objective.form_error_inflation)
    slopes = raw_slopes(objective, fit.parts)
    own = objective.whiten(slopes)
    own = own / (np.linalg.norm(own, axis=0) + 1e-300)
    free = np.hstack([np.sqrt(_FREE) * own, form_error_columns(objective, fit) / np.sqrt(noise)])
    normal = np.eye(free.shape[1]) + free.T @ free

    def cleared(rows: np.ndarray) -> np.ndarray:
        return rows - free @ np.linalg.solve(normal, free.T @ rows)

    left, variables, out, first = cleared(fit.residuals), _variables(objective), [], 0
    for part, is_named in zip(fit.parts, named, strict=True):
        effect = slopes[:, first : first + len(part.values)] @ _steps_from_none(part)
        first += len(part.values)
        whole = objective.whiten(effect)
        if not is_named or not whole.any():
            continue
        for name, functions in variables.items():
            columns = objective.whiten(effect[:, None] * functions)
            if not columns.any():
                # A bias of an accelerometer changes witnesses alone.
                continue
            normal_of = columns.T @ cleared(columns)
            ridge = 1e-6 * np.trace(normal_of) * np.eye(len(normal_of))
            weights = np.linalg.solve(normal_of + ridge, columns.T @ left)
            saved, freedom = float(left @ (columns @ weights)), functions.shape[1]
            bent = columns @ weights
            bent -= whole * (whole @ bent) / (whole @ whole)
            # The part of the size that is fitted noise is removed.
            sure = max(1.0 - noise * freedom / max(saved, 1e-9), 0.0)
            size = float(np.linalg.norm(bent) / np.linalg.norm(whole) * np.sqrt(sure))
            p_value = minimum_effect_p(saved, freedom, size, noise, allowance=share)
            out.append(Bend(part.candidate.term, name, size, p_value))
    return tuple(sorted(out, key=lambda bend: bend.p_value))


def beyond_form_error(
    objective: MarginalLikelihood, fit: Fit, named: Sequence[bool], variance_inflation: float
) -> dict[str, float]:
    """Return, by named term, the p value of its estimated model-form error under the prior of a single track.

    An engine whose gain depends on the torque fits as a gain with a model-form error by torque. Such a fit leaves no
    residual, but the error would have to be larger than the prior allows.

    Parameters
    ----------
    named : sequence of bool
        Of every part of the fit.

    Notes
    -----
    Let M be that of `costs_beside_form_error` without the part that the parameters themselves can take up, and e the
    residuals, both over the root of the variance inflation. The most likely weights are w = (I + M^T M)^-1 M^T e. Under
    the prior they are N(0, C) with C = I - (I + M^T M)^-1. Then |M_k w_k|^2 of one term k is a sum of chi squared
    weighted by the eigenvalues of C_kk M_k^T M_k. Its distribution is approximated by two moments (Satterthwaite,
    1946). So a weight counts by its effect: an error of a lag in the longitudinal direction, where it does little,
    counts little.
    """
    from scipy.stats import chi2

    if not any(named):
        return {}
    noise = max(variance_inflation, objective.form_error_inflation)
    form_error, own = (
        form_error_columns(objective, fit) / np.sqrt(noise),
        _orthonormal(sensitivity_of(objective, fit)),
    )
    form_error = form_error - own @ (own.T @ form_error)
    products = form_error.T @ form_error
    normal = np.eye(len(products)) + products
    weights = np.linalg.solve(normal, form_error.T @ fit.residuals) / np.sqrt(noise)
    covariance = np.eye(len(products)) - np.linalg.inv(normal)
    out = {}
    for k, of_part in enumerate(np.split(np.arange(len(products)), len(fit.parts))):
        if named[k]:
            at = np.ix_(of_part, of_part)
            spread = covariance[at] @ products[at]
            mean, square = float(np.trace(spread)), float(np.sum(spread * spread.T))
            energy = float(weights[of_part] @ products[at] @ weights[of_part])
            measurable = mean > 0.0
            p_value = float(chi2.sf(energy * mean / square, mean**2 / square)) if measurable else 1.0
            out[fit.parts[k].candidate.term] = p_value
    return out


def _steps_from_none(part: Part) -> np.ndarray:
    """Return the distance of each parameter from neutral in steps, shape (P,); 0 for one without a neutral value."""
    neutral, ranges = CATALOGUE[part.candidate.term].neutral, part.candidate.ranges
    return np.array(
        [
            0.0 if neutral.get(name) is None else (value - neutral[name]) / ranges[name].step
            for name, value in part.values.items()
        ]
    )


def _variables(objective: MarginalLikelihood) -> dict[str, np.ndarray]:
    """Return functions of each variable on the objective's entries, shape (R, F), about within [-1, 1]."""
    tables = [_variables_of(one) for one in objective.evidence]
    extra = sum(len(one.begin) for one in objective.kinematics)
    out = {}
    for name in tables[0]:
        rows = [np.repeat(t[name][keep], 3, axis=0) for t, keep in zip(tables, objective.keep, strict=True)]
        out[name] = np.concatenate([*rows, np.zeros((extra, tables[0][name].shape[1]))])
    return out


def _variables_of(one: Evidence) -> dict[str, np.ndarray]:
    """Return functions of each variable on the rows of a recording, shape (G, F), about within [-1, 1]."""
    series = one.series
    a, b, torque, speed = scaled_features(series, one.vehicle).T
    share = series.t / max(float(series.t[-1]), 1e-9)
    powers = {"sliding": a * a + b * b, "work": np.abs(torque) * speed, "braking": np.maximum(-torque, 0.0) * speed}

    def heats(power: np.ndarray) -> np.ndarray:
        warm = [first_order_response(power, 1.0 / tau, series.recording) for tau in HEAT_SECONDS]
        return np.stack([one / max(float(np.quantile(np.abs(one), 0.98)), 1e-9) for one in warm], axis=1)

    functions = {
        "front slip": np.stack([np.abs(a), a * a], axis=1),
        "rear slip": np.stack([np.abs(b), b * b], axis=1),
        "torque": np.stack([torque, np.abs(torque)], axis=1),
        "speed": speed[:, None],
        "the side of the turn": np.sign(series.smooth[:, 2])[:, None],
        "time": np.cos(np.pi * share[:, None] * np.arange(1, _WAVES + 1)),
        **{f"heat of {name}": heats(power) for name, power in powers.items()},
    }
    return {name: np.clip(values, -1.5, 1.5)[one.at] for name, values in functions.items()}


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    left, size, _ = np.linalg.svd(columns / scale, full_matrices=False)
    return left[:, size > 1e-4 * max(float(size.max(initial=0.0)), 1e-12)]
