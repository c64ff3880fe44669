"""Valleys of the cost over a delay: a fit ends in the one where it began, and several may explain as well.

A driver who steers to and fro is answered alike by a car that is late by less and one that is late by more. So is
a command that is held for some time. Noise of a channel that is moved in time has a valley between any two
samples, where it is averaged. So the whole range is looked at.
"""

from collections.abc import Iterator

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, sensitivity_of
from split_cli.diagnosis.search.term_tests import error_of_sum

_POINTS = 48  # at which a delay's range is looked at; 13 ms apart for a full-size car


def in_lowest_valleys(objective: MarginalLikelihood, fit: Fit, least: float) -> Fit:
    """Return a fit whose delays lie in the lowest valley each, the others beside them.

    Parameters
    ----------
    objective : MarginalLikelihood
    fit : Fit
    least : float
        What another valley has to save [chi squared] to be taken.
    """
    for k, name in _delays(fit):
        grid, blocks = _profile(objective, fit, k, name)
        cost = blocks.sum(axis=1)
        if cost.min() < fit.cost - least:
            values = {**fit.parts[k].values, name: float(grid[np.argmin(cost)])}
            parts = (*fit.parts[:k], Part(fit.parts[k].candidate, values), *fit.parts[k + 1 :])
            deeper = fit_parts(objective, parts)
            fit = deeper if deeper.cost < fit.cost - least else fit
    return fit


def other_valleys(objective: MarginalLikelihood, fit: Fit, k: int, name: str) -> list[float]:
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
    grid, blocks = _profile(objective, fit, k, name)
    cost, found = blocks.sum(axis=1), []
    before, after = np.append(np.inf, cost[:-1]), np.append(cost[1:], np.inf)
    reference = objective.block_sums(fit.residuals**2)
    for i in np.flatnonzero((cost < before) & (cost <= after)):
        more = blocks[i] - reference
        z = float(more.sum()) / error_of_sum(more)
        if abs(grid[i] - here) > grid[1] - grid[0] and z < objective.policy.selection.deviations:
            found.append(float(grid[i]))
    return found


def _delays(fit: Fit) -> Iterator[tuple[int, str]]:
    """Yield number and parameter of the parts of a fit that are transport delays."""
    for k, part in enumerate(fit.parts):
        if part.term.moves_samples or getattr(part.term, "input_delays", None):
            yield from ((k, name) for name in part.values)


def _profile(objective: MarginalLikelihood, fit: Fit, k: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return delays all over the range, shape (D,), and what each leaves block by block, shape (D, B).

    At each of them the other parameters take what is best to first order.
    """
    part = fit.parts[k]
    limit = part.candidate.ranges[name]
    own = sum(len(one.values) for one in fit.parts[:k]) + list(part.values).index(name)
    others = np.delete(sensitivity_of(objective, fit), own, axis=1)
    along = np.linalg.qr(others / (np.linalg.norm(others, axis=0) + 1e-300))[0]

    def left(delay: float) -> np.ndarray:
        moved = Part(part.candidate, {**part.values, name: delay})
        residuals = objective.whiten(objective.left_by([*fit.terms[:k], moved.term, *fit.terms[k + 1 :]]))
        return objective.block_sums((residuals - along @ (along.T @ residuals)) ** 2)

    grid = np.linspace(limit.lower, limit.upper, _POINTS)
    return grid, np.stack([left(float(delay)) for delay in grid])
