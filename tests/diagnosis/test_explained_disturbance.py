"""What an explanation explains is no disturbance: noise and weights of the second search."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.case import DiagnosisCase, gather_case
from split_cli.diagnosis.innovations.objective import build_objective
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import case_of, driven, noisy, prepared
from tests.factories import road_car

LAG = CATALOGUE["steer_lag"]({"tau": 0.08})
SLOW = CATALOGUE["steer_lag"]({"tau": 0.15})
TURNED = CATALOGUE["sensor_misalignment"]({"angle": 0.03})


def cost_of_an_entry(case: DiagnosisCase) -> float:
    """Return the cost that the true model leaves, over the number of compared entries [1]."""
    objective = build_objective(case.real, None, case.discrepancy, case.keep)
    return objective.cost((SLOW,)) / (3 * sum(int(keep.sum()) for keep in case.keep))


def test_the_truth_costs_one_for_each_entry():
    """The recording has sensor noise alone; the lag was taken for noise."""
    case = gather_case(road_car(), [prepared(noisy(driven(43, (SLOW,)), 3))])
    # 5,000 entries have a standard deviation of 2 %; the noise of the sensors is estimated to a few per cent.
    assert cost_of_an_entry(case) < 0.75
    assert cost_of_an_entry(case.whitened_about((SLOW,))) == pytest.approx(1.0, abs=0.12)


def test_all_that_was_found_counts_and_the_simulation_is_learned_again():
    """A lag, and a velocity sensor that is turned: either alone leaves the other as disturbance."""
    drive = noisy(driven(43, (LAG,)), 3)
    turned = replace(drive, columns={**drive.columns, **TURNED.corrupt(drive.columns, None)})
    case = case_of(turned, noisy(driven(44), 4))
    sound = case_of(noisy(driven(43), 3), noisy(driven(44), 4))
    found = {terms: case.whitened_about(terms) for terms in ((), (LAG,), (LAG, TURNED))}
    across = [float(one.real[0].disturbance[1]) for one in found.values()]
    # A grid of the search has two steps in a factor of 3.2.
    assert across[0] > 300.0 * sound.real[0].disturbance[1] and across[1] > 300.0 * sound.real[0].disturbance[1]
    assert across[2] < 10.0 * sound.real[0].disturbance[1]
    # Rows that were far off beside the fault have their whole weight.
    assert np.all(found[(LAG, TURNED)].real[0].weight >= case.real[0].weight)
    assert found[()] is case
    again = found[(LAG, TURNED)]
    deviation = [np.sqrt(np.diag(np.linalg.inv(one.posterior.precision))) for one in (case, again)]
    assert np.median(deviation[1] / deviation[0]) < 0.8


def test_equal_disturbance_leaves_what_was_learned():
    case = case_of(noisy(driven(43, (LAG,)), 3), noisy(driven(44), 4))
    about = case.whitened_about((LAG,))
    again = about.whitened_about((LAG,))
    assert about.rewhitened is not case.rewhitened
    assert again.rewhitened is about.rewhitened and again.posterior is about.posterior
