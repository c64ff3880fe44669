"""How much of the correction learned from the simulation is used, by held-out simulation and real time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import learn_discrepancy
from split_cli.diagnosis.innovations.rollouts import (
    HORIZONS,
    RolloutErrors,
    SharedRates,
    Stage,
    roll_out_stages,
    shared_rates,
)
from split_cli.vehicle.effects import Term

#: What a simulation offers to predict with: the nominal model alone; with what the simulation taught at the
#: recorded states; and with what it taught of other states.
OFFERS = ("nominal", "taught", "taught_elsewhere")
# Lateral velocity and yaw rate move together.
_LONGITUDINAL, _LATERAL = (0,), (1, 2)
_JUDGED = (0.05, *HORIZONS)  # [s]
_CHECKED_SHARE = 0.25  # of each simulation's time, at its end, as of the real drives
_STARTS = 40


@dataclass(frozen=True)
class SimulationPart:
    """What of a simulation predicts beside the nominal model, one of `OFFERS` each."""

    longitudinal: str = "nominal"  # in v_x
    lateral: str = "nominal"  # in v_y and r


def part_of(part: SimulationPart, whole: SharedRates | None) -> SharedRates | None:
    """Return what a part adds to the nominal model along a recording; None adds nothing."""
    offers = np.array([part.longitudinal, part.lateral, part.lateral])
    if whole is None or np.all(offers == "nominal"):
        return None
    return whole.only(offers != "nominal", offers == "taught_elsewhere")


def chosen_simulation_parts(
    recordings: Sequence[tuple[Evidence, np.ndarray]],
    simulated: Sequence[Evidence],
    discrepancy: SharedDiscrepancy,
    bare: Sequence[SharedRates | None],
    named: Sequence[SharedRates | None],
    terms: Sequence[Term] = (),
) -> tuple[SimulationPart, SimulationPart]:
    """Return which parts predict best without and with terms, never one that fails on the simulation itself.

    Parameters
    ----------
    recordings : sequence of (Evidence, ndarray of bool of shape (N,))
        Real recordings and which of their rows are held out; those are not looked at.
    bare, named : sequence of SharedRates or None
        All that the simulation knows along each recording, without and with terms.

    Notes
    -----
    An offer must predict the end of every simulation no worse than the nominal model does, learned from what comes
    before; of the pairs of those that do, the one is taken that predicts the real drives' training time best. Both
    by `log_error_ratio`. With terms another pair than without them is taken only if no velocity is predicted worse
    with it there: else what names do to one velocity would be mixed with what the exchange does to another.
    """
    if any(one is None for one in bare):
        return SimulationPart(), SimulationPart()
    believable = _that_predict_the_simulation(simulated, discrepancy)
    rows = [(one, ~held) for one, held in recordings]
    before = _best(rows, bare, (), believable)
    return before, _best(rows, named, terms, believable, before) if terms else before


def _that_predict_the_simulation(
    simulated: Sequence[Evidence], discrepancy: SharedDiscrepancy
) -> tuple[Sequence[str], Sequence[str]]:
    """Return the longitudinal and the lateral offers that predict the simulations' ends."""
    ends = [one.series.t > (1.0 - _CHECKED_SHARE) * one.series.t[-1] for one in simulated]
    taught = learn_discrepancy([_without(one, end) for one, end in zip(simulated, ends, strict=True)])
    rates = [shared_rates(one.series, discrepancy, taught) for one in simulated]
    parts = {offer: SimulationPart(offer, offer) for offer in OFFERS}
    judged = _errors(list(zip(simulated, ends, strict=True)), rates, (), parts)
    return tuple(
        [offer for offer in OFFERS if _excess(judged, offer, "nominal", channels) <= 0.0]
        for channels in (_LONGITUDINAL, _LATERAL)
    )


def _best(
    rows: Sequence[tuple[Evidence, np.ndarray]],
    rates: Sequence[SharedRates | None],
    terms: Sequence[Term],
    believable: tuple[Sequence[str], Sequence[str]],
    usual: SimulationPart | None = None,
) -> SimulationPart:
    parts = [SimulationPart(*pair) for pair in product(*believable)]
    return best_part(_errors(rows, rates, terms, {str(part): part for part in parts}), parts, usual)


def best_part(
    judged: Sequence[RolloutErrors], parts: Sequence[SimulationPart], usual: SimulationPart | None = None
) -> SimulationPart:
    """Return the part with the least errors; beside a usual one, of those by which no velocity has larger ones.

    Parameters
    ----------
    judged : sequence of RolloutErrors
        With a stage for each part, named by ``str(part)``.
    """
    channels = (*_LONGITUDINAL, *_LATERAL)
    if usual is not None:
        parts = [
            part
            for part in parts
            if all(_excess(judged, str(part), str(usual), (channel,)) <= 0.0 for channel in channels)
        ]
    return min(parts, key=lambda part: _excess(judged, str(part), str(SimulationPart()), channels))


def _excess(judged: Sequence[RolloutErrors], stage: str, than: str, channels: Sequence[int]) -> float:
    return sum(len(one.t) * log_error_ratio(one, stage, than, channels) for one in judged)


def _without(evidence: Evidence, rows: np.ndarray) -> Evidence:
    """Return evidence to learn from, less what lies on `rows` of the recording."""
    kept = ~rows[evidence.at]
    return replace(
        evidence,
        nominal_rows=evidence.nominal_rows[kept],
        discrepancy=evidence.discrepancy[kept],
        weight=evidence.weight[kept],
    )


def _errors(
    rows: Sequence[tuple[Evidence, np.ndarray]],
    rates: Sequence[SharedRates | None],
    terms: Sequence[Term],
    parts: dict[str, SimulationPart],
) -> list[RolloutErrors]:
    """Return rollout errors with each part; recordings too short for one are left out."""
    out = []
    for (one, judged), known in zip(rows, rates, strict=True):
        stages = {name: Stage(tuple(terms), part_of(part, known)) for name, part in parts.items()}
        out.append(roll_out_stages(one, stages, judged, horizons=_JUDGED, most_starts=_STARTS))
    return [errors for errors in out if errors is not None]


def log_error_ratio(errors: RolloutErrors, stage: str, than: str, channels: Sequence[int] = (0, 1, 2)) -> float:
    """Return by how much a stage's errors exceed another's [1].

    The mean of log(rms/rms) over horizons and channels. Below the noise floor all errors are alike.
    """
    columns = list(channels)
    floor = errors.floor[:, :, columns].mean(axis=0)
    one, other = (np.maximum(errors.squared[name][:, :, columns].mean(axis=0), floor) for name in (stage, than))
    return 0.5 * float(np.mean(np.log(one / other)))
