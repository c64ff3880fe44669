"""Model-form error of a term: the share of its effect that a single track gets wrong, by operating point.

Physics that is put into a single track acts on two tyres instead of four, so a few hundredths of what it does are
wrong, and where it does much that is far more than noise. Of two terms that do nearly the same, the one that
happens to err less would win by it. With that share free, what decides is what they do differently.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.baseline.common import scaled_features
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.judge import Judge
from split_cli.diagnosis.search.fitting import Fit
from split_cli.vehicle.effects import Term

__all__ = ["costs_beside_misfit"]


def costs_beside_misfit(judge: Judge, fits: Sequence[Fit]) -> list[float]:
    """Return the cost of each fit with a share of every effect of them all free, by channel and operating point.

    What one of them might get wrong is free for the others too: else the one would win that can bend most.

    Notes
    -----
    M holds the whitened effects times functions of the operating point, times the policy's `misfit_share`; e are
    the entries left. The weights of M are integrated out: e^T (I + M M^T)^-1 e = |e|^2 - |L^-1 M^T e|^2 with
    L L^T = I + M^T M.
    """
    share = judge.policy.selection.misfit_share
    columns = [share * judge.whiten(_varied(judge, fit.terms, k)) for fit in fits for k in range(len(fit.parts))]
    if not columns:
        return [fit.cost for fit in fits]
    misfit = np.hstack(columns)
    normal = np.eye(misfit.shape[1]) + misfit.T @ misfit
    scores = misfit.T @ np.stack([fit.entries for fit in fits], axis=1)
    told = np.sum(scores * np.linalg.solve(normal, scores), axis=0)
    return [float(fit.entries @ fit.entries - one) for fit, one in zip(fits, told, strict=True)]


def _varied(judge: Judge, terms: tuple[Term, ...], k: int) -> np.ndarray:
    """Return what one term adds, channel by channel and times each function, as entries, shape (R, 18)."""
    others = terms[:k] + terms[k + 1 :]
    return judge.stack([one.whitener(_variations(one, terms, others)) for one in judge.evidence])


def _variations(one: Evidence, terms: Sequence[Term], others: Sequence[Term]) -> np.ndarray:
    """Return the defects that terms take off beyond others, varied, shape (N - 1, 3, 18)."""
    effect = one.left(others) - one.left(terms)
    functions = _functions(one)
    out = np.zeros((len(effect), 3, 3 * functions.shape[1]))
    for channel in range(3):
        columns = slice(channel * functions.shape[1], (channel + 1) * functions.shape[1])
        out[:, channel, columns] = effect[:, channel, None] * functions
    return out


def _functions(one: Evidence) -> np.ndarray:
    """Return 1, and slips, torque and speed within about [-1, 1], in the middle of each transition, (N - 1, 6)."""
    a, b, c, v = np.clip(scaled_features(one.series, one.vehicle), -1.5, 1.5).T
    out = np.stack([np.ones_like(a), a * a, b * b, c, np.abs(c), v], axis=1)
    return 0.5 * (out[1:] + out[:-1])
