"""Values, standard errors and intervals of the parameters of an explanation."""

from __future__ import annotations

import numpy as np

from split_cli.diagnosis.fitting import Fit
from split_cli.diagnosis.judge import Judge
from split_cli.diagnosis.result import ParameterEstimate
from split_cli.diagnosis.selection import term_size

__all__ = ["parameter_estimates"]

# What a single track calls one thing and a car does as another: this share of the one-step noise, put wholly on
# one term, is the systematic error each parameter is given beside chance.
_SYSTEMATIC = 0.03


def parameter_estimates(judge: Judge, fit: Fit) -> tuple[dict[str, ParameterEstimate], ...]:
    """Return the parameters of every part.

    Notes
    -----
    The covariance is the sandwich (J^T J)^-1 (sum over blocks of s_b s_b^T) (J^T J)^-1, s_b a block's score: what
    a bootstrap over blocks converges to, with the simulation's uncertainty inside J. Systematic error is added.
    """
    from scipy.stats import t as student

    J = fit.sensitivity
    if not J.shape[1]:
        return ()
    scale = np.sqrt(np.sum(J**2, axis=0)) + 1e-300
    normal = np.linalg.pinv((J / scale).T @ (J / scale), rcond=1e-10)
    scores = judge.block_sums((J / scale) * fit.entries[:, None])
    blocks = len(scores)
    middle = scores.T @ scores * blocks / max(blocks - J.shape[1], 1)
    covariance = normal @ np.maximum(middle, 0.0) @ normal / np.outer(scale, scale)
    plain = np.diag(normal) / scale**2
    variance = np.maximum(np.diag(covariance), plain)
    wide = float(student.ppf(0.975, max(blocks - J.shape[1], 2)))
    out, column = [], 0
    for k, part in enumerate(fit.parts):
        size = term_size(judge, fit, k)
        term, entries = part.term, {}
        for name, unit in term.parameter_units(part.candidate.variant).items():
            value = term.parameters[name]
            away = value - term.neutral.get(name, value)
            systematic = abs(away) * _SYSTEMATIC / max(size, 1e-9)
            error = float(np.sqrt(variance[column] + systematic**2))
            limits = (value - wide * error, value + wide * error)
            if not np.isfinite(error):
                # No row says anything of it: an end of a stretch where nothing was driven.
                limit = part.candidate.ranges[name]
                error, limits = limit.upper - limit.lower, (limit.lower, limit.upper)
            entries[name] = ParameterEstimate(value, error, unit, limits)
            column += 1
        out.append(entries)
    return tuple(out)
