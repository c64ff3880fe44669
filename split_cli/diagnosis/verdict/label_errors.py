"""Errors of labels and of steps of 0.05 s on a recording, without and with terms, and blocks of time for statistics."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.rollouts import SharedRates
from split_cli.diagnosis.recording.series import extended_model
from split_cli.learning.features import Z2
from split_cli.learning.labels import Labels, compute_labels
from split_cli.scoring.noise import covariance_of_ends, white_noise
from split_cli.vehicle.effects import Term
from split_cli.vehicle.integration import Situation
from split_cli.vehicle.windows import recorded_inputs

BLOCK_SECONDS = 2.0  # longest block of time for standard errors [s]; judgement: longer than transients
_WANTED_BLOCKS = 10  # blocks on a short drive, which are shorter then [1]; judgement: a standard error to a quarter
_SHORTEST_BLOCK = 0.5  # [s]; judgement: a yaw mode of 1 to 2 Hz has died out


@dataclass(frozen=True)
class LabelErrors:
    """Errors of labels and of single steps on one recording, and which windows are held out.

    A label is the rate that a model lacks. The error of a step is its effect on the velocities: Phi times the label,
    over the length of the step. Stages are compared by steps, since Phi depends on the slip angles, and those differ
    between models. Where a tyre reacts within the step, Phi is small and labels are large. States of terms follow the
    velocities within the step, see `Windows.responses`.
    """

    labels: Labels  # of the nominal model
    # before, physics: (L, 3): label errors with the shared discrepancy, and with the terms too [m/s^2, m/s^2, rad/s^2].
    before: np.ndarray
    physics: np.ndarray
    # phi_before, phi_physics: (L, 3, 3): mean over the step of exp(A s), A the Jacobian with the states of terms.
    phi_before: np.ndarray
    phi_physics: np.ndarray
    # persistence, floor: (L, 3): step errors of held velocities, and variance of step errors by sensor noise alone.
    persistence: np.ndarray
    held: np.ndarray  # bool (L,): labels whose step lies in held-out time
    floor: np.ndarray

    def steps(self, stage: str, errors: np.ndarray) -> np.ndarray:
        """Return label errors (L, 3) of a stage, ``before`` or ``physics``, as step errors over the step's length."""
        out: np.ndarray = np.einsum("nij,nj->ni", getattr(self, f"phi_{stage}"), errors)
        return out


def label_errors(
    evidence: Evidence,
    terms: Sequence[Term],
    shared: SharedRates | None,
    shared_named: SharedRates | None,
    held_rows: np.ndarray,
) -> LabelErrors:
    """Return the label errors of a recording without and with terms.

    Parameters
    ----------
    shared, shared_named : SharedRates or None
        Shared discrepancy along the recording, without and with the terms.
    held_rows : ndarray of bool, shape (N,)
        Samples of held-out time.
    """
    series, vehicle = evidence.series, evidence.vehicle
    # Effects of the vehicle file that depend on time, place or yaw use those of the diagnosis.
    situation = {"t": series.t, "s": series.s, "yaw": series.yaw}
    drive = replace(series.drive, columns={**series.drive.columns, **situation})
    labels = compute_labels(drive, vehicle, Z2)
    labels = labels.take(np.isfinite(labels.y).all(axis=1))
    window, rows = labels.window, labels.row
    span = rows[:, None] + np.arange(window + 1)
    before, phi, carried = _labels_with(evidence, (), labels)
    physics, phi_named = (before, phi) if not terms else _labels_with(evidence, terms, labels)[:2]
    moved = (series.measured[rows + window] - series.measured[rows]) / labels.horizon
    held = held_rows[rows] & held_rows[rows + window]
    if shared is not None:
        before = before - shared.base[span[:, :-1]].mean(axis=1)
    # The used part of the discrepancy was chosen for each stage separately.
    if shared_named is not None:
        physics = physics - shared_named.base[span[:, :-1]].mean(axis=1)
    ends = covariance_of_ends(carried, white_noise(series.noise), window) / labels.horizon**2
    floor = np.diagonal(ends, axis1=1, axis2=2)
    return LabelErrors(labels, before, physics, phi, phi_named, moved, held, floor)


def _labels_with(
    evidence: Evidence, terms: Sequence[Term], labels: Labels
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the labels (L, 3) of the nominal model with terms, and Phi and exp(A h) of each, (L, 3, 3)."""
    series, rows, window = evidence.series, labels.row, labels.window
    measured, smooth = series.corrected(terms)
    model = extended_model(evidence.vehicle, terms)
    drive, situation = series.drive, Situation(series.t, series.s, series.yaw)
    recorded = recorded_inputs(model, smooth, drive["T"], drive["delta"], series.recording, situation, held=drive.held)
    windows = recorded.windows(rows, window)
    jacobian = windows.jacobian(model, measured[rows])
    phi, carried = windows.responses(model, measured[rows], jacobian, labels.horizon)
    missed = (measured[rows + window] - windows.predict(model, measured[rows], jacobian)) / labels.horizon
    return np.linalg.solve(phi, missed[:, :, None])[:, :, 0], phi, carried


def blocks_of_time(times: Sequence[np.ndarray], longest: float = BLOCK_SECONDS) -> np.ndarray:
    """Return the number of the block of time of each of the times [s], over all recordings.

    Blocks are `longest` seconds, or shorter if there would be too few for a bootstrap.
    """
    seconds = sum(float(np.ptp(t)) for t in times if len(t)) / _WANTED_BLOCKS
    length = float(np.clip(seconds, _SHORTEST_BLOCK, longest))
    return np.concatenate([1_000_000 * k + (t // length).astype(np.int64) for k, t in enumerate(times)])


def in_standard_errors(values: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return sums of values (L, ...) over their standard errors, with independent blocks of time, shape (...)."""
    _, number = np.unique(block, return_inverse=True)
    sums = np.zeros((int(number.max(initial=0)) + 1, *values.shape[1:]))
    np.add.at(sums, number, values)
    error = np.sqrt(np.sum((sums - sums.mean(axis=0)) ** 2, axis=0) * len(sums) / max(len(sums) - 1, 1))
    return sums.sum(axis=0) / np.maximum(error, 1e-300)
