"""Two further terms at once: what they promise is one linear fit, and a fit of both keeps it."""

from itertools import combinations

import numpy as np
import pytest

from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.search.pairs import costs_of_pairs, estimated_pairs, with_pair
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import candidates_of, driven, explorer, noisy_objective

TRUE = {"aero_drag": {"drag": 0.5}, "steer_gain": {"gain": 1.04}, "yaw_inertia": {"scale": 1.12}}


@pytest.fixture(scope="module")
def explore() -> Explorer:
    objective = noisy_objective(driven(21, [CATALOGUE[term](values) for term, values in TRUE.items()]), 5)
    return explorer(objective, *TRUE, "rolling_resistance", "tire_stiffness", "steer_lag", "steer_signal_delay")


@pytest.fixture(scope="module")
def current(explore) -> Fit:
    (drag,) = candidates_of(explore.objective, "aero_drag")
    return fit_parts(explore.objective, [Part(drag, dict(drag.starts[0]))])


@pytest.mark.parametrize("beside", ["nothing", "drag"])
def test_what_two_promise_is_what_one_linear_fit_of_both_leaves(explore, current, beside):
    lines = explore.tangents()
    if beside == "nothing":
        residuals = explore.objective.whiten(explore.objective.residual(()))
        current = Fit((), float(residuals @ residuals), residuals, np.empty((len(residuals), 0)))
    costs = {(i, j): cost for i, j, cost in costs_of_pairs(current, lines)}
    terms = [one.part.candidate.term for one in lines]
    late = {"steer_lag", "steer_signal_delay"}
    unlike = [
        (i, j)
        for i, j in combinations(range(len(lines)), 2)
        if terms[i] != terms[j] and not {terms[i], terms[j]} <= late
    ]
    assert late < set(terms)
    assert list(costs) == unlike
    for i, j in unlike[::7]:
        columns = np.hstack([lines[i].slopes, lines[j].slopes, current.sensitivity])
        here = current.residuals + lines[i].moved + lines[j].moved
        left = here - columns @ np.linalg.lstsq(columns, here, rcond=None)[0]
        assert costs[i, j] == pytest.approx(float(left @ left), rel=1e-5)


def test_the_true_two_promise_most_and_keep_it(explore, current):
    (best, first, second), (next_best, *_) = estimated_pairs(explore, current)[:2]
    assert {first.part.candidate.term, second.part.candidate.term} == {"steer_gain", "yaw_inertia"}
    fit = with_pair(explore, current, (first, second))
    assert explore.price(fit) == pytest.approx(best, rel=0.02) and explore.price(fit) < next_best
    assert {part.candidate.term: part.values for part in fit.parts} == {
        term: {name: pytest.approx(value, rel=0.05) for name, value in values.items()} for term, values in TRUE.items()
    }
