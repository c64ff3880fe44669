"""Nonlinear least squares within bounds: Levenberg-Marquardt with an active set. All fits of the project use it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

State = TypeVar("State")

_FIRST_DAMPING, _LEAST_DAMPING, _FALL, _RISE = 1e-3, 1e-6, 5.0, 8.0
_RIDGE = 1e-9


@dataclass(frozen=True)
class Slopes:
    """Jacobian of the residuals, gradient and Gauss-Newton Hessian of the cost, at one point."""

    jacobian: np.ndarray  # (M, P), of M residuals by P parameters
    gradient: np.ndarray  # (P,), half the cost's gradient: J^T r, weights and priors included
    curvature: np.ndarray  # (P, P), half the cost's Hessian: J^T J, weights and priors included
    # Bound of the decrease of the cost that these derivatives may miss, where they were computed at another point.
    missed: float = 0.0

    def step(self, damping: float, free: np.ndarray) -> np.ndarray:
        """Return Marquardt's step, shape (P,): (H + lambda diag H) d = -g, no parameter moved that is not free."""
        count = len(self.gradient)
        scaled = self.curvature + damping * np.diag(np.diag(self.curvature)) + _RIDGE * np.eye(count)
        move = np.zeros(count)
        if free.any():
            move[free] = -np.linalg.solve(scaled[np.ix_(free, free)], self.gradient[free])
        return move

    def predicted_decrease(self, free: np.ndarray) -> float:
        """Return the decrease of the cost that a Gauss-Newton step predicts for linear residuals: g^T H^-1 g."""
        return -float(self.gradient @ self.step(_RIDGE, free))


@dataclass(frozen=True)
class Descent(Generic[State]):
    """Result of `descend`."""

    parameters: np.ndarray  # (P,)
    cost: float
    state: State  # what `evaluate` returned beside the cost
    # The last derivatives: those before the last step, or those that `update` derived from them after it.
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
    first: Slopes | None = None,
    update: Callable[[Slopes, tuple[np.ndarray, State], tuple[np.ndarray, State]], Slopes | None] | None = None,
) -> Descent[State]:
    """Minimise a sum of squares inside bounds.

    Parameters
    ----------
    evaluate : callable
        From parameters (P,) to the cost and a state of any kind, which `linearise` gets.
    linearise : callable
        From parameters (P,) and that state to the derivatives.
    start, lower, upper : ndarray, shape (P,)
        `start` lies within the bounds.
    enough : callable
        From the decrease of the last step (0 where none was found) and the cost to whether to end.
    iterations, tries : int
        Largest number of linearisations, and of steps tried at each.
    movable : ndarray of bool, shape (P,), optional
        Parameters that may move; all by default.
    first : Slopes, optional
        Approximate derivatives at the start, taken from a similar problem.
    update : callable, optional
        From the derivatives before a step, and (parameters, state) before and after it, to approximate derivatives
        after it, or None where they must be computed anew, as by default they always are.

    Notes
    -----
    Marquardt (1963), see `Slopes.step`. A parameter at its bound whose descent direction points outward is held for
    the step; steps are clipped at bounds. With approximate derivatives one step is tried, not `tries`. Where they
    predict too small a decrease, the descent ends, unless their `missed` is larger: then they are computed anew.
    """

    def movable_now(x: np.ndarray, slopes: Slopes) -> np.ndarray:
        free = ~(((x <= lower) & (slopes.gradient > 0)) | ((x >= upper) & (slopes.gradient < 0)))
        return free if movable is None else free & movable

    x, damping, kept = start, _FIRST_DAMPING, first
    cost, state = evaluate(x)
    for _ in range(iterations):
        anew = kept is None
        slopes, kept, gained = linearise(x, state) if kept is None else kept, None, 0.0
        free = movable_now(x, slopes)
        if not anew and enough(slopes.predicted_decrease(free), cost):
            if enough(slopes.missed, cost):
                break
            anew, slopes = True, linearise(x, state)
            free = movable_now(x, slopes)
        for _ in range(tries if anew else 1):
            trial = np.clip(x + slopes.step(damping, free), lower, upper)
            there, trial_state = evaluate(trial)
            if there < cost:
                gained = cost - there
                kept = update(slopes, (x, state), (trial, trial_state)) if update else None
                x, cost, state = trial, there, trial_state
                damping = max(damping / _FALL, _LEAST_DAMPING)
                break
            damping *= _RISE
        if anew and enough(gained, cost):
            break
    return Descent(x, cost, state, slopes if kept is None else kept)
