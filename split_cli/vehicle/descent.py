"""The one bounded least-squares iteration of the project: Levenberg-Marquardt with an active set of bounds."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

State = TypeVar("State")

_FIRST_DAMPING, _LEAST_DAMPING, _FALL, _RISE = 1e-3, 1e-6, 5.0, 8.0
_RIDGE = 1e-9


@dataclass(frozen=True)
class Slopes:
    """A cost's first derivatives and its Gauss-Newton curvature at one place."""

    jacobian: np.ndarray  # (M, P): of the residuals
    gradient: np.ndarray  # (P,): half of the cost's: J^T r, weights and priors included
    curvature: np.ndarray  # (P, P): half of the cost's: J^T J, weights and priors included
    # What may be gained yet, in units of the cost, since the derivatives are not quite those of this place.
    doubt: float = 0.0

    def step(self, damping: float, free: np.ndarray) -> np.ndarray:
        """Return Marquardt's step, shape (P,): (H + lambda diag H) d = -g, no parameter moved that is not free."""
        count = len(self.gradient)
        scaled = self.curvature + damping * np.diag(np.diag(self.curvature)) + _RIDGE * np.eye(count)
        move = np.zeros(count)
        if free.any():
            move[free] = -np.linalg.solve(scaled[np.ix_(free, free)], self.gradient[free])
        return move

    def promised(self, free: np.ndarray) -> float:
        """Return what a step to where straight lines have their least would gain, in units of the cost."""
        return -float(self.gradient @ self.step(_RIDGE, free))


@dataclass(frozen=True)
class Descent(Generic[State]):
    """Where a descent ended."""

    parameters: np.ndarray  # (P,)
    cost: float
    state: State  # what `evaluate` returned beside the cost
    slopes: Slopes  # of the last linearisation, which is that before the last step, or as they followed that


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
    known: Slopes | None = None,
    follow: Callable[[Slopes, tuple[np.ndarray, State], tuple[np.ndarray, State]], Slopes | None] | None = None,
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
    known : Slopes, optional
        At the start, by and large: of another problem that is much like this one.
    follow : callable, optional
        Slopes, and parameters and state before and after a step, to the slopes after it, or None where what the
        step did says that they have to be worked out anew; by default they always are.

    Notes
    -----
    Marquardt (1963), see `Slopes.step`. A parameter at its bound whose gradient points outward rests for the step;
    steps end at bounds. Slopes that were not worked out where they are used get one try. Where they promise too
    little for another step they end the descent, unless their doubt is more: then they are worked out anew.
    """

    def movable_now(x: np.ndarray, slopes: Slopes) -> np.ndarray:
        free = ~(((x <= lower) & (slopes.gradient > 0)) | ((x >= upper) & (slopes.gradient < 0)))
        return free if movable is None else free & movable

    x, damping, kept = start, _FIRST_DAMPING, known
    cost, state = evaluate(x)
    for _ in range(iterations):
        anew = kept is None
        slopes, kept, gained = linearise(x, state) if kept is None else kept, None, 0.0
        free = movable_now(x, slopes)
        if not anew and enough(slopes.promised(free), cost):
            if enough(slopes.doubt, cost):
                break
            anew, slopes = True, linearise(x, state)
            free = movable_now(x, slopes)
        for _ in range(tries if anew else 1):
            trial = np.clip(x + slopes.step(damping, free), lower, upper)
            there, trial_state = evaluate(trial)
            if there < cost:
                gained = cost - there
                kept = follow(slopes, (x, state), (trial, trial_state)) if follow else None
                x, cost, state = trial, there, trial_state
                damping = max(damping / _FALL, _LEAST_DAMPING)
                break
            damping *= _RISE
        if anew and enough(gained, cost):
            break
    return Descent(x, cost, state, slopes if kept is None else kept)
