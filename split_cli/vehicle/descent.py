"""The one bounded least-squares iteration of the project: Levenberg-Marquardt with an active set of bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

__all__ = ["Descent", "Slopes", "descend"]

State = TypeVar("State")

_FIRST_DAMPING, _LEAST_DAMPING, _FALL, _RISE = 1e-3, 1e-6, 5.0, 8.0
_RIDGE = 1e-9


@dataclass(frozen=True)
class Slopes:
    """A cost's first derivatives and its Gauss-Newton curvature at one place.

    Attributes
    ----------
    jacobian : ndarray, shape (M, P)
        Of the residuals.
    gradient : ndarray, shape (P,)
        Half of the cost's: J^T r, weights and priors included.
    curvature : ndarray, shape (P, P)
        Half of the cost's: J^T J, weights and priors included.
    """

    jacobian: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray

    def step(self, damping: float, free: np.ndarray) -> np.ndarray:
        """Return Marquardt's step, shape (P,): (H + lambda diag H) d = -g, no parameter moved that is not free."""
        count = len(self.gradient)
        scaled = self.curvature + damping * np.diag(np.diag(self.curvature)) + _RIDGE * np.eye(count)
        move = np.zeros(count)
        if free.any():
            move[free] = -np.linalg.solve(scaled[np.ix_(free, free)], self.gradient[free])
        return move

    @property
    def promised(self) -> float:
        """What a step to where straight lines have their least would gain, in units of the cost."""
        return -float(self.gradient @ self.step(_RIDGE, np.ones(len(self.gradient), dtype=bool)))


@dataclass(frozen=True)
class Descent(Generic[State]):
    """Where a descent ended.

    Attributes
    ----------
    parameters : ndarray, shape (P,)
    cost : float
    state : object
        What `evaluate` returned beside the cost.
    slopes : Slopes
        Of the last linearisation, which is that before the last step.
    """

    parameters: np.ndarray
    cost: float
    state: State
    slopes: Slopes


def descend(
    evaluate: Callable[[np.ndarray], tuple[float, State]],
    linearise: Callable[[np.ndarray, State], Slopes],
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    enough: Callable[[float, float], bool],
    iterations: int,
    tries: int = 5,
    movable: np.ndarray | None = None,
) -> Descent[State]:
    """Minimise a sum of squares inside bounds.

    Parameters
    ----------
    evaluate : callable
        Parameters (P,) to the cost and what `linearise` needs there.
    linearise : callable
        Parameters (P,) and the latter to the slopes.
    start, lower, upper : ndarray, shape (P,)
        `start` lies within the bounds.
    enough : callable
        What the last step gained (0 where none was found) and the cost, to whether to end.
    iterations, tries : int
        At most so many linearisations, and steps tried at each.
    movable : ndarray of bool, shape (P,), optional
        Parameters that may move; all by default.

    Notes
    -----
    Marquardt (1963), see `Slopes.step`. A parameter at its bound whose gradient points outward rests for the step;
    steps end at bounds.
    """
    x, damping = start, _FIRST_DAMPING
    cost, state = evaluate(x)
    for _ in range(iterations):
        slopes, gained = linearise(x, state), 0.0
        free = ~(((x <= lower) & (slopes.gradient > 0)) | ((x >= upper) & (slopes.gradient < 0)))
        if movable is not None:
            free &= movable
        for _ in range(tries):
            trial = np.clip(x + slopes.step(damping, free), lower, upper)
            there, trial_state = evaluate(trial)
            if there < cost:
                gained = cost - there
                x, cost, state = trial, there, trial_state
                damping = max(damping / _FALL, _LEAST_DAMPING)
                break
            damping *= _RISE
        if enough(gained, cost):
            break
    return Descent(x, cost, state, slopes)
