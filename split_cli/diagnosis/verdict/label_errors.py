"""Errors of labels over a step of 0.05 s, before and with terms, and the blocks of time they are drawn in."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.rollouts import SharedRates
from split_cli.diagnosis.recording.series import extended_model
from split_cli.learning.features import Z2
from split_cli.learning.labels import Labels, compute_labels
from split_cli.scoring.noise import covariance_in_labels, covariance_of_ends, white_noise
from split_cli.vehicle.effects import Term
from split_cli.vehicle.integration import Situation, phi_matrix
from split_cli.vehicle.windows import recorded_inputs

BLOCK_SECONDS = 2.0
_WANTED_BLOCKS = 10
_SHORTEST_BLOCK = 0.5


@dataclass(frozen=True)
class LabelErrors:
    """Errors of labels on one recording, in label units, and which windows are held out."""

    labels: Labels  # of the simulation as learned: nominal less the shared discrepancy
    # before, physics, persistence: (L, 3)
    before: np.ndarray
    physics: np.ndarray
    persistence: np.ndarray
    held: np.ndarray  # bool (L,)
    floor: np.ndarray  # (L, 3): variance that sensor noise alone makes


def label_errors(
    evidence: Evidence,
    terms: Sequence[Term],
    shared: SharedRates | None,
    shared_named: SharedRates | None,
    held_rows: np.ndarray,
) -> LabelErrors:
    """Compute label errors before and with the terms.

    Parameters
    ----------
    shared, shared_named : SharedRates or None
        What the simulation knows beyond the nominal model along this recording, as it is and with the terms.
    held_rows : ndarray of bool, shape (N,)
    """
    series, vehicle = evidence.series, evidence.vehicle
    # Effects of the vehicle file act where, when and under which yaw the diagnosis says.
    situation = {"t": series.t, "s": series.s, "yaw": series.yaw}
    drive = replace(series.drive, columns={**series.drive.columns, **situation})
    labels = compute_labels(drive, vehicle, Z2)
    labels = labels.take(np.isfinite(labels.y).all(axis=1))
    window, rows = labels.window, labels.row
    span = rows[:, None] + np.arange(window + 1)
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
    before, physics = labels.y, labels.y + change
    if shared is not None:
        before = before - shared.base[span[:, :-1]].mean(axis=1)
    # Which part of the simulation is believed is chosen for each stage apart.
    if shared_named is not None:
        physics = physics - shared_named.base[span[:, :-1]].mean(axis=1)
    ends = covariance_of_ends(np.eye(3) + labels.horizon * A @ phi, white_noise(series.noise), window)
    floor = np.diagonal(covariance_in_labels(ends, phi, labels.horizon), axis1=1, axis2=2)
    return LabelErrors(labels, before, physics, persistence, held, floor)


def _predict(evidence: Evidence, terms, measured, smooth, rows, window) -> np.ndarray:
    series = evidence.series
    model = extended_model(evidence.vehicle, terms)
    drive, situation = series.drive, Situation(series.t, series.s, series.yaw)
    recorded = recorded_inputs(model, smooth, drive["T"], drive["delta"], series.recording, situation, held=drive.held)
    return recorded.windows(rows, window).predict(model, measured[rows], evidence.jacobian[rows])


def blocks_of_time(times: Sequence[np.ndarray], longest: float = BLOCK_SECONDS) -> np.ndarray:
    """Number the blocks of time of all recordings; shorter ones where too few would be left to draw from."""
    seconds = sum(float(np.ptp(t)) for t in times if len(t)) / _WANTED_BLOCKS
    length = float(np.clip(seconds, _SHORTEST_BLOCK, longest))
    return np.concatenate([1_000_000 * k + (t // length).astype(np.int64) for k, t in enumerate(times)])


def in_standard_errors(values: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return sums of values (L, ...) over their standard errors, blocks of time being independent."""
    _, number = np.unique(block, return_inverse=True)
    sums = np.zeros((int(number.max(initial=0)) + 1, *values.shape[1:]))
    np.add.at(sums, number, values)
    error = np.sqrt(np.sum((sums - sums.mean(axis=0)) ** 2, axis=0) * len(sums) / max(len(sums) - 1, 1))
    return sums.sum(axis=0) / np.maximum(error, 1e-300)
