"""Improvement: held-out errors of one step and of rollouts with and without the findings and SPLIT."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import DiscrepancyPosterior
from split_cli.diagnosis.innovations.rollouts import (
    HORIZONS,
    LearnedCorrection,
    RolloutErrors,
    Stage,
    roll_out_stages,
    shared_rates,
)
from split_cli.diagnosis.statement.improvement import HorizonErrors, Improvement
from split_cli.diagnosis.verdict.label_errors import (
    BLOCK_SECONDS,
    LabelErrors,
    blocks_of_time,
    in_standard_errors,
    label_errors,
)
from split_cli.diagnosis.verdict.learned_correction import learn_correction, without_correction
from split_cli.diagnosis.verdict.simulation_part import chosen_simulation_parts, part_of
from split_cli.vehicle.effects import Term

_BOOTSTRAPS = 400  # draws of blocks [1]; judgement: ten draws lie beyond each end of a 95 % interval
_MOSTLY = 0.9  # share of draws with an error above the noise floor that an interval of a share needs [1]


def measure_improvement(
    recordings: Sequence[tuple[Evidence, np.ndarray]],
    terms: Sequence[Term],
    discrepancy: SharedDiscrepancy,
    posterior: DiscrepancyPosterior | None,
    simulated: Sequence[Evidence] = (),
) -> Improvement | None:
    """Compare the simulation, the findings and SPLIT on held-out time.

    Parameters
    ----------
    recordings : sequence of (Evidence, ndarray of bool of shape (N,))
        Real recordings and which of their samples are held out; SPLIT learns on the other samples.
    terms : sequence of Term
        Fitted without the held-out time.
    posterior : DiscrepancyPosterior or None
        Of the shared discrepancy.
    simulated : sequence of Evidence
        From which it was learned, and on which it is checked.

    Returns
    -------
    Improvement or None
        None if no step lies wholly in held-out time.

    Notes
    -----
    Of the shared discrepancy that part is used which predicts best, see `chosen_simulation_parts`. A comparison with a
    diverging model would be too easy.
    """
    terms = tuple(terms)
    plain = [shared_rates(one.series, discrepancy, posterior) for one, _ in recordings]
    named = [shared_rates(one.series, discrepancy, posterior, terms) for one, _ in recordings] if terms else plain
    chosen = chosen_simulation_parts(recordings, simulated, discrepancy, plain, named, terms)
    plain, named = (
        [part_of(part, one) for one in several] for part, several in zip(chosen, (plain, named), strict=True)
    )
    parts = [label_errors(one, terms, *both, held) for (one, held), *both in zip(recordings, plain, named, strict=True)]
    if not any(part.held.any() for part in parts):
        return None
    errors_before, errors_physics = ([getattr(one, name) for one in parts] for name in ("before", "physics"))
    split_only = learn_correction(recordings, [Stage((), one) for one in plain], parts, errors_before)
    both = split_only
    if terms:
        both = learn_correction(recordings, [Stage(terms, one) for one in named], parts, errors_physics)
    errors = _held_out_errors(parts, split_only, both)
    block = blocks_of_time([part.labels.t[part.held] for part in parts])
    floor = np.concatenate([part.floor[part.held] for part in parts])
    rms = {name: tuple(np.sqrt(np.mean(e**2, axis=0)).tolist()) for name, e in errors.items()}
    intervals, removed = _bootstrap({name: e**2 for name, e in errors.items()}, floor, block)
    stages = [
        {
            "before": Stage((), shared),
            "physics": Stage(terms, shared_named),
            "split_only": Stage((), shared, split_only),
            "after": Stage(terms, shared_named, both),
        }
        for shared, shared_named in zip(plain, named, strict=True)
    ]
    rollouts = [roll_out_stages(one, several, held) for (one, held), several in zip(recordings, stages, strict=True)]
    return Improvement(
        rms["before"],
        rms["physics"],
        rms["after"],
        rms["split_only"],
        rms["persistence"],
        tuple(np.sqrt(floor.mean(axis=0)).tolist()),
        intervals,
        _pooled([one for one in rollouts if one]),
        removed,
        {stage: asdict(part) for stage, part in zip(("before", "physics"), chosen, strict=True)},
        {
            name: (0.0, 0.0, 0.0) if correction is None else tuple(correction.trust.tolist())
            for name, correction in (("split_only", split_only), ("after", both))
        },
    )


def _held_out_errors(
    parts: Sequence[LabelErrors], split_only: LearnedCorrection | None, both: LearnedCorrection | None
) -> dict[str, np.ndarray]:
    """Return the held-out one-step errors of each stage, over all recordings, shape (L, 3) each."""
    by_stage = {
        "before": [part.steps("before", part.before) for part in parts],
        "physics": [part.steps("physics", part.physics) for part in parts],
        "split_only": [part.steps("before", without_correction(part, part.before, split_only)) for part in parts],
        "after": [part.steps("physics", without_correction(part, part.physics, both)) for part in parts],
        "persistence": [part.persistence for part in parts],
    }
    return {
        name: np.concatenate([values[part.held] for values, part in zip(several, parts, strict=True)])
        for name, several in by_stage.items()
    }


def improvable_removed(before: Sequence[float], other: Sequence[float], floor: Sequence[float]) -> float:
    """Return the removed share of the squared error above the noise floor, channels weighted by their noise [1].

    Parameters
    ----------
    before, other, floor : sequence of float
        Rms errors of v_x, v_y and r.

    Returns
    -------
    float
        NaN if the squared error before is on average within 2 % of the floor's.
    """
    removable = removed = 0.0
    for error, left, noise in zip(before, other, floor, strict=True):
        if error > noise > 0.0:
            removable += (error**2 - noise**2) / noise**2
            removed += (error**2 - max(left, noise) ** 2) / noise**2
    return float(removed / removable) if removable > 0.02 * len(floor) else math.nan


def _bootstrap(squared: Mapping[str, np.ndarray], floor: np.ndarray, block: np.ndarray):
    """Return 95 % intervals of each rms, and of the share of `improvable_removed`, by block bootstrap.

    Notes
    -----
    With few blocks bootstrap intervals are too narrow. The distances of the quantiles from the estimate are multiplied
    by the ratio of the Student to the normal quantile and by the root of B/(B - 1), for B blocks.
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
        drawn = np.array([improvable_removed(*row) for row in zip(rms["before"], rms[name], noise, strict=True)])
        drawn = drawn[np.isfinite(drawn)]
        known = math.isfinite(share) and len(drawn) > _MOSTLY * _BOOTSTRAPS
        removed[name] = (share, *np.minimum(interval(drawn, share), 1.0).tolist()) if known else None
    return intervals, removed


