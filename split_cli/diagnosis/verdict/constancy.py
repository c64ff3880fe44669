"""Whether a finding's parameters stay constant over side, slip, torque, speed, heat and time.

A term of the catalogue that stands in for something else has to bend: its parameter drifts with what the something
depends on. Few parameters are tested, so the test sees what a flexible fit of the remainder loses in its freedom.

A single track is wrong about a term by operating point, by a share of what the term does. It is not by the side of
the turn, by time, or by how hot what slides, brakes or works has become. A term that bends with any of these by
more than it may be wrong is not all that acts; one that bends by the greater part of itself is another. Nor is one
all that acts whose model-form error by operating point would have to be larger than a single track's ever is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import scaled_features
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.remainder.structure import minimum_effect_p
from split_cli.diagnosis.search.fitting import Fit, Part, raw_slopes, sensitivity_of
from split_cli.diagnosis.search.form_error import form_error_columns
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.recording import first_order_response

_WAVES = 4  # half waves over a recording
_HEAT_SECONDS = (2.0, 6.0, 20.0)  # in which something heats and cools, those of the flexible fit's memory
_FREE = 1e6  # variance of what the parameters themselves may take, in units of what noise leaves


@dataclass(frozen=True)
class Bend:
    """How much of what one term does has to change with something that its parameters do not depend on."""

    term: str
    variable: str
    size: float  # what changes over what the term does, root mean square on whitened rows [1]
    p_value: float  # of a change no larger than what a single track gets wrong of a term


def bends(
    objective: MarginalLikelihood, fit: Fit, named: Sequence[bool], variance_inflation: float
) -> tuple[Bend, ...]:
    """Return how named parts bend with operating point, side of the turn, time, and heat, surest first.

    Parameters
    ----------
    named : sequence of bool, length of the parts

    Notes
    -----
    With E what a part does to first order, W the columns E f of the functions f of one variable, and S the
    covariance v I + A A^T of noise, of the parts' own parameters (next to free) and of their model-form error by
    operating point, the bend is W g with g = (W^T S^-1 W)^-1 W^T S^-1 e, e the residuals. It saves e^T S^-1 W g,
    tested against a bend of `form_error_share` of E, see `minimum_effect_p`.
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
                # A bias of an accelerometer moves what witnesses it and no velocity.
                continue
            normal_of = columns.T @ cleared(columns)
            ridge = 1e-6 * np.trace(normal_of) * np.eye(len(normal_of))
            weights = np.linalg.solve(normal_of + ridge, columns.T @ left)
            saved, freedom = float(left @ (columns @ weights)), functions.shape[1]
            bent = columns @ weights
            bent -= whole * (whole @ bent) / (whole @ whole)
            # What a fit makes of noise is no bend.
            sure = max(1.0 - noise * freedom / max(saved, 1e-9), 0.0)
            size = float(np.linalg.norm(bent) / np.linalg.norm(whole) * np.sqrt(sure))
            p_value = minimum_effect_p(saved, freedom, size, noise, allowance=share)
            out.append(Bend(part.candidate.term, name, size, p_value))
    return tuple(sorted(out, key=lambda bend: bend.p_value))


def beyond_form_error(
    objective: MarginalLikelihood, fit: Fit, named: Sequence[bool], variance_inflation: float
) -> dict[str, float]:
    """Return p values of named terms' model-form errors, by the term: of errors no larger than a single track's.

    An engine whose torque bends is a gain with an error by torque. Where that error is free to take what it likes,
    it leaves nothing; it is the size it would need that tells.

    Parameters
    ----------
    named : sequence of bool, length of the parts

    Notes
    -----
    With M as in `costs_beside_form_error`, less what the parameters themselves take of it, and e the residuals,
    both over the root of what noise is widened by, the likeliest weights are w = (I + M^T M)^-1 M^T e. They are a
    draw of N(0, C), C = I - (I + M^T M)^-1, where the prior holds. What they make of one term's effect is
    |M_k w_k|^2: a sum of chi squared weighted by the eigenvalues of C_kk M_k^T M_k, of which two moments are
    matched (Satterthwaite, 1946). So a weight counts by what it does. A lag does next to nothing along the car,
    and its error there may be any share of that.
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
    """Return how many steps the parameters are from no effect, 0 for those that no effect leaves open."""
    neutral, ranges = CATALOGUE[part.candidate.term].neutral, part.candidate.ranges
    return np.array(
        [
            0.0 if neutral.get(name) is None else (value - neutral[name]) / ranges[name].step
            for name, value in part.values.items()
        ]
    )


def _variables(objective: MarginalLikelihood) -> dict[str, np.ndarray]:
    """Return functions (R, F) of what a term may bend with, about within [-1, 1], by the variable."""
    tables = [_variables_of(one) for one in objective.evidence]
    extra = sum(len(one.begin) for one in objective.kinematics)
    out = {}
    for name in tables[0]:
        rows = [np.repeat(t[name][keep], 3, axis=0) for t, keep in zip(tables, objective.keep, strict=True)]
        out[name] = np.concatenate([*rows, np.zeros((extra, tables[0][name].shape[1]))])
    return out


def _variables_of(one: Evidence) -> dict[str, np.ndarray]:
    series = one.series
    a, b, torque, speed = scaled_features(series, one.vehicle).T
    share = series.t / max(float(series.t[-1]), 1e-9)
    powers = {"sliding": a * a + b * b, "work": np.abs(torque) * speed, "braking": np.maximum(-torque, 0.0) * speed}

    def heats(power: np.ndarray) -> np.ndarray:
        warm = [first_order_response(power, 1.0 / tau, series.recording) for tau in _HEAT_SECONDS]
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
