"""Baselines of the proof: sparse regression (STLSQ) and greedy selection by BIC, over the same terms.

Both get the regressors of `library`, the prediction errors of the real drive, and, where a simulation's drive is
given, have its errors as a cubic in the operating point taken off first. Neither can abstain.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from split_cli.logs.assembling.noise import difference_noise
from split_cli.logs.drive import Drive
from split_cli.proof.baseline_regressors import Library, build_library
from split_cli.proof.outcome import Named, Statement
from split_cli.proof.windows import FIRST, HORIZON, window_errors
from split_cli.vehicle.parameters import Vehicle

_STLSQ_THRESHOLD = 0.1
"""A term whose error has a smaller rms than this, over the noise's, is cut off: below the hard tier."""
_RIDGE = 1e-3
_MOST_NAMES = 6


@dataclass(frozen=True)
class Regression:
    """Regressors and errors over the noise, shapes (3 K, C) and (3 K,)."""

    library: Library
    target: np.ndarray


def build_regression(real: Drive, sim: Drive | None, vehicle: Vehicle) -> Regression:
    """Return what the baselines work on."""
    noise = np.array([np.sqrt(2.0) * difference_noise(real[name], [(0, len(real))]) for name in ("vx", "vy", "r")])
    columns, lap = _with_place(real)
    library = build_library(columns, vehicle, lap, noise)
    error = window_errors(columns, vehicle, ())
    if sim is not None:
        of_sim, _ = _with_place(sim)
        common = window_errors(of_sim, vehicle, ())
        features, mean, scale = _cubic(of_sim, len(common), None)
        weights = np.linalg.solve(
            features.T @ features + _RIDGE * len(features) * np.eye(features.shape[1]), features.T @ common
        )
        error = error - _cubic(columns, len(error), (mean, scale))[0] @ weights
    return Regression(library, (error / noise).ravel())


def _with_place(drive: Drive) -> tuple[dict[str, np.ndarray], float]:
    """Return a drive's columns with `s` along its first lap, and the lap's length (the drive's if none closes)."""
    step = np.hypot(np.diff(drive["X"]), np.diff(drive["Y"]))
    speed = np.hypot(drive["vx"], drive["vy"])
    # Speed, not noisy positions, gives the way; positions say where the lap closes.
    s = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * drive.period)])
    near = np.hypot(drive["X"] - drive["X"][0], drive["Y"] - drive["Y"][0])
    far = np.flatnonzero(near > 0.1 * near.max() + 5.0 * step.max())
    lap = float(s[-1])
    if len(far):
        back = far[0] + np.flatnonzero(near[far[0] :] < max(0.02 * near.max(), 2.0 * step.max()))
        if len(back):
            first = back[0] + int(np.argmin(near[back[0] : back[0] + 100]))
            lap = float(s[first])
    columns = {name: drive[name] for name in ("t", "yaw", "vx", "vy", "r", "T", "delta")}
    return {**columns, "s": s % lap}, lap


def _cubic(columns: dict[str, np.ndarray], count: int, norm: tuple | None):
    """Return all products up to the third degree of v_x, v_y, r, T, delta at the windows' starts."""
    rate = 1.0 / float(columns["t"][1] - columns["t"][0])
    rows = int(round(FIRST * rate)) + np.arange(count) * int(round(HORIZON * rate))
    point = np.stack([columns[name][rows] for name in ("vx", "vy", "r", "T", "delta")], axis=1)
    mean, scale = norm or (point.mean(axis=0), point.std(axis=0))
    z = np.clip((point - mean) / scale, -4.0, 4.0)
    parts = [np.ones(len(z))]
    for i in range(5):
        parts.append(z[:, i])
        for j in range(i, 5):
            parts.append(z[:, i] * z[:, j])
            for k in range(j, 5):
                parts.append(z[:, i] * z[:, j] * z[:, k])
    return np.stack(parts, axis=1), mean, scale


def _statement(names: list[str]) -> Statement:
    findings = tuple(Named(name) for name in dict.fromkeys(names))
    return Statement("mismatch" if findings else "match", findings)


def stlsq(regression: Regression) -> Statement:
    """Name terms by sequentially thresholded least squares.

    pysindy's optimizer where it is installed (extra ``proof``), else the same algorithm here. Source: Brunton,
    Proctor and Kutz, PNAS 113 (2016), 3932.
    """
    matrix = regression.library.matrix / np.sqrt(np.mean(regression.library.matrix**2, axis=0))
    try:
        from pysindy.optimizers import STLSQ
    except ImportError:
        weights = sequentially_thresholded(matrix, regression.target, _STLSQ_THRESHOLD, 0.05)
    else:
        optimizer = STLSQ(threshold=_STLSQ_THRESHOLD, alpha=0.05)
        with warnings.catch_warnings():
            # It warns where nothing is left, which is an answer here.
            warnings.simplefilter("ignore", UserWarning)
            optimizer.fit(matrix, regression.target[:, None])
        weights = np.ravel(optimizer.coef_)
    return _statement([regression.library.terms[i] for i in np.flatnonzero(weights)])


def sequentially_thresholded(matrix: np.ndarray, target: np.ndarray, threshold: float, ridge: float) -> np.ndarray:
    """Return ridge weights after cutting those below the threshold off until none is, shape (C,)."""
    kept = np.ones(matrix.shape[1], dtype=bool)
    weights = np.zeros(matrix.shape[1])
    for _ in range(20):
        inside = matrix[:, kept]
        weights[:] = 0.0
        if inside.shape[1]:
            gram = inside.T @ inside + ridge * np.eye(inside.shape[1])
            weights[kept] = np.linalg.solve(gram, inside.T @ target)
        small = kept & (np.abs(weights) < threshold)
        if not small.any():
            break
        kept &= ~small
    weights[~kept] = 0.0
    return weights


def greedy_bic(regression: Regression) -> Statement:
    """Name terms one after the other while the Bayesian information criterion, n ln(RSS/n) + k ln n, falls."""
    matrix, target = regression.library.matrix, regression.target
    owner = np.array(regression.library.terms)
    count = len(target)
    # All projections from one set of normal equations.
    gram, moment, total = matrix.T @ matrix, matrix.T @ target, float(target @ target)
    gram = gram + 1e-9 * np.diag(np.diag(gram))
    inside = np.zeros(len(owner), dtype=bool)
    chosen: list[str] = []
    best = count * np.log(total / count)
    while len(chosen) < _MOST_NAMES:
        trials = []
        for name in sorted(set(owner) - set(chosen)):
            kept = inside | (owner == name)
            left = total - moment[kept] @ np.linalg.solve(gram[np.ix_(kept, kept)], moment[kept])
            trials.append((count * np.log(left / count) + kept.sum() * np.log(count), name))
        criterion, name = min(trials)
        if criterion >= best:
            break
        best = criterion
        chosen.append(name)
        inside |= owner == name
    return _statement(chosen)