def _pooled(recordings: Sequence[RolloutErrors]) -> tuple[HorizonErrors, ...]:
    """Return the errors of rollouts at each horizon, pooled over recordings."""
    out = []
    for k, horizon in enumerate(HORIZONS):
        having = [one for one in recordings if len(one.horizons) > k and len(one.t)]
        if not having:
            break
        squared = {name: np.concatenate([one.squared[name][:, k] for one in having]) for name in having[0].squared}
        floor = np.concatenate([one.floor[:, k] for one in having])
        block = blocks_of_time([one.t for one in having], max(BLOCK_SECONDS, horizon))
        intervals, _ = _bootstrap(squared, floor, block)
        rms = {name: tuple(np.sqrt(values.mean(axis=0)).tolist()) for name, values in squared.items()}
        out.append(
            HorizonErrors(
                horizon,
                rms["before"],
                rms["physics"],
                rms["split_only"],
                rms["after"],
                rms["persistence"],
                tuple(np.sqrt(floor.mean(axis=0)).tolist()),
                intervals,
                len(block),
                {
                    name: tuple(in_standard_errors(squared[name] - squared["before"], block).tolist())
                    for name in ("physics", "split_only", "after")
                },
                tuple(in_standard_errors(squared["after"] - squared["physics"], block).tolist()),
                {
                    name: tuple(np.concatenate([one.signed[name][:, k] for one in having]).mean(axis=0).tolist())
                    for name in squared
                },
            )
        )
    return tuple(out)
