"""Does the named physics help: held-out errors of one label and of rollouts, before and after."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.baseline.common import CommonPhysics
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.judge import CommonKnowledge
from split_cli.diagnosis.innovations.rollouts import (
    HORIZONS,
    RolloutErrors,
    SharedRates,
    Stage,
    rest_of,
    roll_out_stages,
    shared_rates,
)
from split_cli.diagnosis.recording.series import extended_model
from split_cli.diagnosis.statement.result import HorizonErrors, Improvement
from split_cli.learning.cells import learn
from split_cli.learning.features import Z2
from split_cli.learning.hyperparameters import default_kernel, scatter_variance
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.region import z2_grid
from split_cli.prediction import make_predictor
from split_cli.vehicle.effects import Term
from split_cli.vehicle.integration import integrate_recorded, phi_matrix, recorded_inputs, substep_count
from split_cli.vehicle.parameters import Vehicle

__all__ = ["LabelErrors", "improvable_removed", "label_errors", "measure_improvement"]

_BOOTSTRAPS = 400
_BLOCK_SECONDS = 2.0
_WANTED_BLOCKS = 10
_SHORTEST_BLOCK = 0.5
_FEWEST_TO_LEARN = 100
_MOSTLY = 0.9  # of the draws must leave something to improve, else a share has no interval


@dataclass(frozen=True)
class LabelErrors:
    """Errors of labels on one recording, in label units, and which windows are held out.

    Attributes
    ----------
    labels : Labels
        Of the simulation as learned: nominal less common physics.
    before, physics, persistence : ndarray, shape (L, 3)
    held : ndarray of bool, shape (L,)
    floor : ndarray, shape (L, 3)
        Variance that sensor noise alone makes.
    """

    labels: Labels
    before: np.ndarray
    physics: np.ndarray
    persistence: np.ndarray
    held: np.ndarray
    floor: np.ndarray


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
    evidence : Evidence
    terms : sequence of Term
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
        before = before - shared.base[span].mean(axis=1)
        physics = physics - shared_named.base[span].mean(axis=1)
    inverse = np.linalg.inv(phi) / labels.horizon
    onward = inverse @ (np.eye(3) + labels.horizon * A @ phi)
    floor = (inverse**2 + onward**2) @ series.noise**2
    return LabelErrors(labels, before, physics, persistence, held, floor)


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


def measure_improvement(
    recordings: Sequence[tuple[Evidence, np.ndarray]],
    terms: Sequence[Term],
    common: CommonPhysics,
    knowledge: CommonKnowledge | None,
) -> Improvement | None:
    """Compare simulation, named physics and SPLIT on held-out time.

    Parameters
    ----------
    recordings : sequence of (Evidence, ndarray of bool of shape (N,))
        Real recordings and which of their rows are held out; SPLIT learns what the others leave.
    terms : sequence of Term
        Fitted without the held-out rows.
    common : CommonPhysics
    knowledge : CommonKnowledge or None
        What the simulation taught.

    Returns
    -------
    Improvement or None
        None where no step lies wholly in held-out time, as behind a long gap.
    """
    terms = tuple(terms)
    plain = [shared_rates(one.series, common, knowledge) for one, _ in recordings]
    named = [shared_rates(one.series, common, knowledge, terms) for one, _ in recordings] if terms else plain
    parts = [
        label_errors(one, terms, *both, held) for (one, held), *both in zip(recordings, plain, named, strict=True)
    ]
    if not any(part.held.any() for part in parts):
        return None
    vehicle = recordings[0][0].vehicle
    split_only = _learn_rest(parts, [part.before for part in parts], vehicle)
    both = _learn_rest(parts, [part.physics for part in parts], vehicle)
    errors = {
        name: np.concatenate([values[part.held] for values, part in zip(several, parts, strict=True)])
        for name, several in {
            "before": [part.before for part in parts],
            "physics": [part.physics for part in parts],
            "split_only": [_without(part, part.before, split_only) for part in parts],
            "after": [_without(part, part.physics, both) for part in parts],
            "persistence": [part.persistence for part in parts],
        }.items()
    }
    block = _blocks([part.labels.t[part.held] for part in parts])
    floor = np.concatenate([part.floor[part.held] for part in parts])
    rms = {name: tuple(np.sqrt(np.mean(e**2, axis=0)).tolist()) for name, e in errors.items()}
    intervals, removed = _bootstrap({name: e**2 for name, e in errors.items()}, floor, block)
    rollouts = [
        roll_out_stages(
            one,
            {
                "before": Stage((), shared),
                "physics": Stage(terms, shared_named),
                "split_only": Stage((), shared, *split_only),
                "after": Stage(terms, shared_named, *both),
            },
            held,
        )
        for (one, held), shared, shared_named in zip(recordings, plain, named, strict=True)
    ]
    return Improvement(
        rms["before"], rms["physics"], rms["after"], rms["split_only"], rms["persistence"],
        tuple(np.sqrt(floor.mean(axis=0)).tolist()), intervals, _pooled([one for one in rollouts if one]), removed,
    )  # fmt: skip


def improvable_removed(before: Sequence[float], other: Sequence[float], floor: Sequence[float]) -> float:
    """Return the share of squared error above the noise floor that is gone, channels weighed by their noise.

    NaN when the squared error before is, on average, within 2 % of the floor's: noise over noise is no share.
    """
    removable = removed = 0.0
    for error, left, noise in zip(before, other, floor, strict=True):
        if error > noise > 0.0:
            removable += (error**2 - noise**2) / noise**2
            removed += (error**2 - max(left, noise) ** 2) / noise**2
    return float(removed / removable) if removable > 0.02 * len(floor) else math.nan


def _learn_rest(parts: Sequence[LabelErrors], errors: list[np.ndarray], vehicle: Vehicle):
    """Learn what is left on the training windows; return a predictor and its grid, two None for too few."""
    training = []
    for part, error in zip(parts, errors, strict=True):
        labels = replace(part.labels, y=error)
        training.append(labels.take(~part.held))
    grid = z2_grid(vehicle, training[0].region)
    training = [labels.inside(grid) for labels in training]
    accepted = np.concatenate([labels.y[labels.accepted] for labels in training])
    if len(accepted) < _FEWEST_TO_LEARN:
        return None, None
    noise = np.mean([scatter_variance(labels) for labels in training], axis=0)
    trained = learn(training, vehicle=vehicle, grid=grid, kernel=default_kernel(grid, accepted, noise))
    return make_predictor("bcm", trained), grid


def _without(part: LabelErrors, error: np.ndarray, split) -> np.ndarray:
    """Return errors less what SPLIT predicts, where it claims to be valid."""
    predictor, grid = split
    left = error.copy()
    use = part.held & part.labels.accepted
    left[use] -= rest_of(predictor, grid, part.labels.z[use])
    return left


def _blocks(times: Sequence[np.ndarray], longest: float = _BLOCK_SECONDS) -> np.ndarray:
    """Number the blocks of time of all recordings; shorter ones where too few would be left to draw from."""
    seconds = sum(float(np.ptp(t)) for t in times if len(t)) / _WANTED_BLOCKS
    length = float(np.clip(seconds, _SHORTEST_BLOCK, longest))
    return np.concatenate([1_000_000 * k + (t // length).astype(np.int64) for k, t in enumerate(times)])


def _bootstrap(squared: Mapping[str, np.ndarray], floor: np.ndarray, block: np.ndarray):
    """Return 95 % intervals of each rms, and of the share of the improvable error removed, by block bootstrap.

    Notes
    -----
    Draws of few blocks vary too little: quantiles are moved away from the estimate by Student's t over the normal
    quantile, times the root of B/(B - 1) for B blocks.
    """
    from scipy.stats import t as student

    rng = np.random.default_rng(20240501)
    _, number = np.unique(block, return_inverse=True)
    count = np.bincount(number).astype(float)
    blocks = len(count)
    wider = float(student.ppf(0.975, max(blocks - 1, 1))) / 1.96 * np.sqrt(blocks / max(blocks - 1, 1))

    def sums(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(number, column) for column in values.T], axis=1)

    def interval(drawn: np.ndarray, estimate: np.ndarray) -> np.ndarray:
        return estimate + wider * (np.quantile(drawn, [0.025, 0.975], axis=0) - estimate)

    draws = rng.integers(0, blocks, (_BOOTSTRAPS, blocks))
    rows = count[draws].sum(axis=1)[:, None]
    rms = {name: np.sqrt(sums(e)[draws].sum(axis=1) / rows) for name, e in squared.items()}
    noise = np.sqrt(sums(floor)[draws].sum(axis=1) / rows)
    level = np.sqrt(floor.mean(axis=0))
    whole = {name: np.sqrt(e.mean(axis=0)) for name, e in squared.items()}
    intervals: dict[str, object] = {
        name: np.maximum(interval(values, whole[name]), 0.0).T.tolist() for name, values in rms.items()
    }
    intervals["blocks"] = blocks
    removed = {}
    for name in ("physics", "split_only", "after"):
        share = improvable_removed(whole["before"], whole[name], level)
        drawn = np.array([
            improvable_removed(*row) for row in zip(rms["before"], rms[name], noise, strict=True)
        ])  # fmt: skip
        drawn = drawn[np.isfinite(drawn)]
        told = math.isfinite(share) and len(drawn) > _MOSTLY * _BOOTSTRAPS
        removed[name] = (share, *np.minimum(interval(drawn, share), 1.0).tolist()) if told else None
    return intervals, removed


def _pooled(recordings: Sequence[RolloutErrors]) -> tuple[HorizonErrors, ...]:
    """Pool the recordings' rollouts, horizon by horizon."""
    out = []
    for k, horizon in enumerate(HORIZONS):
        having = [one for one in recordings if len(one.horizons) > k and len(one.t)]
        if not having:
            break
        squared = {name: np.concatenate([one.squared[name][:, k] for one in having]) for name in having[0].squared}
        floor = np.concatenate([one.floor[:, k] for one in having])
        block = _blocks([one.t for one in having], max(_BLOCK_SECONDS, horizon))
        intervals, _ = _bootstrap(squared, floor, block)
        rms = {name: tuple(np.sqrt(values.mean(axis=0)).tolist()) for name, values in squared.items()}
        out.append(
            HorizonErrors(
                horizon, rms["before"], rms["physics"], rms["split_only"], rms["after"], rms["persistence"],
                tuple(np.sqrt(floor.mean(axis=0)).tolist()), intervals, len(block),
            )
        )  # fmt: skip
    return tuple(out)
