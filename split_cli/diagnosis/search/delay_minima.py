"""Local minima of the cost over a delay, several of which may explain the data equally well.

With periodic steering, or with commands that are held for some time, different delays explain the response equally
well. Noise of a channel that is shifted in time has a minimum between any two samples, where interpolation averages it.
A fit ends in the minimum nearest to its start, so the whole range of a delay is evaluated. Minima of the equations of
motion that witnesses refute are left out.
"""

from collections.abc import Iterator

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.recording.series import key_of_terms
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, sensitivity_of
from split_cli.diagnosis.search.term_tests import error_of_sum

_APART = 0.0125  # evaluated delays [s]: judgement, a quarter of a period of 20 Hz; little is faster


def in_lowest_minima(objective: MarginalLikelihood, fit: Fit, least: float) -> Fit:
    """Return a fit in which each delay lies in its lowest minimum, the other parameters refitted.

    Parameters
    ----------
    objective : MarginalLikelihood
    fit : Fit
    least : float
        Cost that another minimum has to save to be taken [chi squared].
    """
    for k, name in _delays(fit):
        grid, more, refuted = _profile(objective, fit, k, name)
        beyond = np.where(refuted, np.inf, more.sum(axis=1))
        if beyond.min() < -least:
            values = {**fit.parts[k].values, name: float(grid[np.argmin(beyond)])}
            parts = (*fit.parts[:k], Part(fit.parts[k].candidate, values), *fit.parts[k + 1 :])
            deeper = fit_parts(objective, parts)
            fit = deeper if deeper.cost < fit.cost - least else fit
    return fit


def other_minima(objective: MarginalLikelihood, fit: Fit, k: int, name: str) -> list[float]:
    """Return delays at other minima of the cost that explain the data as well as the value of a fit's part.

    Parameters
    ----------
    objective : MarginalLikelihood
    fit : Fit
    k : int
        Number of the part.
    name : str
        Name of its parameter. If that is no transport delay, there are no other minima.

    Returns
    -------
    list of float
        Delays [s].

    Notes
    -----
    Two minima are non-nested models. If both are equally good, the difference of their costs is normal about zero, with
    a standard error estimated over blocks of time (Vuong, 1989).
    """
    if (k, name) not in _delays(fit):
        return []
    here = fit.parts[k].values[name]
    grid, more, refuted = _profile(objective, fit, k, name)
    cost = more.sum(axis=1)
    before, after = np.append(np.inf, cost[:-1]), np.append(cost[1:], np.inf)
    is_minimum = (cost < before) & (cost <= after) & (np.abs(grid - here) > grid[1] - grid[0]) & ~refuted
    return [float(grid[i]) for i in np.flatnonzero(is_minimum) if not _is_worse(objective, more[i])]


def _is_worse(objective: MarginalLikelihood, more: np.ndarray) -> bool:
    """Return whether a delay costs more beyond chance, from differences of cost by block, shape (B,)."""
    return float(more.sum()) >= objective.policy.selection.deviations * error_of_sum(more)


def _delays(fit: Fit) -> Iterator[tuple[int, str]]:
    """Yield part number and parameter name of all transport delays of a fit."""
    for k, part in enumerate(fit.parts):
        if part.term.moves_samples or getattr(part.term, "input_delays", None):
            yield from ((k, name) for name in part.values)


def _profile(objective: MarginalLikelihood, fit: Fit, k: int, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return delays over the range, (D,), their costs less the fit's, (D, B), and whether witnesses refute each, (D,).

    Costs are given by block of time. At each delay the other parameters are adjusted to first order. Witnesses are
    judged by themselves: variable model-form error in the equations of motion would hide what two instruments say.
    Results are cached, since the choice of a minimum and its interval both need them.
    """
    known = objective.memo.setdefault("profiles of delays", {})
    key = (objective.fixed_baseline, k, name, key_of_terms(fit.terms))
    if key not in known:
        known[key] = _profile_anew(objective, fit, k, name)
    return known[key]


def _profile_anew(
    objective: MarginalLikelihood, fit: Fit, k: int, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute `_profile`."""
    part = fit.parts[k]
    limit = part.candidate.ranges[name]
    own = sum(len(one.values) for one in fit.parts[:k]) + list(part.values).index(name)
    others = np.delete(sensitivity_of(objective, fit), own, axis=1)
    along = np.linalg.qr(others / (np.linalg.norm(others, axis=0) + 1e-300))[0]
    reference, seen = fit.residuals**2, objective.of_witnesses(fit.residuals) ** 2
    block = objective.block[len(objective.block) - len(seen) :]

    def compared(delay: float) -> tuple[np.ndarray, bool]:
        moved = Part(part.candidate, {**part.values, name: delay})
        residuals = objective.whiten(objective.raw_residual([*fit.terms[:k], moved.term, *fit.terms[k + 1 :]]))
        residuals = residuals - along @ (along.T @ residuals)
        by_witnesses = np.bincount(block, objective.of_witnesses(residuals) ** 2 - seen)
        refuted = len(seen) > 0 and _is_worse(objective, by_witnesses[np.unique(block)])
        return objective.block_sums(residuals**2 - reference), refuted

    grid = np.arange(limit.lower, limit.upper + 0.5 * _APART, _APART)
    more, refuted = zip(*(compared(float(delay)) for delay in grid), strict=True)
    return grid, np.stack(more), np.array(refuted)
