"""Settings of a set chosen on held-out blocks: every candidate's error and cost, their front, and the choice."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.prediction import DEFAULT_PREDICTOR


@dataclass(frozen=True)
class SelectionSettings:
    """Candidates: every combination of these is tried."""

    features: tuple[str, ...] = ("z2",)  # ``z1``, ``z2`` or comma-separated names
    capacities: tuple[int, ...] = (5, 10, 20)  # points a cell keeps
    thresholds: tuple[float, ...] = (1e-3, 1e-2, 1e-1)  # gain that a point needs to enter a cell with room
    cell_edges: tuple[float, ...] = (1.0, 2.0)  # edge of the cells, in usual edges
    predictor: str = DEFAULT_PREDICTOR
    horizon: float = 0.05  # label interval [s]


@dataclass(frozen=True)
class SetCandidate:
    """One combination of settings, and what it gave on held-out blocks."""

    features: str
    capacity: int
    threshold: float
    cell_edge: float  # in usual edges
    error: float  # root mean over v_x, v_y and r of the squared error over the nominal model's: 1 is no gain
    behind: float  # how much larger the mean square behind `error` is than the best candidate's
    behind_error: float  # standard error of `behind` over blocks
    rmse: np.ndarray  # (3,): [m/s^2], [m/s^2], [rad/s^2]
    points: float  # size of the set, mean over folds: what memory and exports grow with
    cells: float  # non-empty cells, mean over folds
    microseconds: float  # median of one query with variance, asked one at a time [us]
    on_front: bool = False  # whether no candidate with as few points has a smaller error
    chosen: bool = False
    usual: bool = False  # whether these are the settings of `split train` without options


@dataclass(frozen=True)
class SetSelection:
    """All candidates, fewest points first."""

    vehicle: str
    drives: tuple[str, ...]
    # labels, blocks, folds: held-out labels, the blocks of time they are from, and how many sets each candidate
    # trained.
    labels: int
    blocks: int
    folds: int
    candidates: tuple[SetCandidate, ...]
    command: str  # `split train` with the settings chosen


def relative_error(errors: np.ndarray, nominal: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each block's part of the squared relative error, shape (B,), and the RMSE of the states, shape (3,).

    Parameters
    ----------
    errors, nominal : ndarray, shape (N, 3)
        Label errors of a candidate and of the nominal model.
    block : ndarray of int, shape (N,)

    Notes
    -----
    The parts sum to the mean over the states of MSE/MSE of the nominal model. Every state counts alike, whatever
    its unit.
    """
    nominal_squares = np.square(nominal).sum(axis=0)
    share = np.square(errors) / np.where(nominal_squares > 0.0, nominal_squares, 1.0)
    _, member = np.unique(block, return_inverse=True)
    return np.bincount(member, share.mean(axis=1)), np.sqrt(np.square(errors).mean(axis=0))


def choose(found: Sequence[tuple[SetCandidate, np.ndarray]]) -> tuple[SetCandidate, ...]:
    """Return the candidates in order of their points, with errors, the front and the choice marked.

    Parameters
    ----------
    found : sequence of (SetCandidate, ndarray)
        With the parts of the squared relative error, one a block.

    Notes
    -----
    Chosen is the one of fewest points among those that are behind the best by no more than one standard error of
    the difference over blocks, the same blocks for both: the one-standard-error rule (Breiman, Friedman, Olshen
    and Stone, Classification and regression trees, 1984, section 3.4.3), with differences in place of errors.
    """
    best = min(found, key=lambda one: one[1].sum())[1]
    judged = []
    for candidate, parts in found:
        difference, count = parts - best, len(parts)
        spread = float(np.sqrt(count * np.var(difference, ddof=1))) if count > 1 else 0.0
        judged.append(
            replace(candidate, error=float(np.sqrt(parts.sum())), behind=float(difference.sum()), behind_error=spread)
        )
    judged.sort(key=lambda one: (one.points, one.error))
    good = [one for one in judged if one.behind <= one.behind_error]
    chosen, least, marked = good[0], float("inf"), []
    for one in judged:
        on_front = one.error < least
        least = min(least, one.error)
        marked.append(replace(one, on_front=on_front, chosen=one is chosen))
    return tuple(marked)
