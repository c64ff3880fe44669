"""Does the named physics help: held-out errors of one label, before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.evidence import Evidence
from split_cli.diagnosis.result import Improvement
from split_cli.diagnosis.series import extended_model
from split_cli.learning.cells import learn
from split_cli.learning.features import Z2
from split_cli.learning.hyperparameters import default_kernel, scatter_variance
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.region import z2_grid
from split_cli.prediction import make_predictor
from split_cli.vehicle.effects import Term
from split_cli.vehicle.integration import integrate_recorded, phi_matrix, recorded_inputs, substep_count

__all__ = ["LabelErrors", "label_errors", "measure_improvement"]

_BOOTSTRAPS = 400
_BLOCK_SECONDS = 2.0


@dataclass(frozen=True)
class LabelErrors:
    """Errors of labels on one recording, in label units, and which windows are held out.

    Attributes
    ----------
    labels : Labels
        Of the simulation as learned: nominal less common physics.
    before, physics, persistence : ndarray, shape (L, 3)
    held : ndarray of bool, shape (L,)
    floor : ndarray, shape (3,)
        Root mean square that sensor noise alone makes.
    """

    labels: Labels
    before: np.ndarray
    physics: np.ndarray
    persistence: np.ndarray
    held: np.ndarray
    floor: np.ndarray


def label_errors(
    evidence: Evidence, terms: Sequence[Term], common_rates: np.ndarray, held_rows: np.ndarray
) -> LabelErrors:
    """Compute label errors before and with the terms.

    Parameters
    ----------
    evidence : Evidence
    terms : sequence of Term
    common_rates : ndarray, shape (N, 3)
        What the simulation knows beyond the nominal model, along this recording.
    held_rows : ndarray of bool, shape (N,)
    """
    series, vehicle = evidence.series, evidence.vehicle
    labels = compute_labels(series.drive, vehicle, Z2)
    labels = labels.take(np.isfinite(labels.y).all(axis=1))
    window, rows = labels.window, labels.row
    span = rows[:, None] + np.arange(window + 1)
    shared = common_rates[span].mean(axis=1)
    A = evidence.jacobian[rows]
    phi = phi_matrix(A, labels.horizon)
    change = np.zeros_like(labels.y)
    if terms:
        measured, smooth = series.corrected(terms)
        plain = _predict(evidence, (), series.measured, series.smooth, rows, window)
        named = _predict(evidence, terms, measured, smooth, rows, window)
        error = (measured[rows + window] - named) - (series.measured[rows + window] - plain)
        change = np.linalg.solve(phi, error[:, :, None])[:, :, 0] / labels.horizon
    moved = series.measured[rows + window] - series.measured[rows]
    persistence = np.linalg.solve(phi, moved[:, :, None])[:, :, 0] / labels.horizon
    held = held_rows[rows] & held_rows[rows + window]
    before = labels.y - shared
    inverse = np.linalg.inv(phi) / labels.horizon
    onward = inverse @ (np.eye(3) + labels.horizon * A @ phi)
    floor = np.sqrt(((inverse**2 + onward**2) @ series.noise**2).mean(axis=0))
    return LabelErrors(labels, before, before + change, persistence, held, floor)


def _predict(evidence: Evidence, terms, measured, smooth, rows, window) -> np.ndarray:
    series = evidence.series
    model = extended_model(evidence.vehicle, terms)
    situation = {"time": series.t, "track_position": series.s, "yaw": series.yaw}
    recorded = recorded_inputs(model, smooth, series.torque, series.steer_angle, series.recording, **situation)
    span = rows[:, None] + np.arange(window + 1)
    return integrate_recorded(
        model,
        measured[rows],
        recorded.torque[span],
        recorded.steer_angle[span],
        series.period,
        substep_count(evidence.jacobian[rows], series.period),
        term_states=recorded.term_states[rows],
        **{name: values[rows] for name, values in situation.items()},
    )


def measure_improvement(parts: Sequence[LabelErrors], vehicle) -> Improvement:
    """Pool the recordings' held-out label errors, with SPLIT learned on what the training windows leave."""
    held = [part.held for part in parts]
    stacked = {
        "before": [part.before[h] for part, h in zip(parts, held, strict=True)],
        "physics": [part.physics[h] for part, h in zip(parts, held, strict=True)],
        "persistence": [part.persistence[h] for part, h in zip(parts, held, strict=True)],
        "after": _with_split(parts, [part.physics for part in parts], vehicle),
        "split_only": _with_split(parts, [part.before for part in parts], vehicle),
    }
    errors = {name: np.concatenate(blocks) for name, blocks in stacked.items()}
    block = np.concatenate([
        1000 * k + (part.labels.t[h] // _BLOCK_SECONDS).astype(np.int64)
        for k, (part, h) in enumerate(zip(parts, held, strict=True))
    ])  # fmt: skip
    rms = {name: tuple(np.sqrt(np.mean(e**2, axis=0)).tolist()) for name, e in errors.items()}
    floor = tuple(np.sqrt(np.mean([part.floor**2 for part in parts], axis=0)).tolist())
    return Improvement(
        rms["before"], rms["physics"], rms["after"], rms["split_only"], rms["persistence"], floor,
        _intervals(errors, block),
    )  # fmt: skip


def _with_split(parts: Sequence[LabelErrors], errors: list[np.ndarray], vehicle) -> list[np.ndarray]:
    training = []
    for part, error in zip(parts, errors, strict=True):
        labels = replace(part.labels, y=error)
        training.append(labels.take(~part.held))
    grid = z2_grid(vehicle, training[0].region)
    training = [labels.inside(grid) for labels in training]
    accepted = np.concatenate([labels.y[labels.accepted] for labels in training])
    if len(accepted) < 100:
        return [error[part.held] for part, error in zip(parts, errors, strict=True)]
    noise = np.mean([scatter_variance(labels) for labels in training], axis=0)
    trained = learn(training, vehicle=vehicle, grid=grid, kernel=default_kernel(grid, accepted, noise))
    predictor = make_predictor("bcm", trained)
    out = []
    for part, error in zip(parts, errors, strict=True):
        held = part.labels.take(part.held).inside(grid)
        left = error[part.held].copy()
        if held.accepted.any():
            left[held.accepted] -= predictor.mean(held.z[held.accepted])
        out.append(left)
    return out


def _intervals(errors: Mapping[str, np.ndarray], block: np.ndarray) -> dict[str, object]:
    """Return 95 % intervals of the rms, and of the share of the squared error removed, by block bootstrap."""
    rng = np.random.default_rng(20240501)
    _, number = np.unique(block, return_inverse=True)
    count = np.bincount(number).astype(float)
    sums = {
        name: np.stack([np.bincount(number, e[:, c] ** 2) for c in range(3)], axis=1) for name, e in errors.items()
    }
    draws = rng.integers(0, len(count), (_BOOTSTRAPS, len(count)))
    out: dict[str, object] = {}
    for name, total in sums.items():
        rms = np.sqrt(total[draws].sum(axis=1) / count[draws].sum(axis=1)[:, None])
        out[name] = np.quantile(rms, [0.025, 0.975], axis=0).T.tolist()
    out["blocks"] = len(count)
    return out
