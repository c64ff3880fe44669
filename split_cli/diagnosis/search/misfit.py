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

__all__ = ["costs_beside_misfit", "entries_beside_misfit", "saved_beside_misfit"]


def costs_beside_misfit(judge: Judge, fits: Sequence[Fit]) -> list[float]:
    """Return the cost of each fit with a share of every effect of them all free, by channel and operating point.

    What one of them might get wrong is free for the others too: else the one would win that can bend most.

    Notes
    -----
    M holds the whitened effects times functions of the operating point, times the policy's `misfit_share`; e are
    the entries left. The weights of M are integrated out: e^T (I + M M^T)^-1 e = |e|^2 - |L^-1 M^T e|^2 with
    L L^T = I + M^T M.
    """
    misfit = _columns(judge, [(fit.terms, k) for fit in fits for k in range(len(fit.parts))])
    return _costs(misfit, [fit.entries for fit in fits])


def saved_beside_misfit(judge: Judge, before: Fit, after: Fit) -> float:
    """Return what an explanation saves against another, the other's terms free to be wrong by their share.

    What single-track terms get wrong of a real car's effect is of their own kind, channel by channel, and varies
    with the operating point. Evidence for a further term is what it saves beyond that.
    """
    misfit = _columns(judge, [(before.terms, k) for k in range(len(before.parts))])
    here, there = _costs(misfit, [before.entries, after.entries])
    return here - there


def entries_beside_misfit(judge: Judge, fit: Fit) -> np.ndarray:
    """Return the entries that an explanation leaves beyond the likeliest model-form error of its terms, (R,).

    Notes
    -----
    e - M (I + M^T M)^-1 M^T e, with M as in `costs_beside_misfit`.
    """
    misfit = _columns(judge, [(fit.terms, k) for k in range(len(fit.parts))])
    if not misfit.shape[1]:
        return fit.entries
    normal = np.eye(misfit.shape[1]) + misfit.T @ misfit
    return fit.entries - misfit @ np.linalg.solve(normal, misfit.T @ fit.entries)


def _columns(judge: Judge, parts: Sequence[tuple[tuple[Term, ...], int]]) -> np.ndarray:
    """Return M, shape (R, 18 a part), of parts given as terms and the number of one of them."""
    share = judge.policy.selection.misfit_share
    columns = [share * judge.whiten(_varied(judge, terms, k)) for terms, k in parts]
    return np.hstack(columns) if columns else np.empty((len(judge.weight), 0))


def _costs(misfit: np.ndarray, entries: Sequence[np.ndarray]) -> list[float]:
    if not misfit.shape[1]:
        return [float(one @ one) for one in entries]
    normal = np.eye(misfit.shape[1]) + misfit.T @ misfit
    scores = misfit.T @ np.stack(entries, axis=1)
    told = np.sum(scores * np.linalg.solve(normal, scores), axis=0)
    return [float(one @ one - part) for one, part in zip(entries, told, strict=True)]


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
