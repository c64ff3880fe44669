"""Valleys of the cost over a delay: a fit ends in the one where it began, and several may explain as well.

A driver who steers to and fro is answered alike by a car that is late by less and one that is late by more. So is
a command that is held for some time. Noise of a channel that is moved in time has a valley between any two
samples, where it is averaged. So the whole range is looked at. Where witnesses tell when a channel was read, a
valley of the equations of motion that they refute is none.
"""

from collections.abc import Iterator

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.recording.series import key_of_terms
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, sensitivity_of
from split_cli.diagnosis.search.term_tests import error_of_sum

_POINTS = 48  # at which a delay's range is looked at; 13 ms apart


def in_lowest_minima(objective: MarginalLikelihood, fit: Fit, least: float) -> Fit:
    """Return a fit whose delays lie in the lowest valley each, the others beside them.

    Parameters
    ----------
    objective : MarginalLikelihood
    fit : Fit
    least : float
        What another valley has to save [chi squared] to be taken.
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
    """Return delays in other valleys of the cost that explain as well as the one of a fit's part.

    Parameters
    ----------
    objective : MarginalLikelihood
    fit : Fit
    k : int
        Number of the part.
    name : str
        Of its parameter; of anything but a transport delay there are no others.

    Returns
    -------
    list of float
        Delays [s].

    Notes
    -----
    Two valleys are two models of which neither holds the other. What one saves against the other is normal about
    zero where both are as good, with the standard error of differences block by block (Vuong, 1989).
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
    """Return whether a delay costs more beyond chance, by what it costs more block by block, shape (B,)."""
    return float(more.sum()) >= objective.policy.selection.deviations * error_of_sum(more)


def _delays(fit: Fit) -> Iterator[tuple[int, str]]:
    """Yield number and parameter of the parts of a fit that are transport delays."""
    for k, part in enumerate(fit.parts):
        if part.term.moves_samples or getattr(part.term, "input_delays", None):
            yield from ((k, name) for name in part.values)


def _profile(objective: MarginalLikelihood, fit: Fit, k: int, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return delays all over the range, (D,), what each costs more, (D, B), and whether witnesses refute it, (D,).

    Costs are those block by block, less those of the fit. At each delay the other parameters take what is best to
    first order. Witnesses alone refute what the equations of motion find as good: model-form error differs from
    block to block, and would drown what two instruments say. What was asked for a choice is known for an interval.
    """
    known = objective.memo.setdefault("profiles of delays", {})
    key = (objective.fixed_baseline, k, name, key_of_terms(fit.terms))
    if key not in known:
        known[key] = _profile_anew(objective, fit, k, name)
    return known[key]


def _profile_anew(
    objective: MarginalLikelihood, fit: Fit, k: int, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    part = fit.parts[k]
    limit = part.candidate.ranges[name]
    own = sum(len(one.values) for one in fit.parts[:k]) + list(part.values).index(name)
    others = np.delete(sensitivity_of(objective, fit), own, axis=1)
    along = np.linalg.qr(others / (np.linalg.norm(others, axis=0) + 1e-300))[0]
    reference, seen = fit.residuals**2, objective.of_witnesses(fit.residuals) ** 2
    block = objective.block[len(objective.block) - len(seen) :]

    def compared(delay: float) -> tuple[np.ndarray, bool]:
        moved = Part(part.candidate, {**part.values, name: delay})
        residuals = objective.whiten(objective.left_by([*fit.terms[:k], moved.term, *fit.terms[k + 1 :]]))
        residuals = residuals - along @ (along.T @ residuals)
        by_witnesses = np.bincount(block, objective.of_witnesses(residuals) ** 2 - seen)
        refuted = len(seen) > 0 and _is_worse(objective, by_witnesses[np.unique(block)])
        return objective.block_sums(residuals**2 - reference), refuted

    grid = np.linspace(limit.lower, limit.upper, _POINTS)
    more, refuted = zip(*(compared(float(delay)) for delay in grid), strict=True)
    return grid, np.stack(more), np.array(refuted)
