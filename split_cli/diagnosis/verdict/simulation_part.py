"""What of the simulation's own knowledge is believed: checked on held-out simulation and on the real drive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.diagnosis.baseline.common import CommonPhysics
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.judge import CommonKnowledge, learn_common
from split_cli.diagnosis.innovations.rollouts import (
    HORIZONS,
    RolloutErrors,
    SharedRates,
    Stage,
    roll_out_stages,
    shared_rates,
)
from split_cli.vehicle.effects import Term

__all__ = ["PARTS", "believed_parts", "part_of", "relative_error"]

#: What a simulation offers to predict with: the nominal model alone; with what the simulation taught at the
#: recorded states; and with what it taught of other states.
PARTS = ("nominal", "taught", "taught_elsewhere")
_JUDGED = (0.05, *HORIZONS)  # [s]
_CHECKED_SHARE = 0.25  # of each simulation's time, at its end, as of the real drives
_STARTS = 60


def part_of(
    part: str,
    evidence: Evidence,
    common: CommonPhysics,
    knowledge: CommonKnowledge | None,
    terms: Sequence[Term] = (),
) -> SharedRates | None:
    """Return what a part (one of `PARTS`) adds to the nominal model along a recording; None adds nothing."""
    if part == "nominal":
        return None
    shared = shared_rates(evidence.series, common, knowledge, terms)
    return shared if shared is None or part == "taught_elsewhere" else shared.at_recorded_states()


def believed_parts(
    recordings: Sequence[tuple[Evidence, np.ndarray]],
    simulated: Sequence[Evidence],
    common: CommonPhysics,
    knowledge: CommonKnowledge | None,
    terms: Sequence[Term] = (),
) -> tuple[str, str]:
    """Return which of `PARTS` predicts best without and with terms, never one that fails on the simulation itself.

    Parameters
    ----------
    recordings : sequence of (Evidence, ndarray of bool of shape (N,))
        Real recordings and which of their rows are held out; those are not looked at.
    simulated : sequence of Evidence
    common : CommonPhysics
    knowledge : CommonKnowledge or None
        Learned from all of the simulation.
    terms : sequence of Term

    Notes
    -----
    A part must predict the end of every simulation no worse than the nominal model does, learned from what comes
    before; of those that do, the one is taken that predicts the real drives' training time best. Both by
    `relative_error`.
    """
    if knowledge is None:
        return "nominal", "nominal"
    passed = _that_predict_the_simulation(simulated, common)
    plain = _best(recordings, common, knowledge, (), passed)
    return plain, _best(recordings, common, knowledge, terms, passed) if terms else plain


def _best(recordings, common, knowledge, terms: Sequence[Term], parts: Sequence[str]) -> str:
    judged = [_errors(one, ~held, common, knowledge, parts, terms) for one, held in recordings]
    judged = [errors for errors in judged if errors is not None]
    if not judged:
        return "nominal"
    return min(parts, key=lambda part: sum(relative_error(errors, part) for errors in judged))


def _that_predict_the_simulation(simulated: Sequence[Evidence], common: CommonPhysics) -> list[str]:
    ends = [one.series.t > (1.0 - _CHECKED_SHARE) * one.series.t[-1] for one in simulated]
    taught = learn_common([_without(one, end) for one, end in zip(simulated, ends, strict=True)])
    judged = [
        errors
        for one, end in zip(simulated, ends, strict=True)
        if (errors := _errors(one, end, common, taught, PARTS)) is not None
    ]
    if not judged:
        return list(PARTS)
    return [part for part in PARTS if sum(relative_error(errors, part) for errors in judged) <= 0.0]


def _without(evidence: Evidence, rows: np.ndarray) -> Evidence:
    """Return evidence to learn from, less what lies on `rows` of the recording."""
    kept = ~rows[evidence.at]
    return replace(
        evidence, plain=evidence.plain[kept], common=evidence.common[kept], weight=evidence.weight[kept]
    )


def _errors(
    evidence: Evidence,
    rows: np.ndarray,
    common: CommonPhysics,
    knowledge: CommonKnowledge,
    parts: Sequence[str],
    terms: Sequence[Term] = (),
) -> RolloutErrors | None:
    terms = tuple(terms)
    stages = {part: Stage(terms, part_of(part, evidence, common, knowledge, terms)) for part in parts}
    return roll_out_stages(evidence, stages, rows, horizons=_JUDGED, most_starts=_STARTS)


def relative_error(errors: RolloutErrors, stage: str, than: str = "nominal") -> float:
    """Return by how much a stage's errors exceed another's, in the mean over horizons and channels [1].

    Notes
    -----
    The mean of log(rms/rms) times the starts, so that recordings count by their length. Below the noise floor all
    errors are alike.
    """
    squared: Mapping[str, np.ndarray] = errors.squared
    floor = errors.floor.mean(axis=0)
    one, other = (np.maximum(squared[name].mean(axis=0), floor) for name in (stage, than))
    return 0.5 * float(np.mean(np.log(one / other))) * len(errors.t)
