"""Models side by side on the same drives: open-loop errors with intervals, skill, fit, and which is best."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

STATES = ("v_x", "v_y", "r")
UNITS = ("m/s", "m/s", "rad/s")
_DRAWS = 1000
_FEWEST_BLOCKS = 4
_INTERVAL = (2.5, 97.5)


@dataclass(frozen=True)
class RunErrors:
    """Free runs of all models from the same starts, at one horizon.

    Attributes
    ----------
    horizon : float
        [s]
    errors : mapping of str to ndarray, shape (N, 3)
        Of v_x, v_y [m/s] and r [rad/s] at the end of the horizon, by model.
    held : ndarray, shape (N, 3)
        The same of velocities held.
    measured : ndarray, shape (N, 3)
        What was measured there.
    block : ndarray of int, shape (N,)
        Block of time of each start.
    """

    horizon: float
    errors: Mapping[str, np.ndarray]
    held: np.ndarray
    measured: np.ndarray
    block: np.ndarray


@dataclass(frozen=True)
class StateScore:
    """One model, one state, one horizon.

    Attributes
    ----------
    interval : (float, float)
        95 %, bootstrap over blocks of time; NaN with fewer than four blocks.
    skill : float
        1 - MSE/MSE of velocities held [1].
    fit : float
        100 (1 - ||error||/||measured - mean||) [%], as system identification tools quote it.
    to_best : (float, float, float)
        Rms error over that of the best model, and its 95 % interval from the same draws.
    as_good : bool
        Whether the data cannot tell it from the best.
    """

    state: str
    unit: str
    rmse: float
    interval: tuple[float, float]
    skill: float
    fit: float
    to_best: tuple[float, float, float]
    is_best: bool
    as_good: bool


@dataclass(frozen=True)
class ModelScore:
    """One model at one horizon; `total` is the mean over states of rmse over that of velocities held [1]."""

    name: str
    horizon: float
    states: tuple[StateScore, ...]
    total: float
    is_best: bool


def rank(runs: Sequence[RunErrors]) -> tuple[ModelScore, ...]:
    """Return every model at every horizon, in the order given.

    Notes
    -----
    All models share starts, blocks and draws, so that intervals of ratios hold what the models have in common:
    a stretch that is hard for all moves none of them.
    """
    return tuple(score for one in runs for score in _rank_at(one))


def worse_than(scores: Sequence[ModelScore], runs: Sequence[RunErrors], name: str) -> tuple[str, ...]:
    """Return in words where model `name` is worse than another one beyond chance."""
    sentences = []
    for one in runs:
        draws = _draws(one)
        for other in one.errors:
            if other == name:
                continue
            low = _ratio(draws, name, other)[1]
            when = f"after {one.horizon:g} s"
            sentences += [
                f"{name} is worse than {other}: {state} {when}, at least {ratio:.2f} times its error"
                for state, ratio in zip(STATES, low, strict=True)
                if ratio > 1.0
            ]
    return tuple(sentences)


def _draws(one: RunErrors) -> dict[str, np.ndarray]:
    """Return squared errors summed over blocks and drawn anew, shape (1 + draws, 3) a model; first as it is.

    The numbers of samples cancel in ratios and are shared; `""` is velocities held, `"count"` the samples.
    """
    _, number = np.unique(one.block, return_inverse=True)
    blocks = int(number.max()) + 1
    drawn = np.random.default_rng(20240501).multinomial(blocks, np.full(blocks, 1.0 / blocks), _DRAWS)
    weights = np.vstack([np.ones(blocks), drawn])
    out = {"count": weights @ np.bincount(number, minlength=blocks)}
    for name, errors in (*one.errors.items(), ("", one.held)):
        sums = np.stack([np.bincount(number, errors[:, k] ** 2, blocks) for k in range(3)], axis=1)
        out[name] = weights @ sums
    if blocks < _FEWEST_BLOCKS:
        for name in (*one.errors, ""):
            out[name][1:] = np.nan
    return out


def _ratio(draws: Mapping[str, np.ndarray], name: str, other: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt(draws[name] / draws[other])
    return ratio[0], *_ends(ratio[1:])


def _ends(values: np.ndarray) -> np.ndarray:
    if not np.isfinite(values).all():
        return np.full((2, *values.shape[1:]), np.nan)
    ends: np.ndarray = np.percentile(values, _INTERVAL, axis=0)
    return ends


def _rank_at(one: RunErrors) -> list[ModelScore]:
    draws = _draws(one)
    count = draws["count"]
    rmse = {name: np.sqrt(draws[name] / count[:, None]) for name in one.errors}
    names = list(one.errors)
    least = [[float(rmse[name][0, k]) for name in names] for k in range(3)]
    best = [names[min(range(len(names)), key=sizes.__getitem__)] for sizes in least]
    with np.errstate(divide="ignore", invalid="ignore"):
        total = {name: float(np.sqrt(draws[name][0] / draws[""][0]).mean()) for name in one.errors}
    first = min(total, key=total.__getitem__)
    spread = np.std(one.measured, axis=0)
    scores = []
    for name in one.errors:
        ends = _ends(rmse[name][1:])
        states = []
        for k in range(3):
            ratio = _ratio(draws, name, best[k])
            to_best = float(ratio[0][k]), float(ratio[1][k]), float(ratio[2][k])
            own = float(rmse[name][0, k])
            states.append(
                StateScore(
                    STATES[k],
                    UNITS[k],
                    own,
                    (float(ends[0, k]), float(ends[1, k])),
                    float(1.0 - draws[name][0, k] / max(draws[""][0, k], 1e-300)),
                    float(100.0 * (1.0 - own / max(spread[k], 1e-300))),
                    to_best,
                    name == best[k],
                    name == best[k] or not to_best[1] > 1.0,  # nor where its interval is not known
                )
            )
        scores.append(ModelScore(name, one.horizon, tuple(states), total[name], name == first))
    return scores
