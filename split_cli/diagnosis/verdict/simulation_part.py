"""Which part of the shared discrepancy is used for predictions, chosen on held-out simulated time and on real time."""

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

#: Ways to use the shared discrepancy: not at all; at the recorded states; and also at other states, by its derivative.
#: The names are those of `diagnosis.json`.
OFFERS = ("nominal", "taught", "taught_elsewhere")
# Outputs for which one choice is made: v_x; and v_y with r, which are coupled.
_LONGITUDINAL, _LATERAL = (0,), (1, 2)
_JUDGED = (0.05, *HORIZONS)  # [s]
_CHECKED_SHARE = 0.25  # share of each simulation's time, at its end, on which a part is tested [1]
_STARTS = 40  # starts of rollouts in each recording [1]


@dataclass(frozen=True)
class SimulationPart:
    """How the shared discrepancy is used, one of `OFFERS` for each group of outputs."""

    longitudinal: str = "nominal"  # in v_x
    lateral: str = "nominal"  # in v_y and r


def part_of(part: SimulationPart, whole: SharedRates | None) -> SharedRates | None:
    """Return the used part of the shared discrepancy along a recording; None if it is not used."""
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
    """Return the parts that predict best without and with terms.

    Parameters
    ----------
    recordings : sequence of (Evidence, ndarray of bool of shape (N,))
        Real recordings and which of their samples are held out; held-out time is not used.
    bare, named : sequence of SharedRates or None
        The whole shared discrepancy along each recording, without and with terms.

    Notes
    -----
    A way of use must predict the end of every simulation no worse than the nominal model, when learned from the time
    before. Of the remaining pairs that one is taken which predicts the real drives' training time best. Both use
    `log_error_ratio`. With terms another pair than without is taken only if no velocity is predicted worse for it.
    Otherwise the effect of the terms on one velocity would be mixed with that of the exchange on another.
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
    """Return the longitudinal and the lateral ways of use that predict the ends of the simulations."""
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
    """Return the part with the smallest errors; with `usual` only of those that make no velocity's error larger.

    Parameters
    ----------
    judged : sequence of RolloutErrors
        Of rollouts with a stage for each part, named ``str(part)``.
    usual : SimulationPart, optional
        The part chosen without terms.
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
    """Return evidence to learn from, without the samples `rows` of the recording, bool (N,)."""
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
    """Return rollout errors with each part; recordings that are too short are left out."""
    out = []
    for (one, judged), known in zip(rows, rates, strict=True):
        stages = {name: Stage(tuple(terms), part_of(part, known)) for name, part in parts.items()}
        out.append(roll_out_stages(one, stages, judged, horizons=_JUDGED, most_starts=_STARTS))
    return [errors for errors in out if errors is not None]


def log_error_ratio(errors: RolloutErrors, stage: str, than: str, channels: Sequence[int] = (0, 1, 2)) -> float:
    """Return the mean of log(rms of a stage/rms of another) over horizons and channels [1].

    Errors below the noise floor count as the floor.
    """
    columns = list(channels)
    floor = errors.floor[:, :, columns].mean(axis=0)
    one, other = (np.maximum(errors.squared[name][:, :, columns].mean(axis=0), floor) for name in (stage, than))
    return 0.5 * float(np.mean(np.log(one / other)))
