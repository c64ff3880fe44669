"""Held-out errors of the corrected vehicle file compared with those of the given one, without a simulation."""

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.rollouts import HORIZONS, RolloutErrors, Stage, roll_out_stages
from split_cli.diagnosis.statement.improvement import CorrectedVehicle, StateChange
from split_cli.diagnosis.statement.wording import STATES
from split_cli.diagnosis.verdict.label_errors import BLOCK_SECONDS, blocks_of_time, in_standard_errors
from split_cli.logs.drive_metadata import circular_in_any
from split_cli.vehicle.effects import Term

_STEP = 0.05  # [s]


def judge_corrected(
    recordings: Sequence[tuple[Evidence, np.ndarray]], terms: Sequence[Term]
) -> CorrectedVehicle | None:
    """Compare the nominal model with the same model and those terms that a vehicle file can hold.

    Parameters
    ----------
    recordings : sequence of (Evidence, ndarray of bool of shape (N,))
        Real recordings and which of their samples are held out.
    terms : sequence of Term
        Fitted without the held-out time. Recordings are corrected for sensor faults before both models run.

    Returns
    -------
    CorrectedVehicle or None
        Errors of v_x, v_y and r after one step and after 2 s. None if no term belongs into the file, or no rollout
        fits into the held-out time.

    Notes
    -----
    A vehicle file is used without the simulation, so the shared discrepancy is left out. A state is worse if its
    squared error increased by more than 1.96 standard errors, estimated over blocks of time. A state is left out if a
    drive says nothing of it. With a torque that was derived from the motion the nominal model repeats the recorded v_x,
    whatever car drove; with a v_y that the rear tyres of the vehicle file gave, that v_y.
    """
    car = tuple(term for term in terms if term.exported)
    if not car:
        return None
    sensors = tuple(term for term in terms if not term.exported)
    stages = {"nominal": Stage(sensors, None), "corrected": Stage(tuple(terms), None)}
    runs = [
        errors
        for one, held in recordings
        if (errors := roll_out_stages(one, stages, held, horizons=(_STEP, *HORIZONS))) is not None
    ]
    if not runs:
        return None
    last = max(len(one.horizons) for one in runs) - 1
    derived = circular_in_any([one.series.drive.metadata for one, _ in recordings])
    states = (state for k in dict.fromkeys((0, last)) for state in _states_at(runs, k))
    return CorrectedVehicle(tuple(state for state in states if state.channel not in derived))


def _states_at(runs: Sequence[RolloutErrors], k: int) -> list[StateChange]:
    """Return the errors of v_x, v_y and r at the k-th horizon, pooled over recordings."""
    having = [one for one in runs if len(one.horizons) > k]
    horizon = having[0].horizons[k]
    squared = {name: np.concatenate([one.squared[name][:, k] for one in having]) for name in having[0].squared}
    floor = np.sqrt(np.concatenate([one.floor[:, k] for one in having]).mean(axis=0))
    block = blocks_of_time([one.t for one in having], max(BLOCK_SECONDS, horizon))
    change = in_standard_errors(squared["corrected"] - squared["nominal"], block)
    rms = {name: np.sqrt(values.mean(axis=0)) for name, values in squared.items()}
    return [
        StateChange(
            channel,
            unit,
            horizon,
            *(float(rms[name][i]) for name in ("nominal", "corrected", "persistence")),
            float(floor[i]),
            float(change[i]),
        )
        for i, (channel, unit) in enumerate(STATES)
    ]
