"""Are the parameters of an explanation the same everywhere: left and right, hard and gentle, early and late.

A term of the catalogue that stands in for something else has to bend: its parameter drifts with what the something
depends on. Few parameters are tested, so the test sees what a flexible fit of the remainder loses in its freedom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import features
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.fitting import Fit, raw_slopes

__all__ = ["Drift", "parameter_drifts"]


@dataclass(frozen=True)
class Drift:
    """How much cost a fit saves when its parameters may follow one variable.

    Attributes
    ----------
    variable : str
    saved : float
        Cost saved, in units of chi squared.
    freedom : int
        Parameters that may follow.
    """

    variable: str
    saved: float
    freedom: int


def parameter_drifts(objective: MarginalLikelihood, fit: Fit) -> tuple[Drift, ...]:
    """Return the drifts of a fit's parameters, strongest first.

    Notes
    -----
    A score test: the rows' derivatives by the parameters, times the variable, are offered beside the derivatives
    themselves.
    """
    if not fit.parts:
        return ()
    slopes = raw_slopes(objective, fit.parts)
    own = _orthonormal(objective.whiten(slopes))
    left = fit.residuals - own @ (own.T @ fit.residuals)
    out = []
    for name, weight in _modulators(objective).items():
        columns = objective.whiten(slopes * weight[:, None])
        columns -= own @ (own.T @ columns)
        basis = _orthonormal(columns)
        out.append(Drift(name, float(np.sum((basis.T @ left) ** 2)), basis.shape[1]))
    return tuple(sorted(out, key=lambda drift: -drift.saved))


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    left, size, _ = np.linalg.svd(columns / scale, full_matrices=False)
    return left[:, size > 1e-4 * max(float(size.max(initial=0.0)), 1e-12)]


def _modulators(objective: MarginalLikelihood) -> dict[str, np.ndarray]:
    """Return variables between about -1 and 1 on the objective's rows, by the name they are reported with."""
    tables = []
    for one in objective.evidence:
        z = features(one.series, one.vehicle)[one.at]
        torque = z[:, 2]
        tables.append({
            "the side of the turn": np.sign(one.series.smooth[one.at, 2]),
            "torque": torque / max(float(np.quantile(np.abs(torque), 0.98)), 1e-9),
            "the size of torque": np.abs(torque) / max(float(np.quantile(np.abs(torque), 0.98)), 1e-9),
            "speed": z[:, 3] / max(float(np.quantile(z[:, 3], 0.98)), 1e-9),
            "front slip": np.abs(z[:, 0]) / max(float(np.quantile(np.abs(z[:, 0]), 0.98)), 1e-9),
            "rear slip": np.abs(z[:, 1]) / max(float(np.quantile(np.abs(z[:, 1]), 0.98)), 1e-9),
            "time": one.series.t[one.at] / max(float(one.series.t[-1]), 1e-9),
        })  # fmt: skip
    extra = np.zeros(sum(len(one.begin) for one in objective.kinematics))
    out = {}
    for name in tables[0]:
        rows = [
            np.repeat(np.clip(t[name], -1.5, 1.5)[keep], 3) for t, keep in zip(tables, objective.keep, strict=True)
        ]
        out[name] = np.concatenate([*rows, extra])
    return out
